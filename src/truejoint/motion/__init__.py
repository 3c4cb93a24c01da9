"""Trajectories as data, and what drives an arm along them."""

from truejoint.motion.files import read_trajectory, write_trajectory
from truejoint.motion.follow import TrackingReport, follow, nominal_duration
from truejoint.motion.plotting import plot_trajectories
from truejoint.motion.random_motion import random_motion
from truejoint.motion.trajectory import Trajectory, workspace_of
from truejoint.motion.zigzag import DIRECTIONS, zigzag
from truejoint.robots import Workspace

__all__ = [
    "DIRECTIONS",
    "TrackingReport",
    "Trajectory",
    "Workspace",
    "follow",
    "nominal_duration",
    "plot_trajectories",
    "random_motion",
    "read_trajectory",
    "workspace_of",
    "write_trajectory",
    "zigzag",
]
