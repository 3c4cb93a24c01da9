"""Plays and low-passes of every feature, and a model of another family that sees them.

A joint behind cables remembers where its motor came from: friction and slack make a play, creep a
low-pass. A sum of plays of many widths is a Prandtl-Ishlinskii operator (Kuhnen, European Journal
of Control 9(4), 2003), which comes as near as one likes to hysteresis that forgets nothing but by
larger swings. Cables that pull at several joints make plays of all these together: behind elastic
cables each joint stands where its own friction holds it, and moves when the pull of the cables, the
stiffness of all joints times how far each is from where its motor wants it, is larger. That is
Moreau's sweeping process (Journal of Differential Equations 26, 1977) in several dimensions; of one
joint it is a play. What is eccentric, as a capstan may be, errs once in each of its turns.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Final

import numpy as np

from truejoint.array_types import Array, Integers, Mask
from truejoint.compiled import compiled, vector
from truejoint.errors import CalibrationError
from truejoint.estimators.family import Family, Shape, call_row, find_family, only_joint
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.polynomial.run import FAMILY as POLYNOMIAL
from truejoint.estimators.rules import LARGEST, Params, Rule, integer, is_list, numbers, one_of
from truejoint.estimators.stack.run import ONE_MEMBER, member_shapes, members
from truejoint.features.feature_set import MAX_TIME_CONSTANT, lowpass, play
from truejoint.layout import Layout, Memory, part_memory, part_numbers
from truejoint.products import standardise, weighted

MAX_PLAYS: Final = 32
MAX_LOWPASSES: Final = 8
MAX_COUPLED: Final = 12
MAX_TURNING: Final = 16
SHARES: Final = 0.3, 1.0, 2.0
"""Of friction that plays of several joints have, in place of one play with all of it."""
SWEEPS: Final = 20  # over the joints, at most; four to seven are usual
SETTLED: Final = 1e-4  # by how much no joint moves any more in a sweep, in half ranges

JAW_WIDTHS: Final = (
    0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.19, 0.26,
)  # fmt: skip
"""Half-widths of the plays of a forceps' motor and cables, in half ranges of a feature.

