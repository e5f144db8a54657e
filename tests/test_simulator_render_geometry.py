"""Where things appear in the picture, checked against rays cast independently."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.city.mesh import CUT_OUT, TWO_SIDED, Patch, quad
from mixo_env.simulator.city.textures import rgba
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.picture.exposure import during_exposure
from mixo_env.simulator.picture.fleet import body_motions, moving_states
from mixo_env.simulator.picture.render import CameraPose, Renderer
from tests.tiny_world import CHANNELS, FLAT, camera, cast, plain_texture, pose, surface, world_of

pytestmark = pytest.mark.rendering

WHITE, RED, BLUE = plain_texture(255, 255, 255), plain_texture(255, 0, 0), plain_texture(0, 0, 255)


def wall_before(
    at: CameraPose, distance: float, width: float, height: float, slant: float, texture: int = 0, shape: int = 0
) -> Patch:
    """An upright wall with its middle ``distance`` metres down the optical axis, turned about the vertical."""
    forward = at.rotation_map_from_camera[:, 2]
    heading = np.arctan2(forward[1], forward[0]) - 0.5 * np.pi + slant
    along = width * np.array([np.cos(heading), np.sin(heading), 0.0])
    down = np.array([0.0, 0.0, -height])
    origin = at.position_m + distance * forward - 0.5 * along - 0.5 * down
    return quad(surface(texture, shape), tuple(origin.tolist()), tuple(along.tolist()), tuple(down.tolist()))


def picture(world, calibration, at, weather=FLAT):
    return Renderer(world, weather).render(calibration, at, at, gain=1.0).image


@pytest.mark.parametrize("channel", CHANNELS)
@pytest.mark.parametrize("slant", [0.0, 0.9])
def test_wall_covers_exactly_the_pixels_whose_rays_meet_it(channel: str, slant: float) -> None:
    calibration = camera(channel)
    at = pose(calibration, 12.0, -7.0, 0.4)
    wall = wall_before(at, 9.0, 5.0, 3.0, slant)
    s, t, depth = cast(calibration, at, wall)
    wanted = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & np.isfinite(depth)
    seen = picture(world_of([WHITE], [wall]), calibration, at).min(axis=-1) > 100
    assert 1000 < wanted.sum() < 0.6 * wanted.size
    assert np.array_equal(seen, wanted)


def test_wall_that_reaches_behind_the_camera_is_cut_correctly() -> None:
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    wall = quad(surface(0), (-20.0, 3.0, 4.0), (60.0, 0.0, 0.0), (0.0, 0.0, -4.0))  # along the left side of the road
    s, t, depth = cast(calibration, at, wall)
    wanted = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & np.isfinite(depth)
    assert np.array_equal(picture(world_of([WHITE], [wall]), calibration, at).min(axis=-1) > 80, wanted)


def test_back_of_a_patch_is_seen_only_if_two_sided() -> None:
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    for shape, visible in ((0, False), (TWO_SIDED, True)):
        wall = wall_before(at, 9.0, 5.0, 3.0, np.pi, shape=shape)
        assert picture(world_of([WHITE], [wall]), calibration, at).any() == visible


def test_nearer_patch_hides_the_farther_in_either_order() -> None:
    calibration = camera("CAM_FRONT_LEFT")
    at = pose(calibration, 3.0, 5.0, -2.0)
    # The two walls cut through each other, so both orders occur in one picture.
    first, second = wall_before(at, 9.0, 6.0, 3.0, 0.6, 0), wall_before(at, 9.0, 6.0, 2.0, -0.6, 1)
    nearest = np.full((calibration.height, calibration.width), np.inf)
    owner = np.full(nearest.shape, -1)
    for number, wall in enumerate((first, second)):
        s, t, depth = cast(calibration, at, wall)
        inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1) & (depth < nearest)
        nearest[inside], owner[inside] = depth[inside], number
    for patches in ([first, second], [second, first]):
        image = picture(world_of([RED, BLUE], patches), calibration, at)
        seen = np.where(image[..., 0] > 100, 0, np.where(image[..., 2] > 100, 1, -1))
        assert (seen != owner).sum() <= 3  # rounding of 1/z where the walls meet
    assert (owner == 0).sum() > 1000
    assert (owner == 1).sum() > 1000


def test_holes_of_a_cut_out_show_what_is_behind() -> None:
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    leaf = plain_texture(255, 0, 0, 255)
    leaf[:, 8:, 3] = 0  # the right half of every metre is a hole
    front, back = wall_before(at, 4.0, 1.0, 1.0, 0.0, 0, CUT_OUT | TWO_SIDED), wall_before(at, 9.0, 8.0, 5.0, 0.0, 1)
    s, t, _ = cast(calibration, at, front)
    inside = (s > 0) & (s < 1) & (t > 0) & (t < 1)
    image = picture(world_of([leaf, BLUE], [front, back]), calibration, at)
    assert (image[inside & (s < 0.48)][:, 0] > 100).all()
    assert (image[inside & (s > 0.52)][:, 2] > 100).all()
    assert (image[inside & (s > 0.52)][:, 0] < 20).all()


@pytest.mark.parametrize("channel", ["CAM_FRONT", "CAM_BACK_RIGHT"])
def test_texture_lies_on_the_surface_in_perspective(channel: str) -> None:
    calibration = camera(channel, 0.3)
    at = pose(calibration, 1.0, 2.0, 0.7)
    ramp = np.zeros((64, 64, 3), np.float32)
    ramp[..., 0] = np.linspace(20, 240, 64)[None, :]
    ramp[..., 1] = np.linspace(240, 20, 64)[:, None]
    wall = wall_before(at, 6.0, 4.0, 4.0, 1.0)
    s, t, _ = cast(calibration, at, wall)
    image = picture(world_of([rgba(ramp)], [wall]), calibration, at)
    clear = (s > 0.05) & (s < 0.95) & (t > 0.05) & (t < 0.95)
    # Which of two channels is brighter does not depend on exposure, vignette or tone curve.
    red = np.interp(s[clear] * 64 - 0.5, np.arange(64), ramp[0, :, 0])
    green = np.interp(t[clear] * 64 - 0.5, np.arange(64), ramp[:, 0, 1])
    seen = image[clear].astype(float)
    decided = np.abs(red - green) > 6.0
    assert ((seen[:, 0] > seen[:, 1]) == (red > green))[decided].all()
    assert np.corrcoef(np.log(seen[:, 0] / seen[:, 1]), np.log(red / green))[0, 1] > 0.999


def test_nothing_beyond_the_far_limit() -> None:
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    assert picture(world_of([WHITE], [wall_before(at, 230.0, 60.0, 40.0, 0.0)]), calibration, at).any()
    assert not picture(world_of([WHITE], [wall_before(at, 250.0, 60.0, 40.0, 0.0)]), calibration, at).any()


def bar(x: float, y: float, width: float) -> Patch:
    """A thin upright white bar that faces a car looking along +x."""
    return quad(surface(0), (x, y + 0.5 * width, 4.0), (0.0, -width, 0.0), (0.0, 0.0, -4.0))


def test_camera_motion_smears_along_the_image_motion_and_is_centred() -> None:
    calibration = camera("CAM_FRONT", 0.4)
    world = world_of([WHITE], [bar(10.0, 0.0, 0.4)])
    still = pose(calibration, 0.0, 0.0, 0.0)
    shift = 0.2  # metres to the left during the exposure
    start, end = pose(calibration, 0.0, -0.5 * shift, 0.0), pose(calibration, 0.0, 0.5 * shift, 0.0)
    sharp = Renderer(world, FLAT).render(calibration, still, still, gain=1.0).image[..., 0].astype(float)
    smeared = Renderer(world, FLAT).render(calibration, start, end, gain=1.0).image[..., 0].astype(float)
    row = calibration.height // 2
    light_sharp, light_smeared = sharp[row] ** 2, smeared[row] ** 2
    columns = np.arange(calibration.width)
    moved = shift * calibration.intrinsic[0, 0] / (10.0 - 1.7)
    centre = (columns * light_sharp).sum() / light_sharp.sum()
    assert (columns * light_smeared).sum() / light_smeared.sum() == pytest.approx(centre, abs=0.6)
    # Convolution with a box of width w adds w^2 / 12 to the variance.
    spread = ((columns - centre) ** 2 * light_smeared).sum() / light_smeared.sum()
    spread -= ((columns - centre) ** 2 * light_sharp).sum() / light_sharp.sum()
    assert np.sqrt(12.0 * spread) == pytest.approx(moved, rel=0.25)
    assert (smeared[row] > 5).sum() > (sharp[row] > 5).sum() + 0.6 * moved
    rows_sharp, rows_smeared = (sharp.max(axis=1) > 5).sum(), (smeared.max(axis=1) > 5).sum()
    assert abs(int(rows_sharp) - int(rows_smeared)) <= 1


def test_exposure_follows_with_a_lag_and_converges() -> None:
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    weather = dataclasses.replace(FLAT, exposure_target=0.4, largest_gain=10.0)
    renderer = Renderer(world_of([WHITE], [wall_before(at, 6.0, 8.0, 8.0, 0.0)]), weather)
    first = renderer.render(calibration, at, at)
    assert renderer.render(calibration, at, at, gain=first.gain).gain == pytest.approx(first.gain)
    gain, means = 4.0 * first.gain, []
    for _ in range(20):
        shot = renderer.render(calibration, at, at, gain=gain)
        gain, means = shot.gain, [*means, float(shot.image.mean())]
    assert means == sorted(means, reverse=True)
    assert gain == pytest.approx(first.gain, rel=0.02)


def test_noise_has_the_stated_variance_and_depends_on_the_seed() -> None:
    calibration = camera("CAM_FRONT", 0.3)
    at = pose(calibration, 0.0, 0.0, 0.0)
    world = world_of([plain_texture(128, 128, 128)], [wall_before(at, 5.0, 30.0, 30.0, 0.0)])
    noisy = dataclasses.replace(FLAT, shot_noise=4e-4, read_noise=1e-4)
    clean = Renderer(world, FLAT).render(calibration, at, at, gain=1.0).image.astype(float)
    one = Renderer(world, noisy).render(calibration, at, at, gain=1.0, noise_seed=1).image
    same = Renderer(world, noisy).render(calibration, at, at, gain=1.0, noise_seed=1).image
    other = Renderer(world, noisy).render(calibration, at, at, gain=1.0, noise_seed=2).image
    assert np.array_equal(one, same)
    assert not np.array_equal(one, other)
    middle = np.s_[60:80, 100:200]
    exposed = (clean[middle] / 255.0) ** 2  # the tone curve is close to linear for grey
    wanted = 255.0 * np.sqrt(4e-4 * exposed + 1e-4) / (2.0 * np.sqrt(exposed))
    assert (one[middle] - clean[middle]).std() == pytest.approx(wanted.mean(), rel=0.15)
    assert abs((one[middle] - clean[middle]).mean()) < 0.5


def test_picture_wider_than_the_noise_table_is_refused() -> None:
    calibration = camera("CAM_FRONT", 1.5)
    at = pose(calibration, 0.0, 0.0, 0.0)
    with pytest.raises(ConfigurationError, match="at most 1600 pixels wide, got 2400"):
        picture(world_of([WHITE], [bar(10.0, 0.0, 1.0)]), calibration, at)


@pytest.mark.parametrize("turn_rad", [0.0, 1e-9, 0.004, 2.0])
def test_the_second_half_of_the_exposure_moves_what_stands_and_what_drives(turn_rad: float) -> None:
    """Against OpenCV's Rodrigues formula and poses multiplied one by one."""
    rng = np.random.default_rng(3)
    start = np.asarray(cv2.Rodrigues(rng.normal(size=3))[0], np.float64)
    turn = turn_rad * np.array([0.36, -0.48, 0.8])
    end, half = (start @ np.asarray(cv2.Rodrigues(share * turn)[0], np.float64) for share in (1.0, 0.5))
    start_m, end_m = rng.normal(size=(2, 3))
    vehicle = VehicleState("suv", 1, 10.0, -4.0, 0.6, 12.0, 0.5)
    states = moving_states([vehicle])
    rotation, position, motions = during_exposure(start, start_m, end, end_m, states, 0.01)
    assert rotation == pytest.approx(half.T, abs=1e-12)
    assert position == pytest.approx(0.5 * (start_m + end_m))
    for motion, body_turn, body_shift in zip(motions, *body_motions(states, 0.01), strict=True):
        point = rng.normal(size=3)  # in the camera at the middle
        moved = body_turn @ (half @ point + position) + body_shift
        assert motion[:9].reshape(3, 3) @ point + motion[9:] == pytest.approx(end.T @ (moved - end_m), abs=1e-12)
