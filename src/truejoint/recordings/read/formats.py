"""Every file layout by name; its reader is imported when it is first called."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import RecordingError, unknown
from truejoint.plugins import call_plugin, load_plugin, plugins
from truejoint.robots.catalogue import robot_names
from truejoint.toml_file import shipped_table

if TYPE_CHECKING:  # a list of the names needs no NumPy
    from truejoint.recordings.table.recording import Recording


@dataclass(frozen=True)
class Format:
    """A file layout.

    Attributes
    ----------
    name : str
    summary : str
        Description, in a few words for a person.
    read : callable
        Takes the path and any of `options`; gives a recording, or one for each session of a file
        whose clock restarts.
    options : tuple of str
        Names of the keyword arguments that `read` takes.
    folder : bool
        The recording is, or may be, a folder.
    reads_head : bool
        `read` takes ``head``, the first bytes of the file, where they were read before.

    Examples
    --------
    >>> FORMATS["parquet"].summary
    'what truejoint writes'
    """

    name: str
    summary: str
    read: "Callable[..., Recording | list[Recording]]"
    options: tuple[str, ...] = ()
    folder: bool = False
    reads_head: bool = False


def _load(name: str, summary: str, reader: str, options: Sequence[str] = (), **row: Any) -> Format:
    """Layout of a row of the table; its reader is imported when it is called."""

    def read(*args: Any, **how: Any) -> Any:
        return resolve_name(f"truejoint.recordings.{reader}")(*args, **how)

    return Format(name, summary, read, tuple(options), **row)


_ROWS: Final = shipped_table(__package__, "formats.toml")
FORMATS: Final[Mapping[str, Format]] = {name: _load(name, **row) for name, row in _ROWS.items()}
"""Every layout of truejoint's own by name."""


def format_names() -> tuple[str, ...]:
    """Names that `read_recording` knows: truejoint's own and those of other packages.

    Examples
    --------
    >>> format_names()[:2]
    ('parquet', 'csv')
    """
    return (*FORMATS, *plugins("truejoint.formats", tuple(FORMATS)))


def get_format(name: str) -> Format:
    """Layout called `name`; raises RecordingError naming those that there are."""
    if name in FORMATS:
        return FORMATS[name]
    others = plugins("truejoint.formats", tuple(FORMATS))
    if name not in others:
        robot = "; a robot is named by robot=" if name in robot_names() else ""
        raise RecordingError(unknown("format", name, format_names()) + robot)
    entry: Format = load_plugin(others[name], Format)
    return replace(entry, read=partial(call_plugin, others[name], entry.read))
