"""Table I of peng2024: which direction of the zig-zags calibrates best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.motion import DIRECTIONS
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import (
    Part,
    PartResult,
    Settings,
    Statement,
    Summary,
    check_counts,
    check_names,
)
from truejoint.studies.verdicts import RULE, below, whole

FITTED_TO: Final = ("J1", "J2-J3")
"""Directions whose linear and polynomial rows the specimen ``peng2024`` was fitted to."""
KINDS: Final = ("fine", "coarse")
"""Options that say which sparsities are trained on."""
_NAMES: Final = (*DIRECTIONS, s.PUBLISHED)


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, direction and session."""
    check_names("direction", settings["directions"], _NAMES)
    check_counts(settings, "minutes", "sessions", "networks")
    sets = {kind: settings[kind] for kind in KINDS}
    for text in sets.values():
        s.combination(text)
    common = {"networks": settings["networks"], "seconds": 60.0 * settings["minutes"], **sets}
    # Every direction has an arm, a homing and a test of its own, as in the paper.
    cases = {name: {"direction": name} for name in _NAMES}
    chosen = settings["directions"]
    return s.part_for_each(settings, calibrate, 0, common, cases=cases, chosen=chosen)


def calibrate(
    raven: s.Plain, direction: str, seed: int, networks: int, seconds: float, fine: str, coarse: str
) -> PartResult:
    """Calibrate on two combinations of zig-zags of a direction, and judge on a random motion."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, (fine, coarse), direction)
    test = s.random_test(arm, seconds, seed=s.TEST_SEED + seed)
    return PartResult(
        {
            kind: s.judged(s.fitted(training[text], networks, seed), test)
            for kind, text in zip(KINDS, (fine, coarse), strict=True)
        }
    )


def _printed(condition: str, joint: int, method: str) -> float | None:
    named = DIRECTIONS[-1] if condition == s.PUBLISHED else condition
    return tables.printed("I", f"direction={named}", joint, method)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table I beside the paper's, and what it says of directions."""
    made, figures, judged = [], {}, []
    for title in s.specimens(settings["specimens"]):
        fine, coarse = (_by_direction(settings, results, title, kind) for kind in KINDS)
        made += [
            tables.accuracy_table(
                f"peng2024 Table I, specimen {title}, trained on {settings['fine']}",
                fine,
                s.METHODS,
                _printed,
                ("4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6.", RULE),
            ),
            tables.percent_table(
                f"Share of the fixed offset's error, specimen {title}", fine, _printed
            ),
            tables.accuracy_table(
                f"The same trained on {settings['coarse']}, specimen {title}",
                coarse,
                s.METHODS,
                tables.unprinted,
            ),
            tables.ratio_table(
                f"RMSE over the paper's, specimen {title}",
                {
                    "J1, J2-J3": {k: v for k, v in fine.items() if k in FITTED_TO},
                    "the others": {k: v for k, v in fine.items() if k not in FITTED_TO},
                },
                s.METHODS,
                _printed,
            ),
        ]
        figures[f"directions-{title}"] = tables.accuracy_figure(
            f"peng2024 Table I, specimen {title}",
            fine,
            (*s.MODELS, "offset"),
            _printed,
            "RMSE on a random motion by direction of the zig-zags.",
        )
        if set(DIRECTIONS) <= set(fine):
            judged += [claim.judged(fine, title) for claim in CLAIMS]
    return Summary(made, figures, judged)


def _by_direction(
    settings: Settings, results: Mapping[str, PartResult], title: str, kind: str
) -> dict[str, list[s.Errors]]:
    return {
        name: [part.numbers[kind] for part in s.sessions_of(settings, results, title, name)]
        for name in settings["directions"]
    }


def _left(fine: tables.Found, *methods: str) -> dict[str, Any]:
    """Share [%] of the offset's error left by a direction, by session, mean over joints, models."""
    return {
        name: np.mean([tables.percent(fine[name], one).mean(axis=1) for one in methods], axis=0)
        for name in DIRECTIONS
    }


def _best_overall(fine: tables.Found) -> tuple[bool | None, str]:
    left = _left(fine, *s.MODELS)
    order = sorted(left, key=lambda name: float(left[name].mean()))
    text = ", ".join(f"{name} {left[name].mean():.1f} %" for name in order[:3])
    others = [below(left[s.BEST], left[name]) for name in DIRECTIONS if name != s.BEST]
    return whole(*others), f"{text}; {s.BEST} is number {order.index(s.BEST) + 1} of 7"


def _best_of_joint(joint: int, *expected: str) -> Any:
    """Whether the `expected` direction of each of `MODELS` errs least in a joint."""

    def judge(fine: tables.Found) -> tuple[bool | None, str]:
        verdicts, texts = [], []
        for method, direction in zip(s.MODELS, expected, strict=True):
            errors = {name: tables.by_session(fine[name], method)[:, joint] for name in DIRECTIONS}
            least = min(errors, key=lambda name: float(errors[name].mean()))
            others = (below(errors[direction], errors[n]) for n in errors if n != direction)
            verdicts.append(whole(*others))
            texts.append(f"{method}: {least} {errors[least].mean():.3f}")
            if least != direction:
                texts[-1] += f", {direction} {errors[direction].mean():.3f}"
        return whole(*verdicts), "; ".join(texts)

    return judge


def _on_best(method: str, joint: int) -> claims.Pick:
    return lambda fine: tables.by_session(fine[s.BEST], method)[:, joint]


def _removed(fine: tables.Found) -> tuple[bool | None, str]:
    left = np.array([tables.percent(fine[s.BEST], one).mean(axis=0) for one in s.MODELS])
    return bool(left[0].max() <= 25.0), f"the network leaves {_percents(left[0])}"


def _offset_of_raw(fine: tables.Found) -> tuple[bool | None, str]:
    offset, raw = (tables.by_session(fine[s.BEST], one).mean(axis=0) for one in ("offset", "raw"))
    share = 100.0 * offset / raw
    return bool(share.max() < 50.0), f"it leaves {_percents(share)} of the raw error"


def _percents(values: Any) -> str:
    return ", ".join(f"{v:.0f} %" for v in values)


CLAIMS: Final = (
    Statement(
        "J2-J3 is the best direction over all joints and models", "peng2024, II-E", _best_overall
    ),
    Statement(
        "joint 1: the network and the linear model are best on J2-J3, the polynomial on J1-J3",
        "peng2024, Table I",
        _best_of_joint(0, "J2-J3", "J1-J3", "J2-J3"),
    ),
    Statement(
        "joint 2: the network is best on J2-J3, polynomial and linear model on J1-J2-J3",
        "peng2024, Table I",
        _best_of_joint(1, "J2-J3", "J1-J2-J3", "J1-J2-J3"),
    ),
    Statement(
        "joint 3: all models are best on J3",
        "peng2024, Table I",
        _best_of_joint(2, "J3", "J3", "J3"),
    ),
    claims.ordered(
        "trained on J2-J3, the network errs least in every joint",
        "peng2024, Table I",
        *(
            (f"{joint}, {other}", _on_best("dnn", k), _on_best(other, k))
            for k, joint in enumerate(s.JOINTS)
            for other in ("poly2", "linear")
        ),
    ),
    Statement(
        "trained on J2-J3, the network leaves at most a quarter of the fixed offset's error",
        "peng2024, Table I",
        _removed,
    ),
    Statement(
        "a fixed offset removes more than half of the raw error in every joint",
        "peng2024, II-E",
        _offset_of_raw,
    ),
)
