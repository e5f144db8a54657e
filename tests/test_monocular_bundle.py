"""Three images: the change of the turn from pair to pair, without bias, as a full bundle adjustment would have it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mixo_env.experts.monocular.bundle import turn_change
from mixo_env.experts.monocular.camera import MountedCamera
from mixo_env.experts.monocular.motion import Motion, MotionPrior
from mixo_env.experts.monocular.pair import Pair
from mixo_env.geometry import rotation_from_yaw
from tests.rigid_body import camera_displacement
from tests.test_monocular_motion import AXES, CAMERAS, CENTRE, HEIGHT, RATE_HZ, WIDTH, street

pytestmark = pytest.mark.integration

GAP_S = 1.0 / RATE_HZ


@dataclass(frozen=True)
class Views:
    """Three images of a street, compared two by two, and what is true."""

    last: Pair
    pair: Pair
    motion: Motion
    camera: MountedCamera
    yaw_rad: float


def three_images(
    seed: int, name: str, speed: float, rates: tuple[float, float], noise_px: float = 0.2, wrong: float = 0.0
) -> Views:
    """A car drives two arcs [m/s, rad/s], tilting a little, past points that stand still (but for the wrong ones)."""
    rng = np.random.default_rng(seed)
    mounting, focal, x, y = CAMERAS[name]
    rotation, lever = rotation_from_yaw(math.radians(mounting)) @ AXES, np.array([x, y, 1.5])
    distance, yaws = speed * GAP_S, [rate * GAP_S for rate in rates]
    points = street(rng, 600, focal, rotation)
    planes, depths, tilts = [], [], [(0.0, 0.0)] + [tuple(rng.normal(0.0, 0.0008, 2)) for _ in yaws]
    at, turn = np.zeros(3), np.eye(3)
    for yaw, (pitch, roll) in zip((0.0, *yaws), tilts, strict=True):
        if planes:
            at = at + turn @ [*camera_displacement(yaw, distance, x, y), 0.0]
            turn = turn @ Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_matrix()
        seen = (points - at) @ turn @ rotation
        planes.append(seen[:, :2] / seen[:, 2:])
        depths.append(seen[:, 2])
    pixels = np.array(planes) * focal + CENTRE
    kept = (np.array(depths) > 1.0).all(0) & (pixels > 0).all((0, 2)) & (pixels < [WIDTH, HEIGHT]).all((0, 2))
    first, middle, last = np.array(planes)[:, kept]
    n = len(first)

    def noise() -> np.ndarray:
        return rng.normal(0.0, noise_px / focal, (n, 2))

    mistaken = rng.random(n) < wrong  # along the epipolar lines: the motion of the pair alone cannot tell
    shift = np.where(mistaken[:, None], rng.normal(0.0, 20.0 / focal, (n, 2)), 0.0)
    corner = np.stack([np.arange(n), np.arange(n)], axis=1)
    other = rng.permutation(n)  # the second pair lists the corners in another order
    prior = MotionPrior(distance, 0.1, 0.35 / focal, slip_std=0.004, heave_std=0.004)
    camera = MountedCamera(
        name, (900, 1600), (900, 1600), 0, np.array([focal] * 2), 0.0, np.array(CENTRE), rotation, lever
    )
    motion = Motion(yaws[0], 1e-5, *tilts[1], 0.0, 0.0, 0.002, 0.002, np.ones(n, bool), 0.0)
    return Views(
        Pair(n, 5.0, first, middle + noise(), corner, prior, motion),
        Pair(n, 5.0, middle[other], (last + noise() + shift)[other], corner[other], prior, None),
        motion,
        camera,
        yaws[1],
    )


def measured(views: Views, noise_px: float = 0.35) -> tuple[float, float]:
    """Error of the change of the yaw increment and its standard deviation [rad], expecting no change."""
    noise = noise_px / float(views.camera.focal_px[0])
    vague = replace(views.pair.prior, yaw_mean_rad=views.motion.yaw_rad, yaw_std_rad=0.05, noise=noise)
    change = turn_change(views.last, views.motion, views.pair, views.motion, vague, views.camera)
    assert change is not None
    return change[0] - (views.yaw_rad - views.motion.yaw_rad), change[1]


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize(("speed", "rates"), [(9.0, (0.0, 0.0)), (6.0, (0.3, 0.32)), (2.0, (-0.3, -0.28))])
@pytest.mark.parametrize("wrong", [0.0, 0.2])
def test_the_change_is_seen(camera: str, speed: float, rates: tuple[float, float], wrong: float) -> None:
    found = np.array([measured(three_images(seed, camera, speed, rates, wrong=wrong)) for seed in range(20)])
    assert np.median(np.abs(found[:, 0])) < math.radians(0.012)
    assert np.max(np.abs(found[:, 0])) < math.radians(0.05)
    assert 0.4 < np.std(found[:, 0] / found[:, 1]) < 1.6  # the standard deviation is honest


def test_noise_of_the_depths_does_not_bias_the_change() -> None:
    """Jacobians at the depths of the first pair would bias this by 0.01 deg, always to the same side."""
    found = [measured(three_images(seed, "front_left", 6.0, (0.0, 0.0), noise_px=1.0), 1.0)[0] for seed in range(60)]
    assert abs(np.mean(found)) < 3.0 * np.std(found) / math.sqrt(len(found))


@pytest.mark.parametrize("camera", ["front_left", "back_right"])
def test_a_full_bundle_adjustment_agrees(camera: str) -> None:
    """SciPy, with the depth of every point as an unknown of its own and the positions in the middle image shared."""
    views = three_images(1, camera, 6.0, (0.1, 0.11), noise_px=0.05)
    last, pair, mount = views.last, views.pair, views.camera
    order = np.argsort(pair.corner[:, 0])
    middle, end = pair.first[order], pair.second[order]
    distance = pair.prior.distance_m
    prior_std = np.array([0.003, 0.003, *pair.prior.offset()[1], 0.01])
    noise = 0.05 / float(mount.focal_px[0])

    def pose(motion: np.ndarray, travelled: float) -> tuple[np.ndarray, np.ndarray]:
        x, y = camera_displacement(motion[0], travelled, *mount.position_m[:2])
        turn = Rotation.from_euler("ZYX", motion[:3]).as_matrix()
        c = mount.rotation
        return c.T @ turn @ c, c.T @ np.array([x, y + motion[3], motion[4]])

    first = np.array([views.motion.yaw_rad, views.motion.pitch_rad, views.motion.roll_rad, 0.0, 0.0])
    turn1, step1 = pose(first, distance)

    def residuals(unknown: np.ndarray) -> np.ndarray:
        motion, depth = unknown[:6], unknown[6:]
        seen = np.column_stack([middle, np.ones(len(middle))])
        before = seen @ turn1.T + depth[:, None] * step1
        turn2, step2 = pose(motion, distance * (1.0 + motion[5]))
        after = (seen - depth[:, None] * step2) @ turn2
        errors = [before[:, :2] / before[:, 2:] - last.first, after[:, :2] / after[:, 2:] - end]
        return np.concatenate([np.concatenate(errors).ravel() / noise, motion[1:6] / prior_std])

    start = np.concatenate([[views.motion.yaw_rad, 0.0, 0.0, 0.0, 0.0, 0.0], np.full(len(middle), 0.05)])
    solved = least_squares(residuals, start, x_scale="jac")
    error, std = measured(views)
    # errors across the lines, which the change leaves to the pairs, count here too: agreement to within the noise
    assert solved.x[0] - views.yaw_rad == pytest.approx(error, abs=2.0 * std)


def test_nothing_is_said_without_points_without_way_or_against_what_cars_can_do() -> None:
    views = three_images(2, "front_left", 6.0, (0.1, 0.1))
    last, pair, motion, camera = views.last, views.pair, views.motion, views.camera
    prior = replace(pair.prior, yaw_mean_rad=motion.yaw_rad, yaw_std_rad=0.002)
    assert turn_change(last, motion, pair, motion, prior, camera) is not None
    strange = replace(pair, corner=pair.corner + 100_000)
    assert turn_change(last, motion, strange, motion, prior, camera) is None
    nowhere = replace(motion, inlier=np.zeros_like(motion.inlier))
    assert turn_change(last, motion, pair, nowhere, prior, camera) is None
    assert turn_change(last, motion, pair, motion, replace(prior, distance_m=0.05), camera) is None
    surprised = replace(prior, yaw_mean_rad=motion.yaw_rad + 0.02, yaw_std_rad=0.0002)
    assert turn_change(last, motion, pair, motion, surprised, camera) is None
