"""The forceps' dynamics a second time, in plain Python and solved as they stand on paper."""

import math

import numpy as np
from scipy.optimize import brentq


def elastic(cable, pretension, stretch, yielded):
    """Tension above the pretension: dK/K = s dF/F_pre integrated, plus a Bouc-Wen element."""
    if cable.stiffening > 0:
        rate = cable.stiffening * cable.stiffness / pretension
        force = pretension / cable.stiffening * (math.exp(rate * stretch) - 1.0)
        slope = cable.stiffness * math.exp(rate * stretch)
    else:
        force, slope = cable.stiffness * stretch, cable.stiffness
    a = cable.elastic_share
    hysteretic = (1 - a) * cable.stiffness * cable.hysteresis_distance * yielded
    return a * force + hysteretic, a * slope


def lugre(friction, level, total, inertia, speed, bristle):
    peak = 1 + (friction.stribeck_ratio - 1) * math.exp(
        -((speed / friction.stribeck_velocity) ** 2)
    )
    stiffness = level / friction.presliding
    rate = speed - abs(speed) * bristle / (friction.presliding * peak)
    damping = 2 * friction.bristle_damping * math.sqrt(total / friction.presliding * inertia)
    return stiffness * bristle + damping * rate + friction.viscous * speed, rate


def maxwell_slip(friction, level, total, inertia, position, speed, stuck):
    """Four springs, each held where it last stuck until it carries its share of the level."""
    weights = np.array([1, 1 / 2, 1 / 3, 1 / 4])
    springs = level / friction.presliding * weights / weights.sum()
    limit = level / 4
    limit *= 1 + (friction.stribeck_ratio - 1) * math.exp(
        -((speed / friction.stribeck_velocity) ** 2)
    )
    pull = springs * (position - np.asarray(stuck))
    sticking = springs[np.abs(pull) < limit].sum() / springs.sum()
    damping = 2 * friction.bristle_damping * math.sqrt(total / friction.presliding * inertia)
    return np.clip(pull, -limit, limit).sum() + (damping * sticking + friction.viscous) * speed


def guided(cable, pretension, start, end, held, yielded):
    """Tensions before and behind a guide that holds the cable at `held`, or lets it slide."""
    share, ratio = cable.guide_position, math.exp(cable.guide_friction)

    def tensions(at):
        first = elastic(cable, pretension, (start(at) - at) / share, yielded)[0]
        second = elastic(cable, pretension, (at - end) / (1 - share), yielded)[0]
        return pretension + first, pretension + second

    first, second = tensions(held)
    if first > ratio * second:
        at = brentq(lambda z: np.subtract(*np.multiply(tensions(z), (1, ratio))), held, held + 1e-3)
        return tensions(at)
    if second > ratio * first:
        at = brentq(lambda z: np.subtract(*np.multiply(tensions(z), (ratio, 1))), held - 1e-3, held)
        return tensions(at)
    return first, second


