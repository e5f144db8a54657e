"""JOINT: all cameras of a rig in one estimate per step (tight coupling)."""
