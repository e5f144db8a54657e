"""What the pictures look like to a feature tracker, simulated beside real: alone, and two in a row."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from docs._pages.data_sheet.folder import City
from experiments.picture_statistics import AREA_PX, Gray, PictureStatistics, picture_statistics, read_gray
from mixo_env.geometry import FloatArray

Numbers = dict[str, float]

PAIR_CORNERS = 1500
"""ORB corners per ``AREA_PX`` in pairs."""

INTERVAL_S = (0.09, 0.11)
"""Pairs are this far apart in time; the real ones 0.10 s."""

TRAVELLED_M = (0.8, 1.6)
"""And in space; the real ones 1.2 m."""


@dataclass(frozen=True)
class PairStatistics:
    """Of two consecutive pictures of one camera, by OpenCV alone.

    Attributes:
        match_ratio: mutual matches better than 0.8 x the second best, over corners.
        inlier_ratio: those that agree with one essential matrix within a pixel, over matches.
        hamming: median descriptor distance of the inliers.
        flow_px: median displacement of the inliers, in pixels of a camera with 633 px focal length.
    """

    match_ratio: float
    inlier_ratio: float
    hamming: float
    flow_px: float


@dataclass(frozen=True)
class PairMatches:
    """Matched corners of two pictures: ``(n, 2)`` pixels in each, which agree with one motion, and corners there were.

    Attributes:
        first, second: ``(n, 2)`` pixels.
        inlier: ``(n,)`` in agreement with the essential matrix.
        hamming: ``(n,)`` descriptor distance.
        corners: in the first picture.
    """

    first: FloatArray
    second: FloatArray
    inlier: NDArray[np.bool_]
    hamming: FloatArray
    corners: int


def match_pair(first: Gray, second: Gray, intrinsic: FloatArray) -> PairMatches:
    """ORB corners, mutual matches with ratio test, five-point RANSAC (MAGSAC++) at 1 px: what any textbook would do."""
    orb = cv2.ORB.create(round(PAIR_CORNERS * first.size / AREA_PX), 1.2, 8, fastThreshold=12)
    here, here_words = orb.detectAndCompute(first, None)
    there, there_words = orb.detectAndCompute(second, None)
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    forth = matcher.knnMatch(here_words, there_words, k=2)
    back = {match.queryIdx: match.trainIdx for match in matcher.match(there_words, here_words)}
    chosen = [
        pair[0]
        for pair in forth
        if len(pair) == 2 and pair[0].distance < 0.8 * pair[1].distance and back[pair[0].trainIdx] == pair[0].queryIdx
    ]
    a = np.array([here[match.queryIdx].pt for match in chosen]).reshape(-1, 2)
    b = np.array([there[match.trainIdx].pt for match in chosen]).reshape(-1, 2)
    inlier = np.zeros(len(chosen), dtype=np.bool_)
    if len(chosen) >= 8:
        cv2.setRNGSeed(0)
        _, mask = cv2.findEssentialMat(a, b, intrinsic, cv2.USAC_MAGSAC, 0.999, 1.0)
        if mask is not None:
            inlier = mask.ravel() > 0
    return PairMatches(a, b, inlier, np.array([match.distance for match in chosen]), len(here))


def pair_statistics(first: Gray, second: Gray, intrinsic: FloatArray) -> PairStatistics:
    """Statistics of two pictures ``(h, w)`` with the pixel matrix ``(3, 3)`` of their size."""
    pair = match_pair(first, second, intrinsic)
    flow = np.hypot(*(pair.second - pair.first).T)[pair.inlier]
    return PairStatistics(
        match_ratio=len(pair.inlier) / max(pair.corners, 1),
        inlier_ratio=float(pair.inlier.mean()) if len(pair.inlier) else np.nan,
        hamming=float(np.median(pair.hamming[pair.inlier])) if pair.inlier.any() else np.nan,
        flow_px=float(np.median(flow)) * 633.0 / intrinsic[0, 0] if pair.inlier.any() else np.nan,
    )


def summary(rows: Sequence[PictureStatistics] | Sequence[PairStatistics]) -> dict[str, Numbers]:
    """Mean, 5 % and 95 % quantile over pictures or pairs, by statistic."""
    values = {field.name: np.array([asdict(row)[field.name] for row in rows]) for field in fields(rows[0])}
    return {
        name: {
            "mean": float(np.nanmean(column)),
            "p5": float(np.nanpercentile(column, 5)),
            "p95": float(np.nanpercentile(column, 95)),
            "n": float(np.isfinite(column).sum()),
        }
        for name, column in values.items()
    }


def evenly(items: Sequence[Path] | Sequence[tuple[str, int]], count: int) -> list:
    """At most ``count`` of ``items``, evenly spread."""
    return [items[k] for k in np.unique(np.linspace(0, len(items) - 1, min(count, len(items))).round().astype(int))]


def alone(paths: Iterable[Path]) -> dict[str, Numbers]:
    """Statistics of single pictures."""
    return summary([picture_statistics(read_gray(path)) for path in paths])


def simulated_pictures(city: City, per_group: int = 48) -> dict[str, dict[str, Numbers]]:
    """Single pictures by group: every camera by day; all cameras in rain, at night, of low texture, in a low sun."""
    conditions = ("rain", "night", "low texture", "low sun")
    groups: dict[str, list[Path]] = {group: [] for group in (*(f"{c} day" for c in city.config.cameras), *conditions)}
    for log, plan in city.scenes():
        kind = log.weather
        if kind == "day":
            kind = "low texture" if log.low_texture else "low sun" if log.low_sun else "day"
        for channel in city.config.cameras:
            reel = city.dataset.reel(plan.name, channel)
            group = f"{channel} day" if kind == "day" else kind
            groups[group].extend(reel.image_paths[5::20])
    return {group: alone(evenly(paths, per_group)) for group, paths in groups.items() if paths}


def simulated_pairs(city: City, per_group: int = 48) -> dict[str, dict[str, Numbers]]:
    """Consecutive pictures at the pace of the real ones, by camera (day, usual texture)."""
    found: dict[str, list[tuple[str, int]]] = {}
    for log, plan in city.scenes():
        if log.weather != "day" or log.low_texture:
            continue
        for channel in city.config.cameras:
            reel = city.dataset.reel(plan.name, channel)
            seconds = np.diff(reel.timestamp_us) * 1e-6
            metres = np.hypot(np.diff(reel.x_m), np.diff(reel.y_m))
            fits = (INTERVAL_S[0] < seconds) & (seconds < INTERVAL_S[1])
            fits &= (TRAVELLED_M[0] < metres) & (metres < TRAVELLED_M[1])
            found.setdefault(f"{channel} day", []).extend((plan.name, int(i)) for i in np.flatnonzero(fits))
    return {
        group: summary([_simulated_pair(city, group.split()[0], *chosen) for chosen in evenly(pairs, per_group)])
        for group, pairs in found.items()
        if pairs
    }


def _simulated_pair(city: City, channel: str, scene: str, index: int) -> PairStatistics:
    reel = city.dataset.reel(scene, channel)
    first, second = (read_gray(reel.image_paths[i]) for i in (index, index + 1))
    return pair_statistics(first, second, scaled_intrinsic(reel.calibration.intrinsic, reel.calibration.width, first))


def scaled_intrinsic(intrinsic: FloatArray, width: int, gray: Gray) -> FloatArray:
    """The pixel matrix at the size a picture was read (large ones are read at half size)."""
    scaled = intrinsic.copy()
    scaled[:2] *= gray.shape[1] / width
    return scaled


def real_pictures(data: Path) -> dict[str, dict[str, Numbers]]:
    """KITTI 06 (left grey camera) and the six pictures of one nuScenes key frame, from the folder of real data."""
    kitti = sorted((data / "kitti_06" / "image_0").glob("*.png"))
    keyframe = {path.name.split("__")[1]: path for path in sorted((data / "nuscenes_keyframe_6cam").glob("*.jpg"))}
    return {
        "KITTI 06": alone(kitti[::2]),
        **{f"nuScenes {channel}": alone([path]) for channel, path in keyframe.items()},
    }


def real_pairs(data: Path) -> dict[str, dict[str, Numbers]]:
    """Consecutive pictures of KITTI 06."""
    paths = sorted((data / "kitti_06" / "image_0").glob("*.png"))
    values = [float(value) for value in (data / "kitti_06" / "calib.txt").read_text().split("\n")[0].split()[-12:]]
    intrinsic = np.array(values).reshape(3, 4)[:, :3].copy()  # OpenCV wants it contiguous
    grays = [read_gray(path) for path in paths]
    rows = [pair_statistics(first, second, intrinsic) for first, second in itertools.pairwise(grays)]
    return {"KITTI 06": summary(rows)}
