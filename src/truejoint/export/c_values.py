"""Values, statements and structs of C that is being printed; operators and functions."""

import ast
import inspect
import math
import operator
import re
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.resources import files
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from truejoint.errors import ExportError
from truejoint.layout import PART_SIZE, Field, Memory

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
    symbol: str = ""  # what C has for it: a name, an element, an expression of such; else a literal
    level: int = PRIMARY  # how tightly that binds
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
    base: int = 0  # known number that is added to an integer
    origin: Any = None


Scalar = Known | Expr


def named(value: float, name: str) -> Known:
    """Give a number of a memory the name that C has for it, unless it is whole or not finite."""
    plain = isinstance(value, int) or value in (0.0, 1.0) or not math.isfinite(value)
    return Known(value, "" if plain else name)


@dataclass(frozen=True)
class View:
    """An array, row by row, within what a C expression points to."""

    text: str  # name of an array or pointer
    offset: Scalar  # of the first element
    shape: tuple[Scalar, ...]
    kind: Kind  # of its elements
    root: tuple[Any, str]  # struct and field, or function and parameter, that it is a part of
    values: NDArray[Any] | None = None  # what the whole of `text` holds, where nothing writes it
    pointer: Any = None  # local pointer that it goes through, and the view that this points to

    def part(self, offset: Scalar, shape: tuple[Scalar, ...]) -> "View":
        """Part of this one from `offset` on."""
        return replace(self, offset=add(self.offset, offset), shape=shape)

    @property
    def start(self) -> Scalar:
        """Place of the first element within the root."""
        return self.offset if self.pointer is None else add(self.pointer[1].start, self.offset)

    def pointer_text(self, style: "Style") -> str:
        """Pointer to the first element in C."""
        offset = style.text(self.offset)
        return self.text if offset == "0" else f"{self.text} + {offset}"

    def ends_before(self, other: "View") -> bool:
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


def add(a: Scalar, b: Scalar, sign: int = 1) -> Scalar:
    """Sum, or with `sign` -1 difference, of two integers."""
    origin = a.origin if b.origin is None else b.origin if a.origin is None else None
    if isinstance(a, Known):
        if isinstance(b, Known):
            return Known(int(a.value) + sign * int(b.value), origin=origin)
        return add(scale(b, sign), a)
    if isinstance(b, Known):
        return replace(a, kind="int", base=a.base + sign * int(b.value), origin=origin)
    base = a.base + sign * b.base
    if sign < 0 and a.text == b.text:
        return Known(base, origin=origin)
    right = _within(b.text, b.level, SUM if sign > 0 else PRODUCT)
    text = f"{_within(a.text, a.level, SUM)} {'+' if sign > 0 else '-'} {right}"
    return Expr(text, "int", SUM, base, origin)


def scale(a: Scalar, factor: int) -> Scalar:
    """Integer times a known one."""
    if isinstance(a, Known) or factor == 0:
        return Known(int(a.value) * factor if isinstance(a, Known) else 0)
    if factor == 1:
        return a
    if factor == -1:
        return Expr(f"-{_within(a.text, a.level, UNARY + 1)}", "int", UNARY, -a.base)
    text = f"{factor} * {_within(a.text, a.level, PRODUCT + 1)}"
    return Expr(text, "int", PRODUCT, a.base * factor)


