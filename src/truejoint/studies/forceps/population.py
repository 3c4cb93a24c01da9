"""Methods, and designs of sensors and cables, on many virtual specimens, each a part."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame, Series

from truejoint.calibration import Calibration
from truejoint.drawing import PALETTE, Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.jaw_load.learn import GatedPlays
from truejoint.estimators.plays.learn import JawPlays
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ZeroShift, quantised, reference_error
from truejoint.studies.claim_tests import mostly
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.methods import settled
from truejoint.studies.forceps.motions import Plain, changed, load_test, record, signals
from truejoint.studies.rows import ecdf_figure, frame_table, groups, quantiles, select, unique
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary

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
_HELD: Final = 0.15
"""Error under a weight that counts as held [deg]."""
_BEFORE: Final = 0.5
"""Time before the hand comes that tells where the jaw stood without a weight [s]."""


def population_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen; a weight of 0 g is none."""
    settings.check_names("method", "methods", m.METHODS)
    weights = [mass for mass in settings["masses_g"] if mass]
    common = {
        "methods": settings["methods"],
        "motion": settings["motion"],
        "homing_deviation": settings["homing_um"] / 1e6,
        "loads": list(product(weights, settings["directions"])),
    }
    for grams, direction in common["loads"]:
        load_test(1e-3 * grams, direction)  # refuses what cannot be
    ZeroShift.drawn(common["homing_deviation"], 0)  # the same
    drawn = population(settings["count"], settings.seed, settings["prior"])
    return [
        Part(
            f"specimen-{n:05d}", judge, {"forceps": p.to_dict(), "number": n, **common},
            {"specimen": n},
        )
        for n, p in enumerate(drawn)
    ]  # fmt: skip


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
    plant = ForcepsParameters.from_dict(forceps)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else ZeroShift()
    run = m.settled(record(plant, "verification", seed=2 * number + 1, zero_shift=zero))
    models = m.calibrated(plant, tuple(methods), number, motion)
    limits: dict[str, Any] = {"inside": None, "floor": encoder_floor(plant, run), "unseen": 0.0}
    if loads:
        limits["inside"] = covered(models, run, m.SETTLED)
    rows = m.judge(models, run).errors(load=UNLOADED, **limits)
    for mass, direction in loads:
        test = load_test(1e-3 * mass, direction, quick=True, end=17.0)
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
    before = m.within(recording.t, test.loaded_from - _BEFORE, test.loaded_from)
    after = m.within(recording.t, *test.phases["IV"])
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


def population_summary(results: Results) -> Summary:
    """Distribution of each method's errors, unloaded and in phase IV, and how they compare."""
    settings, rows = results.settings, results.rows
    rows = rows.assign(name=rows.method.map(m.TITLES), deg=np.degrees(rows.rms))
    unloaded, loaded = select(rows, load=UNLOADED), rows[rows.load != UNLOADED]
    rms = unloaded.pivot(index="specimen", columns="method", values="deg")
    shares = {order: share(rms, *order) for order in ORDERINGS if set(order) <= set(rms)}
    ends = {"5 %": 0.05, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "95 %": 0.95, "worst": 1.0}
    table = quantiles(unloaded, "name", "deg", ends)
    others: Iterable[str] = rms.columns.drop(m.PAPERS_BEST) if m.PAPERS_BEST in rms else []
    beats = {m.TITLES[k]: f"{100 * share(rms, m.PAPERS_BEST, k):.0f} %" for k in others}
    ratios = {m.TITLES[k]: f"{(rms[m.PAPERS_BEST] / rms[k]).median():.2f}" for k in others}
    for column, texts in (("beats the UKF in", beats), ("median UKF / method", ratios)):
        table[column] = Series(texts, table.index, dtype=object).fillna("")
    if len(loaded):
        held = loaded.groupby("name").deg.agg(lambda deg: f"{100 * np.mean(deg <= _HELD):.0f} %")
        under = {"IV median": 0.5, "IV 90 %": 0.9, "IV worst": 1.0}
        table = table.join(quantiles(loaded, "name", "deg", under)).join(
            held.rename(f"IV within {_HELD:g} deg")
        )
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
        *(_limits(unloaded, loaded, rms) if len(loaded) and m.BEST in rms else ()),
        *m.note_left_out(settings, rows),
    )
    claims = [
        Claim(
            f"error of {_titles(order)}, in most specimens", "yan2020, Table 2",
            mostly(round(value * len(rms)), len(rms)),
            f"so in {100 * value:.0f} % of {len(rms)} drawn; told by the exact 95 % interval",
        )
        for order, value in shares.items()
        if set(order) <= set(m.PAPERS) and not len(loaded)
    ]  # fmt: skip
    title = "Population of virtual forceps"
    name = "forceps-mixed" if len(loaded) else "forceps-population"
    caption = "Share of specimens, and of weights on specimens, with a smaller error, by method."
    drawn = rows.assign(case=np.where(rows.load == UNLOADED, "unloaded, (28)", "phase IV"))
    figure = ecdf_figure(title, drawn, "name", "case", caption, colours=m.COLOURS)
    return Summary((frame_table(title, table, notes, head="method"),), {name: figure}, claims)


