"""The page on which a drive is played by hand: its numbers are the environment's, and so is its arithmetic."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import gymnasium as gym
import numpy as np
import pytest

from docs._pages.play.drive import drive_json, telling_drive
from docs._pages.play.page import page as make_page
from mixo_env.envs.replay import Replay
from mixo_env.errors import RecordingError
from mixo_env.experts.expert import State
from mixo_env.metrics.relative import relative_samples_se2
from mixo_env.recordings.collection import Recordings
from mixo_env.trajectory.planar import PlanarPoses
from tests.browser import PHONE, open_file, wait_until
from tests.bundle import bundled
from tests.synthetic import synthetic_recordings

if TYPE_CHECKING:
    from playwright.sync_api import Page

PAGE = Path(__file__).parent.parent / "docs" / "play.html"
AGAIN = "after new recordings or another page: python -m docs._pages.play"
HOSTILE = "</script><script>document.title = 'taken'</script>\"'<b>&amp;@drive@"
WEIGHTS = (50, 25, 100, 25)
"""Of the four sliders; their shares are exact in float32."""


@pytest.fixture(scope="module")
def drive() -> dict[str, Any]:
    found = re.search(r'<script type="application/json" id="drive">(.*?)</script>', PAGE.read_text(encoding="utf-8"))
    assert found
    return json.loads(found[1])


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return bundled()


@pytest.fixture(scope="module")
def synthetic() -> Recordings:
    return synthetic_recordings(0, scenes=4, steps=80)


@pytest.fixture
def small(synthetic: Recordings, tmp_path: Path) -> Path:
    """A page of an invented drive, without pictures."""
    return write(tmp_path / "small.html", drive_json(synthetic, synthetic.scenes[0].name, "VISION", ("HUBER",)))


def write(path: Path, drive: dict[str, Any]) -> Path:
    pictures = {"width": 16, "height": 9, "columns": 1, "every": 2, "sheets": {}}
    path.write_text(make_page(drive | {"pictures": pictures}), encoding="utf-8")
    return path


def numbers(value: Any) -> Iterator[float]:
    """All numbers in nested lists, in order; none is NaN."""
    if isinstance(value, list):
        for one in value:
            yield from numbers(one)
    elif value is None:
        yield np.nan
    else:
        yield float(value)


def test_the_page_is_small_and_reaches_no_network() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert len(text.encode()) < 2_000_000
    assert not re.search(r"(?:https?|wss?)://|<(?:script|link|img|iframe)[^>]+(?:src|href)=|@import|url\(", text)
    assert "default-src 'none'" in text


def test_the_page_is_written_from_its_parts(drive: dict[str, Any]) -> None:
    assert PAGE.read_text(encoding="utf-8") == make_page(drive), AGAIN


def test_the_pages_numbers_are_those_of_the_recordings(drive: dict[str, Any], recordings: Recordings) -> None:
    assert drive["data"] == recordings.manifest.data_version, AGAIN
    expected = drive_json(recordings, drive["scene"], drive["track"], rows=())
    assert set(expected) | {"pictures"} == set(drive)
    for name in ("experts", "states", "matches", "fold", "log", "conditions"):
        assert drive[name] == expected[name], AGAIN
    for name in ("dt_s", "distance_m", "substitute_rad", "claims_rad"):
        np.testing.assert_allclose([*numbers(drive[name])], [*numbers(expected[name])], atol=1e-12, err_msg=AGAIN)
    for part in ("truth", "pieces"):
        for name, values in expected[part].items():
            np.testing.assert_allclose(drive[part][name], values, atol=1e-12, err_msg=AGAIN)


def test_the_pages_drive_is_one_on_which_fusion_matters(drive: dict[str, Any]) -> None:
    """A camera is lost while the car turns, and the front camera alone errs more than HUBER."""
    rate = np.abs(np.array(drive["truth"]["increment_rad"]) / drive["dt_s"])
    assert any("l" in np.array(list(states))[rate > 0.05] for states in drive["states"].values())
    claims = np.array(drive["claims_rad"], dtype=np.float64)
    claims = np.where(np.isnan(claims), np.array(drive["substitute_rad"])[:, None], claims)
    front = np.cumsum(claims[:, drive["experts"].index("CAM_FRONT")]) - drive["truth"]["yaw_rad"]
    (huber,) = (row for row in drive["rows"] if row["name"] == "HUBER")
    fused = np.cumsum((claims * huber["weights"]).sum(axis=1)) - drive["truth"]["yaw_rad"]
    assert np.sqrt(np.mean(fused**2)) < 0.8 * np.sqrt(np.mean(front**2))


def test_the_telling_drive_has_a_camera_lost_in_a_turn(synthetic: Recordings) -> None:
    """The synthetic car turns all the time; only in the chosen scene a camera is lost."""
    cameras = synthetic.manifest.cameras
    never = {f"{c}.state": np.full(synthetic.offsets[-1], State.TRACKING, np.int8) for c in cameras}
    with pytest.raises(RecordingError, match="no camera is lost in a turn"):
        telling_drive(synthetic.replace(columns=never), "VISION")
    first, stop = synthetic.offsets[2:4]
    rate = np.abs(synthetic["truth.yaw_increment_rad"][first + 1 : stop] / synthetic["dt_s"][first + 1 : stop])
    once = never | {f"{cameras[1]}.state": never[f"{cameras[1]}.state"].copy()}
    once[f"{cameras[1]}.state"][first + 1 + int(np.argmax(rate))] = State.LOST
    assert rate.max() > 0.05
    assert telling_drive(synthetic.replace(columns=once), "VISION") == synthetic.scenes[2].name


def test_a_drive_in_no_fold_is_refused(synthetic: Recordings) -> None:
    with pytest.raises(RecordingError, match="in a fold"):
        drive_json(synthetic, "scene-0000", "VISION")


def set_weights(page: Page, weights: tuple[int, ...]) -> None:
    for j, weight in enumerate(weights):
        page.locator("#experts input").nth(j).fill(str(weight))


def environment(drive: dict[str, Any], recordings: Recordings, lost: str) -> Any:
    return gym.make(
        "mixo_env:MixoOdometry-v0",
        recordings=recordings,
        track=drive["track"],
        split="test",
        fold=drive["fold"],
        weights="simplex",
        lost=lost,
        render_mode="ansi",
    )


def pooled_deg_per_m(session: Any, scene: str) -> float:
    """RTE of what an environment's first entry has driven, by the library."""
    played = session.recordings.select(scenes=[scene])
    truth = PlanarPoses(*(played[f"truth.{name}"].astype(np.float64) for name in ("x_m", "y_m", "yaw_rad")))
    return float(relative_samples_se2(truth, PlanarPoses(*session.replay.trajectory(0))).rotation_deg_per_m.mean())


