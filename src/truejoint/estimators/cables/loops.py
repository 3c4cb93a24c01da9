"""The balance of an instrument's loops as a filter's model: friction and loads in its state.

Joints move so slowly that their inertia does not tell. A loop is a motor's two cables; what counts
is the difference of their tensions: ``D`` at the joints, ``D + f2`` before the wrist's pulleys,
where friction holds ``f2``, and ``D + f1 + f2`` at the motor, as the guides hold ``f1``. Pins hold
``g``, loads pull with ``J l``, so that ``P' D = g - J l``, and joints stand where the loops'
stretch lets them: ``q = P^-1 (R a - c3 D - c2 (D + f2) - c1 (D + f1 + f2))``. All friction is
Dahl's. A loop whose slacker cable lets go, beyond twice the pretension, is half as stiff.
"""

import math
from typing import Final

from truejoint.array_types import Array
from truejoint.compiled import compiled, local_matrix, local_vector
from truejoint.mechanics import dahl, solve

N: Final = 3
"""Joints, motors, loops and loads."""

# Where each part of the state begins: friction of loops at guides and wrist [N], of motors as a
# share, of pins [Nm], and loads [Nm].
GUIDE, WRIST, MOTOR, PIN, LOAD, STATES = range(0, 6 * N, N)

# Inputs: motor angles [rad], by how much they changed in the row, and their speeds [rad/s].
ANGLE, CHANGE, SPEED, INPUTS = range(0, 4 * N, N)

# Where each part of the parameters begins.
RIGID: Final = 0  # (N, N) raw joints per motor angle
INVERSE: Final = 9  # (N, N) P^-1 [1/m]
ON_JOINT: Final = 18  # (N, N) torque on each joint per load
RADIUS: Final = 27  # (N,) of the capstans [m]
STRETCH: Final = 30  # (3, N) of a loop per difference of tension [m/N]: to the guides, wrist, end
LEVEL: Final = 39  # (2, N) friction that guides and wrist hold at pretension [N]
PIN_LEVEL: Final = 45  # (N,) friction that a pin holds at pretension [Nm]
EFFORT: Final = 48  # (4, N) effort per torque, per share of friction, per speed, and constant
CROSSING: Final = 60  # (N, N) share of each loop in the tension on a joint's pin
WRAP: Final = 69  # (N, N) share of a loop's tension that its friction loses per joint angle
LOAD_RATE: Final = 78  # (N,) of loads [Nm2/s]
DRIFT: Final = 81  # variances per second: of loop, motor and pin friction, as shares squared
BUILD_UP: Final = 84  # [N/m] of a loop's friction
PIN_WAY: Final = 85  # [rad] in which a pin's builds up
MOTOR_WAY: Final = 86  # [rad] in which a motor's friction builds up
TENSION: Final = 87  # [N] of both cables of a loop
DECAY: Final = 88  # of loads [1/s]
PARAMETERS: Final = 89

_SWEEPS: Final = 12
_ALIKE: Final = 1e-4
"""Share of what a pin holds at most, by which a sweep may still find it to hold something else."""


@compiled
def tensions(x: Array, p: Array, out: Array) -> None:
    """Difference of tension (N,) [N] of each loop at the joints."""
    for m in range(N):
        out[m] = 0.0
        for j in range(N):
            torque = x[PIN + j]
            for k in range(N):
                torque -= p[ON_JOINT + N * j + k] * x[LOAD + k]
            out[m] += p[INVERSE + N * j + m] * torque


@compiled
def stretched(m: int, pull: float, x: Array, p: Array) -> float:
    """Stretch [m] of a loop of two taut cables."""
    wrist = pull + x[WRIST + m]
    last = p[STRETCH + 2 * N + m] * pull + p[STRETCH + N + m] * wrist
    return float(last + p[STRETCH + m] * (wrist + x[GUIDE + m]))


@compiled
def whole(m: int, p: Array) -> float:
    """Stretch [m/N] of a loop without friction."""
    return float(p[STRETCH + m] + p[STRETCH + N + m] + p[STRETCH + 2 * N + m])


@compiled
def joints(x: Array, a: Array, p: Array, out: Array) -> None:
    """Joint angles (N,) [rad] in balance, at motor angles `a`, of which the first N count."""
    pull = local_vector(N)
    tensions(x, p, pull)
    for j in range(N):
        out[j] = 0.0
    for m in range(N):
        taut = stretched(m, pull[m], x, p)
        beyond = max(abs(taut) - whole(m, p) * p[TENSION], 0.0)
        stretch = taut + math.copysign(beyond, taut)
        for j in range(N):
            out[j] += p[RIGID + N * j + m] * a[m] - p[INVERSE + N * j + m] * stretch


