"""The external load that the filter sees, what friction hides of it, and the cable's stiffness."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.calibration import calibrate
from truejoint.drawing import Curve, Figure, Panel
from truejoint.estimators.jaw.learn import JawFilter
from truejoint.estimators.jaw_load.learn import FrictionFilter
from truejoint.estimators.jaw_load.stiffness import identify_stiffness
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters, friction_at_pretension
from truejoint.studies.forceps.loaded import cases, load_test
from truejoint.studies.forceps.methods import settled, within
from truejoint.studies.forceps.motions import Plain, built, drawn_specimens, record
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.tables import Table, fixed
from truejoint.units import GRAVITY

CALIBRATION_WEIGHTS: Final = (0.1, 0.2, 0.25)
"""Known weights that identify the stiffness, each hung once each way [kg]."""
ROCK: Final = math.radians(10.0)
"""By how much the jaw goes back and forth under each of them."""
_CYCLES: Final = 3
LEVEL: Final = 1.645
"""Deviations on either side that hold 90 % of a normal distribution."""
_ESTIMATES: Final = {"assumed": "K_d assumed", "identified": "K_d identified"}
_CASES: Final = ("unloaded", "along", "opposing")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    hung, motion = list(cases(settings).values()), settings["motion"]
    return [
        Part(name, weigh, {"forceps": plant, "seed": seed, "motion": motion, "hung": hung})
        for name, plant, seed in drawn_specimens(settings)
    ]


def signals(recording: Recording) -> tuple[Array, Array]:
    """Motor angle [rad] and ``x2`` [m] (n, 2), and time since the row before (n,) [s]."""
    inputs = FrictionFilter.family.inputs
    rows = np.column_stack([recording.column(name) for name in (inputs({}) if inputs else ())])
    return rows, time_steps(recording.t, np.inf)


def unloaded_filter(
    forceps: ForcepsParameters, seed: int, motion: str = "calibration"
) -> FrictionFilter:
    """Fit the filter of a specimen to a motion without a load; its stiffness is assumed."""
    recording = settled(record(forceps, motion, seed=2 * seed))
    return cast("FrictionFilter", calibrate(recording, FrictionFilter()).model)


def effective_stiffness(forceps: ForcepsParameters) -> float:
    """Stiffness [N/m] at the pretension of the drive cable and the gear behind it.

    Of the cable what is left once its Bouc-Wen element has yielded, as under any weight.
    """
    cable = forceps.drive_cable.elastic_share * forceps.drive_cable.stiffness
    gear = forceps.assembly.gear_stiffness / forceps.mechanism.wheel_radius**2
    return 1.0 / (1.0 / cable + 1.0 / gear)


def hidden_friction(forceps: ForcepsParameters) -> float:
    """Friction [Nm] of the jaw and of the drive cable's guide, at the pretension and the jaw."""
    guide = math.expm1(forceps.drive_cable.guide_friction) * forceps.assembly.pretension
    return friction_at_pretension(forceps)[0] + guide * forceps.mechanism.jaw_radius


def slack_torque(forceps: ForcepsParameters, angle: float) -> float:
    """Torque [Nm] that opens the jaw at an angle [rad] so far that the drive cable is slack."""
    mechanism = forceps.mechanism
    spring = mechanism.spring_stiffness * mechanism.jaw_radius * angle
    return (forceps.assembly.pretension + spring) * mechanism.jaw_radius


def rocking_test(mass: float, way: str) -> LoadTest:
    """Load test of a weight [kg] at twice the paper's speed, under which the jaw then rocks."""
    speed, quick = math.radians(3.75), {"start": 1.0, "loaded_from": 10.0, "loaded_to": 12.5}
    end = 14.0 + _CYCLES * 2.0 * ROCK / speed
    return LoadTest(mass, cast("Any", way), speed=speed, **quick, end=end, rock=ROCK)


