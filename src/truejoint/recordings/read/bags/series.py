"""Messages of topics as columns, read lot by lot, of which no number is held twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import MAX_VALUES
from truejoint.recordings.read.bags.container import Topic, read_batches
from truejoint.recordings.read.bags.fields import STAMP, Decoder, Fields


@dataclass
class Series:
    """Columns of one topic, which take its messages as they come in.

    Attributes
    ----------
    expected : int
        How many messages there will be, so that no column moves while it grows; 0 if not known.
    count : int
        How many there are so far.

    Examples
    --------
    >>> from truejoint.recordings.read.bags.series import Series
    >>> series = Series()
    >>> series.add(np.array([0]), np.array([10**9]), {"measured/jaw": np.array([0.5])})
    >>> series.joined()[1]
    {'measured/jaw': array([0.5])}
    """

    expected: int = 0
    count: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._places = self._stamps = np.empty(0, dtype=np.int64)
        self._columns: dict[str, Array] = {}

    def add(
        self, places: NDArray[np.int64], stamps: NDArray[np.int64], columns: Mapping[str, Array]
    ) -> None:
        """Take a lot of messages; a column that is new has no value in those before.

        `places` (m,) say where they are among all of the topic, `stamps` (m,) when they are of
        [ns], `columns` (m,) what they hold. Raises RecordingError where there are too many.
        """
        rows = slice(self.count, self.count + len(stamps))
        all_columns = {**self._columns, **columns}
        if rows.stop * (len(all_columns) + 1) > MAX_VALUES:
            raise RecordingError(f"more than {MAX_VALUES} values; extract fewer bags at a time")
        room = max(rows.stop, min(self.expected, MAX_VALUES // (len(all_columns) + 1)))
        self._places = _with_room(self._places, rows, room)
        self._stamps = _with_room(self._stamps, rows, room)
        self._places[rows], self._stamps[rows] = places, stamps
        for name in all_columns:
            if name not in self._columns:
                self._columns[name] = np.empty(room)
                self._columns[name][: self.count] = np.nan
            self._columns[name] = _with_room(self._columns[name], rows, room)
            self._columns[name][rows] = columns.get(name, np.nan)
        self.count = rows.stop

    @property
    def start(self) -> int:
        """Stamp of the first message that came in [ns]."""
        return int(self._stamps[0])

    def joined(self) -> tuple[NDArray[np.int64], dict[str, Array]]:
        """Stamps [ns] and columns in the order of the messages, which are forgotten here."""
        places, stamps = self._places[: self.count], self._stamps[: self.count]
        columns = {name: values[: self.count] for name, values in self._columns.items()}
        self.__post_init__()
        if (np.diff(places) < 0).any():  # messages of different lengths came in lots of their own
            order = np.argsort(places)
            keep_rows(columns, order)
            stamps = stamps[order]
        return stamps, columns


def _with_room(values: NDArray[Any], rows: slice, room: int) -> NDArray[Any]:
    """Array that holds the first values of another, if that one has no place for `rows`."""
    if rows.stop <= len(values):
        return values
    larger = np.empty(max(room, len(values) + len(values) // 2), dtype=values.dtype)
    larger[: rows.start] = values[: rows.start]
    return larger


def keep_rows(columns: dict[str, Array], rows: NDArray[np.int64]) -> None:
    """Keep some rows of all columns, one after the other, as those of a day take much memory."""
    for name in list(columns):
        columns[name] = columns[name][rows]


class Lot(NamedTuple):
    """Messages of one topic that have the same layout."""

    topic: str
    places: NDArray[np.int64]  # (m,), among all messages of the topic
    stamps: NDArray[np.int64]  # (m,) [ns]
    fields: Fields  # by name, (m, length)
    texts: Mapping[str, tuple[str, ...]]  # lists of text, the same in all messages


def lots_of(
    paths: Sequence[Path], wanted: Mapping[str, Collection[str]], lost: Counter[str]
) -> Iterator[Lot]:
    """Lots of messages of the topics that are `wanted`, with the fields of each that are."""
    decoders: dict[Topic, Decoder] = {}
    count: Counter[str] = Counter()
    for path in paths:
        for topic, times, messages in read_batches(path, lambda t: t.name in wanted, lost):
            if topic not in decoders:
                decoders[topic] = Decoder(topic, wanted[topic.name])
            arrivals = np.array(times, dtype=np.int64)
            for rows, fields, texts in decoders[topic].decode(messages):
                stamps = np.where(fields[STAMP] == 0, arrivals[rows], fields[STAMP])
                yield Lot(topic.name, count[topic.name] + rows, stamps, fields, texts)
            count[topic.name] += len(messages)
    for topic, decoder in decoders.items():
        if decoder.damaged:
            what = f"messages of {topic.name} that are not as their definition says"
            lost[what] += decoder.damaged
