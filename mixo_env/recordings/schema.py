"""The recording: one row per step and scene, and the manifest beside it.

Row 0 of a scene is its start (no increment, ``dt_s`` 0); rows 1..T are steps. Step k closes at t_k, the time of the
last image of firing round k among the recorded cameras; an increment in row k covers (t_{k-1}, t_k]. Ground truth and
times are float64, everything else is float32, and a value that does not exist is NaN.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

SCHEMA_VERSION = 2

INERTIAL_EXPERTS = ("INERTIAL", "INERTIAL_POSE", "INERTIAL_CONSUMER")
"""wheels + ms_imu; the paper's CAN ``pose``; wheels + vehicle_monitor or production-grade gyro."""

UNEQUAL = "UNEQUAL"
"""The track in which experts of other families (``experts/families.py``) vote beside the cameras."""

TRACKS: dict[str, str | None] = {
    "PAPER": "INERTIAL_POSE",
    "VISION": None,
    "CONSUMER": "INERTIAL_CONSUMER",
    UNEQUAL: None,
}
"""Track -> the inertial expert that votes beside the cameras (``None``: none does). Never mixed in one table."""

HEADLINE_TRACKS = tuple(track for track in TRACKS if track != UNEQUAL)
"""Those in which the cameras' own odometry votes: recording more experts changes nothing in them."""

SPLITS: dict[str, tuple[int, ...]] = {"train": (0, 1, 2), "test": (3,), "all": (0, 1, 2, 3), "ood": (-1,)}
"""Named splits -> folds; fold -1 holds the night scenes, which are in no fold of the cross-validation.

Where one log after another is left out there are more folds than these four: they count as "train" and "all".
"""


def in_split(fold: int, split: str) -> bool:
    """Whether a fold belongs to a named split."""
    return fold in SPLITS[split] or (fold > max(SPLITS["all"]) and split in ("train", "all"))


STEP_COLUMNS: dict[str, str] = {
    "step": "int32",
    "timestamp_us": "int64",  # t_k, Unix microseconds
    "time_s": "float64",  # t_k - t_0
    "dt_s": "float64",  # t_k - t_{k-1}; 0 in row 0
    "is_keyframe": "bool",  # the image that closes the step is a key frame
    "truth.x_m": "float64",  # ego pose of the image that closes the step, map frame
    "truth.y_m": "float64",
    "truth.yaw_rad": "float64",  # unwrapped
    "truth.yaw_increment_rad": "float64",  # NaN in row 0
    "truth.distance_m": "float64",  # chord between consecutive poses, signed by the heading; NaN in row 0
    "exact.x_m": "float64",  # noise-free truth of a simulator; NaN on real data
    "exact.y_m": "float64",
    "exact.yaw_rad": "float64",
    "distance_m": "float32",  # s_k of INERTIAL over the step; NaN in row 0
    "speed_mps": "float32",  # v_k of INERTIAL at t_k
}

INERTIAL_COLUMNS: dict[str, str] = {
    "yaw_increment_rad": "float32",  # over (t_{k-1}, t_k]; NaN when the grade's messages are missing
    "yaw_std_rad": "float32",  # standard deviation of that increment
}

CAMERA_COLUMNS: dict[str, str] = {
    "state": "int8",
    "image_time_offset_s": "float32",  # own image time - t_k (<= 0); NaN without an image
    "own_window_s": "float32",  # time since the camera's previous image; NaN without one
    "own_window_yaw_increment_rad": "float32",  # raw, over the own window; NaN unless TRACKING
    "own_window_yaw_std_rad": "float32",  # standard deviation of that increment
    "yaw_increment_rad": "float32",  # over (t_{k-1}, t_k]: carried by the camera's own rate (``carry.py``); NaN unless
    # TRACKING with images in both rounds
    "two_frame_yaw_increment_rad": "float32",  # stateless, from two images alone, scaled to the step; NaN if it fails
    "own_window_truth_yaw_increment_rad": "float64",  # from the poses at the camera's own times
    "yaw_std_rad": "float32",  # standard deviation of the carried increment
    "matches": "float32",  # matched features
    "inliers": "float32",  # estimate: share in agreement among the matches solved with (at most 800), times matches
    "residual_px": "float32",  # median reprojection residual of the inliers
    "flow_px": "float32",  # median optical flow of the matches
}

IMAGE_COLUMNS = ("image_time_offset_s", "own_window_s", "own_window_truth_yaw_increment_rad")
"""Camera columns that say when its images were taken, whatever its expert made of them."""

