"""Table 3 and figure 9 of yan2020: weights hung on the jaw's tip, both ways."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.simulation.forceps.load import LoadTest
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record, title_of
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text, reported, reported_text
from truejoint.tables import Table

Case = Mapping[str, Any]

MAX_DRAWS: Final = 1000
JUDGED: Final = ("I", "II", "IV")
SHIFT: Final = 8.0
"""Between the weights' curves in figure 9(a) [deg]."""
_AVERAGE: Final = 0.25  # [s]


def parts(settings: Settings) -> Sequence[Part]:
    """One a weight, direction and draw of the hand; a study without draws has one of them."""
    common, found = m.common_arguments(settings), []
    draws = int(cast("int", settings.options.get("draws", 1)))
    if not 1 <= draws <= MAX_DRAWS:
        raise StudyError(f"draws={draws}; it must be 1 to {MAX_DRAWS}")
    for draw in range(draws):
        for key, case in cases(settings).items():
            drawn = {**case, "hand": case["hand"] + 100 * draw}
            found.append(Part(f"{key}-{draw}" if draw else key, hang, {**common, **drawn}))
    return found


def cases(settings: Settings) -> dict[str, dict[str, Any]]:
    """Weight [kg], direction and seed of the hand's wobble of each load test, by a part's key."""
    pairs = [(g / 1e3, d) for d in settings["directions"] for g in settings["masses_g"]]
    found = {}
    for number, (mass, direction) in enumerate(pairs, 1):
        load_test(mass, direction)  # refuses what cannot be
        hand = 100 * settings.seed + number
        found[f"{1e3 * mass:g}g-{direction}"] = {"mass": mass, "direction": direction, "hand": hand}
    return found


def hang(
    forceps: Plain, methods: Sequence[str], seed: int, mass: float, direction: str, hand: int
) -> PartResult:
    """Calibrate methods unloaded on (27), and judge them while one weight is hung on the jaw."""
    plant, test = built(forceps), load_test(mass, direction)
    models = m.calibrated(plant, tuple(methods), seed)
    judged = m.judge(models, record(plant, test, seed=hand))
    errors = {phase: judged.errors(*test.phases[phase]) for phase in JUDGED}
    still = [judged.exact[m.within(judged.t, *test.phases[phase])].mean() for phase in ("II", "IV")]
    numbers = {
        "mass": mass,
        "direction": direction,
        "jaw_motion": float(still[1] - still[0]),
        "released": test.phases["III"],
        "errors": {key: {phase: errors[phase][key] for phase in JUDGED} for key in models},
    }
    return PartResult(numbers, judged.arrays())


def load_test(mass: float, direction: str) -> LoadTest:
    """Load test of a weight [kg]; raises TruejointError for one that cannot be."""
    return LoadTest(mass, cast("Any", direction))


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table 3 beside the paper's, and figure 9."""
    name, hung = title_of(settings["specimen"]), [result.numbers for result in results.values()]
    methods = list(hung[0]["errors"])
    header = ("load", "paper", *(m.METHODS[key].title for key in methods))
    by_load: dict[str, list[Case]] = {}
    for case in hung:
        by_load.setdefault(f"{1e3 * case['mass']:.0f} g {case['direction']}", []).append(case)
    medians, spreads, extremes = [], [], []
    for load, drawn in by_load.items():
        phases = []
        for phase in JUDGED:
            rms = [degrees_text(float(np.median(_rms(drawn, key, phase)))) for key in methods]
            phases.append([reported_text(_paper(drawn[0], phase).get("rms")), *rms])
        turns = degrees_text(float(np.median([case["jaw_motion"] for case in drawn])), 2)
        medians.append((load, turns, *("/".join(one) for one in zip(*phases, strict=True))))
        there = reported_text(_paper(drawn[0], "IV").get("rms"))
        spreads.append((load, there, *(_spread(drawn, key) for key in methods)))
        paper = _paper(drawn[0], "I")
        there = "/".join(reported_text(paper.get(end)) for end in ("max", "min"))
        extremes.append((load, there, *(_extremes(drawn, key) for key in methods)))
    draws = len(hung) // len(by_load)
    notes = (
        "Error in degrees against the reference encoder in phases I, moving / II, still / IV, "
        f"loaded; {draws} draws of the hand that hangs the weight and of the sensors' noise. The "
        "paper's numbers are of its filter; which way it loaded it does not say.",
        *m.left_out(settings, hung[0]["errors"]),
    )
    title = f"yan2020 Table 3, specimen {name}"
    turning = (header[0], "jaw turns", *header[1:])
    tables = (
        Table(f"{title}: RMS, median of the draws", turning, tuple(medians), notes),
        Table(f"{title}: RMS in phase IV, median (least to largest)", header, tuple(spreads)),
        Table(f"{title}: largest/smallest error in phase I", header, tuple(extremes)),
    )
    first = list(results.values())[: len(by_load)]
    figures = {
        "forceps-loaded-angles": _angles(first, name),
        "forceps-loaded": _figure(first, methods, name),
    }
    claims = list(_claims(hung)) if m.PAPERS_BEST in methods else []
    return Summary(tables, figures, claims)


