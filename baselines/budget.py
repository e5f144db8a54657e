"""Accuracy against milliseconds: LINEAR's weights with only some cameras switched on, in `MixoOdometryBudget-v0`.

python baselines/budget.py --on CAM_FRONT CAM_BACK
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import gymnasium as gym
import numpy as np
import tyro

from mixo_env.envs.budget import BudgetReplay
from mixo_env.envs.stepping import TRUTH
from mixo_env.files import write_json
from mixo_env.fusion import least_squares_weights
from mixo_env.leaderboard.held_out import hold_out
from mixo_env.recordings.collection import Recordings
from mixo_env.recordings.store import load_recordings

RAW_SCALE = 4.0  # of the environment: weights up to 4 fit into its actions


@dataclass(frozen=True)
class Settings:
    """Fit constant weights to the cameras that are on, play them, print accuracy and cost beside all and none."""

    on: tuple[str, ...] = ("CAM_FRONT",)
    """Cameras that are processed at every step."""

    recordings: str = "mixocity"
    """A folder, or the name of a bundled recording."""

    track: str = "CONSUMER"
    """PAPER or CONSUMER: whose inertial expert votes besides the cameras."""

    fold: int = 3
    """Held out; the others are trained on."""

    out: Path = Path("results/baselines/budget")
    """Folder for the weights."""


def main(settings: Settings) -> None:
    """Load; fit, play and print every choice of cameras; save."""
    recordings = load_recordings(settings.recordings)
    training, test = hold_out(recordings, settings.fold)
    learned_from = BudgetReplay(training, track=settings.track)  # two-frame increments: what a switched camera says
    cameras, experts = learned_from.cameras, learned_from.experts

    print(f"Track {settings.track}, {len(test)} held-out scenes\n{'cameras on':32} ms/step  yaw deg  ATE m")
    for name, on in (("none", ()), (" ".join(settings.on), settings.on), ("all (LINEAR)", cameras)):
        # A sleeping camera has no vote; the track's inertial expert always has.
        voting = [j for j, expert in enumerate(experts) if expert in on or expert not in cameras]
        weights = np.zeros(len(experts))
        weights[voting] = least_squares_weights(
            learned_from.votes.increments_rad[:, voting], learned_from.table[:, TRUTH]
        )
        switches = [1.0 if camera in on else -1.0 for camera in cameras]
        action = np.array([*weights / RAW_SCALE, *switches], np.float32)
        cost_ms, yaw_deg, ate_m = play(test, settings.track, action)
        print(f"{name:32} {cost_ms:7.1f}  {yaw_deg:7.4f}  {ate_m:5.2f}")
        if on == settings.on:
            write_json(settings.out / "weights.json", dict(zip(experts, weights.tolist(), strict=True)))
    print(f"saved in {settings.out}")


def play(test: Recordings, track: str, action: np.ndarray) -> tuple[float, float, float]:
    """The same action at every step of every scene: cost [ms per step], RMSE of the yaw increment [deg], ATE [m]."""
    env = gym.make_vec(
        "mixo_env:MixoOdometryBudget-v0", len(test),
        recordings=test, track=track, split="all", order="fixed", weights="raw", raw_scale=RAW_SCALE,
    )  # fmt: skip
    env.reset(seed=0)
    running, cost_ms, steps, scores = np.ones(len(test), bool), *np.zeros((2, len(test))), np.zeros((len(test), 2))
    while running.any():
        _, _, _, truncated, info = env.step(np.tile(action, (len(test), 1)))
        cost_ms += np.where(running, info["cost_ms"], 0.0)
        steps += running
        for i in np.flatnonzero(truncated & running):
            scores[i] = info["scores"]["yaw_rmse_deg"][i], info["scores"]["ate_m"][i]
        running &= ~truncated
    yaw_deg, ate_m = scores.mean(axis=0)
    return float(np.mean(cost_ms / steps)), float(yaw_deg), float(ate_m)


if __name__ == "__main__":
    main(tyro.cli(Settings))
