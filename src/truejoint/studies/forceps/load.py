"""The filter with friction and load: weights and the cable's stiffness."""

import math
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import product
from typing import Any, Final, cast

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array, Mask
from truejoint.calibration import calibrate, identify_stiffness
from truejoint.estimators.jaw_load.learn import FrictionFilter
from truejoint.recordings import Recording
from truejoint.simulation.forceps.load import LoadTest
from truejoint.simulation.forceps.parameters import ForcepsParameters, friction_at_pretension
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.paper import cases
from truejoint.studies.rows import frame_table, notes_on, select
from truejoint.studies.study import Part, Plain, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed
from truejoint.units import GRAVITY

CALIBRATION_WEIGHTS: Final = (0.1, 0.2, 0.25)
"""Known weights that identify the stiffness, each hung once each way [kg]."""
ROCK: Final = math.radians(10.0)
"""By how much the jaw goes back and forth under each of them."""
_CYCLES: Final = 3
_NINETY: Final = 1.645  # deviations on either side that hold 90 % of a normal distribution
_TORQUES: Final = {
    "true": "torque", "K_d assumed": "assumed", "K_d identified": "identified",
    "stated 90 %": "stated",
}  # fmt: skip
_WAYS: Final = ("along", "opposing")
UNLOADED, SLACK = "unloaded", "slack"
"""Cases beside the weights: none, and one that slackens the drive cable."""


def load_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and weight, and one without a weight."""
    weights, common = {**cases(settings), UNLOADED: None}, {"motion": settings["motion"]}
    return [
        Part(
            f"{name}-{key}", weigh, {"forceps": plant, "seed": seed, **common, "hung": hung},
            {"specimen": name},
        )
        for name, plant, seed in m.drawn_specimens(settings)
        for key, hung in weights.items()
    ]  # fmt: skip


def effective_stiffness(forceps: ForcepsParameters) -> float:
    """Stiffness [N/m] at the pretension of the drive cable and the gear behind it.

    Of the cable what is left once its Bouc-Wen element has yielded, as under any weight.
    """
    cable = forceps.drive_cable.elastic_share * forceps.drive_cable.stiffness
    gear = forceps.assembly.gear_stiffness / forceps.mechanism.wheel_radius**2
    return 1.0 / (1.0 / cable + 1.0 / gear)


def hidden_friction(forceps: ForcepsParameters) -> float:
    """Friction [Nm] of the jaw and of the drive cable's guide, at the pretension and the jaw."""
    guide = math.expm1(forceps.drive_cable.guide_friction) * forceps.assembly.pretension
    return friction_at_pretension(forceps)[0] + guide * forceps.mechanism.jaw_radius


def slack_torque(forceps: ForcepsParameters, angle: float) -> float:
    """Torque [Nm] that opens the jaw at an angle [rad] so far that the drive cable is slack."""
    mechanism = forceps.mechanism
    spring = mechanism.spring_stiffness * mechanism.jaw_radius * angle
    return (forceps.assembly.pretension + spring) * mechanism.jaw_radius


def rocking_test(mass: float, way: str) -> LoadTest:
    """Quick load test of a weight [kg], under which the jaw then rocks."""
    end = 14.0 + _CYCLES * 2.0 * ROCK / math.radians(3.75)
    return m.load_test(mass, way, quick=True, end=end, rock=ROCK)


@lru_cache(maxsize=4)
def _identified(
    plant: ForcepsParameters, seed: int, motion: str
) -> tuple[FrictionFilter, FrictionFilter, dict[str, float]]:
    """Fit filters to the motion alone and to known weights; give both and the plant's numbers."""
    unloaded, loads = m.settled(m.record(plant, motion, seed=2 * seed)), []
    assumed = cast("FrictionFilter", calibrate(unloaded, FrictionFilter()).model)
    for n, (mass, way) in enumerate(product(CALIBRATION_WEIGHTS, _WAYS)):
        test = rocking_test(mass, way)
        run = m.record(plant, test, seed=100 * seed + 99 - n)
        hangs = m.within(run.t, *test.phases["IV"])
        torque = np.where(hangs, run.column("truth_load/jaw"), np.nan)
        if float(np.nanmax(torque)) <= slack_torque(plant, test.angle - test.rock):
            loads.append((*m.signals(run), torque))
    X, dt, torque = (np.concatenate(columns) for columns in zip(*loads, strict=True))
    stiffness = identify_stiffness(assumed, X, torque, dt)
    identified = assumed.with_stiffness(stiffness)
    common = {
        **vars(stiffness),
        "true_stiffness": effective_stiffness(plant),
        "friction": identified.jaw_friction,
        "true_friction": hidden_friction(plant),
        "arm": plant.jaw.load_arm,
    }
    return assumed, identified, common


def weigh(forceps: Plain, seed: int, motion: str, hung: Mapping[str, Any] | None) -> Rows:
    """Identify the stiffness of a specimen by known weights, and estimate another, or none."""
    plant = ForcepsParameters.from_dict(forceps)
    assumed, identified, common = _identified(plant, seed, motion)
    if hung is None:
        run = m.settled(m.record(plant, "verification", seed=2 * seed + 1))
        states = _judged(identified, run, np.isfinite(run.column("truth/jaw")))
        return [{**common, "case": UNLOADED, **states}]
    test = m.load_test(hung["mass"], hung["direction"])
    run = m.record(plant, test, seed=hung["hand"])
    still = m.within(run.t, *test.phases["IV"])
    labels = {**common, "mass": hung["mass"], "direction": hung["direction"]}
    if float(run.column("truth_load/jaw")[still].mean()) > slack_torque(plant, test.angle):
        return [{**labels, "case": SLACK}]
    tried = assumed.states(*m.signals(run)).load[still]
    labels |= {"case": hung["direction"], "assumed": float(tried.mean())}
    return [{**labels, **_judged(identified, run, still)}]


