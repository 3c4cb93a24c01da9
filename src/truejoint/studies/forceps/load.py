"""The external load that the estimators see, its dead band, and what one known weight mends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from truejoint.estimators import calibrate
from truejoint.estimators.forceps import FrictionFilter, JawLoad, Stiffness, identify_stiffness
from truejoint.estimators.sequence import time_steps
from truejoint.evaluation.digits import fixed
from truejoint.recordings import Recording
from truejoint.simulation.forceps_load import GRAVITY, LoadTest
from truejoint.simulation.forceps_parameters import ForcepsParameters
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.loaded import cases
from truejoint.studies.forceps.methods import settled
from truejoint.studies.forceps.motions import (
    Direction,
    Plain,
    built,
    plain_specimen,
    record,
    title_of,
)
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table

Array = NDArray[np.float64]

CALIBRATION_WEIGHT: Final = 0.2
"""Known weight that identifies the stiffness, hung along the motion [kg]."""
_ESTIMATES: Final = {
    "assumed": "K_d assumed",
    "identified": "K_d identified",
    "filtered": "filter, K_d identified",
}


@dataclass(frozen=True, eq=False)
class _Scales:
    """What weighs: with the stiffness assumed, with that found, and the filter with that found."""

    assumed: JawLoad
    identified: JawLoad
    filtered: FrictionFilter
    stiffness: Stiffness


def parts(settings: Settings) -> Sequence[Part]:
    """One that finds the stiffness, and one a weight and direction."""
    common = {"forceps": plain_specimen(settings["specimen"]), "seed": settings.seed}
    weights = [Part(key, weigh, {**common, **case}) for key, case in cases(settings).items()]
    return (Part("stiffness", identify, common), *weights)


def signals(recording: Recording) -> tuple[Array, Array]:
    """Motor angle [rad] and ``x2`` [m] (n, 2), and time since the row before (n,) [s]."""
    rows = np.column_stack([recording.column(name) for name in JawLoad.inputs])
    return rows, time_steps(recording.t, np.inf)


@lru_cache(maxsize=2)
def unloaded_load(forceps: ForcepsParameters, seed: int) -> JawLoad:
    """Load estimate of a specimen, with an assumed stiffness, fitted to (27) without a load."""
    calibration = settled(record(forceps, "calibration", seed=2 * seed))
    X, steps = signals(calibration)
    return JawLoad(mechanism=forceps.mechanism).fit(X, calibration.column("truth/jaw"), steps)


@lru_cache(maxsize=2)
def _scales(forceps: ForcepsParameters, seed: int) -> _Scales:
    assumed = unloaded_load(forceps, seed)
    test = LoadTest(CALIBRATION_WEIGHT, "along")
    hung = record(forceps, "load", load=test.mass, direction="along", seed=100 * seed + 99)
    still = {phase: _rows(hung, test, phase) for phase in ("II", "IV")}
    torque = float(hung.column("truth_load/jaw")[still["IV"]].mean())
    X, steps = signals(hung)
    found = identify_stiffness(assumed, X, still["II"], still["IV"], torque, steps)
    model = FrictionFilter(drive_stiffness=found.drive_stiffness)
    calibration = calibrate(settled(record(forceps, "calibration", seed=2 * seed)), model)
    fitted = cast("FrictionFilter", calibration.model)
    return _Scales(assumed, assumed.with_stiffness(found.drive_stiffness), fitted, found)


def _rows(recording: Recording, test: LoadTest, phase: str) -> NDArray[np.bool_]:
    first, last = test.phases[phase]
    return np.asarray((recording.t >= first) & (recording.t <= last))


def identify(forceps: Plain, seed: int) -> PartResult:
    """Find the drive cable's stiffness, and what the jaw's friction hides."""
    plant = built(forceps)
    scales = _scales(plant, seed)
    numbers = {
        "arm": plant.jaw.load_arm,
        "stiffness": vars(scales.stiffness),
        "dead_band": scales.identified.dead_band,
    }
    return PartResult(numbers)


def weigh(forceps: Plain, seed: int, mass: float, direction: str, hand: int) -> PartResult:
    """Estimate one hung weight: mean torques [Nm] while it hangs still."""
    plant = built(forceps)
    scales = _scales(plant, seed)
    test = LoadTest(mass, cast("Direction", direction))
    hung = record(plant, "load", load=mass, direction=direction, seed=hand)
    X, steps = signals(hung)
    torques = {
        "torque": hung.column("truth_load/jaw"),
        "assumed": scales.assumed.predict(X, steps),
        "identified": scales.identified.predict(X, steps),
        "filtered": scales.filtered.states(X, steps).load,
    }
    still = _rows(hung, test, "IV")
    means = {name: float(values[still].mean()) for name, values in torques.items()}
    return PartResult({"mass": mass, "direction": direction, **means})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """List loads as they are and as they are estimated, in mNm and grams."""
    name, found = title_of(settings["specimen"]), results["stiffness"].numbers
    weighed = [result.numbers for key, result in results.items() if key != "stiffness"]
    newton_metres_per_gram = 1e-3 * GRAVITY * float(found["arm"])

    def grams(torque: float) -> float:
        return torque / newton_metres_per_gram

    rows = tuple(
        (
            f"{1e3 * case['mass']:.0f} g {case['direction']}",
            *(
                f"{fixed(1e3 * case[key], 1)} ({fixed(grams(case[key]), 0)})"
                for key in ("torque", *_ESTIMATES)
            ),
        )
        for case in weighed
    )
    stiffness, dead_band = found["stiffness"], found["dead_band"]
    notes = (
        f"Torque in mNm (grams at {1e3 * found['arm']:.1f} mm). Identified with "
        f"{1e3 * CALIBRATION_WEIGHT:.0f} g along the motion: K_d = "
        f"{stiffness['drive_stiffness'] / 1e3:.1f} +- {stiffness['deviation'] / 1e3:.1f} kN/m, "
        f"{stiffness['ratio']:.2f} of the assumed.",
        f"Dead band: up to {1e3 * dead_band:.1f} mNm ({grams(dead_band):.0f} "
        "g) against the last motion may not show, since the jaw's friction holds them.",
    )
    numbers = {
        "specimen": name,
        "arm_mm": 1e3 * found["arm"],
        "stiffness": stiffness,
        "dead_band_mNm": 1e3 * dead_band,
        "dead_band_g": grams(dead_band),
        "estimates": weighed,
    }
    return Summary(
        (
            Table(
                f"External load, specimen {name}",
                ("load", "true", *_ESTIMATES.values()),
                rows,
                notes,
            ),
        ),
        numbers,
        {"forceps-load": _figure(weighed, name)},
    )


def _figure(weighed: Sequence[Mapping[str, Any]], name: str) -> Figure:
    panels = []
    for direction in dict.fromkeys(case["direction"] for case in weighed):
        own = sorted(
            (case for case in weighed if case["direction"] == direction), key=lambda c: c["mass"]
        )
        true = 1e3 * np.array([case["torque"] for case in own])
        curves = [
            Curve(true, 1e3 * np.array([case[key] for case in own]), label, style="o-")
            for key, label in _ESTIMATES.items()
        ]
        equal = Curve(true, true, "as it is", "k", width=0.8)
        panels.append(
            Panel([equal, *curves], "true torque [mNm]", "estimate [mNm]", f"load {direction}")
        )
    caption = (
        "Torque of each weight while it hangs still. Against the motion the jaw's friction holds "
        "part of it, which no estimate sees."
    )
    return Figure(f"External load, specimen {name}", (panels,), caption, height=4.4, legend=True)
