"""`mixo simulate`: a data set in nuScenes format, without nuScenes."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, ClassVar

import tyro

from mixo_env.simulator.config import SimulationConfig, staging


@dataclass(frozen=True)
class Simulate:
    """Simulate drives through a procedural city and write them as a nuScenes folder.

    The official nuscenes-devkit and `mixo record` open the result. An interrupted run continues when the same command
    is given again. A city takes about 15 s, an image of 800x450 0.03 s: 12 scenes with four cameras some 7 minutes on
    one core.

    Worked examples:
      mixo simulate city                                      12 scenes from 4 drives, seed 0
      mixo simulate city --scenes 104 --workers 8             a large one
      mixo simulate can --scenes 100 --no-images              CAN bus, poses and tables only, in seconds
      mixo simulate rain --rain 1 --night 0 --seed 7          rain all day
      mixo simulate trucks --situation lead_truck --seed 7    a truck ahead in every scene, a log each
      mixo simulate mud --fault.kind dirty                    one dirty lens in every scene
      mixo simulate calm --situations.lead-truck 0            never behind a truck on purpose
      mixo simulate city --only scene-2001 scene-2004         two of the 12 scenes; the others can follow later
    """

    interrupted: ClassVar[str] = "finished scenes are kept, and the same command continues"

    out: Annotated[Path, tyro.conf.Positional]
    """Folder to write; new, or of an interrupted run."""
    config: Annotated[SimulationConfig, tyro.conf.arg(name="")] = field(default_factory=SimulationConfig)
    """What to simulate."""
    situation: str | None = None
    """Stage this in every scene, one scene a log, by day (--rain 1 --night 0: in rain): a name of --situations,
    low_texture or ordinary. None: by shares."""
    workers: int = 1
    """Processes; the files do not depend on it."""
    only: tuple[str, ...] = ()
    """Scenes to do now; all by default. A scene is the same with or without the others."""

    def run(self) -> int:
        """Simulate and show progress."""
        from mixo_env.cli.progress import progress
        from mixo_env.simulator.dataset import VERSION, simulate

        config = self.config if self.situation is None else staging(self.config, self.situation)
        scenes = len(set(self.only)) or config.scenes
        with progress("simulating scenes") as report:
            simulate(config, self.out, workers=self.workers, progress=report, only=self.only)
        print(f"{scenes} scenes ({VERSION}) in {self.out}")
        print(f"next: mixo record {self.out} --out {self.out}-recordings")
        return 0
