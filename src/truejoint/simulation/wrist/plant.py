"""Compiled dynamics of joints that several cables turn: C cables, J joints, M motors.

A cable runs from its end, at a motor's capstan or a spring, over nodes to the link that it pulls.
Its segments are springs that go slack and never push; over a node it slides where the tensions
before and behind stand in more than ``exp(mu phi)`` (capstan equation), by as much as closes that
gap. Joints turn on pins with friction that grows with the tensions on them. All of it is at rest
at any time but the joints' inertia, which a linearly implicit Euler step integrates with the
tangent of what each cable would do next: a stiffer one would be a damper that nobody sees.

State: where the cables stand at the nodes, joints and their speeds, friction, motors. It is changed
in place, so that a motion may be cut anywhere.
"""

import math
from typing import NamedTuple

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import borrow, compiled, inlined
from truejoint.mechanics import dahl, solve
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.simulation.friction import N_ELEMENTS, guide_travel, maxwell_slip
from truejoint.simulation.wrist.parameters import PlantConstants

_SWEEPS = 3  # over the nodes of a cable
_NUDGE = 1e-7  # [rad] over which the slope of Maxwell slip is found


class State(NamedTuple):
    """What the plant remembers from step to step."""

    nodes: Array  # (C, N) [m] that the cable has travelled over each
    joint: Array  # (J,) [rad]
    speed: Array  # (J,) [rad/s]
    friction: Array  # (J,) [Nm] of the pins, where they follow Dahl
    stuck: Array  # (J * N_ELEMENTS,) [rad], where they follow Maxwell slip
    motor: Array  # (M,) [rad]
    motor_speed: Array  # (M,) [rad/s]
    motor_friction: Array  # (M,) [Nm]


class Work(NamedTuple):
    """What a step works out and the next one overwrites."""

    matrix: Array  # (J, J) and
    right: Array  # (J,) of the equation that gives the joints' speeds
    level: Array  # (J,) tension on a pin [N], then the friction that it can hold [Nm]
    sine: Array  # (J,)
    cosine: Array  # (J,)
    arm: Array  # (J,) [m] of one cable
    pull: Array  # (N + 1,) [N] tensions of one cable
    slid: Array  # (N + 1,) [m]
    ratio: Array  # (N + 1,)
    first: Array  # (C,) [N] tensions at the cables' ends


class Log(NamedTuple):
    """What the plant did, a row a set-point."""

    motor: Array  # (n, M) [rad]
    joint: Array  # (n, J) [rad]
    effort: Array  # (n, M) [Nm] that the motors give
    tension: Array  # (n, C) [N] at the cables' ends
    grip: Array  # (n,) [Nm] of the jaws on what they hold


def at_rest(c: PlantConstants) -> State:
    """State of an instrument at its zeros, its cables at pretension."""
    n, m = len(c.inertia), c.n_motors
    return State(*(np.zeros(size) for size in (c.ratio.shape, n, n, n, n * N_ELEMENTS, m, m, m)))


def new_work(c: PlantConstants) -> Work:
    """Give memory for `advance` to work in."""
    n, ends = len(c.inertia), c.stiffness.shape[1]
    return Work(*map(np.zeros, ((n, n), n, n, n, n, n, ends, ends, ends, len(c.motor_of))))


def empty_log(rows: int, c: PlantConstants) -> Log:
    """Rows for `advance` to fill."""
    shapes = (c.n_motors,), (len(c.inertia),), (c.n_motors,), (len(c.motor_of),), ()
    return Log(*(np.empty((rows, *shape)) for shape in shapes))


@inlined
def slide_over(
    number: int, node: int, start: float, end: float, c: PlantConstants, nodes: Array, w: Work
) -> bool:
    """Let a cable slide over one node, where friction does not hold it; say whether it did.

    `start` and `end` [m] are what its motor has wound up and its joints have let go.
    """
    first, last = c.stiffness[number, node], c.stiffness[number, node + 1]
    at = nodes[number, node]
    left = nodes[number, node - 1] if node > 0 else start
    right = nodes[number, node + 1] if node + 1 < c.n_nodes[number] else end
    # Below 0 where slack is to be taken up before a segment pulls.
    before = first * (c.slack[number, node] + left - at)
    behind = last * (c.slack[number, node + 1] + at - right)
    if before <= 0.0 and behind <= 0.0:
        return False
    travel = guide_travel(before, behind, w.ratio[node], first, last)
    # No further than until the segment that lets go is slack.
    travel = min(max(travel, -max(behind, 0.0) / last), max(before, 0.0) / first)
    if travel == 0.0:
        return False
    nodes[number, node] = at + travel
    w.slid[node] = travel
    w.pull[node] = max(before - first * travel, 0.0)
    w.pull[node + 1] = max(behind + last * travel, 0.0)
    return True


