"""What real scenes do, and how that is dealt to simulated ones: how far each goes and how much it turns.

Both are drawn from the quantiles of all 850 nuScenes drives by stratified sampling: of n moving scenes every n-th part
of the distribution gets exactly one. Which path meets which turn is not known from quantiles; they are paired by
chance, as far as a car can do both.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# Quantiles over the 850 scenes of nuScenes trainval (Caesar et al. 2020), from the ego poses at 12 Hz, rear axle:
# level, path of a scene [m], absolute heading change from its first to its last pose [deg].
_LEVELS = (0.0, 0.01, 0.02, 0.05, 0.10, 0.25, 0.50, 0.75, 0.90, 0.95, 0.98, 0.99, 1.0)
_PATH_M = (0.01, 0.0125, 0.0137, 0.0246, 7.4767, 52.3476, 103.3792, 139.4496, 173.5991, 193.7465, 224.9873, 252.6772,
           344.629)  # fmt: skip
_TURNED_DEG = (0.0, 0.0028, 0.0042, 0.0094, 0.1312, 1.0716, 8.8189, 54.4827, 89.3738, 97.4591, 119.7644, 149.1137,
               210.524)  # fmt: skip

REAL_SECONDS = 19.4
"""Mean length of a real scene: 198,315 frames at 12 Hz in 850 scenes."""

STANDING_M, STANDING_SHARE = 5.0, 0.0906
"""A scene that stands covers less than this, and so large a share of the real ones does."""

# More levels: the published shares of scenes under and over some values.
_PATH_SHARES = ((STANDING_SHARE, STANDING_M), (1.0 - 0.1929, 150.0), (1.0 - 0.0365, 200.0))
_TURNED_SHARES = ((0.443, 5.0), (1.0 - 0.3459, 30.0), (1.0 - 0.2294, 60.0))

STANDING = frozenset({"standing", "standing_cross_traffic"})
TURNING = frozenset({"tight_turn", "lead_truck", "majority_wrong"})

_TURN_DEG = (77.0, 103.0)  # a whole turn
_TURN_PATH_M = (50.0, 135.0)
_CREEP_PATH_M = (40.0, 70.0)  # of a convoy through a turn
_FAST_M, _FAST_TURN_DEG = (203.0, 285.0), (0.0, 12.0)
_TWO_TURNS_DEG, _TWO_TURNS_PATH_M = 104.0, (96.0, 150.0)


@dataclass(frozen=True)
class Motion:
    """What one scene is to do.

    Attributes:
        mean_mps: mean speed.
        turned_rad: absolute heading change from its beginning to its end.
    """

    mean_mps: float
    turned_rad: float


class _Pool:
    """Values that have not been dealt yet."""

    def __init__(self, values: FloatArray) -> None:
        self._values = sorted(values.tolist())

    def take(self, rng: np.random.Generator, low: float, high: float) -> float:
        """One of the values in ``low`` .. ``high``; any number there if none is left."""
        inside = [number for number, value in enumerate(self._values) if low <= value <= high]
        return self._values.pop(int(rng.choice(inside))) if inside else float(rng.uniform(low, high))

    def take_up_to(self, rng: np.random.Generator, high: float) -> float:
        """One of the values below ``high``, else the smallest."""
        return self.take(rng, 0.0, high) if self._values and self._values[0] <= high else self._values.pop(0)

    def above(self, low: float) -> int:
        """How many are larger."""
        return sum(value > low for value in self._values)

    def rest(self) -> list[float]:
        """All that are left."""
        return self._values


def path_m(levels: FloatArray) -> FloatArray:
    """Quantiles of the path of a real scene [m]."""
    return _quantile(levels, _PATH_M, _PATH_SHARES)


def turned_deg(levels: FloatArray) -> FloatArray:
    """Quantiles of the absolute heading change of a real scene [deg]."""
    return _quantile(levels, _TURNED_DEG, _TURNED_SHARES)


def deal_motions(rng: np.random.Generator, situations: Sequence[str]) -> tuple[Motion, ...]:
    """One motion a scene, such that all together move as the real scenes do, as far as their situations allow.

    Args:
        rng: deals.
        situations: of the scenes: fields of ``SituationShares``, or "ordinary".
    """
    standing = [number for number, name in enumerate(situations) if name in STANDING]
    moving = [number for number, name in enumerate(situations) if name not in STANDING]
    dealt: dict[int, tuple[float, float]] = {}
    still = STANDING_SHARE * _stratified(rng, len(standing))
    for number, path, turned in zip(standing, path_m(still), turned_deg(still), strict=True):
        dealt[number] = float(path), float(turned)
    paths, turns = (
        _Pool(quantile(STANDING_SHARE + (1.0 - STANDING_SHARE) * _stratified(rng, len(moving))))
        for quantile in (path_m, turned_deg)
    )
    for number in moving:
        if situations[number] == "fast_straight":
            dealt[number] = paths.take(rng, *_FAST_M), turns.take(rng, *_FAST_TURN_DEG)
        elif situations[number] in TURNING:
            reach = _CREEP_PATH_M if situations[number] == "majority_wrong" else _TURN_PATH_M
            dealt[number] = paths.take(rng, *reach), turns.take(rng, *_TURN_DEG)
    free = [number for number in moving if number not in dealt]
    pairs = _paired(rng, paths, turns, len(free))
    for number, index in zip(free, rng.permutation(len(free)), strict=True):
        dealt[number] = pairs[index]
    return tuple(
        Motion(path / REAL_SECONDS, float(np.radians(turned)))
        for path, turned in (dealt[number] for number in range(len(situations)))
    )


def _paired(rng: np.random.Generator, paths: _Pool, turns: _Pool, count: int) -> list[tuple[float, float]]:
    """Paths and turns that one car can do: those first which leave the least choice."""
    pairs = []
    for _ in range(min(turns.above(_TWO_TURNS_DEG), count)):
        pairs.append((paths.take(rng, *_TWO_TURNS_PATH_M), turns.take(rng, _TWO_TURNS_DEG, np.inf)))
    rest = np.array(paths.rest())
    for path in rest[np.argsort(-np.abs(rest - 95.0), kind="stable")][: count - len(pairs)]:
        pairs.append((float(path), turns.take_up_to(rng, _most_turned_deg(path))))
    return pairs


def _most_turned_deg(path: float) -> float:
    """A fast car turns little, and so does one that hardly moves."""
    return float(
        np.interp(path, (5.0, 12.0, 25.0, 40.0, 140.0, 150.0, 175.0, 200.0), (5.0, 20, 60, 104, 104, 95, 30, 14))
    )


def _quantile(levels: FloatArray, values: Sequence[float], shares: Sequence[tuple[float, float]]) -> FloatArray:
    known = sorted([*zip(_LEVELS, values, strict=True), *shares])
    return np.interp(levels, *np.array(known).T)


def _stratified(rng: np.random.Generator, count: int) -> FloatArray:
    """``count`` numbers in 0..1 in random order, one in each ``count``-th part."""
    return (rng.permutation(count) + rng.uniform(size=count)) / max(count, 1)
