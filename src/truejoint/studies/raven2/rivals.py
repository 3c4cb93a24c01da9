"""II-K, Tables III and IV of peng2024: joints and tool beside what others reached."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
from sklearn.ensemble import RandomForestRegressor
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from truejoint.array_types import Array
from truejoint.errors import StudyError
from truejoint.estimators import Stack, get_estimator
from truejoint.evaluation.metrics import rmse, tool_error
from truejoint.recordings import Recording
from truejoint.studies.raven2 import claims
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts, check_names
from truejoint.studies.table import reported, reported_text
from truejoint.studies.verdicts import RULE
from truejoint.tables import Table, fixed

RAW: Final = "raw"
WHEN: Final = ("first", "last")
"""Hours that are judged."""
_OFFSET: Final = 600_000  # of the arms' seeds, so that no other study has the same
_AXES: Final = ("x", "y", "z", "distance")
_CONDITION: Final = {"joint": "RAVEN-II unloaded", "tool": "RAVEN-II estimated"}
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


class Rival(NamedTuple):
    """A kind of model, and how many rows a second it is fitted to [Hz]; None: all."""

    title: str
    fit_rate: float | None = None


RIVALS: Final[Mapping[str, Rival]] = {
    "dnn": Rival("network (peng2024)"),
    "linear": Rival("linear (peng2024)"),
    "poly2": Rival("polynomial (peng2024)"),
    "gru": Rival("gated recurrent units"),
    "tcn": Rival("temporal convolutions, as Park 2024"),
    "gpr": Rival("Gaussian process, as Mahler's kind", 1.0),
    "forest": Rival("random forest"),
    "network_forest": Rival("network and a random forest on what it leaves, as Seita 2018"),
    "rich_play": Rival("plays of every signal, ridge (ours)"),
    "rich_trees": Rival("boosted trees on what plays leave (ours)"),
}
"""By the key that stands in options and numbers."""


Found = Sequence[Mapping[str, Any]]
"""Numbers of each session."""


def _unfitted(name: str) -> Any:
    if name == "gpr":
        kernel = ConstantKernel(1.0) * RBF(3.0) + WhiteKernel(1e-2)
        process = GaussianProcessRegressor(kernel, normalize_y=True, random_state=0)
        return make_pipeline(StandardScaler(), process)
    forest = RandomForestRegressor(60, min_samples_leaf=5, n_jobs=1, random_state=0)
    if name == "forest":
        return forest
    if name == "network_forest":
        return Stack(("dnn", forest))
    return get_estimator(name)


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    check_counts(settings, "sessions")
    check_names("model", settings["models"], tuple(RIVALS))
    s.combination(settings["training"])
    if settings["hours"] < 2:
        raise StudyError(f"hours={settings['hours']}; first and last make at least 2")
    common = {name: settings[name] for name in ("models", "training", "hours")}
    return s.part_for_each(settings, compare, _OFFSET, common)


def compare(
    raven: s.Plain, models: Sequence[str], seed: int, training: str, hours: int
) -> PartResult:
    """Fit models, and judge joints and tool in the first and the last hour of unloaded work."""
    arm, _ = s.homed(raven, seed)
    sets = s.training_sets(arm, (training,))[training]
    tests = [s.random_test(arm, s.HOUR, s.TEST_SEED + seed)]
    if hours > 2:
        s.work(arm, (hours - 2) * s.HOUR, 2 * s.TEST_SEED + seed)
    tests.append(s.random_test(arm, s.HOUR, 3 * s.TEST_SEED + seed))
    fitted = {
        name: s.model_of(sets, _unfitted(name), fit_rate=RIVALS[name].fit_rate) for name in models
    }
    return PartResult(
        {
            when: {
                RAW: errors_of(test.columns("measured", s.JOINTS), test),
                **{name: errors_of(model.correct(test), test) for name, model in fitted.items()},
            }
            for when, test in zip(WHEN, tests, strict=True)
        }
    )


def errors_of(estimate: Array, test: Recording) -> dict[str, list[float]]:
    """RMSE of the joints (3,) [rad, rad, m] and of the tool (x, y, z, distance) [m]."""
    truth, robot = test.columns("truth", s.JOINTS), test.robot
    known = np.isfinite(truth).all(axis=1)
    estimate, truth = estimate[known], truth[known]
    here = test.columns("measured", robot.joint_names)[known]
    there, columns = here.copy(), robot.index(s.JOINTS)
    here[:, columns], there[:, columns] = estimate, truth
    assert robot.kinematics is not None  # noqa: S101 - for the type checker; RAVEN-II has them
    away = tool_error(robot.kinematics, here, there)
    distance = float(np.sqrt(np.mean((away**2).sum(axis=1))))
    return {"joint": rmse(estimate - truth).tolist(), "tool": [*rmse(away).tolist(), distance]}


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Tables III and IV beside the paper's and those that it quotes."""
    made, judged = [], []
    for title, numbers in s.numbers_of(settings, results).items():
        for table, kind in (("III", "joint"), ("IV", "tool")):
            made.append(_table(title, table, kind, numbers))
        if set(_MEANT) <= set(settings["models"]):
            judged += [claim.judged(numbers, title) for claim in CLAIMS]
    return Summary(made, claims=judged)


