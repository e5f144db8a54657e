"""Shadows, lamps, wet roads and textures, each against a hand calculation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from mixo_env.simulator.city.furniture import LAMP_M
from mixo_env.simulator.city.mesh import GROUND, Surface, quad
from mixo_env.simulator.city.shadows import EXTENT_M, FIELD_TEXELS_PER_M, PICTURE_TEXELS_PER_M, Shadows
from mixo_env.simulator.city.textures import Atlas, rgba, spectral_noise
from mixo_env.simulator.city.vehicles import VehicleState
from mixo_env.simulator.city.world import grain_levels, lamp_light
from mixo_env.simulator.picture.lamps import add_glare, light_window
from mixo_env.simulator.picture.render import Renderer
from mixo_env.simulator.picture.sampling import Size, Walk, add_texels, even_cells, level, read_grain
from mixo_env.simulator.picture.sensor import NOISE_SIDE, noise_offsets
from mixo_env.simulator.picture.views import View
from tests.tiny_world import FLAT, SUN, camera, plain_texture, pose, surface, world_of

pytestmark = pytest.mark.rendering

HOUSE = np.array([(0.0, 0.0), (10.0, 0.0), (10.0, 20.0), (0.0, 20.0)])


def test_house_throws_a_shadow_as_long_as_the_sun_says() -> None:
    shadows = Shadows(SUN)  # from +x, so the shadow falls towards -x; 0.75 m per metre of height
    shadows.prism(HOUSE, 8.0, field=True)
    picture, field = shadows.picture(), shadows.field()

    def sunlight(x: float, y: float) -> int:
        return int(picture[int((y + 512.0) * PICTURE_TEXELS_PER_M), int((x + 512.0) * PICTURE_TEXELS_PER_M)])

    def height(x: float, y: float) -> float:
        return float(field[int((y + 512.0) * FIELD_TEXELS_PER_M), int((x + 512.0) * FIELD_TEXELS_PER_M)])

    assert sunlight(-5.0, 10.0) == 0
    assert sunlight(-7.0, 10.0) == 255  # 8 m of height reach 6 m
    assert sunlight(-3.0, 21.0) == 255
    assert sunlight(12.0, 10.0) == 255
    for distance in (1.0, 3.0, 5.0):
        assert height(-distance, 10.0) == pytest.approx(8.0 - distance / 0.75, abs=1.0)
    assert height(-8.0, 10.0) < 0.2
    assert height(14.0, 10.0) == 0.0


def test_even_cells_promise_nothing_wrong() -> None:
    shadows = Shadows(SUN)
    shadows.prism(HOUSE, 8.0)
    picture = shadows.picture()
    cells = even_cells(picture)
    side = len(picture) // len(cells)
    blocks = picture.reshape(len(cells), side, len(cells), side)
    low, high = blocks.min(axis=(1, 3)), blocks.max(axis=(1, 3))
    assert (high[cells == 0] < 3).all()
    assert (low[cells == 255] > 252).all()
    assert {0, 1, 255} == set(np.unique(cells))


def test_ground_in_the_shadow_is_darker_by_the_share_of_the_sun() -> None:
    ground = Surface(0, (16.0, 16.0), detail=0.0, material=GROUND)
    patch = quad(ground, (-100.0, 100.0, 0.0), (200.0, 0.0, 0.0), (0.0, -200.0, 0.0))
    column, row, factor = 16.0 * 200.0, 16.0 * 200.0, 16.0
    patch = (*patch[:3], (column, 0.0, -100.0 * factor, 0.0, -row, 100.0 * factor), *patch[4:])
    shadows = Shadows(SUN)
    shadows.prism(HOUSE, 8.0)
    world = dataclasses.replace(world_of([plain_texture(128, 128, 128)], [patch]), sunlight=shadows.picture())
    weather = dataclasses.replace(FLAT, ambient=0.3, sun=1.0)
    calibration = camera("CAM_FRONT")
    images = []
    for x in (-12.0, -30.0):  # looks from 1.7 m ahead of x towards +x: the shadow lies at -6..0
        at = pose(calibration, x, 10.0, 0.0)
        images.append(Renderer(world, weather).render(calibration, at, at, gain=1.0).image)
    focal, height = calibration.intrinsic[1, 1], 1.511
    row_of = lambda distance: int(calibration.intrinsic[1, 2] + focal * height / distance)  # noqa: E731
    dark, light = images[0][row_of(7.3), 160, 0] / 255.0, images[1][row_of(7.3), 160, 0] / 255.0
    # Light 0.3 against 0.3 + 0.8: the tone curve bends a little.
    assert (dark / light) ** 2 == pytest.approx(0.3 / 1.1, rel=0.12)


def test_lamp_light_is_one_below_and_adds_up() -> None:
    one = lamp_light(np.array([[0.5, 0.5]]))
    assert one[512, 512] == pytest.approx(1.0, abs=0.02)
    squared = 10.0**2 + LAMP_M**2
    window = 1.0 - 10.0**2 / 30.0**2
    assert one[512, 522] == pytest.approx(window * (LAMP_M**2 / squared) ** 1.5, rel=0.02)
    two = lamp_light(np.array([[0.5, 0.5], [20.5, 0.5]]))
    assert np.allclose(two, one + lamp_light(np.array([[20.5, 0.5]])), atol=1e-6)
    assert lamp_light(np.array([[900.0, 0.0]])).max() == 0.0


def test_light_window_is_cut_out_of_the_map_and_holds_the_beams() -> None:
    light = lamp_light(np.array([[100.5, -40.5]]))
    window, corner = light_window(light, EXTENT_M, np.array([90.3, -20.7, 1.5]), ())
    row, column = int(-40.5 - corner[1]), int(100.5 - corner[0])
    assert window[row, column] == light[512 - 41, 512 + 100]
    lit, _ = light_window(light, EXTENT_M, np.array([90.3, -20.7, 1.5]), [VehicleState("suv", 0, 90.0, -20.0, 0.0)])
    ahead, behind = (int(-20.0 - corner[1]), int(100.0 - corner[0])), (int(-20.0 - corner[1]), int(80.0 - corner[0]))
    assert lit[ahead] > window[ahead] + 0.1
    assert lit[behind] == window[behind]
    at_edge, _ = light_window(light, EXTENT_M, np.array([500.0, -500.0, 1.5]), ())
    assert np.isfinite(at_edge).all()


def test_glare_spreads_only_bright_light() -> None:
    radiance = np.full((80, 120), 100 | 100 << 21 | 100 << 42, np.int64)
    before = radiance.copy()
    add_glare(radiance, 1000.0, 0.2)
    assert np.array_equal(radiance, before)
    radiance[38:42, 58:62] = 200_000  # a red lamp
    add_glare(radiance, 1000.0, 0.2)
    red, green = radiance & 0x1FFFFF, radiance >> 21 & 0x1FFFFF
    assert red[40, 68] > red[40, 76] > 100
    assert (green[:30] == 100).all()
    assert (red >= before & 0x1FFFFF).all()


def test_wet_road_mirrors_what_stands_on_it() -> None:
    ground = Surface(0, (16.0, 16.0), detail=0.0, material=GROUND)
    road = quad(ground, (-100.0, 100.0, 0.0), (200.0, 0.0, 0.0), (0.0, -200.0, 0.0))
    wall = quad(surface(1), (20.0, 3.0, 6.0), (0.0, -6.0, 0.0), (0.0, 0.0, -6.0))
    world = world_of([plain_texture(90, 90, 90), plain_texture(255, 0, 0)], [road, wall])
    calibration = camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    images = {}
    for wetness in (0.0, 1.0):
        weather = dataclasses.replace(FLAT, wetness=wetness)
        images[wetness] = Renderer(world, weather).render(calibration, at, at, gain=1.0).image.astype(float)
    row = int(calibration.intrinsic[1, 2] + calibration.intrinsic[1, 1] * 1.511 / (17.0 - 1.7)) + 1
    middle, side = images[1.0][row, 160], images[1.0][row, 10]
    assert middle[0] > 1.4 * middle[1]  # red in front of the wall
    assert side[0] == pytest.approx(side[1], abs=1.0)
    assert np.ptp(images[0.0][row, 160]) <= 1.0
    assert images[1.0][row, 10].mean() < images[0.0][row, 10].mean()  # elsewhere darker than dry


@pytest.mark.parametrize("wetness", [0.5, 1.0])
def test_wet_ground_sends_back_half_the_light(wetness: float) -> None:
    """Under a black sky and at one's feet, where water hardly mirrors: the tone curve is nearly a square root."""
    ground = Surface(0, (16.0, 16.0), detail=0.0, material=GROUND)
    road = quad(ground, (-100.0, 100.0, 0.0), (200.0, 0.0, 0.0), (0.0, -200.0, 0.0))
    world, calibration = world_of([plain_texture(90, 90, 90)], [road]), camera("CAM_FRONT")
    at = pose(calibration, 0.0, 0.0, 0.0)
    dry, wet = (
        Renderer(world, dataclasses.replace(FLAT, wetness=share)).render(calibration, at, at, gain=1.0).image[-10, 160]
        for share in (0.0, wetness)
    )
    assert (wet / dry.astype(float)) ** 2 == pytest.approx(1.0 - 0.5 * wetness, rel=0.08)


