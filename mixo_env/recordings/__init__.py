"""Experts recorded once and replayed exactly."""