@compiled
def motor_torque(m: int, pull: float, x: Array, p: Array) -> float:
    """Torque [Nm] with which the cables of a motor pull."""
    return float(p[RADIUS + m] * (pull + x[WRIST + m] + x[GUIDE + m]))


@compiled
def tension_sum(m: int, pull: float, x: Array, p: Array) -> float:
    """Sum [N] of the tensions of a loop's two cables at the joints.

    What the cables are stretched by together stays; where friction adds to the tensions before the
    joints, they lose it. A cable that is slack leaves the other one's.
    """
    guides = p[STRETCH + m] / whole(m, p)
    wrist = guides + p[STRETCH + N + m] / whole(m, p)
    lost = pull * x[WRIST + m] * wrist + (pull + x[WRIST + m]) * x[GUIDE + m] * guides
    return float(max(p[TENSION] - lost / p[TENSION], abs(pull), 0.1 * p[TENSION]))


@compiled
def pin_levels(pull: Array, x: Array, p: Array, out: Array) -> None:
    """Friction (N,) [Nm] that pins hold under the loops' differences of tension."""
    for j in range(N):
        share = 0.0
        for m in range(N):
            if p[CROSSING + N * j + m] > 0.0:
                share += p[CROSSING + N * j + m] * tension_sum(m, pull[m], x, p) / p[TENSION]
        out[j] = p[PIN_LEVEL + j] * share


@compiled
def compliance(shares: Array, slope: Array, p: Array, matrix: Array) -> None:
    """Fill ``I + S diag(slope)``, where ``S`` [rad/Nm] is how the joints yield to torques."""
    for j in range(N):
        for k in range(N):
            yields = 0.0
            for m in range(N):
                yields += p[INVERSE + N * j + m] * shares[m, 2] * p[INVERSE + N * k + m]
            matrix[j, k] = yields * slope[k] + (1.0 if j == k else 0.0)


@compiled
def pulled_by(change: Array, p: Array, out: Array) -> None:
    """How the loops' differences of tension (N,) [N] change with loads (N,) where no pin holds."""
    for m in range(N):
        out[m] = 0.0
        for j in range(N):
            for k in range(N):
                out[m] -= p[INVERSE + N * j + m] * p[ON_JOINT + N * j + k] * change[k]


@compiled
def friction_levels(
    m: int, pull: float, x: Array, u: Array, p: Array, most: Array, middle: Array
) -> None:
    """Find what guides and wrist of a loop hold at most (2,), and about what (2,) [N].

    Two cables of tensions that differ by ``D`` and add up to ``S`` run on and off over pulleys:
    with the capstan equation the difference grows by ``D (cosh mu phi - 1) +- S sinh mu phi``.
    """
    total, lost = tension_sum(m, pull, x, p), 0.0
    guides, wrist = p[LEVEL + m] / p[TENSION], p[LEVEL + N + m] / p[TENSION]
    for j in range(N):  # the wrist's friction loses as the joints wind the loop less
        if p[WRAP + N * m + j] != 0.0:
            raw = 0.0
            for i in range(N):
                raw += p[RIGID + N * j + i] * u[ANGLE + i]
            lost += p[WRAP + N * m + j] * raw
    middle[1] = pull * (math.sqrt(1.0 + wrist * wrist) - 1.0)
    most[1] = max(wrist * total - lost * pull, 0.1 * wrist * p[TENSION])
    # The guides stand behind the wrist: theirs are the tensions with what that holds.
    before = pull + x[WRIST + m]
    total = total * math.sqrt(1.0 + wrist * wrist) + pull * (x[WRIST + m] - middle[1]) / total
    middle[0] = before * (math.sqrt(1.0 + guides * guides) - 1.0)
    most[0] = guides * max(total, abs(before))


@compiled
def loop_shares(m: int, before: Array, hold: Array, p: Array, shares: Array) -> None:
    """How a loop gives way where its friction builds up by `hold` (2,) [N/m].

    `shares` (3,): way over the guides per way of the motor, over the wrist per way over the guides,
    and stretch [m/N] that the joints feel.
    """
    wrist = 1.0 / (1.0 + before[1] * hold[1])
    guides = 1.0 / (1.0 + before[0] * (hold[0] + hold[1] * wrist))
    shares[0], shares[1] = guides, wrist
    shares[2] = wrist * (guides * before[0] * wrist + before[1]) + before[2]


@compiled
def loop_stretch(m: int, taut: float, p: Array, before: Array) -> None:
    """Stretch [m/N] of a loop's parts (3,), twice as much where one cable is slack."""
    loose = 2.0 if abs(taut) > whole(m, p) * p[TENSION] else 1.0
    for n in range(3):
        before[n] = loose * p[STRETCH + N * n + m]


