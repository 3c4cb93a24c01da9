"""Methods, and designs of sensors and cables, on many virtual specimens, each a part."""

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame, Series

from truejoint.calibration import Calibration
from truejoint.errors import StudyError
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.jaw_load.learn import GatedPlays
from truejoint.estimators.plays.learn import JawPlays
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.simulation.forceps.load import SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import PRIORS, population
from truejoint.simulation.forceps.twin import ZeroShift, quantised
from truejoint.studies.claim_tests import RULE, mostly, ordered
from truejoint.studies.forceps import methods as m
from truejoint.studies.rows import (
    ecdf_figure,
    frame_table,
    median_texts,
    notes_on,
    quantiles,
    select,
)
from truejoint.studies.study import CLAIMS, Part, Plain, Results, Rows, Settings, Summary

LEVEL: Final = 0.9
"""Stated share of rows within the half-width."""
UNLOADED: Final = "unloaded"
_HOMED_ALIKE: Final = {"motion": "calibration", "homing_deviation": 0.0}
_HELD: Final = 0.15
"""Error under a weight that counts as held [deg]."""


def population_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen; a weight of 0 g is none."""
    settings.check_names("method", "methods", m.METHODS)
    common = {
        "methods": settings["methods"],
        "motion": settings["motion"],
        "homing_deviation": settings["homing_um"] / 1e6,
        "loads": [way for way in product(settings["masses_g"], settings["directions"]) if way[0]],
    }
    for grams, direction in common["loads"]:
        m.load_test(1e-3 * grams, direction)  # refuses what cannot be
    ZeroShift.drawn(common["homing_deviation"], 0)  # the same
    return _one_each(settings, "specimen", "specimen", common)


def _one_each(settings: Settings, key: str, label: str, common: Mapping[str, Any]) -> list[Part]:
    """One part a specimen, to be judged."""
    drawn = population(settings["count"], settings.seed, settings["prior"])
    arguments = [{"forceps": p.to_dict(), "number": n, **common} for n, p in enumerate(drawn)]
    return [Part(f"{key}-{n:05d}", judge, own, {label: n}) for n, own in enumerate(arguments)]


def judge(
    forceps: Plain,
    methods: Sequence[str],
    motion: str,
    homing_deviation: float,
    loads: Sequence[tuple[Any, ...]],
    number: int,
) -> Rows:
    """Calibrate methods on one motion; judge them on (28), and in phase IV of each load.

    A load is a mass [g] and a direction; one with a rate [Hz] swings all along (28) instead.

    The specimen is homed anew in between: its cable encoders' zeros vary by `homing_deviation` [m].
    Its `number` is the seed of its noise and homing, and of the hands that hang the weights [g].
    """
    plant = ForcepsParameters.from_dict(forceps)
    zero = ZeroShift.drawn(homing_deviation, number) if homing_deviation > 0.0 else ZeroShift()
    run = m.settled(m.record(plant, "verification", seed=2 * number + 1, zero_shift=zero))
    models = m.calibrated(plant, tuple(methods), number, motion)
    inside = covered(models, run, m.SETTLED) if loads else None
    rows = m.errors(m.judge(models, run), load=UNLOADED, inside=inside)
    for mass, direction, *rate in loads:
        if rate:  # it swings all the time, or is steady
            load = SwingingLoad(1e-3 * mass, rate[0], direction == "opening")
            hung = m.record(plant, "verification", seed=2 * number + 1, load=load)
            first, last, name = m.SETTLED, math.inf, f"{rate[0]:g} Hz, {direction}"
        else:
            test = m.load_test(1e-3 * mass, direction, quick=True, end=17.0)
            hung = m.record(plant, test, seed=100 * number + round(mass))
            (first, last), name = test.phases["IV"], f"{mass:g} g {direction}"
        labels = {"load": name, "inside": covered(models, hung, first)}
        rows += m.errors(m.judge(models, hung), first, last, **labels)
    return rows


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
        table = table.join(quantiles(loaded, "name", "deg", under))
        table = table.join(held.rename(f"IV within {_HELD:g} deg"))
    about = {**settings.options, "seed": settings.seed, "specimens": len(results.arrays)}
    notes = notes_on("population", **about, hung=notes_on("hung")[0] if len(loaded) else "")
    notes += _within(unloaded, loaded) if len(loaded) and m.BEST in rms else ()
    notes += m.note_left_out(settings, rows)
    claims, count = [], len(rms)
    if set(m.PAPERS) <= set(rms) and not len(loaded):
        value = share(rms, *m.PAPERS)
        found = f"in {100 * value:.0f} % of {count} drawn"
        holds = mostly(round(value * count), count)
        claims.append(CLAIMS["order-population"].claim(holds, found, "", count))
    title = "Population of virtual forceps"
    name = "forceps-mixed" if len(loaded) else "forceps-population"
    caption = "Share of specimens, and of weights on specimens, with a smaller error, by method."
    drawn = rows.assign(case=np.where(rows.load == UNLOADED, "unloaded, (28)", "phase IV"))
    figure = ecdf_figure(title, drawn, "name", "case", caption, colours=m.COLOURS)
    return Summary((frame_table(title, table, notes, head="method"),), {name: figure}, claims)


def share(errors: DataFrame, *methods: str) -> float:
    """Share of specimens (rows) in which each method's error is larger than the next one's."""
    return float(np.all(np.diff(errors[list(methods)]) < 0.0, axis=1).mean())


def _within(unloaded: DataFrame, loaded: DataFrame) -> list[str]:
    """State how often our default stays within its half-width."""
    alone, cases = (select(rows, method=m.BEST).inside for rows in (unloaded, loaded))
    shares = {"level": LEVEL, "alone": alone.mean(), "worst": alone.min(), "loaded": cases.mean()}
    percent = {name: 100 * share for name, share in shares.items()}
    return notes_on("within", title=m.TITLES[m.BEST], **percent)


def tension_parts(settings: Settings) -> Sequence[Part]:
    """One a friction law, specimen and tension of its cables, with nothing else changed."""
    settings.check_names("prior", "priors", PRIORS)
    settings.check_names("method", "methods", m.METHODS)
    loads = list(product(settings["masses_g"], settings["directions"]))
    common = {**_HOMED_ALIKE, "methods": settings["methods"], "loads": loads}
    return [
        Part(
            f"{prior}-{n:05d}-{factor:g}", judge,
            {"forceps": m.tensioned(p, factor).to_dict(), "number": n, **common},
            {"prior": prior, "specimen": f"{prior} {n}", "tension": factor},
        )
        for prior in settings["priors"]
        for n, p in enumerate(population(settings["count"], settings.seed, prior))
        for factor in settings["tensions"]
    ]  # fmt: skip


def tension_summary(results: Results) -> Summary:
    """Errors of every method by the cables' tension, and whether more of it helps the filter."""
    settings, rows = results.settings, results.rows
    case = np.where(rows.load == UNLOADED, "unloaded, ", "IV, ") + rows.prior
    case = rows.tension.map("{:g} of the tension, ".format) + case
    rows = rows.assign(deg=np.degrees(rows.rms), name=rows.method.map(m.TITLES), case=case)
    table = rows.pivot_table("deg", "case", "name", "median", sort=False).map("{:.3f}".format)
    grams = ", ".join(f"{mass:g}" for mass in settings["masses_g"])
    notes = notes_on("tension", **settings.options, grams=grams)
    made = (frame_table("Tension of the cables", table, notes, head="cables"),)
    hung = select(rows[rows.load != UNLOADED], method=m.PAPERS_BEST)
    errors = hung.pivot_table("deg", "specimen", "tension")
    if errors.shape[1] < 2:
        return Summary(made)
    count, means = len(errors), errors.mean()
    better = int((errors.iloc[:, -1] < errors.iloc[:, 0]).sum())
    found = (
        f"in {better} of {count} specimens of {', '.join(settings['priors'])}; mean in phase IV "
        f"{means.iloc[0]:.2f} deg at {means.index[0]:g} of the tension, {means.iloc[-1]:.2f} at "
        f"{means.index[-1]:g}"
    )
    return Summary(made, claims=(CLAIMS["tension"].claim(mostly(better, count), found, "", count),))