def _values(numbers: Found, when: str, kind: str, model: str) -> Array:
    """RMSE by session and column [deg, deg, mm], or [mm]."""
    scales = s.SCALES if kind == "joint" else 1e3
    return np.array([one[when][model][kind] for one in numbers]) * scales


def _table(title: str, table: str, kind: str, numbers: Found) -> Table:
    columns = s.TITLES if kind == "joint" else tuple(f"{axis} [mm]" for axis in _AXES)
    rows = []
    for model in numbers[0][WHEN[0]]:
        ends = [_values(numbers, when, kind, model).mean(axis=0) for when in WHEN]
        cells = [f"{fixed(a, 3)} to {fixed(b, 3)}" for a, b in zip(*ends, strict=True)]
        rows.append((RIVALS[model].title if model in RIVALS else model, *cells))
    quantities = [f"joint{k + 1}" for k in range(3)] if kind == "joint" else _AXES
    for model in ("dnn", "linear"):
        ends = [
            [_printed(table, f"{_CONDITION[kind]} hour{h}", model, one) for one in quantities]
            for h in (0, 5)
        ]
        cells = [
            f"{reported_text(a, 3)} to {reported_text(b, 3)}" for a, b in zip(*ends, strict=True)
        ]
        rows.append((f"paper: {model}, hour 0 to 5", *cells))
    for own, condition, model in _OTHERS:
        if own == table:
            cells = [reported_text(_printed(table, condition, model, one), 3) for one in quantities]
            rows.append((f"paper: {condition}, {model}", *cells))
    notes = (
        "RMSE in the first to the last hour of unloaded work after one calibration.",
        "The tool by forward kinematics, the last four joints taken as exact, as in the paper."
        if kind == "tool"
        else RULE,
    )
    header = ("model", *columns)
    return Table(f"peng2024 Table {table}, specimen {title}", header, tuple(rows), notes)


def _printed(table: str, condition: str, method: str, quantity: str) -> float | None:
    return reported("peng2024", table, condition, method, quantity).get("rmse")


def _here(when: str, kind: str, model: str, column: int) -> claims.Pick:
    return lambda numbers: _values(numbers, when, kind, model)[:, column]


def _there(table: str, condition: str, method: str, quantity: str) -> claims.Pick:
    value = _printed(table, condition, method, quantity)
    return lambda numbers: np.full(len(numbers), value)


_MEANT: Final = ("dnn", "linear")
CLAIMS: Final = (
    claims.ordered(
        "even after hours, network and linear model are below the filter of Haghighipanah 2015",
        "peng2024, Table III",
        *(
            (
                f"{model}, {joint}",
                _here("last", "joint", model, k),
                _there("III", "RAVEN-II Haghighipanah 2015", "ukf", f"joint{k + 1}"),
            )
            for model in _MEANT
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
    claims.ordered(
        "fresh, network and linear model are below Mahler 2014 and Peng 2020 on every axis",
        "peng2024, Table IV",
        *(
            (
                f"{model}, {axis}, {condition}",
                _here("first", "tool", model, k),
                _there("IV", condition, method, axis),
            )
            for model in _MEANT
            for _, condition, method in _OTHERS[-2:]
            for k, axis in enumerate(_AXES[:3])
        ),
    ),
    claims.ordered(
        "fresh, the tool is off by less than Hwang's 0.65 mm",
        "peng2024, Table IV",
        *(
            (
                model,
                _here("first", "tool", model, 3),
                _there("IV", "dVRK Hwang 2022 pick", "rnn", "distance"),
            )
            for model in _MEANT
        ),
    ),
)
