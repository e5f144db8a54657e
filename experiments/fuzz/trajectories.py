"""Damage trajectory files at random, then read, match, align and score them: a result or a MixoError must come.

    python -m experiments.fuzz.trajectories --inputs 200000

Valid files of every format are the seeds; each input is one of them with one or two mutations of bytes, lines or
numbers. Warnings count as errors: they would stand beside the one line a user is to see.
"""

from __future__ import annotations

import signal
import tempfile
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import numpy as np
import tyro

from experiments.fuzz.outcome import Outcome
from mixo_env.errors import MixoError
from mixo_env.metrics.alignment import ALIGNMENTS, align
from mixo_env.metrics.association import match
from mixo_env.metrics.pairs import PairRule
from mixo_env.scoring.scores import Convention, join, score
from mixo_env.trajectory import Trajectory
from mixo_env.trajectory.formats import TrajectoryFiles, kitti_text, tum_text

POSES = 12
SCORED = 20
"""Every 20th input that can be matched is scored as well."""
LONGEST_S = 10

_NUMBERS = (
    *b"0 1 -1 1e308 -1e308 1e309 nan inf -inf 1e19 1e-320 1e9 1e10 1e5 -0 9223372036854775808".split(),
    *b"0x10 1_0 +.5 5. .5 =".split(),
)
_PIECES = (
    *b", ; \t \r\n \n \r # % \" ' - + @ \x00 \x1b[2J".split(b" "),
    *b"\xef\xbb\xbf \xff\xfe \x1f\x8b \xe2\x80\xa8 \xed\xa0\x80".split(b" "),
    b" ",
    b"\n\n",
)

Mutation = Callable[[np.random.Generator, bytes], bytes]


def seeds() -> list[bytes]:
    """A short drive in every format that is read."""
    k = np.arange(POSES)
    drive = Trajectory.from_planar(4.0 * k, 0.2 * k**2, 0.1 * k, np.asarray(1.7e9 + 0.5 * k, dtype=np.float64))
    tum = np.loadtxt(tum_text(drive).splitlines())
    nano = np.column_stack([np.rint(1e9 * tum[:, 0]), tum[:, 1:4], tum[:, 7], tum[:, 4:7]])
    kitti = np.loadtxt(kitti_text(drive).splitlines())
    matrix = np.column_stack([kitti, np.tile([0, 0, 0, 1], (POSES, 1))])
    heading = "#timestamp,p_x,p_y,p_z,q_w,q_x,q_y,q_z\n"
    texts = [
        _lines(tum, " "),
        "timestamp tx ty tz qx qy qz qw\n" + _lines(tum, " "),
        _lines(tum, ","),
        _lines(np.column_stack([nano[:, 0], tum[:, 1:]]), " "),
        heading + _lines(nano, ","),
        _lines(np.column_stack([nano, np.zeros((POSES, 9))]), ","),
        _lines(np.column_stack([nano, np.zeros((POSES, 3))]), ",").replace("\n", ",\n"),
        _lines(kitti, " "),
        _lines(np.column_stack([k, kitti]), " "),
        _lines(matrix, ";"),
        _lines(np.column_stack([tum[:, 0], matrix]), "\t"),
    ]
    return [text.encode() for text in texts]


def _lines(rows: np.ndarray, separator: str) -> str:
    return "".join(separator.join(f"{value:.17g}" for value in row) + "\n" for row in rows)


def _change_byte(rng: np.random.Generator, data: bytes) -> bytes:
    i = int(rng.integers(len(data)))
    return data[:i] + bytes([int(rng.integers(256))]) + data[i + 1 :]


def _cut(rng: np.random.Generator, data: bytes) -> bytes:
    i, j = sorted(int(x) for x in rng.integers(len(data) + 1, size=2))
    return data[:i] + data[j:] if rng.random() < 0.5 else data[:i]


def _insert(rng: np.random.Generator, data: bytes) -> bytes:
    i = int(rng.integers(len(data) + 1))
    return data[:i] + _PIECES[int(rng.integers(len(_PIECES)))] + data[i:]


def _replace_number(rng: np.random.Generator, data: bytes) -> bytes:
    words = data.split(b" ") if b" " in data else data.split(b",")
    words[int(rng.integers(len(words)))] = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    return (b" " if b" " in data else b",").join(words)


