"""The street grid shared by the world, the drives and the traffic. Metres, map frame, right-hand traffic.

Streets run along every line x = i * BLOCK_M and y = j * BLOCK_M for whole i, j from -HALF_CITY_BLOCKS to
+HALF_CITY_BLOCKS.
"""

from __future__ import annotations

BLOCK_M = 256.0 / 3.0
"""Distance between parallel streets; the ground texture repeats every three blocks."""

HALF_CITY_BLOCKS = 5
"""The city reaches from -HALF_CITY_BLOCKS to +HALF_CITY_BLOCKS streets in x and y."""

HALF_ROAD_M = 6.6
"""Kerb to centre line: two lanes and two parking strips."""

SIDEWALK_M = 10.0
"""House fronts to centre line."""

LANE_M = 1.75
"""Lane centre to centre line; vehicles keep to the right of it."""

PARKING_M = 5.6
"""Centre of the parking strip to centre line."""
