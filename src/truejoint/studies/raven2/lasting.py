"""II-G and II-I of peng2024: what hours of rest and work, and homings, do to a calibration."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np
from pandas import DataFrame, concat

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel, by_condition
from truejoint.errors import StudyError
from truejoint.estimators.family import TARGETS
from truejoint.studies import claim_tests as claims
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2 import tables
from truejoint.studies.raven2.sessions import LOADED, UNLOADED, WORKS
from truejoint.studies.raven2.training import by_length
from truejoint.studies.rows import select, unique
from truejoint.studies.study import Part, Plain, Results, Rows, Settings, Summary

_FEW: Final = 3  # combinations at most that count as the longest, or the shortest (II-G)
_DRAWN: Final = {
    "truth": ("0.8", "-", 5.0), "raw": ("k", ":", 0.9), "dnn": ("tab:blue", "-", 0.9),
    "linear": ("tab:green", "--", 0.9),
}  # fmt: skip
"""What is drawn of them, and how; the last two fitted to the longest training."""

LONGEST, SHORTEST = "longest", "shortest"
"""Combinations of sparsities by the time that they take, up to three of each."""


def endurance_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session: what is fitted is the same for every kind of work.

    Both targets are fitted, so that these are the parts of the study of targets, too.
    """
    settings.check_names("kind of work", "works", WORKS)
    if not 0.0 < settings["load_g"] <= 2000.0:
        raise StudyError(f"load_g={settings['load_g']:g}; it must be above 0, up to 2000")
    load = {LOADED: settings["load_g"] / 1e3}
    works = {work: load.get(work, 0.0) for work in WORKS if work in settings["works"]}
    more = {"works": works, "targets": TARGETS}
    return s.part_for_each(
        settings, s.calibrate_once, 300_000, "sets", "networks", "hours", more=more
    )


