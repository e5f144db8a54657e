"""Accuracy and speed of the single-camera odometry, camera by camera, alone or beside ORB-SLAM3 on the same images.

    python -m experiments.speed.odometry FOLDER --preset fast --scenes scene-2001 scene-2002 --peer

FOLDER is a nuScenes folder, real or simulated, or a KITTI odometry sequence. Truth is the simulator's exact pose where
the folder has it, else the pose of each image. The external scale is the true path length with 1 % noise per step and
0.5 % too long (errors of wheels); yaw is never given. Printed per camera, TRACKING images only: share tracked, times
lost, yaw-increment error (median, RMS), slope against truth in turns above 5 deg/s, accumulated yaw per scene that was
tracked at all (median, 90th percentile), true error over stated standard deviation (RMS), CPU time per image (decoding,
expert), and the relative change of yaw when distances grow by 2 %.

With ``--peer``: ORB-SLAM3 with the same extractor settings beside preset ``paper``, with those of its KITTI examples
beside ``fast``. Its vocabulary is trained on 100 of the images that follow, it sees them at real-time pace, and counts
as tracking when its state is OK. It lives on images alone; ours has the distance too. Ratios are ours over theirs.
"""

from __future__ import annotations

import resource
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from tyro.conf import Positional

from experiments.peers.orbslam3_client import OrbRun, OrbSettings, orbslam3_python, run_orbslam3
from experiments.peers.orbslam3_words import train_words
from experiments.speed.drives import Drive, open_drives
from mixo_env.errors import ConfigurationError, MixoError
from mixo_env.experts.expert import State
from mixo_env.experts.monocular.config import MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.selections import CAMERAS

FloatArray = NDArray[np.float64]
TURN_RADPS = np.radians(5.0)
WARM_UP_IMAGES = 40
VOCABULARY_IMAGES = 100


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


@dataclass(frozen=True)
class PeerRun:
    """ORB-SLAM3 over the same images; nothing tracked if it died."""

    error_deg: FloatArray
    tracking_ms: float
    process_ms: float
    late: float
    settings: OrbSettings


def run_camera(drive: Drive, config: MonocularConfig, rescale: bool, images: int | None = None) -> Run:
    """Show one camera's first ``images`` images (all by default) to the expert."""
    steps, rescaled, decode_ms, expert_ms = [], [], [], []
    noise = np.random.default_rng(0).standard_normal(len(drive.path_m))
    distance = [0.0, *(1.005 * drive.path_m * (1.0 + 0.01 * noise))]
    expert, other = MonocularOdometry(drive.calibration, config), MonocularOdometry(drive.calibration, config)
    for path, stamp, metres in list(zip(drive.image_paths, drive.timestamp_us, distance, strict=True))[:images]:
        start = time.process_time()
        grey = drive.read(path, expert.halvings)
        decoded = time.process_time()
        steps.append(expert.process(grey, int(stamp), float(metres)))
        expert_ms.append(1e3 * (time.process_time() - decoded))
        decode_ms.append(1e3 * (decoded - start))
        if rescale:
            rescaled.append(other.process(grey, int(stamp), 1.02 * float(metres)).yaw_increment_rad)
    states = np.array([step.state for step in steps])
    count = len(steps) - 1
    return Run(
        drive.turn_rad[:count],
        1e-6 * np.diff(drive.timestamp_us)[:count],
        np.array([step.yaw_increment_rad for step in steps[1:]]),
        np.array([step.yaw_std_rad for step in steps[1:]]),
        np.array(rescaled[1:]) if rescale else np.full(count, np.nan),
        int(np.sum((states[1:] == State.LOST) & (states[:-1] == State.TRACKING))),
        decode_ms,
        expert_ms,
    )


def run_peer(python: Path, drive: Drive, vocabulary: Path, wanted: OrbSettings, pace: float) -> PeerRun:
    """Show the same images to ORB-SLAM3."""
    height, width = drive.calibration.height, drive.calibration.width
    settings = wanted.fitting(height, width)
    read = [drive.read(path) for path in drive.image_paths]
    intrinsic = drive.calibration.intrinsic
    try:
        run: OrbRun = run_orbslam3(python, read, drive.timestamp_us, intrinsic, vocabulary, settings, pace)
    except MixoError as error:
        print(f"{drive.scene} {drive.calibration.channel}: {error}")
        return PeerRun(np.full(len(drive.turn_rad), np.nan), np.nan, np.nan, np.nan, settings)
    yaw = run.yaw_increments(drive.calibration.rotation_ego_from_camera)
    late = float(np.mean(run.late_s[1:] > 1e-6 * np.diff(drive.timestamp_us)))
    tracking_ms = float(np.mean(run.tracking_ms))
    return PeerRun(np.degrees(yaw - drive.turn_rad), tracking_ms, run.process_ms, late, settings)


def rms(error: FloatArray) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(error**2))) if len(error) else float("nan")


def accumulated_deg(runs: Sequence[Run] | Sequence[PeerRun]) -> FloatArray:
    """Size of the summed error of every run with a tracked image; NaN if there is none."""
    tracked = [run.error_deg[np.isfinite(run.error_deg)] for run in runs]
    return np.abs([error.sum() for error in tracked if len(error)] or [np.nan])


HEAD = (
    "camera             tracked  lost   median      RMS     gain   accum    p90  error  decode expert  "
    "dyaw/ds\n                                      deg      deg  (turns)     deg    deg   /std      ms     ms"
)


