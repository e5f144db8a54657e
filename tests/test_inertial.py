from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError, DatasetError
from mixo_env.experts.inertial import (
    GRADES,
    SPEED_VARIANCE,
    WHEEL_RADIUS_M,
    YAW_RATE_VARIANCE,
    InertialOdometry,
    ProcessNoise,
    standstill_bias,
)
from mixo_env.experts.rate_filter import RateFilter
from mixo_env.nuscenes.scene import CanBus, Signal
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.schema import INERTIAL_EXPERTS
from tests.nuscenes_fixture import DRIVES, write_nuscenes

START_US = 1_532_402_927_000_000


def stamps_us(duration_s: float, rate_hz: float, first_s: float = 0.0, jitter_s: float = 0.0, seed: int = 0):
    times = np.arange(int(duration_s * rate_hz) + 1) / rate_hz + first_s
    times += np.random.default_rng(seed).uniform(-jitter_s, jitter_s, len(times))
    return START_US + np.sort(np.round(1e6 * times).astype(np.int64))


def signal(times_us, value) -> Signal:
    return Signal(times_us, np.array([value(1e-6 * (t - START_US)) for t in times_us], dtype=np.float64))


def drive(speed, yaw_rate, duration_s: float = 10.0, jitter_s: float = 0.003, bias: float = 0.0) -> CanBus:
    """All messages of a drive given by functions of time; speed in m/s, yaw rate in rad/s."""
    wheel_us = stamps_us(duration_s, 100, 0.002, jitter_s, 1)
    wheels = signal(wheel_us, speed)
    imu_us, pose_us = stamps_us(duration_s, 100, 0.004, jitter_s, 2), stamps_us(duration_s, 50, 0.003, jitter_s, 3)
    monitor_us = stamps_us(duration_s, 2, 0.3)
    return CanBus(
        wheel_speed_radps=Signal(wheel_us, np.tile(wheels.value[:, None] / WHEEL_RADIUS_M, 4)),
        imu_yaw_rate_radps=signal(imu_us, lambda t: yaw_rate(t) + bias),
        pose_speed_mps=signal(pose_us, speed),
        pose_yaw_rate_radps=signal(pose_us, yaw_rate),
        monitor_yaw_rate_radps=signal(monitor_us, lambda t: yaw_rate(t) + bias),
        monitor_speed_mps=signal(monitor_us, speed),
    )


def wiggle(can_bus: CanBus, after_us: int, seed: int = 5) -> CanBus:
    """The same CAN bus with every value after ``after_us`` replaced by noise."""
    rng = np.random.default_rng(seed)

    def change(sent: Signal | None) -> Signal | None:
        if sent is None:
            return None
        value = sent.value.copy()
        late = sent.timestamp_us > after_us
        value[late] = rng.normal(0.0, 9.0, value[late].shape)
        return Signal(sent.timestamp_us, value)

    return CanBus(**{field.name: change(getattr(can_bus, field.name)) for field in fields(CanBus)})


def test_grades_are_those_of_the_recordings():
    assert GRADES == INERTIAL_EXPERTS


@pytest.mark.parametrize("grade", GRADES)
def test_circle(grade):
    """Constant speed on a circle is reproduced exactly, at any time and from before the first message."""
    can_bus = drive(lambda t: 6.0, lambda t: -0.3)
    times = START_US + np.array([-60_000, -10_000, 500_000, 555_555, 4_000_000, 10_050_000])
    track = InertialOdometry(can_bus, grade).at(times)
    elapsed = 1e-6 * np.diff(times)
    np.testing.assert_allclose(np.diff(track.distance_m), 6.0 * elapsed, atol=1e-9)
    np.testing.assert_allclose(track.speed_mps, 6.0, atol=1e-9)
    after = 2 if grade == "INERTIAL_CONSUMER" else 0  # its first message comes after 0.3 s
    np.testing.assert_allclose(np.diff(track.yaw_rad[after:]), -0.3 * elapsed[after:], atol=1e-9)
    np.testing.assert_allclose(track.yaw_rate_radps[after:], -0.3, atol=1e-9)
    assert np.all(np.diff(track.yaw_variance_rad2) > 0)
    assert track.yaw_variance_rad2[0] == 0