The narrow ones stand for presliding of slider and jaw, the wide ones for how far friction stretches
the drive cable.
"""
JAW_SIGNALS: Final = (MOTOR, DRIVE, RESET)

LAYOUT: Final = Layout().declare(__package__, "plays")
ROW, MODEL = LAYOUT.places("row model")
unpack = LAYOUT.unpacker()


@compiled
def coupled_play(
    coupling: Array,
    half_widths: Array,
    share: float,
    fresh: bool,
    values: Array,
    last: Array,
    deflections: Array,
) -> None:
    """Find how far the joints (k,) are from `values` (k,), where their motors want them.

    In `coupling` (k, k), row i is the stiffness between joint i and the others over its own, 0 on
    the diagonal; `half_widths` (k,), times `share`, are friction over that stiffness. `last` (k,)
    is where the joints are, and is brought up to date; a fresh start puts them where they are
    wanted. Joint after joint is moved as far as its friction lets the cables pull it
    (Gauss and Seidel), until none moves.
    """
    k = values.shape[0]
    for i in range(k):
        if fresh:
            last[i] = values[i]
        deflections[i] = last[i] - values[i]
    for _sweep in range(SWEEPS):
        largest = 0.0
        for i in range(k):
            centre = 0.0
            for j in range(k):
                centre -= coupling[i, j] * deflections[j]
            reach = share * half_widths[i]
            moved = min(max(last[i] - values[i], centre - reach), centre + reach)
            largest = max(largest, abs(moved - deflections[i]))
            deflections[i] = moved
        if largest < SETTLED:
            break
    for i in range(k):
        last[i] = values[i] + deflections[i]


@compiled
def coupled_play_rows(
    coupling: Array, half_widths: Array, fresh: Mask, values: Array, last: Array, out: Array
) -> None:
    """Deflections `out` (n, k) of rows `values` (n, k); a history starts where `fresh` (n,)."""
    for i in range(values.shape[0]):
        coupled_play(coupling, half_widths, 1.0, fresh[i], values[i], last, out[i])


@compiled
def expand(numbers: Integers, memory: Array, dt: float, x: Array, inputs: Array) -> None:
    """Scale features `x` (k,) to -1 to 1, add how far plays and low-passes are from them.

    `inputs` is ``n_seen(k, ...)`` long. A play is divided by its half-width, so that it too runs
    from -1 to 1. Behind them are plays of several features together, and cosine and sine of the
    angle of each capstan.
    """
    m = unpack(numbers, memory)
    k, fresh = x.shape[0], dt == 0.0
    standardise(x, m.centre, m.inverse_half_range, inputs)
    for i in range(k):
        for j in range(m.n_plays):
            at = i * m.n_plays + j
            m.outputs[at] = play(m.half_widths[j], fresh, inputs[i], m.outputs[at])
            inputs[k + at] = (m.outputs[at] - inputs[i]) / m.half_widths[j]
        for j in range(m.n_lowpasses):
            at = i * m.n_lowpasses + j
            trail = lowpass(m.time_constants[j], fresh, dt, inputs[i], m.trails[at])
            inputs[k + k * m.n_plays + at] = trail - inputs[i]
    at = k * (1 + m.n_plays + m.n_lowpasses)
    n_coupled = m.n_coupled
    for i in range(n_coupled):
        m.wanted[i] = inputs[m.coupled[i]]
    for j in range(m.n_shares):
        share, deflections = m.shares[j], vector(inputs, at, n_coupled)
        coupled_play(m.coupling, m.reaches, share, fresh, m.wanted, m.stood[j], deflections)
        for i in range(n_coupled):
            deflections[i] /= share * m.reaches[i]
        at += n_coupled
    for i in range(m.n_turning):
        angle = weighted(x, m.turns[i])
        inputs[at + 2 * i], inputs[at + 2 * i + 1] = math.cos(angle), math.sin(angle)


@compiled
def play_bank_row(
    numbers: Integers, memory: Array, dt: float, x: Array, out: Array, half_width: Array
) -> None:
    """Predict by the model from what the features are and were."""
    m = unpack(numbers, memory)
    expand(numbers, memory, dt, x, m.seen)
    model = part_memory(numbers, memory, MODEL)
    call_row(numbers[ROW], part_numbers(numbers, MODEL), model, dt, m.seen, out, half_width)


@compiled
def follow_rows(dt: Array, values: Array, widths: Array, out: Array) -> None:
    """How far `values` (n,) stand in the dead band of each play (k,), from -1 to 1: `out` (n, k).

    Where a history starts, with `dt` (n,) 0, every play is in the middle of its band.
    """
    for j in range(widths.shape[0]):
        output = 0.0
        for i in range(values.shape[0]):
            output = play(widths[j], dt[i] == 0.0, values[i], output)
            out[i, j] = (values[i] - output) / widths[j]


@compiled
def _expand_rows(
    numbers: Integers, memory: Array, dt: Array, X: Array, chosen: Mask, out: Array
) -> None:
    at = 0
    for i in range(X.shape[0]):
        expand(numbers, memory, dt[i], X[i], out[at])
        if chosen[i] and at < out.shape[0] - 1:
            at += 1


def expand_rows(
    params: Params, arrays: Mapping[str, Array], X: Array, dt: Array, chosen: Mask
) -> Array:
    """Give what a model sees (m, n_seen) in the rows `chosen` (n,) of features `X` (n, k)."""
    memory = pack(params, arrays, X.shape[1], 0)
    out = np.empty((int(chosen.sum()) + 1, n_seen(params, X.shape[1])))  # the last is scratch
    _expand_rows(memory.numbers, memory.memory, dt, X, chosen, out)
    return out[:-1]


BARE: Final[Params] = {"time_constants": (), "coupled": (), "turns": ()}
"""Parameters of a bank of plays alone."""


def n_seen(params: Params, n_features: int) -> int:
    """Count what the model sees."""
    alone = n_features * (1 + len(params["plays"]) + len(params["time_constants"]))
    return alone + len(params["coupled"]) * len(SHARES) + 2 * len(params["turns"])


def check_features(params: Params, n_features: int) -> None:
    """Raise CalibrationError for a feature that is not there, or turns by other features."""
    if any(place >= n_features for place in params["coupled"]):
        raise CalibrationError(
            f"play_bank has positions {params['coupled']}; it must be of features 0 to "
            f"{n_features - 1}"
        )
    if any(len(row) != n_features for row in params["turns"]):
        raise CalibrationError(
            f"play_bank has turns by {len(params['turns'][0])} features; it must be by each of "
            f"{n_features}"
        )


def shapes(params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    """Shapes of what is learnt, the model's among them; raises CalibrationError."""
    ((data, _),) = members(params, {})
    family = find_family(data.family)
    if family.inputs is not None or family.remembers:
        raise CalibrationError(
            f"play_bank has a model {data.family!r}; it must be one without a memory, for any "
            "features"
        )
    check_features(params, n_features)
    n_coupled = len(params["coupled"])
    joined = {"coupling": (n_coupled, n_coupled), "reaches": (n_coupled,)} if n_coupled else {}
    model = member_shapes(data, n_seen(params, n_features), n_outputs)
    return {"centre": (n_features,), "inverse_half_range": (n_features,), **joined, **model}


