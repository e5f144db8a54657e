"""``MixoOdometryBudget-v0``: which cameras are worth their milliseconds?"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mixo_env.compiled import compiled
from mixo_env.envs.observation import AWAKE, RICH, Quantity
from mixo_env.envs.odometry import MixoOdometryEnv, MixoOdometryVectorEnv
from mixo_env.envs.replay import Replay
from mixo_env.envs.session import Session
from mixo_env.envs.settings import Settings
from mixo_env.envs.stepping import DT, SUBSTITUTE
from mixo_env.errors import ConfigurationError, RecordingError
from mixo_env.experts.expert import State
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import UNEQUAL

PARTS = ("matches", "inliers", "residual_px", "flow_px", "state", "awake", "yaw_rates", "available", "disagreement")
"""Quantities that depend on the switches, in the order :func:`silence` takes their columns."""

STATELESS = tuple(quantity for quantity in RICH if quantity.name != "yaw_rate_std")
"""``"rich"`` without the standard deviation, which only an odometry that was never switched off can tell."""


@compiled
def charge(state: Any, awake: Any, switches: Any, expert_of_camera: Any, cost_ms: Any, spent: Any) -> None:
    """Switch cameras where a scene goes on, neither paused nor over, and charge for the images they process.

    Args:
        state: ``(batch,)`` STATE; who will deliver nothing is written there.
        awake: ``(batch, cameras)`` bool, changed in place.
        switches: ``(batch, cameras)``; > 0: the image that closes the coming step is to be processed.
        expert_of_camera: ``(cameras,)`` position of each camera among the experts.
        cost_ms: ``(cameras,)`` of an image.
        spent: ``(batch,)`` written: of all images [ms].
    """
    for b in range(awake.shape[0]):
        spent[b] = 0.0
        s = state[b]
        if s.step == 0 or s.done:
            continue
        silent = 0
        for c in range(awake.shape[1]):
            on = switches[b, c] > 0.0
            if on:
                spent[b] += cost_ms[c]
            if not (on and awake[b, c]):
                silent |= 1 << expert_of_camera[c]
            awake[b, c] = on
        s.silent = silent


@compiled
def silence(
    out: Any, state: Any, table: Any, awake: Any, expert_of_camera: Any, columns: Any, experts: int, limit: float
) -> None:
    """Take out of an observation what sleeping and just woken cameras cannot know.

    Args:
        out: ``(batch, width)``, changed in place.
        state: ``(batch,)`` STATE.
        table: of steps.
        awake: ``(batch, cameras)`` bool: the image of this step was processed.
        expert_of_camera: ``(cameras,)`` position of each camera among the experts.
        columns: first column of each of PARTS, -1 where the observation lacks it.
        experts: how many.
        limit: bound of yaw rates [rad/s].
    """
    rates, available, disagreement = columns[6], columns[7], columns[8]
    said = np.empty(experts)
    for b in range(out.shape[0]):
        row, silent = state[b].row, state[b].silent
        substitute = table[row, SUBSTITUTE] / table[row, DT] if silent else 0.0
        for c in range(awake.shape[1]):
            out[b, columns[5] + c] = awake[b, c]
            j = expert_of_camera[c]
            if not (silent >> j) & 1:
                continue
            out[b, rates + j] = min(max(substitute, -limit), limit)
            out[b, columns[0] + c] = 0.0
            if available >= 0:
                out[b, available + j] = 0.0
                out[b, columns[1] + c] = 0.0
                out[b, columns[2] + c] = 0.0
                out[b, columns[3] + c] = 0.0
                out[b, columns[4] + c] = 0.0 if awake[b, c] else 3.0  # INITIALISING or NO_IMAGE
        if disagreement >= 0:
            count = 0
            for j in range(experts):
                if out[b, available + j] > 0.0:
                    said[count] = out[b, rates + j]
                    count += 1
            middle = np.median(said[:count]) if count else table[row, SUBSTITUTE] / table[row, DT]
            for j in range(experts):
                out[b, disagreement + j] = out[b, rates + j] - middle


class BudgetReplay(Replay):
    """Fusion core whose cameras can be switched off.

    A camera delivers its stateless increment for a step only if the images at both ends of it were processed.

    Attributes:
        awake: ``(batch, cameras)`` bool: the image that closes the coming step is processed.
    """

    camera_increments: ClassVar[str] = "two_frame_yaw_increment_rad"
    counts_imported: ClassVar[bool] = False

    def __init__(self, recordings: Recordings, *, quantities: tuple[Quantity, ...] = STATELESS, **options: Any) -> None:
        """Build the tables; options as in :class:`~mixo_env.envs.replay.Replay`."""
        if not recordings.manifest.cameras:
            raise ConfigurationError(
                "expected recordings with cameras to switch on and off, these hold imported trajectories alone: "
                "MixoOdometry-v0 plays them"
            )
        if options["track"] == UNEQUAL:
            raise ConfigurationError(
                f"track {UNEQUAL}: the experts of other families have no price and cannot be switched off; choose "
                "PAPER, VISION or CONSUMER, or MixoOdometry-v0"
            )
        super().__init__(recordings, quantities=(*quantities, AWAKE), **options)
        if not self.cameras:
            raise ConfigurationError("experts: expected at least one camera to switch, got none")
        self._expert_of_camera = np.array([self.experts.index(camera) for camera in self.cameras])
        slices = self.layout.slices
        self._columns = np.array([slices[name].start if name in slices else -1 for name in PARTS])

    def restart(self, which: NDArray[np.int64], scenes: NDArray[np.int64], *, pause: bool = False) -> None:
        """Start ``scenes`` with all cameras awake: their first two images were processed."""
        super().restart(which, scenes, pause=pause)
        self.awake[which] = True

    def awake_cameras(self, entry: int) -> NDArray[np.bool_]:
        """``(cameras,)``: the row of ``awake`` of a batch entry."""
        return self.awake[entry]

    def switch(self, switches: NDArray[np.float32], cost_ms: NDArray[np.float64]) -> NDArray[np.float64]:
        """Let cameras process the image that closes the coming step, where one comes.

        Args:
            switches: ``(batch, cameras)``; on if > 0.
            cost_ms: ``(cameras,)`` of an image.

        Returns:
            ``(batch,)`` milliseconds spent.
        """
        spent = np.empty(len(switches))
        charge(self.state, self.awake, switches, self._expert_of_camera, cost_ms, spent)
        return spent

    def observe_flat(self) -> NDArray[np.float32]:
        """The observation as one fresh array ``(batch, layout.width)``."""
        return self.silenced(super().observe_flat())

    def silenced(self, flat: NDArray[np.float32]) -> NDArray[np.float32]:
        """``flat``, changed in place, without what the cameras that do not deliver would have said."""
        silence(
            flat,
            self.state,
            self._table,
            self.awake,
            self._expert_of_camera,
            self._columns,
            len(self.experts),
            self.rate_limit,
        )
        return flat

    def _allocate(self, batch: int) -> None:
        super()._allocate(batch)
        self.awake = np.ones((batch, len(self.cameras)), np.bool_)

    def _counting_states(self) -> NDArray[np.int8]:
        """TRACKING where two images alone give an increment: there is no memory and so no other way to track."""
        recorded = super()._counting_states()
        found = self.votes.available[:, [self.experts.index(camera) for camera in self.cameras]]
        unseen = recorded == State.NO_IMAGE
        return np.where(found, State.TRACKING, np.where(unseen, State.NO_IMAGE, State.LOST)).astype(np.int8)


@dataclass(frozen=True)
class BudgetSettings(Settings):
    """Options of the budget environment."""

    price_per_ms: float = 0.01

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.price_per_ms < 0:
            raise ConfigurationError(f"price_per_ms: expected a number >= 0, got {self.price_per_ms!r}: e.g. 0.01")
        if self.weights == "select":
            raise ConfigurationError("weights='select' leaves no room for switches: use softmax, simplex or raw")


class BudgetSession(Session):
    """A batch of scenes in which cameras cost time."""

    switchable: ClassVar[bool] = True
    replay_class: ClassVar[type[Replay]] = BudgetReplay
    rich: ClassVar[tuple[Quantity, ...]] = STATELESS
    own_terms: ClassVar[tuple[str, ...]] = ("reward_cost", "cost_ms")
    settings: BudgetSettings
    replay: BudgetReplay

    def __init__(self, settings: BudgetSettings, batch: int, *, keep_trajectories: bool = True) -> None:
        """As the base, with costs from the recordings' manifest."""
        super().__init__(settings, batch, keep_trajectories=keep_trajectories)
        costs = self.recordings.manifest.camera_cost_ms
        missing = [camera for camera in self.replay.cameras if camera not in costs]
        if missing:
            raise RecordingError(f"the manifest has no camera_cost_ms for {', '.join(missing)}: record anew")
        self.cost_ms = np.array([costs[camera] for camera in self.replay.cameras])

    def _switch(self, actions: NDArray[np.float32], report: NDArray[np.float64], flat: NDArray[np.float32]) -> None:
        """Switch cameras by the sign of an action's last numbers, charge for it, and correct the observation."""
        report[-1] = self.replay.switch(actions[:, -self.switches :], self.cost_ms)
        report[-2] = -self.settings.price_per_ms * report[-1]
        report[0] += report[-2]
        self.replay.silenced(flat)


