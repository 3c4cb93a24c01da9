"""II-C to II-F, II-H, II-J of peng2024: what is trained on, what a model sees and predicts."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.estimators import NeuralNetwork
from truejoint.estimators.family import TARGETS
from truejoint.motion import DIRECTIONS
from truejoint.recordings import Recording
from truejoint.recordings.table.recording import default_unit
from truejoint.robots.raven2.state_message import state_message
from truejoint.simulation.raven2 import Raven2Twin
from truejoint.studies import claim_tests as claims
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2 import tables
from truejoint.studies.rows import notes_on, select
from truejoint.studies.study import Part, Plain, Results, Rows, Settings, Summary, get_study

FITTED_TO: Final = ("J1", "J2-J3")
"""Directions whose linear and polynomial rows the specimen ``peng2024`` was fitted to."""
_NAMES: Final = (*DIRECTIONS, s.PUBLISHED)


def directions_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, direction and session."""
    settings.check_names("direction", "directions", _NAMES)
    # Every direction has an arm, a homing and a test of its own, as in the paper.
    more = {"sets": [settings["fine"]], "seconds": 60.0 * settings["minutes"]}
    how: dict[str, Any] = {"more": more, "chosen": settings["directions"]}
    how["cases"] = {name: {"direction": name} for name in _NAMES}
    return s.part_for_each(settings, s.calibrate_once, 0, "networks", **how)


def _printed(condition: str, joint: str, method: str) -> float | None:
    named = DIRECTIONS[-1] if condition == s.PUBLISHED else condition
    return tables.printed("I", "direction={}")(named, joint, method)


@tables.by_specimen
def directions_summary(results: Results, title: str, rows: DataFrame) -> Summary:
    """Table I beside the paper's, and what it says of directions."""
    settings, chosen = results.settings, results.settings["directions"]
    rows = tables.in_order(rows.assign(condition=rows.case), "condition", chosen)
    name = f"peng2024 Table I, specimen {title}"
    of_groups = {
        "J1, J2-J3": [direction for direction in chosen if direction in FITTED_TO],
        "the others": [direction for direction in chosen if direction not in FITTED_TO],
    }
    fine, of = f"{name}, trained on {settings['fine']}", f"specimen {title}"
    notes = (tables.ZIGZAGS, claims.RULE)
    made = (
        tables.accuracy_table(fine, rows, s.METHODS, _printed, notes),
        tables.percent_table(f"Share of the fixed offset's error, {of}", rows, _printed),
        tables.ratio_table(f"RMSE over the paper's, {of}", rows, of_groups, s.METHODS, _printed),
    )
    caption = "RMSE on a random motion by direction of the zig-zags."
    drawn = select(rows, method=s.CORRECTED)
    figure = tables.joint_boxes(name, drawn, caption, "condition")
    every = set(DIRECTIONS) <= set(chosen)
    judged = claims.judged(DIRECTIONS_CLAIMS, rows, title) if every else ()
    return Summary(made, {f"directions-{title}": figure}, judged)


def _best_overall(fine: DataFrame) -> claims.Verdict:
    by = tables.percent(fine)[[*s.MODELS]].mean(axis=1).groupby(level=["condition", "session"])
    shares = {name: by.mean()[name].to_numpy() for name in DIRECTIONS}
    order = sorted(shares, key=lambda name: float(shares[name].mean()))
    text = ", ".join(f"{name} {shares[name].mean():.1f} %" for name in order[:3])
    others = [shares[name] for name in DIRECTIONS if name != s.BEST]
    holds = claims.below_all([(shares[s.BEST], other) for other in others])
    return holds, f"{text}; {s.BEST} is number {order.index(s.BEST) + 1} of 7"


def _best_of_joint(fine: DataFrame, joint: int, expected: Sequence[str]) -> claims.Verdict:
    """Whether the `expected` direction of each of `MODELS` errs least in a joint."""
    pairs, texts = [], []
    for method, direction in zip(s.MODELS, expected, strict=True):
        of: dict[str, Any] = {"joint": s.JOINTS[joint], "method": method}
        errors = {name: claims.by_session(fine, condition=name, **of) for name in DIRECTIONS}
        least = min(errors, key=lambda name: float(errors[name].mean()))
        pairs += [(errors[direction], errors[n]) for n in errors if n != direction]
        texts.append(f"{method}: {least} {errors[least].mean():.3f}")
        if least != direction:
            texts[-1] += f", {direction} {errors[direction].mean():.3f}"
            texts[-1] += claims.against(errors[direction], errors[least])
    return claims.below_all(pairs), "; ".join(texts)


