"""Trajectories as files hold them: timed poses in space, read from and written to TUM, KITTI, EuRoC and rpg layouts."""

from mixo_env.trajectory.formats import read_trajectory as read_trajectory
from mixo_env.trajectory.formats import write_kitti as write_kitti
from mixo_env.trajectory.formats import write_tum as write_tum
from mixo_env.trajectory.poses import Trajectory as Trajectory
