"""What rows close of the way to the oracle."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.closing import FROM, TO, Closing, absolute, beside, closed, errors_of, main, relative, told
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import Truth
from mixo_env.leaderboard.rows import Scorer
from mixo_env.recordings.store import load_recordings, save_recordings
from mixo_env.recordings.truths import with_truth
from tests.bundle import few_drives


def test_a_share_by_hand() -> None:
    """Two logs of two and one pieces: means 3, 4 and 1, of which own closes a third of the way."""
    counts = np.array([2.0, 1.0])
    own, worst, best = (np.array(sums) for sums in ([6.0, 3.0], [8.0, 4.0], [2.0, 1.0]))
    found = closed((own, counts), (worst, counts), (best, counts))
    assert found.mean == pytest.approx(100.0 / 3.0)
    assert (found.low, found.high) == pytest.approx((100.0 / 3.0, 100.0 / 3.0))  # it is the same in both logs
    assert found.groups == 2
    for at, percent in ((worst, 0.0), (best, 100.0)):
        assert closed((at, counts), (worst, counts), (best, counts)).mean == pytest.approx(percent)
    one = tuple((sums[:1], counts[:1]) for sums in (own, worst, best))
    assert np.isnan([closed(*one).low, closed(*one).high]).all()


def test_the_interval_is_that_of_the_share_taken_anew_in_every_draw() -> None:
    """An independent bootstrap, log by log, of shares that differ much less than the errors do."""
    rng = np.random.default_rng(0)
    hard = rng.uniform(0.5, 3.0, 40)  # what is common to all rows does not make the share unsure
    worst, best = 4.0 * hard, hard
    own = worst - rng.uniform(0.3, 0.7, 40) * (worst - best)
    counts = np.ones(40)
    found = closed((own, counts), (worst, counts), (best, counts))
    shares = []
    for _ in range(4000):
        rows = rng.integers(0, 40, 40)
        shares.append(100.0 * (worst[rows] - own[rows]).mean() / (worst[rows] - best[rows]).mean())
    np.testing.assert_allclose([found.low, found.high], np.quantile(shares, [0.025, 0.975]), atol=0.5)
    assert found.high - found.low < 12.0


def test_seeds_are_averaged_first_and_their_spread_is_told() -> None:
    counts = np.ones(3)
    worst, best = (np.full(3, 3.0), counts), (np.full(3, 1.0), counts)
    seeds = [(np.full(3, value), counts) for value in (1.8, 2.0, 2.2)]
    assert told(worst, best, seeds) == "50.0 [50.0, 50.0] ± 10.0"
    assert told(worst, best, seeds[:1]) == "60.0 [60.0, 60.0]"


def test_the_ends_of_the_way_and_the_leaderboards_means(tmp_path: Path) -> None:
    save_recordings(few_drives(6), tmp_path / "few")
    table = Closing(tmp_path / "few", rows=(FROM, "HUBER", TO), tracks=("VISION",), seeds=1).run()
    assert [str(cell) for cell in table.rows[0][1:]] == ["0.0 [0.0, 0.0]"] * 2
    assert [str(cell) for cell in table.rows[2][1:]] == ["100.0 [100.0, 100.0]"] * 2
    protocol = CrossValidation(load_recordings(str(tmp_path / "few")))
    tested = with_truth(protocol.recordings, protocol.truths[0])
    scorer = Scorer(tested, {protocol.truths[0]: Truth(tested)}, floor=0.0, seed=0)
    means = [
        (row.headline.rotation_deg_per_m.mean, row.headline.ate_deg)
        for row in (scorer.row("VISION", protocol.run(name, "VISION")) for name in (FROM, "HUBER", TO))
    ]
    for cell, (worst, own, best) in zip(table.rows[1][1:], zip(*means, strict=True), strict=True):
        assert float(str(cell).partition(" [")[0]) == pytest.approx(100 * (worst - own) / (worst - best), abs=0.06)


def test_other_drives_are_learned_from_and_never_scored(tmp_path: Path) -> None:
    """All that changes is what a row has learned; ends of the way and scored scenes stay."""
    drives = few_drives(4)
    own, other = drives.select(folds=[0, 1]), drives.select(folds=[2, 3])
    joined = beside(own, [other])
    protocol = CrossValidation(joined, tested_folds=(0, 1))
    assert [scene.name for scene in protocol.recordings.scenes] == [scene.name for scene in own.scenes]
    taught = {scene.log for scene in protocol.training(0).scenes}
    assert taught == {s.log for s in own.scenes if s.fold == 1} | {f"1: {s.log}" for s in other.scenes}
    assert not {scene.vehicle for scene in own.scenes} & {scene.vehicle for scene in joined.scenes[len(own) :]}
    for i, scene in enumerate(other.scenes):
        for column, values in joined.rows(f"1: {scene.name}").items():
            np.testing.assert_array_equal(values, other.rows(i)[column])
    truth = Truth(with_truth(protocol.recordings, protocol.truths[0]))
    divided = (CrossValidation(recordings, tested_folds=(0, 1)) for recordings in (own, joined))
    alone, more = (errors_of(division, truth, "LINEAR", "VISION") for division in divided)
    logs = np.array([scene.log for scene in own.scenes])
    for of in (relative, absolute):
        np.testing.assert_array_equal(of(alone[0], logs)[1], of(more[0], logs)[1])
        assert not np.array_equal(of(alone[0], logs)[0], of(more[0], logs)[0])
    save_recordings(own, tmp_path / "own")
    save_recordings(other, tmp_path / "other")
    study = Closing(tmp_path / "own", (tmp_path / "other",), ("VISION",), ("MULTICAMERA GT", "LINEAR"), seeds=1)
    oracle, linear = study.run().rows
    assert str(oracle[1]) == "100.0 [100.0, 100.0]"
    assert str(linear[1]) != "0.0 [0.0, 0.0]"


def test_what_cannot_be_compared_is_said_in_a_line(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    drives = few_drives(2)
    blind = drives.replace(replace(drives.manifest, cameras=drives.manifest.cameras[:2]))
    with pytest.raises(ConfigurationError, match="expected other drives with the experts"):
        beside(drives, [blind])
    save_recordings(drives.select(folds=[1]), tmp_path / "one")
    assert main(["--recordings", str(tmp_path / "one")]) == 1
    assert "expected recordings of 2 or more folds, got 1" in caplog.text
