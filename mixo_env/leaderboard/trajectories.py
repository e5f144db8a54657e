"""Out again: the truth, every expert and any policy's fused trajectory as files, scene by scene.

They are what the leaderboard scores, so ``mixo evaluate`` finds its numbers in them.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from mixo_env.errors import ConfigurationError
from mixo_env.files import atomic_path
from mixo_env.leaderboard.board import Leaderboard, choose, shown_in
from mixo_env.leaderboard.crossvalidation import CrossValidation, Run, Trial
from mixo_env.leaderboard.evaluation import FLOORS, Truth, poses
from mixo_env.policies.agent import Frozen
from mixo_env.policies.fitting import check
from mixo_env.policies.outside import Outside, Reading, resolve
from mixo_env.policies.policy import Policy
from mixo_env.policies.registry import names as policy_names
from mixo_env.recordings.collection import Recordings
from mixo_env.trajectory import Trajectory, write_kitti, write_tum
from mixo_env.trajectory.axes import BODY_AXES
from mixo_env.trajectory.formats import tum_text
from mixo_env.trajectory.planar import PlanarPoses

Format = Literal["tum", "kitti"]

GROUNDTRUTH = "groundtruth"

DECIMALS = 7
"""Of metres and quaternions in the zip of all rows, far below what any row errs by; all digits take twice the room."""


@dataclass(frozen=True)
class Way:
    """One row's way through one scene.

    Attributes:
        row: name of the policy, expert or floor; ``groundtruth``.
        scene: its name.
        trajectory: planar, x forward, y left, z up, with Unix times.
    """

    row: str
    scene: str
    trajectory: Trajectory


def chosen(
    given: Sequence[str], recordings: Recordings, reading: Reading, fitted_on: frozenset[str] | None = None
) -> tuple[Outside, ...]:
    """What texts mean: rows of the leaderboard however they are spelt, then policies from outside.

    Args:
        given: names, or what :func:`mixo_env.policies.outside.resolve` takes.
        recordings: for the names of their experts.
        reading: how those from outside are read.
        fitted_on: hashes of the drives that frozen ones were trained on.

    Raises:
        ConfigurationError: for text that means nothing, or two policies of one name.
        PolicyError: for a policy that cannot be made or read.
    """
    rows = (*policy_names(recordings), *FLOORS)
    plain = {_plain(row) for row in rows}
    known = [text for text in given if _plain(text) in plain or not _looks_foreign(text)]
    found = [Outside(name, Policy, builtin=True) for name in (choose(known, rows) if known else ())]
    found += [resolve(text, recordings, reading, fitted_on) for text in given if text not in known]
    names = [folder_name(policy.name).casefold() for policy in found]
    if repeated := next((name for name in names if names.count(name) > 1), None):
        raise ConfigurationError(f"two of the policies would be written to {repeated}: export them one by one")
    return tuple(found)


def _plain(name: str) -> str:
    return name.casefold().replace("-", " ").replace("_", " ")


def _looks_foreign(text: str) -> bool:
    """Whether text means a class, a function, a zip or a folder rather than a misspelt row."""
    return ":" in text or text.endswith(".zip") or Path(text).is_dir()


def ways(
    recordings: Recordings,
    track: str,
    policies: Sequence[Outside] = (),
    *,
    folds: Sequence[int] = (),
    seed: int = 0,
    progress: Callable[[str], None] = lambda _: None,
) -> Iterator[Way]:
    """The truth of the headline, every expert alone, then policies; a scene on which a row was not tested is left out.

    Args:
        recordings: scenes; policies that learn are fitted on the folds that hold none of them.
        track: whose experts vote.
        policies: rows of the leaderboard, or from outside (:func:`chosen`).
        folds: scenes of these only; empty: all.
        seed: of learned policies.
        progress: told what is about to run.

    Raises:
        ConfigurationError: for an unknown track or fold.
        PolicyError: when a policy does not fit the recordings.
    """
    protocol = divided(recordings, track, policies, folds=folds, seed=seed)
    truth = Truth(protocol.recordings, protocol.truths[0])
    everywhere = np.ones(len(protocol.recordings), np.bool_)
    yield from _scenes(GROUNDTRUTH, truth.poses, everywhere, protocol.recordings)
    for run in runs(protocol, track, policies, progress):
        yield from _scenes(run.name, poses(run.travel, truth.poses, truth.offsets), run.tested, protocol.recordings)


def divided(
    recordings: Recordings,
    track: str,
    policies: Sequence[Outside],
    *,
    folds: Sequence[int] = (),
    seed: int = 0,
    out_of_distribution: bool = False,
) -> CrossValidation:
    """Training and test scenes for :func:`runs`; what does not fit is said before anything is played.

    Raises:
        ConfigurationError: for an unknown track or fold.
        PolicyError: when a frozen policy does not fit the recordings.
    """
    voters = recordings.voters(track)
    outside = {policy.name: policy.kind for policy in policies if not policy.builtin}
    protocol = CrossValidation(
        recordings, Trial(seed, outside=outside), out_of_distribution=out_of_distribution, tested_folds=folds
    )
    for kind in outside.values():
        if isinstance(kind, Frozen):
            kind.start(voters)
            check(kind, protocol.recordings, track)
    return protocol


def runs(
    protocol: CrossValidation, track: str, policies: Sequence[Outside], progress: Callable[[str], None]
) -> Iterator[Run]:
    """Every expert alone, then policies; an expensive one on the last of the tested folds."""
    recordings = protocol.recordings
    for name in dict.fromkeys(
        (*shown_in(recordings, track, recordings.experts), *(policy.name for policy in policies))
    ):
        progress(name)
        yield protocol.run(name, track, folds=protocol.tested_folds[-1:] if protocol.expensive(name) else None)


def write_way(folder: Path, way: Way, form: Format) -> Path:
    """Write one way to ``folder/row/scene.txt`` and return that path; KITTI files are in camera axes, without times."""
    path = folder / folder_name(way.row) / f"{way.scene}.txt"
    path.parent.mkdir(parents=True, exist_ok=True)
    if form == "tum":
        write_tum(path, way.trajectory)
    else:
        write_kitti(path, _in_camera_axes(way.trajectory))
    return path


def write_all(board: Leaderboard, path: Path) -> None:
    """Write the truth's and every row's way through every scene it was tested on: ``TRACK/ROW/SCENE.txt``, in one zip.

    A zip, because a benchmark has ten thousand of them; the same numbers make the same bytes.
    """
    truth = board.truths[board.headline]
    everywhere = np.ones(len(board.recordings), np.bool_)
    texts: dict[bytes, list[tuple[str, str]]] = {}
    with (
        atomic_path(path) as part,
        zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        ThreadPoolExecutor(1) as pool,  # compresses one row while the next is put into words
    ):

        def write(folder: str, found: Sequence[tuple[str, str]]) -> None:
            for scene, text in found:
                archive.writestr(zipfile.ZipInfo(f"{folder}/{scene}.txt"), text, zipfile.ZIP_DEFLATED, 1)

        def add(folder: str, name: str, way: PlanarPoses, tested: np.ndarray) -> Future[None]:
            """One row; single experts and floors go the same way in several tracks."""
            key = way.x_m.tobytes() + way.yaw_rad.tobytes() + tested.tobytes()
            if key not in texts:
                texts[key] = [
                    (one.scene, tum_text(one.trajectory, DECIMALS))
                    for one in _scenes(name, way, tested, board.recordings)
                ]
            return pool.submit(write, folder + folder_name(name), texts[key])

        written = [add("", GROUNDTRUTH, truth.poses, everywhere)]
        for standings in board.standings:
            for row in {row.name: row for row in (*standings.one_fold_rows, *standings.rows)}.values():
                way = poses(row.run.travel, truth.poses, truth.offsets)
                written.append(add(f"{standings.track}/", row.name, way, row.run.tested))
        for one in written:
            one.result()  # raises what writing raised


def folder_name(row: str) -> str:
    """Name of the folder of a row: blanks and what a file's name cannot hold become underscores."""
    return re.sub(r"[^\w+-]+", "_", row).strip("_")


def _scenes(row: str, way: PlanarPoses, tested: np.ndarray, recordings: Recordings) -> Iterator[Way]:
    times_s = 1e-6 * recordings["timestamp_us"]
    for i in np.flatnonzero(tested):
        rows = slice(*recordings.offsets[i : i + 2])
        planar = Trajectory.from_planar(way.x_m[rows], way.y_m[rows], way.yaw_rad[rows], times_s[rows])
        yield Way(row, recordings.scenes[i].name, planar)


def _in_camera_axes(trajectory: Trajectory) -> Trajectory:
    """The same motion with body and world x right, y down, z forward."""
    axes = np.eye(4)
    axes[:3, :3] = np.array(BODY_AXES["camera"], dtype=np.float64).T
    turned = Trajectory.from_matrices(axes @ trajectory.matrices() @ axes.T, trajectory.timestamps_s)
    return replace(turned, camera_axes=True)
