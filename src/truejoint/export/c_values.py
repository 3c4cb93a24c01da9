"""What the C printer knows of a value: the number itself, or the C expression that gives it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Kind = Literal["bool", "int", "real", "time"]
"""Of a number: `real` is the arithmetic's, `time` has double precision always."""

_ORDER: Final[tuple[Kind, ...]] = ("bool", "int", "real", "time")

# How tightly operators of C bind.
PRIMARY, UNARY, PRODUCT, SUM, SHIFT, ORDER, EQUALITY = 16, 15, 13, 12, 11, 10, 9
BIT_AND, BIT_OR, AND, OR, CHOICE = 8, 6, 5, 4, 3


@dataclass(frozen=True)
class Known:
    """A number that is known when printing."""

    value: Any
    symbol: str = ""  # its name in C, or several joined by ``|``; empty for a plain literal
    origin: Any = None  # field of a memory that it is the address or the beginning of

    @property
    def kind(self) -> Kind:
        """Of the number."""
        if isinstance(self.value, bool):
            return "bool"
        return "int" if isinstance(self.value, int) else "real"


@dataclass(frozen=True)
class Expr:
    """A number that the C computes."""

    text: str
    kind: Kind
    level: int = PRIMARY  # how tightly its outermost operator binds


@dataclass(frozen=True)
class Linear:
    """An integer that is a sum of C expressions, each with a known factor, and a known number."""

    terms: tuple[tuple[Expr, int], ...]
    base: int = 0
    origin: Any = None
    kind: Final[Kind] = "int"


Scalar = Known | Expr | Linear


@dataclass(frozen=True)
class View:
    """An array, row by row, within what a C expression points to."""

    text: str  # name of an array or pointer
    offset: Scalar  # of the first element
    shape: tuple[Scalar, ...]
    kind: Kind  # of its elements
    root: tuple[Any, str]  # struct and field, or function and parameter, that it is a part of
    start: Scalar  # of its first element within the root
    values: NDArray[Any] | None = None  # what the whole of `text` holds, where nothing writes it
    pointer: Any = None  # local pointer that it goes through, and the view that this points to

    def part(self, offset: Scalar, shape: tuple[Scalar, ...]) -> View:
        """Part of this one from `offset` on."""
        return replace(
            self, offset=add(self.offset, offset), start=add(self.start, offset), shape=shape
        )

    def ends_before(self, other: View) -> bool:
        """Whether it is certain to end where a view of the same array begins, or before."""
        size: Scalar = Known(1)
        for length in self.shape:
            if not isinstance(length, Known):
                return False
            size = scale(size, length.value)
        gap = add(add(other.start, self.start, -1), size, -1)
        return isinstance(gap, Known) and gap.value >= 0


def join(kinds: Sequence[Kind]) -> Kind:
    """Kind that holds numbers of all these kinds."""
    return max(kinds, key=_ORDER.index)


def linear(value: Scalar) -> Linear:
    """Integer as a sum."""
    if isinstance(value, Known):
        return Linear((), int(value.value), value.origin)
    return value if isinstance(value, Linear) else Linear(((value, 1),))


def settle(value: Linear) -> Scalar:
    """Sum as what it is: a known number, one expression, or a sum."""
    terms = tuple((e, f) for e, f in value.terms if f != 0)
    if not terms:
        return Known(value.base, origin=value.origin)
    if value.base == 0 and value.origin is None and len(terms) == 1 and terms[0][1] == 1:
        return terms[0][0]
    return replace(value, terms=terms)


def either_origin(a: Any, b: Any) -> Any:
    """Origin of a sum: that of the one number that has one."""
    return a if b is None else b if a is None else None


def add(a: Scalar, b: Scalar, sign: int = 1) -> Scalar:
    """Sum, or with `sign` -1 difference, of two integers."""
    x, y = linear(a), linear(b)
    terms = dict(x.terms)
    for expression, factor in y.terms:
        terms[expression] = terms.get(expression, 0) + sign * factor
    origin = either_origin(x.origin, y.origin)
    return settle(Linear(tuple(terms.items()), x.base + sign * y.base, origin))


def scale(a: Scalar, factor: int) -> Scalar:
    """Integer times a known one."""
    x = linear(a)
    return settle(Linear(tuple((e, f * factor) for e, f in x.terms), x.base * factor))


def _within(text: str, level: int, needed: int) -> str:
    """Expression, in parentheses if it binds less than it must."""
    return text if level >= needed else f"({text})"


def _sum_text(value: Linear) -> str:
    text = ""
    for expression, factor in value.terms:
        size = abs(factor)
        needed = PRODUCT + 1 if size != 1 else PRODUCT if text and factor < 0 else SUM
        term = _within(expression.text, expression.level, needed)
        term = term if size == 1 else f"{size} * {term}"
        sign = " - " if factor < 0 else " + "
        text = f"{text}{sign}{term}" if text else ("-" if factor < 0 else "") + term
    if value.base:
        text += f" {'-' if value.base < 0 else '+'} {abs(value.base)}"
    return text


@dataclass(frozen=True)
class Style:
    """How numbers are written: in float where the arithmetic is `single`, else in double."""

    single: bool

    @property
    def real(self) -> str:
        """Type of the arithmetic."""
        return "float" if self.single else "double"

    def type(self, kind: Kind) -> str:
        """C type of a kind."""
        return {"bool": "int", "int": "int", "real": self.real, "time": "double"}[kind]

    def literal(self, value: float, kind: Kind = "real") -> str:
        """Shortest decimal constant that is exactly `value`, or the float nearest to it."""
        return self.literals([value], kind)[0]

    def literals(self, values: ArrayLike, kind: Kind = "real") -> list[str]:
        """Constants of an array, row by row, as `literal`; what no float reaches is the largest."""
        numbers = np.asarray(values, dtype=float).ravel()
        if not self.single or kind == "time":
            texts = list(map(repr, numbers.tolist()))
        else:
            limits = np.finfo(np.float32)
            size = np.clip(np.abs(numbers), float(limits.tiny), float(limits.max))
            size = np.copysign(np.where(numbers == 0.0, 0.0, size), numbers).astype(np.float32)
            texts = [f"{number!s}f" for number in size]
        special = {**dict.fromkeys(np.flatnonzero(np.isnan(numbers)).tolist(), "NAN")}
        for sign in (1, -1):
            places = np.flatnonzero(numbers == sign * np.inf).tolist()
            special |= dict.fromkeys(places, "INFINITY" if sign > 0 else "-INFINITY")
        for place, text in special.items():
            texts[place] = text
        return texts

    def text(self, value: Scalar, needed: int = 0, kind: Kind | None = None) -> str:
        """Value as C, for a place that binds as tightly as `needed` and is of that kind."""
        if isinstance(value, Linear):
            single = value.base == 0 and len(value.terms) == 1
            return _within(_sum_text(value), PRODUCT if single else SUM, needed)
        if isinstance(value, Expr):
            if self.single and (value.kind, kind) == ("real", "time"):
                return _within(f"(double){_within(value.text, value.level, UNARY)}", UNARY, needed)
            return _within(value.text, value.level, needed)
        if value.symbol:
            return _within(value.symbol, BIT_OR if "|" in value.symbol else PRIMARY, needed)
        if isinstance(value.value, (bool, int)) and kind not in ("real", "time"):
            text = str(int(value.value))
        else:
            text = self.literal(float(value.value), kind or "real")
        return _within(text, UNARY if text.startswith("-") else PRIMARY, needed)
