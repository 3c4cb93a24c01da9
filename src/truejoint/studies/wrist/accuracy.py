"""How exactly pitch and both jaws are known, free and under loads, by sensors and method."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.errors import StudyError
from truejoint.estimators import RichPlay
from truejoint.models.features import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.study import (
    Part,
    PartResult,
    Settings,
    Summary,
    check_counts,
    check_names,
)
from truejoint.studies.table import Table
from truejoint.studies.wrist import motions

_JOINTS: Final = ("pitch", "jaw1", "jaw2")
_RAW: Final = "coupling"
_SETTLED: Final = 2.0  # [s] after which a history that began with the recording counts


@dataclass(frozen=True)
class Method:
    """One row of the table: an estimator, what it sees, and whether it is fitted under load too."""

    title: str
    estimator: Any
    quantities: tuple[str, ...] = ()
    with_load: bool = False

    @property
    def features(self) -> list[str]:
        """Features, pitch first, by which the loops of all cables grow and shrink."""
        return [f"{quantity}/{joint}" for quantity in self.quantities for joint in _JOINTS]


# Half-widths in half ranges: 0.1 deg and up of 55 deg of pitch, a few mNm and up of an effort.
# Speed shows in one short low-pass, for the motors' viscous friction.
_PLAYS: Final = RichPlay(
    plays=(0.002, 0.005, 0.01, 0.018, 0.03, 0.05, 0.09, 0.2),
    time_constants=(0.05,),
    leading=3,
    squared=3,
)

METHODS: Final[Mapping[str, Method]] = {
    _RAW: Method("coupling inverse", None),
    "linear_motor": Method("linear, motors", "linear", ("motor",)),
    "play_motor": Method("plays, motors", _PLAYS, ("measured", "motor")),
    "rich_play": Method("rich_play as it is, motors", "rich_play", ("measured", "motor")),
    "linear_effort": Method("linear, motors and effort", "linear", ("motor", "effort"), True),
    "play_effort": Method(
        "plays, motors and effort", _PLAYS, ("measured", "motor", "effort"), True
    ),
}


_SEES_LOADS: Final = "play_effort"
LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_names("method", settings["methods"], tuple(METHODS))
    check_counts(settings, "free_s", "loaded_s")
    if not settings["test_s"] > _SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {_SETTLED:g}")
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    family, count = settings["family"], settings["count"]
    drawn = population(count, settings.seed, family)
    asked = ("methods", "instrument", "free_s", "loaded_s", "test_s")
    common = {name: settings[name] for name in asked}
    return [
        Part(
            f"specimen-{n:05d}",
            judge,
            {"specimen": p.to_dict(), "family": family_of(n, family), "number": n, **common},
        )
        for n, p in enumerate(drawn)
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
    twin.home()
    seed = 4 * number
    free = motions.record(twin, motions.multi_sine, free_s, seed, load=False)
    under_load = motions.record(twin, motions.multi_sine, loaded_s, seed + 1, load=True)
    tests = {
        "free": motions.record(twin, motions.steps, test_s, seed + 2, load=False),
        "loaded": motions.record(twin, motions.steps, test_s, seed + 3, load=True),
    }
    numbers: dict[str, Any] = {"family": family, "errors": {}}
    arrays: dict[str, Array] = {}
    for key in methods:
        method = METHODS[key]
        model = None
        if method.estimator is not None:
            training = [free, under_load] if method.with_load else [free]
            model = calibrate(training, method.estimator, features=method.features, joints=_JOINTS)
        numbers["errors"][key] = {}
        for name, test in tests.items():
            off = errors(model, test)
            numbers["errors"][key][name] = np.sqrt(np.mean(off**2, axis=0)).tolist()
            arrays[f"{name}/{key}"] = off[::4]
    for name, test in tests.items():
        rows = test.t - test.t[0] > _SETTLED
        arrays[f"{name}/t"] = test.t[rows][::4] - test.t[0]
    numbers["loads"] = load_errors([free, under_load], tests) if _SEES_LOADS in methods else {}
    grip = tests["loaded"].column("truth_load/grip")
    numbers["grip_rms"] = float(np.sqrt(np.mean(grip**2)))
    return PartResult(numbers, arrays)


def load_errors(
    training: Sequence[Recording], tests: Mapping[str, Recording]
) -> dict[str, dict[str, tuple[float, float]]]:
    """RMS error and RMS of each load [Nm], by test, of plays fitted to the loads themselves."""
    method = METHODS[_SEES_LOADS]
    features = FeatureSet.parse(method.features)
    gap = default_gap_limit(training)

    def rows(recordings: Sequence[Recording]) -> tuple[Array, Array, Array]:
        return (
            np.vstack([features.compute(r, gap) for r in recordings]),
            np.vstack([r.columns("truth_load", LOADS) for r in recordings]),
            np.concatenate([time_steps(r.t, gap) for r in recordings]),
        )

    X, loads, dt = rows(training)
    model = clone(method.estimator).fit(X, loads, dt=dt)
    found = {}
    for name, test in tests.items():
        X, loads, dt = rows([test])
        settled = test.t - test.t[0] > _SETTLED
        off = (model.predict(X, dt) - loads)[settled]
        pairs = np.sqrt(np.mean([off**2, loads[settled] ** 2], axis=1)).T
        found[name] = {
            load: (float(a), float(b)) for load, (a, b) in zip(LOADS, pairs, strict=True)
        }
    return found


def errors(model: Calibration | None, test: Recording) -> Array:
    """Estimate minus the joints (n, 3) [rad], of a model or of the coupling alone."""
    known = test.columns("measured", _JOINTS) if model is None else model.correct(test)
    off = known - test.columns("truth_exact", _JOINTS)
    return np.asarray(off[test.t - test.t[0] > _SETTLED])


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table of medians by family, and the errors of the first specimen over time."""
    numbers = [result.numbers for result in results.values()]
    families = list(dict.fromkeys(n["family"] for n in numbers))
    tables = [_table(numbers, families, settings)]
    if all(n["loads"] for n in numbers):
        tables.append(_load_table(numbers, families))
    first = next(iter(results.values()))
    return Summary(tables, {"wrist": _figure(numbers, settings), "wrist-errors": _errors(first)})


