from __future__ import annotations

import json
import pickle
from dataclasses import replace

import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.nuscenes.index import TABLES
from mixo_env.nuscenes.selecting import chosen, select
from mixo_env.nuscenes.selections import (
    KNOWN_PROBLEMS,
    SCENES_WITHOUT_CAN_BUS,
    conditions_of,
    lacks_can_bus,
    paper_selection,
    scene_number,
)
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.folds import contiguous_folds
from mixo_env.recordings.schema import SceneEntry
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


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    root = tmp_path_factory.mktemp("city")
    write_nuscenes(root, images=False, duration_s=2.0)
    return root


@pytest.fixture(scope="module")
def trainval(tmp_path_factory):
    """Tables of 850 scenes without images: 99 by night, and the 15 of trainval that never had CAN bus data."""
    root = tmp_path_factory.mktemp("trainval")
    numbers = [*range(161, 169), *range(170, 177), *range(200, 309), *range(315, 942), *range(992, 1091)]
    assert len(numbers) == 850
    tables = {
        "log": [{"token": "l", "logfile": "n015-2018", "vehicle": "n015", "location": "here"}],
        "sensor": [{"token": "s", "channel": "CAM_FRONT", "modality": "camera"}],
        "scene": [
            {
                "token": str(number),
                "name": f"scene-{number:04d}",
                "description": "Night" if number >= 992 else "Street",
                "log_token": "l",
                "nbr_samples": 40,
            }
            for number in reversed(numbers)
        ],
    }
    for version in ("v1.0-trainval", "v1.0-mini"):
        (root / version).mkdir()
        for name in TABLES:
            (root / version / f"{name}.json").write_text(json.dumps(tables.get(name, [])))
    return root


def test_the_papers_selection_and_its_folds(trainval):
    dataset = open_dataset(trainval, "v1.0-trainval")
    names = select(dataset, "paper736")
    assert len(names) == 736
    assert names[0] == "scene-0200"  # 161 to 176 had no CAN bus, although no CAN bus is here at all
    assert names == tuple(sorted(names))
    entries = [SceneEntry(name, "", "", "", ("day",), -1, 1) for name in names]
    folds = contiguous_folds(entries)
    assert folds == sorted(folds)
    assert [folds.count(fold) for fold in range(4)] == [184] * 4  # 1-184, 185-368, 369-552, 553-736


def test_the_papers_selection_is_all_or_nothing(trainval, folder):
    scenes = json.loads((trainval / "v1.0-trainval" / "scene.json").read_text())
    (trainval / "v1.0-mini" / "scene.json").write_text(json.dumps(scenes[:-20]))
    for dataset in (open_dataset(trainval, "v1.0-mini"), open_dataset(folder)):
        with pytest.raises(DatasetError, match=r"paper736 is 850 scenes of v1\.0-trainval less"):
            select(dataset, "paper736")


def test_paper_selection_is_day_with_can_bus(folder):
    """By files where nothing is published about the scenes."""
    dataset = open_dataset(folder)
    assert paper_selection(dataset.scenes, "v1.0-mine") == ("scene-2061", "scene-2103", "scene-2655")
    blind = [replace(scene, has_can_bus=False) for scene in dataset.scenes]
    assert paper_selection(blind, "v1.0-mine") == ()
    assert len(paper_selection(blind, "v1.0-trainval")) == 3


def test_the_list_of_missing_can_bus_is_for_published_versions():
    assert lacks_can_bus("v1.0-trainval", "scene-0161")
    assert not lacks_can_bus("v1.0-mixo", "scene-0161")
    assert not lacks_can_bus("v1.0-trainval", "scene-0061")


@pytest.mark.parametrize(
    ("selection", "expected"),
    [
        ("all", (2061, 2103, 2655, 2757)),
        ("day", (2061, 2103, 2655)),
        ("night", (2757,)),
        ("rain", (2655,)),
        ("moving", (2061, 2655, 2757)),
    ],
)
def test_selections(folder, selection, expected):
    assert select(open_dataset(folder), selection) == tuple(f"scene-{number}" for number in expected)


def test_official_splits_come_from_the_devkits_file(folder):
    dataset = open_dataset(folder)
    with pytest.raises(ConfigurationError, match=r"unknown selection 'val'.*splits\.json"):
        select(dataset, "val")
    path = folder / "v1.0-mini" / "splits.json"
    path.write_text(json.dumps({"val": ["scene-2655", "scene-2061", "scene-0001"]}))
    assert select(dataset, "val") == ("scene-2061", "scene-2655")
    with pytest.raises(ConfigurationError, match="did you mean 'val'"):
        select(dataset, "vall")
    path.write_text('{"val": 3}')
    with pytest.raises(DatasetError, match="is no file of splits"):
        select(dataset, "val")
    path.unlink()


def test_named_scenes_must_be_of_the_selection(folder):
    dataset = open_dataset(folder)
    assert chosen(dataset, (), "night") == ("scene-2757",)
    assert chosen(dataset, ("scene-2103",), "day") == ("scene-2103",)
    with pytest.raises(ConfigurationError, match="scene-2757 is not in the selection 'day'"):
        chosen(dataset, ("scene-2757",), "day")


def test_key_frames_only(folder):
    every, keys = open_dataset(folder), open_dataset(folder, keyframes_only=True)
    reel = keys.reel("scene-2061", "CAM_FRONT")
    assert reel.is_keyframe.all()
    assert len(reel.x_m) == every.reel("scene-2061", "CAM_FRONT").is_keyframe.sum() == 5
    assert all("samples" in path.parts for path in reel.image_paths)
    assert pickle.loads(pickle.dumps(keys)).keyframes_only
