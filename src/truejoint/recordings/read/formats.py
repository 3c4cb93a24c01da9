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


def _own(
    name: str, summary: str, reader: str, options: tuple[str, ...] = (), *, folder: bool = False
) -> Format:
    """Layout whose reader, a function of a module of this package, is imported when called."""

    def read(*given: Any, **named: Any) -> Recording:
        found: Recording = resolve_name(f"truejoint.recordings.{reader}")(*given, **named)
        return found

    return Format(name, summary, read, options, folder)


_MAPPED: Final = ("robot", "arm", "column_map", "rate")
_TRUTH: Final = ("arm", "truth_unit")
_BAG: Final = ("robot", "arm", "profile", "state", "truth", "quantities", "offset")
FORMATS: Final[Mapping[str, Format]] = {
    entry.name: entry
    for entry in (
        _own("parquet", "what truejoint writes", "table.parquet:read_parquet"),
        _own("csv", "header, or column map", "read.mapped:read", _MAPPED),
        _own("arrays", ".npy or .mat with a column map", "read.mapped:read", _MAPPED),
        _own("arrows", "what a recorder was stopped in", "table.stream_file:read_stream_file"),
        _own("bag", "ROS 1 and ROS 2 bags", "read.bags.reading:read_bag", _BAG, folder=True),
        _own("raven_csv_240", "RAVEN-II state", "read.raven_csv:read_240", ("arm",)),
        _own(
            "raven_csv_252",
            "RAVEN-II state with external encoders",
            "read.raven_csv:read_252",
            _TRUTH,
        ),
        _own("davinci_grasper_umn", "da Vinci grasper bench", "read.davinci_grasper:read"),
        _own("dvrk_psm_berkeley", "dVRK PSM, .npy folder", "read.dvrk_berkeley:read", folder=True),
        _own("bros_dual_encoder", "two-joint haptic arm, .mat", "read.double_encoder:read_bros"),
        _own("kuka_kr300_dual_encoder", "KUKA KR300, .mat", "read.double_encoder:read_kuka"),
        _own("kflex_tendon_sheath", "K-FLEX bending joint", "read.kflex:read"),
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
