"""Scores of trajectory files: `mixo evaluate`."""
