"""Kill recording at random moments, again and again: no scene may be lost, and the end must be that of a quiet run.

    python -m experiments.kill_record ROOT --kills 200

Half of the trials begin with an empty folder, half with a recording of the first scene. Each is killed (SIGKILL) up to
``KILLS`` times at random moments and then left to finish. Half of the moments are counted from the claim of the folder,
half from the first byte of the finished recording: the files that must change together change then.
"""

from __future__ import annotations

import multiprocessing
import random
import shutil
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import tyro

from mixo_env.recordings.folder import LOCK_FILE
from mixo_env.recordings.record import RecordConfig, record
from mixo_env.recordings.store import MANIFEST_FILE, NEXT_FILE, RECORDINGS_FILE, load_recordings

KILLS = 4
"""In a row, of one trial."""

LAST_S = 0.03
"""From the first byte of the finished recording to the end of a run, or more."""

Run = Callable[[Path, tuple[str, ...]], object]
"""Records some scenes (none named: all) into a folder."""


@dataclass(frozen=True)
class Outcome:
    """What became of the trials.

    Attributes:
        kills: that hit a running process.
        commits: of them, those after which more scenes were in the recording than before.
        faults: one line for each scene lost, recording unreadable or result that differs.
    """

    kills: int
    commits: int
    faults: list[str]


def torment(run: Run, first: str, kills: int, seed: int, folder: Path) -> Outcome:
    """Kill ``run`` until ``kills`` have hit.

    Args:
        run: the recording; called in forked processes.
        first: scene that half of the trials hold from the beginning.
        kills: how many.
        seed: of the moments.
        folder: for the recordings.
    """
    chance = random.Random(seed)
    start, quiet = folder / "start", folder / "quiet"
    run(start, (first,))
    began = time.monotonic()
    run(quiet, ())
    longest = 1.2 * (time.monotonic() - began)
    hit, commits, faults = 0, 0, []
    trial = 0
    while hit < kills:
        out, trial = folder / f"trial-{trial}", trial + 1
        if trial % 2:
            shutil.copytree(start, out)
        held = _scenes(out, faults)
        for _ in range(min(KILLS, kills - hit)):
            moment = (LOCK_FILE, longest) if chance.random() < 0.5 else (NEXT_FILE, LAST_S)
            if not _killed(run, out, moment[0], chance.uniform(0.0, moment[1])):
                break
            hit += 1
            now = _scenes(out, faults)
            faults += [f"{out.name}: {scene} is lost" for scene in sorted(held - now)]
            commits += now > held
            held = now
        run(out, ())
        for name in (RECORDINGS_FILE, MANIFEST_FILE):
            if (out / name).read_bytes() != (quiet / name).read_bytes():
                faults.append(f"{out.name}: {name} differs from that of a quiet run")
        if {path.name for path in out.iterdir()} != {path.name for path in quiet.iterdir()}:
            faults.append(f"{out.name}: other files than after a quiet run")
        shutil.rmtree(out)
    return Outcome(hit, commits, faults)


def _killed(run: Run, out: Path, sign: str, after_s: float) -> bool:
    """Start a run and kill it so long after a file appeared; ``False`` if it was faster."""
    child = multiprocessing.get_context("fork").Process(target=run, args=(out, ()))
    (out / LOCK_FILE).unlink(missing_ok=True)  # of the one killed before
    child.start()
    while child.is_alive() and not ((out / LOCK_FILE).exists() and (out / sign).exists()):
        time.sleep(2e-4)
    child.join(after_s)
    alive = child.is_alive()
    child.kill()
    child.join()
    return alive


def _scenes(out: Path, faults: list[str]) -> set[str]:
    """Scenes of the recording as it was left."""
    if not (out / MANIFEST_FILE).exists():
        return set()
    try:
        return {scene.name for scene in load_recordings(out).scenes}
    except Exception as error:
        faults.append(f"{out.name}: {error!r}")
        return set()


@dataclass(frozen=True)
class KillRecord:
    """Kill `mixo record` at random moments; exit code 1 if anything was lost or differs."""

    root: tyro.conf.Positional[Path]
    """A small nuScenes folder of two scenes or more, e.g. of `mixo simulate`."""
    kills: int = 200
    """How many."""
    seed: int = 0
    """Of the moments."""
    workers: int = 1
    """Of every recording."""

    def run(self) -> int:
        """Print counts and faults."""
        from mixo_env.nuscenes.tables import open_dataset

        dataset = open_dataset(self.root)

        def run(out: Path, scenes: tuple[str, ...]) -> None:
            record(dataset, RecordConfig(cameras=("CAM_FRONT",), scenes=scenes), out, self.workers)

        with tempfile.TemporaryDirectory() as folder:
            outcome = torment(run, dataset.scene_names[0], self.kills, self.seed, Path(folder))
        print(f"{outcome.kills} kills ({outcome.commits} after the commit), {len(outcome.faults)} faults")
        print(*outcome.faults[:20], sep="\n")
        return int(bool(outcome.faults))


if __name__ == "__main__":
    raise SystemExit(tyro.cli(KillRecord).run())
