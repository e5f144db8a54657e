"""What the benchmarks of the odometry print, on cases worked out by hand."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

from experiments.speed.drives import open_drives
from experiments.speed.matching import correct_matches, cpu_ms
from experiments.speed.odometry import HEAD, Run, accumulated_deg, rms, row, run_camera
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.nuscenes.tables import open_dataset
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import write_sliding_texture

DEG = math.radians(1.0)
NAMES = (
    "tracked", "lost", "median", "rms", "gain", "accumulated", "p90", "over_std", "decode_ms", "expert_ms", "scale",
)  # fmt: skip


def statistics(*runs: Run) -> dict[str, float]:
    """The printed line by name of column."""
    channel, *values = row("CAM_FRONT", list(runs)).split()
    assert channel == "CAM_FRONT"
    return dict(zip(NAMES, map(float, values), strict=True))


def run(truth_deg: list[float], error_deg: list[float], **others: object) -> Run:
    """A camera at 10 Hz whose increments are wrong by ``error_deg`` (NaN: it did not track)."""
    truth, error = np.array(truth_deg) * DEG, np.array(error_deg) * DEG
    values = {
        "truth_rad": truth,
        "dt_s": np.full(len(truth), 0.1),
        "yaw_rad": truth + error,
        "std_rad": np.full(len(truth), 0.1 * DEG),
        "rescaled_rad": np.full(len(truth), np.nan),
        "lost": 0,
        "decode_ms": [1.0],
        "expert_ms": [2.0],
    }
    return Run(**(values | others))  # type: ignore[arg-type]


def test_columns_are_the_ones_named_here() -> None:
    heading = HEAD.splitlines()[0].split()
    assert heading == ["camera", "tracked", "lost", "median", "RMS", "gain", "accum", "p90", "error", "decode",
                       "expert", "dyaw/ds"]  # fmt: skip


def test_share_tracked_and_errors_are_those_of_tracked_images() -> None:
    found = statistics(run([0.0] * 4, [0.1, -0.3, math.nan, 0.2], lost=1), run([0.0] * 4, [math.nan] * 4, lost=2))
    assert found["tracked"] == pytest.approx(3 / 8, abs=1e-3)
    assert found["lost"] == 3
    assert found["median"] == pytest.approx(0.2)
    assert found["rms"] == pytest.approx(math.sqrt((0.01 + 0.09 + 0.04) / 3), abs=1e-4)
    assert found["over_std"] == pytest.approx(10.0 * found["rms"], abs=0.01)
    assert (found["decode_ms"], found["expert_ms"]) == (1.0, 2.0)


def test_gain_is_the_slope_in_turns() -> None:
    """Turns above 5 deg/s are steps above 0.5 deg here; errors on the straight, however large, do not count."""
    truth = [2.0, -1.0, 0.4, 0.0]
    assert statistics(run(truth, [0.02, -0.01, 0.3, -0.3]))["gain"] == pytest.approx(1.01)
    assert statistics(run(truth, [-0.2, 0.1, 0.0, 0.0]))["gain"] == pytest.approx(0.9)
    # (2 x 2.5 + 1 x 1) / (4 + 1): an error of one step weighs as much as the step turns.
    assert statistics(run(truth, [0.5, 0.0, 0.0, 0.0]))["gain"] == pytest.approx(1.2)
    assert math.isnan(statistics(run([0.1, 0.2], [0.0, 0.0]))["gain"])


def test_yaw_accumulates_within_a_scene_not_across() -> None:
    left, right = run([0.0] * 10, [0.1] * 10), run([0.0] * 10, [-0.3] * 10)
    found = statistics(left, right, run([0.0] * 2, [0.5, -0.5]))
    assert found["accumulated"] == pytest.approx(1.0)  # of 1, 3 and 0 deg
    assert found["p90"] == pytest.approx(2.6)


def test_dependence_on_the_scale() -> None:
    """2 % longer distances that make every turn 1 % larger: d(yaw)/yaw over d(scale)/scale is 0.5."""
    truth = np.array([2.0, -1.0]) * DEG
    found = statistics(run([2.0, -1.0], [0.0, 0.0], rescaled_rad=1.01 * truth))
    assert found["scale"] == pytest.approx(0.5)


def test_rms() -> None:
    assert rms(np.array([3.0, 4.0])) == pytest.approx(math.sqrt(12.5))
    assert math.isnan(rms(np.empty(0)))


def test_correct_matches_do_not_count_wrong_ones() -> None:
    """A camera that moves sideways past points at random depths; every fifth match goes astray."""
    rng = np.random.default_rng(0)
    points = rng.uniform((-10.0, -5.0, 8.0), (10.0, 5.0, 40.0), (500, 3))
    p1 = 500.0 * points[:, :2] / points[:, 2:] + (400.0, 225.0)
    moved = points - (1.0, 0.1, 0.3)
    p2 = 500.0 * moved[:, :2] / moved[:, 2:] + (400.0, 225.0)
    p2[::5] += rng.uniform(30.0, 60.0, (100, 2)) * (0.1, 1.0)
    assert correct_matches(p1.astype(np.float32), p2.astype(np.float32)) == pytest.approx(400, abs=8)


def test_cpu_time_does_not_count_the_first_call() -> None:
    calls: list[int] = []
    assert cpu_ms(lambda: calls.append(1), 3) >= 0.0
    assert len(calls) == 4


def test_drives_of_a_nuscenes_folder(tmp_path: Path) -> None:
    write_sliding_texture(tmp_path, write_nuscenes(tmp_path, DRIVES[:1], duration_s=1.0, images=False))
    (drive,) = open_drives(tmp_path, (), ("CAM_FRONT",))
    track = open_dataset(tmp_path).load(DRIVES[0].name, ("CAM_FRONT",)).cameras["CAM_FRONT"]
    assert drive.image_paths == track.image_paths
    np.testing.assert_allclose(drive.turn_rad, np.diff(np.unwrap(track.yaw_rad)), atol=1e-9)
    np.testing.assert_allclose(drive.path_m, np.hypot(np.diff(track.x_m), np.diff(track.y_m)), rtol=1e-9)
    height, width = track.calibration.height, track.calibration.width
    assert drive.read(drive.image_paths[0]).shape == (height, width)
    assert drive.read(drive.image_paths[0], 1).shape == (height // 2, width // 2)


def test_drives_of_a_kitti_sequence(tmp_path: Path) -> None:
    """Camera axes there: a turn to the left is a negative rotation about y, which points down."""
    (tmp_path / "image_0").mkdir()
    poses, yaw, place = [], 0.0, np.zeros(2)
    for k in range(4):
        cv2.imwrite(str(tmp_path / "image_0" / f"{k:06d}.png"), np.full((20, 60), k, np.uint8))
        c, s = math.cos(yaw), math.sin(yaw)
        ahead, left = place
        poses.append([c, 0, -s, -left, 0, 1, 0, 0, s, 0, c, ahead])
        place = place + 1.5 * np.array([math.cos(yaw), math.sin(yaw)])
        yaw += 0.1
    np.savetxt(tmp_path / "poses.txt", poses)
    (tmp_path / "calib.txt").write_text("P0: 700 0 30 0 0 700 10 0 0 0 1 0\n")
    (drive,) = open_drives(tmp_path, (), ("CAM_FRONT",))
    np.testing.assert_allclose(drive.turn_rad, 0.1, atol=1e-6)
    np.testing.assert_allclose(drive.path_m, 1.5, atol=1e-6)
    assert (drive.calibration.width, drive.calibration.height) == (60, 20)
    assert drive.calibration.intrinsic[0, 0] == 700.0
    assert (np.diff(drive.timestamp_us) > 0).all()
    for config in (MonocularConfig(), MonocularConfig(max_pixels=600)):  # halved by the odometry: a PNG comes whole
        shown = run_camera(drive, config, rescale=False)
        assert len(shown.yaw_rad) == 3
        assert np.isnan(shown.yaw_rad).all()  # pictures without a corner


def test_accumulated_yaw_leaves_out_what_was_never_tracked() -> None:
    lost = run([1.0, 1.0], [math.nan, math.nan])
    assert accumulated_deg([run([1.0, 1.0, 1.0], [0.2, -0.5, math.nan]), lost]) == pytest.approx([0.3])
    assert np.isnan(accumulated_deg([lost])).all()
