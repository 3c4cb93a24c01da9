"""Expressions of a kernel as C, with what is known of their values folded in."""

from __future__ import annotations

import ast
import builtins
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numba.core.dispatcher import Dispatcher

from truejoint import compiled as marks
from truejoint import layout
from truejoint.export.c_statements import Block, Statement, Variable
from truejoint.export.c_structs import Handle, Struct, Unprintable, view_of
from truejoint.export.c_syntax import definitions, tree_of
from truejoint.export.c_values import (
    AND,
    BIT_AND,
    BIT_OR,
    CHOICE,
    EQUALITY,
    OR,
    ORDER,
    PRODUCT,
    SHIFT,
    SUM,
    UNARY,
    Expr,
    Kind,
    Known,
    Scalar,
    View,
    add,
    join,
    scale,
)

if TYPE_CHECKING:
    from truejoint.export.c_printer import Printer

FUNCTIONS: Final = frozenset(
    {"sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "atan", "atan2", "tanh", "ceil",
     "floor", "hypot"}
)  # fmt: skip
RESERVED: Final = FUNCTIONS | frozenset(
    {
        "auto", "break", "case", "char", "const", "continue", "default", "do", "double",
        "else", "enum", "extern", "float", "for", "goto", "if", "inline", "int", "long",
        "register", "restrict", "return", "short", "signed", "sizeof", "static", "struct",
        "switch", "typedef", "union", "unsigned", "void", "volatile", "while", "and",
        "bool", "catch", "class", "delete", "explicit", "export", "false", "friend",
        "mutable", "namespace", "new", "not", "operator", "or", "private", "protected",
        "public", "template", "this", "throw", "true", "try", "typename", "using",
        "virtual", "xor", "real", "main", "NAN", "INFINITY", "div", "abs", "exit", "y0",
        "y1", "yn", "j0", "j1", "jn", "gamma",
    }
)  # fmt: skip
_COMPARE: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Lt: ("<", ORDER, lambda a, b: a < b), ast.LtE: ("<=", ORDER, lambda a, b: a <= b),
    ast.Gt: (">", ORDER, lambda a, b: a > b), ast.GtE: (">=", ORDER, lambda a, b: a >= b),
    ast.Eq: ("==", EQUALITY, lambda a, b: a == b), ast.NotEq: ("!=", EQUALITY, lambda a, b: a != b),
}  # fmt: skip
ARITHMETIC: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Add: ("+", SUM, lambda a, b: a + b), ast.Sub: ("-", SUM, lambda a, b: a - b),
    ast.Mult: ("*", PRODUCT, lambda a, b: a * b), ast.Div: ("/", PRODUCT, lambda a, b: a / b),
    ast.FloorDiv: ("/", PRODUCT, lambda a, b: a // b), ast.Mod: ("%", PRODUCT, lambda a, b: a % b),
    ast.BitOr: ("|", BIT_OR, lambda a, b: a | b), ast.BitAnd: ("&", BIT_AND, lambda a, b: a & b),
    ast.LShift: ("<<", SHIFT, lambda a, b: a << b),
    ast.RShift: (">>", SHIFT, lambda a, b: a >> b),
}  # fmt: skip


