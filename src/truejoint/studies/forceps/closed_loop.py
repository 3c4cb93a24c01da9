"""Setting the jaw and not the motor: tracking errors with an estimate in the loop and without."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np
from pandas import DataFrame, concat

from truejoint.array_types import Array, Integers
from truejoint.calibration import Calibration
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.errors import CommandRefused
from truejoint.motion.forceps_trajectories import verification_trajectory
from truejoint.robots.blocks import SETPOINT_DT, StateBlock, TruthBlock
from truejoint.runtime import Compensator, Corrector, Status
from truejoint.runtime.compensator import check_rate
from truejoint.simulation.forceps.load import SwingingLoad
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.specimens import population
from truejoint.simulation.forceps.twin import ForcepsTwin
from truejoint.studies.forceps import methods as m
from truejoint.studies.rows import ecdf_figure, frame_table, notes_on, quantiles, select
from truejoint.studies.study import Part, Plain, Results, Rows, Settings, Summary
from truejoint.tables import Table

OPEN: Final = "open"
"""Stands for no method: the motor is sent where the jaw should be."""
KNOWN: Final = Status.OUT_OF_DOMAIN | Status.OUT_OF_RANGE | Status.IMPLAUSIBLE
"""A load takes motor, x2 and their errors where the calibration, unloaded, never was."""
BARS: Final = {"none": 0.12, "steady": 0.25}
"""Wanted of the error with our estimate in the loop, without a load and with a steady one [deg]."""
QUICK: Final = 0.005
"""Time constant of what the loop takes for lost [s]."""
DEAD_BAND: Final = math.radians(0.05)
"""Of the loop where the jaw shall stand still [rad], half a step of the reference encoder."""
_A_PERIOD: Final = 22.0  # [s] of (28), enough on the specimens of a population


def parts(settings: Settings) -> Sequence[Part]:
    """One a load and method on the specimen, and one a specimen of the population."""
    mass, how = settings["mass_g"] / 1e3, {"rate": settings["rate_hz"], "gain": settings["gain"]}
    common = m.common_arguments(settings)
    forceps, methods, seed = common["forceps"], common["methods"], common["seed"]
    plants = population(settings["count"], seed, settings["prior"])
    for plant in (ForcepsParameters.from_dict(forceps), *plants):
        check_rate(how["rate"], lag(plant), how["gain"])
    loads: dict[str, tuple[float, float, bool]] = {  # arguments of `SwingingLoad`
        "none": (0.0, 0.0, False),
        "steady, shutting": (mass, 0.0, False),
        "steady, opening": (mass, 0.0, True),
        **{f"{f:g} Hz, shutting": (mass, f, False) for f in settings["swings_hz"]},
    }
    for load in loads.values():
        SwingingLoad(*load)  # refuses what cannot be
    case = {"methods": methods, "seconds": settings["seconds"], **how}
    one = {"forceps": forceps, "number": seed, **case}
    found = []
    for n, (name, load) in enumerate(loads.items()):
        for method in (OPEN, *methods):
            tried = {"follows": [method], "loads": {name: load}}
            found.append(Part(f"{n}-{method}", track, one | tried, {"case": n}))
    case |= {"follows": [OPEN, *methods], "seconds": min(settings["seconds"], _A_PERIOD)}
    for n, plant in enumerate(plants):
        # The load shuts the jaw of every other specimen, and opens that of the others.
        hung = {"none": (0.0, 0.0, False), "steady": (mass, 0.0, bool(n % 2))}
        drawn = {"forceps": plant.to_dict(), "number": n, "loads": hung}
        found.append(Part(f"specimen-{n:05d}", track, case | drawn, {"specimen": n}))
    return found


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
    **how: float,
) -> tuple[Array, Array, Integers]:
    """Put a specimen's jaw along angles `wanted` (n,) [rad] at 1 kHz, homed anew.

    With a calibration as `model` in a loop, `how` as `Compensator` takes it, or with none. Returns
    the jaw's angle (m,) [rad] by the reference encoder and exactly, and the statuses of the
    corrector's steps (k,).
    """
    twin = ForcepsTwin(plant, seed=seed)
    arm, blocks = Arm(SimulatedBackend(twin)), list[StateBlock | TruthBlock]()
    arm.enable()
    arm.home()
    start = arm.time
    twin.tip_force = lambda t: load.force(t - start)
    arm.subscribe(blocks.append)
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
            lag=lag(plant),
            time_constant=QUICK,
            integral_time=math.inf,
            dead_band=DEAD_BAND,
            believed=KNOWN,
            **how,
        )
        compensator.drive(arm, wanted[:, None])
        status = np.array(list(compensator.statuses.elements()), dtype=np.int64)
    truth = np.concatenate([b.position[:, 0] for b in blocks if isinstance(b, TruthBlock)])
    exact = [b.extra["truth_exact/jaw"] for b in blocks if isinstance(b, StateBlock)]
    return truth[1:], np.concatenate(exact)[1:], status


def track(
    forceps: Plain,
    methods: Sequence[str],
    follows: Sequence[str],
    loads: Mapping[str, tuple[float, float, bool]],
    number: int,
    seconds: float,
    **how: float,
) -> Rows:
    """Track the first `seconds` of (28) with each of some methods in the loop under each load.

    RMS error [rad] once settled, to the reference and exactly, and the share corrected. All are
    None where no set-point takes the jaw there or the loop falls back, and says so.
    """
    plant, rows = ForcepsParameters.from_dict(forceps), Rows()
    wanted = verification_trajectory().positions[: round(seconds / SETPOINT_DT) + 1, 0]
    first = round(m.SETTLED / SETPOINT_DT)
    for (name, load), method in product(loads.items(), follows):
        model = None if method == OPEN else m.calibrated(plant, tuple(methods), number)[method]
        row: dict[str, Any] = dict.fromkeys(("rms", "exact_rms", "corrected"))
        with suppress(CommandRefused):
            *angles, status = follow_jaw(
                plant, model, wanted, SwingingLoad(*load), seed=2 * number + 1, **how
            )
            errors = (m.rms((angle - wanted[: len(angle)])[first:]) for angle in angles)
            row["rms"], row["exact_rms"] = errors
            row["corrected"] = float(np.mean(status & ~int(KNOWN) == 0)) if len(status) else 0.0
        rows.append({"load": name, "method": method, **row})
    return rows


def summarise(results: Results) -> Summary:
    """Errors by load and method, and their spread over the population."""
    settings, rows = results.settings, results.rows
    rows = rows.assign(name=rows.method.map({OPEN: "open loop", **m.TITLES}))
    group, every = (rows[rows[key].notna()] for key in ("case", "specimen"))
    specimen = f"specimen {Path(settings['specimen']).stem}"
    degrees: DataFrame = np.rad2deg(1.0) * group[["rms", "exact_rms"]].astype(float)
    degrees = degrees.map("{:.3f}".format)
    pairs = group.assign(text=degrees.rms + " (" + degrees.exact_rms + ")")
    pairs = pairs.pivot_table("text", "load", "name", "first", sort=False)
    notes = notes_on("tracking", **settings.options)
    tables = (
        frame_table(f"Tracking (28), {specimen}", pairs, notes, head="load"),
        _spread(settings, every),
    )
    steady = select(every, load="steady").assign(on="population")
    drawn = concat([group.assign(on=specimen), steady])
    caption = "Error against the reference encoder, over loads and on every specimen under one."
    title = "The jaw in a closed loop"
    figure = ecdf_figure(title, drawn, "name", "on", caption, colours=m.COLOURS)
    return Summary(tables, {"forceps-closed-loop": figure})


def _spread(settings: Settings, every: DataFrame) -> Table:
    loads = {"none": "none", "steady": f"{settings['mass_g']:g} g"}
    every = every.sort_values("load", kind="stable")
    every = every.assign(
        row=every.load.map(loads) + ": " + every["name"],
        rms=np.degrees(every.rms),
        within=np.degrees(every.rms) <= every.load.map(BARS),
    )
    table = quantiles(every, "row", "rms", {"median": 0.5, "95 %": 0.95, "worst": 1.0})
    within = 100 * every.groupby("row").within.mean()
    table = table.assign(within=within.map("{:.0f} %".format))
    about = {**settings.options, "seed": settings.seed, "specimens": every.specimen.nunique()}
    first, refused = min(settings["seconds"], _A_PERIOD), every.rms.isna().sum()
    notes = notes_on("tracking_spread", **about, first=first, refused=refused, bars=BARS)
    return frame_table("Tracking over the population", table, notes, head="load: loop")