def test_counts_from_the_first_message():
    can_bus = drive(lambda t: 5.0, lambda t: 0.2, jitter_s=0.0)
    odometry = InertialOdometry(can_bus, "INERTIAL")
    assert odometry.at(can_bus.wheel_speed_radps.timestamp_us[:1]).distance_m[0] == 0.0
    assert odometry.at(can_bus.imu_yaw_rate_radps.timestamp_us[:1]).yaw_rad[0] == 0.0


def test_yaw_is_not_wrapped():
    can_bus = drive(lambda t: 5.0, lambda t: 0.9)
    track = InertialOdometry(can_bus, "INERTIAL").at(START_US + np.array([1_000_000, 9_000_000]))
    assert track.yaw_rad[1] - track.yaw_rad[0] == pytest.approx(7.2)


@pytest.mark.parametrize("grade", GRADES)
@pytest.mark.parametrize("at_s", [0.31, 3.0, 7.77])
def test_causal(grade, at_s):
    """Whatever comes after t, every value up to t stays the same, bit for bit."""
    can_bus = drive(lambda t: max(0.0, 4 * np.sin(t)), lambda t: 0.3 * np.cos(2 * t), bias=0.01)
    can_bus = replace(can_bus, consumer_yaw_rate_radps=None)
    now_us = START_US + round(1e6 * at_s)
    times = np.arange(START_US, now_us + 1, 40_000)
    times[-1] = now_us
    one = InertialOdometry(can_bus, grade).at(times)
    other = InertialOdometry(wiggle(can_bus, now_us), grade).at(times)
    for field in fields(one):
        assert np.array_equal(getattr(one, field.name), getattr(other, field.name)), field.name


def test_same_as_the_papers_four_state_filter():
    """The paper's filter as printed, [s, v, psi, dpsi] with both inputs in one measurement, written with filterpy."""
    from filterpy.kalman import KalmanFilter

    can_bus = drive(lambda t: 5 + np.sin(t), lambda t: 0.2 * np.sin(1.7 * t), duration_s=4.0, jitter_s=0.006)
    noise = ProcessNoise(acceleration=0.7, yaw_acceleration=0.02)
    speed, rate = can_bus.pose_speed_mps, can_bus.pose_yaw_rate_radps
    kalman = KalmanFilter(dim_x=4, dim_z=2)
    kalman.x = np.array([[0.0], [speed.value[0]], [0.0], [rate.value[0]]])
    kalman.P = np.diag([0.0, 0.1, 0.0, 0.01])  # the first message is a measurement too
    kalman.H = np.array([[0.0, 1, 0, 0], [0, 0, 0, 1]])
    kalman.R = np.diag([0.1, 0.01])
    expected = [kalman.x[:, 0]]
    for k, dt in enumerate(1e-6 * np.diff(speed.timestamp_us), start=1):
        block = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        step = np.array([[1.0, dt], [0, 1]])
        kalman.predict(
            F=np.kron(np.eye(2), step), Q=np.kron(np.diag([noise.acceleration, noise.yaw_acceleration]), block)
        )
        kalman.update(np.array([[speed.value[k]], [rate.value[k]]]))
        expected.append(kalman.x[:, 0])
    track = InertialOdometry(can_bus, "INERTIAL_POSE", process_noise=noise).at(speed.timestamp_us)
    found = np.column_stack([track.distance_m, track.speed_mps, track.yaw_rad, track.yaw_rate_radps])
    np.testing.assert_allclose(found, expected, atol=1e-10)


