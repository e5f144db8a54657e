"""ATE and RTE while Stable-Baselines3 trains: the leaderboard's numbers, and no effect on what is trained."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mixo_env.cli.main import main
from mixo_env.leaderboard import curves
from mixo_env.leaderboard.crossvalidation import CrossValidation, Trial
from mixo_env.leaderboard.curves import Curves, watch
from mixo_env.leaderboard.evaluation import Truth, rollout
from mixo_env.policies.fitting import prepare
from mixo_env.policies.reinforcement import PPO
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import save_recordings
from tests.synthetic import synthetic_recordings

RECORDINGS = synthetic_recordings(scenes=8, steps=40)
TRAINING, VALIDATION = RECORDINGS.select(folds=[0, 1, 2]), RECORDINGS.select(folds=[3])
SMALL: dict[str, Any] = {
    "steps": 128,
    "environments": 4,
    "settings": {"n_steps": 16, "batch_size": 32, "n_epochs": 2},
}


def fitted(made: list[Curves] | None = None) -> PPO:
    """A small PPO; its curves are put into ``made``."""
    policy = PPO(**SMALL)
    if made is not None:

        def make(transform: Any) -> Curves:
            options: dict[str, Any] = {"track": "CONSUMER", "observation": "rich", "every": 64}
            made.append(Curves(None, VALIDATION, transform=transform, **options))
            return made[0]

        policy.watch = make
    prepare(policy, TRAINING, "CONSUMER", seed=3)
    return policy


def scores(policy: PPO, validation: Recordings) -> dict[str, float]:
    """The same numbers by the leaderboard's way through the scenes, with the trained policy's plain matrices."""
    errors = Truth(validation, "exact").measure(rollout(policy, validation, "CONSUMER"))
    return {
        "ate_m": float(np.mean(errors.absolute.translation_m)),
        "ate_deg": float(np.mean(errors.absolute.rotation_deg)),
        "yaw_rmse_deg": float(np.sqrt(errors.squared_yaw_increment_deg2.sum() / errors.steps.sum())),
        "rte_deg_per_m": float(np.mean(errors.relative.rotation_deg_per_m)),
        "rte_percent": float(np.mean(errors.relative.translation_percent)),
    }


def test_the_last_point_is_what_the_leaderboard_says_and_looking_on_changes_nothing() -> None:
    made: list[Curves] = []
    watched, alone = fitted(made), fitted()
    for name, tensor in alone.tensors().items():
        np.testing.assert_array_equal(watched.tensors()[name], tensor)
    assert made[0].evaluate() == pytest.approx(scores(watched, VALIDATION), rel=1e-4)


@pytest.mark.integration
@pytest.mark.filterwarnings("default")
def test_mixo_train_writes_curves_of_the_held_out_fold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("tensorboard")
    from tensorboard.backend.event_processing.event_accumulator import (  # pyright: ignore[reportMissingImports]
        EventAccumulator,
    )

    monkeypatch.setattr(PPO, "usual", replace(PPO.usual, **SMALL))
    save_recordings(RECORDINGS, tmp_path / "drives")
    command = ["train", "PPO", "--recordings", str(tmp_path / "drives"), "--tracks", "CONSUMER"]
    assert main([*command, "--out", str(tmp_path / "weights"), "--tensorboard", str(tmp_path / "curves")]) == 0
    events = EventAccumulator(str(tmp_path / "curves" / "PPO" / "CONSUMER" / "fold-3-seed-0"))
    events.Reload()
    drawn = {name: events.Scalars(f"eval/{name}") for name in ("ate_m", "rte_deg_per_m", "rte_percent")}
    for points in drawn.values():
        assert [point.step for point in points] == [0, 128]
    trial = Trial(weights=tmp_path / "weights")
    division = CrossValidation(RECORDINGS, trial)
    policy = division.fitted("PPO", "CONSUMER", 3, 0)
    assert isinstance(policy, PPO)
    expected = scores(policy, division.recordings.select(folds=[3]))
    assert {name: points[-1].value for name, points in drawn.items()} == pytest.approx(
        {name: expected[name] for name in drawn}, rel=1e-4
    )


def test_only_what_stable_baselines_trains_is_watched(tmp_path: Path) -> None:
    from mixo_env.policies.linear import Linear

    linear = Linear()
    watch(linear, tmp_path, VALIDATION, "CONSUMER")
    assert not hasattr(linear, "watch")


def test_rows_that_draw_no_curves_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(curves, "require_tensorboard", lambda: None)
    monkeypatch.chdir(tmp_path)
    assert main(["train", "LINEAR", "--tensorboard", "curves"]) == 2
    assert "none of LINEAR is trained by Stable-Baselines3" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_without_tensorboard_there_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(curves, "find_spec", lambda name: None)
    monkeypatch.chdir(tmp_path)
    assert main(["train", "PPO", "--tensorboard", "curves"]) == 2
    said = capsys.readouterr().err
    assert said == "mixo: curves need the package tensorboard: pip install 'mixo-env[tensorboard]'\n"
    assert not list(tmp_path.iterdir())
