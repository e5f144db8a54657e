"""Faults that are met when a folder is opened: names, paths, files, tables, values beyond sense."""

from __future__ import annotations

from tests.fault_ways import (
    NO_FILES,
    VERSION,
    Fault,
    each,
    image_row,
    instead,
    later,
    one,
    table,
    text,
)

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
BORDER_FAULTS: dict[str, Fault] = {
    **{
        f"scene-name-{k}": (table("scene", one("name", v)), "cannot be the name of a file")
        for k, v in BAD_NAMES.items()
    },
    **{f"image-path-{k}": (image_row("filename", v), "must stay below the folder") for k, v in BAD_PATHS.items()},
    "scene-name-twice": (
        table("scene", lambda rows: [*rows, rows[0] | {"token": "f" * 32, "name": "SCENE-2061"}]),
        "two scenes are named",
    ),
    "log-escape": (table("log", each("logfile", lambda text: f"{text}\x1b[2J")), "must be printable"),
    "location-line": (table("log", each("location", lambda text: f"{text}\n")), "must be printable"),
    "channel-path": (table("sensor", one("channel", "../CAM")), "is no channel"),
    **{
        f"empty-{k}": (table(k, lambda rows: []), r"no scenes|no cameras|refers to|list no images|no ego pose")
        for k in TABLES
    },
    **{f"twice-{k}": (table(k, lambda rows: [*rows, rows[0]]), r"stand there twice|two scenes") for k in TABLES},
    **{
        f"latin-{k}": (text(f"{VERSION}/{k}.json", lambda b: b.replace(b'"token": "', b'"token": "\xdf', 1)), "UTF-8")
        for k in TABLES
    },
    **{
        f"cut-{k}": (text(f"{VERSION}/{k}.json", lambda b: b[: len(b) // 2]), "not a valid nuScenes file")
        for k in TABLES
    },
    **{
        f"{v}-as-{k}": (instead(make, f"{VERSION}/{k}.json"), r"not a file|cannot be read|is missing|not a nuScenes")
        for k in ("scene", "ego_pose")
        for v, make in NO_FILES.items()
    },
    "nested": (
        text(f"{VERSION}/log.json", lambda b: b'[{"token":"","deep":' + b"[" * 200_000 + b"]" * 200_000 + b"}]"),
        "deeply nested",
    ),
    "object": (text(f"{VERSION}/log.json", lambda b: b"{}"), "expected a JSON array"),
    "text-after": (text(f"{VERSION}/log.json", lambda b: b + b"[]"), "not a valid nuScenes file"),
    "endless-row": (text(f"{VERSION}/log.json", lambda b: b'[{"token":"' + b"x" * 8_000_000), "never ends"),
    "nan-position": (text(f"{VERSION}/ego_pose.json", lambda b: b.replace(b"0.0\n]", b"NaN\n]", 1)), "malformed"),
    "infinite-position": (
        text(f"{VERSION}/ego_pose.json", lambda b: b.replace(b"0.0\n]", b"-Infinity\n]", 1)),
        "malformed",
    ),
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
    "one-camera-years-later": (later(10**12, of="CAM_BACK"), "image-gap"),
    "one-camera-two-seconds-later": (later(2_000, of="CAM_BACK"), "image-gap"),
    "negative-size": (image_row("width", -1), "Expected `int`"),
    "huge-size": (image_row("width", 10**6), "Expected `int`"),
    "no-poses": (table("ego_pose", each("token", lambda t: t[::-1])), "no ego pose"),
    "zero-quaternion": (table("ego_pose", one("rotation", [0, 0, 0, 0], 8)), "quaternion is not unit"),
}
