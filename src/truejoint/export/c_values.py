"""What the C printer knows of a value: the number itself, or the C expression that gives it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

Kind = Literal["bool", "int", "real", "time"]
"""Of a number: `real` is the arithmetic's, `time` has double precision always."""

_ORDER: Final[tuple[Kind, ...]] = ("bool", "int", "real", "time")

# How tightly operators of C bind.
PRIMARY: Final = 16
UNARY: Final = 15
PRODUCT: Final = 13
SUM: Final = 12
SHIFT: Final = 11
ORDER: Final = 10
EQUALITY: Final = 9
BIT_AND: Final = 8
BIT_OR: Final = 6
AND: Final = 5
OR: Final = 4
CHOICE: Final = 3
LOWEST: Final = 0


@dataclass(frozen=True)
class Known:
    """A number that is known when printing.

    Attributes
    ----------
    value : bool, int or float
    symbol : str
        Its name in C, or several joined by ``|``; empty for a plain literal.
    origin : object
        Field of a memory that it is the address or the beginning of.
    """

    value: Any
    symbol: str = ""
    origin: Any = None

    @property
    def kind(self) -> Kind:
        """Of the number."""
        if isinstance(self.value, bool):
            return "bool"
        return "int" if isinstance(self.value, int) else "real"


@dataclass(frozen=True)
class Expr:
    """A number that the C computes.

    Attributes
    ----------
    text : str
        The C expression.
    kind : Kind
    level : int
        How tightly its outermost operator binds.
    """

    text: str
    kind: Kind
    level: int = PRIMARY


@dataclass(frozen=True)
class Linear:
    """An integer that is a sum of C expressions, each with a known factor, and a known number."""

    terms: tuple[tuple[Expr, int], ...]
    base: int = 0
    origin: Any = None
    kind: Final[Kind] = "int"


Scalar = Known | Expr | Linear


@dataclass(frozen=True)
class Root:
    """What an array is a part of: a field, a constant, or a parameter of the function.

    Attributes
    ----------
    owner : object
        Struct of a field, function of a parameter; None for a constant.
    name : str
    """

    owner: Any
    name: str


@dataclass(frozen=True)
class View:
    """An array, row by row, within what a C expression points to.

    Attributes
    ----------
    text : str
        Name of an array or pointer.
    offset : Scalar
        Of the first element.
    shape : tuple of Scalar
    kind : Kind
        Of its elements.
    root : Root
    start : Scalar
        Of its first element within the root.
    values : ndarray, optional
        What the whole of `text` holds, where nothing writes it.
    pointer : object
        Local pointer that it goes through.
    """

    text: str
    offset: Scalar
    shape: tuple[Scalar, ...]
    kind: Kind
    root: Root
    start: Scalar
    values: NDArray[Any] | None = None
    pointer: Any = None

    def part(self, offset: Scalar, shape: tuple[Scalar, ...]) -> View:
        """Part of this one from `offset` on."""
        return replace(
            self, offset=add(self.offset, offset), start=add(self.start, offset), shape=shape
        )


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


def add(a: Scalar, b: Scalar, sign: int = 1) -> Scalar:
    """Sum, or with `sign` -1 difference, of two integers."""
    x, y = linear(a), linear(b)
    terms = dict(x.terms)
    for expression, factor in y.terms:
        terms[expression] = terms.get(expression, 0) + sign * factor
    origin = x.origin if y.origin is None else y.origin if x.origin is None else None
    return settle(Linear(tuple(terms.items()), x.base + sign * y.base, origin))


def scale(a: Scalar, factor: int) -> Scalar:
    """Integer times a known one."""
    x = linear(a)
    return settle(Linear(tuple((e, f * factor) for e, f in x.terms), x.base * factor))


def within(text: str, level: int, needed: int) -> str:
    """Expression, in parentheses if it binds less than it must."""
    return text if level >= needed else f"({text})"


def _sum_text(value: Linear) -> str:
    text = ""
    for expression, factor in value.terms:
        size = abs(factor)
        term = within(expression.text, expression.level, SUM if size == 1 else PRODUCT + 1)
        if size != 1:
            term = f"{size} * {term}"
        elif text and factor < 0:
            term = within(expression.text, expression.level, PRODUCT)
        sign = " - " if factor < 0 else " + "
        text = f"{text}{sign}{term}" if text else ("-" if factor < 0 else "") + term
    if value.base:
        text += f" {'-' if value.base < 0 else '+'} {abs(value.base)}"
    return text


@dataclass(frozen=True)
class Style:
    """How numbers are written.

    Attributes
    ----------
    single : bool
        Whether the arithmetic is in float.
    """

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
        if math.isnan(value):
            return "NAN"
        if math.isinf(value):
            return "INFINITY" if value > 0 else "-INFINITY"
        if not self.single or kind == "time":
            return repr(float(value))
        limits = np.finfo(np.float32)
        size = min(abs(value), float(limits.max))
        size = max(size, float(limits.tiny)) if value else 0.0
        text = f"{np.float32(math.copysign(size, value))!s}f"
        return text if "." in text or "e" in text else text[:-1] + ".0f"

    def text(self, value: Scalar, needed: int = LOWEST, kind: Kind | None = None) -> str:
        """Value as C, for a place that binds as tightly as `needed` and is of that kind."""
        if isinstance(value, Linear):
            single = value.base == 0 and len(value.terms) == 1
            level = PRODUCT if single else SUM
            return within(_sum_text(value), level, needed)
        if isinstance(value, Expr):
            return within(value.text, value.level, needed)
        if value.symbol:
            return within(value.symbol, BIT_OR if "|" in value.symbol else PRIMARY, needed)
        if isinstance(value.value, (bool, int)) and kind not in ("real", "time"):
            return within(str(int(value.value)), UNARY if value.value < 0 else PRIMARY, needed)
        text = self.literal(float(value.value), kind or "real")
        return within(text, UNARY if text.startswith("-") else PRIMARY, needed)
