"""Trajectory scores: absolute and relative errors, alignment, lost tracks, intervals."""
