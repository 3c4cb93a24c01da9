"""II-F and figure 5 of peng2024: accuracy against the time that calibrating takes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.drawing import Box, Figure, Panel
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, PartResult, Settings, Statement, Summary, check_counts
from truejoint.studies.verdicts import RULE

_OFFSET: Final = 200_000  # of the arms' seeds, so that no other study has the same
_METHODS: Final = (*s.MODELS, "offset")


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and repetition."""
    check_counts(settings, "minutes", "repeats", "networks")
    s.check_sets(settings)
    common = {
        "sets": settings["sets"],
        "networks": settings["networks"],
        "seconds": 60.0 * settings["minutes"],
    }
    return s.part_for_each(settings, repeat, _OFFSET, common, count="repeats")


def repeat(
    raven: s.Plain, seed: int, sets: Sequence[str], networks: int, seconds: float
) -> PartResult:
    """Record every sparsity once, calibrate on each combination, and judge on a random motion."""
    arm, _ = s.homed(raven, seed)
    training = s.training_sets(arm, sets)
    test = s.random_test(arm, seconds, s.TEST_SEED + seed)
    errors = {text: s.judged(s.fitted(own, networks, seed), test) for text, own in training.items()}
    lengths = {text: s.seconds_of(own) for text, own in training.items()}
    return PartResult({"errors": errors, "seconds": lengths})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Figure 5, its numbers, and what the paper says of them."""
    made, figures, judged = [], {}, []
    for title, numbers in s.numbers_of(settings, results, "repeats").items():
        seconds = {
            text: np.mean([one["seconds"][text] for one in numbers]) for text in settings["sets"]
        }
        order = sorted(seconds, key=lambda text: float(seconds[text]))
        found = {text: [one["errors"][text] for one in numbers] for text in order}
        named = {f"{text}, {seconds[text]:.0f} s": found[text] for text in order}
        made.append(
            tables.accuracy_table(
                f"peng2024 figure 5, specimen {title}",
                named,
                _METHODS,
                tables.unprinted,
                ("4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6.", RULE),
            )
        )
        figures[f"sparsity-{title}"] = _figure(title, found, seconds)
        judged += [claim.judged(found, title) for claim in CLAIMS]
    return Summary(made, figures, judged)


def _figure(title: str, found: tables.Found, seconds: Mapping[str, float]) -> Figure:
    panels = []
    for joint, label in enumerate(s.TITLES):
        boxes = [
            Box(
                place + (number - 1.5) * 0.2,
                tables.by_session(sessions, method)[:, joint],
                tables.COLOURS[method],
                method if place == 0 else "",
            )
            for place, sessions in enumerate(found.values())
            for number, method in enumerate(_METHODS)
        ]
        names = [f"{text}\n{seconds[text]:.0f} s" for text in found]
        panels.append([Panel((), y=f"RMSE, {label}", log="y", boxes=boxes, columns=names)])
    caption = "RMSE on random motions by what was trained on; boxes: over the repetitions."
    return Figure(f"peng2024 figure 5, specimen {title}", panels, caption, height=9.0, legend=True)


def _of(place: int, method: str, joint: int) -> claims.Pick:
    """Errors of the combination at a `place` in the order of time."""
    return lambda found: tables.by_session(list(found.values())[place], method)[:, joint]


def _longer(joint: int, *methods: str) -> list[claims.Pair]:
    return [(name, _of(-1, name, joint), _of(0, name, joint)) for name in methods]


def _spread(found: tables.Found) -> tuple[bool | None, str]:
    """Whether the polynomial scatters more than the others on the shortest, in joint 1 and 2."""
    first = next(iter(found.values()))
    if len(first) < 2:
        return None, "one repetition has no spread"
    spread = {m: tables.by_session(first, m).std(axis=0, ddof=1)[:2] for m in s.MODELS}
    holds = all((spread["poly2"] > spread[name]).all() for name in ("dnn", "linear"))
    text = "; ".join(f"{name} {v[0]:.3f}, {v[1]:.3f}" for name, v in spread.items())
    return bool(holds), f"standard deviations: {text}"


CLAIMS: Final = (
    claims.ordered(
        "joint 1: the longest calibration is better than the shortest, for every model",
        "peng2024, II-F",
        *_longer(0, *s.MODELS),
    ),
    claims.ordered(
        "joint 2: network and linear model are better after more than 800 s",
        "peng2024, II-F",
        *_longer(1, "dnn", "linear"),
    ),
    claims.ordered(
        "joint 3: network and linear model are better after more time",
        "peng2024, II-F",
        *_longer(2, "dnn", "linear"),
    ),
    claims.ordered(
        "joint 1: on the shortest, network and linear model already beat the fixed offset",
        "peng2024, II-F",
        *((name, _of(0, name, 0), _of(0, "offset", 0)) for name in ("dnn", "linear")),
    ),
    claims.ordered(
        "the network needs less data: on the shortest it errs less than the linear model",
        "peng2024, III and Table V",
        *((joint, _of(0, "dnn", k), _of(0, "linear", k)) for k, joint in enumerate(s.JOINTS)),
    ),
    claims.kept(
        "joint 1: the fixed offset gains nothing by more time",
        "peng2024, II-F",
        0.05,
        ("offset", _of(-1, "offset", 0), _of(0, "offset", 0)),
    ),
    Statement(
        "on the shortest, the polynomial scatters more than the others in joints 1 and 2",
        "peng2024, II-F",
        _spread,
    ),
)
