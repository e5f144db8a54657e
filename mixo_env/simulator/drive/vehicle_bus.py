"""The car's CAN bus: wheels, gyros, steering and poses, as noisy, biased and late as measured on the real car.

Message names, fields and units are those of nuScenes (NUSCENES.md section 7); magnitudes come from the CAN files of
four real scenes. ``production_gyro`` is an addition: the yaw-rate sensor of an ordinary car.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.geometry import quaternion_wxyz_from_roll_pitch_yaw, quaternion_wxyz_from_yaw
from mixo_env.simulator.drive.drive import Drive, road_noise
from mixo_env.simulator.drive.localisation import Localisation

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Message = dict[str, Any]

WHEELBASE_M, WHEEL_SPACING_M = 2.588, 1.51
GRAVITY_MPS2 = 9.79
STEERING_RATIO = 14.5
WHEEL_RADIUS_RANGE_M = (0.301, 0.309)
RPM_RESOLUTION = 0.0417
_AFTER_SCENE_US = 15_000  # the bus is recorded from the first key frame until shortly after the last
_WHEELS = ("FL", "FR", "RL", "RR")


@dataclass(frozen=True)
class BusSensors:
    """What is constant in the sensors of one car on one drive.

    Attributes:
        wheel_radius_m: ``(4,)`` effective radius, FL, FR, RL, RR.
        wheel_latency_s: measurement to arrival (and stamp) of ``zoe_veh_info``.
        imu_bias_radps, imu_scale: of the yaw rate in ``ms_imu``.
        imu_tilt_mps2: ``(2,)`` constant share of gravity in the forward and left accelerations (mounting).
        imu_yaw_origin_rad: arbitrary origin of the yaw in ``ms_imu.q``.
        pose_speed_scale, pose_speed_lag_s: ``pose.vel`` follows the wheels, late and a little short.
        monitor_bias_radps, monitor_speed_scale: of ``vehicle_monitor``, its speed against ``pose.vel``.
        gyro_bias_radps, gyro_scale: of ``production_gyro`` when switched on.
        steering_offset_rad: of the steering wheel.
    """

    wheel_radius_m: FloatArray
    wheel_latency_s: float
    imu_bias_radps: float
    imu_scale: float
    imu_tilt_mps2: FloatArray
    imu_yaw_origin_rad: float
    pose_speed_scale: float
    pose_speed_lag_s: float
    monitor_bias_radps: float
    monitor_speed_scale: float
    gyro_bias_radps: float
    gyro_scale: float
    steering_offset_rad: float


def draw_sensors(rng: np.random.Generator, mean_wheel_radius_m: float) -> BusSensors:
    """Sensor constants of one drive of a car whose tyres usually have ``mean_wheel_radius_m``."""
    radius_m = np.clip(mean_wheel_radius_m + rng.uniform(-0.0025, 0.0025), *WHEEL_RADIUS_RANGE_M)
    unequal = rng.normal(0.0, 0.002, 4)
    unequal[2:] -= unequal[2:].mean()  # the rear axle's mean stays the radius of this drive
    return BusSensors(
        wheel_radius_m=radius_m * (1.0 + unequal),
        wheel_latency_s=rng.uniform(0.010, 0.030),
        imu_bias_radps=rng.normal(-0.0006, 0.0006),
        imu_scale=rng.normal(1.0, 0.002),
        imu_tilt_mps2=rng.normal((-0.3, 0.0), (0.25, 0.2)),
        imu_yaw_origin_rad=rng.uniform(-np.pi, np.pi),
        pose_speed_scale=rng.uniform(0.982, 1.002),
        pose_speed_lag_s=rng.uniform(0.09, 0.14),
        monitor_bias_radps=np.radians(rng.normal(-0.18, 0.07)),
        monitor_speed_scale=rng.uniform(0.999, 1.002),
        gyro_bias_radps=np.radians(rng.normal(0.0, 0.15)),
        gyro_scale=rng.normal(1.0, 0.007),
        steering_offset_rad=rng.normal(0.0, 0.03),
    )


@dataclass(frozen=True)
class _Recorder:
    """Everything a message generator needs."""

    rng: np.random.Generator
    drive: Drive
    localisation: Localisation
    sensors: BusSensors
    start_us: int
    end_us: int

    def grid_us(self, period_us: int) -> IntArray:
        """Regular measurement times with a random phase."""
        return np.arange(self.start_us + int(self.rng.integers(period_us)), self.end_us, period_us, dtype=np.int64)

    def seconds(self, utime: IntArray) -> FloatArray:
        return (utime - self.start_us) / 1e6

    def shaking(self, time_s: FloatArray) -> FloatArray:
        """How much the road shakes the sensors, 0 at rest to about 1."""
        return np.minimum(self.drive.at("speed_mps", time_s) / 8.0, 1.4)

    def shaken(self, time_s: FloatArray) -> FloatArray:
        """Coloured noise at the frequency of the body, unit variance at 8 m/s, zero at rest."""
        noise = road_noise(self.rng, len(self.drive.time_s))
        return self.shaking(time_s) * np.interp(time_s, self.drive.time_s, noise)

    def white(self, time_s: FloatArray) -> FloatArray:
        return self.rng.standard_normal(len(time_s))

    def received(self, count: int, lost: float) -> NDArray[np.bool_]:
        """Which of ``count`` messages arrive."""
        return self.rng.uniform(size=count) >= lost


def bus_messages(
    rng: np.random.Generator,
    drive: Drive,
    localisation: Localisation,
    sensors: BusSensors,
    first_sample_us: int,
    last_sample_us: int,
) -> dict[str, list[Message]]:
    """All messages of one scene by name, in time order, each a list of JSON objects with ``utime``."""
    recorder = _Recorder(rng, drive, localisation, sensors, first_sample_us, last_sample_us + _AFTER_SCENE_US)
    imu = _ms_imu(recorder)
    return {
        "ms_imu": imu,
        "pose": _pose(recorder, imu),
        "zoe_veh_info": _zoe_veh_info(recorder),
        "vehicle_monitor": _vehicle_monitor(recorder),
        "steeranglefeedback": _steeranglefeedback(recorder),
        "production_gyro": _production_gyro(recorder),
    }


def _ms_imu(bus: _Recorder) -> list[Message]:
    """100 Hz; one message in ten is stamped late and the next one hastens after it."""
    grid = bus.grid_us(10_000)
    grid = grid[bus.received(len(grid), 0.004)]
    t = bus.seconds(grid)
    drive, sensors = bus.drive, bus.sensors
    yaw_rate = sensors.imu_scale * drive.at("yaw_rate_radps", t) + sensors.imu_bias_radps
    rates = np.stack(
        [
            np.gradient(drive.at("roll_rad", t), t) + 0.002 * bus.white(t),
            np.gradient(drive.at("pitch_rad", t), t) + 0.002 * bus.white(t),
            yaw_rate + 0.0045 * bus.shaken(t) + (0.0008 + 0.0006 * bus.shaking(t)) * bus.white(t),
        ],
        axis=1,
    )
    sideways = drive.at("speed_mps", t) * drive.at("yaw_rate_radps", t)
    noise = (0.02 + np.array([[0.1], [0.1], [0.2]]) * bus.shaking(t)) * bus.rng.standard_normal((3, len(t)))
    tilted = sensors.imu_tilt_mps2
    accelerations = np.stack(
        [
            drive.at("acceleration_mps2", t) - GRAVITY_MPS2 * drive.at("pitch_rad", t) + tilted[0] + noise[0],
            sideways + GRAVITY_MPS2 * drive.at("roll_rad", t) + tilted[1] + noise[1],
            GRAVITY_MPS2 + 0.4 * bus.shaken(t) + noise[2],
        ],
        axis=1,
    )
    yaw = drive.at("yaw_rad", t) - sensors.imu_yaw_origin_rad
    attitude = quaternion_wxyz_from_roll_pitch_yaw(drive.at("roll_rad", t), drive.at("pitch_rad", t), yaw)
    late = bus.rng.uniform(size=len(t)) < 0.1
    stamp = grid + bus.rng.integers(0, 300, len(t)) + 12_000 * late
    stamp[1:] += np.where(late[:-1] & ~late[1:], 4_500, 0)
    stamp = np.maximum.accumulate(stamp)
    return [
        {
            "utime": int(utime),
            "linear_accel": _listed(acceleration),
            "q": _listed(quaternion),
            "rotation_rate": _listed(rate),
        }
        for utime, acceleration, quaternion, rate in zip(stamp, accelerations, attitude, rates, strict=True)
    ]


def _pose(bus: _Recorder, imu: list[Message]) -> list[Message]:
    """50 Hz: the localisation, with copies of what the IMU said last."""
    grid = bus.grid_us(20_000)
    stamp = grid[bus.received(len(grid), 0.006)]
    stamp = stamp + np.rint(300 * bus.rng.standard_normal(len(stamp))).astype(np.int64)
    t = bus.seconds(stamp)
    x, y, yaw = bus.localisation.pose(t)
    quaternions = quaternion_wxyz_from_yaw(yaw)
    speed = bus.sensors.pose_speed_scale * bus.drive.at("speed_mps", t - bus.sensors.pose_speed_lag_s)
    speed = speed + 0.012 * bus.shaken(t)
    imu_us = np.array([message["utime"] for message in imu])
    last = np.maximum(np.searchsorted(imu_us, stamp, side="right") - 1, 0)
    return [
        {
            "utime": int(stamp[i]),
            "accel": imu[last[i]]["linear_accel"],
            "orientation": _listed(quaternions[i]),
            "pos": [float(x[i]), float(y[i]), 0.0],
            "rotation_rate": imu[last[i]]["rotation_rate"],
            "vel": [_number(speed[i]), 0.0, 0.0],
        }
        for i in range(len(stamp))
    ]


def _wheel_rpm(bus: _Recorder, time_s: FloatArray) -> FloatArray:
    """``(n, 4)`` revolutions per minute at measurement times: the axle's motion at each wheel, noise, quantisation."""
    speed, yaw_rate = bus.drive.at("speed_mps", time_s), bus.drive.at("yaw_rate_radps", time_s)
    left, right = speed - 0.5 * WHEEL_SPACING_M * yaw_rate, speed + 0.5 * WHEEL_SPACING_M * yaw_rate
    front = WHEELBASE_M * yaw_rate
    rolled = np.stack([np.hypot(left, front), np.hypot(right, front), left, right], axis=1)
    moving = np.minimum(speed / 2.0, 1.0)[:, None]
    common = 0.022 * bus.shaken(time_s)[:, None]
    rolled = rolled + moving * (common + 0.010 * bus.rng.standard_normal(rolled.shape))
    rpm = np.maximum(rolled, 0.0) / bus.sensors.wheel_radius_m * 60.0 / (2.0 * np.pi)
    rpm[speed < 0.05] = 0.0
    return np.rint(rpm / RPM_RESOLUTION) * RPM_RESOLUTION


