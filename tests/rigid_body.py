"""How a camera moves with a car on a circle: worked out anew for the tests, not with the product's formulas."""

from __future__ import annotations

import math


def camera_displacement(yaw: float, distance: float, lever_x: float, lever_y: float) -> tuple[float, float]:
    """Displacement x, y [m] of a camera, in first ego axes: centre of the circle, end of the arc, lever arm turned."""
    if yaw == 0.0:
        return distance, 0.0
    radius = distance / yaw  # the centre lies at (0, radius), to the left in a left turn
    end_x, end_y = radius * math.sin(yaw), radius - radius * math.cos(yaw)
    turned_x = math.cos(yaw) * lever_x - math.sin(yaw) * lever_y
    turned_y = math.sin(yaw) * lever_x + math.cos(yaw) * lever_y
    return end_x + turned_x - lever_x, end_y + turned_y - lever_y
