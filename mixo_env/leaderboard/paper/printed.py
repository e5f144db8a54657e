"""What the paper prints: Morra, Biondo, Poerio, Lamberti, IEEE Trans. Consumer Electronics 69(3), 2023, pp. 261-270.

doi 10.1109/TCE.2023.3238655. Their data are 736 scenes of nuScenes; nothing here may be read as a result on other data.
"""

from __future__ import annotations

from dataclasses import dataclass

from mixo_env.recordings.variants import WITHOUT_INITIALISATION

PRINTED_ON = "736 scenes of nuScenes trainval"
SCENES = 736


@dataclass(frozen=True)
class PrintedRow:
    """One row of Table I.

    Attributes:
        label: as printed.
        name: of the same row here.
        translation_percent, rotation_deg_per_m: RTE.
        lost_mean, lost_std: tracks lost per scene.
    """

    label: str
    name: str
    translation_percent: float
    rotation_deg_per_m: float
    lost_mean: float
    lost_std: float


def _retrained(camera: str) -> tuple[str, str]:
    return f"{camera} w/ retrained vocab.", f"{camera} w/ retrained vocabulary"


TABLE_1 = (
    PrintedRow("CAM_FRONT w/o inertial initialization", WITHOUT_INITIALISATION, 7.37, 0.238, 0.89, 2.58),
    PrintedRow("CAM_FRONT", "CAM_FRONT", 1.68, 0.029, 0.76, 1.93),
    PrintedRow("CAM_BACK", "CAM_BACK", 3.85, 0.077, 0.74, 3.14),
    PrintedRow("CAM_BACK_RIGHT", "CAM_BACK_RIGHT", 6.75, 0.241, 5.83, 6.20),
    PrintedRow(*_retrained("CAM_BACK_RIGHT"), 5.57, 0.146, 4.43, 4.89),
    PrintedRow("CAM_FRONT_LEFT", "CAM_FRONT_LEFT", 8.93, 0.232, 7.00, 5.58),
    PrintedRow(*_retrained("CAM_FRONT_LEFT"), 7.59, 0.204, 4.68, 5.58),
    PrintedRow("HIGHEST MATCH", "HIGHEST MATCH", 2.18, 0.072, 0.0, 0.0),
    PrintedRow("LINEAR", "LINEAR", 1.57, 0.026, 0.0, 0.0),
    PrintedRow("MIXO", "MIXO", 1.44, 0.019, 0.0, 0.0),
    PrintedRow("MULTICAMERA GT", "MULTICAMERA GT", 1.46, 0.012, 0.0, 0.0),
)
"""Table I, in its order."""

TABLE_2 = {
    "scenes 1-184": (1.44, 0.018),
    "scenes 185-368": (1.43, 0.016),
    "scenes 369-552": (1.44, 0.021),
    "scenes 553-736": (1.46, 0.022),
    "overall": (1.44, 0.019),
}
"""Table II: split -> MIXO's translation [%] and rotation [deg/m]."""

GAIN_PERCENT = (-15.0, -38.0)
"""MIXO against CAM_FRONT in the text, translation and rotation; Table I's rounded numbers give -14 % and -34 %."""

BEST_SHARE = {"CAM_FRONT": 0.39, "CAM_FRONT_LEFT": 0.20, "CAM_BACK": 0.20, "CAM_BACK_RIGHT": 0.20}
"""Eq. 2: share of time points at which a camera is locally best; of the last three only their mean is printed."""

LINEAR_WEIGHTS = {"CAM_FRONT": 0.851, "CAM_FRONT_LEFT": 0.020, "CAM_BACK": 0.031, "CAM_BACK_RIGHT": 0.013}
LINEAR_WEIGHTS |= {"INERTIAL_POSE": 0.1222}
"""LINEAR's constant weights; their sum is 1.037."""

FIGURE_5_ATE_M = {
    "scene-0057": (0.209, 0.138),
    "scene-0393": (0.591, 0.120),
    "scene-0971": (0.382, 0.198),
    "scene-0345": (1.618, 0.233),
}
"""Scene -> ATE [m] of CAM_FRONT and of MIXO."""

HIGH_ATE_SCENES = 29
"""Of 736: CAM_FRONT's ATE is above 0.5 m (Fig. 6)."""

FIGURE_7_END = (200.0, 0.7, 0.002)
"""Where the curves of Fig. 7 end: length [m], translation [%], rotation [deg/m]."""

FRAME_MS = (10.0, 80.0)
"""Run time of a frame, on a desktop of 4 to 8 cores."""

REAL_TIME_MS = 1e3 / 12.0
"""Between two images of a camera."""
