"""II-G, figures 6 and 7, Table III of peng2024: six hours idle, at work, and under a load."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import StudyError
from truejoint.recordings import Recording
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
from truejoint.studies.verdicts import RULE
from truejoint.tables import Table

IDLE, UNLOADED, LOADED = WORKS = ("idle", "unloaded", "loaded")
"""What the arm does; the last with a mass on its tool."""
_OFFSET: Final = 300_000  # of the arms' seeds, so that no other study has the same
_METHODS: Final = (*s.MODELS, "offset")
_FEW: Final = 3  # combinations at most that count as the longest, or the shortest (II-G)
_EXAMPLE: Final = 60.0  # [s] of the first hour that are drawn, as in figure 7
_DRAWN: Final = {
    "truth": ("0.8", "-", 5.0), "raw": ("k", ":", 0.9), "dnn": ("tab:blue", "-", 0.9),
    "linear": ("tab:green", "--", 0.9),
}  # fmt: skip
"""What is drawn of them, and how; the last two fitted to the longest training."""

Hours = Sequence[Mapping[str, s.Errors]]
"""Errors by combination of sparsities, for each hour."""
Choose = Callable[[Mapping[str, s.Errors]], s.Errors]
Found = Mapping[str, Sequence[Hours]]
"""Hours of each session by what the arm did; combinations in the order of time."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, kind of work and session."""
    check_counts(settings, "hours", "sessions", "networks")
    check_names("kind of work", settings["works"], WORKS)
    s.check_sets(settings)
    if not 0.0 < settings["load_g"] <= 2000.0:
        raise StudyError(f"load_g={settings['load_g']:g}; it must be above 0, up to 2000")
    common = {name: settings[name] for name in ("sets", "networks", "hours")}
    load = {LOADED: settings["load_g"] / 1e3}
    cases = {work: {"work": work, "load": load.get(work, 0.0)} for work in WORKS}
    return s.part_for_each(settings, last, _OFFSET, common, cases=cases, chosen=settings["works"])


def last(
    raven: s.Plain,
    work: str,
    load: float,
    seed: int,
    sets: Sequence[str],
    networks: int,
    hours: int,
) -> PartResult:
    """Calibrate once, unloaded, and judge every hour of what follows; `load` is in kg."""
    arm, twin = s.homed(raven, seed)
    training = s.training_sets(arm, sets)
    lengths = {text: s.seconds_of(own) for text, own in training.items()}
    models = {text: s.fitted(own, networks, seed) for text, own in training.items()}
    twin.load = load
    go_on = s.resting if work == IDLE else s.working
    tests = go_on(arm, hours, s.TEST_SEED + seed)
    errors = [{text: s.judged(own, test) for text, own in models.items()} for test in tests]
    example = _example(models[max(lengths, key=lambda text: lengths[text])], tests[0])
    return PartResult({"hours": errors, "seconds": lengths}, example)


def _example(models: s.Models, test: Recording) -> dict[str, Array]:
    """Stamps (n,) [s] and joints (n, 3) of the first minute: true, measured, and corrected."""
    minute = test.with_truth(s.JOINTS)
    minute = minute.rows(minute.t - minute.t[0] <= _EXAMPLE)
    corrected = {name: models[name][0].correct(minute) for name in _DRAWN if name in models}
    return {
        "t": minute.t - minute.t[0],
        "truth": minute.columns("truth", s.JOINTS),
        "raw": minute.columns("measured", s.JOINTS),
        **corrected,
    }


def by_work(settings: Settings, results: Mapping[str, PartResult], title: str) -> Found:
    """Sort the hours of a specimen, combinations by the time that they take."""
    found = {}
    for work in settings["works"]:
        numbers = [part.numbers for part in s.sessions_of(settings, results, title, work)]
        order = sorted(settings["sets"], key=numbers[0]["seconds"].get)
        found[work] = [
            [{text: hour[text] for text in order} for hour in one["hours"]] for one in numbers
        ]
    return found


def longest(hour: Mapping[str, s.Errors]) -> s.Errors:
    """Errors of the models of the longest combinations together."""
    return _together(list(hour.values())[-_some(hour) :])


