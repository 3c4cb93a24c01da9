"""Unscented filter of joints whose motor drives their link by an elastic cable."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from scipy.optimize import least_squares

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, Flags, JointRegressor, Progress, constant_columns
from truejoint.estimators.family import Family, evaluate
from truejoint.estimators.jaw import base as jaw
from truejoint.estimators.motor_side import two_mass_rows as two_mass
from truejoint.estimators.motor_side.learn import mean_dt, thinned
from truejoint.estimators.motor_side.two_mass_rows import PARAMETERS, TwoMassJoint
from truejoint.recordings import Recording

_ROWS: Final = 3000  # that parameters are searched on
_STRETCH: Final = 300  # rows of them on end
_UNJUDGED: Final = 40  # first rows of a stretch, until the filter has settled
_DOUBT: Final = math.log(10.0)  # standard deviation of a parameter's logarithm before the search
_FARTHEST: Final = math.log(1e3)  # that it may go
_NATURAL: Final = 2.0 * math.pi * 10.0  # [rad/s] of motor and link, where the search starts
_RUNS: Final = 10  # of all parameters' slopes, at most
_SLOW: Final = 0.05  # of the root mean square of the velocity


@dataclass(eq=False, repr=False)
class TwoMassFilter(JointRegressor):
    """Unscented filter of motor and link of each joint, and the elastic cable between.

    As Haghighipanah, Li, Miyasaka and Hannaford (IROS 2015) estimate the positioning joints of
    RAVEN: states are position and velocity of motor and link; the effort drives the motor, whose
    position is measured; Coulomb and viscous friction brake both. What a joint carries, gravity
    included, is a further state that wanders. Inertias, stiffness, damping, frictions and noises
    are searched for on the recordings, so that the link's positions explain the truth; a linear
    transmission, couplings and zeros included, makes joint positions of them.

    Parameters
    ----------
    joints : sequence of str
        Joints with a motor each, whose measured positions and efforts are read; `calibrate` takes
        the positioning joints that have truth.

    Examples
    --------
    >>> TwoMassFilter().name
    'ukf_two_mass'
    """

    family: ClassVar[Family] = two_mass.FAMILY
    least_rows: ClassVar[int] = jaw.MIN_ROWS
    joints: tuple[str, ...] = ("jaw",)

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy for the positioning joints that have truth in each recording.

        Raises CalibrationError where the position or the effort of one is not recorded.
        """
        with_truth = [set(one.joints_of("truth")) for one in recordings]
        robot = recordings[0].robot
        joints = tuple(j for j in robot.positioning if all(j in known for known in with_truth))
        for recording in recordings:
            jaw.check_sensors(self.name, two_mass.inputs({"joints": joints}), recording)
        return self.with_params(joints=joints or self.joints)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        known, n = self._known(y), len(self.joints)
        still = np.flatnonzero(constant_columns(X[known]))
        if len(still):
            name = two_mass.inputs(self.model_params())[still[0]]
            raise CalibrationError(
                f"{self.name}: {name} never changes; move the joint over its range, and check "
                "that the sensor is connected"
            )
        places, efforts = X[:, :n], X[:, n:]
        low, high = places[known].min(axis=0), places[known].max(axis=0)
        middle, inverse = 0.5 * (low + high), 2.0 / (high - low)
        places = (places - middle) * inverse
        share = _direction(places, efforts, dt) / efforts[known].std(axis=0)
        efforts = efforts * share
        rows, steps = _stretches(dt, known)
        search = _Search(places[rows], efforts[rows], steps, y[rows], known[rows])
        if len(search.judged) < jaw.MIN_ROWS:
            raise CalibrationError(
                f"{self.name}: {len(search.judged)} rows with truth after the first {_UNJUDGED} of "
                f"a history; it needs {jaw.MIN_ROWS}: record longer motions without a gap"
            )
        joints = []
        for i in range(n):
            joints.append(search.identify(i))
            progress(0.9 * (i + 1) / n)
        moves = zip(joints, places.T, efforts.T, strict=True)
        links = np.column_stack([link_positions(*one, dt) for one in moves])
        known &= np.isfinite(links).all(axis=1)  # but where a filter started anew
        columns = np.column_stack([np.ones(len(links)), links])[known]
        weights = np.linalg.lstsq(columns, y[known], rcond=None)[0]
        progress(1.0)
        return {
            "middle": middle,
            "inverse_half_range": inverse,
            "effort_share": share,
            "dynamics": np.array([joint.row() for joint in joints]),
            "coef": np.ascontiguousarray(weights[1:].T),
            "intercept": weights[0],
        }


def _direction(places: Array, efforts: Array, dt: Array) -> Array:
    """Signs (n,) of efforts that drive positions up: work done against friction is positive."""
    moved = np.where(dt[:, None] > 0.0, np.diff(places, axis=0, prepend=places[:1]), 0.0)
    work = ((efforts - efforts.mean(axis=0)) * moved).sum(axis=0)
    return np.where(work < 0.0, -1.0, 1.0)


