"""ORB-SLAM3 (University of Zaragoza, GPL) as a yardstick for single-camera odometry."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from experiments.peers.environments import ORBSLAM3, peer_python
from mixo_env.errors import MixoError

FloatArray = NDArray[np.float64]

_BORDER_PX = 32  # a pyramid level must be wider than the rim that its corner detector leaves out


@dataclass(frozen=True)
class OrbSettings:
    """Settings of its feature extractor; the defaults are those of its KITTI examples."""

    features: int = 2000
    levels: int = 8
    scale_factor: float = 1.2
    fast_threshold: int = 20
    fast_threshold_low: int = 7

    def fitting(self, height: int, width: int) -> OrbSettings:
        """With as many of the levels as an image of that size has room for: it crashes on levels without any."""
        levels = self.levels
        while levels > 1 and round(min(height, width) / self.scale_factor ** (levels - 1)) <= _BORDER_PX:
            levels -= 1
        return OrbSettings(self.features, levels, self.scale_factor, self.fast_threshold, self.fast_threshold_low)


@dataclass(frozen=True)
class OrbRun:
    """What ORB-SLAM3 said about ``n`` images.

    Attributes:
        rotation: ``(n, 3, 3)`` world from camera, each as given with its image; NaN unless its state is OK.
        position: ``(n, 3)`` of the camera in the world, unknown scale; NaN likewise.
        state: its word for each image, e.g. ``"OK"``, ``"NOT_INITIALIZED"``, ``"RECENTLY_LOST"``.
        matches: ``(n,)`` map points tracked in each image; 0 unless its state is OK.
        tracking_ms: ``(n,)`` CPU of the thread that tracks.
        late_s: ``(n,)`` how long after its due time each image was handed over.
        process_ms: CPU of the whole process per image: tracking and mapping.
    """

    rotation: FloatArray
    position: FloatArray
    state: tuple[str, ...]
    matches: NDArray[np.int64]
    tracking_ms: FloatArray
    late_s: FloatArray
    process_ms: float

    def yaw_increments(self, rotation_ego_from_camera: FloatArray) -> FloatArray:
        """Turn of the car between consecutive images ``(n - 1,)`` [rad], left positive; NaN unless both are tracked.

        Args:
            rotation_ego_from_camera: ``(3, 3)`` mounting of the camera.
        """
        turn = np.swapaxes(self.rotation[:-1], 1, 2) @ self.rotation[1:]
        turn = rotation_ego_from_camera @ turn @ rotation_ego_from_camera.T
        return np.arctan2(turn[:, 1, 0], turn[:, 0, 0])


def orbslam3_python() -> Path | None:
    """The interpreter of ORB-SLAM3's environment, created if need be; ``None`` when it cannot be."""
    python = peer_python(ORBSLAM3)
    if (
        python is None
        or subprocess.run([python, "-c", "import pyorbslam3"], capture_output=True, check=False).returncode
    ):
        return None  # its wheel leaves graphics libraries to the system
    return python


def run_orbslam3(
    python: Path,
    images: Sequence[NDArray[np.uint8]],
    timestamp_us: NDArray[np.int64],
    intrinsic: FloatArray,
    vocabulary: Path,
    settings: OrbSettings,
    pace: float | None = 1.0,
) -> OrbRun:
    """Show ORB-SLAM3 a camera's images in time order (its threads race: two runs differ a little).

    Args:
        python: from :func:`orbslam3_python`.
        images: ``n`` grey ones of one size.
        timestamp_us: ``(n,)`` increasing.
        intrinsic: ``(3, 3)`` pixel matrix of a pinhole camera without skew.
        vocabulary: DBoW2 text file, see :mod:`experiments.peers.orbslam3_words`.
        settings: of its extractor.
        pace: share of real time at which images are handed over, below 1 on a machine that does other things; ``None``
            hands each over when mapping is at rest, or has had a processor for one interval since the last.

    Raises:
        MixoError: ORB-SLAM3 died.
    """
    times_s = 1e-6 * (timestamp_us - timestamp_us[0])
    with tempfile.TemporaryDirectory(prefix="orbslam3-") as name:
        folder = Path(name)
        np.save(folder / "images.npy", np.stack(images))
        rate_hz = 1.0 / float(np.median(np.diff(times_s)))
        (folder / "settings.yaml").write_text(_yaml(intrinsic, images[0].shape, rate_hz, settings), encoding="ascii")
        job = {
            "images": str(folder / "images.npy"),
            "times_s": times_s.tolist(),
            "pace": pace,
            "settings": str(folder / "settings.yaml"),
            "vocabulary": str(vocabulary),
            "result": str(folder / "result.json"),
        }
        result = _served(python, folder, job)
    lost = np.full((4, 4), np.nan)
    pose = np.array([lost if found is None else found for found in result["poses"]], np.float64)
    return OrbRun(
        pose[:, :3, :3],
        pose[:, :3, 3],
        tuple(result["states"]),
        np.array(result["matches"], np.int64),
        1e3 * np.array(result["tracking_s"]),
        np.array(result["late_s"]),
        1e3 * result["process_s"] / len(times_s),
    )


def _served(python: Path, folder: Path, job: dict[str, Any]) -> dict[str, Any]:
    """What the peer's process answers to a job, in a temporary folder."""
    run = subprocess.run(
        [str(python), str(Path(__file__).with_name("orbslam3_api.py"))],
        input=json.dumps(job),
        capture_output=True,
        text=True,
        check=False,
        cwd=folder,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )
    if run.returncode != 0 or not (folder / "result.json").exists():
        last = (run.stderr or run.stdout).strip().splitlines()[-1:]
        raise MixoError(f"ORB-SLAM3 ended with code {run.returncode}: {' '.join(last) or 'no message'}")
    return json.loads((folder / "result.json").read_text(encoding="ascii"))


def _yaml(intrinsic: FloatArray, shape: tuple[int, ...], rate_hz: float, settings: OrbSettings) -> str:
    """Settings in the format of OpenCV's YAML reader, which tells 1.0 from 1; the viewer's are obligatory, not used."""
    entries: dict[str, object] = {
        "File.version": '"1.0"',
        "Camera.type": '"PinHole"',
        "Camera1.fx": float(intrinsic[0, 0]),
        "Camera1.fy": float(intrinsic[1, 1]),
        "Camera1.cx": float(intrinsic[0, 2]),
        "Camera1.cy": float(intrinsic[1, 2]),
        **{f"Camera1.{name}": 0.0 for name in ("k1", "k2", "p1", "p2")},
        "Camera.width": shape[1],
        "Camera.height": shape[0],
        "Camera.fps": round(rate_hz),
        "Camera.RGB": 1,
        "loopClosing": 0,  # the paper has it off, and a pose that jumps to close a loop is no odometry
        "ORBextractor.nFeatures": settings.features,
        "ORBextractor.scaleFactor": float(settings.scale_factor),
        "ORBextractor.nLevels": settings.levels,
        "ORBextractor.iniThFAST": settings.fast_threshold,
        "ORBextractor.minThFAST": settings.fast_threshold_low,
        **{f"Viewer.{name}Size": 1.0 for name in ("KeyFrame", "Point", "Camera")},
        **{f"Viewer.{name}LineWidth": 1.0 for name in ("KeyFrame", "Graph", "Camera")},
        **{f"Viewer.Viewpoint{name}": 1.0 for name in "XYZF"},
    }
    return "%YAML:1.0\n" + "".join(f"{key}: {value}\n" for key, value in entries.items())