@compiled
def yielded(friction: float, along: float) -> float:
    """Friction in the direction in which something moves; 0 where it stands."""
    if along == 0.0:
        return 0.0
    return math.copysign(friction, friction * along)


@compiled
def hold_loops(x: Array, u: Array, taken: Array, pull: Array, p: Array, before: Array,
               shares: Array) -> None:  # fmt: skip
    """Find how each loop gives way: stretch of its parts and `loop_shares`, (N, 3) each."""
    most, middle, hold = local_vector(2), local_vector(2), local_vector(2)
    for m in range(N):
        by, reach = p[RADIUS + m] * u[CHANGE + m], 0.0
        loop_stretch(m, stretched(m, pull[m], x, p), p, before[m])
        friction_levels(m, pull[m], x, u, p, most, middle)
        for n in range(2):
            reach += before[m, n]
            along = yielded(x[GUIDE + N * n + m] - middle[n], by - reach * taken[m])
            hold[n] = p[BUILD_UP] * max(1.0 - along / most[n], 0.0)
        loop_shares(m, before[m], hold, p, shares[m])


@compiled
def free_way(u: Array, taken: Array, shares: Array, p: Array, out: Array) -> None:
    """How far joints (N,) [rad] go where no pin holds, as motors move and tensions change."""
    for j in range(N):
        out[j] = 0.0
        for m in range(N):
            out[j] += p[RIGID + N * j + m] * u[CHANGE + m] * shares[m, 0] * shares[m, 1]
            out[j] -= p[INVERSE + N * j + m] * shares[m, 2] * taken[m]


@compiled
def turn_pins(began: Array, free: Array, level: Array, shares: Array, p: Array, slope: Array,
              way: Array, held: Array) -> float:  # fmt: skip
    """Friction `held` (N,) [Nm] of the pins after the `way` (N,) [rad] that they leave of `free`.

    `slope` (N,) [Nm/rad] is how they hold from where they `began`; it becomes how they held. Give
    by how much that differs, as a share of what a pin holds at most.
    """
    matrix, change = local_matrix(N, N), 0.0
    for j in range(N):
        way[j] = free[j]
    compliance(shares, slope, p, matrix)
    solve(matrix, way)
    for j in range(N):
        held[j] = dahl(began[j], level[j], level[j] / p[PIN_WAY], way[j])
        grown = held[j] - began[j]
        change = max(change, abs(grown - slope[j] * way[j]) / level[j])
        if way[j] != 0.0:
            slope[j] = grown / way[j]
    return change


@compiled
def move(x: Array, u: Array, loads: Array, p: Array, out: Array) -> None:
    """Friction after motors have moved by `u` and loads to `loads` (N,); `out` may not be `x`.

    A cable that friction holds at a pulley keeps a load's change of tension behind it: the motor
    feels it only once the cable slides.
    """
    pull, after, change, taken = local_vector(N), local_vector(N), local_vector(N), local_vector(N)
    free, way, level, slope = local_vector(N), local_vector(N), local_vector(N), local_vector(N)
    began, held, most, middle = local_vector(N), local_vector(N), local_vector(2), local_vector(2)
    before, shares = local_matrix(N, 3), local_matrix(N, 3)
    for m in range(N):
        change[m] = loads[m] - x[LOAD + m]
        out[LOAD + m] = loads[m]
        remains = math.exp(-abs(u[CHANGE + m]) / p[MOTOR_WAY])
        end = math.copysign(1.0, u[CHANGE + m])
        out[MOTOR + m] = end + (x[MOTOR + m] - end) * remains
    tensions(x, p, pull)
    pulled_by(change, p, taken)
    hold_loops(x, u, taken, pull, p, before, shares)
    free_way(u, taken, shares, p, free)
    pin_levels(pull, x, p, level)
    for j in range(N):
        began[j] = min(max(x[PIN + j], -level[j]), level[j])
        slope[j] = (level[j] - yielded(began[j], free[j])) / p[PIN_WAY]
    for _ in range(_SWEEPS):  # until pins hold as they do along the way that the joints then go
        if turn_pins(began, free, level, shares, p, slope, way, held) <= _ALIKE:
            break
    for j in range(N):
        out[PIN + j] = held[j]
    tensions(out, p, after)
    for m in range(N):
        friction_levels(m, after[m], x, u, p, most, middle)
        grown, by = after[m] - pull[m], p[RADIUS + m] * u[CHANGE + m]
        for n in range(2):  # guides, then wrist
            share, at = shares[m, 1] if n == 0 else 1.0, GUIDE + N * n + m
            by = shares[m, n] * (by - before[m, n] * share * grown)
            friction = dahl(x[at] - middle[n], most[n], p[BUILD_UP], by)
            out[at] = middle[n] + min(max(friction, -most[n]), most[n])


