"""Settings of the joint odometry."""

from __future__ import annotations

from dataclasses import dataclass, fields

from mixo_env.errors import ConfigurationError


@dataclass(frozen=True)
class JointConfig:
    """Everything that may be varied.

    Attributes:
        camera_matches: at most so many matches of a camera, evenly picked, enter; more cost time and tell little,
            since neighbouring matches err together.
        min_matches: a camera with fewer has no say in a step.
        yaw_acceleration_radps2: the yaw rate is expected to change by so much per second (standard deviation).
        tilt_rate_std_radps: standard deviation of pitch and roll rate of the body.
        slip_std: of the sideways and vertical motion of the body in one step, as a share of the distance.
        mounting_std: of each camera's own constant offset from that: error of its written mounting [rad].
        own_yaw_std_rad: least standard deviation of a camera's own yaw error in one step.
        own_yaw_share: the same as a share of what its matches alone would leave uncertain: views err in proportion.
        change_std_rad: least standard deviation of what three images say of the change of a turn.
        change_share: the same as a share of what independent errors of the points would leave.
        freedom: of the Student-t distribution of these errors; few degrees let a captured camera lose its say.
        misplaced_rad: a camera is left out once its offset is known to exceed this.
        misplaced_steps: for so many steps in a row.
        least_support: a solution with a smaller share of agreeing matches is none.
        max_yaw_std_rad: an increment less certain than this is not reported.
        max_gap_s: a longer step cannot be bridged.
        initial_steps: good steps in a row that end INITIALISING.
    """

    camera_matches: int = 300
    min_matches: int = 50
    yaw_acceleration_radps2: float = 0.2
    tilt_rate_std_radps: float = 0.036
    slip_std: float = 0.004
    mounting_std: float = 0.003
    own_yaw_std_rad: float = 1.7e-5
    own_yaw_share: float = 1.0
    change_std_rad: float = 5e-5
    change_share: float = 10.0
    freedom: float = 3.0
    misplaced_rad: float = 0.0175
    misplaced_steps: int = 12
    least_support: float = 0.3
    max_yaw_std_rad: float = 0.01
    max_gap_s: float = 0.55
    initial_steps: int = 2

    def __post_init__(self) -> None:
        """Check ranges once.

        Raises:
            ConfigurationError: for a value that is not positive.
        """
        for field in fields(self):
            if not (value := getattr(self, field.name)) > 0:
                raise ConfigurationError(
                    f"JointConfig.{field.name} must be positive, got {value!r}: choose a larger value"
                )
