"""How late the written poses are, by what it is told, and what a wrong lag would do to scores and order."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray

from experiments.studies import exact_turn
from mixo_env.errors import DatasetError, MixoError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Travel, Truth, with_wheels
from mixo_env.nuscenes.can_bus import read_can_bus
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.pose_lag_fit import UNKNOWN, PoseLag, Turns, camera_turns, fit_pose_lag, step_turns
from mixo_env.recordings.schema import Manifest, SceneEntry
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import truths_of

ROWS = ("CAM_FRONT", "LINEAR", "HUBER", "MEDIAN")
POSE_EVERY = 5
"""Every fifth CAN pose (50 Hz) stands for an image."""


def exact_turns(recordings: Recordings) -> list[Turns]:
    """What the simulator's noise-free truth turned, step by step."""
    known = "exact" in truths_of(recordings)
    unknown = np.full(recordings.offsets[-1], np.nan)
    return step_turns(recordings, exact_turn(recordings) if known else unknown)


def lags_by_source(recordings: Recordings) -> dict[str, dict[str, PoseLag]]:
    """Vehicle -> source -> lag, from all scenes of a vehicle at once: to look at, not to score with.

    Sources: the cameras, INERTIAL alone, the exact truth where there is one; some with poses at key frames only.
    """
    found: dict[str, dict[str, PoseLag]] = {}
    for vehicle in dict.fromkeys(scene.vehicle for scene in recordings.scenes):
        own = recordings.select(scenes=[scene.name for scene in recordings.scenes if scene.vehicle == vehicle])
        slow = at_keyframes(own)
        inertial, exact = step_turns(own, own["INERTIAL.yaw_increment_rad"]), exact_turns(own)
        found[vehicle] = {
            "cameras": fit_pose_lag(own, camera_turns(own)),
            "cameras, 2 Hz": fit_pose_lag(slow, camera_turns(slow)),
            "INERTIAL": fit_pose_lag(own, inertial),
            "exact": fit_pose_lag(own, exact) if np.isfinite(exact[0].turn_rad).any() else UNKNOWN,
            "exact, 2 Hz": fit_pose_lag(slow, exact_turns(slow)) if np.isfinite(exact[0].turn_rad).any() else UNKNOWN,
        }
    return found


def moved(recordings: Recordings, seconds: float) -> Recordings:
    """The recordings with every vehicle's lag larger by ``seconds``."""
    vehicles = {
        name: replace(constants, pose_lag_s=constants.pose_lag_s + seconds)
        for name, constants in recordings.manifest.vehicles.items()
    }
    return lag_corrected(recordings.replace(replace(recordings.manifest, vehicles=vehicles)))


class WithWrongLag(CrossValidation):
    """The protocol of the leaderboard with every lag wrong by ``seconds``, in training and in scores."""

    def __init__(self, recordings: Recordings, seconds: float) -> None:
        super().__init__(recordings)
        self.recordings = moved(self.recordings, seconds)
        self._seconds = seconds

    def training(self, fold: int) -> Recordings:
        """The training scenes, as wrong."""
        return moved(super().training(fold), self._seconds)


def scores(recordings: Recordings, seconds: float, truth: str = "truth") -> dict[str, tuple[float, float]]:
    """Row -> rotation RTE [deg/m] and ATE [deg] in track VISION, and of the exact yaw where there is one."""
    protocol = WithWrongLag(recordings, seconds)
    reference = Truth(protocol.recordings, truth)
    travels: dict[str, Travel] = {name: protocol.run(name, "VISION").travel for name in ROWS}
    (exact,) = exact_turns(protocol.recordings)
    if np.isfinite(exact.turn_rad).any():
        travels["PERFECT (exact yaw)"] = with_wheels(protocol.recordings, exact.turn_rad)
    found = {}
    for name, travel in travels.items():
        errors = reference.measure(travel)
        found[name] = (float(errors.relative.rotation_deg_per_m.mean()), float(errors.absolute.rotation_deg.mean()))
    return found


