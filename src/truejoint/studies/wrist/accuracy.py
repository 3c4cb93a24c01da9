"""How exactly pitch and both jaws are known, free and under loads, by sensors and method."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, product
from typing import Any, Final

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.estimators import get_estimator
from truejoint.estimators.cables.hybrid import WRIST_PLAYS
from truejoint.estimators.cables.learn import CableFilter, CableStates
from truejoint.estimators.cables.loops import LOAD, PIN
from truejoint.features.feature_set import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.parameters import WristParameters, plant_constants
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.study import (
    Part,
    PartResult,
    Settings,
    Summary,
    check_counts,
    check_names,
)
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.physical import LOADS, honesty
from truejoint.tables import Table, median_text

_RAW: Final = "coupling"
SETTLED: Final = 2.0
"""Time after which a history that began with the recording counts [s]."""
BLIND: Final = 5e-3
"""Dead band [Nm] above which a torque at the tip is declared blind: what pins hide of it."""
_FILTER: Final = "filter"
_MODEL: Final = "model"


@dataclass(frozen=True, eq=False)
class Told:
    """What is told of a recording by the physical filter, and by its model alone, unloaded."""

    filtered: CableStates
    joints: Array  # (n, 3) [rad]
    states: Array  # (n, 15)


Numbers = Mapping[str, Any]
"""What was found of one specimen, by name."""
Families = Mapping[str, Sequence[Numbers]]
"""That by the specimens' families."""
Known = Mapping[str, Told]
"""That by the recordings' sessions."""


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
_DRAWN: Final = ("play_motor", "linear_effort", _FILTER, "play_effort", "play_filter")
"""Whose errors are drawn over time, the smallest last."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_names("method", settings["methods"], tuple(METHODS))
    check_times(settings)
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    return specimens(settings, judge, "methods", "instrument", "free_s", "loaded_s", "test_s")


def check_times(settings: Settings) -> None:
    """Raise StudyError unless something is calibrated on, and a test lasts beyond `SETTLED`."""
    check_counts(settings, "free_s", "loaded_s")
    if not settings["test_s"] > SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {SETTLED:g}")


def specimens(settings: Settings, judge: Callable[..., PartResult], *names: str) -> list[Part]:
    """One part a virtual instrument: `judge` of it, its family, its number, and options `names`."""
    family, common = settings["family"], {name: settings[name] for name in names}
    return [
        Part(
            f"specimen-{n:05d}",
            judge,
            {"specimen": p.to_dict(), "family": family_of(n, family), "number": n, **common},
        )
        for n, p in enumerate(population(settings["count"], settings.seed, family))
    ]


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    family: str,
    methods: Sequence[str],
    instrument: str,
    free_s: float,
    loaded_s: float,
    test_s: float,
    number: int,
) -> PartResult:
    """Calibrate methods on multi-sines, free and loaded; judge them on steps, free and loaded."""
    twin = WristTwin(WristParameters.from_dict(specimen), arm=instrument, seed=number)
    seed = 4 * number
    free, under_load = motions.calibrating(twin, free_s, loaded_s, seed)
    tests = {
        "free": motions.record(twin, motions.steps, test_s, seed + 2, load=False),
        "loaded": motions.record(twin, motions.steps, test_s, seed + 3, load=True),
    }
    numbers: dict[str, Any] = {"family": family, "errors": {}, "loads": {}}
    arrays: dict[str, Array] = {}
    known: Known = {}
    if any(METHODS[key].with_filter for key in methods):
        physical = calibrate([free, under_load], "ukf_cables", joints=JOINTS)
        known = {
            run.provenance.session: told(physical, run)
            for run in (free, under_load, *tests.values())
        }
        numbers["identified"] = _filter_of(physical).identified
        numbers["true"] = quantities(twin)
        numbers["honest"] = {
            name: honesty(known[test.provenance.session].filtered, test, SETTLED)
            for name, test in tests.items()
        }
    for key in methods:
        found = estimates(METHODS[key], free, under_load, tests, known)
        numbers["errors"][key] = {}
        for name, test in tests.items():
            rows = test.t - test.t[0] > SETTLED
            angle, load = found[name]
            off = (angle - test.columns("truth_exact", JOINTS))[rows]
            numbers["errors"][key][name] = rms(off)
            arrays[f"{name}/{key}"] = off[::4]
            if load is not None:
                truth = test.columns("truth_load", LOADS)[rows]
                own = zip(LOADS, rms(load[rows] - truth), rms(truth), strict=True)
                numbers["loads"].setdefault(key, {})[name] = {n: (a, b) for n, a, b in own}
    for name, test in tests.items():
        rows = test.t - test.t[0] > SETTLED
        arrays[f"{name}/t"] = test.t[rows][::4] - test.t[0]
    grip = tests["loaded"].column("truth_load/grip")
    numbers["grip_rms"] = float(np.sqrt(np.mean(grip**2)))
    return PartResult(numbers, arrays)


def estimates(
    method: Method,
    free: Recording,
    under_load: Recording,
    tests: Mapping[str, Recording],
    known: Known,
) -> Mapping[str, tuple[Array, Array | None]]:
    """Joints (n, 3) [rad], and loads (n, 3) [Nm] where it tells them, of a method in each test."""
    if method.estimator is None and method.with_filter:
        own = {name: known[test.provenance.session] for name, test in tests.items()}
        if not method.with_load:
            return {name: (one.joints, None) for name, one in own.items()}
        return {name: (one.filtered.angle, one.filtered.load) for name, one in own.items()}
    if method.with_load:
        return fitted([free, under_load], tests, method, known)
    if method.estimator is None:
        return {name: (test.columns("measured", JOINTS), None) for name, test in tests.items()}
    if method.with_filter:
        return {name: (a, None) for name, (a, _) in fitted([free], tests, method, known).items()}
    model = calibrate([free], method.estimator, features=method.features, joints=JOINTS)
    return {name: (model.correct(test), None) for name, test in tests.items()}


def told(physical: Calibration, recording: Recording) -> Told:
    """Run the physical filter, and its model alone, over a recording."""
    model, gap = _filter_of(physical), physical.gap_limit
    X, dt = physical.feature_set.compute(recording, gap), time_steps(recording.t, gap)
    return Told(model.states(X, dt), *model.unloaded(X, dt))


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
        own = [(n, cable) for n, cable in enumerate(mechanism.cables) if cable.motor == motor]
        legs = [1.0 / (1.0 / drawn.stiffness[n, : len(c.segments)]).sum() for n, c in own]
        stiffness[f"{joint}_stiffness"] = float(np.mean(legs))
        wrap = math.fsum(node.wrap for node in own[0][1].nodes if not node.joint)
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


def rms(values: Array) -> list[float]:
    """Root mean square of each column (k,) of (n, k)."""
    return np.sqrt(np.mean(values**2, axis=0)).tolist()  # type: ignore[no-any-return]


def fitted(
    training: Sequence[Recording],
    tests: Mapping[str, Recording],
    method: Method,
    known: Known | None,
) -> dict[str, tuple[Array, Array]]:
    """Joints (n, 3) [rad] and loads (n, 3) [Nm] in each test, by a method that learns both."""
    features = FeatureSet.parse(method.features)
    gap = default_gap_limit(training)

    def inputs(recording: Recording) -> Array:
        own, measured = features.compute(recording, gap), recording.columns("measured", JOINTS)
        if not (method.with_filter and known):
            return own
        one = known[recording.provenance.session]
        if not method.with_load:
            return np.hstack([own, one.joints - measured, one.states[:, PIN:LOAD]])
        states = one.filtered.states[:, PIN:LOAD]
        return np.hstack([own, one.filtered.angle - measured, one.filtered.load, states])

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


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table of medians by family, and the errors of the first specimen over time."""
    numbers = [result.numbers for result in results.values()]
    families = by_family(numbers)
    tables = [_table(families, settings)]
    if numbers[0]["loads"]:
        tables.append(_load_table(families))
    if "honest" in numbers[0]:
        tables += [_honest_table(families), _identified_table(families)]
    first = next(iter(results.values()))
    return Summary(tables, {"wrist": _figure(numbers, settings), "wrist-errors": _errors(first)})


