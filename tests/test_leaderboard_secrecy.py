"""No way leads from what a policy is given to the truth of a tested scene: every cheat tried here fails."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from mixo_env.errors import PolicyError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies import registry
from mixo_env.policies.fitting import check, prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.policy import Observation, Policy, Weights
from mixo_env.policies.robust import Mean
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.pose_lag import lag_corrected
from mixo_env.recordings.truths import for_learning
from tests.synthetic import synthetic_recordings

TRACK = "VISION"


def never() -> Recordings:
    raise AssertionError("the bundled recordings must not be opened")


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    """Scenes whose three truths are not the same."""
    drawn = synthetic_recordings(0)
    noise = np.random.default_rng(5).normal(0.0, 1e-3, drawn.offsets[-1])
    return drawn.replace(columns={"exact.yaw_rad": drawn["exact.yaw_rad"] + noise})


def with_other_truth(recordings: Recordings, fold: int) -> Recordings:
    """Every true pose and increment of one fold changed, whatever it is called."""
    held_out = np.repeat([scene.fold == fold for scene in recordings.scenes], np.diff(recordings.offsets))
    columns = {}
    for name in recordings.column_names:
        owner, _, last = name.rpartition(".")
        if owner in ("truth", "exact", "written") or any(word in last for word in ("truth", "exact", "written")):
            columns[name] = recordings[name] + 0.3 * held_out
    return recordings.replace(columns=columns)


def run(monkeypatch: pytest.MonkeyPatch, cheat: type[Policy], recordings: Recordings, **options: Any) -> np.ndarray:
    """Yaw increments of a policy of one's own through the protocol."""
    monkeypatch.setitem(registry.POLICIES, cheat.name, cheat)
    return CrossValidation(recordings, bundled=never).run(cheat.name, TRACK, **options).travel.yaw_increment_rad


class Equal(Policy):
    """What the cheats fall back on: equal weights."""

    name = "EQUAL"
    found: Recordings | None = None

    def act(self, observation: Observation) -> Weights:
        rates = observation["yaw_rates"]
        return np.full(rates.shape, 1.0 / rates.shape[1])


class ReadsInFit(Equal):
    """The twelve lines that once reached 0.0000 deg/m without the dagger."""

    name = "READS IN FIT"

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        super().fit(training, track)
        self.truth = training["truth.yaw_increment_rad"]
        raise AssertionError("fit of a policy that does not learn was called")


class ReadsInWeighted(Equal):
    name = "READS IN WEIGHTED"
    given: ClassVar[list[Any]] = []

    def weighted(self, voters: tuple[str, ...]) -> tuple[str, ...]:
        self.given.append(voters)
        return voters

    def start(self, voters: Any) -> None:
        self.given.append(voters)
        super().start(voters)

    def reset(self, batch: int) -> None:
        self.given.append(batch)


def test_a_policy_that_does_not_learn_is_told_names_and_numbers_only(
    monkeypatch: pytest.MonkeyPatch, recordings: Recordings
) -> None:
    equal = run(monkeypatch, Equal, recordings)
    np.testing.assert_array_equal(run(monkeypatch, ReadsInFit, recordings), equal)
    np.testing.assert_array_equal(run(monkeypatch, ReadsInWeighted, recordings), equal)
    for given in ReadsInWeighted.given:
        assert type(given) is int or all(type(name) is str for name in given)


class KeepsEverything(Equal):
    """A learner that keeps whatever it is given, in every form."""

    name = "KEEPS EVERYTHING"
    learns = True
    kept: ClassVar[list[bytes]] = []
    seen: ClassVar[list[bytes]] = []
    training: ClassVar[list[Recordings]] = []

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        super().fit(training, track)
        columns = {name: training[name] for name in training.column_names}
        self.kept.append(pickle.dumps((columns, asdict(training.manifest), vars(training), track, seed)))
        self.training.append(training)

    def act(self, observation: Observation) -> Weights:
        self.seen.append(pickle.dumps(observation))
        for values in observation.values():
            assert values.base is None
            assert values.flags.owndata
        return super().act(observation)


