"""Which sensors, cables, friction and homing buy which accuracy: a designer's question."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.drawing import PALETTE, Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.jaw_load.learn import GatedPlays
from truejoint.estimators.plays.learn import JawPlays
from truejoint.recordings import Recording
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ZeroShift, quantised
from truejoint.studies.forceps.methods import settled
from truejoint.studies.forceps.motions import Plain, changed, load_test, record, signals
from truejoint.studies.rows import frame_table, groups, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary

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


def parts(settings: Settings) -> Sequence[Part]:
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


def summarise(results: Results) -> Summary:
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
