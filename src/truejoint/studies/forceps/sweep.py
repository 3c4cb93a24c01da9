"""Which sensors, cables, friction and homing buy which accuracy: a designer's question."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any, Final

import numpy as np
from pandas import DataFrame, concat

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel, by_condition
from truejoint.errors import StudyError
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.jaw_load.gated_plays import GatedPlays
from truejoint.estimators.plays.jaw_plays import JawPlays
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.sensors import ZeroShift, quantised
from truejoint.simulation.forceps.specimens import population
from truejoint.studies.forceps.methods import settled, within
from truejoint.studies.forceps.motions import Plain, built, changed, record
from truejoint.studies.rows import Cell, each, groups, select, table_of
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed, median_text

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
_COLOURS: Final = dict(
    zip(LAYOUTS, ("0.5", "tab:orange", "tab:olive", "tab:green", "tab:blue"), strict=True)
)
_FRICTIONS: Final = (
    "jaw_friction.constant", "jaw_friction.tension_share",
    "slider_friction.constant", "slider_friction.tension_share",
)  # fmt: skip
_WEIGHT: Final = {"speed": math.radians(10.0), "start": 1.0, "loaded_from": 5.0, "loaded_to": 7.0}
_LOADED_END: Final = 10.5  # [s]


_DESIGN: Final = ["layout", "resolution", "stiffness", "friction", "homing"]
"""Columns that make a design: lengths [m], stiffness [N/m], friction in that of the specimens."""


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
    plant, rate, rows = built(forceps), {"log_rate": 100.0}, Rows()
    ways: tuple[Any, ...] = ("opposing", "along")
    tests = [LoadTest(mass, way, end=_LOADED_END, **_WEIGHT) for way in ways]
    taught = settled(record(plant, "calibration", seed=4 * number, **rate))
    verified = settled(record(plant, "verification", seed=4 * number + 1, **rate))
    hung = [record(plant, t, seed=4 * number + 2 + i, **rate) for i, t in enumerate(tests)]
    for layout, resolution, homing in product(layouts, resolutions, homings):
        if not encoders(layout) and (resolution, homing) != (resolutions[0], homings[0]):
            continue  # nothing that these change
        zero = ZeroShift.drawn(homing, number)
        estimator = fitted(layout, sensed(taught, resolution, ZeroShift(), number))
        unloaded = rms(estimator, layout, sensed(verified, resolution, zero, number), -math.inf)
        loaded = [
            rms(estimator, layout, sensed(one, resolution, zero, number), test.phases["IV"][0])
            for one, test in zip(hung, tests, strict=True)
        ]
        design = {"layout": layout, "resolution": resolution, "homing": homing}
        rows.append({**design, "unloaded": unloaded, "loaded": max(loaded)})
    return rows


def fitted(layout: str, recording: Recording) -> JointRegressor:
    """Plays on what a layout measures, fitted to the rows of a recording with a truth."""
    gated = layout == "motor+x2"
    X, dt = rows(layout, recording)
    estimator = GatedPlays() if gated else JawPlays(signals=LAYOUTS[layout])
    return estimator.fit(X, recording.column("truth/jaw"), dt=dt)


def rows(layout: str, recording: Recording) -> tuple[Array, Array]:
    """Features (n, k) of a layout, and time since the row before (n,) [s]."""
    X = np.column_stack([recording.column(name) for name in LAYOUTS[layout]])
    return X, time_steps(recording.t, np.inf)


def rms(estimator: JointRegressor, layout: str, recording: Recording, first: float) -> float:
    """RMS error [rad] of an estimate where there is a truth, from `first` [s] on."""
    X, dt = rows(layout, recording)
    error = np.ravel(estimator.predict(X, dt)) - recording.column("truth/jaw")
    return float(np.sqrt(np.nanmean(error[within(recording.t, first, np.inf)] ** 2)))


def summarise(results: Results) -> Summary:
    """Errors of every design, those that no cheaper one beats, and what reaches the target."""
    settings, rows = results.settings, results.rows
    prices = dict(zip(settings["resolutions_um"], settings["prices"], strict=True))
    unit = (1e6 * rows.resolution).round(6).map(prices)
    rows = rows.assign(price=rows.layout.map(encoders) * unit, name=[*map(named, each(rows))])
    by_name, loads = rows.groupby("name", sort=False), ["unloaded", "loaded"]
    medians = by_name[loads].median()
    designs = by_name[[*_DESIGN, "price"]].first().join(medians)
    designs = designs.assign(typical=medians.max(axis=1), worst=by_name[loads].max().max(axis=1))
    best = front(designs)
    reach = designs[designs.worst <= math.radians(settings["target_deg"])]
    reach = reach.sort_values(["price", "worst"], kind="stable")
    answer = f"{reach.index[0]}, price {reach.price.iloc[0]:g}" if len(reach) else "no design does"
    notes = (
        "RMS error in degrees against the reference encoder, median (worst) of "
        f"{settings['count']} specimens of seed {settings.seed}, prior {settings['prior']}, each "
        f"homed anew: on (28), and still under {settings['mass_g']:g} g, the worse of both "
        "directions.",
        f"Cheapest design that keeps {settings['target_deg']:g} deg on every specimen, loaded and "
        f"unloaded: {answer}. Prices are assumed; --set prices=... takes yours.",
    )
    under = f"under {settings['mass_g']:g} g"
    chosen = concat([select(rows, name=name) for name in best.index])
    cells: dict[str, Cell] = {
        "price": lambda group: f"{group.price.iloc[0]:g}",
        "unloaded": lambda group: median_text(np.degrees(group.unloaded), 3),
        under: lambda group: median_text(np.degrees(group.loaded), 3),
    }
    title = "Designs that no cheaper one beats"
    tables = (
        table_of(title, chosen, "name", cells, notes, head="design"),
        _grid(settings, rows),
    )
    return Summary(tables, {"forceps-sweep": _figure(settings, designs, best)})


def named(design: Any) -> str:
    """Name a design, a row with the columns of one, in a person's units."""
    homed = f", homed to {1e6 * design.homing:g} um"
    sensors = f" at {1e6 * design.resolution:g} um{homed}" if encoders(design.layout) else " only"
    rubs = "" if design.friction == 1.0 else f", friction x {design.friction:g}"
    return f"{design.layout}{sensors}, {design.stiffness / 1e3:g} kN/m{rubs}"


