"""Weights by manoeuvre."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs._pages.manoeuvres_page import page
from experiments.manoeuvres import TOLD, Finding, main, study, table, told
from mixo_env.fusion import mix
from mixo_env.leaderboard.crossvalidation import CrossValidation
from mixo_env.leaderboard.manoeuvres import MANOEUVRES, manoeuvre_of, played_weights, preference
from mixo_env.leaderboard.paper.weights import draw_by_manoeuvre
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from mixo_env.recordings.substitutes import substituted_increments
from tests.synthetic import synthetic_recordings

STRAIGHT, LEFT, RIGHT, STANDING = range(4)


@pytest.fixture(scope="module")
def recordings() -> Recordings:
    return synthetic_recordings(0, scenes=8, steps=120)


@pytest.fixture(scope="module")
def findings(recordings: Recordings) -> list[Finding]:
    return study(recordings, "PAPER", ("LINEAR", "HUBER"))


def test_manoeuvres_by_hand() -> None:
    """Steps of .1 s: 1 m straight, 1 m and .006 rad left, 1 m and .006 rad right, 1 cm, 1 m and .004 rad."""
    some = synthetic_recordings(0, scenes=1, steps=60)
    rows = len(some["step"])
    turn, way = np.zeros(rows), np.ones(rows)
    turn[1:6], way[1:6] = [0.0, 0.006, -0.006, 0.006, 0.004], [1.0, 1.0, 1.0, 0.01, 1.0]
    yaw = np.cumsum(turn)
    middle = yaw - 0.5 * turn
    way[0] = 0.0
    x, y = np.cumsum(way * np.cos(middle)), np.cumsum(way * np.sin(middle))
    dt_s = np.full(rows, 0.1)
    dt_s[0] = 0.0
    truth = {f"exact.{name}": values for name, values in (("x_m", x), ("y_m", y), ("yaw_rad", yaw))}
    made = some.replace(columns={**truth, "dt_s": dt_s})
    assert manoeuvre_of(made)[:6].tolist() == [STANDING, STRAIGHT, LEFT, RIGHT, STANDING, STRAIGHT]


@pytest.mark.parametrize("name", ["LINEAR", "HUBER", "MULTICAMERA GT"])
def test_weights_are_those_that_moved_the_car(recordings: Recordings, name: str) -> None:
    protocol = CrossValidation(recordings)
    run = protocol.run(name, "PAPER")
    weights = played_weights(protocol, run, "PAPER")
    rows = np.isfinite(run.travel.yaw_increment_rad)
    np.testing.assert_array_equal(np.isfinite(weights).all(axis=1), rows)
    fused = mix(weights, substituted_increments(protocol.recordings, "PAPER"))
    np.testing.assert_allclose(fused[rows], run.travel.yaw_increment_rad[rows], atol=1e-12)


def test_means_and_errors_are_those_of_plain_loops(recordings: Recordings) -> None:
    rng = np.random.default_rng(1)
    rows, experts = len(recordings["step"]), recordings.voters("PAPER")
    weights, error = rng.random((rows, 5)), rng.normal(size=rows)
    weights[7], error[8] = np.nan, np.nan
    found = preference("X", weights, error, recordings, "PAPER")
    manoeuvre = manoeuvre_of(recordings)
    for k in range(len(MANOEUVRES)):
        kept = [
            i
            for i in range(rows)
            if manoeuvre[i] == k
            and i not in (7, 8)
            and all(np.isfinite(recordings[f"{expert}.yaw_increment_rad"][i]) for expert in experts)
        ]
        assert found.steps[k] == len(kept)
        if kept:
            np.testing.assert_allclose(found.mean[k], weights[kept].mean(axis=0))
            assert found.rms_deg[k] == pytest.approx(np.degrees(np.sqrt(np.mean(error[kept] ** 2))))


def test_a_gate_that_prefers_by_manoeuvre_is_told_from_one_that_does_not(recordings: Recordings) -> None:
    """The first gives CAM_BACK .2 more in left turns, the other only differs from log to log."""
    rng = np.random.default_rng(2)
    manoeuvre = manoeuvre_of(recordings)
    logs = [scene.log for scene in recordings.scenes]
    of_log = {log: rng.uniform(0.1, 0.3) for log in sorted(set(logs))}
    back = np.repeat([of_log[log] for log in logs], np.diff(recordings.offsets))
    error = np.zeros(len(back))

    def weights(back: np.ndarray) -> np.ndarray:
        return np.stack([1.0 - back, 0.0 * back, back, 0.0 * back, 0.0 * back], axis=1)

    gate = preference("G", weights(back + 0.2 * (manoeuvre == LEFT)), error, recordings, "PAPER")
    constant = preference("C", weights(back), error, recordings, "PAPER")
    assert gate.changed[LEFT].tolist() == [True, False, True, False, False]
    assert gate.change[0, LEFT, 2] == pytest.approx(0.2, abs=0.03)
    assert not gate.changed[RIGHT].any()
    assert not constant.changed.any()


def test_interval_of_a_change_is_that_of_redrawn_logs(recordings: Recordings) -> None:
    rng = np.random.default_rng(4)
    weights = rng.random((len(recordings["step"]), 5)) ** 2
    found = preference("X", weights, np.zeros(len(weights)), recordings, "PAPER")
    experts = recordings.voters("PAPER")
    given = np.all([np.isfinite(recordings[f"{e}.yaw_increment_rad"]) for e in experts], axis=0)
    manoeuvre, names = manoeuvre_of(recordings), sorted({scene.log for scene in recordings.scenes})
    log = np.repeat([names.index(scene.log) for scene in recordings.scenes], np.diff(recordings.offsets))
    drawn = []
    for _ in range(3000):
        rows = np.concatenate([np.flatnonzero(given & (log == g)) for g in rng.integers(0, len(names), len(names))])
        left, straight = (weights[rows[manoeuvre[rows] == k], 0].mean() for k in (LEFT, STRAIGHT))
        drawn.append(left - straight)
    np.testing.assert_allclose(found.change[1:, LEFT, 0], np.quantile(drawn, [0.025, 0.975]), atol=0.004)


def test_constant_weights_by_manoeuvre_find_who_is_right_when(recordings: Recordings) -> None:
    """CAM_FRONT is exact on straight road, CAM_BACK in turns; each is poor elsewhere."""
    manoeuvre, turn = manoeuvre_of(recordings), recordings["truth.yaw_increment_rad"]
    rng = np.random.default_rng(0)
    columns = {}
    for expert in recordings.voters("PAPER"):
        right = {"CAM_FRONT": manoeuvre == STRAIGHT, "CAM_BACK": np.isin(manoeuvre, [LEFT, RIGHT])}.get(expert, False)
        noise = np.where(right, 1e-6, 3e-3) * rng.standard_normal(len(turn))
        columns[f"{expert}.yaw_increment_rad"] = (turn + noise).astype(np.float32)
    vehicles = dict.fromkeys(recordings.manifest.vehicles, next(iter(recordings.manifest.vehicles.values())))
    made = recordings.replace(replace(recordings.manifest, vehicles=vehicles), columns)
    found = told(CrossValidation(made), "PAPER").preference
    assert found.row == TOLD
    assert found.mean[STRAIGHT, 0] == pytest.approx(1.0, abs=0.01)
    assert found.mean[LEFT, 2] == pytest.approx(1.0, abs=0.01)
    assert found.mean[RIGHT, 2] == pytest.approx(1.0, abs=0.01)


def test_page_table_and_figure(findings: list[Finding], tmp_path) -> None:
    names = [finding.preference.row for finding in findings]
    assert names == ["LINEAR", "HUBER", "MULTICAMERA GT †", TOLD]
    assert all(np.isfinite(finding.deg_per_m) for finding in findings)
    assert len(table(findings, "x").rows[0]) == 3 + 4 * 5 + 2
    draw_by_manoeuvre([finding.preference for finding in findings], tmp_path / "weights.png")
    assert (tmp_path / "weights.png").read_bytes().startswith(b"\x89PNG")
    one = findings[0]
    named = (replace(one, preference=replace(one.preference, row=name)) for name in ("MIXO", "TOKEN", "TRIO"))
    text = page([*findings, *named])
    assert f"| {TOLD} | straight |" in text


def test_command_line(recordings: Recordings, tmp_path, capsys, caplog) -> None:
    save_recordings(recordings, tmp_path / "some")
    assert main(["--recordings", str(tmp_path / "some"), "--rows", "LINEAR", "--track", "VISION"]) == 0
    assert "MULTICAMERA GT" in capsys.readouterr().out
    assert main(["--recordings", str(tmp_path / "some"), "--rows", "NOBODY"]) == 1
    assert "NOBODY" in caplog.text
