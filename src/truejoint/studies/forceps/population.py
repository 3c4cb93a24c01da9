"""Methods on many virtual specimens, unloaded and under weights, each specimen a part."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise, product
from typing import Any, Final, cast

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.calibration import Calibration
from truejoint.drawing import Curve, Figure, Panel, ecdf
from truejoint.estimators.jaw.signals import RESET
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.sensors import ZeroShift, reference_error
from truejoint.simulation.forceps.specimens import population
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record
from truejoint.studies.rows import Cell, select, table_of, values
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import fixed

ORDERINGS: Final = (
    m.PAPERS,
    ("lsm", m.PAPERS_BEST),
    ("lsm_intercept", m.PAPERS_BEST),
    ("poly2", m.PAPERS_BEST),
    (m.PAPERS_BEST, "play_reset"),
    (m.PAPERS_BEST, m.BEST),
)
"""Claims to count: each method's RMS error is larger than that of the next."""
LEVEL: Final = 0.9
"""Stated share of rows within the half-width."""
UNLOADED: Final = "unloaded"
_HELD: Final = math.radians(0.15)
"""Error under a weight that counts as held [rad]."""
_BEFORE: Final = 0.5
"""Time before the hand comes that tells where the jaw stood without a weight [s]."""
_QUANTILES: Final = {
    "5 %": 0.05, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "worst": 1.0
}  # fmt: skip


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen; a weight of 0 g is none."""
    settings.check_names("method", "methods", m.METHODS)
    weights = [mass for mass in settings["masses_g"] if mass]
    common = {
        "methods": settings["methods"],
        "motion": settings["motion"],
        "homing_deviation": settings["homing_um"] / 1e6,
        "loads": list(product(weights, settings["directions"])),
    }
    for load in common["loads"]:
        load_test(*load)  # refuses what cannot be
    ZeroShift.drawn(common["homing_deviation"], 0)  # the same
    drawn = population(settings["count"], settings.seed, settings["prior"])
    return [
        Part(
            f"specimen-{n:05d}", judge, {"forceps": p.to_dict(), "number": n, **common},
            {"specimen": n},
        )
        for n, p in enumerate(drawn)
    ]  # fmt: skip


def load_test(grams: float, direction: str) -> LoadTest:
    """Load test of IV-D at twice the paper's speed and with shorter waits; a weight in grams."""
    quick = {"start": 1.0, "loaded_from": 10.0, "loaded_to": 12.5, "end": 17.0}
    speed = math.radians(3.75)
    return LoadTest(1e-3 * grams, cast("Any", direction), speed=speed, **quick)


def judge(
    forceps: Plain,
    methods: Sequence[str],
    motion: str,
    homing_deviation: float,
    loads: Sequence[tuple[float, str]],
    number: int,
) -> Rows:
    """Calibrate methods on one motion; judge them on (28), and in phase IV of each load.

    The specimen is homed anew in between: its cable encoders' zeros vary by `homing_deviation` [m].
    Its `number` is the seed of its noise and homing, and of the hands that hang the weights [g].
    """
    plant = built(forceps)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else ZeroShift()
    run = m.settled(record(plant, "verification", seed=2 * number + 1, zero_shift=zero))
    models = m.calibrated(plant, tuple(methods), number, motion)
    limits: dict[str, Any] = {"inside": None, "floor": encoder_floor(plant, run), "unseen": 0.0}
    if loads:
        limits["inside"] = covered(models, run, m.SETTLED)
    rows = m.judge(models, run).errors(load=UNLOADED, **limits)
    for mass, direction in loads:
        test = load_test(mass, direction)
        hung = record(plant, test, seed=100 * number + round(mass))
        first, last = test.phases["IV"]
        limits["inside"] = covered(models, hung, first)
        limits["unseen"] = unseen_turn(plant, hung, test)
        load = f"{mass:g} g {direction}"
        rows += m.judge(models, hung).errors(first, last, load=load, **limits)
    return rows


def encoder_floor(plant: ForcepsParameters, recording: Recording) -> float:
    """RMS [rad] of what the reference encoder adds to the jaw's angle that no estimate can know.

    Its harmonic error is the same at each angle, and learnt; noise and quantisation are not.
    """
    exact = recording.column("truth_exact/jaw")
    ideal = exact + reference_error(exact, plant.reference_encoder)
    return float(np.sqrt(np.nanmean((recording.column("truth/jaw") - ideal) ** 2)))


