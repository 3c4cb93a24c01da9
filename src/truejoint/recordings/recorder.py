"""Recording what an arm reports while it moves."""

from __future__ import annotations

import math
import os
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, field, replace
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.crtk import Arm, OperatingState, StateBlock, TruthBlock
from truejoint.crtk.arm import as_arm
from truejoint.crtk.topics import OPERATING_STATE, check_topics, state_columns, topic_columns
from truejoint.errors import RecordingError
from truejoint.files import check_ending, check_target, free_name, move, uninterrupted
from truejoint.recordings.table import stream_file
from truejoint.recordings.table.parquet import recording_header, write_parquet
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.recordings.table.stream import BRIDGED_TIME, Stream

_STREAMS: Final = stream_file.STATE, stream_file.TRUTH
_PIECE: Final = 0.5  # [s] that are worked on, and written, at a time
LONGEST: Final = 12 * 3600.0
"""Rows later than this after the first [s] are counted and not kept."""
PAST_END: Final = "state: past the longest duration"


class TruthSource(Protocol):
    """Sensors on the joints that report by themselves, as `Arm.subscribe` does for an arm."""

    def subscribe(self, callback: Callable[[TruthBlock], None]) -> None:
        """Call `callback` with every block from now on."""

    def unsubscribe(self, callback: Callable[[TruthBlock], None]) -> None:
        """Stop calling `callback`."""


class Decimator:
    """Picks rows so that no more than `rate` a second [Hz] are left, by their stamps.

    Time is cut into cells of 1/rate from the first stamp on; the first row in each cell
    is picked. So it does not matter how the rows come in pieces, and a stream that is slower than
    `rate` passes whole. A clock that is set back is not judged here: its rows pass.
    """

    def __init__(self, rate: float) -> None:
        if not (rate > 0):
            raise RecordingError(f"recorder: rate {rate} Hz; give one above 0 Hz")
        self._rate = rate
        self._origin = math.nan
        self._cell = -math.inf

    def pick(self, t: Array) -> Mask:
        """Say which rows to keep, of the next stamps (n,) [s]; bool (n,)."""
        if math.isinf(self._rate) or not t.size:
            return np.ones(t.shape, dtype=np.bool_)
        if math.isnan(self._origin):
            self._origin = float(t[0])
        # A stamp on an edge belongs to the cell that it starts, rounding or not.
        cell = np.floor((t - self._origin) * self._rate + 1e-6)
        chosen: Mask = np.diff(cell, prepend=self._cell) != 0
        self._cell = float(cell[-1])
        return chosen


