"""Fit the process noise of inertial odometry to real CAN bus messages, by the likelihood of the filter's innovations.

The paper gives P0 and R but not Q. With R as printed, the two densities of
:class:`mixo_env.experts.inertial.ProcessNoise` are the ones under which wheel speeds and gyro rates of real scenes are
most likely. Worked example, with the ``can_bus`` folder of nuScenes or any subset of it::

    python -m experiments.fit_process_noise /data/nuscenes/can_bus --scenes scene-0061 scene-0655
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from mixo_env.errors import DatasetError, MixoError
from mixo_env.experts.inertial import SPEED_VARIANCE, YAW_RATE_VARIANCE, ProcessNoise, grade_inputs
from mixo_env.experts.rate_filter import run_filter
from mixo_env.nuscenes.can_bus import read_can_bus, scenes_with_can_bus
from mixo_env.nuscenes.scene import Signal

SEARCH_DECADES = (-5.0, 2.0)
"""Range of the densities, powers of ten in SI units."""


@dataclass(frozen=True)
class FitProcessNoise:
    """Fit the process noise of inertial odometry.

    Example: python -m experiments.fit_process_noise /data/nuscenes/can_bus
    """

    can_bus: tyro.conf.Positional[Path]
    """Folder with <scene>_<message>.json files."""
    scenes: tuple[str, ...] = ()
    """Scenes to use; all of the folder by default."""
    grade: str = "INERTIAL"
    """Inertial grade whose messages are used."""

    def run(self) -> int:
        """Print the most likely densities and how flat the likelihood is around them."""
        names = self.scenes or tuple(sorted(scenes_with_can_bus(self.can_bus)))
        inputs = []
        for name in names:
            messages = read_can_bus(self.can_bus, name)
            if messages is None:
                raise DatasetError(f"{self.can_bus} holds no CAN bus messages of {name}")
            inputs.append(grade_inputs(messages, self.grade))
        if not inputs:
            raise DatasetError(f"{self.can_bus} holds no CAN bus messages: give the can_bus folder itself")
        print(f"{self.grade}, {len(names)} scenes: {', '.join(names)}")
        acceleration = fit_density([speed for speed, _ in inputs], SPEED_VARIANCE)
        yaw_acceleration = fit_density([rate for _, rate in inputs], YAW_RATE_VARIANCE[self.grade])
        print(f"most likely: {ProcessNoise(acceleration, yaw_acceleration)}")
        for label, signals, variance, best in (
            ("acceleration", [speed for speed, _ in inputs], SPEED_VARIANCE, acceleration),
            ("yaw acceleration", [rate for _, rate in inputs], YAW_RATE_VARIANCE[self.grade], yaw_acceleration),
        ):
            top = log_likelihood(signals, variance, best)
            for factor in (0.01, 0.1, 0.3, 1.0, 3.0, 10.0, 100.0):
                loss = log_likelihood(signals, variance, factor * best) - top
                print(f"  {label:>16} x {factor:<5g} {factor * best:10.3g}   log-likelihood {loss:+10.2f}")
        return 0


def log_likelihood(signals: list[Signal], measurement_variance: float, noise_density: float) -> float:
    """Log-likelihood of the innovations, summed over scenes."""
    return sum(run_filter(signal, measurement_variance, noise_density)[3] for signal in signals)


def fit_density(signals: list[Signal], measurement_variance: float) -> float:
    """The most likely spectral density, to 1 %."""
    from scipy.optimize import minimize_scalar

    def loss(decades: float) -> float:
        return -log_likelihood(signals, measurement_variance, 10.0**decades)

    # The likelihood can be flat at both ends: bracket its top on a coarse grid first.
    grid = np.arange(SEARCH_DECADES[0], SEARCH_DECADES[1] + 0.5, 1.0)
    top = grid[int(np.argmin([loss(decades) for decades in grid]))]
    result = minimize_scalar(loss, bounds=(top - 1.0, top + 1.0), method="bounded", options={"xatol": 0.004})
    return float(10.0**result.x)


if __name__ == "__main__":
    import sys

    try:
        sys.exit(tyro.cli(FitProcessNoise, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"fit_process_noise: {error}")
