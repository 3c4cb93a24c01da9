"""Constants of the equations of an arm, from its parameters and from what its hardware is."""

from typing import Any, NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.errors import TruejointError
from truejoint.robots import Robot
from truejoint.simulation.arm import kernel
from truejoint.simulation.arm.parameters import ArmParameters


class Hardware(NamedTuple):
    """What an arm's own software knows of it, and how its real mechanism differs.

    Of the seven joints the first n have cables that give way; efforts are at the capstan, in the
    units in which the robot reports them.
    """

    matrix: Array  # (7, 7) motor angle per joint position, lower triangular
    ratio: Array  # (7,) the same without coupling
    gear: Array  # (7,) motor turns per capstan turn
    radius: Array  # (n,) at which the capstan winds the cable [m]
    gains: Array  # (7, 3) proportional, derivative, integral: effort per motor angle
    effort_limit: Array  # (7,)
    effort_step: Array  # (7,)
    counts: Array  # (7,) of a motor encoder, per turn
    coupling_error: Array  # (n, n) real less nominal coupling of the cables, lower triangular
    scale: Array  # (n,) error of the joint's travel per motor travel
    anchor: tuple[Array, Array]  # (n,) pose by the motors and by the joints that belong together
    stops: Array  # (n, 2)
    run_out: tuple[tuple[Array, Array], tuple[Array, Array]]
    """Size [m] and phase (n,) of the capstans and of the pulleys at the first two joints."""
    sideways: Array  # (n, n) m per joint motion, row: cable, column: joint
    aligned: Array  # (n,) pose where every run is straight
    free_run: Array  # (n,) m
    gravity: Array  # (2, 12), see `gravity_potential`
    truth_step: Array  # (n,) resolution of the joint encoders


def build_plant(p: ArmParameters, robot: Robot, hardware: Hardware) -> kernel.Plant:
    """Constants of the equations of one arm.

    Raises TruejointError if a motor is too light for its friction, cable or gains at the step.
    """
    h, n = hardware, p.ON_CABLES
    nominal = h.matrix[:n, :n] / h.ratio[:n, None]
    real = np.tril(nominal, -1) + np.eye(n) + h.coupling_error
    inertia = np.array(p.motor.inertia + p.tool.inertia)
    viscous = np.array(p.motor_friction.viscous + p.tool.viscous) / h.gear
    # Viscous friction is taken at the end of the step, so that it never overshoots.
    keep = 1.0 / (1.0 + kernel.DT * viscous / inertia)
    _check_step(p, robot, h, inertia)
    return kernel.Plant(
        axes=tuple(range(n)),
        motor_from_joint=np.ascontiguousarray(h.matrix),
        joint_from_motor=np.ascontiguousarray(np.linalg.inv(h.matrix)),
        per_ratio=1.0 / h.ratio,
        per_gear=1.0 / h.gear,
        push=kernel.DT * keep / inertia,
        keep=keep,
        coulomb=np.array(p.motor_friction.coulomb + p.tool.coulomb) / h.gear,
        bend=kernel.DT / np.array(p.motor_friction.presliding + p.tool.presliding),
        gains=h.gains,
        effort_limit=h.effort_limit,
        effort_step=h.effort_step,
        channel=np.array(robot.joint_channels),
        friction=np.column_stack(
            [p.joint_friction.coulomb, p.joint_friction.load_share, p.joint_friction.presliding]
        ),
        stiffness=np.array(p.cable.stiffness),
        scale=1.0 + h.scale,
        anchor=np.column_stack([nominal @ h.anchor[0], real @ h.anchor[1]]),
        coupling=real,
        per_arm=h.gear[:n] / (h.radius * h.ratio[:n]),
        run_out=np.column_stack(
            [size * wave(phase) for size, phase in h.run_out for wave in (np.sin, np.cos)]
        ),
        sideways=h.sideways,
        sideways_zero=np.asarray(h.sideways @ h.aligned),
        per_run=0.5 / h.free_run,
        stops=h.stops,
        gravity=h.gravity,
        creep=np.column_stack([p.creep.final, p.creep.travel]),
        truth_step=h.truth_step,
        motor_friction=p.motor_friction,
        aging=p.creep,
        tool_wander=np.array([p.tool.wander, p.tool.wander_effort]),
        tool_wander_time=p.tool.wander_time,
        encoders=p.external_encoders,
        truth_period=1.0 / p.external_encoders.rate,
        counts=h.counts,
    )


