"""What is shown of an arm: reported, corrected and true positions, and what goes with them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Final, Self, get_origin

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.crtk.arm import Arm
from truejoint.crtk.states import check_ready
from truejoint.errors import CalibrationError, RecordingError, TruejointError, words
from truejoint.robots import Robot
from truejoint.robots.blocks import Block, StateBlock, TruthBlock
from truejoint.runtime.status import Status

if TYPE_CHECKING:  # the process that draws needs neither them nor the corrector
    from truejoint.calibration import Calibration
    from truejoint.recordings.table.recording import Recording

MOST_ROWS: Final = 5000
"""State messages that are corrected for one picture; of more, as an arm faster than real time
sends them, the latest count."""
MOST_POINTS: Final = 600  # of a curve
_TRUTH_AGE: Final = 0.15  # of the latest reading of the joint encoders [s], to count as the truth
_STAMP_ERROR: Final = 1e-4  # [s]
_MOST_WORDS: Final = 500  # characters of an error


@dataclass(frozen=True, eq=False)
class Samples(Block):
    """Instants of an arm, a row each; NaN where something is not known."""

    joints: tuple[str, ...]
    t: Array  # (n,), time stamps on the robot's clock [s]
    reported: Array  # (n, n_joints) [rad or m], as what follows
    corrected: Array  # only where the corrector vouches for it
    half_width: Array  # of its interval
    truth: Array
    setpoint: Array
    effort: Array  # as the robot reports it [Nm or N]
    status: Integers  # (n,), bits of the corrector's `Status`
    interval: Array  # (n,), longest time between two state messages since the row before [s]
    effort_units: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.t)

    def rows(self, selection: slice | Integers) -> "Samples":
        """Keep some rows."""
        return replace(self, **{name: getattr(self, name)[selection] for name in _ARRAYS})

    def window(self, end: float, span: float) -> "Samples":
        """Rows of the last `span` until `end` [s], one at least."""
        last = max(int(np.searchsorted(self.t, end, side="right")), 1)
        return self.rows(slice(min(int(np.searchsorted(self.t, end - span)), last - 1), last))

    def thinned(self) -> "Samples":
        """Rows that a curve shows, the latest among them."""
        step = max(len(self) // MOST_POINTS, 1)
        return self.rows(slice((len(self) - 1) % step, None, step))

    def largest(self, values: Array) -> Integers:
        """Rows of the largest of `values` (n,) in size, one in each of `MOST_POINTS` stretches."""
        starts = np.unique(np.linspace(0, len(self), MOST_POINTS + 1, dtype=int)[:-1])
        sizes = np.nan_to_num(np.abs(values), nan=-1.0)
        ends = np.append(starts[1:], len(self))
        pieces = zip(starts.tolist(), ends.tolist(), strict=True)
        return np.array([start + int(np.argmax(sizes[start:end])) for start, end in pieces])

    @property
    def calibrated(self) -> tuple[str, ...]:
        """Joints that are corrected somewhere; without any, those of which the truth is known."""
        for values in (self.corrected, self.truth):
            if (has_values := np.isfinite(values).any(axis=0)).any():
                return tuple(np.array(self.joints)[has_values].tolist())
        return ()

    @classmethod
    def of_recording(
        cls, recording: "Recording", calibration: "Calibration | None" = None
    ) -> "Samples":
        """Every row of a recording, corrected as the robot's loop would.

        Raises RecordingError without a measured position, CalibrationError if the calibration is
        not for it or does not run in a loop.
        """
        robot = recording.robot
        joints = tuple(j for j in recording.joints_of("measured") if j in robot.joint_names)
        if not joints:
            raise RecordingError(
                f"{recording.provenance.source or 'recording'} has no measured position of a joint "
                f"of {robot.title}: nothing to show"
            )
        n, t = len(recording), recording.t
        corrected, half_width = np.full((2, n, len(joints)), np.nan)
        status = np.zeros(n, dtype=np.int64)
        if calibration is not None:
            from truejoint.runtime.corrector import corrector_for  # noqa: PLC0415

            calibration.check_recording(recording)
            corrector = corrector_for(calibration, recording)
            corrector.set_homing(True, recording.provenance.homing_id or None)
            trace = corrector.run(recording)
            status, columns = trace.status, [joints.index(joint) for joint in corrector.joints]
            vouched = _vouched(trace.position, trace.half_width, trace.status)
            corrected[:, columns], half_width[:, columns] = vouched

        def of(quantity: str) -> Array:
            columns = [f"{quantity}/{joint}" for joint in joints]
            return recording.table.reindex(columns=columns).to_numpy(dtype=float, copy=True)

        return cls(
            joints, t, of("measured"), corrected, half_width, of("truth"), of("setpoint"),
            of("effort"), status, np.diff(t, prepend=np.nan),
            tuple(recording.units.get(f"effort/{j}", "") for j in joints),
        )  # fmt: skip


_ARRAYS: Final = [f.name for f in fields(Samples) if get_origin(f.type) is not tuple]


class LiveSamples:
    """Makes a row of what an arm reports, however much that is, and corrects all of it.

    Raises CalibrationError if the `calibration` is of another arm, or does not run in a loop.
    """

    def __init__(self, robot: Robot, calibration: "Calibration | None" = None) -> None:
        from truejoint.recordings.table.recording import default_unit  # noqa: PLC0415
        from truejoint.runtime.corrector import Corrector  # noqa: PLC0415

        if calibration is not None:
            calibration.check_robot(robot)
        self.robot: Final = robot
        self._calibration = calibration
        self.corrector = None if calibration is None else Corrector(calibration)
        self._channels = robot.joint_channels
        names = robot.joint_names
        self._effort_units = tuple(default_unit(f"effort/{name}", robot) for name in names)
        # Period of the samples [s] that a model counts; 0 where it goes by their stamps.
        self._period = 0.0
        if calibration is not None and calibration.counts_samples:
            self._period = calibration.origin.sample_dt
        self._due = -math.inf  # stamp of the next sample [s]
        self._truth: TruthBlock | None = None  # latest readings
        # Correction and half-width (n_joints,) that the corrector vouched for last.
        self._held = np.full((2, len(names)), np.nan)

    def set_homing(self, is_homed: bool, homing_id: str) -> None:
        """Tell the corrector whether the arm is homed, and which homing it is."""
        if self.corrector is not None:
            self.corrector.set_homing(is_homed, homing_id or None)

    def row(
        self,
        states: Sequence[StateBlock],
        truths: Sequence[TruthBlock],
        interval: float = math.nan,
        *,
        is_braked: bool = False,
    ) -> Samples | None:
        """Correct consecutive state messages, one or more, and show one that has a truth.

        That is the latest one that a reading of the joint encoders follows, which are taken
        between the readings; without encoders the latest of all. None where the next reading is
        still to come, or no message is due yet for a model that counts samples. Of an arm that
        `is_braked` signals may stand still: it keeps its correction.
        """
        state = StateBlock.joined(states).rows(slice(-MOST_ROWS, None))
        used = self._due_rows(state.t)
        if not len(used):
            return None
        readings = self._readings(truths)
        if readings is not None and state.t[used[-1]] - readings.t[-1] > _TRUTH_AGE:
            readings = None
        before = used if readings is None else used[state.t[used] <= readings.t[-1]]
        shown = int(before[-1]) if len(before) else -1
        corrected, half_width, status = self._correct(state, used, shown)
        if shown < 0:
            return None
        reported = state.measured[shown, self._channels]
        if np.isfinite(corrected).any():
            self._held = np.stack([corrected - reported, half_width])
        elif is_braked and status == Status.FROZEN:
            corrected, half_width, status = reported + self._held[0], self._held[1], Status.OK
        truth, effort = np.full((2, len(self.robot.joints)), np.nan)
        if readings is not None:
            for name, positions in zip(readings.name, readings.position.T, strict=True):
                at = np.interp(state.t[shown], readings.t, positions)
                truth[self.robot.joint_names.index(name)] = at
        if state.effort.shape[1]:
            effort = state.effort[shown, self._channels]
        return Samples(
            joints=self.robot.joint_names,
            t=state.t[[shown]],
            reported=reported[None],
            corrected=corrected[None],
            half_width=half_width[None],
            truth=truth[None],
            setpoint=state.setpoint[[shown]][:, self._channels],
            effort=effort[None],
            status=np.array([int(status)]),
            interval=np.array([interval]),
            effort_units=self._effort_units,
        )

    def _due_rows(self, t: Array) -> Integers:
        """Rows to step through: all, or for a model that counts samples those at its period."""
        if not self._period:
            return np.arange(len(t))
        rows = []
        for i, stamp in enumerate(t.tolist()):
            if stamp >= self._due or stamp < self._due - 2 * self._period:
                rows.append(i)
                self._due = stamp + self._period - _STAMP_ERROR
        return np.array(rows, dtype=np.int64)

    def _readings(self, truths: Sequence[TruthBlock]) -> TruthBlock | None:
        """Latest readings of the joint encoders, one from before among them."""
        if new := [block for block in truths if len(block.t)]:
            n_rows = sum(len(block.t) for block in new) + 1
            both = TruthBlock.joined([*filter(None, [self._truth]), *new])
            self._truth = TruthBlock(both.t[-n_rows:], both.name, both.position[-n_rows:])
        return self._truth

    def _correct(
        self, state: StateBlock, used: Integers, shown: int
    ) -> tuple[Array, Array, Status]:
        """Step through rows; position and half-width (n_joints,) and status of the one shown."""
        position, half_width = np.full((2, len(self.robot.joints)), np.nan)
        if self.corrector is None:
            return position, half_width, Status.OK
        columns, title = state.columns(), self.robot.title
        missing = [name for name in self.corrector.signals if name not in columns]
        if missing and self._calibration and self._calibration.redundant:
            # As over most topics: go on without what would only check the positions.
            self._calibration = self._calibration.without_redundant()
            self.corrector = type(self.corrector)(self._calibration)
            return position, half_width, Status.NOT_HOMED  # until it is told that it is
        if missing:
            raise CalibrationError(
                f"{title} does not report {', '.join(missing)}, which the model needs"
            )
        rows = np.column_stack([columns[name] for name in self.corrector.signals])
        joints, status_shown = self.robot.index(self.corrector.joints), Status.OK
        for i in used.tolist():
            status = self.corrector.step(float(state.t[i]), rows[i])
            if i == shown:
                status_shown = status
                position[joints], half_width[joints] = _vouched(
                    self.corrector.position, self.corrector.half_width, np.array(int(status))
                )
        return position, half_width, status_shown


def _vouched(position: Array, half_width: Array, status: Integers) -> tuple[Array, Array]:
    """Corrected positions and half-widths, NaN where not corrected, or not known."""
    good = (status == Status.OK)[..., None]
    has_width = good & np.isfinite(half_width)
    return np.where(good, position, np.nan), np.where(has_width, half_width, np.nan)


@dataclass(frozen=True)
class Condition:
    """How an arm, or the recording of one, stands."""

    state: str  # in a word or two: ``"ENABLED"``, ``"no answer"``
    reason: str = ""  # why it takes no commands, or reports nothing new; empty where all is well
    is_fresh: bool = True  # whether the latest sample is of now
    t: float = math.nan  # now, on the robot's clock [s]; NaN if it does not say

    @property
    def is_braked(self) -> bool:
        """Whether the arm stands because it was told to."""
        return self.state in ("PAUSED", "DISABLED")

    @classmethod
    def of(cls, arm: Arm) -> Self:
        """Ask an arm; one that does not answer is in a condition as well, never an error."""
        try:
            now = arm.operating_state()
        except Exception as error:  # noqa: BLE001  # whatever a back end raises is told
            return cls("no answer", words(error, _MOST_WORDS), False)
        if now.is_busy and not now.is_homed:
            return cls("homing", "positions mean nothing before it is homed", False, now.t)
        reason, state, is_fresh = "", f"{now.state}, moving" if now.is_busy else now.state, True
        try:
            check_ready(replace(now, is_busy=False), "motion")
        except TruejointError as error:
            reason = _without_command(error).removeprefix(f"the arm is {now.state}; ")
        try:
            arm.measured_js()
        except Exception as error:  # noqa: BLE001
            reason, state, is_fresh = reason or _without_command(error), now.state, False
        return cls(state, reason, is_fresh, now.t)


def _without_command(error: Exception) -> str:
    """Give what an arm says, without the name of the command that it refused."""
    text = words(error, _MOST_WORDS)
    return text.partition(" refused: ")[2] or text
