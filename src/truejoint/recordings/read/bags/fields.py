"""Fields of many messages at once, by the definition that their bag brings.

Messages of one topic mostly have their fields in the same places: the first tells where, by a walk
through its definition, and whatever has the same lengths of texts and lists is read with it as one
array. So any variant of a message is read, and a million of them in a second.
"""

from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from truejoint.array_types import Array
from truejoint.crtk.messages import DEFINITIONS, message_type, ros2_definition
from truejoint.errors import RecordingError, words
from truejoint.extras import require
from truejoint.recordings.bounded_file import MAX_VALUES, DamagedError
from truejoint.recordings.read.bags.container import Topic, read_batches

_SIZES: Final = {
    "bool": "u1", "byte": "u1", "char": "u1", "int8": "i1", "uint8": "u1", "int16": "i2",
    "uint16": "u2", "int32": "i4", "uint32": "u4", "int64": "i8", "uint64": "u8",
    "float32": "f4", "float64": "f8",
}  # fmt: skip
# Fields of one topic to walk through, and those that take as long as the rest of a walk: joints do
# not come and go that often.
_MOST_WALKED, _START = 1 << 20, 50
_MOST_DEFINITION: Final = 1 << 17  # bytes of a definition, which takes long to parse
_ONE_INTEGER: Final = tuple((order + kind, 1) for order in "<>" for kind in ("i4", "u4"))
_DEEPEST: Final = 20  # messages within messages
_BASE, _MESSAGE, _SEQUENCE = 1, 2, 4  # what rosbags says of a field: 3 is a list of fixed length
_MOST_FIELDS: Final = 1 << 16  # of a message, with those of messages within it
PURPOSE: Final = "reading and writing bags"

Fields = Mapping[str, NDArray[Any]]
Types = Mapping[str, Any]


def typesys() -> Any:
    """Package of rosbags that knows message definitions; raises TruejointError without it."""
    return require("rosbags.typesys", "ros", PURPOSE)


def field_types(topic: Topic) -> Types:
    """Fields of a topic's message and of those in it, by type, as rosbags has them.

    A bag that brings no definition is read by those of ROS 2 and of `DEFINITIONS`. Raises
    RecordingError if neither knows the type, or the definition is none.
    """
    system = typesys()
    # ROS 1 brings its own header, which has a number that ROS 2 left out.
    definitions = dict(system.get_typestore(system.Stores.EMPTY).fielddefs)
    name = full_name(topic.type)
    try:
        if len(topic.definition) > _MOST_DEFINITION:
            raise ValueError(f"more than {_MOST_DEFINITION} bytes")
        if not topic.definition:
            definitions |= system.get_typestore(system.Stores.LATEST).fielddefs
            for kind in DEFINITIONS:
                definitions |= system.get_types_from_msg(ros2_definition(kind), full_name(kind))
        else:
            definitions |= system.get_types_from_msg(topic.definition, name)
    except Exception as error:  # noqa: BLE001 - parsers of others' texts raise what they like
        raise _damaged(topic, words(error, 60)) from None
    if name not in definitions:
        raise RecordingError(
            f"{topic.name}: the bag has no definition of {topic.type}, nor has truejoint; record "
            "with MCAP, which brings it"
        )
    return definitions


def _damaged(topic: Topic, why: str) -> RecordingError:
    return RecordingError(
        f"{topic.name}: the definition of {topic.type} in the bag is damaged ({why})"
    )


def full_name(kind: str) -> str:
    """Name of a type as ROS 2 and rosbags write it."""
    package, _, name = message_type(kind).rpartition("/")
    return f"{package}/msg/{name}"