@pytest.mark.parametrize("begin_s", [0.0, 3.0])
@pytest.mark.parametrize(("grade", "yaw_lag_deg", "step_deg"), [("INERTIAL", 0.2, 0.1), ("INERTIAL_POSE", 0.4, 0.25)])
def test_lag_in_a_turn_of_20_degrees_per_second(grade, yaw_lag_deg, step_deg, begin_s):
    """Within 1 s into a turn of 20 deg/s, at once or after a straight, and out of it again: the yaw hardly lags."""
    peak = np.radians(20.0)
    ramp_s = [-1.0, begin_s, begin_s + 1, begin_s + 4, begin_s + 5, 10.0]
    rate = lambda t: float(np.interp(t, ramp_s, [0, 0, peak, peak, 0, 0]))  # noqa: E731
    times = START_US + np.arange(200_000, 10_000_000, 83_333)
    track = InertialOdometry(drive(lambda t: 6.0, rate, jitter_s=0.0), grade).at(times)
    fine = np.arange(0.0, 10.0, 1e-4)
    true_yaw = np.interp(1e-6 * (times - START_US), fine, np.cumsum([rate(t) for t in fine]) * 1e-4)
    error = np.degrees(track.yaw_rad - true_yaw)
    assert np.abs(error - error[0]).max() < yaw_lag_deg
    assert np.abs(np.diff(error)).max() < step_deg
    assert np.abs(error[-1] - error[0]) < 0.1
    rate_error = np.degrees(track.yaw_rate_radps) - [np.degrees(rate(1e-6 * (t - START_US))) for t in times]
    assert np.abs(rate_error).max() < 12.0  # 0.52 s behind a ramp of 20 deg/s^2


def test_braking_does_not_lose_distance():
    speed = lambda t: float(np.interp(t, [0, 4, 7], [9, 9, 0]))  # noqa: E731
    track = InertialOdometry(drive(speed, lambda t: 0.0), "INERTIAL").at(START_US + np.array([100_000, 9_900_000]))
    assert np.diff(track.distance_m)[0] == pytest.approx(9 * 3.9 + 4.5 * 3, abs=0.02)


def test_variance_of_increments_is_that_of_the_errors():
    """Simulate the model itself many times: predicted and empirical variances of the increments' errors agree."""
    rng = np.random.default_rng(4)
    density, variance = 0.5, 0.02
    times_s = np.array([0.0, 0.1, 0.2, 0.5, 0.6, 0.65, 0.9, 1.4])
    asked_s = np.array([-0.2, 0.03, 0.07, 0.33, 0.7, 0.71, 1.45, 1.6])
    errors = []
    for _ in range(400):
        grid = np.unique(np.concatenate([times_s, asked_s]))
        rate = np.zeros(len(grid))
        quantity = np.zeros(len(grid))
        rate[0] = rng.normal(0.0, np.sqrt(variance))
        for i, dt in enumerate(np.diff(grid)):
            block = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            moved, gained = rng.multivariate_normal([0, 0], block)
            quantity[i + 1] = quantity[i] + rate[i] * dt + moved
            rate[i + 1] = rate[i] + gained
        measured = np.interp(times_s, grid, rate) + rng.normal(0.0, np.sqrt(variance), len(times_s))
        sent = Signal(START_US + np.round(1e6 * times_s).astype(np.int64), measured)
        run = RateFilter.run(sent, variance, density)
        asked_us = START_US + np.round(1e6 * asked_s).astype(np.int64)
        errors.append(np.diff(run.at(asked_us)[0] - np.interp(asked_s, grid, quantity)))
        predicted = run.increment_variance(asked_us)
    assert predicted[0] == 0
    empirical = np.mean(np.square(errors), axis=0)
    np.testing.assert_allclose(predicted[1:], empirical, rtol=0.2)


def test_stated_deviations_follow_how_well_the_filter_predicts():
    """Where R is the paper's a calm drive is surer than a swerving one, and what came later changes nothing."""
    asked = START_US + np.arange(2_000_000, 9_000_000, 83_333)
    variance = {}
    for name, swing in (("calm", 0.0), ("swerving", 0.5)):
        can_bus = drive(lambda t: 6.0, lambda t, swing=swing: swing * np.sin(3.0 * t))
        for grade in GRADES:
            variance[name, grade] = np.diff(InertialOdometry(can_bus, grade).at(asked).yaw_variance_rad2)
            late = InertialOdometry(wiggle(can_bus, int(asked[40])), grade).at(asked[:41])
            np.testing.assert_array_equal(np.diff(late.yaw_variance_rad2), variance[name, grade][:40])
    for grade in ("INERTIAL", "INERTIAL_POSE"):
        assert np.all(variance["swerving", grade] > 30.0 * variance["calm", grade])
        assert np.all(variance["calm", grade][30:] > 0.0)
    np.testing.assert_array_equal(variance["swerving", "INERTIAL_CONSUMER"], variance["calm", "INERTIAL_CONSUMER"])


