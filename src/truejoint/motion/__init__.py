"""Trajectories as data, and what drives an arm along them."""

from truejoint.motion.calibration_motions import DIRECTIONS, PROFILES, random_motion, zigzag
from truejoint.motion.files import read_trajectory, write_trajectory
from truejoint.motion.follow import TrackingReport, follow, nominal_duration
from truejoint.motion.plotting import plot_trajectories
from truejoint.motion.trajectory import Trajectory, workspace_of
from truejoint.robots import Workspace

__all__ = [
    "DIRECTIONS",
    "PROFILES",
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
