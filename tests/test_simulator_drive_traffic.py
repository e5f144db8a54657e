"""Traffic: nobody collides, lanes are kept, and the staged situations really happen."""

from __future__ import annotations

import numpy as np
import pytest

from mixo_env.simulator.city.land import land_of
from mixo_env.simulator.city.streets import BLOCK_M, LANE_M
from mixo_env.simulator.config import SituationShares
from mixo_env.simulator.drive.drive import Drive, plan_drive
from mixo_env.simulator.drive.targets import deal_motions
from mixo_env.simulator.drive.traffic import (
    CAR_LENGTH_M,
    CAR_WIDTH_M,
    REAR_AXLE_TO_FRONT_M,
    Lane,
    Vehicle,
    stage_traffic,
)

pytestmark = pytest.mark.rendering

SITUATIONS = ("ordinary", *SituationShares().by_name())
TIMES_S = np.arange(0.0, 20.0, 0.25)


def staged(situation: str, seed: int = 0) -> tuple[Drive, tuple[Vehicle, ...]]:
    rng = np.random.default_rng([seed, *situation.encode()])
    land = land_of(seed)
    drive = plan_drive(rng, situation, 20.0, -0.008, deal_motions(rng, [situation])[0], land)
    return drive, stage_traffic(rng, drive, 20.0, land)


