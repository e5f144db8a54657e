"""The page about the single-camera odometry: its tables are those of the code, its pictures show what was estimated."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest

from docs._pages.odometry_page import (
    DOCS,
    OdometryPage,
    attributes,
    inside,
    outline,
    page,
    settings_table,
    signals_table,
)
from docs._pages.odometry_pictures import (
    NEAREST_M,
    PairView,
    Track,
    compare,
    draw_frames,
    draw_pairs,
    draw_states,
    epipolar_segments,
    pixels,
)
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.monocular.camera import mount
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.pair import PairSolver
from mixo_env.simulator.city.vehicles import VEHICLE_KINDS, VehicleState
from tests.corridor import AXES, HEIGHT, WIDTH, calibration, picture
from tests.rigid_body import camera_displacement

TURN_RAD, DISTANCE_M = math.radians(1.5), 0.6


@pytest.fixture(scope="module")
def view() -> PairView:
    """Two pictures of the corridor."""
    camera = calibration()
    dx, dy = camera_displacement(TURN_RAD, DISTANCE_M, 0.0, 0.0)
    images = picture(camera, 0.0, 0.0, 0.0), picture(camera, dx, dy, TURN_RAD, 1)
    config = MonocularConfig()
    solver = PairSolver(mount(camera, config.max_pixels), config)
    return compare("CAM_TEST", solver, images, 0.083, DISTANCE_M, TURN_RAD)


def test_kept_matches_lie_on_their_epipolar_segments(view: PairView) -> None:
    assert view.motion is not None
    assert view.motion.yaw_rad == pytest.approx(TURN_RAD, abs=math.radians(0.05))
    kept = np.flatnonzero(view.motion.inlier)
    assert len(kept) > 100
    far, near = np.moveaxis(epipolar_segments(view, kept), 1, 0)
    along = near - far
    length = np.linalg.norm(along, axis=1)
    offset = view.first_px[kept] - far
    across = np.abs(offset[:, 0] * along[:, 1] - offset[:, 1] * along[:, 0]) / length
    assert np.quantile(across, 0.9) < 0.5
    depth_m = NEAREST_M * length / np.maximum((offset * along).sum(1) / length, 1e-9)
    assert 5.0 < np.median(depth_m) < 40.0  # walls 9 m to either side
    assert epipolar_segments(replace(view, motion=None), kept).shape == (0, 2, 2)


def test_pixels_are_those_of_the_full_image(view: PairView) -> None:
    camera = replace(view.camera, skew_px=3.0)
    full = np.array([[0.0, 0.0], [WIDTH - 1.0, HEIGHT - 1.0], [100.0, 250.0]])
    working = (full + 0.5) / 2**camera.halvings - 0.5
    np.testing.assert_allclose(pixels(camera, camera.plane(working)), full, atol=1e-9)


def test_pictures_are_drawn(view: PairView, tmp_path: Path) -> None:
    movers = np.arange(len(view.first_px)) % 3 == 0
    draw_pairs([replace(view, movers=movers), replace(view, motion=None), view]).savefig(tmp_path / "pairs.jpg", dpi=40)
    tracking = CameraStep(State.TRACKING, 0.01, 0.001, 200, 150, 0.1, 5.0, 0.01)
    lost = CameraStep(State.LOST, math.nan, math.nan, 0, 0, math.nan, math.nan, math.nan)
    track = Track("CAM_FRONT", np.arange(4) / 12.0, [tracking, lost, tracking, tracking], np.full(3, 0.01))
    draw_states([track, track], "CAM_FRONT", (0.05, 0.1)).savefig(tmp_path / "states.png", dpi=40)
    draw_frames().savefig(tmp_path / "frames.png", dpi=40)
    assert all(path.stat().st_size > 2_000 for path in tmp_path.iterdir())


def test_outline_of_a_vehicle_ahead() -> None:
    camera = calibration(lever_m=(0.0, 0.0))
    van = VEHICLE_KINDS["van"]
    ahead = VehicleState("van", 0, 20.0, 0.0, 0.0)
    edge = outline(camera, AXES, np.array([0.0, 0.0, 1.5]), ahead)
    focal = camera.intrinsic[0, 0]
    back_m = 20.0 - van.length_m / 2.0
    assert np.ptp(edge[:, 0]) == pytest.approx(focal * van.width_m / back_m, rel=1e-3)
    assert np.ptp(edge[:, 1]) == pytest.approx(focal * van.height_m / back_m, rel=1e-3)
    centre = edge.mean(axis=0)
    np.testing.assert_array_equal(inside(np.array([centre, centre + 500.0]), [edge]), [True, False])
    assert not inside(np.array([centre]), []).any()
    behind = VehicleState("van", 0, -20.0, 0.0, 0.0)
    assert len(outline(camera, AXES, np.array([0.0, 0.0, 1.5]), behind)) == 0


def test_tables_hold_every_setting_and_signal_with_its_meaning() -> None:
    meaning = attributes(MonocularConfig)
    assert set(meaning) == {field.name for field in fields(MonocularConfig)}
    assert all(meaning.values())
    assert set(attributes(CameraStep)) == {field.name for field in fields(CameraStep)}
    assert "| `min_matches` | 50 | 50 | fewer matches and the camera is lost (50 in the paper). |" in settings_table()


def test_the_page_is_up_to_date() -> None:
    text = (DOCS / "odometry.md").read_text(encoding="utf-8")
    again = "run `python -m docs._pages.odometry_page`"
    assert text == page(), again
    assert signals_table() in text
    assert settings_table() in text
    for line in text.splitlines():
        if "](figures/" in line:
            assert (DOCS / line.split("](")[1].rstrip(")")).exists(), again


@pytest.mark.rendering
def test_the_whole_page_is_made_from_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("MIXO_REAL_DATA", raising=False)
    assert OdometryPage(out=tmp_path).run() == 0
    assert (tmp_path / "odometry.md").read_text(encoding="utf-8") == page()
    assert len(list((tmp_path / "figures").iterdir())) == 4