def test_spray_hides_part_of_a_wall_behind_a_fast_vehicle() -> None:
    from mixo_env.simulator.picture.rain import add_spray, spray_puffs

    truck, looking_along_x = (
        np.array([[8.6, 2.5, 3.5]]),
        np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]]),
    )
    fast, slow = np.array([[20.0, 0.0, 0.0, 15.0, 0.0]]), np.array([[20.0, 0.0, 0.0, 1.0, 0.0]])
    view = View(looking_along_x, np.array([0.0, 0.0, 1.5]), 100.0, 100.0, 80.0, 45.0, far_m=100.0)
    puffs = spray_puffs(fast, truck, view, 1.0)
    assert (np.diff(puffs[:, 2]) <= 0.0).all()
    assert puffs[:, 2].max() < 20.0
    assert len(spray_puffs(slow, truck, view, 1.0)) == 0
    clouds = np.full((512, 512), 128, np.uint8)
    for depth, touched in ((1.0 / 60.0, True), (1.0 / 3.0, False)):  # behind the puffs, before them
        radiance = np.zeros((90, 160), np.int64)
        add_spray(radiance, np.full((90, 160), depth, np.float32), puffs, view, clouds, 1000)
        assert radiance.any() == touched
        assert radiance.max() <= 1000


@pytest.mark.parametrize("exponent", [0.5, 1.3])
def test_noise_has_the_spectrum_it_is_asked_for(exponent: float) -> None:
    noise = spectral_noise(256, 256, exponent, np.random.default_rng(1))
    assert noise.mean() == pytest.approx(0.0, abs=1e-5)
    assert noise.std() == pytest.approx(1.0, abs=1e-3)
    amplitude = np.abs(np.fft.fft2(noise))
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(256) * 256, np.fft.fftfreq(256) * 256))
    ratio = amplitude[(frequency > 8) & (frequency < 10)].mean() / amplitude[(frequency > 72) & (frequency < 90)].mean()
    assert ratio == pytest.approx(9.0**exponent, rel=0.15)


