"""The reported heading is what a batch solution over all pairs so far would say, with each new pair."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mixo_env.experts.monocular.heading import Heading
from mixo_env.experts.monocular.motion import Motion

GAP_S = 0.1


def turned(yaw_rad: float, std_rad: float) -> Motion:
    return Motion(yaw_rad, std_rad, 0.0, 0.0, 0.0, 0.0, 0.1, 0.1, np.ones(60, bool), 0.0)


def test_by_hand() -> None:
    heading = Heading(0.2)
    assert heading.report(turned(0.010, 0.003), None, GAP_S, tracking=True) == pytest.approx((0.010, 0.003))
    # change: 0.004 seen with std 0.002 sqrt(2), 0 expected with 0.002: 0.00133 with variance 8 / 3 (x 1e-6)
    # expected 0.011333 with variance 9 + 8 / 3 = 35 / 3, seen 0.021333 with variance 35 / 3: half the way, 0.016333;
    # 9 / (70 / 3) of the innovation 0.01 are owed of the last increment
    change = (0.004, 0.002 * math.sqrt(2.0))
    yaw, std = heading.report(turned(0.064 / 3.0, 1e-3 * math.sqrt(35.0 / 3.0)), change, GAP_S, tracking=True)
    assert yaw == pytest.approx(0.049 / 3.0 + 0.01 * 27.0 / 70.0)
    assert std == pytest.approx(1e-3 * math.sqrt(35.0 / 6.0 + 81.0 / (70.0 / 3.0)))


def test_the_sum_is_that_of_a_batch_solution_at_every_step() -> None:
    rng = np.random.default_rng(5)
    n = 40
    truth = np.cumsum(rng.normal(0.0, 0.01, n))
    pair_std = rng.choice([0.001, 0.004, 0.05], n)
    change_std = rng.choice([0.0005, 0.003], n)
    pairs = truth + pair_std * rng.normal(size=n)
    changes = np.diff(truth, prepend=np.nan) + change_std * rng.normal(size=n)
    heading, total = Heading(0.2), 0.0
    for k in range(n):
        change = (changes[k], change_std[k]) if k else None
        total += heading.report(turned(pairs[k], pair_std[k]), change, GAP_S, tracking=True)[0]
        rows, right = [np.eye(n)[: k + 1] / pair_std[: k + 1, None]], [pairs[: k + 1] / pair_std[: k + 1]]
        rows.append((np.eye(n)[1 : k + 1] - np.eye(n)[:k]) / change_std[1 : k + 1, None])
        right.append(changes[1 : k + 1] / change_std[1 : k + 1])
        rows.append((np.eye(n)[1 : k + 1] - np.eye(n)[:k]) / (0.2 * GAP_S**2))
        right.append(np.zeros(k))
        batch = np.linalg.lstsq(np.vstack(rows)[:, : k + 1], np.concatenate(right), rcond=None)[0]
        assert total == pytest.approx(batch.sum(), abs=1e-12)


def test_a_poor_view_is_bridged_and_made_up_for() -> None:
    """Ten pairs all err to the same side; the changes say that nothing happened."""
    heading = Heading(0.2)
    reported = []
    for k in range(60):
        poor = 20 <= k < 30
        motion = turned(0.002 if poor else 0.0, 0.002 if poor else 0.0003)
        change = (0.0, 0.0002) if k else None
        reported.append(heading.report(motion, change, GAP_S, tracking=True)[0])
    assert abs(sum(reported)) < 0.2 * 10 * 0.002
    assert max(np.cumsum(reported)) > sum(reported) > 0.0


def test_without_a_measured_change_the_car_may_turn_as_cars_do() -> None:
    heading = Heading(0.2)
    heading.report(turned(0.02, 1e-4), None, GAP_S, tracking=True)
    yaw, _ = heading.report(turned(0.03, 1e-4), None, 2.0 * GAP_S, tracking=True)  # expected 0.04 +- 0.008
    assert yaw == pytest.approx(0.03, abs=1e-5)


def test_what_was_not_reported_is_not_made_up_for_and_lost_is_forgotten() -> None:
    change = (0.0, 1e-5)
    silent, spoken, fresh = Heading(0.2), Heading(0.2), Heading(0.2)
    silent.report(turned(0.02, 0.01), None, GAP_S, tracking=False)
    spoken.report(turned(0.02, 0.01), None, GAP_S, tracking=True)
    now = turned(0.0, 0.001)
    quiet, made_up = (each.report(now, change, GAP_S, tracking=True)[0] for each in (silent, spoken))
    assert quiet == pytest.approx(0.0, abs=3e-4)
    assert made_up == pytest.approx(-0.02, abs=6e-4)
    spoken.forget()
    assert spoken.report(now, change, GAP_S, tracking=True) == fresh.report(now, change, GAP_S, tracking=True)
