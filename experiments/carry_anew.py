"""The bundled recordings carried anew from their own windows, without rendering a picture.

    git worktree add /tmp/before COMMIT                       a commit with recordings of schema 1 (mixocity-0.5)
    python -m experiments.carry_anew --data /tmp/before/mixo_env/recordings/data

Schema 1 brought the increments of cameras to the steps with inertial yaw; since schema 2 each is carried by the
camera's own rate (`mixo_env/recordings/carry.py`). The own increments and their standard deviations are recorded, so
both follow to the last bit. Of the stateless two-frame increments only the carried ones were kept: the inertial turn is
taken off again. It is known exactly, because the drives are simulated once more (no pictures, a third of a second
each) and the same inertial odometry runs over their CAN bus; where a camera has both its own and its carried increment
their difference must be that turn.

From recordings of schema 2 (the bundled ones, without `--data`) everything that is derived is made anew: carried
columns, vehicle constants, LINEAR's weights and reward scales.
"""

from __future__ import annotations

import logging
import sys
import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

import mixo_env
from experiments.mixocity import CONFIG, DATA_VERSION, FULL_SIZE, with_planned_folds
from mixo_env.errors import MixoError, RecordingError
from mixo_env.experts.inertial import InertialOdometry
from mixo_env.nuscenes.scene import CanBus, Scene
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.carry import carry_camera, own_windows
from mixo_env.recordings.clock import firing_rounds
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import SCHEMA_VERSION, Manifest, columns
from mixo_env.recordings.store import MANIFEST_FILE, RECORDINGS_FILE, read_columns, save_recordings
from mixo_env.simulator.dataset import simulate

logger = logging.getLogger(__name__)

FloatArray = NDArray[np.float64]
Columns = dict[str, NDArray[Any]]

DATA = Path(mixo_env.__file__).parent / "recordings" / "data"

CONFIGS = {"mixocity": CONFIG, "mixocity-paper": FULL_SIZE}

TOLERANCE_RAD = 1e-7
"""Of single precision and another machine; a degree is 0.017."""


@dataclass(frozen=True)
class CarryAnew:
    """Carry the bundled recordings anew: a minute."""

    data: Path = DATA
    """Where they are read: a folder with ``mixocity`` and ``mixocity-paper``, of schema 1 or 2."""
    out: Path = DATA
    """Where they are written."""
    workers: int = 1
    """Processes that simulate; the result does not depend on it."""

    def run(self) -> None:
        """Both recordings, one after the other."""
        for name in CONFIGS:
            version, recordings = read_any(self.data / name)
            two_frames = raw_two_frames(recordings) if version == SCHEMA_VERSION else self._uncarried(name, recordings)
            done = carried_anew(recordings, two_frames)
            manifest = replace(done.manifest, data_version=f"{name}-{DATA_VERSION}", schema_version=SCHEMA_VERSION)
            manifest.parameters["schema_version"] = SCHEMA_VERSION
            if version != SCHEMA_VERSION:
                manifest.parameters["carried_anew_from"] = recordings.manifest.data_version
            save_recordings(with_planned_folds(done.replace(manifest)), self.out / name)
            logger.info("%s: %d scenes carried anew in %s", name, len(done), self.out / name)

    def _uncarried(self, name: str, recordings: Recordings) -> dict[str, FloatArray]:
        """Raw two-frame increments ``(rows,)`` by expert of recordings of schema 1."""
        names = tuple(scene.name for scene in recordings.scenes)
        found: dict[str, list[FloatArray]] = {}
        with tempfile.TemporaryDirectory() as folder:
            simulate(replace(CONFIGS[name], images=False), Path(folder), self.workers, only=names)
            dataset = open_dataset(Path(folder))
            for i, scene in enumerate(names):
                rows = recordings.rows(i)
                drive = dataset.load(scene, recordings.manifest.cameras)
                for expert, camera, turn in _turns(recordings, rows, drive):
                    raw = rows[f"{expert}.two_frame_yaw_increment_rad"] - turn
                    check_turn(rows, expert, turn, f"{scene}, {camera}")
                    found.setdefault(expert, []).append(raw)
        return {expert: np.concatenate(parts) for expert, parts in found.items()}


