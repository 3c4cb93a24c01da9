"""Setting the jaw and not the motor: tracking errors with an estimate in the loop and without."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Final, cast

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration import Calibration
from truejoint.crtk import Arm
from truejoint.crtk.backends.simulated import SimulatedBackend
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import CommandRefused
from truejoint.motion.forceps_trajectories import verification_trajectory
from truejoint.robots.blocks import StateBlock, TruthBlock
from truejoint.robots.joint_rows import SETPOINT_DT
from truejoint.runtime import Compensator, Corrector, Status
from truejoint.runtime.loop_gain import check_rate
from truejoint.simulation.forceps.load import SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ForcepsTwin
from truejoint.simulation.twin import Twin, glide, hold
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, title_of
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table

OPEN: Final = "open"
"""Stands for no method: the motor is sent where the jaw should be."""
KNOWN: Final = Status.OUT_OF_DOMAIN | Status.OUT_OF_RANGE | Status.IMPLAUSIBLE
"""A load takes motor, x2 and their errors where the calibration, unloaded, never was."""
BARS: Final = {"none": 0.12, "steady": 0.25}
"""Wanted of the error with our estimate in the loop, without a load and with a steady one [deg]."""
MARGINS: Final = (1.0, 2.0)
"""Factors of the gain at which stability is tried."""
QUICK: Final = 0.005
"""Time constant of what the loop takes for lost [s]."""
DEAD_BAND: Final = math.radians(0.05)
"""Of the loop where the jaw shall stand still [rad], half a step of the reference encoder."""
SWING: Final = math.radians(0.05)
"""Standard deviation of a jaw told to stand still from which it counts as swinging [rad]."""
_ASTRAY: Final = math.radians(1.0)  # a jaw told to stand still is unstable from this error on
_A_PERIOD: Final = 22.0  # [s] of (28), enough on the specimens of a population
_STEPS: Final = (0.0, 0.35, -0.2, 0.0)  # [rad] where the jaw stands still in turn
_STANDS: Final = 2.0  # [s]
_AT_REST: Final = 0.5  # [s] of them, the last


def parts(settings: Settings) -> Sequence[Part]:
    """One a load and method on the specimen, and two a specimen of the population."""
    seconds = settings["seconds"]
    how = {"rate": settings["rate_hz"], "gain": settings["gain"]}
    common = m.common_arguments(settings)
    plants = population(settings["count"], settings.seed, settings["prior"])
    for plant in (built(common["forceps"]), *plants):
        check_rate(how["rate"], lag(plant), how["gain"])
    loads = _loads(settings)
    found = []
    for number, load in enumerate(loads.values()):
        for method in (OPEN, *common["methods"]):
            case = {"method": method, "load": load, "seconds": seconds, **how}
            found.append(Part(f"{number}-{method}", track_28, {**common, **case}))
    motion = {"methods": common["methods"], "mass": settings["mass_g"] / 1e3, **how}
    for n, plant in enumerate(plants):
        own = {"forceps": plant.to_dict(), "number": n}
        some = {**own, **motion, "seconds": min(seconds, _A_PERIOD)}
        found.append(Part(f"specimen-{n:05d}", track_specimen, some))
        rests = {**own, **how, "method": common["methods"][-1]}
        found.append(Part(f"margin-{n:05d}", try_margins, rests))
    return found


def _loads(settings: Settings) -> dict[str, tuple[float, float, bool]]:
    """Arguments of `SwingingLoad` by the name of a load on the specimen; refuses what cannot be."""
    mass = settings["mass_g"] / 1e3
    loads = {
        "none": (0.0, 0.0, False),
        "steady, shutting": (mass, 0.0, False),
        "steady, opening": (mass, 0.0, True),
        **{f"{f:g} Hz, shutting": (mass, f, False) for f in settings["swings_hz"]},
    }
    for load in loads.values():
        SwingingLoad(*load)
    return loads


def lag(plant: ForcepsParameters) -> float:
    """Time by which the motor follows a set-point that moves evenly [s]."""
    return plant.motor_loop.damping_ratio / (math.pi * plant.motor_loop.bandwidth)


class _Heard:
    """Jaw angles that an arm on a twin tells: of the reference encoder, and exact."""

    def __init__(self, arm: Arm) -> None:
        self.reference: list[Array] = []
        self.exact: list[Array] = []
        arm.subscribe(self)

    def __call__(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            self.reference.append(block.position[:, 0])
        else:
            self.exact.append(block.extra["truth_exact/jaw"])


def follow_jaw(
    plant: ForcepsParameters,
    model: Calibration | None,
    wanted: Array,
    load: SwingingLoad,
    *,
    seed: int,
    rate: float,
    gain: float,
    margin: float = 1.0,
) -> tuple[Array, Array, Integers]:
    """Put a specimen's jaw along angles `wanted` (n,) [rad] at 1 kHz, homed anew.

    With a calibration as `model` in a loop, at `margin` times its gain, or with none. Returns the
    jaw's angle (m,) [rad] by the reference encoder and exactly, and the statuses of the
    corrector's steps (k,).
    """
    twin = ForcepsTwin(plant, seed=seed)
    arm = Arm(SimulatedBackend(cast("Twin", twin)))
    arm.enable()
    arm.home()
    start = arm.time
    twin.tip_force = lambda t: load.force(t - start)
    heard, status = _Heard(arm), np.zeros(0, dtype=np.int64)
    if model is None:
        arm.wait(SETPOINT_DT)
        arm.servo_jp_stream(wanted[:, None])
    else:
        corrector = Corrector(model.without_redundant())
        corrector.set_homing(True)
        compensator = Compensator(
            corrector,
            arm.robot,
            rate=rate,
            lag=lag(plant),
            gain=gain,
            time_constant=QUICK,
            integral_time=math.inf,
            dead_band=DEAD_BAND,
            believed=KNOWN,
        )
        compensator.gain *= margin
        compensator.drive(arm, wanted[:, None])
        status = np.array(list(compensator.statuses.elements()), dtype=np.int64)
    reference, exact = (np.concatenate(found)[1:] for found in (heard.reference, heard.exact))
    return reference, exact, status


def errors(wanted: Array, followed: tuple[Array, Array, Integers]) -> dict[str, float]:
    """RMS error [rad] once settled, to the reference and exactly, and the share corrected."""
    *angles, status = followed
    first, rows = round(m.SETTLED / SETPOINT_DT), len(angles[0])
    rms = [float(np.sqrt(np.mean((a - wanted[:rows])[first:] ** 2))) for a in angles]
    corrected = float(np.mean(status & ~int(KNOWN) == 0)) if len(status) else 0.0
    return {"rms": rms[0], "exact_rms": rms[1], "corrected": corrected}


def tracked(
    plant: ForcepsParameters,
    model: Calibration | None,
    wanted: Array,
    load: SwingingLoad,
    **how: Any,
) -> dict[str, Any]:
    """Errors of a specimen that follows angles `wanted` (n,) [rad], as `follow_jaw` takes it.

    All None where no set-point takes the jaw there, and the loop says so.
    """
    try:
        return {**errors(wanted, follow_jaw(plant, model, wanted, load, **how))}
    except CommandRefused:
        return dict.fromkeys(("rms", "exact_rms", "corrected"))


def wanted_angles(seconds: float) -> Array:
    """Jaw angles of (28) (n,) [rad] at 1 kHz, up to `seconds` [s]."""
    return verification_trajectory().positions[: round(seconds / SETPOINT_DT) + 1, 0]


def track_28(
    forceps: Plain,
    methods: Sequence[str],
    seed: int,
    method: str,
    load: tuple[float, float, bool],
    rate: float,
    gain: float,
    seconds: float,
) -> PartResult:
    """Track the first `seconds` of (28) with one method in the loop under one load."""
    plant, wanted = built(forceps), wanted_angles(seconds)
    model = None if method == OPEN else m.calibrated(plant, tuple(methods), seed)[method]
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * seed + 1}
    followed = follow_jaw(plant, model, wanted, SwingingLoad(*load), **how)
    thin = slice(None, None, 20)
    error = (followed[0] - wanted[: len(followed[0])])[thin]
    t = SETPOINT_DT * np.arange(len(error)) * 20
    return PartResult(errors(wanted, followed), {"t": t, "error": error})


def track_specimen(
    forceps: Plain,
    methods: Sequence[str],
    mass: float,
    rate: float,
    gain: float,
    seconds: float,
    number: int,
) -> PartResult:
    """Track the first `seconds` of (28) on one specimen, unloaded and loaded.

    The load shuts the jaw of every other specimen, and opens that of the others.
    """
    plant = built(forceps)
    wanted = wanted_angles(seconds)
    models = {OPEN: None, **m.calibrated(plant, tuple(methods), number)}
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * number + 1}
    loads = {"none": SwingingLoad(0.0), "steady": SwingingLoad(mass, opens=bool(number % 2))}
    found: dict[str, Any] = {
        name: {key: tracked(plant, model, wanted, load, **how) for key, model in models.items()}
        for name, load in loads.items()
    }
    return PartResult(found)


def try_margins(forceps: Plain, method: str, rate: float, gain: float, number: int) -> PartResult:
    """Try whether the jaw of one specimen comes to rest, at each of `MARGINS` times the gain."""
    plant = built(forceps)
    model = m.calibrated(plant, (method,), number)[method]
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * number + 1}
    return PartResult({"stable": [is_stable(plant, model, margin=x, **how) for x in MARGINS]})


def is_stable(plant: ForcepsParameters, model: Calibration | None, **how: Any) -> bool:
    """Whether the jaw comes to rest where it is wanted, in a loop as `follow_jaw` takes it."""
    corners = np.array(_STEPS)[:, None]
    pieces = [hold(corners[0], _STANDS)]
    for before, after in pairwise(corners):
        pieces += [glide(before, after, 0.5), hold(after, _STANDS)]
    wanted = np.concatenate(pieces)[:, 0]
    exact = follow_jaw(plant, model, wanted, SwingingLoad(0.0), **how)[1]
    still = round(_AT_REST / SETPOINT_DT)
    ends = np.cumsum([len(piece) for piece in pieces])[::2]
    rests = [exact[end - still : end] - wanted[end - 1] for end in ends]
    return all(rest.std() < SWING and abs(rest.mean()) < _ASTRAY for rest in rests)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Errors by load and method, their spread over the population, and the margin of stability."""
    methods = [OPEN, *settings["methods"]]
    loads = _loads(settings)
    name = title_of(settings["specimen"])
    rows = []
    for number, load in enumerate(loads):
        cells = [_pair(results[f"{number}-{key}"].numbers) for key in methods]
        rows.append((load, *cells))
    header = ("load", *map(_title, methods))
    notes = (
        "RMS error in degrees on (28) against the reference encoder that the estimators were "
        "calibrated on, and in brackets against the jaw itself, which the encoder's own error is "
        "part of. Loads are of "
        f"{settings['mass_g']:g} g; the loop runs at {settings['rate_hz']:g} Hz.",
    )
    tables = [Table(f"Tracking (28), specimen {name}", header, tuple(rows), notes)]
    every = [r.numbers for key, r in results.items() if key.startswith("specimen-")]
    margins = [r.numbers["stable"] for key, r in results.items() if key.startswith("margin-")]
    tables += [_spread(settings, every, methods), _stability(settings, margins)]
    figures = {"forceps-closed-loop": _figure(settings, results, every, methods)}
    return Summary(tables, figures)


