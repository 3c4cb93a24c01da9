"""Table 3 and figure 9 of yan2020: weights hung on the jaw's tip, both ways."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array
from truejoint.simulation.forceps.load import LoadTest
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record, title_of
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text, reported, reported_text

Case = Mapping[str, Any]

JUDGED: Final = ("I", "II", "IV")
_AVERAGE: Final = 0.25  # [s]


def parts(settings: Settings) -> Sequence[Part]:
    """One a weight and direction."""
    common = m.common_arguments(settings)
    return [Part(key, hang, {**common, **case}) for key, case in cases(settings).items()]


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
    header = ("load", "jaw turns", "paper", *(m.METHODS[key].title for key in methods))
    rows = []
    for case in hung:
        grams, by_phase = 1e3 * case["mass"], []
        for phase in JUDGED:
            paper = reported("yan2020", "3", f"load={grams:.0f}g phase {phase}", m.PAPERS_BEST)
            errors = [degrees_text(case["errors"][key][phase]["rms"]) for key in methods]
            by_phase.append([reported_text(paper.get("rms")), *errors])
        cells = ["/".join(phases) for phases in zip(*by_phase, strict=True)]
        load = f"{grams:.0f} g {case['direction']}"
        rows.append((load, degrees_text(case["jaw_motion"], 2), *cells))
    notes = (
        "RMS error in degrees against the reference encoder in phases I, moving / II, still / "
        "IV, loaded. The paper's numbers are of its filter; which way it loaded it does not "
        "say.",
        *m.left_out(settings, hung[0]["errors"]),
    )
    table = Table(f"yan2020 Table 3, specimen {name}", header, tuple(rows), notes)
    figure = _figure(list(results.values()), methods, name)
    claims = list(_claims(hung)) if m.PAPERS_BEST in methods else []
    return Summary((table,), {"forceps-loaded": figure}, claims)


def worst(hung: Sequence[Case], method: str, phase: str, *directions: str) -> float:
    """Largest RMS error [rad] of a method in a phase over the weights, pulling as `directions`."""
    chosen = [case for case in hung if case["direction"] in directions]
    return max(float(case["errors"][method][phase]["rms"]) for case in chosen)


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