def row(channel: str, runs: list[Run]) -> str:
    """One line of the first table."""
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
    accumulated = accumulated_deg(runs)
    decode, expert = (np.mean(np.concatenate([getattr(run, f"{k}_ms") for run in runs])) for k in ("decode", "expert"))
    return (
        f"{channel:18s}{good.mean():8.3f}{sum(run.lost for run in runs):6d}{np.median(np.abs(error[good])):9.4f}"
        f"{rms(error[good]):9.4f}{gain:9.4f}{np.median(accumulated):8.2f}"
        f"{np.quantile(accumulated, 0.9):7.2f}{rms((error / np.degrees(std))[good]):7.2f}"
        f"{decode:8.1f}{expert:7.1f}{scale:9.3f}"
    )


PEER_HEAD = (
    "                   ORB-SLAM3                           both tracking            ours / theirs          "
    "CPU ms per image      ours / theirs\n"
    "camera             tracked   median      RMS  accum   RMS ours  theirs   median     RMS  RMS own    "
    "ours  track  process   track process   late\n"
    "                                deg      deg    deg        deg     deg"
)


def peer_row(channel: str, ours: list[Run], theirs: list[PeerRun]) -> str:
    """One line of the second table; ``late``: share of images handed over more than an interval late."""
    a, b = (np.concatenate([run.error_deg for run in runs]) for runs in (ours, theirs))
    both = np.isfinite(a) & np.isfinite(b)
    own_a, own_b = a[np.isfinite(a)], b[np.isfinite(b)]
    accumulated = np.median(accumulated_deg(theirs))
    expert_ms = float(np.mean(np.concatenate([run.expert_ms for run in ours])))
    track, process, late = (np.nanmean([getattr(r, k) for r in theirs]) for k in ("tracking_ms", "process_ms", "late"))
    medians = [float(np.median(np.abs(some))) if len(some) else np.nan for some in (a[both], b[both], own_b)]
    return (
        f"{channel:18s}{np.isfinite(b).mean():8.3f}{medians[2]:9.4f}{rms(own_b):9.4f}{accumulated:7.2f}"
        f"{rms(a[both]):11.4f}{rms(b[both]):8.4f}{medians[0] / medians[1]:9.2f}{rms(a[both]) / rms(b[both]):8.2f}"
        f"{rms(own_a) / rms(own_b):9.2f}"
        f"{expert_ms:8.1f}{track:7.1f}{process:9.1f}{expert_ms / track:8.2f}{expert_ms / process:8.2f}{late:7.2f}"
    )


def vocabulary_of(drives: list[Drive], path: Path) -> Path:
    """ORB-SLAM3's vocabulary from images picked at random among those of the drives."""
    images = [(drive, image) for drive in drives for image in drive.image_paths]
    some = np.random.default_rng(0).permutation(len(images))[:VOCABULARY_IMAGES]
    words = train_words((drive.read(image) for drive, image in (images[i] for i in some)), path)
    print(f"vocabulary: {words} words from {len(some)} images")
    return path


def main(
    root: Positional[Path],
    preset: Literal["fast", "paper"] = "fast",
    scenes: tuple[str, ...] = (),
    cameras: tuple[str, ...] = CAMERAS,
    rescale: bool = False,
    peer: bool = False,
    peer_pace: float = 1.0,
) -> None:
    """Run the expert over a folder and print one line per camera.

    Args:
        root: nuScenes folder, real or simulated, or KITTI sequence.
        preset: settings of the odometry.
        scenes: all by default.
        cameras: the paper's four by default.
        rescale: also measure d(yaw)/d(scale), at twice the time.
        peer: also run ORB-SLAM3.
        peer_pace: share of real time at which it gets images; lower it on a busy machine, where many would be late.
    """
    cv2.setNumThreads(1)
    config = MonocularConfig.preset(preset)
    drives = list(open_drives(root, scenes, cameras))
    run_camera(drives[0], config, rescale=False, images=WARM_UP_IMAGES)  # compiles, outside of the times
    runs: dict[str, list[Run]] = {}
    for drive in drives:
        runs.setdefault(drive.calibration.channel, []).append(run_camera(drive, config, rescale))
    print(HEAD)
    for channel, some in runs.items():
        print(row(channel, some))
    print(f"peak memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB", flush=True)
    if not peer:
        return
    python = orbslam3_python()
    if python is None:
        raise ConfigurationError("ORB-SLAM3 cannot be installed here: leave out --peer")
    like_ours = OrbSettings(
        config.features, config.levels, config.scale_factor, config.fast_threshold, config.fast_threshold_low
    )
    wanted = like_ours if preset == "paper" else OrbSettings()
    theirs: dict[str, list[PeerRun]] = {}
    with tempfile.TemporaryDirectory() as folder:
        vocabulary = vocabulary_of(drives, Path(folder) / "words.txt")
        for drive in drives:
            found = run_peer(python, drive, vocabulary, wanted, peer_pace)
            theirs.setdefault(drive.calibration.channel, []).append(found)
    for settings in {run.settings: None for some in theirs.values() for run in some}:
        fewer = "" if settings == wanted else f"; the images have no room for {wanted.levels} levels"
        print(f"ORB-SLAM3: {settings}{fewer}")
    print(PEER_HEAD)
    for channel, some in runs.items():
        print(peer_row(channel, some, theirs[channel]))
    if len(runs) > 1:
        print(peer_row("all", [r for some in runs.values() for r in some], [r for s in theirs.values() for r in s]))


if __name__ == "__main__":
    tyro.cli(main)
