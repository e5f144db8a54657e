"""Lettering reads from left to right, whichever side of a thing the camera sees."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from mixo_env.simulator.city import furniture
from mixo_env.simulator.city.ground import ground_texture
from mixo_env.simulator.city.materials import city_materials
from mixo_env.simulator.city.mesh import Mesh, normals
from mixo_env.simulator.city.textures import Atlas
from mixo_env.simulator.city.vehicle_models import vehicle_models

pytestmark = pytest.mark.rendering


class _Kept(Atlas):
    """Remembers the pictures it is given."""

    def __init__(self) -> None:
        super().__init__()
        self.pictures: list[np.ndarray] = []

    def add(self, image: np.ndarray) -> int:
        self.pictures.append(image)
        return super().add(image)


def _reads_rightwards(patches: Mesh) -> bool:
    """Whether texture columns grow to the right of whoever looks at the visible side (upright patches)."""
    right = np.cross(-normals(patches), (0.0, 0.0, 1.0))  # of a viewer who looks against the normal, head up
    return bool((np.sum(patches["edge_u"] * right, axis=1) * patches["texel"][:, 0] > 0.0).all())


def test_both_sides_of_a_lorry_carry_the_same_readable_name() -> None:
    atlas = _Kept()
    model = vehicle_models(atlas, np.random.default_rng(4), 0, 16.0)["truck", 4]
    left, right = (atlas.pictures[texture][..., :3] for texture in model["texture"][:2])
    assert _reads_rightwards(model[:2])
    # The name stands above the band, behind the gap at the cab.
    name = np.ascontiguousarray(left[40:86, 150:330])

    def found(picture: np.ndarray) -> float:
        return float(cv2.matchTemplate(np.ascontiguousarray(right), picture, cv2.TM_CCOEFF_NORMED).max())

    assert found(name) > 0.9
    assert found(np.ascontiguousarray(name[:, ::-1])) < 0.7


@pytest.mark.parametrize("seed", range(3))
def test_signs_face_the_near_lane_and_have_a_bare_back(seed: int) -> None:
    atlas, rng = Atlas(), np.random.default_rng(seed)
    materials = city_materials(atlas, rng, atlas.add(ground_texture(rng, 64)), 1.0, 1, 1.0)
    mesh = furniture.traffic_sign(materials, rng)
    lettered = mesh[np.isin(mesh["texture"], materials.signs)]
    assert len(lettered) == 1
    assert lettered["shape"][0] == 0, "seen from behind it would be mirrored"
    assert _reads_rightwards(lettered)
    # Right-hand traffic: whoever drives along the near side comes from +x of this frame.
    assert normals(lettered)[0] == pytest.approx((1.0, 0.0, 0.0))
    assert (normals(mesh) == (-1.0, 0.0, 0.0)).all(axis=1).any(), "and a back"