@dataclass
class Decoder:
    """Reads the wanted fields of one topic's messages."""

    topic: Topic
    wanted: Collection[str]  # fields, ``pose.position.x`` for one within another
    damaged: int = 0  # messages left out because they are not as their definition says
    _walked: int = field(default=0, init=False)  # fields, to tell where they stand

    def __post_init__(self) -> None:
        self._types = field_types(self.topic)
        fields = list(islice(self._leaves(full_name(self.topic.type), ""), _MOST_FIELDS + 1))
        if len(fields) > _MOST_FIELDS:
            raise _damaged(self.topic, f"more than {_MOST_FIELDS} fields")
        missing = sorted(set(self.wanted) - set(fields))
        if missing:
            has = ", ".join(name for name, _ in self._types[full_name(self.topic.type)][1])
            raise RecordingError(
                f"{self.topic.name}: this version of {self.topic.type} has no field "
                f"{missing[0]!r}; it has {has:.300}"
            )

    def _leaves(self, kind: str, prefix: str, depth: int = 0) -> Iterator[str]:
        if depth > _DEEPEST:
            raise _damaged(self.topic, f"messages within messages, {_DEEPEST} deep")
        for name, (shape, inner) in self._types[kind][1]:
            yield prefix + name
            if shape == _MESSAGE and inner in self._types:
                yield from self._leaves(inner, f"{prefix}{name}.", depth + 1)

    def decode(
        self, times: Sequence[int], messages: Sequence[bytes], first: int = 0
    ) -> "Iterator[Lot]":
        """Lots of messages of the same layout, of messages that were received at `times` [ns].

        The first of them is number `first` of the topic. Raises RecordingError if the layout
        changes all the time.
        """
        arrivals = np.array(times, dtype=np.int64)
        sizes = np.array([len(message) for message in messages])
        order = np.arange(len(messages))
        for size in np.unique(sizes):
            rows = order[sizes == size]
            raw = np.frombuffer(b"".join([messages[row] for row in rows]), dtype=np.uint8)
            raw = raw.reshape(len(rows), size)
            while len(rows):
                layout = _Walk(self._types, self.topic.encoding, raw[0].tobytes())
                is_whole = layout.is_whole(full_name(self.topic.type))
                self._walked += layout.walked
                if self._walked > _MOST_WALKED:
                    what = "its messages change their lengths all the time; is it a joint state?"
                    raise RecordingError(f"{self.topic.name}: {what}")
                alike = np.ones(len(rows), dtype=np.bool_)
                for begin, end in layout.fixed if is_whole else [(0, size)]:
                    alike &= (raw[:, begin:end] == raw[0, begin:end]).all(axis=1)
                if is_whole:
                    lot, places = raw if alike.all() else raw[alike], rows[alike]
                    stamps = layout.stamps(lot)
                    stamps = np.where(stamps == 0, arrivals[places], stamps)
                    fields = {n: layout.read(lot, n) for n in self.wanted if n in layout.places}
                    yield Lot(self.topic.name, first + places, stamps, fields, layout.texts)
                else:
                    self.damaged += int(alike.sum())
                rows, raw = rows[~alike], raw[~alike]


class _Walk:
    """Where the fields of one message stand in its bytes."""

    def __init__(self, types: Types, encoding: str, data: bytes) -> None:
        self._types, self._data = types, data
        self._aligned = encoding == "cdr"
        self._at = self._origin = 4 if self._aligned else 0
        # The first bytes of CDR tell the order of bytes.
        self.fixed: list[tuple[int, int]] = [(0, 4)] if self._aligned else []
        self._order = ">" if self._aligned and data[1:2] == b"\0" else "<"
        self.walked = _START  # fields so far: those of an empty type take no bytes
        self.places: dict[str, tuple[int, str, int]] = {}
        self.texts: dict[str, tuple[str, ...]] = {}

    def is_whole(self, kind: str) -> bool:
        """Go through the fields of a message; False if it is not as its type says."""
        if not self._aligned or self._data[:2] in (b"\0\0", b"\0\1"):
            with suppress(DamagedError, KeyError, UnicodeDecodeError):
                self._walk("", (_MESSAGE, kind))
                return True
        return False

    def _walk(self, path: str, what: tuple[int, Any], depth: int = 0) -> None:
        shape, inner = what
        self._count()
        if depth > _DEEPEST:
            raise DamagedError
        if shape == _MESSAGE:
            for name, part in self._types[inner][1]:
                self._walk(f"{path}.{name}" if path else name, part, depth + 1)
            return
        element, count = (what, 1) if shape == _BASE else inner
        if shape == _SEQUENCE:
            count = self._length()
        begin, base = self._at, element[1][0] if element[0] == _BASE else ""
        if base in _SIZES:
            size = int(_SIZES[base][1])
            begin = self._take(size * count, size if count else 1)
            self.places[path] = begin, self._order + _SIZES[base], count
        elif not base:
            for k in range(count):
                self._walk(f"{path}[{k}]", element, depth)
        elif shape == _BASE:
            self._text()
        else:
            self.texts[path] = tuple(self._text() for _ in range(count))
            self.fixed.append((begin, self._at))

    def _count(self) -> None:
        self.walked += 1
        if self.walked > _MOST_WALKED // 4:
            raise DamagedError

    def _length(self) -> int:
        begin = self._take(4, 4)
        self.fixed.append((begin, self._at))
        return int(np.frombuffer(self._data, self._order + "u4", 1, begin)[0])

    def _text(self) -> str:
        self._count()
        begin = self._take(self._length())
        return self._data[begin : self._at].rstrip(b"\0").decode()

    def _take(self, size: int, step: int = 1) -> int:
        """Place of the next `size` bytes, which in CDR lie at a multiple of `step`."""
        begin = self._at + (-(self._at - self._origin) % step if self._aligned else 0)
        self._at = begin + size
        if self._at > len(self._data):
            raise DamagedError
        return begin

    def stamps(self, raw: NDArray[np.uint8]) -> NDArray[np.int64]:
        """Time stamps in the headers of messages (m, size) that have this layout [ns], or 0."""
        for header in ("header", "hdr"):
            parts = [f"{header}.stamp.{seconds}" for seconds in ("sec", "nanosec")]
            if all(self.places.get(part, (0, "", 0))[1:] in _ONE_INTEGER for part in parts):
                seconds, rest = (self.read(raw, part)[:, 0].astype(np.int64) for part in parts)
                return seconds * 1_000_000_000 + rest
        return np.zeros(len(raw), dtype=np.int64)

    def read(self, raw: NDArray[np.uint8], name: str) -> NDArray[Any]:
        """Read a field (m, length) of messages (m, size) that have this layout."""
        begin, kind, count = self.places[name]
        end = begin + int(kind[2]) * count
        return np.ascontiguousarray(raw[:, begin:end]).view(kind).reshape(len(raw), count)