def _removed(fine: DataFrame) -> claims.Verdict:
    share = tables.percent(fine).dnn[s.BEST].unstack("joint", sort=False).to_numpy()
    holds = claims.below_all([(of_joint, 25.0) for of_joint in share.T])
    return holds, f"the network leaves {_percents(share)}"


def _offset_of_raw(fine: DataFrame) -> claims.Verdict:
    share = 1e4 / tables.percent(fine).raw[s.BEST].unstack("joint", sort=False).to_numpy()
    holds = claims.below_all([(of_joint, 50.0) for of_joint in share.T])
    return holds, f"it leaves {_percents(share)} of the raw error"


def _percents(shares: Array) -> str:
    return ", ".join(f"{v:.0f} %" for v in shares.mean(axis=0))


_BEST_OF_JOINTS: Final = (
    ("J2-J3", "J1-J3", "J2-J3"), ("J2-J3", "J1-J2-J3", "J1-J2-J3"), ("J3", "J3", "J3")
)  # fmt: skip
"""Direction that peng2024 finds best of each joint, by `MODELS`."""
_ROWS: Final = ("network", "polynomial", "linear", "offset", "raw")
DIRECTIONS_CLAIMS: Final = claims.statements(
    "directions",
    {
        "best-direction": _best_overall,
        **{
            f"best-joint-{n + 1}": partial(_best_of_joint, joint=n, expected=expected)
            for n, expected in enumerate(_BEST_OF_JOINTS)
        },
        "a-quarter": _removed,
        "offset-of-raw": _offset_of_raw,
        **{
            f"table-1-{name}": partial(tables.as_printed, paper=_printed, methods=(method,))
            for name, method in zip(_ROWS, s.METHODS, strict=True)
        },
    },
)


def of_endurance(settings: Settings) -> Sequence[Part]:
    """Give the parts of the study of endurance, whose unloaded hours other studies judge, too."""
    endurance = get_study("endurance")
    return endurance.parts(endurance.settings(settings.preset, settings.seed, settings.options))


