"""Damage tables and CAN bus files at random, then open, judge and load: a report or one MixoError must come.

    python -m experiments.fuzz.folders --inputs 400000

The seed is a simulated scene of three seconds without images. Each input has one file with bytes changed, cut or
inserted, or sound JSON with values, rows or whole columns exchanged. Warnings count as errors.
"""

from __future__ import annotations

import json
import signal
import tempfile
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np
import tyro

from experiments.fuzz.outcome import Outcome
from experiments.fuzz.stores import VALUES
from mixo_env.errors import MixoError
from mixo_env.nuscenes.checks.judge import judge
from mixo_env.nuscenes.index import TABLES, build_index
from mixo_env.nuscenes.tables import Dataset
from mixo_env.recordings.provenance import inputs_hash

CAMERAS = ("CAM_FRONT", "CAM_BACK")
SECONDS = 3
LONGEST_S = 10

_NUMBERS = (
    *b"0 -1 1e308 -1e308 1e309 NaN Infinity 1e19 1e-320 18446744073709551616 4102444800000000 1.5 null true".split(),
    *rb'"" "x" [] {} [[[ "\u0000" "\ud800" "../../x" "/etc/passwd" "\u001b[2J"'.split(),
)
_PIECES = (*b', : [ ] { } " \\ ]} }, \x00 \xff \xef\xbb\xbf \xed\xa0\x80 // NaN'.split(b" "), b"[" * 2000, b" " * 5000)
_FACTORS = (0.0, -1.0, 0.5, 2.0, 3.6, 57.3, 1e3, 1e-3, 1e6, 1e-6, 1e300)


@dataclass(frozen=True)
class Folder:
    """A small folder and its files.

    Attributes:
        root: of the folder.
        version: of its tables.
        files: bytes of every table and message, by path.
        rows: the same as objects.
    """

    root: Path
    version: str
    files: dict[Path, bytes]
    rows: dict[Path, list[dict[str, Any]]]


def small_folder(root: Path) -> Folder:
    """Simulate it."""
    from mixo_env.simulator.config import SimulationConfig
    from mixo_env.simulator.dataset import simulate

    simulate(SimulationConfig(scenes=1, seconds=SECONDS, cameras=CAMERAS, images=False), root)
    version = next(path.parent.name for path in root.glob("*/ego_pose.json"))
    paths = [root / version / f"{table}.json" for table in TABLES] + sorted((root / "can_bus").glob("*.json"))
    files = {path: path.read_bytes() for path in paths}
    return Folder(root, version, files, {path: json.loads(data) for path, data in files.items()})


def fuzz(folder: Folder, inputs: int, seed: int) -> Outcome:
    """Try ``inputs`` damaged files, one at a time.

    Args:
        folder: left as it was.
        inputs: how many.
        seed: of the damage.
    """
    rng, outcome = np.random.default_rng(seed), Outcome()
    tables = [path for path in folder.files if path.parent.name == folder.version]
    messages = [path for path in folder.files if path.parent.name != folder.version]
    sound = build_index(folder.root / folder.version)
    signal.signal(signal.SIGALRM, _stop)
    for _ in range(inputs):
        kind, paths = ("table", tables) if rng.random() < 0.5 else ("message", messages)
        path = paths[int(rng.integers(len(paths)))]
        data = _damaged(rng, folder.files[path]) if rng.random() < 0.4 else _exchanged(rng, folder.rows[path])
        path.write_bytes(data)
        signal.alarm(LONGEST_S)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                index = build_index(folder.root / folder.version) if kind == "table" else sound
                outcome.counts[f"{kind}: {_try(Dataset(folder.root, folder.version, index))}"] += 1
        except MixoError as error:
            outcome.counts[f"{kind}: refused"] += 1
            if "\n" in str(error):
                outcome.faults.append((f"{path.name}: {data[:500]!r}", f"several lines: {error}"))
        except Exception:
            outcome.faults.append((f"{path.name}: {data[:500]!r}", traceback.format_exc()))
        finally:
            signal.alarm(0)
        path.write_bytes(folder.files[path])
    return outcome


def _try(dataset: Dataset) -> str:
    """Judge and load every scene, as the commands do."""
    problems = 0
    for name in dataset.scene_names:
        report = judge(dataset, name, dataset.channels)
        problems += sum(finding.check != "images" for finding in report.problems)
        if not any(finding.check in ("tables", "can-file") for finding in report.problems):
            inputs_hash(dataset.load(name, dataset.channels))
    return "problems" if problems else "sound"


def _stop(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {LONGEST_S} s")


def _damaged(rng: np.random.Generator, data: bytes) -> bytes:
    for _ in range(int(rng.integers(1, 3))):
        i, j = sorted(int(at) for at in rng.integers(len(data) + 1, size=2))
        match int(rng.integers(6)):
            case 0:
                data = data[:i]
            case 1:
                data = data[:i] + data[j:]
            case 2:
                data = data[:i] + _PIECES[int(rng.integers(len(_PIECES)))] + data[i:]
            case 3:
                data = data[:i] + bytes([int(rng.integers(256))]) + data[i + 1 :]
            case _:
                colon = data.find(b":", i) + 1
                end = min((at for at in (data.find(end, colon) for end in (b",", b"}")) if at > 0), default=len(data))
                data = data[:colon] + _NUMBERS[int(rng.integers(len(_NUMBERS)))] + data[end:]
    return data


def _exchanged(rng: np.random.Generator, rows: list[dict[str, Any]]) -> bytes:
    """Sound JSON with other values in one row or in all, or with rows repeated, dropped or exchanged."""
    rows = [dict(row) for row in rows]
    for _ in range(int(rng.integers(1, 3))):
        if not rows:
            break
        i, j = (int(at) for at in rng.integers(len(rows), size=2))
        key = list(rows[i])[int(rng.integers(len(rows[i])))] if rows[i] else ""
        match int(rng.integers(8)):
            case 0:
                del rows[min(i, j) : max(i, j)]
            case 1:
                rows.insert(i, dict(rows[j]))
            case 2:
                rows[i], rows[j] = rows[j], rows[i]
            case 3 if key in rows[j]:
                rows[i][key], rows[j][key] = rows[j][key], rows[i][key]
            case 4:
                rows[i].pop(key, None)
            case 5:
                rows[i][key] = VALUES[int(rng.integers(len(VALUES)))]
            case _:
                factor = _FACTORS[int(rng.integers(len(_FACTORS)))]
                some = rows if rng.random() < 0.6 else rows[i : i + 1]
                for row in some:
                    row[key] = _scaled(row.get(key), factor)
    return json.dumps(rows).encode()


def _scaled(value: Any, factor: float) -> Any:
    """Numbers at any depth times a factor; whole numbers stay whole."""
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    if isinstance(value, list):
        return [_scaled(part, factor) for part in value]
    if isinstance(value, int):
        return int(value * factor) if abs(factor) < 1e9 and abs(value) < 10**300 else value * 10**40
    return value * factor if isinstance(value, float) else value


@dataclass(frozen=True)
class Fuzz:
    """Damage tables and CAN bus files; exit code 1 if anything but a report or one line of error came."""

    inputs: int = 400_000
    """How many."""
    seed: int = 0
    """Of the damage."""

    def run(self) -> int:
        """Print counts and the first faults."""
        with tempfile.TemporaryDirectory() as name:
            outcome = fuzz(small_folder(Path(name) / "data"), self.inputs, self.seed)
        return outcome.report(self.inputs)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(Fuzz).run())