def _check_step(p: ArmParameters, robot: Robot, h: Hardware, inertia: Array) -> None:
    """Refuse what the step of 1 ms cannot resolve: a mode may turn one radian in a step."""
    coulomb = p.motor_friction.coulomb + p.tool.coulomb
    presliding = p.motor_friction.presliding + p.tool.presliding
    cable = np.array([*p.cable.stiffness, *(7 - p.ON_CABLES) * [0.0]])
    # Stuck, the motor turns against bristles, cable and its own controller.
    stiff = (np.divide(coulomb, presliding) + h.gains[:, 0]) / h.gear + cable / h.ratio**2
    needed = np.maximum(kernel.DT**2 * stiff, kernel.DT * h.gains[:, 1] / h.gear)
    for joint, light, least in zip(robot.joint_names, inertia, needed, strict=True):
        if not least <= light:
            raise TruejointError(
                f"the {joint}'s motor is too light for a step of 1 ms: raise its inertia "
                f"from {light:.3g} to {least:.3g} kg m2, or lower its friction or its "
                "cable's stiffness"
            )


def build_state(plant: kernel.Plant, pose: Array, seed: int) -> kernel.State:
    """State of a cold robot at rest in `pose` (n,), its encoders not registered."""
    n = len(pose)
    motor = np.zeros(7)
    motor[:n] = (plant.motor_from_joint[:n, :n] @ pose).ravel()
    zeros = {"speed": 7, "bristle": 7, "encoder_zero": 7, "integral": 7, "lag": n, "carried": n}
    zeros |= {"creep": n, "odometer": n}
    random = np.array([seed, ~np.uint64(seed)], dtype=np.uint64)
    return kernel.State(
        motor=motor,
        command=motor.copy(),
        counts=np.floor(motor / (kernel.TURN / plant.counts)),
        **{name: pose.copy() for name in ("joint", "before", "drive")},
        **{name: np.zeros(length) for name, length in zeros.items()},
        wave=np.zeros((n + 2, 2)),
        tool=np.zeros((3, 7 - n)),
        slow=np.zeros(kernel.N_SLOW),
        ticks=np.zeros(2, dtype=np.int64),
        walk=np.array([plant.motor_friction.wander * kernel.normal(random) for _ in range(n)]),
        random=random,
    )


def gravity_potential(
    robot: Robot, mass: Array, centre: Array, gravity: tuple[float, float, float]
) -> Array:
    """Coefficients (2, 12) [J] of `kernel.gravity_load`: the links, and 1 kg at the tool.

    `mass` (3,) [kg] and `centre` of mass (3, 3) [m] are those of the first three links, each in the
    frame of its own axis, `gravity` [m/s^2] is in the base frame. The robot's own link frames in 24
    poses give 12 coefficients, exactly.
    """
    chain: Any = robot.kinematics
    poses = np.tile(robot.home, (24, 1))
    steps = np.arange(24)
    poses[:, :3] = np.column_stack(
        [np.cos(steps), 2.0 * np.sin(1.7 * steps), 0.3 + 0.1 * np.cos(2.3 * steps)]
    )
    frames, down = chain.link_frames(poses), np.array(gravity)
    height = np.zeros((24, 2))
    for k in range(3):
        place = frames[:, k, :3, 3] + frames[:, k, :3, :3] @ centre[k]
        height[:, 0] -= mass[k] * (place @ down)
    height[:, 1] = -(chain.forward(poses)[:, :3, 3] @ down)
    q1, q2, d = poses[:, :3].T
    ones = np.ones_like(d)
    basis = np.column_stack(
        [
            first * second * insertion
            for first in (np.cos(q1), np.sin(q1))
            for second in (ones, np.cos(q2), np.sin(q2))
            for insertion in (ones, d)
        ]
    )
    coefficients: Array = np.linalg.lstsq(basis, height, rcond=None)[0].T
    return np.ascontiguousarray(coefficients).reshape(2, 12)
