"""Recordings made from trajectories alone: no tables, no images, no CAN bus. Sequences are scenes."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixo_env.errors import ConfigurationError, TrajectoryError
from mixo_env.experts.expert import State
from mixo_env.experts.imported import MAXIMUM_GAP_S, imported_columns, imported_increments, local_yaw_rad, lost_columns
from mixo_env.recordings.axis_check import Turns, check_axes
from mixo_env.recordings.collection import Column, Recordings
from mixo_env.recordings.distances import filled_m, path_distances_m, wheel_distances_m
from mixo_env.recordings.fitting import with_fits
from mixo_env.recordings.folds import with_folds
from mixo_env.recordings.manifest import is_scene_name
from mixo_env.recordings.names import CONSTANT_RATE, GROUNDTRUTH, check_expert_name
from mixo_env.recordings.provenance import file_hash, software_versions
from mixo_env.recordings.schema import TRUE_DISTANCE, Manifest, SceneEntry, columns
from mixo_env.recordings.sequence_files import Reading, Source, read_sources
from mixo_env.recordings.thinning import thinned
from mixo_env.recordings.truth import signed_chords
from mixo_env.recordings.vehicles import training_constants
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.axes import Axes, in_vehicle_axes
from mixo_env.trajectory.layout import TRUTH_NAMES, sequence_files

"""Name of the expert that goes on turning as the others did a step before."""

_PART = re.compile(r"[-_ .]?(?:part|clip|segment|seg)[-_ ]?\d+$", re.IGNORECASE)


@dataclass(frozen=True)
class SequenceRules:
    """What is made of the files.

    Attributes:
        reading: how files are read.
        maximum_gap_s: poses further apart are not interpolated.
        logs: pattern of sequence names (as in a shell) -> log.
        leave_one_out: every log is a fold of its own.
        distance: ``"truth"``, the name of an expert, or a folder (or file) of wheel speeds.
        constant_rate: add the expert CONSTANT_RATE.
        despite: experts whose yaw may contradict the truth.
        data_version: part of every result.
    """

    reading: Reading = field(default_factory=Reading)
    maximum_gap_s: float = MAXIMUM_GAP_S
    logs: Mapping[str, str] = field(default_factory=dict)
    leave_one_out: bool = False
    distance: str = TRUE_DISTANCE
    constant_rate: bool = False
    despite: tuple[str, ...] = ()
    data_version: str = "imported"


def recordings_from_trajectories(
    groundtruth: Path,
    experts: Mapping[str, Path],
    rules: SequenceRules | None = None,
    note: Callable[[str], None] = lambda _: None,
) -> Recordings:
    """Recordings whose scenes are the sequences of ``groundtruth`` and whose steps lead from one true pose to the next.

    A truth that is far denser than the experts is thinned (:mod:`mixo_env.recordings.thinning`).

    Args:
        groundtruth: folder of files, one a sequence.
        experts: name -> folder of files with the same names.
        rules: what is made of them.
        note: told what does not belong together.

    Raises:
        ConfigurationError: for names and options that cannot be.
        TrajectoryError: for files that cannot be read, do not belong together or contradict each other.
    """
    rules = rules or SequenceRules()
    _check_names(experts, rules)
    truths = read_sources(GROUNDTRUTH, groundtruth, TRUTH_NAMES, rules.reading)
    sources = {name: read_sources(name, folder, (name,), rules.reading) for name, folder in experts.items()}
    sources = {name: _matched(name, own, truths, note) for name, own in sources.items()}
    for sequence, source in truths.items():
        if not is_scene_name(sequence):
            raise TrajectoryError(f"{source.path}: no scene can be called {sequence!r}: rename the file")
        if source.trajectory.timestamps_s is None:
            raise TrajectoryError(
                f"{source.path}: expected a time for each pose, got none: give --times FOLDER or --rate HZ"
            )
    truths = {name: _thinned(name, truth, sources, note) for name, truth in truths.items()}
    scenes = _entries(truths, rules)
    stamps = {name: _timestamps_us(source) for name, source in truths.items()}
    _check_axes(truths, sources, stamps, rules)
    wheels = _wheel_files(rules, experts)
    parts = [
        _scene(scene.name, truths[scene.name], {n: own.get(scene.name) for n, own in sources.items()}, wheels, rules)
        for scene in scenes
    ]
    names = (*experts, *([CONSTANT_RATE] if rules.constant_rate else []))
    counted = tuple(
        n for n in experts if any(s.quality and np.isfinite(s.quality.matches).any() for s in sources[n].values())
    )
    manifest = Manifest(
        data_version=rules.data_version,
        cameras=(),
        inertial=(),
        imported=names,
        counted=counted,
        distance="wheels" if wheels is not None else rules.distance,
        scenes=scenes,
        parameters={"import": _parameters(truths, sources, rules)},
        software=software_versions(),
    )
    table = {n: np.concatenate([part[n] for part in parts]) for n in columns((), (), names)}
    recordings = Recordings(manifest, table)
    constants = training_constants(recordings)
    return with_fits(recordings.replace(replace(manifest, vehicles=constants)))


def log_of(sequence: str, rules: Mapping[str, str]) -> str:
    """The drive a sequence belongs to: the first pattern that fits; else its name without ``_part2`` and the like."""
    for pattern, log in rules.items():
        if fnmatch.fnmatchcase(sequence, pattern):
            return log
    return _PART.sub("", sequence) or sequence


def _check_names(experts: Mapping[str, Path], rules: SequenceRules) -> None:
    taken: set[str] = set()
    for name in experts:
        check_expert_name(name, taken)
        taken.add(name)
    if not experts:
        raise ConfigurationError("expected at least one expert, got none: give --expert NAME=FOLDER")
    for name in (*rules.reading.axes, *rules.despite):
        if name not in ("", GROUNDTRUTH, *experts):
            raise ConfigurationError(f"{name!r} is none of the experts {', '.join(experts)}")
    if not 0.0 < rules.maximum_gap_s <= 3600.0:
        raise ConfigurationError(f"expected --max-gap-s above 0, got {rules.maximum_gap_s:g}")


def _matched(
    name: str, own: dict[str, Source], truths: Mapping[str, Source], note: Callable[[str], None]
) -> dict[str, Source]:
    """The sequences that have a truth; a single file belongs to a single truth whatever its name."""
    if len(own) == 1 and len(truths) == 1:
        own = dict(zip(truths, own.values(), strict=True))
    matched = {sequence: source for sequence, source in own.items() if sequence in truths}
    if not matched:
        raise TrajectoryError(
            f"{name}: expected files named after the ground truth's sequences, such as {next(iter(truths))}, got "
            f"{', '.join(list(own)[:3])}"
        )
    for sequence in (s for s in own if s not in truths):
        note(f"{name}, {sequence}: no ground truth of this name, left out")
    for sequence in (s for s in truths if s not in own):
        note(f"{name}: no file for {sequence}, lost there all the way")
    for sequence, source in matched.items():
        truth = truths[sequence]
        matched[sequence] = _timed(source, truth)
        poses, frames = len(source.trajectory), len(truth.trajectory)
        if poses != frames and _same_times(matched[sequence], truth):
            note(f"{name}, {sequence}: {poses} poses for {frames} true ones, lost where it has none")
        elif poses != frames:
            note(f"{name}, {sequence}: {poses} poses at other times than the {frames} true ones, interpolated")
    return matched


def _timed(source: Source, truth: Source) -> Source:
    """A source without times of its own has those of the truth, pose by pose or by the frames it numbers.

    Raises:
        TrajectoryError: where there are not as many.
    """
    times_s, frames = truth.trajectory.timestamps_s, source.trajectory.timestamps_s
    numbered = source.trajectory.counted and not truth.trajectory.counted
    if times_s is None or not (frames is None or numbered):
        return source
    index = np.arange(len(source.trajectory)) if frames is None else frames.astype(np.int64)
    if index[-1] >= len(times_s) or (frames is None and len(index) != len(times_s)):
        raise TrajectoryError(
            f"{source.path}: {len(index)} poses without times for {len(times_s)} true ones: give their times "
            f"({source.path.stem}.times beside the file), or number the frames from 0 in a first column"
        )
    return replace(source, trajectory=replace(source.trajectory, timestamps_s=times_s[index], counted=False))


def _thinned(
    sequence: str, truth: Source, sources: Mapping[str, Mapping[str, Source]], note: Callable[[str], None]
) -> Source:
    """The truth without the poses that no expert can follow."""
    times_s = truth.trajectory.timestamps_s
    own = [source.trajectory.timestamps_s for of_one in sources.values() if (source := of_one.get(sequence))]
    kept = None if times_s is None else thinned(times_s, [times for times in own if times is not None])
    if kept is None:
        return truth
    note(f"{sequence}: steps from {len(kept)} of {len(truth.trajectory)} true poses, those nearest to experts' poses")
    return replace(truth, trajectory=truth.trajectory[kept])


def _same_times(one: Source, other: Source) -> bool:
    """Whether every pose of one has a pose of the other at its time."""
    own_s, others_s = one.trajectory.timestamps_s, other.trajectory.timestamps_s
    if own_s is None or others_s is None:
        return False
    return bool(np.isin(np.rint(1e6 * own_s), np.rint(1e6 * others_s)).all())


def _entries(truths: Mapping[str, Source], rules: SequenceRules) -> tuple[SceneEntry, ...]:
    """Scenes in order of their names, with logs and folds."""
    for pattern in rules.logs:
        if not any(fnmatch.fnmatchcase(name, pattern) for name in truths):
            raise ConfigurationError(f"--log {pattern}=...: no sequence is called so, there are {', '.join(truths)}")
    entries = [
        SceneEntry(name, log_of(name, rules.logs), "imported", "", (), 0, len(truths[name].trajectory))
        for name in sorted(truths)
    ]
    return with_folds(entries, "one-log-out" if rules.leave_one_out else "log")


def _timestamps_us(source: Source) -> NDArray[np.int64]:
    assert source.trajectory.timestamps_s is not None
    stamps = np.rint(1e6 * source.trajectory.timestamps_s).astype(np.int64)
    if np.any(np.diff(stamps) <= 0):
        raise TrajectoryError(f"{source.path}: expected poses at least a microsecond apart, got some closer together")
    return stamps


def _check_axes(
    truths: Mapping[str, Source],
    sources: Mapping[str, Mapping[str, Source]],
    stamps: Mapping[str, NDArray[np.int64]],
    rules: SequenceRules,
) -> None:
    order = sorted(truths)
    dt_s = [1e-6 * np.diff(stamps[name], prepend=stamps[name][0]) for name in order]
    check_axes(
        turns_of(truths, stamps, order, rules.maximum_gap_s),
        {name: turns_of(own, stamps, order, rules.maximum_gap_s) for name, own in sources.items()},
        dt_s,
        order,
        rules.despite,
    )


def turns_of(
    sources: Mapping[str, Source], stamps: Mapping[str, NDArray[np.int64]], order: Sequence[str], gap_s: float
) -> Turns:
    """Turns of one program in any axes; those of a sequence without a file are NaN."""

    def increments(axes: str) -> list[NDArray[np.float64]]:
        return [_increments(sources.get(name), axes, stamps[name], gap_s) for name in order]

    return Turns(increments, next(iter(sources.values())).axes)


def _increments(source: Source | None, axes: str, stamps: NDArray[np.int64], gap_s: float) -> NDArray[np.float64]:
    if source is None:
        return np.full(len(stamps), np.nan)
    lost = None if source.quality is None else source.quality.lost
    try:
        return imported_increments(vehicle_poses(source, axes), stamps, gap_s, lost, live=source.live)
    except TrajectoryError as error:
        raise TrajectoryError(f"{source.path}: {error}") from None


def vehicle_poses(source: Source, axes: str = "") -> Trajectory:
    """Poses in the vehicle's axes, read with those of the source or with others."""
    named: Axes = axes or source.axes  # type: ignore[assignment]
    return in_vehicle_axes(source.trajectory, named)


