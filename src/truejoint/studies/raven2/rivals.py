"""II-K, Tables III to V of peng2024: joints and tool beside what others reached, and times."""

import time
import timeit
from collections.abc import Sequence
from functools import partial
from itertools import chain, product
from typing import Any, Final

import numpy as np
from pandas import DataFrame, concat

from truejoint.array_types import Array
from truejoint.calibration import calibrate
from truejoint.errors import StudyError
from truejoint.estimators import estimator_names
from truejoint.evaluation.scoring import rmse, tool_error
from truejoint.motion import PROFILES, follow, random_motion
from truejoint.recordings import Recording
from truejoint.runtime import Corrector
from truejoint.studies import claim_tests as claims
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import frame_table, notes_on, paper_numbers, reported, reported_text
from truejoint.studies.study import Part, Plain, Results, Rows, Settings, Summary
from truejoint.tables import Table

WHEN: Final = ("first", "last")
"""Hours that are judged."""
_AXES: Final = ("x", "y", "z", "distance")
_SCALES: Final = {**dict(zip(s.JOINTS, s.SCALES, strict=True)), **dict.fromkeys(_AXES, 1e3)}
"""From SI to deg and mm."""
_OTHERS: Final = tuple(
    dict.fromkeys(
        (table, condition, method)
        for source, table, condition, method, _ in paper_numbers()
        if source == "peng2024" and " 20" in condition
    )
)
"""Table, condition and method of what peng2024 quotes of others: the condition names a year."""


def rivals_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    settings.check_names("model", "models", estimator_names())
    s.combination(settings["training"])
    if settings["hours"] < 2:
        raise StudyError(f"hours={settings['hours']}; first and last make at least 2")
    return s.part_for_each(settings, compare, 600_000, "models", "training", "hours")


def compare(raven: Plain, models: Sequence[str], seed: int, training: str, hours: int) -> Rows:
    """Fit models, and judge joints and tool in the first and the last hour of unloaded work."""
    arm, _ = s.homed(raven, seed)
    sets = s.training_sets(arm, (training,))[training]
    tests = [s.random_test(arm, s.HOUR, s.TEST_SEED + seed)]
    if hours > 2:
        seconds = (hours - 2) * s.HOUR
        follow(arm, random_motion(arm.robot, seconds, 2 * s.TEST_SEED + seed, profile=PROFILES[1]))
    tests.append(s.random_test(arm, s.HOUR, 3 * s.TEST_SEED + seed))
    fitted = {name: s.model_of(sets, name) for name in models}
    rows: Rows = []
    for when, test in zip(WHEN, tests, strict=True):
        estimates = {"raw": test.columns("measured", s.JOINTS)}
        estimates |= {name: model.correct(test) for name, model in fitted.items()}
        for name, estimate in estimates.items():
            rows += errors_of(estimate, test, when=when, method=name)
    return rows


def errors_of(estimate: Array, test: Recording, **labels: str) -> Rows:
    """RMSE of the joints (3,) [rad, rad, m] and of the tool (x, y, z, distance) [m], as rows."""
    truth, robot = test.columns("truth", s.JOINTS), test.robot
    has_truth = np.isfinite(truth).all(axis=1)
    estimate, truth = estimate[has_truth], truth[has_truth]
    here = test.columns("measured", robot.joint_names)[has_truth]
    there, columns = here.copy(), robot.index(s.JOINTS)
    here[:, columns], there[:, columns] = estimate, truth
    assert robot.kinematics is not None  # noqa: S101 - for the type checker; RAVEN-II has them
    away = tool_error(robot.kinematics, here, there)
    distance = float(np.sqrt(np.mean((away**2).sum(axis=1))))
    errors = [*rmse(estimate - truth).tolist(), *rmse(away).tolist(), distance]
    return [
        {**labels, "quantity": name, "rmse": value}
        for name, value in zip((*s.JOINTS, *_AXES), errors, strict=True)
    ]


def rivals_summary(results: Results) -> Summary:
    """Tables III and IV beside the paper's and those that it quotes."""
    rows = results.rows.assign(rmse=results.rows.rmse * results.rows.quantity.map(_SCALES))
    by_specimen = [(str(title), group) for title, group in rows.groupby("specimen", sort=False)]
    made = [_table(title, group, table) for title, group in by_specimen for table in ("III", "IV")]
    if not set(s.TWO) <= set(results.settings["models"]):
        return Summary(made)
    judged = [claims.judged(RIVALS_CLAIMS, group, title) for title, group in by_specimen]
    return Summary(made, claims=list(chain.from_iterable(judged)))


