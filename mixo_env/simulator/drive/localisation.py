"""The car's own localisation: the poses that are written, close to the truth but not equal to it.

Real poses wander by centimetres and hundredths of a degree, only while the car moves, and come some 30 ms late (they
lag behind the gyro of the same car by that much): a property of the car's computer, the same in all of its drives.
Magnitudes: CAN bus and poses of four real scenes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.drive.drive import DRIVE_RATE_HZ, Drive

FloatArray = NDArray[np.float64]

LAG_RANGE_S = (0.025, 0.035)

# Standard deviation and correlation time, while moving, of the errors along and aside [m] and of two in yaw [rad].
_STD = np.array([0.05, 0.03, np.radians(0.025), np.radians(0.06)])
_CORRELATION_S = np.array([1.5, 1.5, 0.2, 2.5])
_SMOOTHING_S = np.array([0.3, 0.3, 0.05, 0.3])  # the filter behind a localisation does not jump
_MOVING_MPS = 2.0

# Poses of a standing car still tremble: half of the standing seconds of all 850 real scenes turn by more than
# 0.0035 deg and move by more than 0.25 mm. Standard deviation of what comes on top of the above at all times, and how
# long it is correlated.
_TREMBLE_M, _TREMBLE_RAD = 0.0003, np.radians(0.0036)
_TREMBLE_S = 0.6


@dataclass(frozen=True)
class Localisation:
    """Errors over one drive, ``(n,)`` at the drive's own times, and the constant lag."""

    drive: Drive
    lag_s: float
    along_m: FloatArray
    aside_m: FloatArray
    turned_rad: FloatArray

    def pose(self, time_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Written x, y [m] and yaw [rad, not wrapped] at scene times."""
        x, y, yaw = (self.drive.at(name, time_s - self.lag_s) for name in ("x_m", "y_m", "yaw_rad"))
        along, aside, turned = (
            np.interp(time_s, self.drive.time_s, error) for error in (self.along_m, self.aside_m, self.turned_rad)
        )
        cosine, sine = np.cos(yaw), np.sin(yaw)
        return x + along * cosine - aside * sine, y + along * sine + aside * cosine, yaw + turned


def localise(rng: np.random.Generator, drive: Drive, lag_s: float) -> Localisation:
    """Draw the errors of one drive: smoothed Ornstein-Uhlenbeck processes whose clock stops with the car."""
    clock_s = np.minimum(drive.speed_mps / _MOVING_MPS, 1.0) / DRIVE_RATE_HZ
    keep = np.exp(-clock_s[:, None] / _CORRELATION_S)
    follow = 1.0 - np.exp(-clock_s[:, None] / _SMOOTHING_S)
    noise = np.sqrt(1.0 - keep**2) * rng.standard_normal(keep.shape)
    raw = smooth = rng.standard_normal(len(_STD))
    errors = np.empty_like(keep)
    for index in range(len(errors)):
        raw = keep[index] * raw + noise[index]
        smooth = smooth + follow[index] * (raw - smooth)
        errors[index] = smooth
    along, aside, quick, slow = (_STD * errors).T
    window = np.hanning(round(2 * _TREMBLE_S * DRIVE_RATE_HZ) + 1)
    window /= np.linalg.norm(window)
    tremble = [np.convolve(rng.standard_normal(len(errors) + len(window) - 1), window, "valid") for _ in range(3)]
    return Localisation(
        drive,
        lag_s,
        along + _TREMBLE_M * tremble[0],
        aside + _TREMBLE_M * tremble[1],
        quick + slow + _TREMBLE_RAD * tremble[2],
    )
