"""How exactly pitch and both jaws are known, free and under loads, by sensors and method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
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
from truejoint.estimators.cables.learn import WRIST_PLAYS, CableStates
from truejoint.estimators.cables.loops import LOAD as LAST
from truejoint.estimators.cables.loops import PIN
from truejoint.features.feature_set import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.parameters import WristParameters, plant_constants
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import Cell, ecdf_figure, frame_table, median, of, table_of, unique
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


@dataclass(frozen=True, eq=False)
class Simulated:
    """A recording run through the physical filter, and through its model alone, unloaded."""

    filtered: CableStates
    joints: Array  # (n, 3) [rad]
    states: Array  # (n, 15)


Physical = Mapping[str, Simulated]
"""Runs of the physical filter by the recordings' sessions."""


@dataclass(frozen=True)
class Method:
    """One row of the table: an estimator, what it sees, and whether it is fitted under load too.

    `with_filter` it sees the physical filter's states beside, or those of its model alone.
    """

    title: str
    estimator: Any
    quantities: tuple[str, ...] = ()
    with_load: bool = False
    with_filter: bool = False

    @property
    def features(self) -> list[str]:
        """Features, pitch first, by which the loops of all cables grow and shrink."""
        return [f"{quantity}/{joint}" for quantity in self.quantities for joint in JOINTS]


METHODS: Final[Mapping[str, Method]] = {
    "coupling": Method("coupling inverse", None),
    "linear_motor": Method("linear, motors", "linear", ("motor",)),
    "play_motor": Method("plays, motors", WRIST_PLAYS, ("measured", "motor")),
    "model": Method("physical model, motors", None, ("motor",), with_filter=True),
    "play_model": Method(
        "plays, motors, model's states", WRIST_PLAYS, ("measured", "motor"), with_filter=True
    ),
    "linear_effort": Method(
        "linear, motors and effort", get_estimator("linear"), ("motor", "effort"), True
    ),
    "play_effort": Method(
        "plays, motors and effort", WRIST_PLAYS, ("measured", "motor", "effort"), True
    ),
    "filter": Method(
        "physical filter, motors and effort", None, ("motor", "effort"), True, with_filter=True
    ),
    "play_filter": Method(
        "plays, motors, effort, filter's states",
        WRIST_PLAYS,
        ("measured", "motor", "effort"),
        True,
        True,
    ),
}


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    settings.check_names("method", "methods", METHODS)
    if not settings["test_s"] > SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {SETTLED:g}")
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    return specimens(settings, judge, "methods", "instrument", "free_s", "loaded_s", "test_s")


def specimens(settings: Settings, judge: Callable[..., Any], *names: str) -> list[Part]:
    """One part a virtual instrument: `judge` of it, its family, its number, and options `names`."""
    family, common = settings["family"], {name: settings[name] for name in names}
    return [
        Part(
            f"specimen-{n:05d}",
            judge,
            {"specimen": p.to_dict(), "number": n, **common},
            {"specimen": n, "family": family_of(n, family)},
        )
        for n, p in enumerate(population(settings["count"], settings.seed, family))
    ]


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
    free, under_load = motions.calibrating(twin, free_s, loaded_s, seed)
    tests = {
        name: motions.record(twin, motions.steps, test_s, seed + 2 + n, load=bool(n))
        for n, name in enumerate(TESTS)
    }
    rows: Rows = []
    runs: dict[str, Simulated] = {}
    if any(METHODS[key].with_filter for key in methods):
        physical = calibrate([free, under_load], "ukf_cables", joints=JOINTS)
        for run in (free, under_load, *tests.values()):
            gap = physical.gap_limit
            X, dt = physical.feature_set.compute(run, gap), time_steps(run.t, gap)
            filtered = physical.model.states(X, dt)
            runs[run.provenance.session] = Simulated(filtered, *physical.model.unloaded(X, dt))
        true = quantities(twin)
        rows += [
            {"of": IDENTIFIED, "name": name, "value": value, "deviation": deviation, "unit": unit,
             "true": true.get(name)}
            for name, (value, deviation, unit) in physical.model.identified.items()
        ]  # fmt: skip
        for name, test in tests.items():
            rows += honesty(runs[test.provenance.session].filtered, test, SETTLED, motion=name)
    for key in methods:
        found = estimates(METHODS[key], free, under_load, tests, runs)
        for name, test in tests.items():
            settled = test.t - test.t[0] > SETTLED
            angle, load = found[name]
            off = (angle - test.columns("truth_exact", JOINTS))[settled]
            rows.append({"of": ANGLE, "method": key, "test": name, **by_joint(rms(off))})
            if load is not None:
                truth = test.columns("truth_load", LOADS)[settled]
                missed = zip(LOADS, rms(load[settled] - truth), rms(truth), strict=True)
                rows += [
                    {"of": LOAD, "method": key, "test": name, "name": n, "rms": a, "size": b}
                    for n, a, b in missed
                ]
    grip = tests["loaded"].column("truth_load/grip")
    rows.append({"of": GRIP, "rms": float(np.sqrt(np.mean(grip**2)))})
    return rows


