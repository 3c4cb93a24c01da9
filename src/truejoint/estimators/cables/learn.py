"""An unscented filter of a wrist's cables, identified from recordings, free and under loads.

There is one with plays that learn what it leaves, too.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final, Self

import numpy as np
from scipy.optimize import least_squares, nnls
from sklearn.base import clone

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.base import Arrays, JointRegressor, Progress
from truejoint.estimators.cables import loops as r
from truejoint.estimators.cables import run as cable_filter
from truejoint.estimators.cables.run import DECAY, SOUGHT
from truejoint.estimators.family import EstimatorData, Family
from truejoint.estimators.filtered import Estimate, histories, joined, run_filter
from truejoint.estimators.jaw.learn import MIN_ROWS, usual_dt
from truejoint.estimators.plays.learn import Plays
from truejoint.estimators.rules import Params, Rule, optional
from truejoint.recordings import Recording
from truejoint.robots.cable_mechanism import CableMechanism

_ANGLE_NOISE: Final = 1e-3  # [rad] and
_EFFORT_NOISE: Final = 2e-3  # [Nm] that count as much in the fit
_THINNED: Final = 8  # rows of which the fit counts one
_LONGEST: Final = 60.0  # [s] of each history that it simulates
_SETTLED: Final = 2.0  # [s] after which friction has forgotten how it began
_FLOOR: Final = 0.1  # of the filter's own variance that is always stated, in what a run asks for
_DRIFT: Final = (0.1, 0.05, 0.1)  # of friction of loops, motors, pins, in its size per root second
NO_LOAD: Final = 1e-4  # [Nm] below which there is none, or one that does not change
_OTHER_MOTION: Final = 2.0
"""By how much larger squared errors under loads are in another class of motion than in that which
was fitted to: of nine virtual instruments that no figure in the documentation is of."""
_ROUNDS: Final = 25  # of the search, at most
WRIST_PLAYS: Final = Plays(
    plays=(0.002, 0.005, 0.01, 0.02, 0.04, 0.1, 0.25), time_constants=(0.02, 0.1)
)
"""Plays of a wrist's signals.

