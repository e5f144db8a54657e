"""The simulated folder behind a data sheet: its configuration, its logs, and its scenes driven once more."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from mixo_env.errors import DatasetError
from mixo_env.nuscenes.tables import Dataset, open_dataset
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.scenario import LogPlan, ScenePlan, plan_logs
from mixo_env.simulator.drive.scenes import SimulatedScene, simulate_scene


@dataclass(frozen=True)
class City:
    """A folder written by ``mixo simulate``, images included."""

    root: Path
    config: SimulationConfig

    @cached_property
    def logs(self) -> tuple[LogPlan, ...]:
        """All logs of the configuration."""
        return plan_logs(self.config)

    @cached_property
    def dataset(self) -> Dataset:
        """Its tables."""
        return open_dataset(self.root)

    def scenes(self) -> Iterator[tuple[LogPlan, ScenePlan]]:
        """Those whose pictures are there (a run may be asked for some scenes only), in order."""
        present = set(self.dataset.scene_names)
        return ((log, plan) for log in self.logs for plan in log.scenes if plan.name in present)

    def drive_again(self, log: LogPlan, plan: ScenePlan) -> SimulatedScene:
        """The scene with its traffic, which no table holds.

        Raises:
            DatasetError: if the simulator has changed since the folder was written: what it says then is not what the
                pictures show.
        """
        again = simulate_scene(self.config, log, plan, self.root)
        for channel, reel in again.scene.cameras.items():
            written = self.dataset.reel(plan.name, channel)
            if not np.array_equal(reel.timestamp_us, written.timestamp_us) or not np.allclose(
                [reel.x_m, reel.y_m], [written.x_m, written.y_m], atol=1e-3
            ):
                raise DatasetError(
                    f"{self.root}: {plan.name} was written by another version of the simulator: simulate it anew"
                )
        return again


def open_city(root: Path) -> City:
    """Open a folder.

    Raises:
        DatasetError: if ``mixo simulate`` did not write it.
    """
    import msgspec

    try:
        note = json.loads((root / "simulation.json").read_text())
        return City(root.resolve(), msgspec.convert(note, SimulationConfig))
    except (OSError, ValueError, msgspec.ValidationError) as error:
        raise DatasetError(f"{root} is not a folder written by `mixo simulate` ({error}): give one") from None
