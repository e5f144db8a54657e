"""Small sets of trajectory files, as people have them: true drives and odometries of them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from mixo_env.geometry import quaternion_wxyz_from_rotation
from mixo_env.trajectory import Trajectory, write_kitti, write_tum
from mixo_env.trajectory.axes import BODY_AXES

RATE_HZ = 10.0


def rotation_z(angle: np.ndarray) -> np.ndarray:
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], -2)


def drive(seed: int, poses: int = 160, noise_rad: float = 0.0, start_s: float = 0.0) -> Trajectory:
    """A winding drive in vehicle axes; the same seed is the same drive, noise is added to every turn."""
    rng = np.random.default_rng(seed)
    t = np.arange(poses) / RATE_HZ
    rate = 0.35 * np.sin(2 * np.pi * t / 8.0 + rng.uniform(0, 6)) + 0.05
    turn = rate[1:] / RATE_HZ
    turn = turn + noise_rad * np.random.default_rng([seed, 1, round(1e9 * noise_rad)]).standard_normal(poses - 1)
    yaw = np.concatenate([[0.0], np.cumsum(turn)])
    middle = 0.5 * (yaw[1:] + yaw[:-1])
    step = 0.8 * np.stack([np.cos(middle), np.sin(middle), np.zeros(poses - 1)], -1)
    position = np.concatenate([np.zeros((1, 3)), np.cumsum(step, axis=0)])
    return Trajectory(position, quaternion_wxyz_from_rotation(rotation_z(yaw)), start_s + t)


def in_axes(trajectory: Trajectory, axes: str, world: np.ndarray | None = None) -> Trajectory:
    """The same motion told by a body with other axes, in a world that is turned somehow."""
    body = np.eye(4)
    body[:3, :3] = np.array(BODY_AXES[axes], dtype=float).T
    frame = np.eye(4)
    frame[:3, :3] = np.eye(3) if world is None else world
    poses = frame @ body @ trajectory.matrices() @ body.T
    turned = Trajectory.from_matrices(poses, trajectory.timestamps_s)
    return replace(turned, camera_axes=axes == "camera")


def write_set(
    root: Path,
    experts: dict[str, float],
    sequences: int = 4,
    form: str = "kitti",
    poses: int = 160,
    start_s: float = 0.0,
) -> dict[str, Path]:
    """Folders ``root/groundtruth`` and ``root/NAME`` of an expert with noise [rad] for every name; returns them."""
    folders = {name: root / name for name in ("groundtruth", *experts)}
    for name, folder in folders.items():
        folder.mkdir(parents=True)
        for sequence in range(sequences):
            way = drive(sequence, poses, experts.get(name, 0.0), start_s)
            path = folder / f"drive{sequence:02d}.txt"
            if form == "kitti":
                write_kitti(path, in_axes(way, "camera"))
            else:
                write_tum(path, way)
    return folders


def import_command(folders: dict[str, Path], out: Path, *more: str) -> list[str]:
    """Arguments of ``mixo import`` for such a set."""
    experts = [f"{name}={folder}" for name, folder in folders.items() if name != "groundtruth"]
    return ["import", "--groundtruth", str(folders["groundtruth"]), "--expert", *experts, "--out", str(out), *more]