Half-widths in half ranges: 0.1 deg and up of 55 deg of pitch, a few mNm and up of an effort.
Low-passes tell speed, for the motors' viscous friction, and take noise off the efforts.
"""
_FILTERED: Final = 0.8  # share of the fit's time that the filter takes


@dataclass(frozen=True, eq=False)
class Run:
    """One history: motors and efforts (n, 6), true joints and loads (n, 3), NaN where unknown."""

    X: Array
    truth: Array
    load: Array
    dt: Array  # (n,)

    @property
    def step(self) -> float:
        """Time between two rows [s]."""
        return usual_dt(self.dt)

    @property
    def settled(self) -> int:
        """First row that counts."""
        return round(_SETTLED / self.step)

    @property
    def with_truth(self) -> Integers:
        """Rows that count whose joints are known."""
        rows = np.flatnonzero(np.isfinite(self.truth).all(axis=1))
        return rows[rows >= self.settled]


def constants(mechanism: CableMechanism, sought: Mapping[str, float]) -> Array:
    """Parameters of `cable_loops` for an instrument and what was found of it."""
    radius = mechanism.radii
    first = [next(c for c in mechanism.cables if c.motor == m) for m in mechanism.motors]
    moments = np.array([mechanism.row(cable.moments) for cable in first])
    inverse = np.linalg.inv(moments)
    opening = np.zeros(r.N) if mechanism.contact is None else mechanism.row(
        mechanism.contact.opening)  # fmt: skip
    arms = [mechanism.row(arm) for arm in mechanism.arms.values()]
    parts = np.array([cable.segments for cable in first]).T
    parts[1] *= sought["shaft_compliance"]
    parts /= parts.sum(axis=0)
    turned, wrapped = np.zeros_like(moments), np.zeros(r.N)
    for m, cable in enumerate(first):
        for node in (node for node in cable.nodes if node.joint):
            j = mechanism.joint_names.index(node.joint)
            turned[m, j] = np.sign(moments[m, j])
            wrapped[m] += node.wrap
    crossing = (np.abs(moments) > 0.0).T.astype(np.float64)
    stiffness = np.array([sought[f"{name}_stiffness"] for name in ("pitch", "jaw1", "jaw2")])
    level = [sought[f"{name}_friction"] for name in ("pitch", "jaw1", "jaw2")]
    mu, tension = sought["wrist_friction"], sought["tension"]
    parts_of_parameters = (
        inverse * radius,
        inverse,
        np.column_stack([opening, *(arm / np.abs(arm).sum() for arm in arms)]),
        radius,
        0.5 * parts / stiffness,
        level,
        wrapped * mu * tension,
        [sought["pitch_pin"], *[sought["jaw_pin"]] * 2],
        [*[1.0] * 3, *[0.0] * 9],  # efforts are torques, and
        crossing / crossing.sum(axis=1, keepdims=True),
        mu * turned,
        np.zeros(r.N),  # loads do not change, until more is known
        np.square(_DRIFT),
        [sought[name] for name in ("build_up", "pin_way", "motor_way", "tension")],
        [1.0 / DECAY],
    )
    return np.concatenate([np.ravel(part) for part in parts_of_parameters])


def _misfit(runs: Sequence[Run], p: Array) -> tuple[Array, Integers, Array, Array]:
    """Find what a model leaves of angles and efforts (k, 6), in thinned rows with truth.

    With the number of each row's history (k,), and what is linear in it: what geometry adds
    (10, 3), and the effort of each motor (3, 4) per torque, share of friction, speed, and constant.
    """
    parts = []
    rigid = p[r.RIGID : r.RIGID + r.N**2].reshape(r.N, r.N)
    for n, history in enumerate(runs):
        inputs = np.empty((len(history.X), r.INPUTS))
        cable_filter.input_rows(history.X, history.dt, inputs)
        (joint, torque), x = np.empty((2, *history.load.shape)), np.empty((len(inputs), r.STATES))
        r.simulate(inputs, history.load, p, x, joint, torque)
        share, speed = x[:, r.MOTOR : r.PIN], inputs[:, r.SPEED :]
        columns = np.stack([torque, share, speed, np.ones_like(torque)], axis=2)
        rows = history.with_truth[::_THINNED]
        raw = inputs[rows, : r.N] @ rigid.T
        terms = np.column_stack([np.ones(len(raw)), raw, np.sin(raw), np.cos(raw)])
        residuals, efforts = (history.truth - joint)[rows], history.X[rows, r.N :]
        parts.append((residuals, efforts, terms, columns[rows], np.full(len(rows), n)))
    angle, effort, terms, columns, run = (np.concatenate(part) for part in zip(*parts, strict=True))
    added = np.linalg.lstsq(terms, angle, rcond=None)[0]
    by_motor = np.array(
        [np.linalg.lstsq(columns[:, m], effort[:, m], rcond=None)[0] for m in range(r.N)]
    )
    off_effort = effort - np.einsum("nmk,mk->nm", columns, by_motor)
    misfits = np.hstack([angle - terms @ added, off_effort])
    return misfits, run.astype(np.int64), added, by_motor


def jackknife_deviations(
    jacobian: Array, misfits: Array, labels: Sequence[Integers], prior: Array
) -> Array:
    """Deviations (k,) of least squares by what leaving out rows that are alike changes.

    Of a `jacobian` (n, k) and `misfits` (n,). Rows of one label (n,), of each of several
    `labels`, are left out in turn, by one step of Gauss and Newton; changes by different labels
    add up as if they were independent. A model that is not quite true errs alike all along, which
    no spread of single misfits shows, but signals then tell of the same quantity differently.
    `prior` (k,) is what is known of a quantity, one over its variance, where nothing else tells.
    """
    whole, variance = jacobian.T @ jacobian + np.diag(prior), np.zeros(jacobian.shape[1])
    for label in labels:
        kinds = np.unique(label)
        for kind in kinds:
            part = jacobian[label == kind]
            change = np.linalg.solve(whole - part.T @ part, part.T @ misfits[label == kind])
            variance += (1.0 - 1.0 / len(kinds)) * change**2
    return np.asarray(np.sqrt(variance))


def identify(runs: Sequence[Run], mechanism: CableMechanism, progress: Progress) -> Arrays:
    """Find stiffness, friction, radii and sensors' gains by least squares on angles and efforts."""
    short = [Run(*(values[: round(_LONGEST / history.step)] for values in vars(history).values()))
             for history in runs]  # fmt: skip
    names, table = tuple(SOUGHT), np.log([values for _, *values in SOUGHT.values()]).T
    scale = np.repeat([_ANGLE_NOISE, _EFFORT_NOISE], r.N)
    calls = 0

    def parameters(logarithms: Array) -> Array:
        return constants(mechanism, dict(zip(names, np.exp(logarithms), strict=True)))

    def misfit(logarithms: Array) -> Array:
        nonlocal calls
        calls += 1
        progress(min(0.9 * calls / (_ROUNDS * (len(names) + 1)), 0.9))
        return np.ravel(_misfit(short, parameters(logarithms))[0] / scale)

    start = min(table[2:], key=lambda x: float(np.sum(misfit(x) ** 2)))
    search = least_squares(
        misfit, start, bounds=(table[0], table[1]), diff_step=[1e-3], max_nfev=_ROUNDS, x_scale=0.3
    )
    p = parameters(search.x)
    misfits, run, added, by_motor = _misfit(short, p)
    signal = np.tile(np.arange(2 * r.N), len(misfits))
    recording = np.repeat(run, 2 * r.N)
    # Where nothing tells, a quantity may be anything that is searched.
    deviation = jackknife_deviations(
        np.asarray(search.jac), search.fun, (signal, recording), 12.0 / (table[1] - table[0]) ** 2
    )
    p[r.EFFORT : r.EFFORT + 4 * r.N] = by_motor.T.ravel()
    p[r.LOAD_RATE : r.LOAD_RATE + r.N] = 2.0 * load_variances(runs) / DECAY
    return {
        "parameters": p,
        "added": np.asarray(added, dtype=np.float64),
        "effort_misfit": np.maximum(misfits[:, r.N :].std(axis=0), 1e-6),
        "structure": np.repeat([1.0, 0.0, 1.0, 0.0], r.N).reshape(4, r.N),
        "identified": np.column_stack([np.exp(search.x), np.exp(search.x) * deviation]),
        "dt": np.array([float(np.mean([history.step for history in runs]))]),
    }


