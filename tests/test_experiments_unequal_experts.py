"""The table of unequal experts: errors by hand, lost tracks as the leaderboard counts them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from experiments.unequal_experts import COLUMNS, main, study
from mixo_env.errors import RecordingError
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.schema import VARIANT_COLUMNS
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings
from tests.test_track_unequal import with_further


def test_rows_of_every_expert() -> None:
    bare = synthetic_recordings(0, scenes=4)
    rows = {row[0]: dict(zip([c.heading for c in COLUMNS], row, strict=True)) for row in study(with_further(bare)).rows}
    assert set(rows) == {*with_further(bare).experts, JOINT}
    assert list(rows[JOINT].values())[1:] == list(rows["CAM_BACK"].values())[1:]  # its columns are those here
    assert np.isnan(rows["INERTIAL"]["lost"])  # type: ignore[arg-type]
    assert rows["ORBSLAM3_FRONT"]["RMS"] == pytest.approx(0.0, abs=1e-4)
    assert rows["TUTORIAL_BACK"]["largest"] > 10.0  # type: ignore[operator]
    assert rows["CAM_BACK"]["lost"] == 1.0  # one stretch a scene


def test_errors_by_hand() -> None:
    bare = synthetic_recordings(0, scenes=1)
    truth, steps = bare["truth.yaw_increment_rad"], len(bare["step"]) - 1
    error = np.radians(np.concatenate([[np.nan], np.full(steps - 1, 0.01), [-1.0]]))
    told = {f"{JOINT}.{name}": bare[f"CAM_BACK.{name}"] for name in VARIANT_COLUMNS}
    told[f"{JOINT}.yaw_increment_rad"] = (truth + error).astype(np.float32)
    moving = np.ones(steps + 1, np.float32)
    moving[-1] = 0.0
    given = bare.replace(replace(bare.manifest, variants={JOINT: "CAM_BACK"}), told | {"speed_mps": moving})
    row = next(row for row in study(given).rows if row[0] == JOINT)
    assert row[1] == 100.0
    rms = np.sqrt((1.0 + (steps - 1) * 1e-4) / steps)
    assert row[3:] == pytest.approx([0.01, rms, 0.01, 1.0, 0.01, 0.01], abs=1e-4)


def test_real_poses_are_no_judge(tmp_path, caplog) -> None:
    bare = synthetic_recordings(0, scenes=2)
    nothing = np.full(len(bare["step"]), np.nan)
    real = bare.replace(columns={f"exact.{name}": nothing for name in ("x_m", "y_m", "yaw_rad")})
    with pytest.raises(RecordingError, match="exact truth"):
        study(real)
    save_recordings(real, tmp_path / "real")
    assert main(["--recordings", str(tmp_path / "real")]) == 1
    assert "exact truth" in caplog.text
