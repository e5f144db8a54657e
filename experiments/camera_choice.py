"""Choosing cameras before features: a small network looks at tiny pictures and says which cameras to process.

    python -m experiments.camera_choice --cities CITY UNSEEN --recordings RECORDED-CITY RECORDED-UNSEEN

Two simulated folders of different seeds and what `mixo record` made of them; the network learns on the first and is
scored on the second. It predicts, from the pictures of ``observation="pixels"`` made smaller still, how far LINEAR's
weights err with every set of cameras, and takes the set that promises most at a price. Beside it: the best constant
set, and match-count gating, which must process all cameras before it knows whom to believe. Looking costs: reading
four pictures and the network, as measured in this run, are charged to it like the milliseconds of the cameras.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.budget_contexts import steps_of
from experiments.studies import print_study
from mixo_env.envs.images import SceneImages
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.paper.cost import PRICES_PER_MS
from mixo_env.policies.budget import LinearByPattern
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import for_learning, truths_of, with_truth
from mixo_env.tables import Cell, Column, Table

TRACK = "CONSUMER"
SIZE = (32, 56)
"""Height and width of what the network sees [px], in grey."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class City:
    """All steps of some scenes of one city.

    Attributes:
        losses: ``(steps, sets)`` squared capped error of every set of cameras, in units of sigma_0.
        pictures: ``(steps, cameras, height, width)`` uint8, at the end of each step.
        matches: ``(steps, cameras)`` match counts there.
        first: ``(steps,)`` whether the step begins a scene.
        reading_ms: CPU time to read and shrink the pictures of one step.
    """

    losses: FloatArray
    pictures: NDArray[np.uint8]
    matches: FloatArray
    first: NDArray[np.bool_]
    reading_ms: float


def look(dataroot: Path, recordings: Recordings, cameras: tuple[str, ...]) -> tuple[NDArray[np.uint8], float]:
    """Pictures ``(steps, cameras, height, width)``, and CPU milliseconds to read those of one step."""
    import cv2

    images = SceneImages(recordings, dataroot, cameras)
    rows = [(scene, row) for scene, entry in enumerate(recordings.scenes) for row in range(1, entry.rows)]
    found = [images.paths(scene, row) for scene, row in rows]
    out = np.empty((len(rows), len(cameras), *SIZE), np.uint8)
    began = time.process_time()
    for i, paths in enumerate(found):
        for j, camera in enumerate(cameras):
            grey = cv2.cvtColor(images.read(paths[camera]), cv2.COLOR_RGB2GRAY)
            out[i, j] = cv2.resize(grey, SIZE[::-1], interpolation=cv2.INTER_AREA)
    return out, 1000.0 * (time.process_time() - began) / len(rows)