@inlined
def tangent(number: int, c: PlantConstants, w: Work) -> float:
    """Stiffness [N/m] of a cable seen from its joints, while it goes on as it did in this step.

    A node that holds leaves the segment behind it; one over which the cable slides, in a constant
    ratio of tensions, puts what is before it in series.
    """
    stiffness: float = c.stiffness[number, 0] * (w.pull[0] > 0.0)
    for i in range(c.n_nodes[number]):
        own = c.stiffness[number, i + 1] * (w.pull[i + 1] > 0.0)
        if w.slid[i] > 0.0 and own > 0.0:  # the tension before is `ratio` times that behind
            own *= stiffness / (stiffness + w.ratio[i] * own)
        elif w.slid[i] < 0.0 and own > 0.0:
            own *= w.ratio[i] * stiffness / (own + w.ratio[i] * stiffness)
        stiffness = own
    return stiffness


@inlined
def pull_cable(
    number: int, start: float, end: float, c: PlantConstants, q: Array, nodes: Array, w: Work
) -> float:
    """Fill the tensions ``w.pull`` of a cable's segments [N]; give its `tangent` [N/m].

    `start` and `end` are those of `slide_over`; `nodes` (C, N) is moved.
    """
    n = c.n_nodes[number]
    before = start
    for i in range(n + 1):
        behind = nodes[number, i] if i < n else end
        w.pull[i] = max(c.stiffness[number, i] * (c.slack[number, i] + before - behind), 0.0)
        before, w.slid[i] = behind, 0.0
    for i in range(n):
        joint = c.wrap_joint[number, i]
        w.ratio[i] = c.ratio[number, i]
        if joint >= 0:
            w.ratio[i] = max(w.ratio[i] * math.exp(c.wrap_slope[number, i] * q[joint]), 1.0)
    for _ in range(_SWEEPS):
        moved = False
        for i in range(n):
            moved |= slide_over(number, i, start, end, c, nodes, w)
        if not moved:
            break
    return tangent(number, c, w)


@inlined
def move_motor(m: int, start: float, end: float, share: float, c: PlantConstants, s: State) -> None:
    """Move a motor by a step within a ramp of its set-point from `start` to `end` [rad].

    It follows a ramp with a lag, and what it is off that decays, both exactly.
    """
    rate = (end - start) / SETPOINT_DT
    wanted = start + share * (end - start) - c.motor_lag * rate
    off, drift = s.motor[m] - (wanted - c.dt * rate), s.motor_speed[m] - rate
    angle = wanted + c.motor_step[0, 0] * off + c.motor_step[0, 1] * drift
    way = angle - s.motor[m]
    s.motor[m] = angle
    s.motor_speed[m] = rate + c.motor_step[1, 0] * off + c.motor_step[1, 1] * drift
    stiffness = c.motor.coulomb / c.motor.presliding
    s.motor_friction[m] = dahl(s.motor_friction[m], c.motor.coulomb, stiffness, way)


@inlined
def add_cables(c: PlantConstants, s: State, w: Work) -> None:
    """Add the torques of all cables, their stiffness, and the tensions on the pins."""
    q, h = s.joint, c.dt
    for j in range(q.shape[0]):
        w.sine[j], w.cosine[j], w.level[j] = math.sin(q[j]), math.cos(q[j]), 0.0
    for n in range(c.motor_of.shape[0]):
        motor, count = c.motor_of[n], c.n_moved[n]
        wound = c.capstan[n] * s.motor[motor] if motor >= 0 else 0.0
        let_go = 0.0
        for i in range(count):
            j = c.moved[n, i]
            moment, a, b = c.moments[n, i], c.sine[n, i], c.cosine[n, i]
            let_go += moment * q[j] + a * w.sine[j] + b * (w.cosine[j] - 1.0)
            w.arm[i] = moment + a * w.cosine[j] - b * w.sine[j]
        stiffness = pull_cable(n, wound, let_go, c, q, s.nodes, w)
        w.first[n], last = w.pull[0], w.pull[c.n_nodes[n]]
        for i in range(count):
            j = c.moved[n, i]
            w.right[j] += w.arm[i] * last
            w.level[j] += last
            for k in range(count):
                w.matrix[j, c.moved[n, k]] += h * stiffness * w.arm[i] * w.arm[k]