def can_lag(folder: Path, scene: str) -> PoseLag:
    """Lag of a real scene's CAN poses behind its own gyro (ms_imu), whose rate is integrated between them.

    Raises:
        DatasetError: the messages are missing or damaged.
    """
    bus = read_can_bus(folder, scene)
    if bus is None or bus.imu_yaw_rate_radps is None:
        raise DatasetError(f"{folder}: expected ms_imu messages of {scene}, found none: unpack the CAN bus files")
    try:
        messages = json.loads((folder / f"{scene}_pose.json").read_text())[::POSE_EVERY]
    except OSError:
        raise DatasetError(f"{folder}: expected pose messages of {scene}, found none: unpack it again") from None
    utime, (x, y) = np.array([m["utime"] for m in messages]), np.array([m["pos"][:2] for m in messages]).T
    time_s = 1e-6 * (utime - utime[0])
    w, qx, qy, z = np.array([m["orientation"] for m in messages]).T
    yaw = np.unwrap(np.arctan2(2 * (w * z + qx * qy), 1 - 2 * (qy * qy + z * z)))
    gyro_s, rate = 1e-6 * (bus.imu_yaw_rate_radps.timestamp_us - utime[0]), bus.imu_yaw_rate_radps.value
    turned = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * np.diff(gyro_s))])
    turns = np.diff(np.interp(time_s, gyro_s, turned, left=np.nan, right=np.nan), prepend=np.nan)
    entry = SceneEntry(scene, scene, scene, "", (), 0, len(time_s))
    columns: dict[str, NDArray[np.float64]] = {
        "time_s": time_s,
        "dt_s": np.diff(time_s, prepend=0.0),
        "truth.yaw_rad": yaw,
        "truth.distance_m": np.hypot(np.diff(x, prepend=x[0]), np.diff(y, prepend=y[0])),
    }
    recordings = Recordings(Manifest("can", (), (), (), (entry,)), columns)
    return fit_pose_lag(recordings, step_turns(recordings, turns))


@dataclass(frozen=True)
class PoseLagStudy:
    """Print lags by vehicle and source, and scores with lags that are wrong by -10, 0 and 10 ms.

    Worked examples:

      python -m experiments.pose_lag
      python -m experiments.pose_lag --can-bus FOLDER/can_bus --scenes scene-0061 scene-0757
    """

    recordings: str | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: mixocity."""
    can_bus: Path | None = None
    """Folder of real CAN bus files: lag of their poses behind their gyro, instead of everything else."""
    scenes: Sequence[str] = ("scene-0061", "scene-0655", "scene-0757", "scene-0796")
    """Which of them."""

    def run(self) -> int:
        """Print the tables."""
        if self.can_bus is not None:
            for scene in self.scenes:
                print(f"{scene}  {_shown(can_lag(self.can_bus, scene))}")
            return 0
        recordings = load_recordings(self.recordings)
        for vehicle, found in lags_by_source(recordings).items():
            print(f"{vehicle:12s}" + "   ".join(f"{source}: {_shown(lag)}" for source, lag in found.items()))
        cases: tuple[tuple[float, str], ...] = ((-0.010, "truth"), (0.0, "truth"), (0.010, "truth"), (0.0, "written"))
        tables = [scores(recordings, seconds, truth) for seconds, truth in cases]
        print("\ndeg/m (ATE deg)     -10 ms           as fitted        +10 ms           as written")
        for name in tables[0]:
            print(f"{name:20s}" + "  ".join("{:.5f} ({:.3f})".format(*table[name]) for table in tables))
        for (seconds, truth), table in zip(cases, tables, strict=True):
            print(f"{truth:8s}{1e3 * seconds:+4.0f} ms  " + " < ".join(sorted(ROWS, key=dict(table).__getitem__)))
        return 0


def _shown(lag: PoseLag) -> str:
    return f"{1e3 * lag.lag_s:.1f} +- {1e3 * lag.std_s:.1f} ms" + ("" if lag.known else " (not used)")


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(PoseLagStudy, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"pose_lag: {error}")
