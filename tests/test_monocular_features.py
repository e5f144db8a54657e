"""Corners, words and matches: against OpenCV where it does the same, and by what must hold of them."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.monocular.alignment import align_matches
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.corners import BORDER_PX, CELL_PX, corner_scores, grid_corners
from mixo_env.experts.monocular.features import FeatureDetector, Features
from mixo_env.experts.monocular.matching import MatchLimits, match_features
from mixo_env.experts.monocular.vocabulary import Vocabulary, load_vocabulary, train_vocabulary
from tests.corridor import calibration, picture


@pytest.fixture(scope="module")
def street() -> np.ndarray:
    return picture(calibration(), 0.0, 0.0, 0.1)


def test_corner_scores_are_those_of_opencv(street: np.ndarray) -> None:
    scores = np.empty_like(street)
    corner_scores(street, 0, scores)
    found = cv2.FastFeatureDetector.create(12, False).detect(street)
    height, width = street.shape
    expected = np.zeros((height, width), bool)
    for keypoint in found:
        x, y = (int(value) for value in keypoint.pt)
        expected[y, x] = BORDER_PX <= x < width - BORDER_PX and BORDER_PX <= y < height - BORDER_PX
    assert expected.sum() > 1000
    np.testing.assert_array_equal(scores > 12, expected)


def test_threshold_falls_only_where_needed(street: np.ndarray) -> None:
    corners = grid_corners(street, 40, 7, 3, 100_000)
    cell = corners[:, 1] // CELL_PX * 100 + corners[:, 0] // CELL_PX
    for k in np.unique(cell):
        score = corners[cell == k, 2]
        assert (score > 40).all() or (score > 40).sum() < 3
        assert (np.diff(score) <= 0).all()


@pytest.mark.parametrize("quota", [1, 200, 431, 2000])
def test_the_best_of_every_cell_come_first(street: np.ndarray, quota: int) -> None:
    """Against sorting all corners by their rank within the cell, then by score."""
    corners = grid_corners(street, 40, 7, 3, 100_000)
    cell = corners[:, 1] // CELL_PX * 100 + corners[:, 0] // CELL_PX
    rank = np.concatenate([np.arange(count) for count in np.unique_counts(cell).counts])
    expected = corners[np.sort(np.lexsort((-corners[:, 2], rank))[:quota])]
    np.testing.assert_array_equal(grid_corners(street, 40, 7, 3, quota), expected)


def test_corners_are_spread_evenly(street: np.ndarray) -> None:
    ours = FeatureDetector(MonocularConfig(features=400)).detect(street).position_px
    theirs = cv2.KeyPoint.convert(cv2.ORB.create(400, 1.4, 3).detect(street, None))
    empty = [
        np.mean(np.histogram2d(p[:, 0], p[:, 1], (12, 8), ((0, 640), (0, 360)))[0] == 0)
        for p in (ours, np.array(theirs))
    ]
    assert len(ours) == 400
    assert empty[0] < 0.5 * empty[1]


def test_turned_picture_has_the_same_words(street: np.ndarray) -> None:
    """Orientation and descriptor follow a rotation of the picture by 90 degrees."""
    detector = FeatureDetector(MonocularConfig(features=300, levels=1))
    upright, turned = detector.detect(street), detector.detect(np.ascontiguousarray(np.rot90(street)))
    x, y = upright.position_px.T
    back = {(round(float(u)), round(float(v))): k for k, (u, v) in enumerate(turned.position_px)}
    pairs = [(i, back[key]) for i, key in enumerate(zip(y.round(), 639 - x.round(), strict=True)) if key in back]
    assert len(pairs) > 150
    bits = [np.bitwise_count(upright.descriptor[i] ^ turned.descriptor[j]).sum() for i, j in pairs]
    assert np.median(bits) < 40


def slow_mutual(
    a: Features, b: Features, words1: np.ndarray, words2: np.ndarray, radius: float
) -> set[tuple[int, int]]:
    """Mutual matches by the book: every pair, every rule."""
    distance = np.bitwise_count(a.descriptor[:, None] ^ b.descriptor[None]).sum(-1).astype(int)
    shift = np.abs(a.position_px[:, None] - b.position_px[None]).max(-1)
    lean = np.cos(a.angle_rad[:, None] - b.angle_rad[None])
    level = np.abs(a.level[:, None] - b.level[None])
    apart = (words1[:, None] != words2[None, :, :1]).all(-1)
    distance[apart | (shift > radius) | (lean < np.cos(0.5)) | (level > 1)] = 999
    found = set()
    for i, row in enumerate(distance):
        j = int(row.argmin())
        second = np.partition(row, 1)[1]
        if row[j] <= 64 and row[j] <= 0.9 * min(second, 512) and distance[:, j].argmin() == i:
            found.add((i, j))
    return found


@pytest.mark.parametrize("probes", [1, 4, 10])
def test_matching_against_the_slow_way(street: np.ndarray, probes: int) -> None:
    detector, words = FeatureDetector(MonocularConfig(features=400)), load_vocabulary()
    first, second = detector.detect(street), detector.detect(picture(calibration(), 0.5, 0.0, 0.11, 1))
    words1, words2 = words.nearest(first.descriptor, probes), words.nearest(second.descriptor, 1)
    i, j = match_features(first, second, words1, words2, len(words), MatchLimits(80.0, 64, 0.9))
    expected = slow_mutual(first, second, words1, words2, 80.0)
    assert len(expected) > 60
    assert len(set(zip(i.tolist(), j.tolist(), strict=True)) ^ expected) <= 0.02 * len(expected)  # equals may differ


def test_alignment_finds_the_subpixel_shift(street: np.ndarray) -> None:
    shift = np.array([0.4, -0.7], np.float32)
    moved = np.asarray(cv2.warpAffine(street, np.array([[1, 0, shift[0]], [0, 1, shift[1]]], np.float32), (640, 360)))
    corners = FeatureDetector(MonocularConfig(features=200)).detect(street).position_px
    found, good = align_matches(street, moved, corners, np.round(corners + shift))
    assert good.mean() > 0.9
    assert np.median(np.abs(found[good] - corners[good] - shift)) < 0.05


def clusters(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors about 16 random words, 10 of 256 bits flipped, and their labels."""
    centre = rng.integers(0, 2, (16, 256), dtype=np.uint8)
    label = rng.integers(0, 16, 4000)
    bits = centre[label] ^ (rng.random((4000, 256)) < 10 / 256)
    return np.packbits(bits, axis=1, bitorder="little").view(np.uint64), label


