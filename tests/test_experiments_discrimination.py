"""Orders of rows by halves of the logs and by a few scenes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from experiments.discrimination import Discrimination, Errors, chosen, read_errors
from mixo_env.errors import ConfigurationError

HEAD = "track,policy,privileged,truth,scene,log,fold,rte_deg_per_m,rte_samples\n"


def results(folder: Path, lines: list[str]) -> Path:
    (folder / "scenes.csv").write_text(HEAD + "".join(f"{line}\n" for line in lines))
    return folder


def lines_of(policy: str, errors: list[float], *, privileged: int = 0, truth: str = "exact") -> list[str]:
    return [f"VISION,{policy},{privileged},{truth},s{i},log{i // 2},{i % 4},{e},{i + 1}" for i, e in enumerate(errors)]


def test_errors_of_rows_without_the_truth_are_pooled_by_pieces_of_path(tmp_path: Path) -> None:
    lines = [line for i in range(4) for line in lines_of(f"ROW{i}", [0.1 * (i + 1), 0.2, 0.3, 0.4])]
    lines += lines_of("ORACLE", [0.0] * 4, privileged=1) + lines_of("ROW0", [9.0] * 4, truth="written")
    lines += [*lines_of("HALF", [0.1, 0.1]), "VISION,ROW0,0,exact,night,log9,-1,5.0,7"]
    errors = read_errors(results(tmp_path, lines), "VISION")
    assert errors.rows == ("ROW0", "ROW1", "ROW2", "ROW3")
    assert errors.scenes == ("s0", "s1", "s2", "s3")
    assert errors.log.tolist() == [0, 0, 1, 1]
    # (0.1 x 1 + 0.2 x 2) / 3 and (0.3 x 3 + 0.4 x 4) / 7
    assert errors.pooled(errors.of_logs(np.array([0])))[0] == pytest.approx(0.5 / 3)
    assert errors.pooled(np.array([2, 3]))[0] == pytest.approx(2.5 / 7)


def test_the_scenes_chosen_are_those_that_are_like_all() -> None:
    """Two scenes are the mean of all, the others are far on either side."""
    total = np.array([[1.0, 4.0, 2.0, 0.25, 2.0], [2.0, 1.0, 1.0, 1.0, 1.0], [3.0, 0.5, 1.5, 1.0, 1.5]])
    total[:, [2, 4]] = total[:, [0, 1, 3]].mean(axis=1)[:, None]
    errors = Errors(("A", "B", "C"), tuple("vwxyz"), np.arange(5), total, np.ones(5))
    assert sorted(chosen(errors, np.arange(5), np.arange(3), 2).tolist()) == [2, 4]
    assert len(chosen(errors, np.array([0, 1]), np.arange(3), 20)) == 2


def test_scenes_without_a_piece_of_path_are_never_chosen() -> None:
    errors = Errors(("A", "B"), ("x", "y"), np.arange(2), np.array([[1.0, 0.0], [2.0, 0.0]]), np.array([4.0, 0.0]))
    assert chosen(errors, np.arange(2), np.arange(2), 2).tolist() == [0]


def test_rows_that_keep_their_order_in_every_scene_have_tau_1(tmp_path: Path) -> None:
    random = np.random.default_rng(0)
    scene = random.uniform(0.5, 2.0, 24)
    lines = [line for i in range(8) for line in lines_of(f"ROW{i}", (scene * 1.5**i).tolist())]
    table = Discrimination(results(tmp_path, lines), ("VISION",), count=3, splits=5).run()
    assert table.rows[0] == ["VISION", 8, 12, *[pytest.approx(1.0)] * 6]


def test_without_results_or_rows_it_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match="mixo benchmark --out"):
        read_errors(tmp_path, "VISION")
    with pytest.raises(ConfigurationError, match="at least four rows of track VISION, got 1"):
        read_errors(results(tmp_path, lines_of("ROW", [0.1])), "VISION")
