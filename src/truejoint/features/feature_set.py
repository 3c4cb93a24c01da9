"""Causal features of a recording's signals, the same offline as in the robot's loop.

A kernel of one sample allocates nothing, and `feature_rows` calls it for every row of a recording:
offline and in the loop, the same machine code makes the same bits.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Final, Literal, get_args

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.compiled import compiled, unrolled, vector
from truejoint.errors import CalibrationError
from truejoint.summary import Summarised

if TYPE_CHECKING:  # a control loop needs neither, and pandas takes its time
    from truejoint.recordings import Recording
    from truejoint.robots import Robot

Program = tuple[Integers, Integers, Array, Integers]
Operation = Literal["value", "lag", "lowpass", "rate", "play"]

MAX_FEATURES: Final = 512
MAX_LAG: Final = 10_000
MAX_TIME_CONSTANT: Final = 3600.0
MAX_SIGNAL_LENGTH: Final = 120
MAX_RATE_RATIO: Final = 1.5
"""How far the time step may be from that of training where features count samples."""
MAX_STEPS: Final = 10.0
"""How many time steps of the training two rows may be apart, where the past matters at all."""
GAP: Final = 0.3
"""Time without a row [s] that a history bridges, and `MAX_STEPS` where that is longer.

On five recordings of a da Vinci grasper at 1 kHz, with 0.1 to 0.29 s left out in each second,
``rich_trees`` errs by 0.34 deg where it bridges them, by 3.26 deg where it forgets the past, and by
0.31 deg with nothing left out; ``ukf_elastic`` by 0.31, 0.90 and 0.31 deg, ``gru`` by 0.42, 2.02
and 0.40 deg."""

VALUE, LAG, LOWPASS, RATE, PLAY = range(5)
"""Operations as the kernels know them, in the order of `Operation`."""
_CODES: Final = {operation: code for code, operation in enumerate(get_args(Operation))}
_SIGNAL: Final = re.compile(r"[A-Za-z]\w*/\w+", re.ASCII)
_CALL: Final = re.compile(r"(\w+)\(\s*([^\s,()]+)\s*,\s*([^\s,()]+)\s*\)", re.ASCII)
_FORMS: Final = (
    "'measured/jaw', 'lag(measured/jaw, 3)' (samples), 'lowpass(effort/jaw, 0.05)' (s), "
    "'rate(measured/jaw, 0.02)' (s), 'play(measured/jaw, 0.0175)' (half-width, rad or m)"
)


def is_signal(name: str) -> bool:
    """Whether a column is called ``<quantity>/<channel>``, as every input of a model is."""
    return len(name) <= MAX_SIGNAL_LENGTH and _SIGNAL.fullmatch(name) is not None


@dataclass(frozen=True)
class Feature:
    """One input of a model: a signal of the recording, as it is or through a causal operation.

    Attributes
    ----------
    signal : str
        Column of a recording, ``<quantity>/<channel>``; never a ``truth`` column.
    operation : str
        ``value``: the signal itself. ``lag``: its value some samples ago. ``lowpass``: first-order
        low-pass, exact for a signal that runs straight between its samples at any spacing.
        ``rate``: derivative of the same low-pass. ``play``: the play (backlash) operator.
    parameter : float
        Samples (``lag``, 1 to 10000), time constant [s] (``lowpass`` and ``rate``, up to 3600) or
        half-width [unit of the signal] (``play``); 0 for ``value``.

    Raises
    ------
    CalibrationError
        If a part breaks these rules.

    Examples
    --------
    >>> str(Feature.parse("play(measured/jaw, 0.02)"))
    'play(measured/jaw, 0.02)'
    """

    signal: str
    operation: Operation = "value"
    parameter: float = 0.0

    def __post_init__(self) -> None:
        if not is_signal(self.signal):
            raise CalibrationError(
                f"feature signal {self.signal[:80]!r} is not '<quantity>/<channel>'; write one of "
                f"{_FORMS}"
            )
        if self.signal.startswith("truth"):
            raise CalibrationError(
                f"feature {self.signal!r} is what a model has to find; choose motor-side signals"
            )
        if self.operation not in _CODES:
            raise CalibrationError(
                f"no feature operation {self.operation!r}; write one of {_FORMS}"
            )
        p = self.parameter
        smooth = (0 < p <= MAX_TIME_CONSTANT, f"takes up to {MAX_TIME_CONSTANT:g} s")
        rules: dict[Operation, tuple[bool, str]] = {
            "value": (p == 0, "takes no parameter"),
            "lag": (1 <= p <= MAX_LAG and float(p).is_integer(), f"takes 1 to {MAX_LAG} samples"),
            "lowpass": smooth,
            "rate": smooth,
            "play": (0 < p < math.inf, "takes a half-width above 0 in the signal's unit"),
        }
        good, rule = rules[self.operation]
        if not good:
            raise CalibrationError(
                f"feature {self.operation}({self.signal}, {p!r}): {self.operation} {rule}"
            )

    def __str__(self) -> str:
        if self.operation == "value":
            return self.signal
        parameter = int(self.parameter) if self.operation == "lag" else self.parameter
        return f"{self.operation}({self.signal}, {parameter!r})"

    @classmethod
    def parse(cls, text: str) -> Feature:
        """Feature of its text, for instance ``"lag(measured/jaw, 3)"``, the inverse of `str`.

        Raises CalibrationError if the text has another form.
        """
        text = text.strip()
        call = _CALL.fullmatch(text)
        if call is None:
            return cls(text)
        operation, signal, number = call.groups()
        try:
            parameter = float(number)
        except ValueError:
            raise CalibrationError(
                f"feature {text[:80]!r}: {number[:40]!r} is not a number; write one of {_FORMS}"
            ) from None
        if operation == "value":
            raise CalibrationError(f"feature {text[:80]!r}: write {signal!r} for the value itself")
        return cls(signal, operation, parameter)  # type: ignore[arg-type]  # checked there


@dataclass(frozen=True, repr=False)
class FeatureSet(Summarised):
    """Features in the order of a model's inputs.

    Raises
    ------
    CalibrationError
        If there are none, more than 512, or one stands twice.

    Examples
    --------
    >>> FeatureSet.parse(["measured/jaw", "rate(measured/jaw, 0.1)"]).signals
    ('measured/jaw',)
    """

    features: tuple[Feature, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.features) <= MAX_FEATURES:
            raise CalibrationError(
                f"{len(self.features)} features chosen; a model takes 1 to {MAX_FEATURES}"
            )
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise CalibrationError(f"features {', '.join(twice)} stand twice; name each once")

    @classmethod
    def parse(cls, texts: FeatureSet | Iterable[str] | str) -> FeatureSet:
        """Feature set of the texts of its features, or of one; raises CalibrationError."""
        if isinstance(texts, FeatureSet):
            return texts
        if not isinstance(texts, Iterable):
            raise CalibrationError(f"features are {texts!r:.80}; give a list, each one of {_FORMS}")
        parts = (texts,) if isinstance(texts, str) else tuple(texts)
        for text in parts:
            if not isinstance(text, str):
                raise CalibrationError(f"feature {text!r:.80} is no text; write one of {_FORMS}")
        return _parsed(parts)

    def __len__(self) -> int:
        return len(self.features)

    def summary(self) -> dict[str, str]:
        """How many features there are, and the first of them."""
        some = ", ".join(self.names[:3]) + (", ..." if len(self) > 3 else "")
        return {"features": f"{len(self)}: {some}"}

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Text of each feature, in order; `parse` reads it back."""
        return tuple([str(feature) for feature in self.features])

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Columns that the features are made of, each once, in order of first use."""
        return tuple(dict.fromkeys([feature.signal for feature in self.features]))

    @property
    def counts_samples(self) -> bool:
        """Whether a feature counts samples and thus means something else at another rate."""
        return bool((self.program[0] == LAG).any())

    @cached_property
    def program(self) -> Program:
        """Operation, source, parameter and state slot (k,) of each feature, for the kernels."""
        rows = [(_CODES[f.operation], self.signals.index(f.signal)) for f in self.features]
        operation, source = np.array(rows, dtype=np.int64).T.copy()
        parameter = np.array([f.parameter for f in self.features], dtype=float)
        return operation, source, parameter, self._ends[:-1]

    @property
    def memory_size(self) -> int:
        """Numbers that the kernels remember between samples, all 0 before the first."""
        return int(self._ends[-1])

    @cached_property
    def _ends(self) -> Integers:
        """Where the state (k + 1,) of each feature begins, and where that of the last ends."""
        sizes = {"value": 0, "lowpass": 2, "rate": 2, "play": 1}
        lengths = (sizes.get(f.operation, int(f.parameter) + 1) for f in self.features)
        return np.cumsum([0, *lengths])

    def compute(self, recording: Recording, gap_limit: float | None = None) -> Array:
        """Features (n, k) of every row of a recording in units of the signals, a rate per second.

        The history starts at the first row and after each gap of more than `gap_limit` [s], by
        default that of `default_gap_limit`. Raises RecordingError, naming the columns, if a signal
        is missing.
        """
        if gap_limit is None:
            gap_limit = default_gap_limit([recording])
        out = np.empty((len(recording), len(self)))
        samples = np.empty((len(recording), len(self.signals)))
        for column, name in zip(samples.T, self.signals, strict=True):
            column[:] = recording.column(name)  # a fifth of the time that pandas takes for a list
        t, memory = np.array(recording.t), np.zeros(self.memory_size)
        feature_rows(self.program, gap_limit, t, samples, memory, out)
        return out


@lru_cache(maxsize=256)
def _parsed(texts: tuple[str, ...]) -> FeatureSet:
    return FeatureSet(tuple([Feature.parse(text) for text in texts]))


def sample_dt(recordings: Sequence[Recording]) -> float:
    """Median time between the rows [s] of recordings.

    Examples
    --------
    >>> round(sample_dt(training), 6)
    0.01
    """
    return float(np.median(np.concatenate([np.diff(recording.t) for recording in recordings])))


def check_sample_dt(recording: Recording, trained: float) -> None:
    """Refuse, with CalibrationError, a recording whose rows are not about `trained` [s] apart."""
    dt = sample_dt([recording])
    if max(trained, dt) > MAX_RATE_RATIO * min(trained, dt):
        raise CalibrationError(
            f"{recording.provenance.source or 'recording'} has a row every {dt:.4g} s, "
            f"training every {trained:.4g} s, and the model counts samples (lag features, filters, "
            "differences); resample it, or calibrate at this rate"
        )


def check_history(recording: Recording, trained: float) -> None:
    """Refuse, with CalibrationError, a recording whose rows are too far apart to tell of the past.

    They are `MAX_STEPS` of the training's time steps, `trained` [s], apart, but for rounding. A
    `trained` of 0 is not known.
    """
    dt = sample_dt([recording])
    if 0.0 < trained < dt / (0.999 * MAX_STEPS):
        raise CalibrationError(
            f"{recording.provenance.source or 'recording'} has a row every {dt:.4g} s, training "
            f"every {trained:.4g} s, so that it tells too little of the past, which the model "
            "needs; record at the rate of the training, or calibrate at this one"
        )


def default_gap_limit(recordings: Sequence[Recording]) -> float:
    """Time between two rows [s] that counts as a gap where it is longer: see `GAP`.

    Examples
    --------
    >>> default_gap_limit(training)
    0.3
    """
    return max(GAP, MAX_STEPS * sample_dt(recordings))


def time_steps(t: Array, gap_limit: float) -> Array:
    """Time since the row before (n,) [s], 0 where a history starts: first row, and after gaps.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Time stamps [s].
    gap_limit : float
        Time without a sample [s] after which the history starts anew.

    Examples
    --------
    >>> time_steps(np.array([0.0, 0.1, 9.0]), gap_limit=1.0)
    array([0. , 0.1, 0. ])
    """
    steps = np.diff(t, prepend=t[:1])
    return np.where((steps > 0.0) & (steps <= gap_limit), steps, 0.0)


def default_features(robot: Robot, recording: Recording) -> FeatureSet:
    """Measured position and effort of every channel of the robot that the recording has.

    For RAVEN-II these are the 16 inputs of peng2024, II-C: positions and torques of seven joints
    and one unused channel.

    Raises
    ------
    CalibrationError
        If the recording has none of them.

    Examples
    --------
    >>> default_features(test.robot, test).names
    ('measured/jaw', 'effort/jaw')
    """
    names = [
        f"{quantity}/{channel}"
        for quantity in ("measured", "effort")
        for channel in robot.channels
        if f"{quantity}/{channel}" in recording.table.columns
    ]
    if not names:
        raise CalibrationError(
            f"{recording.provenance.source or 'recording'} has no measured or effort column of a "
            f"channel of {robot.title}; name the features to use"
        )
    return FeatureSet.parse(names)


@compiled
def lag(length: int, fresh: bool, value: float, memory: Array) -> float:
    """Value of `length` samples ago; `memory` (length + 1,) is the next slot, then a ring."""
    if fresh:
        memory[0] = 0.0
        for i in range(1, length + 1):
            memory[i] = value
    slot = int(memory[0])
    past = memory[slot + 1]
    memory[slot + 1] = value
    memory[0] = (slot + 1) % length
    return float(past)


@compiled
def lowpass(constant: float, fresh: bool, dt: float, value: float, past: Array) -> float:
    """First-order low-pass, exact for a signal that runs straight between its samples.

    Solves ``constant * dy/dt = u - y`` over `dt` [s] with u going linearly from the last value
    to `value`, so that a recording at 30 Hz and a loop at 1 kHz see nearly the same feature.
    `past` (2,) is the output and the input of the last sample.
    """
    if fresh:
        past[0] = value
    else:
        trail = constant * (value - past[1]) / dt
        past[0] = value - trail + (past[0] - past[1] + trail) * math.exp(-dt / constant)
    past[1] = value
    return float(past[0])


@compiled
def play(half_width: float, fresh: bool, value: float, last: float) -> float:
    """Play (backlash) operator: the output stands still until `value` leaves its dead band.

    `last` is the last output. A fresh start puts the output in the middle of the band.
    """
    output = value if fresh else last
    return min(max(output, value - half_width), value + half_width)


@compiled
def feature_row(
    operation: Integers,
    source: Integers,
    parameter: Array,
    slot: Integers,
    gap_limit: float,
    t: float,
    sample: Array,
    memory: Array,
    clock: Array,
    out: Array,
) -> bool:
    """Features of one sample, into `out` (k,); returns whether their history starts here.

    Each applies its `operation` (`VALUE`, `LAG`, ...) with its `parameter` (samples, time constant
    [s] or half-width) to the signal `source` of the `sample`; its state begins at `slot` of
    `memory`. `clock` (2,) is whether a sample was seen and its stamp [s]; after `gap_limit` [s] all
    starts anew.
    """
    step = t - clock[1]
    fresh = bool(clock[0] == 0.0 or not (step > 0.0 and step <= gap_limit))
    dt = float(step)
    for i in range(unrolled(operation.shape[0])):
        value = sample[source[i]]
        if operation[i] == LAG:
            length = int(parameter[i])
            out[i] = lag(length, fresh, value, vector(memory, slot[i], length + 1))
        elif operation[i] == LOWPASS:
            out[i] = lowpass(parameter[i], fresh, dt, value, vector(memory, slot[i], 2))
        elif operation[i] == RATE:
            trail = lowpass(parameter[i], fresh, dt, value, vector(memory, slot[i], 2))
            out[i] = (value - trail) / parameter[i]
        elif operation[i] == PLAY:
            last = vector(memory, slot[i], 1)
            last[0] = play(parameter[i], fresh, value, last[0])
            out[i] = last[0]
        else:
            out[i] = value
    clock[0] = 1.0
    clock[1] = t
    return fresh


@compiled
def feature_rows(
    program: Program, gap_limit: float, t: Array, samples: Array, memory: Array, out: Array
) -> None:
    """Features `out` (n, k) of `samples` (n, n_signals) at stamps `t` (n,) [s]."""
    clock, (operation, source, parameter, slot) = np.zeros(2), program
    for i in range(t.shape[0]):
        feature_row(
            operation, source, parameter, slot, gap_limit, t[i], samples[i], memory, clock, out[i]
        )
