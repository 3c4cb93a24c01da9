"""Which sensors, cables, friction and homing buy which accuracy: a designer's question."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
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
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table, median_text

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


@dataclass(frozen=True)
class Design:
    """One choice of a designer; lengths [m], stiffness [N/m], friction in that of the specimens."""

    layout: str
    resolution: float
    stiffness: float
    friction: float
    homing: float

    @property
    def encoders(self) -> int:
        """Encoders on the cables."""
        return sum(name != MOTOR for name in LAYOUTS[self.layout])

    @property
    def key(self) -> str:
        """Its name in a part, which says all but stiffness and friction."""
        return f"{self.layout}/{1e6 * self.resolution:g}/{1e6 * self.homing:g}"


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, stiffness and friction: sensors are tried on the same motion."""
    if unknown := [name for name in settings["layouts"] if name not in LAYOUTS]:
        raise StudyError(f"no layout {', '.join(unknown):.60}; known: {', '.join(LAYOUTS)}")
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
    found = []
    for (n, plant), k, f in product(
        enumerate(plants), settings["stiffnesses_kNm"], settings["frictions"]
    ):
        forceps = designed(plant, 1e3 * k, f).to_dict()
        arguments = {"forceps": forceps, "number": n, **common}
        found.append(Part(part_key(n, k, f), measure, arguments))
    return found


def part_key(number: int, stiffness: float, friction: float) -> str:
    """Name of the part of a specimen, a stiffness [kN/m] and a friction."""
    return f"specimen-{number:03d}-{stiffness:g}-{friction:g}"


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
) -> PartResult:
    """Calibrate every layout at every resolution on (27), and judge it on (28) and under a load.

    Homed anew in between; RMS errors [rad] against the reference encoder, loaded the worse of both
    directions.
    """
    plant = built(forceps)
    rate = {"log_rate": 100.0}
    ways: tuple[Any, ...] = ("opposing", "along")
    tests = [LoadTest(mass, way, end=_LOADED_END, **_WEIGHT) for way in ways]
    taught = settled(record(plant, "calibration", seed=4 * number, **rate))
    verified = settled(record(plant, "verification", seed=4 * number + 1, **rate))
    hung = [record(plant, t, seed=4 * number + 2 + i, **rate) for i, t in enumerate(tests)]
    found = {}
    for layout, resolution, homing in product(layouts, resolutions, homings):
        design = Design(layout, resolution, 0.0, 0.0, homing)
        if not design.encoders and (resolution, homing) != (resolutions[0], homings[0]):
            continue  # nothing that these change
        zero = ZeroShift.drawn(homing, number)
        estimator = fitted(layout, sensed(taught, resolution, ZeroShift(), number))
        unloaded = rms(estimator, layout, sensed(verified, resolution, zero, number), -math.inf)
        loaded = [
            rms(estimator, layout, sensed(one, resolution, zero, number), test.phases["IV"][0])
            for one, test in zip(hung, tests, strict=True)
        ]
        found[design.key] = {"unloaded": unloaded, "loaded": max(loaded)}
    return PartResult(found)


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


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Errors of every design, those that no cheaper one beats, and what reaches the target."""
    errors = _errors(settings, results)
    prices = dict(zip(settings["resolutions_um"], settings["prices"], strict=True))
    price = {d: d.encoders * prices[round(1e6 * d.resolution, 6)] for d in errors}
    worst = {d: max(e["unloaded"].max(), e["loaded"].max()) for d, e in errors.items()}
    best = front(price, {d: _typical(e) for d, e in errors.items()})
    target = math.radians(settings["target_deg"])
    reach = [d for d, error in worst.items() if error <= target]
    cheapest = min(reach, key=lambda d: (price[d], worst[d]), default=None)
    answer = (
        "no design does" if cheapest is None else f"{named(cheapest)}, price {price[cheapest]:g}"
    )
    notes = (
        "RMS error in degrees against the reference encoder, median (worst) of "
        f"{settings['count']} specimens of seed {settings.seed}, prior {settings['prior']}, each "
        f"homed anew: on (28), and still under {settings['mass_g']:g} g, the worse of both "
        "directions.",
        f"Cheapest design that keeps {settings['target_deg']:g} deg on every specimen, loaded and "
        f"unloaded: {answer}. Prices are assumed; --set prices=... takes yours.",
    )
    chosen = [
        (named(d), f"{price[d]:g}", _pair(errors[d]["unloaded"]), _pair(errors[d]["loaded"]))
        for d in best
    ]
    header = ("design", "price", "unloaded", f"under {settings['mass_g']:g} g")
    tables = (
        Table("Designs that no cheaper one beats", header, tuple(chosen), notes),
        _grid(settings, errors),
    )
    return Summary(tables, {"forceps-sweep": _figure(settings, errors, price, best)})


def named(design: Design) -> str:
    """Name a design in a person's units."""
    sensors = f" at {1e6 * design.resolution:g} um" if design.encoders else " only"
    homed = f", homed to {1e6 * design.homing:g} um" if design.encoders else ""
    rubs = "" if design.friction == 1.0 else f", friction x {design.friction:g}"
    return f"{design.layout}{sensors}{homed}, {design.stiffness / 1e3:g} kN/m{rubs}"