def test_atlas_keeps_every_reduction() -> None:
    rng = np.random.default_rng(0)
    first = rgba(rng.uniform(0, 255, (8, 32, 3)), rng.uniform(0, 255, (8, 32)))
    second = plain_texture(10, 20, 30, 40)
    atlas = Atlas()
    assert (atlas.add(first), atlas.add(second)) == (0, 1)
    texels, table = atlas.packed()
    start, log_w, log_h = table[0, 0]
    assert (start, log_w, log_h) == (0, 5, 3)
    assert np.array_equal(texels[:256].view(np.uint8).reshape(8, 32, 4), first)
    half = texels[table[0, 1, 0] :][: 16 * 4].view(np.uint8).reshape(4, 16, 4).astype(float)
    assert half == pytest.approx(first.reshape(4, 2, 16, 2, 4).astype(float).mean(axis=(1, 3)), abs=0.51)
    assert texels[table[1, 2, 0]] == 10 | 20 << 8 | 30 << 16 | 40 << 24
    assert (table[1, 4:] == table[1, 3]).all()  # a side of 2 ends the chain


def test_grain_is_interpolated_between_four_texels_and_repeats() -> None:
    tile = np.random.default_rng(2).integers(0, 256, (8, 8), np.uint8)
    tiles, start = grain_levels(tile)
    assert start.tolist() == [0, 64, 80]
    assert np.array_equal(tiles[:64].reshape(8, 8) & 255, tile)
    where, out = np.empty((6, 32), np.int32), np.empty(8, np.float32)
    for u, v, wanted in (
        (3.0, 2.0, tile[2, 3]),
        (3.25, 2.0, 0.75 * tile[2, 3] + 0.25 * tile[2, 4]),
        (7.5, -0.5, 0.25 * (float(tile[7, 7]) + tile[7, 0] + tile[0, 7] + tile[0, 0])),  # around both edges
    ):
        read_grain(tiles, 3, Walk(int(u * 65536), int(v * 65536), 65536, 0), where, out)
        assert out[0] == 256.0 * wanted
        if u == 3.0:
            assert np.array_equal(out, 256.0 * np.roll(tile[2], -3))


