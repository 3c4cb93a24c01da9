"""Statements of a C function that is being printed, and of the Python that it is printed from."""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

from truejoint.export.c_values import Kind, Style

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
    body: list[Statement] | None = None

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