class MixoOdometryBudgetEnv(MixoOdometryEnv):
    """`MixoOdometry-v0` in which cameras cost time: decide also which of them to process next.

    ## Description
    As in `MixoOdometry-v0` the agent weights the experts of this step; besides, it switches every camera on or off for
    the image that closes the *next* step. A camera without memory compares two images: it delivers for a step if both
    the image that opened and the image that closed it were processed. A woken camera therefore delivers one step late
    and pays for both images; meanwhile what it would say about its matches is masked. The increments replayed are the
    stateless ones of two images (`two_frame_yaw_increment_rad`), so the replay equals an odometry whose cameras really
    were switched.

    ## Action space
    `Box(-1, 1, (N + C,), float32)`: N weights as in `MixoOdometry-v0` (`weights="select"` does not exist here), then C
    switches in the order of `env.unwrapped.session.replay.cameras`: on if > 0.

    ## Observation space
    As in `MixoOdometry-v0`, without `yaw_rate_std`, and with `awake` at the end (before a privileged truth):

    | name | width | range | unit | meaning |
    |---|---|---|---|---|
    | `awake` | C | 0 to 1 | 0 or 1 | the image that closes this step was processed |

    For a camera that does not deliver, `yaw_rates` holds the inertial substitute, `available` and everything about
    matches is 0, and `state` is 0 (initialising) if it just woke and 3 (no image) if it sleeps.

    ## Reward
    That of `MixoOdometry-v0` plus `reward_cost` = -`price_per_ms` x `cost_ms`, the fixed cost (manifest of the
    recordings) of the images that this action's switches have processed; both are in `info`. The last action of a scene
    costs nothing: no image follows.

    ## Starting state
    As in `MixoOdometry-v0`. The first two images of every camera are processed and free: nobody could decide.

    ## Episode end
    As in `MixoOdometry-v0`.

    ## Info
    As in `MixoOdometry-v0`, with `reward_cost` and `cost_ms` in every step.

    ## Arguments
    Those of `MixoOdometry-v0` and

    | option | default | meaning |
    |---|---|---|
    | `price_per_ms` | `0.01` | reward lost per millisecond of image processing |

    ## Vectorised use
    `gymnasium.make_vec("mixo_env:MixoOdometryBudget-v0", num_envs=64)`, as there.

    ## Version history
    * v0: first version.
    """

    session_class = BudgetSession
    settings_class = BudgetSettings


class MixoOdometryBudgetVectorEnv(MixoOdometryVectorEnv):
    """``num_envs`` copies of :class:`MixoOdometryBudgetEnv` stepped together; equal to it step for step."""

    session_class = BudgetSession
    settings_class = BudgetSettings