def _table(title: str, rows: DataFrame, table: str) -> Table:
    joints = table == "III"
    quantities = list(s.JOINTS if joints else _AXES)
    means = rows.pivot_table("rmse", "method", ["when", "quantity"], sort=False)
    first, last = (means[when][quantities].map("{:.3f}".format) for when in WHEN)

    def prints(condition: str, method: str) -> list[str]:
        return [reported_text(_printed(table, condition, method, key), 3) for key in quantities]

    hour = f"RAVEN-II {'unloaded' if joints else 'estimated'} hour"
    paper = {
        f"paper: {method}, hour 0 to 5": [*map("{} to {}".format, *ends)]
        for method in s.TWO
        for ends in [[prints(f"{hour}{n}", method) for n in (0, 5)]]
    }
    paper |= {
        f"paper: {condition}, {method}": prints(condition, method)
        for group, condition, method in _OTHERS
        if group == table
    }
    body = concat([first + " to " + last, DataFrame(paper, quantities).T])
    body.columns = s.TITLES if joints else [f"{axis} [mm]" for axis in _AXES]
    notes = (
        "RMSE in the first to the last hour of unloaded work after one calibration.",
        claims.RULE if joints else "The tool by forward kinematics, the last four joints as exact.",
    )
    return frame_table(f"peng2024 Table {table}, specimen {title}", body, notes, head="model")


def _printed(table: str, condition: str, method: str, quantity: str) -> float | None:
    if quantity in s.JOINTS:
        quantity = f"joint{s.JOINTS.index(quantity) + 1}"
    return reported("peng2024", table, condition, method, quantity).get("rmse")


def _as_table_4(rows: DataFrame) -> claims.Verdict:
    """Whether tool errors are those that the paper estimates, fresh and after five hours."""
    hours = zip(WHEN, ("hour0", "hour5"), strict=True)
    pairs = []
    for (when, hour), method, axis in product(hours, s.TWO, _AXES):
        there = _printed("IV", f"RAVEN-II estimated {hour}", method, axis)
        own = claims.by_session(rows, when=when, method=method, quantity=axis)
        pairs += [(f"{when} hour, {method}, {axis}", own, there)] if there else []
    return claims.matches(pairs)


def _below(when: str, quantities: Sequence[str], *sources: tuple[str, str, str]) -> claims.Judge:
    """Judge against the smallest errors of others, by table, condition and method of peng2024."""

    def quoted(rows: DataFrame, quantity: str, **_: Any) -> Array:
        least = min(_printed(*source, quantity) or np.inf for source in sources)
        return np.full(rows.session.nunique(), least)

    return claims.ordered({"when": when}, quoted, {"method": s.TWO, "quantity": quantities})


RIVALS_CLAIMS: Final = claims.statements(
    "state-of-the-art",
    {
        "below-haghighipanah": _below("last", s.JOINTS, _OTHERS[0]),
        "below-mahler-peng": _below("first", _AXES[:3], *_OTHERS[-2:]),
        "below-hwang": _below("first", _AXES[3:], ("IV", "dVRK Hwang 2022 pick", "rnn")),
        "table-4": _as_table_4,
    },
)


SERVO: Final = 1e-3
"""Period of RAVEN-II's servo loop [s]."""
_COLD: Final = 300  # samples before times count
_BOUNDS: Final = {"dnn": 50.0, "linear": 2.0}  # [s], peng2024, Table V
_TIMES: Final = 160.0  # of the network's inference time to the linear model's (abstract)


def timing_parts(settings: Settings) -> Sequence[Part]:
    """One a repetition: times are only comparable one after the other, as each takes them."""
    settings.check_names("model", "models", estimator_names())
    s.combination(settings["training"])
    if settings["samples"] < 1000:
        raise StudyError(f"samples={settings['samples']}; give 1000 or more")
    (raven,) = s.specimens(("peng2024",)).values()
    common = {name: settings[name] for name in ("models", "training", "samples")}
    first = s.STUDY_SEED * settings.seed
    return [
        Part(f"timing-{n}", measure, {"raven": raven, "seed": first + n, **common}, {"session": n})
        for n in range(settings["repeats"])
    ]


