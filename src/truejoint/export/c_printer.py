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

import ast
import builtins
import inspect
import re
import sys
import textwrap
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from typing import Any, Final

import numpy as np
from numba.core.dispatcher import Dispatcher

from truejoint import compiled as marks
from truejoint import layout
from truejoint.export.c_statements import (
    Block,
    Statement,
    Variable,
    block_lines,
    names_in,
    pruned,
    wrapped_comment,
)
from truejoint.export.c_structs import (
    Constants,
    Handle,
    Struct,
    Unprintable,
    Written,
    declaration,
    initial_values,
    view_of,
    wrapped,
)
from truejoint.export.c_values import (
    AND,
    BIT_AND,
    BIT_OR,
    CHOICE,
    EQUALITY,
    LOWEST,
    OR,
    ORDER,
    PRIMARY,
    PRODUCT,
    SHIFT,
    SUM,
    UNARY,
    Expr,
    Kind,
    Known,
    Linear,
    Root,
    Scalar,
    Style,
    View,
    add,
    join,
    scale,
)
from truejoint.layout import Memory

_FUNCTIONS: Final = frozenset(
    {"sqrt", "exp", "expm1", "log", "log1p", "sin", "cos", "tan", "atan", "atan2", "tanh", "ceil",
     "floor", "hypot"}
)  # fmt: skip
_RESERVED: Final = frozenset(
    "auto break case char const continue default do double else enum extern float for goto if "
    "inline int long register restrict return short signed sizeof static struct switch typedef "
    "union unsigned void volatile while and bool catch class delete explicit export false friend "
    "mutable namespace new not operator or private protected public template this throw true try "
    "typename using virtual xor real main NAN INFINITY div abs exit y0 y1 yn j0 j1 jn gamma".split()
) | _FUNCTIONS
_COMPARE: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Lt: ("<", ORDER, lambda a, b: a < b), ast.LtE: ("<=", ORDER, lambda a, b: a <= b),
    ast.Gt: (">", ORDER, lambda a, b: a > b), ast.GtE: (">=", ORDER, lambda a, b: a >= b),
    ast.Eq: ("==", EQUALITY, lambda a, b: a == b), ast.NotEq: ("!=", EQUALITY, lambda a, b: a != b),
}  # fmt: skip
_ARITHMETIC: Final[Mapping[type, tuple[str, int, Callable[[Any, Any], Any]]]] = {
    ast.Add: ("+", SUM, lambda a, b: a + b), ast.Sub: ("-", SUM, lambda a, b: a - b),
    ast.Mult: ("*", PRODUCT, lambda a, b: a * b), ast.Div: ("/", PRODUCT, lambda a, b: a / b),
    ast.FloorDiv: ("/", PRODUCT, lambda a, b: a // b), ast.Mod: ("%", PRODUCT, lambda a, b: a % b),
    ast.BitOr: ("|", BIT_OR, lambda a, b: a | b), ast.BitAnd: ("&", BIT_AND, lambda a, b: a & b),
    ast.LShift: ("<<", SHIFT, lambda a, b: a << b),
    ast.RShift: (">>", SHIFT, lambda a, b: a >> b),
}  # fmt: skip
_LENGTH_NAMES: Final = {1: ("length",), 2: ("rows", "columns")}


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
        printer = Printer(style, written, dict(enums or {}))
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

    def __init__(self, style: Style, written: Written, enums: dict[type, str]) -> None:
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
            one = _Function(self, python, arguments, kinds, avoid)
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
        if wanted in _RESERVED:
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
        self.texts[name] = f"{about}@{name}@\n{{\n{lines}\n}}" if lines else f"{about}@{name}@\n{{\n}}"
        self.pointers[name] = one.pointers(parameters)
        self.tables[name] = one.globals_used & names_in(body)
        self.heads[name] = head
        return printed

    def has_effect(self, text: str) -> bool:
        return any(name in self.effects for name in re.findall(r"(\w+)\(", text))

    def program(
        self, struct: Struct, names: tuple[str, ...], own: Mapping[str, str]
    ) -> Program:
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
        if f.kind == "integers":
            kind, items = "int", [str(value) for value in values]
        else:
            kind = self.style.type("time" if f.is_time else "real")
            items = [self.style.literal(value, "time" if f.is_time else "real") for value in values]
        lines = wrapped(", ".join(items), "    ")
        lines = [lines[0], *(line[4:] for line in lines[1:])]
        body = "\n".join(lines)
        return f"/* {f.meaning} */\nstatic const {kind} {text}[{len(items)}] = {{\n{body}\n}};"

    def _head(self, name: str) -> str:
        """Head of a function, its pointers restricted where no call lets them overlap."""
        result, parameters = self.heads[name]
        pointers = {p for p, _, _ in self.pointers[name]}
        if len(pointers) > 1 and any(w for _, _, w in self.pointers[name]) and self._apart(name, ()):
            parameters = [
                re.sub(r"\*(?=\w+$)", "*restrict ", p) if p.split("*")[-1] in pointers else p
                for p in parameters
            ]
        return "\n".join(
            wrapped(f"static {result} {name}({', '.join(parameters) or 'void'})", "")
        )

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
                    if (pointers[p] or pointers[q]) and not self._disjoint(a, b, caller, seen, name):
                        return False
        return True

    def _disjoint(self, a: Any, b: Any, caller: Any, seen: tuple[str, ...], name: str) -> bool:
        if isinstance(a, Handle) or isinstance(b, Handle):
            return False
        if a.root == b.root:
            return _ends_before(a, b) or _ends_before(b, a)
        owners = [view.root.owner for view in (a, b)]
        if all(isinstance(owner, Struct) for owner in owners):
            return True
        return self._apart(caller.name, (*seen, name))

    def _helpers(self) -> dict[str, str]:
        real, suffix = self.style.real, "f" if self.style.single else ""
        kinds = {suffix and "_real": real, "_time": "double"} if suffix else {"_real": real}
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
    """What of an argument decides how a function is printed."""
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


@cache
def _tree(python: Any) -> tuple[ast.FunctionDef, dict[int, str]]:
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
def _definitions(module: str) -> dict[str, tuple[ast.expr | None, str, str]]:
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


def _assigned(nodes: Iterable[ast.stmt]) -> set[str]:
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


def _first_use(name: str, body: Sequence[ast.stmt]) -> str:
    """Whether a name is first "read" or first "set" by statements, or neither for certain."""
    for s in body:
        if isinstance(s, (ast.If, ast.For)):
            if _loads(name, [s.test if isinstance(s, ast.If) else s.iter]):
                return "read"
            uses = {_first_use(name, s.body), _first_use(name, s.orelse)}
            if "read" in uses:
                return "read"
            if uses == {"set"}:
                return "set"
            continue
        parts = [n for n in ast.iter_child_nodes(s) if isinstance(n, ast.expr)]
        if _loads(name, parts) or (isinstance(s, ast.AugAssign) and name in _assigned([s])):
            return "read"
        if name in _assigned([s]):
            return "set"
    return ""


@dataclass(eq=False)
class _Function:
    """One kernel for arguments of which something is known."""

    printer: Printer
    python: Any
    arguments: Sequence[Any]
    kinds: dict[str, Kind]
    avoid: set[str]
    body: list[Statement | Block] = field(default_factory=list)
    written: set[str] = field(default_factory=set)
    again: bool = False
    name: str = ""

    def __post_init__(self) -> None:
        self.style = self.printer.style
        self.tree, self.comments = _tree(self.python)
        self.out = self.body
        self.env: dict[str, Any] = {}
        self.returns: list[tuple[Statement, Any]] = []
        self.parameters: list[tuple[str, str, str, Any]] = []
        self.pointed: dict[str, View] = {}
        self.loops: list[ast.For] = []
        self.local_names: set[str] = set()
        self.globals_used: set[str] = set()
        self.declared: set[tuple[int, str]] = set()

    # ------------------------------------------------------------------ head and result

    def run(self) -> None:
        """Print the body."""
        names = [a.arg for a in self.tree.args.args]
        notes = [
            a.annotation.id if isinstance(a.annotation, ast.Name) else "" for a in self.tree.args.args
        ]
        for name, note, argument in zip(names, notes, self.arguments, strict=True):
            self.env[name] = self._parameter(name, note, argument)
        self.block(self.tree.body)
        self.finish()
        clash = self.local_names & self.globals_used
        if clash - self.avoid:
            self.avoid |= clash
            self.again = True

    def _local(self, name: str) -> str:
        """Name of a local variable, which hides no name that the function uses."""
        name = {"_": "turn"}.get(name, name.strip("_")) or "turn"
        while name in _RESERVED or name in self.avoid:
            name += "_"
        self.local_names.add(name)
        return name

    def _parameter(self, name: str, note: str, argument: Any) -> Any:
        local = self._local(name)
        if isinstance(argument, Handle):
            pointer = self._local(argument.struct.name)
            self.parameters.append((pointer, "struct", name, argument.struct))
            return Handle(argument.struct, argument.side, pointer, is_pointer=True, owner=pointer)
        if isinstance(argument, View):
            self.parameters.append((local, "view", name, argument.kind))
            shape = []
            for length, word in zip(argument.shape, _LENGTH_NAMES[len(argument.shape)], strict=True):
                if isinstance(length, Known):
                    shape.append(Known(length.value))
                else:
                    hidden = self._local(f"{name}_{word}")
                    self.parameters.append((hidden, "int", f"{name}.{word}", None))
                    shape.append(Expr(hidden, "int"))
            values = None
            if argument.values is not None and isinstance(argument.offset, Known):
                values = argument.values[argument.offset.value :]
            root = Root(self, local)
            view = View(local, Known(0), tuple(shape), argument.kind, root, Known(0), values)
            self.pointed[local] = view
            return view
        if isinstance(argument, Known) and note != "float" and argument.kind in ("int", "bool"):
            return argument
        if isinstance(argument, (Known, Expr, Linear)):
            kind: Kind = argument.kind
            kind = join([kind, "real"]) if note == "float" else kind
            self.parameters.append((local, kind, name, None))
            return Variable(local, kind, assigned=2)
        return argument

    def head(self, body: list[Statement | Block]) -> tuple[tuple[str, tuple[str, ...]], list[str]]:
        """Return type with declarations of the parameters that are used; and their Python names."""
        used = names_in(body) | {
            s.target.name for s in _statements(body) if s.target is not None
        }
        texts, names, seen = [], [], set()
        for local, sort, name, extra in self.parameters:
            if local not in used or local in seen:
                continue
            seen.add(local)
            constant = "" if local in self.written else "const "
            if sort == "struct":
                texts.append(f"{constant}{extra.type} *{local}")
            elif sort == "view":
                texts.append(f"{constant}{self.style.type(extra)} *{local}")
            else:
                texts.append(f"{self.style.type(sort)} {local}")  # type: ignore[arg-type]
            names.append(name)
        result = self.result
        kind = "void" if result is None or isinstance(result, Known) else self.style.type(result)
        return (kind, tuple(texts)), names

    def pointers(self, names: list[str]) -> list[tuple[str, str, bool]]:
        """Local name, Python name and whether it is written, of each pointer parameter in use."""
        return [
            (local, name, local in self.written)
            for local, sort, name, _ in self.parameters
            if sort in ("view", "struct") and name in names
        ]

    def calls_with_effect(self, body: list[Statement | Block], effects: set[str]) -> bool:
        """Whether a function that is called has an effect."""
        return bool(names_in(body) & effects)

    @property
    def result(self) -> Any:
        """Known result, kind of the result, or None."""
        values = [value for _, value in self.returns]
        if not values or values[0] is None:
            return None
        first = values[0]
        if isinstance(first, Known) and all(
            isinstance(v, Known) and v.value == first.value and type(v.value) is type(first.value)
            for v in values
        ):
            return first
        return join([value.kind for value in values])

    # ------------------------------------------------------------------ statements

    def fail(self, node: ast.AST, why: str) -> Unprintable:
        """Error that says where in the Python."""
        line = getattr(node, "lineno", 0)
        return Unprintable(f"{self.python.__module__}.{self.python.__name__}, line {line}: {why}")

    def emit(self, text: str, target: Variable | None = None, **more: Any) -> None:
        """Add a statement."""
        self.out.append(Statement(text, target, **more))

    def block(self, body: Sequence[ast.stmt]) -> bool:
        """Print statements; whether control never goes on behind them."""
        for i, statement in enumerate(body):
            comment = self.comments.get(statement.lineno)
            place = len(self.out)
            ends = self.statement(statement, body[i + 1 :])
            if comment and len(self.out) > place and not self.returns_only_known(place):
                self.out.insert(place, Statement(comment, comment=True))
            if ends:
                return True
        return False

    def returns_only_known(self, place: int) -> bool:
        """Whether what was printed since is no more than a bare return."""
        return len(self.out) == place + 1 and self.out[place].__class__ is Statement and not (
            self.out[place].text  # type: ignore[union-attr]
        )

    def statement(self, s: ast.stmt, rest: Sequence[ast.stmt]) -> bool:
        """Print one statement; whether control never goes on behind it."""
        if isinstance(s, ast.Expr):
            if not isinstance(s.value, ast.Constant):
                self.call_statement(self.value(s.value))
        elif isinstance(s, ast.Assign):
            self.assignment(s.targets, s.value)
        elif isinstance(s, ast.AnnAssign) and s.value is not None:
            self.assignment([s.target], s.value)
        elif isinstance(s, ast.AugAssign):
            self.augmented(s)
        elif isinstance(s, ast.For):
            return self.loop(s, rest)
        elif isinstance(s, ast.If):
            return self.choice(s, rest)
        elif isinstance(s, ast.Return):
            self.give_back(s)
            return True
        elif isinstance(s, (ast.Continue, ast.Break)):
            if not self.loops:
                raise self.fail(s, "it leaves a loop that is unrolled")
            self.emit("continue" if isinstance(s, ast.Continue) else "break")
            return True
        elif not isinstance(s, ast.Pass):
            raise self.fail(s, f"{type(s).__name__} has no C here")
        return False

    def call_statement(self, value: Any) -> None:
        """Print a call whose result nobody wants."""
        if isinstance(value, Expr):
            self.emit(value.text)

    def give_back(self, s: ast.Return) -> None:
        """Print a return."""
        value = None if s.value is None else self.value(s.value)
        statement = Statement("return")
        self.returns.append((statement, value))
        self.out.append(statement)

    def finish(self) -> None:
        """Write the values of returns, once the kind of the result is known."""
        result = self.result
        for statement, value in self.returns:
            if result is not None and not isinstance(result, Known):
                statement.text = f"return {self.style.text(value, kind=result)}"
        last = self.body[-1] if self.body else None
        if isinstance(last, Statement) and last.text == "return":
            self.body.pop()

    def assignment(self, targets: Sequence[ast.expr], source: ast.expr) -> None:
        """Print ``a = b = value`` and ``a, b = values``."""
        if isinstance(targets[0], ast.Tuple):
            assert isinstance(source, ast.Tuple)  # noqa: S101  # kernels return no tuples
            values = [self.value(e) for e in source.elts]
            for target, value in zip(targets[0].elts, values, strict=True):
                self.assign(target, value)
            return
        value = self.value(source)
        for target in targets:
            self.assign(target, value)

    def assign(self, target: ast.expr, value: Any) -> None:
        """Print one assignment."""
        if isinstance(target, ast.Subscript):
            self.store(target, value)
            return
        assert isinstance(target, ast.Name)  # noqa: S101  # kernels have no attributes
        name = target.id
        if isinstance(value, View):
            self.env[name] = self.pointer(name, value)
            return
        held = self.env.get(name)
        variable = held if isinstance(held, Variable) else None
        if variable is None and isinstance(value, Known):
            self.env[name] = value
        elif variable is None and isinstance(value, Handle):
            self.env[name] = value
        elif value is None:
            raise self.fail(target, "a call gives nothing to assign")
        else:
            self.set_variable(name, value, variable)

    def set_variable(self, name: str, value: Scalar, variable: Variable | None) -> None:
        """Print an assignment to a variable, which is declared if it is not yet."""
        if isinstance(value, Known) and name in self.kinds and value.kind == "int":
            kind: Kind = join([value.kind, self.kinds[name]])
        else:
            kind = join([value.kind, self.kinds.get(name, value.kind)])
        if self.kinds.get(name) != kind:
            if name in self.kinds or (variable is not None and variable.kind != kind):
                self.again = True
            self.kinds[name] = kind
        declares = variable is None
        if variable is None:
            variable = Variable(self._local(name), kind)
            self.env[name] = variable
        variable.assigned += 1
        text = self.converted(value, variable.kind)
        self.emit(text, variable, declares=declares)

    def converted(self, value: Scalar, kind: Kind) -> str:
        """Text of a value for a variable or element of that kind."""
        if kind == "real" and value.kind == "time" and not isinstance(value, Known):
            return f"({self.style.real}){self.style.text(value, UNARY)}"
        return self.style.text(value, kind=kind)

    def pointer(self, name: str, view: View) -> View:
        """View for a name: itself where its place is known, else through a local pointer."""
        if isinstance(view.offset, Known) or view.text == name:
            return view
        self.use(view)
        local = self._local(name)
        while (id(self.out), local) in self.declared:
            local += "_"
        self.declared.add((id(self.out), local))
        variable = Variable(local, view.kind, is_pointer=True, assigned=1)
        offset = self.style.text(view.offset)
        self.emit(f"{view.text} + {offset}", variable, declares=True)
        return replace(
            view, text=variable.name, offset=Known(0), pointer=(variable, view), values=None
        )

    def store(self, target: ast.Subscript, value: Scalar) -> None:
        """Print an assignment to an element, or to each element of a slice."""
        if isinstance(target.slice, ast.Slice):
            view = self.value(target)
            index = self._local("index")
            self.mark(view)
            element = self.element(replace(view, values=None), Expr(index, "int"))
            count = self.style.text(view.shape[0], ORDER + 1)
            loop = Block(f"for (int {index} = 0; {index} < {count}; {index}++)")
            loop.body.append(
                Statement(f"{element.text} = {self.converted(value, view.kind)}")
            )
            self.out.append(loop)
            return
        place_ = self.place(target, write=True)
        self.emit(f"{place_.text} = {self.converted(value, place_.kind)}")

    def augmented(self, s: ast.AugAssign) -> None:
        """Print ``a += value`` and the like."""
        sign = _ARITHMETIC[type(s.op)][0]
        if isinstance(s.target, ast.Name):
            held = self.env.get(s.target.id)
            if isinstance(held, Variable):
                value = self.value(s.value)
                if isinstance(value, Known) and isinstance(s.op, (ast.BitOr,)) and value.value == 0:
                    return
                kind = join([held.kind, value.kind])
                if kind != held.kind:
                    self.kinds[s.target.id] = kind
                    self.again = True
                held.assigned += 1
                self.emit(self.converted(value, held.kind), held, operator=f"{sign}=")
                return
            load = ast.copy_location(ast.Name(s.target.id, ast.Load()), s.target)
            self.assign(s.target, self.value(ast.copy_location(ast.BinOp(load, s.op, s.value), s)))
            return
        assert isinstance(s.target, ast.Subscript)  # noqa: S101  # kernels have no attributes
        value = self.value(s.value)
        place = self.place(s.target, write=True)
        self.emit(f"{place.text} {sign}= {self.converted(value, place.kind)}")

    # ------------------------------------------------------------------ loops and choices

    def materialise(self, names: Iterable[str]) -> None:
        """Make variables of what is known so far, since it is about to change."""
        for name in sorted(names):
            held = self.env.get(name)
            if isinstance(held, Known):
                self.set_variable(name, held, None)
                variable = self.env[name]
                variable.assigned += 1
            elif isinstance(held, Expr):
                local = Variable(held.text, held.kind, assigned=2)
                self.env[name] = local

    def hoist(self, names: Iterable[str], rest: Sequence[ast.stmt]) -> None:
        """Declare variables that are set within a choice or loop and read behind it."""
        for name in sorted(names):
            if name not in self.env and _first_use(name, rest) == "read":
                kind = self.kinds.get(name)
                if kind is None:
                    kind = self.kinds[name] = "bool"
                    self.again = True
                variable = Variable(self._local(name), kind, assigned=2)
                self.env[name] = variable
                self.emit("", variable, declares=True)

    def inner(self, head: str, body: Sequence[ast.stmt], env: dict[str, Any]) -> tuple[Block, bool]:
        """Print the body of a loop or branch, whose own names end with it."""
        out, outer = self.out, self.env
        block = Block(head)
        self.out, self.env = block.body, {**outer, **env}
        ends = self.block(body)
        self.out, self.env = out, outer
        return block, ends

    def loop(self, s: ast.For, rest: Sequence[ast.stmt]) -> bool:
        """Print a loop, or its rounds one by one where they are few or marked."""
        assert isinstance(s.target, ast.Name)  # noqa: S101  # ranges give numbers
        call = s.iter
        if not (isinstance(call, ast.Call) and getattr(call.func, "id", "") == "range"):
            raise self.fail(s, "only a range has C")
        limits = call.args
        marked = False
        if len(limits) == 1 and isinstance(limits[0], ast.Call):
            marked = self.lookup(limits[0].func) is marks.unrolled
        bounds = [self.value(a) for a in limits]
        start, stop, step = (
            (Known(0), bounds[0], Known(1))
            if len(bounds) == 1
            else (*bounds, Known(1))
            if len(bounds) == 2
            else bounds
        )
        if not isinstance(step, Known):
            raise self.fail(s, "the step of a range is not known")
        if isinstance(start, Known) and isinstance(stop, Known):
            rounds = range(start.value, stop.value, step.value)
            leaves = any(isinstance(n, (ast.Continue, ast.Break)) for n in ast.walk(s))
            if not rounds or marked or (len(rounds) == 1 and not leaves):
                return self.rounds(s, rounds)
        if marked:
            raise self.fail(s, "the rounds of an unrolled loop are not known")
        names = _assigned(s.body)
        self.materialise(names)
        self.hoist(names, rest)
        name = self._local(s.target.id)
        sign, way = ("<", f"{name}++") if step.value == 1 else (
            (">", f"{name}--") if step.value == -1 else ("<", f"{name} += {step.value}")
        )
        if step.value < -1:
            raise self.fail(s, "a range goes down by one only")
        head = (
            f"for (int {name} = {self.style.text(start)}; "
            f"{name} {sign} {self.style.text(stop, ORDER + 1)}; {way})"
        )
        self.loops.append(s)
        block, _ = self.inner(head, s.body, {s.target.id: Expr(name, "int")})
        self.loops.pop()
        self.out.append(block)
        return False

    def rounds(self, s: ast.For, rounds: range) -> bool:
        """Print the rounds of a loop one after the other."""
        loops, self.loops = self.loops, []
        assert isinstance(s.target, ast.Name)  # noqa: S101  # checked before
        for number in rounds:
            self.env[s.target.id] = Known(number)
            if self.block(s.body):
                self.loops = loops
                return True
        self.loops = loops
        return False

    def choice(self, s: ast.If, rest: Sequence[ast.stmt]) -> bool:
        """Print a choice, or what is chosen where that is known."""
        test = self.truth(s.test)
        if isinstance(test, Known):
            return self.block(s.body if test.value else s.orelse)
        names = _assigned([*s.body, *s.orelse])
        self.materialise(names)
        self.hoist(names, rest)
        return self.branches(s, test, "if")

    def branches(self, s: ast.If, test: Any, word: str) -> bool:
        """Print the branches of a choice, whose variables are declared."""
        head = f"{word} ({self.style.text(test)})"
        chosen, ends = self.inner(head, s.body, {})
        self.out.append(chosen)
        if len(s.orelse) == 1 and isinstance(s.orelse[0], ast.If):
            nested = s.orelse[0]
            place = len(self.out)
            other = self.truth(nested.test)
            if len(self.out) == place and not isinstance(other, Known):
                return self.branches(nested, other, "else if") and ends
            del self.out[place:]
        body = s.orelse
        if not body:
            return False
        block, also = self.inner("else", body, {})
        if block.body:
            self.out.append(block)
        return ends and also

    # ------------------------------------------------------------------ values

    def truth(self, node: ast.expr) -> Any:
        """Value of a test."""
        value = self.value(node)
        if isinstance(value, Known):
            return Known(bool(value.value))
        return value

    def lookup(self, node: ast.expr) -> Any:
        """Object that a global name or attribute stands for."""
        if isinstance(node, ast.Name):
            if node.id in self.python.__globals__:
                return self.python.__globals__[node.id]
            if hasattr(builtins, node.id):
                return getattr(builtins, node.id)
            raise self.fail(node, f"{node.id} is not known here")
        if isinstance(node, ast.Attribute):
            return getattr(self.lookup(node.value), node.attr)
        raise self.fail(node, "this is no name")

    def value(self, node: ast.expr) -> Any:
        """Value of an expression, as far as it is known."""
        method = getattr(self, f"_{type(node).__name__.lower()}", None)
        if method is None:
            raise self.fail(node, f"{type(node).__name__} has no C here")
        return method(node)

    def _constant(self, node: ast.Constant) -> Known:
        if not isinstance(node.value, (bool, int, float)):
            raise self.fail(node, f"{node.value!r} is no number")
        return Known(node.value)

    def _name(self, node: ast.Name) -> Any:
        if node.id in self.env:
            held = self.env[node.id]
            return Expr(held.name, held.kind) if isinstance(held, Variable) else held
        return self.constant(node)

    def constant(self, node: ast.Name | ast.Attribute) -> Any:
        """Constant of a module, by the name that C has for it."""
        value = self.lookup(node)
        if isinstance(value, np.generic):
            value = value.item()
        if not isinstance(value, (bool, int, float)):
            return value
        if isinstance(node, ast.Name):
            module, name = self.python.__module__, node.id
        else:
            module, name = getattr(self.lookup(node.value), "__name__", ""), node.attr
        return self.named(module, name, value)

    def named(self, module: str, name: str, value: Any) -> Known:
        """Known number with the name that C has for it."""
        plain = value
        if module in ("math", "numpy"):
            if not np.isfinite(plain):
                return Known(plain)
            return Known(plain, self.printer.constants.define(name, plain, ""))
        found = _definitions(module).get(name)
        while found is not None and found[0] is None:
            module, name = found[1], found[2]
            if module in ("math", "numpy"):
                return self.named(module, name, value)
            found = _definitions(module).get(name)
        if found is None or found[0] is None:
            return Known(plain)
        source = found[0]
        if isinstance(plain, int) and isinstance(getattr(source, "func", None), ast.Attribute):
            return Known(plain)  # an index that a Layout gave
        if isinstance(source, ast.Call) and getattr(source.func, "id", "") == "int":
            members = self.members(module, source.args[0])
            return Known(plain, members)
        if not isinstance(plain, (int, float)) or isinstance(plain, bool):
            return Known(plain)
        single = self.style.single and isinstance(plain, float)
        rounding = "2.220446049250313e-16" in ast.unparse(source)
        shown = plain
        if single and rounding:
            # What is said in roundings of a double is meant in roundings of the arithmetic.
            shown = plain / 2.220446049250313e-16 * float(np.finfo(np.float32).eps)
        return Known(plain, self.printer.constants.define(name, shown, ""))

    def members(self, module: str, node: ast.expr) -> str:
        """Enumeration members joined by ``|``, as C knows them; empty if it does not."""
        names = []
        for part in ast.walk(node):
            if isinstance(part, ast.Attribute) and isinstance(part.value, ast.Name):
                owner = getattr(sys.modules[module], part.value.id, None)
                if owner not in self.printer.enums:
                    return ""
                names.append(self.printer.enums[owner] + part.attr)
        return " | ".join(names)

    def _attribute(self, node: ast.Attribute) -> Any:
        if node.attr == "shape":
            return self.value(node.value).shape
        return self.constant(node)

    def _unaryop(self, node: ast.UnaryOp) -> Any:
        if isinstance(node.op, ast.Not):
            value = self.truth(node.operand)
            if isinstance(value, Known):
                return Known(not value.value)
            return Expr(f"!{self.style.text(value, UNARY)}", "bool", UNARY)
        value = self.value(node.operand)
        if isinstance(node.op, ast.UAdd):
            return value
        if isinstance(value, Known):
            return Known(-value.value)
        if value.kind in ("int", "bool"):
            return scale(value, -1)
        return Expr(f"-{self.style.text(value, UNARY + 1)}", value.kind, UNARY)

    def _boolop(self, node: ast.BoolOp) -> Any:
        both = isinstance(node.op, ast.And)
        parts: list[Any] = []
        for item in node.values:
            place = len(self.out)
            value = self.truth(item)
            if parts and len(self.out) != place:
                raise self.fail(item, "its calls cannot wait for what stands before them")
            if isinstance(value, Known):
                if value.value != both:
                    if not parts:
                        return value
                    parts.append(value)
                    break
                continue
            parts.append(value)
        if not parts:
            return Known(both)
        if isinstance(parts[-1], Known) and not any(
            self.printer.has_effect(part.text) for part in parts[:-1]
        ):
            return parts[-1]
        if len(parts) == 1:
            return parts[0]
        sign, level = ("&&", AND) if both else ("||", OR)
        text = f" {sign} ".join(
            self.style.text(part, level if _is_of(part, level) else BIT_OR) for part in parts
        )
        return Expr(text, "bool", level)

    def _ifexp(self, node: ast.IfExp) -> Any:
        test = self.truth(node.test)
        if isinstance(test, Known):
            return self.value(node.body if test.value else node.orelse)
        place = len(self.out)
        one, other = self.value(node.body), self.value(node.orelse)
        if len(self.out) != place:
            raise self.fail(node, "one of its values needs statements of its own")
        kind = join([one.kind, other.kind])
        texts = [self.style.text(v, CHOICE + 1, kind) for v in (one, other)]
        return Expr(f"{self.style.text(test, CHOICE + 1)} ? {texts[0]} : {texts[1]}", kind, CHOICE)

    def _compare(self, node: ast.Compare) -> Any:
        values = [self.value(n) for n in (node.left, *node.comparators)]
        parts: list[Any] = []
        for op, a, b in zip(node.ops, values, values[1:], strict=False):
            sign, level, compute = _COMPARE[type(op)]
            if isinstance(a, Known) and isinstance(b, Known):
                if not compute(a.value, b.value):
                    return Known(False)
                continue
            kind = join([a.kind, b.kind])
            left, right = (self.style.text(v, level + 1, kind) for v in (a, b))
            parts.append(Expr(f"{left} {sign} {right}", "bool", level))
        if not parts:
            return Known(True)
        if len(parts) == 1:
            return parts[0]
        return Expr(" && ".join(p.text for p in parts), "bool", AND)

    def _binop(self, node: ast.BinOp) -> Any:
        a = self.value(node.left)
        if isinstance(node.op, ast.Pow):
            return self.power(node, a)
        return self.operate(node, a, self.value(node.right))

    def power(self, node: ast.BinOp, a: Any) -> Any:
        """Second power, as numba computes it."""
        exponent = self.value(node.right)
        if isinstance(a, Known) and isinstance(exponent, Known):
            return Known(a.value**exponent.value)
        if not (isinstance(exponent, Known) and exponent.value == 2):
            raise self.fail(node, "of powers only squares have C")
        if isinstance(a, Expr) and re.fullmatch(r"[\w.>\-\[\]]+", a.text):
            return Expr(f"{a.text} * {a.text}", a.kind, PRODUCT)
        return Expr(f"{self.helper('square', a.kind)}({self.style.text(a)})", a.kind)

    def helper(self, name: str, kind: Kind) -> str:
        """Name of a small function for numbers of a kind."""
        ending = "real" if kind == "time" and not self.style.single else kind
        return f"{name}_{ending}"

    def operate(self, node: ast.AST, a: Any, b: Any) -> Any:
        """Result of an operator on two numbers."""
        op = node.op  # type: ignore[attr-defined]
        sign, level, compute = _ARITHMETIC[type(op)]
        kind = join([a.kind, b.kind])
        if isinstance(op, ast.Div):
            kind = join([kind, "real"])
        elif kind == "bool" and not isinstance(op, (ast.BitAnd, ast.BitOr)):
            kind = "int"
        if isinstance(a, Known) and isinstance(b, Known):
            return self.fold(op, a, b, kind, compute)
        if kind == "int" and isinstance(op, (ast.Add, ast.Sub)):
            return add(a, b, 1 if isinstance(op, ast.Add) else -1)
        if kind == "int" and isinstance(op, ast.Mult) and (isinstance(a, Known) or isinstance(b, Known)):
            return scale(b, a.value) if isinstance(a, Known) else scale(a, b.value)
        if isinstance(op, ast.BitOr):
            if isinstance(a, Known) and a.value == 0:
                return b
            if isinstance(b, Known) and b.value == 0:
                return a
        if isinstance(op, ast.BitAnd) and any(isinstance(v, Known) and v.value == 0 for v in (a, b)):
            return Known(0)
        if isinstance(op, ast.Mult) and kind in ("real", "time"):
            for one, other in ((a, b), (b, a)):
                if isinstance(one, Known) and one.value == 1.0 and other.kind == kind:
                    return other
        if isinstance(op, (ast.BitOr, ast.BitAnd)):
            left = self.style.text(a, level if _is_operation(a, sign) else UNARY, kind)
            right = self.style.text(b, level if _is_operation(b, sign) else UNARY, kind)
        else:
            left, right = self.style.text(a, level, kind), self.style.text(b, level + 1, kind)
        if isinstance(op, ast.Div) and a.kind in ("int", "bool") and b.kind in ("int", "bool"):
            left = f"({self.style.real}){self.style.text(a, UNARY)}"
        return Expr(f"{left} {sign} {right}", kind, level)

    def fold(self, op: ast.operator, a: Known, b: Known, kind: Kind, compute: Any) -> Known:
        """Result of an operator on two known numbers."""
        if kind in ("real", "time"):
            with np.errstate(all="ignore"):
                result = float(compute(np.float64(a.value), np.float64(b.value)))
            return Known(result)
        symbol = ""
        if isinstance(op, ast.BitOr):
            if a.value == 0 or b.value == 0:
                symbol = b.symbol if a.value == 0 else a.symbol
            elif a.symbol and b.symbol:
                symbol = f"{a.symbol} | {b.symbol}"
        origin = None
        if isinstance(op, ast.Add):
            origin = a.origin if b.origin is None else b.origin if a.origin is None else None
        return Known(compute(a.value, b.value), symbol, origin)

    # ------------------------------------------------------------------ arrays

    def _subscript(self, node: ast.Subscript) -> Any:
        if isinstance(node.value, ast.Attribute) and node.value.attr == "shape":
            index = self.value(node.slice)
            return self.value(node.value)[index.value]
        base = self.value(node.value)
        if isinstance(base, Handle):
            if isinstance(node.slice, ast.Slice):
                raise self.fail(node, "take a view of a field instead of a slice of the memory")
            return self.cell(base, self.value(node.slice), node, write=False)
        if not isinstance(base, View):
            raise self.fail(node, "this is no array")
        return self.item(base, node.slice, node)

    def item(self, base: View, index: ast.expr, node: ast.AST) -> Any:
        """Element, row or slice of a view."""
        if isinstance(index, ast.Slice):
            lower = Known(0) if index.lower is None else self.value(index.lower)
            upper = base.shape[0] if index.upper is None else self.value(index.upper)
            if len(base.shape) != 1 or index.step is not None:
                raise self.fail(node, "only a vector has such slices")
            return base.part(lower, (add(upper, lower, -1),))
        if isinstance(index, ast.Tuple):
            row, column = index.elts
            inside = self.row(base, self.value(row))
            return self.item(inside, column, node)
        where = self.value(index)
        if len(base.shape) == 2:
            return self.row(base, where)
        return self.element(base, where)

    def row(self, base: View, index: Scalar) -> View:
        """Row of a matrix."""
        columns = base.shape[1]
        if isinstance(columns, Known):
            offset = scale(index, columns.value)
        elif isinstance(index, Known):
            offset = scale(columns, index.value)
        else:
            a, b = self.style.text(index, PRODUCT), self.style.text(columns, PRODUCT + 1)
            offset = Expr(f"{a} * {b}", "int", PRODUCT)
        return base.part(offset, (columns,))

    def element(self, view: View, index: Scalar) -> Any:
        """Element of a vector: known where the array is constant and the place is known."""
        place = add(view.offset, index)
        values = view.values
        if values is not None and len(values):
            if isinstance(place, Known) and 0 <= place.value < len(values):
                return Known(values[place.value].item())
            bits = values.tobytes()
            if bits == bits[: values.itemsize] * len(values):
                return Known(values[0].item())
        self.use(view)
        return Expr(f"{view.text}[{self.style.text(place)}]", view.kind)

    def use(self, view: View) -> None:
        """Note a name at file scope."""
        if view.values is not None and not isinstance(view.root.owner, _Function):
            self.globals_used.add(view.text)

    def place(self, node: ast.Subscript, *, write: bool) -> Expr:
        """Element as something that can be assigned to."""
        base = self.value(node.value)
        if isinstance(base, Handle):
            return self.cell(base, self.value(node.slice), node, write=write)
        view = replace(base, values=None)
        found = self.item(view, node.slice, node)
        if write:
            self.mark(base)
        if not isinstance(found, Expr):
            raise self.fail(node, "only an element can be assigned to")
        return found

    def mark(self, view: View) -> None:
        """Note that an array is written."""
        while view.pointer is not None:
            view.pointer[0].written = True
            view = view.pointer[1]
        if isinstance(view.root.owner, Struct):
            self.printer.written.fields.add((view.root.owner, view.root.name))
            self.mark_struct(view.text)
        elif view.root.owner is self:
            self.written.add(view.root.name)
        else:
            raise Unprintable(f"{self.python.__name__} writes to {view.text}, which is constant")

    def mark_struct(self, text: str) -> None:
        """Note that a struct is written through a parameter."""
        self.written.add(re.split(r"->|\.", text)[0])

    def cell(self, base: Handle, index: Any, node: ast.AST, *, write: bool) -> Any:
        """Scalar, integer or element of an array of integers in a struct's memory."""
        struct = base.struct
        if isinstance(index, Known) and index.origin is None:
            f = struct.named(base.side, index.value)
            if f is not None:
                if write:
                    self.printer.written.fields.add((struct, f.name))
                    self.written.add(base.owner)
                    if f.kind not in ("scalar", "integer"):
                        raise self.fail(node, f"field {f.name} is no number that can change")
                if f.kind not in ("scalar", "integer"):
                    return Known(int(struct.memory.numbers[index.value]), origin=(struct, f))
                kind: Kind = "int" if f.kind == "integer" else "real"
                if f.is_time and self.style.single:
                    kind = "time"
                if (struct, f.name) in self.printer.written:
                    return Expr(base.field_text(f.name), kind)
                return Known(struct.value(f))
        view = view_of(base, index, (Known(1),), self.printer.written, self.printer.constants)
        if write:
            self.mark(view)
            view = replace(view, values=None)
        return self.element(view, Known(0))

    # ------------------------------------------------------------------ calls

    def _call(self, node: ast.Call) -> Any:
        if isinstance(node.func, ast.Attribute) and node.func.attr == "reshape":
            view = self.value(node.func.value)
            return replace(view, shape=tuple(self.value(a) for a in node.args))
        function = self.lookup(node.func)
        arguments = [self.value(a) for a in node.args]
        if node.keywords:
            raise self.fail(node, "keywords have no C")
        if function in (marks.vector, marks.matrix):
            return self.view(arguments, node)
        if function is marks.borrow or function is marks.unrolled:
            return arguments[0]
        if function in (layout.part_numbers, layout.part_memory):
            return self.part(function, arguments)
        name = getattr(function, "__name__", "")
        if name.startswith("call_") and not isinstance(function, Dispatcher):
            struct, f = arguments[0].origin
            function, arguments = struct.memory.functions[f.name], arguments[1:]
        if isinstance(function, Dispatcher):
            return self.call(function, arguments, node)
        return self.builtin(name, arguments, node)

    def view(self, arguments: list[Any], node: ast.AST) -> View:
        """What `vector` and `matrix` give."""
        base, place, *shape = arguments
        if isinstance(base, View):
            return base.part(place, tuple(shape))
        if not isinstance(base, Handle):
            raise self.fail(node, "this is no memory")
        return view_of(base, place, tuple(shape), self.printer.written, self.printer.constants)

    def part(self, function: Any, arguments: list[Any]) -> Handle:
        """What `part_numbers` and `part_memory` give."""
        base, which = arguments[0], arguments[-1]
        f = base.struct.named("numbers", which.value)
        side = "numbers" if function is layout.part_numbers else "memory"
        inner = base.struct.parts[f.name]
        return Handle(inner, side, base.field_text(f.name), is_pointer=False, owner=base.owner)  # type: ignore[arg-type]

    def builtin(self, name: str, arguments: list[Any], node: ast.AST) -> Any:
        """Call of a function of Python, `math` or NumPy."""
        if name == "len":
            return arguments[0].shape[0]
        if name in ("float", "float64", "int", "bool"):
            return self.convert(name[:5].rstrip("6"), arguments[0])
        if name in ("min", "max"):
            result = arguments[0]
            for other in arguments[1:]:
                if isinstance(result, Known) and isinstance(other, Known):
                    result = Known((min if name == "min" else max)(result.value, other.value))
                    continue
                kind = join([result.kind, other.kind])
                texts = ", ".join(self.style.text(v, kind=kind) for v in (result, other))
                result = Expr(f"{self.helper(name, kind)}({texts})", kind)
            return result
        if all(isinstance(a, Known) for a in arguments) and name in (*_FUNCTIONS, "fabs", "abs"):
            function = getattr(np, name, None) or getattr(np, f"arc{name[1:]}")
            with np.errstate(all="ignore"):
                return Known(function(*(a.value for a in arguments)).item())
        kind = join([a.kind for a in arguments])
        text = ", ".join(self.style.text(a, kind=kind) for a in arguments)
        suffix = "f" if self.style.single and kind != "time" else ""
        if name in ("abs", "fabs"):
            return Expr(f"fabs{suffix}({text})" if kind in ("real", "time") else f"abs({text})", kind)
        if name in ("isnan", "isfinite", "isinf"):
            if isinstance(arguments[0], Known):
                return Known(bool(getattr(np, name)(arguments[0].value)))
            return Expr(f"{name}({text})", "bool")
        if name == "sign":
            return Expr(f"{self.helper('sign', kind)}({text})", kind)
        if name in _FUNCTIONS:
            return Expr(f"{name}{suffix}({text})", join([kind, "real"]))
        raise self.fail(node, f"{name or 'this function'} has no C here")

    def convert(self, name: str, value: Any) -> Any:
        """Number of another kind."""
        if isinstance(value, Known):
            number = {"float": float, "int": int, "bool": bool}[name](value.value)
            return Known(number, value.symbol if type(number) is type(value.value) else "")
        if name == "bool":
            return value if value.kind == "bool" else Expr(f"{self.style.text(value, EQUALITY + 1)} != 0", "bool", EQUALITY)
        if name == "int":
            if value.kind in ("int", "bool"):
                return value
            return Expr(f"(int){self.style.text(value, UNARY)}", "int", UNARY)
        if value.kind == "real":
            return value
        return Expr(f"({self.style.real}){self.style.text(value, UNARY)}", "real", UNARY)

    def call(self, function: Any, arguments: list[Any], node: ast.AST) -> Any:
        """Call of another kernel."""
        tree, _ = _tree(function.py_func)
        if isinstance(tree.returns, ast.Name) and tree.returns.id in ("Array", "Integers"):
            return self.inlined(function.py_func, arguments, node)
        printed = self.printer.function(function, arguments)
        names = [a.arg for a in tree.args.args]
        given = dict(zip(names, arguments, strict=True))
        texts, passed = [], {}
        seen = set()
        notes = {a.arg: getattr(a.annotation, "id", "") for a in tree.args.args}
        for name in printed.parameters:
            base, _, length = name.partition(".")
            value = given[base]
            if length:
                text = self.style.text(value.shape[0 if length in ("length", "rows") else 1])
            elif isinstance(value, Handle):
                if (value.struct, value.text) in seen:
                    continue
                seen.add((value.struct, value.text))
                text = value.pointer
                passed[name] = value
            elif isinstance(value, View):
                self.use(value)
                offset = self.style.text(value.offset)
                text = value.text if offset == "0" else f"{value.text} + {offset}"
                passed[name] = value
            else:
                kind = join([value.kind, "real"]) if notes[base] == "float" else value.kind
                text = self.style.text(value, kind=kind)
            texts.append(text)
        locals_ = {python: local for local, python, _ in self.printer.pointers[printed.name]}
        by_local = {locals_[python]: value for python, value in passed.items()}
        self.printer.calls.append((printed.name, self, by_local))
        for local, value in by_local.items():
            if local in printed.written:
                if isinstance(value, View):
                    self.mark(value)
                else:
                    self.written.add(value.owner)
        self.globals_used.add(printed.name)
        text = f"{printed.name}({', '.join(texts)})"
        if isinstance(printed.result, Known) or printed.result is None:
            if printed.name in self.printer.effects:
                self.emit(text)
            return printed.result
        return Expr(text, printed.result)

    def inlined(self, python: Any, arguments: list[Any], node: ast.AST) -> Any:
        """Call of a function that only gives a view: its statements are run here."""
        outer = (self.python, self.tree, self.comments, self.env)
        tree, _ = _tree(python)
        env = dict(zip([a.arg for a in tree.args.args], arguments, strict=True))
        self.python, self.tree, self.comments, self.env = python, tree, {}, env
        try:
            for statement in tree.body:
                if isinstance(statement, ast.Return) and statement.value is not None:
                    return self.value(statement.value)
                self.statement(statement, ())
        finally:
            self.python, self.tree, self.comments, self.env = outer
        raise self.fail(node, "it gives no view at its end")


def _is_of(value: Any, level: int) -> bool:
    """Whether an expression is of the same operator, so that it needs no parentheses."""
    return isinstance(value, Expr) and value.level == level


def _is_operation(value: Any, sign: str) -> bool:
    """Whether a value is what the same operator gave."""
    if isinstance(value, Known):
        return sign in value.symbol
    level = {"|": BIT_OR, "&": BIT_AND}[sign]
    return isinstance(value, Expr) and value.level == level


def _statements(body: list[Statement | Block]) -> list[Statement]:
    found: list[Statement] = []
    for statement in body:
        if isinstance(statement, Block):
            found += _statements(statement.body)
        else:
            found.append(statement)
    return found
