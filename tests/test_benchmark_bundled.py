"""What the leaderboard of the bundled city must show, whatever policies come and go."""

from __future__ import annotations

import pytest

from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.crossvalidation import Trial
from mixo_env.recordings.schema import HEADLINE_TRACKS
from mixo_env.recordings.store import load_recordings

pytestmark = pytest.mark.integration

VOTING = ("CAM_FRONT", "LINEAR", "HUBER")


@pytest.fixture(scope="module")
def board() -> Leaderboard:
    return build(
        load_recordings().select(split="all"),
        policies=(*VOTING, "MULTICAMERA GT"),
        trial=Trial(ground_truth="keyframes"),
    )


@pytest.mark.parametrize("track", HEADLINE_TRACKS)
@pytest.mark.parametrize("truth", ["exact", "truth", "written"])
def test_the_oracle_beats_every_row_on_the_truth_that_chose_it(board: Leaderboard, track: str, truth: str) -> None:
    (table,) = (table for table in board.standings if table.track == track)
    scores = {row.name: row.scores[truth] for row in table.rows}
    oracle = scores.pop("MULTICAMERA GT")
    assert set(scores) == set(VOTING)
    assert oracle.rotation_deg_per_m.mean < min(score.rotation_deg_per_m.mean for score in scores.values())
    assert oracle.ate_deg < min(score.ate_deg for score in scores.values())


def test_constant_weights_favour_no_camera_for_firing_last(board: Leaderboard) -> None:
    """Carried by a filtered gyro, LINEAR gave CAM_BACK, which fires last, .74; FRONT and BACK are equally good."""
    (table,) = (table for table in board.standings if table.track == "VISION")
    for weights in table.linear_weights().values():
        assert weights["CAM_FRONT"] > 0.25
        assert weights["CAM_BACK"] < 0.65
