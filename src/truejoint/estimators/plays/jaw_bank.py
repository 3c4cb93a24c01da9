"""Plays of a forceps' motor and cables: the bank of `plays.run` on features of its own."""

from __future__ import annotations

from dataclasses import replace
from typing import Final

from truejoint.estimators.family import Params, Rule, only_joint
from truejoint.estimators.jaw.signals import DRIVE, MOTOR, RESET
from truejoint.estimators.plays import run as plays
from truejoint.estimators.polynomial.run import FAMILY as POLYNOMIAL

WIDTHS: Final = (
    0.0005, 0.001, 0.002, 0.005, 0.01, 0.02, 0.035, 0.05, 0.07, 0.1, 0.14, 0.19, 0.26,
)  # fmt: skip
"""Half-widths of the plays, in half ranges of a feature.

The narrow ones stand for presliding of slider and jaw, the wide ones for how far friction stretches
the drive cable.
"""
_SIGNALS: Final = (MOTOR, DRIVE, RESET)


def bank(widths: tuple[float, ...], n_features: int) -> Params:
    """Parameters of `plays.run` for plays of `widths` on so many features.

    Its model is linear in features and plays, and in their products with the first feature; the
    first feature's square multiplies the features alone.
    """
    n_terms = n_features * (1 + len(widths))
    terms = {
        "degree": 2,
        "ridge": True,
        "first": 1,
        "crossed": n_terms,
        "squared": 1,
        "by_squares": n_features,
    }
    model = (POLYNOMIAL.name, terms, ())
    return {**plays.BARE, "plays": widths, "members": (model,)}


def _bank(params: Params) -> Params:
    return bank(tuple(params["plays"]), len(params["signals"]))


def _are_signals(value: object) -> bool:
    return (
        isinstance(value, (tuple, list))
        and 1 <= len(value) <= 2
        and list(value) == [signal for signal in _SIGNALS if signal in value]
    )


WIDTHS_RULE: Final = plays.FAMILY.rules["plays"]

FAMILY: Final = replace(
    plays.FAMILY,
    name="plays.jaw_bank",
    rules={
        "signals": Rule(_are_signals, f"one or two of {', '.join(_SIGNALS)}, in this order"),
        "plays": WIDTHS_RULE,
    },
    shapes=lambda params, k, n_outputs: only_joint(
        "plays.jaw_bank", plays.shapes(_bank(params), k, 1), n_outputs
    ),
    pack=lambda params, arrays, k, _n_outputs: plays.pack(_bank(params), arrays, k, 1),
    inputs=lambda params: tuple(params["signals"]),
    targets=("position", "error"),
    bears_load=lambda params: tuple(params["signals"]) == (RESET,),
)