def _zoe_veh_info(bus: _Recorder) -> list[Message]:
    """100 Hz, stamped on arrival; wheels are measured at 50 Hz, so most messages repeat the last value."""
    latency_us = round(1e6 * bus.sensors.wheel_latency_s)
    measured = np.arange(bus.start_us - 100_000, bus.end_us, 20_000) + int(bus.rng.integers(20_000))
    measured = measured[bus.received(len(measured), 0.05)]
    wheels = _wheel_rpm(bus, bus.seconds(measured))
    stamp = bus.grid_us(10_000)
    stamp = stamp[bus.received(len(stamp), 0.003)]
    stamp = np.sort(stamp + np.rint(1_200 * bus.rng.standard_normal(len(stamp))).astype(np.int64))
    last = np.maximum(np.searchsorted(measured, stamp - latency_us, side="right") - 1, 0)
    t = bus.seconds(stamp) - bus.sensors.wheel_latency_s
    speed, yaw_rate = bus.drive.at("speed_mps", t), bus.drive.at("yaw_rate_radps", t)
    steering_deg = np.degrees(_steering_rad(bus, t))
    offset_deg = np.degrees(bus.sensors.steering_offset_rad)
    distance_cm = 100.0 * bus.drive.at("s_m", t)
    forward = bus.drive.at("acceleration_mps2", t) + 0.05 * bus.white(t)
    sideways = speed * yaw_rate + 0.05 * bus.white(t)
    return [
        {
            "utime": int(stamp[i]),
            **{f"{wheel}_wheel_speed": _number(wheels[last[i], j]) for j, wheel in enumerate(_WHEELS)},
            "longitudinal_accel": round(float(forward[i]) / 0.05) * 0.05,
            "odom_speed": float(int(3.6 * speed[i])),
            "odom": float(int(distance_cm[i]) % 125),
            "meanEffTorque": 0.0,
            "pedal_cc": 0.0,
            "regen": 0.0,
            "requestedTorqueAfterProc": 0.0,
            "transversal_accel": round(float(sideways[i]) / 0.02) * 0.02,
            "left_solar": 0.0,
            "right_solar": 0.0,
            "steer_corrected": _number(steering_deg[i] - offset_deg),
            "steer_offset_can": _number(offset_deg),
            "steer_raw": round(float(steering_deg[i]), 1),
        }
        for i in range(len(stamp))
    ]


