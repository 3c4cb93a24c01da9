"""II-J and Table II of peng2024: to predict the error, or the joint's position end to end."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.studies.claim_tests import RULE
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, Results, Rows, Settings, Summary

TARGETS: Final = ("error", "position")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    return s.part_for_each(settings, predict, 500_000, "sets", "networks", "hours")


def predict(raven: s.Plain, seed: int, sets: Sequence[str], networks: int, hours: int) -> Rows:
    """Fit every model to either target, and judge it on each hour of unloaded work."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, sets)
    tests = s.working(arm, hours, s.TEST_SEED + seed)
    rows: Rows = []
    for target in TARGETS:
        fitted = [s.fitted(group, networks, seed, target=target) for group in training.values()]
        models = {m: [model for several in fitted for model in several[m]] for m in s.MODELS}
        for hour, test in enumerate(tests):
            rows += s.judged(models, test, target=target, hour=hour)
    return rows


@tables.by_specimen
def summarise(results: Results, title: str, rows: DataFrame) -> Summary:
    """Table II beside the paper's."""
    hours = results.settings["hours"]
    notes = (f"Mean over {hours} hours of unloaded work and all trainings.", RULE)
    table = tables.accuracy_table(
        f"peng2024 Table II, specimen {title}", rows.assign(condition=rows.target), s.MODELS,
        tables.printed("II", "target={}"), notes,
    )  # fmt: skip
    return Summary((table,), claims=[claim.judged(rows, title) for claim in CLAIMS])


def _difference(rows: DataFrame, **where: Any) -> Array:
    """Error, and by how much the other target's differs from it."""
    error, position = (tables.by_session(rows, target=one, **where) for one in TARGETS)
    return np.asarray(np.abs(error - position) + error)


_ERROR, _POSITION = ({"target": target} for target in TARGETS)
CLAIMS: Final = (
    claims.ordered(
        "the network errs less in every joint when it predicts the error",
        "peng2024, Table II", _ERROR, _POSITION, method=("dnn",), joint=s.JOINTS,
    ),
    claims.not_worse(
        1e-3, "linear and polynomial model are the same either way",
        "peng2024, Table II", _ERROR, _difference, method=("linear", "poly2"), joint=s.JOINTS,
    ),
    claims.ordered(
        "end to end, the network is worse than the linear model in every joint",
        "peng2024, Table II",
        _POSITION | {"method": "linear"}, _POSITION | {"method": "dnn"}, joint=s.JOINTS,
    ),
    claims.ordered(
        "over the hours, the polynomial errs most",
        "peng2024, Table II",
        _ERROR, _ERROR | {"method": "poly2"}, joint=s.JOINTS, method=("dnn", "linear"),
    ),
)  # fmt: skip
