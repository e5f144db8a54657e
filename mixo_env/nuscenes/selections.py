"""Named selections of nuScenes channels and scenes, and what is known about single scenes of the real data set."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Protocol

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
"""The paper's four cameras, in the order of every table and array."""

ALL_CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
"""The six cameras of the nuScenes car."""

SCENES_WITHOUT_CAN_BUS = frozenset(
    f"scene-{number:04d}" for number in (*range(161, 169), *range(170, 177), *range(309, 315))
)
"""Scenes of the real data set that never had CAN bus data (the devkit's ``can_bus_api.py``); 309-314 are in test."""

KNOWN_PROBLEMS: Mapping[str, str] = {
    "scene-0419": "no vehicle_monitor messages",
    "scene-0499": "slightly wrong poses",
    "scene-0515": "slightly wrong poses",
    "scene-0517": "slightly wrong poses",
    "scene-0501": "outside the annotated map",
    "scene-0502": "outside the annotated map",
}
"""Remarks of the data set's authors (devkit: ``can_bus_api.py`` and "Known issues")."""

PUBLISHED_VERSIONS = ("v1.0-trainval", "v1.0-mini", "v1.0-test")
"""Table folders of the published data set."""

FIRST_NIGHT_SCENE = 992
"""In the real trainval set night scenes are numbered from here on: a cross-check of the description, never the rule."""

FIRST_SIMULATED_SCENE = 2001
"""Simulated scenes are numbered from here on, clear of every number of the real data set."""


STANDING_M = 5.0
"""A scene with a shorter way hardly moves: about one in ten of the real ones."""


class SceneSummary(Protocol):
    """What a selection looks at."""

    @property
    def name(self) -> str:
        """E.g. ``"scene-0061"``."""
        ...

    @property
    def conditions(self) -> tuple[str, ...]:
        """As :func:`conditions_of`."""
        ...

    @property
    def has_can_bus(self) -> bool:
        """Whether there are CAN bus files of the scene."""
        ...


def conditions_of(description: str) -> tuple[str, ...]:
    """Conditions of a scene from its free-text description, the only place where nuScenes states them.

    A word that begins with "night" makes it night, else it is day; a word that begins with "rain" adds rain. "After
    rain" does not: no drops fall and none stick to the lens, which is what a camera expert would suffer from.

    Returns:
        ``("day",)``, ``("night",)``, ``("day", "rain")`` or ``("night", "rain")``.
    """
    text = description.casefold()
    light = "night" if re.search(r"\bnight", text) else "day"
    rains = re.search(r"\brain", re.sub(r"\bafter (the )?rain", "", text))
    return (light, "rain") if rains else (light,)


def scene_number(name: str) -> int | None:
    """61 for ``"scene-0061"``; ``None`` for a name of another form."""
    match = re.fullmatch(r"scene-(\d+)", name)
    return int(match.group(1)) if match else None


def is_published(version: str) -> bool:
    """Whether the tables are those of the published data set, whose scenes are known by number.

    Simulated and private folders number their scenes as they like.
    """
    return version in PUBLISHED_VERSIONS


def lacks_can_bus(version: str, name: str) -> bool:
    """Whether a scene of the published data set never had CAN bus data."""
    return is_published(version) and name in SCENES_WITHOUT_CAN_BUS


def paper_selection(scenes: Iterable[SceneSummary], version: str) -> tuple[str, ...]:
    """The paper's scenes: by day and with CAN bus, in ascending order of name.

    On the full trainval set these are 850 - 99 night - 15 without CAN bus = 736 scenes. The paper cuts them into four
    contiguous folds of 184 without stating the order; ascending scene number is our reading.

    Args:
        scenes: of one folder.
        version: of the tables. On published ones the lacking CAN bus is that of the authors, not of this disk.
    """

    def has_can_bus(scene: SceneSummary) -> bool:
        return not lacks_can_bus(version, scene.name) if is_published(version) else scene.has_can_bus

    return tuple(sorted(scene.name for scene in scenes if "day" in scene.conditions and has_can_bus(scene)))


PAPER_SCENES = 736
"""Number of scenes of the paper's selection: four folds of 184."""

LIDAR_PERIOD_US = 50_000
"""One turn of the lidar: cameras fire on this grid, and two images of one camera are never closer."""

CAMERA_OFFSET_US: Mapping[str, int] = {
    "CAM_FRONT_LEFT": -43_100,
    "CAM_FRONT": -35_500,
    "CAM_FRONT_RIGHT": -27_600,
    "CAM_BACK_RIGHT": -20_100,
    "CAM_BACK": -10_400,
    "CAM_BACK_LEFT": -500,
}
"""Nominal exposure time of each camera minus the end of the lidar's turn; it follows from the geometry of the car."""
