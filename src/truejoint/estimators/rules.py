"""Rules of an estimator's parameters, each a test and the same in words."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from truejoint.errors import CalibrationError

Params = Mapping[str, Any]

LARGEST: Final = 1e12
"""Largest physical parameter, and the inverse of the smallest: squares of products stay finite."""


@dataclass(frozen=True)
class Rule:
    """What a parameter must be: a test, and the same in words that end 'it must be ...'."""

    holds: Callable[[Any], bool]
    text: str


def is_number(value: object, low: float, high: float) -> bool:
    """Whether `value` is a finite real number (no bool) in [low, high]."""
    return (
        isinstance(value, (int, float, np.integer, np.floating))
        and not isinstance(value, bool)
        and bool(low <= value <= high)
    )


def is_integer(value: object, low: int, high: int) -> bool:
    """Whether `value` is an integer (no bool) in [low, high]."""
    return isinstance(value, (int, np.integer)) and is_number(value, low, high)


def is_list(value: object, least: int, most: int, holds: Callable[[Any], bool]) -> bool:
    """Whether `value` is a tuple or list of `least` to `most` items, for each of which it holds."""
    return (
        isinstance(value, (tuple, list)) and least <= len(value) <= most and all(map(holds, value))
    )


def number(low: float, high: float) -> Rule:
    """Rule of a number from `low` to `high`."""
    return Rule(lambda value: is_number(value, low, high), f"a number from {low:g} to {high:g}")


def integer(low: int, high: int) -> Rule:
    """Rule of an integer from `low` to `high`."""
    return Rule(lambda value: is_integer(value, low, high), f"an integer from {low} to {high}")


def one_of(*choices: object) -> Rule:
    """Rule of one value among a few."""
    return Rule(
        lambda value: any(type(value) is type(c) and value == c for c in choices),
        f"one of {', '.join(map(str, choices))}",
    )


def numbers(most: int, low: float, high: float, what: str, *, least: int = 1) -> Rule:
    """Rule of `least` to `most` numbers from `low` to `high`."""
    return Rule(
        lambda value: is_list(value, least, most, number(low, high).holds),
        f"{least} to {most} {what} from {low:g} to {high:g}",
    )


POSITIVE: Final = number(1.0 / LARGEST, LARGEST)
"""Rule of a physical parameter."""
RANDOM_STATE: Final = Rule(
    lambda value: (
        value is None or isinstance(value, np.random.RandomState) or is_integer(value, 0, 2**32 - 1)
    ),
    "None or an integer from 0 to 2**32 - 1",
)
"""Rule of the seed of an estimator that draws."""


ANYTHING: Final = Rule(lambda _value: True, "anything")


def optional(rule: Rule) -> Rule:
    """Rule of None, or of what another rule takes."""
    return Rule(lambda value: value is None or rule.holds(value), f"{rule.text}, or None")


def check_rules(name: str, rules: Mapping[str, Rule], params: Params) -> None:
    """Raise CalibrationError, naming whose parameter, value and rule, when one breaks its rule."""
    for key, rule in rules.items():
        if not rule.holds(params[key]):
            raise CalibrationError(
                f"{name} parameter {key} is {params[key]!r:.60}; it must be {rule.text}"
            )
