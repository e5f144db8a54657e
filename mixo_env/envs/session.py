"""What the single and the batched environment share: all of it but the shape of what they return."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from mixo_env.envs.actions import ActionRule
from mixo_env.envs.faults import active_faults, read_faults
from mixo_env.envs.observation import PAPER, RICH, Quantity
from mixo_env.envs.opening import prepared
from mixo_env.envs.replay import Replay
from mixo_env.envs.reward import Reward, fit_linear
from mixo_env.envs.settings import Settings
from mixo_env.envs.stepping import REPORT, RULES, TRUTH, step
from mixo_env.envs.tables import choose_experts
from mixo_env.errors import ConfigurationError, RecordingError, unknown
from mixo_env.recordings.collection import Recordings

Observation = NDArray[np.float32] | dict[str, NDArray[Any]]

RESET_OPTIONS = ("scene", "reset_mask")


@dataclass(frozen=True)
class Prepared:
    """What sessions of equal settings share: the scenes to play, those to train on, and a replay nobody plays.

    ``faults``: expert -> names of its faults in every row of the recordings, see ``active_faults``.
    """

    recordings: Recordings
    training: Recordings
    replay: Replay
    faults: dict[str, NDArray[np.object_]]


class Session:
    """A batch of scenes being played under one set of options.

    Attributes:
        settings: the options.
        recordings: the scenes that can be played.
        replay: the fusion core.
        rule: actions -> weights.
        reward: errors -> reward terms.
        terms: names of the rows of a step's report after REPORT.
        observation_space: of one environment.
        images: of the cameras, if a ``dataroot`` was given.
    """

    switchable: ClassVar[bool] = False
    """Whether an action ends with a switch for every camera."""
    replay_class: ClassVar[type[Replay]] = Replay
    rich: ClassVar[tuple[Quantity, ...]] = RICH
    """What ``observation="rich"`` shows."""
    own_terms: ClassVar[tuple[str, ...]] = ()
    """Rows of a step's report after the reward's."""

    def __init__(self, settings: Settings, batch: int, *, keep_trajectories: bool = True) -> None:
        """Open the recordings and build the core for ``batch`` environments; rendering needs the trajectories."""
        self.settings = settings
        self._prepared = prepared(settings.key and (type(self), settings.key), self._prepare)
        self.recordings = self._prepared.recordings
        self.replay = self._prepared.replay.another(batch, keep_trajectories=keep_trajectories)
        self.switches = len(self.replay.cameras) if self.switchable else 0
        self.rule = ActionRule(settings.weights, len(self.replay.experts), settings.raw_scale, self.switches)
        self.reward = Reward(settings.reward, settings.track, self.recordings.manifest)
        self.terms = (*self.reward.terms, *self.own_terms)
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
        self._weights = np.zeros((batch, len(self.replay.experts)))
        self._names = np.array([scene.name for scene in self.recordings.scenes], dtype=object)
        self._next = 0
        self._keep_trajectories = keep_trajectories
        self._rules = self._compiled_rules()
        self._flat = isinstance(self.observation_space, spaces.Box)
        self._report_shape = len(REPORT) + len(self.terms), batch
        self._flat_shape = batch, layout.width

    @property
    def weights(self) -> NDArray[np.float64]:
        """``(batch, experts)`` of the last step, zero before a scene's first; only with ``keep_trajectories``."""
        # Asked of the replay, not remembered: whoever restarts a scene there leaves no weights of the old one here.
        return np.where(self.replay.state["step"][:, None] > 0, self._weights, 0.0)

    def rewind(self) -> None:
        """Let ``order="fixed"`` begin again with the first scene."""
        self._next = 0

    def asked(self, options: dict[str, Any] | None, count: int) -> NDArray[np.int64] | None:
        """The scenes ``(count,)`` that a reset's ``options`` name, as indices; None if they name none.

        Raises:
            ConfigurationError: for anything but the name of a scene that is played, or ``count`` of them.
        """
        if not isinstance(options, dict | None):
            raise ConfigurationError(f"reset options: expected a dictionary, got {options!r}: e.g. {{'scene': name}}")
        for option in options or ():
            if option not in RESET_OPTIONS:
                raise ConfigurationError(unknown("reset option", option, RESET_OPTIONS))
        asked = (options or {}).get("scene")
        if asked is None:
            return None
        names = list(asked) if isinstance(asked, Sequence | np.ndarray) and not isinstance(asked, str) else [asked]
        names *= count if isinstance(asked, str) else 1
        if len(names) != count or not all(isinstance(name, str) for name in names):
            raise ConfigurationError(f"scene: expected one name or {count}, got {asked!r}: one per environment reset")
        return np.array([self._index(name) for name in names], dtype=np.int64)

    def begin(
        self,
        which: NDArray[np.intp],
        rng: np.random.Generator,
        scenes: NDArray[np.int64] | None = None,
        *,
        pause: bool = False,
    ) -> None:
        """Start ``scenes`` in the batch entries ``which``, by default the next by ``order``.

        With ``pause`` they sit out the coming step.
        """
        if scenes is not None:
            pass
        elif self.settings.order == "fixed":
            scenes = (self._next + np.arange(len(which))) % len(self.recordings)
            self._next = int(self._next + len(which)) % len(self.recordings)
        else:
            scenes = rng.integers(len(self.recordings), size=len(which))
        self.replay.restart(which, scenes, pause=pause)

    def step(self, actions: NDArray[np.float32]) -> tuple[Observation, NDArray[np.float64], int]:
        """One step of every scene that has not ended and is not paused.

        Args:
            actions: ``(batch, width)`` as :meth:`ActionRule.read` returns them.

        Returns:
            The next observation; the report ``(rows, batch)``, rows named by REPORT and the reward's terms; how many
            scenes have ended.

        Raises:
            ConfigurationError: for NaN and for numbers out of range; nothing has changed then.
        """
        voting = self.replay.voting if self._keep_trajectories else None
        report = np.empty(self._report_shape)
        flat = np.empty(self._flat_shape, np.float32)
        ended = step(actions, report, flat, self._rules, *self.replay.compiled)
        if ended < 0:
            self.rule.complain(actions)
        if voting is not None:
            self._weights = self.rule.weights(actions, voting)
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
        return self._build_replay(self._prepared.training).context

    def image_paths(self, entry: int) -> dict[str, Path | None]:
        """Image of each camera that closes the step a batch entry decides about next; empty without ``dataroot``."""
        if self.images is None:
            return {}
        return self.images.paths(int(self.replay.state["scene"][entry]), self.replay.recording_row(entry))

    @property
    def faulty(self) -> bool:
        """Whether anybody has a fault in any scene."""
        return bool(self._prepared.faults)

    def faults(self) -> dict[str, NDArray[np.object_]]:
        """Expert -> ``(batch,)`` names of its faults in the step to be decided next; only experts that ever fail."""
        if not self._prepared.faults:
            return {}
        state, replay = self.replay.state, self.replay
        scene = state["scene"]
        rows = self.recordings.offsets[scene] + state["row"] - replay.starts["first"][scene] + 1
        return {expert: names[rows] for expert, names in self._prepared.faults.items()}

    def _prepare(self) -> Prepared:
        settings = self.settings
        recordings, training = settings.open()
        voters = recordings.voters(settings.track)
        for expert in choose_experts(recordings, settings.track, settings.experts):
            if expert not in voters:
                raise ConfigurationError(unknown(f"expert of track {settings.track}", expert, voters))
        linear = fit_linear(self._build_replay(training)) if settings.reward == "improvement" else None
        replay = self._build_replay(recordings, linear)
        if len(replay.experts) < 2 and settings.experts is not None:
            raise ConfigurationError(f"experts: expected two or more, got {replay.experts}: nothing to mix")
        if not np.isfinite(replay.table[:, TRUTH]).all():
            raise RecordingError("these recordings lack ground truth in some steps: an environment needs it to reward")
        faults = active_faults(recordings, read_faults(settings.faults), replay.experts)
        return Prepared(recordings, training, replay, faults)

    def _build_replay(self, recordings: Recordings, linear: NDArray[np.float64] | None = None) -> Replay:
        s = self.settings
        return self.replay_class(
            recordings,
            track=s.track,
            experts=s.experts,
            previous=s.previous,
            lost=s.lost,
            privileged=s.privileged,
            quantities=PAPER if s.observation in ("paper", "pixels") else self.rich,
            linear=linear,
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

    def _compiled_rules(self) -> NDArray[Any]:
        """The options as :func:`~mixo_env.envs.stepping.step` reads them."""
        replay, rule, reward = self.replay, self.rule, self.reward
        rules = np.zeros(1, RULES)
        rules[0] = (
            *(rule.scale, rule.exponential, rule.shares),
            *(replay.mask, replay.fused, replay.rate_limit),
            *(reward.code, reward.scale_rad),
        )
        return rules

    def _index(self, name: str) -> int:
        """Position of a scene by name; one that exists but is not played says where it is."""
        here = [scene.name for scene in self.recordings.scenes]
        if name in here:
            return here.index(name)
        settings = self.settings
        for scene in settings.all_recordings().scenes:
            if scene.name == name:
                raise ConfigurationError(
                    f"scene {name!r} is in fold {scene.fold} and shows {', '.join(scene.conditions)}: it is not among "
                    f"the scenes of split={settings.split!r}, fold={settings.fold}, conditions={settings.conditions}; "
                    "split='all' plays every fold, split='ood' fold -1"
                )
        raise ConfigurationError(unknown("scene", name, here))