def test_unknown_start_of_a_slow_gyro():
    """Until the first vehicle_monitor message yaw stands still, as uncertain as a measurement of its rate."""
    can_bus = drive(lambda t: 6.0, lambda t: 0.3)
    times = START_US + np.array([0, 100_000, 250_000, 350_000])
    track = InertialOdometry(can_bus, "INERTIAL_CONSUMER").at(times)
    np.testing.assert_array_equal(track.yaw_rad[:3], 0.0)
    expected = YAW_RATE_VARIANCE["INERTIAL_CONSUMER"] * np.array([0.1, 0.15]) ** 2
    np.testing.assert_allclose(np.diff(track.yaw_variance_rad2)[:2], expected)
    assert track.yaw_rate_radps[3] == pytest.approx(0.3)


class TestBias:
    def can_bus(self, bias=0.02):
        """Stands for 3 s, drives for 4 s, stands again."""
        speed = lambda t: 5.0 if 3.0 <= t <= 7.0 else 0.0  # noqa: E731
        rate = lambda t: 0.2 if 3.0 <= t <= 7.0 else 0.0  # noqa: E731
        return drive(speed, rate, bias=bias, jitter_s=0.0)

    @pytest.mark.parametrize("grade", ["INERTIAL", "INERTIAL_CONSUMER"])
    def test_taken_off_after_half_a_second(self, grade):
        track = InertialOdometry(self.can_bus(), grade).at(START_US + np.array([0, 400_000, 1_500_000, 9_900_000]))
        # The turn itself, 0.8 rad, is sampled at 2 Hz by the consumer gyro; 8.4 s of bias would be 0.17 rad.
        assert track.yaw_rad[3] - track.yaw_rad[2] == pytest.approx(0.8, abs=0.01 if grade == "INERTIAL" else 0.15)

    def test_unknown_at_first_then_exact(self):
        can_bus = self.can_bus()
        bias = standstill_bias(can_bus.imu_yaw_rate_radps, can_bus.wheel_speed_radps)
        time_s = 1e-6 * (can_bus.imu_yaw_rate_radps.timestamp_us - START_US)
        np.testing.assert_array_equal(bias[time_s < 0.5], 0.0)
        np.testing.assert_allclose(bias[time_s > 0.52], 0.02, atol=1e-12)

    def test_gyro_while_driving_or_just_stopped_does_not_count(self):
        can_bus = self.can_bus(bias=0.0)
        gyro = can_bus.imu_yaw_rate_radps
        time_s = 1e-6 * (gyro.timestamp_us - START_US)
        rocking = np.where((time_s > 7.0) & (time_s < 7.4), 0.5, 0.0)
        bias = standstill_bias(Signal(gyro.timestamp_us, gyro.value + rocking), can_bus.wheel_speed_radps)
        np.testing.assert_allclose(bias, 0.0, atol=1e-12)

    def test_never_standing_takes_nothing_off(self):
        can_bus = drive(lambda t: 3.0, lambda t: 0.1)
        assert not standstill_bias(can_bus.imu_yaw_rate_radps, can_bus.wheel_speed_radps).any()

    def test_pose_grade_is_left_as_printed(self):
        can_bus = self.can_bus()
        biased = Signal(can_bus.pose_yaw_rate_radps.timestamp_us, can_bus.pose_yaw_rate_radps.value + 0.02)
        track = InertialOdometry(replace(can_bus, pose_yaw_rate_radps=biased), "INERTIAL_POSE").at(
            START_US + np.array([8_500_000, 9_500_000])
        )
        assert np.diff(track.yaw_rad)[0] == pytest.approx(0.02, abs=1e-3)


def test_consumer_prefers_the_production_gyro():
    can_bus = drive(lambda t: 5.0, lambda t: 0.1)
    gyro = signal(stamps_us(10.0, 50), lambda t: 0.25)
    track = InertialOdometry(replace(can_bus, consumer_yaw_rate_radps=gyro), "INERTIAL_CONSUMER").at(
        START_US + np.array([0, 2_000_000])
    )
    assert np.diff(track.yaw_rad)[0] == pytest.approx(0.5)


