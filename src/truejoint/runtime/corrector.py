"""The corrector: a model file in the robot's control loop."""

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Lock, get_ident
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy import ndarray
from numpy.typing import ArrayLike

from truejoint.array_types import Array, Integers, floats
from truejoint.calibration.calibration import Calibration, as_calibration, as_recorded
from truejoint.calibration.model_file import read_calibration
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError, ModelFileError, TruejointError
from truejoint.layout import refuse_copy
from truejoint.runtime import fields as at
from truejoint.runtime.correction import (
    accept_offset,
    acknowledge,
    begin,
    correct_rows,
    correct_sample,
    tell_homing,
)
from truejoint.runtime.fields import OnFault, Reaction
from truejoint.runtime.limits import RANGE_MARGIN, limits_of
from truejoint.runtime.status import Status, Unlearnt
from truejoint.summary import Summarised

if TYPE_CHECKING:
    from truejoint.recordings import Recording


@dataclass(frozen=True, eq=False)
class CorrectionTrace:
    """Output of a corrector for each row of a recording.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time stamps [s].
    position, half_width : ndarray, shape (n, n_joints)
        As `Corrector.position` and `Corrector.half_width` [rad or m].
    status : ndarray, shape (n,)
        Bits of `Status`.
    unlearnt : ndarray, shape (n,)
        Bits of `Unlearnt`.
    beside : mapping of str to ndarray, shape (n, 2)
        As `Corrector.beside`, with a row each.

    Examples
    --------
    >>> int((Corrector(model).run(test).status == Status.NOT_HOMED).sum())
    400
    """

    t: Array
    position: Array
    half_width: Array
    status: Integers
    unlearnt: Integers
    beside: Mapping[str, Array]


_FLOAT: Final = np.dtype(np.float64)
_T: Final = at.T


