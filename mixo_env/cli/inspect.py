"""`mixo inspect`: is this nuScenes folder fit for recording?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import tyro

if TYPE_CHECKING:
    from mixo_env.nuscenes.inspection import Inspection


@dataclass(frozen=True)
class Inspect:
    """Check the tables, images, calibration, times and CAN bus of a nuScenes folder, real or simulated.

    Exit code 1 if something is wrong with the data. The first run on a folder reads its tables and keeps a cache.

    Worked examples:
      mixo inspect /data/nuscenes
      mixo inspect /data/nuscenes --version v1.0-trainval --scenes scene-0061 scene-0103
      mixo inspect my-city --json > report.json
    """

    interrupted: ClassVar[str] = "nothing was written"

    root: tyro.conf.Positional[Path]
    """Folder that holds v1.0-*, samples, sweeps and can_bus."""
    version: str | None = None
    """Version folder; needed only if there are several."""
    scenes: tuple[str, ...] = ()
    """Scenes to check; all by default."""
    all_cameras: bool = False
    """Check all six cameras instead of the paper's four."""
    json: bool = False
    """Print the report as JSON instead of a table."""

    def run(self) -> int:
        """Inspect and print."""
        import json

        from rich.console import Console
        from rich.progress import track

        from mixo_env.nuscenes.inspection import Inspection, inspect_scene, problems_of_folder
        from mixo_env.nuscenes.selections import CAMERAS
        from mixo_env.nuscenes.tables import open_dataset

        dataset = open_dataset(self.root, self.version)
        cameras = dataset.channels if self.all_cameras else CAMERAS
        names = self.scenes or dataset.scene_names
        scenes = [dataset.scenes[dataset.position(name)] for name in names]
        console = Console(stderr=True)
        reports = [
            inspect_scene(dataset, scene, cameras)
            for scene in track(scenes, "inspecting", console=console, transient=True)
        ]
        inspection = Inspection(str(dataset.root), dataset.version, problems_of_folder(dataset), reports)
        if self.json:
            print(json.dumps({"is_sound": inspection.is_sound, **asdict(inspection)}, indent=1))
        else:
            _print_table(inspection)
        return 0 if inspection.is_sound else 1


def _print_table(inspection: Inspection) -> None:
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    console = Console()
    table = Table(title=f"{inspection.root}, {inspection.version}", title_justify="left")
    for heading in ("scene", "conditions"):
        table.add_column(heading, no_wrap=True)
    for heading in ("s", "m", "turn °", "images", "gyro r", "wheels"):
        table.add_column(heading, justify="right", no_wrap=True)
    for scene in inspection.scenes:
        table.add_row(
            scene.name,
            " ".join(scene.conditions),
            f"{scene.duration_s:.1f}",
            f"{scene.distance_m:.1f}",
            f"{scene.turn_deg:.1f}",
            str(sum(scene.images.values())),
            "" if scene.gyro_correlation is None else f"{scene.gyro_correlation:.3f}",
            "" if scene.wheel_ratio is None else f"{scene.wheel_ratio:.3f}",
            style="red" if scene.problems else None,
        )
    console.print(table)
    console.print(
        "gyro r: correlation of ms_imu with the poses' yaw rate, where the car turns. "
        "wheels: distance rolled at r = 0.305 m over true distance."
    )
    for problem in inspection.problems:
        console.print(f"[red]problem[/red] {escape(problem)}", soft_wrap=True, highlight=False)
    for scene in inspection.scenes:
        for kind, remarks in (("[red]problem[/red]", scene.problems), ("note", scene.notes)):
            for remark in remarks:
                console.print(f"{kind} {scene.name}: {escape(remark)}", soft_wrap=True, highlight=False)
    total_km = 1e-3 * sum(scene.distance_m for scene in inspection.scenes)
    bad = sum(bool(scene.problems) for scene in inspection.scenes)
    verdict = "sound" if inspection.is_sound else "not sound"
    console.print(
        f"{len(inspection.scenes)} scenes, {total_km:.2f} km, {bad} with problems: {verdict}", highlight=False
    )
