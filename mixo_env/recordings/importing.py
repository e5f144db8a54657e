"""Experts from trajectory files, added to existing recordings; and experts left out of them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, TrajectoryError, unknown
from mixo_env.experts.imported import MAXIMUM_GAP_S, imported_columns, lost_columns
from mixo_env.recordings.axis_check import Turns, check_axes
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.names import check_expert_name
from mixo_env.recordings.pose_lag import as_written, lag_corrected
from mixo_env.recordings.sequence_files import Reading, Source, read_sources
from mixo_env.recordings.sequences import turns_of, vehicle_poses


def with_imported(
    recordings: Recordings,
    expert: str,
    sources: Mapping[str, Source],
    maximum_gap_s: float = MAXIMUM_GAP_S,
    *,
    despite: bool = False,
) -> Recordings:
    """The recordings with one more expert; LINEAR and the reward scale are fitted anew.

    It is LOST in scenes without a trajectory. What the files do not tell is absent.

    Args:
        recordings: to be extended.
        expert: name of the new expert.
        sources: by scene; other scenes than those recorded are left out.
        maximum_gap_s: poses further apart are not interpolated.
        despite: take yaw that contradicts the truth.

    Raises:
        ConfigurationError: for a name that is taken or cannot be a column.
        TrajectoryError: if no trajectory belongs to a recorded scene, the times of one do not fit, or its yaw
            contradicts the truth.
    """
    manifest = recordings.manifest
    check_expert_name(expert, (*recordings.experts, *manifest.variants))
    names = [scene.name for scene in recordings.scenes]
    used = [name for name in names if name in sources]
    if not used:
        raise TrajectoryError(
            f"expected trajectories named after scenes like {names[0]}, got {', '.join(sorted(sources)[:3])}"
        )
    parts = []
    for i, name in enumerate(names):
        stamps = recordings["timestamp_us"][recordings.offsets[i] : recordings.offsets[i + 1]]
        if name not in sources:
            parts.append(lost_columns(len(stamps)))
            continue
        source = sources[name]
        try:
            parts.append(_columns(source, stamps, maximum_gap_s))
        except TrajectoryError as error:
            raise TrajectoryError(f"{expert}, {name}: {error}") from None
    if not despite:
        _check(recordings, expert, {name: sources[name] for name in used}, maximum_gap_s)
    columns: dict[str, Column] = {
        f"{expert}.{name}": np.concatenate([part[name] for part in parts]) for name in parts[0]
    }
    counts = np.isfinite(columns[f"{expert}.matches"]).any()
    manifest = replace(
        manifest,
        imported=(*manifest.imported, expert),
        counted=(*manifest.counted, expert) if counts else manifest.counted,
    )
    return with_fits(recordings.replace(manifest, columns))


def _columns(source: Source, stamps: NDArray[np.int64], maximum_gap_s: float) -> dict[str, NDArray[Any]]:
    return imported_columns(vehicle_poses(source), stamps, source.quality, maximum_gap_s, live=source.live)


def without(recordings: Recordings, experts: Sequence[str]) -> Recordings:
    """The recordings without some experts, and without the variants of cameras among them.

    The distance stays: it is the car's, whichever expert measured it.

    Raises:
        ConfigurationError: for an unknown expert.
    """
    manifest = recordings.manifest
    for expert in experts:
        if expert not in (*recordings.experts, *manifest.variants):
            raise ConfigurationError(unknown("expert", expert, (*recordings.experts, *manifest.variants)))
    gone = {*experts, *(name for name, camera in manifest.variants.items() if camera in experts)}

    def left(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(name for name in names if name not in gone)

    manifest = replace(
        manifest,
        cameras=left(manifest.cameras),
        inertial=left(manifest.inertial),
        imported=left(manifest.imported),
        counted=left(manifest.counted),
        variants={name: camera for name, camera in manifest.variants.items() if name not in gone},
        camera_cost_ms={name: cost for name, cost in manifest.camera_cost_ms.items() if name not in gone},
        distance="wheels" if manifest.distance in gone else manifest.distance,
    )
    written = as_written(recordings)
    columns = {name: written[name] for name in written.column_names if name.rpartition(".")[0] not in gone}
    left_over = Recordings(manifest, columns)
    return with_fits(left_over) if left_over.experts else left_over


def import_into(
    recordings: Recordings,
    experts: Mapping[str, Path],
    reading: Reading,
    maximum_gap_s: float,
    leave_out: Sequence[str] = (),
    despite: Sequence[str] = (),
    note: Callable[[str], None] = lambda _: None,
) -> Recordings:
    """Read trajectories named after recorded scenes and add them, after leaving out ``leave_out``.

    Raises:
        ConfigurationError: for names.
        TrajectoryError: for files.
    """
    kept = without(recordings, leave_out) if leave_out else recordings
    for name, folder in experts.items():
        sources = read_sources(name, folder, (name,), reading)
        strangers = sorted(set(sources) - {scene.name for scene in recordings.scenes})
        if strangers and len(strangers) < len(sources):
            note(f"{name}: no scene called {', '.join(strangers[:5])}, left out")
        kept = with_imported(kept, name, sources, maximum_gap_s, despite=name in despite)
    if not kept.experts:
        raise ConfigurationError(f"expected an expert to be left, got --without {' '.join(leave_out)}: keep one")
    return kept


def _check(recordings: Recordings, expert: str, sources: Mapping[str, Source], gap_s: float) -> None:
    """Whether the yaw agrees with the true poses of these scenes."""
    true = lag_corrected(recordings)
    rows = {name: slice(*recordings.offsets[i : i + 2]) for name in sources for i in [recordings.index(name)]}
    truth = [true["truth.yaw_increment_rad"][rows[name]] for name in sources]
    stamps = {name: recordings["timestamp_us"][rows[name]] for name in sources}
    turns = turns_of(sources, stamps, list(sources), gap_s)
    dt_s = [recordings["dt_s"][rows[name]] for name in sources]
    check_axes(Turns(lambda _: truth, "vehicle"), {expert: turns}, dt_s, list(sources))