def _stretches(dt: Array, known: Flags) -> tuple[Integers, Array]:
    """Rows (m,) to search on, and the time since those before (m,) [s], 0 where one starts anew.

    They are stretches on end, evenly spread, of the rows that a filter's fit looks at.
    """
    rows = thinned(dt, known)
    parts = np.array_split(rows, max(1, round(len(rows) / _STRETCH)))
    parts = parts[:: max(1, round(len(rows) / _ROWS))]
    rows = np.concatenate(parts)
    steps = np.diff(np.cumsum(dt)[rows], prepend=0.0)
    steps[np.diff(np.cumsum(dt == 0.0)[rows], prepend=0) > 0] = 0.0
    steps[np.cumsum([0, *map(len, parts[:-1])])] = 0.0
    return rows, steps


def link_positions(joint: TwoMassJoint, motor: Array, effort: Array, dt: Array) -> Array:
    """Link's position (n,) in each row, of the motor's (n,) and its effort (n,)."""
    X = np.column_stack([motor, effort])
    return evaluate(two_mass.FAMILY, joint.memory(), X, dt, 1)[:, 0]


class _Search:
    """Rows to search the parameters of one joint after the other on, by variable projection.

    What a link's position leaves of the targets is that of the best linear model of it and of the
    other joints' measured positions.
    """

    def __init__(self, places: Array, efforts: Array, dt: Array, y: Array, known: Flags) -> None:
        self.places, self.efforts, self.dt = places, efforts, dt
        rows = np.arange(len(dt))
        settled = rows - rows[dt == 0.0][np.cumsum(dt == 0.0) - 1] >= _UNJUDGED
        self.judged = np.flatnonzero(known & settled)
        self.y = y[self.judged]

    def left(self, i: int, joint: TwoMassJoint) -> Array:
        """Give what a joint's link leaves of the targets (m, n_outputs)."""
        link = link_positions(joint, self.places[:, i], self.efforts[:, i], self.dt)
        columns = np.column_stack([self.places, np.ones(len(link))])[self.judged]
        columns[:, i] = link[self.judged]
        told = np.isfinite(columns).all(axis=1)
        left = 10.0 * (self.y - self.y.mean(axis=0))  # where it broke down: worse than knowing none
        if told.sum() > columns.shape[1]:
            weights = np.linalg.lstsq(columns[told], self.y[told], rcond=None)[0]
            left[told] = self.y[told] - columns[told] @ weights
        return np.asarray(left)

    def identify(self, i: int) -> TwoMassJoint:
        """Find the joint whose link's position explains most."""
        start = self._start(i)
        first = start.parameters[:-1]
        scale = np.maximum(self.left(i, start).std(axis=0), 1e-12)

        def joint(logarithms: Array) -> TwoMassJoint:
            found = first * np.exp(logarithms)
            return TwoMassJoint(np.append(found, start.parameters[-1]), *start.row()[-2:])

        def residuals(logarithms: Array) -> Array:
            left = self.left(i, joint(logarithms)) / scale
            return np.concatenate([left.ravel(), logarithms / _DOUBT])

        found = least_squares(
            residuals, np.zeros(len(first)), bounds=(-_FARTHEST, _FARTHEST),
            diff_step=[0.05], max_nfev=_RUNS, x_scale=_DOUBT,
        )  # fmt: skip
        return joint(found.x)

    def _start(self, i: int) -> TwoMassJoint:
        """Joint that the search starts at: what a linear model of position and effort says."""
        place, effort = self.places[:, i], self.efforts[:, i]
        moving = self.dt > 0.0
        velocity = np.zeros(len(place))
        velocity[moving] = np.diff(place, prepend=place[:1])[moving] / self.dt[moving]
        speed = max(float(np.sqrt(np.mean(velocity**2))), 1e-6)
        columns = np.column_stack([self.places, effort, np.ones(len(place))])[self.judged]
        weights = np.linalg.lstsq(columns, self.y, rcond=None)[0]
        most = int(np.abs(weights[i]).argmax())  # the output that this joint moves
        compliance = float(np.clip(-weights[-2, most] / weights[i, most], 1e-3, 0.3))
        friction = max(0.5 * float(np.mean(effort * np.sign(velocity))), 0.02)
        inertia = 1.0 / (compliance * _NATURAL**2)
        known = {
            "motor_inertia": inertia,
            "link_inertia": inertia,
            "stiffness": 1.0 / compliance,
            "damping": 0.2 / (compliance * _NATURAL),
            **dict.fromkeys(("motor_coulomb", "link_coulomb"), friction),
            **dict.fromkeys(("motor_viscous", "link_viscous"), 0.1 * friction / speed),
            "effort_density": 0.1**2 * mean_dt(self.dt),
            "load_density": 1.0,
            "slow": _SLOW * speed,
        }
        return TwoMassJoint(
            np.array([known[name] for name in PARAMETERS]), float(effort.mean()), speed
        )