def load_variances(runs: Sequence[Run]) -> Array:
    """Variances (3,) [Nm2] of the loads to expect, by those in calibration, one of them loaded.

    One that always hung there counts by its size: another day it is not there.
    """
    loaded = [history.load for history in runs if _is_loaded(history.load)]
    varied = np.mean([np.var(load, axis=0) for load in loaded], axis=0)
    size = np.mean([np.mean(np.square(load), axis=0) for load in loaded], axis=0)
    spread: Array = np.asarray(np.where(varied > NO_LOAD**2, varied, size))
    # One that calibration had not may be as large as the largest that it had.
    return np.asarray(np.where(spread > NO_LOAD**2, spread, spread.max()))


def _is_loaded(load: Array) -> bool:
    return bool((np.abs(load) > NO_LOAD).any())


def structure(runs: Sequence[tuple[slice, Run]], states: Estimate) -> Array:
    """By what variances of angles and of loads are multiplied, what is added to them (4, 3).

    The latter in proportion to the loads that are seen: a small load makes pins slip already, and
    the mean square error of a large one is hardly larger. The errors in each of the runs, with its
    rows in `states`, are then as large as is stated, free and, with a margin for other motions,
    loaded; the deviations in `states` are those of the filter alone.
    """
    shown, stated, loads = [], [], []
    estimates = np.hstack([states.angle, states.load])
    deviations = np.hstack([states.angle_deviation, states.load_deviation])
    for rows, run in runs:
        with_truth = run.with_truth
        third = np.diff(run.truth[with_truth], n=3, axis=0)
        white = np.append(np.var(third, axis=0) / 20.0, np.zeros(r.N))  # of the reference
        errors = estimates[rows] - np.hstack([run.truth, run.load])
        squares = np.mean(np.square(errors[with_truth]), axis=0)
        # Of an error that the reference's noise hides, some is believed all the same.
        squares = np.maximum(squares - white, 0.1 * squares)
        shown.append(squares * (_OTHER_MOTION if _is_loaded(run.load) else 1.0))
        stated.append(np.mean(np.square(deviations[rows][with_truth]), axis=0))
        loads.append(np.mean(np.abs(states.load[rows][with_truth]).sum(axis=1)))
    out = np.empty((2, 2 * r.N))
    pairs = zip(np.transpose(shown), np.transpose(stated), strict=True)
    for k, (wanted, variance) in enumerate(pairs):
        variances = np.column_stack([variance, loads])
        factor, by_load = nnls(variances / wanted[:, None], np.ones_like(wanted))[0]
        out[:, k] = max(factor, _FLOOR * np.min(wanted / variance)), by_load
    return out.reshape(2, 2, r.N).swapaxes(0, 1).reshape(4, r.N)


