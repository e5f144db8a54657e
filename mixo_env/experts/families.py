"""Names of further experts: other programs that see a camera's images, called ``FAMILY_CAMERA``.

They vote together with the cameras' own odometry in the track UNEQUAL and in no other: ``TUTORIAL_FRONT_LEFT`` is the
tutorial's odometry on the images of CAM_FRONT_LEFT.
"""

from __future__ import annotations

FAMILIES = ("TUTORIAL", "ORBSLAM3", "LEARNED")
"""Programs of which there is one expert a camera."""

_CHANNEL = "CAM_"


def family_expert(family: str, camera: str) -> str:
    """The name of a family's expert on one camera, e.g. ``("TUTORIAL", "CAM_FRONT")`` -> ``"TUTORIAL_FRONT"``."""
    return f"{family}_{camera.removeprefix(_CHANNEL)}"


def is_family_expert(name: str) -> bool:
    """Whether a name is that of a family's expert on some camera."""
    return any(name.startswith(f"{family}_") for family in FAMILIES)
