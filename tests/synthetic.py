"""Small random recordings with the full schema, for tests that need numbers but no images."""

from __future__ import annotations

import numpy as np

from mixo_env.experts.expert import State
from mixo_env.fusion import dead_reckon
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import INERTIAL_EXPERTS, Manifest, SceneEntry, VehicleConstants, columns

NOISE_RAD = {"CAM_FRONT": 4e-4, "CAM_FRONT_LEFT": 2e-3, "CAM_BACK": 8e-4, "CAM_BACK_RIGHT": 2e-3}
NOISE_RAD |= {"INERTIAL": 2e-4, "INERTIAL_POSE": 1e-4, "INERTIAL_CONSUMER": 1e-3}


def synthetic_scene(rng: np.random.Generator, steps: int) -> dict[str, np.ndarray]:
    """Columns of one scene: smooth drive, experts with their own noise, a lost stretch and a missed image."""
    rows = steps + 1
    table = {
        name: np.full(rows, np.nan, dtype) if "float" in dtype else np.zeros(rows, dtype)
        for name, dtype in columns(CAMERAS, INERTIAL_EXPERTS).items()
    }
    dt = rng.choice([0.05, 0.1, 0.1], size=steps)
    rate = 0.2 * np.sin(np.cumsum(dt) * rng.uniform(0.2, 0.8) + rng.uniform(0, 6))
    speed = np.abs(6.0 + 4.0 * np.sin(np.cumsum(dt) * 0.3 + rng.uniform(0, 6)))
    increment, distance = rate * dt, speed * dt
    start = (rng.uniform(100, 900), rng.uniform(100, 900), rng.uniform(-np.pi, np.pi))
    x, y, yaw = dead_reckon(increment, distance, start=start)
    table["step"][:] = np.arange(rows)
    table["dt_s"][:] = np.concatenate([[0.0], dt])
    table["time_s"][:] = np.cumsum(table["dt_s"])
    table["timestamp_us"][:] = 1_600_000_000_000_000 + np.round(table["time_s"] * 1e6).astype(np.int64)
    table["is_keyframe"][::6] = True
    for name, values in (("x_m", x), ("y_m", y), ("yaw_rad", yaw)):
        table[f"truth.{name}"][:] = values
        table[f"exact.{name}"][:] = values
    table["truth.yaw_increment_rad"][1:] = increment
    table["truth.distance_m"][1:] = distance
    table["distance_m"][1:] = distance * (1 + 0.002 * rng.standard_normal(steps))
    table["speed_mps"][:] = np.concatenate([speed[:1], speed])
    for expert in INERTIAL_EXPERTS:
        noise = NOISE_RAD[expert]
        table[f"{expert}.yaw_increment_rad"][1:] = increment + noise * rng.standard_normal(steps)
        table[f"{expert}.yaw_std_rad"][1:] = noise
    for camera in CAMERAS:
        noise = NOISE_RAD[camera]
        state = table[f"{camera}.state"]
        state[:] = State.TRACKING
        state[:4] = State.INITIALISING
        lost = int(rng.integers(10, rows - 10))
        state[lost : lost + 5] = State.LOST
        state[int(rng.integers(5, rows - 1))] = State.NO_IMAGE
        tracking = state == State.TRACKING
        both = tracking & np.concatenate([[False], state[:-1] != State.NO_IMAGE])
        quality = rng.uniform(0.3, 3.0, rows)
        value = np.concatenate([[np.nan], increment]) + noise * quality * rng.standard_normal(rows)
        table[f"{camera}.own_window_yaw_increment_rad"][tracking] = value[tracking]
        table[f"{camera}.yaw_increment_rad"][both] = value[both]
        table[f"{camera}.two_frame_yaw_increment_rad"][1:] = value[1:]
        table[f"{camera}.own_window_truth_yaw_increment_rad"][1:] = increment
        table[f"{camera}.image_time_offset_s"][:] = 0.0
        table[f"{camera}.own_window_s"][1:] = dt
        for name, told in (("yaw_std_rad", both), ("own_window_yaw_std_rad", tracking)):
            table[f"{camera}.{name}"][told] = (noise * quality)[told]
        matches = np.where(state == State.LOST, 30, np.round(800 / quality))
        table[f"{camera}.matches"][:] = np.where(state == State.NO_IMAGE, 0, matches)
        table[f"{camera}.inliers"][:] = 0.7 * table[f"{camera}.matches"]
        table[f"{camera}.residual_px"][:] = 0.5 * quality
        table[f"{camera}.flow_px"][:] = 10.0
    return table


def synthetic_recordings(seed: int = 0, *, scenes: int = 8, logs: int = 4, steps: int = 60) -> Recordings:
    """A reproducible recording: scene i belongs to log i mod ``logs`` and fold (log mod 4)."""
    tables, entries = [], []
    for i in range(scenes):
        rng = np.random.default_rng([seed, i])
        table = synthetic_scene(rng, steps + int(rng.integers(0, 10)))
        tables.append(table)
        log = i % logs
        entries.append(
            SceneEntry(f"scene-{2001 + i}", f"log-{log}", "n099", "synthetic", ("day",), log % 4, len(table["step"]))
        )
    manifest = Manifest(
        "synthetic-0",
        CAMERAS,
        INERTIAL_EXPERTS,
        (),
        tuple(entries),
        vehicles={"n099": VehicleConstants()},
        reward_scale_rad=dict.fromkeys(("PAPER", "VISION", "CONSUMER"), 1e-3),
        camera_cost_ms=dict.fromkeys(CAMERAS, 20.0),
    )
    return Recordings(manifest, {name: np.concatenate([t[name] for t in tables]) for name in tables[0]})