def test_vocabulary_finds_clusters(tmp_path: Path) -> None:
    descriptor, label = clusters(np.random.default_rng(0))
    words = train_vocabulary(descriptor, branches=4, seed=3)
    node = words.nearest(descriptor)[:, 0]
    purity = sum(np.bincount(label[node == k]).max() for k in np.unique(node)) / len(label)
    assert purity > 0.6
    together = [np.bincount(node[label == k]).max() for k in range(16)]
    assert sum(together) > 0.7 * len(label)  # clusters are seldom cut
    np.testing.assert_array_equal(train_vocabulary(descriptor, branches=4, seed=3).centres, words.centres)
    words.save(tmp_path / "words.npy")
    np.testing.assert_array_equal(load_vocabulary(tmp_path / "words.npy").centres, words.centres)
    bits = np.bitwise_count(descriptor[:, None] ^ words.centres[:, 1:].reshape(1, 16, 4)).sum(-1)
    np.testing.assert_array_equal(words.nearest(descriptor, 16), np.argsort(bits, axis=1, kind="stable"))


def test_bad_vocabularies(tmp_path: Path) -> None:
    with pytest.raises(DatasetError, match="cannot read"):
        load_vocabulary(tmp_path / "none.npy")
    np.save(tmp_path / "wrong.npy", np.zeros((3, 3)))
    with pytest.raises(DatasetError, match="not a vocabulary"):
        load_vocabulary(tmp_path / "wrong.npy")
    with pytest.raises(ConfigurationError, match="needs 2000"):
        train_vocabulary(np.zeros((100, 4), np.uint64))


def test_the_general_vocabulary_splits_evenly(street: np.ndarray) -> None:
    words = load_vocabulary()
    assert isinstance(words, Vocabulary)
    features = FeatureDetector(MonocularConfig()).detect(street)
    assert np.bincount(words.nearest(features.descriptor)[:, 0]).max() < 0.1 * len(features)
