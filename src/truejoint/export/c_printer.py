"""Compiled kernels printed as C99, with everything folded in that is known of their memory.

The printer runs a kernel's Python source with values that are partly known. What no kernel writes
is known: sizes, switches and coefficients become literals and constant arrays, and choices
between them are made here. What kernels write becomes a named field of a C struct. Every
floating-point operation stays where it stands in the Python, so that the C gives the same bits.

The subset of Python: assignment, ``for ... in range``, ``if``, ``return``, ``continue``, ``break``,
arithmetic, comparisons, views and slices of arrays, calls of other kernels, a few functions of
`math`. Anything else raises `Unprintable`.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from numba.core.dispatcher import Dispatcher

from truejoint.export.c_expressions import RESERVED
from truejoint.export.c_function import Function
from truejoint.export.c_statements import block_lines, names_in, pruned, wrapped_comment
from truejoint.export.c_structs import (
    Constants,
    Handle,
    Struct,
    Written,
    declaration,
    element_texts,
    initial_values,
    wrapped,
)
from truejoint.export.c_values import Expr, Kind, Known, Linear, Scalar, Style, View, add
from truejoint.layout import Memory


@dataclass(frozen=True)
class Program:
    """Kernels in C.

    Attributes
    ----------
    structs : str
        Typedefs of what they change; the last is that of the whole memory.
    initial : str
        Initialiser of the whole memory before the first step.
    constants, functions : str
        Named numbers and arrays, and functions, each before it is used.
    names : tuple of str
        Of the C functions of the kernels asked for, in order; each takes a pointer to the struct.
    fields : frozenset of str
        Of the struct.
    """

    structs: str
    initial: str
    constants: str
    functions: str
    names: tuple[str, ...]
    fields: frozenset[str]


def print_kernels(
    kernels: Sequence[Any],
    memory: Memory,
    name: str,
    type_: str,
    *,
    single: bool = False,
    inputs: Iterable[str] = (),
    enums: Mapping[type, str] | None = None,
    own: Mapping[str, str] | None = None,
) -> Program:
    """Print kernels that take the numbers and the memory of one layout.

    Parameters
    ----------
    kernels : sequence of numba dispatcher
        Each of arguments ``numbers, memory``.
    memory : Memory
        As it stands before the first step.
    name : str
        Of pointers to it in C.
    type_ : str
        Of the struct, ``<prefix>_state``; those of its parts are ``<prefix>_<part>_state``.
    single : bool
        Whether the arithmetic is in float.
    inputs : iterable of str
        Fields that are written from outside.
    enums : mapping of type to str, optional
        Prefixes by which C knows the members of enumerations.
    own : mapping of str to str, optional
        Integers at the head of the struct that no kernel knows, with what they mean.

    Returns
    -------
    Program

    Raises
    ------
    Unprintable
        If a kernel holds what has no C.
    """
    struct = Struct(name, type_, memory)
    written = Written({(struct, field_) for field_ in inputs})
    style = Style(single)
    while True:
        before = len(written.fields)
        printer = Printer(style, written, enums or {})
        names = tuple(printer.entry(kernel, struct) for kernel in kernels)
        if len(written.fields) == before:
            return printer.program(struct, names, own or {})


@dataclass(eq=False)
class Printed:
    """A function that is printed.

    Attributes
    ----------
    name : str
    parameters : list of str
        Those that are used, in order.
    result : Any
        Known result, kind of a result, or None.
    written : set of str
        Parameters through which it writes.
    """

    name: str
    parameters: list[str]
    result: Any
    written: set[str]


class Printer:
    """All functions of one program, in one pass over its kernels."""

    def __init__(self, style: Style, written: Written, enums: Mapping[type, str]) -> None:
        self.style = style
        self.written = written
        self.enums = enums
        self.constants = Constants(style)
        self.texts: dict[str, str] = {}
        self._bodies: dict[tuple[Any, ...], Printed] = {}
        self._done: dict[tuple[Any, ...], Printed] = {}
        self.calls: list[tuple[str, Any, dict[str, Any]]] = []
        self.effects: set[str] = set()
        self.pointers: dict[str, list[tuple[str, str, bool]]] = {}
        self.heads: dict[str, tuple[str, tuple[str, ...]]] = {}
        self.tables: dict[str, set[str]] = {}

    def entry(self, kernel: Any, struct: Struct) -> str:
        """Print a kernel of the whole memory."""
        arguments = [
            Handle(struct, "numbers", struct.name, is_pointer=True, owner=struct.name),
            Handle(struct, "memory", struct.name, is_pointer=True, owner=struct.name),
        ]
        return self.function(kernel, arguments).name

    def function(self, kernel: Any, arguments: Sequence[Any]) -> Printed:
        """Print a kernel for such arguments, unless that is done."""
        python = kernel.py_func if isinstance(kernel, Dispatcher) else kernel
        key = (python, *(_key(argument) for argument in arguments))
        if key not in self._done:
            self._done[key] = self._print(python, arguments)
        return self._done[key]

    def _print(self, python: Any, arguments: Sequence[Any]) -> Printed:
        kinds: dict[str, Kind] = {}
        avoid: set[str] = set()
        while True:
            one = Function(self, python, arguments, kinds, avoid)
            one.run()
            if not one.again:
                break
            self.calls = [call for call in self.calls if call[1] is not one]
        body = pruned(one.body, self.has_effect)
        head, parameters = one.head(body)
        lines = "\n".join(block_lines(body, self.style, 1))
        identity = (python, head, lines)
        if identity in self._bodies:
            one.name = self._bodies[identity].name
            return self._bodies[identity]
        wanted = python.__name__.strip("_")
        module = python.__module__.rpartition(".")[2]
        same = any(p is python for p, *_ in self._bodies)
        longer = wanted if same else f"{module}_{wanted}"
        if wanted in RESERVED:
            wanted = longer
        name = self.constants.name(wanted, longer)
        printed = Printed(name, parameters, one.result, set(one.written))
        self._bodies[identity] = printed
        one.name = name
        if one.written or one.calls_with_effect(body, self.effects):
            self.effects.add(name)
        comment = inspect.cleandoc(python.__doc__ or "").split("\n\n")[0].replace("\n", " ")
        comment = comment.replace("`", "").replace("*/", "")
        about = "\n".join(wrapped_comment(comment, "")) + "\n" if comment else ""
        self.texts[name] = (
            f"{about}@{name}@\n{{\n{lines}\n}}" if lines else f"{about}@{name}@\n{{\n}}"
        )
        self.pointers[name] = one.pointers(parameters)
        self.tables[name] = one.globals_used & names_in(body)
        self.heads[name] = head
        return printed

    def has_effect(self, text: str) -> bool:
        """Whether a text calls a function that changes something."""
        return any(name in self.effects for name in re.findall(r"(\w+)\(", text))

    def program(self, struct: Struct, names: tuple[str, ...], own: Mapping[str, str]) -> Program:
        """Put the printed functions together, without those that nothing calls."""
        used, rest = set(names), list(names)
        while rest:
            for name in re.findall(r"(\w+)\(", self.texts[rest.pop()]):
                if name in self.texts and name not in used:
                    used.add(name)
                    rest.append(name)
        whole = "\n\n".join(
            text.replace(f"@{name}@", self._head(name), 1)
            for name, text in self.texts.items()
            if name in used
        )
        words = set(re.findall(r"\w+", re.sub(r"/\*.*?\*/", "", whole, flags=re.DOTALL)))
        tabled = set().union(*(self.tables[name] for name in used))
        helpers = [text for name, text in self._helpers().items() if name in words]
        lines = []
        for name, (value, meaning) in self.constants.defines.items():
            if name in words:
                text = str(value) if isinstance(value, int) else self.style.literal(value)
                lines.append(f"#define {name} {text}" + (f" /* {meaning} */" if meaning else ""))
        tables = [
            self._table(owner, field_, name)
            for (owner, field_), name in self.constants.arrays.items()
            if name in tabled
        ]
        structs = [
            declaration(part, self.written, self.style, own if part is struct else {})
            for part in struct.walk()
            if self.written.has_any(part)
        ]
        return Program(
            "\n\n".join(structs),
            initial_values(struct, self.written, self.style, own),
            "\n\n".join(filter(None, ["\n".join(lines), *tables])),
            "\n\n".join([*helpers, whole]),
            names,
            frozenset(name for owner, name in self.written.fields if owner is struct),
        )

    def _table(self, owner: Struct, name: str, text: str) -> str:
        f = owner.memory.layout.fields[name]
        values = owner.values(f).tolist()
        kind, items = element_texts(f, values, self.style)
        lines = wrapped(", ".join(items), "    ")
        lines = [lines[0], *(line[4:] for line in lines[1:])]
        body = "\n".join(lines)
        return f"/* {f.meaning} */\nstatic const {kind} {text}[{len(items)}] = {{\n{body}\n}};"

    def _head(self, name: str) -> str:
        """Head of a function, its pointers restricted where no call lets them overlap."""
        result, parameters = self.heads[name]
        pointers = {p for p, _, _ in self.pointers[name]}
        if (
            len(pointers) > 1
            and any(w for _, _, w in self.pointers[name])
            and self._apart(name, ())
        ):
            parameters = tuple(
                re.sub(r"\*(?=\w+$)", "*restrict ", p) if p.split("*")[-1] in pointers else p
                for p in parameters
            )
        return "\n".join(wrapped(f"static {result} {name}({', '.join(parameters) or 'void'})", ""))

    def _apart(self, name: str, seen: tuple[str, ...]) -> bool:
        """Whether no call of a function passes pointers to the same numbers."""
        if name in seen:
            return True
        pointers = {p: w for p, _, w in self.pointers[name]}
        for callee, caller, arguments in self.calls:
            if callee != name:
                continue
            given = [(p, a) for p, a in arguments.items() if p in pointers]
            for i, (p, a) in enumerate(given):
                for q, b in given[i + 1 :]:
                    changed = pointers[p] or pointers[q]
                    if changed and not self._disjoint(a, b, caller, (*seen, name)):
                        return False
        return True

    def _disjoint(self, a: Any, b: Any, caller: Any, seen: tuple[str, ...]) -> bool:
        if isinstance(a, Handle) or isinstance(b, Handle):
            return False
        if a.root == b.root:
            return _ends_before(a, b) or _ends_before(b, a)
        owners = [view.root.owner for view in (a, b)]
        if all(isinstance(owner, Struct) for owner in owners):
            return True
        return self._apart(caller.name, seen)

    def _helpers(self) -> dict[str, str]:
        real, suffix = self.style.real, "f" if self.style.single else ""
        texts = {}
        kinds = {"_real": real, "_time": "double"} if suffix else {"_real": real}
        for ending, kind in {**kinds, "_int": "int"}.items():
            for name, sign in (("min", "<"), ("max", ">")):
                about = "smaller" if name == "min" else "larger"
                texts[f"{name}{ending}"] = (
                    f"/* The {about} of two numbers; the first where they do not compare. */\n"
                    f"static {kind} {name}{ending}({kind} a, {kind} b)\n"
                    f"{{\n    return b {sign} a ? b : a;\n}}"
                )
        for ending, kind in kinds.items():
            zero = "0.0f" if kind == "float" else "0.0"
            one = "1.0f" if kind == "float" else "1.0"
            texts[f"square{ending}"] = (
                f"/* Square of a number. */\nstatic {kind} square{ending}({kind} a)\n"
                f"{{\n    return a * a;\n}}"
            )
            texts[f"sign{ending}"] = (
                f"/* Sign of a number: -1, 0 or 1. */\nstatic {kind} sign{ending}({kind} a)\n"
                f"{{\n    return a > {zero} ? {one} : a < {zero} ? -{one} : a;\n}}"
            )
        return texts


def _ends_before(a: View, b: View) -> bool:
    """Whether one view of an array ends where the other begins, or before."""
    size: Scalar = Known(1)
    for length in a.shape:
        if not isinstance(length, Known):
            return False
        size = Known(size.value * length.value)  # type: ignore[union-attr]
    gap = add(add(b.start, a.start, -1), size, -1)
    return isinstance(gap, Known) and gap.value >= 0


def _key(argument: Any) -> Any:
    """Reduce an argument to what decides how a function is printed."""
    if isinstance(argument, Known):
        return (argument.value, argument.symbol, argument.origin)
    if isinstance(argument, (Expr, Linear)):
        return argument.kind
    if isinstance(argument, View):
        shape = tuple(n.value if isinstance(n, Known) else None for n in argument.shape)
        known = argument.values is not None and isinstance(argument.offset, Known)
        return (argument.kind, shape, (argument.root, argument.offset.value) if known else None)  # type: ignore[union-attr]
    if isinstance(argument, Handle):
        return (argument.struct, argument.side)
    return argument