def swinging_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen; at 0 Hz a load is steady."""
    settings.check_names("method", "methods", m.METHODS)
    rates = (0.0, *settings["swings_hz"])
    _ = [SwingingLoad(1e-3 * settings["mass_g"], rate) for rate in rates]  # refuses what cannot be
    loads = list(product([settings["mass_g"]], ("shutting", "opening"), rates))
    common = {**_HOMED_ALIKE, "methods": settings["methods"], "loads": loads}
    return _one_each(settings, "swung", "session", common)


def swinging_summary(results: Results) -> Summary:
    """Errors by load and method, and whether our default's are below those of the paper's."""
    settings, rows = results.settings, results.rows
    rows = rows.assign(rmse=np.degrees(rows.rms), name=rows.method.map(m.TITLES))
    notes = notes_on("swinging", **settings.options, seed=settings.seed, rule=RULE)
    texts = median_texts(rows, ["load", "name"], "rmse", 3)
    table = frame_table("Loads that swing", texts, notes, head="load")
    swung = [name for name in rows.load.unique() if name != UNLOADED and name[0] != "0"]
    low, high = ({"method": name} for name in (m.BEST, m.PAPERS_BEST))
    claim = CLAIMS["swinging"]._replace(judge=ordered(low, high, {"load": swung}))
    judged = {m.BEST, m.PAPERS_BEST} <= set(rows.method) and swung
    return Summary((table,), claims=[claim.judged(rows)] if judged else ())


_SENSORS: Final = {"motor": MOTOR, "x1": DRIVE, "x2": RESET}
LAYOUTS: Final = {
    name: tuple(_SENSORS[sensor] for sensor in name.split("+"))
    for name in ("motor", "x1", "x2", "motor+x2", "x1+x2")
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
_DESIGNS: Final = ("stiffnesses_kNm", "frictions", "tensions")
_LOADS: Final = ["unloaded", "loaded"]


def encoders(layout: str) -> int:
    """Count the encoders on the cables."""
    return sum(name != MOTOR for name in LAYOUTS[layout])


def sweep_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, stiffness and friction: sensors are tried on the same motion."""
    settings.check_names("layout", "layouts", LAYOUTS)
    if not all(value > 0.0 for value in settings["resolutions_um"]):
        raise StudyError("resolutions_um must be above 0")
    for spread in settings["homings_um"]:
        ZeroShift.drawn(spread / 1e6, 0)  # refuses what cannot be drawn
    common = {
        "layouts": settings["layouts"],
        "resolutions": [value / 1e6 for value in settings["resolutions_um"]],
        "homings": [value / 1e6 for value in settings["homings_um"]],
        "mass": settings["mass_g"] / 1e3,
    }
    plants = population(settings["count"], settings.seed, settings["prior"])
    designs = product(enumerate(plants), *(settings[name] for name in _DESIGNS))
    return [
        Part(
            f"specimen-{n:03d}-{k:g}-{f:g}-{t:g}", measure,
            {"forceps": designed(plant, 1e3 * k, f, t).to_dict(), "number": n, **common},
            {"specimen": n, "stiffness": 1e3 * k, "friction": f, "tension": t},
        )
        for (n, plant), k, f, t in designs
    ]  # fmt: skip


