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

import inspect
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntFlag
from importlib.resources import files
from itertools import chain, combinations, count
from struct import pack, unpack
from typing import Any, Final

from numba.core.dispatcher import Dispatcher

from truejoint.export import c_values as c
from truejoint.export.c_function import Function
from truejoint.export.c_values import Constant, Handle, Side, Struct, Unprintable, kind_of
from truejoint.layout import Field, Memory

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
        whole = "\n\n".join(self._text(printed) for printed in printed_functions)
        if any(getattr(printed.python, "is_wide", False) for printed in printed_functions):
            whole = f"{_WIDE}\n{whole}"
        words = set(re.findall(r"\w+", re.sub(r"/\*.*?\*/", "", whole, flags=re.DOTALL)))
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
        flash = sum(len(each.texts) * self.style.size(each.type) for each in constants)
        return Program(
            "\n\n".join(part.declaration(self.style) for part in struct.walk() if part.changes),
            "\n".join(struct.initial(self.style, named)),
            "\n\n".join(filter(None, ["\n".join(lines), *tables])),
            "\n\n".join([*helpers, whole]),
            (*constants, *struct.initial_constants(self.style, "initial.")),
            names,
            flash,
            struct.size(self.style)[0],
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
        for name, given, about, result in _HELPERS:
            texts[f"{name}_{kind}"] = (
                f"/* {about} */\nstatic {type_} {name}_{kind}({given.format(type_)})\n"
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
        known = argument.values is not None and isinstance(argument.offset, c.Known)
        return (argument.kind, shape, (argument.root, argument.offset.value) if known else None)  # type: ignore[union-attr]
    if isinstance(argument, Handle):
        return (argument.struct, argument.side)
    return argument
