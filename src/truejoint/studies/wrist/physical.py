"""A physical filter of an instrument: identified from its recordings, and how honest it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from statistics import NormalDist
from typing import Final

import numpy as np
from scipy.linalg import block_diag
from scipy.optimize import least_squares, nnls

from truejoint.array_types import Array
from truejoint.errors import StudyError
from truejoint.filters import StateSpaceModel, UnscentedFilter
from truejoint.models.play import bank_columns
from truejoint.recordings import Recording
from truejoint.robots import Robot
from truejoint.robots.cable_mechanism import CableMechanism
from truejoint.studies.wrist import reduced as r

JOINTS: Final = ("pitch", "jaw1", "jaw2")
LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""

_ANGLE_NOISE: Final = 1e-3  # [rad] and
_EFFORT_NOISE: Final = 2e-3  # [Nm] that count as much in the fit
_THINNED: Final = 8  # rows of which the fit counts one
_LONGEST: Final = 60.0  # [s] of each recording that it simulates
_SETTLED: Final = 2.0  # [s] after which friction has forgotten how it began
_BLOCK: Final = 2.0  # [s] whose misfits count as one draw
_ERROR_TIME: Final = 0.1  # [s] for which the misfit of an effort stays the same
_QUIET: Final = np.array([4e-4])  # [rad] of a motor
_DECAY: Final = 3.0  # [s] in which a load fades that nothing shows any more
_NINETY: Final = NormalDist().inv_cdf(0.95)  # deviations that hold 90 % of a normal's draws
_DRIFT: Final = (0.1, 0.05, 0.1)  # of friction of loops, motors, pins, in its size per root second

# What is searched for, by name: where the search begins, lowest and highest.
_SOUGHT: Final[Mapping[str, tuple[float, float, float]]] = {
    "pitch_stiffness": (9e4, 8e3, 5e5),  # [N/m] of one cable
    "jaw_stiffness": (9e4, 8e3, 5e5),
    "share_before": (0.45, 0.05, 1.0),  # of a cable's compliance that lies before its guides
    "pitch_friction": (6.0, 0.2, 60.0),  # [N] of a loop over its guides
    "jaw1_friction": (6.0, 0.2, 60.0),
    "jaw2_friction": (6.0, 0.2, 60.0),
    "build_up": (4e5, 2e4, 5e6),  # [N/m]
    "pitch_pin": (8e-3, 3e-4, 6e-2),  # [Nm]
    "jaw_pin": (4e-3, 1e-4, 3e-2),
    "pin_way": (3e-3, 5e-4, 2e-2),  # [rad]
    "tension": (32.0, 12.0, 100.0),  # [N] of both cables of a loop
    "motor_way": (5e-3, 5e-4, 5e-2),  # [rad]
}

STARTS: Final = {name: start for name, (start, _, _) in _SOUGHT.items()}
"""Values of what is sought where the search begins, of an instrument with rods."""


@dataclass(frozen=True)
class Estimate:
    """Angles (n, 3) [rad] and loads (n, 3) [Nm] in every row, each with its deviation."""

    angle: Array
    angle_deviation: Array
    load: Array
    load_deviation: Array
    states: Array  # (n, 12) of `reduced`


@dataclass(frozen=True)
class Signals:
    """What a recording holds, as arrays (n, 3)."""

    motor: Array
    effort: Array
    speed: Array
    truth: Array
    load: Array
    dt: float

    @classmethod
    def of(cls, recording: Recording) -> Signals:
        """Signals of one recording, its rows evenly spaced."""
        dt = float(np.median(np.diff(recording.t)))
        motor = recording.columns("motor", JOINTS)
        speed = np.diff(motor, axis=0, prepend=motor[:1]) / dt
        steps, deflection = np.full(len(motor), dt), np.empty((len(motor), 1))
        steps[0] = 0.0
        for m in range(motor.shape[1]):  # what trembles within noise moves no friction
            bank_columns(steps, motor[:, m].copy(), 1.0, _QUIET, deflection)
            motor[:, m] -= _QUIET * deflection[:, 0]
        return cls(
            motor,
            recording.columns("effort", JOINTS),
            speed,
            recording.columns("truth", JOINTS),
            recording.columns("truth_load", LOADS),
            dt,
        )

    @property
    def inputs(self) -> Array:
        """Inputs (n, 9) of the filter: motors, by how much they moved, and how fast."""
        moved = np.diff(self.motor, axis=0, prepend=self.motor[:1])
        return np.column_stack([self.motor, moved, self.speed])

    def first(self, seconds: float) -> Signals:
        """Its beginning."""
        rows = slice(round(seconds / self.dt))
        return Signals(
            self.motor[rows], self.effort[rows], self.speed[rows], self.truth[rows],
            self.load[rows], self.dt,
        )  # fmt: skip


def geometry(rigid: Array) -> Array:
    """List what radii, zeros, eccentric pulleys may add to joints (n, 10), at raw ones (n, 3)."""
    return np.column_stack([np.ones(len(rigid)), rigid, np.sin(rigid), np.cos(rigid)])


def constants(mechanism: CableMechanism, sought: Mapping[str, float]) -> Array:
    """Parameters of `reduced` for an instrument and what was found of it."""
    p = np.zeros(r.PARAMETERS)
    radius = np.array(list(mechanism.motors.values()))
    first = {motor: n for n, motor in reversed(list(enumerate(c.motor for c in mechanism.cables)))}
    loops = mechanism.moments[[first[motor] for motor in mechanism.motors]]
    inverse = np.linalg.inv(loops)
    opening = np.zeros(r.N) if mechanism.contact is None else mechanism.row(
        mechanism.contact.opening)  # fmt: skip
    arms = [mechanism.row(arm) for arm in mechanism.arms.values()]
    pulls = [opening, *(arm / np.abs(arm).sum() for arm in arms)]
    crossing = (np.abs(loops) > 0.0).T.astype(np.float64)
    stiffness = np.array([sought["pitch_stiffness"], *[sought["jaw_stiffness"]] * 2])
    level = [sought[f"{name}_friction"] for name in JOINTS]
    for at, values in (
        (r.RIGID, inverse * radius),
        (r.INVERSE, inverse),
        (r.ON_JOINT, np.column_stack(pulls)),
        (r.RADIUS, radius),
        (r.STRETCH, 0.5 / stiffness),
        (r.BEFORE, 0.5 * sought["share_before"] / stiffness),
        (r.LEVEL, level),
        (r.PIN_LEVEL, [sought["pitch_pin"], *[sought["jaw_pin"]] * 2]),
        (r.EFFORT, [*[1.0] * 3, *[0.0] * 9]),
        (r.CROSSING, crossing / crossing.sum(axis=1, keepdims=True)),
        (r.DRIFT, np.square(_DRIFT)),
    ):
        flat = np.ravel(values)
        p[at : at + len(flat)] = flat
    p[r.BUILD_UP], p[r.PIN_WAY] = sought["build_up"], sought["pin_way"]
    p[r.TENSION], p[r.MOTOR_WAY] = sought["tension"], sought["motor_way"]
    p[r.DECAY] = 1.0 / _DECAY
    return p


def _simulated(s: Signals, p: Array) -> tuple[Array, Array, Array]:
    joint, torque, share = np.empty((3, *s.motor.shape))
    x = np.zeros(r.STATES)
    x[r.LOAD :] = s.load[0]
    r.simulate(s.motor, s.load, p, x, joint, torque, share)
    return joint, torque, share


@dataclass(frozen=True, eq=False)
class Physical:
    """What recordings tell of an instrument.

    Attributes
    ----------
    found : mapping of str to (float, float)
        What was sought, and its standard deviation.
    parameters : ndarray
        Of `reduced`.
    added : ndarray, shape (10, 3)
        What geometry adds to each joint.
    effort_misfit : ndarray, shape (3,)
        Standard deviation of what the model leaves of each motor's effort [Nm].
    structure : ndarray, shape (2, 2, 3)
        Of angles and of loads: by what the filter's variance is multiplied, and what is added to
        it per square of the loads that it sees, so that calibration's errors are as large as that,
        free and loaded.
    """

    found: Mapping[str, tuple[float, float]]
    parameters: Array
    added: Array
    effort_misfit: Array
    structure: Array

    def unscented(self, dt: float) -> UnscentedFilter:
        """Build the filter of rows `dt` [s] apart."""
        states = [f"{kind}_{k}" for kind in ("loop", "motor", "pin", "load") for k in range(r.N)]
        inputs = [f"{kind}_{k}" for kind in ("angle", "change", "speed") for k in range(r.N)]
        model = StateSpaceModel(
            transition=r.transition,
            measurement=r.measurement,
            process_noise=r.process_noise,
            measurement_noise=np.diag(self.effort_misfit**2 * max(_ERROR_TIME / dt, 1.0)),
            states=tuple(states),
            measurements=tuple(f"effort_{k}" for k in range(r.N)),
            inputs=tuple(inputs),
            parameters=self.parameters,
        )
        return UnscentedFilter(model)

    @property
    def prior(self) -> tuple[Array, Array]:
        """State and covariance of an instrument of which nothing is known."""
        p = self.parameters
        variance = p[r.LOAD_RATE : r.LOAD_RATE + r.N] * 0.5 * _DECAY
        spread = [
            np.diag(p[r.LEVEL : r.LEVEL + r.N] ** 2) / 3.0,
            np.eye(r.N) / 3.0,
            np.diag(p[r.PIN_LEVEL : r.PIN_LEVEL + r.N] ** 2) / 3.0,
            np.diag(variance),
        ]
        return np.zeros(r.STATES), block_diag(*spread)

    def estimate(self, s: Signals) -> Estimate:
        """Angles and loads in every row, from motors and efforts alone."""
        mean, spread = self.prior
        run = self.unscented(s.dt).run(s.effort, s.inputs, x0=mean, P0=spread, dt=s.dt)
        rigid = s.motor @ self.parameters[r.RIGID : r.RIGID + 9].reshape(3, 3).T
        angle = np.empty_like(rigid)
        for row, x, a in zip(angle, run.x, s.motor, strict=True):
            r.joints(x, a, self.parameters, row)
        angle += geometry(rigid) @ self.added
        by_state = self._by_state()
        variance = np.einsum("ji,nik,jk->nj", by_state, run.P, by_state)
        own = np.diagonal(run.P, axis1=1, axis2=2)[:, r.LOAD :]
        seen = np.square(np.abs(run.x[:, r.LOAD :]).sum(axis=1, keepdims=True))
        stated = [
            np.sqrt(np.maximum(each, 0.0) * factor + seen * added)
            for each, (factor, added) in zip((variance, own), self.structure, strict=True)
        ]
        return Estimate(angle, stated[0], run.x[:, r.LOAD :], stated[1], run.x)

    def _by_state(self) -> Array:
        """Give the derivative (3, 12) of the joints by the state, of cables that are taut."""
        rows, zero, still = np.empty((r.STATES, r.N)), np.empty(r.N), np.zeros(r.N)
        r.joints(np.zeros(r.STATES), still, self.parameters, zero)
        for n, unit in enumerate(1e-6 * np.eye(r.STATES)):
            r.joints(unit, still, self.parameters, rows[n])
        return np.asarray((rows - zero).T / 1e-6)


def _linear(s: Sequence[Signals], p: Array) -> tuple[Array, Array, list[Array], Array]:
    """Misfits (k, 6) of thinned rows after what is linear was found, that, and rows' blocks."""
    angle, basis, columns, effort, blocks = [], [], [], [], []
    for n, one in enumerate(s):
        joint, torque, share = _simulated(one, p)
        rows = slice(round(_SETTLED / one.dt), None, _THINNED)
        rigid = one.motor @ p[r.RIGID : r.RIGID + 9].reshape(3, 3).T
        angle.append((one.truth - joint)[rows])
        basis.append(geometry(rigid[rows]))
        columns.append(np.stack([torque, share, one.speed, np.ones_like(torque)], axis=2)[rows])
        effort.append(one.effort[rows])
        number = np.arange(len(one.motor))[rows] * one.dt // _BLOCK
        blocks.append(number + 1e6 * n)
    geometries, left = np.vstack(basis), np.vstack(angle)
    added = np.asarray(np.linalg.lstsq(geometries, left, rcond=None)[0], dtype=np.float64)
    left = left - geometries @ added
    design, told = np.concatenate(columns), np.vstack(effort)
    by_motor = [
        np.asarray(np.linalg.lstsq(design[:, m], told[:, m], rcond=None)[0], dtype=np.float64)
        for m in range(r.N)
    ]
    off = np.column_stack([told[:, m] - design[:, m] @ own for m, own in enumerate(by_motor)])
    return np.asarray(np.hstack([left, off])), added, by_motor, np.concatenate(blocks)


