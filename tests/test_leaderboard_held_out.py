"""One held-out fold in a script is the leaderboard's row on that fold."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.leaderboard.held_out import hold_out, table_of
from mixo_env.leaderboard.rows import Scorer
from mixo_env.policies.fitting import prepare
from mixo_env.policies.linear import Linear
from mixo_env.policies.oracle import OracleAll
from mixo_env.recordings.collection import Recordings
from tests.bundle import bundled

FOLD = 2


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return bundled("mixocity-paper")


def test_a_held_out_row_is_the_leaderboards(recordings: Recordings) -> None:
    training, test = hold_out(recordings, FOLD)
    linear = Linear()
    prepare(linear, training, "VISION")
    travel = rollout(linear, test, "VISION")

    division = CrossValidation(recordings)
    run = division.run("LINEAR", "VISION", folds=[FOLD])
    here = np.repeat(run.tested, np.diff(division.recordings.offsets))
    np.testing.assert_array_equal(travel.yaw_increment_rad, run.travel.yaw_increment_rad[here])
    np.testing.assert_array_equal(travel.distance_m, run.travel.distance_m[here])
    score = Scorer(division.recordings, {"exact": Truth(division.recordings, "exact")}, 0.0, 0).row("VISION", run)
    value = score.headline.rotation_deg_per_m
    text = table_of(test, "VISION", {linear: travel})
    assert f"LINEAR  {value.mean:.4f} [{value.low:.4f}, {value.high:.4f}]" in text


def test_an_oracle_chooses_by_the_truth_that_scores_it(recordings: Recordings) -> None:
    _, test = hold_out(recordings, FOLD)
    oracle = OracleAll()
    oracle.start(test.voters("VISION"))
    run = CrossValidation(recordings).run("ORACLE ALL", "VISION")
    scenes = {scene.name for scene in test.scenes}
    tested = np.array([scene.name in scenes for scene in recordings.scenes])
    here = np.repeat(tested, np.diff(recordings.offsets))
    travel = rollout(oracle, test, "VISION", privileged=True)
    np.testing.assert_array_equal(travel.yaw_increment_rad, run.travels["exact"][0].yaw_increment_rad[here])
    assert "ORACLE ALL †" in table_of(test, "VISION", {oracle: travel})


def test_training_and_test_share_no_drive(recordings: Recordings) -> None:
    training, test = hold_out(recordings, FOLD)
    assert {scene.fold for scene in test.scenes} == {FOLD}
    assert not {scene.log for scene in training.scenes} & {scene.log for scene in test.scenes}


def test_a_fold_without_scenes_is_refused(recordings: Recordings) -> None:
    with pytest.raises(ConfigurationError, match="no scene left"):
        hold_out(recordings, 9)
