"""Every method on many virtual specimens, each a part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.simulation.forceps.specimens import population
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table

ORDERINGS: Final = (
    m.PAPERS,
    ("lsm", m.PAPERS_BEST),
    ("lsm_intercept", m.PAPERS_BEST),
    ("poly2", m.PAPERS_BEST),
    (m.PAPERS_BEST, "play_reset"),
    (m.PAPERS_BEST, m.BEST),
)
"""Claims to count: each method's RMS error is larger than that of the next."""
_QUANTILES: Final = {
    "5 %": 0.05, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "worst": 1.0
}  # fmt: skip


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    m.check_methods(settings["methods"])
    common = {"methods": settings["methods"], "homing_deviation": settings["homing_um"] / 1e6}
    ZeroShift.drawn(common["homing_deviation"], 0)  # refuses what cannot be drawn
    return [
        Part(f"specimen-{n:05d}", verify, {"forceps": plant.to_dict(), "number": n, **common})
        for n, plant in enumerate(population(settings["count"], settings.seed, settings["prior"]))
    ]


def verify(
    forceps: Plain, methods: Sequence[str], homing_deviation: float, number: int
) -> PartResult:
    """Calibrate methods on (27) and judge them on (28), homed anew in between.

    The cable encoders' zeros then vary by `homing_deviation` [m]; the specimen's `number` is the
    seed of its noise and homing.
    """
    plant = built(forceps)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else ZeroShift()
    run = record(plant, "verification", seed=2 * number + 1, zero_shift=zero)
    models = m.calibrated(plant, tuple(methods), number)
    return PartResult(m.judge(models, m.settled(run)).errors())


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Distribution of each method's RMS over the specimens, and how it stands to the UKF."""
    numbers = [result.numbers for result in results.values()]
    rms = {key: np.array([n[key]["rms"] for n in numbers]) for key in numbers[0]}
    shares = {order: share(rms, *order) for order in ORDERINGS if set(order) <= set(rms)}
    rows = []
    for key, errors in rms.items():
        quantiles = quantile_texts(errors, *_QUANTILES.values())
        rows.append((m.METHODS[key].title, *quantiles, *against_paper(rms, key)))
    header = ("method", *_QUANTILES, "beats the UKF in", "median UKF / method")
    notes = (
        f"RMS error in degrees on (28) against the reference encoder, {len(results)} "
        f"specimens of seed {settings.seed}, prior {settings['prior']}, homing deviation "
        f"{settings['homing_um']:g} um.",
        *(f"{_titles(order)}: {100 * value:.0f} % of specimens" for order, value in shares.items()),
        *m.left_out(settings, rms),
    )
    table = Table("Population of virtual forceps", header, tuple(rows), notes)
    paper = [order for order in shares if set(order) <= set(m.PAPERS)]
    claims = [_claim(order, shares[order]) for order in paper]
    return Summary((table,), {"forceps-population": _figure(rms)}, claims)


def share(errors: Mapping[str, Array], *methods: str) -> float:
    """Share of specimens in which each method's error (n,) is larger than the next one's."""
    table = np.column_stack([errors[method] for method in methods])
    return float(np.mean((np.diff(table, axis=1) < 0.0).all(axis=1)))


def quantile_texts(errors: Array, *quantiles: float) -> tuple[str, ...]:
    """Quantiles of errors [rad] in degrees."""
    return tuple(degrees_text(float(np.quantile(errors, q))) for q in quantiles)


def against_paper(rms: Mapping[str, Array], method: str) -> tuple[str, str]:
    """In how many specimens a method beats the paper's filter, and the median ratio of errors."""
    if m.PAPERS_BEST not in rms or method == m.PAPERS_BEST:
        return "", ""
    ratio = float(np.median(rms[m.PAPERS_BEST] / rms[method]))
    return f"{100 * share(rms, m.PAPERS_BEST, method):.0f} %", f"{ratio:.2f}"


def _titles(order: Sequence[str]) -> str:
    return " > ".join(m.METHODS[method].title for method in order)


def _claim(order: Sequence[str], value: float) -> Claim:
    """Judge an order: what holds in some specimens only is not told by the one of the paper."""
    holds = True if value >= 0.95 else False if value <= 0.5 else None
    numbers = f"so in {100 * value:.0f} % of specimens; agrees from 95 %, does not up to 50 %"
    return Claim(f"error of {_titles(order)}", "yan2020, Table 2", holds, numbers)


def _figure(rms: Mapping[str, Array]) -> Figure:
    degrees = {key: np.degrees(errors) for key, errors in rms.items()}
    paper, curves, points = degrees.get(m.PAPERS_BEST), [], []
    for key, error in degrees.items():
        method, below = m.METHODS[key], (np.arange(len(error)) + 0.5) / len(error)
        curves.append(Curve(np.sort(error), below, method.title, method.colour or "0.7", width=1.2))
        if method.colour and paper is not None:
            # The paper's filter against itself gives the line of equal errors.
            points.append(Curve(paper, error, "", method.colour, "-" if error is paper else "."))
    panels = [Panel(curves, "RMS error [deg]", "share of specimens below", log="x")]
    if points:
        against = f"{m.METHODS[m.PAPERS_BEST].title} [deg]"
        panels.append(Panel(points, against, "method [deg]", log="xy"))
    caption = (
        "Left: share of specimens with a smaller error, by method. Right: each method against the "
        "paper's filter, a point a specimen; below the line it is better."
    )
    title = "Virtual forceps drawn at random, trajectory (28), against the encoder"
    return Figure(title, (panels,), caption, width=12.0, height=5.6, legend=True)
