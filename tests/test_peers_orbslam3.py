"""ORB-SLAM3 as a yardstick: our vocabulary file, and its poses on a short drive."""

from __future__ import annotations

import math
import os
from pathlib import Path

import numpy as np
import pytest

from experiments.peers.orbslam3_client import OrbRun, OrbSettings, orbslam3_python, run_orbslam3
from experiments.peers.orbslam3_words import BRANCHES, train_words
from experiments.speed.drives import open_drives
from mixo_env.errors import ConfigurationError, MixoError
from mixo_env.geometry import rotation_from_yaw
from tests.corridor import AXES, calibration, picture

IMAGES, INTERVAL_US = 70, 83_333


@pytest.fixture(scope="module")
def ride() -> tuple[list[np.ndarray], np.ndarray]:
    """Pictures of a drive that sways left and right at 7 m/s; true yaw increments [rad]."""
    camera = calibration()
    yaw = 0.12 * np.sin(np.arange(IMAGES) / 8.0)
    step = 7.0 * INTERVAL_US * 1e-6
    x, y = np.cumsum(step * np.cos(yaw)), np.cumsum(step * np.sin(yaw))
    pictures = [picture(camera, x[k], y[k], yaw[k], k) for k in range(IMAGES)]
    return pictures, np.diff(yaw)


@pytest.fixture(scope="module")
def words(ride: tuple[list[np.ndarray], np.ndarray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("words") / "words.txt"
    assert train_words(ride[0][::4], path) >= BRANCHES**2
    return path


@pytest.mark.integration
def test_vocabulary_is_a_tree_in_text(words: Path) -> None:
    text = words.read_text(encoding="ascii")
    assert not text.endswith("\n")
    head, *lines = text.splitlines()
    assert head.split() == ["10", "6", "0", "0"]
    parent, leaf, weight = [], [], []
    for number, line in enumerate(lines, start=1):
        items = line.split()
        assert len(items) == 1 + 1 + 32 + 1
        assert all(0 <= int(byte) <= 255 for byte in items[2:34])
        parent.append(int(items[0]))
        leaf.append(items[1] == "1")
        weight.append(float(items[-1]))
        assert 0 <= parent[-1] < number  # parents come first
    children = np.bincount(parent, minlength=len(lines) + 1)
    assert children[0] == BRANCHES
    assert set(children) <= {0, BRANCHES}
    assert list(children[1:] == 0) == leaf
    assert all((w > 0.0) == is_word for w, is_word in zip(weight, leaf, strict=True))


def test_vocabulary_of_nothing_is_one_clear_line(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="give more images"):
        train_words([np.zeros((90, 120), np.uint8)], tmp_path / "words.txt")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("height", "width", "levels"), [(900, 1600, 19), (450, 800, 15), (370, 1226, 14), (20, 20, 1)])
def test_levels_that_fit(height: int, width: int, levels: int) -> None:
    assert OrbSettings(8000, 19).fitting(height, width) == OrbSettings(8000, levels)


@pytest.mark.parametrize("mounting_deg", [0.0, 110.0, 250.0])
def test_yaw_increments_are_the_cars(mounting_deg: float) -> None:
    """A camera that looks anywhere, in a world that lies anyhow: the yaw is the car's; NaN where a pose is missing."""
    mounting = rotation_from_yaw(math.radians(mounting_deg)) @ AXES
    yaw = np.array([0.0, 0.1, 0.05, 0.3, 0.31])
    world = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    rotation = np.array([world @ rotation_from_yaw(angle) @ mounting for angle in yaw])
    rotation[3] = np.nan
    nothing = np.zeros(5)
    found = OrbRun(
        rotation, np.zeros((5, 3)), ("OK",) * 5, np.zeros(5, np.int64), nothing, nothing, 0.0
    ).yaw_increments(mounting)
    np.testing.assert_allclose(found[:2], np.diff(yaw)[:2], atol=1e-12)
    assert np.isnan(found[2:]).all()


@pytest.fixture(scope="module")
def python() -> Path:
    """Its interpreter; the tests skip when pip cannot install it."""
    found = orbslam3_python()
    if found is None:
        pytest.skip("ORB-SLAM3 cannot be installed here")
    return found


@pytest.mark.integration
def test_poses_of_a_short_drive(python: Path, words: Path, ride: tuple[list[np.ndarray], np.ndarray]) -> None:
    pictures, truth = ride
    camera = calibration()
    stamps = np.arange(1, IMAGES + 1) * INTERVAL_US
    run = run_orbslam3(python, pictures, stamps, camera.intrinsic, words, OrbSettings(1000), pace=0.5)
    assert run.rotation.shape == (IMAGES, 3, 3)
    assert run.position.shape == (IMAGES, 3)
    assert (run.tracking_ms > 0.0).all()
    assert run.process_ms > np.mean(run.tracking_ms)
    good = np.isfinite(run.rotation[:, 0, 0])
    assert good.mean() > 0.3
    assert (good == np.isfinite(run.position[:, 0])).all()
    square = run.rotation[good] @ np.swapaxes(run.rotation[good], 1, 2)
    np.testing.assert_allclose(square, np.broadcast_to(np.eye(3), square.shape), atol=1e-4)
    error = np.degrees(run.yaw_increments(camera.rotation_ego_from_camera) - truth)
    error = error[np.isfinite(error)]
    assert len(error) > 20
    assert np.median(np.abs(error)) < 0.15
    assert np.max(np.abs(truth)) > math.radians(0.7)  # so that a wrong sign would have shown


@pytest.mark.integration
def test_death_is_one_clear_line(python: Path, tmp_path: Path, ride: tuple[list[np.ndarray], np.ndarray]) -> None:
    with pytest.raises(MixoError, match="ORB-SLAM3 ended with code") as caught:
        run_orbslam3(
            python,
            ride[0][:2],
            np.array([1, 2 * INTERVAL_US]),
            calibration().intrinsic,
            tmp_path / "none.txt",
            OrbSettings(),
        )
    assert "\n" not in str(caught.value)


@pytest.mark.skipif("MIXO_REAL_DATA" not in os.environ, reason="MIXO_REAL_DATA is not set")
def test_kitti_sequence_is_a_drive() -> None:
    (drive,) = open_drives(Path(os.environ["MIXO_REAL_DATA"]) / "kitti_06", (), ())
    height, width = drive.read(drive.image_paths[0]).shape
    assert (width, height) == (drive.calibration.width, drive.calibration.height) == (1226, 370)
    assert len(drive.image_paths) == len(drive.timestamp_us) == len(drive.turn_rad) + 1 == len(drive.path_m) + 1 == 51
    assert np.all(np.diff(drive.timestamp_us) > 0)
    assert np.median(drive.path_m) == pytest.approx(1.2, abs=0.1)
    assert np.max(np.abs(drive.turn_rad)) < math.radians(1.0)
