"""Constants of the twin's equations, from its parameters and from what the robot is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots import Robot
from truejoint.robots.raven2 import hardware
from truejoint.robots.raven2.arm import kinematics
from truejoint.robots.raven2.hardware import Drive
from truejoint.simulation.raven2 import kernel
from truejoint.simulation.raven2.parameters import Raven2Parameters

POSITIONING = 3


def build_plant(parameters: Raven2Parameters, robot: Robot) -> kernel.Plant:
    """Constants of the equations of one arm.

    Raises TruejointError if a motor is too light for its friction, cable or gains at the step.
    """
    p = parameters
    arm_drives = hardware.drives(robot.arm)
    ratio = np.array([drive.transmission_ratio for drive in arm_drives])
    gear = np.array([drive.gear_ratio for drive in arm_drives])
    radius = np.array([drive.capstan_radius for drive in arm_drives])
    assert robot.transmission is not None  # noqa: S101 - for the type checker; RAVEN-II has one
    matrix = robot.transmission.matrix
    nominal = matrix[:POSITIONING, :POSITIONING] / ratio[:POSITIONING, None]
    real = np.eye(POSITIONING)
    below = np.tril_indices(POSITIONING, -1)  # shoulder-elbow, shoulder- and elbow-insertion
    coupling = real[below] = nominal[below] + [
        p.pulleys.coupling_shoulder_elbow,
        p.pulleys.coupling_shoulder_insertion,
        p.pulleys.coupling_elbow_insertion,
    ]
    hard_stop = np.array([drive.hard_stop for drive in arm_drives[:POSITIONING]])
    inertia = np.array(p.motor.inertia + p.tool.inertia)
    viscous = np.array(p.motor_friction.viscous + p.tool.viscous) / gear
    # Viscous friction is taken at the end of the step, so that it never overshoots.
    keep = 1.0 / (1.0 + kernel.DT * viscous / inertia)
    _check_step(p, arm_drives, inertia)
    truth_stop = np.array([encoder.hard_stop for encoder in robot.encoders])
    # One stop is where homing looks for it, the other 5 % beyond the soft limit.
    margin = 0.05 * (robot.upper - robot.lower)
    stops = np.column_stack([robot.lower - margin, robot.upper + margin])[:POSITIONING]
    stops[0, 0], stops[1:, 1] = truth_stop[0], truth_stop[1:]
    sideways = np.column_stack(
        [p.wrap.sideways_shoulder, p.wrap.sideways_elbow, p.wrap.sideways_insertion]
    )
    run_out = (
        (np.array(p.pulleys.capstan_run_out), p.pulleys.capstan_phase),
        (np.array(p.pulleys.joint_run_out), p.pulleys.joint_phase),
    )
    return kernel.Plant(
        motor_from_joint=np.ascontiguousarray(matrix),
        joint_from_motor=np.ascontiguousarray(np.linalg.inv(matrix)),
        per_ratio=1.0 / ratio,
        per_gear=1.0 / gear,
        push=kernel.DT * keep / inertia,
        keep=keep,
        coulomb=np.array(p.motor_friction.coulomb + p.tool.coulomb) / gear,
        bend=kernel.DT / np.array(p.motor_friction.presliding + p.tool.presliding),
        gains=np.array([[drive.kp, drive.kd, drive.ki] for drive in arm_drives]),
        effort_limit=np.array([drive.max_effort for drive in arm_drives]),
        effort_step=np.array([drive.torque_per_amp / drive.dac_per_amp for drive in arm_drives]),
        channel=np.array(robot.joint_channels),
        friction=np.column_stack(
            [p.joint_friction.coulomb, p.joint_friction.load_share, p.joint_friction.presliding]
        ),
        stiffness=np.array(p.cable.stiffness),
        scale=1.0 + np.array(p.pulleys.scale),
        anchor=np.column_stack([nominal @ hard_stop, real @ truth_stop]),
        coupling=coupling,
        per_arm=(gear / (radius * ratio))[:POSITIONING],
        run_out=np.column_stack(
            [size * wave(phase) for size, phase in run_out for wave in (np.sin, np.cos)]
        ),
        sideways=sideways,
        sideways_zero=np.asarray(sideways @ np.array(p.wrap.aligned)),
        per_run=0.5 / np.array(p.wrap.free_run),
        stops=stops,
        gravity=gravity_potential(robot, p.mass.instrument),
        creep=np.column_stack([p.creep.final, p.creep.travel]),
        truth_step=np.array([encoder.resolution for encoder in robot.encoders]),
        motor_friction=p.motor_friction,
        aging=p.creep,
        tool_wander=np.array([p.tool.wander, p.tool.wander_effort]),
        tool_wander_time=p.tool.wander_time,
        encoders=p.external_encoders,
        truth_period=1.0 / p.external_encoders.rate,
        counts=float(hardware.ENCODER_COUNTS_PER_REV),
    )


def _check_step(p: Raven2Parameters, arm_drives: Iterable[Drive], inertia: Array) -> None:
    """Refuse what the step of 1 ms cannot resolve: a mode may turn one radian in a step."""
    coulomb = p.motor_friction.coulomb + p.tool.coulomb
    presliding = p.motor_friction.presliding + p.tool.presliding
    cable = (*p.cable.stiffness, 0.0, 0.0, 0.0, 0.0)
    for k, drive in enumerate(arm_drives):
        # Stuck, the motor turns against bristles, cable and its own controller.
        stiff = (coulomb[k] / presliding[k] + drive.kp) / drive.gear_ratio
        stiff += cable[k] / drive.transmission_ratio**2
        damped = drive.kd / drive.gear_ratio
        needed = max(kernel.DT**2 * stiff, kernel.DT * damped)
        if not needed <= inertia[k]:
            raise TruejointError(
                f"the {drive.joint}'s motor is too light for a step of 1 ms: raise its inertia "
                f"from {inertia[k]:.3g} to {needed:.3g} kg m2, or lower its friction or its "
                "cable's stiffness"
            )


def build_state(plant: kernel.Plant, pose: Array, seed: int) -> kernel.State:
    """State of a cold robot at rest in `pose` (3,), its encoders not registered."""
    motor = np.zeros(7)
    motor[:POSITIONING] = (plant.motor_from_joint[:POSITIONING, :POSITIONING] @ pose).ravel()
    count = kernel.TURN / hardware.ENCODER_COUNTS_PER_REV
    zeros = {"speed": 7, "bristle": 7, "encoder_zero": 7, "integral": 7, "lag": 3, "carried": 3}
    zeros |= {"creep": 3, "odometer": 3}
    random = np.array([seed, ~np.uint64(seed)], dtype=np.uint64)
    return kernel.State(
        motor=motor,
        command=motor.copy(),
        counts=np.floor(motor / count),
        **{name: pose.copy() for name in ("joint", "before", "drive")},
        **{name: np.zeros(length) for name, length in zeros.items()},
        wave=np.zeros((POSITIONING + 2, 2)),
        tool=np.zeros((3, 4)),
        slow=np.zeros(kernel.N_SLOW),
        ticks=np.zeros(2, dtype=np.int64),
        walk=np.array(
            [plant.motor_friction.wander * kernel.normal(random) for _ in range(POSITIONING)]
        ),
        random=random,
    )


def gravity_potential(robot: Robot, instrument: float) -> Array:
    """Coefficients (2, 12) [J] of `kernel.gravity_load`: the links, and 1 kg at the tool.

    Found from the robot's own link frames: 24 poses give 12 coefficients, exactly.
    """
    chain, arm_links = kinematics(robot.arm), hardware.links(robot.arm)
    poses = np.tile(robot.home, (24, 1))
    steps = np.arange(24)
    poses[:, :POSITIONING] = np.column_stack(
        [np.cos(steps), 2.0 * np.sin(1.7 * steps), 0.3 + 0.1 * np.cos(2.3 * steps)]
    )
    frames = chain.link_frames(poses)
    masses = [link.mass for link in arm_links]
    # The carriage holds the instrument, whose weight the published link leaves out.
    masses[2] += instrument
    height = np.zeros((24, 2))
    for k, (mass, link) in enumerate(zip(masses, arm_links, strict=True)):
        place = frames[:, k, :3, 3] + frames[:, k, :3, :3] @ np.array(link.centre_of_mass)
        height[:, 0] -= mass * (place @ np.array(hardware.GRAVITY))
    height[:, 1] = -(chain.forward(poses)[:, :3, 3] @ np.array(hardware.GRAVITY))
    q1, q2, d = poses[:, :POSITIONING].T
    ones = np.ones_like(d)
    basis = np.column_stack(
        [
            shoulder * elbow * insertion
            for shoulder in (np.cos(q1), np.sin(q1))
            for elbow in (ones, np.cos(q2), np.sin(q2))
            for insertion in (ones, d)
        ]
    )
    coefficients: Array = np.linalg.lstsq(basis, height, rcond=None)[0].T
    return np.ascontiguousarray(coefficients).reshape(2, 12)
