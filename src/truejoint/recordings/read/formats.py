"""Every file layout by name; its reader is imported when it is first called."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Any, Final

from truejoint.errors import RecordingError, unknown
from truejoint.plugins import call_plugin, load_plugin, plugins

if TYPE_CHECKING:  # a list of the names needs no NumPy
    from truejoint.recordings.table.recording import Recording


@dataclass(frozen=True)
class Format:
    """A file layout.

    Attributes
    ----------
    name : str
    summary : str
        What it is, in a few words for a person.
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
    read: Callable[..., Recording | list[Recording]]
    options: tuple[str, ...] = ()
    folder: bool = False
    reads_head: bool = False


def _own(
    name: str,
    summary: str,
    reader: str,
    options: tuple[str, ...] = (),
    *,
    folder: bool = False,
    **stated: str,
) -> Format:
    """Layout whose reader, a function of a module of this package, is imported when called."""

    def read(*args: Any, **named: Any) -> Recording:
        recording: Recording = resolve_name(f"truejoint.recordings.{reader}")(
            *args, **named, **stated
        )
        return recording

    return Format(name, summary, read, options, folder, reads_head=reader in _READ_HEAD)


def _public(name: str, summary: str, *, folder: bool = False) -> Format:
    """Layout of a public data set."""
    return _own(name, summary, _LAYOUTS, folder=folder, layout=name)


_MAPPED_FILE: Final = "read.mapped:read"
_LAYOUTS: Final = "read.layouts:read"
_RAVEN_240: Final = "read.raven_csv:read_240"
_RAVEN_252: Final = "read.raven_csv:read_252"
_READ_HEAD: Final = (_MAPPED_FILE, _LAYOUTS, _RAVEN_240, _RAVEN_252)
_MAPPED: Final = ("robot", "arm", "column_map", "rate")
_TRUTH: Final = ("arm", "truth_unit")
_BAG: Final = ("robot", "arm", "profile", "state", "truth", "quantities", "offset")
FORMATS: Final[Mapping[str, Format]] = {
    entry.name: entry
    for entry in (
        _own("parquet", "what truejoint writes", "table.parquet:read_parquet"),
        _own("csv", "header, or column map", _MAPPED_FILE, _MAPPED),
        _own("arrays", ".npy or .mat with a column map", _MAPPED_FILE, _MAPPED),
        _own("arrows", "what a recorder was stopped in", "table.stream_file:read_stream_file"),
        _own("bag", "ROS 1 and ROS 2 bags", "read.bags.reading:read_bag", _BAG, folder=True),
        _own("raven_csv_240", "RAVEN-II state", _RAVEN_240, ("arm",)),
        _own("raven_csv_252", "RAVEN-II state with external encoders", _RAVEN_252, _TRUTH),
        _public("davinci_grasper_umn", "da Vinci grasper bench"),
        _public("dvrk_psm_berkeley", "dVRK PSM, .npy folder", folder=True),
        _public("bros_dual_encoder", "two-joint haptic arm, .mat"),
        _public("kuka_kr300_dual_encoder", "KUKA KR300, .mat"),
        _public("kflex_tendon_sheath", "K-FLEX bending joint"),
    )
}
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
        raise RecordingError(unknown("format", name, format_names()))
    entry: Format = load_plugin(others[name], Format)
    return replace(entry, read=partial(call_plugin, others[name], entry.read))
