"""Equations of motion of an arm that cables drive, compiled: a call advances many milliseconds.

Each millisecond runs in this order, as on the robot:

1. `_settle`: joint positions and cable loads that belong to the motor positions. The links are
   light and slow against their cables (above 20 Hz), so that joints follow quasi-statically.
2. the external encoders take a sample where their own clock says so;
3. `_read_motors`, `_control`: motor encoders, then the robot's PD law gives the torque command;
4. `_turn_motors`: the motors' equation of motion over the next millisecond.

Every 100 ms `age` moves what is slow: creep, friction, grease.

What runs in every millisecond is inlined: handing over the arrays of plant and state took longer
than the equations.
"""

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, inlined
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.simulation.arm.parameters import Creep, ExternalEncoders, MotorFriction

Words = NDArray[np.uint64]

DT: Final = SETPOINT_DT  # s, the robot's servo period
AGE_STEPS: Final = 100  # steps between two updates of what is slow
TURN: Final = 2.0 * np.pi
STILL: Final = 1e-8  # share of the creep's travel within one update that counts as rest

# Positions in `State.slow` and `State.ticks`.
WARMTH, NEXT_TRUTH, LOAD = 0, 1, 2
N_SLOW: Final = 3
CLOCK, TRUTH_ROWS = 0, 1
# Rows of `State.tool`: where homing left the joints beside home [rad], how far their set-points
# have wandered since [rad], and what their cables load the capstans with [Nm].
REGISTERED, WANDER, TOOL_LOAD = 0, 1, 2


class Plant(NamedTuple):
    """Constants of one arm: n joints on cables that give way, 7 - n that follow their motors."""

    axes: tuple[int, ...]  # (n,) joints on cables that give way; its length is compiled in
    motor_from_joint: Array  # (7, 7) nominal transmission, lower triangular
    joint_from_motor: Array  # (7, 7)
    per_ratio: Array  # (7,) joint motion per motor turn, without coupling
    per_gear: Array  # (7,) capstan turn per motor turn
    push: Array  # (7,) change of speed in one step per Nm at the motor shaft
    keep: Array  # (7,) share of the speed left by viscous friction after one step
    coulomb: Array  # (7,) Nm at the motor shaft
    bend: Array  # (7,) change of the bristle in one step per speed
    gains: Array  # (7, 3) kp, kd, ki, capstan torque per motor angle
    effort_limit: Array  # (7,) Nm at the capstan
    effort_step: Array  # (7,) Nm at the capstan per DAC count
    channel: Integers  # (7,) column of each joint in the robot's state message
    friction: Array  # (n, 3) joint friction, its share of the load, presliding
    stiffness: Array  # (n,)
    scale: Array  # (n,) 1 + scale error
    anchor: Array  # (n, 2) cable position at the stop: by the motor, by the joint
    coupling: Array  # (n, n) of the cables, real, lower triangular
    per_arm: Array  # (n,) joint motion per m of cable
    run_out: Array  # (n, 4) capstan cos, sin, joint cos, sin parts [m]
    sideways: Array  # (n, n) m per joint motion, row: cable, column: joint
    sideways_zero: Array  # (n,) m
    per_run: Array  # (n,) 1 / (2 * free run) [1/m]
    stops: Array  # (n, 2) joint positions of the hard stops
    gravity: Array  # (2, 12) potential of the links, and of 1 kg at the tool: see `_gravity`
    creep: Array  # (n, 2) final, travel
    truth_step: Array  # (n,) resolution of the external encoders
    motor_friction: MotorFriction
    aging: Creep
    tool_wander: Array  # (2, 7 - n) standard deviations of WANDER and TOOL_LOAD
    tool_wander_time: float  # s
    encoders: ExternalEncoders
    truth_period: float  # s, of the external encoders
    counts: Array  # (7,) of a motor encoder, per turn


class State(NamedTuple):
    """What changes as time passes; arrays are updated in place."""

    motor: Array  # (7,) rad, motor shafts
    speed: Array  # (7,) rad/s
    bristle: Array  # (7,) motor friction, -1..1
    joint: Array  # (n,) joint positions
    before: Array  # (n,) joint positions one step ago
    drive: Array  # (n,) joint positions without friction, one step ago
    lag: Array  # (n,) joint friction, -1..1
    carried: Array  # (n,) load of the cables
    encoder_zero: Array  # (7,) rad
    counts: Array  # (7,) encoder counts one step ago
    command: Array  # (7,) motor setpoint one step ago
    integral: Array  # (7,) rad s
    creep: Array  # (n,)
    walk: Array  # (n,) wandering of the friction
    odometer: Array  # (n,) joint travel since the last `age`
    tool: Array  # (3, 7 - n) of the tool's joints: REGISTERED, WANDER, TOOL_LOAD
    wave: Array  # (n + 2, 2) cos and sin of the capstans, and of the first two joints
    slow: Array  # (N_SLOW,)
    ticks: Integers  # (2,) milliseconds since the start; truth rows written in this call
    random: Words  # (2,) state of the random numbers: of the arm, of the tool


