"""Weights that come with the package: taken where they belong, refused where they were fitted, few bytes."""

from __future__ import annotations

from pathlib import Path

import pytest

from mixo_env.cli.main import main
from mixo_env.leaderboard import code_hash as code
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.weights import STAMP, UNFOLDED, shipped, stamp
from mixo_env.policies.registry import create
from mixo_env.policies.storage import FILE
from mixo_env.recordings.store import load_recordings, save_recordings
from tests.synthetic import synthetic_recordings

MOST_BYTES = 6_000_000


@pytest.fixture
def small(tmp_path: Path) -> Path:
    """Recordings, with weights of LINEAR and STUDENT-T beside them."""
    save_recordings(synthetic_recordings(0, scenes=4, steps=80), tmp_path / "small")
    assert main(train(tmp_path, "weights")) == 0
    return tmp_path


def train(home: Path, out: str, workers: int = 1) -> list[str]:
    command = ["train", "linear", "student-t", "--recordings", str(home / "small"), "--tracks", "VISION"]
    return [*command, "--out", str(home / out), "--workers", str(workers)]


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_workers_change_no_byte(small: Path) -> None:
    assert main(train(small, "by-two", workers=2)) == 0
    assert len(contents(small / "weights")) == 2 * 2 * 5
    assert contents(small / "by-two") == contents(small / "weights")


def test_no_workers_are_one_line(small: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(train(small, "none", workers=0)) == 2
    assert "workers must be at least 1" in capsys.readouterr().err


def test_a_fit_without_any_fold_serves_the_night(small: Path) -> None:
    recordings = load_recordings(str(small / "small"))
    inside = CrossValidation(recordings).training(UNFOLDED)
    assert {scene.fold for scene in inside.scenes} == {0, 1, 2, 3}
    assert (small / "weights/LINEAR/VISION/all-folds-seed-0" / FILE).is_file()


def test_the_benchmark_takes_them_without_being_asked(small: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("mixo_env.leaderboard.weights.SHIPPED", small / "weights")
    monkeypatch.setattr("mixo_env.leaderboard.weights.prepare", lambda *a, **k: pytest.fail("fitted anew"))
    command = ["benchmark", "--recordings", str(small / "small"), "--tracks", "VISION", "--policies", "LINEAR"]
    assert main([*command, "--out", str(small / "taken")]) == 0
    monkeypatch.undo()
    (small / "empty").mkdir()
    assert main([*command, "--out", str(small / "fitted"), "--weights", str(small / "empty")]) == 0
    assert (small / "taken/leaderboard.json").read_bytes() == (small / "fitted/leaderboard.json").read_bytes()


def test_they_are_scored_by_name_elsewhere_and_refused_at_home(
    small: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("mixo_env.leaderboard.weights.SHIPPED", small / "weights")
    save_recordings(synthetic_recordings(1, scenes=4, steps=80), small / "other")
    assert main(["score", "shipped:student_t", "--recordings", str(small / "other")]) == 0
    assert "STUDENT-T (saved)" in capsys.readouterr().out
    assert main(["score", "shipped:STUDENT-T", "--recordings", str(small / "small")]) == 1
    assert "was fitted on the drive of" in capsys.readouterr().err
    for unknown in ("shipped:TOKEN", "shipped:", "shipped:../x"):
        assert main(["score", unknown, "--recordings", str(small / "other")]) == 2
        (line,) = capsys.readouterr().err.strip().splitlines()
        assert "LINEAR, STUDENT-T" in line


def test_words_change_no_hash_and_statements_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(code, "ROOT", tmp_path)

    def hashed(below: str) -> str:
        (tmp_path / "above.py").write_text("def f():\n    from mixo_env.below import x\n    return x\n")
        (tmp_path / "below.py").write_text(below)
        code._read.cache_clear()
        code._source.cache_clear()
        return code.code_hash("mixo_env.above")

    try:
        first = hashed("x = 1\ny = '# no comment'\n")
        assert hashed('"""Words."""\n\nx = 1  # one\n"""More\nwords."""\ny = \'# no comment\'\n') == first
        assert hashed("x = 2\ny = '# no comment'\n") != first
        assert hashed("x = 1\ny = '# another'\n") != first
    finally:
        code._read.cache_clear()
        code._source.cache_clear()


def test_a_fit_runs_through_the_code_of_its_class() -> None:
    reached = code._read("mixo_env.policies.token_gate")[1]
    assert {"mixo_env.policies.tokens", "mixo_env.policies.lessons"} <= set(reached)


def test_those_in_the_package_are_what_fitting_would_give_and_small() -> None:
    folder = shipped()
    if folder is None:
        pytest.skip("this tree has none: `make weights`")
    held = contents(folder)
    assert sum(map(len, held.values())) <= MOST_BYTES
    assert {Path(name).name for name in held} == {FILE, STAMP}
    division = CrossValidation(load_recordings(), Trial(weights=folder))
    found = {str(path.parent.relative_to(folder)) for path in folder.rglob(STAMP)}
    for name, track, fold, _ in division.pieces(("LINEAR", "HUBER", "TOKEN"), ("VISION",)):
        from mixo_env.leaderboard.weights import _stamped, part

        place = part(name, track, fold, 0)
        assert str(place) in found
        expected = stamp(create(name, division.recordings), division.training(fold), track, division._seed_of(fold, 0))
        assert _stamped(folder / place) == expected, f"{place}: fitted on other data or by other code: `make weights`"
