"""Single-camera odometry: features, matching, motion, tracking."""
