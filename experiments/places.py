"""Places where a row may be played that was fitted in another: other drives, clocks, rigs, and real odometries."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from mixo_env.errors import ConfigurationError, unknown
from mixo_env.experts.expert import State
from mixo_env.leaderboard.crossvalidation import CrossValidation, Run
from mixo_env.leaderboard.evaluation import rollout, with_wheels
from mixo_env.leaderboard.weights import UNFOLDED
from mixo_env.policies.fitting import prepare
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.keyframes import at_keyframes
from mixo_env.recordings.truths import truths_of, with_truth

Change = Callable[[Recordings], Recordings]


@dataclass(frozen=True)
class Place:
    """Where rows are played.

    Attributes:
        name: as printed.
        division: its scenes, with vehicle constants from the other logs.
        change: made to what is played there, and to what is fitted there; not to what rows were fitted on before.
        own: these are the drives that rows were fitted on: each scene is played by a fit without its fold.
    """

    name: str
    division: CrossValidation
    change: Change = lambda recordings: recordings
    own: bool = False

    def tested(self) -> Recordings:
        """What is played, with the headline's truth in the place of the others."""
        changed = self.change(self.division.recordings)
        return with_truth(changed, truths_of(changed)[0])

    def brought(self, name: str, home: CrossValidation, tested: Recordings, track: str) -> Run:
        """The run of a row that was fitted at home.

        Raises:
            PolicyError: when it cannot play with the experts that are here.
        """
        voters = tested.voters(track)

        def policy_of(fold: int) -> Policy:
            policy = home.fitted(name, track, fold, 0)
            if policy.any_experts or not policy.learns:
                policy.start(voters)
            return policy

        return self._run(name, policy_of, self.own, tested, track)

    def at_home_here(self, name: str, shown: str, tested: Recordings, track: str) -> Run:
        """The run of a row that is fitted here, by cross-validation over logs."""

        def policy_of(fold: int) -> Policy:
            policy = create(name, self.division.recordings)
            prepare(policy, self.change(self.division.training(fold)), track, seed=self.division.trial.seed)
            return policy

        return self._run(shown, policy_of, True, tested, track)

    def _run(
        self, shown: str, policy_of: Callable[[int], Policy], by_fold: bool, tested: Recordings, track: str
    ) -> Run:
        increments = np.zeros(tested.offsets[-1])
        scene_of_row = np.repeat(np.arange(len(tested)), np.diff(tested.offsets))
        learns = privileged = False
        for fold in self.division.folds if by_fold else (UNFOLDED,):
            here = np.array([not by_fold or scene.fold == fold for scene in tested.scenes])
            policy = policy_of(fold)
            learns, privileged = policy.learns, policy.privileged
            scenes = tested.select(scenes=[tested.scenes[i].name for i in np.flatnonzero(here)])
            travel = rollout(policy, scenes, track, privileged=privileged)
            increments[here[scene_of_row]] = travel.yaw_increment_rad
        everything = np.ones(len(tested), dtype=np.bool_)
        return Run(shown, privileged, learns, {"truth": (with_wheels(tested, increments),)}, everything, {})


def variants_of(place: Place, strides: Sequence[int], cameras: Sequence[str]) -> list[Place]:
    """The place as it is, at slower clocks, and with some cameras alone."""
    step_s = place.division.recordings["dt_s"]
    rate_hz = 1.0 / float(np.median(step_s[step_s > 0.0]))
    places = [replace(place, name=f"{place.name}, {rate_hz:.0f} Hz")]
    places += [
        replace(place, name=f"{place.name}, {rate_hz / stride:.0f} Hz", change=partial(every, stride=stride))
        for stride in strides
    ]
    if cameras:
        name = f"{place.name}, {' and '.join(cameras)} alone"
        places.append(replace(place, name=name, change=partial(alone, cameras=tuple(cameras))))
    return places


def every(recordings: Recordings, *, stride: int) -> Recordings:
    """The recordings with one step from every ``stride``-th image to the next such one."""
    return at_keyframes(recordings.replace(columns={"is_keyframe": recordings["step"] % stride == 0}))


def alone(recordings: Recordings, *, cameras: Sequence[str]) -> Recordings:
    """The recordings as if no other camera ever had an image.

    Raises:
        ConfigurationError: for a camera that is not recorded.
    """
    for name in cameras:
        if name not in recordings.manifest.cameras:
            raise ConfigurationError(unknown("camera", name, recordings.manifest.cameras))
    columns = {}
    for camera in recordings.manifest.cameras:
        if camera not in cameras:
            increment, state = f"{camera}.yaw_increment_rad", f"{camera}.state"
            columns[increment] = np.full_like(recordings[increment], np.nan)
            columns[state] = np.full_like(recordings[state], State.NO_IMAGE)
            for count in ("matches", "inliers"):
                columns[f"{camera}.{count}"] = np.zeros_like(recordings[f"{camera}.{count}"])
    return recordings.replace(columns=columns)