def _title(method: str) -> str:
    return "open loop" if method == OPEN else m.METHODS[method].title


def _pair(found: Mapping[str, float]) -> str:
    return f"{degrees_text(found['rms'])} ({degrees_text(found['exact_rms'])})"


def _rms(every: Sequence[Mapping[str, Any]], load: str, method: str) -> Array:
    """RMS errors (n,) [rad], NaN where the loop refused."""
    return np.array([one[load][method]["rms"] for one in every], dtype=np.float64)


def _spread(
    settings: Settings, every: Sequence[Mapping[str, Any]], methods: Sequence[str]
) -> Table:
    rows, refused = [], 0
    for load, title in (("none", "none"), ("steady", f"{settings['mass_g']:g} g")):
        for key in methods:
            rms = _rms(every, load, key)
            refused += int(np.isnan(rms).sum())
            quantiles = [degrees_text(float(np.nanquantile(rms, q))) for q in (0.5, 0.95, 1.0)]
            within = float(np.mean(rms <= math.radians(BARS[load])))
            rows.append((f"{title}: {_title(key)}", *quantiles, f"{100 * within:.0f} %"))
    notes = (
        "RMS error in degrees against the reference encoder on the first "
        f"{min(settings['seconds'], _A_PERIOD):g} s of (28), {len(every)} specimens of seed "
        f"{settings.seed}, prior {settings['prior']}; the last column counts those within "
        f"{BARS['none']:g} deg without a load and {BARS['steady']:g} deg with one.",
        f"Refused, since no set-point takes the jaw where it is wanted: {refused}; not within.",
    )
    header = ("load: loop", "median", "95 %", "worst", "within")
    return Table("Tracking over the population", header, tuple(rows), notes)


