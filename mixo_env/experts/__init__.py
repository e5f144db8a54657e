"""Odometry experts: one camera each, inertial, or imported from a file."""