def identify(recordings: Sequence[Recording], robot: Robot) -> Physical:
    """Find stiffness, friction, radii and sensors' gains in recordings with truth and loads.

    Deviations count the misfits of two seconds as one draw (cluster-robust), so that a model that
    is not quite true says so.

    Raises StudyError where the robot states no cables, or no recording has a load.
    """
    mechanism = robot.cable_mechanism
    if mechanism is None:
        raise StudyError(f"{robot.title} states no cables; add [cable_mechanism]")
    own = [Signals.of(recording) for recording in recordings]
    if not any(np.any(one.load) for one in own):
        raise StudyError(
            "no recording has a load, so that grip and tip torque cannot be told from friction; "
            "add a minute under loads"
        )
    signals = [one.first(_LONGEST) for one in own]
    names, table = tuple(_SOUGHT), np.log(np.array(list(_SOUGHT.values())))
    scale = np.repeat([_ANGLE_NOISE, _EFFORT_NOISE], r.N)

    def parameters(logarithms: Array) -> Array:
        return constants(mechanism, dict(zip(names, np.exp(logarithms), strict=True)))

    def misfit(logarithms: Array) -> Array:
        return np.ravel(_linear(signals, parameters(logarithms))[0] / scale)

    search = least_squares(
        misfit, table[:, 0], bounds=(table[:, 1], table[:, 2]), diff_step=[1e-3], max_nfev=15,
        x_scale=0.3,
    )  # fmt: skip
    p = parameters(search.x)
    left, added, by_motor, blocks = _linear(signals, p)
    deviation = np.exp(search.x) * _robust(
        np.asarray(search.jac), search.fun, np.repeat(blocks, 2 * r.N)
    )
    p[r.EFFORT : r.EFFORT + 4 * r.N] = np.array(by_motor).T.ravel()
    spread = np.mean([np.var(one.load, axis=0) for one in own if np.any(one.load)], axis=0)
    p[r.LOAD_RATE : r.LOAD_RATE + r.N] = 2.0 * spread / _DECAY
    found = {
        name: (float(value), float(off))
        for name, value, off in zip(names, np.exp(search.x), deviation, strict=True)
    }
    plain = np.array([np.ones((2, 3)), np.zeros((2, 3))]).swapaxes(0, 1)
    made = Physical(found, p, added, left[:, r.N :].std(axis=0), plain)
    return replace(made, structure=_structure(made, signals))