def designed(
    plant: ForcepsParameters, stiffness: float, friction: float, tension: float = 1.0
) -> ForcepsParameters:
    """Specimen with cables of a `stiffness` [N/m] and multiples of its `friction` and `tension`.

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
    return m.tensioned(plant.with_values(values), tension)


def sensed(recording: Recording, resolution: float, zero: ZeroShift, seed: int) -> Recording:
    """Read the cables' encoders of a recording at a resolution [m], each off by its zero."""
    rng = np.random.default_rng(seed)
    for name, shift in ((DRIVE, zero.drive), (RESET, zero.reset)):
        exact = recording.column(name) + shift
        noise = rng.normal(0.0, NOISE * resolution, len(exact))
        recording = m.changed(recording, name, quantised(exact + noise, resolution))
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
    tests = [m.load_test(mass, way, **_WEIGHT) for way in ("opposing", "along")]
    still = [test.phases["IV"][0] for test in tests]
    taught = m.settled(m.record(plant, "calibration", seed=4 * number, **rate))
    verified = m.settled(m.record(plant, "verification", seed=4 * number + 1, **rate))
    hung = [m.record(plant, t, seed=4 * number + 2 + i, **rate) for i, t in enumerate(tests)]
    for layout, resolution, homing in product(layouts, resolutions, homings):
        if not encoders(layout) and (resolution, homing) != (resolutions[0], homings[0]):
            continue  # nothing that these change
        zero = ZeroShift.drawn(homing, number)
        names = LAYOUTS[layout]
        X, dt = m.signals(sensed(taught, resolution, ZeroShift(), number), *names)
        estimator: Any = GatedPlays() if layout == "motor+x2" else JawPlays(signals=names)
        estimator.fit(X, taught.column("truth/jaw"), dt=dt)
        errors = []
        for run, first in ((verified, -math.inf), *zip(hung, still, strict=True)):
            X, dt = m.signals(sensed(run, resolution, zero, number), *names)
            error = np.ravel(estimator.predict(X, dt)) - run.column("truth/jaw")
            errors.append(float(np.sqrt(np.nanmean(error[run.t >= first] ** 2))))
        design = {"layout": layout, "resolution": resolution, "homing": homing}
        rows.append({**design, "unloaded": errors[0], "loaded": max(errors[1:])})
    return rows


def sweep_summary(results: Results) -> Summary:
    """Errors of every design, in the median and at worst, and how many reach the target."""
    settings, rows = results.settings, results.rows
    rows = rows.assign(
        sensors=[sensors(row) for row in rows.itertuples()],
        cables=(rows.stiffness / 1e3).map("{:g} kN/m".format),
        **{load: np.degrees(rows[load]) for load in _LOADS},
    )
    by = rows.groupby(["sensors", "cables"], sort=False)[_LOADS]
    reach = (by.max() <= settings["target_deg"]).all(axis=1)
    good = "; ".join(map(", ".join, reach[reach].index)) or "none"
    notes = notes_on("sweep", **settings.options, seed=settings.seed, good=good)
    tables = []
    for title, errors in (("median", by.median()), ("worst specimen", by.max())):
        texts = errors.map("{:.3f}".format)
        grid = (texts.unloaded + "/" + texts.loaded).unstack()
        grid = grid.loc[rows.sensors.unique(), rows.cables.unique()]
        tables.append(frame_table(f"Every design, {title}", grid, notes, head="sensors"))
    return Summary(tables)


def sensors(design: Any) -> str:
    """Name all of a design but its cables' stiffness, in a person's units."""
    homed = f", homed to {1e6 * design.homing:g} um"
    at = f" at {1e6 * design.resolution:g} um{homed}" if encoders(design.layout) else " only"
    rubs = "" if design.friction == 1.0 else f", friction x {design.friction:g}"
    return f"{design.layout}{at}{rubs}"