def outline(x: float, y: float, yaw: float, length: float, width: float) -> np.ndarray:
    """Points all over a rectangle: an independent, simple-minded check of overlap."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, 9) * length, np.linspace(-0.5, 0.5, 5) * width)
    return (x + 1j * y) + (u.ravel() + 1j * v.ravel()) * np.exp(1j * yaw)


def contains(points: np.ndarray, x: float, y: float, yaw: float, length: float, width: float) -> bool:
    local = (points - (x + 1j * y)) * np.exp(-1j * yaw)
    return bool(np.any((np.abs(local.real) < 0.5 * length) & (np.abs(local.imag) < 0.5 * width)))


@pytest.mark.parametrize("situation", SITUATIONS)
def test_nobody_collides(situation):
    drive, vehicles = staged(situation)
    for time_s in TIMES_S[::4]:
        x, y, yaw = (float(drive.at(name, time_s)) for name in ("x_m", "y_m", "yaw_rad"))
        ahead = REAR_AXLE_TO_FRONT_M - 0.5 * CAR_LENGTH_M
        boxes = [(x + ahead * np.cos(yaw), y + ahead * np.sin(yaw), yaw, CAR_LENGTH_M, CAR_WIDTH_M)]
        for vehicle in vehicles:
            state = vehicle.state(time_s)
            boxes.append((state.x_m, state.y_m, state.yaw_rad, *vehicle.size_m))
        for i, first in enumerate(boxes):
            points = outline(*first)
            for second in boxes[i + 1 :]:
                if np.hypot(first[0] - second[0], first[1] - second[1]) < 12.0:
                    assert not contains(points, *second), f"at {time_s} s"


@pytest.mark.parametrize("situation", ["ordinary", "lead_truck", "oncoming_platoon"])
def test_motion_is_smooth_and_forward(situation):
    _, vehicles = staged(situation, seed=1)
    for vehicle in vehicles:
        vx, vy = np.gradient(vehicle.x_m, vehicle.time_s), np.gradient(vehicle.y_m, vehicle.time_s)
        forward = vx * np.cos(vehicle.yaw_rad) + vy * np.sin(vehicle.yaw_rad)
        sideways = -vx * np.sin(vehicle.yaw_rad) + vy * np.cos(vehicle.yaw_rad)
        assert forward.min() > -1e-6
        assert forward.max() < 16.0
        assert np.abs(sideways).max() < 0.8
        assert np.abs(np.gradient(forward, vehicle.time_s)).max() < 3.5
        assert np.abs(np.diff(vehicle.yaw_rad)).max() < 0.1  # not wrapped, no jump


def test_state_interpolates():
    _, vehicles = staged("ordinary", seed=2)
    vehicle = vehicles[0]
    time_s = 3.21
    state = vehicle.state(time_s)
    assert state.x_m == pytest.approx(np.interp(time_s, vehicle.time_s, vehicle.x_m), abs=1e-9)
    later = vehicle.state(time_s + 0.004)
    assert later.x_m - state.x_m == pytest.approx(0.004 * state.speed_mps * np.cos(state.yaw_rad), abs=2e-3)


def test_lead_truck_and_following_van_fill_their_views():
    for seed in range(12):  # never left out for lack of room
        drive, vehicles = staged("lead_truck", seed)
        assert vehicles[0].kind == "truck"
        in_view = [relative(drive, vehicles[0], time_s) for time_s in TIMES_S]
        assert all(4.0 < np.hypot(ahead, aside) < 32.0 and ahead > 0.0 for ahead, aside in in_view)
        drive, vehicles = staged("following_van", seed)
        van = next(
            vehicle for vehicle in vehicles[:2] if vehicle.kind == "van" and relative(drive, vehicle, 0.0)[0] < 0.0
        )
        behind = [relative(drive, van, time_s) for time_s in TIMES_S]
        assert all(4.0 < np.hypot(ahead, aside) < 20.0 and ahead < 0.0 for ahead, aside in behind)


def test_what_the_route_swerves_around_is_there():
    passed = standing = 0
    for seed in range(40):
        drive, vehicles = staged("ordinary", seed)
        first_m, last_m = drive.at("s_m", np.array([0.0, 20.0]))
        for passed_m in drive.route.passed_m:
            if first_m < passed_m < last_m:
                time_s = float(np.interp(passed_m, drive.s_m, drive.time_s))
                beside = [
                    relative(drive, vehicle, time_s) for vehicle in vehicles if np.ptp(vehicle.x_m + vehicle.y_m) == 0
                ]
                passed += 1
                standing += any(abs(ahead) < 0.5 and -3.2 < aside < -2.4 for ahead, aside in beside)
    assert passed >= 3
    assert standing == passed


def test_queue_platoon_and_cross_traffic_are_there():
    drive, vehicles = staged("side_queue")
    beside = [
        any(abs(ahead) < 12.0 and 2.0 < aside < 5.5 for ahead, aside in (relative(drive, v, t) for v in vehicles))
        for t in TIMES_S
    ]
    assert np.mean(beside) > 0.6
    drive, vehicles = staged("standing_cross_traffic")
    crossing = [v for v in vehicles if abs(np.sin(v.yaw_rad[0] - drive.yaw_rad[0])) > 0.9]
    passing = [any(abs(relative(drive, v, t)[1]) < 12.0 for v in crossing) for t in TIMES_S]
    assert np.mean(passing) > 0.5
    _, vehicles = staged("oncoming_platoon")
    assert len(vehicles) > 12


def relative(drive: Drive, vehicle: Vehicle, time_s: float) -> tuple[float, float]:
    """Metres ahead and to the left of the car's rear axle."""
    state = vehicle.state(time_s)
    x, y, yaw = (float(drive.at(name, time_s)) for name in ("x_m", "y_m", "yaw_rad"))
    local = (state.x_m - x + 1j * (state.y_m - y)) * np.exp(-1j * yaw)
    return local.real, local.imag


@pytest.mark.parametrize(
    ("lane", "expected"),
    [
        (Lane(0, 2, 1), (5.0, 2 * BLOCK_M - LANE_M, 0.0)),
        (Lane(0, 2, -1), (5.0, 2 * BLOCK_M + LANE_M, np.pi)),
        (Lane(1, -1, 1), (-BLOCK_M + LANE_M, 5.0, 0.5 * np.pi)),
        (Lane(1, -1, -1), (-BLOCK_M - LANE_M, 5.0, 1.5 * np.pi)),
    ],
)
def test_traffic_keeps_to_the_right(lane, expected):
    x, y, heading = lane.at(np.array([5.0]))
    assert (float(x[0]), float(y[0]), heading) == pytest.approx(expected)