class Series:
    """Columns of one topic, which take its messages as they come in."""

    def __init__(self) -> None:
        self.count = 0  # messages so far
        self._lots: list[tuple[NDArray[np.int64], NDArray[np.int64], dict[str, Array]]] = []
        self._names: dict[str, None] = {}

    def add(self, lot: "Lot", columns: Mapping[str, Array]) -> None:
        """Take what a lot of messages holds (m,); a column that a lot lacks has no value there.

        Raises RecordingError where there are too many.
        """
        self.count += len(lot.stamps)
        self._names |= dict.fromkeys(columns)
        if self.count * (len(self._names) + 1) > MAX_VALUES:
            raise RecordingError(f"more than {MAX_VALUES} values; extract fewer bags at a time")
        # Copies: those that came are of a whole message, and would keep all of it.
        copies = {name: np.array(values, np.float64) for name, values in columns.items()}
        self._lots.append((lot.places, lot.stamps, copies))

    @property
    def start(self) -> int:
        """Stamp of the first message that came in [ns]."""
        return int(self._lots[0][1][0])

    def joined(self) -> tuple[NDArray[np.int64], dict[str, Array]]:
        """Stamps [ns] and columns in the order of the messages, which are forgotten here."""
        lots, names = self._lots, self._names
        self.__init__()  # type: ignore[misc]
        if not lots:
            return np.empty(0, dtype=np.int64), {}
        lacking = max((stamps for _, stamps, _ in lots), key=len) * np.nan
        columns = {
            name: np.concatenate([c.pop(name, lacking[: len(s)]) for _, s, c in lots])
            for name in names
        }
        places, stamps = (np.concatenate([lot[k] for lot in lots]) for k in (0, 1))
        if (np.diff(places) < 0).any():  # other lengths came in lots of their own
            order = np.argsort(places)
            keep_rows(columns, order)
            stamps = stamps[order]
        return stamps, columns


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

    def numbers(self, name: str, least: int, place: str) -> NDArray[Any]:
        """Field that a message of this type has, with `least` values; raises RecordingError."""
        if name not in self.fields or self.fields[name].shape[1] < least:
            raise RecordingError(
                f"{place}: {self.topic}: its {name} is not as such a message has it"
            )
        return self.fields[name]


def lots_of(
    paths: Sequence[Path], wanted: Mapping[str, Collection[str]], lost: Counter[str]
) -> Iterator[Lot]:
    """Lots of messages of the topics that are `wanted`, with the fields of each that are."""
    decoders: dict[Topic, Decoder] = {}
    count: Counter[str] = Counter()
    batches = (batch for p in paths for batch in read_batches(p, lambda t: t.name in wanted, lost))
    for topic, times, messages in batches:
        if topic not in decoders:
            decoders[topic] = Decoder(topic, wanted[topic.name])
        yield from decoders[topic].decode(times, messages, count[topic.name])
        count[topic.name] += len(messages)
    for topic, decoder in decoders.items():
        what = f"messages of {topic.name} that are not as their definition says"
        lost.update({what: decoder.damaged} if decoder.damaged else {})
