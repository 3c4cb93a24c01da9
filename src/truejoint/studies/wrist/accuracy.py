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
from truejoint.calibration import Calibration, calibrate
from truejoint.drawing import Figure, ecdf
from truejoint.errors import StudyError
from truejoint.estimators import get_estimator
from truejoint.estimators.cables.hybrid import WRIST_PLAYS
from truejoint.estimators.cables.learn import CableFilter, CableStates
from truejoint.estimators.cables.loops import LOAD as LAST
from truejoint.estimators.cables.loops import PIN
from truejoint.features.feature_set import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.parameters import WristParameters, plant_constants
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import Cell, median, of, select, table_of, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.wrist import motions
from truejoint.tables import Table

_RAW: Final = "coupling"
SETTLED: Final = 2.0
"""Time after which a history that began with the recording counts [s]."""
BLIND: Final = 5e-3
"""Dead band [Nm] above which a torque at the tip is declared blind: what pins hide of it."""
LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""
TESTS: Final = ("free", "loaded")
ANGLE, LOAD, HONESTY, IDENTIFIED, GRIP = "angle", "load", "honesty", "identified", "grip"
"""What a row is of."""
_NINETY: Final = NormalDist().inv_cdf(0.95)  # deviations that hold 90 % of a normal's draws
_FILTER: Final = "filter"
_MODEL: Final = "model"


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
    _RAW: Method("coupling inverse", None),
    "linear_motor": Method("linear, motors", "linear", ("motor",)),
    "play_motor": Method("plays, motors", WRIST_PLAYS, ("measured", "motor")),
    "rich_play": Method("rich_play as it is, motors", "rich_play", ("measured", "motor")),
    _MODEL: Method("physical model, motors", None, ("motor",), with_filter=True),
    "play_model": Method(
        "plays, motors, model's states", WRIST_PLAYS, ("measured", "motor"), with_filter=True
    ),
    "linear_effort": Method(
        "linear, motors and effort", get_estimator("linear"), ("motor", "effort"), True
    ),
    "play_effort": Method(
        "plays, motors and effort", WRIST_PLAYS, ("measured", "motor", "effort"), True
    ),
    _FILTER: Method(
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

_COLOURS: Final = {key: f"C{k}" for k, key in enumerate(METHODS)}


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    settings.check_names("method", "methods", METHODS)
    check_times(settings)
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    return specimens(settings, judge, "methods", "instrument", "free_s", "loaded_s", "test_s")


def check_times(settings: Settings) -> None:
    """Raise StudyError unless something is calibrated on, and a test lasts beyond `SETTLED`."""
    settings.check_positive("free_s", "loaded_s")
    if not settings["test_s"] > SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {SETTLED:g}")


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
        "free": motions.record(twin, motions.steps, test_s, seed + 2, load=False),
        "loaded": motions.record(twin, motions.steps, test_s, seed + 3, load=True),
    }
    rows: Rows = []
    runs: Physical = {}
    if any(METHODS[key].with_filter for key in methods):
        physical = calibrate([free, under_load], "ukf_cables", joints=JOINTS)
        runs = {
            run.provenance.session: simulated(physical, run)
            for run in (free, under_load, *tests.values())
        }
        true = quantities(twin)
        rows += [
            {"of": IDENTIFIED, "name": name, "value": value, "deviation": deviation, "unit": unit,
             "true": true.get(name)}
            for name, (value, deviation, unit) in _filter_of(physical).identified.items()
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
    if method.with_load:
        return fitted([free, under_load], tests, method, runs)
    if method.estimator is None:
        return {name: (test.columns("measured", JOINTS), None) for name, test in tests.items()}
    if method.with_filter:
        return {name: (a, None) for name, (a, _) in fitted([free], tests, method, runs).items()}
    model = calibrate([free], method.estimator, features=method.features, joints=JOINTS)
    return {name: (model.correct(test), None) for name, test in tests.items()}


def simulated(physical: Calibration, recording: Recording) -> Simulated:
    """Run the physical filter, and its model alone, over a recording."""
    model, gap = _filter_of(physical), physical.gap_limit
    X, dt = physical.feature_set.compute(recording, gap), time_steps(recording.t, gap)
    return Simulated(model.states(X, dt), *model.unloaded(X, dt))


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


def _filter_of(physical: Calibration) -> CableFilter:
    model: CableFilter = physical.model
    return model


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
) -> dict[str, tuple[Array, Array]]:
    """Joints (n, 3) [rad] and loads (n, 3) [Nm] in each test, by a method that learns both."""
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
    found = {}
    for name, test in tests.items():
        out = model.predict(inputs(test), time_steps(test.t, gap))
        n = len(JOINTS)
        found[name] = out[:, :n] + test.columns("measured", JOINTS), out[:, n:]
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
    """Table of medians by family, and the errors of the first specimen over time."""
    settings = results.settings
    by_kind = {str(kind): rows for kind, rows in results.rows.groupby("of", sort=False)}
    tables = [_table(by_kind[ANGLE], settings, by_kind[GRIP])]
    if LOAD in by_kind:
        tables.append(_load_table(by_kind[LOAD], by_kind.get(IDENTIFIED)))
    if HONESTY in by_kind:
        tables += [_honest_table(by_kind[HONESTY]), _identified_table(by_kind[IDENTIFIED])]
    angles = by_kind[ANGLE][["test", "method", *JOINTS]]
    errors = angles.melt(["test", "method"], list(JOINTS), "joint", "rms")
    errors = errors.assign(name=errors.method.map({k: m.title for k, m in METHODS.items()}))
    colours = {METHODS[key].title: colour for key, colour in _COLOURS.items()}
    panels = [
        ecdf(
            select(errors, test=name), "rms", "name", scale=np.degrees(1.0), colours=colours,
            x="RMS error [deg]", y="share of joints [%]", title=name, log="x",
        )
        for name in TESTS
    ]  # fmt: skip
    caption = "Share of all specimens' joints with a smaller error, by method."
    figure = Figure("Wristed instruments, another class of motion", (panels,), caption, legend=True)
    return Summary(tables, {"wrist": figure})


