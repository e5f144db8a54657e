"""`mixo inspect`: is this nuScenes folder fit for recording?"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import tyro

from mixo_env.errors import printable
from mixo_env.tables import Column, Table

if TYPE_CHECKING:
    from mixo_env.nuscenes.checks.judge import Inspection
    from mixo_env.nuscenes.tables import Dataset


@dataclass(frozen=True)
class Inspect:
    """Check the tables, images, calibration, times and CAN bus of a nuScenes folder, real or simulated.

    `mixo record` skips the scenes in which this finds a problem, with the same words. Exit code 1 if something is wrong
    with the data. The first run on a folder reads its tables and keeps a cache.

    Worked examples:
      mixo inspect /data/nuscenes
      mixo inspect /data/nuscenes --version v1.0-trainval --scenes scene-0061 scene-0103
      mixo inspect /data/nuscenes --cameras all
      mixo inspect /data/nuscenes --selection paper736
      mixo inspect my-city --json > report.json
    """

    interrupted: ClassVar[str] = "nothing was written"

    root: tyro.conf.Positional[Path]
    """Folder that holds v1.0-*, samples, sweeps and can_bus."""
    version: str | None = None
    """Version folder; needed only if there are several."""
    scenes: tuple[str, ...] = ()
    """Scenes to check; those of the selection by default."""
    selection: str = "all"
    """Scenes by name: all, day, night, rain, moving (5 m or more), paper736, or an official split such as val, whose
    list is read from splits.json in the version folder or from an installed nuscenes-devkit."""
    key_frames: bool = False
    """Leave the images between key frames (sweeps) out: 2 Hz."""
    cameras: tuple[str, ...] = ()
    """Cameras to check, or "all"; by default the paper's four, or those of them that are there."""
    json: bool = False
    """Print the report as JSON instead of a table."""

    def run(self) -> int:
        """Inspect and print."""
        import json

        from mixo_env.cli.progress import progress
        from mixo_env.nuscenes.checks.judge import Inspection, judge, problems_of_folder
        from mixo_env.nuscenes.selecting import chosen
        from mixo_env.nuscenes.tables import open_dataset

        dataset = open_dataset(self.root, self.version, self.key_frames)
        cameras = _cameras(dataset, self.cameras)
        names = chosen(dataset, self.scenes, self.selection)
        reports = []
        with progress("inspecting scenes") as report:
            for name in names:
                report(len(reports), len(names))
                reports.append(judge(dataset, name, cameras))
        inspection = Inspection(str(dataset.root), dataset.version, problems_of_folder(dataset), reports)
        if self.json:
            print(json.dumps({"is_sound": inspection.is_sound, **asdict(inspection)}, indent=1))
        else:
            _print_table(inspection)
        return 0 if inspection.is_sound else 1


def _cameras(dataset: Dataset, wanted: tuple[str, ...]) -> tuple[str, ...]:
    """The cameras to check: those wanted, else the paper's, as far as images of them are listed and unpacked."""
    from mixo_env.nuscenes.selections import CAMERAS

    if wanted == ("all",):
        return dataset.channels
    if wanted:
        for camera in wanted:
            dataset.channel(camera)
        return tuple(dict.fromkeys(wanted))
    listed = [camera for camera in CAMERAS if camera in dataset.channels and dataset.has_images(camera)]
    unpacked = [camera for camera in listed if dataset.has_folder(camera)]
    return tuple(unpacked or listed or dataset.channels)


def _print_table(inspection: Inspection) -> None:
    """What was measured, what is wrong, and the verdict."""
    for table in _tables(inspection):
        print(table.text())
    for problem in inspection.problems:
        print(f"problem {printable(str(problem))}")
    for scene in inspection.scenes:
        for kind, remarks in (("problem", scene.problems), ("note", scene.notes)):
            for remark in remarks:
                print(f"{kind} {printable(scene.name)}: {printable(str(remark))}")
    cameras = sorted({camera for scene in inspection.scenes for camera in scene.images})
    total_km = 1e-3 * sum(scene.distance_m for scene in inspection.scenes)
    bad = sum(bool(scene.problems) for scene in inspection.scenes)
    verdict = "sound" if inspection.is_sound else "not sound"
    print(f"cameras: {', '.join(cameras) or 'none'}")
    print(f"{len(inspection.scenes)} scenes, {total_km:.2f} km, {bad} with problems: {verdict}")


def _tables(inspection: Inspection) -> tuple[Table, Table]:
    """One line a scene: how it drove, and what its messages are like."""
    scenes, measures = [], []
    for scene in inspection.scenes:
        name = f"{scene.name} !" if scene.problems else scene.name
        images = sum(scene.images.values())
        drove = (scene.duration_s, scene.distance_m, scene.turn_deg, images, scene.gyro_correlation, scene.wheel_ratio)
        scenes.append((name, *drove, " ".join(scene.conditions)))
        rates = (scene.rates_hz.get(message) for message in _RATES.values())
        times = (_milliseconds(scene.imu_latency_s), _milliseconds(scene.pose_lag_s))
        measures.append((name, *rates, *times, scene.course_offset_deg, scene.truth_noise_deg))
    driving = f"{inspection.root}, {inspection.version}; ! is told about below. {_DRIVING}"
    return (
        Table(printable(driving), _columns(_DROVE), scenes),
        Table(_MESSAGES, _columns(dict.fromkeys(_RATES, ".0f") | _MEASURED), measures),
    )


def _columns(specs: dict[str, str]) -> tuple[Column, ...]:
    return tuple(Column(heading, spec=spec) for heading, spec in ({"scene": ""} | specs).items())


def _milliseconds(seconds: float | None) -> float | None:
    return None if seconds is None else 1e3 * seconds


_DROVE = {"s": ".1f", "m": ".1f", "turn °": ".1f", "images": "d", "gyro r": ".3f", "wheels": ".3f", "conditions": ""}
_MEASURED = {"latency ms": ".0f", "lag ms": ".0f", "course °": ".1f", "noise °": ".3f"}
"""Heading -> how its numbers are printed."""

_DRIVING = (
    "gyro r: correlation of ms_imu with the poses' yaw rate, where the car turns. "
    "wheels: distance rolled at r = 0.305 m over true distance."
)
_MESSAGES = (
    "Hz: messages a second. latency: of the copies of ms_imu in `pose`. lag: how late the poses follow ms_imu. "
    "course: direction of motion minus heading. noise: RMS difference of half-second turns, poses against ms_imu."
)

_RATES = {"wheel Hz": "zoe_veh_info", "IMU Hz": "ms_imu", "pose Hz": "pose", "monitor Hz": "vehicle_monitor"}
"""Heading -> message."""
