"""Operators and functions of Python as C, of numbers of which something may be known."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np

from truejoint.export.c_values import (
    BIT_AND,
    BIT_OR,
    EQUALITY,
    ORDER,
    PRODUCT,
    SHIFT,
    SUM,
    UNARY,
    Expr,
    Kind,
    Known,
    Style,
    add,
    either_origin,
    join,
    scale,
)

FUNCTIONS: Final = frozenset(
    {"sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "atan", "atan2", "tanh", "ceil",
     "floor", "hypot", "copysign"}
)  # fmt: skip
_C_AND_CPP: Final = """
auto break case char const continue default do double else enum extern float for goto if inline int
long register restrict return short signed sizeof static struct switch typedef union unsigned void
volatile while and bool catch class delete explicit export false friend mutable namespace new not
operator or private protected public template this throw true try typename using virtual xor real
main NAN INFINITY div abs exit y0 y1 yn j0 j1 jn gamma
"""
RESERVED: Final = FUNCTIONS | frozenset(_C_AND_CPP.split())
_TESTS: Final = frozenset({"isnan", "isfinite", "isinf"})
_FOLDED: Final = FUNCTIONS | _TESTS | {"fabs", "abs"}
COMPARISONS: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Lt: ("<", ORDER, operator.lt), ast.LtE: ("<=", ORDER, operator.le),
    ast.Gt: (">", ORDER, operator.gt), ast.GtE: (">=", ORDER, operator.ge),
    ast.Eq: ("==", EQUALITY, operator.eq), ast.NotEq: ("!=", EQUALITY, operator.ne),
}  # fmt: skip
ARITHMETIC: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Add: ("+", SUM, operator.add), ast.Sub: ("-", SUM, operator.sub),
    ast.Mult: ("*", PRODUCT, operator.mul), ast.Div: ("/", PRODUCT, operator.truediv),
    ast.FloorDiv: ("/", PRODUCT, operator.floordiv), ast.Mod: ("%", PRODUCT, operator.mod),
    ast.BitOr: ("|", BIT_OR, operator.or_), ast.BitAnd: ("&", BIT_AND, operator.and_),
    ast.LShift: ("<<", SHIFT, operator.lshift), ast.RShift: (">>", SHIFT, operator.rshift),
}  # fmt: skip


def operate(style: Style, op: ast.operator, a: Any, b: Any) -> Any:  # noqa: C901
    """Apply an operator to two numbers."""
    sign, level, compute = ARITHMETIC[type(op)]
    kind = join([a.kind, b.kind])
    of_integers, bitwise = kind in ("int", "bool"), isinstance(op, (ast.BitAnd, ast.BitOr))
    if isinstance(op, ast.Div):
        kind = join([kind, "real"])
    elif kind == "bool" and not bitwise:
        kind = "int"
    if isinstance(a, Known) and isinstance(b, Known):
        return _folded(op, a, b, kind, compute)
    if kind == "int" and isinstance(op, (ast.Add, ast.Sub)):
        return add(a, b, 1 if isinstance(op, ast.Add) else -1)
    for one, other in ((a, b), (b, a)):  # 0 | x, 0 & x, 1 * x
        if isinstance(one, Known):
            if isinstance(op, ast.Mult) and kind == "int":
                return scale(other, one.value)
            if isinstance(op, ast.Mult) and one.value == 1.0 and other.kind == kind:
                return other
            if bitwise and one.value == 0:
                return other if isinstance(op, ast.BitOr) else Known(0)
    if bitwise:
        first, second = (
            style.text(v, level if _is_operation(v, sign, level) else UNARY, kind) for v in (a, b)
        )
    else:
        first, second = style.text(a, level, kind), style.text(b, level + 1, kind)
    if isinstance(op, ast.Div) and of_integers:
        first = f"({style.real}){style.text(a, UNARY)}"
    return Expr(f"{first} {sign} {second}", kind, level)


def call_builtin(  # noqa: C901, PLR0911  # one function after the other
    style: Style, name: str, arguments: list[Any]
) -> Any:
    """Call a function of Python, `math` or NumPy; None if it has no C."""
    first = arguments[0]
    if name == "len":
        return first.shape[0]
    if name in ("float", "float64", "int", "bool"):
        return convert(style, name.removesuffix("64"), first)
    if name in ("min", "max"):
        for other in arguments[1:]:
            if isinstance(first, Known) and isinstance(other, Known):
                first = Known((min if name == "min" else max)(first.value, other.value))
                continue
            kind = join([first.kind, other.kind])
            texts = ", ".join(style.text(v, kind=kind) for v in (first, other))
            first = Expr(f"{name}_{kind}({texts})", kind)
        return first
    if all(isinstance(a, Known) for a in arguments) and name in _FOLDED:
        function = getattr(np, name, None) or getattr(np, f"arc{name[1:]}")
        with np.errstate(all="ignore"):
            return Known(function(*(a.value for a in arguments)).item())
    kind = join([a.kind for a in arguments])
    text = ", ".join(style.text(a, kind=kind) for a in arguments)
    suffix = "f" if style.single and kind != "time" else ""
    if name in ("abs", "fabs"):
        called = "abs" if kind in ("int", "bool") else f"fabs{suffix}"
        return Expr(f"{called}({text})", kind)
    if name in _TESTS:
        return Expr(f"{name}({text})", "bool")
    if name == "sign":
        return Expr(f"sign_{kind}({text})", kind)
    if name in FUNCTIONS:
        return Expr(f"{name}{suffix}({text})", join([kind, "real"]))
    return None


def convert(style: Style, name: str, value: Any) -> Any:
    """Convert a number to another kind."""
    if isinstance(value, Known):
        number = {"float": float, "int": int, "bool": bool}[name](value.value)
        return Known(number, value.symbol if type(number) is type(value.value) else "")
    if value.kind in {"bool": ("bool",), "int": ("int", "bool"), "float": ("real",)}[name]:
        return value
    if name == "bool":
        return Expr(f"{style.text(value, EQUALITY + 1)} != 0", "bool", EQUALITY)
    type_ = "int" if name == "int" else style.real
    kind: Kind = "int" if name == "int" else "real"
    return Expr(f"({type_}){style.text(value, UNARY)}", kind, UNARY)


def is_of(value: Any, level: int) -> bool:
    """Whether an expression is of the same operator, so that it needs no parentheses."""
    return isinstance(value, Expr) and value.level == level


def _is_operation(value: Any, sign: str, level: int) -> bool:
    """Whether a value is what the same operator gave."""
    return sign in value.symbol if isinstance(value, Known) else is_of(value, level)


def _folded(op: ast.operator, a: Known, b: Known, kind: Kind, compute: Any) -> Known:
    """Apply an operator to two known numbers."""
    if kind in ("real", "time"):
        with np.errstate(all="ignore"):
            return Known(float(compute(np.float64(a.value), np.float64(b.value))))
    symbol = ""
    if isinstance(op, ast.BitOr):
        if a.value == 0 or b.value == 0:
            symbol = b.symbol if a.value == 0 else a.symbol
        elif a.symbol and b.symbol:
            symbol = f"{a.symbol} | {b.symbol}"
    origin = either_origin(a.origin, b.origin) if isinstance(op, ast.Add) else None
    return Known(compute(a.value, b.value), symbol, origin)
