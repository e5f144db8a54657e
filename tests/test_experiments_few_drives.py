"""Rows fitted on few logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.few_drives import FewDrives, draw_logs, main
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.truths import with_truth
from tests.bundle import few_drives


def test_fewer_logs_are_among_more_and_draws_differ() -> None:
    drives = few_drives(4)
    many, few, other = (draw_logs(drives, count, draw) for count, draw in ((6, 0), (3, 0), (6, 1)))
    logs = [{scene.log for scene in part.scenes} for part in (many, few, other)]
    assert [len(some) for some in logs] == [6, 3, 6]
    assert logs[1] < logs[0] != logs[2]
    assert len(few) == sum(scene.log in logs[1] for scene in drives.scenes)


def test_fitted_on_all_logs_it_is_the_leaderboards_row(tmp_path: Path) -> None:
    """With every log of the other folds a row is that of the table, whose RTE is that of every fold."""
    save_recordings(few_drives(6), tmp_path / "few")
    table = FewDrives(tmp_path / "few", rows=("LINEAR", "HUBER"), logs=(2, 18), draws=1).run()
    protocol = CrossValidation(load_recordings(str(tmp_path / "few")))
    scenes = with_truth(protocol.recordings, protocol.truths[0])
    fold_of = np.array([scene.fold for scene in scenes.scenes])
    for line in table.rows:
        relative = Truth(scenes).measure(protocol.run(str(line[0]), "VISION").travel).relative
        expected = np.mean([relative.rotation_deg_per_m[fold_of[relative.scene] == fold].mean() for fold in range(4)])
        assert str(line[2]) == f"{1e3 * expected:.2f} ± 0.00"
    assert table.rows[0][1] != table.rows[0][2]


def test_what_cannot_be_drawn_is_said_in_a_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    drives = few_drives(2)
    save_recordings(drives, tmp_path / "few")
    assert main(["--recordings", str(tmp_path / "few"), "--logs", "200"]) == 1
    assert "expected 1 or more draws of 1 to" in caplog.text
    save_recordings(drives.select(folds=[1]), tmp_path / "one")
    assert main(["--recordings", str(tmp_path / "one")]) == 1
    assert "expected recordings of 2 or more folds, got 1" in caplog.text
