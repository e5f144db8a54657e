"""The figure of `make coverage` counts branches alone, and too few of them fail the run."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent


@pytest.mark.parametrize(("covered", "code"), [(95, 0), (94, 1), (0, 1)])
def test_too_few_branches_fail_however_many_lines_are_covered(covered: int, code: int, tmp_path: Path) -> None:
    report = tmp_path / "coverage.json"
    totals = {"covered_branches": covered, "num_branches": 100, "covered_lines": 10_000, "percent_covered": 99.9}
    report.write_text(json.dumps({"totals": totals}), encoding="utf-8")
    command = [sys.executable, str(ROOT / ".ci" / "branches"), str(report), "95"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code, done.stderr
    assert done.stdout == f"branches: {covered}.00 % of 100 are covered; at least 95 % should be\n"


def test_a_compiled_function_reads_and_writes_rows_as_plain_python() -> None:
    """By hand: 2 + 3, written where the caller sees it."""
    code = """
import numpy as np
from mixo_env.compiled import compiled

@compiled
def add(rows, by):
    for i in range(rows.size):
        row = rows[i]
        row.x += by

rows = np.zeros(2, [("x", float), ("n", int)])
rows["x"] = 2.0
add(rows, by=3.0)
print(rows["x"].tolist(), type(rows).__name__, add.__name__)
"""
    environment = os.environ | {"NUMBA_DISABLE_JIT": "1"}
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.stdout == "[5.0, 5.0] ndarray add\n", done.stderr