def _vehicle_monitor(bus: _Recorder) -> list[Message]:
    """2 Hz, some missing; the yaw rate is averaged over 0.2 s, biased, noisy and rounded to 0.1 deg/s."""
    grid = bus.grid_us(500_000)
    stamp = grid[bus.received(len(grid), 0.025)]
    stamp = stamp + np.rint(400 * bus.rng.standard_normal(len(stamp))).astype(np.int64)
    t = bus.seconds(stamp)
    drive, sensors = bus.drive, bus.sensors
    averaged = (drive.at("yaw_rad", t) - drive.at("yaw_rad", t - 0.2)) / 0.2
    noise_degps = 0.05 * bus.white(t) + 0.2 * bus.shaken(t)
    yaw_rate = np.degrees(averaged + sensors.monitor_bias_radps) + noise_degps
    scale = sensors.monitor_speed_scale * sensors.pose_speed_scale  # both come from the same estimate
    speed = 3.6 * (scale * drive.at("speed_mps", t) + 0.004 * bus.shaken(t))
    rpm = _wheel_rpm(bus, t - sensors.wheel_latency_s)
    steering = np.degrees(_steering_rad(bus, t))
    steering_speed = (steering - np.degrees(_steering_rad(bus, t - 0.1))) / 0.1
    forward = drive.at("acceleration_mps2", t)
    return [
        {
            "utime": int(stamp[i]),
            "available_distance": 100,
            "battery_level": 80,
            "brake": round(max(0.0, -8.0 * float(forward[i]))),
            "brake_switch": 2 if forward[i] < -0.2 else 1,
            "gear_position": 7,
            "left_signal": int(steering[i] > 90.0),
            "right_signal": int(steering[i] < -90.0),
            "rear_left_rpm": _number(rpm[i, 2]),
            "rear_right_rpm": _number(rpm[i, 3]),
            "steering": round(float(steering[i]), 1),
            "steering_speed": round(float(steering_speed[i]), 1),
            "throttle": round(max(0.0, 60.0 * float(forward[i]))),
            "vehicle_speed": round(max(0.0, float(speed[i])), 2),
            "yaw_rate": round(float(yaw_rate[i]), 1),
        }
        for i in range(len(stamp))
    ]