@pytest.mark.browser
@pytest.mark.parametrize("lost", ["inertial", "mask"])
def test_driven_to_the_end_the_errors_are_the_environments(
    page: Page, drive: dict[str, Any], recordings: Recordings, lost: str
) -> None:
    env = environment(drive, recordings, lost)
    env.reset(options={"scene": drive["scene"]})
    action, info, over = np.float32(np.array(WEIGHTS) / sum(WEIGHTS)), {}, False
    while not over:
        _, _, _, over, info = env.step(action)
    open_file(page, PAGE)
    set_weights(page, WEIGHTS)
    page.set_checked("#hide", lost == "mask")
    page.click("#end")
    mine = page.evaluate("game.you.scores()")
    for name in ("ate_m", "ate_deg", "yaw_rmse_deg"):
        assert mine[name] == pytest.approx(info[name], abs=1e-9), name
    assert mine["rte_deg_per_m"] == pytest.approx(pooled_deg_per_m(env.unwrapped.session, drive["scene"]), abs=1e-9)
    assert f"{info['ate_deg']:.3f} deg" in page.inner_text("#verdict")
    assert page.inner_text("#scores tr:first-child td:nth-child(3)") == f"{info['ate_deg']:.3f}"


@pytest.mark.browser
def test_driven_to_the_end_the_rows_to_beat_are_those_of_the_replay(
    page: Page, drive: dict[str, Any], recordings: Recordings
) -> None:
    session = environment(drive, recordings, "inertial").unwrapped.session
    replay = Replay(session.recordings.select(scenes=[drive["scene"]]), track=drive["track"])
    open_file(page, PAGE)
    page.click("#end")
    for i, row in enumerate(drive["rows"]):
        replay.reset([0])
        for weights in row["weights"]:
            replay.step(np.array([weights]))
        found = page.evaluate(f"game.rows[{i + 1}].estimate.scores()")
        for name, value in replay.scores().items():
            assert found[name] == pytest.approx(value[0], abs=1e-9), (row["name"], name)


