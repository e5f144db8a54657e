"""Mutual matching at 8000 features: ours within vocabulary nodes against ``cv2.BFMatcher(crossCheck=True)``.

Run ``python -m experiments.benchmarks.matching FIRST SECOND`` with two consecutive street images (any format, grey or
colour). CPU time of one thread, median of repeats; inliers by OpenCV's fundamental matrix, so that neither side judges
itself.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.features import FeatureDetector
from mixo_env.experts.monocular.matching import match_features
from mixo_env.experts.monocular.vocabulary import load_vocabulary

SEARCH_PX = 1e6  # like the peer: no search window


def cpu_ms(work: Callable[[], object], repeats: int) -> float:
    """Median CPU time of one call, after one to warm up."""
    work()
    spent = []
    for _ in range(repeats):
        start = time.thread_time()
        work()
        spent.append(1e3 * (time.thread_time() - start))
    return statistics.median(spent)


def inlier_share(p1: NDArray[np.float32], p2: NDArray[np.float32]) -> float:
    """Share of matches on a common epipolar geometry, to a pixel."""
    cv2.setRNGSeed(0)
    mask = cv2.findFundamentalMat(p1, p2, cv2.USAC_MAGSAC, 1.0, 0.999, 5000)[1]
    return 0.0 if mask is None else float(np.mean(mask))


def main(paths: list[str]) -> None:
    """Print both times, their ratio and both inlier shares of two image files."""
    cv2.setNumThreads(1)
    if len(paths) != 2:
        sys.exit("usage: python -m experiments.benchmarks.matching FIRST SECOND (consecutive images of one camera)")
    images = [np.asarray(cv2.imread(path, cv2.IMREAD_GRAYSCALE), np.uint8) for path in paths]
    config = MonocularConfig.preset("paper")
    detector, words = FeatureDetector(config), load_vocabulary()
    first, second = (detector.detect(np.asarray(image, np.uint8)) for image in images)

    def ours() -> tuple[NDArray[np.intp], NDArray[np.int32]]:
        node1, node2 = words.nodes(first.descriptor, True), words.nodes(second.descriptor, True)
        nodes, bits, ratio = words.branches**2, config.match_max_bits, config.match_ratio
        return match_features(first, second, node1, node2, nodes, SEARCH_PX, bits, ratio)

    matcher = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True)
    d1, d2 = first.descriptor.view(np.uint8), second.descriptor.view(np.uint8)
    theirs = matcher.match(d1, d2)
    i, j = ours()
    p, q = np.array([[m.queryIdx, m.trainIdx] for m in theirs if m.distance <= config.match_max_bits]).T
    our_ms, their_ms = cpu_ms(ours, 9), cpu_ms(lambda: matcher.match(d1, d2), 3)
    print(f"{len(first)} x {len(second)} features, CPU ms of one thread")
    for name, ms, a, b in (("vocabulary nodes", our_ms, i, j), ("cv2.BFMatcher crossCheck", their_ms, p, q)):
        share = inlier_share(first.position_px[a], second.position_px[b])
        print(f"{name:26s}{ms:9.2f} ms{len(a):7d} matches{100 * share:7.1f} % inliers")
    print(f"ratio {their_ms / our_ms:.0f}x")


if __name__ == "__main__":
    main(sys.argv[1:])