def by_training(rows: DataFrame) -> DataFrame:
    """Rows of the longest and of the shortest combinations, which the column ``training`` names.

    ``when`` says ``"first"`` of the first hour and ``"last"`` of the last.
    """
    count, ends = rows.place.nunique(), {0: "first", rows.hour.max(): "last"}
    some = max(1, min(_FEW, count // 2))
    which = ((LONGEST, rows.place >= count - some), (SHORTEST, rows.place < some))
    return concat(
        rows[chosen].assign(training=name, when=rows.hour.map(ends)) for name, chosen in which
    )


@tables.by_specimen
def endurance_summary(results: Results, title: str, rows: DataFrame) -> Summary:
    """Figures 6 and 7, the rows of Table III, and what the paper says of the hours."""
    settings, works = results.settings, results.settings["works"]
    every = tables.in_order(by_length(select(rows, target=TARGETS[0])), "work", works)
    rows = by_training(every)
    hours = select(rows, training=LONGEST).sort_values("hour", kind="stable")
    hours = hours.assign(condition=hours.hour.map("hour {}".format))
    note = "Models of the longest trainings, three where there are six or more."
    made = [
        tables.accuracy_table(
            f"peng2024 figure 6 and Table III, {name}, specimen {title}", select(hours, work=work),
            s.CORRECTED, partial(_printed, work), (note, claims.RULE),
        )
        for work in works
        for name in [f"{work}, {settings['load_g']:g} g" if work == LOADED else work]
    ]  # fmt: skip
    mean = f"Mean over {settings['hours']} h by what was trained on, specimen {title}"
    every = every.assign(condition=every.work + ", " + every.set)
    made.append(tables.accuracy_table(mean, every, s.CORRECTED, notes=(tables.ZIGZAGS,)))
    drawn = select(rows, method=s.CORRECTED)
    drawn = drawn.assign(name=drawn.method + ", " + drawn.training + " trainings")
    caption = "RMSE by hour after one calibration; median over trainings of the three lengths."
    name = f"peng2024 figure 6, specimen {title}"
    look = {"condition": "hour", "by": "name", "x": "hour", "log": "y"}
    figure = tables.joint_figure(name, drawn, caption, by_condition, "work", **look)
    minute = _trajectories(title, works, results.arrays[f"{title}-0"])
    figures = {f"endurance-{title}": figure, f"trajectories-{title}": minute}
    whole = set(WORKS) <= set(works) and settings["hours"] > 1
    return Summary(made, figures, claims.judged(ENDURANCE_CLAIMS, rows, title) if whole else ())


def _printed(work: str, condition: str, joint: str, method: str) -> float | None:
    return tables.printed("III", f"RAVEN-II {work} {{}}")(condition.replace(" ", ""), joint, method)


def _trajectories(title: str, works: Sequence[str], minutes: Mapping[str, Array]) -> Figure:
    panels = [
        [
            Panel(
                [
                    Curve(
                        minutes[f"{work}/t"], s.SCALES[joint] * minutes[f"{work}/{name}"][:, joint],
                        name, *look,
                    )
                    for name, look in _DRAWN.items()
                ],
                "time [s]", label, "" if joint else work,
            )
            for work in works
        ]
        for joint, label in enumerate(s.TITLES)
    ]  # fmt: skip
    caption = (
        "The first minute of the first hour's test: the true joints, those that the robot reports, "
        "and these corrected by models of the longest training."
    )
    return Figure(f"peng2024 figure 7, specimen {title}", panels, caption, height=8.0, legend=True)


def _as_table_3(rows: DataFrame) -> claims.Verdict:
    hours = select(rows, training=LONGEST, work=UNLOADED, when=("first", "last"))
    hours = hours.assign(condition=hours.hour.map("hour {}".format))
    return tables.as_printed(hours, partial(_printed, UNLOADED), s.TWO)


def _length_gain(rows: DataFrame) -> claims.Verdict:
    """Whether long trainings are better by a fifth, geometric mean over joints and all works."""
    texts, pairs = [], []
    gain = {"training": LONGEST}, {"training": SHORTEST}
    for method in ("dnn", "linear", "poly2"):
        logs = [
            np.log(claims.errors(rows, gain, work=work, joint=joint, method=method))
            for work in unique(rows, "work")
            for joint in s.JOINTS
        ]
        ratios = np.exp(np.mean(logs, axis=0))  # by session
        pairs.append((ratios, 0.8))
        texts.append(
            f"{method} {100 * (1 - ratios.mean()):.0f} % better{claims.against(ratios, 0.8)}"
        )
    return claims.below_all(pairs), f"{', '.join(texts)} after the longest than the shortest"


ENDURANCE_CLAIMS: Final = claims.statements(
    "endurance", {"table-3-hours": _as_table_3, "long-trainings": _length_gain}
)


SEEN: Final = ("none", "one")
"""Homings amid the training."""


def homing_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, data set and session."""
    divisions = s.combination(settings["training"])
    if len(divisions) < 2:
        raise StudyError(f"training={settings['training']}: two zig-zags or more see a homing")
    more = {"seconds": 60.0 * settings["minutes"], "divisions": divisions}
    cases = {seen: {"seen": seen == "one"} for seen in SEEN}
    return s.part_for_each(
        settings, home_again, 400_000, "networks", "homings", more=more, cases=cases
    )


def home_again(
    raven: Plain,
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
def homing_summary(_results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 9, its numbers, and what the paper says of homing."""
    rows = rows.assign(seen=rows.case + " seen", homed_since=rows.homings > 0)
    rows = rows.sort_values("case", kind="stable")
    after = rows.homings.map(lambda n: f", after homing {n}" if n else ", before")
    rows = rows.assign(condition=rows.seen + after, name=rows.method + ", " + rows.seen)
    name = f"peng2024 figure 9, specimen {title}"
    table = tables.accuracy_table(name, rows, s.CORRECTED, notes=(claims.RULE,))
    drawn = select(rows, method=(*s.TWO, "offset"))
    caption = "RMSE of a random motion after each homing; median over the sessions."
    look = {"condition": "homings", "by": "name", "x": "homings since"}
    figure = tables.joint_figure(name, drawn, caption, by_condition, **look)
    judged = claims.judged(HOMING_CLAIMS, rows, title)
    return Summary((table,), {f"homing-{title}": figure}, judged)


HOMING_CLAIMS: Final = claims.statements("homing", {})
