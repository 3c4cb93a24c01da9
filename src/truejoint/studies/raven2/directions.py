"""Table I of peng2024: which direction of the zig-zags calibrates best."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.motion import DIRECTIONS
from truejoint.studies.claim_tests import RULE, against, below_all
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import select
from truejoint.studies.study import Part, Results, Rows, Settings, Statement, Summary

FITTED_TO: Final = ("J1", "J2-J3")
"""Directions whose linear and polynomial rows the specimen ``peng2024`` was fitted to."""
KINDS: Final = ("fine", "coarse")
"""Options that say which sparsities are trained on."""
_NAMES: Final = (*DIRECTIONS, s.PUBLISHED)


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, direction and session."""
    settings.check_names("direction", "directions", _NAMES)
    for kind in KINDS:
        s.combination(settings[kind])
    # Every direction has an arm, a homing and a test of its own, as in the paper.
    more, chosen = {"seconds": 60.0 * settings["minutes"]}, settings["directions"]
    cases = {name: {"direction": name} for name in _NAMES}
    return s.part_for_each(
        settings, calibrate, 0, "networks", *KINDS, more=more, cases=cases, chosen=chosen
    )


def calibrate(
    raven: s.Plain, direction: str, seed: int, networks: int, seconds: float, fine: str, coarse: str
) -> Rows:
    """Calibrate on two combinations of zig-zags of a direction, and judge on a random motion."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, (fine, coarse), direction)
    test = s.random_test(arm, seconds, seed=s.TEST_SEED + seed)
    rows: Rows = []
    for kind, text in zip(KINDS, (fine, coarse), strict=True):
        rows += s.judged(s.fitted(training[text], networks, seed), test, kind=kind)
    return rows


def _printed(condition: str, joint: int, method: str) -> float | None:
    named = DIRECTIONS[-1] if condition == s.PUBLISHED else condition
    return tables.printed("I", "direction={}")(named, joint, method)


@tables.by_specimen
def summarise(results: Results, title: str, rows: DataFrame) -> Summary:
    """Table I beside the paper's, and what it says of directions."""
    settings, chosen = results.settings, results.settings["directions"]
    rows = tables.in_order(rows.assign(condition=rows.case), "condition", chosen)
    fine, coarse = (select(rows, kind=kind) for kind in KINDS)
    name = f"peng2024 Table I, specimen {title}"
    of_groups = {
        "J1, J2-J3": [one for one in chosen if one in FITTED_TO],
        "the others": [one for one in chosen if one not in FITTED_TO],
    }
    made = (
        tables.accuracy_table(
            f"{name}, trained on {settings['fine']}", fine, s.METHODS, _printed,
            (tables.ZIGZAGS, RULE),
        ),
        tables.percent_table(
            f"Share of the fixed offset's error, specimen {title}", fine, _printed
        ),
        tables.accuracy_table(
            f"The same trained on {settings['coarse']}, specimen {title}", coarse, s.METHODS
        ),
        tables.ratio_table(
            f"RMSE over the paper's, specimen {title}", fine, of_groups, s.METHODS, _printed
        ),
    )  # fmt: skip
    caption = "RMSE on a random motion by direction of the zig-zags."
    drawn = select(fine, method=(*s.MODELS, "offset"))
    figure = tables.joint_boxes(name, drawn, caption, "condition")
    judged = CLAIMS if set(DIRECTIONS) <= set(chosen) else ()
    found = [claim.judged(fine, title) for claim in judged]
    return Summary(made, {f"directions-{title}": figure}, found)


def _best_overall(fine: DataFrame) -> claims.Verdict:
    shares = {
        name: np.mean(
            [tables.percent(fine, method=one, condition=name).mean(axis=1) for one in s.MODELS],
            axis=0,
        )
        for name in DIRECTIONS
    }
    order = sorted(shares, key=lambda name: float(shares[name].mean()))
    text = ", ".join(f"{name} {shares[name].mean():.1f} %" for name in order[:3])
    holds = below_all([(shares[s.BEST], shares[name]) for name in DIRECTIONS if name != s.BEST])
    return holds, f"{text}; {s.BEST} is number {order.index(s.BEST) + 1} of 7"


def _best_of_joint(joint: int, *expected: str) -> Callable[[DataFrame], claims.Verdict]:
    """Whether the `expected` direction of each of `MODELS` errs least in a joint."""

    def judge(fine: DataFrame) -> claims.Verdict:
        pairs, texts = [], []
        for method, direction in zip(s.MODELS, expected, strict=True):
            of: dict[str, Any] = {"joint": s.JOINTS[joint], "method": method}
            errors = {name: tables.by_session(fine, condition=name, **of) for name in DIRECTIONS}
            least = min(errors, key=lambda name: float(errors[name].mean()))
            pairs += [(errors[direction], errors[n]) for n in errors if n != direction]
            texts.append(f"{method}: {least} {errors[least].mean():.3f}")
            if least != direction:
                texts[-1] += f", {direction} {errors[direction].mean():.3f}"
                texts[-1] += against(errors[direction], errors[least])
        return below_all(pairs), "; ".join(texts)

    return judge


def _removed(fine: DataFrame) -> claims.Verdict:
    share = tables.percent(fine, method="dnn", condition=s.BEST)
    return below_all([(own, 25.0) for own in share.T]), f"the network leaves {_percents(share)}"


def _offset_of_raw(fine: DataFrame) -> claims.Verdict:
    offset, raw = (
        np.array([tables.by_session(fine, joint=j, method=m, condition=s.BEST) for j in s.JOINTS]).T
        for m in ("offset", "raw")
    )
    share = 100.0 * offset / raw
    holds = below_all([(own, 50.0) for own in share.T])
    return holds, f"it leaves {_percents(share)} of the raw error"


def _percents(shares: Array) -> str:
    return ", ".join(f"{v:.0f} %" for v in shares.mean(axis=0))


_TABLE: Final = "peng2024, Table I"
_ON_BEST: Final = {"condition": s.BEST}
CLAIMS: Final = (
    Statement(
        "J2-J3 is the best direction over all joints and models", "peng2024, II-E", _best_overall
    ),
    Statement(
        "joint 1: the network and the linear model are best on J2-J3, the polynomial on J1-J3",
        _TABLE,
        _best_of_joint(0, "J2-J3", "J1-J3", "J2-J3"),
    ),
    Statement(
        "joint 2: the network is best on J2-J3, polynomial and linear model on J1-J2-J3",
        _TABLE,
        _best_of_joint(1, "J2-J3", "J1-J2-J3", "J1-J2-J3"),
    ),
    Statement("joint 3: all models are best on J3", _TABLE, _best_of_joint(2, "J3", "J3", "J3")),
    claims.ordered(
        "trained on J2-J3, the network errs least in every joint",
        _TABLE, _ON_BEST | {"method": "dnn"}, _ON_BEST, joint=s.JOINTS, method=("poly2", "linear"),
    ),
    Statement(
        "trained on J2-J3, the network leaves at most a quarter of the fixed offset's error",
        _TABLE,
        _removed,
    ),
    Statement(
        "a fixed offset removes more than half of the raw error in every joint",
        "peng2024, II-E",
        _offset_of_raw,
    ),
)  # fmt: skip