@compiled
def simulate(
    inputs: Array, loads: Array, p: Array, states: Array, joint: Array, torque: Array
) -> None:
    """States (n, STATES), joints and motor torques (n, N) along inputs under known loads.

    Of inputs (n, INPUTS) and loads (n, N); friction begins at nothing.
    """
    x, pull = local_vector(STATES), local_vector(N)
    for i in range(STATES):
        x[i] = loads[0, i - LOAD] if i >= LOAD else 0.0
    for i in range(inputs.shape[0]):
        move(x, inputs[i], loads[i], p, states[i])
        x[:] = states[i]
        joints(x, inputs[i], p, joint[i])
        tensions(x, p, pull)
        for m in range(N):
            torque[i, m] = motor_torque(m, pull[m], x, p)


@compiled
def transition(x: Array, u: Array, dt: float, p: Array, out: Array) -> None:
    """Move friction on along the motors; loads fade."""
    loads = local_vector(N)
    for k in range(N):
        loads[k] = x[LOAD + k] * math.exp(-p[DECAY] * dt)
    move(x, u, loads, p, out)


@compiled
def measurement(x: Array, u: Array, p: Array, out: Array) -> None:
    """Motor torques (N,) [Nm] as they are measured."""
    pull = local_vector(N)
    tensions(x, p, pull)
    for m in range(N):
        out[m] = p[EFFORT + m] * motor_torque(m, pull[m], x, p)
        out[m] += p[EFFORT + N + m] * x[MOTOR + m]
        out[m] += p[EFFORT + 2 * N + m] * u[SPEED + m] + p[EFFORT + 3 * N + m]


@compiled
def held_of(k: int, before: Array, hold: Array, shares: Array, slope: Array, p: Array,
            held: Array) -> None:  # fmt: skip
    """Change of the state (STATES,) per change of a load, at motors that stand."""
    unit, taken, way = local_vector(N), local_vector(N), local_vector(N)
    still, matrix = local_vector(INPUTS), local_matrix(N, N)
    for i in range(N):
        unit[i] = 1.0 if i == k else 0.0
        still[CHANGE + i] = 0.0
    pulled_by(unit, p, taken)
    free_way(still, taken, shares, p, way)
    compliance(shares, slope, p, matrix)
    solve(matrix, way)
    for m in range(N):
        for j in range(N):
            taken[m] += p[INVERSE + N * j + m] * slope[j] * way[j]
        way_over = shares[m, 0] * (0.0 - before[m, 0] * shares[m, 1] * taken[m])
        held[GUIDE + m] = hold[m, 0] * way_over
        held[WRIST + m] = hold[m, 1] * (shares[m, 1] * (way_over - before[m, 1] * taken[m]))
        held[MOTOR + m] = 0.0
        held[PIN + m] = slope[m] * way[m]
        held[LOAD + m] = unit[m]


@compiled
def process_noise(x: Array, u: Array, dt: float, p: Array, out: Array) -> None:
    """Random walks; what a load changes by, pins and pulleys hold back as they give way.

    What slides along with its motor gives way: it holds what it holds. Where the motor stands it
    does not matter which way the load goes.
    """
    pull, slope, held = local_vector(N), local_vector(N), local_vector(STATES)
    before, shares, hold = local_matrix(N, 3), local_matrix(N, 3), local_matrix(N, 2)
    most, middle = local_vector(2), local_vector(2)
    tensions(x, p, pull)
    pin_levels(pull, x, p, slope)
    for j in range(N):
        out[MOTOR + j, MOTOR + j] = p[DRIFT + 1] * dt
        out[PIN + j, PIN + j] = p[DRIFT + 2] * slope[j] ** 2 * dt
        friction_levels(j, pull[j], x, u, p, most, middle)
        for n in range(2):
            at = GUIDE + N * n + j
            out[at, at] = p[DRIFT] * p[LEVEL + N * n + j] ** 2 * dt
            share = yielded(x[at] - middle[n], u[CHANGE + j]) / most[n]
            hold[j, n] = p[BUILD_UP] * min(max(1.0 - share, 0.0), 1.0)
        along = 0.0
        for m in range(N):
            along += p[RIGID + N * j + m] * u[CHANGE + m]
        slope[j] = max(slope[j] - yielded(x[PIN + j], along), 0.0) / p[PIN_WAY]
        loop_stretch(j, stretched(j, pull[j], x, p), p, before[j])
        loop_shares(j, before[j], hold[j], p, shares[j])
    for k in range(N):
        held_of(k, before, hold, shares, slope, p, held)
        variance = p[LOAD_RATE + k] * dt
        for i in range(STATES):
            for j in range(STATES):
                out[i, j] += held[i] * held[j] * variance
