"""The external load that the estimators see, its dead band, and what one known weight mends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.estimators.friction_filter import FrictionFilter
from truejoint.estimators.jaw_load import JawLoad, Stiffness, identify_stiffness
from truejoint.evaluation.digits import fixed
from truejoint.models.features import time_steps
from truejoint.recordings import Recording
from truejoint.simulation.forceps.load import GRAVITY
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.loaded import cases, load_test
from truejoint.studies.forceps.methods import settled, within
from truejoint.studies.forceps.motions import Plain, built, plain_specimen, record, title_of
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table

CALIBRATION_WEIGHT: Final = 0.2
"""Known weight that identifies the stiffness, hung along the motion [kg]."""
_ESTIMATES: Final = {
    "assumed": "K_d assumed",
    "identified": "K_d identified",
    "filtered": "filter, K_d identified",
}


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
    X, dt = signals(calibration)
    return JawLoad(mechanism=forceps.mechanism).fit(X, calibration.column("truth/jaw"), dt)


@lru_cache(maxsize=2)
def _scales(forceps: ForcepsParameters, seed: int) -> tuple[Stiffness, JawLoad, FrictionFilter]:
    """Stiffness found by the known weight, and the two estimates that know it."""
    assumed, test = unloaded_load(forceps, seed), load_test(CALIBRATION_WEIGHT, "along")
    hung = record(forceps, test, seed=100 * seed + 99)
    still = {phase: within(hung.t, *test.phases[phase]) for phase in ("II", "IV")}
    torque = float(hung.column("truth_load/jaw")[still["IV"]].mean())
    X, dt = signals(hung)
    found = identify_stiffness(assumed, X, still["II"], still["IV"], torque, dt)
    model = FrictionFilter(drive_stiffness=found.drive_stiffness)
    calibration = calibrate(settled(record(forceps, "calibration", seed=2 * seed)), model)
    identified = assumed.with_stiffness(found.drive_stiffness)
    return found, identified, cast("FrictionFilter", calibration.model)


def identify(forceps: Plain, seed: int) -> PartResult:
    """Find the drive cable's stiffness [N/m], and the torque that the jaw's friction hides [Nm]."""
    plant = built(forceps)
    found, load, _ = _scales(plant, seed)
    return PartResult({**vars(found), "dead_band": load.dead_band, "arm": plant.jaw.load_arm})


def weigh(forceps: Plain, seed: int, mass: float, direction: str, hand: int) -> PartResult:
    """Estimate one hung weight: mean torques [Nm] while it hangs still."""
    plant, test = built(forceps), load_test(mass, direction)
    _, identified, filtered = _scales(plant, seed)
    hung = record(plant, test, seed=hand)
    X, dt = signals(hung)
    torques = {
        "torque": hung.column("truth_load/jaw"),
        "assumed": unloaded_load(plant, seed).predict(X, dt),
        "identified": identified.predict(X, dt),
        "filtered": filtered.states(X, dt).load,
    }
    still = within(hung.t, *test.phases["IV"])
    means = {name: float(values[still].mean()) for name, values in torques.items()}
    return PartResult({"mass": mass, "direction": direction, **means})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """List loads as they are and as they are estimated, in mNm and grams."""
    found = results["stiffness"].numbers
    weighed = [result.numbers for key, result in results.items() if key != "stiffness"]

    def grams(torque: float) -> float:
        return 1e3 * torque / (GRAVITY * float(found["arm"]))

    rows = []
    for case in weighed:
        torques = [case[key] for key in ("torque", *_ESTIMATES)]
        cells = [f"{fixed(1e3 * value, 1)} ({fixed(grams(value), 0)})" for value in torques]
        rows.append((f"{1e3 * case['mass']:.0f} g {case['direction']}", *cells))
    dead_band = found["dead_band"]
    notes = (
        f"Torque in mNm (grams at {1e3 * found['arm']:.1f} mm). Identified with "
        f"{1e3 * CALIBRATION_WEIGHT:.0f} g along the motion: K_d = "
        f"{found['drive_stiffness'] / 1e3:.1f} +- {found['deviation'] / 1e3:.1f} kN/m, "
        f"{found['ratio']:.2f} of the assumed.",
        f"Dead band: up to {1e3 * dead_band:.1f} mNm ({grams(dead_band):.0f} "
        "g) against the last motion may not show, since the jaw's friction holds them.",
    )
    title = f"External load, specimen {title_of(settings['specimen'])}"
    table = Table(title, ("load", "true", *_ESTIMATES.values()), tuple(rows), notes)
    return Summary((table,), {"forceps-load": _figure(weighed, title)})


def _figure(weighed: Sequence[Mapping[str, Any]], title: str) -> Figure:
    panels = []
    for way in dict.fromkeys(case["direction"] for case in weighed):
        own = sorted((c for c in weighed if c["direction"] == way), key=lambda c: float(c["mass"]))
        mNm = {k: 1e3 * np.array([c[k] for c in own]) for k in ("torque", *_ESTIMATES)}
        curves = [Curve(mNm["torque"], mNm["torque"], "as it is", "k")]
        curves += [Curve(mNm["torque"], mNm[k], v, style="o-") for k, v in _ESTIMATES.items()]
        panels.append(Panel(curves, "true torque [mNm]", "estimate [mNm]", f"load {way}"))
    caption = (
        "Torque of each weight while it hangs still. Against the motion the jaw's friction holds "
        "part of it, which no estimate sees."
    )
    return Figure(title, (panels,), caption, height=4.4, legend=True)
