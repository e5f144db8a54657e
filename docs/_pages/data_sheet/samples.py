"""Sample pictures of the data sheet: every situation, all cameras at one instant, movers, distributions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np

from docs._pages.data_sheet.folder import City
from docs._pages.data_sheet.motion import PERCENTILES, Numbers, motion_samples
from docs._pages.data_sheet.motion import Path as Way
from docs._pages.data_sheet.movers import EVERY, MoverShares, Sight, matched_sight, scene_sights
from experiments.picture_statistics import read_gray
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.simulator.drive.scenario import LogPlan, ScenePlan

STRIP = ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT", "CAM_BACK_RIGHT", "CAM_BACK", "CAM_BACK_LEFT")
"""Two rows as the car sees them: ahead, and behind (seen from the driver's seat, right is left)."""

JPEG_QUALITY = 82

STREET_LEFT = 0.6
"""Pictures that movers cover more than this show little else."""

Choice = Callable[[City, LogPlan, ScenePlan, str], int]
"""Chooses an image of one camera in one scene."""


@dataclass(frozen=True)
class Sample:
    """One picture of the sheet: file name below the folder of figures, what it shows, and where it comes from."""

    file: str
    title: str
    source: str


def _middle(city: City, log: LogPlan, plan: ScenePlan, channel: str) -> int:
    return len(city.dataset.reel(plan.name, channel).timestamp_us) // 2


def _fullest(kind: str | None = None) -> Choice:
    """The image that movers (of one kind) cover most, as long as it still shows a street and no wall of paint."""

    def choose(city: City, log: LogPlan, plan: ScenePlan, channel: str) -> int:
        found = scene_sights(log, plan, city.drive_again(log, plan), channel, kind)
        return max(found, key=lambda sight: sight.covered if sight.covered < STREET_LEFT else -sight.covered).index

    return choose


def _turning(city: City, log: LogPlan, plan: ScenePlan, channel: str) -> int:
    """The middle of the eight intervals in which the car turns most."""
    yaw = np.unwrap(city.dataset.reel(plan.name, channel).yaw_rad)
    return int(np.argmax(np.abs(yaw[8:] - yaw[:-8]))) + 4


def _barest(city: City, log: LogPlan, plan: ScenePlan, channel: str) -> int:
    """The image with the fewest corners, of every tenth."""
    paths = city.dataset.reel(plan.name, channel).image_paths[::EVERY]
    fast = cv2.FastFeatureDetector.create(12)
    return EVERY * int(np.argmin([len(fast.detect(read_gray(path), None)) for path in paths]))


SITUATIONS: dict[str, tuple[str, str, Choice]] = {
    "ordinary": ("Ordinary drive", "CAM_FRONT", _middle),
    "lead_truck": ("Lead truck", "CAM_FRONT", _fullest("truck")),
    "following_van": ("Following van", "CAM_BACK", _fullest("van")),
    "side_queue": ("Queue on one side", "CAM_FRONT_LEFT", _fullest()),
    "oncoming_platoon": ("Oncoming platoon", "CAM_FRONT", _fullest()),
    "standing": ("Standing", "CAM_FRONT", _middle),
    "standing_cross_traffic": ("Standing, cross traffic", "CAM_FRONT", _fullest()),
    "blank_wall": ("Blank wall", "CAM_FRONT", _turning),
    "fast_straight": ("Fast straight", "CAM_FRONT", _middle),
    "tight_turn": ("Tight turn", "CAM_FRONT", _turning),
}
"""Staged situation -> title, the camera that shows it, and which of its images: the middle one, the one that movers
cover most, or the middle of the sharpest turn."""

CONDITIONS: dict[str, tuple[str, str, Choice, Callable[[LogPlan], bool]]] = {
    "low_texture": ("Low texture", "CAM_BACK_RIGHT", _barest, lambda log: log.low_texture and log.weather == "day"),
    "low_sun": ("Low sun", "CAM_FRONT", _middle, lambda log: log.low_sun),
    "rain": ("Rain", "CAM_FRONT", _middle, lambda log: log.weather == "rain"),
    "night": ("Night", "CAM_FRONT", _middle, lambda log: log.weather == "night"),
}
"""Condition of a whole log -> title, camera, which image, and test; shown by its first ordinary scene."""


def write_situations(city: City, folder: Path, width: int = 480) -> list[Sample]:
    """One picture of every situation and condition that the folder has."""
    scenes = list(city.scenes())
    samples = []
    for situation, (title, channel, choice) in SITUATIONS.items():
        staged = [(log, plan) for log, plan in scenes if plan.situation == situation]
        clear = [(log, plan) for log, plan in staged if log.weather == "day" and not log.low_texture] or staged
        if clear and channel in city.config.cameras:
            log, plan = clear[0]
            index = choice(city, log, plan, channel)
            samples.append(_picture(city, plan, channel, index, title, folder / f"{situation}.jpg", width))
    for condition, (title, channel, choice, holds) in CONDITIONS.items():
        fitting = sorted(
            ((log, plan) for log, plan in scenes if holds(log)), key=lambda scene: scene[1].situation != "ordinary"
        )
        if fitting and channel in city.config.cameras:
            log, plan = fitting[0]
            index = choice(city, log, plan, channel)
            samples.append(_picture(city, plan, channel, index, title, folder / f"{condition}.jpg", width))
    return samples


def _picture(city: City, plan: ScenePlan, channel: str, index: int, title: str, path: Path, width: int) -> Sample:
    image = cv2.imread(str(city.dataset.reel(plan.name, channel).image_paths[index]))
    assert image is not None
    _write(path, cv2.resize(image, (width, width * 9 // 16), interpolation=cv2.INTER_AREA))
    return Sample(path.name, title, f"{plan.name} {channel}, image {index}")


def _write(path: Path, image: np.ndarray | cv2.typing.MatLike) -> None:
    """A JPEG, whole or not at all."""
    from mixo_env.files import write_bytes

    encoded = cv2.imencode(".jpg", np.asarray(image), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1]
    write_bytes(path, encoded.tobytes())


def write_strip(city: City, folder: Path, width: int = 1440) -> Sample:
    """All six cameras at one instant, rendered anew: the folder holds those that were asked for."""
    from mixo_env.simulator.dataset import simulate

    scenes = list(city.scenes())
    clear = [
        plan for log, plan in scenes if log.weather == "day" and not log.low_texture and plan.situation == "ordinary"
    ]
    plan = next((plan for plan in clear if _moves(city, plan)), scenes[0][1])
    config = replace(city.config, cameras=STRIP, seconds=2, images=True)
    tile = width // 3, width * 9 // 48
    with TemporaryDirectory() as temporary:
        simulate(config, Path(temporary), only=(plan.name,))
        dataset = open_dataset(Path(temporary))
        tiles = []
        for channel in STRIP:
            reel = dataset.reel(plan.name, channel)
            image = cv2.imread(str(reel.image_paths[np.flatnonzero(reel.is_keyframe)[1]]))
            assert image is not None
            image = cv2.resize(image, tile, interpolation=cv2.INTER_AREA)
            (label_width, _), _ = cv2.getTextSize(channel, cv2.FONT_HERSHEY_SIMPLEX, 0.5, 1)
            cv2.rectangle(image, (0, 0), (label_width + 12, 24), (0, 0, 0), -1)
            cv2.putText(image, channel, (6, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (255,) * 3, 1, cv2.LINE_AA)
            tiles.append(image)
    _write(folder / "cameras.jpg", np.vstack([np.hstack(tiles[:3]), np.hstack(tiles[3:])]))
    return Sample("cameras.jpg", "All six cameras", f"{plan.name}, second key frame of a two-second drive in its city")


def _moves(city: City, plan: ScenePlan) -> bool:
    reel = city.dataset.reel(plan.name, city.config.cameras[0])
    return float(np.hypot(reel.x_m[24] - reel.x_m[0], reel.y_m[24] - reel.y_m[0])) > 10.0


def write_movers(
    city: City, shares: dict[str, list[tuple[Sight, MoverShares]]], folder: Path, width: int = 720
) -> Sample:
    """The pair whose plain RANSAC is captured most while the picture still shows a street; red: inliers on movers."""
    everything = [(sight, share) for rows in shares.values() for sight, share in rows if share.covered < STREET_LEFT]
    sight, share = max(everything, key=lambda row: np.nan_to_num(row[1].inliers))
    pair = matched_sight(city, sight)
    image = cv2.imread(str(city.dataset.reel(sight.plan.name, sight.channel).image_paths[sight.index]))
    assert image is not None
    scale = width / pair.masks[0].shape[1]
    image = cv2.resize(image, (width, width * 9 // 16), interpolation=cv2.INTER_AREA)
    on = pair.on_movers(pair.first, pair.second)
    for a, b, is_on in zip(pair.first[pair.inlier], pair.second[pair.inlier], on[pair.inlier], strict=True):
        ends = [tuple(((point + 0.5) * scale).round().astype(int).tolist()) for point in (a, b)]
        cv2.line(image, ends[0], ends[1], (40, 40, 255) if is_on else (80, 230, 80), 1, cv2.LINE_AA)
        cv2.circle(image, ends[0], 2, (40, 40, 255) if is_on else (80, 230, 80), -1, cv2.LINE_AA)
    _write(folder / "movers.jpg", image)
    source = (
        f"{sight.plan.name} {sight.channel}, images {sight.index} and {sight.index + 1}: {100 * share.inliers:.0f} % "
        f"of the RANSAC inliers lie on movers (red), {100 * share.odometry:.0f} % of the odometry's"
    )
    return Sample("movers.jpg", "Moving vehicles capture RANSAC", source)


def draw_motion(paths: Sequence[Way], real: dict[str, Numbers], path: Path) -> None:
    """Cumulative distributions of the simulated motion, with the quantiles of the real one."""
    from matplotlib.figure import Figure

    samples = motion_samples(paths)
    panels = {
        "speed over 1 s [m/s]": "speed_1s_mps",
        "|yaw rate| over 1 s [deg/s]": "abs_yaw_rate_1s_degps",
        "acceleration over 1 s [m/s²]": "longitudinal_accel_1s_mps2",
        "path per scene [m]": "path_length_per_scene_m",
    }
    figure = Figure(figsize=(9.6, 2.6), layout="constrained")
    for axes, (label, name) in zip(figure.subplots(1, 4, sharey=True), panels.items(), strict=True):
        values = samples[name]
        axes.plot(np.sort(values), np.linspace(0.0, 100.0, len(values)), color="#4477aa", label="simulated")
        quantiles = [real[name][f"p{p}"] for p in PERCENTILES]
        axes.plot(quantiles, PERCENTILES, "o", color="#cc3311", markersize=4, label="real quantiles")
        axes.set_xlabel(label)
        axes.grid(alpha=0.3)
        if name == "abs_yaw_rate_1s_degps":
            axes.set_xlim(-1.0, 30.0)
        if name == "speed_1s_mps":
            axes.set_ylabel("per cent below")
            axes.legend(fontsize=7, loc="upper left")
    from mixo_env.files import atomic_path

    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110, metadata={"Software": None})