def pack(params: Params, arrays: Mapping[str, Array], n_features: int, n_outputs: int) -> Memory:
    """Memory of the plays and of the model of what is seen, or of the plays alone for no output."""
    model, address, functions = Layout().pack(), 0, {}
    if n_outputs:
        ((data, _),) = members(params, arrays)
        family = find_family(data.family)
        model = family.memory(data, n_seen(params, n_features), n_outputs)
        address, functions = family.row_address(), {"row": family.row}
    k, n_plays = n_features, len(params["plays"])
    return LAYOUT.pack(
        functions,
        centre=arrays["centre"],
        inverse_half_range=arrays["inverse_half_range"],
        half_widths=params["plays"],
        time_constants=params["time_constants"],
        outputs=np.zeros(k * n_plays),
        trails=np.zeros((k * len(params["time_constants"]), 2)),
        seen=np.zeros(n_seen(params, k)),
        coupled=params["coupled"],
        coupling=arrays.get("coupling", np.zeros((0, 0))),
        reaches=arrays.get("reaches", np.zeros(0)),
        shares=SHARES,
        turns=np.reshape(params["turns"], (-1, k)),
        row=address,
        model=model,
    )


_TURN: Final = numbers(10**6, -LARGEST, LARGEST, "factors", least=0)
FAMILY: Final = Family(
    "plays",
    rules={
        "learner": one_of("ridge", "trees", "gaussian_process"),
        **dict.fromkeys(("couple", "turn"), one_of(False, True)),
        "plays": numbers(MAX_PLAYS, 1e-6, 1.0, "half-widths in half ranges of a feature", least=0),
        "time_constants": numbers(MAX_LOWPASSES, 1e-6, MAX_TIME_CONSTANT, "times [s]", least=0),
        "coupled": Rule(
            lambda value: (
                is_list(value, 0, MAX_COUPLED, integer(0, 10**6).holds)
                and len(value) == len(set(value)) != 1
            ),
            f"2 to {MAX_COUPLED} measured positions by their places, or none: one alone has none",
        ),
        "turns": Rule(
            lambda value: (
                is_list(value, 0, MAX_TURNING, _TURN.holds) and len({*map(len, value)}) <= 1
            ),
            f"rows of up to {MAX_TURNING} capstans: angle by each feature [rad over its unit]",
        ),
        "members": ONE_MEMBER,
    },
    shapes=shapes,
    pack=pack,
    row=play_bank_row,
    remembers=True,
)


def jaw_bank(widths: tuple[float, ...], n_features: int) -> Params:
    """Parameters of a bank for plays of `widths` on so many features of a forceps.

    Its model is linear in features and plays, and in their products with the first feature; the
    first feature's square multiplies the features alone.
    """
    terms = {
        "degree": 2,
        "ridge": True,
        "first": 1,
        "crossed": n_features * (1 + len(widths)),
        "squared": 1,
        "by_squares": n_features,
    }
    return {**BARE, "plays": widths, "members": ((POLYNOMIAL.name, terms, ()),)}


def _jaw_bank(params: Params) -> Params:
    return jaw_bank(tuple(params["plays"]), len(params["signals"]))


JAW_BANK: Final = replace(
    FAMILY,
    name="plays.jaw_bank",
    rules={
        "signals": Rule(
            lambda value: (
                is_list(value, 1, 2, JAW_SIGNALS.__contains__)
                and list(value) == [signal for signal in JAW_SIGNALS if signal in value]
            ),
            f"one or two of {', '.join(JAW_SIGNALS)}, in this order",
        ),
        "plays": FAMILY.rules["plays"],
    },
    shapes=lambda params, k, n_outputs: only_joint(
        "plays.jaw_bank", shapes(_jaw_bank(params), k, 1), n_outputs
    ),
    pack=lambda params, arrays, k, _n_outputs: pack(_jaw_bank(params), arrays, k, 1),
    inputs=lambda params: tuple(params["signals"]),
    targets=("position", "error"),
    bears_load=lambda params: tuple(params["signals"]) == (RESET,),
)
"""Plays of a forceps' motor and cables: the bank on features of its own."""