def unseen_turn(plant: ForcepsParameters, recording: Recording, test: LoadTest) -> float:
    """By how much a weight turns the jaw [rad] while neither motor nor reset encoder tells.

    0 where the reset encoder moves by as much as it resolves.
    """
    first, last = test.phases["IV"]
    before = m.within(recording.t, test.loaded_from - _BEFORE, test.loaded_from)
    after = m.within(recording.t, first, last)
    turned, moved = (
        abs(float(values[after].mean() - values[before].mean()))
        for values in map(recording.column, ("truth_exact/jaw", RESET))
    )
    return turned if moved < plant.reset_encoder.resolution else 0.0


def covered(models: Mapping[str, Calibration], recording: Recording, first: float) -> float | None:
    """Share of rows from `first` [s] on in which our default stays within what it states."""
    if m.BEST not in models:
        return None
    corrector = Corrector(models[m.BEST], level=LEVEL)
    corrector.set_homing(True, recording.provenance.homing_id)
    trace = corrector.run(recording)
    rows = trace.t > first
    error = np.abs(trace.position[:, 0] - recording.column("truth/jaw"))
    return float(np.mean(error[rows] <= trace.half_width[rows, 0]))


def summarise(results: Results) -> Summary:
    """Distribution of each method's errors, unloaded and in phase IV, and how they compare."""
    settings, rows = results.settings, results.rows
    unloaded, loaded = (rows[chosen] for chosen in (rows.load == UNLOADED, rows.load != UNLOADED))
    rms = {str(key): group.rms.to_numpy() for key, group in unloaded.groupby("method", sort=False)}
    shares = {order: share(rms, *order) for order in ORDERINGS if set(order) <= set(rms)}
    cells: dict[str, Cell] = {name: _quantile(q) for name, q in _QUANTILES.items()}
    cells["beats the UKF in"] = lambda group: against_paper(rms, group.method.iloc[0])[0]
    cells["median UKF / method"] = lambda group: against_paper(rms, group.method.iloc[0])[1]
    if len(loaded):
        for name, q in (("IV median", 0.5), ("IV 90 %", 0.9), ("IV worst", 1.0)):
            cells[name] = partial(_of_method, loaded, _quantile(q))
        cells["IV within 0.15 deg"] = partial(_of_method, loaded, _held)
    hung = (
        "; IV hung still, every weight and direction of every specimen a case (at twice the speed "
        "of IV-D)"
    )
    notes = (
        f"RMS error in degrees against the reference encoder, {len(results.arrays)} specimens of "
        f"seed {settings.seed}, prior {settings['prior']}, homing deviation "
        f"{settings['homing_um']:g} um, calibrated on the motion {settings['motion']}: unloaded on "
        f"(28){hung * bool(len(loaded))}.",
        *(f"{_titles(order)}: {100 * value:.0f} % of specimens" for order, value in shares.items()),
        *(_floors(unloaded, loaded, rms) if len(loaded) else ()),
        *(_stated(unloaded, loaded) if len(loaded) else ()),
        *m.note_left_out(settings, rows),
    )
    table = table_of("Population of virtual forceps", unloaded, "method", cells, notes,
                     names=m.title)  # fmt: skip
    paper = [] if len(loaded) else [order for order in shares if set(order) <= set(m.PAPERS)]
    claims = [_claim(order, shares[order]) for order in paper]
    name = "forceps-mixed" if len(loaded) else "forceps-population"
    return Summary((table,), {name: _figure(unloaded, loaded, rms)}, claims)


def share(errors: Mapping[str, Array], *methods: str) -> float:
    """Share of specimens in which each method's error (n,) is larger than the next one's."""
    larger = [errors[one] > errors[other] for one, other in pairwise(methods)]
    return float(np.mean(np.all(larger, axis=0)))


def _quantile(q: float) -> Cell:
    return lambda group: fixed(math.degrees(group.rms.quantile(q)), 3)


def _held(group: DataFrame) -> str:
    return f"{100 * np.mean(group.rms <= _HELD):.0f} %"


def _of_method(rows: DataFrame, cell: Cell, group: DataFrame) -> str:
    return cell(select(rows, method=group.method.iloc[0]))


