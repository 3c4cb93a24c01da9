"""How exactly pitch and both jaws are known, free and under loads, by sensors and method."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from pandas import DataFrame
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.errors import StudyError
from truejoint.estimators import get_estimator
from truejoint.estimators.cables.learn import WRIST_PLAYS
from truejoint.estimators.cables.loops import LOAD as LAST
from truejoint.estimators.cables.loops import PIN
from truejoint.estimators.filtered import Estimate
from truejoint.evaluation.scoring import rmse
from truejoint.features.feature_set import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.parameters import WristParameters, plant_constants
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import ecdf_figure, frame_table, median_texts, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.wrist import motions
from truejoint.tables import Table

SETTLED: Final = 2.0
"""Time after which a history that began with the recording counts [s]."""
LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""
TESTS: Final = ("free", "loaded")
ANGLE, LOAD, HONESTY, IDENTIFIED, GRIP = "angle", "load", "honesty", "identified", "grip"
"""What a row is of."""
_NINETY: Final = NormalDist().inv_cdf(0.95)  # deviations that hold 90 % of a normal's draws


Physical = Mapping[str, Mapping[bool, Estimate]]
"""By the recordings' sessions: what the physical filter says, and by False its model alone.

The model is unloaded and has neither loads nor deviations.
"""


@dataclass(frozen=True)
class Method:
    """One row of the table: an estimator, what it sees, and whether it is fitted under load too.

    `with_filter` it sees the physical filter's states beside, or those of its model alone. Without
    an estimator these, or the measured joints, are the estimate.
    """

    title: str
    estimator: Any
    quantities: tuple[str, ...] = ()
    with_load: bool = False
    with_filter: bool = False


_LINEAR: Final = get_estimator("linear")
_EFFORT: Final = ("motor", "effort")
METHODS: Final[Mapping[str, Method]] = {
    "coupling": Method("coupling inverse", None),
    "linear_motor": Method("linear, motors", _LINEAR, ("motor",)),
    "play_motor": Method("plays, motors", WRIST_PLAYS, ("measured", "motor")),
    "model": Method("physical model, motors", None, with_filter=True),
    "play_model": Method(
        "plays, motors, model's states", WRIST_PLAYS, ("measured", "motor"), with_filter=True
    ),
    "linear_effort": Method("linear, motors and effort", _LINEAR, _EFFORT, True),
    "play_effort": Method("plays, motors and effort", WRIST_PLAYS, ("measured", *_EFFORT), True),
    "filter": Method("physical filter, motors and effort", None, (), True, True),
    "play_filter": Method(
        "plays, motors, effort, filter's states", WRIST_PLAYS, ("measured", *_EFFORT), True, True
    ),
}


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    settings.check_names("method", "methods", METHODS)
    if not settings["test_s"] > SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {SETTLED:g}")
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    names, family = ("methods", "instrument", "free_s", "loaded_s", "test_s"), settings["family"]
    common, instruments = {name: settings[name] for name in names}, []
    for n, specimen in enumerate(population(settings["count"], settings.seed, family)):
        arguments = {"specimen": specimen.to_dict(), "number": n, **common}
        labels = {"specimen": n, "family": family_of(n, family)}
        instruments.append(Part(f"specimen-{n:05d}", judge, arguments, labels))
    return instruments


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    methods: Sequence[str],
    instrument: str,
    free_s: float,
    loaded_s: float,
    test_s: float,
    number: int,
) -> Rows:
    """Calibrate methods on multi-sines, free and loaded; judge them on steps, free and loaded."""
    twin = WristTwin(WristParameters.from_dict(specimen), arm=instrument, seed=number)
    seed = 4 * number
    twin.home()
    training = [
        motions.record(twin, motions.paused_sines, seconds, seed + n, load=bool(n))
        for n, seconds in enumerate((free_s, loaded_s))
    ]
    tests = {
        name: motions.record(twin, motions.steps, test_s, seed + 2 + n, load=bool(n))
        for n, name in enumerate(TESTS)
    }
    rows, runs = Rows(), dict[str, dict[bool, Estimate]]()
    if any(METHODS[key].with_filter for key in methods):
        physical = calibrate(training, "ukf_cables", joints=JOINTS)
        for run in (*training, *tests.values()):
            gap, none = physical.gap_limit, np.empty((len(run), 0))
            X, dt = physical.feature_set.compute(run, gap), time_steps(run.t, gap)
            angle, states = physical.model.unloaded(X, dt)
            alone = Estimate(angle, none, none, none, states)
            runs[run.provenance.session] = {True: physical.model.states(X, dt), False: alone}
        true, keys = quantities(twin), ("value", "deviation", "unit")
        for name, values in physical.model.identified.items():
            quantity = dict(zip(keys, values, strict=True))
            rows.append({"of": IDENTIFIED, "name": name, **quantity, "true": true.get(name)})
        for name, test in tests.items():
            rows += honesty(runs[test.provenance.session][True], test, SETTLED, motion=name)
    for key in methods:
        for name, (angle, load) in estimates(METHODS[key], training, tests, runs).items():
            test = tests[name]
            settled = test.t - test.t[0] > SETTLED
            off = (angle - test.columns("truth_exact", JOINTS))[settled]
            labels = {"method": key, "test": name}
            rows.append(
                {"of": ANGLE, **labels, **dict(zip(JOINTS, rmse(off).tolist(), strict=True))}
            )
            if METHODS[key].with_load:
                truth = test.columns("truth_load", LOADS)[settled]
                sizes = np.column_stack((rmse(load[settled] - truth), rmse(truth))).tolist()
                for n, (missed, size) in zip(LOADS, sizes, strict=True):
                    rows.append({"of": LOAD, **labels, "name": n, "rms": missed, "size": size})
    grip = tests["loaded"].column("truth_load/grip")
    rows.append({"of": GRIP, "rms": float(rmse(grip))})
    return rows


def estimates(
    method: Method,
    recordings: Sequence[Recording],
    tests: Mapping[str, Recording],
    runs: Physical,
) -> dict[str, tuple[Array, Array]]:
    """Joints (n, 3) [rad] and loads (n, 3) [Nm] of a method in each test; no loads without effort.

    It learns them from `recordings` without and under load, if it learns.
    """

    def physical(recording: Recording) -> Estimate:
        return runs[recording.provenance.session][method.with_load]

    estimate: dict[str, tuple[Array, Array]] = {}
    if method.estimator is None:
        for name, test in tests.items():
            measured = test.columns("measured", JOINTS)
            run = physical(test) if method.with_filter else None
            estimate[name] = (run.angle, run.load) if run else (measured, measured[:, :0])
        return estimate
    # Pitch comes first: by it the loops of all cables grow and shrink.
    features = FeatureSet.parse(
        [f"{quantity}/{j}" for quantity in method.quantities for j in JOINTS]
    )
    training = recordings if method.with_load else recordings[:1]
    gap = default_gap_limit(training)

    def inputs(recording: Recording) -> Array:
        group = features.compute(recording, gap)
        if not method.with_filter:
            return group
        run, measured = physical(recording), recording.columns("measured", JOINTS)
        return np.hstack([group, run.angle - measured, run.load, run.states[:, PIN:LAST]])

    def targets(recording: Recording) -> Array:
        measured, truth = (recording.columns(key, JOINTS) for key in ("measured", "truth"))
        loads = recording.columns("truth_load", LOADS if method.with_load else ())
        return np.hstack([truth - measured, loads])

    dt = np.concatenate([time_steps(r.t, gap) for r in training])
    X, y = (np.vstack([make(r) for r in training]) for make in (inputs, targets))
    model = clone(method.estimator).fit(X, y, dt=dt)
    for name, test in tests.items():
        angle, load = np.split(model.predict(inputs(test), time_steps(test.t, gap)), [3], axis=1)
        estimate[name] = angle + test.columns("measured", JOINTS), load
    return estimate


def quantities(twin: WristTwin) -> dict[str, float]:
    """Say what a virtual instrument truly has of what is identified, where it is one number.

    Of a loop, what its own two cables are as they were drawn, not those of its family.
    """
    cables, friction = twin.parameters.cables, twin.parameters.joint_friction
    mechanism = twin.robot.mechanism
    assert mechanism is not None  # noqa: S101  # a twin of a wrist has one
    crossing = np.count_nonzero(mechanism.moments, axis=0)
    pins = {
        joint: friction.constant * pin.friction
        + friction.tension_share * pin.radius * int(count) * cables.pretension
        for (joint, pin), count in zip(mechanism.pins.items(), crossing, strict=True)
    }
    drawn, _ = plant_constants(twin.parameters, mechanism)
    stiffness, held = {}, {}
    for joint, motor in zip(JOINTS, mechanism.motors, strict=True):
        group = [(n, cable) for n, cable in enumerate(mechanism.cables) if cable.motor == motor]
        legs = [1.0 / (1.0 / drawn.stiffness[n, : len(c.segments)]).sum() for n, c in group]
        stiffness[f"{joint}_stiffness"] = float(np.mean(legs))
        wrap = math.fsum(node.wrap for node in group[0][1].nodes if not node.joint)
        hold = math.sinh(cables.guide_friction * wrap)
        held[f"{joint}_friction"] = 2.0 * cables.pretension * hold
    return {
        **stiffness,
        "shaft_compliance": cables.shaft_compliance,
        **held,
        "wrist_friction": cables.wrist_friction,
        "pitch_pin": pins["pitch"],
        "jaw_pin": pins["jaw1"],
        "pin_way": friction.presliding,
        "tension": 2.0 * cables.pretension,
        "motor_way": twin.parameters.motor.presliding,
    }


def honesty(states: Estimate, test: Recording, settled: float, **labels: Any) -> Rows:
    """NEES per number, and share within the stated 90 %, of angles and loads `settled` s on."""
    chosen, rows = test.t - test.t[0] > settled, Rows()
    for name, error, deviation in (
        ("angle", states.angle - test.columns("truth_exact", JOINTS), states.angle_deviation),
        ("load", states.load - test.columns("truth_load", LOADS), states.load_deviation),
    ):
        scaled = (error / deviation)[chosen]
        covered = float(np.mean(np.abs(scaled) < _NINETY))
        nees = float(np.mean(scaled**2))
        rows.append({**labels, "of": HONESTY, "name": name, "nees": nees, "covered": covered})
    return rows


def summarise(results: Results) -> Summary:
    """Tables of medians by family, and the distribution of the errors by method."""
    by_kind = {str(kind): rows for kind, rows in results.rows.groupby("of", sort=False)}
    titles = {key: method.title for key, method in METHODS.items()}
    angles = by_kind[ANGLE].drop(columns="rms")
    angles = angles.assign(title=angles.method.map(titles))
    tables = [_table(angles, results.settings, by_kind[GRIP])]
    if LOAD in by_kind:
        tables.append(_load_table(by_kind[LOAD].assign(title=by_kind[LOAD].method.map(titles))))
    if HONESTY in by_kind:
        tables += [_honest_table(by_kind[HONESTY]), _identified_table(by_kind[IDENTIFIED])]
    errors = angles.melt(["test", "title"], list(JOINTS), "joint", "rms")
    caption = "Share of all specimens' joints with a smaller error, by method."
    title = "Wristed instruments, another class of motion"
    return Summary(tables, {"wrist": ecdf_figure(title, errors, "title", "test", caption)})


def _table(rows: DataFrame, settings: Settings, grips: DataFrame) -> Table:
    rows = rows.assign(name=rows.title + ", " + rows.family)
    by = rows.groupby(["name", "test"], sort=False)[list(JOINTS)]
    medians = (
        by.median().mul(math.degrees(1.0)).map("{:.3f}".format).agg(" ".join, axis=1).unstack()
    )
    worst = by.max().max(axis=1).mul(math.degrees(1.0)).map("{:.2f}".format).unstack()
    table = rows.groupby("name", sort=False).specimen.nunique().map(str).to_frame("n")
    for name, mark in zip(TESTS, ("", " "), strict=True):
        table[f"{name}: pitch jaw1 jaw2"], table["worst" + mark] = medians[name], worst[name]
    notes = (
        "RMS error in degrees against the joints themselves, median of the specimens of seed "
        f"{settings.seed}; worst: of any specimen's any joint. Fitted to {settings['free_s']:g} s "
        f"of multi-sines without load and, with effort, {settings['loaded_s']:g} s under loads; "
        f"tested on {settings['test_s']:g} s of steps each.",
        "Loads: grips half of the time (RMS "
        f"{1e3 * grips.rms.median():.0f} mNm in the median) and pushes at the tip up to 2 N along "
        "two axes. Motors alone do not see them.",
    )
    title = "Pitch and jaws of a wristed instrument"
    return frame_table(title, table, notes, head="method, family")


def _load_table(rows: DataFrame) -> Table:
    rows = rows.assign(row=rows.title + ", " + rows.family)
    keys = ["row", "test", "name"]
    errors = median_texts(rows, keys, "rms", 1, 1e3)
    sizes = rows.groupby(keys, sort=False)["size"].median().mul(1e3).map("{:.1f}".format)
    table = DataFrame(index=unique(rows, "row"))
    for load in LOADS:
        table[load] = errors["loaded", load]
        table["of " + load] = sizes.unstack(["test", "name"])["loaded", load]
    table["grip when free"] = errors["free", "grip"]
    note = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself: pitch and yaw are torques of the force at the tip. What a pin "
        "holds by friction no motor feels: its dead band stands where it was identified."
    )
    return frame_table("Grip and tip torque", table, (note,), head="method, family")


def _honest_table(rows: DataFrame) -> Table:
    keys = ["family", "motion", "name"]
    squares = median_texts(rows, keys, "nees", 2)
    shares = rows.groupby(keys, sort=False).covered.median().unstack(keys[1:]).mul(100)
    shares = shares.map("{:.0f} %".format)
    table = DataFrame(index=unique(rows, "family"))
    for n, key in enumerate(product(TESTS, ("angle", "load"))):
        table[": ".join(key)], table["in 90 %" + " " * n] = squares[key], shares[key]
    note = (
        "Normalised square of the physical filter's errors, 1 where its deviations are honest: "
        "median (worst) of the specimens; share of errors within what it states for 90 %, median."
    )
    return frame_table("What the physical filter states of itself", table, (note,), head="family")


def _identified_table(rows: DataFrame) -> Table:
    rows = rows.assign(
        off=(rows.value / rows.true - 1.0).abs(),
        square=((rows.value - rows.true) / rows.deviation) ** 2,
    )
    by = rows.groupby(["name", "family"], sort=False)
    centre = by[["value", "deviation", "off"]].median()
    text = centre.value.map("{:.3g}".format) + " +- " + centre.deviation.map("{:.1g}".format)
    apart = (100.0 * centre.off).map("{:.0f} %, ".format)
    apart += (by.square.mean() ** 0.5).map("{:.1f} x".format)
    apart = apart.where(centre.off.notna(), "-")
    table = rows.groupby("name", sort=False)[["unit"]].first()
    for family in rows.family.unique():
        table[family], table[f"off, {family}"] = text.xs(family, level=1), apart.xs(family, level=1)
    note = (
        "Medians of what was identified and of its stated deviation; how far it is off what the "
        "specimen was made with, where that is one number, in the median, and the RMS of that in "
        "stated deviations. A loop's stiffness is that of its own two cables."
    )
    return frame_table("What was identified", table, (note,), head="identified")
