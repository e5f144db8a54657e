"""`mixo benchmark`: the leaderboard."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    from mixo_env.leaderboard.board import Leaderboard
    from mixo_env.recordings.collection import Recordings


@dataclass(frozen=True)
class Benchmark:
    """Cross-validated leaderboard of all policies, one table per track.

    Worked examples:

      mixo benchmark                                    everything on the bundled recordings
      mixo benchmark --recordings recorded              on your own, from `mixo record`
      mixo benchmark --tracks CONSUMER --policies LINEAR MIXO highest-match --sort deg/m
      mixo benchmark --by condition situation           also by day, rain, night, and by what was staged
      mixo benchmark --paper --tracks PAPER             also every table and figure of the paper, beside its numbers
      mixo benchmark --ground-truth keyframes           the paper's clock: one step from key frame to key frame
    """

    interrupted: ClassVar[str] = "nothing was written: a table is computed in one go"

    recordings: Path | None = None
    """Folder written by `mixo record`, or the name of a bundled recording. None: the bundled mixocity."""

    tracks: tuple[str, ...] = ()
    """Who votes besides the cameras (PAPER, VISION, CONSUMER; UNEQUAL: experts of other families, where recorded);
    every track has a table of its own. Empty: all; of imported trajectories alone the first three are the same, and
    VISION stands for them."""

    policies: tuple[str, ...] = ()
    """Rows to run; case, hyphens and underscores do not matter. Empty: all that fit these recordings, but
    those trained by reinforcement (PPO, A2C, SAC, TD3, DQN) only where weights are at hand: fits take long.
    `all`: those, too."""

    seed: int = 0
    """Of everything random: same seed, same machine, same numbers."""

    seeds: int = 1
    """Fits of every learned policy; its row is the mean of their errors, never the best."""

    ground_truth: Literal["poses", "keyframes"] = "poses"
    """A step from image to image, or between key frames (2 Hz) as in the paper."""

    weights: Path | None = None
    """Folder written by `mixo train`: what it holds for just these recordings is not fitted again (`-v` names it).
    None: weights that come with the package; with an empty folder all is fitted, agents if named."""

    by: tuple[Literal["condition", "situation"], ...] = ()
    """Show tables by condition or by staged situation as well (leaderboard.json always holds them)."""

    sort: Literal["table", "deg/m", "%", "ate-m", "ate-deg", "yaw", "written"] = "table"
    """Order of the rows within each section."""

    paper: bool = False
    """Write paper.md as well: the paper's tables beside its printed numbers, and its figures (paper-*.png)."""

    workers: int | None = None
    """Processes; no number depends on it. Each holds the recordings: some 0.55 GB for the bundled ones. None: one a
    core, at most 4, and no more than a tenth of the rows."""

    out: Path | None = None
    """Folder for the results. None: results/benchmark-<date>-<time>, and results/latest points there."""

    def run(self) -> int:
        """Print the leaderboard and write it, with figure, per-scene results and configuration."""
        from msgspec import json

        from mixo_env.cli.progress import progress
        from mixo_env.cli.results import point_latest, run_folder
        from mixo_env.files import write_bytes, write_json, write_text
        from mixo_env.leaderboard.board import build, requested
        from mixo_env.leaderboard.conditions import check_grouping
        from mixo_env.leaderboard.crossvalidation import Trial
        from mixo_env.leaderboard.drives import drives_json
        from mixo_env.leaderboard.exports import to_csv, to_json
        from mixo_env.leaderboard.figures import draw_trajectories
        from mixo_env.leaderboard.paper.pages import write_paper
        from mixo_env.leaderboard.paper.parts import folder_of
        from mixo_env.leaderboard.report import print_leaderboard, to_markdown
        from mixo_env.leaderboard.report_page import write_report
        from mixo_env.leaderboard.results import FAILURES_FILE, shipped_failures
        from mixo_env.leaderboard.trajectories import write_all
        from mixo_env.leaderboard.weights import shipped
        from mixo_env.recordings.store import load_recordings

        recordings = load_recordings(None if self.recordings is None else str(self.recordings))
        requested(recordings, self.tracks, self.policies)  # raises before there is a folder
        for by in self.by:
            check_grouping(recordings, by)
        folder = run_folder("benchmark", self.out)
        with progress("computing rows") as report:
            board = build(
                recordings,
                tracks=self.tracks,
                policies=self.policies,
                trial=Trial(self.seed, self.seeds, self.ground_truth, weights=self.weights or shipped()),
                workers=self.workers,
                progress=report,
            )
        write_json(folder / "configuration.json", self._resolved(board, recordings))
        write_text(folder / "leaderboard.md", to_markdown(board, sort=self.sort, by=self.by))
        write_json(folder / "leaderboard.json", to_json(board))
        write_text(folder / "scenes.csv", to_csv(board))
        write_bytes(folder / "drives.json", json.encode(drives_json(board)))  # long lists: not a number a line
        draw_trajectories(board, folder / "trajectories.png")
        write_all(board, folder / "trajectories.zip")
        if self.paper:
            write_paper(board, recordings, folder, folder_of(self.recordings))
        if failures := shipped_failures(recordings.manifest.data_version):
            write_json(folder / FAILURES_FILE, failures)
        page = write_report(folder)
        point_latest(folder)
        print_leaderboard(board, sort=self.sort, by=self.by)
        print(f"Read {page}. Beside it: {', '.join(sorted(path.name for path in folder.iterdir() if path != page))}.")
        return 0

    def _resolved(self, board: Leaderboard, recordings: Recordings) -> dict[str, Any]:
        """Everything that made the numbers."""
        from importlib.metadata import version

        from mixo_env.recordings.store import DEFAULT_RECORDINGS

        scored = {scene.name for scene in board.recordings.scenes}
        packages = ("mixo-env", "numpy", "torch", "stable-baselines3", "gymnasium")
        return {
            "command": "benchmark",
            "recordings": str(self.recordings or DEFAULT_RECORDINGS),
            "tracks": [standings.track for standings in board.standings],
            "policies": list(board.policies),
            "asked": {"tracks": list(self.tracks), "policies": list(self.policies)},
            "seed": self.seed,
            "seeds": self.seeds,
            "weights": None if self.weights is None else str(self.weights),
            "ground_truth": self.ground_truth,
            "by": list(self.by),
            "sort": self.sort,
            "paper": self.paper,
            "data_version": board.recordings.manifest.data_version,
            "scenes": {scene.name: scene.values_hash for scene in recordings.scenes if scene.name in scored},
            "software": {package: version(package) for package in packages},
        }
