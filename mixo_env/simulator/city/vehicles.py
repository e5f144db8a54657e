"""Vehicles of the simulated street: the kinds there are and the state of one at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from mixo_env.errors import ConfigurationError, unknown

COLOURS = 10
"""Number of paints; ``VehicleState.colour`` counts from 0 to ``COLOURS - 1``."""


@dataclass(frozen=True)
class VehicleKind:
    """Outer size in metres."""

    length_m: float
    width_m: float
    height_m: float


VEHICLE_KINDS = {
    "sedan": VehicleKind(4.5, 1.8, 1.45),
    "suv": VehicleKind(4.7, 1.9, 1.72),
    "van": VehicleKind(5.4, 2.0, 2.4),
    "truck": VehicleKind(8.6, 2.5, 3.5),
}


@dataclass(frozen=True)
class VehicleState:
    """One vehicle at one instant.

    Attributes:
        kind: a key of ``VEHICLE_KINDS``.
        colour: paint, ``0 <= colour < COLOURS``.
        x_m, y_m: centre of the vehicle on the ground, map frame.
        yaw_rad: heading, anticlockwise from the map's x axis.
        speed_mps: along the heading; moves the vehicle during the exposure.
        yaw_rate_radps: of the heading.

    Raises:
        ConfigurationError: for an unknown kind or colour.
    """

    kind: str
    colour: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float = 0.0
    yaw_rate_radps: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in VEHICLE_KINDS:
            raise ConfigurationError(unknown("vehicle kind", self.kind, VEHICLE_KINDS))
        if not 0 <= self.colour < COLOURS:
            raise ConfigurationError(f"vehicle colour must lie in 0..{COLOURS - 1}, got {self.colour}")