def _within(text: str, level: int, needed: int) -> str:
    """Expression, in parentheses if it binds less than it must."""
    return text if level >= needed else f"({text})"


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

    def dtype(self, type_: str) -> np.dtype[Any]:
        """Numbers of a C type; of the arithmetic's where none is given."""
        return np.dtype({"int": np.int32, "float": np.float32, "double": float}[type_ or self.real])

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
        names = {"nan": "NAN", "inf": "INFINITY", "-inf": "-INFINITY"}
        return [names.get(repr(v), text) for v, text in zip(numbers.tolist(), texts, strict=True)]

    def text(self, value: Scalar, needed: int = 0, kind: Kind | None = None) -> str:
        """Value as C, for a place that binds as tightly as `needed` and is of that kind."""
        if isinstance(value, Expr):
            if self.single and {value.kind, kind} == {"real", "time"}:
                cast = f"({self.type(kind)}){self.text(value, UNARY)}"  # type: ignore[arg-type]
                return _within(cast, UNARY, needed)
            if value.base:
                plain = _within(value.text, value.level, SUM)
                sign = "-" if value.base < 0 else "+"
                return _within(f"{plain} {sign} {abs(value.base)}", SUM, needed)
            return _within(value.text, value.level, needed)
        if value.symbol:
            return _within(value.symbol, value.level, needed)
        if isinstance(value.value, (bool, int)) and kind not in ("real", "time"):
            text = str(int(value.value))
        else:
            text = self.literal(float(value.value), kind or "real")
        return _within(text, UNARY if text.startswith("-") else PRIMARY, needed)


FUNCTIONS: Final = frozenset(
    {"sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "atan", "atan2", "tanh", "ceil",
     "floor", "hypot", "copysign"}
)  # fmt: skip
_RESERVED: Final = files(__package__).joinpath("templates/reserved.txt").read_text("utf-8")
RESERVED: Final = FUNCTIONS | frozenset(_RESERVED.split())
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
    sign, level, _ = ARITHMETIC[type(op)]
    kind = join([a.kind, b.kind])
    of_integers, bitwise = kind in ("int", "bool"), isinstance(op, (ast.BitAnd, ast.BitOr))
    if isinstance(op, ast.Div):
        kind = join([kind, "real"])
    elif kind == "bool" and not bitwise:
        kind = "int"
    are_known = isinstance(a, Known) and isinstance(b, Known)
    if kind == "int" and isinstance(op, (ast.Add, ast.Sub)) and not are_known:
        return add(a, b, 1 if isinstance(op, ast.Add) else -1)
    for operand, other in ((a, b), (b, a)):  # 0 | x, 0 & x, 1 * x
        if isinstance(operand, Known):
            if isinstance(op, ast.Mult) and kind == "int":
                return scale(other, operand.value)
            if isinstance(op, ast.Mult) and operand.value == 1.0 and other.kind == kind:
                return other
            if bitwise and operand.value == 0:
                return other if isinstance(op, ast.BitOr) else Known(0)
    if bitwise:
        first, second = (style.text(v, level if v.level == level else UNARY, kind) for v in (a, b))
    else:
        first, second = style.text(a, level, kind), style.text(b, level + 1, kind)
    if isinstance(op, ast.Div) and of_integers:
        first = f"({style.real}){style.text(a, UNARY)}"
    text = f"{first} {sign} {second}"
    return (
        _folded(style, op, a, b, Expr(text, kind, level)) if are_known else Expr(text, kind, level)
    )


def call_builtin(style: Style, name: str, arguments: list[Any]) -> Any:  # noqa: C901, PLR0911
    """Call a function of Python, `math` or NumPy; None if it has no C."""
    first = arguments[0]
    if name == "len":
        return first.shape[0]
    if name in ("float", "float64", "int", "bool"):
        return convert(style, name.removesuffix("64"), first)
    if name in ("min", "max"):
        for other in arguments[1:]:
            if isinstance(first, Known) and isinstance(other, Known):
                first = (min if name == "min" else max)(first, other, key=lambda v: v.value)
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
        return value if type(number) is type(value.value) else Known(number)
    if value.kind in {"bool": ("bool",), "int": ("int", "bool"), "float": ("real",)}[name]:
        return value
    if name == "bool":
        return Expr(f"{style.text(value, EQUALITY + 1)} != 0", "bool", EQUALITY)
    type_ = "int" if name == "int" else style.real
    kind: Kind = "int" if name == "int" else "real"
    return Expr(f"({type_}){style.text(value, UNARY)}", kind, UNARY)