def test_nothing_given_to_a_learner_depends_on_the_truth_of_the_tested_fold(
    monkeypatch: pytest.MonkeyPatch, recordings: Recordings
) -> None:
    kept, seen = [], []
    for data in (recordings, with_other_truth(recordings, 1)):
        for memory in (KeepsEverything.kept, KeepsEverything.seen, KeepsEverything.training):
            memory.clear()
        run(monkeypatch, KeepsEverything, data, folds=[1])
        kept.append(list(KeepsEverything.kept))
        seen.append(list(KeepsEverything.seen))
    assert len(kept[0]) == 1
    assert len(seen[0]) > 50
    assert kept[0] == kept[1]
    assert seen[0] == seen[1]


def test_training_scenes_are_copies_without_exact_poses_and_without_test_scenes(
    monkeypatch: pytest.MonkeyPatch, recordings: Recordings
) -> None:
    KeepsEverything.training.clear()
    run(monkeypatch, KeepsEverything, recordings, folds=[1])
    (training,) = KeepsEverything.training
    assert not {scene.name for scene in recordings.scenes if scene.fold == 1} & {s.name for s in training.scenes}
    assert not any("exact" in name or "written" in name for name in training.column_names)
    for name in training.column_names:
        assert training[name].base is None
        assert not np.shares_memory(training[name], recordings[name])
    assert training.manifest.parameters == {}


class Vandal(Equal):
    """Writes on everything it can reach."""

    name = "VANDAL"
    learns = True

    def fit(self, training: Recordings, track: str, *, seed: int = 0) -> None:
        super().fit(training, track)
        for name in training.column_names:
            training[name][:] = 0

    def act(self, observation: Observation) -> Weights:
        weights = super().act(observation)
        for values in observation.values():
            values[:] = 0.0
        return weights


def test_writing_on_what_is_given_changes_nothing(monkeypatch: pytest.MonkeyPatch, recordings: Recordings) -> None:
    monkeypatch.setitem(registry.POLICIES, Vandal.name, Vandal)
    monkeypatch.setitem(registry.POLICIES, Equal.name, Equal)
    protocol = CrossValidation(recordings, bundled=never)
    before = protocol.run("LINEAR", TRACK).travel.yaw_increment_rad
    vandal, equal = (protocol.run(name, TRACK).travel.yaw_increment_rad for name in ("VANDAL", "EQUAL"))
    np.testing.assert_array_equal(vandal, equal)
    np.testing.assert_array_equal(protocol.run("LINEAR", TRACK).travel.yaw_increment_rad, before)


class TwoFaced(Equal):
    """Privileged whenever it is asked for the second time."""

    name = "TWO-FACED"
    asked = 0

    @property
    def privileged(self) -> bool:  # type: ignore[override]
        self.asked += 1
        return self.asked > 1

    def act(self, observation: Observation) -> Weights:
        assert "truth_yaw_rate" not in observation
        return super().act(observation)


def test_the_dagger_and_the_truth_are_one_answer(monkeypatch: pytest.MonkeyPatch, recordings: Recordings) -> None:
    monkeypatch.setitem(registry.POLICIES, TwoFaced.name, TwoFaced)
    found = CrossValidation(recordings, bundled=never).run(TwoFaced.name, TRACK)
    assert not found.privileged


class Borrower(Equal):
    name = "BORROWER"

    def weighted(self, voters: tuple[str, ...]) -> tuple[str, ...]:
        return (*voters, "INERTIAL_POSE")


def test_an_expert_without_a_vote_cannot_be_borrowed(monkeypatch: pytest.MonkeyPatch, recordings: Recordings) -> None:
    with pytest.raises(PolicyError, match=r"would weight .* INERTIAL_POSE in track VISION"):
        run(monkeypatch, Borrower, recordings)


