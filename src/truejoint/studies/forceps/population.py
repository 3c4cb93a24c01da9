"""Every method on many virtual specimens, each a part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.simulation.forceps_sensors import ZeroShift
from truejoint.simulation.forceps_specimens import population
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.methods import (
    BEST,
    METHODS,
    PAPERS,
    PAPERS_BEST,
    calibrated,
    check_methods,
    judge,
    settled,
)
from truejoint.studies.forceps.motions import Plain, built, record
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text

Array = NDArray[np.float64]

ORDERINGS: Final = (
    PAPERS,
    ("lsm", PAPERS_BEST),
    ("lsm_intercept", PAPERS_BEST),
    ("poly2", PAPERS_BEST),
    (PAPERS_BEST, "play_reset"),
    (PAPERS_BEST, BEST),
)
"""Claims to count: each method's RMS error is larger than that of the next."""
_QUANTILES: Final = {
    "5 %": 0.05, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "worst": 1.0
}  # fmt: skip


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    check_methods(settings["methods"])
    common = {"methods": settings["methods"], "homing_deviation": settings["homing_um"] / 1e6}
    ZeroShift.drawn(common["homing_deviation"], 0)  # refuses what cannot be drawn
    return [
        Part(f"specimen-{n:05d}", verify, {"forceps": plant.to_dict(), "number": n, **common})
        for n, plant in enumerate(population(settings["count"], settings.seed))
    ]


def verify(
    forceps: Plain, methods: Sequence[str], homing_deviation: float, number: int
) -> PartResult:
    """Calibrate methods on (27) and judge them on (28), homed in between with `homing_deviation`.

    Parameters
    ----------
    forceps : mapping
    methods : sequence of str
    homing_deviation : float
        Standard deviation of the cable encoders' zeros [m]; 0 leaves them.
    number : int
        Of the specimen, which is the seed of its noise and homing.
    """
    plant = built(forceps)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else ZeroShift()
    run = record(plant, "verification", seed=2 * number + 1, zero_shift=zero)
    return PartResult(judge(calibrated(plant, tuple(methods), number), settled(run)).errors())


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Distribution of each method's RMS over the specimens, and how it stands to the UKF."""
    methods = list(next(iter(results.values())).numbers)
    rms, exact = (
        {m: np.array([r.numbers[m][kind] for r in results.values()]) for m in methods}
        for kind in ("rms", "exact_rms")
    )
    shares = {order: share(rms, *order) for order in ORDERINGS if set(order) <= set(methods)}
    rows = []
    for method in methods:
        quantiles = [degrees_text(float(np.quantile(rms[method], q))) for q in _QUANTILES.values()]
        rows.append((METHODS[method].title, *quantiles, *_against(rms, method)))
    header = ("method", *_QUANTILES, "beats the UKF in", "median UKF / method")
    notes = (
        f"RMS error in degrees on (28) against the reference encoder, {len(results)} "
        f"specimens of seed {settings.seed}, homing deviation {settings['homing_um']:g} um.",
        *(f"{_titles(order)}: {100 * value:.0f} % of specimens" for order, value in shares.items()),
    )
    numbers: dict[str, Any] = {
        "specimens": len(results),
        "rms_deg": {m: np.degrees(rms[m]).tolist() for m in methods},
        "exact_rms_deg": {m: np.degrees(exact[m]).tolist() for m in methods},
        "orderings": {" > ".join(order): value for order, value in shares.items()},
    }
    if BEST in methods:
        numbers["median_ratio_to_best"] = {m: median_ratio(rms, m, BEST) for m in methods}
    return Summary(
        (Table("Population of virtual forceps", header, tuple(rows), notes),),
        numbers,
        {"forceps-population": _figure(rms, len(results))},
        [_claim(order, value) for order, value in shares.items() if set(order) <= set(PAPERS)],
    )


def share(errors: Mapping[str, Array], *methods: str) -> float:
    """Share of specimens in which each method's error (n,) is larger than the next one's."""
    table = np.column_stack([errors[method] for method in methods])
    return float(np.mean((np.diff(table, axis=1) < 0.0).all(axis=1)))


def median_ratio(errors: Mapping[str, Array], worse: str, better: str) -> float:
    """Median over specimens of one method's error (n,) over another's."""
    return float(np.median(errors[worse] / errors[better]))


def _against(rms: Mapping[str, Array], method: str) -> tuple[str, str]:
    if PAPERS_BEST not in rms or method == PAPERS_BEST:
        return "", ""
    better, ratio = share(rms, PAPERS_BEST, method), median_ratio(rms, PAPERS_BEST, method)
    return f"{100 * better:.0f} %", f"{ratio:.2f}"


def _titles(order: Sequence[str]) -> str:
    return " > ".join(METHODS[method].title for method in order)


def _claim(order: Sequence[str], value: float) -> Claim:
    """Judge an order: what holds in some specimens only is not told by the one of the paper."""
    holds = True if value >= 0.95 else False if value <= 0.5 else None
    numbers = f"so in {100 * value:.0f} % of specimens; agrees from 95 %, does not up to 50 %"
    return Claim(f"error of {_titles(order)}", "yan2020, Table 2", holds, numbers)


def _figure(rms: Mapping[str, Array], count: int) -> Figure:
    order = (np.arange(count) + 0.5) / count
    distributions = [
        Curve(
            np.sort(np.degrees(error)), order, METHODS[m].title, METHODS[m].colour or "0.7",
            width=1.2,
        )
        for m, error in rms.items()
    ]  # fmt: skip
    panels = [
        Panel(distributions, "RMS error [deg]", "share of specimens below", log="x", legend=False)
    ]
    if PAPERS_BEST in rms:
        paper = np.degrees(rms[PAPERS_BEST])
        others = [m for m in rms if METHODS[m].colour and m != PAPERS_BEST]
        ends = np.array([0.8 * paper.min(), 1.2 * paper.max()])
        points = [Curve(paper, np.degrees(rms[m]), "", METHODS[m].colour, ".") for m in others]
        equal = Curve(ends, ends, colour="k", width=0.8)
        against = f"{METHODS[PAPERS_BEST].title} [deg]"
        panels.append(Panel([*points, equal], against, "method [deg]", log="xy"))
    caption = (
        "Left: share of specimens with a smaller error, by method. Right: each method against the "
        "paper's filter, a point a specimen; below the line it is better."
    )
    title = f"{count} virtual forceps, trajectory (28), against the encoder"
    return Figure(title, (panels,), caption, width=12.0, height=5.6, legend=True)
