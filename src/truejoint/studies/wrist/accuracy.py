"""How exactly estimators know pitch and both jaws, free and under loads, and motions that tell."""

import math
from collections.abc import Callable, Mapping, Sequence
from statistics import NormalDist
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate
from truejoint.errors import StudyError
from truejoint.estimators import estimator_names
from truejoint.estimators.cables.learn import CableFilter
from truejoint.evaluation.scoring import rmse
from truejoint.features.feature_set import time_steps
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.robots.blocks import SETPOINT_DT
from truejoint.robots.wrist.instruments import JOINTS
from truejoint.simulation.twin import glide
from truejoint.simulation.wrist.parameters import WristParameters
from truejoint.simulation.wrist.specimens import family_of, population
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.rows import ecdf_figure, frame_table, median_texts, notes_on, select, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import Table

# Centre and half width [rad] of pitch, yaw and opening: the jaws stay apart by 8 deg and more.
_CENTRE: Final = np.radians([0.0, 0.0, 24.0])
_REACH: Final = np.radians([55.0, 45.0, 16.0])
_TONES: Final = 6  # of a random multi-sine, each joint
_BAND: Final = (0.04, 0.5)  # [Hz]
_SPEED: Final = math.radians(60.0)  # [rad/s] at the middle of a step
_REST: Final = (0.2, 1.0)  # [s] between steps
_HALT: Final = 0.15  # [s] in which sines come to rest
_BETWEEN: Final = (0.8, 3.0)  # [s] from one rest of theirs to the next
_RAMP: Final = 0.4  # [s] in which a grip builds up
_CLEAR: Final = 0.05  # [rad] by which what jaws close on is smaller than their opening
_PRESSED: Final = (0.06, 0.2)  # [rad] by which they are asked to close beyond it
_FREE: Final = -0.3  # [rad] by which what is between them is out of their reach
_FORCE: Final = 2.0  # [N] of a push at the tip, at most
_PUSH: Final = (0.6, 2.0)  # [s]
_EVERY: Final = 5  # milliseconds from row to row of a recording


def joints(pose: Array) -> Array:
    """Joint angles (n, 3) of pitch, yaw and opening (n, 3) [rad]."""
    pitch, yaw, opening = pose.T
    return np.column_stack([pitch, yaw - 0.5 * opening, yaw + 0.5 * opening])