def _shortest(hour: Mapping[str, s.Errors]) -> s.Errors:
    return _together(list(hour.values())[: _some(hour)])


def _some(hour: Mapping[str, s.Errors]) -> int:
    return max(1, min(_FEW, len(hour) // 2))


def _together(errors: Sequence[s.Errors]) -> s.Errors:
    return {method: [row for one in errors for row in one[method]] for method in errors[0]}


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Figures 6 and 7, the rows of Table III, and what the paper says of the hours."""
    made, figures, judged = [], {}, []
    for title in s.specimens(settings["specimens"]):
        found = by_work(settings, results, title)
        for work, sessions in found.items():
            rows = {
                f"hour {hour}": [longest(one[hour]) for one in sessions]
                for hour in range(settings["hours"])
            }
            name = f"{work}, {settings['load_g']:g} g" if work == LOADED else work
            made.append(
                tables.accuracy_table(
                    f"peng2024 figure 6 and Table III, {name}, specimen {title}",
                    rows,
                    _METHODS,
                    partial(_printed, work),
                    ("Models of the longest trainings, three where there are six or more.", RULE),
                )
            )
        made.append(_by_length(title, found, settings))
        figures[f"endurance-{title}"] = _figure(title, found)
        first = {
            work: s.sessions_of(settings, results, title, work)[0].arrays
            for work in settings["works"]
        }
        figures[f"trajectories-{title}"] = _trajectories(title, first)
        if set(WORKS) <= set(found) and settings["hours"] > 1:
            judged += [claim.judged(found, title) for claim in CLAIMS]
    return Summary(made, figures, judged)


def _printed(work: str, condition: str, joint: int, method: str) -> float | None:
    return tables.printed("III", f"RAVEN-II {work} {condition.replace(' ', '')}", joint, method)


def _by_length(title: str, found: Found, settings: Settings) -> Table:
    rows = {}
    for work, sessions in found.items():
        for text in sessions[0][0]:
            rows[f"{work}, {text}"] = [_together([hour[text] for hour in one]) for one in sessions]
    return tables.accuracy_table(
        f"Mean over {settings['hours']} h by what was trained on, specimen {title}",
        rows,
        _METHODS,
        tables.unprinted,
        ("4+5+6: zig-zags of sparsity 1/4, 1/5 and 1/6.",),
    )


def _figure(title: str, found: Found) -> Figure:
    rows = []
    for joint, label in enumerate(s.TITLES):
        panels = []
        for work, sessions in found.items():
            curves = []
            for method in _METHODS:
                for part, style in ((longest, "o-"), (_shortest, "o:")):
                    by_hour = [
                        _errors([part(hour) for hour in hours], method, joint).mean()
                        for hours in zip(*sessions, strict=True)
                    ]
                    name = f"{method}, {'longest' if part is longest else 'shortest'} trainings"
                    place = np.arange(len(by_hour))
                    curves.append(Curve(place, by_hour, name, tables.COLOURS[method], style))
            names, name = [str(hour) for hour in range(len(sessions[0]))], "" if joint else work
            panels.append(Panel(curves, "hour", f"RMSE, {label}", name, "y", columns=names))
        rows.append(panels)
    caption = "RMSE by hour after one calibration; mean over trainings of the three lengths."
    return Figure(f"peng2024 figure 6, specimen {title}", rows, caption, height=9.5, legend=True)


def _trajectories(title: str, examples: Mapping[str, Mapping[str, Array]]) -> Figure:
    rows = []
    for joint, label in enumerate(s.TITLES):
        panels = []
        for work, example in examples.items():
            curves = [
                Curve(example["t"], s.SCALES[joint] * example[name][:, joint], name, *look)
                for name, look in _DRAWN.items()
            ]
            panels.append(Panel(curves, "time [s]", label, "" if joint else work))
        rows.append(panels)
    caption = (
        "The first minute of the first hour's test: the true joints, those that the robot reports, "
        "and these corrected by models of the longest training."
    )
    return Figure(f"peng2024 figure 7, specimen {title}", rows, caption, height=8.0, legend=True)


def _at(work: str, hour: int, method: str, joint: int) -> claims.Pick:
    """Errors in an hour (-1: the last) with the longest trainings."""
    return lambda found: _errors([longest(one[hour]) for one in found[work]], method, joint)


def _over(work: str, method: str, joint: int, part: Choose = longest) -> claims.Pick:
    """Errors over all hours."""
    return lambda found: _errors(
        [_together([part(hour) for hour in one]) for one in found[work]], method, joint
    )


def _errors(sessions: Sequence[s.Errors], method: str, joint: int) -> Array:
    return np.asarray(tables.by_session(sessions, method)[:, joint])


def _growth(work: str, method: str, joint: int) -> claims.Pick:
    """Last hour over the first."""
    return lambda found: _at(work, -1, method, joint)(found) / _at(work, 0, method, joint)(found)


def _length_gain(found: Found) -> tuple[bool | None, str]:
    """Whether long trainings are better by a fifth, geometric mean over joints and all works."""
    texts, ratios = [], []
    for method in ("dnn", "linear", "poly2"):
        logs = [
            np.log(_over(work, method, k)(found) / _over(work, method, k, _shortest)(found))
            for work in found
            for k in range(len(s.JOINTS))
        ]
        ratios.append(float(np.exp(np.mean(logs))))
        texts.append(f"{method} {100 * (1 - ratios[-1]):.0f} % better")
    return bool(max(ratios) <= 0.8), f"{', '.join(texts)} after the longest than the shortest"


_WORKED: Final = (UNLOADED, LOADED)
_TWO: Final = ("dnn", "linear")

CLAIMS: Final = (
    claims.kept(
        "idle for six hours, network, linear model and fixed offset hardly get worse",
        "peng2024, II-G",
        0.15,
        *(
            (f"{name}, {joint}", _at(IDLE, 0, name, k), _at(IDLE, -1, name, k))
            for name in (*_TWO, "offset")
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
    claims.ordered(
        "joint 1: network and linear model are worse after hours of work, without and with a load",
        "peng2024, II-G",
        *(
            (f"{work}, {name}", _at(work, 0, name, 0), _at(work, -1, name, 0))
            for work in _WORKED
            for name in _TWO
        ),
    ),
    claims.ordered(
        "joint 1 drifts most: its error grows by the largest factor",
        "peng2024, III",
        *(
            (f"{work}, {name}, {s.JOINTS[k]}", _growth(work, name, k), _growth(work, name, 0))
            for work in _WORKED
            for name in _TWO
            for k in (1, 2)
        ),
    ),
    claims.ordered(
        "joint 1: a load makes it worse",
        "peng2024, II-G",
        *((name, _at(UNLOADED, -1, name, 0), _at(LOADED, -1, name, 0)) for name in _METHODS),
    ),
    claims.ordered(
        "joint 1: the fixed offset too gets worse with work",
        "peng2024, II-G and III",
        *((work, _at(work, 0, "offset", 0), _at(work, -1, "offset", 0)) for work in _WORKED),
    ),
    claims.kept(
        "joints 2 and 3: the fixed offset does not get worse with work",
        "peng2024, II-G and III",
        0.1,
        *(
            (f"{work}, {s.JOINTS[k]}", _at(work, 0, "offset", k), _at(work, -1, "offset", k))
            for work in _WORKED
            for k in (1, 2)
        ),
    ),
    Statement(
        "trainings above 800 s leave a fifth less error than those below 500 s",
        "peng2024, II-G",
        _length_gain,
    ),
    claims.ordered(
        "the polynomial is worse than the fixed offset in joints 2 and 3, even idle",
        "peng2024, II-G and Table II",
        *(
            (f"{work}, {s.JOINTS[k]}", _over(work, "offset", k), _over(work, "poly2", k))
            for work in WORKS
            for k in (1, 2)
        ),
    ),
    claims.ordered(
        "under the load, the network errs less than the linear model",
        "peng2024, III",
        *(
            (joint, _over(LOADED, "dnn", k), _over(LOADED, "linear", k))
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
    claims.ordered(
        "on the three shortest trainings, the network errs less than the linear model",
        "peng2024, III",
        *(
            (
                f"{work}, {joint}",
                _over(work, "dnn", k, _shortest),
                _over(work, "linear", k, _shortest),
            )
            for work in _WORKED
            for k, joint in enumerate(s.JOINTS)
        ),
    ),
)