def test_texture_is_interpolated_between_four_texels_and_repeats() -> None:
    image = np.random.default_rng(3).integers(0, 256, (4, 8, 4), np.uint8)
    texels = image.view(np.uint32).ravel()
    where = np.empty((6, 32), np.int32)
    for u, v in ((3.25, 2.5), (7.5, 3.75), (-0.75, -1.0), (4000.5, 1.25)):
        walk = Walk(int(u * 65536), int(v * 65536), 3 * 65536 // 2, -65536)
        even, odd = np.ones(8, np.uint32), np.zeros(8, np.uint32)
        add_texels(texels, Size(3, 7, 3), walk, where, np.uint32(0xFFFFFFFF), even, odd)
        fresh_even, fresh_odd = np.full((2, 8), 77, np.uint32)  # what was there before is dropped
        add_texels(texels, Size(3, 7, 3), walk, where, np.uint32(0), fresh_even, fresh_odd)
        assert np.array_equal(fresh_even + 1, even)
        assert np.array_equal(fresh_odd, odd)
        for i in range(8):
            x, y = u + 1.5 * i, v - i
            left, top = int(np.floor(x)), int(np.floor(y))
            a, b = x - left, y - top
            four = image[np.ix_([top % 4, (top + 1) % 4], [left % 8, (left + 1) % 8])].astype(float)
            wanted = np.einsum("ijc,i,j->c", four, [1.0 - b, b], [1.0 - a, a])
            got = [int(even[i] & 0xFFFF) - 1, int(odd[i] & 0xFFFF), int(even[i] >> 16), int(odd[i] >> 16)]
            assert got == pytest.approx(wanted.tolist(), abs=2.0)


def test_the_exponent_chooses_the_reduction_that_the_comparisons_choose():
    steps = np.array([1.41, 2.83, 5.66, 11.3, 22.6, 45.2, 90.5, 181.0, 362.0, 724.0])
    ratios = [0.0, 1e-300, 0.7, 1.0, 2.0, 4.0, 1024.0, 1e300, np.inf, np.nan]
    ratios += [*steps, *np.nextafter(steps, 0.0), *np.nextafter(steps, np.inf)]
    for ratio in ratios:
        assert level(ratio) == np.sum(ratio > steps), ratio


@pytest.mark.parametrize("seed", [0, 5, 2**63 + 11])
def test_places_in_the_table_of_noise_are_numbers_of_splitmix(seed: int) -> None:
    """Against the published generator in Python's own whole numbers."""
    whole, state, expected = 2**64 - 1, seed, []
    for _ in range(7):
        state = (state + 0x9E3779B97F4A7C15) & whole
        word = ((state ^ state >> 30) * 0xBF58476D1CE4E5B9) & whole
        word = ((word ^ word >> 27) * 0x94D049BB133111EB) & whole
        word ^= word >> 31
        expected.append([word % 2**32 % NOISE_SIDE, (word >> 32) % NOISE_SIDE])
    np.testing.assert_array_equal(noise_offsets(seed, 7), expected)