def by_family(numbers: Sequence[Numbers]) -> Families:
    """Sort what was found of specimens by their families."""
    families = dict.fromkeys(n["family"] for n in numbers)
    return {family: [n for n in numbers if n["family"] == family] for family in families}


def _table(families: Families, settings: Settings) -> Table:
    rows = []
    for key in settings["methods"]:
        for family, own in families.items():
            cells = []
            for name in ("free", "loaded"):
                rms = np.degrees([n["errors"][key][name] for n in own])
                middle = " ".join(f"{value:.3f}" for value in np.median(rms, axis=0))
                cells += [middle, f"{rms.max():.2f}"]
            rows.append((METHODS[key].title, family, str(len(own)), *cells))
    header = (
        "method", "family", "n", "free: pitch jaw1 jaw2", "worst", "loaded: pitch jaw1 jaw2",
        "worst",
    )  # fmt: skip
    grip = 1e3 * float(np.median([n["grip_rms"] for own in families.values() for n in own]))
    notes = (
        f"RMS error in degrees against the joints themselves, median of the specimens of seed "
        f"{settings.seed}; worst: of any specimen's any joint. Fitted to {settings['free_s']:g} s "
        f"of multi-sines without load and, with effort, {settings['loaded_s']:g} s under loads; "
        f"tested on {settings['test_s']:g} s of steps each.",
        f"Loads: grips half of the time (RMS {grip:.0f} mNm in the median) and pushes at the tip "
        "up to 2 N along two axes. Motors alone do not see them: what stands there is what a load "
        "that nothing measures does.",
    )
    return Table("Pitch and jaws of a wristed instrument", header, tuple(rows), notes)


