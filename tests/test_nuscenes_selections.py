from __future__ import annotations

import pytest

from mixo_env.nuscenes.selections import (
    KNOWN_PROBLEMS,
    SCENES_WITHOUT_CAN_BUS,
    conditions_of,
    paper_selection,
    scene_number,
)
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import write_nuscenes


@pytest.mark.parametrize(
    ("description", "conditions"),
    [
        ("Parked truck, construction, intersection", ("day",)),
        ("Night, big street, bus stop", ("night",)),
        ("Nighttime, rainy", ("night", "rain")),
        ("Heavy rain, turn right", ("day", "rain")),
        ("Night, after rain, many peds", ("night",)),
        ("After the rain, puddles", ("day",)),
        ("After rain, rain starts again", ("day", "rain")),
        ("Train crossing, terrain, overnight parking", ("day",)),
        ("", ("day",)),
    ],
)
def test_conditions(description, conditions):
    assert conditions_of(description) == conditions


def test_scene_number():
    assert scene_number("scene-0061") == 61
    assert scene_number("kitti-06") is None


def test_scenes_without_can_bus():
    """21 scenes, 15 of them in trainval; 169 does not exist."""
    assert len(SCENES_WITHOUT_CAN_BUS) == 21
    assert sum(scene_number(name) < 300 for name in SCENES_WITHOUT_CAN_BUS) == 15
    assert "scene-0169" not in SCENES_WITHOUT_CAN_BUS
    assert not SCENES_WITHOUT_CAN_BUS & set(KNOWN_PROBLEMS)


def test_paper_selection_is_day_with_can_bus(tmp_path):
    write_nuscenes(tmp_path, images=False, duration_s=0.5)
    assert paper_selection(open_dataset(tmp_path).scenes) == ("scene-2061", "scene-2103", "scene-2655")
