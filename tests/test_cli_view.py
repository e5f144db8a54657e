"""`mixo view`: one drive in Rerun and as a film, with the leaderboard's numbers."""

from __future__ import annotations

import itertools
import os
import re
import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
import simplejpeg

from mixo_env.cli.main import main
from mixo_env.envs import rendering
from mixo_env.errors import ConfigurationError
from mixo_env.experts.expert import State
from mixo_env.leaderboard import rerun_file
from mixo_env.leaderboard.film import frames
from mixo_env.leaderboard.one_drive import OneDrive, most_winding, one_drive, protocol_of
from mixo_env.leaderboard.rig import WIDTH_PX, Rig
from mixo_env.leaderboard.trajectories import chosen, ways
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.policies.outside import Outside, Reading
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.store import save_recordings
from mixo_env.simulator.config import SimulationConfig
from mixo_env.simulator.dataset import simulate
from tests.recording_fakes import FAKES
from tests.synthetic import synthetic_recordings

ROOT = Path(__file__).parent.parent
RECORDINGS = synthetic_recordings(scenes=8, steps=20)
SCENE = "scene-2002"
SLIDE_PX = 3
"""How far the simulated cameras' pictures move from one to the next."""


def policies(*names: str) -> tuple[Outside, ...]:
    return chosen(names, RECORDINGS, Reading())


