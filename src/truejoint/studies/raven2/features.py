"""II-H and figure 8 of peng2024: 16 selected features against all that the robot's state holds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

from truejoint.estimators.network.learn import WideNetwork
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import default_unit
from truejoint.robots.raven2.state_message import state_message
from truejoint.simulation.raven2 import Raven2Twin
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.study import Part, PartResult, Settings, Summary, check_counts, check_names
from truejoint.studies.verdicts import RULE

SELECTED: Final = "selected"
ALL: Final = "all"
TIMELESS: Final = "all but time"
"""And but the sequence number: neither was ever seen as it is hours later."""
WIDE: Final = "wide"
"""The larger network, on all features."""
KINDS: Final = (SELECTED, TIMELESS, ALL)
_CLOCKS: Final = ("state/time", "state/last_seq")
_OFFSET: Final = 700_000  # of the arms' seeds, so that no other study has the same
_METHODS: Final = ("dnn", "linear", "poly2", "offset", WIDE)
_STRIDE: Final = 10
"""Every tenth row of the hours is judged: a large network takes its time to predict them."""
_FIT_RATE: Final = 10.0  # [Hz], of the larger network


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    check_counts(settings, "hours", "sessions", "networks")
    check_names("model", settings["models"], ("dnn", WIDE))
    s.check_sets(settings)
    common = {name: settings[name] for name in ("sets", "models", "networks", "hours")}
    return s.part_for_each(settings, fit_both, _OFFSET, common)


def fit_both(
    raven: s.Plain, seed: int, sets: Sequence[str], models: Sequence[str], networks: int, hours: int
) -> PartResult:
    """Fit with the selected and with all features, and judge hours of unloaded work."""
    arm, twin = s.homed(raven, seed)
    training = {
        text: [with_state(one, twin) for one in own]
        for text, own in s.training_sets(arm, sets).items()
    }
    worked = s.random_test(arm, hours * s.HOUR, s.TEST_SEED + seed, s.STATE_RATE / _STRIDE)
    test = with_state(worked, twin)
    longest = max(training, key=lambda text: s.seconds_of(training[text]))
    names = all_features(test)
    found = {}
    for text, own in training.items():
        every = s.fitted(own, networks, seed, features=names)
        if WIDE in models and text == longest:
            wide = s.model_of(own, WideNetwork(), features=names, fit_rate=_FIT_RATE)
            every = {**every, WIDE: [wide]}
        timeless = [name for name in names if name not in _CLOCKS]
        found[text] = {
            SELECTED: s.judged(s.fitted(own, networks, seed), test),
            TIMELESS: s.judged(s.fitted(own, 0, seed, features=timeless), test),
            ALL: s.judged(every, test),
        }
    lengths = {text: s.seconds_of(own) for text, own in training.items()}
    return PartResult({"errors": found, "seconds": lengths, "inputs": len(names)})


def with_state(recording: Recording, twin: Raven2Twin) -> Recording:
    """Put the rest of the state message into a recording of a twin."""
    t = recording.t + recording.provenance.start
    signals = {name: recording.column(name) for name in recording.units}
    columns = state_message(recording.robot, t, signals, twin.encoder_zero)
    units = {name: default_unit(name, recording.robot) for name in columns}
    table = recording.table.assign(**columns)
    return replace(recording, table=table, units={**recording.units, **units})


def all_features(recording: Recording) -> list[str]:
    """Every column of the state message of one arm: 122, constant ones included."""
    return [name for name in recording.units if not name.startswith("truth")]


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Figure 8, its numbers, and what the paper says of features."""
    made, figures, judged = [], {}, []
    for title, numbers in s.numbers_of(settings, results).items():
        order = sorted(settings["sets"], key=numbers[0]["seconds"].get)
        found = {
            (kind, text): [one["errors"][text][kind] for one in numbers]
            for kind in KINDS
            for text in order
        }
        rows = {f"{kind}, {text}": sessions for (kind, text), sessions in found.items()}
        known = found[ALL, order[-1]][0]
        methods = [method for method in _METHODS if method in known]
        name = f"peng2024 figure 8, specimen {title}"
        notes = (
            "Selected: measured position and torque of every channel, 16; all: "
            f"{numbers[0]['inputs']} of one arm's state message, constant ones included (the paper "
            "counts 138).",
            f"Mean over {settings['hours']} hours of unloaded work. A dash: the polynomial of all "
            "features has more coefficients than a tenth of the rows, and is not fitted.",
            RULE,
        )
        made.append(tables.accuracy_table(name, rows, methods, tables.unprinted, notes))
        shown = [method for method in ("dnn", "linear", "offset", WIDE) if method in known]
        figures[f"features-{title}"] = tables.accuracy_figure(
            name, rows, shown, tables.unprinted, "RMSE over the hours by features and training."
        )
        longest = {kind: found[kind, order[-1]] for kind in KINDS}
        judged += [claim.judged(longest, title) for claim in (*CLAIMS, CAUSE)]
        if WIDE in known:
            judged += [claim.judged(longest, title) for claim in OF_WIDE]
    return Summary(made, figures, judged)


def _of(kind: str, method: str, joint: int) -> claims.Pick:
    return lambda found: tables.by_session(found[kind], method)[:, joint]


def _growth(method: str, joint: int) -> claims.Pick:
    """All features over the selected ones."""
    return lambda found: _of(ALL, method, joint)(found) / _of(SELECTED, method, joint)(found)


def _each(name: str, low: tuple[str, str], high: tuple[str, str]) -> list[claims.Pair]:
    """One pair a joint, of a kind of features and a method each."""
    return [(f"{name}, {joint}", _of(*low, k), _of(*high, k)) for k, joint in enumerate(s.JOINTS)]


CLAIMS: Final = (
    claims.ordered(
        "all features make the network worse in every joint",
        "peng2024, II-H",
        *_each("dnn", (SELECTED, "dnn"), (ALL, "dnn")),
    ),
    claims.ordered(
        "all features make the linear model worse in every joint",
        "peng2024, II-H",
        *_each("linear", (SELECTED, "linear"), (ALL, "linear")),
    ),
    claims.ordered(
        "all features hurt the linear model most",
        "peng2024, II-H and Table V",
        *((joint, _growth("dnn", k), _growth("linear", k)) for k, joint in enumerate(s.JOINTS)),
    ),
    claims.ordered(
        "with all features the linear model is no better than the fixed offset",
        "peng2024, II-H",
        *_each("linear", (ALL, "offset"), (ALL, "linear")),
    ),
)
CAUSE: Final = claims.kept(
    "without time and sequence number, all features do the linear model no harm in joints 2 and 3",
    "ours",
    0.1,
    *((s.JOINTS[k], _of(SELECTED, "linear", k), _of(TIMELESS, "linear", k)) for k in (1, 2)),
)
"""Why all features hurt: a fit of minutes is followed for hours along what grows all the time."""
OF_WIDE: Final = (
    claims.ordered(
        "with all features the larger network is better than the small one",
        "peng2024, II-H",
        *_each("wide", (ALL, WIDE), (ALL, "dnn")),
    ),
    claims.ordered(
        "yet the larger network is not as good as the small one on the selected features",
        "peng2024, II-H",
        *_each("wide", (SELECTED, "dnn"), (ALL, WIDE)),
    ),
)