def estimates(
    method: Method,
    free: Recording,
    under_load: Recording,
    tests: Mapping[str, Recording],
    runs: Physical,
) -> Mapping[str, tuple[Array, Array | None]]:
    """Joints (n, 3) [rad], and loads (n, 3) [Nm] where it tells them, of a method in each test."""
    if method.estimator is None and method.with_filter:
        group = {name: runs[test.provenance.session] for name, test in tests.items()}
        if not method.with_load:
            return {name: (one.joints, None) for name, one in group.items()}
        return {name: (one.filtered.angle, one.filtered.load) for name, one in group.items()}
    if method.estimator is None:
        return {name: (test.columns("measured", JOINTS), None) for name, test in tests.items()}
    if not (method.with_load or method.with_filter):
        model = calibrate([free], method.estimator, features=method.features, joints=JOINTS)
        return {name: (model.correct(test), None) for name, test in tests.items()}
    return fitted([free, under_load] if method.with_load else [free], tests, method, runs)


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


def by_joint(values: Sequence[float], suffix: str = "") -> dict[str, float]:
    """Name values (3,) by the joints."""
    return {joint + suffix: value for joint, value in zip(JOINTS, values, strict=True)}


def rms(values: Array) -> list[float]:
    """Root mean square of each column (k,) of (n, k)."""
    return np.sqrt(np.mean(values**2, axis=0)).tolist()  # type: ignore[no-any-return]


def fitted(
    training: Sequence[Recording],
    tests: Mapping[str, Recording],
    method: Method,
    runs: Physical,
) -> dict[str, tuple[Array, Array | None]]:
    """Joints (n, 3) [rad] and loads (n, 3) [Nm] in each test, by a method that learns them."""
    features = FeatureSet.parse(method.features)
    gap = default_gap_limit(training)

    def inputs(recording: Recording) -> Array:
        group, measured = features.compute(recording, gap), recording.columns("measured", JOINTS)
        if not (method.with_filter and runs):
            return group
        one = runs[recording.provenance.session]
        if not method.with_load:
            return np.hstack([group, one.joints - measured, one.states[:, PIN:LAST]])
        states = one.filtered.states[:, PIN:LAST]
        return np.hstack([group, one.filtered.angle - measured, one.filtered.load, states])

    def targets(recording: Recording) -> Array:
        measured, truth = (recording.columns(key, JOINTS) for key in ("measured", "truth"))
        return np.hstack([truth - measured, recording.columns("truth_load", LOADS)])

    dt = np.concatenate([time_steps(r.t, gap) for r in training])
    X, y = (np.vstack([of(r) for r in training]) for of in (inputs, targets))
    outputs = y.shape[1] if method.with_load else len(JOINTS)
    model = clone(method.estimator).fit(X, y[:, :outputs], dt=dt)
    found: dict[str, tuple[Array, Array | None]] = {}
    for name, test in tests.items():
        angle, load = np.split(model.predict(inputs(test), time_steps(test.t, gap)), [3], axis=1)
        found[name] = angle + test.columns("measured", JOINTS), load if method.with_load else None
    return found


def honesty(states: CableStates, test: Recording, settled: float, **labels: Any) -> Rows:
    """NEES per number, and share within the stated 90 %, of angles and loads `settled` s on."""
    chosen, rows = test.t - test.t[0] > settled, Rows()
    for name, error, deviation in (
        ("angle", states.angle - test.columns("truth_exact", JOINTS), states.angle_deviation),
        ("load", states.load - test.columns("truth_load", LOADS), states.load_deviation),
    ):
        scaled = (error / deviation)[chosen]
        covered = float(np.mean(np.abs(scaled) < _NINETY))
        found = {"name": name, "nees": float(np.mean(scaled**2)), "covered": covered}
        rows.append({**labels, "of": HONESTY, **found})
    return rows


