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
def definitions(module: str) -> dict[str, tuple[ast.expr | None, str, str]]:
    """Constants of a module by name: expression, and module and name if imported."""
    found: dict[str, tuple[ast.expr | None, str, str]] = {}
    for node in ast.parse(inspect.getsource(sys.modules[module])).body:
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            found[node.target.id] = (node.value, "", "")
        elif isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            found[node.targets[0].id] = (node.value, "", "")
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                found[alias.asname or alias.name] = (None, node.module, alias.name)
    return found


def assigned(nodes: Iterable[ast.stmt]) -> set[str]:
    """Names of scalars and arrays that statements assign to."""
    names = set()
    for statement in nodes:
        for node in ast.walk(statement):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                names.add(node.id)
    loops = {
        node.target.id
        for statement in nodes
        for node in ast.walk(statement)
        if isinstance(node, ast.For) and isinstance(node.target, ast.Name)
    }
    return names - loops


def _loads(name: str, nodes: Iterable[ast.AST]) -> bool:
    return any(
        isinstance(node, ast.Name) and node.id == name and isinstance(node.ctx, ast.Load)
        for root in nodes
        for node in ast.walk(root)
    )


def first_use(name: str, body: Sequence[ast.stmt]) -> str:
    """Whether a name is first "read" or first "set" by statements, or neither for certain."""
    for s in body:
        if isinstance(s, (ast.If, ast.For)):
            if _loads(name, [s.test if isinstance(s, ast.If) else s.iter]):
                return "read"
            uses = {first_use(name, s.body), first_use(name, s.orelse)}
            if "read" in uses:
                return "read"
            if uses == {"set"}:
                return "set"
            continue
        parts = [n for n in ast.iter_child_nodes(s) if isinstance(n, ast.expr)]
        if _loads(name, parts) or (isinstance(s, ast.AugAssign) and name in assigned([s])):
            return "read"
        if name in assigned([s]):
            return "set"
    return ""
