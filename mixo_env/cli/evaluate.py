"""``mixo evaluate``: score trajectory files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import tyro

from mixo_env.tables import Table

if TYPE_CHECKING:
    from mixo_env.scoring.scores import Convention, MethodScore
    from mixo_env.trajectory.formats import TrajectoryFiles


@dataclass(frozen=True)
class Evaluate:
    """Score estimated trajectories against ground truth: ATE, RTE, KITTI, end drift and more (docs/metrics.md).

    Files are TUM, KITTI, EuRoC, VINS or 4x4 matrices, told from their columns (docs/trajectories.md); - is standard
    input. Folders hold one file per scene, with the same names on
    both sides, or the layout of rpg_trajectory_evaluation (then give the same folder twice).

    Worked examples:

      mixo evaluate --groundtruth gt.txt --estimate orb.txt                         one pair
      mixo evaluate --groundtruth gt.txt --estimate orb.txt droid.txt --align sim3  monocular scale is free
      mixo evaluate --groundtruth gt --estimate orb mixo --out results/vo --figures folders of scenes, everything saved
      mixo evaluate --groundtruth 07.txt --estimate est.txt --lengths 100 200 --json  all statistics
      mixo evaluate --groundtruth gt.txt --estimate orb.txt --pairs rpg --align sim3  as rpg_trajectory_evaluation
    """

    interrupted: ClassVar[str] = "nothing was written"

    groundtruth: Path
    """Ground truth: a file, or a folder of scenes."""
    estimate: tuple[Path, ...]
    """One or more estimates: files, or folders of the same scenes."""
    align: Literal["none", "posyaw", "se3", "sim3"] = "none"
    """none: the first pose is ground truth; posyaw: translation and a turn about z; se3; sim3: with scale."""
    align_poses: int | None = None
    """Align on the first n poses only (default: all)."""
    lengths: tuple[float, ...] = (10.0, 20.0, 30.0, 40.0, 50.0, 75.0, 100.0, 125.0, 150.0, 200.0)
    """Path lengths of the relative error [m]."""
    pairs: Literal["true", "rpg"] = "true"
    """rpg: reproduce rpg_trajectory_evaluation with its index shift, tolerance 0.2 and dense starts."""
    tolerance: Annotated[str, tyro.conf.arg(metavar="step|FRACTION")] = "step"
    """How far a piece may miss its length: one local step, or a fraction of the length such as 0.2."""
    min_start_spacing_m: float = 1.0
    """Starts of pieces are at least this far apart along the path [m]; 0: every frame starts one."""
    end_length: Literal["nominal", "actual"] = "nominal"
    """Divide a piece's error by its nominal or by its actual path length."""
    max_difference_s: float = 0.02
    """Largest time difference of two poses that belong together [s]."""
    times: Path | None = None
    """For KITTI files: one time in seconds a line, for both sides. Without times poses match by index."""
    quaternions: Literal["file", "xyzw", "wxyz"] = "file"
    """Order of quaternions in files that do not tell it by heading; file: as their format has it."""
    format: Literal["table", "csv", "markdown", "latex"] = "table"
    """What is printed."""
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Print all statistics as JSON instead."""
    out: Path | None = None
    """Folder for scores.json, CSV, Markdown, LaTeX, and one zip per method and scene that evo_res opens."""
    figures: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also draw top views, error boxes and error against distance into --out."""

    def run(self) -> int:
        """Read, match, score, print."""
        import itertools
        import json
        import logging
        import sys

        from mixo_env.cli.results import run_folder
        from mixo_env.errors import ConfigurationError, printable
        from mixo_env.scoring.scores import read_matched, score
        from mixo_env.trajectory.formats import TrajectoryFiles
        from mixo_env.trajectory.text import STANDARD_INPUT

        if not self.estimate:
            raise ConfigurationError("expected at least one file or folder after --estimate, got none")
        if self.figures and self.out is None:
            raise ConfigurationError("--figures needs a folder to draw into: give --out FOLDER")
        if [self.groundtruth, *self.estimate, self.times].count(STANDARD_INPUT) > 1:
            raise ConfigurationError("- is standard input and can be one file only, it is given several times")
        convention = self._convention()
        if self.out is not None:
            run_folder("evaluate", self.out)  # now, not after the work
        files = TrajectoryFiles(self.times, self.quaternions)
        scores = []
        for name, path in zip(_method_names(self.estimate), self.estimate, strict=True):
            matched = read_matched(name, self.groundtruth, path, convention, files)
            scores.append(score(matched, convention))
        for note in (*_assumptions(files), *itertools.chain(*map(self._notes, scores))):
            print(f"note: {printable(note)}", file=sys.stderr)
        numbers = {
            "convention": convention.as_numbers(),
            "methods": {method.name: method.as_numbers() for method in scores},
        }
        if self.out is not None:
            self._save(self.out, scores, convention, numbers)
            logging.getLogger(__name__).info("saved to %s", printable(str(self.out)))
        if self.json:
            print(json.dumps(numbers, indent=2))
        else:
            print(self._printed(numbers), end="")
        return 0

    def _convention(self) -> Convention:
        from mixo_env.errors import ConfigurationError
        from mixo_env.metrics.pairs import PairRule
        from mixo_env.scoring.scores import Convention

        tolerance: Any = self.tolerance
        if tolerance != "step":
            try:
                tolerance = float(tolerance)
            except ValueError:
                raise ConfigurationError(
                    f"expected --tolerance step or a number such as 0.2, got {tolerance!r}"
                ) from None
        rule = PairRule(self.lengths, tolerance, self.min_start_spacing_m, self.end_length, self.pairs)
        if not self.max_difference_s > 0.0:
            raise ConfigurationError(f"expected --max-difference-s above 0, got {self.max_difference_s}")
        return Convention(self.align, self.align_poses, self.max_difference_s, rule)

    def _notes(self, method: MethodScore) -> list[str]:
        """What a reader of one method's scores must know: scenes without a scale, a frame of its own."""
        notes = []
        if method.unscaled:
            shown = ", ".join(method.unscaled[:5]) + (", ..." if len(method.unscaled) > 5 else "")
            notes.append(
                f"{method.name}: sim3 has no scale where truth or estimate stands; {len(method.unscaled)} of "
                f"{len(method.matched.scenes)} scenes are aligned by se3: {shown}"
            )
        starts = method.matched.offsets[:-1]
        apart_m = float(method.absolute.translation_m[starts].max())
        turned_deg = float(method.absolute.rotation_deg[starts].max())
        if self.align == "none" and (apart_m > 1.0 or turned_deg > 5.0):
            notes.append(
                f"{method.name} starts {apart_m:.1f} m and {turned_deg:.1f} deg from the ground truth, and nothing "
                "was aligned: its ATE says little; --align se3 --align-poses 1 aligns the first pose"
            )
        return notes

    def _printed(self, numbers: dict[str, Any]) -> str:
        from mixo_env.scoring.score_tables import headline, several

        if self.format == "csv":  # one file, one table
            return headline(numbers).csv()
        render = {"table": Table.text, "markdown": Table.markdown, "latex": Table.latex}[self.format]
        return "\n".join(render(table) for table in several(numbers))

    def _save(self, out: Path, scores: Sequence[MethodScore], convention: Convention, numbers: dict[str, Any]) -> None:
        from mixo_env.cli.results import point_latest, run_folder
        from mixo_env.files import write_json, write_text
        from mixo_env.scoring.evo_results import write_evo_result
        from mixo_env.scoring.score_tables import by_length, by_scene, headline, several

        folder = run_folder("evaluate", out)
        write_json(folder / "scores.json", numbers)
        for name, table in (("scores", headline), ("lengths", by_length), ("scenes", by_scene)):
            write_text(folder / f"{name}.csv", table(numbers).csv())
        write_text(folder / "scores.md", "\n".join(table.markdown() for table in several(numbers)))
        write_text(folder / "scores.tex", "\n".join(table.latex() for table in several(numbers)))
        (folder / "evo").mkdir(exist_ok=True)
        for method in scores:
            for scene, name in enumerate(method.matched.scenes):
                file = method.name if len(method.matched.scenes) == 1 else f"{method.name}-{name}"
                write_evo_result(folder / "evo" / f"{file}.zip", method, scene, convention.alignment_words())
        if self.figures:
            from mixo_env.scoring.score_figures import draw_all

            draw_all(folder, scores, convention)
        point_latest(folder)


