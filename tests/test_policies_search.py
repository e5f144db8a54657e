"""The grid search: stages, finalists, the nested choice, and that nothing is done twice."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError
from mixo_env.policies import search_pieces
from mixo_env.policies.gates import Setting
from mixo_env.policies.search import EXHAUSTIVE, PAPER, Final, Grid, Piece, finals, judge, lessons
from mixo_env.policies.search_pieces import Pieces
from mixo_env.recordings.store import save_recordings
from tests.bundle import few_drives

FOLDS = (0, 1, 2, 3)
SMALL = Grid(n1=(4, 8), n2=(4,), d1=(0.0,), d2=(0.0, 0.1), eta0=(0.01, 0.02), alpha=(0.1,))
WORDS = (
    *("--grid.n1", "4", "8", "--grid.n2", "4", "--grid.d1", "0", "--grid.d2", "0", "0.1"),
    *("--grid.eta0", "0.01", "0.02", "--grid.alpha", "0.1"),
)


def known(pieces: list[Piece]) -> list[np.ndarray]:
    """Errors that are known: eta0 and a little of the fold; training only makes the differences clearer."""
    return [
        np.array(
            [[s.eta0 + 0.001 * fold + 0.01 * s.d1 / piece.updates for s in piece.settings] for fold in piece.held_out]
        )
        for piece in pieces
    ]


def test_the_papers_grid_has_ten_thousand_points_and_holds_its_optimum() -> None:
    settings = Grid().settings()
    assert len(settings) == len(set(settings)) == 10_000
    assert PAPER in settings


def test_halving_finds_the_best_at_a_fifth_of_the_cost() -> None:
    settings = Grid(n1=(8,), n2=(8, 16)).settings()
    judged = judge(settings, FOLDS, 400, known)
    assert judged.cost == pytest.approx(0.2, abs=0.01)
    assert [int(np.isfinite(stage).sum()) for stage in judged.stages] == [800, 160, 32]
    assert judged.settings[judged.order[0]].eta0 == 0.001
    whole = judge(settings, FOLDS, 400, known, EXHAUSTIVE)
    assert whole.cost == 1.0
    assert len(whole.order) == 800
    assert whole.stages[-1][judged.order[0]] == whole.stages[-1].min()


def test_the_nested_choice_never_sees_the_fold_that_judges() -> None:
    """Setting 0 is best where fold 0 judges, setting 1 everywhere else: without fold 0 setting 1 is chosen."""
    a, b = Setting(4, 4, 0, 0, 0.01, 0.1), Setting(8, 4, 0, 0, 0.01, 0.1)

    def errors(pieces: list[Piece]) -> list[np.ndarray]:
        def one(setting: Setting, fold: int) -> float:
            return (0.1 if fold == 0 else 0.5) if setting == a else 0.4

        return [np.array([[one(s, f) for s in piece.settings] for f in piece.held_out]) for piece in pieces]

    final = finals(judge((a, b), FOLDS, 10, errors, EXHAUSTIVE), FOLDS, 10, errors, count=2, seeds=2)
    chosen, nested = final.nested
    place = {setting: i for i, setting in enumerate(final.settings)}
    assert [final.settings[i] for i in chosen] == [b, a, a, a] or chosen[0] == place[b]
    assert chosen[0] == place[b]
    assert nested[0] == 0.4  # not 0.1, which fold 0 alone would have chosen
    # without fold 1: folds 0, 2, 3 give a (0.1 + 0.5 + 0.5) / 3 < 0.4
    assert chosen[1] == place[a]


def test_alike_are_those_within_a_standard_error_and_the_smallest_is_named() -> None:
    rng = np.random.default_rng(0)
    noise = rng.normal(0.0, 0.01, (3, 4, 1))
    offsets = np.stack([np.zeros((3, 4)), rng.normal(0.0, 0.01, (3, 4)), np.full((3, 4), 0.1)], axis=-1)
    offsets[..., 1] -= offsets[..., 1].mean() - 1e-4
    settings = tuple(Setting(n, n, 0, 0, 0.01, 0.1) for n in (64, 8, 4))
    final = Final(settings, 1.0 + noise + offsets, np.zeros((4, 3)))
    assert final.best == 0
    assert final.alike == (0, 1)
    assert final.smallest == 1


def test_lessons_standardise_by_the_training_folds_alone() -> None:
    recordings = few_drives()
    training, others, linear = lessons(recordings, "VISION", (1, 3))
    np.testing.assert_allclose(training.x.mean(axis=1), 0.0, atol=1e-3)
    np.testing.assert_allclose(training.x.std(axis=1), 1.0, atol=1e-3)
    assert len(others) == len(linear) == 2
    steps = {fold: sum(s.rows - 1 for s in recordings.scenes if s.fold == fold) for fold in FOLDS}
    assert [len(one.truth) for one in others] == [steps[1], steps[3]]
    assert len(training.truth) == steps[0] + steps[2]
    with pytest.raises(ConfigurationError, match="leave none to learn from"):
        lessons(recordings, "VISION", FOLDS)


@pytest.fixture(scope="module")
def words(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, ...]:
    """Of a search on a few drives."""
    folder = tmp_path_factory.mktemp("drives") / "few"
    save_recordings(few_drives(), folder)
    return (*WORDS, "--recordings", str(folder))


@pytest.fixture(scope="module")
def searched(words: tuple[str, ...], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small search, of short schedules."""
    folder = tmp_path_factory.mktemp("search")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(search_pieces, "updates_of", lambda training: 20)
        assert main(["search", *words, "--workers", "1", "--finalists", "4", "--seeds", "2", "--out", str(folder)]) == 0
    return folder


