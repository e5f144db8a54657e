"""Columns that follow from others: the file leaves them out, and whoever opens it computes them.

A column is left out only where computing it gives what was recorded, to the last bit; so a file says nothing else than
a file with all columns, and such a file can be read as well.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.recordings.carry import carry, own_windows
from mixo_env.recordings.schema import Manifest
from mixo_env.recordings.truth import signed_chords

Columns = Mapping[str, NDArray[Any]]


def completed(stored: Columns, manifest: Manifest) -> dict[str, NDArray[Any]]:
    """All columns, those that the file left out among them.

    Args:
        stored: of whole scenes, one after another.
        manifest: says which experts they are of.
    """
    columns = dict(stored)
    with np.errstate(all="ignore"):  # nothing is known of the values yet: their hash is checked when they are whole
        for name, values in _derive(columns, manifest):
            columns.setdefault(name, values)
    return columns


def stored(columns: Columns, manifest: Manifest) -> dict[str, NDArray[Any]]:
    """The columns that a file has to hold, in their order."""
    kept = dict(columns)
    for name, values in _derive(columns, manifest):
        recorded = columns[name]
        if recorded.dtype == values.dtype and canonical(recorded).tobytes() == canonical(values).tobytes():
            del kept[name]
    return kept


def scene_rows(columns: Columns) -> list[int]:
    """Rows of each scene, which begins where ``step`` is 0."""
    return np.diff(np.append(np.flatnonzero(columns["step"] == 0), len(columns["step"]))).tolist()


def derivable(manifest: Manifest) -> frozenset[str]:
    """Names of the columns that a file may leave out."""
    camera_of = _camera_of(manifest)
    carried = {f"{expert}.{name}" for expert in camera_of for name in ("yaw_increment_rad", "yaw_std_rad")}
    windows = {f"{camera}.own_window_s" for camera in manifest.cameras}
    return frozenset({"time_s", "dt_s", "truth.distance_m"} | windows | carried)


def canonical(values: NDArray[Any]) -> NDArray[Any]:
    """One bit pattern for NaN: its sign bit depends on the machine."""
    return np.where(np.isnan(values), values.dtype.type(np.nan), values) if values.dtype.kind == "f" else values


def _camera_of(manifest: Manifest) -> dict[str, str]:
    """Expert -> the camera whose images it saw."""
    return {camera: camera for camera in manifest.cameras} | {
        name: camera for name, camera in manifest.variants.items() if camera in manifest.cameras
    }


def _derive(columns: Columns, manifest: Manifest) -> Iterator[tuple[str, NDArray[Any]]]:
    """Every derivable column, from ``columns`` as they are when it is asked for."""
    counts, first = scene_rows(columns), np.flatnonzero(columns["step"] == 0)
    time_us = columns["timestamp_us"]
    yield "time_s", 1e-6 * (time_us - np.repeat(time_us[first], counts))
    since = 1e-6 * np.diff(time_us, prepend=time_us[:1])
    since[first] = 0.0
    yield "dt_s", since
    chords = signed_chords(columns["truth.x_m"], columns["truth.y_m"], columns["truth.yaw_rad"])
    yield "truth.distance_m", _from_second(chords, first)
    scene = np.repeat(np.arange(len(counts)), counts)
    for camera in manifest.cameras:
        yield f"{camera}.own_window_s", _own_windows_s(columns[f"{camera}.image_time_offset_s"], time_us, scene)
    for expert, camera in _camera_of(manifest).items():
        increment, std = carry(own_windows(columns, expert, camera))
        for name, values in (("yaw_increment_rad", increment), ("yaw_std_rad", std)):
            values[first] = np.nan
            yield f"{expert}.{name}", values.astype(np.float32)


def _from_second(values: NDArray[np.float64], first: NDArray[np.int64]) -> NDArray[np.float64]:
    """Values between neighbouring rows at the later one; NaN where a scene begins."""
    result = np.concatenate([[np.nan], values])
    result[first] = np.nan
    return result


def _own_windows_s(
    offset_s: NDArray[np.float32], time_us: NDArray[np.int64], scene: NDArray[np.int64]
) -> NDArray[np.float32]:
    """Time since the camera's previous image in the scene; NaN without one."""
    fired = np.flatnonzero(np.isfinite(offset_s))
    taken_us = time_us[fired] + np.rint(1e6 * offset_s[fired].astype(np.float64)).astype(np.int64)
    window = np.full(len(offset_s), np.nan, np.float32)
    later = np.flatnonzero(scene[fired[1:]] == scene[fired[:-1]])
    window[fired[later + 1]] = 1e-6 * (taken_us[later + 1] - taken_us[later])
    return window
