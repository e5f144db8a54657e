"""ORB-SLAM3 over a folder: files that `mixo import` reads, nothing done twice, nothing told across two maps."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from experiments.peers import orbslam3_expert
from experiments.peers.orbslam3_client import OrbRun, OrbSettings, orbslam3_python
from experiments.peers.orbslam3_expert import SETTINGS, files_of, main, working_intrinsic
from mixo_env.cli.main import main as mixo
from mixo_env.experts.imported import imported_increments
from mixo_env.experts.monocular.camera import mount
from mixo_env.experts.quality import read_quality
from mixo_env.geometry import rotation_from_yaw
from mixo_env.recordings.store import load_recordings
from mixo_env.trajectory.formats import TrajectoryFiles
from tests.corridor import AXES, calibration
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import write_sliding_texture

STEP_US, START_US = 83_333, 1_533_151_603_512_404


def run_of(states: list[str], yaw: np.ndarray, mounting: np.ndarray) -> OrbRun:
    """A program that says ``states`` and is right; every map starts in a frame of its own."""
    rng, frames, world = np.random.default_rng(0), [], np.eye(3)
    for k, state in enumerate(states):
        if k and state == "OK" and states[k - 1] == "NOT_INITIALIZED":
            world = np.linalg.qr(rng.standard_normal((3, 3)))[0]
            world *= np.linalg.det(world)
        frames.append(world @ rotation_from_yaw(yaw[k]) @ mounting if state == "OK" else np.full((3, 3), np.nan))
    rotation, n = np.array(frames), len(states)
    position = np.where(np.isfinite(rotation[:, :1, 0]), np.arange(n)[:, None] * np.ones(3), np.nan)
    matches = np.where(np.isfinite(rotation[:, 0, 0]), 100 + np.arange(n), 0)
    return OrbRun(rotation, position, tuple(states), matches, np.zeros(n), np.zeros(n), 0.0)


@pytest.mark.parametrize("mounting_deg", [0.0, 55.0, 180.0])
def test_increments_are_the_cars_and_none_leads_from_map_to_map(mounting_deg: float, tmp_path: Path) -> None:
    states = ["NOT_INITIALIZED"] * 3 + ["OK"] * 10 + ["RECENTLY_LOST"] * 2 + ["OK"] * 5
    states += ["RECENTLY_LOST", "LOST", "NOT_INITIALIZED"] + ["OK"] * 12
    yaw = np.cumsum(np.random.default_rng(1).uniform(-0.05, 0.05, len(states)))
    mounting = rotation_from_yaw(math.radians(mounting_deg)) @ AXES
    stamps = START_US + STEP_US * np.arange(len(states))
    trajectory, quality = files_of(run_of(states, yaw, mounting), stamps, mounting)
    path = tmp_path / "scene-2001.txt"
    path.write_text(trajectory)
    (tmp_path / "scene-2001.quality.csv").write_text(quality)

    read = TrajectoryFiles().read(path)
    told = read_quality(tmp_path / "scene-2001.quality.csv", len(states))
    found = imported_increments(read, stamps, lost=told.lost)
    known = np.isfinite(found)
    assert known[4:20].all()  # a map, lost and found again
    bridged = slice(13, 16)
    assert found[bridged].sum() == pytest.approx(yaw[15] - yaw[12], abs=1e-6)
    found[bridged] = np.diff(yaw)[12:15]
    np.testing.assert_allclose(found[known], np.diff(yaw, prepend=0.0)[known], atol=1e-6)
    second = 23 + int(np.argmax(~told.lost[23:]))  # the first pose that is told of the second map
    assert stamps[second] - stamps[19] > 600_000
    assert not known[20 : second + 1].any()
    assert known[second + 1 :].all()
    assert told.matches.tolist() == [0, 0, 0, *range(103, 113), 0, 0, *range(115, 120), 0, 0, 0, *range(123, 135)]


def test_a_program_that_is_never_sure(tmp_path: Path) -> None:
    states = ["NOT_INITIALIZED"] * 5
    trajectory, quality = files_of(run_of(states, np.zeros(5), AXES), START_US + STEP_US * np.arange(5), AXES)
    (tmp_path / "a.txt").write_text(trajectory)
    assert len(TrajectoryFiles().read(tmp_path / "a.txt")) == 5
    (tmp_path / "a.quality.csv").write_text(quality)
    assert read_quality(tmp_path / "a.quality.csv", 5).lost.all()


def test_pixels_of_the_halved_picture() -> None:
    """A ray hits the halved picture where the working pixel lies that :class:`MountedCamera` gives the ray to."""
    camera = mount(calibration(), 640 * 360 // 4)
    assert camera.halvings == 1
    pixel = np.array([[100.0, 20.0], [0.0, 0.0]])
    plane = np.column_stack([camera.plane(pixel), [1.0, 1.0]])
    np.testing.assert_allclose((plane @ working_intrinsic(camera).T)[:, :2], pixel, atol=1e-9)


def test_settings_by_name() -> None:
    assert SETTINGS["small"] == (OrbSettings(2000, 8), 800 * 450)
    assert SETTINGS["paper"] == (OrbSettings(8000, 19), 1600 * 900)


def test_without_the_peer_it_is_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(orbslam3_expert, "orbslam3_python", lambda: None)
    write_nuscenes(tmp_path / "root", DRIVES[:1], duration_s=1.0)
    assert main(["--dataroot", str(tmp_path / "root"), "--out", str(tmp_path / "out")]) == 1
    assert "ORB-SLAM3 cannot be installed here" in caplog.text
    assert len(caplog.messages) == 1
    assert not (tmp_path / "out").exists()


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """Two scenes of a second, whose pictures slide."""
    folder = tmp_path / "root"
    write_sliding_texture(folder, write_nuscenes(folder, DRIVES[:2], duration_s=1.0, images=False))
    return folder


def test_a_finished_camera_is_not_done_again(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    calls: list[int] = []

    def fake(*arguments: object) -> OrbRun:
        calls.append(len(arguments[1]))  # type: ignore[arg-type]
        if len(calls) == 2:
            raise KeyboardInterrupt
        n = calls[-1]
        return run_of(["OK"] * n, np.zeros(n), AXES)

    monkeypatch.setattr(orbslam3_expert, "orbslam3_python", lambda: Path("python"))
    monkeypatch.setattr(orbslam3_expert, "run_orbslam3", fake)
    monkeypatch.setattr(orbslam3_expert, "train_words", lambda images, path: path.write_text(str(len(list(images)))))
    command = ["--dataroot", str(root), "--out", str(tmp_path / "out"), "--cameras", "CAM_FRONT", "CAM_BACK"]
    with pytest.raises(KeyboardInterrupt):
        main(command)
    assert len(list((tmp_path / "out").rglob("*.txt"))) == 3  # words, settings and one that is done
    assert main(command) == 0
    assert len(calls) == 2 + 3
    assert main(command) == 0
    assert len(calls) == 5
    assert len(list((tmp_path / "out" / "ORBSLAM3_BACK").iterdir())) == 4
    assert main([*command, "--settings", "paper"]) == 1
    assert "made with other settings" in caplog.text


@pytest.mark.integration
def test_a_tiny_folder_is_run_and_imported(root: Path, tmp_path: Path) -> None:
    if orbslam3_python() is None:
        pytest.skip("ORB-SLAM3 cannot be installed here")
    out = tmp_path / "out"
    assert main(["--dataroot", str(root), "--out", str(out), "--cameras", "CAM_FRONT"]) == 0
    files = sorted((out / "ORBSLAM3_FRONT").glob("*.txt"))
    assert len(files) == 2
    for file in files:
        poses = TrajectoryFiles().read(file)
        assert len(poses) >= 12
        assert np.isfinite(read_quality(file.with_suffix(".quality.csv"), len(poses)).matches).all()
    recorded, made = str(tmp_path / "recorded"), str(tmp_path / "with")
    assert mixo(["record", str(root), "--out", recorded, "--cameras", "CAM_FRONT"]) == 0
    assert mixo(["import", recorded, "--expert", f"ORBSLAM3_FRONT={out / 'ORBSLAM3_FRONT'}", "--out", made]) == 0
    assert "ORBSLAM3_FRONT" in load_recordings(made).further