def joint_medians(rows: DataFrame, decimals: int = 3) -> str:
    """Medians of columns of all joints [rad], in degrees."""
    return " ".join(f"{value:.{decimals}f}" for value in np.degrees(rows[list(JOINTS)].median()))


def worst(rows: DataFrame) -> str:
    """Largest error of any specimen's any joint, in degrees."""
    return f"{np.degrees(rows[list(JOINTS)].to_numpy().max()):.2f}"


def _table(rows: DataFrame, settings: Settings, grips: DataFrame) -> Table:
    grip = 1e3 * grips.rms.median()
    cells: dict[str, Cell] = {"n": lambda group: str(group.specimen.nunique())}
    for name, mark in zip(TESTS, ("", " "), strict=True):
        cells[f"{name}: pitch jaw1 jaw2"] = of(joint_medians, test=name)
        cells["worst" + mark] = of(worst, test=name)
    notes = (
        f"RMS error in degrees against the joints themselves, median of the specimens of seed "
        f"{settings.seed}; worst: of any specimen's any joint. Fitted to {settings['free_s']:g} s "
        f"of multi-sines without load and, with effort, {settings['loaded_s']:g} s under loads; "
        f"tested on {settings['test_s']:g} s of steps each.",
        f"Loads: grips half of the time (RMS {grip:.0f} mNm in the median) and pushes at the tip "
        "up to 2 N along two axes. Motors alone do not see them: what stands there is what a load "
        "that nothing measures does.",
    )
    title = "Pitch and jaws of a wristed instrument"
    return table_of(title, rows, ["method", "family"], cells, notes, names=_named)


def _middle(column: str, scale: float) -> Cell:
    return lambda group: f"{scale * group[column].median():.1f}"


def _share(group: DataFrame) -> str:
    return f"{100 * group.covered.median():.0f} %"


def _named(method: str, family: str) -> str:
    return f"{METHODS[method].title}, {family}"


def _load_table(rows: DataFrame, identified: DataFrame | None) -> Table:
    cells: dict[str, Cell] = {}
    for load in LOADS:
        cells[load] = of(median("rms", 1, 1e3), test="loaded", name=load)
        cells["of " + load] = of(_middle("size", 1e3), test="loaded", name=load)
    cells["grip when free"] = of(median("rms", 1, 1e3), test="free", name="grip")
    notes = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself: pitch and yaw are torques of the force at the tip. What a pin "
        "holds by friction no motor feels; that is the dead band below which a push stays unseen.",
        *(() if identified is None else (_blind(identified),)),
    )
    by = ["method", "family"]
    return table_of("Grip and tip torque", rows, by, cells, notes, names=_named)


def _blind(identified: DataFrame) -> str:
    """State by the identified dead bands which torques at the tip are declared blind."""
    texts = []
    for title, name in (("grip", "grip"), ("pitch", "tip_first"), ("yaw", "tip_second")):
        bands = 1e3 * select(identified, name=f"{name}_dead_band").value
        texts.append(
            f"{title} {bands.median():.1f} ({bands.min():.1f} to {bands.max():.1f}), "
            f"{(bands > 1e3 * BLIND).sum()} of {len(bands)} blind"
        )
    return (
        f"Dead bands that were identified, in mNm; above {1e3 * BLIND:g} a torque is declared "
        f"blind: {'; '.join(texts)}."
    )


def _honest_table(rows: DataFrame) -> Table:
    cells: dict[str, Cell] = {}
    for n, (test, name) in enumerate(product(TESTS, ("angle", "load"))):
        cells[f"{test}: {name}"] = of(median("nees", 2), motion=test, name=name)
        cells["in 90 %" + " " * n] = of(_share, motion=test, name=name)
    notes = (
        "Normalised square of the physical filter's errors, 1 where its deviations are honest: "
        "median (worst) of the specimens; share of errors within what it states for 90 %, median. "
        "Its deviations are scaled to the errors in calibration, of another class of motion.",
    )
    return table_of("What the physical filter states of itself", rows, "family", cells, notes)


def _value(group: DataFrame) -> str:
    return f"{group.value.median():.3g} +- {group.deviation.median():.1g}"


def _off(group: DataFrame) -> str:
    group = group.dropna(subset="true")
    apart = np.sqrt(group.ratio.mean())
    return f"{100 * group.off.median():.0f} %, {apart:.1f} x" if len(group) else "-"


def _identified_table(rows: DataFrame) -> Table:
    ratio = ((rows.value - rows.true) / rows.deviation) ** 2
    rows = rows.assign(off=(rows.value / rows.true - 1.0).abs(), ratio=ratio)
    cells: dict[str, Cell] = {"unit": lambda group: str(group.unit.iloc[0])}
    for n, family in enumerate(unique(rows, "family")):
        cells |= {family: of(_value, family=family), "off" + " " * n: of(_off, family=family)}
    notes = (
        "Medians of what was identified and of its stated deviation; how far it is off what the "
        "specimen was made with, where that is one number, in the median, and the RMS of that in "
        "stated deviations. A loop's stiffness is that of its own two cables; what their radii "
        "stray by stays in it.",
    )
    return table_of("What was identified", rows, "name", cells, notes, head="identified")
