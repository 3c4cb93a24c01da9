"""The balance of an instrument's loops as a filter's model: friction and loads in its state.

Joints move so slowly that their inertia does not tell. A loop is a motor's two cables; what counts
is the difference of their tensions, at the joints ``D``, at the motor ``D + f``, where friction
over the guides holds ``f``. Pins hold ``g``, loads pull with ``J l``, so that ``P' D = g - J l``,
and joints stand where the loops' stretch lets them: ``q = P^-1 (R a - C D - C_f f)``. All friction
is Dahl's. A loop whose slacker cable lets go, beyond twice the pretension, is half as stiff.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled
from truejoint.simulation.wrist.plant import dahl, solve

N: Final = 3
"""Joints, motors, loops and loads."""

# Where each part of the state begins: friction of loops [N], of motors as a share, of pins [Nm],
# and loads [Nm].
LOOP: Final = 0
MOTOR: Final = N
PIN: Final = 2 * N
LOAD: Final = 3 * N
STATES: Final = 4 * N

# Inputs: motor angles [rad], by how much they changed in the row, and their speeds [rad/s].
ANGLE: Final = 0
CHANGE: Final = N
SPEED: Final = 2 * N
INPUTS: Final = 3 * N

# Where each part of the parameters begins.
RIGID: Final = 0  # (N, N) raw joints per motor angle
INVERSE: Final = 9  # (N, N) P^-1 [1/m]
ON_JOINT: Final = 18  # (N, N) torque on each joint per load
RADIUS: Final = 27  # (N,) of the capstans [m]
STRETCH: Final = 30  # (N,) of a loop per difference of tension [m/N]
BEFORE: Final = 33  # (N,) and per friction, which pulls before the guides alone
LEVEL: Final = 36  # (N,) friction that a loop holds at pretension [N]
BUILD_UP: Final = 39  # [N/m] of it
PIN_LEVEL: Final = 40  # (N,) friction that a pin holds at pretension [Nm]
PIN_WAY: Final = 43  # [rad] in which that builds up
TENSION: Final = 44  # [N] of both cables of a loop
PER_BEND: Final = 45  # (N,) by how much pitch changes friction of tension [1/rad]
MOTOR_WAY: Final = 48  # [rad] in which a motor's friction builds up
EFFORT: Final = 49  # (4, N) effort per torque, per share of friction, per speed, and constant
CROSSING: Final = 61  # (N, N) share of each loop in the tension on a joint's pin
DRIFT: Final = 70  # variances per second: of loop, motor and pin friction, as shares squared
LOAD_RATE: Final = 73  # (N,) of loads [Nm2/s]
DECAY: Final = 76  # of loads [1/s]
PARAMETERS: Final = 77


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
def joints(x: Array, a: Array, p: Array, out: Array) -> None:
    """Joint angles (N,) [rad] in balance, at motor angles `a` (N,)."""
    pull = np.empty(N)
    tensions(x, p, pull)
    for j in range(N):
        out[j] = 0.0
    for m in range(N):
        beyond = math.copysign(max(abs(pull[m]) - p[TENSION], 0.0), pull[m])
        stretch = p[STRETCH + m] * (pull[m] + beyond) + p[BEFORE + m] * x[LOOP + m]
        for j in range(N):
            out[j] += p[RIGID + N * j + m] * a[m] - p[INVERSE + N * j + m] * stretch


@compiled
def efforts(x: Array, speed: Array, p: Array, out: Array) -> None:
    """Motor torques (N,) [Nm] as they are measured, at motor speeds (N,)."""
    pull = np.empty(N)
    tensions(x, p, pull)
    for m in range(N):
        torque = p[RADIUS + m] * (pull[m] + x[LOOP + m])
        out[m] = p[EFFORT + m] * torque + p[EFFORT + N + m] * x[MOTOR + m]
        out[m] += p[EFFORT + 2 * N + m] * speed[m] + p[EFFORT + 3 * N + m]


@compiled
def pin_levels(pull: Array, p: Array, out: Array) -> None:
    """Friction (N,) [Nm] that pins hold under the loops' differences of tension."""
    for j in range(N):
        share = 0.0
        for m in range(N):
            share += p[CROSSING + N * j + m] * max(abs(pull[m]) / p[TENSION], 1.0)
        out[j] = p[PIN_LEVEL + j] * share


@compiled
def compliance(slope: Array, p: Array, matrix: Array) -> None:
    """Fill ``I + S diag(slope)``, where ``S`` [rad/Nm] is how the joints yield to torques."""
    for j in range(N):
        for k in range(N):
            own = 0.0
            for m in range(N):
                own += p[INVERSE + N * j + m] * p[STRETCH + m] * p[INVERSE + N * k + m]
            matrix[j, k] = own * slope[k] + (1.0 if j == k else 0.0)


@compiled
def yielding(loads: Array, p: Array, out: Array) -> None:
    """How far joints (N,) [rad] yield to a change of loads (N,) where no pin holds."""
    for j in range(N):
        out[j] = 0.0
    for m in range(N):
        pulled = 0.0
        for k in range(N):
            torque = 0.0
            for i in range(N):
                torque += p[ON_JOINT + N * k + i] * loads[i]
            pulled += p[INVERSE + N * k + m] * torque
        for j in range(N):
            out[j] += p[INVERSE + N * j + m] * p[STRETCH + m] * pulled


