"""Rotations the scores are built on: products, inverses, conversions and angles at their extremes."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.geometry import (
    angle_between_quaternions_rad,
    conjugate_quaternion_wxyz,
    multiply_quaternions_wxyz,
    quaternion_wxyz_from_rotation,
    rotation_from_quaternion_wxyz,
)
from tests.trajectories import literal_angle_deg, random_rotation

IDENTITY = np.array([1.0, 0.0, 0.0, 0.0])


def test_products_and_inverses_are_those_of_the_matrices():
    rng = np.random.default_rng(0)
    a, b = np.stack([random_rotation(rng) for _ in range(20)]), np.stack([random_rotation(rng) for _ in range(20)])
    p, q = quaternion_wxyz_from_rotation(a), quaternion_wxyz_from_rotation(b)
    np.testing.assert_allclose(rotation_from_quaternion_wxyz(multiply_quaternions_wxyz(p, q)), a @ b, atol=1e-12)
    inverse = rotation_from_quaternion_wxyz(conjugate_quaternion_wxyz(p))
    np.testing.assert_allclose(inverse, a.transpose(0, 2, 1), atol=1e-12)
    angles = np.rad2deg(angle_between_quaternions_rad(p, -q))
    expected = [literal_angle_deg(x.T @ y) for x, y in zip(a, b, strict=True)]
    np.testing.assert_allclose(angles, expected, atol=1e-9)


def test_a_stack_of_matrices_converts_like_each_alone():
    rng = np.random.default_rng(1)
    matrices = np.stack([random_rotation(rng) for _ in range(6)]).reshape(2, 3, 3, 3)
    stacked = quaternion_wxyz_from_rotation(matrices)
    assert stacked.shape == (2, 3, 4)
    np.testing.assert_allclose(stacked[1, 2], quaternion_wxyz_from_rotation(matrices[1, 2]))


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-8, 1e-3, 1.0, np.pi / 2, 3.0, np.pi - 1e-9, np.pi])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_angles_keep_their_digits_from_nothing_to_half_a_turn(angle, sign):
    turned = sign * np.array([np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0])
    assert angle_between_quaternions_rad(IDENTITY, turned) == pytest.approx(angle, rel=1e-12, abs=1e-15)


def test_half_turns_convert():
    for axis in np.eye(3):
        half_turn = 2.0 * np.outer(axis, axis) - np.eye(3)
        np.testing.assert_allclose(np.abs(quaternion_wxyz_from_rotation(half_turn)), [0.0, *axis], atol=1e-12)
