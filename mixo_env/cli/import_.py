"""``mixo import``: trajectories of other programs become experts."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro
from tyro.conf import FlagCreatePairsOff, Positional, UseAppendAction

if TYPE_CHECKING:
    from mixo_env.recordings.collection import Recordings
    from mixo_env.recordings.sequence_files import Reading

Words = Annotated[tuple[tuple[str, ...], ...], UseAppendAction]
_ALONE = ("rate", "log", "leave_one_out", "distance", "constant_rate")
"""Options that shape a new recording only."""


@dataclass(frozen=True)
class Import:
    """Make a recording from trajectories alone, or add experts to one.

    Files are TUM, KITTI, EuRoC, VINS or 4x4 matrices, told from their columns (docs/trajectories.md), one file a
    sequence, named alike in all folders: 03.txt; or a folder a sequence that holds one file, or one named after the
    expert (groundtruth.txt, ORB.txt). Only yaw is used of an expert: its turns from pose to pose about the vehicle's up
    axis. All rows share one distance.

    Worked examples:

      mixo import --groundtruth gt --expert ORB=orb DSO=dso --rate 10 --out drives    from trajectories alone
      mixo import --groundtruth gt --expert ORB=orb --distance ORB --leave-one-out --out drives
      mixo import --groundtruth gt --expert ORB=orb --axes ORB=camera --log 'MH_*=hall' --out drives
      mixo import mixocity --expert ORB=tum --axes camera --out with-orb              added to a recording
      mixo import mixocity --expert CAM_BACK=tum --without CAM_BACK --out exchanged   in place of its own
      mixo benchmark --recordings drives                                              what to do next
    """

    interrupted: ClassVar[str] = "nothing was written"

    out: Path
    """Folder of the recording that is written."""
    recordings: Positional[str | None] = None
    """Folder written by `mixo record`, or the name of a bundled recording, to be extended; none with --groundtruth."""
    groundtruth: Path | None = None
    """Folder of the true trajectories: every file a scene, every pose the end of a step."""
    expert: Annotated[Words, tyro.conf.arg(metavar="NAME=FOLDER ...")] = ()
    """Name of a new expert, and the folder of its files; as many as you like."""
    axes: Annotated[Words, tyro.conf.arg(metavar="[NAME=]AXES ...")] = ()
    """Axes of the body, of all or of one expert or of groundtruth: file (as the format defines them: KITTI camera,
    others vehicle), vehicle (x forward, y left, z up), camera (x right, y down, z forward), ned (x forward, y right, z
    down), opengl (x right, y up, z backward). Visual SLAM mostly writes camera poses into TUM files."""
    quaternions: Literal["file", "xyzw", "wxyz"] = "file"
    """Order of quaternions in files that do not tell it (docs/trajectories.md)."""
    times: Path | None = None
    """Folder of the times of files without any, one in seconds a line: 03.txt or 03/times.txt. 03.times beside the
    trajectory needs no option."""
    rate: float | None = None
    """Instead of times: poses a second, from 0 on."""
    max_gap_s: float = 0.6
    """Poses further apart are not interpolated; the expert is lost there [s]."""
    live: Annotated[bool, FlagCreatePairsOff] = False
    """The poses were given live, each with its image: a step is told by the poses up to its end, and the last one is
    carried there by the rate of the last two. Otherwise yaw is interpolated, for which a later pose may be used."""
    without: Annotated[Words, tyro.conf.arg(metavar="NAME ...")] = ()
    """Experts of the recording to leave out; one of the same name may then be imported."""
    despite: Annotated[Words, tyro.conf.arg(metavar="NAME ...")] = ()
    """Experts whose yaw may contradict the truth."""
    log: Annotated[Words, tyro.conf.arg(metavar="SEQUENCE=LOG ...")] = ()
    """Drive of the sequences that fit a pattern, such as 'MH_*=hall'. Otherwise each is a drive of its own, but for
    names that end in _part2, _clip2, _segment2."""
    leave_one_out: Annotated[bool, FlagCreatePairsOff] = False
    """Every drive is a fold of its own; otherwise drives are dealt out to four folds."""
    distance: str | None = None
    """Where the distance comes from: a folder of wheel speeds (lines of `time speed` in s and m/s), the path of an
    expert, or truth (the default; marked as privileged in every table)."""
    constant_rate: Annotated[bool, FlagCreatePairsOff] = False
    """Add the expert CONSTANT_RATE: it goes on turning as the median of the others did a step before."""

    def run(self) -> int:
        """Write the recording and say what every expert covers."""
        from mixo_env.errors import ConfigurationError, printable
        from mixo_env.recordings.folder import claimed
        from mixo_env.recordings.store import settled, write_recordings

        experts = self._experts()
        reading = self._reading(experts)
        alone = [name for name in _ALONE if getattr(self, name) not in (None, (), False)]
        if self.groundtruth is None and self.recordings is None:
            raise ConfigurationError("expected --groundtruth FOLDER, or the recording to be extended, got neither")
        if self.groundtruth is not None and self.recordings is not None:
            raise ConfigurationError("--groundtruth makes a new recording: leave it out, or the recording to extend")
        if self.groundtruth is None and alone:
            raise ConfigurationError(f"--{alone[0].replace('_', '-')} is for new recordings, with --groundtruth")
        if self.groundtruth is not None and self.without:
            raise ConfigurationError("--without is for recordings that are extended: leave the --expert out")
        notes: list[str] = []
        with claimed(self.out) as home:
            old = settled(home)
            given = None if self.recordings is None else Path(self.recordings)
            same = given is not None and given.is_dir() and home.samefile(given)
            if old is not None and not same:
                raise ConfigurationError(f"{home} holds another recording: choose another --out, or remove it first")
            made = self._made(experts, reading, notes)
            write_recordings(made, home)
        for text in notes:
            print(f"note: {printable(text)}", file=sys.stderr)
        self._say(made, [name for name in made.manifest.imported if name in experts or name == "CONSTANT_RATE"])
        return 0

    def _made(self, experts: dict[str, Path], reading: Reading, notes: list[str]) -> Recordings:
        if self.groundtruth is not None:
            from mixo_env.recordings.sequences import SequenceRules, recordings_from_trajectories

            rules = SequenceRules(
                reading=reading,
                maximum_gap_s=self.max_gap_s,
                logs=dict(_pairs("log", _flat(self.log))),
                leave_one_out=self.leave_one_out,
                distance=self.distance or "truth",
                constant_rate=self.constant_rate,
                despite=_flat(self.despite),
                data_version=self.out.resolve().name,
            )
            return recordings_from_trajectories(self.groundtruth, experts, rules, notes.append)
        from mixo_env.recordings.importing import import_into
        from mixo_env.recordings.store import load_recordings

        return import_into(
            load_recordings(self.recordings),
            experts,
            reading,
            self.max_gap_s,
            _flat(self.without),
            _flat(self.despite),
            notes.append,
        )

    def _experts(self) -> dict[str, Path]:
        from mixo_env.errors import ConfigurationError

        experts: dict[str, Path] = {}
        for name, folder in _pairs("expert", _flat(self.expert)):
            if name in experts:
                raise ConfigurationError(f"--expert {name} is given twice: one folder an expert")
            experts[name] = Path(folder)
        if not experts and not self.without:
            raise ConfigurationError("expected at least one --expert NAME=FOLDER, got none")
        return experts

    def _reading(self, experts: dict[str, Path]) -> Reading:
        from typing import get_args

        from mixo_env.errors import ConfigurationError, unknown
        from mixo_env.recordings.sequence_files import Reading
        from mixo_env.trajectory.axes import Axes

        axes: dict[str, Any] = {}
        for word in _flat(self.axes):
            name, _, value = word.rpartition("=")
            if value not in get_args(Axes):
                raise ConfigurationError(unknown("axes", value, get_args(Axes)))
            if name and name not in (*experts, "groundtruth"):
                raise ConfigurationError(unknown("expert of --axes", name, (*experts, "groundtruth")))
            if name in axes:
                raise ConfigurationError(f"--axes {name or value} is given twice")
            axes[name] = value
        if self.groundtruth is not None and "groundtruth" not in axes:
            axes["groundtruth"] = "file"
        return Reading(axes, self.quaternions, self.times, self.rate, self.live)

    def _say(self, made: Recordings, names: list[str]) -> None:
        import numpy as np

        scenes, steps = len(made), len(made["step"]) - len(made)
        for name in names:
            available = np.isfinite(made[f"{name}.yaw_increment_rad"])
            covered = sum(bool(available[a:b].any()) for a, b in zip(made.offsets, made.offsets[1:], strict=False))
            print(f"{self.out}: {name} in {covered} of {scenes} scenes, {available.sum() / steps:.1%} of the steps")
        if self.groundtruth is None:
            if self.without:
                print(f"{self.out}: without {', '.join(_flat(self.without))}")
            return
        folds = len({scene.fold for scene in made.scenes})
        logs = len({scene.log for scene in made.scenes})
        source = made.manifest.distance + (" (privileged)" if made.manifest.distance == "truth" else "")
        print(f"{self.out}: {scenes} scenes, {steps:,} steps, {logs} logs, {folds} folds; distance from {source}")
        print("Only yaw is used of the experts: positions of their files are not used.")


def _flat(words: tuple[tuple[str, ...], ...]) -> tuple[str, ...]:
    return tuple(word for group in words for word in group)


def _pairs(option: str, words: Any) -> list[tuple[str, str]]:
    from mixo_env.errors import ConfigurationError

    pairs = []
    for word in words:
        name, equals, value = word.partition("=")
        if not (name and equals and value):
            what = "NAME=FOLDER" if option == "expert" else "SEQUENCE=LOG"
            raise ConfigurationError(f"expected --{option} {what}, got {word!r}")
        pairs.append((name, value))
    return pairs