def _judged(model: FrictionFilter, run: Recording, chosen: Mask) -> dict[str, float]:
    """Load and angle of some rows of a run, and how they stand to what is stated of them."""
    states = model.states(*m.signals(run))
    load = states.load - run.column("truth_load/jaw")
    angle = states.angle - run.column("truth/jaw")
    return {
        "torque": float(run.column("truth_load/jaw")[chosen].mean()),
        "identified": float(states.load[chosen].mean()),
        "stated": _NINETY * float(states.load_deviation[chosen].mean()),
        "load_rms": m.rms(load[chosen]),
        **_coverage("load", (load / states.load_deviation)[chosen]),
        "angle_rms": m.rms(angle[chosen]),
        **_coverage("angle", (angle / states.angle_deviation)[chosen]),
    }


def _coverage(name: str, ratio: Array) -> dict[str, float]:
    """Share of errors (n,) in stated deviations within 90 %, and their mean square (NEES)."""
    inside = float(np.mean(np.abs(ratio) <= _NINETY))
    return {f"{name}_inside": inside, f"{name}_nees": float(np.mean(ratio**2))}


def load_summary(results: Results) -> Summary:
    """List the loads of the first specimen, and errors and coverage over all."""
    rows = results.rows
    rows = rows.assign(grams=1e3 / (GRAVITY * rows.arm))  # at the tip of the jaw, for each Nm
    first = select(rows, specimen=rows.specimen.iloc[0])
    return Summary((_weights(first), _population(results.settings, rows)))


def _weights(rows: DataFrame) -> Table:
    """Each weight as it is, as it is estimated, and what is stated of it."""
    one, hung = rows.iloc[0], rows.dropna(subset="mass")
    hung = hung.set_index((1e3 * hung.mass).map("{:.0f} g ".format) + hung.direction)
    weighed, slack = select(hung, case=_WAYS), select(hung, case=SLACK)
    texts = {
        title: [f"{fixed(1e3 * v, 1)} ({fixed(one.grams * v, 0)})" for v in weighed[column]]
        for title, column in _TORQUES.items()
    }
    inside = [f"{100 * share:.0f} %" for share in weighed.load_inside]
    friction, true_friction = (
        f"{1e3 * value:.1f} mNm ({one.grams * value:.0f} g)"
        for value in (2.0 * one.friction, 2.0 * one.true_friction)
    )
    values = {"known": ", ".join(f"{1e3 * mass:.0f}" for mass in CALIBRATION_WEIGHTS)}
    values |= {"friction": friction, "true_friction": true_friction}
    stiffness = [one[name] / 1e3 for name in ("drive_stiffness", "deviation", "true_stiffness")]
    notes = notes_on("load", arm=1e3 * one.arm, stiffness=stiffness, growth=one.growth, **values)
    if len(slack):
        names = ", ".join(slack.index)
        notes.append(f"Left out, since the drive cable is slack under it: {names}.")
    table = DataFrame({**texts, "inside": inside}, weighed.index)
    return frame_table(f"External load, {one.specimen}", table, notes, head="load")


def _population(settings: Settings, rows: DataFrame) -> Table:
    """Quantiles over the specimens, and how often what is stated holds."""
    one, weighed = rows.drop_duplicates("specimen"), select(rows, case=_WAYS)
    stiffness = 100.0 * np.abs(one.drive_stiffness / one.true_stiffness - 1.0)
    # RMS over the weights one way [g], by specimen.
    squares = (weighed.grams * (weighed.identified - weighed.torque)) ** 2
    squares = squares.groupby([weighed.direction, weighed.specimen], sort=False).mean()
    errors = {way: np.sqrt(squares[squares.index.get_level_values(0) == way]) for way in _WAYS}
    # Of an estimate that sees all but what friction may hide: 0 to twice its size.
    floor = one.grams * 2.0 * one.true_friction / math.sqrt(3.0)
    measures = {
        "stiffness off by [%]": stiffness,
        **{f"load {way}, RMS [g]": errors[way] for way in _WAYS},
        "its floor by friction [g]": floor,
    }
    body: dict[str, list[Any]] = {
        label: [*(np.quantile(values, [0.5, 0.95, 1.0]) if len(values) else [math.nan] * 3), ""]
        for label, values in measures.items()
    }
    for kind, case in product(("load", "angle"), (UNLOADED, *_WAYS)):
        group = select(rows, case=case)
        if len(group):
            inside, nees = 100.0 * group[f"{kind}_inside"].mean(), group[f"{kind}_nees"].mean()
            stated = f"{inside:.0f} % inside, NEES {nees:.2f}"
            body[f"stated 90 % of the {kind}, {case}"] = ["", "", "", stated]
    opposing = errors["opposing"].to_numpy()
    below = np.mean(opposing <= floor.to_numpy()) if len(opposing) == len(floor) else math.nan
    notes = notes_on(
        "load_population", specimens=len(one), seed=settings.seed, below=100 * below,
        masses=", ".join(f"{mass:g}" for mass in settings["masses_g"]),
        stiff=100 * np.mean(stiffness <= 5.0), slack=len(select(rows, case=SLACK)),
    )  # fmt: skip
    table = DataFrame.from_dict(body, "index", columns=["median", "95 %", "worst", "stated"])
    return frame_table("External load over the specimens", table, notes, decimals=1)
