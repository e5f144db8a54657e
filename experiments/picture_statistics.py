"""How a picture looks to a feature tracker: corners, spectrum, repeatability, matches. For real and simulated streets.

``python -m experiments.picture_statistics FOLDER`` prints one row for every folder or picture it is given.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import astuple, dataclass, fields
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import DatasetError

Gray = NDArray[np.uint8]

AREA_PX = 360_000.0
"""Corners are counted per this area, one picture of 800 x 450."""


@dataclass(frozen=True)
class PictureStatistics:
    """Of one picture.

    Attributes:
        mean: grey level.
        contrast: standard deviation of the grey level.
        corners: ORB corners (FAST threshold 12, 8 octaves) per ``AREA_PX``.
        empty_cells: share of 6 x 10 cells without a corner.
        slope: of the log power spectrum over log frequency.
        repeatability: share of the 1,500 strongest corners found again after a known small warp, darkening and noise.
        correct: share of matches between the two that agree with the warp.
        hamming: median descriptor distance of these matches.
    """

    mean: float
    contrast: float
    corners: float
    empty_cells: float
    slope: float
    repeatability: float
    correct: float
    hamming: float


def _orb(corners: int) -> cv2.ORB:
    return cv2.ORB.create(corners, 1.2, 8, fastThreshold=12)


def _spectrum_slope(gray: Gray) -> float:
    side = min(384, *gray.shape)
    top, left = (gray.shape[0] - side) // 2, (gray.shape[1] - side) // 2
    patch = gray[top : top + side, left : left + side].astype(np.float64)
    window = np.hanning(side)
    power = np.abs(np.fft.fftshift(np.fft.fft2((patch - patch.mean()) * window[:, None] * window[None, :]))) ** 2
    y, x = np.mgrid[:side, :side] - side // 2
    radius = np.hypot(y, x)
    rings = np.array([4, 8, 16, 32, 64, 110])
    mean = [power[(radius >= ring) & (radius < 1.3 * ring)].mean() for ring in rings]
    return float(np.polyfit(np.log(rings), np.log(mean), 1)[0])


def _matched(first: cv2.typing.MatLike, second: cv2.typing.MatLike) -> list[cv2.DMatch]:
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(first, second, k=2)
    return [pair[0] for pair in pairs if len(pair) == 2 and pair[0].distance < 0.8 * pair[1].distance]


def picture_statistics(gray: Gray) -> PictureStatistics:
    """Statistics of one grey picture ``(h, w)``."""
    height, width = gray.shape
    corners = _orb(20000).detect(gray, None)
    cells = {(int(k.pt[1] * 6 / height), int(k.pt[0] * 10 / width)) for k in corners}

    warp = np.array([[1.04, 0.03, -6.0], [-0.02, 1.05, 4.0], [3e-5, -2e-5, 1.0]])
    noise = np.random.default_rng(0).normal(0.0, 3.0, gray.shape)
    moved = np.clip(0.9 * cv2.warpPerspective(gray, warp, (width, height)) + noise, 0, 255).astype(np.uint8)
    orb = _orb(1500)
    here, here_words = orb.detectAndCompute(gray, None)
    there, there_words = orb.detectAndCompute(moved, None)
    expected = cv2.perspectiveTransform(np.array([[k.pt for k in here]], np.float64), warp)[0]
    found = np.array([k.pt for k in there])
    distance = np.linalg.norm(expected[:, None] - found[None], axis=2)
    inside = (expected > 0).all(axis=1) & (expected < (width, height)).all(axis=1)
    matches = _matched(here_words, there_words)
    return PictureStatistics(
        mean=float(gray.mean()),
        contrast=float(gray.std()),
        corners=len(corners) * AREA_PX / gray.size,
        empty_cells=1.0 - len(cells) / 60.0,
        slope=_spectrum_slope(gray),
        repeatability=float((distance.min(axis=1)[inside] < 2.0).mean()),
        correct=float(np.mean([distance[m.queryIdx, m.trainIdx] < 3.0 for m in matches])),
        hamming=float(np.median([m.distance for m in matches])),
    )


def read_gray(path: Path) -> Gray:
    """A picture in grey; one of 1600 x 900 at half that size.

    Raises:
        DatasetError: if it cannot be read.
    """
    gray = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
    if gray is None:
        raise DatasetError(f"{path} cannot be read as a picture: give PNG or JPEG files, or folders of them")
    if gray.shape[1] == 1600:
        gray = cv2.resize(gray, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    return gray.astype(np.uint8)


def mean_row(rows: Sequence[PictureStatistics]) -> str:
    """Means over pictures, one ``name value`` after the other."""
    means = np.mean([astuple(row) for row in rows], axis=0)
    return "  ".join(f"{field.name} {mean:.2f}" for field, mean in zip(fields(rows[0]), means, strict=True))


def main() -> None:
    """Print the statistics of pictures and folders named on the command line (at most 60 pictures each, 800 wide)."""
    for name in sys.argv[1:]:
        root = Path(name)
        paths = sorted(p for p in root.rglob("*") if p.suffix in (".png", ".jpg")) if root.is_dir() else [root]
        rows = [picture_statistics(read_gray(path)) for path in paths[:: max(1, len(paths) // 60)]]
        print(f"{root.name:28s} ({len(rows)})  {mean_row(rows)}")


if __name__ == "__main__":
    main()
