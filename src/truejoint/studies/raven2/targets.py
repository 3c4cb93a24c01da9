"""II-J and Table II of peng2024: to predict the error, or the joint's position end to end."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts
from truejoint.studies.verdicts import RULE

TARGETS: Final = ("error", "position")
_OFFSET: Final = 500_000  # of the arms' seeds, so that no other study has the same

Found = Mapping[str, Sequence[s.Errors]]
"""Errors of each session by target, all hours and trainings together."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    check_counts(settings, "hours", "sessions", "networks")
    s.check_sets(settings)
    common = {name: settings[name] for name in ("sets", "networks", "hours")}
    return s.part_for_each(settings, predict, _OFFSET, common)


def predict(
    raven: s.Plain, seed: int, sets: Sequence[str], networks: int, hours: int
) -> PartResult:
    """Fit every model to either target, and judge it on each hour of unloaded work."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, sets)
    tests = s.working(arm, hours, s.TEST_SEED + seed)
    found: dict[str, s.Errors] = {}
    for target in TARGETS:
        fitted = [s.fitted(own, networks, seed, target=target) for own in training.values()]
        models = {m: [model for ones in fitted for model in ones[m]] for m in s.MODELS}
        by_hour = [s.judged(models, test) for test in tests]
        found[target] = {m: [row for hour in by_hour for row in hour[m]] for m in by_hour[0]}
    return PartResult(found)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table II beside the paper's."""
    made, judged = [], []
    for title, numbers in s.numbers_of(settings, results).items():
        found = {target: [one[target] for one in numbers] for target in TARGETS}
        name = f"peng2024 Table II, specimen {title}"
        note = f"Mean over {settings['hours']} hours of unloaded work and all trainings."
        made.append(tables.accuracy_table(name, found, s.MODELS, _printed, (note, RULE)))
        judged += [claim.judged(found, title) for claim in CLAIMS]
    return Summary(made, claims=judged)


def _printed(condition: str, joint: int, method: str) -> float | None:
    return tables.printed("II", f"target={condition}", joint, method)


def _of(target: str, method: str, joint: int) -> claims.Pick:
    return lambda found: tables.by_session(found[target], method)[:, joint]


def _same(method: str, joint: int) -> claims.Pair:
    name = f"{method}, {s.JOINTS[joint]}"

    def difference(found: Found) -> np.ndarray:
        one, other = (_of(target, method, joint)(found) for target in TARGETS)
        return np.abs(one - other) + one

    return name, _of("error", method, joint), difference


CLAIMS: Final = (
    claims.ordered(
        "the network errs less in every joint when it predicts the error",
        "peng2024, Table II",
        *(
            (joint, _of("error", "dnn", k), _of("position", "dnn", k))
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
    claims.kept(
        "linear and polynomial model are the same either way",
        "peng2024, Table II",
        1e-3,
        *(_same(method, k) for method in ("linear", "poly2") for k in range(len(s.JOINTS))),
    ),
    claims.ordered(
        "end to end, the network is worse than the linear model in every joint",
        "peng2024, Table II",
        *(
            (joint, _of("position", "linear", k), _of("position", "dnn", k))
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
    claims.ordered(
        "over the hours, the polynomial errs most",
        "peng2024, Table II",
        *(
            (f"{joint}, {other}", _of("error", other, k), _of("error", "poly2", k))
            for k, joint in enumerate(s.JOINTS)
            for other in ("dnn", "linear")
        ),
    ),
)