@dataclass(eq=False, repr=False)
class CableFilter(JointRegressor):
    """Unscented filter of three joints that three motors' cables turn, and of what loads them.

    Its state is friction along the cables, of motors and of pins, and the loads: grip, and torques
    of two arms at the tip; its measurements are the motors' efforts. Stiffness, friction,
    pretension, radii and gains are identified from recordings with truth and known loads, at least
    one of them loaded.

    Parameters
    ----------
    channels : tuple of str
        Names of the motors, in the mechanism's order.
    mechanism : CableMechanism, optional
        Mechanism of the cables; by default that of the recorded robot.

    Examples
    --------
    >>> CableFilter().name
    'ukf_cables'
    """

    family: ClassVar[Family] = cable_filter.FAMILY
    least_rows: ClassVar[int] = MIN_ROWS
    training: ClassVar[Mapping[str, Rule]] = {
        "mechanism": optional(
            Rule(lambda value: isinstance(value, CableMechanism), "a CableMechanism")
        )
    }
    channels: tuple[str, ...] = ("pitch", "jaw1", "jaw2")
    mechanism: CableMechanism | None = None

    @property
    def identified(self) -> dict[str, tuple[float, float, str]]:
        """Identified values of the instrument, by name: value, standard deviation, unit.

        A deviation is by how much the value changes without each of the six signals (angles and
        efforts), and without each recording. Dead bands of the loads follow from the pins'
        friction: a load within its dead band may stay unseen.
        """
        rows = zip(SOUGHT.items(), self.arrays_["identified"].tolist(), strict=True)
        quantities = {name: (*pair, unit) for (name, (unit, *_)), pair in rows}
        pins = [quantities[name][:2] for name in ("pitch_pin", "jaw_pin", "jaw_pin")]
        p = self.arrays_["parameters"]
        on_joint = np.abs(p[r.ON_JOINT : r.ON_JOINT + r.N**2].reshape(r.N, r.N))
        for name, arms in zip(cable_filter.LOADS, on_joint.T, strict=True):
            # It shows as soon as one of the joints that it turns slides.
            bands = [(level / arm, off / arm) for (level, off), arm in zip(pins, arms, strict=True)
                     if arm > 0.0]  # fmt: skip
            quantities[f"{name}_dead_band"] = (*min(bands), "Nm")
        return quantities

    def for_recordings(self, recordings: Sequence[Recording]) -> Self:
        """Unfitted copy for the cables that were recorded; CalibrationError for other ones."""
        robot = recordings[0].robot
        mechanism = self.mechanism or robot.mechanism
        if mechanism is None:
            raise CalibrationError(
                f"{robot.title} states no cables; {self.name} takes a robot with [mechanism]"
            )
        _check_mechanism(self.name, mechanism)
        for recording in recordings:
            if recording.provenance.load > 0.0 and "truth_load/grip" not in recording.units:
                raise CalibrationError(
                    f"{recording.provenance.source or 'recording'}: something hangs on the tip, "
                    f"and no truth_load/... says what torque; {self.name} needs to know its loads"
                )
        return self.with_params(mechanism=mechanism, channels=robot.channels)

    def truth_beside(self) -> tuple[str, ...]:
        """Columns of the loads that `fit` takes as `loads`; where there are none, nothing loads."""
        if self.mechanism is None:
            return ()
        return tuple(f"truth_load/{name}" for name in ("grip", *self.mechanism.arms))

    def states(self, X: Array, dt: Array, arrays: Arrays | None = None) -> Estimate:
        """Angles and loads in every row of `X` (n, 6), `dt` (n,) [s] after that before."""
        learnt = self.arrays_ if arrays is None else arrays
        data = EstimatorData(self.family.name, self.model_params(), learnt)
        run = run_filter(data, X, dt, n_outputs=r.N)
        return Estimate(run.outputs, run.deviations, run.beside[:, 0], run.beside[:, 1], run.x)

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = self._identified(X, y, dt, progress)
        arrays["structure"] = structure(self._runs(X, y, dt), self.states(X, dt, arrays))
        progress(1.0)
        return arrays

    def _identified(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        """Arrays that were identified, with the filter's own deviations."""
        if self.mechanism is None:
            raise CalibrationError(f"{self.name} knows no cables; give it a mechanism")
        self._known(y)
        unknown = int((~np.isfinite(self._loads)).any(axis=1).sum())
        if unknown:
            raise CalibrationError(
                f"{self.name}: {unknown} rows whose load is not known (truth_load/... is NaN); "
                "leave out the recordings that have them"
            )
        runs = [history for _, history in self._runs(X, y, dt)]
        if not runs:
            raise CalibrationError(
                f"{self.name}: no recording has more than {_SETTLED:g} s of truth after its first "
                f"{_SETTLED:g} s; record a minute"
            )
        if not any(_is_loaded(history.load) for history in runs):
            raise CalibrationError(
                f"{self.name}: no recording with truth has a load, so that grip and tip torque "
                "cannot be told from friction; add a minute under known loads (truth_load/...)"
            )
        return identify(runs, self.mechanism, progress)

    def _runs(self, X: Array, y: Array, dt: Array) -> list[tuple[slice, Run]]:
        """Histories that have truth, and the rows of each."""
        every = [(rows, Run(X[rows], y[rows], self._loads[rows], dt[rows]))
                 for rows in histories(dt)]  # fmt: skip
        return [(rows, run) for rows, run in every if len(run.with_truth) > run.settled]


def _check_mechanism(name: str, mechanism: CableMechanism) -> None:
    """Raise CalibrationError for cables that are not three motors' loops of two alike."""
    by_motor = [[c for c in mechanism.cables if c.motor == m] for m in mechanism.motors]
    loops = [
        cables for cables in by_motor if len(cables) == 2 and cables[0].sign == -cables[1].sign
    ]
    shafts = all(len(cable.segments) == 3 for cable in mechanism.cables)
    if not (len(by_motor) == len(loops) == r.N and shafts):
        raise CalibrationError(
            f"{name} takes three motors with two cables each, of three segments; it has no model "
            "of other cables: choose an estimator that learns from features"
        )
    if mechanism.contact is None or len(mechanism.arms) != r.N - 1:
        raise CalibrationError(
            f"{name} tells a grip and two torques at the tip; state [mechanism.contact] and "
            "two arms"
        )


@dataclass(eq=False, repr=False)
class CableHybrid(CableFilter):
    """`CableFilter`, and a ridge regression on plays of what it says that learns what it leaves.

    Plays see the joints and loads that the filter estimates, friction of the pins, motors and
    efforts. They tell the joints, which the filter's model of the cables leaves off by some
    hundredths of a degree, and the loads. Half-widths are the filter's own, times what makes them
    as large as errors on blocks of the calibration that the plays did not see. It needs the same as
    the filter.

    Examples
    --------
    >>> CableHybrid().name
    'hybrid_cables'
    """

    family: ClassVar[Family] = cable_filter.HYBRID_ROWS

    fitted_params: ClassVar[Params] = {"model": (Plays.family.name, WRIST_PLAYS.model_params(), ())}

    def _learn(self, X: Array, y: Array, dt: Array, progress: Progress) -> Arrays:
        arrays = self._identified(X, y, dt, lambda done: progress(_FILTERED * done))
        data = EstimatorData(self.family.name, self.model_params(), arrays)
        run = run_filter(data, X, dt, n_outputs=r.N)
        # Of a load that calibration does not have, the filter's word is all there is.
        has_load = np.ptp(self._loads, axis=0) > NO_LOAD
        by_filter = run.sighted[:, 4 * r.N : 5 * r.N]
        wanted = np.hstack([y - run.outputs, np.where(has_load, self._loads, by_filter)])
        plays = clone(WRIST_PLAYS).fit(run.sighted, wanted, dt=dt)
        self.fitted_params_ = {"model": (Plays.family.name, plays.model_params(), ())}
        arrays = joined(arrays, plays.arrays_)
        estimate = self.states(X, dt, arrays)
        errors = np.hstack([y - estimate.angle, self._loads - estimate.load])
        # Squares of errors are larger on blocks that plays were not fitted to.
        has_truth = np.isfinite(wanted).all(axis=1)
        blocks = np.square(plays.model_.errors_ * wanted[has_truth].std(axis=0))
        grown = np.maximum(blocks / np.mean(np.square(errors[has_truth]), axis=0), 1.0)
        unseen = np.repeat(grown.reshape(2, r.N), 2, axis=0)
        arrays["structure"] = structure(self._runs(X, y, dt), estimate) * unseen
        progress(1.0)
        return arrays
