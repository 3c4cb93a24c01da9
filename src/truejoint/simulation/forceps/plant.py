"""Compiled dynamics of the forceps: equations (1)-(8) of yan2020 and what they leave out.

State, in this order: jaw angle [rad] and its speed, displacement ``x2`` of the reset cable's end
[m] and its speed, bristle deflections of jaw [rad] and slider [m], and the Bouc-Wen states [1] of
drive and reset cable. Behind these stands what only jumps from step to step, since it depends on
the way and not on time: by how much each cable has travelled over its guide [m], how far it has
crept [m], where the Maxwell elements of jaw [rad] and slider [m] last stuck, and the wheel [rad]
behind the gear's backlash. The motor loop runs beside it: nothing acts back on the motor, but the
gear behind it twists.
"""

import math

import numpy as np

from truejoint.array_types import Array
from truejoint.compiled import compiled, inlined
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.simulation import friction
from truejoint.simulation.forceps.parameters import CableConstants, PlantConstants
from truejoint.simulation.friction import ContactLaw

N_STATES = 8  # that Runge and Kutta integrate
TRAVEL, CREEP, JAW_STUCK = 0, 2, 4  # places in the history behind the states
SLIDER_STUCK = JAW_STUCK + friction.N_ELEMENTS
WHEEL = SLIDER_STUCK + friction.N_ELEMENTS
N_HISTORY = WHEEL + 1
N_LOGGED = 7  # motor, x1, x2, jaw, external torque, drive tension, reset tension


@inlined
def cable_force(stretch: float, yielded: float, cable: CableConstants) -> tuple[float, float]:
    """Tension above the pretension [N] of a cable at rest, and its slope [N/m].

    The elastic part's stiffness grows linearly with its tension, so that its law is exponential;
    the rest is a Bouc-Wen element of state `yielded`. Below zero tension the caller cuts it off.
    """
    growth = math.exp(min(cable.growth * stretch, 20.0))
    force = cable.elastic * (growth - 1.0) + cable.hysteretic * yielded
    return force, cable.elastic * cable.growth * growth


@inlined
def stretched(
    distance: float, yielded: float, share: float, cable: CableConstants
) -> tuple[float, float, float]:
    """Stretch of a cable behind its gear [m], tension [N] and share of motion that stretches it.

    Both are as if the whole cable were strained like its piece, a `share` of its length. The gear's
    torsion is in series with the cable and takes up a few per cent of `distance` [m]; damping and
    mass forces, a thousand times smaller than the tension, do not twist it. One Newton step from
    the linear solution leaves less than 1e-7 of the stretch.
    """
    stretch, compliance = distance, cable.compliance / share
    if compliance > 0.0:
        stretch = distance / (1.0 + compliance * cable.of.stiffness)
        force, slope = cable_force(stretch, yielded, cable)
        stretch -= (stretch + compliance * force - distance) / (1.0 + compliance * slope)
    force, slope = cable_force(stretch, yielded, cable)
    if force < -cable.pretension:  # slack: the gear is unloaded and the cable follows freely
        return distance + compliance * cable.pretension, 0.0, 1.0
    return stretch, cable.pretension + force, 1.0 / (1.0 + compliance * slope)


