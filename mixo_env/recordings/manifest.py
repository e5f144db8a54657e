"""``manifest.json``: what a recording says about itself, sealed with a hash and checked whenever it is opened."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, fields
from typing import Any

import msgspec

from mixo_env.errors import RecordingError, printable
from mixo_env.recordings.folds import MOST_FOLDS, OUT_OF_DISTRIBUTION
from mixo_env.recordings.schema import (
    INERTIAL_EXPERTS,
    SCHEMA_VERSION,
    TRACKS,
    Manifest,
    SceneEntry,
    VehicleConstants,
)

MANIFEST_FILE = "manifest.json"

HASH = "hash"
"""Key of the hash of everything else in the file."""

LARGEST_MANIFEST = 64 << 20
"""Bytes; the thousand scenes of nuScenes take less than one MiB."""

LARGEST_SCENE = 1_000_000
"""Rows; a day at 12 Hz."""

LONGEST_NAME = 200


def encode_manifest(manifest: Manifest) -> bytes:
    """The file's content; the same manifest gives the same bytes.

    Raises:
        RecordingError: for a manifest that could not be opened again.
    """
    check_manifest(manifest)
    table = msgspec.to_builtins(manifest)
    return msgspec.json.format(msgspec.json.encode(table | {HASH: manifest_hash(table)}), indent=2) + b"\n"


def decode_manifest(data: bytes) -> Manifest:
    """The manifest of a file's content.

    Raises:
        RecordingError: if it is damaged, edited, or of another schema version; the message begins with the file's name.
    """
    if len(data) > LARGEST_MANIFEST:
        raise _damaged(f"more than {LARGEST_MANIFEST >> 20} MiB")
    try:
        table = msgspec.json.decode(data)
        version = table.get("schema_version") if isinstance(table, dict) else None
        if version != SCHEMA_VERSION:
            raise RecordingError(f"expected schema version {SCHEMA_VERSION}, got {printable(str(version)[:40])}")
        if table.pop(HASH, None) != manifest_hash(table):
            raise _damaged("it was edited, or a byte of it changed: its hash differs")
        _check_fields(table)
        manifest = msgspec.convert(table, Manifest)
    except (msgspec.MsgspecError, UnicodeDecodeError, RecursionError) as error:
        raise _damaged(printable(str(error)[:200])) from None
    check_manifest(manifest)
    return manifest


def manifest_hash(table: Mapping[str, Any]) -> str:
    """Hash of a manifest's plain values, whatever their order and the layout of the file."""
    return hashlib.blake2b(msgspec.json.encode(table, order="sorted"), digest_size=16).hexdigest()


def is_label(text: str) -> bool:
    """Whether a scene or expert may be called so: printable, one line, no blanks around."""
    return 0 < len(text) <= LONGEST_NAME and text.isprintable() and text.strip() == text


def is_scene_name(text: str) -> bool:
    """Whether a scene may be called so: a label that can be the name of a file as well."""
    return is_label(text) and not text.startswith(".") and not set("/\\") & set(text)


def check_manifest(manifest: Manifest) -> None:
    """Whether it can be true of any recording, whoever wrote it.

    Raises:
        RecordingError: for names that are no names or not unique, folds, row counts or constants out of range.
    """
    if not manifest.scenes:
        raise _damaged("expected at least one scene, got none")
    _check_names("scene", [scene.name for scene in manifest.scenes], is_scene_name)
    for scene in manifest.scenes:
        if not OUT_OF_DISTRIBUTION <= scene.fold < MOST_FOLDS:
            raise _damaged(
                f"expected a fold from {OUT_OF_DISTRIBUTION} to {MOST_FOLDS - 1} for {scene.name}, got {scene.fold}"
            )
        if not 1 <= scene.rows <= LARGEST_SCENE:
            raise _damaged(f"expected 1 to {LARGEST_SCENE:,} rows for {scene.name}, got {scene.rows}")
    experts = manifest.cameras + manifest.inertial + manifest.imported
    _check_names("expert", [*experts, *manifest.variants], is_label)
    _check_known("inertial expert", manifest.inertial, INERTIAL_EXPERTS)
    _check_known("expert with counts", manifest.counted, manifest.imported)
    _check_known("source of distance", [manifest.distance], ("INERTIAL", "wheels", "truth", *manifest.imported))
    _check_known("camera of a variant", manifest.variants.values(), manifest.cameras)
    _check_known("camera with a cost", manifest.camera_cost_ms, manifest.cameras)
    _check_known("track", [*manifest.reward_scale_rad, *manifest.linear_weights], TRACKS)
    _check_finite("cost of a camera", manifest.camera_cost_ms.values(), least=0.0)
    _check_finite("reward scale", manifest.reward_scale_rad.values(), least=0.0)
    for constants in manifest.vehicles.values():
        _check_finite("vehicle constant", asdict(constants).values())
        _check_finite("wheel scale", [constants.wheel_scale], least=1e-3)
    for by_fold in manifest.linear_weights.values():
        _check_known("fold held out", by_fold, ["none", *map(str, range(MOST_FOLDS))])
        for weights in by_fold.values():
            _check_known("expert with a weight", weights, (*experts, *manifest.variants))
            _check_finite("weight of LINEAR", weights.values())


def _check_fields(table: dict[str, Any]) -> None:
    """Unknown fields are refused: somebody meant something by them that would be passed over in silence."""
    rows: list[tuple[str, Any, type]] = [("the manifest", table, Manifest)]
    rows += [("a scene", scene, SceneEntry) for scene in _items(table.get("scenes"))]
    rows += [("a vehicle", vehicle, VehicleConstants) for vehicle in _items(table.get("vehicles"))]
    for kind, row, layout in rows:
        known = {field.name for field in fields(layout)}
        if isinstance(row, dict) and (strange := sorted(set(row) - known)):
            raise _damaged(f"unknown field {strange[0][:LONGEST_NAME]!r} of {kind}")


def _items(value: Any) -> list[Any]:
    return list(value.values()) if isinstance(value, dict) else value if isinstance(value, list) else []


def _check_names(kind: str, names: list[str], fits: Callable[[str], bool]) -> None:
    seen: set[str] = set()
    for name in names:
        if not fits(name):
            raise _damaged(f"no {kind} can be called {name[:LONGEST_NAME]!r}")
        if name.casefold() in seen:
            raise _damaged(f"{kind} {name!r} is there twice")
        seen.add(name.casefold())


def _check_known(kind: str, names: Iterable[str], valid: Iterable[str]) -> None:
    known = set(valid)
    for name in names:
        if name not in known:
            raise _damaged(f"unknown {kind} {name[:LONGEST_NAME]!r}")


def _check_finite(kind: str, values: Iterable[float], least: float = -math.inf) -> None:
    for value in values:
        if not (math.isfinite(value) and value >= least):
            raise _damaged(
                f"expected a finite {kind}" + (f" of {least:g} or more" if least > -math.inf else "") + f", got {value}"
            )


def _damaged(why: str) -> RecordingError:
    return RecordingError(f"{MANIFEST_FILE} is damaged ({why})")
