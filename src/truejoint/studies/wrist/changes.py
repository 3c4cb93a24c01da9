"""What an instrument that changed after its calibration costs, what shows it, and a zero anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.estimators.cable_filter import CableStates
from truejoint.models.features import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.recordings.wrist import record_wrist
from truejoint.robots.joint_rows import SETPOINT_DT
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.twin import TwinOutput, glide, hold
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
_STOPS: Final = ((0, -1.0), (0, 1.0), (1, -1.0), (2, 1.0))  # joints, and which way they come
_SHORT: Final = 0.25  # [rad] from the limit where they begin to,
_COMING: Final = 0.1  # [rad/s]
_BEYOND: Final = 0.19  # [rad] beyond which no set-point goes
_PRESS: Final = 0.03  # [Nm] more than on the way there
_GRAIN: Final = 20  # [ms] in which the torque is looked at
_FREE: Final = 60  # of these pieces, the second half of which tells the torque on the way
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
    free = motions.record(twin, motions.paused_sines, free_s, seed, load=False)
    loaded = motions.record(twin, motions.paused_sines, loaded_s, seed + 1, load=True)
    model = calibrate([free, loaded], "hybrid_cables", joints=JOINTS)
    tests, checks = {NOTHING + ", closing": closing(twin)}, {}
    stops = {NOTHING: touched(twin)}
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
            stops[ENGAGED] = touched(other)
        tests[name] = motions.record(other, motions.steps, test_s, seed + 2, load=True)
        checks[name] = motions.record(other, motions.paused_sines, _CHECK, seed + 3, load=False)
        if name == GAIN:
            tests[name], checks[name] = (amplified(run, 1.1) for run in (tests[name], checks[name]))
    known = {name: told(model, test) for name, test in tests.items()}
    strange = strangeness(free, checks)
    errors = {}
    for name in CHANGES:
        test = tests[name]
        rows = test.t - test.t[0] > SETTLED
        off = (known[name].angle - test.columns("truth_exact", JOINTS))[rows]
        errors[name] = {
            "angle": rms(off),
            "grip": rms((known[name].load - test.columns("truth_load", LOADS))[rows])[0],
            "mean": off.mean(axis=0).tolist(),
            "strange": strange[name],
        }
    before, after = (closed_opening(known[f"{name}, closing"]) for name in (NOTHING, ENGAGED))
    moved = (stops[ENGAGED] - stops[NOTHING]).tolist()
    zeros = {"opening": after - before, "stops": moved}
    return PartResult({"family": family, "errors": errors, **zeros})


def told(model: Calibration, recording: Recording) -> CableStates:
    """Say what a calibration by a filter of the cables tells of joints and loads."""
    gap = model.gap_limit
    found: CableStates = model.model.states(
        model.feature_set.compute(recording, gap), time_steps(recording.t, gap)
    )
    return found


def touched(twin: WristTwin) -> Array:
    """Measured joints (3,) [rad] at stops: the pitch between both, each jaw outside."""
    low, high, *jaws = (stop(twin, k, way) for k, way in _STOPS)
    return np.array([0.5 * (low + high), *jaws])


def stop(twin: WristTwin, k: int, way: float) -> float:
    """Measured angle [rad] of joint `k` at its stop, the upper one for a `way` of 1, lower for -1.

    It goes on until its torque is larger than on the way there by `_PRESS`, and back. A line
    through torque and angle tells where it was half of that.
    """
    limit = twin.robot.upper if way > 0.0 else twin.robot.lower
    transmission = twin.robot.transmission
    assert transmission is not None  # noqa: S101  # a robot of cables has one
    pose = np.array([0.0, -0.5 * _OPEN, 0.5 * _OPEN])
    if k > 0:
        pose[1:] = limit[k] - way * (_SHORT + _OPEN)  # the other jaw stays behind
    pose[k] = limit[k] - way * _SHORT
    twin.run(glide(twin.commanded, pose, 2.0))
    far = way * _COMING * SETPOINT_DT * np.arange(1, _GRAIN + 1)
    ahead = np.outer(far, np.eye(len(pose))[k])
    runs: list[TwinOutput] = []

    def torque(run: TwinOutput) -> Array:
        return np.asarray(way * (run.effort @ transmission.matrix)[:, k])

    usual = 0.0
    while way * (twin.commanded - limit)[k] < _BEYOND:
        runs.append(twin.run(twin.commanded + ahead))
        if len(runs) == _FREE:
            usual = float(np.mean([torque(run).mean() for run in runs[_FREE // 2 :]]))
        if len(runs) > _FREE and torque(runs[-1]).mean() - usual > _PRESS:
            break
    twin.run(glide(twin.commanded, pose, 1.0))
    pressed = np.concatenate([torque(run) for run in runs]) - usual
    angle = np.concatenate([run.measured[:, k] for run in runs])
    felt = pressed > 0.25 * _PRESS
    slope, at = np.polyfit(pressed[felt], angle[felt], 1)
    return float(at + 0.5 * slope * _PRESS)


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


def closed_opening(found: CableStates) -> float:
    """Give the opening [rad] at which jaws begin to press on each other, by what is known of both.

    Jaws give way as they press, by how much depends on where the zeros are; so it is that of a line
    through their opening over their grip, closing and opening, where there is none.
    """
    grip = found.load[:, 0]
    pressed = grip > _FELT
    opening = (found.angle[:, 2] - found.angle[:, 1])[pressed]
    rows = np.column_stack([np.ones(len(opening)), grip[pressed]])
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
    zero = _zero_table(numbers)
    place = np.arange(len(CHANGES))
    curves = [
        Curve(np.array(middle)[:, j], place, joint, f"C{j}", "o") for j, joint in enumerate(JOINTS)
    ]
    panel = Panel(curves, "median RMS error under loads [deg]", rows=list(CHANGES))
    figure = Figure("Changed after the calibration", ((panel,),), notes[0], height=3.6, legend=True)
    table = Table("Changed after the calibration", header, tuple(rows), notes)
    return Summary((table, zero), {"wrist-changes": figure})


def _zero_table(numbers: Sequence[Mapping[str, Any]]) -> Table:
    """How far engaging anew moved the errors, and what each way to a zero leaves of that."""
    means = np.array([[n["errors"][name]["mean"] for name in (NOTHING, ENGAGED)] for n in numbers])
    moved = means[:, 1] - means[:, 0]
    left = moved - np.array([n["stops"] for n in numbers])
    opening = moved[:, 2] - moved[:, 1]
    closed = opening - np.array([n["opening"] for n in numbers])

    def cell(values: Array) -> str:
        found = np.abs(np.degrees(values))
        return f"{np.median(found):.3f} ({found.max():.3f})"

    rows = (
        ("as engaged", *map(cell, moved.T), cell(opening)),
        ("after touching their stops", *map(cell, left.T), cell(left[:, 2] - left[:, 1])),
        ("after closing the jaws on themselves", *["-"] * len(JOINTS), cell(closed)),
    )
    notes = (
        "How far, in degrees, the mean errors are from those before; the worst in brackets. Joints "
        "that press on the stops at the ends of their ranges, as lightly as they did after "
        "calibration, measure there by how much their zeros have moved. Jaws that begin to press "
        "on each other are at the opening at which they did then: a line through opening over grip "
        "tells it.",
    )
    return Table("Engaged anew", ("", *JOINTS, "opening"), rows, notes)
