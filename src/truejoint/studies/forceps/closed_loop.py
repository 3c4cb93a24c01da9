"""Setting the jaw and not the motor: tracking errors with an estimate in the loop and without."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array, Integers
from truejoint.calibration import Calibration
from truejoint.drawing import Figure, by_condition, ecdf
from truejoint.errors import CommandRefused
from truejoint.motion.forceps_trajectories import verification_trajectory
from truejoint.robots.joint_rows import SETPOINT_DT
from truejoint.runtime import Compensator, Corrector, Status
from truejoint.runtime.loop_gain import check_rate
from truejoint.simulation.forceps.load import SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ForcepsTwin
from truejoint.simulation.twin import glide, hold
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, title_of
from truejoint.studies.loop import TwinSignals, homed_arm
from truejoint.studies.rows import Cell, select, table_of
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed

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
            labels = {"number": number, "load": list(loads)[number], "method": method}
            found.append(Part(f"{number}-{method}", track_28, {**common, **case}, labels))
    motion = {"methods": common["methods"], "mass": settings["mass_g"] / 1e3, **how}
    for n, plant in enumerate(plants):
        group = {"forceps": plant.to_dict(), "number": n}
        some = {**group, **motion, "seconds": min(seconds, _A_PERIOD)}
        found.append(Part(f"specimen-{n:05d}", track_specimen, some, {"specimen": n}))
        rests = {**group, **how, "method": common["methods"][-1]}
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
    arm = homed_arm(twin)
    start = arm.time
    twin.tip_force = lambda t: load.force(t - start)
    signals = TwinSignals(arm, ("truth/jaw", "truth_exact/jaw"))
    status = np.zeros(0, dtype=np.int64)
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
    return signals.values("truth/jaw")[1:], signals.values("truth_exact/jaw")[1:], status


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
) -> Rows:
    """Track the first `seconds` of (28) with one method in the loop under one load."""
    plant, wanted = built(forceps), wanted_angles(seconds)
    model = None if method == OPEN else m.calibrated(plant, tuple(methods), seed)[method]
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * seed + 1}
    followed = follow_jaw(plant, model, wanted, SwingingLoad(*load), **how)
    return [errors(wanted, followed)]


def track_specimen(
    forceps: Plain,
    methods: Sequence[str],
    mass: float,
    rate: float,
    gain: float,
    seconds: float,
    number: int,
) -> Rows:
    """Track the first `seconds` of (28) on one specimen, unloaded and loaded.

    The load shuts the jaw of every other specimen, and opens that of the others.
    """
    plant = built(forceps)
    wanted = wanted_angles(seconds)
    models = {OPEN: None, **m.calibrated(plant, tuple(methods), number)}
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * number + 1}
    loads = {"none": SwingingLoad(0.0), "steady": SwingingLoad(mass, opens=bool(number % 2))}
    return [
        {"load": name, "method": key, **tracked(plant, model, wanted, load, **how)}
        for name, load in loads.items()
        for key, model in models.items()
    ]


def try_margins(forceps: Plain, method: str, rate: float, gain: float, number: int) -> Rows:
    """Try whether the jaw of one specimen comes to rest, at each of `MARGINS` times the gain."""
    plant = built(forceps)
    model = m.calibrated(plant, (method,), number)[method]
    how: dict[str, Any] = {"rate": rate, "gain": gain, "seed": 2 * number + 1}
    return [{"margin": x, "stable": is_stable(plant, model, margin=x, **how)} for x in MARGINS]


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


def summarise(results: Results) -> Summary:
    """Errors by load and method, their spread over the population, and the margin of stability."""
    settings, rows = results.settings, results.rows
    methods, name = [OPEN, *settings["methods"]], title_of(settings["specimen"])
    group, every, margins = (
        rows[rows[column].notna()] for column in ("number", "specimen", "margin")
    )

    def pair(key: str) -> Cell:
        def cell(of_load: DataFrame) -> str:
            row = select(of_load, method=key)
            return f"{m.degrees(row)} ({m.degrees(row, 'exact_rms')})"

        return cell

    notes = (
        "RMS error in degrees on (28) against the reference encoder that the estimators were "
        "calibrated on, and in brackets against the jaw itself, which the encoder's own error is "
        "part of. Loads are of "
        f"{settings['mass_g']:g} g; the loop runs at {settings['rate_hz']:g} Hz.",
    )
    cells = {_title(key): pair(key) for key in methods}
    tables = (
        table_of(f"Tracking (28), specimen {name}", group, "load", cells, notes),
        _spread(settings, every),
        _stability(settings, margins),
    )
    return Summary(tables, {"forceps-closed-loop": _figure(settings, group, every, methods)})


def _title(method: str) -> str:
    return "open loop" if method == OPEN else m.title(method)


def _spread(settings: Settings, every: DataFrame) -> Table:
    every = every.assign(bar=every.load.map(BARS))
    loads = {"none": "none", "steady": f"{settings['mass_g']:g} g"}

    def quantile(q: float) -> Cell:
        return lambda group: fixed(math.degrees(group.rms.quantile(q)), 3)

    cells: dict[str, Cell] = {"median": quantile(0.5), "95 %": quantile(0.95)}
    cells["worst"] = quantile(1.0)
    cells["within"] = lambda group: f"{100 * np.mean(np.degrees(group.rms) <= group.bar):.0f} %"
    notes = (
        "RMS error in degrees against the reference encoder on the first "
        f"{min(settings['seconds'], _A_PERIOD):g} s of (28), {every.specimen.nunique()} specimens "
        f"of seed {settings.seed}, prior {settings['prior']}; the last column counts those within "
        f"{BARS['none']:g} deg without a load and {BARS['steady']:g} deg with one.",
        f"Refused, since no set-point takes the jaw where it is wanted: {every.rms.isna().sum()}; "
        "not within.",
    )
    return table_of(
        "Tracking over the population", every.sort_values("load", kind="stable"),
        ["load", "method"], cells, notes,
        names=lambda load, method: f"{loads[load]}: {_title(method)}", head="load: loop",
    )  # fmt: skip


def _stability(settings: Settings, margins: DataFrame) -> Table:
    notes = (
        f"Specimens of the population on which {_title(settings['methods'][-1])} in the loop bring "
        f"the jaw to rest within {math.degrees(_ASTRAY):g} deg of where it is wanted, swinging by "
        f"less than {math.degrees(SWING):g} deg RMS, after steps of up to 30 deg.",
    )
    cells: dict[str, Cell] = {"stable": lambda group: f"{100 * group.stable.mean():.0f} %"}
    return table_of("Margin of stability", margins, "margin", cells, notes,
                    names="{:g} x".format, head="gain")  # fmt: skip


def _figure(
    settings: Settings, group: DataFrame, every: DataFrame, methods: Sequence[str]
) -> Figure:
    colours = {OPEN: "0.6", **{key: m.METHODS[key].colour or "0.7" for key in methods[1:]}}
    titles = {_title(key): colour for key, colour in colours.items()}

    first = group.number.nunique() - len(settings["swings_hz"])
    rates = dict(enumerate(settings["swings_hz"], first))
    swinging, steady = (
        rows.assign(name=rows.method.map(_title), rate=rows.number.map(rates))
        for rows in (select(group, number=rates), select(every, load="steady").dropna(subset="rms"))
    )
    look: dict[str, Any] = {"scale": np.degrees(1.0), "colours": titles}
    panels = (
        by_condition(
            swinging, "rate", "rms", "name", x="load swings at [Hz]", y="RMS error [deg]",
            title=f"specimen {title_of(settings['specimen'])}", log="xy", **look,
        ),
        ecdf(
            steady, "rms", "name", x="RMS error [deg]", y="share of specimens [%]",
            title=f"population, {settings['mass_g']:g} g", log="x", **look,
        ),
    )  # fmt: skip
    caption = "Error against the reference encoder under a load that swings, and on every specimen."
    return Figure("The jaw in a closed loop", (panels,), caption, height=4.4, legend=True)
