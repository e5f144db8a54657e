"""Pictures of a faulty camera, made of those that the files of a sound one hold: nothing need be drawn twice."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mixo_env.simulator.picture.faults import PixelFault, Shot, spoil

JPEG_QUALITY = 80
"""With colour at half resolution (4:2:0), as the images of nuScenes."""


def encoded(image: NDArray[np.uint8]) -> bytes:
    """A picture as JPEG."""
    import simplejpeg

    return simplejpeg.encode_jpeg(image, quality=JPEG_QUALITY, colorspace="RGB", colorsubsampling="420")


class Spoiler:
    """Spoils the pictures of one camera over one scene, which come in time order."""

    def __init__(self, fault: PixelFault, shots: dict[Path, Shot]) -> None:
        """Remember fault and shots; the paths are those of the faulty camera's pictures."""
        self._fault, self._shots = fault, shots
        self._last: tuple[NDArray[np.uint8], bytes] | None = None

    def spoilt(self, path: Path, jpeg: bytes) -> bytes:
        """What is written to ``path`` instead of ``jpeg``; the same bytes where the fault changes nothing."""
        import simplejpeg

        if path not in self._shots:
            return jpeg
        image = simplejpeg.decode_jpeg(jpeg, "RGB")
        last = None if self._last is None else self._last[0]
        seen = spoil(image, last, self._fault, self._shots[path])
        if self._last is not None and seen is self._last[0]:
            return self._last[1]
        self._last = seen, jpeg if seen is image else encoded(seen)
        return self._last[1]