def read_any(folder: Path) -> tuple[int, Recordings]:
    """Schema version, and a recording of either version in the columns of the present one.

    Raises:
        RecordingError: if it is missing, damaged, or of a version before 1 or after the present one.
    """
    try:
        table = msgspec.json.decode((folder / MANIFEST_FILE).read_bytes())
        read, _, _ = read_columns((folder / RECORDINGS_FILE).read_bytes())
        manifest = msgspec.convert(table, Manifest)
    except (OSError, msgspec.MsgspecError) as error:
        raise RecordingError(f"{folder}: expected a recording, got {error}") from None
    if manifest.schema_version not in (1, SCHEMA_VERSION):
        raise RecordingError(
            f"{folder}: expected schema version 1 or {SCHEMA_VERSION}, got {manifest.schema_version}; record anew"
        )
    if manifest.schema_version == 1:
        for expert in (*manifest.cameras, *manifest.variants):
            read[f"{expert}.own_window_yaw_std_rad"] = read[f"{expert}.yaw_std_rad"]
    order = columns(manifest.cameras, manifest.inertial, manifest.imported, tuple(manifest.variants))
    return manifest.schema_version, Recordings(manifest, {name: read[name].copy() for name in order})


def experts_of(recordings: Recordings) -> dict[str, str]:
    """Cameras and their variants: expert -> camera whose images it saw."""
    return {camera: camera for camera in recordings.manifest.cameras} | recordings.manifest.variants


def raw_two_frames(recordings: Recordings) -> dict[str, FloatArray]:
    """Two-frame increments ``(rows,)`` by expert over their own windows, from those scaled to the steps."""
    raw: dict[str, list[FloatArray]] = {}
    for i in range(len(recordings)):
        rows = recordings.rows(i)
        for expert, camera in experts_of(recordings).items():
            own = own_windows(rows, expert, camera)
            step_s = own.window_s + own.tail_s - np.concatenate([[np.nan], own.tail_s[:-1]])
            scaled = rows[f"{expert}.two_frame_yaw_increment_rad"].astype(np.float64)
            raw.setdefault(expert, []).append(scaled * own.window_s / step_s)
    return {expert: np.concatenate(parts) for expert, parts in raw.items()}


def carried_anew(recordings: Recordings, two_frames: Mapping[str, FloatArray]) -> Recordings:
    """The recordings with every column that is carried made from the own windows.

    Args:
        recordings: with own-window columns.
        two_frames: raw two-frame increments ``(rows,)`` by expert.
    """
    done = recordings.replace(columns={name: recordings[name].copy() for name in recordings.column_names})
    for i in range(len(done)):
        rows = done.rows(i)  # views
        for expert, camera in experts_of(done).items():
            carry_camera(rows, expert, camera, two_frames[expert][done.offsets[i] : done.offsets[i + 1]])
    return done


def _turns(recordings: Recordings, rows: Columns, drive: Scene) -> Iterator[tuple[str, str, FloatArray]]:
    """Expert, camera and what schema 1 added to its increments ``(rows,)``: the change of the inertial tail.

    Raises:
        RecordingError: if the drive is not the recorded one.
    """
    rounds = firing_rounds({camera: reel.timestamp_us for camera, reel in drive.cameras.items()})
    times = np.unique(rounds.image_time_us[rounds.fired])
    assert isinstance(drive.can_bus, CanBus)
    yaw = InertialOdometry(drive.can_bus, "INERTIAL").at(times).yaw_rad
    at_close = yaw[np.searchsorted(times, rounds.closing_time_us)]
    same = np.array_equal(rounds.closing_time_us, rows["timestamp_us"]) and np.allclose(
        np.diff(at_close), rows["INERTIAL.yaw_increment_rad"][1:], rtol=0.0, atol=TOLERANCE_RAD
    )
    if not same:
        raise RecordingError(f"{drive.name}: the simulator drives another way than when it was recorded: record anew")
    for expert, camera in experts_of(recordings).items():
        fired = rounds.fired[:, rounds.cameras.index(camera)]
        image_us = rounds.image_time_us[fired, rounds.cameras.index(camera)]
        tail = np.full(len(rounds), np.nan)
        tail[fired] = at_close[fired] - yaw[np.searchsorted(times, image_us)]
        yield expert, camera, np.diff(tail, prepend=np.nan)


def check_turn(rows: Columns, expert: str, turn_rad: FloatArray, label: str) -> None:
    """Compare the inertial turn with what was recorded, wherever a camera has its own and its carried increment.

    Raises:
        RecordingError: if they differ by more than the rounding of the columns.
    """
    own = rows[f"{expert}.own_window_yaw_increment_rad"].astype(np.float64)
    difference = np.abs(rows[f"{expert}.yaw_increment_rad"] - own - turn_rad)
    worst = float(np.nanmax(difference, initial=0.0))
    if worst > TOLERANCE_RAD:
        raise RecordingError(f"{label}: expected the recorded inertial turn, got one {worst:.1e} rad off: record anew")


def main() -> int:
    """Run the command line."""
    import tyro

    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(message)s", datefmt="%H:%M:%S")
    try:
        tyro.cli(CarryAnew).run()
    except MixoError as error:
        logger.error("%s", error)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
