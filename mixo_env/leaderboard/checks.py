"""What recordings hold nothing of."""

from __future__ import annotations

import numpy as np

from mixo_env.recordings.collection import Recordings


def silent_experts(recordings: Recordings) -> tuple[str, ...]:
    """Experts without an increment in any step: their rows show what stands in for them."""
    return tuple(e for e in recordings.experts if not np.isfinite(recordings[f"{e}.yaw_increment_rad"]).any())
