"""Cross-validation with folds by log: what a policy learned never comes from a drive on which it is scored."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, PolicyError, unknown
from mixo_env.leaderboard.evaluation import FLOORS, Travel, rollout, with_wheels
from mixo_env.leaderboard.weights import UNFOLDED, fit_or_take, holds, part
from mixo_env.policies.fitting import drives, prepare
from mixo_env.policies.outside import make_policy
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import POLICIES, create, kind
from mixo_env.policies.reinforcement import AGENTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.complete import check_complete
from mixo_env.recordings.drives import drive_hash
from mixo_env.recordings.folds import OUT_OF_DISTRIBUTION
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.truths import truths_of, with_truth
from mixo_env.recordings.variants import as_variant, variants
from mixo_env.recordings.vehicles import with_held_out_constants, with_training_constants

GroundTruth = Literal["poses", "keyframes"]
"""One step from image to image, or from key frame to key frame (2 Hz) as in the paper."""

NOT_FITTED = (
    "slow to fit, and no weights at hand are of this run: name it in --policies, or fit it with `mixo train` and give "
    "--weights"
)
"""Why an agent has no row where nobody asked for it."""


@dataclass(frozen=True)
class Trial:
    """How policies are tried, whatever the scenes.

    Attributes:
        seed: of every learned policy and of the bootstrap.
        seeds: of every learned policy; its row is the mean of their errors.
        ground_truth: the clock.
        outside: further policies, name -> class, or one that is played as it is.
        weights: folder written by ``mixo train``: what it holds is not fitted again. ``None``: everything is fitted.
        curves: folder for TensorBoard of rows that Stable-Baselines3 trains, on the held-out fold; ``None``: none.

    Raises:
        ConfigurationError: for no seed at all, or weights that are no folder.
    """

    seed: int = 0
    seeds: int = 1
    ground_truth: GroundTruth = "poses"
    outside: Mapping[str, type[Policy] | Policy] = field(default_factory=dict, hash=False)
    weights: Path | None = None
    curves: Path | None = None

    def __post_init__(self) -> None:
        """Look at the number of seeds and at the folder."""
        if self.seeds < 1:
            raise ConfigurationError(f"seeds: expected 1 or more, got {self.seeds}")
        if self.weights is not None and not self.weights.is_dir():
            raise ConfigurationError(f"expected a folder of weights, got {self.weights}: write one with `mixo train`")


@dataclass(frozen=True)
class Run:
    """One row of the leaderboard before scoring.

    Attributes:
        name: of the policy or floor.
        privileged: it reads ground truth.
        learns: it was fitted on training scenes.
        travels: truth -> travels over all scenes, one a seed; without any turn in scenes not tested. A privileged row
            chooses by the truth that scores it, others move the same whatever the truth.
        tested: ``(scenes,)``.
        policies: the fitted policy of the first seed for every fold it was tested on; empty for floors.
    """

    name: str
    privileged: bool
    learns: bool
    travels: Mapping[str, tuple[Travel, ...]]
    tested: NDArray[np.bool_]
    policies: dict[int, Policy]

    @property
    def travel(self) -> Travel:
        """That of the first seed, as the headline's truth has it."""
        return next(iter(self.travels.values()))[0]


USUAL = Trial()
"""One seed, from image to image, nothing from outside."""


