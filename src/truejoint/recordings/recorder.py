"""Recording what an arm reports while it moves."""

from __future__ import annotations

import math
import os
import types
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Final, Self

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.errors import RecordingError
from truejoint.files import check_target, free_name, uninterrupted
from truejoint.recordings.parquet import write_parquet
from truejoint.recordings.recording import Provenance, Recording, nominal_rates
from truejoint.recordings.synchronise import BACK, Stream, forward_rows, synchronise

_PIECE: Final = 1.0  # [s] that are worked on at a time
PAST_END: Final = "state: past the longest duration"


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
    second of motion whatever the arm's own rate. If the block is left by an exception or by
    Ctrl-C, what was recorded is kept; with a `path` it is written beside it, as
    ``<name>.partial.parquet``, and no whole recording is replaced. Where `path` cannot be written
    at the end, the recording is kept as ``<name>.kept.parquet`` if that can be.

    Parameters
    ----------
    arm : Arm
    state_rate : float
        Rate of the rows [Hz]; peng2024 (IV-A) records the state at 30 Hz.
    truth_rate : float, optional
        Thin the joint encoders out to this rate [Hz]; all readings by default.
    gap_limit : float
        Longest time between two readings of the joint encoders to interpolate across [s].
    max_duration : float
        Rows later than this after the first are counted and not kept [s].
    path : path-like, optional
        Parquet file to write when the block is left; where it was written is in `written`.
    overwrite : bool
        Whether a file at `path` may be replaced by a whole recording.
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
    truth_rate: float | None = None
    _: KW_ONLY
    gap_limit: float = 0.05
    max_duration: float = 12 * 3600.0
    path: str | os.PathLike[str] | None = None
    overwrite: bool = False
    session: str = ""
    homing_id: str | None = None
    load: float = math.nan
    command: str = ""

    def __post_init__(self) -> None:
        if not (self.gap_limit > 0 and self.max_duration > 0):
            raise RecordingError(
                f"recorder: gap limit {self.gap_limit} s and longest duration {self.max_duration} "
                "s; both must be above 0 s"
            )
        self.written: Path | None = None
        if self.path is not None:
            check_target(Path(self.path), overwrite=self.overwrite, error=RecordingError)
        if self.homing_id is None:
            self.homing_id = self.arm.homing_id
        self._clear()

    def __enter__(self) -> Self:
        self._clear()
        self.arm.subscribe(self._receive, every=_PIECE)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: types.TracebackType | None,
    ) -> None:
        self.arm.unsubscribe(self._receive)
        if kind is not None:
            self._stopped = f"stopped by {kind.__name__}" + (f": {error}" if str(error) else "")
        if self.path is not None and self.rows >= 2:
            with uninterrupted():
                self._write(Path(self.path))

    @property
    def rows(self) -> int:
        """Rows of the state that are kept so far."""
        return len(self._state)

    def recording(self, source: str = "") -> Recording:
        """Make a recording of what there is so far; may be called while recording goes on.

        It has `QUANTITIES` of every channel, whatever else the arm reads with its state
        (`StateBlock.extra`), and the joint encoders where it has them, interpolated to the state's
        stamps (`truejoint.recordings.synchronise`). `source` is for the provenance; by default
        ``"recorded from <robot>"``. Raises RecordingError if there are fewer than 2 rows.
        """
        if self.rows < 2:
            raise RecordingError(
                f"recorder: {self.rows} rows from {self.arm.robot.title}; it reports only while "
                "homed and moving or holding"
            )
        state, back = self._state.joined()
        dropped = {PAST_END: self._past_end, f"state: {BACK}": back}
        columns = {"t": state.t, **state.columns}
        known = {} if math.isinf(self.state_rate) else {"state": self.state_rate}
        rates = nominal_rates(state=state.t) | known
        if len(self._truth) >= 2:
            truth, back = self._truth.joined()
            columns, unmatched = synchronise(state, truth, self.gap_limit)
            dropped |= {f"truth: {BACK}": back} | unmatched
            rates |= nominal_rates(truth=truth.t)
        start = float(columns["t"][0])
        columns["t"] = columns["t"] - start
        provenance = Provenance(
            robot=self.arm.robot.name,
            arm=self.arm.robot.arm,
            source=source or f"recorded from {self.arm.robot.title}",
            session=self.session,
            homing_id=self.homing_id or "",
            load=self.load,
            mechanism=vars(self.arm.robot.mechanism) if self.arm.robot.mechanism else {},
            rates=rates,
            dropped=dropped,
            start=start,
            command=self.command,
            notes=self._stopped,
        )
        return Recording.from_columns(columns, provenance)

    def _write(self, path: Path) -> None:
        """Write what there is; a part of a recording gets a name of its own."""
        stopped = bool(self._stopped)
        if stopped:
            path = free_name(path, "partial")
        recording = self.recording(str(path))
        try:
            write_parquet(recording, path, overwrite=self.overwrite and not stopped)
        except RecordingError as error:
            kept = free_name(path, "kept")
            try:
                write_parquet(recording, kept)
            except RecordingError:
                raise error from None
            self.written = kept
            raise RecordingError(f"{error}; the recording is in {kept}") from None
        self.written = path

    def _clear(self) -> None:
        self._state = _Rows(self.state_rate)
        self._truth = _Rows(math.inf if self.truth_rate is None else self.truth_rate)
        self._first = math.nan
        self._past_end = 0
        self._stopped = ""

    def _receive(self, block: StateBlock | TruthBlock) -> None:
        stream = self._truth if isinstance(block, TruthBlock) else self._state
        chosen = stream.decimator.pick(block.t)
        if stream is self._state and math.isnan(self._first) and chosen.any():
            self._first = float(block.t[chosen][0])
        late = block.t - self._first > self.max_duration  # never, before the first state
        if isinstance(block, TruthBlock):
            stream.names = tuple(f"truth/{joint}" for joint in block.name)
            stream.add(block.t, np.asarray(block.position), chosen & ~late)
            return
        self._past_end += int((chosen & late).sum())
        columns = block.columns()
        stream.names, rows = tuple(columns), np.column_stack([*columns.values()])
        stream.add(block.t, rows, chosen & ~late)


class _Rows:
    """Rows kept of one stream, in the blocks that they came in."""

    def __init__(self, rate: float) -> None:
        self.decimator = Decimator(rate)
        self.names: tuple[str, ...] = ()
        self._blocks: list[tuple[Array, Array]] = []

    def __len__(self) -> int:
        return sum(len(t) for t, _ in self._blocks)

    def add(self, t: Array, values: Array, kept: Mask) -> None:
        """Keep some of the rows (n, n_columns) at stamps (n,) [s]."""
        self._blocks.append((t[kept], values[kept]))

    def joined(self) -> tuple[Stream, int]:
        """One stream of all rows but those of a clock that was set back, and how many those are."""
        t, rows = (np.concatenate(part) for part in zip(*self._blocks, strict=True))
        forward = forward_rows(t)
        columns = dict(zip(self.names, rows[forward].T, strict=True))
        return Stream(t[forward], columns), int((~forward).sum())
