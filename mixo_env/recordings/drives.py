"""A drive by its own name: what a car did, whatever was recorded of it."""

from __future__ import annotations

import hashlib

import numpy as np

from mixo_env.recordings.collection import Recordings

_DIGITS = {"x_m": 4, "y_m": 4, "yaw_rad": 6}


def drive_hash(recordings: Recordings, scene: str | int) -> str:
    """Hash of the drive of one scene: its times and poses, exact ones where they exist, else those written.

    Experts, data versions, picture sizes and names do not enter, so a drive is known again in any recording of it with
    the same clock. Poses are rounded to 0.1 mm and a millionth of a radian: simulated truth differs in its last digits
    from machine to machine.

    Args:
        recordings: that hold the scene.
        scene: its name or position.

    Raises:
        ConfigurationError: for an unknown name.
    """
    columns = recordings.rows(scene)
    exact = all(np.isfinite(columns[f"exact.{name}"]).all() for name in _DIGITS)
    # Poses that were freed of their lag depend on what the lag was fitted on; those written stay what they are.
    kind = "exact" if exact else "written" if "written.x_m" in columns else "truth"
    digest = hashlib.blake2b(b"exact" if exact else b"written", digest_size=16)
    digest.update(np.ascontiguousarray(columns["timestamp_us"], dtype="<i8").tobytes())
    for name, digits in _DIGITS.items():
        rounded = np.round(columns[f"{kind}.{name}"].astype("<f8"), digits) + 0.0  # no negative zero
        digest.update(np.where(np.isnan(rounded), np.nan, rounded).tobytes())
    return digest.hexdigest()