def test_saved_policies_say_on_which_drives_they_were_fitted_and_are_refused_there(
    recordings: Recordings, tmp_path: Path
) -> None:
    training, test = recordings.select(folds=[0, 1, 2]), recordings.select(folds=[3])
    policy = Linear()
    prepare(policy, training, TRACK)
    policy.save(tmp_path)
    loaded = registry.load(tmp_path)
    assert loaded.fitted_on == policy.fitted_on
    assert len(loaded.fitted_on) == len(training)
    rollout(loaded, test, TRACK)
    with pytest.raises(PolicyError, match=r"LINEAR was fitted on the drive of scene-2001: score it on other scenes"):
        rollout(loaded, recordings, TRACK)


@pytest.mark.parametrize("change", ["name", "expert", "data version"])
def test_a_drive_is_known_again_under_another_name_and_with_other_experts(recordings: Recordings, change: str) -> None:
    policy = Linear()
    prepare(policy, recordings.select(folds=[0, 1, 2]), TRACK)
    again = recordings
    if change == "name":
        scenes = tuple(replace(s, name=f"new-{s.name}", log=f"new-{s.log}", values_hash="x") for s in again.scenes)
        again = again.replace(replace(again.manifest, scenes=scenes))
    elif change == "expert":
        again = again.replace(columns={"CAM_FRONT.matches": again["CAM_FRONT.matches"] + 1})
    else:
        again = again.replace(replace(again.manifest, data_version="other-1"))
    with pytest.raises(PolicyError, match="was fitted on the drive of"):
        check(policy, again, TRACK)


class Remembers(Mean):
    """Learns nothing, as it says, but comes with a tensor."""

    name = "REMEMBERS"

    def tensors(self) -> Mapping[str, np.ndarray]:  # type: ignore[override]
        return {"truth": np.zeros(3)}


def test_what_was_learned_somewhere_unsaid_is_refused(recordings: Recordings) -> None:
    silent = Linear()
    silent.fit(synthetic_recordings(9), TRACK)
    remembers = Remembers()
    remembers.start(recordings.voters(TRACK))
    for policy in (silent, remembers):
        with pytest.raises(PolicyError, match="does not say on which drives"):
            rollout(policy, recordings, TRACK)


class Smuggler(Equal):
    """Saves a closure."""

    name = "SMUGGLER"

    def tensors(self) -> dict[str, np.ndarray]:
        smuggled: Callable[[], float] = float
        return {"closure": np.array([smuggled], dtype=object)}


def test_closures_are_neither_saved_nor_loaded(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"tensor 'closure': expected floating-point numbers, got object"):
        Smuggler().save(tmp_path)
    (tmp_path / "policy.safetensors").write_bytes(pickle.dumps({"x": 1}))
    with pytest.raises(PolicyError, match="is not a saved policy"):
        registry.load(tmp_path)


def test_statistics_of_the_manifest_are_those_of_the_training_scenes(recordings: Recordings) -> None:
    from mixo_env.recordings.fitting import with_fits

    training = recordings.select(folds=[0, 1, 2])
    told = for_learning(training).manifest
    alone = with_fits(training).manifest
    assert told.reward_scale_rad == alone.reward_scale_rad
    assert told.linear_weights == alone.linear_weights
    assert told.reward_scale_rad != with_fits(recordings).manifest.reward_scale_rad


def test_the_lag_is_removed_from_training_truth_once(recordings: Recordings) -> None:
    vehicles = {name: replace(c, pose_lag_s=0.03) for name, c in recordings.manifest.vehicles.items()}
    late = recordings.replace(replace(recordings.manifest, vehicles=vehicles))
    corrected = lag_corrected(late)["truth.yaw_rad"]
    assert not np.array_equal(corrected, late["truth.yaw_rad"])
    for given in (late, lag_corrected(late)):
        training = for_learning(given)
        np.testing.assert_array_equal(training["truth.yaw_rad"], corrected)
        np.testing.assert_array_equal(lag_corrected(training)["truth.yaw_rad"], corrected)
        assert not any("written" in name for name in training.column_names)
