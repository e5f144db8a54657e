"""Vocabulary tree of binary words: which descriptors may be compared at all.

A tree of k-majority clusters (Grana et al., 2013; DBoW2 of Galvez-Lopez and Tardos, TRO 2012, does alike): every node
splits its descriptors into ``branches`` groups, whose centres are bitwise majorities. Two descriptors match only
within a node, which is what makes matching take milliseconds.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.monocular.bits import population_count
from mixo_env.files import atomic_path

GENERAL_VOCABULARY = Path(__file__).parents[1] / "data" / "vocabulary.npy"
"""Learned on three simulated drives (rain, night, sun; another seed than any recording) in all four cameras:

    mixo simulate city101 --seed 101 --scenes 3 --scenes-per-log 1 --rain 0.34 --night 0.34
    mixo train-vocabulary city101 --out vocabulary.npy
"""

_MOST_DESCRIPTORS = 200_000  # for training: a sample of so many bounds time and memory
_TAKEN = 2**31 - 1  # larger than any key: a word that was chosen is not chosen again


@dataclass(frozen=True)
class Vocabulary:
    """Two levels of words.

    Attributes:
        centres: ``(branches, 1 + branches, 4)`` uint64: of each first-level node its centre, then its children's.
    """

    centres: NDArray[np.uint64]

    @property
    def branches(self) -> int:
        """Children per node."""
        return len(self.centres)

    def __len__(self) -> int:
        """Number of words, the leaves of the tree."""
        return self.branches**2

    def nearest(self, descriptor: NDArray[np.uint64], count: int = 1) -> NDArray[np.int32]:
        """Words nearest to each descriptor ``(n, 4)``, the nearest first: ``(n, count)``, below ``len(self)``."""
        return nearest_words(descriptor, self.centres[:, 1:].reshape(-1, 4), count)

    def save(self, path: Path) -> None:
        """Write to an ``.npy`` file, atomically.

        Raises:
            OutputError: when it cannot be written.
        """
        with atomic_path(path) as temporary, temporary.open("wb") as file:
            np.save(file, self.centres)


@functools.cache
def load_vocabulary(path: Path = GENERAL_VOCABULARY) -> Vocabulary:
    """Read a vocabulary.

    Raises:
        DatasetError: no such file, or not a vocabulary.
    """
    try:
        centres = np.load(path, allow_pickle=False)
    except (OSError, ValueError) as error:
        raise DatasetError(f"cannot read vocabulary {path}: {error}; make one with `mixo train-vocabulary`") from error
    shape = centres.shape
    if centres.dtype != np.uint64 or len(shape) != 3 or shape[1] != shape[0] + 1 or shape[2] != 4:
        raise DatasetError(
            f"{path} is not a vocabulary: expected uint64 (k, k + 1, 4), got {centres.dtype} {shape}; "
            "make one with `mixo train-vocabulary`"
        )
    return Vocabulary(centres)


def train_vocabulary(descriptor: NDArray[np.uint64], branches: int = 10, seed: int = 0) -> Vocabulary:
    """Cluster descriptors into a two-level tree.

    Args:
        descriptor: ``(n, 4)`` uint64; at most 200,000 of them, picked at random, are used.
        branches: children per node.
        seed: of that pick and of the first centres.

    Raises:
        ConfigurationError: too few descriptors for so many branches.
    """
    if len(descriptor) < 20 * branches**2:
        raise ConfigurationError(
            f"a vocabulary of {branches} x {branches} words needs {20 * branches**2} descriptors, "
            f"got {len(descriptor)}: give more images"
        )
    rng = np.random.default_rng(seed)
    some = np.sort(rng.permutation(len(descriptor))[:_MOST_DESCRIPTORS])
    descriptor = np.ascontiguousarray(descriptor[some])
    centres = np.empty((branches, branches + 1, 4), np.uint64)
    top, label = _cluster(descriptor, branches, rng)
    for k in range(branches):
        centres[k, 0] = top[k]
        centres[k, 1:], _ = _cluster(descriptor[label == k], branches, rng)
    return Vocabulary(centres)


def _cluster(
    descriptor: NDArray[np.uint64], k: int, rng: np.random.Generator, rounds: int = 12
) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """k-majority clustering: centres ``(k, 4)`` and label ``(n,)``. Sets smaller than k repeat their members."""
    start = rng.permutation(len(descriptor))[:k]
    centres = descriptor[np.resize(start, k)].copy() if len(start) else np.zeros((k, 4), np.uint64)
    label = np.full(len(descriptor), -1, np.int32)
    for _ in range(rounds):
        if _assign(descriptor, centres, label) <= len(descriptor) // 200:
            break
        _majority(descriptor, label, centres)
    return centres, label


@compiled
def _nearest(word: NDArray[np.uint64], centres: NDArray[np.uint64]) -> int:
    best, at = 512, 0
    for k in range(len(centres)):
        bits = np.int64(0)
        for w in range(4):
            bits += np.int64(population_count(word[w] ^ centres[k, w]))
        if bits < best:
            best, at = bits, k
    return at


@compiled
def _assign(descriptor: NDArray[np.uint64], centres: NDArray[np.uint64], label: NDArray[np.int32]) -> int:
    changed = 0
    for i in range(len(descriptor)):
        k = _nearest(descriptor[i], centres)
        changed += label[i] != k
        label[i] = k
    return changed


@compiled
def _majority(descriptor: NDArray[np.uint64], label: NDArray[np.int32], centres: NDArray[np.uint64]) -> None:
    k = len(centres)
    ones = np.zeros((k, 256), np.int64)
    members = np.zeros(k, np.int64)
    for i in range(len(descriptor)):
        members[label[i]] += 1
        for bit in range(256):
            ones[label[i], bit] += np.int64((descriptor[i, bit >> 6] >> np.uint64(bit & 63)) & np.uint64(1))
    for j in range(k):
        if members[j] == 0:
            continue
        for w in range(4):
            word = np.uint64(0)
            for bit in range(64):
                if 2 * ones[j, 64 * w + bit] > members[j]:
                    word |= np.uint64(1) << np.uint64(bit)
            centres[j, w] = word


@compiled
def nearest_words(descriptor: NDArray[np.uint64], words: NDArray[np.uint64], count: int) -> NDArray[np.int32]:
    """Words ``(k, 4)`` nearest to each descriptor ``(n, 4)``, the nearest first: indices ``(n, count)``."""
    n, k = len(descriptor), len(words)
    w0, w1, w2, w3 = words[:, 0].copy(), words[:, 1].copy(), words[:, 2].copy(), words[:, 3].copy()
    key = np.empty(k, np.int32)  # bits, then index: one minimum gives both, on many words at a time
    taken = np.int32(_TAKEN)
    out = np.empty((n, count), np.int32)
    for i in range(n):
        a0, a1, a2, a3 = descriptor[i, 0], descriptor[i, 1], descriptor[i, 2], descriptor[i, 3]
        for j in range(k):
            bits = np.int32(
                population_count(a0 ^ w0[j])
                + population_count(a1 ^ w1[j])
                + population_count(a2 ^ w2[j])
                + population_count(a3 ^ w3[j])
            )
            key[j] = bits << np.int32(16) | np.int32(j)
        for rank in range(count):
            best = taken
            for j in range(k):
                best = min(best, key[j])
            at = best & 0xFFFF
            out[i, rank] = at
            key[at] = taken
    return out
