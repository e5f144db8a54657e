"""Faults for robustness studies: what an expert says is changed, what it says about its own quality is not.

That is the dangerous kind of failure: match counts still look good. Only a dropped expert says that it is gone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from mixo_env.envs.options import check_fields
from mixo_env.errors import ConfigurationError, unknown
from mixo_env.experts.expert import State
from mixo_env.recordings.camera_faults import noted_faults
from mixo_env.recordings.collection import Recordings

FaultKind = Literal["stuck", "flipped", "noisy", "delayed", "dropped"]

INCREMENTS = ("yaw_increment_rad", "two_frame_yaw_increment_rad")


@dataclass(frozen=True)
class Fault:
    """One expert failing from one step of every scene on.

    Attributes:
        expert: by name.
        kind: ``"stuck"`` (repeats the yaw rate before the fault; 0 from the first step), ``"flipped"`` (wrong sign),
            ``"noisy"`` (white noise added to its rate), ``"delayed"`` (says what it should have said earlier),
            ``"dropped"`` (says nothing; a camera is LOST).
        start_step: first step of the fault.
        noise_radps: standard deviation of ``"noisy"``.
        delay_steps: of ``"delayed"``.
    """

    expert: str
    kind: FaultKind
    start_step: int = 1
    noise_radps: float = 0.05
    delay_steps: int = 1

    def __post_init__(self) -> None:
        check_fields(self)
        if self.start_step < 1 or self.noise_radps < 0 or self.delay_steps < 1:
            raise ConfigurationError(f"expected start_step >= 1, noise_radps >= 0 and delay_steps >= 1, got {self}")


def read_faults(given: Iterable[Fault | Mapping[str, Any]]) -> tuple[Fault, ...]:
    """Faults from themselves or from plain mappings of their fields (JSON)."""
    names = [field.name for field in fields(Fault)]
    faults = []
    for fault in given:
        if isinstance(fault, Fault):
            faults.append(fault)
            continue
        for key in fault:
            if key not in names:
                raise ConfigurationError(unknown("fault field", key, names))
        if "expert" not in fault or "kind" not in fault:
            raise ConfigurationError(f"a fault needs expert and kind, got {dict(fault)}: e.g. CAM_FRONT and stuck")
        faults.append(Fault(**fault))
    return tuple(faults)


def inject(recordings: Recordings, faults: Sequence[Fault], *, seed: int = 0) -> Recordings:
    """The recordings with ``faults`` in them; noise depends on (seed, scene, expert) alone."""
    if not faults:
        return recordings
    columns = {name: recordings[name] for name in recordings.column_names}
    for fault in faults:
        if fault.expert not in recordings.experts:
            raise ConfigurationError(unknown("expert", fault.expert, recordings.experts))
        names = [name for name in (f"{fault.expert}.{part}" for part in INCREMENTS) if name in columns]
        lost = [f"{fault.expert}.state"] if fault.kind == "dropped" and f"{fault.expert}.state" in columns else []
        for name in (*names, *lost):
            columns[name] = columns[name].copy()
        for i, scene in enumerate(recordings.scenes):
            rows = slice(recordings.offsets[i], recordings.offsets[i + 1])
            key = [seed, *scene.name.encode(), recordings.experts.index(fault.expert)]
            for name in names:
                faulty(columns[name][rows], columns["dt_s"][rows], fault, np.random.default_rng(key))
            for name in lost:
                columns[name][rows][fault.start_step :] = State.LOST
    return Recordings(recordings.manifest, columns)


def faulty(increments: NDArray[Any], dt_s: NDArray[np.float64], fault: Fault, rng: np.random.Generator) -> None:
    """Put ``fault`` into one scene's ``increments`` ``(rows,)`` [rad], in place; what is missing stays missing."""
    start = min(fault.start_step, len(increments))
    healthy = increments.copy()
    after = slice(start, None)
    match fault.kind:
        case "flipped":
            increments[after] = -healthy[after]
        case "noisy":
            increments[after] += fault.noise_radps * dt_s[after] * rng.standard_normal(len(increments))[after]
        case "dropped":
            increments[after] = np.nan
        case "delayed":
            late = np.concatenate([np.full(fault.delay_steps, np.nan, healthy.dtype), healthy])
            increments[after] = late[: len(healthy)][after]
        case "stuck":
            said = np.flatnonzero(np.isfinite(healthy[1:start])) + 1
            rate = healthy[said[-1]] / dt_s[said[-1]] if len(said) else 0.0
            increments[after] = np.where(np.isfinite(healthy[after]), rate * dt_s[after], np.nan)


def active_faults(
    recordings: Recordings, faults: Sequence[Fault], experts: Sequence[str]
) -> dict[str, NDArray[np.object_]]:
    """Names of the faults that every row shows, of pictures (as the recordings note) and of what experts say.

    Args:
        recordings: that are played.
        faults: injected into them.
        experts: who votes.

    Returns:
        Expert -> ``(rows,)`` names, joined by a comma where there are several, ``""`` where all is well. Experts that
        are sound everywhere are left out.
    """
    lasting: dict[str, list[tuple[str, NDArray[np.bool_]]]] = {}
    variants = recordings.manifest.variants
    for (camera, kind), where in noted_faults(recordings).items():
        for expert in experts:
            if variants.get(expert, expert) == camera:  # all that see these pictures
                lasting.setdefault(expert, []).append((kind, where))
    first = np.repeat(recordings.offsets[:-1], np.diff(recordings.offsets))
    step = np.arange(recordings.offsets[-1]) - first
    for fault in faults:
        if fault.expert in experts:
            lasting.setdefault(fault.expert, []).append((fault.kind, step >= fault.start_step))
    return {expert: _joined(told) for expert, told in lasting.items()}


def _joined(told: Sequence[tuple[str, NDArray[np.bool_]]]) -> NDArray[np.object_]:
    names = np.full(len(told[0][1]), "", dtype=object)
    for kind, where in told:
        names[where] = [f"{before}, {kind}" if before else kind for before in names[where]]
    return names