def test_a_search_leaves_table_numbers_and_picture(searched: Path) -> None:
    found = json.loads((searched / "landscape.json").read_text())
    assert len(found["settings"]) == len(SMALL.settings())
    assert np.shape(found["again"]) == (2, 4, 4)
    assert (searched / "landscape.png").stat().st_size > 10_000
    assert "LINEAR" in (searched / "landscape.md").read_text()


def test_the_same_command_does_nothing_twice_and_prints_the_same(
    words: tuple[str, ...], searched: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(search_pieces, "updates_of", lambda training: 20)
    before = (searched / "landscape.json").read_text()
    pieces = {path: path.stat().st_mtime_ns for path in (searched / "pieces").iterdir()}
    broken, lost = sorted(pieces)[:2]
    expected = broken.read_text()
    broken.write_text(expected[:20])
    lost.unlink()
    assert main(["search", *words, "--workers", "1", "--finalists", "4", "--seeds", "2", "--out", str(searched)]) == 0
    assert (searched / "landscape.json").read_text() == before
    assert broken.read_text() == expected  # done again, to the digit
    assert all(path.stat().st_mtime_ns == at for path, at in pieces.items() if path not in (broken, lost))


def test_a_folder_of_another_search_is_one_line(
    words: tuple[str, ...], searched: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(search_pieces, "updates_of", lambda training: 20)
    assert main(["search", *words, "--track", "CONSUMER", "--out", str(searched)]) == 2
    assert "holds a search of another track" in capsys.readouterr().err
    assert main(["search", *words[-2:], "--grid.n1", "4", "--out", str(searched)]) == 2
    assert "holds a search of another grid" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("wrong", "complaint"),
    [
        (["--grid.d1", "0.95"], "d1 must lie between 0 and 0.9"),
        (["--grid.eta0", "0"], "eta0 must be above 0"),
        (["--grid.alpha", "nan"], "alpha must be above 0"),
        (["--finalists", "0"], "finalists and seeds are at least 1"),
        (["--workers", "0"], "workers must be at least 1"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_bad_options_are_one_line(
    words: tuple[str, ...], wrong: list[str], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["search", *words[-2:], "--grid.n1", "4", "--grid.n2", "4", *wrong, "--out", str(tmp_path)]) == 2
    assert complaint in capsys.readouterr().err


def test_too_few_folds_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="three folds or more, got 2"):
        Pieces(few_drives().select(folds=[0, 1]), "VISION", tmp_path, workers=1)


@pytest.mark.integration
@pytest.mark.faults
def test_a_search_that_is_killed_goes_on(tmp_path: Path) -> None:
    line = [sys.executable, "-m", "mixo_env.cli.main", "search", *WORDS, "--workers", "1", "--finalists", "2"]
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    subprocess.run([*line, "--out", str(whole)], check=True, capture_output=True)
    with subprocess.Popen(
        [*line, "--out", str(killed)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as process:
        while process.poll() is None and len(list(killed.glob("pieces/*.json"))) < 6:
            time.sleep(0.01)
        os.kill(process.pid, signal.SIGKILL)
    kept = {path.name: path.stat().st_mtime_ns for path in killed.glob("pieces/*.json")}
    assert len(kept) >= 6
    subprocess.run([*line, "--out", str(killed)], check=True, capture_output=True)
    assert (killed / "landscape.json").read_text() == (whole / "landscape.json").read_text()
    assert all((killed / "pieces" / name).stat().st_mtime_ns == at for name, at in kept.items())