def _paper(case: Case, phase: str) -> Mapping[str, float]:
    return reported("yan2020", "3", f"load={1e3 * case['mass']:.0f}g phase {phase}", m.PAPERS_BEST)


def _rms(drawn: Sequence[Case], method: str, phase: str) -> list[float]:
    return [float(case["errors"][method][phase]["rms"]) for case in drawn]


def _spread(drawn: Sequence[Case], method: str) -> str:
    rms = _rms(drawn, method, "IV")
    middle, least, largest = (degrees_text(float(f(rms))) for f in (np.median, np.min, np.max))
    return f"{middle} ({least} to {largest})"


def _extremes(drawn: Sequence[Case], method: str) -> str:
    errors = [case["errors"][method]["I"] for case in drawn]
    most, least = max(e["largest"] for e in errors), min(e["smallest"] for e in errors)
    return f"{degrees_text(most, 2)}/{degrees_text(least, 2)}"


def worst(hung: Sequence[Case], method: str, phase: str, *directions: str) -> float:
    """Largest RMS error [rad] of a method in a phase over the weights, pulling as `directions`."""
    chosen = [case for case in hung if case["direction"] in directions]
    return max(_rms(chosen, method, phase))


def _claims(hung: Sequence[Case]) -> Iterator[Claim]:
    for phase, limit in (("I", 0.2), ("II", 0.2), ("IV", 0.5)):
        ways = dict.fromkeys(case["direction"] for case in hung)
        text = f"the filter's RMS error in phase {phase} stays within {limit} deg at every weight"
        found = {way: worst(hung, m.PAPERS_BEST, phase, way) for way in ways}
        yield _claim(text, "yan2020, IV-D and Table 3", limit, found)
    light = [(abs(case["jaw_motion"]), case["direction"]) for case in hung if case["mass"] < 0.05]
    if light:
        text = "a weight below 50 g hardly turns the jaw: less than 0.5 deg"
        yield _claim(text, "yan2020, IV-D", 0.5, {way: turn for turn, way in sorted(light)})


def _claim(text: str, source: str, limit: float, found: Mapping[str, float]) -> Claim:
    """Judge angles [rad] by direction: the paper does not say which way it loaded."""
    degrees = {direction: float(np.degrees(value)) for direction, value in found.items()}
    within = {value <= limit for value in degrees.values()}
    numbers = ", ".join(f"{value:.2f} deg {d}" for d, value in degrees.items())
    return Claim(text, source, within.pop() if len(within) == 1 else None, f"worst {numbers}")


def _angles(results: Sequence[PartResult], name: str) -> Figure:
    """Draw figure 9(a), the paper's filter, or the first method, beside the encoder."""
    method = next(iter(results[0].numbers["errors"]))
    panels = []
    for way in dict.fromkeys(result.numbers["direction"] for result in results):
        curves = []
        own = [r for r in results if r.numbers["direction"] == way]
        for place, result in enumerate(own):
            t, colour = result.arrays["t"], f"C{place}"
            label = f"{1e3 * result.numbers['mass']:g} g"
            for key, style, text in (("truth", "-", label), (method, ":", "")):
                angle = np.degrees(result.arrays[key]) + SHIFT * place
                curves.append(Curve(t, _averaged(t, angle), text, colour, style, width=1.4))
        shade = own[0].numbers["released"]
        panels.append(Panel(curves, "time [s]", "jaw [deg]", f"load {way}", shade=shade))
    caption = (
        f"Jaw by the reference encoder and, dotted, by {m.METHODS[method].title}; each weight "
        f"{SHIFT:g} deg above the one before. Grey: the hand lets go."
    )
    title = f"yan2020 figure 9(a), specimen {name}"
    return Figure(title, (panels,), caption, height=4.8, legend=True)


def _figure(results: Sequence[PartResult], methods: Sequence[str], name: str) -> Figure:
    rows = [
        [
            _panel(method, [r for r in results if r.numbers["direction"] == way])
            for way in dict.fromkeys(result.numbers["direction"] for result in results)
        ]
        for method in methods
    ]
    caption = (
        f"Errors while weights are hung on the jaw, means over {_AVERAGE:g} s, each panel with a "
        "scale of its own; grey: the hand lets go."
    )
    title, height = f"yan2020 figure 9(b), specimen {name}", 2.3 * len(rows) + 1.0
    return Figure(title, rows, caption, height=height, legend=True)


def _panel(method: str, results: Sequence[PartResult]) -> Panel:
    curves = []
    for result in results:
        t, error = result.arrays["t"], result.arrays[method] - result.arrays["truth"]
        # The encoder's steps of 0.088 deg would hide everything else.
        label = f"{1e3 * result.numbers['mass']:g} g"
        curves.append(Curve(t, _averaged(t, np.degrees(error)), label))
    first = results[0].numbers
    title = f"{m.METHODS[method].title}, load {first['direction']}"
    return Panel(curves, "time [s]", "error [deg]", title, shade=first["released"])


def _averaged(t: Array, values: Array) -> Array:
    """Centred mean (n,) over `_AVERAGE`."""
    weights = np.ones(max(1, round(_AVERAGE / float(t[1] - t[0]))))
    count = np.convolve(np.ones_like(values), weights, "same")
    return np.asarray(np.convolve(values, weights, "same") / count)
