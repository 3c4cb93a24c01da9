"""Recording what an arm reports while it moves."""

import logging
import math
import os
import threading
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Final, Protocol, Self

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.crtk.arm import as_arm
from truejoint.errors import RecordingError
from truejoint.files import check_ending, check_target, free_name
from truejoint.recordings.table import stream_file
from truejoint.recordings.table.parquet import recording_header, write_parquet
from truejoint.recordings.table.recording import Provenance, Recording
from truejoint.recordings.table.stream import BRIDGED_TIME, Stream

_STREAMS: Final = stream_file.STATE, stream_file.TRUTH
LONGEST: Final = 12 * 3600.0
"""Rows later than this after the first [s] are counted and not kept."""
PAST_END: Final = "state: past the longest duration"
REHOMED: Final = "state: after another homing"
_log = logging.getLogger(__name__)


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

    The state is thinned out to `state_rate` as it arrives. Memory grows by about 10 kB per second
    of motion at any rate of the arm, for 12 h at most. With a `path` it is written meanwhile, as
    often as the arm's `stretch` says, to ``<name>.unfinished.stream``, which any command reads.
    There it stays if the block is left by an exception or by Ctrl-C, if the program is killed, or
    where `path` cannot be written at the end; no whole recording is replaced. Rows after another
    homing, whose zero is another, are counted and not kept.

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
        Parquet file to write when the block is left; what was written is in `written`.
    overwrite : bool
        Whether a file at `path` may be replaced by a whole recording.
    homing_id : str, optional
        Name of the homing from which the positions count; by default the arm's own name of its
        homing.
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
        as_arm(self.arm)
        if self.path is not None:
            check_ending(Path(self.path), ".parquet", "a recording", RecordingError)
            check_target(Path(self.path), overwrite=self.overwrite, error=RecordingError)
        self._clear()

    def __enter__(self) -> Self:
        self._clear()
        if self.path is not None:  # a file that survives whatever ends the program
            header = {
                **recording_header(self._provenance(), self.arm.robot),
                "gap_limit": self.gap_limit,
                "state_rate": None if math.isinf(self.state_rate) else self.state_rate,
            }
            unfinished = free_name(Path(self.path).with_suffix(stream_file.SUFFIX), "unfinished")
            self._stream = stream_file.StreamWriter(unfinished, header)
        self.arm.subscribe(self._from_arm, every=self.arm.stretch)
        if self.truth is not None:
            self.truth.subscribe(self._from_encoders)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, _: object
    ) -> None:
        self.arm.unsubscribe(self._from_arm)
        if self.truth is not None:
            self.truth.unsubscribe(self._from_encoders)
        if kind is not None:
            self._stopped = f"stopped by {kind.__name__}" + (f": {error}" if str(error) else "")
        if self._stream is not None and self.path is not None:
            self._stream.close(self._stopped)
            self._finish(self._stream.path, Path(self.path))

    @property
    def rows(self) -> int:
        """Rows of the state that are kept so far."""
        return sum(len(piece.t) for piece in self._pieces[stream_file.STATE])

    def recording(self, source: str = "") -> Recording:
        """Make a recording of what there is so far; may be called while recording goes on.

        It has `QUANTITIES` of every channel, whatever else the arm reads with its state
        (`StateBlock.extra`), and the joint encoders where it has them, interpolated to the state's
        stamps (`synchronise`). `source` is for the provenance; by default
        ``"recorded from <robot>"``. Raises RecordingError if there are fewer than 2 rows.
        """
        self.arm.deliver(self._from_arm)
        origin = replace(
            self._provenance(),
            source=source or f"recorded from {self.arm.robot.title}",
            notes=self._stopped,
            dropped={PAST_END: self._past_end, REHOMED: self._rehomed},
        )
        # Others may come in another thread meanwhile.
        pieces = [tuple(self._pieces[name]) for name in _STREAMS]
        state, truth = (Stream.joined(part) if part else None for part in pieces)
        robot, limit = self.arm.robot, self.gap_limit
        return stream_file.recording_of_streams(state, truth, origin, robot, limit, self.state_rate)

    def _provenance(self) -> Provenance:
        robot, names = self.arm.robot, (self.homing_id, self._homing, self.arm.homing_id)
        homing = next(name for name in names if name is not None)
        origin = Provenance(robot.name, robot.arm, session=self.session, homing_id=homing)
        return replace(origin, load=self.load, command=self.command)

    def _finish(self, unfinished: Path, path: Path) -> None:
        """Write a whole recording in place of what is unfinished."""
        if self.rows < 2:
            unfinished.unlink()
            return
        self.written = unfinished
        if self._stopped:
            return
        try:
            write_parquet(self.recording(str(path)), path, overwrite=self.overwrite)
        except RecordingError as error:
            raise RecordingError(f"{error}; the recording is in {unfinished}") from None
        self.written = path
        unfinished.unlink()

    def _clear(self) -> None:
        self._decimator = Decimator(self.state_rate)
        self._pieces: dict[str, list[Stream]] = {name: [] for name in _STREAMS}
        self._first = math.nan
        self._homing: str | None = None  # of the first row
        self._past_end = self._rehomed = 0
        self._stopped = ""

    def _from_arm(self, block: StateBlock | TruthBlock) -> None:
        """Take what the arm says; of joint encoders nothing where others are given."""
        if isinstance(block, StateBlock):
            kept = block.rows(self._decimator.pick(block.t))
            if math.isnan(self._first) and kept.t.size:
                self._first, self._homing = float(kept.t[0]), self.arm.homing_id
            if kept.t.size and self.arm.homing_id != self._homing:
                if not self._rehomed:
                    _log.warning("the arm was homed again: record what follows by itself")
                self._rehomed += len(kept.t)
                return
            self._past_end += int(self._is_late(kept.t).sum())
            self._keep(stream_file.STATE, Stream(kept.t, kept.columns()))
        elif self.truth is None:
            self._from_encoders(block)

    def _from_encoders(self, block: TruthBlock) -> None:
        columns = {f"truth/{n}": block.position[:, k] for k, n in enumerate(block.name)}
        self._keep(stream_file.TRUTH, Stream(block.t, columns))

    def _is_late(self, t: Array) -> Mask:
        """Which stamps (n,) are past the longest duration; none before the first state."""
        return t - self._first > LONGEST

    def _keep(self, name: str, piece: Stream) -> None:
        piece = piece.rows(~self._is_late(piece.t))
        with self._lock:  # state and truth may come in threads of their own
            self._pieces[name].append(piece)
            if self._stream is not None and len(piece.t):
                self._stream.write(name, piece.t, piece.columns)
