"""Compiled kernels printed as C99, with everything folded in that is known of their memory.

The printer runs a kernel's Python source with values that are partly known. What no kernel writes
is known: sizes, switches and coefficients become literals and constant arrays, and choices
between them are made here. What kernels write becomes a named field of a C struct. Every
floating-point operation stays where it stands in the Python, so that the C gives the same bits.

The subset of Python: assignment, ``for ... in range``, ``if``, ``return``, ``continue``, ``break``,
arithmetic, comparisons, views and slices of arrays, `local_vector`s, calls of other
kernels, a few functions of `math`. A name that is read behind a loop or choice is set before it.
Anything else raises `Unprintable`.
"""

import ast
import builtins
import inspect
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import IntFlag
from importlib.resources import files
from itertools import chain, combinations, count
from struct import pack, unpack
from typing import Any, Final

import numpy as np
from numba.core.dispatcher import Dispatcher

from truejoint import compiled as marks
from truejoint import layout
from truejoint.export import c_values as c
from truejoint.export.c_values import Constant, Handle, Record, Side, Struct, Unprintable, kind_of
from truejoint.layout import Field, Memory

_MOST_ROUNDINGS: Final = 1e4


@dataclass
class _Parameter:
    name: str  # in C
    declaration: str
    source: str  # parameter of the Python
    text: Callable[[Any], str]  # of what a caller passes for that
    is_pointer: bool = False


