"""What public data sets there are: where they come from, their hashes and how to judge on them."""

import csv
import io
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from importlib.resources import files
from typing import Any, Final
from urllib.parse import quote

from truejoint.errors import RecordingError, unknown
from truejoint.toml_file import shipped_table

RAW_HOST: Final = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class DatasetFile:
    """One file of a data set.

    Attributes
    ----------
    name : str
        Its path in a copy of the data set, whose folder is named after it.
    upstream : str
        Its path in the upstream repository; ``owner/name@commit:path`` if that is another one.
    size : int
        [bytes].
    sha256 : str
        SHA-256 of the file as it is upstream, hexadecimal.

    Examples
    --------
    >>> len(get_dataset("kflex_tendon_sheath").recordings["0"][0].sha256)
    64
    """

    name: str
    upstream: str
    size: int
    sha256: str


@dataclass(frozen=True)
class HeldOut:
    """A way to hold out recordings, or the last part of each.

    Attributes
    ----------
    name : str
    files : str
        Pattern of the recordings that take part.
    test : str
        Pattern of those among them that are held out whole; empty to split by time.
    test_fraction : float
        Last part by time of each recording that is held out; 0 to split by recording.

    Examples
    --------
    >>> HeldOut("loads", files="*", test="*_500g").holds_out("run_500g")
    True
    """

    name: str
    files: str
    test: str = ""
    test_fraction: float = 0.0

    def __post_init__(self) -> None:
        if bool(self.test) == (0.0 < self.test_fraction < 1.0):
            raise RecordingError(
                f"split {self.name!r}: give either test or a test_fraction between 0 and 1"
            )

    def holds_out(self, recording: str) -> bool:
        """Whether the recording of this name (its session) is held out whole."""
        return bool(self.test) and fnmatchcase(recording, self.test)


@dataclass(frozen=True)
class Dataset:
    """A public set of recordings.

    Attributes
    ----------
    name, title : str
    robot : str
        As in `truejoint.robots.get_robot`.
    repository, commit : str
        On GitHub, ``owner/name``, and the commit that the hashes are of.
    licence : str
        SPDX name; empty if upstream states none: evaluate such data, do not pass it on.
    notice : str
        Notice that must stand beside results made with it; often empty.
    citation : str
    features : tuple of str
        Causal features that suit it, as `truejoint.features.FeatureSet.parse` takes them.
    fit_rate : float or None
        Rate [Hz] of the rows that a fit needs; None: all of them.
    settings : mapping
        Parameters that suit it, by estimator and name.
    splits : tuple of HeldOut
        Recommended ways to judge on it, the first by default; none where there is no truth.
    recordings : mapping
        Files by name of recording, several where it is a folder.
    layouts : sequence of mapping
        How the files stand, as ``catalogue.toml`` says it.

    Examples
    --------
    >>> get_dataset("davinci_grasper_umn").split().name
    'frequency'
    """

    name: str
    title: str
    robot: str
    repository: str
    commit: str
    citation: str
    features: tuple[str, ...]
    splits: tuple[HeldOut, ...]
    recordings: Mapping[str, tuple[DatasetFile, ...]]
    layouts: Sequence[Mapping[str, Any]]
    licence: str = ""
    notice: str = ""
    fit_rate: float | None = None
    settings: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)

    @property
    def size(self) -> int:
        """All files together [bytes]."""
        return sum(file.size for files in self.recordings.values() for file in files)

    def match(self, pattern: str = "*") -> tuple[str, ...]:
        """Names of recordings by a shell pattern; raises RecordingError when none fits."""
        matching = tuple(name for name in self.recordings if fnmatchcase(name, pattern))
        if not matching:
            some = ", ".join(list(self.recordings)[:4])
            more = ", ..." if len(self.recordings) > 4 else ""
            raise RecordingError(
                f"{self.name}: no recording fits {pattern!r}; there are {some}{more}"
            )
        return matching

    def split(self, name: str = "") -> HeldOut:
        """Recommended split by name, the first by default; raises RecordingError if unknown."""
        for split in self.splits:
            if name in {"", split.name}:
                return split
        names = [split.name for split in self.splits]
        raise RecordingError(f"{self.name}: {unknown('split', name, names)}")

    def layout(self, recording: str) -> Mapping[str, Any]:
        """How the files of the recording of this name stand."""
        return next(row for row in self.layouts if fnmatchcase(recording, row.get("files", "*")))

    def url(self, file: DatasetFile) -> str:
        """Address of a file of it."""
        repository, commit, path = self.origin(file)
        return f"{RAW_HOST}/{repository}/{commit}/{quote(path)}"

    def origin(self, file: DatasetFile) -> tuple[str, str, str]:
        """Repository, commit and path of a file of it."""
        place, separator, path = file.upstream.rpartition(":")
        repository, _, commit = place.partition("@")
        return (repository, commit, path) if separator else (self.repository, self.commit, path)


def get_dataset(name: str) -> Dataset:
    """Find a data set by name; raises RecordingError naming those that are known.

    Examples
    --------
    >>> get_dataset("kflex_tendon_sheath").robot
    'kflex'
    """
    if name not in DATASETS:
        raise RecordingError(unknown("data set", name, DATASETS))
    return DATASETS[name]


def _load() -> dict[str, Dataset]:
    recordings: dict[str, dict[str, tuple[DatasetFile, ...]]] = {}
    text = files(__package__).joinpath("files.csv").read_text("utf-8")
    for row in csv.DictReader(io.StringIO(text)):
        file = DatasetFile(row["file"], row["upstream"], int(row["bytes"]), row["sha256"])
        of_set = recordings.setdefault(row["dataset"], {})
        of_set[row["recording"]] = (*of_set.get(row["recording"], ()), file)
    datasets = {}
    for name, values in shipped_table(__package__, "catalogue.toml").items():
        splits = tuple(HeldOut(**split) for split in values.get("splits", ()))
        layouts = tuple(
            row | {"map": {"robot": values["robot"], **_column_map(row["map"])}}
            for row in values["layouts"]
        )
        about = {"features": (), **values, "splits": splits, "layouts": layouts}
        datasets[name] = Dataset(name, recordings=recordings[name], **about)
    return datasets


def _column_map(table: Mapping[str, Any]) -> dict[str, Any]:
    """Column map in which each channel has an entry of its own."""
    columns = {}
    for names, entry in table["columns"].items():
        quantity, slash, channels = names.partition("/")
        about = entry if isinstance(entry, Mapping) else {"column": entry}
        for k, channel in enumerate(channels.split() or [""]):
            columns[quantity + slash + channel] = {**about, "column": _behind(about["column"], k)}
    return {**table, "columns": columns}


def _behind(column: str | int, k: int) -> str | int:
    """Give the column that is `k` behind another, as ``q[2]`` is two behind ``q[0]``."""
    if isinstance(column, int):
        return column + k
    return re.sub(r"\d+(?=\]$)", lambda number: str(int(number[0]) + k), column)


DATASETS: Final[Mapping[str, Dataset]] = _load()
"""Every public data set by name."""
