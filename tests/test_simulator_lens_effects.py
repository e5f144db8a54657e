"""Drops and glare on finished pictures and as populations: what stays, what moves, and how much of it there is."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.city.mesh import quad
from mixo_env.simulator.city.world import World
from mixo_env.simulator.picture.developed import image_of, radiance_of
from mixo_env.simulator.picture.drops import OUTSIDE, WINDSCREEN, Drops, drops_on, glass_of
from mixo_env.simulator.picture.drops_seen import add_drops, drops_veil
from mixo_env.simulator.picture.exposure import EXPOSURE_S, adapted_gain
from mixo_env.simulator.picture.glare import SCATTER, add_sun, lens_glare, sun_share
from mixo_env.simulator.picture.render import Renderer
from mixo_env.simulator.picture.weather import weather_named
from tests.tiny_world import camera, plain_texture, pose, surface, world_of

pytestmark = pytest.mark.rendering

FOCAL = 0.79


def _one(x: float, y: float, radius: float, pupil: float) -> Drops:
    one = np.ones(1)
    return Drops(x * one, y * one, radius * one, 0.0 * one, 9.0 * one, np.inf * one, 0.1, pupil)


def _toward(u: float, v: float, intrinsic: np.ndarray) -> np.ndarray:
    ray = np.linalg.solve(intrinsic, (u, v, 1.0))
    return ray / np.linalg.norm(ray)


def test_finished_pictures_survive_the_way_to_light_and_back() -> None:
    image = np.arange(256, dtype=np.uint8).reshape(1, 256, 1).repeat(3, axis=2)
    assert (image_of(radiance_of(image)) == image).all()


def test_equal_names_give_equal_drops_and_other_cameras_others() -> None:
    first, again, other = (drops_on(OUTSIDE, seed, 20.0, FOCAL) for seed in ((1, 2), (1, 2), (1, 3)))
    assert np.array_equal(first.x, again.x)
    assert np.array_equal(first.gone_s, again.gone_s)
    assert len(first.x) != len(other.x) or not np.array_equal(first.x, other.x)


def test_a_drop_stays_at_its_pixels_between_pictures() -> None:
    drops = drops_on(OUTSIDE, (5,), 20.0, FOCAL)
    now, later = drops.at(8.0), drops.at(8.1)
    kept = sum((later == drop).all(axis=1).any() for drop in now)
    assert kept >= 0.9 * len(now) > 3


def test_only_the_windscreen_is_wiped_and_then_it_is_clear() -> None:
    assert glass_of("CAM_FRONT") == WINDSCREEN
    assert glass_of("CAM_BACK") == glass_of("CAM_FRONT_LEFT") == OUTSIDE
    assert OUTSIDE.wiped_every_s == 0.0
    drops = drops_on(WINDSCREEN, (5,), 20.0, FOCAL)
    times = np.arange(0.0, 19.99, 0.01)
    counts = np.array([len(drops.at(time)) for time in times])
    strokes = times[1:][(counts[1:] <= 1) & (counts[:-1] > 10)]
    assert np.diff(strokes) == pytest.approx(WINDSCREEN.wiped_every_s, abs=0.03)
    assert len(strokes) >= 15


def test_number_of_drops_is_what_marshall_and_palmer_say() -> None:
    # 4 mm/h: 4.1 * 4^-0.21 = 3.064 per mm, so 8000 / 3.064 * exp(-1.532) = 564 drops above half a millimetre in a m^3.
    still = OUTSIDE.__class__(distance_mm=15.0, wind_mps=1.5, lives_s=1e-3)  # gone before any other can meet them
    per_mm = FOCAL / 15.0
    margin = per_mm * (1.53 + 2.0)
    area_m2 = 1e-6 * (1 + 2 * margin) * (0.5625 + 2 * margin) / per_mm**2
    drops = drops_on(still, (1,), 5000.0, FOCAL)
    assert len(drops.x) == pytest.approx(564.0 * 1.5 * area_m2 * 5000.0, rel=0.05)


def test_no_rain_no_drops_and_nonsense_is_refused() -> None:
    assert len(drops_on(OUTSIDE, (1,), 20.0, FOCAL, rain_mmph=0.0).x) == 0
    with pytest.raises(ConfigurationError, match="mm/h"):
        drops_on(OUTSIDE, (1,), 20.0, FOCAL, rain_mmph=-1.0)


def test_heavy_drops_run_down_and_swallowed_ones_swell_the_other() -> None:
    drops = drops_on(OUTSIDE, (3,), 300.0, FOCAL)
    runs = np.flatnonzero(np.isfinite(drops.run_s))
    assert len(runs) > 0
    heavy = FOCAL / OUTSIDE.distance_mm * 2.0
    assert (drops.radius[runs] > heavy).all()
    assert (np.delete(drops.radius, runs) <= heavy).all()
    moving = runs[drops.gone_s[runs] > drops.run_s[runs] + 0.05]
    for n in moving[:3]:
        y = [drops.at(float(drops.run_s[n]) + later)[:, 1].max() for later in (0.0, 0.04)]
        assert y[1] > y[0] or len(moving) > 1


@pytest.mark.parametrize("size", [1.0, 0.2])
def test_a_drop_larger_than_the_pupil_is_opaque_in_its_middle_and_ends_at_both_radii(size: float) -> None:
    veil = drops_veil(_one(0.5, 0.28125, 0.1 * size, 0.05 * size), 1.0, 450, 800)

    def share(aside_px: float) -> int:
        return int(veil.share[225 >> veil.shift, int(400 + size * aside_px) >> veil.shift])

    assert share(0.0) == 255
    assert share(34.0) >= 254, "inside R - P = 40 pixels"
    assert 0 < share(80.0) < 255, "at R half the pupil is covered"
    assert share(125.0) == 0, "beyond R + P = 120 pixels"


def test_a_drop_smaller_than_the_pupil_only_dims_by_the_ratio_of_the_areas() -> None:
    share = drops_veil(_one(0.5, 0.28125, 0.02, 0.08), 1.0, 450, 800).share
    assert share.max() == pytest.approx(255.0 / 16.0, abs=1.0)


def test_a_drop_shows_the_picture_upside_down() -> None:
    image = np.full((450, 800, 3), 40, np.uint8)
    image[:225] = 220  # sky above
    out = add_drops(image, _one(0.5, 0.28125, 0.12, 0.02), 1.0)
    assert out[225 - 60, 400, 0] < 60
    assert out[225 + 60, 400, 0] > 200
    assert (out[:, :200] == image[:, :200]).all()


@pytest.mark.parametrize("at", [(200.0, 60.0), (600.0, 300.0)])
def test_glare_is_brightest_where_the_sun_stands(at: tuple[float, float]) -> None:
    k = camera("CAM_FRONT", 0.5).intrinsic
    light = lens_glare(_toward(*at, k), k, 450, 800, 1.0)
    row, column = np.unravel_index(int(light.argmax()), light.shape)
    assert (8 * column + 4, 8 * row + 4) == pytest.approx(at, abs=8.0)


def test_glare_falls_with_the_square_of_the_angle_and_adds_up_to_what_is_scattered() -> None:
    k = np.array([[633.0, 0.0, 399.5], [0.0, 633.0, 223.5], [0.0, 0.0, 1.0]])
    light = lens_glare(np.array([0.0, 0.0, 1.0]), k, 448, 800, 1.0)
    ten, twenty = (light[28, int((399.5 + 633.0 * np.tan(np.radians(a))) / 8)] for a in (10.0, 20.0))
    assert ten / twenty == pytest.approx(4.0, rel=0.12)
    # Whole hemisphere, by the formula's own integral; here only what the picture holds.
    angle = np.radians(np.arange(0.005, 90.0, 0.01))
    per_sr = SCATTER / (np.pi * np.log(1.0 + 90.0**2))
    total = np.sum(per_sr / (angle**2 + np.radians(1.0) ** 2) * 2.0 * np.pi * angle) * np.radians(0.01)
    assert total == pytest.approx(SCATTER, rel=1e-3)


def test_the_hood_hides_a_sun_far_beyond_the_edge() -> None:
    k = camera("CAM_FRONT", 0.5).intrinsic
    assert sun_share(_toward(400.0, 20.0, k), k, 450, 800) == pytest.approx(1.0, abs=1e-6)
    shares = [sun_share(_toward(400.0, v, k), k, 450, 800) for v in (-20.0, -80.0, -400.0)]
    assert 1.0 > shares[0] > shares[1] > shares[2] == 0.0
    assert sun_share(np.array([0.0, 0.0, -1.0]), k, 450, 800) == 0.0


def test_glare_on_a_finished_picture_is_a_veil_that_grows_with_its_strength() -> None:
    k = camera("CAM_FRONT", 0.5).intrinsic
    image = np.random.default_rng(0).integers(30, 120, (450, 800, 3), dtype=np.uint8)
    sun = _toward(650.0, 40.0, k)
    some, more = (add_sun(image, k, sun, strength) for strength in (1.0, 3.0))
    assert (add_sun(image, k, sun, 0.0) == image).all()
    assert (some >= image).all()
    assert (more >= some).all()
    assert (more[30:50, 640:660] == 255).all(), "clipped around the sun"
    far = np.s_[300:, :200]
    assert more[far].std() < some[far].std() < image[far].std()
    with pytest.raises(ConfigurationError, match="strength"):
        add_sun(image, k, sun, -1.0)


def _open_world() -> World:
    return world_of(
        [plain_texture(120.0, 120.0, 120.0)], [quad(surface(0), (0.0, 0.0, -50.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0))]
    )


def _sky(yaw_rad: float, **changes: Any) -> np.ndarray:
    """Grey levels of an empty sky, looking along ``yaw_rad``; the sun stands in +x, 12 degrees high."""
    low = np.radians(12.0)
    world = replace(_open_world(), sun=np.array([np.cos(low), 0.0, np.sin(low)]), **changes)
    renderer = Renderer(
        world, replace(weather_named("low sun"), haze=(0.1, 0.1, 0.1), zenith=(0.1, 0.1, 0.1), clouds=0.0)
    )
    calibration = camera("CAM_FRONT", 0.2)
    at = pose(calibration, 0.0, 0.0, yaw_rad)
    return renderer.render(calibration, at, at, gain=1.0).image.mean(axis=2)


@pytest.mark.parametrize("yaw_deg", [-15.0, 0.0, 15.0])
def test_the_picture_clips_where_the_sun_stands(yaw_deg: float) -> None:
    image = _sky(np.radians(yaw_deg))
    calibration = camera("CAM_FRONT", 0.2)
    assert image.max() >= 254.0
    row, column = (places.mean() for places in np.nonzero(image >= image.max() - 1.0))
    # The car turned left by yaw sees the sun to its right, and it stands above the horizon.
    focal = calibration.intrinsic[0, 0]
    assert column == pytest.approx(calibration.intrinsic[0, 2] + focal * np.tan(np.radians(yaw_deg)), abs=25.0)
    assert row < calibration.intrinsic[1, 2] - 0.5 * focal * np.tan(np.radians(12.0))


def test_no_glare_with_the_sun_behind_and_less_behind_a_house() -> None:
    away = _sky(np.pi)
    assert away.max() < 150.0
    shaded = _sky(0.0, shadow_height=np.full((2048, 2048), 30.0, np.float32))
    free = _sky(0.0)
    assert (free >= shaded - 2.0).all()
    assert free.mean() > shaded.mean() + 1.0


def test_exposure_follows_its_time_constant() -> None:
    """After one time constant 1/e of the way is left, whatever the rhythm of the images."""
    assert adapted_gain(1.0, 3.0, EXPOSURE_S) == pytest.approx(3.0 - 2.0 / np.e)
    gain = 1.0
    for _ in range(6):
        gain = adapted_gain(gain, 3.0, EXPOSURE_S / 6.0)
    assert gain == pytest.approx(3.0 - 2.0 / np.e)
    assert adapted_gain(2.0, 2.0, 1.0) == 2.0
