"""Cross-validation with folds by log: what a policy learned never comes from a drive on which it is scored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import PolicyError
from mixo_env.leaderboard.evaluation import FLOORS, Motion, rollout, with_wheels
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.store import load_recordings
from mixo_env.recordings.variants import as_variant
from mixo_env.recordings.vehicles import with_held_out_constants, with_training_constants

UNFOLDED = -1
"""Stands for the held-out fold where none is held out."""


@dataclass(frozen=True)
class Run:
    """One row of the leaderboard before scoring.

    Attributes:
        name: of the policy or floor.
        privileged: it reads ground truth.
        learns: it was fitted on training scenes.
        motion: over all scenes; without any turn in those not tested.
        tested: ``(scenes,)``.
        policies: the fitted policy for every fold it was tested on; empty for floors.
    """

    name: str
    privileged: bool
    learns: bool
    motion: Motion
    tested: NDArray[np.bool_]
    policies: dict[int, Policy]


class CrossValidation:
    """How the scenes of a recording are divided into training and test.

    Scenes outside every fold (night) are left out. With fewer than two folds there is nothing to train on that is not
    tested as well: learned policies then come from the bundled recordings, and wheel scale and course offset of the
    vehicles stay nominal; their pose lag comes from their other logs.

    Attributes:
        recordings: the scenes that are scored, with vehicle constants fitted on the folds that hold none of them, and
            true poses without the lag among those constants.
        folds: those present.
        left_out: number of scenes in no fold.
        foreign: learned policies are fitted on the bundled recordings.
    """

    def __init__(
        self, recordings: Recordings, *, seed: int = 0, bundled: Callable[[], Recordings] = load_recordings
    ) -> None:
        """Divide ``recordings``; when nothing is in a fold, all scenes are scored."""
        self.folds: tuple[int, ...] = tuple(sorted({scene.fold for scene in recordings.scenes if scene.fold >= 0}))
        inside = recordings.select(folds=self.folds) if self.folds else recordings
        self.recordings = lag_corrected(with_held_out_constants(inside))
        self._inside = inside
        self._training: dict[int, Recordings] = {}
        self.left_out = len(recordings) - len(inside)
        self.foreign = len(self.folds) < 2
        self.seed = seed
        self._bundled = bundled

    def training(self, fold: int) -> Recordings:
        """The scenes a learned policy is fitted on before it is tested on ``fold``.

        Their vehicle constants are fitted on them alone: those they are scored with may have seen ``fold``, and the
        pose lag would carry a little of its truth into the targets.
        """
        if fold not in self._training:
            self._training[fold] = self._foreign_training() if self.foreign else self._own_training(fold)
        return self._training[fold]

    def _own_training(self, fold: int) -> Recordings:
        others = [other for other in self.folds if other != fold]
        return lag_corrected(with_training_constants(self._inside.select(folds=others), others))

    def _foreign_training(self) -> Recordings:
        bundled = lag_corrected(self._bundled())
        tested = {scene.values_hash for scene in self.recordings.scenes}
        names = [scene.name for scene in bundled.scenes if scene.fold >= 0 and scene.values_hash not in tested]
        if not names:
            raise PolicyError("expected training scenes that are not tested, found none: give recordings with 2 folds")
        return bundled.select(scenes=names)

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
            return Run(name, True, False, FLOORS[name](self.recordings), everything, {})
        policy = create(name, self.recordings)
        if not policy.learns:
            recordings = as_variant(self.recordings, name)
            policy.fit(recordings, track, seed=self.seed)
            motion = rollout(policy, recordings, track)
            return Run(name, policy.privileged, False, motion, everything, {UNFOLDED: policy})
        return self._run_learned(name, track, folds)

    def _run_learned(self, name: str, track: str, folds: Sequence[int] | None) -> Run:
        """One freshly fitted policy per fold, each tested on the scenes it has not seen."""
        entries = self.recordings.scenes
        increments = np.zeros(self.recordings.offsets[-1])
        scene_of_row = np.repeat(np.arange(len(entries)), np.diff(self.recordings.offsets))
        tested = np.zeros(len(entries), dtype=np.bool_)
        policies: dict[int, Policy] = {}
        for fold in (UNFOLDED,) if self.foreign else self.folds if folds is None else folds:
            policy = policies[fold] = create(name, self.recordings)
            seed = int(np.random.SeedSequence([self.seed, fold + 1]).generate_state(1)[0])
            policy.fit(self.training(fold), track, seed=seed)
            here = np.array([self.foreign or scene.fold == fold for scene in entries])
            scenes = self.recordings.select(scenes=[entries[i].name for i in np.flatnonzero(here)])
            increments[here[scene_of_row]] = rollout(policy, scenes, track).yaw_increment_rad
            tested |= here
        privileged = any(policy.privileged for policy in policies.values())
        return Run(name, privileged, True, with_wheels(self.recordings, increments), tested, policies)
