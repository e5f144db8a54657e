"""Gymnasium environments over recordings."""
