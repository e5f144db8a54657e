"""What a simulated data set is made of: one frozen dataclass, which is also the command line of ``mixo simulate``."""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.nuscenes.selections import ALL_CAMERAS, CAMERAS


def _check_shares(kind: str, shares: dict[str, float]) -> None:
    for name, share in shares.items():
        if not 0.0 <= share <= 1.0:
            raise ConfigurationError(f"{kind} {name} must lie between 0 and 1, got {share:g}: change it")
    total = sum(shares.values())
    if total > 1.0 + 1e-9:
        named = ", ".join(f"{name} {share:g}" for name, share in shares.items() if share)
        raise ConfigurationError(
            f"the shares of {kind} add up to {total:.3g}, at most 1 is possible: lower some of {named}"
        )


@dataclass(frozen=True)
class SituationShares:
    """Share of scenes in which a named situation is staged; the remaining scenes are ordinary drives.

    ``standing`` is part of realistic motion (about 10 % of the real scenes hardly move, together with
    ``standing_cross_traffic``); all others put a difficulty of the paper on the stage on purpose.
    """

    standing: float = 0.05
    """The car hardly moves."""
    standing_cross_traffic: float = 0.04
    """The car waits at a crossing while vehicles pass in front of it."""
    lead_truck: float = 0.06
    """A truck ahead fills the front view, also through a turn."""
    following_van: float = 0.06
    """A van behind fills the rear view."""
    side_queue: float = 0.05
    """A creeping queue fills the oncoming lane on the left."""
    oncoming_platoon: float = 0.05
    """A dense platoon comes the other way."""
    blank_wall: float = 0.05
    """One windowless wall along a whole side of the way, swept by the front view in a turn."""
    fast_straight: float = 0.03
    """Straight on at 11 to 14 m/s."""
    tight_turn: float = 0.05
    """A turn at the smallest radius the streets allow."""
    majority_wrong: float = 0.0
    """Truck ahead, van behind and a creeping queue on the left at once: three of the paper's four cameras see more of
    them than of the street."""

    def __post_init__(self) -> None:
        _check_shares("situation", self.by_name())

    def by_name(self) -> dict[str, float]:
        """Situation -> share, in the order of the fields."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}


FAULTS = ("none", "frozen", "black", "dropped", "dirty", "drops", "glare", "exposure", "knocked")
"""What can be wrong with a camera in every scene of a data set; see :mod:`mixo_env.simulator.picture.faults`."""


@dataclass(frozen=True)
class CameraFault:
    """One camera of every scene is out of order. Drive, truth, poses and CAN bus stay as they are without."""

    kind: str = "none"
    """none, frozen, black, dropped, dirty, drops, glare, exposure or knocked."""
    camera: str | None = None
    """Which; None: one of the cameras written, drawn for every scene."""

    def __post_init__(self) -> None:
        if self.kind not in FAULTS:
            raise ConfigurationError(unknown("camera fault", self.kind, FAULTS))
        if self.kind == "none" and self.camera is not None:
            raise ConfigurationError(f"fault camera {self.camera} needs a fault kind: {', '.join(FAULTS[1:])}")


@dataclass(frozen=True)
class SimulationConfig:
    """A simulated data set. Equal configurations give equal files, whatever the number of workers."""

    scenes: int = 12
    """Number of scenes; they are named scene-2001 upwards."""
    scenes_per_log: int = 3
    """Scenes of one drive: they share city, weather, rig, wheels and sensor biases (folds never split a log)."""
    seed: int = 0
    """Any other number gives another data set."""
    seconds: int = 20
    """Length of a scene [s]."""
    width: int = 800
    """Image width [px]; the height must be 9/16 of it, as in nuScenes."""
    height: int = 450
    """Image height [px]."""
    cameras: tuple[str, ...] = CAMERAS
    """Channels to write: the paper's four by default, at most all six of the car."""
    images: bool = True
    """Without images everything but the pixels is written: CAN bus, poses and tables, in seconds."""
    rain: float = 0.2
    """Share of logs driven in rain (by day)."""
    night: float = 0.08
    """Share of logs driven at night."""
    low_sun: float = 0.2
    """Share of the logs by day under a low sun, which stands along the streets."""
    low_texture: float = 0.1
    """Share of logs in a city with many blank walls and little fine texture."""
    situations: SituationShares = field(default_factory=SituationShares)
    """Shares of staged situations."""
    fault: CameraFault = field(default_factory=CameraFault)
    """Of one camera in every scene."""

    def __post_init__(self) -> None:
        for name, low, high in (
            ("scenes", 1, 7999),  # scene-2001 to scene-9999: four digits, as the official CAN bus reader expects
            ("scenes_per_log", 1, 7999),
            ("seconds", 2, 30),
            ("width", 32, 1600),
            ("seed", 0, 2**32 - 1),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigurationError(f"{name} must lie between {low} and {high}, got {value}: change it")
        if self.width * 9 != self.height * 16:
            raise ConfigurationError(
                f"images must be 16:9 like nuScenes, got {self.width}x{self.height}: use for example 800x450"
            )
        for channel in self.cameras:
            if channel not in ALL_CAMERAS:
                raise ConfigurationError(unknown("camera", channel, ALL_CAMERAS))
        if not self.cameras or len(set(self.cameras)) != len(self.cameras):
            raise ConfigurationError(f"cameras must be given once each, got {', '.join(self.cameras) or 'none'}")
        if self.fault.camera is not None and self.fault.camera not in self.cameras:
            raise ConfigurationError(unknown("fault camera", self.fault.camera, self.cameras))
        _check_shares("weather", {"rain": self.rain, "night": self.night})
        _check_shares("log", {"low_texture": self.low_texture})
        _check_shares("light", {"low_sun": self.low_sun})

    @property
    def logs(self) -> int:
        """Number of logs."""
        return -(-self.scenes // self.scenes_per_log)


STAGED = (*(entry.name for entry in fields(SituationShares)), "low_texture", "ordinary")
"""What :func:`staging` knows: situations, and ordinary drives, through a city of little texture or a usual one."""


def staging(config: SimulationConfig, situation: str) -> SimulationConfig:
    """The same data set with one situation in every scene, and every scene of a log of its own.

    It is day under a high sun, or rain in the share asked for: what is staged is to be the only difficulty.

    Raises:
        ConfigurationError: for an unknown situation; the line names the nearest.
    """
    if situation not in STAGED:
        raise ConfigurationError(unknown("situation", situation, STAGED))
    shares = {entry.name: float(entry.name == situation) for entry in fields(SituationShares)}
    return replace(
        config,
        scenes_per_log=1,
        night=0.0,
        low_sun=0.0,
        low_texture=float(situation == "low_texture"),
        situations=SituationShares(**shares),
    )