@dataclass(eq=False)
class Expressions:
    """Expressions of one kernel for arguments of which something is known.

    Attributes
    ----------
    printer : Printer
    python : function
        The kernel.
    arguments : sequence
        Known numbers, expressions, views and handles.
    kinds : dict of str to Kind
        Of local variables, by their Python names; it grows until another pass finds no more.
    avoid : set of str
        Names at file scope that no local variable may hide; it grows too.
    body : list of statements
        What is printed.
    written : set of str
        Parameters through which it writes.
    again : bool
        Whether another pass is needed.
    name : str
        In C.
    """

    printer: Printer
    python: Any
    arguments: Sequence[Any]
    kinds: dict[str, Kind]
    avoid: set[str]
    body: list[Statement | Block] = field(default_factory=list)
    written: set[str] = field(default_factory=set)
    again: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        self.style = self.printer.style
        self.tree, self.comments = tree_of(self.python)
        self.out = self.body
        self.env: dict[str, Any] = {}
        self.returns: list[tuple[Statement, Any]] = []
        self.parameters: list[tuple[str, str, str, Any]] = []
        self.pointed: dict[str, View] = {}
        self.loops: list[ast.For] = []
        self.local_names: set[str] = set()
        self.globals_used: set[str] = set()
        self.declared: set[tuple[int, str]] = set()

    def fail(self, node: ast.AST, why: str) -> Unprintable:
        """Error that says where in the Python."""
        line = getattr(node, "lineno", 0)
        return Unprintable(f"{self.python.__module__}.{self.python.__name__}, line {line}: {why}")

    def emit(self, text: str, target: Variable | None = None, **more: Any) -> None:
        """Add a statement."""
        self.out.append(Statement(text, target, **more))

    # ------------------------------------------------------------------ values

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Print statements; whether control never goes on behind them."""
        raise NotImplementedError

    def truth(self, node: ast.expr) -> Any:
        """Value of a test."""
        value = self.value(node)
        if isinstance(value, Known):
            return Known(bool(value.value))
        return value

    def lookup(self, node: ast.expr) -> Any:
        """Object that a global name or attribute stands for."""
        if isinstance(node, ast.Name):
            if node.id in self.python.__globals__:
                return self.python.__globals__[node.id]
            if hasattr(builtins, node.id):
                return getattr(builtins, node.id)
            raise self.fail(node, f"{node.id} is not known here")
        if isinstance(node, ast.Attribute):
            return getattr(self.lookup(node.value), node.attr)
        raise self.fail(node, "this is no name")

    def value(self, node: ast.expr) -> Any:
        """Value of an expression, as far as it is known."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.fail(node, f"{type(node).__name__} has no C here")
        return method(node)

    def _constant(self, node: ast.Constant) -> Known:
        if not isinstance(node.value, (bool, int, float)):
            raise self.fail(node, f"{node.value!r} is no number")
        return Known(node.value)

    def _name(self, node: ast.Name) -> Any:
        if node.id in self.env:
            held = self.env[node.id]
            return Expr(held.name, held.kind) if isinstance(held, Variable) else held
        return self.constant(node)

    def constant(self, node: ast.Name | ast.Attribute) -> Any:
        """Constant of a module, by the name that C has for it."""
        value = self.lookup(node)
        if isinstance(value, np.generic):
            value = value.item()
        if not isinstance(value, (bool, int, float)):
            return value
        if isinstance(node, ast.Name):
            module, name = self.python.__module__, node.id
        else:
            module, name = getattr(self.lookup(node.value), "__name__", ""), node.attr
        return self.named(module, name, value)

    def named(  # noqa: PLR0911  # one kind of constant after the other
        self, module: str, name: str, value: Any
    ) -> Known:
        """Known number with the name that C has for it."""
        plain = value
        if module in ("math", "numpy"):
            if not np.isfinite(plain):
                return Known(plain)
            return Known(plain, self.printer.constants.define(name, plain, ""))
        found = definitions(module).get(name)
        while found is not None and found[0] is None:
            module, name = found[1], found[2]
            if module in ("math", "numpy"):
                return self.named(module, name, value)
            found = definitions(module).get(name)
        if found is None or found[0] is None:
            return Known(plain)
        source = found[0]
        if isinstance(plain, int) and isinstance(getattr(source, "func", None), ast.Attribute):
            return Known(plain)  # an index that a Layout gave
        if isinstance(source, ast.Call) and getattr(source.func, "id", "") == "int":
            members = self.members(module, source.args[0])
            return Known(plain, members)
        if not isinstance(plain, (int, float)) or isinstance(plain, bool):
            return Known(plain)
        single = self.style.single and isinstance(plain, float)
        rounding = "2.220446049250313e-16" in ast.unparse(source)
        shown = plain
        if single and rounding:
            # What is said in roundings of a double is meant in roundings of the arithmetic.
            shown = plain / 2.220446049250313e-16 * float(np.finfo(np.float32).eps)
        return Known(plain, self.printer.constants.define(name, shown, ""))

    def members(self, module: str, node: ast.expr) -> str:
        """Join enumeration members by ``|``, as C knows them; empty if it does not."""
        names = []
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name):
                owner: Any = getattr(sys.modules[module], part.value.id, None)
                if owner not in self.printer.enums:
                    return ""
                names.append(self.printer.enums[owner] + part.attr)
        return " | ".join(names)

    def _attribute(self, node: ast.Attribute) -> Any:
        if node.attr == "shape":
            return self.value(node.value).shape
        return self.constant(node)

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            value = self.truth(node.operand)
            if isinstance(value, Known):
                return Known(not value.value)
            return Expr(f"!{self.style.text(value, UNARY)}", "bool", UNARY)
        value = self.value(node.operand)
        if isinstance(node.op, ast.UAdd):
            return value
        if isinstance(value, Known):
            return Known(-value.value)
        if value.kind in ("int", "bool"):
            return scale(value, -1)
        return Expr(f"-{self.style.text(value, UNARY + 1)}", value.kind, UNARY)

    def _boolop(self, node: ast.BoolOp) -> Any:
        both = isinstance(node.op, ast.And)
        parts: list[Any] = []
        for item in node.values:
            place = len(self.out)
            value = self.truth(item)
            if parts and len(self.out) != place:
                raise self.fail(item, "its calls cannot wait for what stands before them")
            if isinstance(value, Known):
                if value.value != both:
                    if not parts:
                        return value
                    parts.append(value)
                    break
                continue
            parts.append(value)
        if not parts:
            return Known(both)
        if isinstance(parts[-1], Known) and not any(
            self.printer.has_effect(part.text) for part in parts[:-1]
        ):
            return parts[-1]
        if len(parts) == 1:
            return parts[0]
        sign, level = ("&&", AND) if both else ("||", OR)
        text = f" {sign} ".join(
            self.style.text(part, level if _is_of(part, level) else BIT_OR) for part in parts
        )
        return Expr(text, "bool", level)

    def _ifexp(self, node: ast.IfExp) -> Any:
        test = self.truth(node.test)
        if isinstance(test, Known):
            return self.value(node.body if test.value else node.orelse)
        place = len(self.out)
        one, other = self.value(node.body), self.value(node.orelse)
        if len(self.out) != place:
            raise self.fail(node, "one of its values needs statements of its own")
        kind = join([one.kind, other.kind])
        texts = [self.style.text(v, CHOICE + 1, kind) for v in (one, other)]
        return Expr(f"{self.style.text(test, CHOICE + 1)} ? {texts[0]} : {texts[1]}", kind, CHOICE)

    def _compare(self, node: ast.Compare) -> Any:
        values = [self.value(n) for n in (node.left, *node.comparators)]
        parts: list[Any] = []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            sign, level, compute = _COMPARE[type(op)]
            if isinstance(a, Known) and isinstance(b, Known):
                if not compute(a.value, b.value):
                    return Known(False)
                continue
            kind = join([a.kind, b.kind])
            left, right = (self.style.text(v, level + 1, kind) for v in (a, b))
            parts.append(Expr(f"{left} {sign} {right}", "bool", level))
        if not parts:
            return Known(True)
        if len(parts) == 1:
            return parts[0]
        return Expr(" && ".join(p.text for p in parts), "bool", AND)

    def _binop(self, node: ast.BinOp) -> Any:
        a = self.value(node.left)
        if isinstance(node.op, ast.Pow):
            return self.power(node, a)
        return self.operate(node, a, self.value(node.right))

    def power(self, node: ast.BinOp, a: Any) -> Any:
        """Second power, as numba computes it."""
        exponent = self.value(node.right)
        if isinstance(a, Known) and isinstance(exponent, Known):
            return Known(a.value**exponent.value)
        if not (isinstance(exponent, Known) and exponent.value == 2):
            raise self.fail(node, "of powers only squares have C")
        if isinstance(a, Expr) and re.fullmatch(r"[\w.>\-\[\]]+", a.text):
            return Expr(f"{a.text} * {a.text}", a.kind, PRODUCT)
        return Expr(f"{self.helper('square', a.kind)}({self.style.text(a)})", a.kind)

    def helper(self, name: str, kind: Kind) -> str:
        """Name of a small function for numbers of a kind."""
        ending = "real" if kind == "time" and not self.style.single else kind
        return f"{name}_{ending}"

    def operate(  # noqa: C901, PLR0911, PLR0912  # one rule after the other
        self, node: ast.AST, a: Any, b: Any
    ) -> Any:
        """Apply an operator to two numbers."""
        op = node.op  # type: ignore[attr-defined]
        sign, level, compute = ARITHMETIC[type(op)]
        kind = join([a.kind, b.kind])
        if isinstance(op, ast.Div):
            kind = join([kind, "real"])
        elif kind == "bool" and not isinstance(op, (ast.BitAnd, ast.BitOr)):
            kind = "int"
        if isinstance(a, Known) and isinstance(b, Known):
            return self.fold(op, a, b, kind, compute)
        if kind == "int" and isinstance(op, (ast.Add, ast.Sub)):
            return add(a, b, 1 if isinstance(op, ast.Add) else -1)
        if (
            kind == "int"
            and isinstance(op, ast.Mult)
            and (isinstance(a, Known) or isinstance(b, Known))
        ):
            return scale(b, a.value) if isinstance(a, Known) else scale(a, b.value)
        if isinstance(op, ast.BitOr):
            if isinstance(a, Known) and a.value == 0:
                return b
            if isinstance(b, Known) and b.value == 0:
                return a
        if isinstance(op, ast.BitAnd) and any(
            isinstance(v, Known) and v.value == 0 for v in (a, b)
        ):
            return Known(0)
        if isinstance(op, ast.Mult) and kind in ("real", "time"):
            for one, other in ((a, b), (b, a)):
                if isinstance(one, Known) and one.value == 1.0 and other.kind == kind:
                    return other
        if isinstance(op, (ast.BitOr, ast.BitAnd)):
            left = self.style.text(a, level if _is_operation(a, sign) else UNARY, kind)
            right = self.style.text(b, level if _is_operation(b, sign) else UNARY, kind)
        else:
            left, right = self.style.text(a, level, kind), self.style.text(b, level + 1, kind)
        if isinstance(op, ast.Div) and a.kind in ("int", "bool") and b.kind in ("int", "bool"):
            left = f"({self.style.real}){self.style.text(a, UNARY)}"
        return Expr(f"{left} {sign} {right}", kind, level)

    def fold(self, op: ast.operator, a: Known, b: Known, kind: Kind, compute: Any) -> Known:
        """Apply an operator to two known numbers."""
        if kind in ("real", "time"):
            with np.errstate(all="ignore"):
                result = float(compute(np.float64(a.value), np.float64(b.value)))
            return Known(result)
        symbol = ""
        if isinstance(op, ast.BitOr):
            if a.value == 0 or b.value == 0:
                symbol = b.symbol if a.value == 0 else a.symbol
            elif a.symbol and b.symbol:
                symbol = f"{a.symbol} | {b.symbol}"
        origin = None
        if isinstance(op, ast.Add):
            origin = a.origin if b.origin is None else b.origin if a.origin is None else None
        return Known(compute(a.value, b.value), symbol, origin)

    # ------------------------------------------------------------------ arrays

    def _subscript(self, node: ast.Subscript) -> Any:
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            index = self.value(node.slice)
            return self.value(node.value)[index.value]
        base = self.value(node.value)
        if isinstance(base, Handle):
            if isinstance(node.slice, ast.Slice):
                raise self.fail(node, "take a view of a field instead of a slice of the memory")
            return self.cell(base, self.value(node.slice), node, write=False)
        if not isinstance(base, View):
            raise self.fail(node, "this is no array")
        return self.item(base, node.slice, node)

    def item(self, base: View, index: ast.expr, node: ast.AST) -> Any:
        """Element, row or slice of a view."""
        if isinstance(index, ast.Slice):
            lower = Known(0) if index.lower is None else self.value(index.lower)
            upper = base.shape[0] if index.upper is None else self.value(index.upper)
            if len(base.shape) != 1 or index.step is not None:
                raise self.fail(node, "only a vector has such slices")
            return base.part(lower, (add(upper, lower, -1),))
        if isinstance(index, ast.Tuple):
            row, column = index.elts
            inside = self.row(base, self.value(row))
            return self.item(inside, column, node)
        where = self.value(index)
        if len(base.shape) == 2:
            return self.row(base, where)
        return self.element(base, where)

    def row(self, base: View, index: Scalar) -> View:
        """Row of a matrix."""
        columns = base.shape[1]
        if isinstance(columns, Known):
            offset = scale(index, columns.value)
        elif isinstance(index, Known):
            offset = scale(columns, index.value)
        else:
            a, b = self.style.text(index, PRODUCT), self.style.text(columns, PRODUCT + 1)
            offset = Expr(f"{a} * {b}", "int", PRODUCT)
        return base.part(offset, (columns,))

    def element(self, view: View, index: Scalar) -> Any:
        """Element of a vector: known where the array is constant and the place is known."""
        place = add(view.offset, index)
        values = view.values
        if values is not None and len(values):
            if isinstance(place, Known) and 0 <= place.value < len(values):
                return Known(values[place.value].item())
            bits = values.tobytes()
            if bits == bits[: values.itemsize] * len(values):
                return Known(values[0].item())
        self.use(view)
        return Expr(f"{view.text}[{self.style.text(place)}]", view.kind)

    def use(self, view: View) -> None:
        """Note a name at file scope."""
        if view.values is not None and not isinstance(view.root.owner, Expressions):
            self.globals_used.add(view.text)

    def place(self, node: ast.Subscript, *, write: bool) -> Expr:
        """Element as something that can be assigned to."""
        base = self.value(node.value)
        if isinstance(base, Handle):
            found = self.cell(base, self.value(node.slice), node, write=write)
            assert isinstance(found, Expr)  # noqa: S101  # what is written is not known
            return found
        found = self.item(replace(base, values=None), node.slice, node)
        if write:
            self.mark(base)
        assert isinstance(found, Expr)  # noqa: S101  # kernels assign to elements
        return found

    def mark(self, view: View) -> None:
        """Note that an array is written."""
        while view.pointer is not None:
            view.pointer[0].written = True
            view = view.pointer[1]
        if isinstance(view.root.owner, Struct):
            self.printer.written.fields.add((view.root.owner, view.root.name))
            self.mark_struct(view.text)
        elif view.root.owner is self:
            self.written.add(view.root.name)
        else:
            raise Unprintable(f"{self.python.__name__} writes to {view.text}, which is constant")

    def mark_struct(self, text: str) -> None:
        """Note that a struct is written through a parameter."""
        self.written.add(re.split(r"->|\.", text)[0])

    def cell(self, base: Handle, index: Any, node: ast.AST, *, write: bool) -> Any:
        """Scalar, integer or element of an array of integers in a struct's memory."""
        struct = base.struct
        if isinstance(index, Known) and index.origin is None:
            f = struct.named(base.side, index.value)
            if f is not None:
                if write:
                    self.printer.written.fields.add((struct, f.name))
                    self.written.add(base.owner)
                    if f.kind not in ("scalar", "integer"):
                        raise self.fail(node, f"field {f.name} is no number that can change")
                if f.kind not in ("scalar", "integer"):
                    return Known(int(struct.memory.numbers[index.value]), origin=(struct, f))
                kind: Kind = "int" if f.kind == "integer" else "real"
                if f.is_time and self.style.single:
                    kind = "time"
                if (struct, f.name) in self.printer.written:
                    return Expr(base.field_text(f.name), kind)
                return Known(struct.value(f))
        view = view_of(base, index, (Known(1),), self.printer.written, self.printer.constants)
        if write:
            self.mark(view)
            view = replace(view, values=None)
        return self.element(view, Known(0))

    # ------------------------------------------------------------------ calls

    def _call(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            view = self.value(node.func.value)
            return replace(view, shape=tuple(self.value(a) for a in node.args))
        function = self.lookup(node.func)
        arguments = [self.value(a) for a in node.args]
        if node.keywords:
            raise self.fail(node, "keywords have no C")
        if function in (marks.vector, marks.matrix):
            return self.view(arguments, node)
        if function is marks.borrow or function is marks.unrolled:
            return arguments[0]
        if function in (layout.part_numbers, layout.part_memory):
            return self.part(function, arguments)
        name = getattr(function, "__name__", "")
        if name.startswith("call_") and not isinstance(function, Dispatcher):
            struct, f = arguments[0].origin
            function, arguments = struct.memory.functions[f.name], arguments[1:]
        if isinstance(function, Dispatcher):
            return self.call(function, arguments, node)
        return self.builtin(name, arguments, node)

    def view(self, arguments: list[Any], node: ast.AST) -> View:
        """Give what `vector` and `matrix` do."""
        base, place, *shape = arguments
        if isinstance(base, View):
            return base.part(place, tuple(shape))
        if not isinstance(base, Handle):
            raise self.fail(node, "this is no memory")
        return view_of(base, place, tuple(shape), self.printer.written, self.printer.constants)

    def part(self, function: Any, arguments: list[Any]) -> Handle:
        """Give what `part_numbers` and `part_memory` do."""
        base, which = arguments[0], arguments[-1]
        f = base.struct.named("numbers", which.value)
        side = "numbers" if function is layout.part_numbers else "memory"
        inner = base.struct.parts[f.name]
        return Handle(inner, side, base.field_text(f.name), is_pointer=False, owner=base.owner)  # type: ignore[arg-type]

    def builtin(  # noqa: C901, PLR0911  # one function after the other
        self, name: str, arguments: list[Any], node: ast.AST
    ) -> Any:
        """Call of a function of Python, `math` or NumPy."""
        if name == "len":
            return arguments[0].shape[0]
        if name in ("float", "float64", "int", "bool"):
            return self.convert(name[:5].rstrip("6"), arguments[0])
        if name in ("min", "max"):
            result = arguments[0]
            for other in arguments[1:]:
                if isinstance(result, Known) and isinstance(other, Known):
                    result = Known((min if name == "min" else max)(result.value, other.value))
                    continue
                kind = join([result.kind, other.kind])
                texts = ", ".join(self.style.text(v, kind=kind) for v in (result, other))
                result = Expr(f"{self.helper(name, kind)}({texts})", kind)
            return result
        if all(isinstance(a, Known) for a in arguments) and name in (*FUNCTIONS, "fabs", "abs"):
            function = getattr(np, name, None) or getattr(np, f"arc{name[1:]}")
            with np.errstate(all="ignore"):
                return Known(function(*(a.value for a in arguments)).item())
        kind = join([a.kind for a in arguments])
        text = ", ".join(self.style.text(a, kind=kind) for a in arguments)
        suffix = "f" if self.style.single and kind != "time" else ""
        if name in ("abs", "fabs"):
            return Expr(
                f"fabs{suffix}({text})" if kind in ("real", "time") else f"abs({text})", kind
            )
        if name in ("isnan", "isfinite", "isinf"):
            if isinstance(arguments[0], Known):
                return Known(bool(getattr(np, name)(arguments[0].value)))
            return Expr(f"{name}({text})", "bool")
        if name == "sign":
            return Expr(f"{self.helper('sign', kind)}({text})", kind)
        if name in FUNCTIONS:
            return Expr(f"{name}{suffix}({text})", join([kind, "real"]))
        raise self.fail(node, f"{name or 'this function'} has no C here")

    def convert(self, name: str, value: Any) -> Any:
        """Convert a number to another kind."""
        if isinstance(value, Known):
            number = {"float": float, "int": int, "bool": bool}[name](value.value)
            return Known(number, value.symbol if type(number) is type(value.value) else "")
        if name == "bool":
            return (
                value
                if value.kind == "bool"
                else Expr(f"{self.style.text(value, EQUALITY + 1)} != 0", "bool", EQUALITY)
            )
        if name == "int":
            if value.kind in ("int", "bool"):
                return value
            return Expr(f"(int){self.style.text(value, UNARY)}", "int", UNARY)
        if value.kind == "real":
            return value
        return Expr(f"({self.style.real}){self.style.text(value, UNARY)}", "real", UNARY)

    def call(  # noqa: C901, PLR0912  # one kind of argument after the other
        self, function: Any, arguments: list[Any], node: ast.AST
    ) -> Any:
        """Call of another kernel."""
        tree, _ = tree_of(function.py_func)
        if isinstance(tree.returns, ast.Name) and tree.returns.id in ("Array", "Integers"):
            return self.inlined(function.py_func, arguments, node)
        printed = self.printer.function(function, arguments)
        names = [a.arg for a in tree.args.args]
        given = dict(zip(names, arguments, strict=True))
        texts: list[str] = []
        passed: dict[str, Handle | View] = {}
        seen = set()
        notes = {a.arg: getattr(a.annotation, "id", "") for a in tree.args.args}
        for name in printed.parameters:
            base, _, length = name.partition(".")
            value = given[base]
            if length:
                text = self.style.text(value.shape[0 if length in ("length", "rows") else 1])
            elif isinstance(value, Handle):
                if (value.struct, value.text) in seen:
                    continue
                seen.add((value.struct, value.text))
                text = value.pointer
                passed[name] = value
            elif isinstance(value, View):
                self.use(value)
                offset = self.style.text(value.offset)
                text = value.text if offset == "0" else f"{value.text} + {offset}"
                passed[name] = value
            else:
                kind = join([value.kind, "real"]) if notes[base] == "float" else value.kind
                text = self.style.text(value, kind=kind)
            texts.append(text)
        locals_ = {python: local for local, python, _ in self.printer.pointers[printed.name]}
        by_local = {locals_[python]: value for python, value in passed.items()}
        self.printer.calls.append((printed.name, self, by_local))
        for local, value in by_local.items():
            if local in printed.written:
                if isinstance(value, View):
                    self.mark(value)
                else:
                    self.written.add(value.owner)
        self.globals_used.add(printed.name)
        text = f"{printed.name}({', '.join(texts)})"
        if isinstance(printed.result, Known) or printed.result is None:
            if printed.name in self.printer.effects:
                self.emit(text)
            return printed.result
        return Expr(text, printed.result)

    def inlined(self, python: Any, arguments: list[Any], node: ast.AST) -> Any:
        """Call of a function that only gives a view: its statements are run here."""
        outer = (self.python, self.tree, self.comments, self.env)
        tree, _ = tree_of(python)
        env = dict(zip([a.arg for a in tree.args.args], arguments, strict=True))
        self.python, self.tree, self.comments, self.env = python, tree, {}, env
        try:
            for statement in tree.body:
                if isinstance(statement, ast.Return) and statement.value is not None:
                    return self.value(statement.value)
                self.block([statement])
        finally:
            self.python, self.tree, self.comments, self.env = outer
        raise self.fail(node, "it gives no view at its end")


def _is_of(value: Any, level: int) -> bool:
    """Whether an expression is of the same operator, so that it needs no parentheses."""
    return isinstance(value, Expr) and value.level == level


def _is_operation(value: Any, sign: str) -> bool:
    """Whether a value is what the same operator gave."""
    if isinstance(value, Known):
        return sign in value.symbol
    level = {"|": BIT_OR, "&": BIT_AND}[sign]
    return isinstance(value, Expr) and value.level == level