@dataclass(eq=False, repr=False)
class Recorder:
    """Records an arm from entering to leaving a ``with`` block.

    The state is thinned out to `state_rate` as it arrives, so memory grows by about 10 kB per
    second of motion whatever the arm's own rate, for 12 h at most. If the block is left by an
    exception or by Ctrl-C, what was recorded is kept; with a `path` it is written beside it, as
    ``<name>.partial.parquet``, and no whole recording is replaced. Meanwhile it is written, twice a
    second of the arm's clock, to ``<name>.unfinished.arrows``, which any command reads: there it is
    if the program is killed, or where `path` cannot be written at the end.

    Parameters
    ----------
    arm : Arm
    state_rate : float
        Rate of the rows [Hz]; peng2024 (IV-A) records the state at 30 Hz.
    truth : TruthSource, optional
        Joint encoders that are read in place of the arm's own, such as `JointEncoders`, stamped by
        the arm's clock.
    gap_limit : float
        Longest time between two readings of the joint encoders to interpolate across [s].
    path : path-like, optional
        Parquet file to write when the block is left; where it was written is in `written`.
    topics : mapping of str to float, optional
        CRTK topics (`truejoint.crtk.topics.TOPICS`) to keep as well, with a `path`, each at most so
        often [Hz] and with its own stamps; ``operating_state`` at most twice a second, and whenever
        the arm tells of a change (`Arm.watch`). They stand beside state and truth in the stream,
        which is then kept as ``<name>.topics.arrows`` (`read_recorded_topics`).
    overwrite : bool
        Whether files at `path` and beside it may be replaced by a whole recording.
    homing_id : str, optional
        What the positions count from; by default the arm's own name of its homing.
    session, command : str
    load : float
        Mass hung on the tool [kg]. All for the provenance.

    Examples
    --------
    >>> with Recorder(arm, state_rate=10.0) as recorder:
    ...     arm.move_jp(arm.robot.home + [0.1, 0, 0, 0, 0, 0, 0]).wait()
    >>> recorder.recording().joints_of("truth")
    ('shoulder', 'elbow', 'insertion')
    """

    arm: Arm
    state_rate: float = 30.0
    _: KW_ONLY
    truth: TruthSource | None = None
    gap_limit: float = BRIDGED_TIME
    path: str | os.PathLike[str] | None = None
    topics: Mapping[str, float] = field(default_factory=dict)
    overwrite: bool = False
    session: str = ""
    homing_id: str | None = None
    load: float = math.nan
    command: str = ""

    def __post_init__(self) -> None:
        if not (self.gap_limit > 0):
            raise RecordingError(f"recorder: gap limit {self.gap_limit} s; give one above 0 s")
        self.written: Path | None = None
        self._stream: stream_file.StreamWriter | None = None
        self._lock = threading.Lock()
        check_topics(as_arm(self.arm).robot, self.topics)
        if self.topics and self.path is None:
            raise RecordingError("recorder: topics are kept on the disk alone; give a path")
        if self.path is not None:
            check_ending(Path(self.path), ".parquet", "a recording", RecordingError)
            paths = [Path(self.path), *([topics_beside(self.path)] if self.topics else [])]
            for path in paths:
                check_target(path, overwrite=self.overwrite, error=RecordingError)
        if self.homing_id is None:
            self.homing_id = self.arm.homing_id
        self._clear()

    def __enter__(self) -> Self:
        self._clear()
        if OPERATING_STATE in self.topics:  # refused by a silent arm before anything is opened
            self._states.append(self.arm.operating_state())
        if self.path is not None:  # a file that survives whatever ends the program
            header = {
                **recording_header(self._provenance(), self.arm.robot),
                "gap_limit": self.gap_limit,
                "state_rate": None if math.isinf(self.state_rate) else self.state_rate,
            }
            unfinished = free_name(Path(self.path).with_suffix(stream_file.SUFFIX), "unfinished")
            self._stream = stream_file.StreamWriter(unfinished, header)
        self.arm.subscribe(self._from_arm, every=_PIECE)
        if OPERATING_STATE in self.topics:
            self.arm.watch(self._keep_state)
        if self.truth is not None:
            self.truth.subscribe(self._receive)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: object
    ) -> None:
        self.arm.unsubscribe(self._from_arm)
        if OPERATING_STATE in self.topics:
            self.arm.unwatch(self._keep_state)
        if self.truth is not None:
            self.truth.unsubscribe(self._receive)
        if kind is not None:
            self._stopped = f"stopped by {kind.__name__}" + (f": {error}" if str(error) else "")
        if self._stream is not None and self.path is not None:
            with uninterrupted():
                with self._lock:  # a last change of the state may come in another thread
                    self._stream.close()
                self._write(Path(self.path))
                if self.rows < 2:
                    self._stream.path.unlink()

    @property
    def rows(self) -> int:
        """Rows of the state that are kept so far."""
        return sum(len(piece.t) for piece in self._pieces[stream_file.STATE])

    @property
    def size(self) -> int:
        """Bytes on disk so far; 0 without a `path`."""
        return self._stream.size if self._stream else 0

    @property
    def streams(self) -> dict[str, stream_file.StreamSize]:
        """Rows, rate and bytes on disk so far of state, truth and each topic."""
        return dict(self._stream.streams) if self._stream else {}

    def recording(self, source: str = "") -> Recording:
        """Make a recording of what there is so far; may be called while recording goes on.

        It has `QUANTITIES` of every channel, whatever else the arm reads with its state
        (`StateBlock.extra`), and the joint encoders where it has them, interpolated to the state's
        stamps (`synchronise`). `source` is for the provenance; by default
        ``"recorded from <robot>"``. Raises RecordingError if there are fewer than 2 rows.
        """
        origin = replace(
            self._provenance(),
            source=source or f"recorded from {self.arm.robot.title}",
            notes=self._stopped,
            dropped={PAST_END: self._past_end},
        )
        state, truth = (_joined(self._pieces[name]) for name in _STREAMS)
        robot, limit = self.arm.robot, self.gap_limit
        return stream_file.recording_of_streams(state, truth, origin, robot, limit, self.state_rate)

    def _provenance(self) -> Provenance:
        robot, homing = self.arm.robot, self.homing_id or ""
        origin = Provenance(robot.name, robot.arm, session=self.session, homing_id=homing)
        return replace(origin, load=self.load, command=self.command)

    def _write(self, path: Path) -> None:
        """Write what there is; a part of a recording gets a name of its own."""
        overwrite, stream = self.overwrite and not self._stopped, self._stream
        if self._stopped:
            path = free_name(path, "partial")
        if stream is None or self.rows < 2:
            return
        try:
            write_parquet(self.recording(str(path)), path, overwrite=overwrite)
        except RecordingError as error:
            self.written = stream.path
            raise RecordingError(f"{error}; the recording is in {stream.path}") from None
        self.written = path
        beside = topics_beside(path)
        if not self.topics:
            stream.path.unlink()
            if self.overwrite:  # those of what was recorded here before would be taken for its own
                beside.unlink(missing_ok=True)
            return
        try:
            move(stream.path, beside, overwrite=overwrite)
        except FileExistsError:
            raise RecordingError(f"{beside}: exists; the topics are in {stream.path}") from None
        stream.path.unlink(missing_ok=True)

    def _clear(self) -> None:
        state, truth = _STREAMS
        rates = {state: self.state_rate, truth: math.inf, **self.topics}
        self._thinning = {name: Decimator(rate) for name, rate in rates.items()}
        self._pieces: dict[str, list[Stream]] = {name: [] for name in _STREAMS}
        self._states: list[OperatingState] = []  # not yet written
        self._first = math.nan
        self._past_end = 0
        self._stopped = ""

    def _from_arm(self, block: StateBlock | TruthBlock) -> None:
        """Take what the arm says; of joint encoders nothing where others are given."""
        if self.truth is None or isinstance(block, StateBlock):
            self._receive(block)

    def _receive(self, block: StateBlock | TruthBlock) -> None:
        state, truth = _STREAMS
        name = truth if isinstance(block, TruthBlock) else state
        chosen = self._thinning[name].pick(block.t)
        if name == state and math.isnan(self._first) and chosen.any():
            self._first = float(block.t[chosen][0])
        late = block.t - self._first > LONGEST  # never, before the first state
        if isinstance(block, TruthBlock):
            columns = {f"truth/{n}": block.position[:, k] for k, n in enumerate(block.name)}
        else:
            self._past_end += int((chosen & late).sum())
            columns = block.columns()
        piece = Stream(block.t, columns).rows(chosen & ~late)
        with self._lock:  # state and truth may come in threads of their own
            self._pieces[name].append(piece)
            if self._stream is not None and len(piece.t):
                self._stream.write(name, piece.t, piece.columns)
        if isinstance(block, StateBlock) and self.topics:
            self._keep_topics(block.rows(~late))

    def _keep_topics(self, block: StateBlock) -> None:
        """Write what an arm's topics say of a block of its state messages."""
        robot = self.arm.robot
        for topic in self.topics:
            decimator = self._thinning[topic]
            if topic == OPERATING_STATE:
                if decimator.pick(block.t[-1:]).any():
                    self._keep_state(self.arm.operating_state())
                continue
            rows = block.rows(decimator.pick(block.t))
            with self._lock:
                if self._stream is not None and len(rows.t):
                    self._stream.write(topic, rows.t, topic_columns(robot, topic, rows))
        self._write_states()

    def _keep_state(self, state: OperatingState) -> None:
        """Write an operating state; on a full disk with the next block, which then says so."""
        with self._lock:
            self._states.append(state)
        with suppress(RecordingError):
            self._write_states()

    def _write_states(self) -> None:
        with self._lock:
            while self._stream is not None and self._states:
                state = self._states[0]
                self._stream.write(OPERATING_STATE, np.array([state.t]), state_columns(state))
                del self._states[0]


def topics_beside(path: str | os.PathLike[str]) -> Path:
    """File of the topics that are recorded with a recording at `path`."""
    return Path(path).with_suffix(stream_file.TOPICS_SUFFIX)


def _joined(pieces: Sequence[Stream]) -> Stream | None:
    """One stream of its pieces; None without any."""
    pieces = tuple(pieces)  # others may come in another thread meanwhile
    if not pieces:
        return None
    names = pieces[0].columns
    columns = {name: np.concatenate([p.columns[name] for p in pieces]) for name in names}
    return Stream(np.concatenate([piece.t for piece in pieces]), columns)
