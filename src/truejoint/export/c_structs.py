"""The memory of kernels as C: a struct of what they change, constants for all the rest."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import ExportError
from truejoint.export.c_values import Kind, Style, wrapped
from truejoint.layout import PART_SIZE, Field, Memory

Side = Literal["numbers", "memory"]


class Unprintable(ExportError):
    """A kernel holds what has no C; the message says where."""


@dataclass(frozen=True)
class Constant:
    """A number of the C, or an array of them."""

    name: str
    texts: tuple[str, ...]
    type: str = ""  # of the elements of an array

    @property
    def numbers(self) -> list[float]:
        """What a compiler makes of it, in double."""
        return [
            float(np.float32(text[:-1])) if text.endswith("f") else float(text)
            for text in self.texts
        ]


@dataclass(eq=False)
class Struct:
    """One memory, those within it, and what of it some kernel changes."""

    name: str  # of pointers to it
    type: str  # of the C struct
    memory: Memory
    written: set[str] = field(default_factory=set)
    parts: "dict[str, Struct]" = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.fields: dict[tuple[Side, int], Field] = {}  # by the index that kernels use
        for f in self.memory.layout.fields.values():
            side: Side = "memory" if f.kind == "scalar" else "numbers"
            size = PART_SIZE if f.kind == "part" else 1
            self.fields |= {(side, f.index + i): f for i in range(size)}
            if f.kind == "part":
                name = f"{self.type.removesuffix('_state')}_{f.name}_state"
                self.parts[f.name] = Struct(f.name, name, self.memory.part(f.name))

    def values(self, f: Field) -> NDArray[Any]:
        """Elements of an array field, or the one number of another, in one dimension."""
        if f.name in self.memory.shapes:
            return np.asarray(self.memory.view(f.name)).ravel()
        source: Any = self.memory.memory if f.kind == "scalar" else self.memory.numbers
        return np.asarray(source[f.index : f.index + 1])

    def walk(self) -> "Iterator[Struct]":
        """Parts first, then this one."""
        for part in self.parts.values():
            yield from part.walk()
        yield self

    @property
    def changes(self) -> bool:
        """Whether anything in it or its parts is changed."""
        return any(part.written for part in self.walk())

    def members(self) -> list[Field]:
        """Fields of the C struct: those that change, and parts in which anything does."""
        return [
            f
            for f in self.memory.layout.fields.values()
            if (self.parts[f.name].changes if f.kind == "part"
                else f.name in self.written and self.values(f).size)
        ]  # fmt: skip

    def constant(self, f: Field, name: str, style: Style) -> Constant:
        """Name what a field holds before the first step."""
        type_ = style.type(kind_of(f)) if f.name in self.memory.shapes else ""
        return Constant(name, tuple(element_texts(f, self.values(f), style)), type_)

    def initial_constants(self, style: Style, where: str) -> Iterator[Constant]:
        """Give the numbers of the C struct that are not 0 before the first step."""
        for f in self.members():
            if f.kind == "part":
                yield from self.parts[f.name].initial_constants(style, f"{where}{f.name}.")
            elif kind_of(f) != "int" and np.nan_to_num(self.values(f)).any():
                yield self.constant(f, where + f.name, style)

    def declaration(self, style: Style) -> str:
        """Typedef of the C struct, its fields explained."""
        lines = ["typedef struct {"]
        for f in self.members():
            is_part = f.kind == "part"
            kind = self.parts[f.name].type if is_part else style.type(kind_of(f))
            size = f"[{self.values(f).size}]" if f.name in self.memory.shapes else ""
            lines.append(f"    {kind} {f.name}{size}; /* {f.meaning} */")
        return "\n".join([*lines, f"}} {self.type};"])

    def size(self, style: Style) -> tuple[int, int]:
        """Bytes of the C struct and its alignment, where numbers are aligned to their own size."""
        offset, alignment = 0, 1
        for f in self.members():
            if f.kind == "part":
                n_bytes, aligned_to = self.parts[f.name].size(style)
            else:
                aligned_to = style.size(style.type(kind_of(f)))
                n_bytes = aligned_to * (self.values(f).size if f.name in self.memory.shapes else 1)
            offset += -offset % aligned_to + n_bytes
            alignment = max(alignment, aligned_to)
        return offset + -offset % alignment, alignment

    def initial(self, style: Style, named: Mapping[str, str], depth: int = 0) -> list[str]:
        """Lines of a braced initialiser with what its fields hold before the first step.

        C knows the numbers of some fields by a name.
        """
        pad = "    " * depth
        lines = [f"{pad}{{"]
        for f in self.members():
            if f.kind == "part":
                lines += self.parts[f.name].initial(style, {}, depth + 1)
                lines[-1] += f" /* {f.name} */"
                continue
            values = self.values(f)
            texts = element_texts(f, values if values.any() else values[:1], style)
            single = named.get(f.name, texts[0])
            text = "{" + ", ".join(texts) + "}" if f.name in self.memory.shapes else single
            lines += wrapped(f"{text}, /* {f.name} */", f"{pad}    ")
        return [*lines, f"{pad}}}{',' if depth else ''}"]


@dataclass(frozen=True)
class Handle:
    """The numbers or the memory of a struct, as a kernel holds them."""

    struct: Struct
    side: Side
    text: str  # the struct, or a pointer to it, in C
    is_pointer: bool
    owner: str  # parameter of the function that it comes from

    def field_text(self, name: str) -> str:
        """Give a field of the struct in C."""
        return f"{self.text}{'->' if self.is_pointer else '.'}{name}"

    @property
    def pointer(self) -> str:
        """Pointer to the struct in C."""
        return self.text if self.is_pointer else f"&{self.text}"


@dataclass(frozen=True)
class Record:
    """The fields of a struct by name, as a kernel has unpacked them."""

    numbers: Handle
    memory: Handle


def kind_of(f: Field, style: Style | None = None) -> Kind:
    """Kind of the numbers of a field; in double precision, of a `style`, time is like the rest."""
    if f.kind in ("integer", "integers"):
        return "int"
    return "time" if f.is_time and (style is None or style.single) else "real"


def element_texts(f: Field, values: NDArray[Any], style: Style) -> list[str]:
    """Constants of elements of a field; raises ExportError if one does not fit."""
    kind = kind_of(f)
    if kind == "int":
        return [str(value) for value in values.tolist()]
    if style.single and kind == "real":
        large = values[np.isfinite(values) & (np.abs(values) > float(np.finfo(np.float32).max))]
        if large.size:
            raise ExportError(f"{large.tolist()[0]!r} does not fit a float; export in double")
    return style.literals(values, kind)