def _wheel_files(rules: SequenceRules, experts: Mapping[str, Path]) -> dict[str, Path] | None:
    """Sequence -> file of wheel speeds; ``None`` if the distance comes from poses."""
    if rules.distance == TRUE_DISTANCE or rules.distance in experts:
        return None
    if not Path(rules.distance).exists():
        raise ConfigurationError(
            f"--distance {rules.distance}: expected truth, one of the experts {', '.join(experts)}, or a folder of "
            "wheel speeds"
        )
    return sequence_files(Path(rules.distance), ("wheels", "speed"))


def _scene(
    name: str,
    truth: Source,
    experts: Mapping[str, Source | None],
    wheels: Mapping[str, Path] | None,
    rules: SequenceRules,
) -> dict[str, Column]:
    """All columns of one scene."""
    stamps = _timestamps_us(truth)
    time_s = 1e-6 * (stamps - stamps[0])
    dt_s = np.diff(time_s, prepend=0.0)
    table: dict[str, Any] = _truth_columns(vehicle_poses(truth), stamps, time_s, dt_s)
    for expert, source in experts.items():
        own = lost_columns(len(stamps))
        if source is not None:
            own = imported_columns(vehicle_poses(source), stamps, source.quality, rules.maximum_gap_s, live=source.live)
        table |= {f"{expert}.{column}": values for column, values in own.items()}
    if rules.constant_rate:
        increments = np.stack([table[f"{expert}.yaw_increment_rad"] for expert in experts])
        table |= {f"{CONSTANT_RATE}.{n}": values for n, values in constant_rate_columns(increments, dt_s).items()}
    if wheels is not None:
        if name not in wheels:
            raise TrajectoryError(f"{rules.distance}: no wheel speeds for {name}: add its file")
        distance = wheel_distances_m(wheels[name], stamps, rules.maximum_gap_s)
    elif rules.distance == TRUE_DISTANCE:
        distance = table["truth.distance_m"]
    else:
        source = experts[rules.distance]
        distance = np.full(len(stamps), np.nan)
        if source is not None:
            distance = path_distances_m(vehicle_poses(source), stamps, rules.maximum_gap_s)
    filled = filled_m(distance, dt_s)
    if filled is None:
        raise TrajectoryError(f"{name}: {rules.distance} tells no distance: choose another --distance")
    speed = np.concatenate([filled[1:2] / dt_s[1:2], filled[1:] / dt_s[1:]])
    return table | {"distance_m": filled.astype(np.float32), "speed_mps": speed.astype(np.float32)}


