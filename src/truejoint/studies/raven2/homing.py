"""II-I and figure 9 of peng2024: what a new homing costs, with none or one seen in training."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts
from truejoint.studies.verdicts import RULE

NONE, ONE = "none seen", "one seen"
SEEN: Final = {NONE: "none", ONE: "one"}
"""Homings amid the training, and what a part is called after it."""
_OFFSET: Final = 400_000  # of the arms' seeds, so that no other study has the same
_METHODS: Final = (*s.MODELS, "offset")

Found = Mapping[str, Sequence[Sequence[s.Errors]]]
"""Errors of each session and test by what was seen."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, data set and session."""
    check_counts(settings, "homings", "minutes", "sessions", "networks")
    common = {
        "networks": settings["networks"],
        "homings": settings["homings"],
        "seconds": 60.0 * settings["minutes"],
        "divisions": s.combination(settings["training"]),
    }
    if len(common["divisions"]) < 2:
        raise StudyError(f"training={settings['training']}: two zig-zags or more see a homing")
    cases = {case: {"seen": seen == ONE} for seen, case in SEEN.items()}
    return s.part_for_each(settings, home_again, _OFFSET, common, cases=cases)


def home_again(
    raven: s.Plain,
    seen: bool,
    seed: int,
    networks: int,
    homings: int,
    seconds: float,
    divisions: Sequence[int],
) -> PartResult:
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
    return PartResult({"tests": [s.judged(models, test) for test in tests]})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Figure 9, its numbers, and what the paper says of homing."""
    made, figures, judged = [], {}, []
    for title in s.specimens(settings["specimens"]):
        found = {
            seen: [p.numbers["tests"] for p in s.sessions_of(settings, results, title, case)]
            for seen, case in SEEN.items()
        }
        rows = {
            f"{seen}, after homing {n}" if n else f"{seen}, before": [one[n] for one in sessions]
            for seen, sessions in found.items()
            for n in range(settings["homings"] + 1)
        }
        title_text = f"peng2024 figure 9, specimen {title}"
        made.append(tables.accuracy_table(title_text, rows, _METHODS, tables.unprinted, (RULE,)))
        figures[f"homing-{title}"] = _figure(title_text, found)
        judged += [claim.judged(found, title) for claim in CLAIMS]
    return Summary(made, figures, judged)


def _figure(title: str, found: Found) -> Figure:
    panels = []
    for joint, label in enumerate(s.TITLES):
        curves = []
        for seen, style in zip(SEEN, ("o:", "o-"), strict=True):
            for method in ("dnn", "linear", "offset"):
                by_test = [
                    tables.by_session(tests, method)[:, joint].mean()
                    for tests in zip(*found[seen], strict=True)
                ]
                name, colour = f"{method}, {seen}", tables.COLOURS[method]
                curves.append(Curve(np.arange(len(by_test)), by_test, name, colour, style))
        names = [str(n) for n in range(len(found[NONE][0]))]
        panels.append(Panel(curves, "homings since", f"RMSE, {label}", columns=names))
    caption = "RMSE of a random motion after each homing; mean over the sessions."
    return Figure(title, (panels,), caption, width=12.0, height=4.4, legend=True)


def _first(seen: str, method: str, joint: int) -> claims.Pick:
    return lambda found: tables.by_session([one[0] for one in found[seen]], method)[:, joint]


def _after(seen: str, method: str, joint: int) -> claims.Pick:
    """Mean over the tests after homings, by session."""
    return lambda found: np.array(
        [tables.by_session(one[1:], method)[:, joint].mean() for one in found[seen]]
    )


CLAIMS: Final = (
    claims.ordered(
        "joint 2: with no homing seen, a homing makes network and linear model worse",
        "peng2024, II-I",
        *((m, _first(NONE, m, 1), _after(NONE, m, 1)) for m in ("dnn", "linear")),
    ),
    claims.ordered(
        "joint 2: one homing seen in training helps after the next ones",
        "peng2024, II-I",
        *((m, _after(ONE, m, 1), _after(NONE, m, 1)) for m in ("dnn", "linear")),
    ),
    claims.kept(
        "joint 1: a homing costs nothing, whether one was seen or not",
        "peng2024, II-I",
        0.2,
        *(
            (f"{m}, {seen}", _first(seen, m, 0), _after(seen, m, 0))
            for m in ("dnn", "linear")
            for seen in SEEN
        ),
    ),
    claims.kept(
        "joint 3: a homing costs nothing, whether one was seen or not",
        "peng2024, II-I",
        0.2,
        *(
            (f"{m}, {seen}", _first(seen, m, 2), _after(seen, m, 2))
            for m in ("dnn", "linear")
            for seen in SEEN
        ),
    ),
)
