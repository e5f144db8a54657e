"""One held-out fold without the leaderboard around it: what a script in ``baselines/`` prints."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mixo_env.leaderboard.crossvalidation import CrossValidation, Run, Trial
from mixo_env.leaderboard.evaluation import Travel, Truth
from mixo_env.leaderboard.report import cells, sections
from mixo_env.leaderboard.rows import Scorer
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.truths import truths_of, with_truth
from mixo_env.tables import Column, Table

COLUMNS = ("policy", "RTE deg/m", "- LINEAR", "RTE %", "ATE m", "ATE deg", "yaw deg")


def hold_out(recordings: Recordings, fold: int, *, seed: int = 0) -> tuple[Recordings, Recordings]:
    """Training and test scenes of one fold, divided by log.

    Wheel scale, course offset and pose lag of every vehicle are fitted on training folds alone. True poses are those of
    the headline: the simulator's exact ones where they exist, else without their lag.

    Raises:
        ConfigurationError: when the fold holds no scene.
        PolicyError: when no scene is left to train on.
    """
    division = CrossValidation(recordings, Trial(seed))
    test = division.recordings.select(folds=[fold])
    return division.training(fold), with_truth(test, truths_of(test)[0])


def table_of(test: Recordings, track: str, travels: Mapping[Policy, Travel], *, seed: int = 0) -> str:
    """A row for every policy that was played, with its paired difference to LINEAR when that is among them.

    Args:
        test: the scenes that all of them were played on, as :func:`hold_out` gave them.
        track: whose experts voted.
        travels: policy -> what :func:`~mixo_env.leaderboard.evaluation.rollout` returned.
        seed: of bootstrap and sign patterns.
    """
    # Against the headline's truth alone, which `hold_out` has put in the place of the others.
    scorer = Scorer(test, {"truth": Truth(test)}, floor=0.0, seed=seed)
    everything = np.ones(len(test), dtype=np.bool_)
    rows = [
        scorer.row(track, Run(policy.name, policy.privileged, policy.learns, {"truth": (travel,)}, everything, {}))
        for policy, travel in travels.items()
    ]
    comparisons = scorer.compare(rows)
    texts = [cells(row, comparisons) for section in sections(rows) for row in section]
    logs = len({scene.log for scene in test.scenes})
    caption = (
        f"Track {track}, {len(test)} held-out scenes of {logs} logs; † reads ground truth or the future, * has no vote"
    )
    lines = [[text[column] for column in COLUMNS] for text in texts]
    return Table(caption, tuple(map(Column, COLUMNS)), lines).text()