class Function:
    """One kernel as a C function, for arguments of which something is known."""

    def __init__(self, printer: "Printer", python: Any, arguments: Sequence[Any]) -> None:
        self.printer, self.style = printer, printer.style
        self.python, self.arguments = python, arguments  # numbers, expressions, views and handles
        self.tree, self.comments = c.tree_of(python)
        self.body: list[c.Statement] = []  # what is printed
        self.out = self.body
        self.env: dict[str, Any] = {}
        self.written: set[str] = set()  # parameters through which it writes
        self.returns: list[tuple[c.Statement, Any]] = []
        self.parameters: list[_Parameter] = []
        self.loops: list[ast.For] = []
        self.declared: set[tuple[int, str]] = set()
        # What is printed, once it is finished.
        self.name = ""  # in C
        self.pointers: dict[str, bool] = {}  # whether it writes through them
        self.head: tuple[str, tuple[str, ...]] = "void", ()  # type of the result, parameters
        self.text = ""
        self.has_effect = False

    # ------------------------------------------------------------------ head and result

    def run(self) -> None:
        """Print the body."""
        for parameter, argument in zip(self.tree.args.args, self.arguments, strict=True):
            is_float = getattr(parameter.annotation, "id", "") == "float"
            self.env[parameter.arg] = self._parameter(parameter.arg, argument, is_float=is_float)
        self.block(self.tree.body)
        result = self.result
        for statement, value in self.returns:
            if result is not None and not isinstance(result, c.Known):
                statement.text = f"return {self.style.text(value, kind=result)}"
        if self.body and self.body[-1].text == "return":
            self.body.pop()
        body = c.without_unread(self.body, self.printer.has_effect)
        self.text = "\n".join(c.block_lines(body, self.style, 1))
        # Parameters, each once, that the text uses.
        used = set(c.NAME.findall(self.text))
        by_name = {p.name: p for p in reversed(self.parameters) if p.name in used}
        self.parameters = [p for p in self.parameters if by_name.get(p.name) is p]
        self.pointers = {p.name: p.name in self.written for p in self.parameters if p.is_pointer}
        kind = "void" if result is None or isinstance(result, c.Known) else self.style.type(result)
        declarations = (
            p.declaration if self.pointers.get(p.name, True) else f"const {p.declaration}"
            for p in self.parameters
        )
        self.head = kind, tuple(declarations)

    def _local(self, name: str) -> str:
        """Name of a local variable in C."""
        name = name.strip("_") or "turn"
        return f"{name}_" if name in c.RESERVED else name

    def _parameter(self, name: str, argument: Any, *, is_float: bool) -> Any:
        style, local = self.style, self._local(name)

        def declare(name_in_c: str, type_: str, text: Callable[..., str]) -> None:
            is_pointer = type_.endswith("*")
            declaration = f"{type_}{'' if is_pointer else ' '}{name_in_c}"
            self.parameters.append(_Parameter(name_in_c, declaration, name, text, is_pointer))

        if isinstance(argument, Handle):
            pointer = self._local(argument.struct.name)
            declare(pointer, f"{argument.struct.type} *", lambda handle: handle.pointer)
            return replace(argument, text=pointer, is_pointer=True, owner=pointer)
        if isinstance(argument, c.View):
            declare(local, f"{style.type(argument.kind)} *", lambda view: view.pointer_text(style))
            words = ("length",) if len(argument.shape) == 1 else ("rows", "columns")
            shape: list[c.Scalar] = []
            for axis, (length, word) in enumerate(zip(argument.shape, words, strict=True)):
                if isinstance(length, c.Known):
                    shape.append(c.Known(length.value))
                else:
                    hidden = self._local(f"{name}_{word}")
                    declare(hidden, "int", lambda view, axis=axis: style.text(view.shape[axis]))
                    shape.append(c.Expr(hidden, "int"))
            values = None
            if argument.values is not None and isinstance(argument.offset, c.Known):
                values = argument.values[argument.offset.value :]
            return c.View(local, c.Known(0), tuple(shape), argument.kind, (self, local), values)
        is_folded = isinstance(argument, c.Known) and argument.kind != "real" and not is_float
        if is_folded or not isinstance(argument, (c.Known, c.Expr)):
            return argument
        least: list[c.Kind] = ["real"] if is_float else []
        kind = c.join([argument.kind, *least])
        declare(local, style.type(kind), lambda v: style.text(v, kind=c.join([v.kind, *least])))
        return c.Variable(local, kind, assigned=2)

    @property
    def result(self) -> Any:
        """Known result, kind of the result, or None."""
        values = [value for _, value in self.returns]
        if not values or values[0] is None:
            return None
        first = values[0]
        numbers = [(type(v.value), v.value) if isinstance(v, c.Known) else v for v in values]
        is_number = isinstance(first, c.Known) and not (first.symbol and first.kind == "real")
        if is_number and all(number == numbers[0] for number in numbers):
            return first
        return c.join([value.kind for value in values])

    def need(self, is_so: object, node: ast.AST, why: str) -> None:
        """Raise Unprintable, which says where in the Python and `why`, unless something holds."""
        if not is_so:
            place = f"{self.python.__module__}.{self.python.__name__}"
            raise Unprintable(f"{place}, line {getattr(node, 'lineno', 0)}: {why}")

    def emit(self, text: str, target: c.Variable | None = None, **more: Any) -> None:
        """Add a statement."""
        self.out.append(c.Statement(text, target, **more))

    # ------------------------------------------------------------------ values

    def visit(self, node: ast.AST) -> Any:
        """Give what the method for this kind of node gives."""
        method: Any = getattr(self, f"_{type(node).__name__.lower()}", None)
        self.need(method, node, f"{type(node).__name__} has no C here")
        return method(node)

    def truth(self, node: ast.expr) -> Any:
        """Value of a test."""
        value = self.visit(node)
        return c.Known(bool(value.value)) if isinstance(value, c.Known) else value

    def lookup(self, node: Any) -> Any:
        """Object that a global name or attribute stands for."""
        if isinstance(node, ast.Attribute):
            return getattr(self.lookup(node.value), node.attr)
        names = {**vars(builtins), **self.python.__globals__}
        self.need(getattr(node, "id", "") in names, node, "this is no name that is known here")
        return names[node.id]

    def _constant(self, node: ast.Constant) -> c.Known:
        self.need(isinstance(node.value, (bool, int, float)), node, f"{node.value!r} is no number")
        return c.Known(node.value)

    def _name(self, node: ast.Name) -> Any:
        if node.id in self.env:
            held = self.env[node.id]
            if not isinstance(held, c.Variable):
                return held
            held.is_read = True
            return c.Expr(held.name, held.kind)
        return self.constant(node, node.id)

    def _attribute(self, node: ast.Attribute) -> Any:
        if node.attr == "shape":
            return self.visit(node.value).shape
        record = self.env.get(node.value.id) if isinstance(node.value, ast.Name) else None
        if not isinstance(record, Record):
            is_member = node.attr == "value"
            return self.constant(node, self.lookup(node.value).name if is_member else node.attr)
        memory = record.numbers.struct.memory
        f = memory.layout.fields[node.attr]
        side = record.memory if f.kind in ("scalar", "array") else record.numbers
        place = self.cell(record.numbers if f.shape else side, c.Known(f.index), node, write=False)
        if not f.shape:
            return place
        return self.printer.view(side, place, tuple(map(c.Known, memory.shapes[f.name])))

    def constant(self, node: ast.expr, name: str) -> Any:
        """Give what a global name stands for, a number by the name that C has for it."""
        value = self.lookup(node)
        if isinstance(value, np.generic):
            value = value.item()
        if not isinstance(value, (int, float)):
            return value
        name = name.strip("_").upper()
        if isinstance(value, (bool, layout.Index)) or not np.isfinite(value):
            return c.Known(value)
        for enum, prefix in self.printer.enums.items():
            if enum.__members__.get(name) == value:
                return c.Known(value, prefix + name)
        shown, roundings = value, value / float(np.finfo(np.float64).eps)
        if self.style.single and 0.0 < roundings < _MOST_ROUNDINGS and roundings.is_integer():
            # A whole number of roundings of a double is meant in roundings of the arithmetic.
            shown = roundings * float(np.finfo(np.float32).eps)
        return c.Known(value, self.printer.define(name, shown))

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            value = self.truth(node.operand)
            if isinstance(value, c.Known):
                return c.Known(not value.value)
            return c.Expr(f"!{self.style.text(value, c.UNARY)}", "bool", c.UNARY)
        value = self.visit(node.operand)
        if isinstance(node.op, ast.UAdd):
            return value
        if isinstance(value, c.Known):
            text = f"-{self.style.text(value, c.UNARY + 1)}" if value.symbol else ""
            return c.Known(-value.value, text, c.UNARY)
        if value.kind in ("int", "bool"):
            return c.scale(value, -1)
        return c.Expr(f"-{self.style.text(value, c.UNARY + 1)}", value.kind, c.UNARY)

    def _boolop(self, node: ast.BoolOp) -> Any:
        both = isinstance(node.op, ast.And)
        parts: list[Any] = []
        for item in node.values:
            place = len(self.out)
            value = self.truth(item)
            is_first = not parts or len(self.out) == place
            self.need(is_first, item, "its calls cannot wait for what stands before them")
            if not isinstance(value, c.Known):
                parts.append(value)
            elif value.value != both:  # what follows is never looked at
                if not any(self.printer.has_effect(part.text) for part in parts):
                    return value
                parts.append(value)
                break
        if len(parts) < 2:
            return parts[0] if parts else c.Known(both)
        sign, level = ("&&", c.AND) if both else ("||", c.OR)
        needed = (level if part.level == level else c.BIT_OR for part in parts)
        text = f" {sign} ".join(map(self.style.text, parts, needed))
        return c.Expr(text, "bool", level)

    def _ifexp(self, node: ast.IfExp) -> Any:
        test = self.truth(node.test)
        if isinstance(test, c.Known):
            return self.visit(node.body if test.value else node.orelse)
        place = len(self.out)
        values = [self.visit(node.body), self.visit(node.orelse)]
        self.need(len(self.out) == place, node, "one of its values needs statements of its own")
        kind = c.join([v.kind for v in values])
        yes, no = (self.style.text(v, c.CHOICE + 1, kind) for v in values)
        return c.Expr(f"{self.style.text(test, c.CHOICE + 1)} ? {yes} : {no}", kind, c.CHOICE)

    def _compare(self, node: ast.Compare) -> Any:
        values = [self.visit(n) for n in (node.left, *node.comparators)]
        parts: list[Any] = []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            sign, level, compute = c.COMPARISONS[type(op)]
            if isinstance(a, c.Known) and isinstance(b, c.Known):
                if not compute(a.value, b.value):
                    return c.Known(False)
                continue
            kind = c.join([a.kind, b.kind])
            first, right = (self.style.text(v, level + 1, kind) for v in (a, b))
            parts.append(c.Expr(f"{first} {sign} {right}", "bool", level))
        if len(parts) < 2:
            return parts[0] if parts else c.Known(True)
        return c.Expr(" && ".join(p.text for p in parts), "bool", c.AND)

    def _binop(self, node: ast.BinOp) -> Any:
        a, b = self.visit(node.left), self.visit(node.right)
        if not isinstance(node.op, ast.Pow):
            return c.operate(self.style, node.op, a, b)
        self.need(isinstance(b, c.Known) and b.value == 2, node, "of powers only squares have C")
        if isinstance(a, c.Known):
            return c.operate(self.style, ast.Mult(), a, a)
        if isinstance(a, c.Expr) and not a.base and re.fullmatch(r"[\w.>\-\[\]]+", a.text):
            return c.Expr(f"{a.text} * {a.text}", a.kind, c.PRODUCT)
        return c.Expr(f"square_{a.kind}({self.style.text(a)})", a.kind)

    # ------------------------------------------------------------------ arrays

    def _subscript(self, node: ast.Subscript) -> Any:
        base = self.visit(node.value)
        if isinstance(base, tuple):  # a shape
            return base[self.visit(node.slice).value]
        return self.item(base, node.slice, node)

    def item(self, base: Any, index: ast.expr, node: ast.AST, *, write: bool = False) -> Any:
        """Element, row or slice of a view, or a cell of a memory."""
        if isinstance(base, Handle) and not isinstance(index, ast.Slice):
            return self.cell(base, self.visit(index), node, write=write)
        self.need(isinstance(base, c.View), node, "this is no array, nor a view of a field")
        if isinstance(index, ast.Slice):
            lower = c.Known(0) if index.lower is None else self.visit(index.lower)
            upper = base.shape[0] if index.upper is None else self.visit(index.upper)
            has_it = len(base.shape) == 1 and index.step is None
            self.need(has_it, node, "only a vector has such slices")
            return base.part(lower, (c.add(upper, lower, -1),))
        if isinstance(index, ast.Tuple):
            row, column = index.elts
            return self.item(self.row(base, self.visit(row)), column, node)
        where = self.visit(index)
        return self.row(base, where) if len(base.shape) == 2 else self.element(base, where)

    def row(self, base: c.View, index: c.Scalar) -> c.View:
        """Row of a matrix."""
        columns = base.shape[1]
        if isinstance(columns, c.Known):
            offset = c.scale(index, columns.value)
        else:
            a, b = self.style.text(index, c.PRODUCT), self.style.text(columns, c.PRODUCT + 1)
            offset = c.Expr(f"{a} * {b}", "int", c.PRODUCT)
        return base.part(offset, (columns,))

    def element(self, view: c.View, index: c.Scalar) -> Any:
        """Element of a vector: known where the array is constant and the place is known."""
        place = c.add(view.offset, index)
        values, text = view.values, f"{view.text}[{self.style.text(place)}]"
        if values is not None and len(values):
            if isinstance(place, c.Known) and 0 <= place.value < len(values):
                return c.named(values[place.value].item(), text)
            bits, first = values.tobytes(), c.named(values[0].item(), text)
            if not first.symbol and bits == bits[: values.itemsize] * len(values):
                return first
        return c.Expr(text, view.kind)

    def place(self, node: ast.Subscript) -> c.Expr:
        """Element as something that is assigned to."""
        base = self.visit(node.value)
        if isinstance(base, c.View):
            self.mark(base)
            base = replace(base, values=None)
        element = self.item(base, node.slice, node, write=True)
        assert isinstance(element, c.Expr)  # noqa: S101  # what is written is not known
        return element

    def mark(self, view: Any) -> None:
        """Note that an array, or what a handle leads to, is written."""
        if isinstance(view, Handle):
            self.written.add(view.owner)
            return
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
        is_place = isinstance(index, c.Known) and index.origin is None
        f = struct.fields.get((base.side, index.value)) if is_place else None
        if f is None:  # within an array
            view = self.printer.view(base, index, (c.Known(1),))
            if write:
                self.mark(view)
                view = replace(view, values=None)
            return self.element(view, c.Known(0))
        if f.kind not in ("scalar", "integer"):
            self.need(not write, node, f"field {f.name} is no number that can change")
            return c.Known(int(struct.memory.numbers[index.value]), origin=(struct, f))
        if write:
            struct.written.add(f.name)
            self.written.add(base.owner)
        if f.name in struct.written:
            return c.Expr(base.field_text(f.name), kind_of(f, self.style))
        return c.named(struct.values(f)[0].item(), self.printer.table(struct, f))

    # ------------------------------------------------------------------ calls

    def _call(self, node: ast.Call) -> Any:  # noqa: PLR0911  # one kind of call after the other
        function = self.lookup(node.func)
        self.need(not node.keywords, node, "keywords have no C")
        if function in (marks.local_vector, marks.local_matrix):
            shape = tuple(self.visit(n) for n in node.args)
            self.need(all(isinstance(n, c.Known) for n in shape), node, "its size is not known")
            # It gets the name that it is assigned to.
            return c.View("", c.Known(0), shape, "real", (self, ""))
        arguments = [self.visit(a) for a in node.args]
        if getattr(function, "gives_fields", False):
            return Record(*arguments)
        if function in (marks.vector, marks.matrix):
            base, place, *sizes = arguments
            if isinstance(base, c.View):
                return base.part(place, tuple(sizes))
            self.need(isinstance(base, Handle), node, "this is no memory")
            return self.printer.view(base, place, tuple(sizes))
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
        value = c.call_builtin(self.style, name, arguments)
        self.need(value is not None, node, f"{name or 'this function'} has no C here")
        return value

    def call(self, function: Any, arguments: list[Any], node: ast.AST) -> Any:
        """Call of another kernel."""
        tree, _ = c.tree_of(function.py_func)
        gives = getattr(tree.returns, "id", "")
        self.need(gives not in ("Array", "Integers"), node, "a kernel gives an array: no C")
        printed = self.printer.function(function, arguments)
        values = dict(zip((a.arg for a in tree.args.args), arguments, strict=True))
        passed = {p.name: values[p.source] for p in printed.parameters if p.is_pointer}
        for name in passed.keys() & printed.written:
            self.mark(passed[name])
        texts = [p.text(values[p.source]) for p in printed.parameters]
        self.printer.calls.append((printed.name, self, passed))
        text = f"{printed.name}({', '.join(texts)})"
        if printed.result is None or isinstance(printed.result, c.Known):
            if printed.has_effect:
                self.emit(text)
            return printed.result
        return c.Expr(text, printed.result)

    # ------------------------------------------------------------------ statements

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Print statements; whether control never goes on behind them."""
        for statement in body:
            comment = self.comments.get(statement.lineno)
            place = len(self.out)
            ends = self.visit(statement)
            if comment and len(self.out) > place:
                self.out.insert(place, c.Statement(comment, comment=True))
            if ends:
                return True
        return False

    def _pass(self, s: ast.Pass) -> None:
        """Print nothing."""

    def _expr(self, s: ast.Expr) -> None:
        if not isinstance(s.value, ast.Constant):
            value = self.visit(s.value)
            if isinstance(value, c.Expr):
                self.emit(value.text)

    def _return(self, s: ast.Return) -> bool:
        value = None if s.value is None else self.visit(s.value)
        self.emit("return")
        self.returns.append((self.out[-1], value))
        return True

    def _continue(self, s: ast.stmt) -> bool:
        self.need(self.loops, s, "it leaves a loop that is unrolled")
        self.emit(type(s).__name__.lower())
        return True

    _break = _continue

    def _assign(self, s: ast.Assign | ast.AnnAssign) -> None:
        if s.value is None:
            return
        targets: Sequence[ast.expr] = s.targets if isinstance(s, ast.Assign) else [s.target]
        if isinstance(targets[0], ast.Tuple):
            assert isinstance(s.value, ast.Tuple)  # noqa: S101  # kernels return no tuples
            targets, values = targets[0].elts, [self.visit(e) for e in s.value.elts]
        else:
            values = [self.visit(s.value)] * len(targets)
        for target, value in zip(targets, values, strict=True):
            self.assign(target, value)

    _annassign = _assign

    def assign(self, target: ast.expr, value: Any) -> None:
        """Print one assignment."""
        if isinstance(target, ast.Subscript):
            place = self.place(target)
            self.emit(f"{place.text} = {self.style.text(value, kind=place.kind)}")
            return
        assert isinstance(target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = target.id
        held = self.env.get(name)
        variable = held if isinstance(held, c.Variable) else None
        if isinstance(value, c.View):
            self.env[name] = self.pointer(name, value) if value.text else self.array(name, value)
        elif variable is None and isinstance(value, (c.Known, Handle, Record)):
            self.env[name] = value
        else:
            self.need(value is not None, target, "a call gives nothing to assign")
            self.set_variable(name, value, variable)

    def set_variable(self, name: str, value: c.Scalar, variable: c.Variable | None) -> None:
        """Print an assignment to a variable, which is declared if it is not yet."""
        declares = variable is None
        if variable is None:
            self.env[name] = variable = c.Variable(self._local(name), value.kind)
        self.grow(variable, value.kind)
        variable.assigned += 1
        self.emit(self.style.text(value, kind=variable.kind), variable, declares=declares)

    def grow(self, variable: c.Variable, kind: c.Kind) -> None:
        """Let a variable hold numbers of a kind, too, unless it was read as what it was."""
        kind = c.join([variable.kind, kind])
        changes = {variable.kind, kind} - {"bool", "int"} and kind != variable.kind
        why = f"{variable.name} begins as {variable.kind} and becomes {kind}; begin it so"
        self.need(not (variable.is_read and changes), self.tree, why)
        variable.kind = kind

    def array(self, name: str, view: c.View) -> c.View:
        """Declare a local array, for a name."""
        local, size = self._local(name), 1
        for length in view.shape:
            size *= length.value  # type: ignore[union-attr]  # `_call` knows it
        self.emit(f"{self.style.type(view.kind)} {local}[{size}]")
        return replace(view, text=local, root=(self, local))

    def pointer(self, name: str, view: c.View) -> c.View:
        """View for a name: itself where its place is known, else through a local pointer."""
        if isinstance(view.offset, c.Known) or view.text == name:
            return view
        local = self._local(name)
        while (id(self.out), local) in self.declared:
            local += "_"
        self.declared.add((id(self.out), local))
        variable = c.Variable(local, view.kind, is_pointer=True, assigned=1)
        self.emit(f"{view.text} + {self.style.text(view.offset)}", variable, declares=True)
        return replace(view, text=local, offset=c.Known(0), pointer=(variable, view), values=None)

    def _augassign(self, s: ast.AugAssign) -> None:
        sign = c.ARITHMETIC[type(s.op)][0]
        value = self.visit(s.value)
        if isinstance(s.target, ast.Subscript):
            place = self.place(s.target)
            self.emit(f"{place.text} {sign}= {self.style.text(value, kind=place.kind)}")
            return
        assert isinstance(s.target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = s.target.id
        held = self.env.get(name)
        if not isinstance(held, c.Variable):
            load = ast.copy_location(ast.Name(name, ast.Load()), s.target)
            self.assign(s.target, c.operate(self.style, s.op, self.visit(load), value))
        elif not (isinstance(s.op, ast.BitOr) and value == c.Known(0)):
            held.is_read = True
            self.grow(held, value.kind)
            held.assigned += 1
            self.emit(self.style.text(value, kind=held.kind), held, operator=f"{sign}=")

    # ------------------------------------------------------------------ loops and choices

    def prepare(self, *body: ast.stmt) -> None:
        """Make variables of what a loop or choice changes and is known so far."""
        for name in sorted(c.assigned(*body)):
            held = self.env.get(name)
            if isinstance(held, c.Known):
                self.set_variable(name, held, None)
                self.env[name].assigned += 1

    def inner(self, head: str, body: Sequence[ast.stmt], env: dict[str, Any]) -> tuple[Any, bool]:
        """Print the body of a loop or branch, whose own names end with it."""
        out, outer = self.out, self.env
        self.out, self.env = [], {**outer, **env}
        ends = self.block(body)
        block = c.Statement(head, body=self.out)
        self.out, self.env = out, outer
        return block, ends

    def _for(self, s: ast.For) -> bool:
        """Print a loop, or its rounds one by one where they are few or marked."""
        assert isinstance(s.target, ast.Name)  # noqa: S101  # ranges give numbers
        called: Any = s.iter
        is_range = getattr(getattr(called, "func", None), "id", "") == "range"
        self.need(is_range, s, "only a range has C")
        marked = any(
            isinstance(n, ast.Call) and self.lookup(n.func) is marks.unrolled for n in called.args
        )
        bounds = [self.visit(a) for a in called.args]
        start = bounds.pop(0) if len(bounds) > 1 else c.Known(0)
        stop, step = (*bounds, c.Known(1))[:2]
        self.need(isinstance(step, c.Known), s, "the step of a range is not known")
        if isinstance(start, c.Known) and isinstance(stop, c.Known):
            rounds = range(start.value, stop.value, step.value)
            if not rounds or marked or (len(rounds) == 1 and not c.leaves_early(s)):
                loops, self.loops, ends = self.loops, [], False
                for number in rounds:
                    self.env[s.target.id] = c.Known(number)
                    ends = ends or self.block(s.body)
                self.loops = loops
                return ends
        self.need(not marked, s, "the rounds of an unrolled loop are not known")
        self.need(step.value >= -1, s, "a range goes down by one only")
        self.prepare(*s.body)
        name = self._local(s.target.id)
        way = {1: f"{name}++", -1: f"{name}--"}.get(step.value, f"{name} += {step.value}")
        sign, end = ">" if step.value < 0 else "<", self.style.text(stop, c.ORDER + 1)
        head = f"for (int {name} = {self.style.text(start)}; {name} {sign} {end}; {way})"
        self.loops.append(s)
        block, _ = self.inner(head, s.body, {s.target.id: c.Expr(name, "int")})
        self.loops.pop()
        self.out.append(block)
        return False

    def _if(self, s: ast.If) -> bool:
        """Print a choice, or what is chosen where that is known."""
        test = self.truth(s.test)
        if isinstance(test, c.Known):
            return self.block(s.body if test.value else s.orelse)
        self.prepare(*s.body, *s.orelse)
        chosen, ends = self.inner(f"if ({self.style.text(test)})", s.body, {})
        other, also = self.inner("else", s.orelse, {})
        first, *rest = other.body or [other]
        if (
            first.body is not None
            and first.text.startswith("if (")
            and all(s.body is not None and s.text.startswith("else") for s in rest)
        ):
            first.text = f"else {first.text}"
            self.out += [chosen, *other.body]
        else:
            self.out += [chosen, other] if other.body else [chosen]
        return ends and also


_WIDE: Final = (files(__package__) / "templates/wide.h").read_text("utf-8")
_COMPARED: Final = "of two numbers; the first where they do not compare."
_HELPERS: Final = (
    ("min", "{0} a, {0} b", f"The smaller {_COMPARED}", "b < a ? b : a"),
    ("max", "{0} a, {0} b", f"The larger {_COMPARED}", "b > a ? b : a"),
    ("square", "{0} a", "Square of a number.", "a * a"),
    ("sign", "{0} a", "Sign of a number: -1, 0 or 1.", "a > {0} ? {1} : a < {0} ? -{1} : a"),
)


@dataclass(frozen=True)
class Program:
    """Kernels in C."""

    structs: str  # typedefs of what they change; the last is that of the whole memory
    initial: str  # initialiser of the whole memory before the first step
    constants: str  # named numbers and arrays
    functions: str  # each before it is used
    numbers: tuple[Constant, ...]  # that the C computes with
    names: tuple[str, ...]  # functions of the kernels asked for; each takes a pointer to the struct
    flash: int  # bytes of the numbers that do not change
    ram: int  # bytes of the struct

    @property
    def digest(self) -> int:
        """What `digest.c.j2` makes of the numbers: of FNV-1a, with 64 bits at a time."""
        digest = 0
        for number in chain.from_iterable(constant.numbers for constant in self.numbers):
            (bits,) = unpack("<Q", pack("<d", number))
            digest = ((digest ^ bits) * 1099511628211) % 2**64
            digest ^= digest >> 32
        return digest


def print_kernels(
    kernels: Sequence[Any],
    memory: Memory,
    name: str,
    type_: str,
    *,
    single: bool = False,
    inputs: Iterable[str] = (),
    enums: Mapping[type[IntFlag], str] | None = None,
    named: Mapping[str, str] | None = None,
) -> Program:
    """Print kernels of arguments ``numbers, memory``, of a `memory` before the first step.

    In C, pointers to it have the `name`, its struct the type ``<prefix>_state`` and those of its
    parts ``<prefix>_<part>_state``. `single`: in float; `inputs`: fields that are written from
    outside; `enums`: prefixes by which C knows their members; `named`: names of what fields hold at
    first.
    Raises Unprintable for what has no C.
    """
    struct = Struct(name, type_, memory, set(inputs))
    sides: tuple[Side, Side] = ("numbers", "memory")
    arguments = [Handle(struct, side, name, is_pointer=True, owner=name) for side in sides]
    while True:  # the first round finds what the kernels change
        before = [len(part.written) for part in struct.walk()]
        printer = Printer(c.Style(single), enums or {})
        names = tuple(printer.function(kernel, arguments).name for kernel in kernels)
        if [len(part.written) for part in struct.walk()] == before:
            return printer.program(struct, names, named or {})


class Printer:
    """All functions of one program, in one pass over its kernels."""

    def __init__(self, style: c.Style, enums: Mapping[type[IntFlag], str]) -> None:
        self.style = style
        self.enums = enums
        self.tables: dict[tuple[Struct, Field], str] = {}  # names of constants of the memory
        self.defines: dict[str, Any] = {}  # and of constant numbers
        self.names: set[str] = set()  # at file scope
        self.functions: dict[str, Function] = {}
        self.calls: list[tuple[str, Function, dict[str, Any]]] = []
        self._bodies: dict[tuple[Any, ...], Function] = {}
        self._done: dict[tuple[Any, ...], Function] = {}

    def function(self, kernel: Any, arguments: Sequence[Any]) -> Function:
        """Print a kernel for such arguments, unless that is done."""
        python = kernel.py_func if isinstance(kernel, Dispatcher) else kernel
        key = (python, *(_key(argument) for argument in arguments))
        if key in self._done:
            return self._done[key]
        function = Function(self, python, arguments)
        function.run()
        identity = (python, function.head, function.text)
        if identity not in self._bodies:
            wanted = python.__name__.strip("_")
            longer = f"{python.__module__.rpartition('.')[2]}_{wanted}"
            if any(p is python for p, *_ in self._bodies):
                longer = wanted
            function.name = self.name(longer if wanted in c.RESERVED else wanted, longer)
            function.has_effect = bool(function.written) or self.has_effect(function.text)
            self.functions[function.name] = self._bodies[identity] = function
        self._done[key] = self._bodies[identity]
        function.name = self._done[key].name  # its calls have been noted, and name their caller
        return self._done[key]

    def name(self, wanted: str, longer: str) -> str:
        """Free name: the wanted one, the longer one, or that with a number."""
        options = chain((wanted, longer), (f"{longer}_{i}" for i in count(2)))
        free = next(option for option in options if option not in self.names)
        self.names.add(free)
        return free

    def define(self, name: str, value: Any) -> str:
        """Name of a constant number of a module."""
        for option in chain((name,), (f"{name}_{i}" for i in count(2))):
            held = self.defines.setdefault(option, value)
            if held == value and isinstance(held, type(value)):
                self.names.add(option)
                return option
        raise AssertionError  # there is always another

    def view(self, handle: Handle, place: c.Scalar, shape: tuple[c.Scalar, ...]) -> c.View:
        """View of a struct's flat memory from a place on, as a part of the array there."""
        struct = handle.struct
        if place.origin is None or place.origin[0] is not struct:
            raise Unprintable(f"{struct.name}: a view begins at no field of its {handle.side}")
        f: Field = place.origin[1]
        start = c.Known(int(struct.memory.numbers[f.index]), origin=(struct, f))
        offset = c.add(place, start, -1)
        kind, root = kind_of(f, self.style), (struct, f.name)
        if f.name in struct.written:
            return c.View(handle.field_text(f.name), offset, shape, kind, root)
        return c.View(self.table(struct, f), offset, shape, kind, root, struct.values(f))

    def table(self, struct: Struct, f: Field) -> str:
        """Name of what a field that nothing writes is in C."""
        return self.tables.setdefault((struct, f), f"{struct.type.removesuffix('_state')}_{f.name}")

    def has_effect(self, text: str) -> bool:
        """Whether a text calls a function that changes something."""
        called = re.findall(r"(\w+)\(", text)
        return any(n in self.functions and self.functions[n].has_effect for n in called)

    def program(self, struct: Struct, names: tuple[str, ...], named: Mapping[str, str]) -> Program:
        """Put the printed functions together, without those that nothing calls."""
        used = set(names)
        for name, printed in reversed(self.functions.items()):  # each after those that it calls
            if name in used:
                used |= set(re.findall(r"(\w+)\(", printed.text))
        printed_functions = [printed for name, printed in self.functions.items() if name in used]
        source = "\n\n".join(self._text(printed) for printed in printed_functions)
        if any(getattr(printed.python, "is_wide", False) for printed in printed_functions):
            source = f"{_WIDE}\n{source}"
        words = set(re.findall(r"\w+", re.sub(r"/\*.*?\*/", "", source, flags=re.DOTALL)))
        constants = [
            Constant(name, (str(value) if isinstance(value, int) else self.style.literal(value),))
            for name, value in self.defines.items()
            if name in words
        ]
        lines = [f"#define {constant.name} {constant.texts[0]}" for constant in constants]
        tables = []
        for (owner, f), name in self.tables.items():
            if name in words:
                constants.append(owner.constant(f, name, self.style))
                tables.append(_definition(constants[-1], f, self.style))
        helpers = [text for name, text in _helpers(self.style).items() if name in words]
        flash = sum(len(each.texts) * self.style.dtype(each.type).itemsize for each in constants)
        return Program(
            "\n\n".join(part.declaration(self.style) for part in struct.walk() if part.changes),
            "\n".join(struct.initial(self.style, named)),
            "\n\n".join(filter(None, ["\n".join(lines), *tables])),
            "\n\n".join([*helpers, source]),
            (*constants, *struct.initial_constants(self.style, "initial.")),
            names,
            flash,
            struct.dtype(self.style).itemsize,
        )

    def _text(self, printed: Function) -> str:
        """Definition of a function, its pointers restricted where no call lets them overlap."""
        result_type, parameters = printed.head
        written = printed.pointers.values()
        if len(written) > 1 and any(written) and self._apart(printed.name, ()):
            parameters = tuple(re.sub(r"\*(?=\w+$)", "*restrict ", p) for p in parameters)
        head = f"static {result_type} {printed.name}({', '.join(parameters) or 'void'})"
        doc = inspect.cleandoc(printed.python.__doc__ or "").split("\n\n")[0]
        about = doc.replace("\n", " ").replace("`", "").replace("*/", "")
        lines = c.wrapped_comment(about, "") if about else []
        lines += ["WIDE"] if getattr(printed.python, "is_wide", False) else []
        return "\n".join([*lines, *c.wrapped(head, ""), "{", *filter(None, [printed.text]), "}"])

    def _apart(self, name: str, callers: tuple[str, ...]) -> bool:
        """Whether no call of a function passes pointers to the same numbers."""
        pointers = self.functions[name].pointers
        for callee, caller, arguments in self.calls:
            passed = [(pointers[p], a) for p, a in arguments.items() if p in pointers]
            if callee != name or callee in callers:
                continue
            for (written, a), (also, b) in combinations(passed, 2):
                if not (written or also):
                    continue
                if isinstance(a, Handle) or isinstance(b, Handle):
                    return False
                if a.root == b.root:
                    if not (a.ends_before(b) or b.ends_before(a)):
                        return False
                elif not (
                    all(isinstance(view.root[0], Struct) for view in (a, b))
                    or self._apart(caller.name, (*callers, name))
                ):
                    return False
        return True