def measure(raven: Plain, models: Sequence[str], seed: int, training: str, samples: int) -> Rows:
    """Time fits, and the control loop's corrections sample by sample [s]."""
    arm, _ = s.homed(raven, seed)
    sets = s.training_sets(arm, (training,))[training]
    test = s.random_test(arm, samples / s.STATE_RATE + 2.0, s.TEST_SEED + seed)
    calibrate([one.rows(slice(0, 400)) for one in sets], "linear")  # libraries and kernels
    few = test.rows(slice(0, 2))  # the shortest table, as a framework's call for a sample
    timed: Rows = []
    for name in models:
        # Processor time: what else the machine does shall not count.
        began = time.process_time()
        model = calibrate(sets, name)
        fit = time.process_time() - began
        corrector = Corrector(model)
        rows = test.table[list(corrector.signals)].to_numpy()[:samples]
        each = np.empty(len(rows))
        for i, (t, row) in enumerate(zip(test.t, rows, strict=False)):
            began = time.perf_counter()
            corrector.step(t, row)
            each[i] = time.perf_counter() - began
        whole = timeit.repeat(partial(model.correct, few), number=1, repeat=50)
        step, step_99 = np.quantile(each[_COLD:], [0.5, 0.99]).tolist()
        seconds = {"fit": fit, "table": float(np.median(whole)), "step": step, "step_99": step_99}
        timed.append({"method": name, **seconds, "rows": sum(map(len, sets))})
    return timed


def timing_summary(results: Results) -> Summary:
    """Table V beside the paper's."""
    rows = results.rows
    times = rows.groupby("method", sort=False).median(numeric_only=True)

    def printed(row: str, metric: str, form: str, scale: float = 1.0) -> list[str]:
        there = [reported("peng2024", "V", row, name, "all").get(metric) for name in times.index]
        return ["" if value is None else form.format(scale * value) for value in there]

    table = DataFrame(
        {
            "fit [s of CPU]": times.fit,
            "paper": printed("training time", "upper bound", "< {:g}"),
            "a sample in the loop [us]": 1e6 * times.step,
            "99 %": 1e6 * times.step_99,
            "a call on a table [us]": (1e6 * times.table).map("{:.0f}".format),
            "paper [us]": printed("inference one sample", "mean", "{:g}", 1e3),
        }
    )
    notes = notes_on("timing", **results.settings.options, rows=times.rows.iloc[0])
    judged = claims.judged(TIMING_CLAIMS, rows) if set(s.TWO) <= set(times.index) else ()
    title = "peng2024 Table V: time"
    return Summary((frame_table(title, table, notes, decimals=2, head="model"),), claims=judged)


def _of(rows: DataFrame, method: str, column: str) -> Array:
    """Give the times (k,) [s] of a model in every repetition."""
    return np.asarray(rows[rows.method == method][column])


def _fits(rows: DataFrame) -> claims.Verdict:
    fits = {name: _of(rows, name, "fit") for name in _BOUNDS}
    text = ", ".join(f"{name} {np.median(seconds):.2f} s" for name, seconds in fits.items())
    return claims.below_all([(fits[name], most) for name, most in _BOUNDS.items()]), text


def _servo(rows: DataFrame, name: str, *, expected: bool) -> claims.Verdict:
    late = _of(rows, name, "step_99")
    text = f"{1e6 * np.median(late):.1f} us at 99 %"
    return claims.below(late, SERVO) if expected else claims.below(SERVO, late), text


def _speed(rows: DataFrame, name: str, seconds: float) -> claims.Verdict:
    own = 1e6 * _of(rows, name, "step")
    return claims.matches([(f"{name}, a sample [us]", own, 1e6 * seconds)])


def _faster(rows: DataFrame, times: float = 1.0) -> claims.Verdict:
    """Whether the linear model's speed is above so many times the network's."""
    network, linear = (_of(rows, name, "step") for name in s.TWO)
    text = (
        f"{np.median(network / linear):.1f} times; what took 61 ms there is a framework's overhead "
        f"a call, not the 12,103 weights, which take {1e6 * np.median(network):.1f} us compiled"
    )
    return claims.below(times, network / linear), text


TIMING_CLAIMS: Final = claims.statements(
    "timing",
    {
        "fit-times": _fits,
        "servo-linear": partial(_servo, name="linear", expected=True),
        "servo-network": partial(_servo, name="dnn", expected=False),
        "speed-network": partial(_speed, name="dnn", seconds=61e-3),
        "speed-linear": partial(_speed, name="linear", seconds=0.38e-3),
        "faster-linear": _faster,
        "160-times": partial(_faster, times=_TIMES / 2.0),
    },
)