def _table(
    numbers: Sequence[Mapping[str, Any]], families: Sequence[str], settings: Settings
) -> Table:
    rows = []
    for key in settings["methods"]:
        for family in families:
            own = [n for n in numbers if n["family"] == family]
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
    grip = 1e3 * float(np.median([n["grip_rms"] for n in numbers]))
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


def _load_table(numbers: Sequence[Mapping[str, Any]], families: Sequence[str]) -> Table:
    rows = []
    for family in families:
        own = [n["loads"] for n in numbers if n["family"] == family]
        cells = []
        for load in LOADS:
            error, size = 1e3 * np.array([n["loaded"][load] for n in own]).T
            cells += [f"{np.median(error):.1f} ({error.max():.1f})", f"{np.median(size):.1f}"]
        false = 1e3 * np.array([n["free"]["grip"][0] for n in own])
        rows.append((family, *cells, f"{np.median(false):.1f} ({false.max():.1f})"))
    header = ("family", *(text for load in LOADS for text in (load, "of")), "grip when free")
    notes = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself: pitch and yaw are torques of the force at the tip. What a pin "
        "holds by friction no motor feels; that is the dead band below which a push stays unseen.",
    )
    return Table("Grip and tip torque", header, tuple(rows), notes)


def _figure(numbers: Sequence[Mapping[str, Any]], settings: Settings) -> Figure:
    panels = []
    for name in ("free", "loaded"):
        curves = []
        for k, key in enumerate(settings["methods"]):
            sizes = np.sort(np.degrees([n["errors"][key][name] for n in numbers]), axis=None)
            below = (np.arange(sizes.size) + 0.5) / sizes.size
            curves.append(Curve(sizes, below, METHODS[key].title, f"C{k}", width=1.3))
        panels.append(Panel(curves, "RMS error [deg]", "share of joints below", name, log="x"))
    caption = "Share of all specimens' joints with a smaller error, by method."
    return Figure("Wristed instruments, another class of motion", (panels,), caption, legend=True)


def _errors(result: PartResult) -> Figure:
    """Errors over the first half minute of the loaded test."""
    t = result.arrays["loaded/t"]
    shown = t < _SETTLED + 30.0
    panels = []
    for j, joint in enumerate(_JOINTS):
        curves = [
            Curve(t[shown], np.degrees(result.arrays[f"loaded/{key}"][shown, j]), method.title,
                  f"C{k}")
            for k, (key, method) in enumerate(METHODS.items())
            if f"loaded/{key}" in result.arrays and key != _RAW
        ]  # fmt: skip
        panels.append(Panel(curves, "time [s]", "error [deg]", joint))
    caption = "Errors under load, first specimen; the motors alone see no load."
    return Figure("Errors under load", (panels,), caption, legend=True, height=4.5)
