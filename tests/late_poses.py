"""Recordings of a car whose written poses are late by a known time: yaw and way are exact at any instant."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import CAMERA_COLUMNS, INERTIAL_EXPERTS, Manifest, SceneEntry, columns

OFFSETS_S = {"CAM_FRONT": -0.02, "CAM_FRONT_LEFT": -0.03, "CAM_BACK": 0.0, "CAM_BACK_RIGHT": -0.01}
CAMERAS = tuple(OFFSETS_S)
FINE_S = 0.001


class Drive:
    """Yaw, way and distance of 30 s from -1 s on, by summation on a fine grid."""

    def __init__(self, rng: np.random.Generator, turning: float = 1.0) -> None:
        self._t = np.arange(-1.0, 30.0, FINE_S)
        phase, slow, quick = rng.uniform(0, 6, 3), rng.uniform(0.5, 0.9), rng.uniform(1.3, 1.8)
        rate = turning * (0.2 * np.sin(slow * self._t + phase[0]) + 0.1 * np.sin(quick * self._t + phase[1]))
        speed = 7.0 + 3.0 * np.sin(0.9 * self._t + phase[2])
        self._yaw, self._speed = np.cumsum(rate) * FINE_S, speed
        self._distance = np.cumsum(speed) * FINE_S
        self._x, self._y = (np.cumsum(speed * part(self._yaw)) * FINE_S for part in (np.cos, np.sin))

    def __call__(self, name: str, t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.interp(t, self._t, getattr(self, f"_{name}"))


def late_scene(
    rng: np.random.Generator, lag_s: float, *, spacing_s: float, turning: float, noise_rad: float, wheels_s: float
) -> dict[str, NDArray]:
    """All columns of one scene whose poses are ``lag_s`` late and whose wheels are ``wheels_s`` late."""
    steps = rng.choice([0.05, 0.1, 0.1], 240) if spacing_s < 0.5 else np.full(40, spacing_s)
    time = np.concatenate([[0.0], np.cumsum(steps)])
    drive, rows = Drive(rng, turning), len(time)
    table = {
        name: np.full(rows, np.nan, dtype) if "float" in dtype else np.zeros(rows, dtype)
        for name, dtype in columns(CAMERAS, INERTIAL_EXPERTS).items()
    }
    table["step"][:], table["time_s"][:], table["dt_s"][1:] = np.arange(rows), time, steps
    table["dt_s"][0] = 0.0
    table["timestamp_us"][:] = 1_600_000_000_000_000 + np.round(1e6 * time).astype(np.int64)
    table["is_keyframe"][::6] = True
    for truth, t in (("truth", time - lag_s), ("exact", time)):
        for name in ("x", "y", "yaw"):
            table[f"{truth}.{name}_{'rad' if name == 'yaw' else 'm'}"][:] = drive(name, t)
    table["truth.yaw_increment_rad"][1:] = np.diff(table["truth.yaw_rad"])
    table["truth.distance_m"][1:] = np.hypot(np.diff(table["truth.x_m"]), np.diff(table["truth.y_m"]))
    table["distance_m"][1:] = np.diff(drive("distance", time - wheels_s))
    table["speed_mps"][:] = drive("speed", time - wheels_s)
    for expert in INERTIAL_EXPERTS:
        table[f"{expert}.yaw_increment_rad"][1:] = np.diff(drive("yaw", time))
        table[f"{expert}.yaw_std_rad"][1:] = 1e-3
    for camera, offset in OFFSETS_S.items():
        turn = np.diff(drive("yaw", time + offset))
        table[f"{camera}.state"][1:] = State.TRACKING
        table[f"{camera}.image_time_offset_s"][:] = offset
        table[f"{camera}.own_window_s"][1:] = steps
        table[f"{camera}.own_window_yaw_increment_rad"][1:] = turn + noise_rad * rng.standard_normal(len(turn))
        table[f"{camera}.own_window_truth_yaw_increment_rad"][1:] = np.diff(drive("yaw", time + offset - lag_s))
        table[f"{camera}.yaw_increment_rad"][1:] = np.diff(drive("yaw", time))
        for name in set(CAMERA_COLUMNS) - {"state", "own_window_s", "image_time_offset_s"}:
            if "yaw_increment" not in name:
                table[f"{camera}.{name}"][1:] = 1.0
    return table


def late_recordings(
    lag_s: float | dict[str, float] = 0.03,
    *,
    scenes: int = 4,
    spacing_s: float = 0.1,
    turning: float = 1.0,
    noise_rad: float = 2e-4,
    wheels_s: float = 0.0,
    seed: int = 0,
) -> Recordings:
    """Scene i is log i in fold i mod 4; cars take turns if ``lag_s`` names several."""
    lags = lag_s if isinstance(lag_s, dict) else {"n099": lag_s}
    entries, tables = [], []
    for i in range(scenes):
        car = list(lags)[i % len(lags)]
        rng = np.random.default_rng([seed, i])
        options = {"spacing_s": spacing_s, "turning": turning, "noise_rad": noise_rad, "wheels_s": wheels_s}
        tables.append(late_scene(rng, lags[car], **options))
        rows = len(tables[-1]["step"])
        entries.append(
            SceneEntry(f"scene-{2001 + i}", f"log-{i}", car, "synthetic", ("day",), i // len(lags) % 4, rows)
        )
    manifest = Manifest("late-0", CAMERAS, INERTIAL_EXPERTS, (), tuple(entries))
    return Recordings(manifest, {name: np.concatenate([table[name] for table in tables]) for name in tables[0]})
