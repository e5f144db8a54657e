"""Rows played where they were not fitted: other clocks, other rigs, other drives, experts of other names."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.closing import Closing
from experiments.places import Place, alone, every
from experiments.transfer import Transfer, main
from mixo_env.errors import ConfigurationError
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.evaluation import rollout
from mixo_env.policies.policy import Policy
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=4, steps=80)


def test_every_third_image_makes_steps_of_three(recordings: Recordings) -> None:
    slow = every(recordings, stride=3)
    for i in range(len(recordings)):
        fast, turn = recordings.rows(i), slow.rows(i)["truth.yaw_increment_rad"]
        steps = fast["truth.yaw_increment_rad"]
        assert len(turn) == -(-len(steps) // 3)
        np.testing.assert_allclose(turn[1], steps[1:4].sum(), atol=1e-6)
        np.testing.assert_array_equal(slow.rows(i)["timestamp_us"], fast["timestamp_us"][::3])


def test_a_camera_that_is_taken_away_tells_nothing(recordings: Recordings) -> None:
    kept, *others = recordings.manifest.cameras
    rig = alone(recordings, cameras=(kept,))
    assert rig.manifest.cameras == recordings.manifest.cameras
    for name in others:
        assert np.isnan(rig[f"{name}.yaw_increment_rad"]).all()
        assert not rig[f"{name}.matches"].any()
    np.testing.assert_array_equal(rig[f"{kept}.yaw_increment_rad"], recordings[f"{kept}.yaw_increment_rad"])
    with pytest.raises(ConfigurationError, match="CAM_NONE"):
        alone(recordings, cameras=("CAM_NONE",))


def test_own_drives_are_played_by_fits_without_their_fold(recordings: Recordings) -> None:
    home = CrossValidation(recordings)
    place = Place("here", home, own=True)
    tested = place.tested()
    played = place.brought("LINEAR", home, tested, "VISION").travel.yaw_increment_rad
    np.testing.assert_array_equal(played, home.run("LINEAR", "VISION").travel.yaw_increment_rad)
    np.testing.assert_array_equal(
        played, place.at_home_here("LINEAR", "LINEAR THERE", tested, "VISION").travel.yaw_increment_rad
    )


def test_elsewhere_one_fit_on_all_folds_plays(recordings: Recordings) -> None:
    home, there = CrossValidation(recordings), CrossValidation(synthetic_recordings(1, scenes=4, steps=80))
    place = Place("there", there)
    tested = place.tested()
    policy: Policy = home.fitted("HUBER", "VISION", -1, 0)
    np.testing.assert_array_equal(
        place.brought("HUBER", home, tested, "VISION").travel.yaw_increment_rad,
        rollout(policy, tested, "VISION").yaw_increment_rad,
    )


def test_the_table_has_every_place_and_no_p_of_few_logs(
    recordings: Recordings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.delenv("MIXO_REAL_DATA", raising=False)
    many = synthetic_recordings(1, scenes=8, steps=80)
    scenes = tuple(replace(scene, log=f"log-{i}") for i, scene in enumerate(many.scenes))
    save_recordings(recordings, tmp_path / "home")
    save_recordings(many.replace(replace(many.manifest, scenes=scenes)), tmp_path / "many")
    study = Transfer((tmp_path / "many",), tmp_path / "home", (3,), ("CAM_FRONT",), rows=("MEDIAN", "LINEAR"))
    table = study.run()
    places = list(dict.fromkeys(str(row[0]) for row in table.rows))
    assert [place.rpartition(" (")[0] for place in places] == [
        f"{place}, {way}" for place in ("here", "many") for way in ("10 Hz", "3 Hz", "CAM_FRONT alone")
    ]
    columns = [column.heading for column in table.columns]
    assert columns == ["place", "what", "MEDIAN", "LINEAR", "LINEAR THERE", "HUBER THERE"]
    for place in places:
        lines = {row[1]: [str(cell) for cell in row[2:]] for row in table.rows if row[0] == place}
        assert list(lines) == ["RTE", "closed, RTE / ATE", "- LINEAR", "- LINEAR THERE", "- HUBER THERE"]
        assert lines["- LINEAR"][1] == "-"
        assert lines["closed, RTE / ATE"][1] == "0 % / 0 %"
        median, linear = (float(cell) for cell in lines["RTE"][:2])
        assert float(lines["- LINEAR"][0].partition(" %")[0]) == pytest.approx(100 * (median / linear - 1), abs=1.0)
        assert ("(" in lines["- LINEAR"][0]) == place.startswith("many")
    shown = [[str(cell) for cell in row] for row in replace(study, intervals=True).run().rows]
    for what, ends in (("- LINEAR", 1), ("closed, RTE / ATE", 2)):
        found = [cell for row in shown if row[1] == what for cell in row[2:] if "[" in cell]
        assert found
        for cell in found:
            numbers = [float(number) for number in re.findall(r"[-+]?[\d.]+", cell)]
            assert len(numbers) == 3 * ends
            for share, low, high in zip(*(numbers[k::3] for k in range(3)), strict=True):
                assert low - 0.5 <= share <= high + 0.5  # as printed
    alone_here = Closing(tmp_path / "home", rows=("MEDIAN",), tracks=("VISION",), seeds=1).run().rows[0][1:]
    way = next(row[2] for row in shown if row[1] == "closed, RTE / ATE").split(" / ")  # few logs: no interval
    for share, expected in zip(way, alone_here, strict=True):
        assert float(share.removesuffix(" %")) == pytest.approx(float(str(expected).partition(" ")[0]), abs=0.56)
    assert main(["--home", str(tmp_path / "none")]) == 1
    assert capsys.readouterr().out == ""
