"""The fusion core: recorded experts replayed over a batch of scenes in lockstep, eqs. 3, 4 and 1 step by step.

Everything that scores or trains a policy goes through :class:`Replay`: the evaluation of policies uses it directly, the
Gymnasium environments dress it. Sums stay in float64, and a weight of one on a single expert reproduces that expert bit
for bit.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixo_env.envs.observation import PRIVILEGED, RICH, Layout, Quantity, tabulate
from mixo_env.envs.stepping import (
    DISTANCE,
    DT,
    FIRST_EXPERT,
    SCENE,
    SCORES,
    STATE,
    SUBSTITUTE,
    TRUTH,
    advance,
    look,
    restart,
    tally,
)
from mixo_env.envs.tables import choose_experts, collect_votes, step_rows, tabulate_steps
from mixo_env.errors import ConfigurationError, unknown
from mixo_env.fusion import dead_reckon
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import VehicleConstants

Previous = Literal["fused", "inertial", "truth"]
Lost = Literal["inertial", "mask"]

FloatArray = NDArray[np.float64]


class Replay:
    """Scenes of a recording, played in lockstep by final weights.

    Attributes:
        recordings: what is replayed; scene indices refer to it.
        experts: the voters, in the order of the weights.
        cameras: those of them that are cameras.
        counting: those of them whose match counts and states are observed.
        layout: of the flat observation.
        state: ``(batch,)`` STATE after :meth:`reset`; read only.
        compiled: the arrays that compiled code reads and writes: state, table, history, context.
    """

    camera_increments: ClassVar[str] = "yaw_increment_rad"
    """The camera column that votes."""
    counts_imported: ClassVar[bool] = True
    """Whether match counts of imported experts are observed beside those of cameras."""

    def __init__(
        self,
        recordings: Recordings,
        *,
        track: str,
        experts: Sequence[str] | None = None,
        previous: Previous = "fused",
        lost: Lost = "inertial",
        privileged: bool = False,
        quantities: tuple[Quantity, ...] = RICH,
        keep_trajectories: bool = True,
        linear: FloatArray | None = None,
    ) -> None:
        """Build the tables; the recordings are not copied and not changed.

        Args:
            recordings: any number of scenes.
            track: ``"PAPER"``, ``"VISION"``, ``"CONSUMER"`` or ``"UNEQUAL"``: who votes, and which inertial expert
                substitutes.
            experts: who votes, in the order of the weights (default: the track's voters).
            previous: source of the observed previous yaw rate; ``"truth"`` is privileged.
            lost: a lost expert votes with the inertial increment, or does not vote.
            privileged: add ``truth_yaw_rate`` to the observation.
            quantities: what is observed, in order; the first must be the previous yaw rate.
            keep_trajectories: remember the fused increments, which :meth:`trajectory` needs.
            linear: ``(experts,)`` weights of LINEAR, if the reward is "improvement".

        Raises:
            ConfigurationError: for an unknown option value.
            RecordingError: when a step has no duration or no distance.
        """
        choices = (("previous", previous, ("fused", "inertial", "truth")), ("lost", lost, ("inertial", "mask")))
        for kind, value, valid in choices:
            if value not in valid:
                raise ConfigurationError(unknown(f"{kind} option", value, valid))
        self.recordings = recordings
        self.experts = choose_experts(recordings, track, experts)
        self.cameras = tuple(expert for expert in self.experts if expert in recordings.manifest.cameras)
        counting = recordings.counting if self.counts_imported else recordings.manifest.cameras
        self.counting = tuple(expert for expert in self.experts if expert in counting)
        observed = (*quantities, PRIVILEGED) if privileged else quantities
        self.layout = Layout(observed, len(self.counting), len(self.experts))

        self._steps = step_rows(recordings)
        first = recordings.offsets[:-1]
        self._start = np.stack([recordings[f"truth.{c}"][first] for c in ("x_m", "y_m", "yaw_rad")], axis=-1)
        self.votes = collect_votes(recordings, self._steps, self.experts, self.cameras, track, self.camera_increments)
        self.mask = lost == "mask"
        self._table = tabulate_steps(recordings, self._steps, self._start, self.votes, self.mask, linear)
        self.rate_limit = float(self.layout.high[0])
        self.fused = previous == "fused"
        previous_rate = self._previous_yaw_rate(previous)
        seen = self.experts, self.counting, self._counting_states()
        self._context = tabulate(self.layout, recordings, self._steps, self.votes, *seen, previous_rate)
        vehicles = [recordings.manifest.vehicles.get(scene.vehicle, VehicleConstants()) for scene in recordings.scenes]
        self._course_offset = np.array([vehicle.course_offset_rad for vehicle in vehicles])
        self.starts = self._starts_of_scenes(previous_rate)
        self._only_batch: int | None = None
        self._keep_trajectories = keep_trajectories
        self._allocate(0)

    def __len__(self) -> int:
        """Number of scenes."""
        return len(self.starts)

    @property
    def table(self) -> FloatArray:
        """``(rows, columns)`` of steps, read only."""
        return read_only(self._table)

    @property
    def context(self) -> NDArray[np.float32]:
        """``(rows, layout.width)`` recorded observations, read only."""
        return read_only(self._context)

    @property
    def batch(self) -> int:
        """Scenes played at once."""
        return len(self.state)

    @property
    def done(self) -> NDArray[np.bool_]:
        """``(batch,)``: the scene has ended."""
        return self.state["done"]

    @property
    def voting(self) -> NDArray[np.bool_]:
        """``(batch, experts)``: the expert, or its substitute, has a vote in the coming step."""
        silent = (self.state["silent"][:, None] >> np.arange(len(self.experts))) & 1 == 1
        return np.isfinite(self._table[self.state["row"], FIRST_EXPERT:]) & ~(silent & self.mask)

    @property
    def steps(self) -> NDArray[np.int64]:
        """``(scenes,)`` number of steps of each scene."""
        return self.starts["stop"] - self.starts["first"]

    def another(self, batch: int, *, keep_trajectories: bool) -> Self:
        """A replay of its own on the same tables, for ``batch`` scenes at once and no other number, at their start."""
        twin = copy.copy(self)
        twin._only_batch, twin._keep_trajectories = batch, keep_trajectories
        twin._allocate(batch)
        twin.reset(np.zeros(batch, np.int64))
        return twin

    def reset(self, scenes: ArrayLike) -> None:
        """Start ``(batch,)`` scenes, given by their index in the recordings.

        Raises:
            ConfigurationError: for another number of scenes than an environment's replay was made for.
        """
        chosen = np.asarray(scenes, dtype=np.int64)
        if self._only_batch not in (None, len(chosen)):
            raise ConfigurationError(
                f"expected {self._only_batch} scenes, got {len(chosen)}: this replay belongs to an environment; "
                "make one of your own with Replay(recordings, track=...)"
            )
        if self.batch != len(chosen):
            self._allocate(len(chosen))
        self.restart(np.arange(len(chosen)), chosen)

    def restart(self, which: NDArray[np.int64], scenes: NDArray[np.int64], *, pause: bool = False) -> None:
        """Start ``scenes`` in the batch entries ``which`` and leave the others where they are.

        With ``pause`` the restarted entries sit out the coming step (Gymnasium's NEXT_STEP autoreset).
        """
        restart(self.state, which, scenes, self.starts, pause)

    def observe(self) -> dict[str, NDArray[np.float32]]:
        """What a policy sees before the next step: name -> ``(batch, width)``; after the end the last step again."""
        return self.layout.split(self.observe_flat())

    def observe_flat(self) -> NDArray[np.float32]:
        """The same as one fresh array ``(batch, layout.width)``."""
        out = np.empty((self.batch, self.layout.width), np.float32)
        look(out, self.state, self._context, self.fused, self.rate_limit)
        return out

    def step(self, weights: FloatArray, *, shares: bool = False) -> None:
        """Mix, integrate and go on by one step wherever a scene has not ended.

        Args:
            weights: ``(batch, experts)`` float64, used as they are.
            shares: instead, numbers >= 0 that are normalised over the experts that vote.
        """
        advance(
            np.ascontiguousarray(weights, dtype=np.float64),
            shares,
            self.mask,
            self.state,
            self._table,
            self.history,
        )

    def scores(self) -> dict[str, FloatArray]:
        """Scores ``(batch,)`` of the scenes that have ended (0 for the others), named by SCORES."""
        values = np.empty((len(SCORES), self.batch))
        tally(self.state, values)
        return dict(zip(SCORES, values, strict=True))

    def trajectory(self, entry: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Fused x [m], y [m], yaw [rad, unwrapped] ``(steps so far + 1,)`` of one batch entry, map frame.

        Raises:
            ConfigurationError: where the steps were not kept.
        """
        if not self._keep_trajectories:
            raise ConfigurationError(
                "this replay keeps no trajectories, to be fast: make the environment with render_mode='rgb_array' or "
                "'ansi', or a replay of your own with Replay(recordings, track=..., keep_trajectories=True)"
            )
        scene, done = int(self.state[entry]["scene"]), int(self.state[entry]["step"])
        first = int(self.starts[scene]["first"])
        x, y, yaw = (float(value) for value in self._start[scene])
        return dead_reckon(
            self.history[:done, entry],
            self.table[first : first + done, DISTANCE],
            start=(x, y, yaw),
            course_offset_rad=float(self._course_offset[scene]),
        )

    def awake_cameras(self, entry: int) -> NDArray[np.bool_]:
        """``(cameras,)``: whether a batch entry processes the image that closes the coming step; here always."""
        return np.ones(len(self.cameras), np.bool_)

    def recording_row(self, entry: int) -> int:
        """Row of its scene's recording that a batch entry decides about next (at the end: the last one)."""
        state = self.state[entry]
        return int(state["row"] - self.starts[state["scene"]]["first"]) + 1

    def true_trajectory(self, scene: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """True x [m], y [m], yaw [rad, unwrapped] ``(steps + 1,)`` of a scene, map frame."""
        rows = self.recordings.rows(scene)
        return rows["truth.x_m"], rows["truth.y_m"], rows["truth.yaw_rad"]

    def _allocate(self, batch: int) -> None:
        """Make the arrays that playing ``batch`` scenes at once changes."""
        self.state = np.zeros(batch, STATE)
        self.history = np.zeros((int(self.steps.max()) if self._keep_trajectories else 0, batch))
        self.compiled = self.state, self._table, self.history, self._context

    def _counting_states(self) -> NDArray[np.int8]:
        """State ``(rows, counting)`` at every step."""
        states = [self.recordings[f"{expert}.state"][self._steps] for expert in self.counting]
        return np.stack(states, axis=-1) if states else np.zeros((len(self._steps), 0), np.int8)

    def _starts_of_scenes(self, previous_rate: FloatArray) -> NDArray[Any]:
        """``(scenes,)`` SCENE: the steps of each scene among all, and the car's state at the first one."""
        offsets, number = self.recordings.offsets, np.arange(len(self.recordings))
        starts = np.zeros(len(number), SCENE)
        starts["first"] = offsets[:-1] - number  # row 0 of each scene is no step
        starts["stop"] = offsets[1:] - number - 1
        starts["course_rad"] = self._start[:, 2] + self._course_offset
        starts["previous_yaw_rate"] = previous_rate[starts["first"]]
        return starts

    def _previous_yaw_rate(self, previous: Previous) -> FloatArray:
        """Recorded previous yaw rate ``(rows,)`` [rad/s].

        Before the first step of a scene there is no previous one: the inertial rate of that first step stands in.
        """
        source = self.table[:, TRUTH if previous == "truth" else SUBSTITUTE] / self.table[:, DT]
        rate = np.concatenate([[0.0], source[:-1]])
        first = self.recordings.offsets[:-1] - np.arange(len(self.recordings))
        rate[first] = self.table[first, SUBSTITUTE] / self.table[first, DT]
        return rate


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """A view that cannot be written; compiled code takes the array itself, whose type it recognises faster."""
    view = array.view()
    view.flags.writeable = False
    return view
