"""II-F and figure 5 of peng2024: accuracy against the time that calibrating takes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from pandas import DataFrame

from truejoint.studies.claim_tests import RULE, scatters_more, whole
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import select
from truejoint.studies.study import Part, Results, Rows, Settings, Statement, Summary

_METHODS: Final = (*s.MODELS, "offset")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and repetition."""
    test = {"seconds": 60.0 * settings["minutes"]}
    return s.part_for_each(
        settings, repeat, 200_000, "sets", "networks", more=test, count="repeats"
    )


def repeat(raven: s.Plain, seed: int, sets: Sequence[str], networks: int, seconds: float) -> Rows:
    """Record every sparsity once, calibrate on each combination, and judge on a random motion."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, sets)
    test = s.random_test(arm, seconds, s.TEST_SEED + seed)
    rows: Rows = []
    for text, group in training.items():
        models = s.fitted(group, networks, seed)
        rows += s.judged(models, test, set=text, seconds=s.seconds_of(group))
    return rows


def by_length(rows: DataFrame) -> DataFrame:
    """Rows in the order of the mean ``length`` [s] of what was trained on.

    ``when`` says ``"first"`` of the shortest and ``"last"`` of the longest.
    """
    length = rows.groupby("set").seconds.mean()
    place = {text: n for n, text in enumerate(length.sort_values().index)}
    ends = {0: "first", len(place) - 1: "last"}
    rows = rows.assign(length=rows.set.map(length), place=rows.set.map(place))
    return rows.assign(when=rows.place.map(ends)).sort_values("place", kind="stable")


@tables.by_specimen
def summarise(_results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 5, its numbers, and what the paper says of them."""
    rows = by_length(rows)
    seconds = rows.length.map("{:.0f} s".format)
    rows = rows.assign(condition=rows.set + ", " + seconds, place=rows.set + "\n" + seconds)
    name = f"peng2024 figure 5, specimen {title}"
    table = tables.accuracy_table(name, rows, _METHODS, notes=(tables.ZIGZAGS, RULE))
    caption = "RMSE on random motions by what was trained on; boxes: over the repetitions."
    figure = tables.joint_boxes(name, select(rows, method=_METHODS), caption, "place")
    judged = [claim.judged(rows, title) for claim in CLAIMS]
    return Summary((table,), {f"sparsity-{title}": figure}, judged)


def _spread(rows: DataFrame) -> claims.Verdict:
    """Whether the polynomial scatters more than the others on the shortest, in joint 1 and 2."""
    first = select(rows, when="first", joint=s.JOINTS[:2])
    if first.session.nunique() < 2:
        return None, "one repetition has no spread"
    errors = first.pivot_table("rmse", "session", ["joint", "method"], sort=False)
    verdicts = [scatters_more(errors[j]["poly2"], [errors[j][name] for name in _TWO])
                for j in s.JOINTS[:2]]  # fmt: skip
    text = "; ".join(f"{m} {', '.join(f'{errors[j][m].std():.3f}' for j in s.JOINTS[:2])}"
                     for m in s.MODELS)  # fmt: skip
    return whole(*verdicts), f"standard deviations: {text}"


_SHORTEST, _LONGEST = {"when": "first"}, {"when": "last"}
_SHOULDER, _ELBOW, _INSERTION = ((joint,) for joint in s.JOINTS)
_TWO: Final = ("dnn", "linear")
CLAIMS: Final = (
    claims.ordered(
        "joint 1: the longest calibration is better than the shortest, for every model",
        "peng2024, II-F", _LONGEST, _SHORTEST, method=s.MODELS, joint=_SHOULDER,
    ),
    claims.ordered(
        "joint 2: network and linear model are better after more than 800 s",
        "peng2024, II-F", _LONGEST, _SHORTEST, method=_TWO, joint=_ELBOW,
    ),
    claims.ordered(
        "joint 3: network and linear model are better after more time",
        "peng2024, II-F", _LONGEST, _SHORTEST, method=_TWO, joint=_INSERTION,
    ),
    claims.ordered(
        "joint 1: on the shortest, network and linear model already beat the fixed offset",
        "peng2024, II-F", _SHORTEST, _SHORTEST | {"method": "offset"}, method=_TWO, joint=_SHOULDER,
    ),
    claims.ordered(
        "the network needs less data: on the shortest it errs less than the linear model",
        "peng2024, III and Table V",
        _SHORTEST | {"method": "dnn"}, _SHORTEST | {"method": "linear"}, joint=s.JOINTS,
    ),
    claims.not_worse(
        0.05, "joint 1: the fixed offset gains nothing by more time",
        "peng2024, II-F", _LONGEST, _SHORTEST, method=("offset",), joint=_SHOULDER,
    ),
    Statement(
        "on the shortest, the polynomial scatters more than the others in joints 1 and 2",
        "peng2024, II-F", _spread, flaw=True,
    ),
)  # fmt: skip