def _robust(jacobian: Array, left: Array, blocks: Array) -> Array:
    """Give deviations of least squares whose misfits (n,) are alike within `blocks` (n,)."""
    order = np.argsort(blocks, kind="stable")
    edges = [0, *(np.flatnonzero(np.diff(blocks[order])) + 1), len(order)]
    score = np.array(
        [jacobian[rows].T @ left[rows] for a, b in pairwise(edges) for rows in [order[a:b]]]
    )
    bread = np.linalg.pinv(jacobian.T @ jacobian)
    return np.sqrt(np.maximum(np.diag(bread @ (score.T @ score) @ bread), 0.0))


def _structure(made: Physical, signals: Sequence[Signals]) -> Array:
    """Find `Physical.structure` in the errors that its plain filter makes in each recording."""
    shown, stated, seen = [], [], []
    for one in signals:
        found, rows = made.estimate(one), slice(round(_SETTLED / one.dt), None)
        white = np.var(np.diff(one.truth, n=3, axis=0), axis=0) / 20.0  # of the reference
        off = [found.angle - one.truth, found.load - one.load]
        squares = [np.mean(each[rows] ** 2, axis=0) for each in off]
        # Of an error that the reference's noise hides, some is believed all the same.
        shown.append([np.maximum(squares[0] - white, 0.1 * squares[0]), squares[1]])
        own = found.angle_deviation, found.load_deviation
        stated.append([np.mean(each[rows] ** 2, axis=0) for each in own])
        seen.append(np.mean(np.abs(found.load[rows]).sum(axis=1) ** 2))
    out = np.empty((2, 2, r.N))
    for quantity, k in np.ndindex(2, r.N):
        variances = np.array(stated)[:, quantity, k], np.array(seen)
        wanted = np.array(shown)[:, quantity, k]
        out[quantity, :, k] = nnls(np.column_stack(variances) / wanted[:, None], wanted / wanted)[0]
    return out


def honesty(physical: Physical, test: Recording) -> dict[str, dict[str, float]]:
    """NEES per number, and share within the stated 90 %, of angles and of loads."""
    signals = Signals.of(test)
    found, rows = physical.estimate(signals), slice(round(_SETTLED / signals.dt), None)
    out = {}
    for name, error, deviation in (
        ("angle", found.angle - test.columns("truth_exact", JOINTS), found.angle_deviation),
        ("load", found.load - signals.load, found.load_deviation),
    ):
        scaled = (error / deviation)[rows]
        covered = float(np.mean(np.abs(scaled) < _NINETY))
        out[name] = {"nees": float(np.mean(scaled**2)), "covered": covered}
    return out
