"""What the single and the batched environment share: all of it but the shape of what they return."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mixo_env.envs.actions import ActionRule
from mixo_env.envs.observation import PAPER, RICH, Quantity
from mixo_env.envs.replay import Replay
from mixo_env.envs.reward import Reward
from mixo_env.envs.settings import Settings
from mixo_env.envs.stepping import REPORT, RULES, TRUTH, play
from mixo_env.errors import ConfigurationError, RecordingError, unknown
from mixo_env.recordings.collection import Recordings

Observation = NDArray[np.float32] | dict[str, NDArray[Any]]

RESET_OPTIONS = ("scene", "reset_mask")


class Session:
    """A batch of scenes being played under one set of options.

    Attributes:
        settings: the options.
        recordings: the scenes that can be played.
        replay: the fusion core.
        rule: actions -> weights.
        reward: errors -> reward terms.
        observation_space: of one environment.
        images: of the cameras, if a ``dataroot`` was given.
        weights: ``(batch, experts)`` of the last step; kept up to date only where trajectories are kept.
    """

    switchable: ClassVar[bool] = False
    """Whether an action ends with a switch for every camera."""
    replay_class: ClassVar[type[Replay]] = Replay
    rich: ClassVar[tuple[Quantity, ...]] = RICH
    """What ``observation="rich"`` shows."""

    def __init__(self, settings: Settings, batch: int, *, keep_trajectories: bool = True) -> None:
        """Open the recordings and build the core for ``batch`` environments; rendering needs the trajectories."""
        self.settings = settings
        self.recordings, self._training = settings.open()
        self.replay = self._build_replay(self.recordings, keep_trajectories)
        voters = self.recordings.voters(settings.track)
        for expert in self.replay.experts:
            if expert not in voters:
                raise ConfigurationError(unknown(f"expert of track {settings.track}", expert, voters))
        if len(self.replay.experts) < 2:
            raise ConfigurationError(f"experts: expected two or more, got {self.replay.experts}: nothing to mix")
        if not np.isfinite(self.replay.table[:, TRUTH]).all():
            raise RecordingError("these recordings lack ground truth in some steps: an environment needs it to reward")
        self.switches = len(self.replay.cameras) if self.switchable else 0
        self.rule = ActionRule(settings.weights, len(self.replay.experts), settings.raw_scale, self.switches)
        self.reward = Reward(settings.reward, self.replay, settings.track, self._training)
        layout = self.replay.layout
        self._named_parts = settings.observation == "dict"
        self.observation_space: spaces.Space[Any] = layout.dict() if self._named_parts else layout.box()
        self.images = None
        if settings.dataroot is not None:
            from mixo_env.envs.images import THUMBNAIL, SceneImages

            self.images = SceneImages(self.recordings, settings.dataroot, self.replay.cameras)
            if settings.observation == "pixels":
                picture = spaces.Box(0, 255, THUMBNAIL, dtype=np.uint8)
                pictures = dict.fromkeys(self.replay.cameras, picture)
                self.observation_space = spaces.Dict({"state": layout.box(), **pictures})
        self.weights = np.zeros((batch, len(self.replay.experts)))
        self._names = np.array([scene.name for scene in self.recordings.scenes], dtype=object)
        self._next = 0
        self._keep_trajectories = keep_trajectories
        self.replay.reset(np.zeros(batch, np.int64))
        self._game = self._compiled_arguments()
        self._flat = isinstance(self.observation_space, spaces.Box)
        self._report_shape = len(REPORT) + len(self.reward.terms), batch
        self._flat_shape = batch, layout.width

    def rewind(self) -> None:
        """Let ``order="fixed"`` begin again with the first scene."""
        self._next = 0

    def begin(
        self,
        which: NDArray[np.intp],
        rng: np.random.Generator,
        options: dict[str, Any] | None = None,
        *,
        pause: bool = False,
    ) -> None:
        """Start scenes in the batch entries ``which``: those named in ``options``, else the next by ``order``.

        With ``pause`` they sit out the coming step.
        """
        for option in options or ():
            if option not in RESET_OPTIONS:
                raise ConfigurationError(unknown("reset option", option, RESET_OPTIONS))
        asked = (options or {}).get("scene")
        if asked is not None:
            scenes = self._named(asked, len(which))
        elif self.settings.order == "fixed":
            scenes = (self._next + np.arange(len(which))) % len(self.recordings)
            self._next = int(self._next + len(which)) % len(self.recordings)
        else:
            scenes = rng.integers(len(self.recordings), size=len(which))
        self.replay.restart(which, scenes, pause=pause)
        if self._keep_trajectories:
            self.weights[which] = 0.0

    def play(self, actions: NDArray[np.float32]) -> tuple[Observation, NDArray[np.float64], int]:
        """One step of every scene that has not ended and is not paused.

        Args:
            actions: ``(batch, width)`` as :meth:`ActionRule.read` returns them.

        Returns:
            The next observation; the report ``(rows, batch)``, rows named by REPORT and the reward's terms; how many
            scenes have ended.

        Raises:
            ConfigurationError: for NaN and for numbers out of range; nothing has changed then.
        """
        if self._keep_trajectories:
            self.weights = self.rule.weights(actions, self.replay.voting)
        report = np.empty(self._report_shape)
        flat = np.empty(self._flat_shape, np.float32)
        ended = play(actions, report, flat, *self._game)
        if ended < 0:
            self.rule.complain(actions)
        if self.switches:
            self._switch(actions, report, flat)
        return (flat if self._flat else self._dressed(flat)), report, ended

    def observe(self) -> Observation:
        """The batch's observation: ``(batch, width)``, or name -> ``(batch, width)``."""
        return self._dressed(self.replay.observe_flat())

    def scene_names(self, mask: NDArray[np.bool_]) -> NDArray[Any]:
        """Names ``(batch,)`` of the scenes being played where ``mask`` is True, None elsewhere."""
        names = np.full(len(mask), None, dtype=object)
        which = np.flatnonzero(mask)
        names[which] = self._names[self.replay.state["scene"][which]]
        return names

    def training_observations(self) -> NDArray[np.float32]:
        """Flat observations ``(rows, width)`` of the training scenes, whatever is played; previous rates inertial."""
        return self._build_replay(self._training, keep_trajectories=False).context

    def image_paths(self, entry: int) -> dict[str, Path | None]:
        """Image of each camera that closes the step a batch entry decides about next; empty without ``dataroot``."""
        if self.images is None:
            return {}
        return self.images.paths(int(self.replay.state["scene"][entry]), self.replay.recording_row(entry))

    def _build_replay(self, recordings: Recordings, keep_trajectories: bool) -> Replay:
        s = self.settings
        return self.replay_class(
            recordings,
            track=s.track,
            experts=s.experts,
            previous=s.previous,
            lost=s.lost,
            privileged=s.privileged,
            quantities=PAPER if s.observation in ("paper", "pixels") else self.rich,
            keep_trajectories=keep_trajectories,
        )

    def _switch(self, actions: NDArray[np.float32], report: NDArray[np.float64], flat: NDArray[np.float32]) -> None:
        """What the numbers of ``actions`` beyond the weights do, in environments that have ``switches``."""

    def _dressed(self, flat: NDArray[np.float32]) -> Observation:
        if self._named_parts:
            return self.replay.layout.split(flat)
        if self.images is not None and self.settings.observation == "pixels":
            read = self.images.read
            paths = [self.image_paths(entry) for entry in range(len(flat))]
            return {"state": flat, **{camera: np.stack([read(p[camera]) for p in paths]) for camera in paths[0]}}
        return flat

    def _compiled_arguments(self) -> tuple[NDArray[Any], ...]:
        """What :func:`~mixo_env.envs.stepping.play` takes besides the arrays that are fresh in every step."""
        replay, rule, reward = self.replay, self.rule, self.reward
        rules = np.zeros(1, RULES)
        rules[0] = (
            *(rule.scale, rule.exponential, rule.shares),
            *(replay.mask, replay.fused, replay.rate_limit),
            *(reward.code, reward.scale_rad),
        )
        return rules, replay.state, replay.table, replay.history, replay.context

    def _named(self, asked: str | Sequence[str], count: int) -> NDArray[np.int64]:
        names = [asked] * count if isinstance(asked, str) else list(asked)
        if len(names) != count:
            raise ConfigurationError(
                f"scene: expected one name or {count}, got {len(names)}: one per environment reset"
            )
        return np.array([self.recordings.index(name) for name in names], dtype=np.int64)