def share(errors: DataFrame, *methods: str) -> float:
    """Share of specimens (rows) in which each method's error is larger than the next one's."""
    return float(np.all(np.diff(errors[list(methods)]) < 0.0, axis=1).mean())


def _titles(order: Sequence[str]) -> str:
    return " > ".join(m.TITLES[key] for key in order)


def _limits(unloaded: DataFrame, loaded: DataFrame, rms: DataFrame) -> Iterator[str]:
    """State what no estimate can pass, and how often our default stays within its half-width."""
    alone, cases = select(unloaded, method=m.BEST), select(loaded, method=m.BEST)
    if m.PAPERS_BEST in rms:
        floor = np.degrees(alone.floor.to_numpy())
        paper, ours = rms[m.PAPERS_BEST].to_numpy(), rms[m.BEST].to_numpy()
        beyond = np.sqrt(np.maximum([paper**2 - floor**2, ours**2 - floor**2], 1e-9))
        unseen = np.degrees(cases.unseen) > _HELD
        visible = np.where(unseen, 0.0, cases.deg)
        yield (
            f"The reference encoder's noise and counts alone are {np.median(floor):.3f} deg: "
            f"without any error an estimate would have a median ratio of "
            f"{np.median(paper / floor):.2f}. "
            f"Of what exceeds them, ours has one of {np.median(beyond[0] / beyond[1]):.2f}."
        )
        yield (
            f"In {100 * np.mean(unseen):.1f} % of the cases in phase IV the weight turned the jaw "
            f"by more than {_HELD:g} deg and neither motor nor x2 moved; but for these ours holds "
            f"{100 * np.mean(visible <= _HELD):.0f} % within that, the worst {visible.max():.3f} "
            "deg."
        )
    yield (
        f"{m.TITLES[m.BEST]}: a stated {100 * LEVEL:.0f} % holds in "
        f"{100 * alone.inside.mean():.0f} % of rows unloaded (worst specimen "
        f"{100 * alone.inside.min():.0f} %), in {100 * cases.inside.mean():.0f} % in phase IV."
    )


LAYOUTS: Final[Mapping[str, tuple[str, ...]]] = {
    "motor": (MOTOR,),
    "x1": (DRIVE,),
    "x2": (RESET,),
    "motor+x2": (MOTOR, RESET),
    "x1+x2": (DRIVE, RESET),
}
"""What the estimate is made of, by name; the motor's encoder is there anyhow."""
NOISE: Final = 0.1
"""Jitter of a cable's encoder, in its resolutions, as the nominal one has it."""
_FRICTIONS: Final = (
    "jaw_friction.constant", "jaw_friction.tension_share",
    "slider_friction.constant", "slider_friction.tension_share",
)  # fmt: skip
_WEIGHT: Final[dict[str, Any]] = {
    "speed": math.radians(10.0), "start": 1.0, "loaded_from": 5.0, "loaded_to": 7.0, "end": 10.5,
}  # fmt: skip
_LOADS: Final = ["unloaded", "loaded"]


def encoders(layout: str) -> int:
    """Count the encoders on the cables."""
    return sum(name != MOTOR for name in LAYOUTS[layout])