def multi_sine(seconds: float, seed: int) -> Array:
    """Random sum of sines: pitch, yaw and opening (n, 3) [rad] at 1 kHz, over the whole reach."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, SETPOINT_DT)
    waves = []
    for _ in range(3):
        rates = np.exp(rng.uniform(math.log(_BAND[0]), math.log(_BAND[1]), _TONES))
        phases, sizes = rng.uniform(0.0, 2.0 * math.pi, _TONES), rng.uniform(0.5, 1.0, _TONES)
        wave = sum(
            size * np.sin(2.0 * math.pi * rate * t + phase)
            for rate, phase, size in zip(rates, phases, sizes, strict=True)
        )
        waves.append(wave / np.abs(wave).max())
    return np.asarray(_CENTRE + _REACH * np.column_stack(waves))


def paused_sines(seconds: float, seed: int) -> Array:
    """`multi_sine` that stands still now and then, as a hand does: (n, 3) as that gives."""
    rng, length = np.random.default_rng([seed, 3]), round(seconds / SETPOINT_DT)
    rate = np.ones(length)
    at = rng.uniform(*_BETWEEN)
    t = np.arange(length) * SETPOINT_DT
    while at < seconds:
        rest = rng.uniform(*_REST)
        inside = np.clip(np.minimum(t - at, at + rest + 2.0 * _HALT - t) / _HALT, 0.0, 1.0)
        rate -= inside**2 * (3.0 - 2.0 * inside)
        at += rest + 2.0 * _HALT + rng.uniform(*_BETWEEN)
    sines = multi_sine(seconds, seed)
    clock = np.cumsum(rate)
    return np.column_stack([np.interp(clock, np.arange(length), column) for column in sines.T])


def steps(seconds: float, seed: int) -> Array:
    """Minimum-jerk steps between random poses, each followed by a rest, (n, 3) as `multi_sine`."""
    rng, length = np.random.default_rng(seed), round(seconds / SETPOINT_DT)
    pose, parts, rows = _CENTRE.copy(), [], 0
    while rows < length:
        end = _CENTRE + 0.9 * _REACH * rng.uniform(-1.0, 1.0, 3)
        duration = max(0.2, 1.875 * float(np.abs(end - pose).max()) / _SPEED)
        s = np.arange(1, round(duration / SETPOINT_DT) + 1) * SETPOINT_DT / duration
        blend = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        rest = round(rng.uniform(*_REST) / SETPOINT_DT)
        parts += [pose + blend[:, None] * (end - pose), np.tile(end, (rest, 1))]
        rows, pose = rows + len(blend) + rest, end
    return np.asarray(np.vstack(parts)[:length])


def grips(pose: Array, seed: int) -> tuple[Array, Array]:
    """Close the jaws of `pose` (n, 3) on something, half of the time.

    Give the pose that is then asked for, and the opening (n,) [rad] of what is between the jaws:
    there before they close on it, and gone once they have opened again. They go on turning.
    """
    rng, asked = np.random.default_rng([seed, 1]), pose.copy()
    t, held = np.arange(len(pose)) * SETPOINT_DT, np.full(len(pose), _FREE)
    at = 0.5
    while at < t[-1]:
        length, pressed = rng.uniform(1.0, 4.0), rng.uniform(*_PRESSED)
        gone = at + length + _RAMP
        size = float(pose[(t >= at) & (t <= gone), 2].min()) - _CLEAR
        there = np.clip(np.minimum(3.0 * (t - at), gone - t) / _RAMP, 0.0, 1.0)
        held = np.maximum(held, _FREE + (size - _FREE) * there)
        closed = np.clip(np.minimum(t - at, at + length - t) / _RAMP, 0.0, 1.0)
        closed = closed**2 * (3.0 - 2.0 * closed)
        asked[:, 2] += closed * (size - pressed - asked[:, 2])
        at += 2.0 * length
    return asked, held


def pushes(rows: int, seed: int) -> Array:
    """Draw forces at the tip (n, 2) [N] that come and go, a row a millisecond."""
    rng, t = np.random.default_rng([seed, 2]), np.arange(rows) * SETPOINT_DT
    force = np.zeros((rows, 2))
    for k in range(force.shape[1]):
        at = 1.0
        while at < t[-1]:
            length, size = rng.uniform(*_PUSH), rng.uniform(-_FORCE, _FORCE)
            inside = (t > at) & (t < at + length)
            force[:, k] += inside * size * np.sin(math.pi * (t - at) / length) ** 2
            at += length + rng.uniform(0.5, 3.0)
    return force


def record(
    twin: WristTwin, motion: Callable[[float, int], Array], seconds: float, seed: int, load: bool
) -> Recording:
    """Record a homed twin along a motion, free or with `grips` and `pushes`.

    It glides to where the motion begins, which is not recorded. Columns are ``measured``,
    ``effort``, ``motor`` and ``truth`` of every joint, tensions where they are measured, and what
    no laboratory has: ``truth_exact`` of the joints and ``truth_load``, torques [Nm] of grip and
    tip. Raises what `WristTwin.run` does.
    """
    pose, held = motion(seconds, seed), None
    if load:
        pose, held = grips(pose, seed)
    path = joints(pose)
    twin.run(glide(twin.commanded, path[0], 1.5))
    if held is not None:
        twin.held = later(twin.time, held)
        twin.tip_force = later(twin.time, pushes(len(pose), seed))
    try:
        run = twin.run(path)
    finally:
        twin.held = twin.tip_force = None
    columns = {"t": run.t, **run.columns()}
    columns |= {f"truth/{name}": run.truth.position[:, k] for k, name in enumerate(run.truth.name)}
    provenance = Provenance(
        robot=twin.robot.name,
        arm=twin.robot.arm,
        source=f"virtual wrist, seed {twin.seed}",
        session=f"{motion.__name__} {'loaded' if load else 'free'} {seed}",
        homing_id=f"seed {twin.seed}, homing {twin.homing_count}",
        load=twin.load,
        rates={"state": 1.0 / (_EVERY * SETPOINT_DT)},
    )
    return Recording.from_columns({k: v[::_EVERY] for k, v in columns.items()}, provenance)


def later(start: float, values: Array) -> Callable[[Array], Array]:
    """Give rows of `values`, one a millisecond from `start` [s] on, at times of a twin.

    The first and the last one hold before and after.
    """

    def at(t: Array) -> Array:
        rows = np.clip(np.rint((t - start) / SETPOINT_DT).astype(np.int64), 0, len(values) - 1)
        return values[rows]

    return at


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
        record(twin, paused_sines, seconds, seed + n, load=bool(n))
        for n, seconds in enumerate((free_s, loaded_s))
    ]
    tests = {
        name: record(twin, steps, test_s, seed + 2 + n, load=bool(n))
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
    notes = notes_on("wrist", **settings.options, seed=settings.seed)
    title = "Pitch and jaws of a wristed instrument"
    return frame_table(title, table, notes, head="estimator, family")


def _loads(rows: DataFrame) -> Table:
    keys = ["name", "test", "load"]
    errors, shares = median_texts(rows, keys, "rms", 1, 1e3), _shares(rows, keys)
    sizes = rows.groupby(keys, sort=False)["size"].median().mul(1e3).map("{:.1f}".format)
    table = DataFrame(index=unique(rows, "name"))
    for n, load in enumerate(LOADS):
        table[load] = errors[LOADED, load]
        table["of " + load] = sizes.unstack(keys[1:])[LOADED, load]
        table["in 90 %" + " " * n] = shares[LOADED, load]
    table["grip when free"] = errors[FREE, "grip"]
    notes = notes_on("wrist_loads")
    return frame_table("Grip and tip torque", table, notes, head="estimator, family")


def _shares(rows: DataFrame, keys: list[str]) -> DataFrame:
    """Texts of the median share within what is stated; empty where nothing is."""
    shares = rows.groupby(keys, sort=False).inside.median().mul(100)
    return shares.map(lambda share: "" if math.isnan(share) else f"{share:.0f} %").unstack(keys[1:])