@inlined
def pull_cable(
    start: float,
    end: float,
    bent: float,
    yielded: float,
    cable: CableConstants,
    dt: float,
    history: Array,
    keep: bool,
) -> tuple[float, float, float, float]:
    """``x1`` [m] of a cable, tensions before and behind its guide [N], share of motion as above.

    `start` [m] is what is wound up at the end towards the motor, `end` + `bent` what is let go at
    the other. A Kelvin-Voigt element behind the cable's spring makes it creep.
    """
    travel, creep = TRAVEL + cable.number, CREEP + cable.number
    crept = history[creep]
    if cable.guide_ratio > 1.0:
        first, last, held = cable.of.guide_position, 1.0 - cable.of.guide_position, history[travel]
        stretch, before, share = stretched((start - held) / first - crept, yielded, first, cable)
        slope = share * cable_force(stretch, yielded, cable)[1] / first if before > 0.0 else 0.0
        behind, stiffness = cable_force((held - end - bent) / last - crept, yielded, cable)
        behind = max(behind + cable.pretension, 0.0)
        stiffness = stiffness / last if behind > 0.0 else 0.0
        slid = friction.guide_travel(before, behind, cable.guide_ratio, slope, stiffness)
        before, behind = max(before - slope * slid, 0.0), max(behind + stiffness * slid, 0.0)
        x1 = held + first * (stretch + crept) + (1.0 - share) * slid
        share /= share + first * (1.0 - share)  # of the whole cable
        if keep:
            history[travel] += slid
    else:
        stretch, before, share = stretched(start - end - bent - crept, yielded, 1.0, cable)
        x1, behind = stretch + crept + end + bent, before
    if keep:
        force = before - cable.pretension
        history[creep] += cable.creep_rate * dt * (cable.creep * force - crept)
    return x1, before, behind, share


@inlined
def bouc_wen_rate(speed: float, yielded: float, distance: float) -> float:
    """Rate [1/s] of a Bouc-Wen state with n = 1 and beta = gamma = 1/2; it stays in [-1, 1]."""
    return (speed - 0.5 * (abs(speed) * yielded + speed * abs(yielded))) / distance


@inlined
def friction_force(
    speed: float, bristle: float, level: float, f: ContactLaw, max_rate: float
) -> tuple[float, float]:
    """LuGre friction [N or Nm] at Coulomb level `level`, and the rate of its bristle.

    The bristle relaxes at most at `max_rate` [1/s], which only binds in a fast run-away where the
    fixed step could not follow it.
    """
    limit = f.presliding * friction.stribeck_peak(speed, f)
    rate = min(abs(speed) / limit, max_rate) * (math.copysign(limit, speed) - bristle)
    force = level / f.presliding * bristle + f.damping * rate + f.viscous * speed
    return force, rate


@inlined
def accelerations(
    drive_pull: float,
    reset_pull: float,
    share: float,
    wheel_acceleration: float,
    bend: float,
    slope: float,
    torque: float,
    force: float,
    c: PlantConstants,
) -> tuple[float, float, float, float]:
    """Solve (6) and (8) for the accelerations of jaw and slider; also both tensions [N].

    `drive_pull`, `reset_pull`: tensions but for the mass terms [N], zero where slack; `share`: of
    the drive cable's motion, what its gear leaves. `wheel_acceleration`, `bend` [m/s2]: of the
    drive cable at the wheel, and at both ends through the bending of the eccentric pulley's path,
    which lengthens the drive cable's arm by `slope` [m]. `torque` [Nm] acts on the jaw and `force`
    [N] on the slider, from all but the cables.

    The cables' mass in (4) and (5) couples the two. Where it would make a cable push, the cable is
    slack and they are solved again without it.
    """
    arm_drive, arm_reset = c.mechanism.jaw_radius + slope, c.mechanism.jaw_radius - slope
    jaw_acceleration, slider_acceleration = 0.0, 0.0
    drive_tension, reset_tension = drive_pull, reset_pull
    for _ in range(3):
        drive_mass = share * c.drive.of.mass if drive_pull > 0.0 else 0.0
        reset_mass = c.reset.of.mass if reset_pull > 0.0 else 0.0
        drive_free = drive_pull + drive_mass * (wheel_acceleration - bend)
        reset_free = reset_pull - reset_mass * bend
        m11 = (
            c.jaw.inertia + arm_drive * arm_drive * drive_mass + arm_reset * arm_reset * reset_mass
        )
        m12 = -arm_reset * reset_mass
        m22 = c.slider_mass + reset_mass
        b1 = arm_drive * drive_free - arm_reset * reset_free + torque
        b2 = reset_free + force
        determinant = m11 * m22 - m12 * m12
        jaw_acceleration = (m22 * b1 - m12 * b2) / determinant
        slider_acceleration = (m11 * b2 - m12 * b1) / determinant
        drive_tension = drive_free - drive_mass * arm_drive * jaw_acceleration
        reset_tension = reset_free + reset_mass * (
            arm_reset * jaw_acceleration - slider_acceleration
        )
        if drive_tension >= 0.0 and reset_tension >= 0.0:
            break
        drive_pull = 0.0 if drive_tension < 0.0 else drive_pull
        reset_pull = 0.0 if reset_tension < 0.0 else reset_pull
    return jaw_acceleration, slider_acceleration, drive_tension, reset_tension