def _steeranglefeedback(bus: _Recorder) -> list[Message]:
    """100 Hz, the steering wheel in rad, positive to the left, in steps of 0.1 degree."""
    stamp = bus.grid_us(10_000)
    stamp = stamp[bus.received(len(stamp), 0.01)]
    stamp = np.sort(stamp + np.rint(500 * bus.rng.standard_normal(len(stamp))).astype(np.int64))
    step_rad = np.radians(0.1)
    angle = np.rint(_steering_rad(bus, bus.seconds(stamp)) / step_rad) * step_rad
    return [{"utime": int(utime), "value": _number(value)} for utime, value in zip(stamp, angle, strict=True)]


def _production_gyro(bus: _Recorder) -> list[Message]:
    """50 Hz: a consumer-grade MEMS gyro with turn-on bias, bias random walk, scale error and noise."""
    stamp = bus.grid_us(20_000)
    t = bus.seconds(stamp)
    walk = np.cumsum(np.radians(0.01) * np.sqrt(0.02) * bus.white(t))
    noise = np.radians(0.07) * bus.white(t) + 0.003 * bus.shaken(t)
    bias = bus.sensors.gyro_bias_radps + walk
    yaw_rate = bus.sensors.gyro_scale * bus.drive.at("yaw_rate_radps", t) + bias + noise
    return [{"utime": int(utime), "yaw_rate": _number(value)} for utime, value in zip(stamp, yaw_rate, strict=True)]


def _steering_rad(bus: _Recorder, time_s: FloatArray) -> FloatArray:
    """Angle of the steering wheel: the road wheels point along the curvature of the path (bicycle model)."""
    route = bus.drive.route
    curvature = np.interp(bus.drive.at("s_m", time_s), route.s_m, route.curvature_pm)
    return STEERING_RATIO * np.arctan(WHEELBASE_M * curvature) + bus.sensors.steering_offset_rad


def _number(value: float) -> float:
    """A float without digits nobody measures."""
    return round(float(value), 9)


def _listed(values: FloatArray) -> list[float]:
    return [_number(value) for value in values]
