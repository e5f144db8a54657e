"""Trajectory files of many sequences: which belong together, and when their poses were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.experts.imported import Quality
from mixo_env.experts.quality import quality_file, read_quality
from mixo_env.geometry import FloatArray
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.axes import Axes, resolved
from mixo_env.trajectory.formats import TrajectoryFiles
from mixo_env.trajectory.layout import is_file, sequence_files
from mixo_env.trajectory.quaternions import QuaternionOrder
from mixo_env.trajectory.text import read_numbers

TIMES_SUFFIX = ".times"
"""``03.times`` beside ``03.txt`` has one time in seconds a line."""


@dataclass(frozen=True)
class Reading:
    """How files are read.

    Attributes:
        axes: name of an expert, ``groundtruth`` or ``""`` (all others) -> body axes.
        quaternions: their order in files that do not tell it.
        times: folder (or file, for one sequence) of the times of files without any; by default ``03.times`` beside
            ``03.txt``.
        rate_hz: poses a second of files without times, from 0 on.
        live: every pose was given with its image: what a step is told rests on no pose after its end.
    """

    axes: Mapping[str, Axes] = field(default_factory=dict)
    quaternions: QuaternionOrder = "file"
    times: Path | None = None
    rate_hz: float | None = None
    live: bool = False

    def __post_init__(self) -> None:
        """Check what excludes each other."""
        if self.times is not None and self.rate_hz is not None:
            raise ConfigurationError("--times and --rate both say when poses were: give one of them")
        if self.rate_hz is not None and not 1e-3 <= self.rate_hz <= 1e5:
            raise ConfigurationError(f"expected --rate in poses a second, such as 10, got {self.rate_hz:g}")

    def axes_of(self, name: str) -> Axes:
        """Those of an expert."""
        return self.axes.get(name, self.axes.get("", "file"))


@dataclass(frozen=True)
class Source:
    """One sequence of one program, with times in seconds if these are known.

    Attributes:
        path: of the file.
        trajectory: in the axes of its body.
        axes: their name.
        quality: what stands beside it.
        live: as in :class:`Reading`.
    """

    path: Path
    trajectory: Trajectory
    axes: str
    quality: Quality | None
    live: bool = False


def read_sources(name: str, folder: Path, names: tuple[str, ...], reading: Reading) -> dict[str, Source]:
    """Sequence -> its trajectory.

    Args:
        name: of the expert, for axes and errors; ``groundtruth`` for the truth.
        folder: of the files, see :func:`~mixo_env.trajectory.layout.sequence_files`.
        names: of its file where a sequence's folder holds several.
        reading: how.

    Raises:
        TrajectoryError: if there are no such files or one of them cannot be read.
    """
    sources = {}
    for sequence, path in sequence_files(folder, names).items():
        trajectory = TrajectoryFiles(quaternions=reading.quaternions).read(path)
        if trajectory.timestamps_s is None or trajectory.counted:
            stamps, known = _stamps(sequence, path, trajectory, reading)
            trajectory = replace(trajectory, timestamps_s=stamps, counted=trajectory.counted and not known)
        beside = quality_file(path)
        quality = read_quality(beside, len(trajectory)) if is_file(beside) else None
        sources[sequence] = Source(path, trajectory, resolved(trajectory, reading.axes_of(name)), quality, reading.live)
    return sources


def _stamps(sequence: str, path: Path, trajectory: Trajectory, reading: Reading) -> tuple[FloatArray | None, bool]:
    """Times of poses that have none, or frame numbers at most; whether they were found."""
    frames = trajectory.timestamps_s
    index = np.arange(len(trajectory)) if frames is None else frames.astype(np.int64)
    if reading.rate_hz is not None:
        return index / reading.rate_hz, True
    times = _times_file(sequence, path, reading.times)
    if times is None:
        return frames, False  # whole seconds, or nothing
    table = read_numbers(times)
    stamps = table.values[:, 0]
    if table.values.shape[1] != 1:
        raise table.error(0, f"expected one time in seconds a line, got {table.values.shape[1]} columns")
    if index[-1] >= len(stamps) or (frames is None and len(stamps) != len(index) and reading.times is None):
        raise TrajectoryError(
            f"{times}: expected a time for each of the {index[-1] + 1} frames of {path}, got {len(stamps)}"
        )
    back = np.flatnonzero(np.diff(stamps) <= 0.0)
    if len(back):
        raise table.error(int(back[0]) + 1, "expected increasing times")
    return stamps[index], True


def _times_file(sequence: str, path: Path, times: Path | None) -> Path | None:
    """Where the times of a sequence stand; ``None`` if nowhere.

    Raises:
        TrajectoryError: when they were said to be in a folder and are not.
    """
    if times is None:
        beside = path.with_suffix(TIMES_SUFFIX)
        return beside if is_file(beside) else None
    if times.is_file():
        return times
    places = [times / f"{sequence}{suffix}" for suffix in (".txt", TIMES_SUFFIX, ".csv")]
    places += [times / sequence / f"{name}.txt" for name in ("times", "timestamps")]
    for place in places:
        if is_file(place):
            return place
    raise TrajectoryError(f"{times}: expected the times of {sequence} in {places[0].name} or {sequence}/times.txt")
