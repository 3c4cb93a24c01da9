"""Messages of topics as columns, read lot by lot, of which no number is held twice."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.errors import RecordingError
from truejoint.recordings.bounded_file import MAX_VALUES
from truejoint.recordings.read.bags.container import Topic, read_batches
from truejoint.recordings.read.bags.fields import STAMP, Decoder, Fields


class Series:
    """Columns of one topic, which take its messages as they come in.

    Attributes
    ----------
    count : int
        How many messages there are so far.

    Examples
    --------
    >>> from truejoint.recordings.read.bags.series import Series
    >>> series = Series()
    >>> series.add(np.array([0]), np.array([10**9]), {"measured/jaw": np.array([0.5])})
    >>> series.joined()[1]
    {'measured/jaw': array([0.5])}
    """

    def __init__(self) -> None:
        self.count = 0
        self._places: list[NDArray[np.int64]] = []
        self._stamps: list[NDArray[np.int64]] = []
        self._columns: list[dict[str, Array]] = []
        self._names: dict[str, None] = {}

    def add(
        self, places: NDArray[np.int64], stamps: NDArray[np.int64], columns: Mapping[str, Array]
    ) -> None:
        """Take a lot of messages; a column that a lot lacks has no value there.

        `places` (m,) say where they are among all of the topic, `stamps` (m,) when they are of
        [ns], `columns` (m,) what they hold. Raises RecordingError where there are too many.
        """
        self.count += len(stamps)
        self._names |= dict.fromkeys(columns)
        if self.count * (len(self._names) + 1) > MAX_VALUES:
            raise RecordingError(f"more than {MAX_VALUES} values; extract fewer bags at a time")
        self._places.append(places)
        self._stamps.append(stamps)
        # Copies: those that came are of a whole message, and would keep all of it.
        self._columns.append({name: np.array(v, np.float64) for name, v in columns.items()})

    @property
    def start(self) -> int:
        """Stamp of the first message that came in [ns]."""
        return int(self._stamps[0][0])

    def joined(self) -> tuple[NDArray[np.int64], dict[str, Array]]:
        """Stamps [ns] and columns in the order of the messages, which are forgotten here."""
        places, stamps, pieces, names = self._places, self._stamps, self._columns, self._names
        self.__init__()  # type: ignore[misc]
        if not pieces:
            return np.empty(0, dtype=np.int64), {}
        lacking = [np.full(len(part), np.nan) for part in stamps] if len(names) else []
        columns = {
            name: np.concatenate([p.pop(name, n) for p, n in zip(pieces, lacking, strict=True)])
            for name in names
        }
        all_places, all_stamps = np.concatenate(places), np.concatenate(stamps)
        if (np.diff(all_places) < 0).any():  # other lengths came in lots of their own
            order = np.argsort(all_places)
            keep_rows(columns, order)
            all_stamps = all_stamps[order]
        return all_stamps, columns


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