def front(designs: DataFrame) -> DataFrame:
    """Designs, cheapest first, that err less than every cheaper one: the Pareto front."""
    ordered = designs.sort_values(["price", "typical"], kind="stable")
    least = ordered.typical.cummin().shift(fill_value=math.inf)
    return ordered[ordered.typical < least]


def _grid(settings: Settings, rows: DataFrame) -> Table:
    """Medians of every design, a row for what does not change the cables' stiffness."""
    names = [
        name.replace(f", {k / 1e3:g} kN/m", "")
        for name, k in zip(rows.name, rows.stiffness, strict=True)
    ]

    def cell(stiffness: float) -> Cell:
        return lambda group: "/".join(
            fixed(math.degrees(select(group, stiffness=stiffness)[load].median()), 3)
            for load in ("unloaded", "loaded")
        )

    cells = {f"{k:g} kN/m": cell(1e3 * k) for k in settings["stiffnesses_kNm"]}
    note = f"Median RMS error in degrees, unloaded/under {settings['mass_g']:g} g."
    return table_of("Every design", rows.assign(sensors=names), "sensors", cells, (note,))


def _figure(settings: Settings, designs: DataFrame, best: DataFrame) -> Figure:
    finest, usual = designs.resolution.min(), designs.homing.min()
    middle = sorted(settings["stiffnesses_kNm"])[len(settings["stiffnesses_kNm"]) // 2]
    plain = select(designs, homing=usual, friction=settings["frictions"][0])
    sensors = plain.layout.map(encoders) > 0
    stiff = plain[(plain.resolution == finest) | ~sensors]
    fine = plain[sensors & (plain.stiffness == 1e3 * middle)]
    look: dict[str, Any] = {"by": "layout", "scale": math.degrees(1.0), "colours": _COLOURS}
    look["y"] = "median RMS error [deg]"
    costs = [
        Curve(group.price, np.degrees(group.typical), layout, _COLOURS[layout], "o")
        for layout, group in groups(designs, "layout")
    ]
    costs.append(Curve(best.price, np.degrees(best.typical), "", "k", "--o"))
    mass, none = f"under {settings['mass_g']:g} g", "the worse of both; line: none better for less"
    panels = (
        by_condition(
            stiff.assign(kNm=stiff.stiffness / 1e3), "kNm", "loaded", log="xy",
            x="cable stiffness [kN/m]", title=f"{mass}, at {1e6 * finest:g} um", **look,
        ),
        by_condition(
            fine.assign(um=1e6 * fine.resolution), "um", "unloaded", log="xy",
            x="resolution of the cables' encoders [um]", title=f"unloaded, {middle:g} kN/m", **look,
        ),
        Panel(costs, "price of the cables' encoders", look["y"], none, "y"),
    )  # fmt: skip
    caption = (
        "Median over the specimens: what stiffness and resolution buy, and every design against "
        "the price of its encoders; the line joins those that none beats for less."
    )
    return Figure("What accuracy costs", (panels,), caption, width=13.0, legend=True)
