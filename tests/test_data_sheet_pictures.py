"""Statistics of pictures behind the data sheet: pairs of images, and where movers are seen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from docs._pages.data_sheet.images import evenly, match_pair, pair_statistics
from docs._pages.data_sheet.movers import in_sight, mover_mask, outline
from mixo_env.nuscenes.scene import CameraCalibration
from mixo_env.simulator.city.streets import BLOCK_M
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.picture.render import CameraPose


def textured(shift: int = 0) -> np.ndarray:
    noise = np.random.default_rng(3).integers(0, 256, (40, 100)).astype(np.uint8)
    large = cv2.resize(noise, (1000, 400), interpolation=cv2.INTER_CUBIC)
    return np.ascontiguousarray(large[20:380, 50 + shift : 690 + shift])


def test_pair_of_a_shifted_picture():
    intrinsic = np.array([[633.0, 0.0, 320.0], [0.0, 633.0, 180.0], [0.0, 0.0, 1.0]])
    found = pair_statistics(textured(), textured(6), intrinsic)
    assert found.flow_px == pytest.approx(6.0, abs=0.3)
    assert found.inlier_ratio > 0.9
    assert found.match_ratio > 0.5
    twice = pair_statistics(textured(), textured(6), intrinsic)
    assert twice == found


def test_pictures_without_matches_have_no_inliers():
    black, intrinsic = np.zeros((90, 160), np.uint8), np.eye(3)
    pair = match_pair(black, black, intrinsic)
    assert (len(pair.first), pair.corners, pair.inlier.any()) == (0, 0, False)
    assert np.isnan(pair_statistics(black, black, intrinsic).inlier_ratio)


def test_even_choice():
    paths = [Path(str(k)) for k in range(10)]
    assert evenly(paths, 4) == [paths[k] for k in (0, 3, 6, 9)]
    assert evenly(paths[:2], 4) == paths[:2]


# --- movers

CAMERA = CameraCalibration(
    "CAM_FRONT", np.array([[100.0, 0, 80], [0, 100.0, 45], [0, 0, 1]]), np.eye(3), np.zeros(3), 160, 90
)
AHEAD = CameraPose(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.array([0.0, 0.0, 1.5]))
"""At the origin, 1.5 m above the ground, looking along x."""


def test_outline_of_a_truck_ahead():
    # Its rear stands 10 m away: 2.5 m wide and 3.5 m high; the front face lies inside that outline.
    polygon = outline(VehicleState("truck", 0, 10.0 + 4.3, 0.0, 0.0), CAMERA, AHEAD)
    assert polygon is not None
    assert polygon.min(axis=0) == pytest.approx([80 - 12.5, 45 - 20.0], abs=0.51)
    assert polygon.max(axis=0) == pytest.approx([80 + 12.5, 45 + 15.0], abs=0.51)


def test_outline_behind_and_beside_the_camera():
    assert outline(VehicleState("sedan", 0, -10.0, 0.0, 0.0), CAMERA, AHEAD) is None
    beside = outline(VehicleState("truck", 0, 1.0, 3.0, 0.0), CAMERA, AHEAD)  # reaches behind the camera
    assert beside is not None
    assert beside[:, 0].min() < 0


def test_mask_holds_movers_only():
    moving = VehicleState("sedan", 0, 12.0, 0.0, 0.0, speed_mps=5.0)
    parked = VehicleState("sedan", 0, 12.0, 4.0, 0.0)
    far = VehicleState("sedan", 0, 500.0, 0.0, 0.0, speed_mps=5.0)
    mask = mover_mask([moving, parked, far], CAMERA, AHEAD)
    assert np.array_equal(mask, mover_mask([moving], CAMERA, AHEAD))
    assert mask[47, 80]
    assert not mask[:, 100:].any()


def test_houses_hide_what_is_behind_them():
    street = np.array([0.0, 0.0, 1.5])
    assert in_sight(street, VehicleState("sedan", 0, 60.0, 1.75, 0.0))
    between_crossings = np.array([0.5 * BLOCK_M, 0.0, 1.5])
    assert not in_sight(between_crossings, VehicleState("sedan", 0, 0.5 * BLOCK_M, BLOCK_M, 0.0))
    assert in_sight(street, VehicleState("sedan", 0, 0.0, BLOCK_M, 0.0))  # along the crossing street


# --- tables and files
