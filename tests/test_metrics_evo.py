"""Agreement with evo where definitions coincide: dense starts, tolerance 0.2, pairs taken from the truth."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import numpy as np
import pytest

from experiments.peers.evo_client import evo_python, evo_scores
from mixo_env.metrics.aggregate import per_length, statistics
from mixo_env.metrics.pairs import PairRule
from mixo_env.scoring.evo_results import write_evo_result
from mixo_env.scoring.scores import Convention, join, score
from mixo_env.trajectory import Trajectory, read_trajectory, write_kitti, write_tum
from tests.trajectories import disturbed, drive, moved, random_rotation

pytestmark = pytest.mark.integration

LENGTHS = (10.0, 20.0, 50.0, 100.0)
RULE = PairRule(LENGTHS, tolerance=0.2, min_start_spacing_m=0.0)
STATISTICS = ("rmse", "mean", "median", "std", "max")
ALIGNMENTS = {"none": Convention(pair_rule=RULE), "origin": Convention("se3", 1, pair_rule=RULE)}
ALIGNMENTS |= {align: Convention(align, pair_rule=RULE) for align in ("se3", "sim3")}


@pytest.fixture(scope="session")
def evo() -> Path:
    """evo's interpreter; the tests skip when pip cannot install it."""
    python = evo_python()
    if python is None:
        pytest.skip("evo cannot be installed here")
    return python


def estimates() -> list[Path]:
    """Every real estimate that lies beside a ground truth."""
    root = os.environ.get("MIXO_REAL_DATA")
    folder = Path(root) / "vo_estimates" if root else None
    return sorted(path for path in folder.glob("*/*/*.txt") if path.stem != "GT") if folder else []


def compare(evo: Path, tmp_path: Path, truth: Trajectory, estimate: Trajectory, align: str) -> None:
    write_tum(tmp_path / "gt.txt", truth)
    write_tum(tmp_path / "est.txt", estimate)
    theirs = evo_scores(evo, [(tmp_path / "gt.txt", tmp_path / "est.txt")], LENGTHS, align)["scores"][0]
    ours = score(join("estimate", {"scene": (truth, estimate)}), ALIGNMENTS[align])
    for name, errors in (("translation", ours.absolute.translation_m), ("rotation", ours.absolute.rotation_deg)):
        result = statistics(errors)
        for key in STATISTICS:
            assert getattr(result, key) == pytest.approx(theirs["absolute"][name][key], abs=1e-6), (align, name, key)
    for found in per_length(ours.relative):
        reference = theirs["relative"].get(str(found.length_m), {})
        assert found.samples == reference.get("translation", {}).get("count", 0)
        for name, result in (("translation", found.translation_m), ("rotation", found.rotation_deg)):
            for key in STATISTICS if found.samples else ():
                assert getattr(result, key) == pytest.approx(reference[name][key], abs=1e-6), (
                    found.length_m,
                    name,
                    key,
                )


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("path", estimates(), ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_real_estimates(evo, tmp_path, path, align):
    times = 0.1 * np.arange(2000)
    truth, estimate = (read_trajectory(file) for file in (path.with_name("GT.txt"), path))
    truth, estimate = (
        Trajectory(one.positions_m, one.quaternions_wxyz, times[: len(one)]) for one in (truth, estimate)
    )
    compare(evo, tmp_path, truth, estimate, align)


@pytest.mark.parametrize("align", ALIGNMENTS)
@pytest.mark.parametrize("seed", range(3))
def test_synthetic_estimates(evo, tmp_path, seed, align):
    rng = np.random.default_rng(seed)
    truth = drive(rng, 240, stop=seed == 1, gap=seed == 2)
    estimate = moved(disturbed(rng, truth, scale=0.9), random_rotation(rng), rng.standard_normal(3))
    compare(evo, tmp_path, truth, estimate, align)


@pytest.mark.parametrize("timed", [True, False])
def test_evo_opens_our_result_files(evo, tmp_path, timed):
    rng = np.random.default_rng(0)
    truth = drive(rng)
    if not timed:
        truth = Trajectory(truth.positions_m, truth.quaternions_wxyz)
        write_kitti(tmp_path / "gt.txt", truth)
    methods = [score(join(name, {"scene": (truth, disturbed(rng, truth))}), Convention()) for name in ("orb", "mixo")]
    files = []
    for method in methods:
        files.append(tmp_path / f"{method.name}.zip")
        write_evo_result(files[-1], method, 0, Convention().alignment_words())
    command = [evo.with_name("evo_res"), *files, "--save_table", tmp_path / "table.json", "--no_warnings"]
    environment = {**os.environ, "HOME": str(tmp_path)}
    run = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False, env=environment)
    assert run.returncode == 0, run.stderr
    assert "orb" in run.stdout
    table = (tmp_path / "table.json").read_text()
    for method in methods:
        assert f"{statistics(method.absolute.translation_m).rmse:.6f}"[:-1] in run.stdout + table
    assert json.dumps(table)
