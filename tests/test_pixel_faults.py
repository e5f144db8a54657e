"""Pixel faults change the picture inside their seconds only."""

import numpy as np
import pytest

from mixo_env.errors import ConfigurationError
from mixo_env.simulator.picture.faults import KINDS, PixelFault, spoil


@pytest.mark.parametrize("kind", KINDS)
def test_a_fault_changes_pictures_inside_its_seconds_only(kind: str) -> None:
    image, last = np.full((2, 3, 3), 9, np.uint8), np.full((2, 3, 3), 5, np.uint8)
    fault = PixelFault(kind, "CAM_FRONT", 1.0, 2.0)
    assert (spoil(image, last, fault, 1.0) == {"frozen": 5, "black": 0}[kind]).all()
    assert spoil(image, last, fault, 0.9) is image
    assert spoil(image, last, fault, 2.0) is image
    assert (image == 9).all()


def test_an_unknown_fault_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="frozen"):
        PixelFault("frozn", "CAM_FRONT", 1.0, 2.0)
