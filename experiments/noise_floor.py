"""How well the noise of written poses is told without exact truth: beside the exact truth of simulated recordings.

    python -m experiments.noise_floor

The leaderboard of real data has a row NOISE FLOOR, from poses, cameras and gyro alone. Here the exact yaw itself is
scored against the same poses: what the floor should be. By clock, by vehicle and by log.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np
import tyro

from mixo_env.errors import ConfigurationError, MixoError
from mixo_env.leaderboard.crossvalidation import CrossValidation, GroundTruth, Trial
from mixo_env.leaderboard.evaluation import Truth, noisy_truth, with_wheels
from mixo_env.leaderboard.noise import yaw_noise
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import with_truth
from mixo_env.tables import Column, Table

CLOCKS: tuple[GroundTruth, ...] = ("poses", "keyframes")


def floors(recordings: Recordings) -> tuple[float, float]:
    """Error [deg/m] against the poses without their lag: of their estimated noise, and of the exact yaw."""
    truth = Truth(recordings, "truth")
    exact = with_wheels(recordings, with_truth(recordings, "exact")["truth.yaw_increment_rad"])
    told, true = (truth.measure(travel).relative.rotation_deg_per_m for travel in (noisy_truth(recordings), exact))
    return (float(told.mean()), float(true.mean())) if len(true) else (float("nan"), float("nan"))


@dataclass(frozen=True)
class NoiseFloor:
    """Print the estimated and the true noise floor."""

    recordings: str = "mixocity"
    """A bundled recording or a folder; it must hold noise-free truth."""

    def run(self) -> int:
        """All scenes, each vehicle, each log, at both clocks."""
        loaded = load_recordings(self.recordings)
        for clock in CLOCKS:
            validation = CrossValidation(loaded, Trial(ground_truth=clock))
            if validation.truths[0] != "exact":
                raise ConfigurationError("expected recordings with noise-free truth (a simulated folder), got none")
            print(self._table(clock, validation.recordings).text())
        return 0

    def _table(self, clock: str, recordings: Recordings) -> Table:
        groups = {"all": [scene.name for scene in recordings.scenes]}
        for scene in recordings.scenes:
            groups.setdefault(f"vehicle {scene.vehicle.partition(' ')[0]}", []).append(scene.name)
        for scene in recordings.scenes:
            groups.setdefault(scene.log, []).append(scene.name)
        rows, ratios = [], []
        for name, scenes in groups.items():
            chosen = recordings.select(scenes=scenes)
            told, true = floors(chosen)
            second = np.degrees(np.sqrt(yaw_noise(chosen).variance_rad2(np.ones(1))[0]))
            rows.append([name, told, true, told / true, float(second)])
            if name in {scene.log for scene in recordings.scenes}:
                ratios.append(told / true)
        columns = (
            Column("scenes of"),
            Column("told", "deg/m", ".4f"),
            Column("true", "deg/m", ".4f"),
            Column("told / true", "", ".2f"),
            Column("in 1 s", "deg", ".3f"),
        )
        spread = (
            f"told / true over logs: mean {np.nanmean(ratios):.2f}, {np.nanmin(ratios):.2f} to {np.nanmax(ratios):.2f}"
        )
        return Table(f"Noise floor of the truth, {clock}; {spread}", columns, rows)


if __name__ == "__main__":
    try:
        sys.exit(tyro.cli(NoiseFloor, description=__doc__).run())
    except MixoError as error:
        sys.exit(f"noise_floor: {error}")
