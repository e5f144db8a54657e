"""Do four cameras keep up with the rig on two cores? A scene of 1600x900 images from JPEG to yaw increment.

    mixo simulate city1600 --width 1600 --height 900 --scenes 1 --scenes-per-log 1
    python -m experiments.speed.realtime city1600

Two processes with one thread and two cameras each take every firing round of a scene; files are read from disk, decoded
and processed. A round takes as long as the slower process; the rig fires every 83.3 ms. Printed are wall and CPU time
of the rounds, the memory of each process, and one thread's CPU time per image (decoding and expert) of every preset.
"""

from __future__ import annotations

import multiprocessing
import resource
import time
from multiprocessing.connection import Connection
from pathlib import Path

import cv2
import numpy as np
import tyro
from numpy.typing import NDArray
from tyro.conf import Positional

from experiments.speed.drives import Drive, open_drives
from mixo_env.experts.monocular.config import PRESETS, MonocularConfig
from mixo_env.experts.monocular.odometry import MonocularOdometry
from mixo_env.nuscenes.selections import CAMERAS

STEP_MS = 1e3 / 12.0
_WARM_UP = 6  # rounds that compile and fill caches, the first ones of TRACKING among them


def _distances(drive: Drive) -> NDArray[np.float64]:
    return np.concatenate([[0.0], drive.path_m])


def _round(drives: list[Drive], experts: list[MonocularOdometry], k: int) -> None:
    """Show image ``k`` of every drive."""
    for drive, expert in zip(drives, experts, strict=True):
        if k < len(drive.image_paths):
            image = drive.read(drive.image_paths[k], expert.halvings)
            expert.process(image, int(drive.timestamp_us[k]), float(_distances(drive)[k]))


def _work(pipe: Connection, root: Path, scene: str, cameras: tuple[str, ...], preset: str) -> None:
    """One process: answers every number of a round with its wall and CPU time [ms]; ``None`` ends it."""
    cv2.setNumThreads(1)
    drives = list(open_drives(root, (scene,), cameras))
    config = MonocularConfig.preset(preset)
    _warm_up(drives, config)
    experts = [MonocularOdometry(drive.calibration, config) for drive in drives]
    pipe.send(max(len(drive.image_paths) for drive in drives))
    while (k := pipe.recv()) is not None:
        wall, cpu = time.perf_counter(), time.process_time()
        _round(drives, experts, k)
        pipe.send((1e3 * (time.perf_counter() - wall), 1e3 * (time.process_time() - cpu)))
    pipe.send(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)


def _warm_up(drives: list[Drive], config: MonocularConfig) -> None:
    experts = [MonocularOdometry(drive.calibration, config) for drive in drives]
    for k in range(_WARM_UP):
        _round(drives, experts, k)


def run_rig(root: Path, scene: str, preset: str) -> tuple[NDArray[np.float64], NDArray[np.float64], list[float]]:
    """Four cameras on two processes over a scene.

    Returns:
        Wall time of each round ``(rounds,)`` [ms], CPU time of each process ``(rounds, 2)`` [ms], and the peak memory
        of each process [MiB].
    """
    context = multiprocessing.get_context("spawn")
    pipes, processes = [], []
    for cameras in (CAMERAS[:2], CAMERAS[2:]):
        ours, theirs = context.Pipe()
        process = context.Process(target=_work, args=(theirs, root, scene, cameras, preset), daemon=True)
        process.start()
        theirs.close()
        pipes.append(ours)
        processes.append(process)
    rounds = max(pipe.recv() for pipe in pipes)
    wall, cpu = [], []
    for k in range(rounds):
        start = time.perf_counter()
        for pipe in pipes:
            pipe.send(k)
        answers = [pipe.recv() for pipe in pipes]
        wall.append(1e3 * (time.perf_counter() - start))
        cpu.append([spent for _, spent in answers])
    for pipe in pipes:
        pipe.send(None)
    memory = [pipe.recv() for pipe in pipes]
    for process in processes:
        process.join()
    return np.array(wall), np.array(cpu), memory


def per_image(drives: list[Drive], config: MonocularConfig, images: int) -> tuple[float, float]:
    """Median CPU time of decoding and of the expert [ms], one thread, over the first images of every drive."""
    decode_ms, expert_ms = [], []
    _warm_up(drives, config)
    for drive in drives:
        expert, metres = MonocularOdometry(drive.calibration, config), _distances(drive)
        for k, path in enumerate(drive.image_paths[:images]):
            start = time.thread_time()
            image = drive.read(path, expert.halvings)
            decoded = time.thread_time()
            expert.process(image, int(drive.timestamp_us[k]), float(metres[k]))
            decode_ms.append(1e3 * (decoded - start))
            expert_ms.append(1e3 * (time.thread_time() - decoded))
    return float(np.median(decode_ms)), float(np.median(expert_ms))


def _quantiles(name: str, values: NDArray[np.float64]) -> str:
    return f"  {name:34s}{np.median(values):8.1f}{np.quantile(values, 0.95):8.1f}{values.max():8.1f}"


def main(root: Positional[Path], scene: str = "", images: int = 60) -> None:
    """Print everything.

    Args:
        root: nuScenes folder, real or simulated, with 1600x900 images.
        scene: the first by default.
        images: per camera, for the times per image.
    """
    cv2.setNumThreads(1)
    drives = list(open_drives(root, (scene,) if scene else (), CAMERAS))
    scene = drives[0].scene
    drives = [drive for drive in drives if drive.scene == scene]
    calibration = drives[0].calibration
    wall, cpu, memory = run_rig(root, scene, "fast")
    print(
        f"{scene}, {len(drives)} cameras of {calibration.width}x{calibration.height} on two processes, preset fast, "
        f"{len(wall)} rounds\n  {'ms':34s}  median    95 %     max"
    )
    print(_quantiles("wall per round", wall))
    for k in range(2):
        print(_quantiles(f"CPU per round of process {k + 1} (2 cameras)", cpu[:, k]))
    print(f"  rounds within {STEP_MS:.1f} ms of wall time: {np.mean(wall <= STEP_MS):.1%}, of CPU time: ", end="")
    print(f"{np.mean(cpu.max(axis=1) <= STEP_MS):.1%}")
    print(f"  peak memory {memory[0]:.0f} and {memory[1]:.0f} MiB\n\nCPU ms per image, one thread (median)")
    for name, config in PRESETS.items():
        decode, expert = per_image(drives, config, images)
        print(f"  {name:8s} decode {decode:6.1f}   expert {expert:6.1f}   together {decode + expert:6.1f}")


if __name__ == "__main__":
    tyro.cli(main)
