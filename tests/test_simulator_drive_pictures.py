"""Pictures, poses and calibrations belong together: what stands at a known place appears at the computed pixel."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import simplejpeg

from mixo_env.nuscenes.selections import ALL_CAMERAS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.simulator import dataset
from mixo_env.simulator.city.land import FLAT
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from mixo_env.simulator.city.world import CityPlan, build_world
from mixo_env.simulator.config import SimulationConfig, SituationShares
from mixo_env.simulator.dataset import simulate
from mixo_env.simulator.drive.drive import plan_drive
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import camera_pose, pictures, simulate_scene
from mixo_env.simulator.picture.render import CameraPose, Renderer

pytestmark = pytest.mark.rendering

CONFIG = SimulationConfig(scenes=1, seconds=2, width=320, height=180, cameras=("CAM_FRONT", "CAM_BACK"))


@pytest.fixture(scope="module")
def renderer() -> Renderer:
    """A tiny city by overcast day."""
    world = build_world(3, CityPlan(half_blocks=1, variety=4, ground_side=512))
    day = Renderer(world, "day").weather
    return Renderer(world, replace(day, sun=0.0))


@pytest.mark.parametrize("channel", ALL_CAMERAS)
def test_a_van_at_a_known_place_appears_where_the_tables_say(renderer, channel):
    config = replace(CONFIG, cameras=ALL_CAMERAS)
    log = plan_logs(config)[0]
    motion = log.scenes[0].motion
    drive = plan_drive(np.random.default_rng(0), "ordinary", 20.0, log.course_offset_rad, motion, FLAT)
    drive = replace(drive, x_m=drive.x_m + 700.0)  # out of town: nothing stands in the way
    x, y, yaw = (float(drive.at(name, 1.0)) for name in ("x_m", "y_m", "yaw_rad"))
    true, written = log.rig.true[channel], log.rig.written[channel]

    axis = written.rotation_ego_from_camera[:, 2]
    bearing = yaw + np.arctan2(axis[1], axis[0])
    van = VehicleState("van", 2, x + 13.0 * np.cos(bearing), y + 13.0 * np.sin(bearing), bearing + 0.5 * np.pi)
    poses = [camera_pose(drive, true.rotation_ego_from_camera, true.translation_m, t) for t in (1.0, 1.0)]
    with_van, without = (renderer.render(true, *poses, vehicles, gain=1.0).image for vehicles in ([van], []))
    changed = np.abs(with_van.astype(int) - without.astype(int)).sum(axis=2) > 30

    # Corners of the van's box from the written calibration and the flat pose, by hand.
    size = VEHICLE_KINDS["van"]
    corners = np.array([[u, v, w] for u in (-0.5, 0.5) for v in (-0.5, 0.5) for w in (0.0, 1.0)])
    corners *= (size.length_m, size.width_m, size.height_m)
    c, s = np.cos(van.yaw_rad), np.sin(van.yaw_rad)
    on_map = np.stack(
        [van.x_m + c * corners[:, 0] - s * corners[:, 1], van.y_m + s * corners[:, 0] + c * corners[:, 1]]
    )
    c, s = np.cos(yaw), np.sin(yaw)
    dx, dy = on_map[0] - x, on_map[1] - y
    in_ego = np.stack([c * dx + s * dy, -s * dx + c * dy, corners[:, 2]])
    in_camera = written.rotation_ego_from_camera.T @ (in_ego - written.translation_m[:, None])
    assert in_camera[2].min() > 5.0
    u, v, _ = written.intrinsic @ (in_camera / in_camera[2])

    columns = np.flatnonzero(changed.sum(axis=0) > 4)
    rows = np.flatnonzero(changed.sum(axis=1) > 25)
    assert (columns[0], columns[-1]) == (pytest.approx(u.min(), abs=5.0), pytest.approx(u.max(), abs=5.0))
    assert rows[0] == pytest.approx(v.min(), abs=5.0)
    assert rows[-1] == pytest.approx(v.max(), abs=5.0)


def test_every_row_of_the_tables_has_its_picture(renderer, tmp_path, monkeypatch):
    shares = dict.fromkeys(SituationShares().by_name(), 0.0)
    config = replace(CONFIG, situations=SituationShares(**shares | {"fast_straight": 1.0}))
    monkeypatch.setattr(dataset, "_renderer", lambda *_: renderer)
    simulate(config, tmp_path / "city")
    scene = open_dataset(tmp_path / "city").load("scene-2001", ("CAM_FRONT", "CAM_BACK"))
    for reel in scene.cameras.values():
        images = [simplejpeg.decode_jpeg(path.read_bytes(), "GRAY") for path in reel.image_paths]
        assert {image.shape for image in images} == {(180, 320, 1)}
        assert len({path.read_bytes() for path in reel.image_paths}) == len(images)  # no picture twice
    simulate(config, tmp_path / "again")
    for path in (tmp_path / "city").rglob("*.jpg"):
        assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "city")).read_bytes()


class ShutterWatch:
    """Stands in for the renderer and notes what it is asked to show."""

    def __init__(self, shutter_s: float) -> None:
        self.weather = SimpleNamespace(shutter_s=shutter_s)
        self.asked: list[tuple[CameraPose, CameraPose, list[VehicleState]]] = []

    def render(self, _: object, start: CameraPose, end: CameraPose, vehicles: list[VehicleState], **__: object) -> Any:
        self.asked.append((start, end, vehicles))
        return SimpleNamespace(image=None, gain=1.0)


def test_vehicles_stand_where_they_are_in_the_middle_of_the_exposure(tmp_path):
    """The camera moves from the opening to the closing of the shutter; a picture shows its middle, of vehicles too."""
    log = plan_logs(CONFIG)[0]
    plan = log.scenes[0]
    simulated = simulate_scene(CONFIG, log, plan, tmp_path)
    moving = SimpleNamespace(state=lambda time_s: VehicleState("van", 0, 20.0 * time_s, 0.0, 0.0))
    watch = ShutterWatch(0.018)
    for _ in pictures(CONFIG, log, plan, replace(simulated, vehicles=(moving,)), watch):  # type: ignore[arg-type]
        pass
    frames = [simulated.times.cameras[channel] for channel in CONFIG.cameras]
    opens_s = [(int(us) - plan.start_us) / 1e6 for camera in frames for us in camera.exposure_us]
    assert len(watch.asked) == len(opens_s) > 20
    camera = log.rig.true[CONFIG.cameras[0]]
    for (start, end, (van,)), open_s in zip(watch.asked, opens_s, strict=True):
        assert van.x_m == pytest.approx(20.0 * (open_s + 0.009), abs=1e-9)
        if start is watch.asked[0][0]:
            mounting = camera.rotation_ego_from_camera, camera.translation_m
            for pose, time_s in ((start, open_s), (end, open_s + 0.018)):
                expected = camera_pose(simulated.drive, *mounting, time_s)
                np.testing.assert_allclose(pose.position_m, expected.position_m)
