"""What comes with the project of the failure suite: its matrix, and a few scenes beside the tests."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

from experiments.failures import KINDS, SAMPLED, Failures
from experiments.failures_table import INSTANT, TRACK, check_experts
from mixo_env.leaderboard.conditions import SITUATIONS
from mixo_env.leaderboard.results import shipped_failures
from mixo_env.policies.registry import POLICIES, kind, names
from mixo_env.recordings.camera_faults import CAMERA_FAULTS
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.joint import JOINT
from mixo_env.recordings.store import load_recordings
from tests.bundle import bundled

HERE = Path(__file__).parent / "data" / "failures"


@pytest.fixture(scope="module")
def suite() -> dict[str, Recordings]:
    return {trouble: load_recordings(str(HERE / trouble)) for trouble in SAMPLED}


def test_the_matrix_is_whole_and_of_the_bundled_headline() -> None:
    found = shipped_failures(bundled().manifest.data_version)
    assert found is not None
    assert (found["track"], found["scenes"]) == (TRACK, dict.fromkeys(KINDS, 16))
    rows = [name for name in names(bundled()) if INSTANT not in name and not kind(name, bundled()).expensive]
    assert list(found["matrix"]) == rows
    assert JOINT in rows
    assert found["privileged"] == [name for name in found["matrix"] if name in POLICIES and POLICIES[name].privileged]
    for row in found["matrix"].values():
        assert list(row) == list(KINDS)
        assert all(0.0 < value < 10.0 for value in row.values())


def test_rows_fitted_on_other_recordings_have_no_matrix() -> None:
    assert shipped_failures("mine-1") is None


def test_the_experts_of_the_suite_are_those_of_the_headline(suite: dict[str, Recordings]) -> None:
    for trouble, recordings in suite.items():
        check_experts(recordings, bundled(), trouble)
        assert JOINT in recordings.manifest.variants
        assert set(recordings.manifest.parameters[SITUATIONS].values()) == {trouble}
        assert recordings.manifest.data_version == f"mixocity-failures-{trouble}-{Failures().seed(trouble)}"


def test_a_fault_spoils_one_camera_and_nothing_else(suite: dict[str, Recordings]) -> None:
    sound, faulty = suite["ordinary"], suite["frozen"]
    told = faulty.manifest.parameters[CAMERA_FAULTS]
    assert CAMERA_FAULTS not in sound.manifest.parameters
    for scene in sound.scenes:
        camera, before, after = told[scene.name]["camera"], sound.rows(scene.name), faulty.rows(scene.name)
        different = {
            column.split(".")[0]
            for column in before
            if not np.array_equal(before[column], after[column], equal_nan=True)
        }
        assert camera in different
        assert different <= {camera, JOINT}


def test_an_environment_says_which_camera_is_frozen_now(suite: dict[str, Recordings]) -> None:
    told = suite["frozen"].manifest.parameters[CAMERA_FAULTS]
    for scene in suite["frozen"].scenes:
        env = gymnasium.make("mixo_env:MixoOdometry-v0", recordings=suite["frozen"], split="ood")
        _, info = env.reset(options={"scene": scene.name})
        said, ended = [info["faults"]], False
        while not ended:
            *_, ended, info = env.step(np.zeros(5, np.float32))
            said.append(info["faults"])
        at_work = {(name, fault) for faults in said for name, fault in faults.items() if fault}
        assert at_work == {(told[scene.name]["camera"], "frozen")}
        assert 0.3 < np.mean([any(faults.values()) for faults in said]) < 0.7
