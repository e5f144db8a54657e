"""People of the simulated street: who there is, and the state of one at one instant."""

from __future__ import annotations

from dataclasses import dataclass

from mixo_env.errors import ConfigurationError, unknown

LOOKS = 12
"""Number of people and clothes; ``PersonState.look`` counts from 0 to ``LOOKS - 1``."""

PHASES = 16
"""Poses of one cycle: two steps, or one turn of the pedals."""

PEOPLE_KINDS = {"walker": (0.35, 0.5, 1.7), "cyclist": (1.75, 0.5, 1.75)}
"""Usual length, width and height in metres."""


@dataclass(frozen=True)
class PersonState:
    """One person at one instant.

    Attributes:
        kind: a key of ``PEOPLE_KINDS``.
        look: ``0 <= look < LOOKS``.
        x_m, y_m: of the point on the ground below the hips, map frame.
        z_m: height of that ground, above the carriageway.
        yaw_rad: heading, anticlockwise from the map's x axis.
        speed_mps: along the heading; 0 is a person who stands.
        stride: how much of the present cycle is done, 0..1.

    Raises:
        ConfigurationError: for an unknown kind or look.
    """

    kind: str
    look: int
    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float
    speed_mps: float = 0.0
    stride: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in PEOPLE_KINDS:
            raise ConfigurationError(unknown("kind of person", self.kind, PEOPLE_KINDS))
        if not 0 <= self.look < LOOKS:
            raise ConfigurationError(f"a person's look must lie in 0..{LOOKS - 1}, got {self.look}")

    @property
    def pose(self) -> int:
        """Number of the pose that the person is in; the one after the last of a cycle is standing."""
        return PHASES if self.speed_mps == 0.0 else int(self.stride * PHASES) % PHASES