@compiled
def plant_rates(
    state: Array,
    wheel: Array,
    force: float,
    line_angle: float,
    c: PlantConstants,
    max_rate: float,
    history: Array,
    keep: bool,
    rates: Array,
) -> tuple[float, float, float]:
    """Right-hand side of the plant: fills `rates` (8,), returns both tensions [N] and ``x1`` [m].

    `state` (8,) and `history` (13,) are in the order that the module states, `wheel` (3,) the
    displacement [m] of the drive cable on a rigid gear, its speed and its acceleration; the `force`
    [N] at the jaw's tip is perpendicular at the jaw angle `line_angle` [rad]; `max_rate` [1/s], one
    a step, as in `friction_force`. `keep` where this is the state that a step ends in: then the
    history goes on to it.
    """
    angle, speed, slider, slider_speed = state[0], state[1], state[2], state[3]
    # (7), with an eccentric pulley: y1 = r theta + D, y2 = r theta - D, and D' lengthens an arm.
    eccentricity, phase = c.jaw.eccentricity, c.jaw.eccentricity_phase
    centre = eccentricity * math.cos(angle + phase)
    slope = -eccentricity * math.sin(angle + phase)
    offset = centre - eccentricity * math.cos(phase)
    radius = c.mechanism.jaw_radius
    arm_drive, arm_reset = radius + slope, radius - slope
    bend = -centre * speed * speed  # what of the second derivative of D is no angular acceleration

    # (4) and (5) without the mass terms; a slack cable neither pulls nor weighs.
    turned, dt = radius * angle, 1.0 / max_rate
    x1, _, drive_pull, share = pull_cable(
        wheel[0], turned, offset, state[6], c.drive, dt, history, keep
    )
    drive_rate = share * (wheel[1] - arm_drive * speed)
    reset_rate = arm_reset * speed - slider_speed
    # Both cables run from the motor on, so that the jaw stands before this one's guide.
    _, reset_pull, end_pull, _ = pull_cable(
        turned - offset, slider, 0.0, state[7], c.reset, dt, history, keep
    )
    guide_drag = reset_pull - end_pull
    if drive_pull > 0.0:
        drive_pull = max(drive_pull + c.drive.of.damping * drive_rate, 0.0)
    if reset_pull > 0.0:
        reset_pull += c.reset.of.damping * reset_rate
    reset_pull = max(reset_pull, 0.0)

    level = c.jaw_friction.constant + c.jaw_friction.tension_share * radius * (
        drive_pull + reset_pull
    )
    slider_level = c.slider_friction.constant + c.slider_friction.tension_share * reset_pull
    if c.is_maxwell_slip:
        rates[4], rates[5] = 0.0, 0.0
        jaw_drag = friction.maxwell_slip(angle, speed, level, c.jaw_law, history, JAW_STUCK, keep)
        drag = friction.maxwell_slip(
            slider, slider_speed, slider_level, c.slider_law, history, SLIDER_STUCK, keep
        )
    else:
        jaw_drag, rates[4] = friction_force(speed, state[4], level, c.jaw_law, max_rate)
        drag, rates[5] = friction_force(
            slider_speed, state[5], slider_level, c.slider_law, max_rate
        )
    free_torque = force * c.jaw.load_arm * math.cos(angle - line_angle) - jaw_drag
    beyond = max(angle - c.jaw.stop_upper, 0.0) + min(angle - c.jaw.stop_lower, 0.0)
    if beyond != 0.0:  # the mechanical stops push and never pull
        stop = -c.jaw.stop_stiffness * beyond - c.jaw.stop_damping * speed
        free_torque += min(stop, 0.0) if beyond > 0.0 else max(stop, 0.0)
    free_force = -c.mechanism.spring_stiffness * slider - drag - c.assembly.pretension - guide_drag

    rates[1], rates[3], drive_tension, reset_tension = accelerations(
        drive_pull, reset_pull, share, wheel[2], bend, slope, free_torque, free_force, c
    )
    rates[0] = speed
    rates[2] = slider_speed
    rates[6] = bouc_wen_rate(drive_rate, state[6], c.drive.of.hysteresis_distance)
    rates[7] = bouc_wen_rate(reset_rate, state[7], c.reset.of.hysteresis_distance)
    return drive_tension, reset_tension, x1


