"""What the judge of recordings can find: one line each; `findings.toml` has their meanings."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Final, Literal

from truejoint.toml_file import shipped_table

if TYPE_CHECKING:  # a list of the names needs no NumPy
    from truejoint.recordings.table.recording import Recording

Level = Literal["fail", "warn", "info", "good"]
Rows = tuple[tuple[int, int], ...]

ORDER: Final[dict[Level, int]] = {"fail": 0, "warn": 1, "info": 2, "good": 3}

_TABLE: Final = shipped_table(__package__, "findings.toml")
_ROWS: Final = {name: row for names in _TABLE.values() for name, row in names.items()}

HEADINGS: Final = tuple(_TABLE)
"""Headings in the order in which a person reads them."""

FINDINGS: Final[Mapping[str, str]] = {name: _ROWS[name][0] for name in sorted(_ROWS)}
"""Meaning of each name; ``--accept`` takes the names."""

_ADVICE: Final = {name: row[1] for name, row in _ROWS.items() if row[1:]}

HEADING_OF: Final[Mapping[str, str]] = {n: heading for heading in _TABLE for n in _TABLE[heading]}
"""Heading of each name."""

WELL: Final[Mapping[str, str]] = {name: row[2] for name, row in _ROWS.items() if len(row) > 2}
"""What is said where nothing under a heading is wrong, by one name of each."""


@dataclass(frozen=True)
class Finding:
    """One thing that the judge found.

    Attributes
    ----------
    level : {"fail", "warn", "info", "good"}
        ``"fail"``: results on these data would mislead; ``"warn"``: look before you trust them;
        ``"good"``: this was examined and is well.
    name : str
        One of `FINDINGS`, such as ``"outliers"`` or ``"delay"``; ``--accept`` takes it.
    what : str
        Observation, with its number.
    where : str
        Which joint, signal and recordings; empty for the whole recording.
    advice : str
        Remedy, by default that of the name; empty where all is well.
    rows : tuple of pairs of int
        Rows concerned of the recording that `where` names, each pair the first and the one behind
        the last; empty when it is about the whole.

    Examples
    --------
    >>> Finding("warn", "missing", "1 % of the truth is missing", "jaw", "look at the sensor").level
    'warn'
    """

    level: Level
    name: str
    what: str
    where: str
    advice: str = ""
    rows: Rows = ()

    def __post_init__(self) -> None:
        if not self.advice and self.level != "good":
            object.__setattr__(self, "advice", _ADVICE.get(self.name, ""))

    @property
    def heading(self) -> str:
        """Heading of its name, one of `HEADINGS`."""
        return HEADING_OF[self.name]

    @property
    def text(self) -> str:
        """Place and observation, for a person."""
        return f"{self.where}: {self.what}" if self.where else self.what


@dataclass(frozen=True)
class Defect(Finding):
    """A defect of one recording; `size` orders those with the same `name` and `where`."""

    size: float = 0.0


def one_line_each(
    defects: "Iterable[tuple[Defect, Recording]]", recordings: "Sequence[Recording]"
) -> Iterable[Finding]:
    """One finding for each kind of defect and signal; the worst recording speaks for all."""
    groups: dict[tuple[str, str, str], list[tuple[Defect, Recording]]] = {}
    for defect, recording in defects:
        key = (defect.name, defect.advice, defect.where)
        groups.setdefault(key, []).append((defect, recording))
    for group in groups.values():
        worst, recording = max(group, key=lambda pair: (-ORDER[pair[0].level], pair[0].size))
        others = len({id(item) for _, item in group}) - 1
        more = f" and {others} more of {len(recordings)} recordings" if others else ""
        file = PurePath(recording.provenance.source).name or "recording"
        where = f"{worst.where} in {file}{more}"
        yield Finding(worst.level, worst.name, worst.what, where, worst.advice, worst.rows)