def _folded(style: Style, op: ast.operator, a: Known, b: Known, in_c: Expr) -> Known:
    """Apply an operator to two known numbers, of which C computes what has a name.

    In float it computes no such number: that is rounded once, from double.
    """
    compute = ARITHMETIC[type(op)][2]
    if in_c.kind in ("real", "time"):
        with np.errstate(all="ignore"):
            value = float(compute(np.float64(a.value), np.float64(b.value)))
        named = not style.single and (a.symbol or b.symbol)
    else:
        value = compute(a.value, b.value)
        named = isinstance(op, ast.BitOr) and a.symbol and b.symbol
    origin = (a.origin or b.origin) if isinstance(op, ast.Add) else None
    return Known(value, in_c.text, in_c.level, origin) if named else Known(value, origin=origin)


NAME = re.compile(r"(?<![\w.>])[A-Za-z_]\w*")
_BREAK = re.compile(r"(?<=, )|(?<= = )|(?= (?:&&|\|\||[-+*/|?:]) )")  # places to break a line at


@dataclass(eq=False)
class Variable:
    """A local variable or pointer of a C function."""

    name: str
    kind: Kind
    is_pointer: bool = False
    assigned: int = 0  # how often it is given a value
    written: bool = False  # of a pointer: whether what it points to is changed
    is_read: bool = False  # as a number of this kind

    def declared(self, style: Style) -> str:
        """Type and name, ``const`` where that holds."""
        constant = not self.written if self.is_pointer else self.assigned == 1
        star = "*" if self.is_pointer else ""
        return f"{'const ' if constant else ''}{style.type(self.kind)} {star}{self.name}"


@dataclass(eq=False)
class Statement:
    """One line; with a `body`, a loop or one branch of a choice."""

    text: str  # without what stands left of an assignment; with a body ``for (...)``, ``else``, ...
    target: Variable | None = None  # that the text is assigned to; without text only declared
    declares: bool = False  # whether the variable is declared here
    operator: str = "="  # of the assignment
    comment: bool = False
    body: "list[Statement] | None" = None

    def lines(self, style: Style, depth: int) -> list[str]:
        """In C."""
        pad = "    " * depth
        if self.comment:
            return wrapped_comment(self.text, pad)
        if self.body is not None:
            # The brace that an else follows comes before it.
            head = wrapped(f"{self.text} {{", pad, 98 if self.text.startswith("else") else 100)
            return [*head, *block_lines(self.body, style, depth + 1), f"{pad}}}"]
        if self.target is None:
            return wrapped(f"{self.text};", pad)
        left = self.target.declared(style) if self.declares else self.target.name
        return wrapped(f"{left} {self.operator} {self.text};" if self.text else f"{left};", pad)

    def names(self) -> set[str]:
        """Names that it reads, those within its body too."""
        names = set() if self.comment else set(NAME.findall(self.text))
        return names.union(*(statement.names() for statement in self.body or ()))


def wrapped(text: str, pad: str, width: int = 100) -> list[str]:
    """Lines of a statement or initialiser, broken at spaces where it is too long."""
    lines, indent = [], pad
    while len(indent) + len(text) > width:
        places = _BREAK.finditer(text[: width - len(indent)])
        cut = max((place.start() for place in places), default=0)
        if cut == 0:
            break
        lines.append(indent + text[:cut].rstrip())
        text, indent = text[cut:].lstrip(), pad + "    "
    return [*lines, indent + text]


def wrapped_comment(text: str, pad: str) -> list[str]:
    """Text as a C comment of lines that fit."""
    if len(pad) + len(text) + 6 <= 100:
        return [f"{pad}/* {text} */"]
    start = f"{pad} * "
    lines = textwrap.wrap(text, 100 - len(start), break_long_words=False, break_on_hyphens=False)
    return [f"{pad}/*", *(start + line for line in lines), f"{pad} */"]


def block_lines(body: list[Statement], style: Style, depth: int) -> list[str]:
    """Statements in C; an else joins the brace before it."""
    lines: list[str] = []
    for statement in body:
        new = statement.lines(style, depth)
        if statement.body is not None and statement.text.startswith("else"):
            lines[-1] += f" {new.pop(0).lstrip()}"
        lines += new
    return lines