class CrossValidation:
    """How the scenes of a recording are divided into training and test.

    Scenes outside every fold (night) are left out, or are the only ones tested, by policies that learned from all folds
    (``out_of_distribution``). With fewer than two folds there is nothing to train on that is not tested as well:
    learned policies then come from the bundled recordings, and wheel scale and course offset of the vehicles stay
    nominal; their pose lag comes from their other logs.

    Attributes:
        recordings: the scenes that are scored, with vehicle constants fitted on the folds that hold none of them, and
            true poses without the lag among those constants.
        folds: those present.
        tested_folds: those of them that are scored.
        out_of_distribution: the tested scenes are in no fold.
        left_out: number of scenes that are not scored.
        foreign: learned policies are fitted on the bundled recordings.
        truths: those of the recordings, the headline first.
        trial: how policies are tried.
    """

    def __init__(
        self,
        recordings: Recordings,
        trial: Trial = USUAL,
        *,
        out_of_distribution: bool = False,
        tested_folds: Sequence[int] = (),
        bundled: Callable[[], Recordings] = load_recordings,
    ) -> None:
        """Divide ``recordings``; when nothing is in a fold, all scenes are scored.

        ``tested_folds`` are scored, empty: all.

        Raises:
            ConfigurationError: for an unknown fold, or when no scene is out of distribution and these are asked for.
            RecordingError: where a true pose, a speed or a distance is missing.
        """
        check_complete(recordings)
        self.folds: tuple[int, ...] = tuple(sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0}))
        for fold in tested_folds:
            if fold not in self.folds:
                raise ConfigurationError(unknown("fold", fold, map(str, self.folds)))
        self.tested_folds: tuple[int, ...] = tuple(sorted(set(tested_folds))) or self.folds
        self.foreign = len(self.folds) < 2
        self.trial = trial
        self._inside = recordings.select(folds=self.folds) if self.folds else recordings
        self.out_of_distribution = out_of_distribution
        tested = recordings.select(folds=[OUT_OF_DISTRIBUTION]) if out_of_distribution else self._inside
        if tested_folds:
            tested = self._inside.select(folds=self.tested_folds)
        self._tested = tested
        # Constants of what is tested come from other folds, so all folds take part before the tested are taken out.
        prepared = self._at_clock(self._with_constants(recordings))
        self.recordings = prepared.select(scenes=[scene.name for scene in tested.scenes])
        self.left_out = len(recordings) - len(tested)
        self.truths = truths_of(self.recordings)
        self._bundled = bundled
        self._training: dict[int, Recordings] = {}

    def __getstate__(self) -> dict[str, Any]:
        """Policies from outside stay in their process: what they hold may not be sent to another."""
        return self.__dict__ | {"trial": replace(self.trial, outside={})}

    def _with_constants(self, recordings: Recordings) -> Recordings:
        if self.out_of_distribution and not self.foreign:  # what is tested is in no fold: one fit, on all of them
            return with_training_constants(recordings, self.folds)
        return with_held_out_constants(recordings if self.out_of_distribution else self._inside)

    def training(self, fold: int) -> Recordings:
        """The scenes a learned policy is fitted on before it is tested on ``fold``.

        Their vehicle constants are fitted on them alone: those they are scored with may have seen ``fold``,
        and the pose lag would carry a little of its truth into the targets.

        Raises:
            ConfigurationError: for a fold that holds no scene.
            PolicyError: if there is no scene that is not tested.
        """
        if fold != UNFOLDED and fold not in self.folds:
            raise ConfigurationError(unknown("fold", fold, map(str, self.folds)))
        if fold not in self._training:
            if self.foreign:
                training = self._foreign_scenes()
            else:
                others = [other for other in self.folds if self.out_of_distribution or other != fold]
                training = with_training_constants(self._inside.select(folds=others), others)
            self._training[fold] = self._at_clock(training)
        return self._training[fold]

    def expensive(self, name: str) -> bool:
        """Whether a class says that it is too slow to fit for every fold; one that cannot be imported does not."""
        return self._says(name, "expensive")

    def slow(self, name: str) -> bool:
        """Whether a row takes far longer to fit than all others: an agent trained by reinforcement, or expensive."""
        return self.expensive(name) or name in AGENTS

    def learns(self, name: str) -> bool:
        """Whether a row is fitted; one that cannot be imported is not."""
        return self._says(name, "learns")

    def strange(self, name: str) -> bool:
        """Whether a row is no policy of this package, but from outside or a plug-in."""
        ours = (*FLOORS, *POLICIES, *variants(self.recordings), *self.recordings.experts)
        return name in self.trial.outside or name not in ours

    def _says(self, name: str, trait: Literal["expensive", "learns"]) -> bool:
        try:
            return name not in FLOORS and bool(getattr(self._kind(name), trait))
        except PolicyError:
            return False

    def _kind(self, name: str) -> type[Policy] | Policy:
        outside = self.trial.outside
        return outside[name] if name in outside else kind(name, self.recordings)

    def _create(self, name: str) -> Policy:
        if name not in self.trial.outside:
            return create(name, self.recordings)
        given = self.trial.outside[name]
        return make_policy(given) if isinstance(given, type) else given

    def run(self, name: str, track: str, *, folds: Sequence[int] | None = None) -> Run:
        """Fit, where there is something to learn, and play through every test scene.

        Args:
            name: of a policy or of a floor.
            track: whose experts vote.
            folds: test a learned policy on these folds only; ``None``: on all.

        Raises:
            ConfigurationError: for an unknown name.
            PolicyError: when a policy does not fit these recordings.
        """
        everything = np.ones(len(self.recordings), dtype=np.bool_)
        if name in FLOORS:
            travels = {truth: (FLOORS[name](with_truth(self.recordings, truth)),) for truth in self.truths}
            return Run(name, True, False, travels, everything, {})
        policy = self._create(name)
        # Asked once: what is shown to a policy and what the table says of it must be the same.
        learns, privileged = bool(policy.learns), bool(policy.privileged)
        if learns:
            return self._run_learned(name, track, folds, privileged)
        recordings = as_variant(self.recordings, name)
        policy.start(recordings.voters(track))
        return Run(name, privileged, False, self._play(policy, recordings, track, privileged), everything, {-1: policy})

    def _run_learned(self, name: str, track: str, folds: Sequence[int] | None, privileged: bool) -> Run:
        """Freshly fitted policies per fold, each tested on the scenes it has not seen."""
        self._check_trainable(name, track)
        entries = self.recordings.scenes
        whole = self.foreign or self.out_of_distribution
        tested_folds = self._held_out(folds)
        tested = np.array([whole or scene.fold in tested_folds for scene in entries])
        scene_of_row = np.repeat(np.arange(len(entries)), np.diff(self.recordings.offsets))
        increments = {truth: np.zeros((self.trial.seeds, self.recordings.offsets[-1])) for truth in self.truths}
        policies: dict[int, Policy] = {}
        for fold in tested_folds:
            here = np.array([whole or scene.fold == fold for scene in entries])
            scenes = self.recordings.select(scenes=[entries[i].name for i in np.flatnonzero(here)])
            for k in range(self.trial.seeds):
                policy = self.fitted(name, track, fold, k)
                policies.setdefault(fold, policy)
                for truth, (travel,) in self._play(policy, scenes, track, privileged).items():
                    increments[truth][k, here[scene_of_row]] = travel.yaw_increment_rad
        travels = {
            truth: tuple(with_wheels(self.recordings, of_seed) for of_seed in values)
            for truth, values in increments.items()
        }
        return Run(name, privileged, True, travels, tested, policies)

    def _held_out(self, folds: Sequence[int] | None) -> tuple[int, ...]:
        """The folds for each of which a learned policy is fitted, if ``folds`` are to be tested."""
        whole = self.foreign or self.out_of_distribution
        return (UNFOLDED,) if whole else self.tested_folds if folds is None else tuple(folds)

    def _check_trainable(self, name: str, track: str) -> None:
        if self.foreign and not self._bundled_experts(track):
            raise PolicyError(
                f"{name} learns, and needs drives that are not tested: these recordings have fewer than two folds, and "
                "no bundled recording has their experts"
            )

    def check_fitted(self, name: str, track: str, folds: Sequence[int] | None) -> None:
        """Look whether :meth:`run` would take all weights of a row that learns and fit none.

        Raises:
            PolicyError: when it would not, or there is nothing to learn from.
        """
        self._check_trainable(name, track)
        weights = None if name in self.trial.outside else self.trial.weights
        for fold in self._held_out(folds):
            for k in range(self.trial.seeds):
                policy, training, seed = self._create(name), self.training(fold), self._seed_of(fold, k)
                if weights is None or not holds(weights / part(name, track, fold, k), policy, training, track, seed):
                    raise PolicyError(NOT_FITTED)

    def fitted(self, name: str, track: str, fold: int, repetition: int, *, keep: bool = False) -> Policy:
        """A row fitted without ``fold``, or taken from the folder of weights where it holds just that.

        Args:
            name: of a row that learns.
            track: whose experts vote.
            fold: held out.
            repetition: which of the trial's seeds.
            keep: write it into the folder of weights.

        Raises:
            PolicyError: when it does not fit these recordings, or its piece is damaged.
            OutputError: when it cannot be written.
        """
        policy, training, seed = self._create(name), self.training(fold), self._seed_of(fold, repetition)
        place = part(name, track, fold, repetition)
        if self.trial.curves is not None and fold != UNFOLDED:
            from mixo_env.leaderboard.curves import watch

            watch(policy, self.trial.curves / place, self.recordings.select(folds=[fold]), track)
        if self.trial.weights is None or name in self.trial.outside:
            prepare(policy, training, track, seed=seed)
            return policy
        return fit_or_take(policy, training, track, seed, self.trial.weights / place, keep=keep)

    def pieces(self, names: Sequence[str], tracks: Sequence[str]) -> tuple[tuple[str, str, int, int], ...]:
        """Name, track, fold and repetition of all that is fitted for these rows.

        Every fold is held out in turn, then none, for night and other recordings; of an expensive row the last alone.

        Raises:
            PolicyError: with fewer than two folds.
        """
        if self.foreign:
            raise PolicyError("expected recordings with two folds or more to train on, got fewer: give such recordings")
        return tuple(
            (name, track, fold, k)
            for name in names
            if name not in FLOORS and self._kind(name).learns
            for track in tracks
            if self._kind(name).only_track in ("", track)
            for fold in (self.folds[-1:] if self.expensive(name) else (*self.folds, UNFOLDED))
            for k in range(self.trial.seeds)
        )

    def _play(self, policy: Policy, scenes: Recordings, track: str, privileged: bool) -> dict[str, tuple[Travel]]:
        """Its travel for every truth; a policy that does not read it is played once."""
        if privileged:
            return {
                truth: (rollout(policy, with_truth(scenes, truth), track, privileged=True),) for truth in self.truths
            }
        return dict.fromkeys(self.truths, (rollout(policy, scenes, track),))

    def _bundled_experts(self, track: str) -> bool:
        """Whether the same experts vote in a track of the bundled recordings."""
        bundled = self._bundled()
        return track in bundled.tracks and bundled.voters(track) == self.recordings.voters(track)

    def _foreign_scenes(self) -> Recordings:
        """Bundled scenes whose drives are not tested."""
        bundled, tested = self._bundled(), drives(self._tested)
        names = [
            scene.name
            for i, scene in enumerate(bundled.scenes)
            if scene.fold >= 0 and drive_hash(bundled, i) not in tested
        ]
        if not names:
            raise PolicyError("expected training scenes that are not tested, found none: give recordings with 2 folds")
        chosen = bundled.select(scenes=names)
        return with_training_constants(chosen, {scene.fold for scene in chosen.scenes})

    def _at_clock(self, recordings: Recordings) -> Recordings:
        """Recordings as policies and scores see them: poses without their lag, at the chosen clock."""
        corrected = lag_corrected(recordings)
        return at_keyframes(corrected) if self.trial.ground_truth == "keyframes" else corrected

    def _seed_of(self, fold: int, repetition: int) -> int:
        parts = [self.trial.seed, fold + 1] + ([repetition] if repetition else [])
        return int(np.random.SeedSequence(parts).generate_state(1)[0])
