"""What the renderer's loops hand to each other: named tuples of arrays, and the columns of those arrays by name.

Numba passes a named tuple as the single values in it, so a name costs nothing; a table per patch stays one array of
numbers, because whole rows of it are copied.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]
UInt8s = NDArray[np.uint8]
Int8s = NDArray[np.int8]
Int32s = NDArray[np.int32]
Int64s = NDArray[np.int64]
UInt32s = NDArray[np.uint32]

Point = tuple[float, float, float]

SIDES, MATERIAL, TEXTURE, BODY = range(4)
"""Columns of ``PatchSet.tag``: bits of the shape (``TWO_SIDED``, ``CUT_OUT``), material, number in the atlas, number of
the rigid body (0 is the world)."""

RED, GREEN, BLUE, EMISSION, GRAIN_PER_U, GRAIN_PER_V, GRAIN_U, GRAIN_V, GRAIN_STRENGTH, FACING = range(10)
NORMAL_X, NORMAL_Y, NORMAL_Z = range(10, 13)
"""Columns of ``PatchSet.look``: tint; factor on the light emitted at night; texels of the fine grain per texel, its
offsets and strength; share of the sun before shadows; outward normal."""

U_CONSTANT, U_COLUMN, U_ROW, V_CONSTANT, V_COLUMN, V_ROW, W_CONSTANT, W_COLUMN, W_ROW = range(9)
"""Columns of ``Seen.plane``: u = texel column/z, v = texel row/z and w = 1/z, each as what it is at pixel (0, 0), what
every column of pixels adds and what every row adds."""


LIGHT = np.dtype(
    [
        ("ambient", np.float64),
        ("sun", np.float64),
        ("haze_per_m", np.float64),  # share of light lost to the air
        ("haze_red", np.float64),  # radiance of the air, also of the sky at the horizon
        ("haze_green", np.float64),
        ("haze_blue", np.float64),
        ("zenith_red", np.float64),  # radiance of the sky overhead
        ("zenith_green", np.float64),
        ("zenith_blue", np.float64),
        ("clouds", np.float64),  # their contrast
        ("lamps", np.float64),
        ("wetness", np.float64),  # 0..1
        ("red", np.float64),  # colour of all light but that of the air
        ("green", np.float64),
        ("blue", np.float64),
    ]
)
"""Light and air of a ``Weather``; radiance in units of the integer result. An array of one."""


class View(NamedTuple):
    """One camera at one instant.

    Attributes:
        rotation: ``(3, 3)`` camera from map.
        position_m: ``(3,)`` camera centre, map frame.
        fx, fy, cx, cy: lens in pixels; pixel centres at whole numbers.
        far_m: nothing farther than this is drawn.
    """

    rotation: Float64s
    position_m: Float64s
    fx: float
    fy: float
    cx: float
    cy: float
    far_m: float


class Seen(NamedTuple):
    """Which patch each pixel of a picture shows. A patch that is seen has a slot, one row of the three tables.

    Attributes:
        depth: ``(h, w)`` float32 1/z, 0 where nothing is seen.
        owner: ``(h, w)`` int32 slot of the patch that is seen, -1 for the sky.
        plane: ``(slots, 9)`` its texture and depth over the picture, see ``U_CONSTANT`` and the names after it.
        style: ``(slots, 13)`` ``PatchSet.look`` of the patch.
        mark: ``(slots, 4)`` ``PatchSet.tag`` of the patch.
    """

    depth: Float32s
    owner: Int32s
    plane: Float64s
    style: Float32s
    mark: Int32s


class Textures(NamedTuple):
    """All that surfaces are covered with.

    Attributes:
        texels: of the atlas, ``Atlas.packed``.
        table: of the atlas: first texel, log2 of width and of height, ``(textures, reductions, 3)``.
        detail: fine grain with all its reductions.
        detail_start: first entry of each reduction.
        sky: clouds, ``quads``.
        ground_texels_per_m: scale of the ground texture.
        grain_levels: reductions of the fine grain that are drawn.
        most_taps: samples along the long axis of a pixel's footprint on a slanted surface.
    """

    texels: UInt32s
    table: Int64s
    detail: UInt32s
    detail_start: Int64s
    sky: UInt32s
    ground_texels_per_m: float
    grain_levels: int
    most_taps: int


class Daylight(NamedTuple):
    """Where the sun shines.

    Attributes:
        picture: sunlight on the ground, bytes.
        cells: its ``even_cells``.
        field: height in metres below which a point lies in a house's shadow.
    """

    picture: UInt8s
    cells: UInt8s
    field: Float32s


class Lamps(NamedTuple):
    """What shines at night.

    Attributes:
        window: light of street lamps and other cars on the ground, one value a metre, a power of two wide.
        corner: map position of its corner.
        ground: ``(3,)`` the plane of the ground below the camera: height at the map's origin, slope along x and y.
        beam: ``(8,)`` rows x and y of ego from camera with their translation, for the car's own head lights.
    """

    window: Float32s
    corner: Float64s
    ground: Float64s
    beam: Float64s