def open_city(folder: Path, scenes: int) -> Recordings:
    """``scenes`` of a recording, evenly spread, with their headline truth in place of the written poses."""
    recordings = load_recordings(folder)
    if not 0 < scenes <= len(recordings):
        raise ConfigurationError(f"scenes: expected 1 to {len(recordings)}, got {scenes}: so many are in {folder}")
    names = [recordings.scenes[i * len(recordings) // scenes].name for i in range(scenes)]
    chosen = lag_corrected(recordings.select(scenes=names))
    return for_learning(with_truth(chosen, truths_of(chosen)[0]))


def city(dataroot: Path, recordings: Recordings, linear: LinearByPattern, sigma_rad: float) -> City:
    """Errors, pictures and matches of every step."""
    pictures, reading_ms = look(dataroot, recordings, linear.cameras)
    steps = recordings["step"] > 0
    matches = np.stack([recordings[f"{camera}.matches"][steps] for camera in linear.cameras], axis=1)
    losses = steps_of(recordings, TRACK, linear, sigma_rad).losses
    return City(losses, pictures, matches.astype(np.float64), recordings["step"][steps] == 1, reading_ms)


def network(cameras: int, sets: int) -> Any:
    """One small convolutional trunk for every camera, and one layer from all of them to the sets."""
    from torch import nn

    trunk = [nn.Conv2d(1, 8, 5, 2), nn.ReLU(), nn.Conv2d(8, 16, 3, 2), nn.ReLU(), nn.Conv2d(16, 16, 3, 2), nn.ReLU()]
    own = nn.Sequential(*trunk, nn.Flatten(), nn.LazyLinear(16), nn.ReLU())
    return nn.Sequential(nn.Flatten(0, 1), own, nn.Unflatten(0, (-1, cameras)), nn.Flatten(1), nn.LazyLinear(sets))


class Foresight:
    """Losses of every set foretold from pictures: the mean of the training steps plus what the network adds."""

    def __init__(self, training: City, epochs: int, seed: int) -> None:
        """Train on four fifths of the steps, in one piece; keep the epoch that foretells the last fifth best."""
        import torch

        torch.set_num_threads(1)
        torch.manual_seed(seed)
        cut = int(0.8 * len(training.losses))
        self._mean = training.losses[:cut].mean(axis=0)
        targets = torch.from_numpy(training.losses - self._mean).float()
        self._model = network(training.pictures.shape[1], training.losses.shape[1])
        self._model(self._tensor(training.pictures[:1]))
        torch.nn.init.zeros_(self._model[-1].weight)
        torch.nn.init.zeros_(self._model[-1].bias)
        optimiser = torch.optim.Adam(self._model.parameters(), 1e-3, weight_decay=1e-4)
        best, self.epoch = self._off(training, cut), 0
        kept = {name: value.clone() for name, value in self._model.state_dict().items()}
        for epoch in range(1, epochs + 1):
            for batch in torch.randperm(cut).split(128):
                off = self._model(self._tensor(training.pictures[batch.numpy()])) - targets[batch]
                optimiser.zero_grad()
                off.square().mean().backward()
                optimiser.step()
            now = self._off(training, cut)
            if now < best:
                best, self.epoch = now, epoch
                kept = {name: value.clone() for name, value in self._model.state_dict().items()}
        self._model.load_state_dict(kept)

    def __call__(self, pictures: NDArray[np.uint8]) -> FloatArray:
        """Foretold losses ``(steps, sets)``."""
        import torch

        with torch.no_grad():
            parts = [
                self._model(self._tensor(part)).numpy() for part in np.array_split(pictures, -(-len(pictures) // 512))
            ]
        return self._mean + np.concatenate(parts)

    def ms(self, pictures: NDArray[np.uint8]) -> float:
        """CPU milliseconds of one step alone."""
        began, times = time.process_time(), 200
        for i in range(times):
            self(pictures[i % len(pictures)][None])
        return 1000.0 * (time.process_time() - began) / times

    def _tensor(self, pictures: NDArray[np.uint8]) -> Any:
        import torch

        shown = pictures.astype(np.float32)[:, :, None]
        return torch.from_numpy(shown / 127.5 - 1.0)

    def _off(self, training: City, cut: int) -> float:
        return float(np.mean((self(training.pictures[cut:]) - training.losses[cut:]) ** 2))


def images_ms(on: NDArray[np.bool_], first: NDArray[np.bool_], each_ms: FloatArray) -> float:
    """Mean cost of a step: a set of two-image increments needs the images at both ends, each processed once.

    Args:
        on: ``(steps, cameras)`` which deliver.
        first: ``(steps,)`` the step begins a scene.
        each_ms: ``(cameras,)`` of one image.
    """
    before = np.concatenate([np.zeros_like(on[:1]), on[:-1]]) & ~first[:, None]
    return float(((on.astype(np.int64) + (on & ~before)) @ each_ms).mean())


@dataclass(frozen=True)
class CameraChoice:
    """Print what looking before processing is worth in a city nobody has seen."""

    cities: tuple[Path, Path]
    """Simulated folders: to learn from, to be scored on."""
    recordings: tuple[Path, Path]
    """What `mixo record` made of them."""
    scenes: int = 20
    """Of each city."""
    epochs: int = 12
    """Of training, at most."""
    seeds: int = 3
    """Networks; their rows are shown one by one."""

    def run(self) -> Table:
        """Look, learn, choose."""
        training, test = (open_city(folder, self.scenes) for folder in self.recordings)
        linear, sigma_rad = LinearByPattern(training, TRACK), training.manifest.reward_scale_rad[TRACK]
        seen, unseen = (
            city(root, recordings, linear, sigma_rad)
            for root, recordings in zip(self.cities, (training, test), strict=True)
        )
        each_ms = np.array([training.manifest.camera_cost_ms[camera] for camera in linear.cameras])
        score = _Score(unseen, np.array(list(linear.weights)), each_ms)
        rows = [score.row("clairvoyant", price, unseen.losses, 0.0) for price in PRICES_PER_MS]
        rows += [score.row("best constant set", price, seen.losses.mean(axis=0)[None], 0.0) for price in PRICES_PER_MS]
        for count in (1, 2):
            rows += score.gating(count)
        for seed in range(self.seeds):
            foresight = Foresight(seen, self.epochs, seed)
            looking = unseen.reading_ms + foresight.ms(unseen.pictures)
            name = f"pictures, seed {seed}, epoch {foresight.epoch}"
            foretold = foresight(unseen.pictures)
            rows += [score.row(name, price, foretold, looking) for price in PRICES_PER_MS]
        columns = Column("choice"), Column("price", "per ms", ".3f"), Column("images", "ms", ".1f")
        columns = *columns, Column("looking", "ms", ".1f"), Column("loss", "sigma^2", ".3f")
        return Table(
            f"{len(seen.losses)} steps learned from, {len(unseen.losses)} scored in another city; track {TRACK}",
            (*columns, Column("reward", "", ".3f"), Column("without looking", "", ".3f")),
            rows,
        )


@dataclass(frozen=True)
class _Score:
    """What a choice of sets earns."""

    city: City
    patterns: NDArray[np.bool_]
    each_ms: FloatArray

    def row(self, name: str, price: float, foretold: FloatArray, looking_ms: float) -> list[Cell]:
        """Take in every step the set that promises most, as if its cameras had been on before."""
        chosen = np.argmin(foretold + price * (self.patterns @ self.each_ms), axis=1)
        chosen = np.broadcast_to(chosen, len(self.city.losses))
        cost = images_ms(self.patterns[chosen], self.city.first, self.each_ms)
        return self._cells(name, price, chosen, cost, looking_ms)

    def gating(self, count: int) -> list[list[Cell]]:
        """The ``count`` cameras with most matches, after all were processed."""
        rank = np.argsort(np.argsort(-self.city.matches, axis=1, kind="stable"), axis=1)
        numbers = {tuple(pattern): i for i, pattern in enumerate(self.patterns.tolist())}
        chosen = np.array([numbers[tuple(on)] for on in (rank < count).tolist()])
        cost = images_ms(np.ones_like(self.city.matches, np.bool_), self.city.first, self.each_ms)
        return [self._cells(f"most matches, {count}", price, chosen, cost, 0.0) for price in PRICES_PER_MS]

    def _cells(self, name: str, price: float, chosen: Any, cost: float, looking_ms: float) -> list[Cell]:
        loss = float(self.city.losses[np.arange(len(chosen)), chosen].mean())
        free = -loss - price * cost
        return [name, price, cost, looking_ms, loss, free - price * looking_ms, free]


def main(arguments: Sequence[str] | None = None) -> int:
    """Command line; see :class:`CameraChoice`."""
    return print_study(CameraChoice, arguments)


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    raise SystemExit(main())