@pytest.fixture(scope="module")
def drive() -> OneDrive:
    return one_drive(RECORDINGS, SCENE, "CONSUMER", policies("LINEAR", "MEDIAN"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("recordings")
    save_recordings(RECORDINGS, path)
    return path


@pytest.fixture(scope="module")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Recordings]:
    """A simulated folder whose pictures slide to the right, and recordings of it."""
    root = tmp_path_factory.mktemp("pictured")
    simulate(SimulationConfig(scenes=1, scenes_per_log=1, seconds=2, images=False, width=320, height=180), root)
    noise = np.random.default_rng(0).integers(0, 256, (45, 160), np.uint8)
    texture = cv2.resize(noise, (640, 180), interpolation=cv2.INTER_CUBIC)
    dataset = open_dataset(root)
    for reel in dataset.load(dataset.scene_names[0]).cameras.values():
        for k, path in enumerate(reel.image_paths):
            path.parent.mkdir(parents=True, exist_ok=True)
            left = 320 - SLIDE_PX * k
            path.write_bytes(
                simplejpeg.encode_jpeg(np.ascontiguousarray(texture[:, left : left + 320, None]), 95, "GRAY")
            )
    return root, record(dataset, RecordConfig(), root / "recordings", experts=FAKES)


def test_ways_are_those_that_export_writes(drive: OneDrive) -> None:
    written = {
        way.row: way.trajectory.matrices()[:, :2, 3]
        for way in ways(RECORDINGS, "CONSUMER", policies("LINEAR", "MEDIAN"), folds=[1])
        if way.scene == SCENE
    }
    shown = {way.name: np.stack([way.x_m, way.y_m], axis=1) for way in (*drive.ways, drive.truth)}
    shown["groundtruth"] = shown.pop("truth")
    assert set(shown) == set(written)
    for name, way in written.items():
        np.testing.assert_allclose(shown[name], way, atol=1e-9)


def test_weights_are_those_of_policies_fitted_on_other_drives(drive: OneDrive) -> None:
    by_name = {way.name: way for way in drive.ways}
    protocol = protocol_of(RECORDINGS, SCENE, "CONSUMER", (), 0)
    fitted = protocol.fitted("LINEAR", "CONSUMER", 1, 0)
    expected = fitted.act({"yaw_rates": np.zeros((1, 5), np.float32)})
    linear = by_name["LINEAR"]
    assert linear.experts == fitted.experts
    np.testing.assert_allclose(linear.weights, np.broadcast_to(expected, linear.weights.shape))
    assert len(linear.weights) == len(drive.time_s) - 1
    assert not by_name["CAM_FRONT"].experts
    assert drive.error_m(linear)[0] == 0.0 < drive.error_m(linear)[-1]


def test_the_scene_that_turns_most_is_the_default() -> None:
    yaw = [RECORDINGS.rows(i)["truth.yaw_rad"] for i in range(len(RECORDINGS))]
    assert most_winding(RECORDINGS) == RECORDINGS.scenes[int(np.argmax([np.ptp(y) for y in yaw]))].name


def test_a_scene_outside_all_folds_is_played_by_policies_of_all_folds() -> None:
    from dataclasses import replace

    scenes = tuple(replace(s, fold=-1) if s.log == RECORDINGS.scenes[1].log else s for s in RECORDINGS.scenes)
    night = RECORDINGS.replace(replace(RECORDINGS.manifest, scenes=scenes))
    drive = one_drive(night, SCENE, "VISION", chosen(["LINEAR"], night, Reading()))
    assert drive.ways[-1].weights.shape == (len(drive.time_s) - 1, 4)


def test_a_film_shows_every_step_and_names_its_policy(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "new" / "drive.mp4"
    command = ["view", str(folder), "--scene", SCENE, "--policies", "linear", "--track", "VISION", "--out", str(out)]
    assert main(command) == 0
    assert [path.name for path in out.parent.iterdir()] == ["drive.mp4"]
    expected = list(frames(RECORDINGS, SCENE, "VISION", policies("LINEAR")[0]))
    assert len(expected) == RECORDINGS.scenes[1].rows
    film = cv2.VideoCapture(str(out))
    assert film.get(cv2.CAP_PROP_FPS) == 12.0
    for picture in expected:
        there, frame = film.read()
        assert there
        assert frame.shape == (540, 960, 3)
        assert np.abs(frame[:, :, ::-1].astype(int) - picture).mean() < 6.0  # colours are coded at half the size
    assert not film.read()[0]
    left, top, _, _ = rendering.MAP
    title = np.full((24, 300, 3), 255, np.uint8)
    rendering.write(title, "policy LINEAR, track VISION", (0, 16))
    np.testing.assert_array_equal(expected[-1][top + 46 : top + 70, left + 12 : left + 312], title)
    assert (expected[0] != expected[-1]).any()


@pytest.mark.parametrize(
    ("options", "code", "words"),
    [
        (["--out", "drive.gif"], 2, "expected a file .rrd or .mp4"),
        (["--out", "drive.mp4", "--policies", "HUBER", "LINEAR"], 2, "a film shows one policy"),
        (["--out", "drive.mp4", "--spawn"], 2, "a film shows one policy"),
        (["--out", "drive.mp4", "--scene", "scene-2"], 2, "unknown scene 'scene-2'"),
        (["--out", "drive.mp4", "--policies", "PERFECT YAW"], 2, "is a floor"),
        (["--out", "drive.mp4", "--policies", "HUBBER"], 2, "did you mean 'HUBER'"),
        (["--out", "drive.mp4", "--images", "nowhere"], 1, "nowhere"),
    ],
)
def test_what_cannot_be_shown_is_one_line(
    options: list[str],
    code: int,
    words: str,
    folder: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["view", str(folder), *options]) == code
    said = capsys.readouterr().err
    assert words in said
    assert said.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_without_rerun_there_is_one_line(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(rerun_file, "find_spec", lambda name: None)
    assert main(["view", str(folder), "--out", str(tmp_path / "drive.rrd")]) == 2
    assert capsys.readouterr().err == "mixo: the viewer needs the package rerun-sdk: pip install 'mixo-env[view]'\n"
    assert not list(tmp_path.iterdir())


def test_no_viewer_is_opened_without_a_display(drive: OneDrive, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(ConfigurationError, match="needs a display"):
        rerun_file.open_viewer(drive, None, lambda done, total: None)


def test_corners_are_found_again_where_the_picture_slid_to(pictured: tuple[Path, Recordings]) -> None:
    root, recordings = pictured
    rig = Rig(recordings, root)
    assert rig.has_images
    assert tuple(rig.calibrations) == recordings.manifest.cameras
    camera = "CAM_FRONT"
    looks = list(rig.looks(camera))
    taken = np.isfinite(recordings[f"{camera}.image_time_offset_s"])
    assert [look.row for look in looks] == np.flatnonzero(taken).tolist()
    assert len(looks[0].matches) == 0
    number = {
        path.name: k for k, path in enumerate(open_dataset(root).reel(recordings.scenes[0].name, camera).image_paths)
    }
    paths = [rig._images.paths(0, look.row)[camera] for look in looks]
    for (before, path), look in zip(itertools.pairwise(paths), looks[1:], strict=True):
        assert before
        assert path
        slid = (number[path.name] - number[before.name]) * SLIDE_PX * WIDTH_PX / 320
        assert len(look.matches) > 30
        np.testing.assert_allclose(np.median(look.matches[:, 1] - look.matches[:, 0], axis=0), [slid, 0.0], atol=0.6)
        assert simplejpeg.decode_jpeg_header(look.jpeg)[:2] == (225, WIDTH_PX)


def test_a_broken_picture_is_passed_over(pictured: tuple[Path, Recordings], tmp_path: Path) -> None:
    root, recordings = pictured
    rig = Rig(recordings, root)
    broken = rig._images.paths(0, 5)["CAM_BACK"]
    assert broken
    whole = broken.read_bytes()
    try:
        broken.write_bytes(whole[: len(whole) // 2])
        rows = [look.row for look in rig.looks("CAM_BACK")]
    finally:
        broken.write_bytes(whole)
    assert [look.row for look in rig.looks("CAM_BACK") if look.row not in rows] == [5]


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
def test_the_file_for_rerun_holds_the_numbers(drive: OneDrive, folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    out = tmp_path / "drive.rrd"
    command = ["view", str(folder), "--scene", SCENE, "--policies", "LINEAR", "MEDIAN", "--out", str(out)]
    assert main(command) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["drive.rrd"]
    for way in drive.ways:
        check(out, f"/error_m/{way.name}", "Scalars", drive.time_s, drive.error_m(way))
        check(out, f"/world/ways/{way.name}/now", "Points3D", drive.time_s, rerun_file.places_m(drive, way))
        for j, expert in enumerate(way.experts):
            check(out, f"/weights/{way.name}/{expert}", "Scalars", drive.time_s[1:], way.weights[:, j])
    check(out, "/world/truth/now", "Points3D", drive.time_s, rerun_file.places_m(drive, drive.truth))
    for camera in RECORDINGS.manifest.cameras:
        matches, lost = (drive.recordings[f"{camera}.{name}"] for name in ("matches", "state"))
        there = np.isfinite(matches)
        check(out, f"/matches/{camera}", "Scalars", drive.time_s[there], matches[there])
        check(out, f"/lost/{camera}", "Scalars", drive.time_s, (lost == State.LOST).astype(float))


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
def test_the_file_for_rerun_holds_the_rig_and_its_images(pictured: tuple[Path, Recordings], tmp_path: Path) -> None:
    pytest.importorskip("rerun")
    root, recordings = pictured
    out, store = tmp_path / "drive.rrd", tmp_path / "recordings"
    save_recordings(recordings, store)
    command = [
        "view",
        str(store),
        "--policies",
        "MEDIAN",
        "--track",
        "VISION",
        "--images",
        str(root),
        "--out",
        str(out),
    ]
    assert main(command) == 0
    rig = Rig(recordings, root)
    for camera in rig.calibrations:
        looks = list(rig.looks(camera))
        times, images = over_time(out, f"/world/rig/{camera}", "EncodedImage:blob")
        np.testing.assert_allclose(times, recordings["time_s"][[look.row for look in looks]], atol=1e-6)
        assert [bytes(image[0]) for image in images] == [look.jpeg for look in looks]


def over_time(path: Path, entity: str, component: str) -> tuple[np.ndarray, list]:
    """Times [s] and values of one component of an entity."""
    from rerun.chunk import RrdReader  # pyright: ignore[reportMissingImports]

    times, values = [], []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path.replace("\\", "") != entity or chunk.is_static:
            continue
        batch = chunk.to_record_batch()
        names = [name for name in batch.schema.names if component in name]
        if names:
            times += batch.column("time_s").cast("int64").to_pylist()
            values += batch.column(names[0]).to_pylist()
    order = np.argsort(times, kind="stable")
    return 1e-9 * np.array(times)[order], [values[k] for k in order]


def check(path: Path, entity: str, kind: str, time_s: np.ndarray, expected: np.ndarray) -> None:
    component = {"Scalars": "Scalars:scalars", "Points3D": "Points3D:positions"}[kind]
    times, values = over_time(path, entity, component)
    np.testing.assert_allclose(times, time_s, atol=1e-6, err_msg=entity)
    np.testing.assert_allclose(np.array(values)[:, 0], expected, rtol=1e-6, err_msg=entity)


COMMANDS = [
    line
    for block in re.findall(r"```sh\n(.*?)```", (ROOT / "docs" / "viewers.md").read_text(encoding="utf-8"), re.DOTALL)
    for line in block.splitlines()
]


@pytest.mark.site
@pytest.mark.integration
@pytest.mark.parametrize("line", COMMANDS)
def test_the_page_is_followed_word_by_word(line: str, pictured: tuple[Path, Recordings], tmp_path: Path) -> None:
    """Only the path of the real folder is another."""
    pytest.importorskip("tensorboard" if "--tensorboard" in line else "rerun")
    root, recordings = pictured
    save_recordings(recordings, tmp_path / "recordings")
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "-c", line.replace("/data/nuscenes", str(root))]
    done = subprocess.run(
        command, cwd=tmp_path, env=os.environ | {"PATH": path}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, (line, done.stdout, done.stderr)
    out = re.findall(r"--(?:out|tensorboard) (\S+)", line)
    assert all((tmp_path / name).exists() for name in out)
