"""What a recording was made of and by: everything that can change its values, as text and as short hashes."""

from __future__ import annotations

import hashlib
import json
import platform
from collections.abc import Iterator
from dataclasses import asdict, fields
from importlib.metadata import version
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np

from mixo_env.nuscenes.scene import Scene, Signal

SOFTWARE = ("mixo-env", "numpy", "numba", "llvmlite", "filterpy", "simplejpeg", "pyarrow")
"""Packages whose version can change a recorded value."""

_CODE = ("geometry.py", "compiled.py", "experts", "nuscenes", "recordings")
_SUFFIXES = (".py", ".npy", ".npz", ".json")


def software_versions() -> dict[str, str]:
    """Versions of Python, OpenCV (whatever package it came in) and the packages of ``SOFTWARE``."""
    import cv2

    versions = {"python": platform.python_version(), "cv2": cv2.__version__}
    return versions | {package: version(package) for package in SOFTWARE}


def code_hash() -> str:
    """Hash of the project's own code between images and rows, data files included."""
    root = files("mixo_env")
    digest = hashlib.blake2b(digest_size=8)
    for part in _CODE:
        for name, content in _walk(root / part, part):
            digest.update(f"{name}:{len(content)};".encode() + content)
    return digest.hexdigest()


def file_hash(path: Path) -> str:
    """Hash of the bytes of a file."""
    return hashlib.blake2b(path.read_bytes(), digest_size=8).hexdigest()


def _walk(entry: Traversable, name: str) -> Iterator[tuple[str, bytes]]:
    """Sources and their data files below ``entry`` in order of name, without the bundled recordings."""
    if entry.is_dir():
        for child in sorted(entry.iterdir(), key=lambda child: child.name):
            if name != "recordings/data":
                yield from _walk(child, f"{name}/{child.name}")
    elif name.endswith(_SUFFIXES):
        yield name, entry.read_bytes()


def configuration_hash(configuration: dict[str, Any]) -> str:
    """Hash of a configuration of plain JSON values, with the software that runs it."""
    text = json.dumps(configuration | {"software": software_versions(), "code": code_hash()}, sort_keys=True)
    return hashlib.blake2b(text.encode(), digest_size=8).hexdigest()


def _size(path: Path) -> int:
    """Bytes of an image; -1 if it is missing, which is a matter of one step."""
    try:
        return path.stat().st_size
    except OSError:
        return -1


def inputs_hash(scene: Scene) -> str:
    """Hash of what the experts of a scene are given: times, poses, calibration, CAN bus, and the sizes of the images.

    It notices a folder that was simulated or unpacked anew; the bytes of the images themselves are not read.
    """
    digest = hashlib.blake2b(digest_size=8)

    def add(name: str, value: object) -> None:
        content = np.ascontiguousarray(value).tobytes() if isinstance(value, np.ndarray) else repr(value).encode()
        digest.update(f"{name}:{len(content)};".encode() + content)

    add("description", (scene.name, scene.log, scene.vehicle, scene.location, scene.conditions))
    for camera, reel in scene.cameras.items():
        add("camera", camera)
        for name, value in asdict(reel.calibration).items():
            add(name, value)
        for name in ("timestamp_us", "is_keyframe", "x_m", "y_m", "yaw_rad"):
            add(name, getattr(reel, name))
        add("images", [_size(path) for path in reel.image_paths])
    for part in (scene.can_bus, scene.exact):
        for field in fields(part) if part is not None else ():
            value = getattr(part, field.name)
            for array in (value.timestamp_us, value.value) if isinstance(value, Signal) else (value,):
                add(field.name, array)
    return digest.hexdigest()