def without_unread(body: list[Statement], has_effect: Callable[[str], bool]) -> list[Statement]:
    """Statements without values that nothing reads."""
    read: set[str] = set()
    while read != (read := set().union(*(statement.names() for statement in body))):
        body = _live(body, read, has_effect)
    return body


def _live(
    body: list[Statement], read: set[str], has_effect: Callable[[str], bool]
) -> list[Statement]:
    live = []
    for statement in body:
        if statement.body is not None:
            live.append(replace(statement, body=_live(statement.body, read, has_effect)))
        elif statement.target is None or statement.target.name in read:
            live.append(statement)
        elif has_effect(statement.text):
            live.append(Statement(statement.text))
    return live


@cache
def tree_of(python: Any) -> tuple[ast.FunctionDef, dict[int, str]]:
    """Syntax of a function, and comments by the line of the statement below them."""
    source = textwrap.dedent(inspect.getsource(python))
    tree = ast.parse(source).body[0]
    assert isinstance(tree, ast.FunctionDef)  # noqa: S101  # a dispatcher is made of a function
    comments: dict[int, str] = {}
    collected: list[str] = []
    for number, line in enumerate(source.splitlines(), 1):
        text = line.strip()
        if text.startswith("#"):
            collected.append(text.lstrip("# "))
        else:
            if collected and not any("numba" in part for part in collected):
                comments[number] = " ".join(collected).replace("`", "").replace("*/", "")
            collected = []
    return tree, comments


@cache
def assigned(*statements: ast.stmt) -> set[str]:
    """Names of scalars and arrays that statements assign to."""
    nodes = [node for statement in statements for node in ast.walk(statement)]
    loops = {
        n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)
    }
    stored = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return stored - loops


@cache
def leaves_early(loop: ast.For) -> bool:
    """Whether a loop, or one within it, is left or goes on before its end."""
    return any(isinstance(node, (ast.Continue, ast.Break)) for node in ast.walk(loop))


Side = Literal["numbers", "memory"]


class Unprintable(ExportError):
    """A kernel holds what has no C; the message says where."""


@dataclass(frozen=True)
class Constant:
    """A number of the C, or an array of them."""

    name: str
    texts: tuple[str, ...]
    type: str = ""  # of the elements of an array

    @property
    def numbers(self) -> list[float]:
        """What a compiler makes of it, in double."""
        return [
            float(np.float32(text[:-1])) if text.endswith("f") else float(text)
            for text in self.texts
        ]


