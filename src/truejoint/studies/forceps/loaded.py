"""Table 3 and figure 9 of yan2020: weights hung on the jaw's tip, both ways."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, cast

import numpy as np
from numpy.typing import NDArray

from truejoint.simulation.forceps_load import LoadTest
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.methods import (
    METHODS,
    PAPERS_BEST,
    calibrated,
    in_degrees,
    judge,
    left_out,
)
from truejoint.studies.forceps.motions import (
    Direction,
    Plain,
    built,
    plain_specimen,
    record,
    title_of,
)
from truejoint.studies.paper import reported
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text, reported_text

Array = NDArray[np.float64]
Case = Mapping[str, Any]

JUDGED: Final = ("I", "II", "IV")
_AVERAGE: Final = 0.25  # [s]


def parts(settings: Settings) -> Sequence[Part]:
    """One a weight and direction."""
    forceps, methods = plain_specimen(settings["specimen"]), settings["methods"]
    return [
        Part(key, hang, {"forceps": forceps, "methods": methods, "seed": settings.seed, **case})
        for key, case in cases(settings).items()
    ]


def cases(settings: Settings) -> dict[str, dict[str, Any]]:
    """Weight [kg], direction and seed of the hand's wobble of each load test, by a part's key."""
    found: dict[str, dict[str, Any]] = {}
    for direction in settings["directions"]:
        for grams in settings["masses_g"]:
            test = LoadTest(grams / 1e3, direction)
            hand = 100 * settings.seed + len(found) + 1
            found[f"{grams:g}g-{direction}"] = {
                "mass": test.mass,
                "direction": test.direction,
                "hand": hand,
            }
    return found


def hang(
    forceps: Plain, methods: Sequence[str], seed: int, mass: float, direction: str, hand: int
) -> PartResult:
    """Calibrate methods unloaded on (27), and judge them while one weight is hung on the jaw."""
    plant = built(forceps)
    models = calibrated(plant, tuple(methods), seed)
    test = LoadTest(mass, cast("Direction", direction))
    judged = judge(models, record(plant, "load", load=mass, direction=direction, seed=hand))
    by_phase = {phase: judged.errors(*test.phases[phase]) for phase in JUDGED}
    before, after = (
        judged.exact[(judged.t >= test.phases[p][0]) & (judged.t <= test.phases[p][1])].mean()
        for p in ("II", "IV")
    )
    numbers = {
        "mass": mass,
        "direction": direction,
        "jaw_motion": float(after - before),
        "released": test.phases["III"],
        "errors": {key: {phase: by_phase[phase][key] for phase in JUDGED} for key in models},
    }
    return PartResult(numbers, judged.arrays())


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table 3 beside the paper's, and figure 9."""
    name, hung = title_of(settings["specimen"]), [result.numbers for result in results.values()]
    methods = list(hung[0]["errors"])
    header = ("load", "jaw turns", "paper", *(METHODS[key].title for key in methods))
    notes = (
        "RMS error in degrees against the reference encoder in phases I, moving / II, still / "
        "IV, loaded. The paper's numbers are of its filter; which way it loaded it does not "
        "say.",
        *left_out(settings["methods"], hung[0]["errors"]),
    )
    rows = tuple(_row(case, methods) for case in hung)
    return Summary(
        (Table(f"yan2020 Table 3, specimen {name}", header, rows, notes),),
        {"specimen": name, "cases": [plain_case(case) for case in hung]},
        {"forceps-loaded": _figure(list(results.values()), methods, name)},
        _claims(hung) if PAPERS_BEST in methods else (),
    )


def worst(cases: Sequence[Case], method: str, phase: str, direction: str | None = None) -> float:
    """Largest RMS error [rad] of a method in a phase over the weights; NaN without any."""
    errors = [
        c["errors"][method][phase]["rms"] for c in cases if direction in (None, c["direction"])
    ]
    return max(errors, default=np.nan)


