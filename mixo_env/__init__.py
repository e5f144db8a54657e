"""MixoOdometry: a Gymnasium benchmark of mixture-of-experts visual odometry for multi-camera cars."""

from __future__ import annotations

from importlib.metadata import version

__version__ = version("mixo-env")
