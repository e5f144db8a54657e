"""Accuracy and speed of the single-camera odometry over a nuScenes folder, camera by camera.

    python -m experiments.benchmarks.odometry FOLDER --preset fast --scenes scene-2001 scene-2002

Truth is the simulator's exact pose where the folder has it, else the ego pose of each image. The external scale is the
true path length with 1 % noise per step and 0.5 % too long (errors of wheels); yaw is never given. Printed per camera,
TRACKING images only: share tracked, times lost, yaw-increment error (median, RMS), slope against truth in turns above
5 deg/s, accumulated yaw per scene (median, 90th percentile), true error over stated standard deviation (RMS), CPU time
of one thread per image (JPEG decoding + expert), and the relative change of yaw when distances grow by 2 %.
"""

from __future__ import annotations

import resource
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from tyro.conf import Positional

from mixo_env.experts.expert import State
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.scene import CameraTrack, Scene
from mixo_env.nuscenes.selections import CAMERAS
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.steps import read_grey

FloatArray = NDArray[np.float64]
TURN_RADPS = np.radians(5.0)


@dataclass
class Run:
    """One camera over one scene: per image, the first excluded."""

    truth_rad: FloatArray
    dt_s: FloatArray
    yaw_rad: FloatArray
    std_rad: FloatArray
    rescaled_rad: FloatArray
    lost: int
    decode_ms: list[float] = field(default_factory=list)
    expert_ms: list[float] = field(default_factory=list)

    @property
    def error_deg(self) -> FloatArray:
        """NaN unless TRACKING."""
        return np.degrees(self.yaw_rad - self.truth_rad)


def true_motion(scene: Scene, track: CameraTrack) -> tuple[FloatArray, FloatArray]:
    """Yaw increment and path length between consecutive images."""
    if scene.exact is None:
        return np.diff(np.unwrap(track.yaw_rad)), np.hypot(np.diff(track.x_m), np.diff(track.y_m))
    exact, at = scene.exact, track.timestamp_us
    path = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(exact.x_m), np.diff(exact.y_m)))])
    yaw = np.interp(at, exact.timestamp_us, np.unwrap(exact.yaw_rad))
    return np.diff(yaw), np.diff(np.interp(at, exact.timestamp_us, path))


def run_camera(scene: Scene, channel: str, config: MonocularConfig, rescale: bool) -> Run:
    """Show one camera's images to the expert."""
    track = scene.cameras[channel]
    turn, path = true_motion(scene, track)
    distance = 1.005 * path * (1.0 + 0.01 * np.random.default_rng(0).standard_normal(len(path)))
    expert, other = MonocularOdometry(track.calibration, config), MonocularOdometry(track.calibration, config)
    steps, rescaled, decode_ms, expert_ms = [], [], [], []
    for image, stamp, metres in zip(track.image_paths, track.timestamp_us, [0.0, *distance], strict=True):
        start = time.thread_time()
        grey = read_grey(image)
        decoded = time.thread_time()
        steps.append(expert.process(grey, int(stamp), float(metres)))
        expert_ms.append(1e3 * (time.thread_time() - decoded))
        decode_ms.append(1e3 * (decoded - start))
        if rescale:
            rescaled.append(other.process(grey, int(stamp), 1.02 * float(metres)).yaw_increment_rad)
    states = np.array([step.state for step in steps])
    return Run(
        turn,
        1e-6 * np.diff(track.timestamp_us),
        np.array([step.yaw_increment_rad for step in steps[1:]]),
        np.array([step.yaw_std_rad for step in steps[1:]]),
        np.array(rescaled[1:]) if rescale else np.full(len(turn), np.nan),
        int(np.sum((states[1:] == State.LOST) & (states[:-1] == State.TRACKING))),
        decode_ms,
        expert_ms,
    )


def row(channel: str, runs: list[Run]) -> str:
    """One line of the table."""
    error = np.concatenate([run.error_deg for run in runs])
    truth, yaw, dt, std, rescaled = (
        np.concatenate([getattr(run, name) for run in runs])
        for name in ("truth_rad", "yaw_rad", "dt_s", "std_rad", "rescaled_rad")
    )
    good = np.isfinite(error)
    turning = good & (np.abs(truth) > TURN_RADPS * dt)
    gain = float(yaw[turning] @ truth[turning] / (truth[turning] @ truth[turning])) if turning.any() else np.nan
    both = turning & np.isfinite(rescaled)
    scale = float((rescaled - yaw)[both] @ truth[both] / (truth[both] @ truth[both]) / 0.02) if both.any() else np.nan
    accumulated = np.abs([np.nansum(run.error_deg) for run in runs])
    decode, expert = (
        np.median(np.concatenate([getattr(run, f"{k}_ms") for run in runs])) for k in ("decode", "expert")
    )
    return (
        f"{channel:18s}{good.mean():8.3f}{sum(run.lost for run in runs):6d}{np.median(np.abs(error[good])):9.4f}"
        f"{np.sqrt(np.mean(error[good] ** 2)):9.4f}{gain:9.4f}{np.median(accumulated):8.2f}"
        f"{np.quantile(accumulated, 0.9):7.2f}{np.sqrt(np.mean((error / np.degrees(std))[good] ** 2)):7.2f}"
        f"{decode:8.1f}{expert:7.1f}{scale:9.3f}"
    )


def main(
    root: Positional[Path],
    preset: Literal["fast", "paper"] = "fast",
    scenes: tuple[str, ...] = (),
    cameras: tuple[str, ...] = CAMERAS,
    rescale: bool = False,
) -> None:
    """Run the expert over a folder and print one line per camera.

    Args:
        root: nuScenes folder, real or simulated.
        preset: settings of the odometry.
        scenes: all by default.
        cameras: the paper's four by default.
        rescale: also measure d(yaw)/d(scale), at twice the time.
    """
    cv2.setNumThreads(1)
    dataset, config = open_dataset(root), MonocularConfig.preset(preset)
    print(
        "camera             tracked  lost   median      RMS     gain   accum    p90  error  decode expert  "
        "dyaw/ds\n                                      deg      deg  (turns)     deg    deg   /std      ms     ms"
    )
    runs: dict[str, list[Run]] = {channel: [] for channel in cameras}
    for name in scenes or dataset.scene_names:
        scene = dataset.load(name, cameras)
        for channel in cameras:
            runs[channel].append(run_camera(scene, channel, config, rescale))
    for channel in cameras:
        print(row(channel, runs[channel]))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


if __name__ == "__main__":
    tyro.cli(main)
