"""Recording what an arm reports while it moves."""

from __future__ import annotations

import math
import os
import types
from pathlib import Path
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from truejoint.crtk import Arm, StateBlock, TruthBlock
from truejoint.errors import RecordingError
from truejoint.recordings.parquet import write_parquet
from truejoint.recordings.recording import Provenance, Recording
from truejoint.recordings.synchronise import (
    STATE_BACK,
    TRUTH_BACK,
    Stream,
    forward_rows,
    synchronise,
)

Array = NDArray[np.float64]

QUANTITIES: Final = ("measured", "velocity", "effort", "setpoint", "motor", "motor_velocity")
"""What is recorded of every channel."""
PAST_END: Final = "state: past the longest duration"

_MAX_DURATION: Final = 12 * 3600.0


class Decimator:
    """Picks rows so that no more than `rate` a second are left, by their stamps.

    Time is cut into intervals of 1/rate from the first stamp on; the first row in each interval
    is picked. So it does not matter how the rows come in pieces, and a stream that is slower than
    `rate` passes whole. A clock that is set back is not judged here: its rows pass.

    Parameters
    ----------
    rate : float
        [Hz]; infinite to pick every row.
    """

    def __init__(self, rate: float) -> None:
        if not (rate > 0):
            raise RecordingError(f"recorder: rate {rate} Hz; give one above 0 Hz")
        self._rate = rate
        self._origin = math.nan
        self._interval = -math.inf

    def pick(self, t: Array) -> NDArray[np.bool_]:
        """Say which rows to keep, of the next stamps (n,) [s]; bool (n,)."""
        if math.isinf(self._rate) or not t.size:
            return np.ones(t.shape, dtype=np.bool_)
        if math.isnan(self._origin):
            self._origin = float(t[0])
        # A stamp on an edge belongs to the interval that it starts, rounding or not.
        interval = np.floor((t - self._origin) * self._rate + 1e-6)
        chosen: NDArray[np.bool_] = np.diff(interval, prepend=self._interval) != 0
        self._interval = float(interval[-1])
        return chosen