def sweep_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, stiffness and friction: sensors are tried on the same motion."""
    settings.check_names("layout", "layouts", LAYOUTS)
    if len(settings["prices"]) != len(settings["resolutions_um"]):
        raise StudyError("prices: give one for each of resolutions_um")
    if not all(value > 0.0 for name in ("prices", "resolutions_um") for value in settings[name]):
        raise StudyError("prices and resolutions_um must be above 0")
    for spread in settings["homings_um"]:
        ZeroShift.drawn(spread / 1e6, 0)  # refuses what cannot be drawn
    common = {
        "layouts": settings["layouts"],
        "resolutions": [value / 1e6 for value in settings["resolutions_um"]],
        "homings": [value / 1e6 for value in settings["homings_um"]],
        "mass": settings["mass_g"] / 1e3,
    }
    plants = population(settings["count"], settings.seed, settings["prior"])
    return [
        Part(
            f"specimen-{n:03d}-{k:g}-{f:g}", measure,
            {"forceps": designed(plant, 1e3 * k, f).to_dict(), "number": n, **common},
            {"specimen": n, "stiffness": 1e3 * k, "friction": f},
        )
        for (n, plant), k, f in product(
            enumerate(plants), settings["stiffnesses_kNm"], settings["frictions"]
        )
    ]  # fmt: skip


def designed(plant: ForcepsParameters, stiffness: float, friction: float) -> ForcepsParameters:
    """Specimen with cables of a `stiffness` [N/m] and a multiple of its `friction`.

    Its encoders are nearly exact; `sensed` makes them coarser.
    """
    flat = {f"{s}.{k}": v for s, values in plant.to_dict().items() for k, v in values.items()}
    values: dict[str, Any] = {name: friction * flat[name] for name in _FRICTIONS}
    for side in ("drive", "reset"):
        values |= {
            f"{side}_cable.stiffness": stiffness,
            f"{side}_encoder.installed": True,
            f"{side}_encoder.resolution": 1e-9,
            f"{side}_encoder.noise": 0.0,
        }
    return plant.with_values(values)


def sensed(recording: Recording, resolution: float, zero: ZeroShift, seed: int) -> Recording:
    """Read the cables' encoders of a recording at a resolution [m], each off by its zero."""
    rng = np.random.default_rng(seed)
    for name, shift in ((DRIVE, zero.drive), (RESET, zero.reset)):
        exact = recording.column(name) + shift
        noise = rng.normal(0.0, NOISE * resolution, len(exact))
        recording = changed(recording, name, quantised(exact + noise, resolution))
    return recording


def measure(
    forceps: Plain,
    layouts: Sequence[str],
    resolutions: Sequence[float],
    homings: Sequence[float],
    mass: float,
    number: int,
) -> Rows:
    """Calibrate every layout at every resolution on (27), and judge it on (28) and under a load.

    Homed anew in between; RMS errors [rad] against the reference encoder, loaded the worse of both
    directions.
    """
    plant, rate, rows = ForcepsParameters.from_dict(forceps), {"log_rate": 100.0}, Rows()
    tests = [load_test(mass, way, **_WEIGHT) for way in ("opposing", "along")]
    still = [test.phases["IV"][0] for test in tests]
    taught = settled(record(plant, "calibration", seed=4 * number, **rate))
    verified = settled(record(plant, "verification", seed=4 * number + 1, **rate))
    hung = [record(plant, t, seed=4 * number + 2 + i, **rate) for i, t in enumerate(tests)]
    for layout, resolution, homing in product(layouts, resolutions, homings):
        if not encoders(layout) and (resolution, homing) != (resolutions[0], homings[0]):
            continue  # nothing that these change
        zero = ZeroShift.drawn(homing, number)
        names = LAYOUTS[layout]
        X, dt = signals(sensed(taught, resolution, ZeroShift(), number), *names)
        estimator: Any = GatedPlays() if layout == "motor+x2" else JawPlays(signals=names)
        estimator.fit(X, taught.column("truth/jaw"), dt=dt)
        errors = []
        for run, first in ((verified, -math.inf), *zip(hung, still, strict=True)):
            X, dt = signals(sensed(run, resolution, zero, number), *names)
            error = np.ravel(estimator.predict(X, dt)) - run.column("truth/jaw")
            errors.append(float(np.sqrt(np.nanmean(error[run.t >= first] ** 2))))
        design = {"layout": layout, "resolution": resolution, "homing": homing}
        rows.append({**design, "unloaded": errors[0], "loaded": max(errors[1:])})
    return rows


