"""Named selections of nuScenes channels and scenes."""

from __future__ import annotations

CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_BACK", "CAM_BACK_RIGHT")
"""The paper's four cameras, in the order of every table and array."""

ALL_CAMERAS = ("CAM_FRONT", "CAM_FRONT_LEFT", "CAM_FRONT_RIGHT", "CAM_BACK", "CAM_BACK_LEFT", "CAM_BACK_RIGHT")
"""The six cameras of the nuScenes car."""
