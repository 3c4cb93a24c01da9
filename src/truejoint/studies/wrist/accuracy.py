"""How exactly estimators know pitch and both jaws, free and under loads, by motors and efforts."""

import math
from collections.abc import Mapping, Sequence
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.calibration import Calibration, calibrate
from truejoint.errors import StudyError
from truejoint.estimators import estimator_names
from truejoint.estimators.cables.learn import CableFilter
from truejoint.evaluation.scoring import rmse
from truejoint.features.feature_set import time_steps
from truejoint.recordings import Recording
from truejoint.robots import get_robot
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import ecdf_figure, frame_table, median_texts, select, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.studies.wrist import motions
from truejoint.tables import Table

SETTLED: Final = 2.0
"""Time after which a history that began with the recording counts [s]."""
LOADS: Final = ("grip", "pitch", "yaw")
"""Of jaws on what they hold, and of forces at the tip about pitch and yaw."""
FREE, LOADED = TESTS = ("free", "loaded")
ANGLE, LOAD = "angle", "load"
"""What a row is of."""
BLIND: Final = ("linear", "rich_play", "coupled_play")
"""Estimators that are fitted to the motors of the free recording alone, too."""
_NINETY: Final = NormalDist().inv_cdf(0.95)  # deviations that hold 90 % of a normal's draws


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen."""
    settings.check_names("estimator", "estimators", (*estimator_names(), "auto"))
    if not settings["test_s"] > SETTLED:
        raise StudyError(f"test_s={settings['test_s']:g}; it must be above {SETTLED:g}")
    get_robot("wrist", settings["instrument"])  # refused here if there is none
    names, family = ("estimators", "instrument", "free_s", "loaded_s", "test_s"), settings["family"]
    common, instruments = {name: settings[name] for name in names}, []
    for n, specimen in enumerate(population(settings["count"], settings.seed, family)):
        arguments = {"specimen": specimen.to_dict(), "number": n, **common}
        labels = {"specimen": n, "family": family_of(n, family)}
        instruments.append(Part(f"specimen-{n:05d}", judge, arguments, labels))
    return instruments


def judge(
    specimen: Mapping[str, Mapping[str, Any]],
    estimators: Sequence[str],
    instrument: str,
    free_s: float,
    loaded_s: float,
    test_s: float,
    number: int,
) -> Rows:
    """Calibrate on multi-sines, free and loaded; judge on steps, free and loaded."""
    twin = WristTwin(WristParameters.from_dict(specimen), arm=instrument, seed=number)
    seed = 4 * number
    twin.home()
    training = [
        motions.record(twin, motions.paused_sines, seconds, seed + n, load=bool(n))
        for n, seconds in enumerate((free_s, loaded_s))
    ]
    tests = {
        name: motions.record(twin, motions.steps, test_s, seed + 2 + n, load=bool(n))
        for n, name in enumerate(TESTS)
    }
    motors = [f"measured/{joint}" for joint in JOINTS]
    models: dict[str, Calibration | None] = {"raw": None}
    models |= {
        f"{name}, motors": calibrate(training[:1], name, joints=JOINTS, features=motors)
        for name in BLIND
        if name in estimators
    }
    models |= {name: calibrate(training, name, joints=JOINTS) for name in estimators}
    return [
        row
        for test, recording in tests.items()
        for method, model in models.items()
        for row in judged(model, recording, method=method, test=test)
    ]


def judged(model: Calibration | None, recording: Recording, **labels: str) -> Rows:
    """Errors of the joints [rad], raw without a model, and of the loads [Nm] where it knows them.

    With them, of a filter, the share of errors within what it states for 90 %.
    """
    late = recording.t - recording.t[0] > SETTLED
    truth, loads = recording.columns("truth_exact", JOINTS), recording.columns("truth_load", LOADS)
    angle = model.correct(recording) if model else recording.columns("measured", JOINTS)
    sizes = dict(zip(JOINTS, rmse((angle - truth)[late]).tolist(), strict=True))
    rows: Rows = [{"of": ANGLE, **labels, **sizes}]
    if model and isinstance(model.model, CableFilter):
        X = model.feature_set.compute(recording, model.gap_limit)
        states = model.model.states(X, time_steps(recording.t, model.gap_limit))
        off = np.hstack([states.angle - truth, states.load - loads])[late]
        stated = np.hstack([states.angle_deviation, states.load_deviation])[late]
        inside = (np.abs(off) < _NINETY * stated).mean(axis=0)
        rows[0] = {**rows[0], "inside": float(inside[: len(JOINTS)].mean())}
        numbers = np.column_stack((rmse(off), inside))[len(JOINTS) :], rmse(loads[late])
        for name, (rms, share), size in zip(LOADS, *(n.tolist() for n in numbers), strict=True):
            load = {"load": name, "rms": rms, "size": size, "inside": share}
            rows.append({"of": LOAD, **labels, **load})
    return rows


def summarise(results: Results) -> Summary:
    """Tables of medians by family, and the distribution of the errors by method."""
    rows = results.rows
    name, inside = rows.method + ", " + rows.family, rows.get("inside", math.nan)
    rows = rows.assign(name=name, inside=inside)
    angles, loads = select(rows, of=ANGLE), select(rows, of=LOAD)
    tables = [_angles(angles, results.settings)]
    if len(loads):
        tables.append(_loads(loads))
    errors = angles.drop(columns="rms", errors="ignore")
    errors = errors.melt(["test", "method"], list(JOINTS), "joint", "rms")
    caption = "Share of all specimens' joints with a smaller error, by method."
    title = "Wristed instruments, another class of motion"
    return Summary(tables, {"wrist": ecdf_figure(title, errors, "method", "test", caption)})


def _angles(rows: DataFrame, settings: Settings) -> Table:
    by = rows.groupby(["name", "test"], sort=False)[list(JOINTS)]
    degrees = math.degrees(1.0)
    medians = by.median().mul(degrees).map("{:.3f}".format).unstack()
    worst = by.max().max(axis=1).mul(degrees).map("{:.2f}".format).unstack()
    shares = _shares(rows, ["name", "test"])
    table = rows.groupby("name", sort=False).specimen.nunique().map(str).to_frame("n")
    for test, mark in zip(TESTS, ("", " "), strict=True):
        for joint in JOINTS:
            table[f"{test}: {joint}" if joint == JOINTS[0] else joint + mark] = medians[joint, test]
        table["worst" + mark], table["in 90 %" + mark] = worst[test], shares[test]
    notes = (
        "RMS error in degrees against the joints themselves, median of the specimens of seed "
        f"{settings.seed}; worst: of any specimen's any joint; share of errors within what a "
        f"filter states for 90 %, median. Fitted to {settings['free_s']:g} s of multi-sines "
        f"without load and {settings['loaded_s']:g} s under loads, by motors alone to the first; "
        f"tested on {settings['test_s']:g} s of steps each.",
        "Loads: grips half of the time and pushes at the tip up to 2 N along two axes. Motors "
        "alone do not see them.",
    )
    title = "Pitch and jaws of a wristed instrument"
    return frame_table(title, table, notes, head="estimator, family")


def _loads(rows: DataFrame) -> Table:
    keys = ["name", "test", "load"]
    errors, shares = median_texts(rows, keys, "rms", 1, 1e3), _shares(rows, keys)
    sizes = rows.groupby(keys, sort=False)["size"].median().mul(1e3).map("{:.1f}".format)
    table = DataFrame(index=unique(rows, "name"))
    for n, load in enumerate(LOADS):
        table[load], table["of " + load] = (
            errors[LOADED, load],
            sizes.unstack(keys[1:])[LOADED, load],
        )
        table["in 90 %" + " " * n] = shares[LOADED, load]
    table["grip when free"] = errors[FREE, "grip"]
    note = (
        "RMS error in mNm of loads from motors and effort, median (worst) of the specimens, beside "
        "the RMS of the load itself, and the share within what is stated for 90 %: pitch and yaw "
        "are torques of the force at the tip. What a pin holds by friction no motor feels."
    )
    return frame_table("Grip and tip torque", table, (note,), head="estimator, family")


def _shares(rows: DataFrame, keys: list[str]) -> DataFrame:
    """Texts of the median share within what is stated; empty where nothing is."""
    shares = rows.groupby(keys, sort=False).inside.median().mul(100)
    return shares.map(lambda share: "" if math.isnan(share) else f"{share:.0f} %").unstack(keys[1:])
