"""Trajectories for the tests of the metrics, and literal slow implementations of the definitions as oracle."""

from __future__ import annotations

import itertools
import math

import numpy as np

from mixo_env.geometry import multiply_quaternions_wxyz, quaternion_wxyz_from_rotation
from mixo_env.trajectory import Trajectory


def random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A uniformly random rotation matrix."""
    q, r = np.linalg.qr(rng.standard_normal((3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else -q


def drive(rng: np.random.Generator, poses: int = 120, *, stop: bool = False, gap: bool = False) -> Trajectory:
    """A winding drive at 12 Hz in three dimensions, optionally with an exact standstill or with frames missing."""
    n = poses + 40
    speed = np.abs(8.0 + 4.0 * np.sin(np.arange(n) * 0.05 + rng.uniform(0, 6)))
    if stop:
        speed[n // 3 : n // 2] = 0.0
    yaw = np.cumsum(0.02 * np.sin(np.arange(n) * rng.uniform(0.02, 0.1)) * (speed > 0)) + rng.uniform(-3, 3)
    step = speed / 12.0
    position = np.stack([np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw)), 0.02 * np.cumsum(step)], axis=-1)
    position += rng.uniform(-500, 500, 3)
    half = 0.5 * yaw
    quaternion = np.stack([np.cos(half), np.zeros(n), np.zeros(n), np.sin(half)], axis=-1)
    tilt = quaternion_wxyz_from_rotation(random_rotation(rng))
    trajectory = Trajectory(position, multiply_quaternions_wxyz(quaternion, tilt), 100.0 + np.arange(n) / 12.0)
    keep = np.ones(n, dtype=bool)
    if gap:
        keep[n // 2 : n // 2 + 30] = False
    return trajectory[np.flatnonzero(keep)[:poses]]


def disturbed(rng: np.random.Generator, truth: Trajectory, *, scale: float = 1.0) -> Trajectory:
    """An estimate of ``truth``: noise on positions and rotations, scaled, and quaternion signs flipped at random."""
    n = len(truth)
    axis = 0.02 * np.cumsum(rng.standard_normal((n, 3)), axis=0) / math.sqrt(n)
    noise = np.concatenate([np.ones((n, 1)), 0.5 * axis], axis=1)
    noise /= np.linalg.norm(noise, axis=1, keepdims=True)
    quaternion = multiply_quaternions_wxyz(truth.quaternions_wxyz, noise) * rng.choice([-1.0, 1.0], size=(n, 1))
    position = truth.positions_m + 0.05 * np.cumsum(rng.standard_normal((n, 3)), axis=0)
    return Trajectory(scale * position, quaternion, truth.timestamps_s)


def moved(trajectory: Trajectory, rotation: np.ndarray, translation: np.ndarray) -> Trajectory:
    """The trajectory seen from another world frame."""
    quaternion = multiply_quaternions_wxyz(quaternion_wxyz_from_rotation(rotation), trajectory.quaternions_wxyz)
    return Trajectory(trajectory.positions_m @ rotation.T + translation, quaternion, trajectory.timestamps_s)


def literal_path(positions: np.ndarray) -> list[float]:
    """Cumulative path length, one pose after the other."""
    distance = [0.0]
    for previous, position in itertools.pairwise(positions):
        distance.append(distance[-1] + math.sqrt(sum((b - a) ** 2 for a, b in zip(previous, position, strict=True))))
    return distance


def literal_pairs(
    distance: list[float], length: float, tolerance: str | float = "step", spacing: float = 1.0
) -> list[tuple[int, int]]:
    """The definition word by word, in O(n^2)."""
    n = len(distance)
    pairs, previous = [], None
    for i in range(n - 1):
        if previous is not None and distance[i] - distance[previous] < spacing:
            continue
        previous = i
        misses = [abs(distance[j] - distance[i] - length) for j in range(i + 1, n)]
        miss = min(misses)
        j = i + 1 + misses.index(miss)
        if tolerance == "step":
            local = distance[j] - distance[j - 1]
            if j + 1 < n:
                local = max(local, distance[j + 1] - distance[j])
            accepted = distance[-1] - distance[i] >= length and miss <= local
        else:
            accepted = miss < float(tolerance) * length
        if accepted and distance[j] > distance[i]:
            pairs.append((i, j))
    return pairs


def literal_rpg_pairs(distance: list[float], length: float) -> list[tuple[int, int]]:
    """The reference tool's: ends are collected, starts are the positions in that list, a single one is refused."""
    ends = [j for _, j in literal_pairs(distance, length, 0.2, 0.0)]
    return list(enumerate(ends)) if len(ends) > 1 else []


def literal_error(truth: np.ndarray, estimate: np.ndarray, i: int, j: int, scale: float = 1.0) -> tuple[float, float]:
    """Translation [m] and rotation [deg] of (G_i^-1 G_j)^-1 (E_i^-1 E_j), by 4x4 products."""
    true_motion = np.linalg.inv(truth[i]) @ truth[j]
    motion = np.linalg.inv(estimate[i]) @ estimate[j]
    motion[:3, 3] *= scale
    error = np.linalg.inv(true_motion) @ motion
    return float(np.linalg.norm(error[:3, 3])), literal_angle_deg(error[:3, :3])


def literal_angle_deg(rotation: np.ndarray) -> float:
    """Rotation angle by atan2 of the antisymmetric part and the trace."""
    r = rotation
    sine = math.sqrt((r[2, 1] - r[1, 2]) ** 2 + (r[0, 2] - r[2, 0]) ** 2 + (r[1, 0] - r[0, 1]) ** 2)
    return math.degrees(math.atan2(sine, float(np.trace(r)) - 1.0))
