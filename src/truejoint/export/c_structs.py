"""The memory of kernels as C: a struct of what they change, constants for all the rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import ExportError
from truejoint.export.c_values import Kind, Known, Root, Scalar, Style, View, add, linear
from truejoint.layout import Field, Memory

Side = Literal["numbers", "memory"]
_PART: Final = 4  # numbers of a part's field


class Unprintable(ExportError):
    """A kernel holds what has no C; the message says where."""


@dataclass(eq=False)
class Struct:
    """One memory, and those within it.

    Attributes
    ----------
    name : str
        Of pointers to it.
    type : str
        Of the C struct.
    memory : Memory
    parts : dict of str to Struct
    """

    name: str
    type: str
    memory: Memory
    parts: dict[str, Struct] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self._by_index: dict[tuple[Side, int], Field] = {}
        for f in self.memory.layout.fields.values():
            side: Side = "memory" if f.kind == "scalar" else "numbers"
            for i in range(_PART if f.kind == "part" else 1):
                self._by_index[side, f.index + i] = f
        for f in self.memory.layout.fields.values():
            if f.kind == "part":
                name = f"{self.type.removesuffix('_state')}_{f.name}_state"
                self.parts[f.name] = Struct(f.name, name, self._part(f))

    def _part(self, f: Field) -> Memory:
        """Memory of a part as it stands within this one."""
        mine, part = self.memory, self.memory.parts[f.name]
        place = mine.numbers[f.index : f.index + _PART].tolist()
        numbers = mine.numbers[place[0] : place[0] + place[2]]
        memory = mine.memory[place[1] : place[1] + place[3]]
        return Memory(part.layout, numbers, memory, part.shapes, part.parts, part.functions)

    def named(self, side: Side, index: int) -> Field | None:
        """Field of an index, None where there is none."""
        return self._by_index.get((side, index))

    def array_at(self, side: Side, place: int) -> Field:
        """Array field that holds a place of the flat memory."""
        kind = "array" if side == "memory" else "integers"
        for f in self.memory.layout.fields.values():
            start = int(self.memory.numbers[f.index])
            if f.kind == kind and start <= place < start + self.size(f):
                return f
        raise Unprintable(f"{self.name}: no {kind} field holds place {place} of its {side}")

    def size(self, f: Field) -> int:
        """Length of an array field."""
        return int(np.prod(self.memory.shapes[f.name]))

    def values(self, f: Field) -> NDArray[Any]:
        """Elements of an array field."""
        view: NDArray[Any] = self.memory.view(f.name).ravel()
        return view

    def value(self, f: Field) -> Any:
        """Value of a scalar, integer or address."""
        if f.kind == "scalar":
            return float(self.memory.memory[f.index])
        return int(self.memory.numbers[f.index])

    def walk(self) -> Iterator[Struct]:
        """Parts first, then this one."""
        for part in self.parts.values():
            yield from part.walk()
        yield self


@dataclass(frozen=True)
class Handle:
    """The numbers or the memory of a struct, as a kernel holds them.

    Attributes
    ----------
    struct : Struct
    side : {"numbers", "memory"}
    text : str
        The struct, or a pointer to it, in C.
    is_pointer : bool
    owner : str
        Parameter of the function that it comes from.
    """

    struct: Struct
    side: Side
    text: str
    is_pointer: bool
    owner: str

    def field_text(self, name: str) -> str:
        """Give a field of the struct in C."""
        return f"{self.text}{'->' if self.is_pointer else '.'}{name}"

    @property
    def pointer(self) -> str:
        """Pointer to the struct in C."""
        return self.text if self.is_pointer else f"&{self.text}"


class Constants:
    """Names at file scope, and the arrays among them.

    Parameters
    ----------
    style : Style
    """

    def __init__(self, style: Style) -> None:
        self.style = style
        self.arrays: dict[tuple[Struct, str], str] = {}
        self.defines: dict[str, tuple[Any, str]] = {}
        self.names: set[str] = set()

    def name(self, wanted: str, longer: str) -> str:
        """Free name: the wanted one, the longer one, or that with a number."""
        options = [wanted, longer, *(f"{longer}_{i}" for i in range(2, 10_000))]
        free = next(option for option in options if option not in self.names)
        self.names.add(free)
        return free

    def array(self, struct: Struct, name: str) -> str:
        """Name of a constant array."""
        if (struct, name) not in self.arrays:
            self.arrays[struct, name] = self.name(name, f"{struct.name}_{name}")
        return self.arrays[struct, name]

    def define(self, name: str, value: Any, meaning: str) -> str:
        """Name of a constant number of a module."""
        wanted = name.strip("_").upper()
        for option in (wanted, *(f"{wanted}_{i}" for i in range(2, 100))):
            held = self.defines.setdefault(option, (value, meaning))[0]
            if held == value and isinstance(held, type(value)):
                self.names.add(option)
                return option
        raise Unprintable(f"{name}: too many constants of this name")


@dataclass
class Written:
    """Fields that some kernel changes; it grows until another pass finds no more."""

    fields: set[tuple[Struct, str]] = field(default_factory=set)

    def __contains__(self, key: object) -> bool:
        return key in self.fields

    def has_any(self, struct: Struct) -> bool:
        """Whether anything in a struct or its parts is changed."""
        mine = {name for owner, name in self.fields if owner is struct}
        return bool(mine) or any(self.has_any(part) for part in struct.parts.values())


def view_of(
    handle: Handle, place: Scalar, shape: tuple[Scalar, ...], written: Written, constants: Constants
) -> View:
    """View of a struct's flat memory from a place on, as a part of the array that stands there."""
    struct, side = handle.struct, handle.side
    position = linear(place)
    if isinstance(position.origin, tuple) and position.origin[0] is struct:
        f: Field = position.origin[1]
    else:
        f = struct.array_at(side, position.base)
    offset = add(place, Known(int(struct.memory.numbers[f.index]), origin=(struct, f)), -1)
    kind: Kind = "int" if side == "numbers" else "time" if f.is_time else "real"
    if kind == "time" and not constants.style.single:
        kind = "real"
    if (struct, f.name) in written:
        text = handle.field_text(f.name)
        return View(text, offset, shape, kind, Root(struct, f.name), offset)
    name = constants.array(struct, f.name)
    return View(name, offset, shape, kind, Root(struct, f.name), offset, struct.values(f))


