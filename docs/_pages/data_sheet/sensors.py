"""How noisy, biased and late the CAN bus is against the poses: same code for real scenes and simulated ones.

The reference is the 50 Hz ``pose`` message, which is the ground truth itself, so every figure contains the reference's
own noise, vibration, and (for wheels) slip and turning. A sensor *leads* the pose by g when its value at t fits the
pose at t + g best (g on a grid of 5 ms within 0.2 s; flat, and therefore vague, where the speed hardly changes).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError
from mixo_env.geometry import yaw_from_quaternion_wxyz

FloatArray = NDArray[np.float64]
Numbers = dict[str, float]

LAGS_S = np.arange(-0.2, 0.2001, 0.005)
RADPS_PER_RPM = 2.0 * np.pi / 60.0
WHEELS = ("FL", "FR", "RL", "RR")
MOVING_MPS = 0.5
"""Wheel noise and radius are measured above this speed."""


@dataclass(frozen=True)
class Reference:
    """The pose message of one scene, ``(n,)`` each."""

    time_s: FloatArray
    yaw_rad: FloatArray
    x_m: FloatArray
    y_m: FloatArray
    speed_mps: FloatArray

    def yaw_rate(self, time_s: FloatArray) -> FloatArray:
        """Centred difference of the heading over 0.1 s."""
        return (self._yaw(time_s + 0.05) - self._yaw(time_s - 0.05)) / 0.1

    def speed(self, time_s: FloatArray) -> FloatArray:
        """What the message calls its velocity."""
        return np.interp(time_s, self.time_s, self.speed_mps)

    def path_speed(self, time_s: FloatArray) -> FloatArray:
        """Derivative of the position over 0.2 s."""
        step = [
            np.interp(time_s + 0.1, self.time_s, p) - np.interp(time_s - 0.1, self.time_s, p)
            for p in (self.x_m, self.y_m)
        ]
        return np.hypot(*step) / 0.2

    def _yaw(self, time_s: FloatArray) -> FloatArray:
        return np.interp(time_s, self.time_s, self.yaw_rad)


def read_messages(can_bus: Path, scene: str, message: str) -> list[dict[str, Any]]:
    """One message file.

    Raises:
        DatasetError: if it is missing or damaged.
    """
    import msgspec

    path = can_bus / f"{scene}_{message}.json"
    try:
        return msgspec.json.decode(path.read_bytes())
    except (OSError, msgspec.MsgspecError) as error:
        raise DatasetError(f"{path} cannot be read as a CAN bus file ({error}): simulate or unpack it again") from None


def sensor_statistics(can_bus: Path, scene: str) -> Numbers:
    """All figures of one scene; NaN where the scene cannot show one (a car that stands, a road without a bend).

    Raises:
        DatasetError: if a message is missing.
    """
    names = ("pose", "ms_imu", "zoe_veh_info", "vehicle_monitor")
    pose, imu, wheels, monitor = (read_messages(can_bus, scene, name) for name in names)
    start_us = pose[0]["utime"]

    def seconds(messages: list[dict[str, Any]]) -> FloatArray:
        return (np.array([message["utime"] for message in messages]) - start_us) * 1e-6

    position = np.array([message["pos"] for message in pose])
    reference = Reference(
        seconds(pose),
        np.unwrap(yaw_from_quaternion_wxyz([message["orientation"] for message in pose])),
        position[:, 0],
        position[:, 1],
        np.array([message["vel"][0] for message in pose]),
    )
    gyro = np.array([message["rotation_rate"][2] for message in imu])
    acceleration = np.array([message["linear_accel"] for message in imu])
    turning = np.array([[message[f"{wheel}_wheel_speed"] for wheel in WHEELS] for message in wheels]) * RADPS_PER_RPM
    slow = {key: np.array([message[key] for message in monitor]) for key in ("yaw_rate", "vehicle_speed")}
    everything = (
        _pose_statistics(reference)
        | _gyro_statistics(reference, seconds(imu), gyro)
        | _accelerometer_statistics(acceleration)
        | _wheel_statistics(reference, seconds(wheels), turning)
        | _monitor_statistics(reference, seconds(monitor), slow["yaw_rate"], slow["vehicle_speed"] / 3.6)
    )
    return {name: float(value) for name, value in everything.items()}


def production_gyro_statistics(can_bus: Path, scene: str) -> Numbers:
    """Bias and noise of the simulator's own addition; no real counterpart.

    Raises:
        DatasetError: if the message is missing.
    """
    pose, gyro = read_messages(can_bus, scene, "pose"), read_messages(can_bus, scene, "production_gyro")
    time_s = np.array([message["utime"] for message in pose]) * 1e-6
    yaw = np.unwrap(yaw_from_quaternion_wxyz([message["orientation"] for message in pose]))
    rates = np.array([message["yaw_rate"] for message in gyro])
    seconds = np.array([message["utime"] for message in gyro]) * 1e-6 - time_s[0]
    reference = Reference(time_s - time_s[0], yaw, *np.zeros((3, len(yaw))))
    full = _gyro_statistics(reference, seconds, rates)
    keep = ("gyro_rate_hz", "gyro_bias_degps", "gyro_noise_0p1_s_radps", "gyro_drift_5_s_deg")
    return {f"production_{name}": float(full[name]) for name in keep}


def _rate_hz(time_s: FloatArray) -> float:
    return (len(time_s) - 1) / (time_s[-1] - time_s[0])


def _inside(reference: Reference, time_s: FloatArray, margin_s: float = 0.35) -> NDArray[np.bool_]:
    """Where every lag and difference stays inside the reference."""
    return (time_s > reference.time_s[0] + margin_s) & (time_s < reference.time_s[-1] - margin_s)


def _pose_statistics(reference: Reference) -> Numbers:
    t = reference.time_s[_inside(reference, reference.time_s)]
    difference = reference.speed(t) - reference.path_speed(t)
    path_m = np.hypot(np.diff(reference.x_m), np.diff(reference.y_m)).sum()
    integral_m = np.trapezoid(reference.speed_mps, reference.time_s)
    return {
        "pose_rate_hz": _rate_hz(reference.time_s),
        "pose_speed_minus_path_mps": float(difference.mean()),
        "pose_speed_minus_path_std_mps": float(difference.std()),
        "path_over_pose_speed": path_m / integral_m if integral_m > 5.0 else np.nan,
    }


def _gyro_statistics(reference: Reference, time_s: FloatArray, rate: FloatArray) -> Numbers:
    inside = _inside(reference, time_s)
    t, measured = time_s[inside], rate[inside]
    errors = [measured - reference.yaw_rate(t + lag) for lag in LAGS_S]
    best = int(np.argmin([error.std() for error in errors]))
    error, bias = errors[best], float(errors[best].mean())
    moved = np.degrees(np.concatenate([[0.0], np.cumsum((measured[1:] - bias) * np.diff(t))]))
    moved -= np.degrees(np.interp(t + LAGS_S[best], reference.time_s, reference.yaw_rad))
    drift = {}
    for seconds in (1, 5):
        later = np.interp(t + seconds, t, moved)[t + seconds <= t[-1]]
        drift[f"gyro_drift_{seconds}_s_deg"] = float(np.std(later - moved[: len(later)]))
    return {
        "gyro_rate_hz": _rate_hz(time_s),
        "gyro_bias_degps": float(np.degrees(bias)),
        "gyro_leads_pose_s": float(LAGS_S[best]) if np.ptp(measured) > 0.05 else np.nan,
        "gyro_noise_raw_radps": float(error.std()),
        "gyro_noise_0p1_s_radps": _block_std(t, error, 0.1),
        "gyro_noise_0p5_s_radps": _block_std(t, error, 0.5),
        "gyro_sample_to_sample_radps": float(np.std(np.diff(measured)) / np.sqrt(2.0)),
        **drift,
    }


def _block_std(time_s: FloatArray, values: FloatArray, seconds: float) -> float:
    """Standard deviation of the means over consecutive windows."""
    block = ((time_s - time_s[0]) / seconds).astype(int)
    return float(np.std(np.bincount(block, values)[:-1] / np.bincount(block)[:-1]))


def _accelerometer_statistics(acceleration: FloatArray) -> Numbers:
    mean, std = acceleration.mean(axis=0), acceleration.std(axis=0)
    steps = np.std(np.diff(acceleration, axis=0), axis=0) / np.sqrt(2.0)
    return {
        **{f"accel_{axis}_mean_mps2": float(value) for axis, value in zip("xyz", mean, strict=True)},
        **{f"accel_{axis}_std_mps2": float(value) for axis, value in zip("xyz", std, strict=True)},
        **{f"accel_{axis}_sample_to_sample_mps2": float(value) for axis, value in zip("xyz", steps, strict=True)},
    }


def _wheel_statistics(reference: Reference, time_s: FloatArray, turning_radps: FloatArray) -> Numbers:
    rear = turning_radps[:, 2:].mean(axis=1)
    path_m = np.hypot(np.diff(reference.x_m), np.diff(reference.y_m)).sum()
    angle = np.trapezoid(rear, time_s)
    repeats = (np.diff(turning_radps[:, 2:], axis=0) == 0.0).mean()
    fit = _fitted_wheel(reference, time_s, rear)
    unequal = turning_radps.sum(axis=0)
    spread = np.ptp(1.0 / unequal) * unequal.mean() if unequal.min() > 0.0 and path_m > 20.0 else np.nan
    return {
        "wheel_rate_hz": _rate_hz(time_s),
        "wheel_repeats": float(repeats),
        "wheel_radius_from_distance_m": path_m / angle if path_m > 5.0 else np.nan,
        "wheel_spread_of_radii": spread,
        **fit,
    }


def _fitted_wheel(reference: Reference, time_s: FloatArray, rear_radps: FloatArray) -> Numbers:
    """Radius, noise and lead of the rear axle against the speed in the pose message."""
    keep = _inside(reference, time_s) & (rear_radps * 0.305 > MOVING_MPS)
    if keep.sum() < 200:
        return dict.fromkeys(("wheel_radius_m", "wheel_noise_mps", "wheel_leads_pose_speed_s"), np.nan)
    t, omega = time_s[keep], rear_radps[keep]
    fits = []
    for lag in LAGS_S:
        speed = reference.speed(t + lag)
        radius = float(omega @ speed / (omega @ omega))
        fits.append((float(np.std(radius * omega - speed)), radius, float(lag)))
    noise, radius, lag = min(fits)
    changes = np.ptp(reference.speed(t)) > 2.0
    return {
        "wheel_radius_m": radius,
        "wheel_noise_mps": noise,
        "wheel_leads_pose_speed_s": lag if changes else np.nan,
    }


def _monitor_statistics(
    reference: Reference, time_s: FloatArray, yaw_rate_degps: FloatArray, speed_mps: FloatArray
) -> Numbers:
    inside = _inside(reference, time_s)
    t = time_s[inside]
    error = yaw_rate_degps[inside] - np.degrees(reference.yaw_rate(t))
    steps = np.unique(np.round(np.abs(np.diff(np.unique(yaw_rate_degps))), 6))
    true_mps, measured = reference.speed(t), speed_mps[inside]
    moving = true_mps.max() > 2.0
    fits = []
    for lag in LAGS_S:
        true = reference.speed(t + lag)
        scale = float(measured @ true / (true @ true)) if moving else np.nan
        fits.append((float(np.std(measured - scale * true)), scale))
    noise, scale = min(fits) if moving else (np.nan, np.nan)
    return {
        "monitor_rate_hz": _rate_hz(time_s),
        "monitor_gaps": float((np.diff(time_s) > 0.75).sum()),
        "monitor_yaw_bias_degps": float(error.mean()),
        "monitor_yaw_noise_degps": float(error.std()),
        "monitor_yaw_resolution_degps": float(steps[0]) if len(steps) else np.nan,
        "monitor_speed_scale": scale,
        "monitor_speed_noise_mps": noise,
    }