def _method_names(paths: Sequence[Path]) -> list[str]:
    """The shortest distinct ends of the paths: ``orb`` and ``mixo``, or ``a/est`` and ``b/est``."""
    from mixo_env.errors import ConfigurationError, printable
    from mixo_env.trajectory.layout import RPG_ESTIMATE
    from mixo_env.trajectory.text import STANDARD_INPUT

    parts = []
    for path in paths:
        if path == STANDARD_INPUT:
            parts.append(("stdin",))
            continue
        # os.path.isfile never raises, whatever the name.
        is_file = os.path.isfile(path)  # noqa: PTH113
        named = path.parent if path.name == RPG_ESTIMATE else path.with_suffix("") if is_file else path
        parts.append(tuple(map(printable, named.absolute().parts)))
    if len(set(parts)) < len(parts):
        raise ConfigurationError("the same estimate is given twice: give each method once")
    depth = 1
    while len({part[-depth:] for part in parts}) < len(parts):
        depth += 1
    return ["-".join(part[-depth:]) for part in parts]


def _assumptions(files: TrajectoryFiles) -> list[str]:
    """What had to be assumed to read the files, each thing once."""
    first: dict[str, tuple[Path, int]] = {}
    for path, note in files.notes.items():
        first[note] = (first.get(note, (path, 0))[0], first.get(note, (path, 0))[1] + 1)
    return [f"{path}{f' and {count - 1} more' if count > 1 else ''}: {note}" for note, (path, count) in first.items()]
