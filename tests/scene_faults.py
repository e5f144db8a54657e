"""Faults of one scene that its checks find: poses, images, calibration, CAN bus."""

from __future__ import annotations

import math

from tests.fault_ways import (
    NO_FILES,
    SCENE,
    Fault,
    bomb,
    cameras,
    can,
    conjugate,
    each,
    image,
    instead,
    one,
    shifted,
    swap,
    table,
    text,
    wheels,
    xyzw,
    yaw_rates,
)
from tests.nuscenes_fixture import grey_jpeg

SCENE_FAULTS: dict[str, Fault] = {
    # poses
    "poses-xyzw": (table("ego_pose", each("rotation", xyzw)), "pose-tilt"),
    "one-pose-xyzw": (table("ego_pose", one("rotation", xyzw, 20)), "pose-tilt"),
    "poses-conjugate": (table("ego_pose", each("rotation", conjugate)), "pose-heading|wrong-axis"),
    "poses-turned-around": (table("ego_pose", each("rotation", lambda q: [-q[3], 0, 0, q[0]])), "pose-heading"),
    "poses-90-degrees": (
        table(
            "ego_pose",
            each("rotation", lambda q: [math.sqrt(0.5) * (q[0] - q[3]), 0, 0, math.sqrt(0.5) * (q[0] + q[3])]),
        ),
        "pose-heading",
    ),
    "poses-identity": (table("ego_pose", each("rotation", lambda q: [1, 0, 0, 0])), "wrong-axis|pose-heading"),
    "poses-rolled": (table("ego_pose", each("rotation", lambda q: [0, q[0], q[3], 0])), "pose-tilt"),
    "x-and-y-exchanged": (table("ego_pose", each("translation", lambda t: [t[1], t[0], 0])), "pose-heading"),
    "poses-in-millimetres": (table("ego_pose", each("translation", lambda t: [1000 * v for v in t])), "pose-jump"),
    "poses-in-feet": (table("ego_pose", each("translation", lambda t: [3.28 * v for v in t])), "wheel-unit"),
    "poses-frozen": (table("ego_pose", each("translation", lambda t: [600.0, 1647.0, 0])), "wheel-unit"),
    "pose-jump": (table("ego_pose", one("translation", lambda t: [t[0] + 30, t[1], 0], 9)), "pose-jump"),
    "small-pose-jump": (table("ego_pose", one("translation", lambda t: [t[0], t[1] + 2, 0], 9)), "pose-jump"),
    "pose-turns-once": (table("ego_pose", one("rotation", [0, 0, 0, 1], 9)), "pose-jump"),
    "poses-late": (table("ego_pose", each("timestamp", lambda t: t + 100_000)), "pose-time"),
    "one-pose-late": (table("ego_pose", one("timestamp", lambda t: t + 500_000, 4)), "pose-time"),
    "poses-exchanged": (table("ego_pose", lambda rows: [swap(rows, "token", 3, 20), rows][1]), "pose-time"),
    "times-exchanged": (
        table("sample_data", lambda rows: swap(cameras(rows), "timestamp", 7, 97)),
        "image-time|pose-time",
    ),
    "names-exchanged": (table("sample_data", lambda rows: swap(cameras(rows), "filename", 6, 96)), "image-time"),
    # images and cameras
    "images-missing": (instead(lambda path: None), "3 of 43 images are missing"),
    "images-empty": (image(b""), "images are empty"),
    "images-text": (image(b"hello, no image " * 99), "no JPEG"),
    "images-png": (image(b"\x89PNG\r\n\x1a\n" + bytes(2000)), "no JPEG"),
    "images-cut": (image(lambda jpeg: jpeg[:-200]), "cut short"),
    "images-header-only": (image(lambda jpeg: jpeg[:12]), "no JPEG"),
    "images-one-pixel": (image(grey_jpeg(1, 1)), "1 x 1"),
    "images-half-size": (image(grey_jpeg(800, 450)), "800 x 450"),
    "images-on-its-side": (image(grey_jpeg(900, 1600)), "900 x 1600"),
    "images-bomb": (image(bomb), "65500 x 65500"),
    "all-images-smaller": (image(grey_jpeg(800, 450), 99), "images are 800 x 450"),
    **{f"{k}-as-images": (instead(make), "unreadable or no files") for k, make in NO_FILES.items()},
    "image-twice": (
        table("sample_data", lambda rows: one("filename", cameras(rows)[6]["filename"], 12)(cameras(rows))),
        "image-time",
    ),
    "camera-silent": (
        table(
            "sample_data",
            lambda rows: [
                r
                for r in rows
                if "CAM_BACK__" not in r["filename"]
                or r["timestamp"] % 10**8 < 28_000_000
                or r["timestamp"] % 10**8 > 29_500_000
            ],
        ),
        "image-gap",
    ),
    "camera-absent": (
        table("sample_data", lambda rows: [r for r in rows if "CAM_BACK__" not in r["filename"]]),
        "list no images|",
    ),
    "key-frames-missing": (table("sample_data", each("is_key_frame", lambda v: False)), "key-frames"),
    "mounting-xyzw": (table("calibrated_sensor", each("rotation", xyzw)), "calibration"),
    "mounting-conjugate": (table("calibrated_sensor", each("rotation", conjugate)), "calibration"),
    "mounting-identity": (table("calibrated_sensor", each("rotation", lambda q: [1, 0, 0, 0])), "calibration"),
    "mounting-in-millimetres": (
        table("calibrated_sensor", each("translation", lambda t: [100 * v for v in t])),
        "calibration",
    ),
    "mountings-exchanged": (table("calibrated_sensor", lambda rows: swap(rows, "rotation", 0, 3)), "calibration"),
    "intrinsic-transposed": (
        table("calibrated_sensor", each("camera_intrinsic", lambda k: [list(c) for c in zip(*k, strict=True)])),
        "calibration",
    ),
    "intrinsic-zero": (
        table("calibrated_sensor", each("camera_intrinsic", lambda k: [[0.0] * 3] * 3)),
        "camera_intrinsic",
    ),
    "intrinsic-ragged": (
        table("calibrated_sensor", each("camera_intrinsic", lambda k: k and [k[0], k[1][:2], k[2]])),
        "camera_intrinsic",
    ),
    "intrinsic-empty": (table("calibrated_sensor", each("camera_intrinsic", lambda k: [])), "camera_intrinsic"),
    "intrinsic-of-half-size": (
        table(
            "calibrated_sensor", each("camera_intrinsic", lambda k: [[v / 100 for v in row] for row in k[:2]] + k[2:])
        ),
        "calibration",
    ),
    # CAN bus
    "can-missing": (
        lambda root: [p.unlink() for p in (root / "can_bus").glob(f"{SCENE}_*")] and None,
        "can-bus|no CAN",
    ),
    **{f"no-{k}": (can(k, lambda rows: []), f"no {k} messages") for k in ("ms_imu", "zoe_veh_info")},
    "can-text": (text(f"can_bus/{SCENE}_pose.json", lambda b: b"hello"), "not a valid CAN bus file"),
    "can-latin": (
        text(f"can_bus/{SCENE}_pose.json", lambda b: b.replace(b"utime", b"utim\xdf", 1)),
        "not a valid CAN bus file",
    ),
    "can-nested": (text(f"can_bus/{SCENE}_pose.json", lambda b: b'[{"a":' + b"[" * 100_000), "deeply nested"),
    "can-nan": (
        text(f"can_bus/{SCENE}_ms_imu.json", lambda b: b.replace(b"[0.0,", b"[NaN,", 1)),
        "not a valid CAN bus file",
    ),
    **{f"{k}-as-can": (instead(make, f"can_bus/{SCENE}_ms_imu.json"), "can-file") for k, make in NO_FILES.items()},
    "huge-rate": (can("ms_imu", one("rotation_rate", [0, 0, 1e308], 50)), "can-file"),
    "can-zero-time": (can("ms_imu", one("utime", 0)), "can-file"),
    "can-overflowing-time": (can("zoe_veh_info", one("utime", 10**19, 9)), "can-file"),
    "can-one-time-years-later": (can("zoe_veh_info", one("utime", 4 * 10**15, 9)), "can-file"),
    "can-of-another-day": (can("ms_imu", shifted(86_400_000)), "can-coverage"),
    "can-times-exchanged": (can("ms_imu", lambda rows: swap(rows, "utime", 30, 250)), "can-order"),
    "can-reversed": (can("ms_imu", lambda rows: rows[::-1]), "can-order"),
    "gyro-silent": (can("ms_imu", lambda rows: rows[:60] + rows[260:]), "is silent for 2.01 s"),
    "wheels-silent": (can("zoe_veh_info", lambda rows: rows[:100] + rows[200:]), "is silent for 1.01 s"),
    "gyro-ends-early": (can("ms_imu", lambda rows: rows[:-60]), "before the last image"),
    "gyro-begins-late": (can("ms_imu", lambda rows: rows[30:]), "after the first image"),
    "gyro-sign": (can("ms_imu", yaw_rates(-1.0)), "wrong-axis"),
    "gyro-axis": (can("ms_imu", each("rotation_rate", lambda r: [r[2], r[0], r[1]])), "wrong-axis"),
    "gyro-in-degrees": (can("ms_imu", yaw_rates(57.3)), "gyro-size"),
    "gyro-doubled": (can("ms_imu", yaw_rates(2.0)), "gyro-size"),
    "gyro-biased": (can("ms_imu", yaw_rates(1.0, 0.5)), "gyro-size"),
    "gyro-zero": (can("ms_imu", yaw_rates(0.0)), "wrong-axis"),
    "gyro-spike": (can("ms_imu", one("rotation_rate", [0, 0, 40.0], 90)), "gyro-size|wrong-axis"),
    "pose-gyro-sign": (can("pose", yaw_rates(-1.0)), "wrong-axis"),
    "monitor-in-radians": (can("vehicle_monitor", each("yaw_rate", math.radians)), "gyro-size"),
    "monitor-sign": (can("vehicle_monitor", each("yaw_rate", lambda v: -v)), "gyro-size"),
    **{
        f"gyro-{ms}-ms": (can("ms_imu", shifted(ms)), "clock-offset|can-coverage")
        for ms in (-400, -200, -100, 100, 200, 400)
    },
    "wheel-sentinel": (can("zoe_veh_info", one("RL_wheel_speed", 65535, 70)), "wheel-range"),
    "wheel-sentinels": (can("zoe_veh_info", wheels(lambda v: 65535.0)), "wheel-range"),
    "wheels-negative": (can("zoe_veh_info", wheels(lambda v: -32768.0)), "wheel-range"),
    "wheels-in-kmh": (can("zoe_veh_info", wheels(lambda v: 28.8)), "wheel-unit"),
    "wheels-in-mps": (can("zoe_veh_info", wheels(lambda v: 8.0)), "wheel-unit"),
    "wheels-in-radps": (can("zoe_veh_info", wheels(lambda v: v * math.pi / 30)), "wheel-unit"),
    "wheels-in-degps": (can("zoe_veh_info", wheels(lambda v: v * 6)), "wheel-unit"),
    "one-wheel-dead": (can("zoe_veh_info", wheels(lambda v: 0.0, "RL_wheel_speed")), "wheel-unit"),
    "wheels-dead": (can("zoe_veh_info", wheels(lambda v: 0.0)), "wheel-unit"),
    "monitor-speed-in-mps": (can("vehicle_monitor", each("vehicle_speed", lambda v: v / 3.6)), "wheel-unit"),
    "pose-speed-in-kmh": (can("pose", each("vel", lambda v: [3.6 * v[0], 0, 0])), "wheel-unit"),
}
