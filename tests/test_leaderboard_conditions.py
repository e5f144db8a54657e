"""The headline's truth, oracles by truth, conditions, seeds, key frames, the noise floor and the firing order."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard import exports, report
from mixo_env.leaderboard.board import Leaderboard, build
from mixo_env.leaderboard.conditions import check_grouping, condition_of, members
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.evaluation import Truth, mean_errors
from mixo_env.leaderboard.firing_order import best_shares, firing_order, weights_of_one
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.schema import HEADLINE_TRACKS
from mixo_env.recordings.truths import truths_of, with_truth
from tests.synthetic import synthetic_recordings

ORACLES = ("MULTICAMERA GT", "ORACLE ALL", "ORACLE HULL")
NOISE_RAD = 1e-3


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    """Sixteen scenes of eight logs: two at night, every other log in rain; written poses are noisier than cameras."""
    drawn = synthetic_recordings(0, scenes=16, logs=8, steps=100)
    noise = np.random.default_rng(1).normal(0.0, NOISE_RAD, drawn.offsets[-1])
    noise[drawn.offsets[:-1]] = 0.0
    scenes = tuple(
        replace(
            scene,
            conditions=("night",) if i in (7, 15) else ("day", "rain") if i % 2 else ("day",),
            fold=-1 if i in (7, 15) else scene.fold,
        )
        for i, scene in enumerate(drawn.scenes)
    )
    yaw = drawn["truth.yaw_rad"] + noise
    turn = np.diff(yaw, prepend=np.nan)
    turn[drawn.offsets[:-1]] = np.nan
    staged = {scene.name: "lead_truck" if i % 3 == 0 else "ordinary" for i, scene in enumerate(scenes)}
    manifest = replace(drawn.manifest, scenes=scenes, parameters={"situations": staged})
    return drawn.replace(manifest, {"truth.yaw_rad": yaw, "truth.yaw_increment_rad": turn})


@pytest.fixture(scope="module")
def board(recordings: Recordings) -> Leaderboard:
    return build(
        recordings, policies=("INERTIAL", "CAM_FRONT", "CAM_BACK", "MEDIAN", "LINEAR", "HUBER", *ORACLES, "PERFECT YAW")
    )


def without_exact(recordings: Recordings) -> Recordings:
    """As real data: no noise-free truth."""
    nothing = np.full(recordings.offsets[-1], np.nan)
    return recordings.replace(columns={f"exact.{name}": nothing for name in ("x_m", "y_m", "yaw_rad")})


def test_the_exact_truth_leads_where_it_exists(recordings: Recordings, board: Leaderboard) -> None:
    assert (truths_of(recordings)[0], board.headline, board.noise_floor) == ("exact", "exact", 0.0)
    for row in board.standings[0].rows:
        assert row.headline is row.scores["exact"]
    assert truths_of(without_exact(recordings))[0] == "truth"


def test_oracles_choose_by_the_truth_that_scores_them(board: Leaderboard) -> None:
    """On exact picks by exact truth the oracle wins; on the picks of the noisy truth it would not."""
    for table in board.standings:
        rows = {row.name: row for row in table.rows}
        for name in ORACLES:
            exact, noisy = (rows[name].run.travels[truth][0].yaw_increment_rad for truth in ("exact", "truth"))
            assert not np.array_equal(exact, noisy)
        crossed = board.truths["exact"].measure(rows["MULTICAMERA GT"].run.travels["truth"][0])
        own = rows["MULTICAMERA GT"].headline.rotation_deg_per_m.mean
        assert own < 0.7 * crossed.relative.rotation_deg_per_m.mean()


@pytest.mark.parametrize("truth", ["exact", "truth"])
def test_multicamera_gt_beats_every_row_without_a_dagger(board: Leaderboard, truth: str) -> None:
    for table in board.standings:
        scores = {row.name: row.scores[truth].yaw_increment_rmse_deg for row in table.rows}
        cameras = {r.name for r in table.rows if not r.run.privileged and r.votes and not r.name.startswith("INERTIAL")}
        assert all(scores["ORACLE HULL"] < scores[name] for name in cameras)
        assert all(scores["MULTICAMERA GT"] < scores[name] for name in ("CAM_FRONT", "CAM_BACK"))


def test_floors_are_perfect_by_each_truth(board: Leaderboard) -> None:
    floor = next(row for row in board.standings[0].rows if row.name == "PERFECT YAW")
    for score in floor.scores.values():
        assert score.ate_deg == pytest.approx(0.0, abs=1e-9)


def test_written_poses_are_a_truth_of_their_own(recordings: Recordings) -> None:
    written = {f"written.{name}": recordings[f"truth.{name}"] + 1.0 for name in ("x_m", "y_m", "yaw_rad")}
    both = recordings.replace(columns=written)
    assert truths_of(both) == ("exact", "truth", "written")
    np.testing.assert_array_equal(with_truth(both, "written")["truth.x_m"], both["written.x_m"])
    with pytest.raises(ConfigurationError, match="unknown truth 'written'"):
        with_truth(recordings, "written")


def test_another_truth_has_increments_and_chords_of_its_own(recordings: Recordings) -> None:
    """Exact poses of these scenes are those that distances and increments were made of."""
    original = synthetic_recordings(0, scenes=16, logs=8, steps=100)
    exact = with_truth(recordings, "exact")
    for name in ("yaw_increment_rad", "distance_m"):
        expected = original[f"truth.{name}"]
        np.testing.assert_allclose(exact[f"truth.{name}"], expected, atol=1e-9 if name[0] == "y" else 2e-3)


def test_conditions_divide_the_scenes_and_their_samples(recordings: Recordings, board: Leaderboard) -> None:
    for table in board.standings:
        for by in ("condition", "situation"):
            groups = [group for group in table.groups if group.by == by]
            assert len(groups) == 2
            for whole, *parts in zip(table.rows, *(group.rows for group in groups), strict=True):
                scores = [part.headline for part in parts]
                assert sum(score.samples for score in scores) == whole.headline.samples
                assert sum(score.scenes for score in scores) == whole.headline.scenes == 14
                pooled = sum(score.samples * score.rotation_deg_per_m.mean for score in scores)
                assert pooled / whole.headline.samples == pytest.approx(whole.headline.rotation_deg_per_m.mean)
                ate = sum(score.scenes * score.ate_deg for score in scores)
                assert ate / 14 == pytest.approx(whole.headline.ate_deg)


def test_names_of_conditions() -> None:
    scene = synthetic_recordings(0, scenes=1, steps=40).scenes[0]
    named = {("day",): "day", ("day", "rain"): "rain", ("night",): "night", ("night", "rain"): "night"}
    assert {c: condition_of(replace(scene, conditions=c)) for c in named} == named


def test_situations_are_known_of_simulated_scenes_only() -> None:
    plain = synthetic_recordings(0, scenes=2, steps=40)
    assert members(plain, "situation") == {}
    with pytest.raises(ConfigurationError, match=r"--by situation: .* does not say what was staged"):
        check_grouping(plain, "situation")
    check_grouping(plain, "condition")


def test_night_is_a_table_of_its_own_by_policies_of_all_folds(recordings: Recordings, board: Leaderboard) -> None:
    night = board.night
    assert night is not None
    assert [scene.name for scene in night.recordings.scenes] == ["scene-2008", "scene-2016"]
    assert [row.name for row in night.standings[0].rows] == [row.name for row in board.standings[0].rows]
    protocol = CrossValidation(recordings, out_of_distribution=True)
    assert len(protocol.training(-1)) == 14
    assert all(scene.fold >= 0 for scene in protocol.training(-1).scenes)
    assert "night (out of distribution): 2 scenes of 1 log" in report.to_markdown(board, by=("condition",))
    assert "night (out" not in report.to_markdown(board)
    assert len(exports.to_json(board)["night"]["tracks"]) == len(HEADLINE_TRACKS)


def test_groups_are_in_the_json_and_on_request_in_the_tables(board: Leaderboard) -> None:
    groups = exports.to_json(board)["tracks"]["VISION"]["groups"]
    assert [(group["by"], group["name"]) for group in groups] == [
        ("condition", "day"),
        ("condition", "rain"),
        ("situation", "ordinary"),
        ("situation", "lead_truck"),
    ]
    text = report.to_markdown(board, by=("situation",))
    assert "VISION, situation lead truck: 5 scenes" in text
    assert "condition rain" not in text


def test_rows_are_sorted_within_their_sections(board: Leaderboard) -> None:
    for section in report.sections(board.standings[0].rows, "deg/m"):
        values = [row.headline.rotation_deg_per_m.mean for row in section]
        assert values == sorted(values)
    for order in ("%", "ate-m", "ate-deg", "yaw", "written"):
        sections = report.sections(board.standings[0].rows, order)
        assert sum(map(len, sections)) == len(board.standings[0].rows)
        assert not any(row.run.privileged for row in sections[0])


def test_every_row_prints_its_differences(board: Leaderboard) -> None:
    table = board.standings[0]
    for row in table.rows:
        line = report.cells(row, table.comparisons)
        if row.run.privileged or row.name == "LINEAR":
            assert line["- LINEAR"] == "-"
            continue
        found = table.comparisons.between(row.name, "LINEAR")
        assert found is not None
        samples, linear = (r.errors["exact"].relative for r in (row, next(r for r in table.rows if r.name == "LINEAR")))
        here = row.run.tested[samples.scene]
        difference = (samples.rotation_deg_per_m - linear.rotation_deg_per_m)[here].mean()
        assert found.difference.mean == pytest.approx(difference)
        assert line["- LINEAR"].startswith(report.percent(found.share))
    assert set(table.comparisons.letters) == {row.name for row in table.rows if not row.run.privileged}


def test_a_row_of_several_seeds_is_the_mean_of_their_errors(
    recordings: Recordings, monkeypatch: pytest.MonkeyPatch
) -> None:
    from mixo_env.policies.gate import Mixo

    monkeypatch.setattr(Mixo.__init__, "__kwdefaults__", Mixo.__init__.__kwdefaults__ | {"min_updates": 20})
    board = build(recordings, tracks=("VISION",), policies=("MIXO",), trial=Trial(seeds=2))
    (row,) = board.standings[0].rows
    one, other = row.run.travels["exact"]
    assert not np.array_equal(one.yaw_increment_rad, other.yaw_increment_rad)
    errors = [board.truths["exact"].measure(travel) for travel in (one, other)]
    means = [error.relative.rotation_deg_per_m.mean() for error in errors]
    assert row.headline.rotation_deg_per_m.mean == pytest.approx(np.mean(means))
    assert row.headline.rotation_deg_per_m.mean > min(means)
    assert row.headline.ate_deg == pytest.approx(np.mean([error.absolute.rotation_deg.mean() for error in errors]))
    alone = build(recordings, tracks=("VISION",), policies=("MIXO",)).standings[0].rows[0]
    np.testing.assert_array_equal(alone.run.travel.yaw_increment_rad, one.yaw_increment_rad)
    assert mean_errors(errors[:1]) is errors[0]


def test_key_frames_are_the_papers_clock(recordings: Recordings) -> None:
    board = build(
        recordings, tracks=("VISION",), policies=("CAM_FRONT", "LINEAR"), trial=Trial(ground_truth="keyframes")
    )
    expected = [int(recordings.rows(i)["is_keyframe"].sum()) for i in range(14 + 1) if i != 7]
    assert [scene.rows for scene in board.recordings.scenes] == expected
    assert board.protocol.training(0).scenes[0].rows < 25
    assert "from key frame to key frame (2 Hz)" in report.to_markdown(board)


def test_real_data_has_a_noise_floor_and_no_letter_below_it(recordings: Recordings) -> None:
    real = without_exact(recordings)
    board = build(real, tracks=("VISION",), policies=("CAM_FRONT", "CAM_BACK_RIGHT", "NOISE FLOOR"))
    assert board.headline == "truth"
    rows = {row.name: row for row in board.standings[0].rows}
    floor = rows["NOISE FLOOR"]
    assert floor.run.privileged
    assert floor.headline.rotation_deg_per_m.mean == pytest.approx(board.noise_floor)
    below = {name for name, row in rows.items() if row.headline.rotation_deg_per_m.mean < board.noise_floor}
    lettered = set(board.standings[0].comparisons.letters)
    assert lettered == {"CAM_FRONT", "CAM_BACK_RIGHT"} - below
    assert "Noise floor of the truth" in report.to_markdown(board)


def test_a_row_that_is_exact_scores_about_the_noise_floor(recordings: Recordings) -> None:
    quiet = without_exact(recordings).replace(
        columns={"INERTIAL.yaw_increment_rad": with_truth(recordings, "exact")["truth.yaw_increment_rad"]}
    )
    board = build(quiet, tracks=("VISION",), policies=("INERTIAL",))
    exact = board.standings[0].rows[0].headline.rotation_deg_per_m.mean
    assert exact == pytest.approx(board.noise_floor, rel=0.1)


def test_best_of_own_windows_is_not_moved_by_an_offset_of_the_clock(recordings: Recordings) -> None:
    """Carried increments of CAM_FRONT are spoiled: at the steps it loses its share, over its own window it does not."""
    spoiled = recordings["CAM_FRONT.yaw_increment_rad"] + np.float32(0.01)
    order = firing_order(recordings.replace(columns={"CAM_FRONT.yaw_increment_rad": spoiled}), "exact")
    plain = firing_order(recordings, "exact")
    assert order is not None
    assert plain is not None
    assert order.at_steps.best_share[0] < 0.05 < 0.3 < order.own_windows.best_share[0]
    np.testing.assert_array_equal(order.own_windows.best_share, plain.own_windows.best_share)
    assert order.cost_deg[0] == pytest.approx(np.degrees(0.01), rel=0.05)
    assert order.own_windows.best_share.sum() == pytest.approx(1.0)
    assert order.own_windows.weights.sum() == pytest.approx(1.0)


def test_weights_of_sum_one_by_hand() -> None:
    """Two independent errors of variance 1 and 3: weights 3/4 and 1/4."""
    errors = np.array([[1.0, np.sqrt(3.0)], [1.0, -np.sqrt(3.0)], [-1.0, np.sqrt(3.0)], [-1.0, -np.sqrt(3.0)]])
    assert weights_of_one(errors) == pytest.approx([0.75, 0.25])
    assert best_shares(np.abs(errors), np.ones(4, dtype=bool)) == pytest.approx([1.0, 0.0])


def test_courses_of_both_truths_begin_at_their_own_first_pose(recordings: Recordings) -> None:
    truth = Truth(recordings, "exact")
    assert truth.poses.yaw_rad[0] == recordings["exact.yaw_rad"][0]