def _load_table(families: Families) -> Table:
    rows, numbers = [], list(chain(*families.values()))
    for key, (family, specimens) in product(numbers[0]["loads"], families.items()):
        own, cells = [n["loads"][key] for n in specimens], []
        for load in LOADS:
            error, size = 1e3 * np.array([n["loaded"][load] for n in own]).T
            cells += [median_text(error, 1), f"{np.median(size):.1f}"]
        false = 1e3 * np.array([n["free"]["grip"][0] for n in own])
        rows.append((METHODS[key].title, family, *cells, median_text(false, 1)))
    header = ("method", "family", *(t for load in LOADS for t in (load, "of")), "grip when free")
    notes = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself: pitch and yaw are torques of the force at the tip. What a pin "
        "holds by friction no motor feels; that is the dead band below which a push stays unseen.",
        *_blind(numbers),
    )
    return Table("Grip and tip torque", header, tuple(rows), notes)


def _blind(numbers: Sequence[Numbers]) -> tuple[str, ...]:
    """Say by the dead bands that were identified which torques at the tip are declared blind."""
    if "identified" not in numbers[0]:
        return ()
    said = []
    for title, name in (("grip", "grip"), ("pitch", "tip_first"), ("yaw", "tip_second")):
        bands = 1e3 * np.array([n["identified"][f"{name}_dead_band"][0] for n in numbers])
        said.append(
            f"{title} {np.median(bands):.1f} ({bands.min():.1f} to {bands.max():.1f}), "
            f"{np.count_nonzero(bands > 1e3 * BLIND)} of {len(bands)} blind"
        )
    return (
        f"Dead bands that were identified, in mNm; above {1e3 * BLIND:g} a torque is declared "
        f"blind: {'; '.join(said)}.",
    )


def _honest_table(families: Families) -> Table:
    rows = []
    for family, specimens in families.items():
        own, cells = [n["honest"] for n in specimens], []
        for name, quantity in product(("free", "loaded"), ("angle", "load")):
            nees, covered = np.array(
                [[n[name][quantity][key] for key in ("nees", "covered")] for n in own]
            ).T
            cells += [median_text(nees, 2), f"{100 * np.median(covered):.0f} %"]
        rows.append((family, *cells))
    header = (
        "family", "free: angle", "in 90 %", "load", "in 90 %", "loaded: angle", "in 90 %", "load",
        "in 90 %",
    )  # fmt: skip
    notes = (
        "Normalised square of the physical filter's errors, 1 where its deviations are honest: "
        "median (worst) of the specimens; share of errors within what it states for 90 %, median. "
        "Its deviations are scaled to the errors in calibration, of another class of motion.",
    )
    return Table("What the physical filter states of itself", header, tuple(rows), notes)


def _identified_table(families: Families) -> Table:
    rows = []
    for name, (_, _, unit) in next(iter(families.values()))[0]["identified"].items():
        cells = []
        for own in families.values():
            found, deviation = np.array([n["identified"][name][:2] for n in own]).T
            cells += [f"{np.median(found):.3g} +- {np.median(deviation):.1g}"]
            if name in own[0]["true"]:
                true = np.array([n["true"][name] for n in own])
                apart = np.sqrt(np.mean(((found - true) / deviation) ** 2))
                cells += [f"{100 * np.median(np.abs(found / true - 1.0)):.0f} %, {apart:.1f} x"]
            else:
                cells += ["-"]
        rows.append((name, unit, *cells))
    header = ("identified", "unit", *(title for f in families for title in (f, "off")))
    notes = (
        "Medians of what was identified and of its stated deviation; how far it is off what the "
        "specimen was made with, where that is one number, in the median, and the RMS of that in "
        "stated deviations. A loop's stiffness is that of its own two cables; what their radii "
        "stray by stays in it.",
    )
    return Table("What was identified", header, tuple(rows), notes)


def _figure(numbers: Sequence[Numbers], settings: Settings) -> Figure:
    panels = []
    for name in ("free", "loaded"):
        curves = []
        for key in settings["methods"]:
            sizes = np.sort(np.degrees([n["errors"][key][name] for n in numbers]), axis=None)
            below = (np.arange(sizes.size) + 0.5) / sizes.size
            curves.append(Curve(sizes, below, METHODS[key].title, _COLOURS[key], width=1.3))
        panels.append(Panel(curves, "RMS error [deg]", "share of joints below", name, log="x"))
    caption = "Share of all specimens' joints with a smaller error, by method."
    return Figure("Wristed instruments, another class of motion", (panels,), caption, legend=True)


def _errors(result: PartResult) -> Figure:
    """Errors over the first half minute of the loaded test."""
    t = result.arrays["loaded/t"]
    shown = t < SETTLED + 30.0
    panels = []
    for j, joint in enumerate(JOINTS):
        curves = [
            Curve(t[shown], np.degrees(result.arrays[f"loaded/{key}"][shown, j]),
                  METHODS[key].title, _COLOURS[key])
            for key in _DRAWN
            if f"loaded/{key}" in result.arrays
        ]  # fmt: skip
        panels.append(Panel(curves, "time [s]", "error [deg]", joint))
    caption = "Errors under load, first specimen; the motors alone see no load."
    return Figure("Errors under load", (panels,), caption, legend=True, height=4.5)
