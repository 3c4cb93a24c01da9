"""Statements of a C function that is being printed, and what of them is of use."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from truejoint.export.c_structs import wrapped
from truejoint.export.c_values import Kind, Style

_NAME = re.compile(r"(?<![\w.>])[A-Za-z_]\w*")


@dataclass(eq=False)
class Variable:
    """A local variable or pointer of a C function.

    Attributes
    ----------
    name : str
    kind : Kind
    is_pointer : bool
    assigned : int
        How often it is given a value.
    written : bool
        Of a pointer: whether what it points to is changed.
    """

    name: str
    kind: Kind
    is_pointer: bool = False
    assigned: int = 0
    written: bool = False

    def declared(self, style: Style) -> str:
        """Type and name, ``const`` where that holds."""
        if self.is_pointer:
            return f"{'' if self.written else 'const '}{style.type(self.kind)} *{self.name}"
        return f"{'const ' if self.assigned == 1 else ''}{style.type(self.kind)} {self.name}"


@dataclass(eq=False)
class Statement:
    """One line.

    Attributes
    ----------
    text : str
        Without what stands left of an assignment.
    target : Variable, optional
        That the text is assigned to; without text it is only declared.
    declares : bool
        Whether the variable is declared here.
    operator : str
        Of the assignment.
    comment : bool
    """

    text: str
    target: Variable | None = None
    declares: bool = False
    operator: str = "="
    comment: bool = False

    def lines(self, style: Style, depth: int) -> list[str]:
        """In C."""
        pad = "    " * depth
        if self.comment:
            return wrapped_comment(self.text, pad)
        if self.target is None:
            return wrapped(f"{self.text};", pad)
        left = self.target.declared(style) if self.declares else self.target.name
        if not self.text:
            return [f"{pad}{left};"]
        return wrapped(f"{left} {self.operator} {self.text};", pad)


@dataclass(eq=False)
class Block:
    """A loop, or one branch of a choice.

    Attributes
    ----------
    head : str
        ``for (...)``, ``if (...)``, ``else if (...)`` or ``else``.
    body : list of statements
    """

    head: str
    body: list[Statement | Block] = field(default_factory=list)

    def lines(self, style: Style, depth: int) -> list[str]:
        """In C."""
        pad = "    " * depth
        # The brace that an else follows comes before it.
        width = 98 if self.head.startswith("else") else 100
        head = wrapped(f"{self.head} {{", pad, width)
        return [*head, *block_lines(self.body, style, depth + 1), f"{pad}}}"]


def wrapped_comment(text: str, pad: str, width: int = 100) -> list[str]:
    """Text as a C comment of lines that fit."""
    if len(pad) + len(text) + 6 <= width:
        return [f"{pad}/* {text} */"]
    lines, line = [f"{pad}/*"], f"{pad} *"
    for word in text.split():
        if len(line) + len(word) + 1 > width:
            lines.append(line)
            line = f"{pad} *"
        line += f" {word}"
    return [*lines, line, f"{pad} */"]


def block_lines(body: list[Statement | Block], style: Style, depth: int) -> list[str]:
    """Statements in C; an else joins the brace before it."""
    lines: list[str] = []
    for statement in body:
        new = statement.lines(style, depth)
        if isinstance(statement, Block) and statement.head.startswith("else"):
            lines[-1] += f" {new[0].lstrip()}"
            new = new[1:]
        lines += new
    return lines


def walk(body: list[Statement | Block]) -> Iterator[Statement | Block]:
    """All statements, those within others too."""
    for statement in body:
        yield statement
        if isinstance(statement, Block):
            yield from walk(statement.body)


def names_in(body: list[Statement | Block]) -> set[str]:
    """Names that statements read; an assignment does not read its target."""
    found: set[str] = set()
    for statement in walk(body):
        if isinstance(statement, Block):
            found.update(_NAME.findall(statement.head))
        elif not statement.comment:
            found.update(_NAME.findall(statement.text))
    return found


def pruned(
    body: list[Statement | Block], has_effect: Callable[[str], bool]
) -> list[Statement | Block]:
    """Statements without those that only compute what nobody reads."""
    while True:
        used = names_in(body)
        smaller = _direct(_without(body, used, has_effect))
        if _texts(smaller) == _texts(body):
            return smaller
        body = smaller


def _texts(body: list[Statement | Block]) -> list[str]:
    return [s.head if isinstance(s, Block) else s.text for s in walk(body)]


def _direct(body: list[Statement | Block]) -> list[Statement | Block]:
    """Statements in which a value that is only copied on at once goes straight to its place."""
    kept: list[Statement | Block] = []
    for i, statement in enumerate(body):
        if isinstance(statement, Block):
            kept.append(Block(statement.head, _direct(statement.body)))
            continue
        before = kept[-1] if kept else None
        if (
            isinstance(before, Statement)
            and before.target is not None
            and not before.target.is_pointer
            and before.operator == "="
            and statement.target is None
            and statement.text.endswith(f"] = {before.target.name}")
            and before.target.name not in _NAME.findall(statement.text.rpartition(" = ")[0])
            and _is_dead(before.target.name, body[i + 1 :], at_end=before.declares)
        ):
            if before.declares:
                before.target.assigned = 2
                kept[-1] = Statement("", before.target, declares=True)
            else:
                kept.pop()
            left = statement.text.rpartition(" = ")[0]
            kept.append(Statement(f"{left} = {before.text}"))
        else:
            kept.append(statement)
    return kept


def _is_dead(name: str, rest: list[Statement | Block], *, at_end: bool) -> bool:
    """Whether statements set a variable again before they read it; `at_end` if none names it."""
    for statement in rest:
        if isinstance(statement, Block):
            if name in names_in([statement]) or any(
                isinstance(s, Statement) and s.target is not None and s.target.name == name
                for s in walk([statement])
            ):
                return False
            continue
        if not statement.comment and name in _NAME.findall(statement.text):
            return False
        if statement.target is not None and statement.target.name == name:
            return statement.operator == "="
    return at_end


def _without(
    body: list[Statement | Block], used: set[str], has_effect: Callable[[str], bool]
) -> list[Statement | Block]:
    kept: list[Statement | Block] = []
    for i, statement in enumerate(body):
        if isinstance(statement, Block):
            inner = Block(statement.head, _without(statement.body, used, has_effect))
            following = body[i + 1] if i + 1 < len(body) else None
            goes_on = isinstance(following, Block) and following.head.startswith("else")
            if (
                any(not _is_comment(s) for s in inner.body)
                or goes_on
                or has_effect(inner.head)
                or inner.head.startswith("else if")
            ):
                kept.append(inner)
            elif kept and _is_comment(kept[-1]):
                kept.pop()
        elif statement.target is not None and statement.target.name not in used:
            if has_effect(statement.text):
                kept.append(Statement(statement.text))
            elif kept and _is_comment(kept[-1]):
                kept.pop()
        else:
            kept.append(statement)
    return kept


def _is_comment(statement: Statement | Block) -> bool:
    return isinstance(statement, Statement) and statement.comment