def _replace_column(rng: np.random.Generator, data: bytes) -> bytes:
    """One column constant, scaled or dropped: standing truths, foreign units, other formats."""
    separator = b"," if b"," in data else b" "
    rows = [line.split(separator) for line in data.split(b"\n") if line]
    column, kind = int(rng.integers(8)), int(rng.integers(3))
    value = _NUMBERS[int(rng.integers(len(_NUMBERS)))]
    for row in rows:
        if column < len(row):
            row[column : column + 1] = [[value], [row[column] + b"e9"], []][kind]
    return b"\n".join(separator.join(row) for row in rows) + b"\n"


def _move_lines(rng: np.random.Generator, data: bytes) -> bytes:
    lines = data.split(b"\n")
    i, j = (int(x) for x in rng.integers(len(lines), size=2))
    lines[i] = lines[j] if rng.random() < 0.5 else lines[i] + lines[j]
    return b"\n".join(lines)


def _encode(rng: np.random.Generator, data: bytes) -> bytes:
    codec = ("utf-16", "utf-16-le", "utf-32", "utf-8-sig")[int(rng.integers(4))]
    return data.decode("latin-1").encode(codec)


MUTATIONS: tuple[Mutation, ...] = (
    *(_change_byte, _cut, _insert, _insert, _replace_number, _replace_number, _replace_number),
    *(_replace_column, _replace_column, _move_lines),
)


def damaged(rng: np.random.Generator, data: bytes) -> bytes:
    """A seed with one or two mutations; now and then in another encoding."""
    for _ in range(int(rng.integers(1, 3))):
        data = MUTATIONS[int(rng.integers(len(MUTATIONS)))](rng, data or b"0")
    return _encode(rng, data) if rng.random() < 0.01 else data


def fuzz(inputs: int, seed: int, folder: Path) -> Outcome:
    """Try ``inputs`` damaged files.

    Args:
        inputs: how many.
        seed: of the damage.
        folder: for the files.
    """
    rng = np.random.default_rng(seed)
    texts = seeds()
    truths = []
    for k, text in enumerate(texts):
        path = folder / f"truth-{k}"
        path.write_bytes(text)
        truths.append(TrajectoryFiles().read(path))
    outcome = Outcome()
    path = folder / "damaged"
    signal.signal(signal.SIGALRM, _stop)
    for n in range(inputs):
        k = int(rng.integers(len(texts)))
        data = damaged(rng, texts[k])
        path.write_bytes(data)
        signal.alarm(LONGEST_S)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                outcome.counts[_try(path, truths[k], scored=n % SCORED == 0, swap=bool(n % 2))] += 1
        except MixoError as error:
            outcome.counts["refused"] += 1
            if "\n" in str(error) and str(path) in str(error):
                outcome.faults.append((repr(data[:2000]), f"several lines: {error}"))
        except Exception:
            outcome.faults.append((repr(data[:2000]), traceback.format_exc()))
        finally:
            signal.alarm(0)
    return outcome


def _try(path: Path, truth: Trajectory, *, scored: bool, swap: bool) -> str:
    read = TrajectoryFiles().read(path)
    pair = match(read, truth) if swap else match(truth, read)
    for method in ALIGNMENTS:
        try:
            align(*pair, method).apply(pair[1])
        except MixoError:
            if method != "sim3":
                raise
    if not scored:
        return "aligned"
    score(join("fuzz", {"scene": pair}), Convention(pair_rule=PairRule((5.0, 10.0)))).as_numbers()
    return "scored"


def _stop(_number: int, _frame: FrameType | None) -> None:
    raise TimeoutError(f"more than {LONGEST_S} s")


@dataclass(frozen=True)
class Fuzz:
    """Damage trajectory files at random; exit code 1 if anything but a result or one line of error came."""

    inputs: int = 200_000
    """How many."""
    seed: int = 0
    """Of the damage."""

    def run(self) -> int:
        """Print counts and the first faults."""
        with tempfile.TemporaryDirectory() as folder:
            outcome = fuzz(self.inputs, self.seed, Path(folder))
        return outcome.report(self.inputs)


if __name__ == "__main__":
    raise SystemExit(tyro.cli(Fuzz).run())
