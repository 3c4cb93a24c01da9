"""II-I and figure 9 of peng2024: what a new homing costs, with none or one seen in training."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from pandas import DataFrame

from truejoint.drawing import by_condition
from truejoint.errors import StudyError
from truejoint.studies.claim_tests import RULE
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import select
from truejoint.studies.study import Part, Results, Rows, Settings, Summary

NONE, ONE = SEEN = ("none", "one")
"""Homings amid the training."""
_METHODS: Final = (*s.MODELS, "offset")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, data set and session."""
    divisions = s.combination(settings["training"])
    if len(divisions) < 2:
        raise StudyError(f"training={settings['training']}: two zig-zags or more see a homing")
    more = {"seconds": 60.0 * settings["minutes"], "divisions": divisions}
    cases = {seen: {"seen": seen == ONE} for seen in SEEN}
    return s.part_for_each(
        settings, home_again, 400_000, "networks", "homings", more=more, cases=cases
    )


def home_again(
    raven: s.Plain,
    seen: bool,
    seed: int,
    networks: int,
    homings: int,
    seconds: float,
    divisions: Sequence[int],
) -> Rows:
    """Calibrate before the first of some homings, or before and after it; judge after each.

    Where a homing is seen, the last of the zig-zags comes after it.
    """
    arm, _ = s.homed(raven, seed)
    training = s.zigzags(arm, divisions[:-1] if seen else divisions)
    tests = [s.random_test(arm, seconds, s.TEST_SEED + seed)]
    for homing in range(homings):
        arm.home()
        if seen and homing == 0:
            training += s.zigzags(arm, divisions[-1:])
        tests.append(s.random_test(arm, seconds, s.TEST_SEED * (homing + 2) + seed))
    models = s.fitted(training, networks, seed)
    rows: Rows = []
    for n, test in enumerate(tests):
        rows += s.judged(models, test, homings=n)
    return rows


@tables.by_specimen
def summarise(_results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 9, its numbers, and what the paper says of homing."""
    rows = rows.assign(seen=rows.case + " seen", homed_since=rows.homings > 0)
    rows = rows.sort_values("case", kind="stable")
    after = rows.homings.map(lambda n: f", after homing {n}" if n else ", before")
    rows = rows.assign(condition=rows.seen + after, name=rows.method + ", " + rows.seen)
    name = f"peng2024 figure 9, specimen {title}"
    table = tables.accuracy_table(name, rows, _METHODS, notes=(RULE,))
    drawn = select(rows, method=("dnn", "linear", "offset"))
    caption = "RMSE of a random motion after each homing; median over the sessions."
    look = {"condition": "homings", "by": "name", "x": "homings since"}
    figure = tables.joint_figure(name, drawn, caption, by_condition, **look)
    judged = [claim.judged(rows, title) for claim in CLAIMS]
    return Summary((table,), {f"homing-{title}": figure}, judged)


_BEFORE, _AFTER = {"homings": 0}, {"homed_since": True}
_TWO: Final = ("dnn", "linear")
CLAIMS: Final = (
    claims.ordered(
        "joint 2: with no homing seen, a homing makes network and linear model worse",
        "peng2024, II-I", _BEFORE, _AFTER, method=_TWO, seen=("none seen",), joint=("elbow",),
    ),
    claims.ordered(
        "joint 2: one homing seen in training helps after the next ones", "peng2024, II-I",
        _AFTER | {"case": ONE}, _AFTER | {"case": NONE}, method=_TWO, joint=("elbow",),
    ),
    *(
        claims.not_worse(
            0.2, f"joint {number}: a homing costs nothing, whether one was seen or not",
            "peng2024, II-I", _BEFORE, _AFTER,
            method=_TWO, seen=("none seen", "one seen"), joint=(joint,),
        )
        for number, joint in ((1, "shoulder"), (3, "insertion"))
    ),
)  # fmt: skip