def summarise(results: Results) -> Summary:
    """Tables of medians by family, and the distribution of the errors by method."""
    settings = results.settings
    by_kind = {str(kind): rows for kind, rows in results.rows.groupby("of", sort=False)}
    angles = by_kind[ANGLE][["specimen", "family", "test", "method", *JOINTS]]
    tables = [_table(angles, settings, by_kind[GRIP])]
    if LOAD in by_kind:
        tables.append(_load_table(by_kind[LOAD]))
    if HONESTY in by_kind:
        tables += [_honest_table(by_kind[HONESTY]), _identified_table(by_kind[IDENTIFIED])]
    angles = angles.assign(name=angles.method.map({k: m.title for k, m in METHODS.items()}))
    errors = angles.melt(["test", "name"], list(JOINTS), "joint", "rms")
    caption = "Share of all specimens' joints with a smaller error, by method."
    title = "Wristed instruments, another class of motion"
    return Summary(tables, {"wrist": ecdf_figure(title, errors, "name", "test", caption)})


def joint_medians(rows: DataFrame, decimals: int = 3) -> str:
    """Medians of columns of all joints [rad], in degrees."""
    return " ".join(f"{value:.{decimals}f}" for value in np.degrees(rows[list(JOINTS)].median()))


def worst(rows: DataFrame) -> str:
    """Largest error of any specimen's any joint, in degrees."""
    return f"{np.degrees(rows[list(JOINTS)].to_numpy().max()):.2f}"


def _named(method: str, family: str) -> str:
    return f"{METHODS[method].title}, {family}"


def _table(rows: DataFrame, settings: Settings, grips: DataFrame) -> Table:
    cells: dict[str, Cell] = {"n": lambda group: str(group.specimen.nunique())}
    for name, mark in zip(TESTS, ("", " "), strict=True):
        cells[f"{name}: pitch jaw1 jaw2"] = of(joint_medians, test=name)
        cells["worst" + mark] = of(worst, test=name)
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
    return table_of(title, rows, ["method", "family"], cells, notes, names=_named)


def _load_table(rows: DataFrame) -> Table:
    cells: dict[str, Cell] = {}
    for load in LOADS:
        cells[load] = of(median("rms", 1, 1e3), test="loaded", name=load)
        cells["of " + load] = of(_size, test="loaded", name=load)
    cells["grip when free"] = of(median("rms", 1, 1e3), test="free", name="grip")
    note = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself: pitch and yaw are torques of the force at the tip. What a pin "
        "holds by friction no motor feels: its dead band stands where it was identified."
    )
    by = ["method", "family"]
    return table_of("Grip and tip torque", rows, by, cells, (note,), names=_named)


def _size(group: DataFrame) -> str:
    return f"{1e3 * group['size'].median():.1f}"


def _honest_table(rows: DataFrame) -> Table:
    cells: dict[str, Cell] = {}
    for n, (test, name) in enumerate(product(TESTS, ("angle", "load"))):
        cells[f"{test}: {name}"] = of(median("nees", 2), motion=test, name=name)
        cells["in 90 %" + " " * n] = of(_share, motion=test, name=name)
    note = (
        "Normalised square of the physical filter's errors, 1 where its deviations are honest: "
        "median (worst) of the specimens; share of errors within what it states for 90 %, median."
    )
    return table_of("What the physical filter states of itself", rows, "family", cells, (note,))


def _share(group: DataFrame) -> str:
    return f"{100 * group.covered.median():.0f} %"


def _identified_table(rows: DataFrame) -> Table:
    off, ratio = (rows.value / rows.true - 1.0).abs(), (rows.value - rows.true) / rows.deviation
    by = [rows["name"], rows.family]
    values = rows.groupby(by, sort=False)[["value", "deviation"]].median()
    text = values.value.map("{:.3g}".format) + " +- " + values.deviation.map("{:.1g}".format)
    share = (100.0 * off.groupby(by, sort=False).median()).map("{:.0f} %".format)
    squares = (ratio**2).groupby(by, sort=False).mean()
    apart = (squares**0.5).map("{:.1f} x".format)
    known = off.groupby(by, sort=False).count() > 0
    apart = (share + ", " + apart).where(known, "-")
    table = rows.groupby("name", sort=False)[["unit"]].first()
    for family in unique(rows, "family"):
        table[family], table[f"off, {family}"] = text.xs(family, level=1), apart.xs(family, level=1)
    note = (
        "Medians of what was identified and of its stated deviation; how far it is off what the "
        "specimen was made with, where that is one number, in the median, and the RMS of that in "
        "stated deviations. A loop's stiffness is that of its own two cables."
    )
    return frame_table("What was identified", table, (note,), head="identified")