def sweep_summary(results: Results) -> Summary:
    """Errors of every design, those that no cheaper one beats, and what reaches the target."""
    settings, rows = results.settings, results.rows
    prices = dict(zip(settings["resolutions_um"], settings["prices"], strict=True))
    unit = (1e6 * rows.resolution).round(6).map(prices)
    rows = rows.assign(
        price=rows.layout.map(encoders) * unit,
        sensors=[sensors(row) for row in rows.itertuples()],
        cables=(rows.stiffness / 1e3).map("{:g} kN/m".format),
        **{load: np.degrees(rows[load]) for load in _LOADS},
        name=lambda own: own.sensors + ", " + own.cables,
    )
    by_name = rows.groupby("name", sort=False)
    medians, most = by_name[_LOADS].median(), by_name[_LOADS].max()
    designs = by_name[["layout", "price"]].first()
    designs = designs.assign(typical=medians.max(axis=1), worst=most.max(axis=1))
    best = front(designs)
    reach = designs[designs.worst <= settings["target_deg"]]
    reach = reach.sort_values(["price", "worst"], kind="stable")
    answer = f"{reach.index[0]}, price {reach.price.iloc[0]:g}" if len(reach) else "no design does"
    under = f"under {settings['mass_g']:g} g"
    notes = (
        "RMS error in degrees against the reference encoder, median (worst) of "
        f"{settings['count']} specimens of seed {settings.seed}, prior {settings['prior']}, each "
        f"homed anew: on (28), and still {under}, the worse of both directions.",
        f"Cheapest design that keeps {settings['target_deg']:g} deg on every specimen, loaded and "
        f"unloaded: {answer}. Prices are assumed; --set prices=... takes yours.",
    )
    cells = medians.map("{:.3f}".format) + " (" + most.map("{:.3f}".format) + ")"
    cells = cells.rename(columns={"loaded": under}).loc[best.index]
    cells.insert(0, "price", best.price.map("{:g}".format))
    grid = rows.groupby(["sensors", "cables"], sort=False)[_LOADS].median().map("{:.3f}".format)
    grid = (grid.unloaded + "/" + grid.loaded).unstack()
    grid = grid.loc[unique(rows, "sensors"), unique(rows, "cables")]
    note = f"Median RMS error in degrees, unloaded/{under}."
    tables = (
        frame_table("Designs that no cheaper one beats", cells, notes, head="design"),
        frame_table("Every design", grid, (note,), head="sensors"),
    )
    points = [
        Curve(group.price, group.typical, layout, colour, "o")
        for (layout, group), colour in zip(groups(designs, "layout"), PALETTE, strict=False)
    ]
    points.append(Curve(best.price, best.typical, "", "k", "--o"))
    panel = Panel(points, "price of the cables' encoders", "median RMS error [deg]", log="y")
    caption = "The worse of loaded and unloaded; the line joins designs that none beats for less."
    figure = Figure("What accuracy costs", ((panel,),), caption, legend=True)
    return Summary(tables, {"forceps-sweep": figure})


def sensors(design: Any) -> str:
    """Name all of a design but its cables' stiffness, in a person's units."""
    homed = f", homed to {1e6 * design.homing:g} um"
    at = f" at {1e6 * design.resolution:g} um{homed}" if encoders(design.layout) else " only"
    rubs = "" if design.friction == 1.0 else f", friction x {design.friction:g}"
    return f"{design.layout}{at}{rubs}"


def front(designs: DataFrame) -> DataFrame:
    """Designs, cheapest first, that err less than every cheaper one: the Pareto front."""
    ordered = designs.sort_values(["price", "typical"], kind="stable")
    least = ordered.typical.cummin().shift(fill_value=math.inf)
    return ordered[ordered.typical < least]
