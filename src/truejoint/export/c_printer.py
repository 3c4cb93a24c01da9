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
from typing import Any, Final

from numba.core.dispatcher import Dispatcher

from truejoint.export.c_expressions import RESERVED, Expressions, Printed
from truejoint.export.c_function import Function
from truejoint.export.c_statements import (
    block_lines,
    names_in,
    pruned,
    wrapped,
    wrapped_comment,
)
from truejoint.export.c_structs import Constants, Handle, Struct
from truejoint.export.c_values import Expr, Kind, Known, Linear, Style, View
from truejoint.layout import Memory

WIDE: Final = """\
/* A function of which GCC makes two versions; a program with glibc loads the one that its processor
 * is fit for. AVX2 rounds as SSE2 does: the bits are the same. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__GLIBC__)
#define WIDE __attribute__((target_clones("avx2", "default")))
#else
#define WIDE
#endif"""


@dataclass(frozen=True)
class Program:
    """Kernels in C."""

    structs: str  # typedefs of what they change; the last is that of the whole memory
    initial: str  # initialiser of the whole memory before the first step
    constants: str  # named numbers and arrays
    functions: str  # each before it is used
    names: tuple[str, ...]  # functions of the kernels asked for; each takes a pointer to the struct


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

    Raises
    ------
    Unprintable
        If a kernel holds what has no C.
    """
    struct = Struct(name, type_, memory, set(inputs))
    arguments = [
        Handle(struct, "numbers", name, is_pointer=True, owner=name),
        Handle(struct, "memory", name, is_pointer=True, owner=name),
    ]
    while True:
        before = sum(len(part.written) for part in struct.walk())
        printer = Printer(Style(single), enums or {})
        names = tuple(printer.function(kernel, arguments).name for kernel in kernels)
        if sum(len(part.written) for part in struct.walk()) == before:
            return printer.program(struct, names, own or {})


class Printer:
    """All functions of one program, in one pass over its kernels."""

    def __init__(self, style: Style, enums: Mapping[type, str]) -> None:
        self.style = style
        self.enums = enums
        self.constants = Constants(style)
        self.functions: dict[str, Printed] = {}
        self.calls: list[tuple[str, Expressions, dict[str, Any]]] = []
        self._bodies: dict[tuple[Any, ...], Printed] = {}
        self._done: dict[tuple[Any, ...], Printed] = {}

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
        parameters = one.used_parameters(body)
        head = one.head(parameters)
        lines = "\n".join(block_lines(body, self.style, 1))
        identity = (python, head, lines)
        if identity in self._bodies:
            one.name = self._bodies[identity].name
            return self._bodies[identity]
        wanted = python.__name__.strip("_")
        longer = f"{python.__module__.rpartition('.')[2]}_{wanted}"
        if any(p is python for p, *_ in self._bodies):
            longer = wanted
        one.name = name = self.constants.name(longer if wanted in RESERVED else wanted, longer)
        about = inspect.cleandoc(python.__doc__ or "").split("\n\n")[0].replace("\n", " ")
        used = names_in(body)
        printed = self.functions[name] = self._bodies[identity] = Printed(
            name=name,
            result_type=head[0],
            declarations=head[1],
            parameters=[(p.name, p.local) for p in parameters],
            pointers={p.local: p.local in one.written for p in parameters if p.is_pointer},
            result=one.result,
            written=set(one.written),
            about=about.replace("`", "").replace("*/", ""),
            body=lines,
            globals_used=one.globals_used & used,
            has_effect=bool(one.written)
            or any(self.functions[n].has_effect for n in used & set(self.functions)),
            is_wide=getattr(python, "is_wide", False),
        )
        return printed

    def has_effect(self, text: str) -> bool:
        """Whether a text calls a function that changes something."""
        called = re.findall(r"(\w+)\(", text)
        return any(n in self.functions and self.functions[n].has_effect for n in called)

    def program(self, struct: Struct, names: tuple[str, ...], own: Mapping[str, str]) -> Program:
        """Put the printed functions together, without those that nothing calls."""
        used, rest = set(names), list(names)
        while rest:
            called = set(re.findall(r"(\w+)\(", self.functions[rest.pop()].body))
            fresh = called & set(self.functions) - used
            used |= fresh
            rest += fresh
        kept = [printed for name, printed in self.functions.items() if name in used]
        whole = "\n\n".join(self._text(printed) for printed in kept)
        if any(printed.is_wide for printed in kept):
            whole = f"{WIDE}\n\n{whole}"
        words = set(re.findall(r"\w+", re.sub(r"/\*.*?\*/", "", whole, flags=re.DOTALL)))
        lines = [
            f"#define {name} {value if isinstance(value, int) else self.style.literal(value)}"
            for name, value in self.constants.defines.items()
            if name in words
        ]
        tables = self.constants.tables(set().union(*(p.globals_used for p in kept)))
        helpers = [text for name, text in _helpers(self.style).items() if name in words]
        return Program(
            "\n\n".join(
                part.declaration(self.style, own if part is struct else {})
                for part in struct.walk()
                if part.changes
            ),
            "\n".join(struct.initial(self.style, own)),
            "\n\n".join(filter(None, ["\n".join(lines), *tables])),
            "\n\n".join([*helpers, whole]),
            names,
        )

    def _text(self, printed: Printed) -> str:
        """Definition of a function, its pointers restricted where no call lets them overlap."""
        parameters = printed.declarations
        written = printed.pointers.values()
        if len(written) > 1 and any(written) and self._apart(printed.name, ()):
            parameters = tuple(re.sub(r"\*(?=\w+$)", "*restrict ", p) for p in parameters)
        head = f"static {printed.result_type} {printed.name}({', '.join(parameters) or 'void'})"
        about = wrapped_comment(printed.about, "") if printed.about else []
        wide = ["WIDE"] if printed.is_wide else []
        return "\n".join(
            [*about, *wide, *wrapped(head, ""), "{", *filter(None, [printed.body]), "}"]
        )

    def _apart(self, name: str, seen: tuple[str, ...]) -> bool:
        """Whether no call of a function passes pointers to the same numbers."""
        if name in seen:
            return True
        pointers = self.functions[name].pointers
        for callee, caller, arguments in self.calls:
            if callee != name:
                continue
            given = [(pointers[p], a) for p, a in arguments.items() if p in pointers]
            for i, (p, a) in enumerate(given):
                for q, b in given[i + 1 :]:
                    if (p or q) and not self._disjoint(a, b, caller, (*seen, name)):
                        return False
        return True

    def _disjoint(self, a: Any, b: Any, caller: Expressions, seen: tuple[str, ...]) -> bool:
        if isinstance(a, Handle) or isinstance(b, Handle):
            return False
        if a.root == b.root:
            return bool(a.ends_before(b) or b.ends_before(a))
        if all(isinstance(view.root[0], Struct) for view in (a, b)):
            return True
        return self._apart(caller.name, seen)


def _helpers(style: Style) -> dict[str, str]:
    """Small functions by name, for each kind of number."""
    bodies = {
        "min": ("The smaller of two numbers; the first where they do not compare.",
                "b < a ? b : a"),
        "max": ("The larger of two numbers; the first where they do not compare.",
                "b > a ? b : a"),
        "square": ("Square of a number.", "a * a"),
        "sign": ("Sign of a number: -1, 0 or 1.", "a > {0} ? {1} : a < {0} ? -{1} : a"),
    }  # fmt: skip
    kinds: tuple[Kind, ...] = ("real", "time", "int") if style.single else ("real", "int")
    texts = {}
    for names in (("min", "max"), ("square", "sign")):
        for kind in kinds:
            for name in names:
                about, body = bodies[name]
                type_, suffix = style.type(kind), "f" if style.type(kind) == "float" else ""
                given = f"{type_} a" + (f", {type_} b" if name in ("min", "max") else "")
                body = body.format(f"0.0{suffix}", f"1.0{suffix}")
                texts[f"{name}_{kind}"] = (
                    f"/* {about} */\nstatic {type_} {name}_{kind}({given})\n"
                    f"{{\n    return {body};\n}}"
                )
    return texts


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