class TestBadInput:
    @pytest.mark.parametrize(
        ("grade", "missing", "message"),
        [
            ("INERTIAL", "wheel_speed_radps", "zoe_veh_info"),
            ("INERTIAL", "imu_yaw_rate_radps", "ms_imu"),
            ("INERTIAL_POSE", "pose_speed_mps", "pose"),
            ("INERTIAL_CONSUMER", "wheel_speed_radps", "zoe_veh_info"),
            ("INERTIAL_CONSUMER", "monitor_yaw_rate_radps", "vehicle_monitor"),
        ],
    )
    def test_missing_message(self, grade, missing, message):
        can_bus = replace(drive(lambda t: 5.0, lambda t: 0.1, duration_s=0.1), **{missing: None})
        with pytest.raises(DatasetError, match=f"^{grade} needs the CAN bus message {message}"):
            InertialOdometry(can_bus, grade)

    def test_unknown_grade(self):
        with pytest.raises(ConfigurationError, match="did you mean 'INERTIAL_POSE'"):
            InertialOdometry(CanBus(), "INERTIAL-POSE")

    def test_times_outside_the_can_bus(self):
        odometry = InertialOdometry(drive(lambda t: 5.0, lambda t: 0.1, duration_s=2.0))
        with pytest.raises(DatasetError, match=r"begins 0\.50 s after the first image"):
            odometry.at(np.array([START_US - 498_000]))
        with pytest.raises(DatasetError, match=r"silent for 3\.\d s"):
            odometry.at(np.array([START_US + 5_000_000]))

    def test_descending_times(self):
        odometry = InertialOdometry(drive(lambda t: 5.0, lambda t: 0.1, duration_s=1.0))
        with pytest.raises(ConfigurationError, match="ascending"):
            odometry.at(START_US + np.array([500_000, 400_000]))

    def test_no_times(self):
        assert len(InertialOdometry(drive(lambda t: 5.0, lambda t: 0.1, duration_s=0.1)).at(np.array([])).yaw_rad) == 0


def test_repeated_stamps_are_harmless():
    can_bus = drive(lambda t: 5.0, lambda t: 0.1, duration_s=2.0)
    wheels = can_bus.wheel_speed_radps
    twice = Signal(np.repeat(wheels.timestamp_us, 2), np.repeat(wheels.value, 2, axis=0))
    track = InertialOdometry(replace(can_bus, wheel_speed_radps=twice)).at(START_US + np.array([0, 1_500_000]))
    assert np.diff(track.distance_m)[0] == pytest.approx(7.5)


def test_from_a_folder_to_the_true_path(tmp_path):
    write_nuscenes(tmp_path, drives=DRIVES[:1], images=False)
    scene = open_dataset(tmp_path).load("scene-2061")
    for grade, degrees in (("INERTIAL", 0.1), ("INERTIAL_POSE", 0.3), ("INERTIAL_CONSUMER", 10.0)):
        for camera in scene.cameras.values():
            track = InertialOdometry(scene.can_bus, grade).at(camera.timestamp_us)
            np.testing.assert_allclose(np.diff(track.distance_m), 8e-6 * np.diff(camera.timestamp_us), atol=1e-6)
            error = track.yaw_rad - np.unwrap(camera.yaw_rad)
            assert np.degrees(np.abs(error - error[0]).max()) < degrees


def test_defaults_are_the_papers():
    assert (SPEED_VARIANCE, YAW_RATE_VARIANCE["INERTIAL_POSE"], YAW_RATE_VARIANCE["INERTIAL"]) == (0.1, 0.01, 0.01)


def test_fit_finds_the_process_noise_again():
    """A random walk of known density, measured with the paper's R; and the script that prints the fit."""
    from experiments.fit_process_noise import fit_density

    rng = np.random.default_rng(8)
    times = stamps_us(20.0, 20, jitter_s=0.01)
    walk = np.cumsum(rng.normal(0.0, np.sqrt(2.0 * np.diff(1e-6 * times, prepend=1e-6 * times[0]))))
    sent = Signal(times, walk + rng.normal(0.0, np.sqrt(SPEED_VARIANCE), len(times)))
    assert fit_density([sent], SPEED_VARIANCE) == pytest.approx(2.0, rel=0.3)


def test_fit_without_messages_is_one_line(tmp_path):
    import subprocess
    import sys

    command = [sys.executable, "-m", "experiments.fit_process_noise", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "give the can_bus folder itself" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