def initial_values(struct: Struct, written: Written, style: Style, own: Mapping[str, str]) -> str:
    """Braced initialiser of a struct with what its fields hold before the first step."""
    lines = _initial_lines(struct, written, style, 0)
    return "\n".join([lines[0], *(f"    0, /* {name} */" for name in own), *lines[1:]])


def _initial_lines(struct: Struct, written: Written, style: Style, depth: int) -> list[str]:
    pad = "    " * (depth + 1)
    lines = ["{" if depth == 0 else f"{'    ' * depth}{{"]
    for f in members(struct, written):
        if f.kind == "part":
            lines += _initial_lines(struct.parts[f.name], written, style, depth + 1)
            lines[-1] += f" /* {f.name} */"
            continue
        is_array = f.name in struct.memory.shapes
        values = struct.values(f).tolist() if is_array else [struct.value(f)]
        _, texts = element_texts(f, values if any(values) else values[:1], style)
        text = "{" + ", ".join(texts) + "}" if is_array else texts[0]
        lines += wrapped(f"{text}, /* {f.name} */", pad)
    lines.append(f"{'    ' * depth}}}{',' if depth else ''}")
    return lines


def element_texts(f: Field, values: Sequence[Any], style: Style) -> tuple[str, list[str]]:
    """C type and constants of the elements of a field; raises ExportError if one does not fit."""
    if f.kind in ("integer", "integers"):
        return "int", [str(value) for value in values]
    kind: Kind = "time" if f.is_time else "real"
    if style.single and kind == "real":
        large = [v for v in values if np.isfinite(v) and abs(v) > float(np.finfo(np.float32).max)]
        if large:
            raise ExportError(f"{large[0]!r} does not fit a float; export in double")
    return style.type(kind), [style.literal(value, kind) for value in values]


def wrapped(text: str, pad: str, width: int = 100) -> list[str]:
    """Lines of a statement or initialiser, broken at spaces where it is too long."""
    lines, indent = [], pad
    while len(indent) + len(text) > width:
        room = width - len(indent)
        cut = max(_last(text, ", ", room), _last(text, " = ", room), *_operators(text, room))
        if cut <= 0:
            break
        lines.append(indent + text[:cut].rstrip())
        text, indent = text[cut:].lstrip(), pad + "    "
    return [*lines, indent + text]


def _last(text: str, mark: str, room: int) -> int:
    """Where to go on after the last mark within room."""
    at = text.rfind(mark, 0, room)
    return at + len(mark) if at > 0 else -1


def _operators(text: str, room: int) -> list[int]:
    marks = (" && ", " || ", " + ", " - ", " * ", " / ", " | ", " ? ", " : ")
    return [text.rfind(mark, 0, room) for mark in marks]


def members(struct: Struct, written: Written) -> list[Field]:
    """Fields of the C struct: those that change, and parts in which anything does."""
    found = []
    for f in struct.memory.layout.fields.values():
        if f.kind == "part":
            changes = written.has_any(struct.parts[f.name])
        else:
            changes = (struct, f.name) in written
        if changes and (f.name not in struct.memory.shapes or struct.size(f)):
            found.append(f)
    return found


def declaration(struct: Struct, written: Written, style: Style, own: Mapping[str, str]) -> str:
    """Typedef of the C struct, its fields explained."""
    lines = ["typedef struct {", *(f"    int {name}; /* {own[name]} */" for name in own)]
    for f in members(struct, written):
        size = f"[{struct.size(f)}]" if f.name in struct.memory.shapes else ""
        if f.kind == "part":
            kind = struct.parts[f.name].type
        elif f.kind in ("integer", "integers"):
            kind = "int"
        else:
            kind = style.type("time" if f.is_time else "real")
        lines.append(f"    {kind} {f.name}{size}; /* {f.meaning} */")
    return "\n".join([*lines, f"}} {struct.type};"])