class Rows(NamedTuple):
    """Where a call writes what the robot reports, by channel of its state message."""

    measured: Array  # (k, channels)
    velocity: Array  # (k, channels)
    motor: Array  # (k, channels)
    motor_velocity: Array  # (k, channels)
    effort: Array  # (k, channels)
    setpoint: Array  # (k, channels)
    joint: Array  # (k, n)
    truth_t: Array  # (m,)
    truth: Array  # (m, n)


@inlined
def _uniform(random: Words) -> float:
    """Uniform in (0, 1): splitmix64, so that a twin owns its random numbers."""
    random[0] += np.uint64(0x9E3779B97F4A7C15)
    z = random[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    uniform: float = (np.float64(z >> np.uint64(11)) + 0.5) * 1.1102230246251565e-16
    return uniform


@compiled
def normal(random: Words) -> float:
    """Draw a standard normal random number (Box and Muller)."""
    radius = np.sqrt(-2.0 * np.log(_uniform(random)))
    value: float = radius * np.cos(TURN * _uniform(random))
    return value


@compiled
def gravity_load(
    potential: Array, load: float, shoulder: Array, elbow: Array, d: float, out: Array
) -> None:
    """First three joints' efforts [Nm, Nm, N] that hold the arm against gravity, into `out`.

    The height of every mass is linear in (cos, sin) of the shoulder, (1, cos, sin) of the elbow
    and (1, insertion `d`); `potential` (2, 12) holds the 12 coefficients [J] of the links and of
    1 kg at the tool, in the order of that product. `shoulder` and `elbow` are (cos, sin).
    """
    c1, s1 = shoulder[0], shoulder[1]
    c2, s2 = elbow[0], elbow[1]
    out[0] = 0.0
    out[1] = 0.0
    out[2] = 0.0
    for i in range(2):
        part, slope = (c1, -s1) if i == 0 else (s1, c1)
        p = potential[0, 6 * i : 6 * i + 6]
        w = potential[1, 6 * i : 6 * i + 6]
        a0, b0 = p[0] + load * w[0], p[1] + load * w[1]
        a1, b1 = p[2] + load * w[2], p[3] + load * w[3]
        a2, b2 = p[4] + load * w[4], p[5] + load * w[5]
        out[0] += slope * (a0 + d * b0 + c2 * (a1 + d * b1) + s2 * (a2 + d * b2))
        out[1] += part * (c2 * (a2 + d * b2) - s2 * (a1 + d * b1))
        out[2] += part * (b0 + c2 * b1 + s2 * b2)


@inlined
def _couple(plant: Plant, cable: Array, joint: Array) -> None:
    """Joint positions of cable positions: what a joint's cable loses to the joints before it."""
    for k in range(len(plant.axes)):
        joint[k] = cable[k]
        for j in range(k):
            joint[k] -= plant.coupling[k, j] * joint[j]


@inlined
def _path(plant: Plant, state: State, k: int) -> float:
    """Cable position [joint units] that motor `k` has wound, with run-out and wrap."""
    eccentric = plant.run_out[k, 0] * state.wave[k, 0] + plant.run_out[k, 1] * state.wave[k, 1]
    if k < 2:
        after = len(plant.axes) + k
        eccentric += plant.run_out[k, 2] * state.wave[after, 0]
        eccentric += plant.run_out[k, 3] * state.wave[after, 1]
    sideways = -plant.sideways_zero[k]
    for j in range(len(plant.axes)):
        sideways += plant.sideways[k, j] * state.joint[j]
    longer = eccentric - sideways * sideways * plant.per_run[k]
    wound = plant.scale[k] * (state.motor[k] * plant.per_ratio[k] - plant.anchor[k, 0])
    path: float = wound + plant.anchor[k, 1] + longer * plant.per_arm[k] + state.creep[k]
    return path


@inlined
def _settle(plant: Plant, state: State, work: Array) -> None:
    """Joint positions and cable loads in balance with gravity, friction and stops."""
    n = len(plant.axes)
    gravity, cable, free, load = work[0], work[1], work[2], work[3]
    for k in range(n + 2):
        angle = state.motor[k] * plant.per_gear[k] if k < n else state.joint[k - n]
        state.wave[k, 0] = np.cos(angle)
        state.wave[k, 1] = np.sin(angle)
    gravity_load(
        plant.gravity, state.slow[LOAD], state.wave[n], state.wave[n + 1], state.joint[2], gravity
    )
    for k in range(n):
        cable[k] = _path(plant, state, k)
    _couple(plant, cable, free)
    grease = 1.0 + plant.motor_friction.warm_up * (1.0 - state.slow[WARMTH])
    for k in range(n):
        limit = plant.friction[k, 0] * grease * (1.0 + state.walk[k])
        limit += plant.friction[k, 1] * abs(gravity[k])
        moved = free[k] - state.drive[k]
        state.drive[k] = free[k]
        # Dahl friction in series with the cable: while the joint sticks, the cable takes up
        # the motion of the motor.
        slip = 1.0 - state.lag[k] * np.sign(moved)
        soft = plant.friction[k, 2] + slip * limit / plant.stiffness[k]
        state.lag[k] = min(1.0, max(-1.0, state.lag[k] + slip * moved / soft))
        load[k] = gravity[k] + limit * state.lag[k]
    _carry(plant, state, load)
    for k in range(n):
        cable[k] -= state.carried[k] / plant.stiffness[k]
    _couple(plant, cable, free)
    pressed = False
    for k in range(n):
        inside = min(plant.stops[k, 1], max(plant.stops[k, 0], free[k]))
        if inside != free[k]:
            load[k] += plant.stiffness[k] * (free[k] - inside)
            pressed = True
        state.before[k] = state.joint[k]
        state.joint[k] = inside
        state.odometer[k] += abs(inside - state.before[k])
    if pressed:
        _carry(plant, state, load)


@inlined
def _carry(plant: Plant, state: State, load: Array) -> None:
    """Load the cables with what the joints carry: by power, the transpose of the coupling."""
    n = len(plant.axes)
    for k in range(n - 1, -1, -1):
        state.carried[k] = load[k]
        for j in range(k + 1, n):
            state.carried[k] -= plant.coupling[j, k] * state.carried[j]


@inlined
def _sample_truth(plant: Plant, state: State, t: float, rows: Rows) -> None:
    """Read the external encoders where their time has come, each at its own instant."""
    while state.slow[NEXT_TRUTH] <= t:
        row = state.ticks[TRUTH_ROWS]
        part = 1.0 - (t - state.slow[NEXT_TRUTH]) / DT
        for k in range(len(plant.axes)):
            q = state.before[k] + part * (state.joint[k] - state.before[k])
            step = plant.truth_step[k]
            rows.truth[row, k] = plant.stops[k, 0] + step * np.floor(
                (q - plant.stops[k, 0]) / step + 0.5
            )
        rows.truth_t[row] = state.slow[NEXT_TRUTH] + plant.encoders.stamp_delay
        state.ticks[TRUTH_ROWS] = row + 1
        # Never shorter than a tenth of the period, so that stamps keep their order.
        wait = plant.truth_period + plant.encoders.jitter * normal(state.random)
        state.slow[NEXT_TRUTH] += max(0.1 * plant.truth_period, wait)


@inlined
def _read_motors(plant: Plant, state: State, rows: Rows, i: int) -> None:
    """Motor encoders, and the joint positions and velocities that the robot makes of them."""
    for k in range(7):
        count = TURN / plant.counts[k]
        counts = np.floor(state.motor[k] * (plant.counts[k] / TURN))
        rows.motor[i, plant.channel[k]] = counts * count - state.encoder_zero[k]
        rows.motor_velocity[i, plant.channel[k]] = (counts - state.counts[k]) * count / DT
        state.counts[k] = counts
    for k in range(7):
        position, velocity = 0.0, 0.0
        for j in range(k + 1):
            share = plant.joint_from_motor[k, j]
            position += share * rows.motor[i, plant.channel[j]]
            velocity += share * rows.motor_velocity[i, plant.channel[j]]
        rows.measured[i, plant.channel[k]] = position
        rows.velocity[i, plant.channel[k]] = velocity


@inlined
def _control(plant: Plant, state: State, goal: Array, rows: Rows, i: int) -> None:
    """Torque commands of the robot's PD law on the motor angles."""
    n = len(plant.axes)
    for k in range(7):
        column = plant.channel[k]
        rows.setpoint[i, column] = goal[k]
        wanted = 0.0
        for j in range(k + 1):
            # The tool's motors follow the insertion where it is, not where it should be.
            target = rows.measured[i, j] if j < n <= k else goal[j]
            if j >= n:
                target += state.tool[REGISTERED, j - n] + state.tool[WANDER, j - n]
            wanted += plant.motor_from_joint[k, j] * target
        error = wanted - rows.motor[i, column]
        state.integral[k] += error * DT
        lag = (wanted - state.command[k]) / DT - rows.motor_velocity[i, column]
        torque = (
            plant.gains[k, 0] * error
            + plant.gains[k, 1] * lag
            + plant.gains[k, 2] * state.integral[k]
        )
        state.command[k] = wanted
        limited = min(plant.effort_limit[k], max(-plant.effort_limit[k], torque))
        if limited != torque:
            state.integral[k] -= error * DT
        step = plant.effort_step[k]
        rows.effort[i, column] = step * np.rint(limited / step)


@inlined
def _turn_motors(plant: Plant, state: State, effort: Array) -> None:
    """Motor angles one step later: rotor, Dahl friction and the load of the cables."""
    c = plant.motor_friction
    grease = 1.0 + c.warm_up * (1.0 - state.slow[WARMTH])
    n = len(plant.axes)
    for k in range(7):
        torque = effort[plant.channel[k]] * plant.per_gear[k]
        limit = plant.coulomb[k]
        if k < n:
            ripple = c.capstan_ripple * state.wave[k, 1] + c.gear_ripple * np.sin(
                c.gear_ripple_cycles * state.motor[k] * plant.per_gear[k]
            )
            load = state.carried[k] * plant.scale[k] * plant.per_ratio[k]
            limit *= grease * (1.0 + state.walk[k]) * (1.0 + ripple)
            limit += c.gear_loss * abs(load)
            torque -= load
        else:
            torque -= state.tool[TOOL_LOAD, k - n] * plant.per_gear[k]
        torque -= limit * state.bristle[k]
        state.speed[k] = plant.keep[k] * state.speed[k] + plant.push[k] * torque
        bent = plant.bend[k] * state.speed[k]
        state.bristle[k] = (state.bristle[k] + bent) / (1.0 + abs(bent))
        state.motor[k] += DT * state.speed[k]


@compiled
def age(plant: Plant, state: State, duration: float) -> None:
    """Age cables and grease by `duration` seconds and by the travel in the odometer."""
    c = plant.motor_friction
    still = True
    for k in range(len(plant.axes)):
        final = plant.creep[k, 0] * (1.0 + plant.aging.load_gain * state.slow[LOAD])
        worked = state.odometer[k] / plant.creep[k, 1]
        still = still and worked < STILL
        missing = final - state.creep[k]
        # A cable does not shorten again when its load is taken off.
        if missing * final > 0.0:
            state.creep[k] -= missing * np.expm1(-worked - duration / plant.aging.idle_time)
        keep = np.exp(-duration / c.wander_time)
        noise = c.wander * np.sqrt(1.0 - keep * keep) * normal(state.random)
        state.walk[k] = max(-0.9, keep * state.walk[k] + noise)
        state.odometer[k] = 0.0
    keep = np.exp(-duration / plant.tool_wander_time)
    for i in range(2):
        for k in range(7 - len(plant.axes)):
            noise = plant.tool_wander[i, k] * np.sqrt(1.0 - keep * keep) * normal(state.random[1:])
            state.tool[1 + i, k] = keep * state.tool[1 + i, k] + noise
    warm = 0.0 if still else 1.0
    state.slow[WARMTH] += (warm - state.slow[WARMTH]) * -np.expm1(-duration / c.warm_up_time)


@compiled
def advance(plant: Plant, state: State, setpoint: Array, rows: Rows) -> None:
    """Run one millisecond per row of `setpoint` (n, 7) and write what the robot reports."""
    state.ticks[TRUTH_ROWS] = 0
    work = np.zeros((4, len(plant.axes)))
    for i in range(setpoint.shape[0]):
        _settle(plant, state, work)
        rows.joint[i] = state.joint
        _sample_truth(plant, state, state.ticks[CLOCK] * DT, rows)
        _read_motors(plant, state, rows, i)
        _control(plant, state, setpoint[i], rows, i)
        _turn_motors(plant, state, rows.effort[i])
        state.ticks[CLOCK] += 1
        if state.ticks[CLOCK] % AGE_STEPS == 0:
            age(plant, state, AGE_STEPS * DT)
