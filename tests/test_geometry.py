from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from mixo_env import geometry

ANGLES = st.floats(-50.0, 50.0)
UNIT = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .filter(lambda q: np.linalg.norm(q) > 1e-3)
    .map(lambda q: np.array(q) / np.linalg.norm(q))
)


@given(ANGLES)
def test_wrap_keeps_the_direction_and_the_interval(angle: float) -> None:
    wrapped = geometry.wrap_angle_rad(angle)
    assert -np.pi < wrapped <= np.pi
    np.testing.assert_allclose([np.cos(wrapped), np.sin(wrapped)], [np.cos(angle), np.sin(angle)], atol=1e-12)


def test_wrap_at_the_border() -> None:
    np.testing.assert_array_equal(geometry.wrap_angle_rad([np.pi, -np.pi, 0.0]), [np.pi, np.pi, 0.0])


@given(UNIT)
def test_rotation_matches_scipy(q: np.ndarray) -> None:
    expected = Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()
    np.testing.assert_allclose(geometry.rotation_from_quaternion_wxyz(q), expected, atol=1e-12)


@given(UNIT)
def test_quaternion_round_trip_up_to_sign(q: np.ndarray) -> None:
    back = geometry.quaternion_wxyz_from_rotation(geometry.rotation_from_quaternion_wxyz(q))
    assert back[0] >= 0
    np.testing.assert_allclose(abs(back @ q), 1.0, atol=1e-12)


@given(ANGLES)
def test_yaw_of_a_yaw_quaternion(yaw: float) -> None:
    q = geometry.quaternion_wxyz_from_yaw(yaw)
    for sign in (1, -1):  # both signs are the same rotation
        difference = geometry.wrap_angle_rad(geometry.yaw_from_quaternion_wxyz(sign * q) - yaw)
        assert abs(difference) < 1e-9
    np.testing.assert_allclose(geometry.rotation_from_yaw(yaw), geometry.rotation_from_quaternion_wxyz(q), atol=1e-12)


def test_left_turn_is_positive() -> None:
    forward_after_left_turn = geometry.rotation_from_yaw(np.pi / 2) @ [1.0, 0.0, 0.0]
    np.testing.assert_allclose(forward_after_left_turn, [0.0, 1.0, 0.0], atol=1e-15)


@pytest.mark.parametrize("shape", [(), (3,), (2, 5)])
def test_shapes_broadcast(shape: tuple[int, ...]) -> None:
    yaw = np.zeros(shape)
    assert geometry.quaternion_wxyz_from_yaw(yaw).shape == (*shape, 4)
    assert geometry.rotation_from_yaw(yaw).shape == (*shape, 3, 3)
    assert geometry.yaw_from_quaternion_wxyz(geometry.quaternion_wxyz_from_yaw(yaw)).shape == shape


@given(*[st.floats(-3.0, 3.0)] * 3)
def test_roll_pitch_and_yaw_match_scipy(roll: float, pitch: float, yaw: float) -> None:
    expected = Rotation.from_euler("ZYX", [yaw, pitch, roll])
    np.testing.assert_allclose(
        geometry.rotation_from_roll_pitch_yaw(roll, pitch, yaw), expected.as_matrix(), atol=1e-12
    )
    quaternion = geometry.quaternion_wxyz_from_roll_pitch_yaw(roll, pitch, yaw)
    np.testing.assert_allclose(geometry.rotation_from_quaternion_wxyz(quaternion), expected.as_matrix(), atol=1e-12)
