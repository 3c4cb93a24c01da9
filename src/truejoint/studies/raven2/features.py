"""II-H and figure 8 of peng2024: 16 selected features against all that the robot's state holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.estimators import NeuralNetwork
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import default_unit
from truejoint.robots.raven2.state_message import state_message
from truejoint.simulation.raven2 import Raven2Twin
from truejoint.studies.claim_tests import RULE
from truejoint.studies.raven2 import claims, tables
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.sparsity import by_length
from truejoint.studies.rows import select
from truejoint.studies.study import Part, Results, Rows, Settings, Summary

SELECTED: Final = "selected"
ALL: Final = "all"
NO_TORQUES, NO_POSITIONS = "selected without torques", "selected without positions"
TIMELESS: Final = "all but time"
"""And but the sequence number: neither was ever seen as it is hours later."""
WIDE: Final = "wide"
"""The larger network of II-H, on all features."""
KINDS: Final = (SELECTED, NO_TORQUES, NO_POSITIONS, TIMELESS, ALL)
_CLOCKS: Final = ("state/time", "state/last_seq")
_METHODS: Final = ("dnn", "linear", "poly2", "offset", WIDE)
_STRIDE: Final = 10
"""Every tenth row of the hours is judged: a large network takes its time to predict them."""
_FIT_RATE: Final = 10.0  # [Hz], of the larger network
_LARGE: Final = (600, 500, 400)  # units


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    settings.check_names("model", "models", ("dnn", WIDE))
    names = ("sets", "models", "networks", "hours")
    return s.part_for_each(settings, fit_both, 700_000, *names)


def fit_both(
    raven: s.Plain, seed: int, sets: Sequence[str], models: Sequence[str], networks: int, hours: int
) -> Rows:
    """Fit with the selected and with all features, and judge hours of unloaded work."""
    arm, twin = s.homed(raven, seed)
    training = {
        text: [with_state(one, twin) for one in group]
        for text, group in s.training_sets(arm, sets).items()
    }
    worked = s.random_test(arm, hours * s.HOUR, s.TEST_SEED + seed, s.STATE_RATE / _STRIDE)
    test = with_state(worked, twin)
    longest = max(training, key=lambda text: s.seconds_of(training[text]))
    names = [name for name in test.units if not name.startswith("truth")]  # 122, some constant
    positions, torques = ([n for n in names if n.startswith(q)] for q in ("measured/", "effort/"))
    timeless = [name for name in names if name not in _CLOCKS]
    rows: Rows = []
    for text, group in training.items():
        every = s.fitted(group, networks, seed, features=names)
        if WIDE in models and text == longest:
            network = NeuralNetwork(_LARGE, weight_decay=1e-4)
            every[WIDE] = [s.model_of(group, network, features=names, fit_rate=_FIT_RATE)]
        for kind, fitted in (
            (SELECTED, s.fitted(group, networks, seed)),
            (NO_TORQUES, s.fitted(group, networks, seed, features=positions)),
            (NO_POSITIONS, s.fitted(group, networks, seed, features=torques)),
            (TIMELESS, s.fitted(group, 0, seed, features=timeless)),
            (ALL, every),
        ):
            labels = {"kind": kind, "set": text, "seconds": s.seconds_of(group)}
            rows += s.judged(fitted, test, inputs=len(names), **labels)
    return rows


def with_state(recording: Recording, twin: Raven2Twin) -> Recording:
    """Put the rest of the state message into a recording of a twin."""
    t = recording.t + recording.provenance.start
    signals = {name: recording.column(name) for name in recording.units}
    columns = state_message(recording.robot, t, signals, twin.encoder_zero)
    units = {name: default_unit(name, recording.robot) for name in columns}
    table = recording.table.assign(**columns)
    return replace(recording, table=table, units={**recording.units, **units})


@tables.by_specimen
def summarise(results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 8, its numbers, and what the paper says of features."""
    rows = tables.in_order(by_length(rows), "kind", KINDS)
    rows = rows.assign(condition=rows.kind + ", " + rows.set)
    methods = [name for name in _METHODS if name in set(rows.method)]
    name = f"peng2024 figure 8, specimen {title}"
    notes = (
        "Selected: measured position and torque of every channel, 16; all: "
        f"{rows.inputs.iloc[0]} of one arm's state message, constant ones included (the paper "
        "counts 138).",
        f"Mean over {results.settings['hours']} hours of unloaded work. A dash: the polynomial "
        "of all features has more coefficients than a tenth of the rows, and is not fitted.",
        RULE,
    )
    table = tables.accuracy_table(name, rows, methods, notes=notes)
    caption = "RMSE over the hours by features and training."
    drawn = rows[rows.method.isin(methods) & (rows.method != "poly2")]
    figure = tables.joint_boxes(name, drawn, caption, "condition")
    chosen = (*CLAIMS, CAUSE, *(OF_WIDE if WIDE in methods else ()))
    longest = select(rows, place=rows.place.max())
    judged = [claim.judged(longest, title) for claim in chosen]
    return Summary((table,), {f"features-{title}": figure}, judged)


