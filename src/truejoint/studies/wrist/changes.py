"""What an instrument that changed after its calibration costs, what shows it, and a zero anew."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from pandas import DataFrame
from sklearn.base import clone

from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.features.feature_set import FeatureSet, default_gap_limit, time_steps
from truejoint.recordings import Recording
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.twin import glide
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import Cell, ecdf_figure, frame_table, select, table_of
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.wrist import motions
from truejoint.studies.wrist.accuracy import (
    LOADS,
    METHODS,
    SETTLED,
    by_joint,
    check_times,
    joint_medians,
    rms,
    specimens,
    worst,
)
from truejoint.tables import Table, median_text

NOTHING: Final = "nothing"
GAIN: Final = "effort gain + 10 %"
ENGAGED: Final = "engaged anew"
TOUCHED: Final = "stops touched"
STOPS: Final = ("pitch_stop", "jaw1_stop", "jaw2_stop", "opening_stop")
"""By how much engaging anew moved what the joints measure at their stops [rad]."""
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
_OPEN: Final = 0.2  # [rad] of the jaws that come to a stop
_SHORT: Final = 0.25  # [rad] before it,
_FAR: Final = 0.44  # [rad] in which they meet it, or are said to,
_COMING: Final = 0.1  # [rad/s]
_PRESS: Final = 0.03  # [Nm] more than on the way there
_GRAIN: Final = 20  # [ms] in which the torque is looked at
_FREE: Final = 60  # of these pieces, the second half of which tells the torque on the way


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_times(settings)
    return specimens(settings, judge, "free_s", "loaded_s", "test_s")


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    number: int,
    free_s: float,
    loaded_s: float,
    test_s: float,
) -> Rows:
    """Errors after each change, of a calibration from before, and the misfit of its efforts."""
    plant, seed = WristParameters.from_dict(specimen), 5 * number
    twin = WristTwin(plant, seed=number)
    free, loaded = motions.calibrating(twin, free_s, loaded_s, seed)
    model = calibrate([free, loaded], "hybrid_cables", joints=JOINTS)
    tests, checks, stops = {}, {}, {NOTHING: touched(twin)}
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
            stops[ENGAGED] = touched(other)
        tests[name] = motions.record(other, motions.steps, test_s, seed + 2, load=True)
        checks[name] = motions.record(other, motions.paused_sines, _CHECK, seed + 3, load=False)
        if name == GAIN:
            for runs in (tests, checks):
                efforts = {f"effort/{j}": 1.1 * runs[name].column(f"effort/{j}") for j in JOINTS}
                runs[name] = replace(runs[name], table=runs[name].table.assign(**efforts))
    strange = strangeness(free, checks)
    rows: Rows = []
    for name, test in tests.items():
        settled = test.t - test.t[0] > SETTLED
        gap = model.gap_limit
        states = model.model.states(model.feature_set.compute(test, gap), time_steps(test.t, gap))
        off = (states.angle - test.columns("truth_exact", JOINTS))[settled]
        load = (states.load - test.columns("truth_load", LOADS))[settled]
        rows.append(
            {"changed": name, **by_joint(rms(off)), **by_joint(off.mean(axis=0).tolist(), "_mean"),
             "grip": rms(load)[0], "strange": strange[name]}
        )  # fmt: skip
    moved = zip(STOPS, (stops[ENGAGED] - stops[NOTHING]).tolist(), strict=True)
    return [*rows, {"changed": TOUCHED, **dict(moved)}]


def touched(twin: WristTwin) -> Array:
    """Measured joints (3,) [rad] at stops, the pitch between both, and opening of jaws that meet.

    Of a jaw the stop outside, to which the other one comes less near.
    """
    lower, upper, opposite = twin.robot.lower, twin.robot.upper, np.array([0.0, -0.5, 0.5])
    pitch, first, second = np.eye(3)
    low = stop(twin, (lower[0] + _SHORT) * pitch + _OPEN * opposite, -pitch)
    high = stop(twin, (upper[0] - _SHORT) * pitch + _OPEN * opposite, pitch)
    left = stop(twin, (lower[1] + _SHORT) * (first + second) + _OPEN * second, -first)
    right = stop(twin, (upper[2] - _SHORT) * (first + second) - _OPEN * first, second)
    return np.array([0.5 * (high - low), -left, right, -stop(twin, _SHORT * opposite, -opposite)])


def stop(twin: WristTwin, pose: Array, way: Array) -> float:
    """How far along a `way` (3,) measured joints are where something stops them, from `pose` on.

    They go on until the torque along the way has grown by `_PRESS`, and back. A line through torque
    and joints tells where it was half of that.
    """
    transmission = twin.robot.transmission
    assert transmission is not None  # noqa: S101  # a robot of cables has one
    twin.run(glide(twin.commanded, pose, 2.0))
    ahead = np.outer(_COMING * SETPOINT_DT * np.arange(1, _GRAIN + 1), way)
    torque, joints, usual = np.zeros(0), np.zeros((0, 3)), 0.0
    for n in range(round(_FAR / (_COMING * SETPOINT_DT * _GRAIN))):
        run = twin.run(twin.commanded + ahead)
        torque = np.append(torque, run.effort @ transmission.matrix @ way)
        joints = np.vstack([joints, run.measured])
        if n == _FREE:
            usual = float(torque[len(torque) // 2 :].mean())
        if n > _FREE and torque[-_GRAIN:].mean() - usual > _PRESS:
            break
    twin.run(glide(twin.commanded, pose, 1.0))
    pressed = torque - usual
    felt = pressed > 0.25 * _PRESS
    along = joints[felt] @ way / (way @ way)
    slope, at = np.polyfit(pressed[felt], along, 1)
    return float(at + 0.5 * slope * _PRESS)


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
    taught = free.t - free.t[0] < last
    X, efforts = features.compute(free, gap), free.columns("effort", JOINTS)
    dt = time_steps(free.t, gap)
    model = clone(METHODS["play_motor"].estimator).fit(X[taught], efforts[taught], dt=dt[taught])
    usual = size(free, last)
    return {
        name: float(np.abs(size(run, SETTLED) / usual - 1.0).max()) for name, run in checks.items()
    }


def summarise(results: Results) -> Summary:
    """Medians over the specimens by change, and what each way to a zero leaves."""
    rows = results.rows[results.rows.changed != TOUCHED]
    cells: dict[str, Cell] = {
        "pitch jaw1 jaw2": lambda group: joint_medians(group, 2),
        "worst": worst,
        "grip [mNm]": lambda group: f"{1e3 * group.grip.median():.1f}",
        "efforts differ by": lambda group: f"{100 * group.strange.median():.1f} %",
        "flagged": lambda group: f"{100 * np.mean(group.strange > FLAGGED):.0f} %",
    }
    notes = (
        "RMS error in degrees under loads, of the filter with plays that was calibrated before "
        f"the change: medians of {len(results.arrays)} specimens of seed {results.settings.seed}. "
        f"Efforts in {_CHECK:g} s of free motion are compared with those that such a motion took "
        "in calibration; the motor that differs most counts, and is flagged from "
        f"{FLAGGED:.0%} on.",
    )
    title = "Changed after the calibration"
    table = table_of(title, rows, "changed", cells, notes)
    errors = rows.melt(["changed"], list(JOINTS), "joint", "rms")
    caption = "Share of all specimens with a smaller error under loads, by joint and change."
    figure = ecdf_figure(title, errors, "changed", "joint", caption)
    return Summary((table, _zero_table(results.rows)), {"wrist-changes": figure})


def _zero_table(rows: DataFrame) -> Table:
    """How far engaging anew moved the errors, and what each way to a zero leaves of that."""
    means: DataFrame = rows.set_index(["changed", "specimen"])[
        [f"{joint}_mean" for joint in JOINTS]
    ]
    moved: Any = (means.loc[ENGAGED] - means.loc[NOTHING]).set_axis(list(JOINTS), axis=1)
    stops = select(rows, changed=TOUCHED).set_index("specimen")[list(STOPS)]
    left = moved - stops[list(STOPS[:3])].to_numpy()
    opening, remaining = moved.jaw2 - moved.jaw1, left.jaw2 - left.jaw1
    closed = moved.assign(opening=opening - stops[STOPS[3]]) * [np.nan, np.nan, np.nan, 1.0]
    ways = {
        "as engaged": moved.assign(opening=opening),
        "after touching their stops": left.assign(opening=remaining),
        "after closing the jaws on themselves": closed,
    }
    table = DataFrame(
        {
            name: (np.rad2deg(1.0) * off.abs()).apply(
                lambda column: median_text(column.dropna(), 3)
            )
            for name, off in ways.items()
        }
    ).T
    note = (
        "How far, in degrees, the mean errors are from those before; the worst in brackets. Joints "
        "that press on their stops, or jaws on each other, as lightly as they did after "
        "calibration, measure there by how much their zeros have moved."
    )
    return frame_table("Engaged anew", table, (note,))