@inlined
def motor_acceleration(angle: float, speed: float, goal: float, c: PlantConstants) -> float:
    """Acceleration [rad/s2] of the motor's position loop, within its limits."""
    wanted = c.motor_frequency * (
        c.motor_frequency * (goal - angle) - 2.0 * c.motor.damping_ratio * speed
    )
    limited = min(max(wanted, -c.motor.max_acceleration), c.motor.max_acceleration)
    if abs(speed) >= c.motor.max_speed and limited * speed > 0.0:
        return 0.0
    return limited


@compiled
def advance_motor(motor: Array, goal: Array, dt: float, c: PlantConstants) -> None:
    """One Runge-Kutta step of the motor (angle, speed) with goals at start, middle and end."""
    angle, speed = motor[0], motor[1]
    half = 0.5 * dt
    a1 = motor_acceleration(angle, speed, goal[0], c)
    s2 = speed + half * a1
    a2 = motor_acceleration(angle + half * speed, s2, goal[1], c)
    s3 = speed + half * a2
    a3 = motor_acceleration(angle + half * s2, s3, goal[1], c)
    s4 = speed + dt * a3
    a4 = motor_acceleration(angle + dt * s3, s4, goal[2], c)
    motor[0] += dt / 6.0 * (speed + 2.0 * s2 + 2.0 * s3 + s4)
    motor[1] += dt / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
    motor[1] = min(max(motor[1], -c.motor.max_speed), c.motor.max_speed)


@compiled
def wheel_motion(
    motor: Array, goal: float, c: PlantConstants, history: Array, keep: bool, wheel: Array
) -> None:
    """Fill `wheel` (3,): cable wound on an eccentric wheel [m], its speed and acceleration; (3).

    Within the gear's backlash the wheel rests where the `history` (13,) has it, which `keep` moves.
    """
    angle = motor[0] * c.wheel_per_motor
    speed = motor[1] * c.wheel_per_motor
    acceleration = motor_acceleration(motor[0], motor[1], goal, c) * c.wheel_per_motor
    half = 0.5 * c.assembly.gear_backlash
    if half > 0.0:
        if abs(angle - history[WHEEL]) <= half:
            angle, speed, acceleration = history[WHEEL], 0.0, 0.0
        else:
            angle -= math.copysign(half, angle - history[WHEEL])
        if keep:
            history[WHEEL] = angle
    eccentricity, phase = c.assembly.wheel_eccentricity, c.assembly.wheel_phase
    sine = eccentricity * math.sin(angle + phase)
    radius = c.mechanism.wheel_radius + eccentricity * math.cos(angle + phase)
    wheel[0] = c.mechanism.wheel_radius * angle + sine - eccentricity * math.sin(phase)
    wheel[1] = radius * speed
    wheel[2] = radius * acceleration - sine * speed * speed


