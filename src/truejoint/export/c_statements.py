"""Statements of a C function that is being printed, and what of them is of use."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from truejoint.export.c_values import Kind, Style

NAME = re.compile(r"(?<![\w.>])[A-Za-z_]\w*")


@dataclass(eq=False)
class Variable:
    """A local variable or pointer of a C function."""

    name: str
    kind: Kind
    is_pointer: bool = False
    assigned: int = 0  # how often it is given a value
    written: bool = False  # of a pointer: whether what it points to is changed

    def declared(self, style: Style) -> str:
        """Type and name, ``const`` where that holds."""
        constant = not self.written if self.is_pointer else self.assigned == 1
        star = "*" if self.is_pointer else ""
        return f"{'const ' if constant else ''}{style.type(self.kind)} {star}{self.name}"


@dataclass(eq=False)
class Statement:
    """One line."""

    text: str  # without what stands left of an assignment
    target: Variable | None = None  # that the text is assigned to; without text only declared
    declares: bool = False  # whether the variable is declared here
    operator: str = "="  # of the assignment
    comment: bool = False

    def lines(self, style: Style, depth: int) -> list[str]:
        """In C."""
        pad = "    " * depth
        if self.comment:
            return wrapped_comment(self.text, pad)
        if self.target is None:
            return wrapped(f"{self.text};", pad)
        left = self.target.declared(style) if self.declares else self.target.name
        return wrapped(f"{left} {self.operator} {self.text};" if self.text else f"{left};", pad)


@dataclass(eq=False)
class Block:
    """A loop, or one branch of a choice."""

    head: str  # ``for (...)``, ``if (...)``, ``else if (...)`` or ``else``
    body: list[Statement | Block] = field(default_factory=list)

    def lines(self, style: Style, depth: int) -> list[str]:
        """In C."""
        pad = "    " * depth
        # The brace that an else follows comes before it.
        head = wrapped(f"{self.head} {{", pad, 98 if self.head.startswith("else") else 100)
        return [*head, *block_lines(self.body, style, depth + 1), f"{pad}}}"]


Body = list[Statement | Block]


def wrapped(text: str, pad: str, width: int = 100) -> list[str]:
    """Lines of a statement or initialiser, broken at spaces where it is too long."""
    lines, indent = [], pad
    while len(indent) + len(text) > width:
        room = width - len(indent)
        cut = -1
        for mark in (", ", " = "):  # stay at the end of the line
            at = text.rfind(mark, 0, room)
            cut = max(cut, at + len(mark) if at > 0 else -1)
        for mark in (" && ", " || ", " + ", " - ", " * ", " / ", " | ", " ? ", " : "):
            cut = max(cut, text.rfind(mark, 0, room))
        if cut <= 0:
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


def block_lines(body: Body, style: Style, depth: int) -> list[str]:
    """Statements in C; an else joins the brace before it."""
    lines: list[str] = []
    for statement in body:
        new = statement.lines(style, depth)
        if isinstance(statement, Block) and statement.head.startswith("else"):
            lines[-1] += f" {new.pop(0).lstrip()}"
        lines += new
    return lines


def walk(body: Body) -> Iterator[Statement | Block]:
    """All statements, those within others too."""
    for statement in body:
        yield statement
        if isinstance(statement, Block):
            yield from walk(statement.body)


def names_in(body: Body, *, targets: bool = False) -> set[str]:
    """Names that statements read, and with `targets` those that they assign to."""
    found: set[str] = set()
    for statement in walk(body):
        if isinstance(statement, Block):
            found.update(NAME.findall(statement.head))
        elif not statement.comment:
            found.update(NAME.findall(statement.text))
            if targets and statement.target is not None:
                found.add(statement.target.name)
    return found


def pruned(body: Body, has_effect: Callable[[str], bool]) -> Body:
    """Statements without those that only compute what nobody reads."""
    while True:
        smaller = _direct(_without(body, names_in(body), has_effect))
        texts = [[s.head if isinstance(s, Block) else s.text for s in walk(b)]
                 for b in (smaller, body)]  # fmt: skip
        if texts[0] == texts[1]:
            return smaller
        body = smaller


def _direct(body: Body) -> Body:
    """Statements in which a value that is only copied on at once goes straight to its place."""
    kept: Body = []
    for i, statement in enumerate(body):
        if isinstance(statement, Block):
            kept.append(Block(statement.head, _direct(statement.body)))
            continue
        before = kept[-1] if kept else None
        left = statement.text.rpartition(" = ")[0]
        if (
            isinstance(before, Statement)
            and before.target is not None
            and not before.target.is_pointer
            and before.operator == "="
            and statement.target is None
            and statement.text.endswith(f"] = {before.target.name}")
            and before.target.name not in NAME.findall(left)
            and _is_dead(before.target.name, body[i + 1 :], at_end=before.declares)
        ):
            kept.pop()
            if before.declares:
                before.target.assigned = 2
                kept.append(Statement("", before.target, declares=True))
            statement = Statement(f"{left} = {before.text}")  # noqa: PLW2901  # in its place
        kept.append(statement)
    return kept


def _is_dead(name: str, rest: Body, *, at_end: bool) -> bool:
    """Whether statements set a variable again before they read it; `at_end` if none names it."""
    for statement in rest:
        if name in names_in([statement], targets=isinstance(statement, Block)):
            return False
        target = None if isinstance(statement, Block) else statement
        if target is not None and target.target is not None and target.target.name == name:
            return target.operator == "="
    return at_end


def _without(body: Body, used: set[str], has_effect: Callable[[str], bool]) -> Body:
    kept: Body = []
    for i, statement in enumerate(body):
        if isinstance(statement, Block):
            inner = _without(statement.body, used, has_effect)
            following = body[i + 1] if i + 1 < len(body) else None
            stays = (
                not all(_is_comment(s) for s in inner)
                or (isinstance(following, Block) and following.head.startswith("else"))
                or has_effect(statement.head)
                or statement.head.startswith("else if")
            )
            left: Statement | Block = Block(statement.head, inner)
        else:
            stays, left = True, statement
            if statement.target is not None and statement.target.name not in used:
                stays, left = has_effect(statement.text), Statement(statement.text)
        if stays:
            kept.append(left)
        elif kept and _is_comment(kept[-1]):
            kept.pop()
    return kept


def _is_comment(statement: Statement | Block) -> bool:
    return isinstance(statement, Statement) and statement.comment
