"""Somebody's odometry on the leaderboard, from text files alone: `python own_odometry.py`, or `mixo import`."""

import tempfile
from pathlib import Path

import numpy as np

import mixo_env
from mixo_env.recordings.sequence_files import Reading
from mixo_env.recordings.sequences import SequenceRules, recordings_from_trajectories
from mixo_env.trajectory import Trajectory, write_tum


def odometry(truth: Trajectory, noise_rad: float, rng: np.random.Generator) -> Trajectory:
    """Stands for yours: the true drive, every turn a little wrong."""
    x_m, y_m, yaw_rad = truth.planar()
    wander_rad = np.cumsum(noise_rad * rng.standard_normal(len(truth)))
    return Trajectory.from_planar(x_m, y_m, yaw_rad + wander_rad, truth.timestamps_s)


def write_files(root: Path, drives: int = 6) -> None:
    """A folder a method, a file a drive: what you would have anyway."""
    rng = np.random.default_rng(0)
    time_s = 0.1 * np.arange(600)
    for drive in range(drives):
        yaw_rad = 0.4 * np.sin(time_s / (3.0 + drive))
        x_m, y_m = np.cumsum(0.8 * np.cos(yaw_rad)), np.cumsum(0.8 * np.sin(yaw_rad))
        truth = Trajectory.from_planar(x_m, y_m, yaw_rad, time_s)
        for method, noise_rad in {"groundtruth": 0.0, "ORB": 4e-4, "DSO": 8e-4}.items():
            (root / method).mkdir(exist_ok=True)
            write_tum(root / method / f"drive{drive}.txt", odometry(truth, noise_rad, rng))


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write_files(root)
        recordings = recordings_from_trajectories(
            root / "groundtruth", {"ORB": root / "ORB", "DSO": root / "DSO"}, SequenceRules(reading=Reading()), print
        )
    print("\n".join(mixo_env.score("LINEAR", recordings=recordings).lines()))
