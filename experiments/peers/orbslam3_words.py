"""A vocabulary for ORB-SLAM3, trained by ourselves: a tree of binary words in the text format of DBoW2.

The format: a line ``branches levels scoring weighting``, then a line per node, parents first: ``parent is_leaf``, the
32 bytes of the centre, ``weight``. Nodes count from 1 in the order of the lines; 0 is the root.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.vocabulary import nearest_words, train_vocabulary
from mixo_env.files import write_text

BRANCHES = 10
_DECLARED_LEVELS = 6  # of the vocabulary that ORB-SLAM3 ships: it matches within the nodes 4 levels above the words
_FEATURES = 5000
_FEWEST = 20 * BRANCHES**2  # descriptors that train_vocabulary wants


def train_words(images: Iterable[NDArray[np.uint8]], path: Path, seed: int = 0) -> int:
    """Train a tree of up to four levels on the ORB descriptors of some images, write it and return its words.

    The first two levels, of which ORB-SLAM3's matching makes use, are one vocabulary of ours; every second-level node
    with enough descriptors is split by another one. Descriptors are OpenCV's, which compare the pixels that
    ORB-SLAM3's compare.

    Args:
        images: grey, any sizes; a hundred of the kind to come are enough.
        path: text file to write, atomically.
        seed: of the clustering.

    Raises:
        ConfigurationError: too few corners in the images.
    """
    orb = cv2.ORB.create(_FEATURES)
    found = [np.empty((0, 32), np.uint8)]
    for image in images:
        descriptor = orb.detectAndCompute(image, None)[1]
        if descriptor is not None:
            found.append(np.asarray(descriptor, np.uint8))
    descriptor = np.ascontiguousarray(np.concatenate(found)).view(np.uint64)

    lines = [f"{BRANCHES} {_DECLARED_LEVELS} 0 0"]
    words = 0

    def add(parent: int, centre: NDArray[np.uint64], count: int, leaf: bool) -> int:
        nonlocal words
        words += leaf
        # Weights by share of corners, not of images (inverse document frequency): a word seen in every image would
        # weigh nothing, and ORB-SLAM3 would not match its corners.
        weight = np.log(len(descriptor) / max(count, 1)) if leaf else 0.0
        lines.append(f"{parent} {int(leaf)} {' '.join(map(str, centre.view(np.uint8)))} {weight:.6f}")
        return len(lines) - 1

    def split(parent: int, members: NDArray[np.uint64], level: int) -> None:
        vocabulary = train_vocabulary(members, BRANCHES, seed)
        branch = nearest_words(members, vocabulary.centres[:, 0], 1)[:, 0]
        for i, centres in enumerate(vocabulary.centres):
            top = add(parent, centres[0], 0, leaf=False)
            below = members[branch == i]
            node = nearest_words(below, centres[1:], 1)[:, 0]
            for j, centre in enumerate(centres[1:]):
                own = below[node == j]
                leaf = level > 1 or len(own) < _FEWEST
                child = add(top, centre, len(own), leaf)
                if not leaf:
                    split(child, own, level + 2)

    split(0, descriptor, 1)
    # No line end after the last node: DBoW2 would read an empty line as one more.
    write_text(path, "\n".join(lines))
    return words
