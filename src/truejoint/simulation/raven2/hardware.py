"""The RAVEN-II arm as its twin takes it: its software's numbers, and how the real arm differs."""

import numpy as np

from truejoint.robots import Robot
from truejoint.robots.raven2 import hardware
from truejoint.simulation.arm.plant import Hardware, gravity_potential
from truejoint.simulation.raven2.parameters import Raven2Parameters


def build_hardware(p: Raven2Parameters, robot: Robot) -> Hardware:
    """Hardware of an arm that is called as `robot` is."""
    drives = hardware.drives(robot.arm)
    ratio = np.array([drive.transmission_ratio for drive in drives])
    assert robot.transmission is not None  # noqa: S101 - for the type checker; RAVEN-II has one
    coupling_error = np.zeros((3, 3))
    below = np.tril_indices(3, -1)  # shoulder-elbow, shoulder- and elbow-insertion
    coupling_error[below] = [
        p.pulleys.coupling_shoulder_elbow,
        p.pulleys.coupling_shoulder_insertion,
        p.pulleys.coupling_elbow_insertion,
    ]
    truth_stop = np.array([encoder.hard_stop for encoder in robot.encoders])
    # One stop is where homing looks for it, the other 5 % beyond the soft limit.
    margin = 0.05 * (robot.upper - robot.lower)
    stops = np.column_stack([robot.lower - margin, robot.upper + margin])[:3]
    stops[0, 0], stops[1:, 1] = truth_stop[0], truth_stop[1:]
    links = hardware.links(robot.arm)
    # The carriage holds the instrument, whose weight the published link leaves out.
    mass = [link.mass for link in links]
    mass[2] += p.mass.instrument
    return Hardware(
        matrix=robot.transmission.matrix,
        ratio=ratio,
        gear=np.array([drive.gear_ratio for drive in drives]),
        radius=np.array([drive.capstan_radius for drive in drives[:3]]),
        gains=np.array([[drive.kp, drive.kd, drive.ki] for drive in drives]),
        effort_limit=np.array([drive.max_effort for drive in drives]),
        effort_step=np.array([drive.torque_per_amp / drive.dac_per_amp for drive in drives]),
        counts=np.full(7, float(hardware.ENCODER_COUNTS_PER_REV)),
        coupling_error=coupling_error,
        scale=np.array(p.pulleys.scale),
        anchor=(np.array([drive.hard_stop for drive in drives[:3]]), truth_stop),
        stops=stops,
        run_out=(
            (np.array(p.pulleys.capstan_run_out), np.array(p.pulleys.capstan_phase)),
            (np.array(p.pulleys.joint_run_out), np.array(p.pulleys.joint_phase)),
        ),
        sideways=np.column_stack(
            [p.wrap.sideways_shoulder, p.wrap.sideways_elbow, p.wrap.sideways_insertion]
        ),
        aligned=np.array(p.wrap.aligned),
        free_run=np.array(p.wrap.free_run),
        gravity=gravity_potential(
            robot, mass, [link.centre_of_mass for link in links], hardware.GRAVITY
        ),
        truth_step=np.array([encoder.resolution for encoder in robot.encoders]),
    )
