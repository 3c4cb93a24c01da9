"""Statements of a kernel as a C function."""

from __future__ import annotations

import ast
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from truejoint import compiled as marks
from truejoint.export.c_expressions import ARITHMETIC, RESERVED, Expressions
from truejoint.export.c_statements import Block, Statement, Variable, names_in, walk
from truejoint.export.c_structs import Handle
from truejoint.export.c_syntax import assigned, first_use
from truejoint.export.c_values import (
    ORDER,
    UNARY,
    Expr,
    Kind,
    Known,
    Linear,
    Root,
    Scalar,
    View,
    join,
)

_LENGTH_NAMES: Final = {1: ("length",), 2: ("rows", "columns")}


@dataclass(eq=False)
class Function(Expressions):
    """One kernel as a C function, for arguments of which something is known."""

    # ------------------------------------------------------------------ head and result

    def run(self) -> None:
        """Print the body."""
        names = [a.arg for a in self.tree.args.args]
        notes = [
            a.annotation.id if isinstance(a.annotation, ast.Name) else ""
            for a in self.tree.args.args
        ]
        for name, note, argument in zip(names, notes, self.arguments, strict=True):
            self.env[name] = self._parameter(name, note, argument)
        self.block(self.tree.body)
        self.finish()
        clash = self.local_names & self.globals_used
        if clash - self.avoid:
            self.avoid |= clash
            self.again = True

    def _local(self, name: str) -> str:
        """Name of a local variable, which hides no name that the function uses."""
        name = {"_": "turn"}.get(name, name.strip("_")) or "turn"
        while name in RESERVED or name in self.avoid:
            name += "_"
        self.local_names.add(name)
        return name

    def _parameter(self, name: str, note: str, argument: Any) -> Any:
        local = self._local(name)
        if isinstance(argument, Handle):
            pointer = self._local(argument.struct.name)
            self.parameters.append((pointer, "struct", name, argument.struct))
            return Handle(argument.struct, argument.side, pointer, is_pointer=True, owner=pointer)
        if isinstance(argument, View):
            self.parameters.append((local, "view", name, argument.kind))
            shape: list[Scalar] = []
            for length, word in zip(
                argument.shape, _LENGTH_NAMES[len(argument.shape)], strict=True
            ):
                if isinstance(length, Known):
                    shape.append(Known(length.value))
                else:
                    hidden = self._local(f"{name}_{word}")
                    self.parameters.append((hidden, "int", f"{name}.{word}", None))
                    shape.append(Expr(hidden, "int"))
            values = None
            if argument.values is not None and isinstance(argument.offset, Known):
                values = argument.values[argument.offset.value :]
            root = Root(self, local)
            view = View(local, Known(0), tuple(shape), argument.kind, root, Known(0), values)
            self.pointed[local] = view
            return view
        if isinstance(argument, Known) and note != "float" and argument.kind in ("int", "bool"):
            return argument
        if isinstance(argument, (Known, Expr, Linear)):
            kind: Kind = argument.kind
            kind = join([kind, "real"]) if note == "float" else kind
            self.parameters.append((local, kind, name, None))
            return Variable(local, kind, assigned=2)
        return argument

    def head(self, body: list[Statement | Block]) -> tuple[tuple[str, tuple[str, ...]], list[str]]:
        """Return type with declarations of the parameters that are used; and their Python names."""
        used = names_in(body) | {
            s.target.name for s in walk(body) if isinstance(s, Statement) and s.target
        }
        texts, names, seen = [], [], set()
        for local, sort, name, extra in self.parameters:
            if local not in used or local in seen:
                continue
            seen.add(local)
            constant = "" if local in self.written else "const "
            if sort == "struct":
                texts.append(f"{constant}{extra.type} *{local}")
            elif sort == "view":
                texts.append(f"{constant}{self.style.type(extra)} *{local}")
            else:
                texts.append(f"{self.style.type(sort)} {local}")  # type: ignore[arg-type]
            names.append(name)
        result = self.result
        kind = "void" if result is None or isinstance(result, Known) else self.style.type(result)
        return (kind, tuple(texts)), names

    def pointers(self, names: list[str]) -> list[tuple[str, str, bool]]:
        """Local name, Python name and whether it is written, of each pointer parameter in use."""
        return [
            (local, name, local in self.written)
            for local, sort, name, _ in self.parameters
            if sort in ("view", "struct") and name in names
        ]

    def calls_with_effect(self, body: list[Statement | Block], effects: set[str]) -> bool:
        """Whether a function that is called has an effect."""
        return bool(names_in(body) & effects)

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
            ends = self.statement(statement, body[i + 1 :])
            if comment and len(self.out) > place and not self.returns_only_known(place):
                self.out.insert(place, Statement(comment, comment=True))
            if ends:
                return True
        return False

    def returns_only_known(self, place: int) -> bool:
        """Whether what was printed since is no more than a bare return."""
        return (
            len(self.out) == place + 1
            and self.out[place].__class__ is Statement
            and not (
                self.out[place].text  # type: ignore[union-attr]
            )
        )

    def statement(  # noqa: C901  # one kind of statement after the other
        self, s: ast.stmt, rest: Sequence[ast.stmt]
    ) -> bool:
        """Print one statement; whether control never goes on behind it."""
        if isinstance(s, ast.Expr):
            if not isinstance(s.value, ast.Constant):
                self.call_statement(self.value(s.value))
        elif isinstance(s, ast.Assign):
            self.assignment(s.targets, s.value)
        elif isinstance(s, ast.AnnAssign) and s.value is not None:
            self.assignment([s.target], s.value)
        elif isinstance(s, ast.AugAssign):
            self.augmented(s)
        elif isinstance(s, ast.For):
            return self.loop(s, rest)
        elif isinstance(s, ast.If):
            return self.choice(s, rest)
        elif isinstance(s, ast.Return):
            self.give_back(s)
            return True
        elif isinstance(s, (ast.Continue, ast.Break)):
            if not self.loops:
                raise self.fail(s, "it leaves a loop that is unrolled")
            self.emit("continue" if isinstance(s, ast.Continue) else "break")
            return True
        elif not isinstance(s, ast.Pass):
            raise self.fail(s, f"{type(s).__name__} has no C here")
        return False

    def call_statement(self, value: Any) -> None:
        """Print a call whose result nobody wants."""
        if isinstance(value, Expr):
            self.emit(value.text)

    def give_back(self, s: ast.Return) -> None:
        """Print a return."""
        value = None if s.value is None else self.value(s.value)
        statement = Statement("return")
        self.returns.append((statement, value))
        self.out.append(statement)

    def finish(self) -> None:
        """Write the values of returns, once the kind of the result is known."""
        result = self.result
        for statement, value in self.returns:
            if result is not None and not isinstance(result, Known):
                statement.text = f"return {self.style.text(value, kind=result)}"
        last = self.body[-1] if self.body else None
        if isinstance(last, Statement) and last.text == "return":
            self.body.pop()

    def assignment(self, targets: Sequence[ast.expr], source: ast.expr) -> None:
        """Print ``a = b = value`` and ``a, b = values``."""
        if isinstance(targets[0], ast.Tuple):
            assert isinstance(source, ast.Tuple)  # noqa: S101  # kernels return no tuples
            values = [self.value(e) for e in source.elts]
            for target, value in zip(targets[0].elts, values, strict=True):
                self.assign(target, value)
            return
        value = self.value(source)
        for target in targets:
            self.assign(target, value)

    def assign(self, target: ast.expr, value: Any) -> None:
        """Print one assignment."""
        if isinstance(target, ast.Subscript):
            self.store(target, value)
            return
        assert isinstance(target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = target.id
        if isinstance(value, View):
            self.env[name] = self.pointer(name, value)
            return
        held = self.env.get(name)
        variable = held if isinstance(held, Variable) else None
        if (variable is None and isinstance(value, Known)) or (
            variable is None and isinstance(value, Handle)
        ):
            self.env[name] = value
        elif value is None:
            raise self.fail(target, "a call gives nothing to assign")
        else:
            self.set_variable(name, value, variable)

    def set_variable(self, name: str, value: Scalar, variable: Variable | None) -> None:
        """Print an assignment to a variable, which is declared if it is not yet."""
        if isinstance(value, Known) and name in self.kinds and value.kind == "int":
            kind: Kind = join([value.kind, self.kinds[name]])
        else:
            kind = join([value.kind, self.kinds.get(name, value.kind)])
        if self.kinds.get(name) != kind:
            if name in self.kinds or (variable is not None and variable.kind != kind):
                self.again = True
            self.kinds[name] = kind
        declares = variable is None
        if variable is None:
            variable = Variable(self._local(name), kind)
            self.env[name] = variable
        variable.assigned += 1
        text = self.converted(value, variable.kind)
        self.emit(text, variable, declares=declares)

    def converted(self, value: Scalar, kind: Kind) -> str:
        """Text of a value for a variable or element of that kind."""
        if kind == "real" and value.kind == "time" and not isinstance(value, Known):
            return f"({self.style.real}){self.style.text(value, UNARY)}"
        return self.style.text(value, kind=kind)

    def pointer(self, name: str, view: View) -> View:
        """View for a name: itself where its place is known, else through a local pointer."""
        if isinstance(view.offset, Known) or view.text == name:
            return view
        self.use(view)
        local = self._local(name)
        while (id(self.out), local) in self.declared:
            local += "_"
        self.declared.add((id(self.out), local))
        variable = Variable(local, view.kind, is_pointer=True, assigned=1)
        offset = self.style.text(view.offset)
        self.emit(f"{view.text} + {offset}", variable, declares=True)
        return replace(
            view, text=variable.name, offset=Known(0), pointer=(variable, view), values=None
        )

    def store(self, target: ast.Subscript, value: Scalar) -> None:
        """Print an assignment to an element, or to each element of a slice."""
        if isinstance(target.slice, ast.Slice):
            view = self.value(target)
            index = self._local("index")
            self.mark(view)
            element = self.element(replace(view, values=None), Expr(index, "int"))
            count = self.style.text(view.shape[0], ORDER + 1)
            loop = Block(f"for (int {index} = 0; {index} < {count}; {index}++)")
            loop.body.append(Statement(f"{element.text} = {self.converted(value, view.kind)}"))
            self.out.append(loop)
            return
        place_ = self.place(target, write=True)
        self.emit(f"{place_.text} = {self.converted(value, place_.kind)}")

    def augmented(self, s: ast.AugAssign) -> None:
        """Print ``a += value`` and the like."""
        sign = ARITHMETIC[type(s.op)][0]
        if isinstance(s.target, ast.Name):
            held = self.env.get(s.target.id)
            if isinstance(held, Variable):
                value = self.value(s.value)
                if isinstance(s.op, ast.BitOr) and value == Known(0):
                    return
                kind = join([held.kind, value.kind])
                if kind != held.kind:
                    self.kinds[s.target.id] = kind
                    self.again = True
                held.assigned += 1
                self.emit(self.converted(value, held.kind), held, operator=f"{sign}=")
                return
            load = ast.copy_location(ast.Name(s.target.id, ast.Load()), s.target)
            self.assign(s.target, self.value(ast.copy_location(ast.BinOp(load, s.op, s.value), s)))
            return
        assert isinstance(s.target, ast.Subscript)  # noqa: S101  # kernels have no attributes
        value = self.value(s.value)
        place = self.place(s.target, write=True)
        self.emit(f"{place.text} {sign}= {self.converted(value, place.kind)}")

    # ------------------------------------------------------------------ loops and choices

    def materialise(self, names: Iterable[str]) -> None:
        """Make variables of what is known so far, since it is about to change."""
        for name in sorted(names):
            held = self.env.get(name)
            if isinstance(held, Known):
                self.set_variable(name, held, None)
                variable = self.env[name]
                variable.assigned += 1
            elif isinstance(held, Expr):
                local = Variable(held.text, held.kind, assigned=2)
                self.env[name] = local

    def hoist(self, names: Iterable[str], rest: Sequence[ast.stmt]) -> None:
        """Declare variables that are set within a choice or loop and read behind it."""
        for name in sorted(names):
            if name not in self.env and first_use(name, rest) == "read":
                kind = self.kinds.get(name)
                if kind is None:
                    kind = self.kinds[name] = "bool"
                    self.again = True
                variable = Variable(self._local(name), kind, assigned=2)
                self.env[name] = variable
                self.emit("", variable, declares=True)

    def inner(self, head: str, body: Sequence[ast.stmt], env: dict[str, Any]) -> tuple[Block, bool]:
        """Print the body of a loop or branch, whose own names end with it."""
        out, outer = self.out, self.env
        block = Block(head)
        self.out, self.env = block.body, {**outer, **env}
        ends = self.block(body)
        self.out, self.env = out, outer
        return block, ends

    def loop(self, s: ast.For, rest: Sequence[ast.stmt]) -> bool:
        """Print a loop, or its rounds one by one where they are few or marked."""
        assert isinstance(s.target, ast.Name)  # noqa: S101  # ranges give numbers
        call = s.iter
        if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "range"):
            raise self.fail(s, "only a range has C")
        limits = call.args
        marked = any(
            isinstance(n, ast.Call) and self.lookup(n.func) is marks.unrolled for n in limits
        )
        bounds = [self.value(a) for a in limits]
        start, stop, step = (
            (Known(0), bounds[0], Known(1))
            if len(bounds) == 1
            else (*bounds, Known(1))
            if len(bounds) == 2
            else bounds
        )
        if not isinstance(step, Known):
            raise self.fail(s, "the step of a range is not known")
        if isinstance(start, Known) and isinstance(stop, Known):
            rounds = range(start.value, stop.value, step.value)
            leaves = any(isinstance(n, (ast.Continue, ast.Break)) for n in ast.walk(s))
            if not rounds or marked or (len(rounds) == 1 and not leaves):
                return self.rounds(s, rounds)
        if marked:
            raise self.fail(s, "the rounds of an unrolled loop are not known")
        names = assigned(s.body)
        self.materialise(names)
        self.hoist(names, rest)
        name = self._local(s.target.id)
        sign, way = (
            ("<", f"{name}++")
            if step.value == 1
            else ((">", f"{name}--") if step.value == -1 else ("<", f"{name} += {step.value}"))
        )
        if step.value < -1:
            raise self.fail(s, "a range goes down by one only")
        head = (
            f"for (int {name} = {self.style.text(start)}; "
            f"{name} {sign} {self.style.text(stop, ORDER + 1)}; {way})"
        )
        self.loops.append(s)
        block, _ = self.inner(head, s.body, {s.target.id: Expr(name, "int")})
        self.loops.pop()
        self.out.append(block)
        return False

    def rounds(self, s: ast.For, rounds: range) -> bool:
        """Print the rounds of a loop one after the other."""
        loops, self.loops = self.loops, []
        assert isinstance(s.target, ast.Name)  # noqa: S101  # checked before
        for number in rounds:
            self.env[s.target.id] = Known(number)
            if self.block(s.body):
                self.loops = loops
                return True
        self.loops = loops
        return False

    def choice(self, s: ast.If, rest: Sequence[ast.stmt]) -> bool:
        """Print a choice, or what is chosen where that is known."""
        test = self.truth(s.test)
        if isinstance(test, Known):
            return self.block(s.body if test.value else s.orelse)
        names = assigned([*s.body, *s.orelse])
        self.materialise(names)
        self.hoist(names, rest)
        return self.branches(s, test, "if")

    def branches(self, s: ast.If, test: Any, word: str) -> bool:
        """Print the branches of a choice, whose variables are declared."""
        head = f"{word} ({self.style.text(test)})"
        chosen, ends = self.inner(head, s.body, {})
        self.out.append(chosen)
        if len(s.orelse) == 1 and isinstance(s.orelse[0], ast.If):
            nested = s.orelse[0]
            place = len(self.out)
            other = self.truth(nested.test)
            if len(self.out) == place and not isinstance(other, Known):
                return self.branches(nested, other, "else if") and ends
            del self.out[place:]
        body = s.orelse
        if not body:
            return False
        block, also = self.inner("else", body, {})
        if block.body:
            self.out.append(block)
        return ends and also