@compiled
def move(x: Array, u: Array, loads: Array, p: Array, out: Array) -> None:
    """Friction after motors have moved by `u` and loads to `loads` (N,); `out` may not be `x`."""
    pull, level, way = np.empty(N), np.empty(N), np.empty(N)
    slope, change, matrix = np.empty(N), np.empty(N), np.empty((N, N))
    tensions(x, p, pull)
    bent = 0.0
    for m in range(N):
        bent += p[RIGID + m] * u[ANGLE + m]
        change[m] = loads[m] - x[LOAD + m]
        out[LOAD + m] = loads[m]
    yielding(change, p, way)
    for m in range(N):
        by = u[CHANGE + m]
        held = x[LOOP + m]
        share = max(abs(pull[m]) / p[TENSION], 1.0)
        most = p[LEVEL + m] * share
        # A loop under load holds more on the side that pulls.
        ratio = p[LEVEL + m] / p[TENSION]
        middle = pull[m] * (math.sqrt(1.0 + ratio * ratio) - 1.0)
        side = p[PER_BEND + m] * bent * pull[m]
        middle -= math.copysign(side, by) if by != 0.0 else 0.0
        kept = math.exp(-p[BUILD_UP] * p[RADIUS + m] * abs(by) / most)
        end = middle + (math.copysign(most, by) if by != 0.0 else 0.0)
        out[LOOP + m] = end + (held - end) * kept if by != 0.0 else held
        kept = math.exp(-abs(by) / p[MOTOR_WAY])
        end = math.copysign(1.0, by)
        out[MOTOR + m] = end + (x[MOTOR + m] - end) * kept
        for j in range(N):
            way[j] += p[RIGID + N * j + m] * by
            way[j] -= p[INVERSE + N * j + m] * p[BEFORE + m] * (out[LOOP + m] - held)
    pin_levels(pull, p, level)
    for j in range(N):
        along = x[PIN + j] if way[j] > 0.0 else -x[PIN + j]
        slope[j] = max(level[j] - along, 0.0) / p[PIN_WAY]
    compliance(slope, p, matrix)
    solve(matrix, way)
    for j in range(N):
        held = dahl(x[PIN + j], level[j], level[j] / p[PIN_WAY], way[j])
        out[PIN + j] = min(max(held, -level[j]), level[j])


@compiled
def simulate(motor: Array, loads: Array, p: Array, x: Array, joint: Array, torque: Array,
             share: Array) -> None:  # fmt: skip
    """Joints, motor torques and shares of motor friction (n, N) along motors under known loads.

    `x` (STATES,) is where it begins, and is changed.
    """
    u, after, still = np.zeros(INPUTS), x.copy(), np.zeros(N)
    for i in range(motor.shape[0]):
        for m in range(N):
            u[ANGLE + m] = motor[i, m]
            u[CHANGE + m] = motor[i, m] - motor[max(i - 1, 0), m]
        move(x, u, loads[i], p, after)
        x[:] = after
        joints(x, motor[i], p, joint[i])
        tensions(x, p, still)
        for m in range(N):
            torque[i, m] = p[RADIUS + m] * (still[m] + x[LOOP + m])
            share[i, m] = x[MOTOR + m]


@compiled
def transition(x: Array, u: Array, dt: float, p: Array, out: Array) -> None:
    """Move friction on along the motors; loads fade."""
    loads = np.empty(N)
    for k in range(N):
        loads[k] = x[LOAD + k] * math.exp(-p[DECAY] * dt)
    move(x, u, loads, p, out)


@compiled
def measurement(x: Array, u: Array, p: Array, out: Array) -> None:
    """Efforts of the motors."""
    efforts(x, u[SPEED:], p, out)


@compiled
def process_noise(x: Array, u: Array, dt: float, p: Array, out: Array) -> None:
    """Random walks; what a load changes by, the pins hold back as far as they give no way.

    A pin that slides along with its motor gives way: it holds what it holds.
    """
    pull, slope, unit, way = np.empty(N), np.empty(N), np.zeros(N), np.empty(N)
    matrix = np.empty((N, N))
    tensions(x, p, pull)
    pin_levels(pull, p, slope)
    for m in range(N):
        out[LOOP + m, LOOP + m] = p[DRIFT] * p[LEVEL + m] ** 2 * dt
        out[MOTOR + m, MOTOR + m] = p[DRIFT + 1] * dt
        out[PIN + m, PIN + m] = p[DRIFT + 2] * slope[m] ** 2 * dt
    for j in range(N):
        along = 0.0
        for m in range(N):
            along += p[RIGID + N * j + m] * u[CHANGE + m]
        held = math.copysign(x[PIN + j], x[PIN + j] * along) if along != 0.0 else 0.0
        slope[j] = max(slope[j] - held, 0.0) / p[PIN_WAY]
    for k in range(N):
        variance = p[LOAD_RATE + k] * dt
        unit[k] = 1.0
        yielding(unit, p, way)
        unit[k] = 0.0
        compliance(slope, p, matrix)
        solve(matrix, way)
        out[LOAD + k, LOAD + k] = variance
        for i in range(N):
            held = slope[i] * way[i] * variance
            out[PIN + i, LOAD + k] = held
            out[LOAD + k, PIN + i] = held
            for j in range(N):
                out[PIN + i, PIN + j] += slope[i] * way[i] * slope[j] * way[j] * variance
