"""How numbers, texts and tables become C99 source, and how a set of files is written."""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any, Final, Literal, get_args

import jinja2
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.errors import ExportError
from truejoint.export.c_values import Style
from truejoint.files import write_all_atomically

Precision = Literal["double", "float"]

MAX_PREFIX: Final = 40
_PREFIX: Final = re.compile(r"[A-Za-z](?:_?[A-Za-z0-9])*", re.ASCII)
_UNSAFE: Final = re.compile(r"[^A-Za-z0-9 _.,:;()\[\]{}<>=+/'%^-]")


def check_precision(precision: str) -> None:
    """Refuse, with ExportError, a precision other than ``"double"`` and ``"float"``."""
    if precision not in get_args(Precision):
        raise ExportError(f"precision {precision!r:.60} is not 'double' or 'float'")


def check_prefix(prefix: str) -> str:
    """Return `prefix` if every C and C++ name may begin with it; raises ExportError."""
    if len(prefix) > MAX_PREFIX or not _PREFIX.fullmatch(prefix):
        raise ExportError(
            f"prefix {prefix!r:.60} cannot begin the names of the source; use up to {MAX_PREFIX} "
            "letters, digits and single underscores, a letter first and no underscore last"
        )
    return prefix


def table(values: ArrayLike, precision: Precision) -> str:
    """Braced initialiser of the values of an array, row by row."""
    return f"{{{', '.join(Style(precision == 'float').literals(values))}}}"


def rows(values: Array, precision: Precision) -> list[str]:
    """Braced initialisers of the rows of an array (n, k)."""
    texts = Style(precision == "float").literals(values)
    starts = range(0, len(texts), max(values.shape[1], 1))
    return [f"{{{', '.join(texts[i : i + values.shape[1]])}}}" for i in starts]


def comment(text: object) -> str:
    """Text that cannot end a C comment, whatever a model file says: plain ASCII, no ``*``."""
    return _UNSAFE.sub(".", str(text))


def render(template: str, context: Mapping[str, Any], precision: Precision) -> str:
    """Fill a template of this package with `context`; an unknown name is an error."""
    single = precision == "float"
    names = {"real": precision, "suffix": "f" if single else "", "single": single}
    return _environment(precision).get_template(template).render(**names, **context)


@cache
def _environment(precision: Precision) -> jinja2.Environment:
    """Templates and filters, each template compiled once."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("truejoint.export", "templates"),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701  # C source; texts from files go through `comment`
    )
    filters: dict[str, Callable[[Any], str]] = {
        "table": lambda values: table(values, precision),
        "exact_table": lambda values: table(values, "double"),
        "comment": comment,
    }
    environment.filters.update(filters)
    return environment


def write_files(
    folder: str | os.PathLike[str], contents: Mapping[str, bytes], *, overwrite: bool
) -> tuple[Path, ...]:
    """Write `contents` by file name into `folder`, none of them if one may not be written.

    Raises ExportError if a file exists and `overwrite` is false, or one cannot be written.
    """
    paths = tuple(Path(folder) / name for name in contents)
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ExportError(f"{folder} cannot be written: {error.strerror or error}") from None
    writers = [partial(Path.write_bytes, data=content) for content in contents.values()]
    files = dict(zip(paths, writers, strict=True))
    write_all_atomically(files, overwrite=overwrite, error=ExportError)
    return paths