@inlined
def _between(samples: Array, n: int, quarter: float, per_sample: int) -> float:
    """Linear interpolation of `samples`, `quarter` after integration step number `n`.

    The end value stays; counting in whole steps makes it the same however a motion is cut.
    """
    index = min(n // per_sample, samples.size - 2)
    part = (n - index * per_sample + quarter) / per_sample
    if part >= 1.0:
        return float(samples[index + 1])
    return float(samples[index] + part * (samples[index + 1] - samples[index]))


@compiled
def advance(
    state: Array,
    motor: Array,
    goal: Array,
    force: Array,
    line_angle: float,
    c: PlantConstants,
    per_sample: int,
    log_every: int,
) -> Array:
    """Run the forceps on by fixed Runge-Kutta steps of fourth order.

    Advances `state` (21,) and `motor` (2,), its angle and speed. `goal` (n,) is the motor angle
    wanted [rad] every `SETPOINT_DT`, from now on and linear in between, `force` (n,) [N] at the
    jaw's tip on the same grid, positive where it opens the jaw, to which it is perpendicular at
    `line_angle` [rad]. There are `per_sample` steps in one `SETPOINT_DT`, `log_every` between rows.

    Returns rows (m, 7): motor angle [rad], ``x1``, ``x2`` [m], jaw angle [rad], external torque
    [Nm], tension of drive and of reset cable [N]; the first is before the first step.
    """
    dt = SETPOINT_DT / per_sample
    n_steps = (goal.size - 1) * per_sample
    log = np.empty((n_steps // log_every + 1, N_LOGGED))
    trial, k = np.empty(N_STATES), np.empty((4, N_STATES))
    wheels, forces, goals = np.empty((3, 3)), np.empty(3), np.empty(5)
    history, keep = state[N_STATES:], bool(0)  # a constant's type is its own: compiled once more
    for n in range(n_steps + 1):
        for i in range(5):
            goals[i] = _between(goal, n, 0.25 * i, per_sample)
        for i in range(3):
            forces[i] = _between(force, n, 0.5 * i, per_sample)
        wheel_motion(motor, goals[0], c, history, not keep, wheels[0])
        drive_tension, reset_tension, x1 = plant_rates(
            state, wheels[0], forces[0], line_angle, c, 1.0 / dt, history, n < n_steps, k[0]
        )
        if n % log_every == 0:
            row = log[n // log_every]
            row[0], row[1], row[2], row[3] = motor[0], x1, state[2], state[0]
            row[4] = forces[0] * c.jaw.load_arm * math.cos(state[0] - line_angle)
            row[5], row[6] = drive_tension, reset_tension
        if n == n_steps:
            break
        for half in range(2):  # the plant needs the motor in the middle of the step, too
            advance_motor(motor, goals[2 * half : 2 * half + 3], 0.5 * dt, c)
            wheel_motion(motor, goals[2 * half + 2], c, history, keep, wheels[half + 1])
        for stage in range(1, 4):
            part = 1.0 if stage == 3 else 0.5
            at = 2 if stage == 3 else 1
            for i in range(N_STATES):
                trial[i] = state[i] + part * dt * k[stage - 1, i]
            plant_rates(
                trial, wheels[at], forces[at], line_angle, c, 1.0 / dt, history, keep, k[stage]
            )
        for i in range(N_STATES):
            state[i] += dt / 6.0 * (k[0, i] + 2.0 * k[1, i] + 2.0 * k[2, i] + k[3, i])
    return log


def settled(c: PlantConstants, per_sample: int, duration: float) -> tuple[Array, Array]:
    """State (21,) and motor (2,) at zero after `duration` [s], pretension and friction settled."""
    state, motor = np.zeros(N_STATES + N_HISTORY), np.zeros(2)
    still = np.zeros(round(duration / SETPOINT_DT) + 1)
    advance(state, motor, still, still, 0.0, c, per_sample, per_sample)
    return state, motor