def weigh(forceps: Plain, seed: int, motion: str, hung: Sequence[Mapping[str, Any]]) -> PartResult:
    """Find the stiffness of a specimen by known weights, and estimate others on it."""
    plant = built(forceps)
    assumed, known = unloaded_filter(plant, seed, motion), []
    for n, (mass, way) in enumerate(product(CALIBRATION_WEIGHTS, ("along", "opposing"))):
        test = rocking_test(mass, way)
        run = record(plant, test, seed=100 * seed + 99 - n)
        hangs = within(run.t, *test.phases["IV"])
        torque = np.where(hangs, run.column("truth_load/jaw"), np.nan)
        if float(np.nanmax(torque)) <= slack_torque(plant, test.angle - test.rock):
            known.append((*signals(run), torque))
    X, dt, torque = (np.concatenate(columns) for columns in zip(*known, strict=True))
    found = identify_stiffness(assumed, X, torque, dt)
    identified = assumed.with_stiffness(found)
    weighed, slack = [], []
    judged: dict[str, list[dict[str, float]]] = {}
    for case in hung:
        test = load_test(case["mass"], case["direction"])
        run = record(plant, test, seed=case["hand"])
        still = within(run.t, *test.phases["IV"])
        if float(run.column("truth_load/jaw")[still].mean()) > slack_torque(plant, test.angle):
            slack.append(case)
            continue
        own = _judged(identified, run, still)
        judged.setdefault(case["direction"], []).append(own)
        tried = assumed.states(*signals(run)).load[still]
        weighed.append({**case, **own, "assumed": float(tried.mean())})
    run = settled(record(plant, "verification", seed=2 * seed + 1))
    paper = _paper_filter(plant, seed, motion, run)
    judged["unloaded"] = [_judged(identified, run, np.isfinite(run.column("truth/jaw")))]
    return PartResult(
        {
            **vars(found),
            "true_stiffness": effective_stiffness(plant),
            "friction": identified.jaw_friction,
            "true_friction": hidden_friction(plant),
            "arm": plant.jaw.load_arm,
            "weighed": weighed,
            "slack": slack,
            "judged": judged,
            "paper": paper,
        }
    )


def _paper_filter(
    plant: ForcepsParameters, seed: int, motion: str, run: Recording
) -> dict[str, float]:
    """How the covariance of yan2020's filter stands to its errors (NEES) and innovations (NIS)."""
    recording = settled(record(plant, motion, seed=2 * seed))
    model = cast("JawFilter", calibrate(recording, JawFilter(compensated=True)).model)
    X, dt = signals(run)
    known = np.isfinite(run.column("truth/jaw"))
    states = model.states(X, dt)
    error = (model.evaluate(X, dt)[:, 0] - run.column("truth/jaw"))[known]
    ratio = error / np.sqrt(states.P[known, 0, 0])
    return {
        "angle_inside": float(np.mean(np.abs(ratio) <= LEVEL)),
        "angle_nees": float(np.mean(ratio**2)),
        "nis": float(np.nanmean(states.nis[known])) / 2.0,  # of two measurements
    }


def _judged(model: FrictionFilter, run: Recording, rows: Mask) -> dict[str, float]:
    """Load and angle of some rows of a run, and how they stand to what is stated of them."""
    states = model.states(*signals(run))
    load = states.load - run.column("truth_load/jaw")
    angle = states.angle - run.column("truth/jaw")
    pairs = {"load": (load, states.load_deviation), "angle": (angle, states.angle_deviation)}
    found = {
        "torque": float(run.column("truth_load/jaw")[rows].mean()),
        "identified": float(states.load[rows].mean()),
        "stated": LEVEL * float(states.load_deviation[rows].mean()),
    }
    for name, (error, deviation) in pairs.items():
        ratio = (error / deviation)[rows]
        found |= {
            f"{name}_rms": float(np.sqrt(np.mean(error[rows] ** 2))),
            f"{name}_inside": float(np.mean(np.abs(ratio) <= LEVEL)),
            f"{name}_nees": float(np.mean(ratio**2)),
        }
    return found


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """List the loads of the first specimen, and errors and coverage over all."""
    numbers = [result.numbers for result in results.values()]
    first = next(iter(results))
    tables = (_weights(first, numbers[0]), _population(settings, numbers))
    return Summary(tables, {"forceps-load": _figure(numbers)})


def _grams(numbers: Mapping[str, Any], torque: float) -> float:
    return 1e3 * torque / (GRAVITY * float(numbers["arm"]))


def _weights(name: str, found: Mapping[str, Any]) -> Table:
    """Each weight as it is, as it is estimated, and what is stated of it."""
    rows = []
    for case in found["weighed"]:
        torques = [case[key] for key in ("torque", *_ESTIMATES, "stated")]
        cells = [f"{fixed(1e3 * v, 1)} ({fixed(_grams(found, v), 0)})" for v in torques]
        load = f"{1e3 * case['mass']:.0f} g {case['direction']}"
        rows.append((load, *cells, f"{100 * case['load_inside']:.0f} %"))
    friction = [_text(found, 2.0 * found[key]) for key in ("friction", "true_friction")]
    notes = [
        f"Torque in mNm (grams at {1e3 * found['arm']:.1f} mm), still under the weight. Identified"
        f" with {', '.join(f'{1e3 * mass:.0f}' for mass in CALIBRATION_WEIGHTS)} g each way, "
        "but where the drive cable is slack: "
        f"K_d = {found['drive_stiffness'] / 1e3:.1f} +- {found['deviation'] / 1e3:.1f} kN/m, "
        f"growing by {found['growth']:.0f} N/m per N; cable and gear have "
        f"{found['true_stiffness'] / 1e3:.1f}.",
        f"Dead band: up to {friction[0]} against the last motion may not show, since the jaw's "
        f"friction holds them; in truth {friction[1]}.",
    ]
    if found["slack"]:
        left = ", ".join(f"{1e3 * c['mass']:.0f} g {c['direction']}" for c in found["slack"])
        notes.append(f"Left out, since the drive cable is slack under it: {left}.")
    header = ("load", "true", *_ESTIMATES.values(), "stated 90 %", "inside")
    return Table(f"External load, {name}", header, tuple(rows), tuple(notes))