def _definition(constant: Constant, f: Field, style: c.Style) -> str:
    """Definition of a constant, with what it means."""
    head = f"/* {f.meaning} */\nstatic const {style.type(kind_of(f))} {constant.name}"
    if not constant.type:
        return f"{head} = {constant.texts[0]};"
    first, *rest = c.wrapped(", ".join(constant.texts), "    ")
    body = "\n".join([first, *(line[4:] for line in rest)])
    return f"{head}[{len(constant.texts)}] = {{\n{body}\n}};"


def _helpers(style: c.Style) -> dict[str, str]:
    """Small functions by name, for each kind of number."""
    kinds: tuple[c.Kind, ...] = ("real", "time", "int") if style.single else ("real", "int")
    texts = {}
    for kind in kinds:
        type_ = style.type(kind)
        suffix = "f" if type_ == "float" else ""
        for name, parameters, about, result in _HELPERS:
            texts[f"{name}_{kind}"] = (
                f"/* {about} */\nstatic {type_} {name}_{kind}({parameters.format(type_)})\n"
                f"{{\n    return {result.format(f'0.0{suffix}', f'1.0{suffix}')};\n}}"
            )
    return texts


def _key(argument: Any) -> Any:
    """Reduce an argument to what decides how a function is printed."""
    if isinstance(argument, c.Known):
        return (argument.value, argument.symbol, argument.origin)
    if isinstance(argument, c.Expr):
        return argument.kind
    if isinstance(argument, c.View):
        shape = tuple(n.value if isinstance(n, c.Known) else None for n in argument.shape)
        is_known = argument.values is not None and isinstance(argument.offset, c.Known)
        return (argument.kind, shape, (argument.root, argument.offset.value) if is_known else None)  # type: ignore[union-attr]
    if isinstance(argument, Handle):
        return (argument.struct, argument.side)
    return argument
