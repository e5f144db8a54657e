"""Settings of the single-camera odometry, with the presets ``fast`` (default) and ``paper``."""

from __future__ import annotations

from dataclasses import dataclass, fields

from mixo_env.errors import ConfigurationError, unknown


@dataclass(frozen=True)
class MonocularConfig:
    """Everything that may be varied; the defaults are the preset ``fast``.

    Attributes:
        features: corners kept per image, over all pyramid levels.
        features_apart: at least so many in each of two images that are further apart than ``apart_s``: they have few
            corners in common (and there is time).
        apart_s: a time between two images that is far apart.
        levels: pyramid levels.
        scale_factor: size ratio of consecutive pyramid levels.
        fast_threshold: contrast [grey levels] of a FAST corner.
        fast_threshold_low: the same where a grid cell has too few corners.
        max_pixels: images with more pixels are halved (2 x 2 averages) until they fit; ``None`` keeps them as they are.
        vocabulary: ``"general"``: the one that ships; or the path of one made by ``mixo train-vocabulary``.
        match_words: so many nearest words of a feature of the first image are searched for its partner in the second.
        match_max_bits: largest Hamming distance (of 256 bits) of a match.
        match_ratio: a match must be better than this share of the second-best distance in its search window.
        max_yaw_rate_radps: faster turns of the car are not searched for.
        max_curvature_radpm: nor are tighter ones [rad per metre]: wheels that hardly roll cannot turn a car. (A robot
            that turns on the spot needs a large value.)
        standing_yaw_rad: turn allowed between two images beyond that, for distances that are a little too small.
        noise_px: expected position noise of a feature, in working pixels; the start value of the robust scale.
        tilt_std_rad: soft zero prior on the roll and pitch increments between two images.
        slip_std: soft prior of the sideways and vertical motion, as a share of the distance (non-holonomic car).
        course_spread: the same for a single pair, about the slow mean that earlier pairs have shown.
        yaw_acceleration_radps2: from one pair of images to the next the yaw rate is expected to change by so
            much per second (standard deviation); four times as much, and the camera is lost.
        solver_matches: at most so many matches, evenly picked, enter the motion solver.
        min_matches: fewer matches and the camera is lost (50 in the paper).
        min_inliers: fewer matches in agreement with the motion (an estimate) and the camera is lost.
        max_yaw_std_rad: an increment less certain than this is not reported: the camera is lost.
        max_gap_s: a longer time between two images cannot be bridged: the camera is lost.
        initial_matches: matches a pair must have to count for initialisation.
        initial_pairs: consecutive good pairs that end INITIALISING, once ``initial_distance_m`` was travelled.
        initial_distance_m: parallax that initialisation waits for ...
        initial_patience_pairs: ... unless this many good pairs came without it (a car that stands still).
    """

    features: int = 1200
    features_apart: int = 4000
    apart_s: float = 0.3
    levels: int = 3
    scale_factor: float = 1.4
    fast_threshold: int = 20
    fast_threshold_low: int = 7
    max_pixels: int | None = 600_000
    vocabulary: str = "general"
    match_words: int = 10
    match_max_bits: int = 64
    match_ratio: float = 0.9
    max_yaw_rate_radps: float = 1.0
    max_curvature_radpm: float = 0.3
    standing_yaw_rad: float = 0.005
    noise_px: float = 0.35
    tilt_std_rad: float = 0.003
    slip_std: float = 0.05
    course_spread: float = 0.006
    yaw_acceleration_radps2: float = 0.2
    solver_matches: int = 800
    min_matches: int = 50
    min_inliers: int = 30
    max_yaw_std_rad: float = 0.01
    max_gap_s: float = 0.55
    initial_matches: int = 100
    initial_pairs: int = 2
    initial_distance_m: float = 0.5
    initial_patience_pairs: int = 10

    def __post_init__(self) -> None:
        """Check ranges once, so that nothing inside needs to.

        Raises:
            ConfigurationError: for a value that is not positive or a contradiction.
        """
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(value, str | bool | None) or field.name == "initial_distance_m":
                continue
            if not value > 0:
                raise ConfigurationError(
                    f"MonocularConfig.{field.name} must be positive, got {value!r}: choose a larger value"
                )
        if not self.scale_factor > 1.0:
            raise ConfigurationError(
                f"MonocularConfig.scale_factor must exceed 1, got {self.scale_factor!r}: use e.g. 1.2"
            )

    @staticmethod
    def preset(name: str) -> MonocularConfig:
        """Preset by name.

        Args:
            name: ``"fast"`` (default everywhere) or ``"paper"`` (8000 features, 19 levels, full resolution).

        Raises:
            ConfigurationError: for another name.
        """
        if name not in PRESETS:
            raise ConfigurationError(unknown("odometry preset", name, PRESETS))
        return PRESETS[name]


PRESETS = {
    "fast": MonocularConfig(),
    "paper": MonocularConfig(features=8000, levels=19, scale_factor=1.2, max_pixels=None, match_words=4),
}
"""Preset name -> settings."""