@inlined
def add_contact(held: float, c: PlantConstants, s: State, w: Work) -> float:
    """Add what pushes the jaws apart at the opening `held` [rad]; give its torque [Nm]."""
    gap, rate, n = held, 0.0, s.joint.shape[0]
    for j in range(n):
        gap -= c.opening[j] * s.joint[j]
        rate += c.opening[j] * s.speed[j]
    if gap <= 0.0:
        return 0.0
    for j in range(n):
        w.right[j] += c.contact[0] * gap * c.opening[j]
        for k in range(n):
            both = c.opening[j] * c.opening[k]
            w.matrix[j, k] += (c.dt * c.contact[0] + c.contact[1]) * both
    torque: float = max(c.contact[0] * gap - c.contact[1] * rate, 0.0)
    return torque


@inlined
def add_friction(j: int, c: PlantConstants, s: State, w: Work) -> None:
    """Add the friction of a pin and its slope, which the direction of motion tells."""
    w.level[j] = level = c.friction[j] + c.per_tension[j] * w.level[j]
    if c.is_maxwell_slip:
        at, q = j * N_ELEMENTS, s.joint[j]
        drag = maxwell_slip(q, 0.0, level, c.law, s.stuck, at, False)
        ahead = q + math.copysign(_NUDGE, s.speed[j])
        slope = maxwell_slip(ahead, 0.0, level, c.law, s.stuck, at, False)
        slope = abs(slope - drag) / _NUDGE
    else:
        drag = s.friction[j]
        slope = max(level - math.copysign(drag, drag * s.speed[j]), 0.0) / c.presliding
    w.right[j] -= drag
    w.matrix[j, j] += c.damping[j] + c.dt * slope


@inlined
def move_joints(c: PlantConstants, s: State, w: Work) -> None:
    """Solve ``(M + h D + h^2 K) v' = M v + h F`` and move joints and friction on."""
    n, h = s.joint.shape[0], c.dt
    for j in range(n):
        w.right[j] = c.inertia[j] * s.speed[j] + h * w.right[j]
        for k in range(n):
            w.matrix[j, k] *= h
        w.matrix[j, j] += c.inertia[j]
    solve(w.matrix, w.right)
    for j in range(n):
        s.speed[j] = w.right[j]
        way, level = h * s.speed[j], w.level[j]
        s.joint[j] += way
        if c.is_maxwell_slip:
            maxwell_slip(s.joint[j], 0.0, level, c.law, s.stuck, j * N_ELEMENTS, True)
        else:
            s.friction[j] = dahl(s.friction[j], level, level / c.presliding, way)


@inlined
def write_row(row: int, grip: float, c: PlantConstants, s: State, w: Work, log: Log) -> None:
    """Write down where everything is."""
    for m in range(c.n_motors):
        log.motor[row, m] = s.motor[m]
        log.effort[row, m] = s.motor_friction[m] + c.motor.viscous * s.motor_speed[m]
    for n in range(c.motor_of.shape[0]):
        log.tension[row, n] = w.first[n]
        if c.motor_of[n] >= 0:
            log.effort[row, c.motor_of[n]] += c.capstan[n] * w.first[n]
    for j in range(s.joint.shape[0]):
        log.joint[row, j] = s.joint[j]
    log.grip[row] = grip


@compiled
def advance(
    constants: PlantConstants,
    state: State,
    work: Work,
    goal: Array,
    torque: Array,
    held: Array,
    substeps: int,
    log: Log,
) -> None:
    """Run along motor angles; fills a row of `log` at the end of each set-point's period.

    The state is changed in place, `work` is scratch. `goal` (n + 1, M) are the motor angles wanted
    [rad], each reached in a straight line from the one before, `torque` (n + 1, J) those on the
    joints from outside [Nm], straight between rows, `held` (n + 1,) the opening [rad] at which the
    jaws meet each other or what they hold; a period has `substeps` of the constants' `dt`.
    """
    c, s, w = borrow(constants), borrow(state), borrow(work)
    n = s.joint.shape[0]
    for row in range(goal.shape[0] - 1):
        grip = 0.0
        for step in range(1, substeps + 1):
            share = step / substeps
            for m in range(c.n_motors):
                move_motor(m, goal[row, m], goal[row + 1, m], share, c, s)
            for j in range(n):
                w.right[j] = torque[row, j] + share * (torque[row + 1, j] - torque[row, j])
                for k in range(n):
                    w.matrix[j, k] = 0.0
            add_cables(c, s, w)
            grip = add_contact(held[row] + share * (held[row + 1] - held[row]), c, s, w)
            for j in range(n):
                beyond = max(s.joint[j] - c.highest[j], 0.0) + min(s.joint[j] - c.lowest[j], 0.0)
                if beyond != 0.0:  # a stop pushes the joint back
                    w.right[j] -= c.stop[0] * beyond
                    w.matrix[j, j] += c.dt * c.stop[0] + c.stop[1]
                add_friction(j, c, s, w)
            move_joints(c, s, w)
        write_row(row, grip, c, s, w, log)
