"""Named faults of nuScenes folders: how each is put into a sound folder, and by which check or words it is found.

The folder is one scene of :func:`tests.nuscenes_fixture.write_nuscenes`, so a fault of that scene stops a recording.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.nuscenes_fixture import grey_jpeg

VERSION, SCENE = "v1.0-mini", "scene-2061"
Change = Callable[[list[dict[str, Any]]], Any]
Fault = tuple[Callable[[Path], None], str]


def table(name: str, change: Change) -> Callable[[Path], None]:
    """Change the rows of a table, in place or by what ``change`` returns."""

    def apply(root: Path) -> None:
        path = root / VERSION / f"{name}.json"
        rows = json.loads(path.read_text())
        changed = change(rows)
        path.write_text(json.dumps(changed if isinstance(changed, list) else rows))

    return apply


def each(key: str, value: Callable[[Any], Any]) -> Change:
    """One field of every row becomes a function of itself."""

    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row[key] = value(row[key])

    return change


def one(key: str, value: Any, row: int = 0) -> Change:
    """One field of one row; a function is applied to the field."""

    def change(rows: list[dict[str, Any]]) -> None:
        rows[row][key] = value(rows[row][key]) if callable(value) else value

    return change


def cameras(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Rows of ``sample_data`` that are images, in order of time."""
    return sorted((row for row in rows if "/CAM_" in row["filename"]), key=lambda row: row["timestamp"])


def image_row(key: str, value: Any, position: int = 1) -> Callable[[Path], None]:
    """One field of one image row; the second of a scene is CAM_FRONT's."""
    return table("sample_data", lambda rows: one(key, value, position)(cameras(rows)))


def can(message: str, change: Change) -> Callable[[Path], None]:
    """Change the rows of a CAN bus message."""

    def apply(root: Path) -> None:
        path = root / "can_bus" / f"{SCENE}_{message}.json"
        rows = json.loads(path.read_text())
        changed = change(rows)
        path.write_text(json.dumps(changed if isinstance(changed, list) else rows))

    return apply