class Recorder:
    """Records an arm from entering to leaving a ``with`` block.

    The state is thinned out to `state_rate` as it arrives, so memory grows by about 10 kB per
    second of motion whatever the arm's own rate. If the block is left by an exception or by
    Ctrl-C, what was recorded is kept, and written if a `path` was given.

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
        Parquet file to write when the block is left, whichever way; must not exist yet.
    session, homing_id, command : str
    load : float
        Mass hung on the tool [kg]. All for the provenance.

    Examples
    --------
    >>> with Recorder(arm, state_rate=10.0) as recorder:
    ...     arm.move_jp(arm.robot.home + [0.1, 0, 0, 0, 0, 0, 0])
    >>> recorder.recording().joints_of("truth")
    ('shoulder', 'elbow', 'insertion')
    """

    def __init__(
        self,
        arm: Arm,
        state_rate: float = 30.0,
        truth_rate: float | None = None,
        *,
        gap_limit: float = 0.05,
        max_duration: float = _MAX_DURATION,
        path: str | os.PathLike[str] | None = None,
        session: str = "",
        homing_id: str = "",
        load: float = math.nan,
        command: str = "",
    ) -> None:
        if not (gap_limit > 0 and max_duration > 0):
            raise RecordingError(
                f"recorder: gap limit {gap_limit} s and longest duration {max_duration} s; "
                "both must be above 0 s"
            )
        self._path = None if path is None else Path(path)
        if self._path is not None and self._path.exists():
            raise RecordingError(f"{self._path}: exists already; choose another name")
        self._arm = arm
        self._state_rate = state_rate
        self._truth_rate = math.inf if truth_rate is None else truth_rate
        self._gap_limit = gap_limit
        self._max_duration = max_duration
        self._provenance = Provenance(
            robot=arm.robot.name,
            arm=arm.robot.arm,
            session=session,
            homing_id=homing_id,
            load=load,
            command=command,
        )
        self._clear()

    def __enter__(self) -> Self:
        self._clear()
        self._arm.subscribe(self._receive)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: types.TracebackType | None,
    ) -> None:
        self._arm.unsubscribe(self._receive)
        if kind is not None:
            self._stopped = f"stopped by {kind.__name__}" + (f": {error}" if str(error) else "")
        if self._path is not None and self.rows >= 2:
            write_parquet(self.recording(), self._path)

    @property
    def rows(self) -> int:
        """Rows of the state that are kept so far."""
        return sum(len(t) for t, _ in self._state)

    def recording(self, source: str = "") -> Recording:
        """Make a recording of what there is so far; may be called while recording goes on.

        Parameters
        ----------
        source : str
            For the provenance; by default ``"recorded from <robot>"``.

        Returns
        -------
        Recording
            `QUANTITIES` of every channel, and the joint encoders where the arm has them,
            interpolated to the state's stamps (`truejoint.recordings.synchronise`).

        Raises
        ------
        RecordingError
            If the arm has reported fewer than 2 rows: did it move?
        """
        if self.rows < 2:
            raise RecordingError(
                f"recorder: {self.rows} rows from {self._arm.robot.title}; it reports only while "
                "homed and moving or holding"
            )
        dropped: dict[str, int] = {PAST_END: self._past_end} if self._past_end else {}
        state = self._join(self._state, self._state_names, dropped, STATE_BACK)
        columns = {"t": state.t, **state.columns}
        rates = {"state": self._state_rate}
        if sum(len(t) for t, _ in self._truth) >= 2:
            truth = self._join(self._truth, self._truth_names, dropped, TRUTH_BACK)
            columns, unmatched = synchronise(state, truth, self._gap_limit)
            dropped |= unmatched
            rates["truth"] = round(float(1.0 / np.median(np.diff(truth.t))), 3)
        start = float(columns["t"][0])
        columns["t"] = columns["t"] - start
        values = {
            **self._provenance.to_dict(),
            "source": source or f"recorded from {self._arm.robot.title}",
            "rates": rates,
            "dropped": dropped,
            "start": start,
            "notes": self._stopped,
        }
        return Recording.from_columns(columns, Provenance.from_dict(values))

    def _clear(self) -> None:
        self._state: list[tuple[Array, Array]] = []
        self._truth: list[tuple[Array, Array]] = []
        self._state_names: tuple[str, ...] = ()
        self._truth_names: tuple[str, ...] = ()
        self._first = math.nan
        self._past_end = 0
        self._stopped = ""
        self._state_decimator = Decimator(self._state_rate)
        self._truth_decimator = Decimator(self._truth_rate)

    def _receive(self, block: StateBlock | TruthBlock) -> None:
        if isinstance(block, TruthBlock):
            self._receive_truth(block)
        else:
            self._receive_state(block)

    def _receive_state(self, block: StateBlock) -> None:
        chosen = self._state_decimator.pick(block.t)
        if not chosen.any():
            return
        self._state_names = tuple(f"{q}/{channel}" for q in QUANTITIES for channel in block.name)
        t = block.t[chosen]
        if math.isnan(self._first):
            self._first = float(t[0])
        inside = t - self._first <= self._max_duration
        self._past_end += int((~inside).sum())
        rows = np.hstack([getattr(block, quantity)[chosen][inside] for quantity in QUANTITIES])
        self._state.append((t[inside], rows))

    def _receive_truth(self, block: TruthBlock) -> None:
        self._truth_names = tuple(f"truth/{joint}" for joint in block.name)
        chosen = self._truth_decimator.pick(block.t)
        if not math.isnan(self._first):
            chosen &= block.t - self._first <= self._max_duration
        self._truth.append((block.t[chosen], np.asarray(block.position)[chosen]))

    @staticmethod
    def _join(
        blocks: list[tuple[Array, Array]],
        names: tuple[str, ...],
        dropped: dict[str, int],
        reason: str,
    ) -> Stream:
        """One stream of all blocks, without the rows of a clock that was set back."""
        t = np.concatenate([stamps for stamps, _ in blocks])
        rows = np.concatenate([values for _, values in blocks])
        forward = forward_rows(t)
        if not forward.all():
            dropped[reason] = int((~forward).sum())
        return Stream(t[forward], dict(zip(names, rows[forward].T, strict=True)))
