"""II-K, Tables III and IV of peng2024: joints and tool beside what others reached."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.errors import StudyError
from truejoint.estimators import estimator_names
from truejoint.evaluation.judge import rmse, tool_error
from truejoint.motion import PROFILES, follow, random_motion
from truejoint.recordings import Recording
from truejoint.studies.claim_tests import RULE
from truejoint.studies.paper_tables import reported, reported_text
from truejoint.studies.raven2 import claims
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import Table

WHEN: Final = ("first", "last")
"""Hours that are judged."""
_AXES: Final = ("x", "y", "z", "distance")
_SCALES: Final = {**dict(zip(s.JOINTS, s.SCALES, strict=True)), **dict.fromkeys(_AXES, 1e3)}
"""From SI to deg and mm."""
_OTHERS: Final = (
    ("III", "RAVEN-II Haghighipanah 2015", "ukf"),
    ("III", "dVRK left arm Hwang 2022", "rnn"),
    ("III", "dVRK right arm Hwang 2022", "rnn"),
    ("IV", "dVRK Hwang 2022 pick", "rnn"),
    ("IV", "dVRK Hwang 2022 random", "rnn"),
    ("IV", "RAVEN-II Mahler 2014", "gpr"),
    ("IV", "RAVEN-II Peng 2020", "dnn"),
)
"""Table, condition and method of what peng2024 quotes of others."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    settings.check_names("model", "models", estimator_names())
    s.combination(settings["training"])
    if settings["hours"] < 2:
        raise StudyError(f"hours={settings['hours']}; first and last make at least 2")
    return s.part_for_each(settings, compare, 600_000, "models", "training", "hours")


def compare(raven: s.Plain, models: Sequence[str], seed: int, training: str, hours: int) -> Rows:
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


def summarise(results: Results) -> Summary:
    """Tables III and IV beside the paper's and those that it quotes."""
    judged = CLAIMS if set(_MEANT) <= set(results.settings["models"]) else ()
    made, found_claims = [], []
    for title, found in results.rows.groupby("specimen", sort=False):
        rows = found.assign(rmse=found.rmse * found.quantity.map(_SCALES))
        made += [_table(str(title), rows, table) for table in ("III", "IV")]
        found_claims += [claim.judged(rows, str(title)) for claim in judged]
    return Summary(made, claims=found_claims)


def _table(title: str, rows: DataFrame, table: str) -> Table:
    joints = table == "III"
    quantities = list(s.JOINTS if joints else _AXES)
    means = rows.pivot_table("rmse", "method", ["quantity", "when"], sort=False)
    ends: list[Any] = [
        means.xs(when, axis=1, level="when")[quantities].map("{:.3f}".format) for when in WHEN
    ]
    body = [tuple(cells) for cells in (ends[0] + " to " + ends[1]).itertuples()]
    condition = f"RAVEN-II {'unloaded' if joints else 'estimated'} hour"
    for method in _MEANT:
        hours = [_prints(table, f"{condition}{hour}", method, quantities) for hour in (0, 5)]
        cells = [" to ".join(pair) for pair in zip(*hours, strict=True)]
        body.append((f"paper: {method}, hour 0 to 5", *cells))
    for group, condition, method in _OTHERS:
        if group == table:
            cells = _prints(table, condition, method, quantities)
            body.append((f"paper: {condition}, {method}", *cells))
    notes = (
        "RMSE in the first to the last hour of unloaded work after one calibration.",
        RULE if joints else "The tool by forward kinematics, the last four joints as exact.",
    )
    columns = s.TITLES if joints else tuple(f"{axis} [mm]" for axis in _AXES)
    return Table(
        f"peng2024 Table {table}, specimen {title}", ("model", *columns), tuple(body), notes
    )


def _prints(table: str, condition: str, method: str, quantities: Sequence[str]) -> list[str]:
    found = (_printed(table, condition, method, quantity) for quantity in quantities)
    return [reported_text(value, 3) for value in found]


def _printed(table: str, condition: str, method: str, quantity: str) -> float | None:
    if quantity in s.JOINTS:
        quantity = f"joint{s.JOINTS.index(quantity) + 1}"
    return reported("peng2024", table, condition, method, quantity).get("rmse")


def _quoted(*sources: tuple[str, str, str]) -> claims.Pick:
    """Smallest of the errors that peng2024 quotes of others, by table, condition and method."""

    def pick(rows: DataFrame, quantity: str, **_: Any) -> Array:
        least = min(_printed(*source, quantity) or np.inf for source in sources)
        return np.full(rows.session.nunique(), least)

    return pick


_MEANT: Final = ("dnn", "linear")
CLAIMS: Final = (
    claims.ordered(
        "even after hours, network and linear model are below the filter of Haghighipanah 2015",
        "peng2024, Table III",
        {"when": "last"}, _quoted(_OTHERS[0]), method=_MEANT, quantity=s.JOINTS,
    ),
    claims.ordered(
        "fresh, network and linear model are below Mahler 2014 and Peng 2020 on every axis",
        "peng2024, Table IV",
        {"when": "first"}, _quoted(*_OTHERS[-2:]), method=_MEANT, quantity=_AXES[:3],
    ),
    claims.ordered(
        "fresh, the tool is off by less than Hwang's 0.65 mm", "peng2024, Table IV",
        {"when": "first"}, _quoted(("IV", "dVRK Hwang 2022 pick", "rnn")),
        method=_MEANT, quantity=("distance",),
    ),
)  # fmt: skip