def _stability(settings: Settings, stable: Sequence[Sequence[bool]]) -> Table:
    rows = tuple(
        (f"{margin:g} x", f"{100 * share:.0f} %")
        for margin, share in zip(MARGINS, np.mean(stable, axis=0), strict=True)
    )
    notes = (
        f"Specimens of the population on which {_title(settings['methods'][-1])} in the loop bring "
        f"the jaw to rest within {math.degrees(_ASTRAY):g} deg of where it is wanted, swinging by "
        f"less than {math.degrees(SWING):g} deg RMS, after steps of up to 30 deg.",
    )
    return Table("Margin of stability", ("gain", "stable"), rows, notes)


def _figure(
    settings: Settings,
    results: Mapping[str, PartResult],
    every: Sequence[Mapping[str, Any]],
    methods: Sequence[str],
) -> Figure:
    colours = {OPEN: "0.6", **{key: m.METHODS[key].colour for key in methods[1:]}}
    loads = list(_loads(settings))

    def panel(number: int) -> Panel:
        curves = []
        for key in methods:
            found = results[f"{number}-{key}"].arrays
            error = np.degrees(found["error"])
            curves.append(Curve(found["t"], error, _title(key), colours[key]))
        title = f"specimen {title_of(settings['specimen'])}, load {loads[number]}"
        return Panel(curves, "time [s]", "jaw minus wanted [deg]", title)

    swings = settings["swings_hz"]
    first = len(loads) - len(swings)
    swinging, spread = [], []
    for key in methods:
        rms = [results[f"{first + i}-{key}"].numbers["rms"] for i in range(len(swings))]
        swinging.append(Curve(swings, np.degrees(rms), _title(key), colours[key], "o-"))
        rms_there = _rms(every, "steady", key)
        error = np.sort(np.degrees(rms_there[np.isfinite(rms_there)]))
        below = np.arange(1, len(error) + 1) / len(every)
        spread.append(Curve(error, below, _title(key), colours[key], width=1.2))
    panels = (
        (panel(0), panel(1)),
        (
            Panel(swinging, "load swings at [Hz]", "RMS error [deg]", "a load that swings", "xy"),
            Panel(
                spread, "RMS error [deg]", "share of specimens below",
                f"population, {settings['mass_g']:g} g", "x",
            ),
        ),
    )  # fmt: skip
    caption = (
        "Above: how far the jaw is from where it is wanted, against the reference encoder. Below: "
        "the same as RMS error, under a load that swings, and on every specimen."
    )
    return Figure("The jaw in a closed loop", panels, caption, height=7.0, legend=True)