def _truth_columns(
    truth: Trajectory, stamps: NDArray[np.int64], time_s: NDArray[np.float64], dt_s: NDArray[np.float64]
) -> dict[str, Any]:
    """Times and truth: the plane of the first pose, yaw summed up from local turns as that of the experts."""
    yaw = local_yaw_rad(truth)
    x, y = truth.positions_m[:, 0], truth.positions_m[:, 1]
    nothing = np.full(len(stamps), np.nan)
    return {
        "step": np.arange(len(stamps), dtype=np.int32),
        "timestamp_us": stamps,
        "time_s": time_s,
        "dt_s": dt_s,
        "is_keyframe": np.ones(len(stamps), np.bool_),
        "truth.x_m": x,
        "truth.y_m": y,
        "truth.yaw_rad": yaw,
        "truth.yaw_increment_rad": np.diff(yaw, prepend=np.nan),
        "truth.distance_m": np.concatenate([[np.nan], signed_chords(x, y, yaw)]),
        "exact.x_m": nothing,
        "exact.y_m": nothing,
        "exact.yaw_rad": nothing,
    }


def constant_rate_columns(increments_rad: NDArray[np.floating], dt_s: NDArray[np.float64]) -> dict[str, Column]:
    """Columns of the expert that keeps the median rate of the others' last step in which any of them delivered.

    Args:
        increments_rad: ``(experts, rows)``.
        dt_s: ``(rows,)``.
    """
    table = lost_columns(len(dt_s))
    known = np.isfinite(increments_rad).any(axis=0)
    rate = np.zeros(len(dt_s))
    rate[known] = np.nanmedian(increments_rad[:, known].astype(np.float64), axis=0) / dt_s[known]
    last = np.maximum.accumulate(np.where(known, np.arange(len(dt_s)), -1))
    before = np.concatenate([[-1], last[:-1]])
    told = before >= 0
    table["yaw_increment_rad"][told] = (rate[before] * dt_s)[told]
    table["state"][told] = State.TRACKING
    return table


def _parameters(
    truths: Mapping[str, Source], sources: Mapping[str, Mapping[str, Source]], rules: SequenceRules
) -> dict[str, Any]:
    """Everything that made the values: rules, axes, and hashes of the files."""

    def described(own: Mapping[str, Source]) -> dict[str, Any]:
        return {
            "axes": next(iter(own.values())).axes,
            "files": {name: file_hash(source.path) for name, source in sorted(own.items())},
        }

    plain = asdict(rules)
    plain["reading"] = {name: getattr(rules.reading, name) for name in ("quaternions", "rate_hz", "live")}
    plain["distance"] = Path(rules.distance).name
    plain["distance_privileged"] = rules.distance == TRUE_DISTANCE
    return {
        **plain,
        "logs": dict(rules.logs),
        "despite": list(rules.despite),
        GROUNDTRUTH: described(truths),
        "experts": {name: described(own) for name, own in sources.items()},
    }
