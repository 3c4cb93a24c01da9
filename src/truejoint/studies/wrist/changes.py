"""What an instrument that changed after its calibration costs, what shows it, and a zero anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.models.features import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.recordings.wrist import record_wrist
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.twin import glide, hold
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.accuracy import (
    METHODS,
    SETTLED,
    check_times,
    fitted,
    rms,
    specimens,
)
from truejoint.studies.wrist.physical import LOADS

NOTHING: Final = "nothing"
GAIN: Final = "effort gain + 10 %"
ENGAGED: Final = "engaged anew"
CHANGES: Final[Mapping[str, Mapping[str, float]]] = {
    NOTHING: {},
    "pretension - 25 %": {"cables.pretension": 0.75},
    "motors' friction x 1.5": {"motor.coulomb": 1.5},
    "friction at the wrist x 1.4": {"cables.wrist_friction": 1.4},
    GAIN: {},
    ENGAGED: {},
}
"""By what each multiplies which parameter."""

FLAGGED: Final = 0.04
"""Share by which efforts of a motor are larger or smaller from which an instrument has changed."""
_CHECK: Final = 30.0  # [s] of free motion that tells
_SEEN: Final = 0.75  # share of the free calibration that efforts are learnt from
_OPEN: Final = 0.2  # [rad] from which jaws close on each other,
_PRESSED: Final = -0.15  # to this,
_YAWS: Final = (-0.5, 0.0, 0.5)  # [rad] here and there,
_CLOSING: Final = 2.0  # [s] in which
_FELT: Final = 0.01  # [Nm] of grip from which they meet for certain: pins hold less


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_times(settings)
    return specimens(settings, judge, "free_s", "loaded_s", "test_s")


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    family: str,
    number: int,
    free_s: float,
    loaded_s: float,
    test_s: float,
) -> PartResult:
    """Errors after each change, of a calibration from before, and the misfit of its efforts."""
    plant, seed = WristParameters.from_dict(specimen), 5 * number
    twin = WristTwin(plant, seed=number)
    twin.home()
    free = motions.record(twin, motions.multi_sine, free_s, seed, load=False)
    loaded = motions.record(twin, motions.multi_sine, loaded_s, seed + 1, load=True)
    tests, checks = {NOTHING + ", closing": closing(twin)}, {}
    for name, factors in CHANGES.items():
        base = plant.to_dict()
        values = {
            key: factor * base[key.split(".")[0]][key.split(".")[1]]
            for key, factor in factors.items()
        }
        other = WristTwin(plant.with_values(values), seed=number)
        other.home()
        if name == ENGAGED:
            other.home()
            tests[ENGAGED + ", closing"] = closing(other)
        tests[name] = motions.record(other, motions.steps, test_s, seed + 2, load=True)
        checks[name] = motions.record(other, motions.multi_sine, _CHECK, seed + 3, load=False)
        if name == GAIN:
            tests[name], checks[name] = (amplified(run, 1.1) for run in (tests[name], checks[name]))
    known = fitted([free, loaded], tests, METHODS["play_effort"], None)
    strange = strangeness(free, checks)
    errors = {}
    for name in CHANGES:
        test = tests[name]
        rows = test.t - test.t[0] > SETTLED
        angle, load = known[name]
        off = (angle - test.columns("truth_exact", JOINTS))[rows]
        errors[name] = {
            "angle": rms(off),
            "grip": rms((load - test.columns("truth_load", LOADS))[rows])[0],
            "opening": float(np.mean(off[:, 2] - off[:, 1])),
            "strange": strange[name],
        }
    before, after = (closed_opening(*known[f"{name}, closing"]) for name in (NOTHING, ENGAGED))
    return PartResult({"family": family, "errors": errors, "zero": after - before})


def closing(twin: WristTwin) -> Recording:
    """Record jaws that close on each other slowly, and open again, where they look each way."""
    poses = [motions.joints(np.array([[0.0, y, _OPEN], [0.0, y, _PRESSED]])) for y in _YAWS]
    before = poses[0][0]
    twin.run(glide(twin.commanded, before, 1.5))
    path = []
    for apart, pressed in poses:
        path += [glide(before, apart, 1.0), glide(apart, pressed, _CLOSING), hold(pressed, 0.5)]
        path += [glide(pressed, apart, _CLOSING)]
        before = apart
    return record_wrist(twin, np.vstack(path), session="closing")


def closed_opening(angle: Array, load: Array) -> float:
    """Give the opening [rad] at which jaws begin to press on each other, by what is known of both.

    Jaws give way as they press, by how much depends on where the zeros are; so it is that of a line
    through their opening over their grip, closing and opening, where there is none.
    """
    pressed = load[:, 0] > _FELT
    opening = (angle[:, 2] - angle[:, 1])[pressed]
    rows = np.column_stack([np.ones(len(opening)), load[pressed, 0]])
    return float(np.linalg.lstsq(rows, opening, rcond=None)[0][0])


def amplified(run: Recording, gain: float) -> Recording:
    """Copy whose efforts are read `gain` times as large."""
    scaled = {f"effort/{name}": gain * run.column(f"effort/{name}") for name in JOINTS}
    return Recording(run.table.assign(**scaled), run.units, run.provenance)


def strangeness(free: Recording, checks: Mapping[str, Recording]) -> dict[str, float]:
    """By which share efforts are larger or smaller than those in calibration along such a way.

    Efforts are learnt of motors and raw joints in the calibration without a load, whose end tells
    what is usual; of each check's motors the one that is furthest from it counts.
    """
    features = FeatureSet.parse(METHODS["play_motor"].features)
    gap = default_gap_limit([free])

    def size(run: Recording, first: float) -> Array:
        rows = run.t - run.t[0] > first
        expected = model.predict(features.compute(run, gap), time_steps(run.t, gap))[rows]
        shown = run.columns("effort", JOINTS)[rows]
        return np.asarray(np.sum(expected * shown, axis=0) / np.sum(expected**2, axis=0))

    last = _SEEN * (free.t[-1] - free.t[0])
    seen = free.t - free.t[0] < last
    X, efforts = features.compute(free, gap), free.columns("effort", JOINTS)
    dt = time_steps(free.t, gap)
    model = clone(METHODS["play_motor"].estimator).fit(X[seen], efforts[seen], dt=dt[seen])
    usual = size(free, last)
    return {
        name: float(np.abs(size(run, SETTLED) / usual - 1.0).max()) for name, run in checks.items()
    }


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Medians over the specimens by change, and what a closing of the jaws leaves."""
    numbers = [result.numbers for result in results.values()]
    rows, middle = [], []
    for name in CHANGES:
        own = [n["errors"][name] for n in numbers]
        angle = np.degrees([one["angle"] for one in own])
        middle.append(np.median(angle, axis=0))
        grip, strange = (np.array([one[key] for one in own]) for key in ("grip", "strange"))
        rows.append(
            (
                name,
                " ".join(f"{value:.2f}" for value in middle[-1]),
                f"{angle.max():.2f}",
                f"{1e3 * np.median(grip):.1f}",
                f"{100 * np.median(strange):.1f} %",
                f"{100 * np.mean(strange > FLAGGED):.0f} %",
            )
        )
    header = ("changed", "pitch jaw1 jaw2", "worst", "grip [mNm]", "efforts differ by", "flagged")
    notes = (
        "RMS error in degrees under loads, of plays on motors and effort that were calibrated "
        f"before the change: medians of {len(numbers)} specimens of seed {settings.seed}. Efforts "
        f"in {_CHECK:g} s of free motion are compared with those that such a motion took in "
        f"calibration; the motor that differs most counts, and is flagged from {FLAGGED:.0%} on.",
    )
    off = np.degrees(
        [
            [n["errors"][ENGAGED]["opening"], n["errors"][ENGAGED]["opening"] - n["zero"]]
            for n in numbers
        ]
    )
    before, after = np.abs(off - _usual(numbers)).T
    zero = Table(
        "Engaged anew: the jaws' opening",
        ("", "median", "worst"),
        tuple(
            (title, f"{np.median(each):.3f}", f"{each.max():.3f}")
            for title, each in (("as engaged", before), ("after closing on themselves", after))
        ),
        (
            "How far, in degrees, the mean error of the opening is from that before. Jaws that "
            "begin to press on each other are at the opening at which they did in calibration: a "
            "line through opening over grip tells it. Pitch and yaw have no such stop here: what "
            "engaging moved of them stays.",
        ),
    )
    place = np.arange(len(CHANGES))
    curves = [
        Curve(np.array(middle)[:, j], place, joint, f"C{j}", "o") for j, joint in enumerate(JOINTS)
    ]
    panel = Panel(curves, "median RMS error under loads [deg]", rows=list(CHANGES))
    figure = Figure("Changed after the calibration", ((panel,),), notes[0], height=3.6, legend=True)
    table = Table("Changed after the calibration", header, tuple(rows), notes)
    return Summary((table, zero), {"wrist-changes": figure})


def _usual(numbers: Sequence[Mapping[str, Any]]) -> Array:
    """Mean error (n, 1) [deg] of the opening where nothing changed."""
    return np.degrees([[n["errors"][NOTHING]["opening"]] for n in numbers])
