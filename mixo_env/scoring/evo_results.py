"""Result files that evo's ``evo_res`` opens: a zip of info, statistics, error arrays and trajectories."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np

from mixo_env.files import atomic_path
from mixo_env.scoring.scores import MethodScore
from mixo_env.trajectory.formats import kitti_text, tum_text


def write_evo_result(path: Path, score: MethodScore, scene: int, convention: str) -> None:
    """Write the absolute translation errors of one scene.

    Args:
        path: the zip file to write.
        score: of one method.
        scene: index of the scene.
        convention: goes into the title, as with evo.
    """
    rows = score.rows(scene)
    error_m = score.absolute.translation_m[rows]
    truth, estimate = score.matched.truth[rows], score.aligned[rows]
    statistics = {
        "rmse": np.sqrt(np.mean(error_m**2)),
        "mean": np.mean(error_m),
        "median": np.median(error_m),
        "std": np.std(error_m),
        "min": np.min(error_m),
        "max": np.max(error_m),
        "sse": np.sum(error_m**2),
    }
    info = {
        "title": f"APE w.r.t. translation part (m)\n({convention})",
        "ref_name": score.matched.scenes[scene],
        "est_name": score.name if len(score.matched.scenes) == 1 else f"{score.name} {score.matched.scenes[scene]}",
        "label": "APE (m)",
    }
    arrays = {"error_array": error_m, "distances_from_start": score.distance_m[rows]}
    if truth.timestamps_s is not None:
        arrays["timestamps"] = truth.timestamps_s
        arrays["seconds_from_start"] = truth.timestamps_s - truth.timestamps_s[0]
    with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w") as archive:
        archive.writestr("info.json", json.dumps(info))
        archive.writestr("stats.json", json.dumps({name: float(value) for name, value in statistics.items()}))
        for name, array in arrays.items():
            buffer = io.BytesIO()
            np.save(buffer, array)
            archive.writestr(f"{name}.npy", buffer.getvalue())
        for name, trajectory in (("groundtruth", truth), ("estimate", estimate)):
            timed = trajectory.timestamps_s is not None
            archive.writestr(f"{name}.{'tum' if timed else 'kitti'}", (tum_text if timed else kitti_text)(trajectory))