def rates(p, state, wheel, torque, history=None):
    """Rates (8,) and tensions (2,) of a taut forceps away from its stops.

    The accelerations come from the residuals of (4)-(8) with the mass terms written out, solved
    as linear equations in four unknowns: both tensions and both accelerations.
    """
    angle, speed, slider, slider_speed, jaw_bristle, slider_bristle, drive_z, reset_z = state
    r, e, psi = p.mechanism.jaw_radius, p.jaw.eccentricity, p.jaw.eccentricity_phase
    bent = e * (math.cos(angle + psi) - math.cos(psi))
    y1, y2 = r * angle + bent, r * angle - bent
    dy1 = r - e * math.sin(angle + psi)
    dy2 = r + e * math.sin(angle + psi)
    ddy1 = -e * math.cos(angle + psi)  # times speed^2, beside dy1 times the acceleration
    pretension = p.assembly.pretension
    compliance = p.mechanism.wheel_radius**2 / p.assembly.gear_stiffness

    def wound(gap, length):
        """Stretch of a share of the drive cable behind a gear that twists."""

        def missing(d):
            return d + compliance * elastic(p.drive_cable, pretension, d / length, drive_z)[0] - gap

        return brentq(missing, -2e-3, 2e-3, xtol=1e-18)

    stretch = wound(wheel[0] - y1, 1.0)
    drive, slope = elastic(p.drive_cable, pretension, stretch, drive_z)
    share = 1 / (1 + compliance * slope)
    drive_rate = share * (wheel[1] - dy1 * speed)
    reset_rate = dy2 * speed - slider_speed
    reset = elastic(p.reset_cable, pretension, y2 - slider, reset_z)[0]
    kept = 0.0  # of the reset cable's tension, by its guide
    if p.drive_cable.guide_friction > 0:
        share = p.drive_cable.guide_position
        _, drive = guided(
            p.drive_cable, pretension, lambda z: z + wound(wheel[0] - z, share), y1, history[0],
            drive_z,
        )  # fmt: skip
        drive -= pretension
        stretch = wound(wheel[0] - history[0], share) / share
        share = 1 / (1 + compliance * elastic(p.drive_cable, pretension, stretch, drive_z)[1])
        drive_rate = share * (wheel[1] - dy1 * speed)
    if p.reset_cable.guide_friction > 0:
        reset, behind = guided(p.reset_cable, pretension, lambda z: y2, slider, history[1], reset_z)
        kept, reset = reset - behind, reset - pretension
    drive += pretension + p.drive_cable.damping * drive_rate
    reset += pretension + p.reset_cable.damping * reset_rate

    level = p.jaw_friction.constant + p.jaw_friction.tension_share * r * (drive + reset)
    total = p.jaw_friction.constant + p.jaw_friction.tension_share * r * 2 * pretension
    maxwell = p.contact.law == "maxwell_slip"
    jaw_drag, jaw_rate = lugre(p.jaw_friction, level, total, p.jaw.inertia, speed, jaw_bristle)
    level = p.slider_friction.constant + p.slider_friction.tension_share * reset
    total = p.slider_friction.constant + p.slider_friction.tension_share * pretension
    drag, slider_rate = lugre(
        p.slider_friction, level, total, p.slider.mass, slider_speed, slider_bristle
    )

    if maxwell:
        total = p.jaw_friction.constant + p.jaw_friction.tension_share * r * 2 * pretension
        at_jaw = p.jaw_friction.constant + p.jaw_friction.tension_share * r * (drive + reset)
        jaw_drag = maxwell_slip(
            p.jaw_friction, at_jaw, total, p.jaw.inertia, angle, speed, history[4:8]
        )
        total = p.slider_friction.constant + p.slider_friction.tension_share * pretension
        drag = maxwell_slip(
            p.slider_friction, level, total, p.slider.mass, slider, slider_speed, history[8:12]
        )
        jaw_rate, slider_rate = 0.0, 0.0

    # Unknowns: F_wd, F_wr, jaw acceleration, slider acceleration.
    md, mr = share * p.drive_cable.mass, p.reset_cable.mass
    matrix = np.array(
        [
            [1, 0, md * dy1, 0],  # (4)
            [0, 1, -mr * dy2, mr],  # (5)
            [0, -1, 0, p.slider.mass],  # (6)
            [-dy1, dy2, p.jaw.inertia, 0],  # (8), by virtual work on an eccentric pulley
        ]
    )
    right = np.array(
        [
            drive + md * (wheel[2] - ddy1 * speed**2),
            reset - mr * ddy1 * speed**2,
            -p.mechanism.spring_stiffness * slider - drag - pretension - kept,
            torque - jaw_drag,
        ]
    )
    drive_tension, reset_tension, jaw_acc, slider_acc = np.linalg.solve(matrix, right)

    def yielding(rate, z, cable):
        return (rate - 0.5 * abs(rate) * z - 0.5 * rate * abs(z)) / cable.hysteresis_distance

    result = [
        speed,
        jaw_acc,
        slider_speed,
        slider_acc,
        jaw_rate,
        slider_rate,
        yielding(drive_rate, drive_z, p.drive_cable),
        yielding(reset_rate, reset_z, p.reset_cable),
    ]
    return np.array(result), np.array([drive_tension, reset_tension])


def wheel(p, motor, motor_speed, motor_acceleration):
    """Cable wound on an eccentric wheel, its speed and acceleration, from the motor's."""
    n, e, psi = p.mechanism.gear_ratio, p.assembly.wheel_eccentricity, p.assembly.wheel_phase
    angle, speed, acceleration = motor / n, motor_speed / n, motor_acceleration / n
    radius = p.mechanism.wheel_radius + e * math.cos(angle + psi)
    return np.array(
        [
            p.mechanism.wheel_radius * angle + e * (math.sin(angle + psi) - math.sin(psi)),
            radius * speed,
            radius * acceleration - e * math.sin(angle + psi) * speed**2,
        ]
    )