class Corrector(Summarised):
    """Corrects joint positions sample by sample, as fast as the loop that calls it.

    Everything is compiled, or taken from the disk, when it is made; `step` allocates nothing,
    raises nothing, and gives the same numbers as `Calibration.correct`. Until `set_homing` says
    that the robot is homed, no position is corrected.

    Parameters
    ----------
    model : path-like or Calibration
        Model file, or what `calibrate` gave. For motions that begin with `rezero`, give
        `Calibration.for_rezeroing`; until then it is the less accurate one.
    level : float, optional
        Probability of the half-width: of the model's interval or, where it has none, of the normal
        distribution that a filter takes its error for; by default 0.9, or the nearest that the
        model states.
    range_margin : float
        Share of its trained range by which a feature may lie outside, 0 to 1; the interval is
        wider there.
    on_fault : {"hold", "raw", "silent"} or OnFault
        Value of `position` where the status is not OK. The default holds the correction
        that it believed last for 1 s. Then it takes the correction back at 2 deg/s and 2 mm/s. It
        goes to the next correction that it believes at the same speed.

    Attributes
    ----------
    made_for : tuple of str
        Robot and arm that the model is of.
    on_fault : OnFault
        Value of `position` where the status is not OK.
    joints, signals : tuple of str
        Joints that come out, and the columns that a sample must hold, in order: those of the model,
        then those that are redundant to the measured positions.
    position : ndarray, shape (n_joints,)
        Corrected position; where the status is not OK, as `on_fault` says [rad or m]. NaN where
        the status is WRONG_SIZE.
    half_width : ndarray, shape (n_joints,)
        How far off `position` may be [rad or m]; infinite where that is not known.
    correction : ndarray, shape (n_joints,)
        Error of the measured position by the model [rad or m], whatever the status; NaN where the
        sample was not used. Without the offset of `rezero`.
    features : ndarray, shape (k,)
        Features of the last sample that was used.
    offset : ndarray, shape (n_joints,)
        Given to `rezero` [rad or m].
    beside : mapping of str to ndarray, shape (2,)
        Further estimates of the model, and its half-width at `level`, of the last sample that was
        used: ``"load"`` of ``ukf_friction``, the torque on the jaw from outside [Nm]; ``"torque"``
        of ``ukf_elastic`` and ``hybrid`` at the jaw [Nm], where recordings had ``truth_effort/jaw``
        (its half-width is the filter's, too wide with trees); ``"grip"``, ``"tip_first"`` and
        ``"tip_second"`` [Nm] of ``ukf_cables`` and ``hybrid_cables``; those of a mean's members.

    Raises
    ------
    ModelFileError
        If the file is missing, damaged or of a newer format, lacks what the checks need, or its
        estimator uses later rows.
    CalibrationError
        If the model does not state that level, the margin is not from 0 to 1, or a calibration
        that is given as such uses later rows.

    Notes
    -----
    The arrays change in place at every step: copy what you want to keep. A corrector belongs to the
    thread of its first step, until `release` or that thread's end; a step of another one is
    OTHER_THREAD, and changes nothing. `set_homing`, `rezero` and `acknowledge` may come from any
    thread: each takes effect between two samples, as a whole. It refuses to be copied and pickled.

    Examples
    --------
    >>> corrector = Corrector(model)
    >>> status = corrector.set_homing(True)
    >>> status = corrector.step(0.0, [test.column(name)[0] for name in corrector.signals])
    >>> corrector.position.shape
    (1,)
    """

    __slots__ = (
        "_commands", "_homings", "_memory", "_n_signals", "_numbers", "_packed", "_sample",
        "_statuses", "_taking", "_thread", "beside", "correction", "features", "half_width",
        "joints", "made_for", "offset", "on_fault", "position", "signals",
    )  # fmt: skip

    def __init__(
        self,
        model: str | os.PathLike[str] | Calibration,
        *,
        level: float | None = None,
        range_margin: float = RANGE_MARGIN,
        on_fault: OnFault | Reaction = "hold",
    ) -> None:
        data = _read(model)
        self.made_for = data.robot, data.arm
        self.on_fault = on_fault if isinstance(on_fault, OnFault) else OnFault(on_fault)
        self.joints, self.signals = data.joints, data.loop_signals
        self._n_signals = len(self.signals)
        # Packed memory holds on to the compiled functions whose addresses it contains.
        self._packed = packed = at.pack(data, limits_of(data, range_margin), level, self.on_fault)
        self._numbers, self._memory = packed.numbers, packed.memory
        self._sample = packed.view("sample")
        self.position = packed.view("position")
        self.half_width = packed.view("half_width")
        self.correction = packed.view("correction")
        self.offset = packed.view("offset")
        self.features = packed.view("features")
        family = data.family
        paths = family.beside(data.fitted.params)
        self.beside: dict[str, Array] = {
            name: packed.part("model", *path).view(name) for name, path in paths.items()
        }
        homings = data.origin.homing_ids
        self._homings = {name: at.HOMING_OF_CALIBRATION - k for k, name in enumerate(homings)}
        self._statuses = _Statuses()
        self._thread, self._taking = 0, Lock()
        # One command at a time. Samples need no lock: a kernel holds the interpreter to its end.
        self._commands = Lock()
        # Compile what is not compiled yet; `step` finds everything ready.
        for kernel in (begin, acknowledge, tell_homing, accept_offset, correct_sample):
            kernel(self._numbers.copy(), self._memory.copy())

    @property
    def spike_speed(self) -> Array:
        """Speed (n_joints,) [rad/s or m/s] above which a measured position is taken for a spike."""
        reach = self._packed.view("reach")[self._packed.view("measured")]
        return np.asarray(reach / self._memory[at.TRAINING_DT])

    @property
    def unlearnt(self) -> Unlearnt:
        """How the motion up to the last sample that was used is unlike that of the training."""
        return Unlearnt(int(self._numbers[at.UNLEARNT]))

    def summary(self) -> dict[str, str]:
        """Give what goes in and out, and where it stands, by label."""
        return {
            "signals": ", ".join(self.signals),
            "joints": ", ".join(self.joints),
            "position": str(self.position),
            "homing": str(Status(int(self._numbers[at.HOMING])).name),
        }

    def step(self, t: float, sample: ArrayLike) -> Status:
        """Correct one `sample` (n_signals,), taken at `t` [s], into `position` and `half_width`.

        It holds the values of `signals`, in their order and units; fastest as an array of float64.
        Returns OK (0), or why the sample is not believed.
        """
        if self._thread != get_ident() and not self._take():
            return Status.OTHER_THREAD
        memory = self._memory
        try:
            # By exact type first: a look at a type costs as much as looking at ten signals.
            if type(sample) is not ndarray or sample.dtype is not _FLOAT:
                sample = _real(sample)
            if type(t) is not float and not isinstance(t, (float, int)):
                t = float(_real(t))
            if len(sample) != self._n_signals:
                return self._refuse()
            self._sample[:] = sample
            memory[_T] = t
        except Exception:  # noqa: BLE001  # what is given may be anything
            return self._refuse()
        return self._statuses[correct_sample(self._numbers, memory)]

    def set_homing(self, is_homed: bool, homing_id: str | None = None) -> Status:
        """Say whether the robot is homed, and which homing its positions refer to.

        Call it before the first sample, and whenever it changes: then an offset of `rezero` ends
        and the history of the signals starts anew. A `homing_id` is compared with those of the
        training recordings or, where these have none, with the first one told; without it, a robot
        that is homed after it was said not to be counts as homed again. It also does as `release`,
        unless another thread has the corrector: that one goes on with it.

        Returns OK, NOT_HOMED or HOMED_AGAIN: what every sample from now on is flagged with.
        """
        with self._commands:
            number = at.HOMING_UNKNOWN
            if homing_id is not None:
                number = self._homings.setdefault(homing_id, len(self._homings) + 1)
            self._numbers[at.IS_HOMED], self._numbers[at.TOLD_ID] = bool(is_homed), number
            if self._thread == get_ident():
                self.release()
            return self._statuses[tell_homing(self._numbers, self._memory)]

    def rezero(self, zero: Zero | ArrayLike) -> Status:
        """Add an offset to every corrected position: the calibration is valid for this homing.

        It moves the output; `Calibration.at` moves the inputs too, where the zero is one of them.

        `zero` is a `Zero`, which moves by its `shift`, or an offset (n_joints,) [rad or m] of true
        minus corrected position, for instance from a touched stop. Returns as `set_homing`, no
        longer HOMED_AGAIN, and ends ZERO_SUSPECT as `acknowledge` does; raises CalibrationError
        unless there is one finite number for each joint.
        """
        offset = zero.shift if isinstance(zero, Zero) else zero
        values = floats(offset, "offset", CalibrationError)
        if values.shape != self.offset.shape or not np.isfinite(values).all():
            raise CalibrationError(
                f"offset {offset!r:.80} is not a finite number for each of {', '.join(self.joints)}"
            )
        with self._commands:
            self.offset[:] = values
            return self._statuses[accept_offset(self._numbers, self._memory)]

    def acknowledge(self) -> None:
        """Say that the zero is right after all: ends ZERO_SUSPECT.

        The redundant signals of the next sample count as right from then on.
        """
        with self._commands:
            acknowledge(self._numbers, self._memory)

    def release(self) -> None:
        """Let the thread of the next step have the corrector; its history goes on."""
        self._thread = 0

    def run(self, recording: "Recording") -> CorrectionTrace:
        """Correct a whole recording as the loop would, from a fresh start, homed as it was told.

        Raises RecordingError if this is no recording or lacks a signal, and CalibrationError while
        another thread has the corrector.
        """
        as_recorded(recording)
        if not self._take():
            raise CalibrationError("another thread has this corrector; make one for this thread")
        begin(self._numbers, self._memory)
        t = np.array(recording.t)
        samples = np.ascontiguousarray(np.column_stack([recording.column(s) for s in self.signals]))
        position, half_width = np.empty((2, len(t), len(self.joints)))
        status, unlearnt = np.empty((2, len(t)), np.int64)
        beside = np.empty((len(t), len(self.beside), 2))
        first = self._memory.ctypes.data
        starts = [(view.ctypes.data - first) // view.itemsize for view in self.beside.values()]
        places = np.array(starts, dtype=np.int64)
        correct_rows(
            self._numbers, self._memory, t, samples, position, half_width, status, unlearnt,
            places, beside,
        )  # fmt: skip
        self.release()
        named = {name: beside[:, k] for k, name in enumerate(self.beside)}
        return CorrectionTrace(t, position, half_width, status, unlearnt, named)

    __reduce__ = refuse_copy

    def _take(self) -> bool:
        """Whether this thread has the corrector, which it may take if no living one has it."""
        with self._taking:
            if self._thread not in sys._current_frames():  # documented: every thread that lives
                self._thread = get_ident()
            return self._thread == get_ident()

    def _refuse(self) -> Status:
        self.position[:] = self.correction[:] = np.nan
        self.half_width[:] = np.inf
        return self._statuses[int(self._numbers[at.HOMING]) | Status.WRONG_SIZE]


def corrector_for(calibration: Calibration, recording: "Recording", **how: Any) -> Corrector:
    """Corrector to run over a recording, which `how` is given to.

    Where it lacks a column that only checks measured positions, none is asked for.
    """
    is_reported = calibration.redundant.keys() <= recording.units.keys()
    return Corrector(calibration if is_reported else calibration.without_redundant(), **how)


class _Statuses(dict[int, Status]):
    """Status by its bits: making one anew would take longer than a linear model."""

    def __missing__(self, bits: int) -> Status:
        self[bits] = status = Status(bits)
        return status


def _real(values: ArrayLike) -> Array:
    """Real numbers as an array; raises TypeError for masked, complex and other objects."""
    array = np.asarray(values)
    if isinstance(values, np.ma.MaskedArray) or array.dtype.kind not in "fiub":
        raise TypeError(f"{array.dtype} are not real numbers")
    return array


def _read(model: str | os.PathLike[str] | Calibration) -> Calibration:
    if not isinstance(model, (str, os.PathLike)):
        return as_calibration(model)
    calibration = read_calibration(model)
    try:
        limits_of(calibration)
        shape = len(calibration.feature_set), len(calibration.joints)
        calibration.family.memory(calibration.fitted, *shape)
    except TruejointError as error:
        raise ModelFileError(f"{model}: {error}; copy or calibrate it again") from None
    return calibration
