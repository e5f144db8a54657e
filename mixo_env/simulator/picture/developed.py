"""Finished pictures as light again, for effects of lens and glass that come after the picture was taken.

The renderer works on packed radiance (three fields of 21 bits, red lowest). A finished picture gives it back as far as
a picture can: bytes are square roots of light, and what was clipped stays clipped.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_FIELD = (1 << 21) - 1
_UNIT = 2  # radiance per squared byte: 255 becomes about 2^17, half of what a field holds at most


def radiance_of(image: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Packed radiance ``(h, w)`` of a picture ``(h, w, 3)``; white is ``2 * 255**2``."""
    light = _UNIT * image.astype(np.int64) ** 2
    return light[..., 0] | light[..., 1] << 21 | light[..., 2] << 42


def image_of(radiance: NDArray[np.int64]) -> NDArray[np.uint8]:
    """The picture ``(h, w, 3)`` of packed radiance ``(h, w)``; what is brighter than white is white."""
    light = np.stack([radiance & _FIELD, radiance >> 21 & _FIELD, radiance >> 42], axis=-1) / _UNIT
    return np.minimum(np.sqrt(light) + 0.5, 255.0).astype(np.uint8)


WHITE = _UNIT * 255**2
"""Radiance of a white pixel of a finished picture."""
