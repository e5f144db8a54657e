"""Weights that are kept: the same bits as a fit, used only where they belong, finished pieces survive."""

from __future__ import annotations

import dataclasses
import errno
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError, OutputError, PolicyError, RecordingError
from mixo_env.experts.expert import State
from mixo_env.leaderboard.board import requested, shown_in
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies.fitting import prepare
from mixo_env.policies.gate import Mixo
from mixo_env.policies.linear import Linear
from mixo_env.policies.registry import create, load
from mixo_env.policies.tandem import Tandem
from mixo_env.policies.token_gate import Token
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=4, steps=80)


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    """Few updates: nothing here depends on how well anything is learnt."""
    for policy, few in ((Mixo, {"min_updates": 20}), (Token, {"epochs": 10}), (Tandem, {"epochs": 10})):
        monkeypatch.setattr(policy.__init__, "__kwdefaults__", policy.__init__.__kwdefaults__ | few)


@pytest.mark.parametrize("name", ["LINEAR", "MIXO", "TOKEN"])
def test_kept_weights_play_the_same_bits_as_a_fit(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    division = CrossValidation(recordings, Trial(weights=tmp_path))
    division.fitted(name, "VISION", 3, 0, keep=True)
    fresh = CrossValidation(recordings).run(name, "VISION", folds=[3]).travel.yaw_increment_rad
    monkeypatch.setattr("mixo_env.leaderboard.weights.prepare", lambda *a, **k: pytest.fail("fitted anew"))
    taken = division.run(name, "VISION", folds=[3]).travel.yaw_increment_rad
    np.testing.assert_array_equal(taken, fresh)


def test_weights_of_other_data_or_seed_are_not_taken(recordings: Recordings, tmp_path: Path) -> None:
    CrossValidation(recordings, Trial(weights=tmp_path)).fitted("LINEAR", "VISION", 3, 0, keep=True)
    for other, seed in ((synthetic_recordings(1, scenes=4, steps=80), 0), (recordings, 1)):
        kept = CrossValidation(other, Trial(seed, weights=tmp_path)).fitted("LINEAR", "VISION", 3, 0)
        fresh = CrossValidation(other, Trial(seed)).fitted("LINEAR", "VISION", 3, 0)
        assert kept.fitted_on == fresh.fitted_on
        for tensor, value in fresh.tensors().items():
            np.testing.assert_array_equal(kept.tensors()[tensor], value)


def test_training_goes_on_where_it_was_interrupted(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_recordings(recordings, tmp_path / "small")
    command = ["train", "linear", "--recordings", str(tmp_path / "small"), "--tracks", "VISION"]
    command += ["--out", str(tmp_path / "weights")]
    fit, fits = Linear.fit, []

    def counted(self: Linear, training: Recordings, track: str, *, seed: int = 0) -> None:
        fits.append(track)
        if len(fits) == 3:
            raise KeyboardInterrupt
        fit(self, training, track, seed=seed)

    monkeypatch.setattr(Linear, "fit", counted)
    assert main(command) == 130
    assert capsys.readouterr().err.strip() == (
        "mixo: interrupted; finished pieces are kept, and the same command continues"
    )
    assert main(command) == 0
    assert len(fits) == 6
    assert "5 sets of weights" in capsys.readouterr().out


def test_a_piece_that_is_not_what_its_stamp_says_is_refused(recordings: Recordings, tmp_path: Path) -> None:
    division = CrossValidation(recordings, Trial(weights=tmp_path))
    for fold in (2, 3):
        division.fitted("LINEAR", "VISION", fold, 0, keep=True)
    pieces = [tmp_path / f"LINEAR/VISION/fold-{fold}-seed-0" for fold in (2, 3)]
    (pieces[1] / "policy.safetensors").write_bytes((pieces[0] / "policy.safetensors").read_bytes())
    with pytest.raises(PolicyError, match="does not hold what its stamp"):
        division.fitted("LINEAR", "VISION", 3, 0)
    damaged = dataclasses.replace(division.trial, weights=tmp_path)
    (pieces[0] / "policy.safetensors").write_bytes(b"no")
    with pytest.raises(PolicyError, match="is not a saved policy"):
        CrossValidation(recordings, damaged).fitted("LINEAR", "VISION", 2, 0)


def test_weights_that_are_no_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="expected a folder of weights"):
        Trial(weights=tmp_path / "none")


@pytest.mark.parametrize("arguments", [[], ["TOKEN", "--all"], ["MEAN"], ["NOBODY"]])
def test_nothing_to_fit_is_one_line(
    recordings: Recordings, arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_recordings(recordings, tmp_path / "small")
    assert main(["train", *arguments, "--recordings", str(tmp_path / "small"), "--out", str(tmp_path / "w")]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1


def test_a_full_disk_is_one_line(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_recordings(recordings, tmp_path / "small")

    def full(self: Path, content: bytes) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    command = ["train", "linear", "--recordings", str(tmp_path / "small"), "--out", str(tmp_path / "weights")]
    assert main(command) == 1
    (line,) = (text for text in capsys.readouterr().err.splitlines() if text.startswith("mixo:"))
    assert "policy.safetensors: No space left on device" in line
    assert [path for path in (tmp_path / "weights").rglob("*") if path.is_file()] == []


def test_an_old_stamp_that_cannot_be_removed_is_one_line(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(self: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr(Path, "unlink", read_only)
    with pytest.raises(OutputError, match=r"stamp\.json: Read-only file system"):
        CrossValidation(recordings, Trial(weights=tmp_path)).fitted("LINEAR", "VISION", 3, 0, keep=True)


@pytest.mark.parametrize("column", ["truth.yaw_increment_rad", "truth.x_m", "speed_mps", "dt_s"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
@pytest.mark.parametrize("name", ["LINEAR", "HUBER", "MIXO"])
def test_training_data_that_are_not_finite_are_refused(
    recordings: Recordings, name: str, value: float, column: str
) -> None:
    values = recordings[column].copy()
    values[7] = value
    with pytest.raises(RecordingError, match=f"^{column}: expected a number .* in scene-2001, row 7"):
        prepare(create(name, recordings), recordings.replace(columns={column: values}), "VISION")


def test_a_fold_without_scenes_cannot_be_held_out(recordings: Recordings) -> None:
    with pytest.raises(ConfigurationError, match="fold"):
        CrossValidation(recordings).fitted("LINEAR", "VISION", 7, 0)


@pytest.mark.parametrize("name", ["LINEAR", "HUBER", "STUDENT-T", "BIAS FILTER", "MIXO", "TOKEN", "TANDEM", "TRIO"])
def test_an_expert_that_never_tells_anything_is_done_without(recordings: Recordings, tmp_path: Path, name: str) -> None:
    silent = recordings.voters("VISION")[0]
    nothing = {
        f"{silent}.yaw_increment_rad": np.full_like(recordings[f"{silent}.yaw_increment_rad"], np.nan),
        f"{silent}.state": np.full_like(recordings[f"{silent}.state"], State.NO_IMAGE),
    }
    without = recordings.replace(columns=nothing)
    training, tested = without.select(folds=[0, 1, 2]), without.select(folds=[3])
    policy = create(name, training)
    prepare(policy, training, "VISION")
    played = rollout(policy, tested, "VISION").yaw_increment_rad
    assert np.isfinite(played[tested["step"] > 0]).all()
    policy.save(tmp_path)
    np.testing.assert_array_equal(rollout(load(tmp_path), tested, "VISION").yaw_increment_rad, played)


def test_slow_agents_are_fitted_for_one_fold_of_one_track_and_ppo_for_all(recordings: Recordings) -> None:
    division = CrossValidation(recordings, Trial(seeds=2))
    pieces = division.pieces(("PPO", "SAC"), ("VISION", "CONSUMER"))
    assert [piece for piece in pieces if piece[0] == "SAC"] == [
        ("SAC", "CONSUMER", division.folds[-1], k) for k in (0, 1)
    ]
    assert len(pieces) == 2 + 2 * 2 * (len(division.folds) + 1)  # every fold held out, then none
    assert shown_in(recordings, "CONSUMER", ("PPO", "SAC")) == ("PPO", "SAC")
    assert shown_in(recordings, "VISION", ("PPO", "SAC")) == ("PPO",)
    with pytest.raises(
        ConfigurationError, match="SAC: shown in track CONSUMER alone, got --tracks VISION: add CONSUMER"
    ):
        requested(recordings, ["VISION"], ["SAC"])