def front(price: Mapping[Design, float], error: Mapping[Design, float]) -> list[Design]:
    """Designs, cheapest first, that err less than every cheaper one: the Pareto front."""
    found: list[Design] = []
    for design in sorted(price, key=lambda d: (price[d], error[d])):
        if not found or error[design] < error[found[-1]]:
            found.append(design)
    return found


def _errors(
    settings: Settings, results: Mapping[str, PartResult]
) -> dict[Design, dict[str, Array]]:
    """Errors [rad] of each design, unloaded and loaded, (count,) over the specimens."""
    found = {}
    lists = (settings[name] for name in ("layouts", "resolutions_um", "homings_um"))
    for layout, um, spread in product(*lists):
        for k, friction in product(settings["stiffnesses_kNm"], settings["frictions"]):
            design = Design(layout, um / 1e6, 1e3 * k, friction, spread / 1e6)
            own = [results[part_key(n, k, friction)].numbers for n in range(settings["count"])]
            if design.key in own[0]:
                both = ("unloaded", "loaded")
                found[design] = {b: np.array([one[design.key][b] for one in own]) for b in both}
    return found


def _typical(error: Mapping[str, Array]) -> float:
    """Larger of the medians [rad] over the specimens, unloaded and loaded."""
    return max(float(np.median(values)) for values in error.values())


def _pair(values: Array) -> str:
    return median_text(np.degrees(values), 3)


def _grid(settings: Settings, errors: Mapping[Design, Mapping[str, Array]]) -> Table:
    """Medians of every design, a row for what does not change the cables' stiffness."""
    rows: dict[str, list[str]] = {}
    for design, found in errors.items():
        name = named(design).replace(f", {design.stiffness / 1e3:g} kN/m", "")
        medians = [degrees_text(float(np.median(found[b]))) for b in ("unloaded", "loaded")]
        rows.setdefault(name, []).append("/".join(medians))
    header = ("sensors", *(f"{k:g} kN/m" for k in settings["stiffnesses_kNm"]))
    note = f"Median RMS error in degrees, unloaded/under {settings['mass_g']:g} g."
    return Table("Every design", header, tuple((n, *c) for n, c in rows.items()), (note,))


def _figure(
    settings: Settings,
    errors: Mapping[Design, Mapping[str, Array]],
    price: Mapping[Design, float],
    best: Sequence[Design],
) -> Figure:
    finest, usual = min(d.resolution for d in errors), min(d.homing for d in errors)
    friction = settings["frictions"][0]
    middle = sorted(settings["stiffnesses_kNm"])[len(settings["stiffnesses_kNm"]) // 2]
    plain = [d for d in errors if (d.homing, d.friction) == (usual, friction)]
    by_stiffness: list[Curve] = []
    by_resolution: list[Curve] = []
    both: list[Curve] = []
    costs: list[Curve] = []

    def medians(designs: Sequence[Design], which: str) -> list[float]:
        return [math.degrees(float(np.median(errors[one][which]))) for one in designs]

    def typical(designs: Sequence[Design]) -> tuple[list[float], list[float]]:
        return [price[d] for d in designs], [math.degrees(_typical(errors[d])) for d in designs]

    for layout in settings["layouts"]:
        look = layout, _COLOURS[layout]
        own = [d for d in plain if d.layout == layout]
        row = [d for d in own if d.resolution == finest or not d.encoders]
        x = [d.stiffness / 1e3 for d in row]
        by_stiffness.append(Curve(x, medians(row, "loaded"), *look, "o-"))
        column = [d for d in own if d.stiffness == 1e3 * middle]
        if column and column[0].encoders:
            x = [1e6 * d.resolution for d in column]
            by_resolution.append(Curve(x, medians(column, "unloaded"), *look, "o-"))
        every = [d for d in errors if d.layout == layout]
        both.append(Curve(medians(every, "unloaded"), medians(every, "loaded"), *look, "o"))
        costs.append(Curve(*typical(every), *look, "o"))
    costs.append(Curve(*typical(best), "", "k", "--o"))
    mass = f"under {settings['mass_g']:g} g"
    rms_name = "median RMS error [deg]"
    panels = (
        (
            Panel(
                by_stiffness, "cable stiffness [kN/m]", rms_name,
                f"{mass}, at {1e6 * finest:g} um", "xy",
            ),
            Panel(
                by_resolution, "resolution of the cables' encoders [um]", rms_name,
                f"unloaded, {middle:g} kN/m", "xy",
            ),
        ),
        (
            Panel(both, "unloaded [deg]", f"{mass} [deg]", "every design", "xy"),
            Panel(
                costs, "price of the cables' encoders", rms_name,
                "the worse of both; line: none better for less", "y",
            ),
        ),
    )  # fmt: skip
    caption = (
        "Median over the specimens. Above: what stiffness and resolution buy. Below: every design "
        "without a load and with one, and against the price of its encoders; the line joins those "
        "that none beats for less."
    )
    return Figure("What accuracy costs", panels, caption, height=7.5, legend=True)
