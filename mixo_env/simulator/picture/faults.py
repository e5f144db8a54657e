"""Faults of one camera, at the pixels: what it sees changes; drive, truth, poses and CAN bus never do.

Pure functions of the finished picture and of the fault, which is drawn from data set, scene and camera. The two that
need more are asked about before: a knocked camera is rendered from another direction, a dropped picture is not written.
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

Image = NDArray[np.uint8]

GAMMA = 2.2
"""Display value -> light: close enough for a gain that is wrong by a factor."""

LOST_SWEEPS = 0.7
"""Share of the pictures between key frames that a dropping camera loses."""


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


def spoil(image: Image, last: Image | None, fault: PixelFault, time_s: float) -> Image:
    """What the camera writes instead of a picture, which itself is left alone.

    Args:
        image: ``(h, w, 3)`` RGB as the sound camera gives it.
        last: written before it, which a frozen camera repeats; ``None`` for the first of a scene.
        fault: of this camera.
        time_s: of exposure, since the scene began.
    """
    if not fault.active(time_s):
        return image
    return KINDS[fault.kind](image, last, fault, time_s)


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


def _frozen(image: Image, last: Image | None, _fault: PixelFault, _time_s: float) -> Image:
    return image if last is None else last


def _black(image: Image, _last: Image | None, _fault: PixelFault, _time_s: float) -> Image:
    return np.zeros_like(image)


def _as_it_is(image: Image, _last: Image | None, _fault: PixelFault, _time_s: float) -> Image:
    return image


def _dirty(image: Image, _last: Image | None, fault: PixelFault, _time_s: float) -> Image:
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


def _drops(image: Image, _last: Image | None, fault: PixelFault, _time_s: float) -> Image:
    import cv2

    height, width = image.shape[:2]
    cover, map_x, map_y = _lenses(fault.seed, height, width)
    seen = cv2.remap(image, map_x, map_y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
    seen = cv2.GaussianBlur(seen, (0, 0), 0.006 * width)
    return _picture(image * (1.0 - cover[..., None]) + seen * cover[..., None])


@lru_cache(maxsize=8)
def _lenses(seed: int, height: int, width: int) -> tuple[FloatArray, NDArray[np.float32], NDArray[np.float32]]:
    """``(h, w)`` cover by drops, and the column and row seen through them: a drop shows the wide view upside down."""
    import cv2

    rng = np.random.default_rng(seed)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    map_x, map_y, cover = columns.copy(), rows.copy(), np.zeros((height, width), np.float32)
    for _ in range(int(rng.integers(15, 30))):
        x, y, radius = rng.uniform(0, width), rng.uniform(0, height), width * rng.uniform(0.015, 0.06)
        inside = (columns - x) ** 2 + (rows - y) ** 2 < radius**2
        map_x[inside] = x - 4.0 * (columns[inside] - x)
        map_y[inside] = y - 4.0 * (rows[inside] - y)
        cover[inside] = 1.0
    return np.asarray(cv2.GaussianBlur(cover, (0, 0), 0.005 * width), np.float64), map_x, map_y


def _glare(image: Image, _last: Image | None, fault: PixelFault, _time_s: float) -> Image:
    return _picture(image + _veil(fault.seed, *image.shape[:2])[..., None] * np.array([1.0, 0.96, 0.88]))


@lru_cache(maxsize=8)
def _veil(seed: int, height: int, width: int) -> FloatArray:
    """``(h, w)`` stray light [display values]: a saturated disc, a glow around it and a veil over everything."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0.2, 0.8) * width, rng.uniform(0.1, 0.45) * height
    rows, columns = np.mgrid[:height, :width]
    distance = np.hypot(columns - x, rows - y) / width
    return 35.0 + 150.0 * np.exp(-distance / 0.22) + 255.0 * (distance < rng.uniform(0.05, 0.09))


def _exposure(image: Image, _last: Image | None, fault: PixelFault, time_s: float) -> Image:
    """The gain runs away by a factor of 4 to 8 within 2 s and sticks there: bright in one scene, dark in another."""
    rng = np.random.default_rng(fault.seed)
    stops = rng.choice([-1.0, 1.0]) * rng.uniform(2.0, 3.0) * min(1.0, (time_s - fault.start_s) / 2.0)
    levels = 255.0 * ((np.arange(256) / 255.0) ** GAMMA * 2.0**stops) ** (1.0 / GAMMA)
    return _picture(levels)[image]


def _picture(values: FloatArray) -> Image:
    return np.rint(np.clip(values, 0.0, 255.0)).astype(np.uint8)


KINDS: dict[str, Callable[[Image, Image | None, PixelFault, float], Image]] = {
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
