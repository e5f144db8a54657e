"""nuScenes folders, real or simulated: reading, checking and writing the tables that odometry needs."""
