"""The first seconds of one bundled scene, simulated and recorded anew, within the promised tolerance."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from experiments.mixocity import CONFIG, DATA_VERSION
from mixo_env.files import write_bytes
from mixo_env.nuscenes.scene import CameraReel
from mixo_env.nuscenes.tables import open_dataset
from mixo_env.recordings.record import RecordConfig, default_experts
from mixo_env.recordings.steps import record_scene
from mixo_env.recordings.store import load_recordings
from mixo_env.simulator.dataset import _renderer, simulate
from mixo_env.simulator.drive.scenario import plan_logs
from mixo_env.simulator.drive.scenes import pictures, simulate_scene
from mixo_env.simulator.drive.spoiling import encoded

SCENE, CAMERA, IMAGES = "scene-2006", "CAM_FRONT", 120


def first_images(reel: CameraReel, start_us: int, stop: int) -> CameraReel:
    """Images from ``start_us`` until the ``stop``-th of the scene."""
    kept = slice(int(np.searchsorted(reel.timestamp_us, start_us)), stop)
    arrays = {name: getattr(reel, name)[kept] for name in ("timestamp_us", "is_keyframe", "x_m", "y_m", "yaw_rad")}
    return replace(reel, image_paths=reel.image_paths[kept], **arrays)


@pytest.mark.integration
def test_one_scene_comes_out_the_same(tmp_path: Path) -> None:
    recordings = load_recordings("mixocity")
    if recordings.manifest.data_version != f"mixocity-{DATA_VERSION}":
        pytest.skip(f"needs mixocity-{DATA_VERSION}")
    bundled = recordings.rows(SCENE)
    offset_s = np.nan_to_num(bundled[f"{CAMERA}.image_time_offset_s"].astype(np.float64))  # 0: no image
    image_us = bundled["timestamp_us"] + np.rint(1e6 * offset_s).astype(np.int64)

    simulate(replace(CONFIG, images=False), tmp_path, only=(SCENE,))
    (log, plan) = next((log, plan) for log in plan_logs(CONFIG) for plan in log.scenes if plan.name == SCENE)
    one = replace(CONFIG, cameras=(CAMERA,))
    frames = pictures(one, log, plan, simulate_scene(one, log, plan, tmp_path), _renderer(one, log))
    for path, image in itertools.islice(frames, IMAGES):
        write_bytes(path, encoded(image))
    scene = open_dataset(tmp_path).load(SCENE, (CAMERA,))
    reel = first_images(scene.cameras[CAMERA], image_us[0], IMAGES)
    anew, _ = record_scene(replace(scene, cameras={CAMERA: reel}), default_experts(RecordConfig(), SCENE))

    rows = np.searchsorted(image_us, anew["timestamp_us"])  # with one camera every step closes with its image
    np.testing.assert_array_equal(image_us[rows], anew["timestamp_us"])
    yaw, matches = (f"{CAMERA}.{name}" for name in ("own_window_yaw_increment_rad", "matches"))
    both = np.isfinite(anew[yaw]) & np.isfinite(bundled[yaw][rows])
    assert both.sum() >= 0.8 * len(rows)
    difference = np.degrees(np.abs(anew[yaw] - bundled[yaw][rows])[both])
    assert np.mean(difference < 0.01) >= 0.95
    assert np.median(np.abs(anew[matches][1:] / bundled[matches][rows][1:] - 1.0)) <= 0.02

    # The drive itself. (Not the written poses: each log of the bundled recordings was given a lag of its own, simulated
    # cars have one each.)
    assert scene.exact is not None
    close_s, known_s = (1e-6 * (us - image_us[0]) for us in (bundled["timestamp_us"], scene.exact.timestamp_us))
    for name in ("x_m", "y_m", "yaw_rad"):
        values = getattr(scene.exact, name)
        again = np.interp(close_s, known_s, np.unwrap(values) if name == "yaw_rad" else values)
        np.testing.assert_allclose(again, bundled[f"exact.{name}"], atol=1e-9)
