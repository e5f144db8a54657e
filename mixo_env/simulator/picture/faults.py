"""Faults of one camera, at the pixels: what it sees changes; drive, truth, poses and CAN bus never do.

Pure functions of the finished picture, of how it was taken and of the fault, which is drawn from data set, scene and
camera. The two that need more are asked about before: a knocked camera is rendered from another direction, a dropped
picture is not written.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.geometry import FloatArray, rotation_from_roll_pitch_yaw
from mixo_env.simulator.picture.drops import OUTSIDE, Drops, drops_on
from mixo_env.simulator.picture.drops_seen import add_drops
from mixo_env.simulator.picture.glare import add_sun

Image = NDArray[np.uint8]

GAMMA = 2.2
"""Display value -> light: close enough for a gain that is wrong by a factor."""

LOST_SWEEPS = 0.7
"""Share of the pictures between key frames that a dropping camera loses."""

RAIN_MMPH = 25.0
"""Strength of the shower that leaves its drops on a lens."""

DUST = 3.0
"""Light that a dusty lens scatters, over that of a clean one."""

_SUN_UP_RAD, _SUN_ASIDE_RAD = (0.07, 0.24), 0.35  # elevation of the glaring sun, azimuth from the view's middle


@dataclass(frozen=True)
class Shot:
    """How a picture was taken.

    Attributes:
        time_s: of exposure, since the scene began.
        intrinsic: ``(3, 3)`` of the camera.
        sun: ``(3,)`` unit vector towards a glaring sun, camera axes (x right, y down, z forward).
    """

    time_s: float
    intrinsic: FloatArray
    sun: FloatArray


@dataclass(frozen=True)
class PixelFault:
    """One fault of one camera over ``start_s`` <= t < ``end_s`` [s since the scene began].

    Attributes:
        kind: a key of ``KINDS``.
        camera: channel.
        start_s, end_s: when [s].
        seed: of everything random in it.
    """

    kind: str
    camera: str
    start_s: float
    end_s: float
    seed: int = 0

    def __post_init__(self) -> None:
        """Check kind and seconds.

        Raises:
            ConfigurationError: for an unknown kind, or a fault that ends before it starts.
        """
        if self.kind not in KINDS:
            raise ConfigurationError(unknown("camera fault", self.kind, KINDS))
        if not 0.0 <= self.start_s < self.end_s:
            raise ConfigurationError(
                f"a fault must end after it starts, got {self.start_s:g} to {self.end_s:g} s: change the seconds"
            )

    def active(self, time_s: float) -> bool:
        """Whether it is there at a time [s since the scene began]."""
        return self.start_s <= time_s < self.end_s

    def note(self) -> dict[str, Any]:
        """Plain values for ``simulation.json``."""
        return asdict(self)


def spoil(image: Image, last: Image | None, fault: PixelFault, shot: Shot) -> Image:
    """What the camera writes instead of a picture, which itself is left alone.

    Args:
        image: ``(h, w, 3)`` RGB as the sound camera gives it.
        last: written before it, which a frozen camera repeats; ``None`` for the first of a scene.
        fault: of this camera.
        shot: how the picture was taken.
    """
    if not fault.active(shot.time_s):
        return image
    return KINDS[fault.kind](image, last, fault, shot)


def dropped(fault: PixelFault, number: int, time_s: float, is_keyframe: bool) -> bool:
    """Whether picture ``number`` of its camera is missing. Key frames stay: a nuScenes sample has them all."""
    if fault.kind != "dropped" or is_keyframe or not fault.active(time_s):
        return False
    return bool(np.random.default_rng([fault.seed, number]).random() < LOST_SWEEPS)


def knock(fault: PixelFault) -> FloatArray:
    """``(3, 3)`` rotation in ego axes of a knocked mounting: 1 to 2 degrees about a random axis, else identity."""
    if fault.kind != "knocked":
        return np.eye(3)
    rng = np.random.default_rng(fault.seed)
    axis = rng.standard_normal(3)
    roll, pitch, yaw = np.radians(rng.uniform(1.0, 2.0)) * axis / np.linalg.norm(axis)
    return rotation_from_roll_pitch_yaw(roll, pitch, yaw)  # of so small angles: the rotation vector, within 1 %


def _frozen(image: Image, last: Image | None, _fault: PixelFault, _shot: Shot) -> Image:
    return image if last is None else last


def _black(image: Image, _last: Image | None, _fault: PixelFault, _shot: Shot) -> Image:
    return np.zeros_like(image)


def _as_it_is(image: Image, _last: Image | None, _fault: PixelFault, _shot: Shot) -> Image:
    return image


def _dirty(image: Image, _last: Image | None, fault: PixelFault, _shot: Shot) -> Image:
    cover = _dirt(fault.seed, *image.shape[:2])[..., None]
    return _picture(image * (1.0 - cover) + np.array([46.0, 40.0, 33.0]) * cover)


@lru_cache(maxsize=8)
def _dirt(seed: int, height: int, width: int) -> FloatArray:
    """``(h, w)`` share of light that mud on the lens takes: far out of focus, so no blotch has an edge."""
    import cv2

    rng = np.random.default_rng(seed)
    cover = np.zeros((height, width), np.float32)
    for _ in range(int(rng.integers(8, 15))):
        centre = (int(rng.uniform(0, width)), int(rng.uniform(0, height)))
        axes = tuple(max(1, int(width * size)) for size in rng.uniform(0.03, 0.12, 2))
        cv2.ellipse(cover, centre, axes, rng.uniform(0, 180), 0, 360, float(rng.uniform(0.6, 1.0)), -1)
    return np.asarray(cv2.GaussianBlur(cover, (0, 0), 0.015 * width), np.float64)


def _drops(image: Image, _last: Image | None, fault: PixelFault, shot: Shot) -> Image:
    height, width = image.shape[:2]
    drops = _shower(fault, float(shot.intrinsic[0, 0] / width), height / width)
    return add_drops(image, drops, shot.time_s)


@lru_cache(maxsize=8)
def _shower(fault: PixelFault, focal: float, aspect: float) -> Drops:
    """Drops on an outside glass without a wiper, whatever the camera: kinds are compared across cameras."""
    return drops_on(OUTSIDE, (fault.seed, *b"shower", *fault.camera.encode()), fault.end_s, focal, aspect, RAIN_MMPH)


def glaring_sun(fault: PixelFault, view: FloatArray) -> FloatArray:
    """Where the sun of a glare stands.

    Args:
        fault: whose seed places it.
        view: ``(3, 3)`` rotation map <- camera at the moment at which the sun stands in the picture; it stays in the
            map, so the picture turns away from it when the car turns.

    Returns:
        ``(3,)`` unit vector towards it, map frame.
    """
    rng = np.random.default_rng([fault.seed, *b"sun"])
    up = rng.uniform(*_SUN_UP_RAD)
    azimuth = np.arctan2(view[1, 2], view[0, 2]) + rng.uniform(-_SUN_ASIDE_RAD, _SUN_ASIDE_RAD)
    return np.array([np.cos(up) * np.cos(azimuth), np.cos(up) * np.sin(azimuth), np.sin(up)])


def _glare(image: Image, _last: Image | None, _fault: PixelFault, shot: Shot) -> Image:
    return add_sun(image, shot.intrinsic, shot.sun, DUST)


def _exposure(image: Image, _last: Image | None, fault: PixelFault, shot: Shot) -> Image:
    """The gain runs away by a factor of 4 to 8 within 2 s and sticks there: bright in one scene, dark in another."""
    rng = np.random.default_rng(fault.seed)
    stops = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 3.0) * min(1.0, (shot.time_s - fault.start_s) / 2.0)
    levels = 255.0 * ((np.arange(256) / 255.0) ** GAMMA * 2.0**stops) ** (1.0 / GAMMA)
    return _picture(levels)[image]


def _picture(values: FloatArray) -> Image:
    return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)


KINDS: dict[str, Callable[[Image, Image | None, PixelFault, Shot], Image]] = {
    "frozen": _frozen,
    "black": _black,
    "dropped": _as_it_is,
    "dirty": _dirty,
    "drops": _drops,
    "glare": _glare,
    "exposure": _exposure,
    "knocked": _as_it_is,
}
"""Kind -> what it makes of a picture."""

PASSING = ("frozen", "black")
"""Kinds that last for the middle half of a scene: an image stuck from first to last would be no drive at all."""

REDRAWN = ("knocked",)
"""Kinds whose pictures are no function of the sound ones."""
