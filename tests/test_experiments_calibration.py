"""Coverage of the experts' standard deviations, by condition."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.calibration import CONDITIONS, Told, collect, draw, main, study
from mixo_env.errors import RecordingError
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings


def in_all_weathers() -> Recordings:
    recordings = synthetic_recordings(0, scenes=6, steps=300)
    weathers = (("day",), ("day", "rain"), ("night",)) * 2
    scenes = tuple(replace(s, conditions=w) for s, w in zip(recordings.manifest.scenes, weathers, strict=True))
    return recordings.replace(replace(recordings.manifest, scenes=scenes))


def test_share_within_limits_by_hand() -> None:
    told = Told("X", "day", np.array([0.5, -0.9, 1.5, -3.0]), np.array([1.0, 1.0, 1.0, 2.0]))
    assert (told.within(1.0), told.within(1.96)) == (50.0, 100.0)
    assert told.within(1.4) == 50.0


def test_experts_that_err_as_they_say_are_calibrated() -> None:
    recordings = in_all_weathers()
    told = collect(recordings)
    assert {(part.expert, part.condition) for part in told} == {
        (expert, name) for expert in recordings.experts for name in CONDITIONS
    }
    for part in told:
        assert part.within(1.0) == pytest.approx(68.3, abs=6.0)
        assert part.within(1.96) == pytest.approx(95.0, abs=3.0)


def test_overconfidence_in_the_rain_is_seen_there_alone() -> None:
    recordings = in_all_weathers()
    wet = np.repeat(["rain" in scene.conditions for scene in recordings.scenes], np.diff(recordings.offsets))
    stated = recordings["CAM_BACK.yaw_std_rad"]
    bold = recordings.replace(columns={"CAM_BACK.yaw_std_rad": np.where(wet, stated / 3, stated).astype(np.float32)})
    rows = {(row[0], row[1]): np.array(row[2:], np.float64) for row in study(bold, collect(bold)).rows}
    assert rows["CAM_BACK", "rain"][1] < 40.0
    assert rows["CAM_BACK", "rain"][3] == pytest.approx(3.0, abs=0.4)
    assert rows["CAM_BACK", "day"][1] > 60.0
    assert rows["CAM_FRONT", "rain"][1] > 60.0


def test_an_expert_without_standard_deviations_has_no_row() -> None:
    recordings = in_all_weathers()
    nothing = np.full(len(recordings["step"]), np.nan, np.float32)
    silent = recordings.replace(columns={"CAM_BACK.yaw_std_rad": nothing})
    assert {part.expert for part in collect(silent)} >= {*CAMERAS} - {"CAM_BACK"}
    assert "CAM_BACK" not in {part.expert for part in collect(silent)}


def test_poses_of_real_drives_are_no_judge(tmp_path, caplog) -> None:
    recordings = in_all_weathers()
    nothing = np.full(len(recordings["step"]), np.nan)
    real = recordings.replace(columns={f"exact.{name}": nothing for name in ("x_m", "y_m", "yaw_rad")})
    with pytest.raises(RecordingError, match="exact truth"):
        collect(real)
    save_recordings(real, tmp_path / "real")
    assert main(["--recordings", str(tmp_path / "real")]) == 1
    assert "exact truth" in caplog.text


def test_the_figure_is_drawn(tmp_path) -> None:
    draw(collect(in_all_weathers()), tmp_path / "figure.png")
    assert (tmp_path / "figure.png").read_bytes().startswith(b"\x89PNG")
