"""Mutual matching at 8000 features: ours by nearest words against ``cv2.BFMatcher(crossCheck=True)``.

Run ``python -m experiments.speed.matching FIRST SECOND`` with two consecutive street images (any format, grey or
colour). CPU time of one thread, median of repeats, ours with the search for the words. Correct is what OpenCV's
fundamental matrix (MAGSAC, 1 px) of the same matches agrees with, so that neither side judges itself. The peer's
matches are cut at the same Hamming distance. Ours is shown without a search window, like the peer, and with the one
that the odometry uses at 36 km/h.
"""

from __future__ import annotations

import math
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.features import FeatureDetector
from mixo_env.experts.monocular.matching import MatchLimits, match_features
from mixo_env.experts.monocular.vocabulary import load_vocabulary

WINDOW_RAD = 0.29  # largest turn and shift of a point 4 m away in 1/12 s at 10 m/s


def cpu_ms(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of one call, after one to warm up."""
    work()
    spent = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        spent.append(1e3 * (time.thread_time() - start))
    return statistics.median(spent)


def correct_matches(p1: NDArray[np.float32], p2: NDArray[np.float32]) -> int:
    """How many matches lie on a common epipolar geometry, to a pixel."""
    cv2.setRNGSeed(0)
    mask = cv2.findFundamentalMat(p1, p2, cv2.USAC_MAGSAC, 1.0, 0.999, 5000)[1]
    return 0 if mask is None else int(np.sum(mask))


def main(paths: list[str]) -> None:
    """Print times, ratios, and numbers and shares of correct matches of two image files."""
    cv2.setNumThreads(1)
    if len(paths) != 2:
        sys.exit("usage: python -m experiments.speed.matching FIRST SECOND (consecutive images of one camera)")
    images = [np.asarray(cv2.imread(path, cv2.IMREAD_GRAYSCALE), np.uint8) for path in paths]
    config = MonocularConfig.preset("paper")
    detector, words = FeatureDetector(config), load_vocabulary()
    first, second = (detector.detect(np.asarray(image, np.uint8)) for image in images)

    def ours(radius_px: float) -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        words1, words2 = words.nearest(first.descriptor, config.match_words), words.nearest(second.descriptor)
        limits = MatchLimits(radius_px, config.match_max_bits, config.match_ratio)
        return match_features(first, second, words1, words2, len(words), limits)

    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    d1, d2 = first.descriptor.view(np.uint8), second.descriptor.view(np.uint8)
    theirs = matcher.match(d1, d2)
    p, q = np.array([[m.queryIdx, m.trainIdx] for m in theirs if m.distance <= config.match_max_bits]).T
    window_px = 0.8 * images[0].shape[1] * WINDOW_RAD  # focal length of most cameras: 0.8 widths
    their_ms = cpu_ms(lambda: matcher.match(d1, d2), 3)
    print(f"{len(first)} x {len(second)} features, CPU ms of one thread")
    rows = [("cv2.BFMatcher crossCheck", their_ms, p, q)]
    for radius in (math.inf, window_px):
        where = "no window" if math.isinf(radius) else f"within {radius:.0f} px"
        rows.append((f"nearest words, {where}", cpu_ms(partial(ours, radius), 9), *ours(radius)))
    for name, ms, i, j in rows:
        correct = correct_matches(first.position_px[i], second.position_px[j])
        print(
            f"{name:30s}{ms:9.2f} ms{their_ms / ms:6.0f}x{len(i):7d} matches{correct:7d} correct"
            f"{100 * correct / len(i):7.1f} %"
        )


if __name__ == "__main__":
    main(sys.argv[1:])
