"""Statements of a kernel as a C function."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from truejoint import compiled as marks
from truejoint.export.c_expressions import Expressions
from truejoint.export.c_operators import ARITHMETIC, RESERVED, operate
from truejoint.export.c_statements import (
    NAME,
    Block,
    Body,
    Statement,
    Variable,
    block_lines,
    without_unread,
)
from truejoint.export.c_structs import Handle, Record, Unprintable
from truejoint.export.c_syntax import assigned, first_use
from truejoint.export.c_values import ORDER, UNARY, Expr, Kind, Known, Linear, Scalar, View, join


@dataclass
class _Parameter:
    local: str
    name: str  # in Python; of a length, that of the array and what it counts
    declaration: str
    is_pointer: bool = False


@dataclass(eq=False)
class Function(Expressions):
    """One kernel as a C function, for arguments of which something is known."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.returns: list[tuple[Statement, Any]] = []
        self.parameters: list[_Parameter] = []
        self.loops: list[ast.For] = []
        self.declared: set[tuple[int, str]] = set()
        # What is printed, once it is finished.
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
            if result is not None and not isinstance(result, Known):
                statement.text = f"return {self.style.text(value, kind=result)}"
        last = self.body[-1] if self.body else None
        if isinstance(last, Statement) and last.text == "return":
            self.body.pop()
        self.finish(without_unread(self.body, set(), self.printer.has_effect))

    def _local(self, name: str) -> str:
        """Name of a local variable in C."""
        name = name.strip("_") or "turn"
        return f"{name}_" if name in RESERVED else name

    def _parameter(self, name: str, argument: Any, *, is_float: bool) -> Any:
        add, local = self.parameters.append, self._local(name)
        if isinstance(argument, Handle):
            pointer = self._local(argument.struct.name)
            add(_Parameter(pointer, name, f"{argument.struct.type} *{pointer}", is_pointer=True))
            return Handle(argument.struct, argument.side, pointer, is_pointer=True, owner=pointer)
        if isinstance(argument, View):
            add(_Parameter(local, name, f"{self.style.type(argument.kind)} *{local}", True))
            words = ("length",) if len(argument.shape) == 1 else ("rows", "columns")
            shape: list[Scalar] = []
            for length, word in zip(argument.shape, words, strict=True):
                if isinstance(length, Known):
                    shape.append(Known(length.value))
                else:
                    hidden = self._local(f"{name}_{word}")
                    add(_Parameter(hidden, f"{name}.{word}", f"int {hidden}"))
                    shape.append(Expr(hidden, "int"))
            values = None
            if argument.values is not None and isinstance(argument.offset, Known):
                values = argument.values[argument.offset.value :]
            start = Known(0)
            return View(local, start, tuple(shape), argument.kind, (self, local), start, values)
        is_folded = isinstance(argument, Known) and argument.kind != "real" and not is_float
        if is_folded or not isinstance(argument, (Known, Expr, Linear)):
            return argument
        kind: Kind = join([argument.kind, "real"]) if is_float else argument.kind
        add(_Parameter(local, name, f"{self.style.type(kind)} {local}"))
        return Variable(local, kind, assigned=2)

    def finish(self, body: Body) -> None:
        """Make the text of these statements, and keep the parameters (each once) that they use."""
        self.text = "\n".join(block_lines(body, self.style, 1))
        used = set(NAME.findall(self.text))
        by_local = {p.local: p for p in reversed(self.parameters) if p.local in used}
        self.parameters = [p for p in self.parameters if by_local.get(p.local) is p]
        self.pointers = {p.local: p.local in self.written for p in self.parameters if p.is_pointer}
        result = self.result
        kind = "void" if result is None or isinstance(result, Known) else self.style.type(result)
        self.head = (
            kind,
            tuple(
                p.declaration if self.pointers.get(p.local, True) else f"const {p.declaration}"
                for p in self.parameters
            ),
        )

    @property
    def result(self) -> Any:
        """Known result, kind of the result, or None."""
        values = [value for _, value in self.returns]
        if not values or values[0] is None:
            return None
        first = values[0]
        if isinstance(first, Known) and all(
            isinstance(v, Known) and v.value == first.value and type(v.value) is type(first.value)
            for v in values
        ):
            return first
        return join([value.kind for value in values])

    # ------------------------------------------------------------------ statements

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Print statements; whether control never goes on behind them."""
        for i, statement in enumerate(body):
            comment = self.comments.get(statement.lineno)
            place = len(self.out)
            ends = self.visit(statement, body[i + 1 :])
            if comment and len(self.out) > place:
                self.out.insert(place, Statement(comment, comment=True))
            if ends:
                return True
        return False

    def _pass(self, s: ast.Pass, rest: Sequence[ast.stmt]) -> None:
        """Print nothing."""

    def _expr(self, s: ast.Expr, rest: Sequence[ast.stmt]) -> None:  # noqa: ARG002
        if not isinstance(s.value, ast.Constant):
            value = self.value(s.value)
            if isinstance(value, Expr):
                self.emit(value.text)

    def _return(self, s: ast.Return, rest: Sequence[ast.stmt]) -> bool:  # noqa: ARG002
        value = None if s.value is None else self.value(s.value)
        self.emit("return")
        self.returns.append((self.out[-1], value))  # type: ignore[arg-type]  # it was emitted
        return True

    def _continue(self, s: ast.stmt, rest: Sequence[ast.stmt]) -> bool:  # noqa: ARG002
        if not self.loops:
            raise self.fail(s, "it leaves a loop that is unrolled")
        self.emit(type(s).__name__.lower())
        return True

    _break = _continue

    def _assign(self, s: ast.Assign, rest: Sequence[ast.stmt]) -> None:  # noqa: ARG002
        targets: Sequence[ast.expr] = s.targets
        if isinstance(targets[0], ast.Tuple):
            assert isinstance(s.value, ast.Tuple)  # noqa: S101  # kernels return no tuples
            targets, values = targets[0].elts, [self.value(e) for e in s.value.elts]
        else:
            values = [self.value(s.value)] * len(targets)
        for target, value in zip(targets, values, strict=True):
            self.assign(target, value)

    def _annassign(self, s: ast.AnnAssign, rest: Sequence[ast.stmt]) -> None:  # noqa: ARG002
        if s.value is not None:
            self.assign(s.target, self.value(s.value))

    def assign(self, target: ast.expr, value: Any) -> None:
        """Print one assignment."""
        if isinstance(target, ast.Subscript):
            self.store(target, value)
            return
        assert isinstance(target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = target.id
        held = self.env.get(name)
        variable = held if isinstance(held, Variable) else None
        if isinstance(value, View):
            self.env[name] = self.pointer(name, value) if value.text else self.array(name, value)
        elif variable is None and isinstance(value, (Known, Handle, Record)):
            self.env[name] = value
        elif value is None:
            raise self.fail(target, "a call gives nothing to assign")
        else:
            self.set_variable(name, value, variable)

    def set_variable(self, name: str, value: Scalar, variable: Variable | None) -> None:
        """Print an assignment to a variable, which is declared if it is not yet."""
        declares = variable is None
        if variable is None:
            self.env[name] = variable = Variable(self._local(name), value.kind)
        self.grow(variable, value.kind)
        variable.assigned += 1
        self.emit(self.converted(value, variable.kind), variable, declares=declares)

    def grow(self, variable: Variable, kind: Kind) -> None:
        """Let a variable hold numbers of a kind, too, unless it was read as what it was."""
        kind = join([variable.kind, kind])
        if variable.is_read and {variable.kind, kind} - {"bool", "int"} and kind != variable.kind:
            raise Unprintable(
                f"{self.python.__module__}.{self.python.__name__}: {variable.name} begins as "
                f"{variable.kind} and becomes {kind}; begin it as a number of that kind"
            )
        variable.kind = kind

    def converted(self, value: Scalar, kind: Kind) -> str:
        """Text of a value for a variable or element of that kind."""
        if kind == "real" and value.kind == "time" and not isinstance(value, Known):
            return f"({self.style.real}){self.style.text(value, UNARY)}"
        return self.style.text(value, kind=kind)

    def array(self, name: str, view: View) -> View:
        """Declare a local array, for a name."""
        local, size = self._local(name), 1
        for length in view.shape:
            size *= length.value  # type: ignore[union-attr]  # `room` knows it
        self.emit(f"{self.style.type(view.kind)} {local}[{size}]")
        return replace(view, text=local, root=(self, local))

    def pointer(self, name: str, view: View) -> View:
        """View for a name: itself where its place is known, else through a local pointer."""
        if isinstance(view.offset, Known) or view.text == name:
            return view
        local = self._local(name)
        while (id(self.out), local) in self.declared:
            local += "_"
        self.declared.add((id(self.out), local))
        variable = Variable(local, view.kind, is_pointer=True, assigned=1)
        self.emit(f"{view.text} + {self.style.text(view.offset)}", variable, declares=True)
        return replace(view, text=local, offset=Known(0), pointer=(variable, view), values=None)

    def store(self, target: ast.Subscript, value: Scalar) -> None:
        """Print an assignment to an element, or to each element of a slice."""
        if not isinstance(target.slice, ast.Slice):
            place = self.place(target)
            self.emit(f"{place.text} = {self.converted(value, place.kind)}")
            return
        view = self.value(target)
        index = self._local("index")
        self.mark(view)
        element = self.element(replace(view, values=None), Expr(index, "int"))
        count = self.style.text(view.shape[0], ORDER + 1)
        text = f"{element.text} = {self.converted(value, view.kind)}"
        head = f"for (int {index} = 0; {index} < {count}; {index}++)"
        self.out.append(Block(head, [Statement(text)]))

    def _augassign(self, s: ast.AugAssign, rest: Sequence[ast.stmt]) -> None:  # noqa: ARG002
        sign = ARITHMETIC[type(s.op)][0]
        value = self.value(s.value)
        if isinstance(s.target, ast.Subscript):
            place = self.place(s.target)
            self.emit(f"{place.text} {sign}= {self.converted(value, place.kind)}")
            return
        assert isinstance(s.target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = s.target.id
        held = self.env.get(name)
        if not isinstance(held, Variable):
            load = ast.copy_location(ast.Name(name, ast.Load()), s.target)
            self.assign(s.target, operate(self.style, s.op, self.value(load), value))
        elif not (isinstance(s.op, ast.BitOr) and value == Known(0)):
            held.is_read = True
            self.grow(held, value.kind)
            held.assigned += 1
            self.emit(self.converted(value, held.kind), held, operator=f"{sign}=")

    # ------------------------------------------------------------------ loops and choices

    def prepare(self, body: Iterable[ast.stmt], rest: Sequence[ast.stmt]) -> None:
        """Make variables of what a loop or choice changes: known so far, or read behind it."""
        names = sorted(assigned(body))
        for name in names:
            held = self.env.get(name)
            if isinstance(held, Known):
                self.set_variable(name, held, None)
                self.env[name].assigned += 1
            elif isinstance(held, Expr):
                self.env[name] = Variable(held.text, held.kind, assigned=2)
        for name in names:
            if name not in self.env and first_use(name, rest) == "read":
                self.env[name] = Variable(self._local(name), "bool", assigned=2)
                self.emit("", self.env[name], declares=True)

    def inner(self, head: str, body: Sequence[ast.stmt], env: dict[str, Any]) -> tuple[Block, bool]:
        """Print the body of a loop or branch, whose own names end with it."""
        out, outer = self.out, self.env
        block = Block(head)
        self.out, self.env = block.body, {**outer, **env}
        ends = self.block(body)
        self.out, self.env = out, outer
        return block, ends

    def _for(self, s: ast.For, rest: Sequence[ast.stmt]) -> bool:
        """Print a loop, or its rounds one by one where they are few or marked."""
        assert isinstance(s.target, ast.Name)  # noqa: S101  # ranges give numbers
        if not (isinstance(s.iter, ast.Call) and getattr(s.iter.func, "id", "") == "range"):
            raise self.fail(s, "only a range has C")
        limits = s.iter.args
        marked = any(
            isinstance(n, ast.Call) and self.lookup(n.func) is marks.unrolled for n in limits
        )
        bounds = [self.value(a) for a in limits]
        start = bounds.pop(0) if len(bounds) > 1 else Known(0)
        stop, step = (*bounds, Known(1))[:2]
        if not isinstance(step, Known):
            raise self.fail(s, "the step of a range is not known")
        if isinstance(start, Known) and isinstance(stop, Known):
            rounds = range(start.value, stop.value, step.value)
            one = len(rounds) == 1 and not any(
                isinstance(n, (ast.Continue, ast.Break)) for n in ast.walk(s)
            )
            if not rounds or marked or one:
                return self.rounds(s, s.target.id, rounds)
        if marked:
            raise self.fail(s, "the rounds of an unrolled loop are not known")
        if step.value < -1:
            raise self.fail(s, "a range goes down by one only")
        self.prepare(s.body, rest)
        name = self._local(s.target.id)
        way = {1: f"{name}++", -1: f"{name}--"}.get(step.value, f"{name} += {step.value}")
        sign, end = ">" if step.value < 0 else "<", self.style.text(stop, ORDER + 1)
        head = f"for (int {name} = {self.style.text(start)}; {name} {sign} {end}; {way})"
        self.loops.append(s)
        block, _ = self.inner(head, s.body, {s.target.id: Expr(name, "int")})
        self.loops.pop()
        self.out.append(block)
        return False

    def rounds(self, s: ast.For, name: str, rounds: range) -> bool:
        """Print the rounds of a loop one after the other."""
        loops, self.loops = self.loops, []
        ends = False
        for number in rounds:
            self.env[name] = Known(number)
            ends = self.block(s.body)
            if ends:
                break
        self.loops = loops
        return ends

    def _if(self, s: ast.If, rest: Sequence[ast.stmt]) -> bool:
        """Print a choice, or what is chosen where that is known."""
        test = self.truth(s.test)
        if isinstance(test, Known):
            return self.block(s.body if test.value else s.orelse)
        self.prepare([*s.body, *s.orelse], rest)
        return self.branches(s, test, "if")

    def branches(self, s: ast.If, test: Any, word: str) -> bool:
        """Print the branches of a choice, whose variables are declared."""
        chosen, ends = self.inner(f"{word} ({self.style.text(test)})", s.body, {})
        self.out.append(chosen)
        if len(s.orelse) == 1 and isinstance(s.orelse[0], ast.If):
            nested = s.orelse[0]
            place = len(self.out)
            other = self.truth(nested.test)
            if len(self.out) == place and not isinstance(other, Known):
                return self.branches(nested, other, "else if") and ends
            del self.out[place:]
        if not s.orelse:
            return False
        block, also = self.inner("else", s.orelse, {})
        if block.body:
            self.out.append(block)
        return ends and also