def _text(found: Mapping[str, Any], torque: float) -> str:
    return f"{1e3 * torque:.1f} mNm ({_grams(found, torque):.0f} g)"


def errors_in_grams(found: Mapping[str, Any], way: str) -> float:
    """RMS [g] of what the mean estimate is off by, over the weights one way; NaN without any."""
    off = [c["identified"] - c["torque"] for c in found["weighed"] if c["direction"] == way]
    return _grams(found, math.sqrt(float(np.mean(np.square(off))))) if off else math.nan


def floor_in_grams(found: Mapping[str, Any]) -> float:
    """RMS [g] of an estimate that sees all but what friction may hide: 0 to twice its size."""
    return _grams(found, 2.0 * float(found["true_friction"]) / math.sqrt(3.0))


def _population(settings: Settings, numbers: Sequence[Mapping[str, Any]]) -> Table:
    """Quantiles over the specimens, and how often what is stated holds."""
    stiffness = np.array(
        [100.0 * (n["drive_stiffness"] / n["true_stiffness"] - 1) for n in numbers]
    )
    measures = {
        "stiffness off by [%]": np.abs(stiffness),
        "load along, RMS [g]": np.array([errors_in_grams(n, "along") for n in numbers]),
        "load opposing, RMS [g]": np.array([errors_in_grams(n, "opposing") for n in numbers]),
        "its floor by friction [g]": np.array([floor_in_grams(n) for n in numbers]),
    }
    rows = []
    for label, values in measures.items():
        known = values[np.isfinite(values)]
        quantiles = np.quantile(known, [0.5, 0.95, 1.0]) if len(known) else [math.nan] * 3
        rows.append((label, *(fixed(float(value), 1) for value in quantiles), ""))
    for kind in ("load", "angle"):
        for case in _CASES:
            own = [j for n in numbers for j in n["judged"].get(case, ())]
            if own:
                inside = 100.0 * float(np.mean([j[f"{kind}_inside"] for j in own]))
                nees = float(np.mean([j[f"{kind}_nees"] for j in own]))
                label = f"stated 90 % of the {kind}, {case}"
                rows.append((label, "", "", "", f"{inside:.0f} % inside, NEES {nees:.2f}"))
    paper = {key: np.array([n["paper"][key] for n in numbers]) for key in numbers[0]["paper"]}
    text = (
        f"{100 * paper['angle_inside'].mean():.0f} % inside, "
        f"NEES {paper['angle_nees'].mean():.1f}, "
        f"NIS per measurement {np.median(paper['nis']):.1f} (median)"
    )
    rows.append(("the same of the paper's filter (26), unloaded", "", "", "", text))
    floors = measures["its floor by friction [g]"]
    below = float(np.mean(measures["load opposing, RMS [g]"] <= floors))
    slack = sum(len(n["slack"]) for n in numbers)
    notes = (
        f"{len(numbers)} specimens of seed {settings.seed}. Weights "
        f"{', '.join(f'{mass:g}' for mass in settings['masses_g'])} g; still under each. The floor "
        "is of an estimate that sees all but what jaw and guide may hide, evenly from nothing "
        f"to twice its size; opposing is no worse in {100 * below:.0f} %.",
        f"Stiffness within 5 % in {100 * float(np.mean(np.abs(stiffness) <= 5.0)):.0f} %. "
        f"Left out, since the drive cable is slack under it: {slack} weights.",
    )
    header = ("", "median", "95 %", "worst", "stated")
    return Table("External load over the specimens", header, tuple(rows), notes)


def _figure(numbers: Sequence[Mapping[str, Any]]) -> Figure:
    panels = []
    for way in ("opposing", "along"):
        own = [(n, c) for n in numbers for c in n["weighed"] if c["direction"] == way]
        if not own:
            continue
        true = np.array([_grams(n, c["torque"]) for n, c in own])
        curves = [Curve(np.sort(true), np.sort(true), "as it is", "k")]
        for key, label in _ESTIMATES.items():
            shown = np.array([_grams(n, c[key]) for n, c in own])
            curves.append(Curve(true, shown, label, style="."))
        panels.append(Panel(curves, "true load [g]", "estimate [g]", f"load {way}"))
    caption = (
        "Each weight while it hangs still. Against the motion the jaw's friction hides part of it, "
        "which no estimate sees."
    )
    return Figure("External load", (panels,), caption, height=4.4, legend=True)
