"""What the Python source of a kernel says before any value is known."""

from __future__ import annotations

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterable, Sequence
from functools import cache
from typing import Any


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
def definitions(module: str) -> dict[str, tuple[Any, ...]]:
    """Constants of a module by name: the expression, or None with module and name if imported."""
    constants: dict[str, tuple[Any, ...]] = {}
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(node, (ast.AnnAssign, ast.Assign)):
            target = node.target if isinstance(node, ast.AnnAssign) else node.targets[0]
            if isinstance(target, ast.Name):
                constants[target.id] = (node.value,)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                constants[alias.asname or alias.name] = (None, node.module, alias.name)
    return constants


def assigned(statements: Iterable[ast.stmt]) -> set[str]:
    """Names of scalars and arrays that statements assign to."""
    nodes = [node for statement in statements for node in _nodes(statement)]
    loops = {
        n.target.id for n in nodes if isinstance(n, ast.For) and isinstance(n.target, ast.Name)
    }
    stored = {n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
    return stored - loops


@cache  # of what `tree_of` keeps: a printer asks again for each of its arguments
def _nodes(root: ast.AST) -> tuple[ast.Name | ast.For, ...]:
    """Names and loops in a tree."""
    return tuple(node for node in ast.walk(root) if isinstance(node, (ast.Name, ast.For)))


def first_use(name: str, body: Sequence[ast.stmt]) -> str:
    """Whether a name is first "read" or first "set" by statements, or neither for certain."""

    def loads(roots: Iterable[ast.AST]) -> bool:
        nodes = (node for root in roots for node in _nodes(root) if isinstance(node, ast.Name))
        return any(node.id == name and isinstance(node.ctx, ast.Load) for node in nodes)

    for s in body:
        if isinstance(s, (ast.If, ast.For)):
            uses = {first_use(name, s.body), first_use(name, s.orelse)}
            if "read" in uses or loads([s.test if isinstance(s, ast.If) else s.iter]):
                return "read"
            if uses == {"set"}:
                return "set"
            continue
        sets = name in assigned([s])
        if loads(ast.iter_child_nodes(s)) or (sets and isinstance(s, ast.AugAssign)):
            return "read"
        if sets:
            return "set"
    return ""
