"""Camera faults change what one camera sees, and nothing else of a data set."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.camera_faults import told_faults
from mixo_env.simulator.city.land import land_of
from mixo_env.simulator.config import FAULTS, STAGED, CameraFault, SimulationConfig, SituationShares, staging
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive.scenario import generator, plan_logs
from mixo_env.simulator.drive.scenes import scene_drive
from mixo_env.simulator.drive.traffic import stage_traffic
from mixo_env.simulator.picture.faults import KINDS, LOST_SWEEPS, PixelFault, Shot, dropped, glaring_sun, knock, spoil

pytestmark = pytest.mark.rendering

TINY = SimulationConfig(scenes=1, scenes_per_log=1, seconds=2, width=160, height=90, cameras=("CAM_FRONT", "CAM_BACK"))
AT_RENDERING = {"dropped", "knocked"}


def picture(shade: int = 120) -> NDArray[np.uint8]:
    rng = np.random.default_rng(shade)
    return np.clip(rng.normal(shade, 25.0, (90, 160, 3)), 0, 255).astype(np.uint8)


def shot(time_s: float, sun: tuple[float, float, float] = (0.1, -0.15, 0.98)) -> Shot:
    """Of ``picture``, taken by a camera of 65 degrees."""
    return Shot(time_s, np.array([[126.0, 0.0, 79.5], [0.0, 126.0, 44.5], [0.0, 0.0, 1.0]]), np.array(sun))


def hashes(folder: Path, *patterns: str) -> dict[str, str]:
    found = (path for pattern in patterns for path in folder.glob(pattern) if path.is_file())
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in found}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    root = tmp_path_factory.mktemp("faults")

    def made(kind: str) -> Path:
        if not (root / kind).exists():
            if kind == "none":
                simulate(TINY, root / kind)
            else:
                simulate(replace(TINY, fault=CameraFault(kind, "CAM_FRONT")), root / kind, sound=made("none"))
        return root / kind

    return made


def test_the_configuration_offers_every_kind_there_is() -> None:
    assert ("none", *KINDS) == FAULTS


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_changes_pictures_inside_its_seconds_only(kind: str) -> None:
    image, last, fault = picture(), picture(60), PixelFault(kind, "CAM_FRONT", 1.0, 9.0, seed=3)
    before = image.copy()
    spoilt = spoil(image, last, fault, shot(4.0))
    assert (image == before).all()
    assert spoilt.dtype == np.uint8
    assert spoilt.shape == image.shape
    assert (spoilt != image).any() == (kind not in AT_RENDERING)
    assert (spoilt == spoil(image, last, fault, shot(4.0))).all()
    assert spoil(image, last, fault, shot(0.9)) is image
    assert spoil(image, last, fault, shot(9.0)) is image


def test_mud_stays_and_is_another_in_another_scene() -> None:
    image = picture()
    one = PixelFault("dirty", "CAM_FRONT", 0.0, 9.0, seed=3)
    assert (spoil(image, None, one, shot(1.0)) == spoil(image, None, one, shot(8.0))).all()
    assert (spoil(image, None, one, shot(1.0)) != spoil(image, None, replace(one, seed=4), shot(1.0))).any()


def test_drops_come_and_go_and_dull_more_than_a_tenth_of_every_camera() -> None:
    image = np.repeat(np.tile([[40], [200]], (45, 160))[..., None], 3, axis=2).astype(np.uint8)  # finest stripes
    for camera in ("CAM_FRONT", "CAM_BACK"):
        one = PixelFault("drops", camera, 0.0, 9.0, seed=3)
        early, late = (spoil(image, None, one, shot(time_s)) for time_s in (1.0, 8.0))
        assert (early != late).any()
        assert 0.1 < (np.abs(early.astype(int) - image).max(axis=2) > 10).mean() < 0.95


def test_the_sun_of_a_glare_stays_in_the_map_and_hides_behind_the_car() -> None:
    view = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])  # a camera that looks along x
    image, fault = picture(), PixelFault("glare", "CAM_FRONT", 0.0, 9.0, seed=5)
    sun = glaring_sun(fault, view)
    assert np.linalg.norm(sun) == pytest.approx(1.0)
    assert 0.0 < np.arcsin(sun[2]) < 0.3
    assert abs(np.arctan2(sun[1], sun[0])) < 0.4
    ahead = view.T @ sun
    assert (spoil(image, None, fault, shot(1.0, tuple(ahead))) != image).any()
    assert (spoil(image, None, fault, shot(1.0, tuple(-ahead))) == image).all()


def test_frozen_repeats_black_is_black_and_glare_saturates() -> None:
    image, last = picture(), picture(60)
    faults = {kind: PixelFault(kind, "CAM_FRONT", 0.0, 9.0) for kind in KINDS}
    assert (spoil(image, last, faults["frozen"], shot(1.0)) == last).all()
    assert (spoil(image, None, faults["frozen"], shot(1.0)) == image).all()
    assert (spoil(image, last, faults["black"], shot(1.0)) == 0).all()
    assert (spoil(image, last, faults["glare"], shot(1.0)) == 255).all(axis=2).mean() > 0.005


def test_the_gain_runs_away_by_two_to_three_stops() -> None:
    grey = np.full((4, 4, 3), 100, np.uint8)
    for seed in range(20):
        fault = PixelFault("exposure", "CAM_FRONT", 0.0, 9.0, seed)
        light = (float(spoil(grey, None, fault, shot(5.0))[0, 0, 0]) / 100.0) ** 2.2
        assert light > 3.9 or 1 / 8.5 < light < 1 / 3.8
        assert (spoil(grey, None, fault, shot(0.0)) == grey).all()


def test_sweeps_are_lost_and_key_frames_are_not() -> None:
    fault = PixelFault("dropped", "CAM_FRONT", 0.0, 9.0, seed=1)
    assert not any(dropped(fault, number, 1.0, True) for number in range(1000))
    assert np.mean([dropped(fault, n, 1.0, False) for n in range(1000)]) == pytest.approx(LOST_SWEEPS, abs=0.05)
    assert not any(dropped(replace(fault, kind="black"), n, 1.0, False) for n in range(100))


def test_a_knock_turns_the_mounting_by_one_to_two_degrees() -> None:
    for seed in range(50):
        turn = knock(PixelFault("knocked", "CAM_FRONT", 0.0, 9.0, seed))
        assert 0.98 <= np.degrees(np.arccos((np.trace(turn) - 1.0) / 2.0)) <= 2.02
    assert (knock(PixelFault("dirty", "CAM_FRONT", 0.0, 9.0)) == np.eye(3)).all()


@pytest.mark.parametrize("kind", KINDS)
def test_truth_poses_calibration_bus_and_other_cameras_are_those_of_the_sound_drive(
    kind: str, folder: Callable[[str], Path]
) -> None:
    sound, faulty = folder("none"), folder(kind)
    same = ("exact/*", "can_bus/*", "*/CAM_BACK/*", "v1.0-mixo/calibrated_sensor.json", "v1.0-mixo/sample.json")
    assert len(hashes(sound, *same)) > 10
    assert hashes(sound, *same) == hashes(faulty, *same)
    before, after = hashes(sound, "*/CAM_FRONT/*"), hashes(faulty, "*/CAM_FRONT/*")
    assert before != after
    assert set(after) < set(before) if kind == "dropped" else set(after) == set(before)
    if kind == "dropped":
        assert after.items() < before.items()
    one, other = (open_dataset(root).load("scene-2001", TINY.cameras).cameras["CAM_FRONT"] for root in (sound, faulty))
    kept = np.isin(one.timestamp_us, other.timestamp_us)
    assert np.array_equal(one.x_m[kept], other.x_m)
    assert np.array_equal(one.yaw_rad[kept], other.yaw_rad)


@pytest.mark.parametrize("kind", KINDS)
def test_the_folder_names_the_fault_of_every_scene(kind: str, folder: Callable[[str], Path]) -> None:
    note = told_faults(folder(kind))["scene-2001"]
    assert (note["kind"], note["camera"]) == (kind, "CAM_FRONT")
    scene = open_dataset(folder(kind)).load("scene-2001", TINY.cameras)
    assert abs(note["begin_us"] - int(scene.cameras["CAM_BACK"].timestamp_us[0])) < 200_000


@pytest.mark.parametrize("kind", ["dropped", "drops", "knocked"])
def test_pictures_taken_from_the_sound_folder_are_those_drawn_anew(
    kind: str, folder: Callable[[str], Path], tmp_path: Path
) -> None:
    simulate(replace(TINY, fault=CameraFault(kind, "CAM_FRONT")), tmp_path / "drawn")
    everything = "*/CAM_*/*", "v1.0-mixo/*", "*.json", "exact/*"
    assert hashes(tmp_path / "drawn", *everything) == hashes(folder(kind), *everything)


def test_a_folder_of_other_or_unfinished_drives_is_not_taken_for_the_sound_one(
    folder: Callable[[str], Path], tmp_path: Path
) -> None:
    other = replace(TINY, seed=1, fault=CameraFault("black", "CAM_FRONT"))
    with pytest.raises(ConfigurationError, match="does not hold these drives"):
        simulate(other, tmp_path / "out", sound=folder("none"))


def test_a_sound_folder_says_nothing_of_faults(folder: Callable[[str], Path]) -> None:
    assert not {"fault", "faults"} & set(json.loads((folder("none") / "simulation.json").read_text()))


@pytest.mark.parametrize("name", STAGED)
def test_a_situation_is_staged_in_every_scene_of_a_log_of_its_own(name: str) -> None:
    logs = plan_logs(staging(SimulationConfig(scenes=5, rain=1.0, night=0.0), name))
    assert len(logs) == 5
    assert {log.weather for log in logs} == {"rain"}
    assert {log.low_texture for log in logs} == {name == "low_texture"}
    staged = "ordinary" if name == "low_texture" else name
    assert {scene.situation for log in logs for scene in log.scenes} == {staged}
    assert not any(log.low_sun for log in plan_logs(staging(SimulationConfig(scenes=5, rain=0.0, low_sun=1.0), name)))


@pytest.mark.parametrize("seed", range(3))
def test_most_cameras_look_at_a_convoy_that_turns_as_one_body(seed: int) -> None:
    config = staging(SimulationConfig(scenes=1, seed=seed, rain=0.0), "majority_wrong")
    log = plan_logs(config)[0]
    drive = scene_drive(config, log, log.scenes[0])
    vehicles = stage_traffic(generator(config, "traffic", 0), drive, config.seconds, land_of(log.world_seed))
    ahead, behind, left = 0, 0, 0
    for time_s in np.arange(0.0, 20.0, 1.0):
        x, y, yaw = (float(drive.at(name, time_s)) for name in ("x_m", "y_m", "yaw_rad"))
        states = [vehicle.state(time_s) for vehicle in vehicles]
        dx, dy = (np.array([s.x_m - x for s in states]), np.array([s.y_m - y for s in states]))
        along, across = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
        truck = np.array([s.kind == "truck" for s in states])
        ahead += bool((truck & (along > 5) & (along < 12) & (abs(across) < 7)).any())
        behind += bool((truck & (along < -4) & (along > -9) & (abs(across) < 5)).any())
        left += bool(((abs(along) < 8) & (across > 1.5) & (across < 6)).any())
    assert min(ahead, behind, left) >= 18
    assert abs(float(drive.at("yaw_rad", 20.0) - drive.at("yaw_rad", 0.0))) > 1.0


def test_unknown_names_are_one_line_with_the_nearest() -> None:
    with pytest.raises(ConfigurationError, match="did you mean 'lead_truck'"):
        staging(SimulationConfig(), "lead_trck")
    with pytest.raises(ConfigurationError, match="did you mean 'frozen'"):
        CameraFault("frozn")
    with pytest.raises(ConfigurationError, match="did you mean 'frozen'"):
        PixelFault("frozn", "CAM_FRONT", 1.0, 2.0)
    with pytest.raises(ConfigurationError, match="after it starts"):
        PixelFault("frozen", "CAM_FRONT", 2.0, 2.0)
    with pytest.raises(ConfigurationError, match="unknown fault camera"):
        replace(TINY, fault=CameraFault("black", "CAM_FRONT_LEFT"))
    with pytest.raises(ConfigurationError, match="needs a fault kind"):
        CameraFault(camera="CAM_FRONT")
    assert set(STAGED) > set(SituationShares().by_name())
