"""Expressions of a kernel as C, with what is known of their values folded in."""

from __future__ import annotations

import ast
import builtins
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numba.core.dispatcher import Dispatcher

from truejoint import compiled as marks
from truejoint import layout
from truejoint.export.c_operators import COMPARISONS, call_builtin, is_of, operate
from truejoint.export.c_statements import Body, Statement, Variable
from truejoint.export.c_structs import Handle, Record, Struct, Unprintable, kind_of
from truejoint.export.c_syntax import definitions, tree_of
from truejoint.export.c_values import (
    AND,
    BIT_OR,
    CHOICE,
    OR,
    PRODUCT,
    UNARY,
    Expr,
    Known,
    Scalar,
    View,
    add,
    join,
    scale,
)

if TYPE_CHECKING:
    from truejoint.export.c_printer import Printer

_DOUBLE_EPSILON: Final = "2.220446049250313e-16"


@dataclass(eq=False)
class Expressions:
    """Expressions of one kernel for arguments of which something is known."""

    printer: Printer
    python: Any  # the kernel
    arguments: Sequence[Any]  # known numbers, expressions, views and handles
    body: Body = field(default_factory=list)  # what is printed
    written: set[str] = field(default_factory=set)  # parameters through which it writes
    name: str = ""  # in C

    def __post_init__(self) -> None:
        self.style = self.printer.style
        self.tree, self.comments = tree_of(self.python)
        self.out = self.body
        self.env: dict[str, Any] = {}

    def fail(self, node: ast.AST, why: str) -> Unprintable:
        """Error that says where in the Python."""
        line = getattr(node, "lineno", 0)
        return Unprintable(f"{self.python.__module__}.{self.python.__name__}, line {line}: {why}")

    def emit(self, text: str, target: Variable | None = None, **more: Any) -> None:
        """Add a statement."""
        self.out.append(Statement(text, target, **more))

    # ------------------------------------------------------------------ values

    def visit(self, node: ast.AST, *more: Any) -> Any:
        """Give what the method for this kind of node gives."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.fail(node, f"{type(node).__name__} has no C here")
        return method(node, *more)

    def value(self, node: ast.expr) -> Any:
        """Value of an expression, as far as it is known."""
        return self.visit(node)

    def truth(self, node: ast.expr) -> Any:
        """Value of a test."""
        value = self.value(node)
        return Known(bool(value.value)) if isinstance(value, Known) else value

    def lookup(self, node: ast.expr) -> Any:
        """Object that a global name or attribute stands for."""
        if isinstance(node, ast.Attribute):
            return getattr(self.lookup(node.value), node.attr)
        if not isinstance(node, ast.Name):
            raise self.fail(node, "this is no name")
        for names in (self.python.__globals__, vars(builtins)):
            if node.id in names:
                return names[node.id]
        raise self.fail(node, f"{node.id} is not known here")

    def _constant(self, node: ast.Constant) -> Known:
        if not isinstance(node.value, (bool, int, float)):
            raise self.fail(node, f"{node.value!r} is no number")
        return Known(node.value)

    def _name(self, node: ast.Name) -> Any:
        if node.id in self.env:
            held = self.env[node.id]
            if not isinstance(held, Variable):
                return held
            held.is_read = True
            return Expr(held.name, held.kind)
        return self.constant(node, self.python.__module__, node.id)

    def _attribute(self, node: ast.Attribute) -> Any:
        if node.attr == "shape":
            return self.value(node.value).shape
        if isinstance(node.value, ast.Name) and isinstance(self.env.get(node.value.id), Record):
            return self.field_of(self.env[node.value.id], node)
        return self.constant(node, getattr(self.lookup(node.value), "__name__", ""), node.attr)

    def constant(self, node: ast.expr, module: str, name: str) -> Any:
        """Constant of a module, by the name that C has for it."""
        value = self.lookup(node)
        if isinstance(value, np.generic):
            value = value.item()
        return self.named(module, name, value) if isinstance(value, (bool, int, float)) else value

    def named(self, module: str, name: str, value: Any) -> Known:
        """Known number with the name that C has for it."""
        define = self.printer.constants.define
        if module in ("math", "numpy"):
            return Known(value, define(name, value) if np.isfinite(value) else "")
        source, *imported = definitions(module).get(name, (None,))
        if imported:
            module, name = imported
            return self.named(module, name, value)
        call = getattr(source, "func", None)
        is_index = isinstance(call, ast.Attribute)  # of a field, which a `Layout` gave
        if source is None or isinstance(value, bool) or (isinstance(value, int) and is_index):
            return Known(value)
        if isinstance(source, ast.Call) and getattr(call, "id", "") == "int":
            return Known(value, self.members(module, source.args[0]))
        shown = value
        if self.style.single and _DOUBLE_EPSILON in ast.unparse(source):
            # What is said in roundings of a double is meant in roundings of the arithmetic.
            shown = value / float(_DOUBLE_EPSILON) * float(np.finfo(np.float32).eps)
        return Known(value, define(name, shown))

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
            if not isinstance(value, Known):
                parts.append(value)
            elif value.value != both:  # what follows is never looked at
                if not any(self.printer.has_effect(part.text) for part in parts):
                    return value
                parts.append(value)
                break
        if len(parts) < 2:
            return parts[0] if parts else Known(both)
        sign, level = ("&&", AND) if both else ("||", OR)
        text = f" {sign} ".join(
            self.style.text(part, level if is_of(part, level) else BIT_OR) for part in parts
        )
        return Expr(text, "bool", level)

    def _ifexp(self, node: ast.IfExp) -> Any:
        test = self.truth(node.test)
        if isinstance(test, Known):
            return self.value(node.body if test.value else node.orelse)
        place = len(self.out)
        values = [self.value(node.body), self.value(node.orelse)]
        if len(self.out) != place:
            raise self.fail(node, "one of its values needs statements of its own")
        kind = join([v.kind for v in values])
        one, other = (self.style.text(v, CHOICE + 1, kind) for v in values)
        return Expr(f"{self.style.text(test, CHOICE + 1)} ? {one} : {other}", kind, CHOICE)

    def _compare(self, node: ast.Compare) -> Any:
        values = [self.value(n) for n in (node.left, *node.comparators)]
        parts: list[Any] = []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            sign, level, compute = COMPARISONS[type(op)]
            if isinstance(a, Known) and isinstance(b, Known):
                if not compute(a.value, b.value):
                    return Known(False)
                continue
            kind = join([a.kind, b.kind])
            first, right = (self.style.text(v, level + 1, kind) for v in (a, b))
            parts.append(Expr(f"{first} {sign} {right}", "bool", level))
        if len(parts) < 2:
            return parts[0] if parts else Known(True)
        return Expr(" && ".join(p.text for p in parts), "bool", AND)

    def _binop(self, node: ast.BinOp) -> Any:
        a, b = self.value(node.left), self.value(node.right)
        if not isinstance(node.op, ast.Pow):
            return operate(self.style, node.op, a, b)
        if isinstance(a, Known) and isinstance(b, Known):
            return Known(a.value**b.value)
        if not (isinstance(b, Known) and b.value == 2):
            raise self.fail(node, "of powers only squares have C")
        if isinstance(a, Expr) and re.fullmatch(r"[\w.>\-\[\]]+", a.text):
            return Expr(f"{a.text} * {a.text}", a.kind, PRODUCT)
        return Expr(f"square_{a.kind}({self.style.text(a)})", a.kind)

    # ------------------------------------------------------------------ arrays

    def _subscript(self, node: ast.Subscript) -> Any:
        base = self.value(node.value)
        if isinstance(base, tuple):  # a shape
            return base[self.value(node.slice).value]
        return self.at(base, node, write=False)

    def at(self, base: Any, node: ast.Subscript, *, write: bool) -> Any:
        """Element, row or slice of a view, or a cell of a memory."""
        if isinstance(base, Handle):
            if isinstance(node.slice, ast.Slice):
                raise self.fail(node, "take a view of a field instead of a slice of the memory")
            return self.cell(base, self.value(node.slice), node, write=write)
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
            return self.item(self.row(base, self.value(row)), column, node)
        where = self.value(index)
        return self.row(base, where) if len(base.shape) == 2 else self.element(base, where)

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
        return Expr(f"{view.text}[{self.style.text(place)}]", view.kind)

    def place(self, node: ast.Subscript) -> Expr:
        """Element as something that is assigned to."""
        base = self.value(node.value)
        if isinstance(base, View):
            self.mark(base)
            base = replace(base, values=None)
        found = self.at(base, node, write=True)
        assert isinstance(found, Expr)  # noqa: S101  # what is written is not known
        return found

    def mark(self, view: View) -> None:
        """Note that an array is written."""
        while view.pointer is not None:
            view.pointer[0].written = True
            view = view.pointer[1]
        owner, name = view.root
        if isinstance(owner, Struct):
            owner.written.add(name)
            self.written.add(re.split(r"->|\.", view.text)[0])
        elif owner is self:
            self.written.add(name)
        else:
            raise Unprintable(f"{self.python.__name__} writes to {view.text}, which is constant")

    def cell(self, base: Handle, index: Any, node: ast.AST, *, write: bool) -> Any:
        """Scalar, integer or element of an array of integers in a struct's memory."""
        struct = base.struct
        f = None
        if isinstance(index, Known) and index.origin is None:
            f = struct.fields.get((base.side, index.value))
        if f is not None:
            is_number = f.kind in ("scalar", "integer")
            if write:
                struct.written.add(f.name)
                self.written.add(base.owner)
                if not is_number:
                    raise self.fail(node, f"field {f.name} is no number that can change")
            if not is_number:
                return Known(int(struct.memory.numbers[index.value]), origin=(struct, f))
            if f.name in struct.written:
                return Expr(base.field_text(f.name), kind_of(f, self.style))
            return Known(struct.values(f)[0].item())
        view = self.printer.constants.view(base, index, (Known(1),))
        if write:
            self.mark(view)
            view = replace(view, values=None)
        return self.element(view, Known(0))

    def field_of(self, record: Record, node: ast.Attribute) -> Any:
        """Field that a kernel has unpacked: a view of an array, or a number."""
        memory = record.numbers.struct.memory
        f = memory.layout.fields[node.attr]
        side = record.memory if f.kind in ("scalar", "array") else record.numbers
        place = self.cell(record.numbers if f.shape else side, Known(f.index), node, write=False)
        if not f.shape:
            return place
        return self.printer.constants.view(side, place, tuple(map(Known, memory.shapes[f.name])))

    # ------------------------------------------------------------------ calls

    def _call(self, node: ast.Call) -> Any:  # noqa: C901, PLR0911  # one kind of call after the other
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            view = self.value(node.func.value)
            return replace(view, shape=tuple(self.value(a) for a in node.args))
        function = self.lookup(node.func)
        if node.keywords:
            raise self.fail(node, "keywords have no C")
        if function in (marks.local_vector, marks.local_matrix):
            return self.room(node)
        arguments = [self.value(a) for a in node.args]
        if getattr(function, "gives_fields", False):
            return Record(*arguments)
        if function in (marks.vector, marks.matrix):
            base, place, *shape = arguments
            if isinstance(base, View):
                return base.part(place, tuple(shape))
            if not isinstance(base, Handle):
                raise self.fail(node, "this is no memory")
            return self.printer.constants.view(base, place, tuple(shape))
        if function is marks.borrow or function is marks.unrolled:
            return arguments[0]
        if function in (layout.part_numbers, layout.part_memory):
            base, index = arguments[0], arguments[-1].value
            name = base.struct.fields["numbers", index].name
            side: Any = "numbers" if function is layout.part_numbers else "memory"
            inner, text = base.struct.parts[name], base.field_text(name)
            return Handle(inner, side, text, is_pointer=False, owner=base.owner)
        name = getattr(function, "__name__", "")
        if name.startswith("call_") and not isinstance(function, Dispatcher):
            struct, f = arguments[0].origin
            function, arguments = struct.memory.functions[f.name], arguments[1:]
        if isinstance(function, Dispatcher):
            return self.call(function, arguments, node)
        found = call_builtin(self.style, name, arguments)
        if found is None:
            raise self.fail(node, f"{name or 'this function'} has no C here")
        return found

    def room(self, node: ast.Call) -> View:
        """Room for numbers of a known count, which gets the name that it is assigned to."""
        shape = tuple(self.value(n) for n in node.args)
        if not all(isinstance(n, Known) for n in shape):
            raise self.fail(node, "its size is not known")
        return View("", Known(0), shape, "real", (self, ""), Known(0))

    def call(  # noqa: C901, PLR0912  # one kind of argument after the other
        self, function: Any, arguments: list[Any], node: ast.AST
    ) -> Any:
        """Call of another kernel."""
        tree, _ = tree_of(function.py_func)
        if isinstance(tree.returns, ast.Name) and tree.returns.id in ("Array", "Integers"):
            return self.inlined(function.py_func, arguments, node)
        printed = self.printer.function(function, arguments)
        by_parameter = {a.arg: (a, v) for a, v in zip(tree.args.args, arguments, strict=True)}
        texts: list[str] = []
        passed_structs = set()
        passed: dict[str, Handle | View] = {}
        for p in printed.parameters:
            base, _, length = p.name.partition(".")
            parameter, value = by_parameter[base]
            if length:
                text = self.style.text(value.shape[0 if length in ("length", "rows") else 1])
            elif isinstance(value, Handle):
                if (value.struct, value.text) in passed_structs:
                    continue
                passed_structs.add((value.struct, value.text))
                text = value.pointer
            elif isinstance(value, View):
                offset = self.style.text(value.offset)
                text = value.text if offset == "0" else f"{value.text} + {offset}"
            else:
                is_float = getattr(parameter.annotation, "id", "") == "float"
                text = self.style.text(
                    value, kind=join([value.kind, "real"]) if is_float else value.kind
                )
            texts.append(text)
            if isinstance(value, (Handle, View)) and not length:
                passed[p.local] = value
                if p.local in printed.written:
                    if isinstance(value, View):
                        self.mark(value)
                    else:
                        self.written.add(value.owner)
        self.printer.calls.append((printed.name, self, passed))
        text = f"{printed.name}({', '.join(texts)})"
        if printed.result is None or isinstance(printed.result, Known):
            if printed.has_effect:
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
                self.visit(statement, [])
        finally:
            self.python, self.tree, self.comments, self.env = outer
        raise self.fail(node, "it gives no view at its end")
