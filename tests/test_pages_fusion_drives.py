"""The figure of the drives on which fusion gains and loses most."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from docs._pages.fusion_drives import FusionDrives, extremes
from mixo_env.errors import RecordingError
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def board() -> Leaderboard:
    recordings = synthetic_recordings(0, scenes=4, steps=80)
    return build(recordings, tracks=("VISION",), policies=("CAM_FRONT", "HUBER"), night=False)


def scored(board: Leaderboard, front: list[float], huber: list[float]) -> Leaderboard:
    """The same board with other errors of its four scenes."""
    errors = {"CAM_FRONT": np.array([front]), "HUBER": np.array([huber])}
    rows = tuple(replace(row, scene_deg_per_m=errors[row.name]) for row in board.standings[0].rows)
    return replace(board, standings=(replace(board.standings[0], rows=rows),))


def test_the_scenes_of_largest_gain_and_loss_by_hand(board: Leaderboard) -> None:
    nan = float("nan")
    assert extremes(scored(board, [0.5, 0.9, 0.2, nan], [0.4, 0.3, 0.6, nan]), "HUBER") == (1, 2)
    with pytest.raises(RecordingError, match="no scene has a piece of path of 10 m"):
        extremes(scored(board, [nan] * 4, [nan] * 4), "HUBER")


def test_the_figure_is_drawn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    save_recordings(synthetic_recordings(0, scenes=4, steps=80), tmp_path / "recorded")
    out = tmp_path / "fusion.png"
    assert FusionDrives(out, tmp_path / "recorded", row="HUBER", others=("LINEAR",)).run() == 0
    assert out.stat().st_size > 30_000
    first, second = (float(line.split()[3]) for line in capsys.readouterr().out.splitlines()[:2])
    assert first > second