def _without(*kinds: str) -> claims.Pick:
    """Errors of the network on a kind of features in each of the joints."""

    def pick(rows: DataFrame, joint: str) -> Array:
        kind = kinds[s.JOINTS.index(joint)]
        return tables.by_session(rows, kind=kind, method="dnn", joint=joint)

    return pick


_OF_ALL, _OF_SELECTED = {"kind": ALL}, {"kind": SELECTED}
_LINEAR, _NETWORK, _OF_WIDE = ({"method": method} for method in ("linear", "dnn", WIDE))
CLAIMS: Final = (
    claims.ordered(
        "all features make the network worse in every joint",
        "peng2024, II-H", _OF_SELECTED, _OF_ALL, method=("dnn",), joint=s.JOINTS, flaw=True,
    ),
    claims.ordered(
        "all features make the linear model worse in every joint",
        "peng2024, II-H", _OF_SELECTED, _OF_ALL, method=("linear",), joint=s.JOINTS, flaw=True,
    ),
    claims.ordered(
        "all features hurt the linear model most", "peng2024, II-H and Table V",
        (_OF_ALL | _NETWORK, _OF_SELECTED | _NETWORK), (_OF_ALL | _LINEAR, _OF_SELECTED | _LINEAR),
        joint=s.JOINTS,
    ),
    claims.ordered(
        "with all features the linear model is no better than the fixed offset", "peng2024, II-H",
        _OF_ALL | {"method": "offset"}, _OF_ALL | _LINEAR, joint=s.JOINTS, flaw=True,
    ),
    claims.not_worse(
        0.05,
        "joint positions and motor torques are enough: the network loses nothing without the rest",
        "peng2024, II-C", _OF_ALL, _OF_SELECTED, method=("dnn",), joint=s.JOINTS,
    ),
    claims.ordered(
        "joint 3 is the one in which torques matter more than positions", "peng2024, III",
        _without(NO_TORQUES, NO_TORQUES, NO_POSITIONS),
        _without(NO_POSITIONS, NO_POSITIONS, NO_TORQUES), joint=s.JOINTS,
    ),
)  # fmt: skip
CAUSE: Final = claims.not_worse(
    0.1,
    "without time and sequence number, all features do the linear model no harm in joints 2 and 3",
    "ours", _OF_SELECTED, {"kind": TIMELESS}, method=("linear",), joint=s.JOINTS[1:],
)  # fmt: skip
"""Why all features hurt: a fit of minutes is followed for hours along what grows all the time."""
OF_WIDE: Final = (
    claims.ordered(
        "with all features the larger network is better than the small one",
        "peng2024, II-H", _OF_ALL | _OF_WIDE, _OF_ALL | _NETWORK, joint=s.JOINTS,
    ),
    claims.ordered(
        "yet the larger network is not as good as the small one on the selected features",
        "peng2024, II-H", _OF_SELECTED | _NETWORK, _OF_ALL | _OF_WIDE, joint=s.JOINTS,
    ),
)  # fmt: skip