def plain_case(case: Case) -> dict[str, Any]:
    """Numbers of one weight for a person."""
    return {
        "mass_g": 1e3 * case["mass"],
        "direction": case["direction"],
        "jaw_motion_deg": float(np.degrees(case["jaw_motion"])),
        "errors": {
            key: {phase: in_degrees(error) for phase, error in phases.items()}
            for key, phases in case["errors"].items()
        },
    }


def _paper(case: Case, phase: str) -> Mapping[str, float]:
    condition = f"load={1e3 * case['mass']:.0f}g phase {phase}"
    return reported("yan2020", "3", condition, PAPERS_BEST)


def _row(case: Case, methods: Sequence[str]) -> tuple[str, ...]:
    return (
        f"{1e3 * case['mass']:.0f} g {case['direction']}",
        degrees_text(case["jaw_motion"], 2),
        "/".join(reported_text(_paper(case, phase).get("rms")) for phase in JUDGED),
        *(
            "/".join(degrees_text(case["errors"][key][phase]["rms"]) for phase in JUDGED)
            for key in methods
        ),
    )


def _claims(hung: Sequence[Case]) -> list[Claim]:
    directions = dict.fromkeys(case["direction"] for case in hung)

    def claim(text: str, source: str, limit: float, found: Mapping[str, float]) -> Claim:
        # The paper does not say which way it loaded: if one way holds and one does not, who knows?
        within = {value <= limit for value in found.values()}
        numbers = ", ".join(f"{value:.2f} deg {d}" for d, value in found.items())
        return Claim(text, source, within.pop() if len(within) == 1 else None, f"worst {numbers}")

    claims = []
    for phase, limit in (("I", 0.2), ("II", 0.2), ("IV", 0.5)):
        errors = {d: float(np.degrees(worst(hung, PAPERS_BEST, phase, d))) for d in directions}
        text = f"the filter's RMS error in phase {phase} stays within {limit} deg at every weight"
        claims.append(claim(text, "yan2020, IV-D and Table 3", limit, errors))
    turns = {
        case["direction"]: abs(float(np.degrees(case["jaw_motion"])))
        for case in sorted(hung, key=lambda case: float(case["mass"]), reverse=True)
        if case["mass"] < 0.05
    }
    if turns:
        text = "a weight below 50 g hardly turns the jaw: less than 0.5 deg"
        claims.append(claim(text, "yan2020, IV-D", 0.5, turns))
    return claims


def _figure(results: Sequence[PartResult], methods: Sequence[str], name: str) -> Figure:
    directions = list(dict.fromkeys(result.numbers["direction"] for result in results))
    rows = []
    for method in methods:
        panels = []
        for direction in directions:
            own = [r for r in results if r.numbers["direction"] == direction]
            curves = [
                Curve(
                    result.arrays["t"],
                    # The encoder's steps of 0.088 deg would hide everything else.
                    _averaged(result, np.degrees(result.arrays[method] - result.arrays["truth"])),
                    f"{1e3 * result.numbers['mass']:g} g",
                )
                for result in own
            ]
            title, shade = f"{METHODS[method].title}, load {direction}", own[0].numbers["released"]
            panels.append(Panel(curves, "time [s]", "error [deg]", title, shade=tuple(shade)))
        rows.append(panels)
    caption = (
        f"Errors while weights are hung on the jaw, means over {_AVERAGE:g} s, each panel with a "
        "scale of its own; grey: the hand lets go."
    )
    title = f"yan2020 figure 9(b), specimen {name}"
    return Figure(title, rows, caption, height=2.3 * len(rows) + 1.0, legend=True)


def _averaged(result: PartResult, values: Array) -> Array:
    """Centred mean (n,) over `_AVERAGE`."""
    t = result.arrays["t"]
    weights = np.ones(max(1, round(_AVERAGE / float(t[1] - t[0]))))
    count = np.convolve(np.ones_like(values), weights, "same")
    return np.asarray(np.convolve(values, weights, "same") / count)
