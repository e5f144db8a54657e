"""Bounds of what a nuScenes file can sensibly hold, as types for the parser: beyond them a file is refused.

They are far outside anything a car does, so that they never drop real data, and near enough that no sum, grid or time
difference made of accepted values can overflow or fill the memory.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

FIRST_US, LAST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2100."""

LONGEST_SCENE_S = 3_600.0
"""Of one scene and of its CAN bus; real scenes last 20 s."""

TimeUs = Annotated[int, msgspec.Meta(ge=FIRST_US, le=LAST_US)]
"""Unix microseconds."""

Coordinate = Annotated[float, msgspec.Meta(ge=-1e7, le=1e7)]
"""Metres on a map: maps in UTM reach 1e7."""

Reading = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""Any value on the CAN bus in its own unit."""

Component = Annotated[float, msgspec.Meta(ge=-1e3, le=1e3)]
"""Of a quaternion, or of a mounting in metres."""

Pixels = Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)]
"""Of an intrinsic matrix."""

Side = Annotated[int, msgspec.Meta(ge=0, le=65_535)]
"""Width or height of an image: what a JPEG can hold."""

Count = Annotated[int, msgspec.Meta(ge=0, le=1_000_000)]
"""Of key frames."""