def against_paper(rms: Mapping[str, Array], method: str) -> tuple[str, str]:
    """In how many specimens a method beats the paper's filter, and the median ratio of errors."""
    if m.PAPERS_BEST not in rms or method == m.PAPERS_BEST:
        return "", ""
    ratio = float(np.median(rms[m.PAPERS_BEST] / rms[method]))
    return f"{100 * share(rms, m.PAPERS_BEST, method):.0f} %", f"{ratio:.2f}"


def _titles(order: Sequence[str]) -> str:
    return " > ".join(map(m.title, order))


def _claim(order: Sequence[str], value: float) -> Claim:
    """Judge an order: what holds in some specimens only is not told by the one of the paper."""
    holds = True if value >= 0.95 else False if value <= 0.5 else None
    found = f"so in {100 * value:.0f} % of specimens; agrees from 95 %, does not up to 50 %"
    return Claim(f"error of {_titles(order)}", "yan2020, Table 2", holds, found)


def _floors(unloaded: DataFrame, loaded: DataFrame, rms: Mapping[str, Array]) -> tuple[str, ...]:
    """State what no estimate can pass: the reference encoder's noise, and turns without a sign."""
    if not {m.BEST, m.PAPERS_BEST} <= set(rms):
        return ()
    floor = values(unloaded, "floor", method=m.BEST)
    paper, ours = rms[m.PAPERS_BEST], rms[m.BEST]
    beyond = np.sqrt(np.maximum([paper**2 - floor**2, ours**2 - floor**2], 1e-12))
    cases = select(loaded, method=m.BEST)
    unseen = cases.unseen > _HELD
    visible = np.where(unseen, 0.0, cases.rms)
    return (
        "The reference encoder's noise and counts alone are "
        f"{fixed(math.degrees(np.median(floor)), 3)} deg: without any error an estimate would have "
        f"a median ratio of {np.median(paper / floor):.2f}. Of what exceeds them, ours has one of "
        f"{np.median(beyond[0] / beyond[1]):.2f}.",
        f"In {100 * np.mean(unseen):.1f} % of the cases in phase IV the weight turned the jaw by "
        f"more than {math.degrees(_HELD):g} deg and neither motor nor x2 moved; but for these ours "
        f"holds {100 * np.mean(visible <= _HELD):.0f} % within that, the worst "
        f"{fixed(math.degrees(visible.max()), 3)} deg.",
    )


def _stated(unloaded: DataFrame, loaded: DataFrame) -> tuple[str, ...]:
    """State how often our default stays within its half-width, if it was there."""
    without, under = (values(rows, "inside", method=m.BEST) for rows in (unloaded, loaded))
    if not len(without):
        return ()
    return (
        f"{m.title(m.BEST)}: a stated {100 * LEVEL:.0f} % holds in "
        f"{100 * np.mean(without):.0f} % of rows unloaded (worst specimen "
        f"{100 * min(without):.0f} %), in {100 * np.mean(under):.0f} % in phase IV.",
    )


def _figure(unloaded: DataFrame, loaded: DataFrame, rms: Mapping[str, Array]) -> Figure:
    look = {"scale": np.degrees(1.0), "colours": m.COLOURS, "x": "RMS error [deg]", "log": "x"}

    def shares(rows: DataFrame, title: str) -> Panel:
        named = rows.assign(name=rows.method.map(m.TITLES))
        return ecdf(named, "rms", "name", title=title, y="share of cases [%]", **look)

    panels = [shares(unloaded, "unloaded, (28)")]
    if len(loaded):
        panels.append(shares(loaded, "under a weight, phase IV"))
    elif (paper := rms.get(m.PAPERS_BEST)) is not None:
        # The paper's filter against itself gives the line of equal errors.
        points = [
            Curve(np.degrees(paper), np.degrees(rms[key]), "", m.METHODS[key].colour,
                  "-" if key == m.PAPERS_BEST else ".")
            for key in rms
            if m.METHODS[key].colour
        ]  # fmt: skip
        panels.append(Panel(points, f"{m.title(m.PAPERS_BEST)} [deg]", "method [deg]", log="xy"))
    caption = (
        "Share of specimens, and of weights on specimens, with a smaller error, by method; or each "
        "method against the paper's filter, a point a specimen, below the line where it is better."
    )
    title = "Virtual forceps drawn at random, against the encoder"
    return Figure(title, (panels,), caption, width=12.0, height=5.6, legend=True)