sparsity_parts = targets_parts = of_endurance


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
def sparsity_summary(_results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 5, its numbers, and what the paper says of them, by the first hour."""
    rows = by_length(select(rows, work=s.UNLOADED, hour=0, target=TARGETS[0]))
    seconds = rows.length.map("{:.0f} s".format)
    rows = rows.assign(condition=rows.set + ", " + seconds, place=rows.set + "\n" + seconds)
    name = f"peng2024 figure 5, specimen {title}"
    table = tables.accuracy_table(name, rows, s.CORRECTED, notes=(tables.ZIGZAGS, claims.RULE))
    caption = "RMSE on random motions by what was trained on; boxes: over the repetitions."
    figure = tables.joint_boxes(name, select(rows, method=s.CORRECTED), caption, "place")
    judged = claims.judged(SPARSITY_CLAIMS, rows, title)
    return Summary((table,), {f"sparsity-{title}": figure}, judged)


def _spread(rows: DataFrame) -> claims.Verdict:
    """Whether the polynomial scatters more than the others on the shortest, in joint 1 and 2."""
    first = select(rows, when="first", joint=s.JOINTS[:2])
    if first.session.nunique() < 2:
        return None, "one repetition has no spread"
    errors = first.pivot_table("rmse", "session", ["joint", "method"], sort=False)
    verdicts = (
        claims.scatters_more(errors[j]["poly2"], [errors[j][name] for name in s.TWO])
        for j in s.JOINTS[:2]
    )
    text = "; ".join(f"{m} {', '.join(f'{errors[j][m].std():.3f}' for j in s.JOINTS[:2])}"
                     for m in s.MODELS)  # fmt: skip
    return claims.whole(*verdicts), f"standard deviations: {text}"


def _minutes(rows: DataFrame) -> claims.Verdict:
    """Whether the shortest and the longest take 4 to 17 minutes, to half a minute."""
    least, most = (rows.groupby("session").seconds.agg(how) / 60.0 for how in ("min", "max"))
    holds = claims.below_all([(3.5, least), (least, 4.5), (16.5, most), (most, 17.5)])
    return holds, f"{least.mean():.1f} to {most.mean():.1f} minutes; half a minute off counts as so"


SPARSITY_CLAIMS: Final = claims.statements(
    "sparsity", {"minutes": _minutes, "polynomial-scatters": _spread}
)


@tables.by_specimen
def targets_summary(results: Results, title: str, rows: DataFrame) -> Summary:
    """Table II beside the paper's."""
    hours = results.settings["hours"]
    notes = (f"Mean over {hours} hours of unloaded work and all trainings.", claims.RULE)
    rows = select(rows, work=s.UNLOADED)
    rows = rows.assign(condition=rows.target)
    name = f"peng2024 Table II, specimen {title}"
    table = tables.accuracy_table(name, rows, s.MODELS, _TABLE_2, notes)
    return Summary((table,), claims=claims.judged(TARGETS_CLAIMS, rows, title))


def _difference(rows: DataFrame, **where: Any) -> Array:
    """Error, and by how much the other target's differs from it."""
    error, position = (claims.by_session(rows, target=one, **where) for one in TARGETS)
    return np.asarray(np.abs(error - position) + error)


_TABLE_2: Final = tables.printed("II", "target={}")
_EITHER_WAY: Final = {"method": ("linear", "poly2"), "joint": s.JOINTS}
TARGETS_CLAIMS: Final = claims.statements(
    "targets",
    {
        "target-same": claims.ordered({"target": "error"}, _difference, _EITHER_WAY, 1e-3),
        "table-2": partial(tables.as_printed, paper=_TABLE_2, methods=s.TWO),
    },
)


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


def features_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and session."""
    settings.check_names("model", "models", ("dnn", WIDE))
    names = ("sets", "models", "networks", "hours")
    return s.part_for_each(settings, fit_both, 700_000, *names)


def fit_both(
    raven: Plain, seed: int, sets: Sequence[str], models: Sequence[str], networks: int, hours: int
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
        kinds = {SELECTED: s.fitted(group, networks, seed), ALL: every}
        if text == longest:  # on which claims are judged
            kinds[NO_TORQUES] = s.fitted(group, networks, seed, features=positions)
            kinds[NO_POSITIONS] = s.fitted(group, networks, seed, features=torques)
            kinds[TIMELESS] = s.fitted(group, 0, seed, features=timeless)
        for kind, fitted in kinds.items():
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
def features_summary(results: Results, title: str, rows: DataFrame) -> Summary:
    """Figure 8, its numbers, and what the paper says of features."""
    rows = tables.in_order(by_length(rows), "kind", KINDS)
    rows = rows.assign(condition=rows.kind + ", " + rows.set)
    methods = [name for name in _METHODS if name in set(rows.method)]
    name = f"peng2024 figure 8, specimen {title}"
    about = {**results.settings.options, "inputs": rows.inputs.iloc[0], "rule": claims.RULE}
    notes = notes_on("features", **about)
    table = tables.accuracy_table(name, rows, methods, notes=notes)
    caption = "RMSE over the hours by features and training."
    drawn = rows[rows.method.isin(methods) & (rows.method != "poly2")]
    figure = tables.joint_boxes(name, drawn, caption, "condition")
    longest = select(rows, place=rows.place.max())
    judged = claims.judged(FEATURES_CLAIMS, longest, title, () if WIDE in methods else _OF_WIDE)
    return Summary((table,), {f"features-{title}": figure}, judged)


def _without(*kinds: str) -> claims.Pick:
    """Errors of the network on a kind of features in each of the joints."""

    def pick(rows: DataFrame, joint: str) -> Array:
        kind = kinds[s.JOINTS.index(joint)]
        return claims.by_session(rows, kind=kind, method="dnn", joint=joint)

    return pick


_OF_WIDE: Final = ("wide-all", "wide-selected")
FEATURES_CLAIMS: Final = claims.statements(
    "features",
    {
        "torques-3": claims.ordered(
            _without(NO_TORQUES, NO_TORQUES, NO_POSITIONS),
            _without(NO_POSITIONS, NO_POSITIONS, NO_TORQUES),
            {"joint": s.JOINTS},
        )
    },
)