VARIANT_COLUMNS = {name: dtype for name, dtype in CAMERA_COLUMNS.items() if name not in IMAGE_COLUMNS}
"""A camera's expert run once more with other settings: what stands in place of that camera's own columns."""

IMPORTED_COLUMNS: dict[str, str] = {
    "state": "int8",  # LOST where no pose is near
    "yaw_increment_rad": "float32",  # over (t_{k-1}, t_k], from the turns between neighbouring poses
    "yaw_std_rad": "float32",  # these three: NaN unless a file beside the trajectory tells them
    "matches": "float32",
    "confidence": "float32",  # of the program's own making: recorded, but seen by no policy
}
"""A trajectory from a file. What the file does not tell is absent and masked, never invented."""

TRUE_DISTANCE = "truth"
"""Source of ``distance_m`` where the truth itself is: privileged, and said in every table."""


def columns(
    cameras: tuple[str, ...],
    inertial: tuple[str, ...],
    imported: tuple[str, ...] = (),
    variants: tuple[str, ...] = (),
) -> dict[str, str]:
    """All columns of a recording with these experts, in file order: name -> NumPy dtype."""
    table = dict(STEP_COLUMNS)
    for experts, layout in (
        (cameras, CAMERA_COLUMNS),
        (inertial, INERTIAL_COLUMNS),
        (imported, IMPORTED_COLUMNS),
        (variants, VARIANT_COLUMNS),
    ):
        table |= {f"{expert}.{name}": dtype for expert in experts for name, dtype in layout.items()}
    return table


def empty_columns(
    rows: int, cameras: tuple[str, ...], inertial: tuple[str, ...], variants: tuple[str, ...] = ()
) -> dict[str, NDArray[Any]]:
    """All columns of a scene, ``(rows,)`` each, filled with NaN (zero in columns that are not floats)."""
    layout = columns(cameras, inertial, variants=variants)
    return {name: np.full(rows, np.nan if "float" in dtype else 0, dtype) for name, dtype in layout.items()}


@dataclass(frozen=True)
class SceneEntry:
    """One scene of a recording, as the manifest lists it; ``values_hash`` covers its column values."""

    name: str
    log: str
    vehicle: str
    location: str
    conditions: tuple[str, ...]
    fold: int
    rows: int
    values_hash: str = ""


@dataclass(frozen=True)
class VehicleConstants:
    """Constants of one vehicle, fitted on training folds or fixed: never corrected from a test scene's poses."""

    wheel_scale: float = 1.0  # true distance / distance from the nominal wheel radius
    course_offset_rad: float = 0.0  # direction of travel minus ego heading
    can_latency_s: float = 0.0  # how late the wheel messages arrive
    pose_lag_s: float = 0.0  # how late the written poses are; 0 where it is not known


@dataclass(frozen=True)
class Manifest:
    """Everything about a recording but its rows.

    Attributes:
        data_version: e.g. ``"mixocity-0.1"``; part of every printed result.
        cameras, inertial, imported: experts by kind, in column order.
        counted: imported experts for which match counts are recorded.
        distance: where ``distance_m`` comes from: ``"INERTIAL"``, ``"wheels"``, an imported expert, or ``"truth"``.
        variants: name -> camera whose images it saw with other settings or by another program; scored, and a voter in
            no track but UNEQUAL, there only if it belongs to a family of further experts.
        parameters: resolved configuration of every expert, as plain JSON values.
        software: package -> version used when recording.
        scenes: in file order.
        vehicles: constants by vehicle.
        reward_scale_rad: sigma_0 by track: 1.4826 x median absolute deviation of LINEAR's yaw error.
        linear_weights: track -> fold held out (as text; ``"none"``: fitted on all folds) -> expert -> weight.
        camera_cost_ms: fixed processing cost per image and camera for budget environments.
    """

    data_version: str
    cameras: tuple[str, ...]
    inertial: tuple[str, ...]
    imported: tuple[str, ...]
    scenes: tuple[SceneEntry, ...]
    parameters: dict[str, Any] = field(default_factory=dict)
    software: dict[str, str] = field(default_factory=dict)
    vehicles: dict[str, VehicleConstants] = field(default_factory=dict)
    reward_scale_rad: dict[str, float] = field(default_factory=dict)
    linear_weights: dict[str, dict[str, dict[str, float]]] = field(default_factory=dict)
    camera_cost_ms: dict[str, float] = field(default_factory=dict)
    variants: dict[str, str] = field(default_factory=dict)
    counted: tuple[str, ...] = ()
    distance: str = "INERTIAL"
    schema_version: int = SCHEMA_VERSION