@dataclass(eq=False)
class Struct:
    """One memory, those within it, and what of it some kernel changes."""

    name: str  # of pointers to it
    type: str  # of the C struct
    memory: Memory
    written: set[str] = field(default_factory=set)
    parts: "dict[str, Struct]" = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.fields: dict[tuple[Side, int], Field] = {}  # by the index that kernels use
        for f in self.memory.layout.fields.values():
            side: Side = "memory" if f.kind == "scalar" else "numbers"
            size = PART_SIZE if f.kind == "part" else 1
            self.fields |= {(side, f.index + i): f for i in range(size)}
            if f.kind == "part":
                name = f"{self.type.removesuffix('_state')}_{f.name}_state"
                self.parts[f.name] = Struct(f.name, name, self.memory.part(f.name))

    def values(self, f: Field) -> NDArray[Any]:
        """Elements of an array field, or the one number of another, in one dimension."""
        if f.name in self.memory.shapes:
            return np.asarray(self.memory.view(f.name)).ravel()
        source: Any = self.memory.memory if f.kind == "scalar" else self.memory.numbers
        return np.asarray(source[f.index : f.index + 1])

    def walk(self) -> "Iterator[Struct]":
        """Parts first, then this one."""
        for part in self.parts.values():
            yield from part.walk()
        yield self

    @property
    def changes(self) -> bool:
        """Whether anything in it or its parts is changed."""
        return any(part.written for part in self.walk())

    def members(self) -> list[Field]:
        """Fields of the C struct: those that change, and parts in which anything does."""
        return [
            f
            for f in self.memory.layout.fields.values()
            if (self.parts[f.name].changes if f.kind == "part"
                else f.name in self.written and self.values(f).size)
        ]  # fmt: skip

    def constant(self, f: Field, name: str, style: Style) -> Constant:
        """Name what a field holds before the first step."""
        type_ = style.type(kind_of(f)) if f.name in self.memory.shapes else ""
        return Constant(name, tuple(element_texts(f, self.values(f), style)), type_)

    def initial_constants(self, style: Style, where: str) -> Iterator[Constant]:
        """Give the numbers of the C struct that are not 0 before the first step."""
        for f in self.members():
            if f.kind == "part":
                yield from self.parts[f.name].initial_constants(style, f"{where}{f.name}.")
            elif kind_of(f) != "int" and np.nan_to_num(self.values(f)).any():
                yield self.constant(f, where + f.name, style)

    def declaration(self, style: Style) -> str:
        """Typedef of the C struct, its fields explained."""
        lines = ["typedef struct {"]
        for f in self.members():
            is_part = f.kind == "part"
            kind = self.parts[f.name].type if is_part else style.type(kind_of(f))
            size = f"[{self.values(f).size}]" if f.name in self.memory.shapes else ""
            lines.append(f"    {kind} {f.name}{size}; /* {f.meaning} */")
        return "\n".join([*lines, f"}} {self.type};"])

    def dtype(self, style: Style) -> np.dtype[Any]:
        """Lay the C struct out as a compiler does."""
        return np.dtype(
            [(f.name, self.parts[f.name].dtype(style)) if f.kind == "part"
             else (f.name, style.dtype(style.type(kind_of(f))), self.values(f).shape)
             for f in self.members()],
            align=True,
        )  # fmt: skip

    def initial(self, style: Style, named: Mapping[str, str], depth: int = 0) -> list[str]:
        """Lines of a braced initialiser with what its fields hold before the first step.

        C knows the numbers of some fields by a name.
        """
        pad = "    " * depth
        lines = [f"{pad}{{"]
        for f in self.members():
            if f.kind == "part":
                lines += self.parts[f.name].initial(style, {}, depth + 1)
                lines[-1] += f" /* {f.name} */"
                continue
            values = self.values(f)
            texts = element_texts(f, values if values.any() else values[:1], style)
            single = named.get(f.name, texts[0])
            text = "{" + ", ".join(texts) + "}" if f.name in self.memory.shapes else single
            lines += wrapped(f"{text}, /* {f.name} */", f"{pad}    ")
        return [*lines, f"{pad}}}{',' if depth else ''}"]


@dataclass(frozen=True)
class Handle:
    """The numbers or the memory of a struct, as a kernel holds them."""

    struct: Struct
    side: Side
    text: str  # the struct, or a pointer to it, in C
    is_pointer: bool
    owner: str  # parameter of the function that it comes from

    def field_text(self, name: str) -> str:
        """Give a field of the struct in C."""
        return f"{self.text}{'->' if self.is_pointer else '.'}{name}"

    @property
    def pointer(self) -> str:
        """Pointer to the struct in C."""
        return self.text if self.is_pointer else f"&{self.text}"


@dataclass(frozen=True)
class Record:
    """The fields of a struct by name, as a kernel has unpacked them."""

    numbers: Handle
    memory: Handle


def kind_of(f: Field, style: Style | None = None) -> Kind:
    """Kind of the numbers of a field; in double precision, of a `style`, time is like the rest."""
    if f.kind in ("integer", "integers"):
        return "int"
    return "time" if f.is_time and (style is None or style.single) else "real"


def element_texts(f: Field, values: NDArray[Any], style: Style) -> list[str]:
    """Constants of elements of a field; raises ExportError if one does not fit."""
    kind = kind_of(f)
    if kind == "int":
        return [str(value) for value in values.tolist()]
    if style.single and kind == "real":
        large = values[np.isfinite(values) & (np.abs(values) > float(np.finfo(np.float32).max))]
        if large.size:
            raise ExportError(f"{large.tolist()[0]!r} does not fit a float; export in double")
    return style.literals(values, kind)