def text(name: str, change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    """Change the bytes of a file, by its path below the root."""

    def apply(root: Path) -> None:
        path = root / name
        path.write_bytes(change(path.read_bytes()))

    return apply


def image(content: bytes | Callable[[bytes], bytes], count: int = 1) -> Callable[[Path], None]:
    """Other bytes in the first images of CAM_FRONT."""

    def apply(root: Path) -> None:
        for path in _images(root)[:count]:
            new = content(path.read_bytes()) if callable(content) else content
            path.unlink()
            path.write_bytes(new)

    return apply


def instead(make: Callable[[Path], Any], name: str | None = None) -> Callable[[Path], None]:
    """Something that is no file in place of an image, or of the file ``name``."""

    def apply(root: Path) -> None:
        path = root / name if name else _images(root)[0]
        path.unlink()
        make(path)

    return apply


def _images(root: Path) -> list[Path]:
    return sorted((root / "samples" / "CAM_FRONT").iterdir())


def _bomb(jpeg: bytes) -> bytes:
    at = max(jpeg.find(b"\xff\xc0"), jpeg.find(b"\xff\xc2"))
    return jpeg[: at + 5] + (65_500).to_bytes(2, "big") * 2 + jpeg[at + 9 :]


def _xyzw(q: list[float]) -> list[float]:
    return [*q[1:], q[0]]


def _conjugate(q: list[float]) -> list[float]:
    return [q[0], *(-v for v in q[1:])]


def _yaw_rates(factor: float = 1.0, offset: float = 0.0) -> Change:
    return each("rotation_rate", lambda rate: [rate[0], rate[1], factor * rate[2] + offset])


def _shift(ms: int) -> Change:
    return each("utime", lambda time: time + 1000 * ms)


def _wheels(value: Callable[[float], float], *names: str) -> Change:
    keys = names or ("FL_wheel_speed", "FR_wheel_speed", "RL_wheel_speed", "RR_wheel_speed")

    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row.update({key: value(row[key]) for key in keys})

    return change


def _swap_times(rows: list[dict[str, Any]], key: str, i: int, j: int) -> None:
    rows[i][key], rows[j][key] = rows[j][key], rows[i][key]


def _later(ms: int, *, of: str) -> Callable[[Path], None]:
    """All images of one camera are stamped later, in the tables alone."""
    return table(
        "sample_data",
        lambda rows: [
            row | {"timestamp": row["timestamp"] + 1000 * ms} if f"/{of}/" in row["filename"] else row for row in rows
        ],
    )


def _all(*applied: Callable[[Path], None]) -> Callable[[Path], None]:
    def apply(root: Path) -> None:
        for one_of_them in applied:
            one_of_them(root)

    return apply


BAD_NAMES = {
    "parent": "../../../pwned",
    "absolute": "/tmp/pwned",
    "separator": "a/b",
    "backslash": "..\\pwned",
    "dots": "..",
    "dot": ".",
    "hidden": ".scene",
    "nul": "scene\0",
    "escape": "\x1b[31mRED\x1b]0;owned\x07",
    "line": "scene-1\nscene-2",
    "markup": "[red]scene[/red]",
    "direction": "scene\u202etxt",
    "device": "NUL",
    "empty": "",
    "blank": " ",
    "long": "x" * 300,
    "option": "--out",
    "timings": "scene-2061.timings",
    "drive": "C:scene",
    "formula": "=1+1",
}
BAD_PATHS = {
    "absolute": "/etc/passwd",
    "parent": "../secret.jpg",
    "deep-parent": "samples/../../secret.jpg",
    "dot": "samples/./a.jpg",
    "empty": "",
    "double-slash": "samples//a.jpg",
    "backslash": "samples\\..\\..\\a.jpg",
    "drive": "C:/a.jpg",
    "nul": "samples/a\0.jpg",
    "escape": "samples/\x1b[2J.jpg",
    "tab": "samples/a\t.jpg",
    "line": "samples/a\n.jpg",
    "long-part": f"samples/{'x' * 300}.jpg",
    "long": "/".join(["x" * 100] * 20),
    "stream": "http://example.org/a.jpg",
    "device": "samples/CON",
}
TABLES = ("scene", "log", "sample", "sensor", "calibrated_sensor", "sample_data", "ego_pose")
NO_FILES: dict[str, Callable[[Path], Any]] = {
    "folder": Path.mkdir,
    "pipe": os.mkfifo,
    "device": lambda path: path.symlink_to("/dev/zero"),
    "loop": lambda path: path.symlink_to(path),
}

FAULTS: dict[str, Fault] = {
    **{f"scene-name-{k}": (table("scene", one("name", v)), "cannot be the name of a file") for k, v in BAD_NAMES.items()},
    **{f"image-path-{k}": (image_row("filename", v), "must stay below the folder") for k, v in BAD_PATHS.items()},
    "scene-name-twice": (
        table("scene", lambda rows: [*rows, rows[0] | {"token": "f" * 32, "name": "SCENE-2061"}]),
        "two scenes are named",
    ),
    "log-escape": (table("log", each("logfile", lambda text: f"{text}\x1b[2J")), "must be printable"),
    "location-line": (table("log", each("location", lambda text: f"{text}\n")), "must be printable"),
    "channel-path": (table("sensor", one("channel", "../CAM")), "is no channel"),
    **{f"empty-{k}": (table(k, lambda rows: []), r"no scenes|no cameras|refers to|list no images|no ego pose") for k in TABLES},
    **{f"twice-{k}": (table(k, lambda rows: [*rows, rows[0]]), r"stand there twice|two scenes") for k in TABLES},
    **{f"latin-{k}": (text(f"{VERSION}/{k}.json", lambda b: b.replace(b'"token": "', b'"token": "\xdf', 1)), "UTF-8") for k in TABLES},
    **{f"cut-{k}": (text(f"{VERSION}/{k}.json", lambda b: b[: len(b) // 2]), "not a valid nuScenes file") for k in TABLES},
    **{f"{v}-as-{k}": (instead(make, f"{VERSION}/{k}.json"), r"not a file|cannot be read|is missing|not a nuScenes") for k in ("scene", "ego_pose") for v, make in NO_FILES.items()},
    "nested": (text(f"{VERSION}/log.json", lambda b: b'[{"token":"","deep":' + b"[" * 200_000 + b"]" * 200_000 + b"}]"), "deeply nested"),
    "object": (text(f"{VERSION}/log.json", lambda b: b"{}"), "expected a JSON array"),
    "text-after": (text(f"{VERSION}/log.json", lambda b: b + b"[]"), "not a valid nuScenes file"),
    "endless-row": (text(f"{VERSION}/log.json", lambda b: b'[{"token":"' + b"x" * 8_000_000), "never ends"),
    "nan-position": (text(f"{VERSION}/ego_pose.json", lambda b: b.replace(b"0.0\n]", b"NaN\n]", 1)), "malformed"),
    "infinite-position": (text(f"{VERSION}/ego_pose.json", lambda b: b.replace(b"0.0\n]", b"-Infinity\n]", 1)), "malformed"),
    "huge-position": (table("ego_pose", one("translation", [1e308, 0, 0])), "Expected `float`"),
    "far-position": (table("ego_pose", one("translation", [0, -1e12, 0])), "Expected `float`"),
    "huge-quaternion": (table("ego_pose", one("rotation", [1e200, 0, 0, 0])), "Expected `float`"),
    "zero-time": (image_row("timestamp", 0), "Expected `int`"),
    "negative-time": (image_row("timestamp", -(10**15)), "Expected `int`"),
    "overflowing-time": (image_row("timestamp", 10**19), "Expected `int`"),
    "seconds-as-time": (table("sample_data", each("timestamp", lambda t: t // 10**6)), "Expected `int`"),
    "nanoseconds-as-time": (table("sample_data", each("timestamp", lambda t: t * 1000)), "Expected `int`"),
    "text-as-time": (image_row("timestamp", "now"), "Expected `int`"),
    "one-image-years-later": (image_row("timestamp", 4 * 10**15), "span"),
    "one-camera-years-later": (_later(10**12, of="CAM_BACK"), "image-gap"),
    "one-camera-two-seconds-later": (_later(2_000, of="CAM_BACK"), "image-gap"),
    "negative-size": (image_row("width", -1), "Expected `int`"),
    "huge-size": (image_row("width", 10**6), "Expected `int`"),
    "no-poses": (table("ego_pose", each("token", lambda t: t[::-1])), "no ego pose"),
    "zero-quaternion": (table("ego_pose", one("rotation", [0, 0, 0, 0], 8)), "quaternion is not unit"),
    # poses
    "poses-xyzw": (table("ego_pose", each("rotation", _xyzw)), "pose-tilt"),
    "one-pose-xyzw": (table("ego_pose", one("rotation", _xyzw, 20)), "pose-tilt"),
    "poses-conjugate": (table("ego_pose", each("rotation", _conjugate)), "pose-heading|wrong-axis"),
    "poses-turned-around": (table("ego_pose", each("rotation", lambda q: [-q[3], 0, 0, q[0]])), "pose-heading"),
    "poses-90-degrees": (
        table("ego_pose", each("rotation", lambda q: [math.sqrt(0.5) * (q[0] - q[3]), 0, 0, math.sqrt(0.5) * (q[0] + q[3])])),
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
    "poses-exchanged": (table("ego_pose", lambda rows: [_swap_times(rows, "token", 3, 20), rows][1]), "pose-time"),
    "times-exchanged": (table("sample_data", lambda rows: _swap_times(cameras(rows), "timestamp", 7, 97)), "image-time|pose-time"),
    "names-exchanged": (table("sample_data", lambda rows: _swap_times(cameras(rows), "filename", 6, 96)), "image-time"),
    # images and cameras
    "image-missing": (lambda root: _images(root)[0].unlink(), "images are missing"),
    "image-empty": (image(b""), "images are empty"),
    "image-text": (image(b"hello, no image " * 99), "no JPEG"),
    "image-png": (image(b"\x89PNG\r\n\x1a\n" + bytes(2000)), "no JPEG"),
    "image-cut": (image(lambda jpeg: jpeg[:-200]), "cut short"),
    "image-header-only": (image(lambda jpeg: jpeg[:12]), "no JPEG"),
    "image-one-pixel": (image(grey_jpeg(1, 1)), "1 x 1"),
    "image-half-size": (image(grey_jpeg(800, 450)), "800 x 450"),
    "image-on-its-side": (image(grey_jpeg(900, 1600)), "900 x 1600"),
    "image-bomb": (image(_bomb), "65500 x 65500"),
    "all-images-smaller": (image(grey_jpeg(800, 450), 99), "images are 800 x 450"),
    **{f"{k}-as-image": (instead(make), "unreadable or no files") for k, make in NO_FILES.items()},
    "image-twice": (table("sample_data", lambda rows: one("filename", cameras(rows)[6]["filename"], 12)(cameras(rows))), "image-time"),
    "camera-silent": (
        table("sample_data", lambda rows: [r for r in rows if "CAM_BACK__" not in r["filename"] or r["timestamp"] % 10**8 < 28_000_000 or r["timestamp"] % 10**8 > 29_500_000]),
        "image-gap",
    ),
    "camera-absent": (table("sample_data", lambda rows: [r for r in rows if "CAM_BACK__" not in r["filename"]]), "list no images|"),
    "key-frames-missing": (table("sample_data", each("is_key_frame", lambda v: False)), "key-frames"),
    "mounting-xyzw": (table("calibrated_sensor", each("rotation", _xyzw)), "calibration"),
    "mounting-conjugate": (table("calibrated_sensor", each("rotation", _conjugate)), "calibration"),
    "mounting-identity": (table("calibrated_sensor", each("rotation", lambda q: [1, 0, 0, 0])), "calibration"),
    "mounting-in-millimetres": (table("calibrated_sensor", each("translation", lambda t: [100 * v for v in t])), "calibration"),
    "mountings-exchanged": (table("calibrated_sensor", lambda rows: _swap_times(rows, "rotation", 0, 3)), "calibration"),
    "intrinsic-transposed": (table("calibrated_sensor", each("camera_intrinsic", lambda k: [list(c) for c in zip(*k, strict=True)])), "calibration"),
    "intrinsic-zero": (table("calibrated_sensor", each("camera_intrinsic", lambda k: [[0.0] * 3] * 3)), "camera_intrinsic"),
    "intrinsic-empty": (table("calibrated_sensor", each("camera_intrinsic", lambda k: [])), "camera_intrinsic"),
    "intrinsic-of-half-size": (table("calibrated_sensor", each("camera_intrinsic", lambda k: [[v / 100 for v in row] for row in k[:2]] + k[2:])), "calibration"),
    # CAN bus
    "can-missing": (lambda root: [p.unlink() for p in (root / "can_bus").glob(f"{SCENE}_*")] and None, "can-bus|no CAN"),
    **{f"no-{k}": (can(k, lambda rows: []), f"no {k} messages") for k in ("ms_imu", "zoe_veh_info")},
    "can-text": (text(f"can_bus/{SCENE}_pose.json", lambda b: b"hello"), "not a valid CAN bus file"),
    "can-latin": (text(f"can_bus/{SCENE}_pose.json", lambda b: b.replace(b"utime", b"utim\xdf", 1)), "not a valid CAN bus file"),
    "can-nested": (text(f"can_bus/{SCENE}_pose.json", lambda b: b'[{"a":' + b"[" * 100_000), "deeply nested"),
    "can-nan": (text(f"can_bus/{SCENE}_ms_imu.json", lambda b: b.replace(b"[0.0,", b"[NaN,", 1)), "not a valid CAN bus file"),
    **{f"{k}-as-can": (instead(make, f"can_bus/{SCENE}_ms_imu.json"), "can-file") for k, make in NO_FILES.items()},
    "huge-rate": (can("ms_imu", one("rotation_rate", [0, 0, 1e308], 50)), "can-file"),
    "can-zero-time": (can("ms_imu", one("utime", 0)), "can-file"),
    "can-overflowing-time": (can("zoe_veh_info", one("utime", 10**19, 9)), "can-file"),
    "can-one-time-years-later": (can("zoe_veh_info", one("utime", 4 * 10**15, 9)), "can-file"),
    "can-of-another-day": (can("ms_imu", _shift(86_400_000)), "can-coverage"),
    "can-times-exchanged": (can("ms_imu", lambda rows: _swap_times(rows, "utime", 30, 250)), "can-order"),
    "can-reversed": (can("ms_imu", lambda rows: rows[::-1]), "can-order"),
    "gyro-silent": (can("ms_imu", lambda rows: rows[:60] + rows[260:]), "is silent for 2.01 s"),
    "wheels-silent": (can("zoe_veh_info", lambda rows: rows[:100] + rows[200:]), "is silent for 1.01 s"),
    "gyro-ends-early": (can("ms_imu", lambda rows: rows[:-60]), "before the last image"),
    "gyro-begins-late": (can("ms_imu", lambda rows: rows[30:]), "after the first image"),
    "gyro-sign": (can("ms_imu", _yaw_rates(-1.0)), "wrong-axis"),
    "gyro-axis": (can("ms_imu", each("rotation_rate", lambda r: [r[2], r[0], r[1]])), "wrong-axis"),
    "gyro-in-degrees": (can("ms_imu", _yaw_rates(57.3)), "gyro-size"),
    "gyro-doubled": (can("ms_imu", _yaw_rates(2.0)), "gyro-size"),
    "gyro-biased": (can("ms_imu", _yaw_rates(1.0, 0.5)), "gyro-size"),
    "gyro-zero": (can("ms_imu", _yaw_rates(0.0)), "wrong-axis"),
    "gyro-spike": (can("ms_imu", one("rotation_rate", [0, 0, 40.0], 90)), "gyro-size|wrong-axis"),
    "pose-gyro-sign": (can("pose", _yaw_rates(-1.0)), "wrong-axis"),
    "monitor-in-radians": (can("vehicle_monitor", each("yaw_rate", math.radians)), "gyro-size"),
    "monitor-sign": (can("vehicle_monitor", each("yaw_rate", lambda v: -v)), "gyro-size"),
    **{f"gyro-{ms}-ms": (can("ms_imu", _shift(ms)), "clock-offset|can-coverage") for ms in (-400, -200, -100, 100, 200, 400)},
    "wheel-sentinel": (can("zoe_veh_info", one("RL_wheel_speed", 65535, 70)), "wheel-range"),
    "wheel-sentinels": (can("zoe_veh_info", _wheels(lambda v: 65535.0)), "wheel-range"),
    "wheels-negative": (can("zoe_veh_info", _wheels(lambda v: -32768.0)), "wheel-range"),
    "wheels-in-kmh": (can("zoe_veh_info", _wheels(lambda v: 28.8)), "wheel-unit"),
    "wheels-in-mps": (can("zoe_veh_info", _wheels(lambda v: 8.0)), "wheel-unit"),
    "wheels-in-radps": (can("zoe_veh_info", _wheels(lambda v: v * math.pi / 30)), "wheel-unit"),
    "wheels-in-degps": (can("zoe_veh_info", _wheels(lambda v: v * 6)), "wheel-unit"),
    "one-wheel-dead": (can("zoe_veh_info", _wheels(lambda v: 0.0, "RL_wheel_speed")), "wheel-unit"),
    "wheels-dead": (can("zoe_veh_info", _wheels(lambda v: 0.0)), "wheel-unit"),
    "monitor-speed-in-mps": (can("vehicle_monitor", each("vehicle_speed", lambda v: v / 3.6)), "wheel-unit"),
    "pose-speed-in-kmh": (can("pose", each("vel", lambda v: [3.6 * v[0], 0, 0])), "wheel-unit"),
}  # fmt: skip