@pytest.mark.browser
def test_without_any_weight_all_votes_are_alike(page: Page, small: Path) -> None:
    open_file(page, small)
    set_weights(page, (0, 0, 0, 0))
    page.click("#end")
    none = page.evaluate("game.you.scores()")
    page.click("#again")
    page.click("#equal")
    page.click("#end")
    assert page.evaluate("game.you.scores()") == pytest.approx(none, abs=1e-12)


@pytest.mark.browser
def test_the_keyboard_plays(page: Page, small: Path) -> None:
    open_file(page, small)
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert page.evaluate("game.you.step") == 2
    page.focus("#experts input >> nth=1")
    page.keyboard.press("ArrowRight")  # the slider's own key
    assert page.evaluate("[game.you.step, scores()]") == [2, [50, 51, 50, 50]]
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    page.evaluate("document.activeElement.blur()")
    page.keyboard.press("Space")
    wait_until(page, "game.you.step > 3")
    page.keyboard.press("Space")
    assert page.inner_text("#run").endswith("Play")
    page.keyboard.press("e")
    assert page.evaluate("game.you.step === STEPS")
    assert page.is_disabled("#run")
    page.keyboard.press("r")
    assert page.evaluate("[game.you.step, game.timer]") == [0, None]


@pytest.mark.browser
def test_who_has_no_answer_says_so_in_words(page: Page, drive: dict[str, Any]) -> None:
    camera = next(name for name, states in drive["states"].items() if "l" in states)
    open_file(page, PAGE)
    for _ in range(drive["states"][camera].index("l")):
        page.evaluate("advance()")
    page.evaluate("draw()")
    card = page.locator("#experts .expert").nth(drive["experts"].index(camera))
    assert "✕ lost; the inertial sensor votes" in card.inner_text()
    page.check("#hide")
    assert "✕ lost; no vote" in card.inner_text()
    assert card.locator("output").inner_text() == "0 %"
    assert page.evaluate("game.cards.every((card) => card.sheet.naturalWidth > 0)")


@pytest.mark.browser
def test_a_phone_shows_everything_without_scrolling_sideways(page: Page) -> None:
    page.set_viewport_size(PHONE)  # type: ignore[arg-type]
    open_file(page, PAGE)
    page.click("#end")
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]
    for canvas in ("#path", "#claims"):
        assert page.evaluate(f"byId('{canvas[1:]}').getBoundingClientRect().right") <= PHONE["width"]


@pytest.mark.browser
def test_hostile_names_stay_text(page: Page, synthetic: Recordings, tmp_path: Path) -> None:
    text = json.dumps(drive_json(synthetic, synthetic.scenes[0].name, "VISION", ("HUBER",)))
    for name in ("HUBER", synthetic.scenes[0].name, "CAM_BACK"):
        text = text.replace(f'"{name}"', json.dumps(f"{name}{HOSTILE}"))
    open_file(page, write(tmp_path / "hostile.html", json.loads(text)))
    page.click("#end")
    assert page.title().startswith("Play a drive")
    assert HOSTILE in page.title()
    assert f"HUBER{HOSTILE}" in page.locator("#scores th").all_inner_texts()
    assert page.locator("#experts b, #scores b").count() == 0
