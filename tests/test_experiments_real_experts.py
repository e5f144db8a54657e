"""Odometries as people have them: some break, some say nothing, none counts matches; and the study of real ones."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from experiments.real_experts import CHOSEN, HINDSIGHT, RealExperts, Scored, chosen, hindsight, main
from experiments.real_experts import table as table_of_scores
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies.fitting import prepare
from mixo_env.policies.registry import POLICIES, create
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.sequence_files import Reading
from mixo_env.recordings.sequences import SequenceRules, recordings_from_trajectories
from tests.odometry_files import RATE_HZ, write_set

REAL = Path(os.environ.get("MIXO_REAL_DATA", "/nonexistent")) / "kitti_experts"
SURVIVORS = (
    *("INVERSE VARIANCE", "COVARIANCE INTERSECTION", "STUDENT-T", "SOFTMIN", "FIXED SHARE", "BIAS FILTER"),
    "SMOOTHER (NON-CAUSAL)",
)
NOISE_RAD = 5e-4


def drives(root: Path, experts: int) -> Recordings:
    folders = write_set(root, {f"E{j}": NOISE_RAD * (1 + j % 3) for j in range(experts)}, sequences=3)
    truth = folders.pop("groundtruth")
    rules = SequenceRules(Reading(rate_hz=RATE_HZ), leave_one_out=True)
    return recordings_from_trajectories(truth, folders, rules)


@pytest.fixture(scope="module")
def five(tmp_path_factory: pytest.TempPathFactory) -> Recordings:
    return drives(tmp_path_factory.mktemp("five"), 5)


def damaged(recordings: Recordings, expert: str, how: str, rows: slice) -> Recordings:
    name = f"{expert}.yaw_increment_rad"
    values = recordings[name].copy()
    part = values[rows]
    if how == "breaks":
        part += np.radians(40.0) * np.random.default_rng(0).choice([-1.0, 1.0], len(part)).astype(np.float32)
    elif how == "stuck":
        part[:] = 0.0
    else:
        part[:] = np.nan
    values[recordings.offsets[:-1]] = np.nan
    return recordings.replace(columns={name: values})


def rms_deg(name: str, training: Recordings, test: Recordings) -> float:
    policy = create(name, training)
    prepare(policy, training, "VISION")
    travel = rollout(policy, test, "VISION", privileged=policy.privileged)
    error = np.degrees(travel.yaw_increment_rad - test["truth.yaw_increment_rad"])
    assert np.isfinite(error[1:]).all()
    return float(np.sqrt(np.mean(error[1:] ** 2)))


def split(recordings: Recordings) -> tuple[Recordings, Recordings, slice]:
    first, stop = int(recordings.offsets[0]), int(recordings.offsets[1])
    return recordings.select(folds=[1, 2]), recordings.select(folds=[0]), slice(first, stop)


@pytest.mark.parametrize("how", ["breaks", "stuck", "lost"])
@pytest.mark.parametrize("name", SURVIVORS)
def test_the_best_expert_may_fail_throughout_a_drive(name: str, how: str, five: Recordings) -> None:
    _, _, rows = split(five)
    training, test, _ = split(damaged(five, "E0", how, rows))
    assert rms_deg(name, training, test) < 0.15


@pytest.mark.parametrize("how", ["breaks", "lost"])
@pytest.mark.parametrize("name", SURVIVORS)
def test_an_expert_may_fail_in_all_training_drives(name: str, how: str, five: Recordings) -> None:
    training, _, _ = split(damaged(five, "E0", how, slice(0, None)))
    assert rms_deg(name, training, split(five)[1]) < 0.15


@pytest.mark.parametrize("experts", [1, 2, 9])
def test_any_number_of_experts(experts: int, tmp_path: Path) -> None:
    training, test, _ = split(drives(tmp_path, experts))
    for name in (*SURVIVORS, "LINEAR SIMPLEX"):
        assert rms_deg(name, training, test) < np.degrees(1.05 * NOISE_RAD)


def test_a_broken_expert_breaks_constant_weights_and_gates_that_do_not_see_it(five: Recordings) -> None:
    _, _, rows = split(five)
    training, test, _ = split(damaged(five, "E0", "breaks", rows))
    assert rms_deg("LINEAR SIMPLEX", training, test) > 1.0


def test_chosen_never_sees_the_sequence_and_hindsight_always() -> None:
    alone = {
        "A": Scored(np.array([1.0, 1.0, 9.0]), np.array([1.0, 1.0, 9.0])),
        "B": Scored(np.array([2.0, 2.0, 2.0]), np.array([2.0, 2.0, 2.0])),
    }
    assert chosen(alone).deg_per_m.tolist() == [2.0, 2.0, 9.0]  # A, whose third drive breaks, looks best without it
    assert hindsight(alone).deg_per_m.tolist() == [1.0, 1.0, 2.0]
    scores = {**alone, CHOSEN: chosen(alone), HINDSIGHT: hindsight(alone), "HUBER": alone["B"]}
    rows = {str(row[0]): row for row in table_of_scores(scores, set(), ["x", "y", "z"]).rows}
    assert rows["A"][-3:] == [pytest.approx((0.5 + 0.5 + 4.5) / 3)] * 2 + [1.0]


def test_the_command_imports_and_prints_a_row_each(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folders = write_set(tmp_path / "files", {"A": 5e-4, "B": 1e-3}, sequences=3)
    for name, folder in folders.items():
        for file in sorted(folder.iterdir()):
            home = tmp_path / "data" / file.stem
            home.mkdir(parents=True, exist_ok=True)
            file.rename(home / f"{name}.txt")
    command = ["--data", str(tmp_path / "data"), "--rate", "10", "--policies", "MEDIAN", "SOFTMIN", "--markdown"]
    assert main(command) == 0
    out = capsys.readouterr().out
    named = [line.split("|")[1].strip() for line in out.splitlines() if line.startswith("| ")]
    assert named == ["row", "A", "B", CHOSEN, HINDSIGHT, "HUBER", "MEDIAN", "SOFTMIN"]


def test_a_folder_without_sequences_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(ConfigurationError, match=r"expected folders with groundtruth\.txt"):
        RealExperts(data=tmp_path).run()
    monkeypatch.delenv("MIXO_REAL_DATA", raising=False)
    with pytest.raises(ConfigurationError, match="expected --data FOLDER"):
        RealExperts().run()


@pytest.mark.skipif(not REAL.is_dir(), reason="needs real data")
def test_the_filter_of_biases_beats_huber_on_real_experts_and_never_collapses() -> None:
    result = RealExperts(data=REAL, policies=("BIAS FILTER",)).run()
    (row,) = (row for row in result.rows if row[0] == "BIAS FILTER")
    *errors, rms_ratio, rte_ratio, worst = (float(value) for value in row[1:] if value is not None)
    assert rms_ratio <= 0.97
    assert rte_ratio <= 0.97
    assert worst <= 1.10
    assert max(errors[: len(errors) // 2]) < 0.15


def test_every_survivor_is_a_row() -> None:
    assert set(SURVIVORS) <= set(POLICIES)
