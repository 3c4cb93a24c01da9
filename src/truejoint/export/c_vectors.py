"""Test vectors of an exported calibration: samples, and what `Corrector` makes of them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration.encoding import CalibrationData
from truejoint.errors import ExportError
from truejoint.estimators.family import EstimatorData
from truejoint.runtime.compensator import Compensator
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.fields import HOMING_OF_CALIBRATION, HOMING_UNKNOWN, homing_ids
from truejoint.runtime.limits import Limits

if TYPE_CHECKING:  # whoever fitted it has imported what learns
    from truejoint.calibration import Calibration

NOTHING, SET_HOMING, REZERO, ACKNOWLEDGE = 0, 1, 2, 3
"""What is done before a sample."""

_QUIET: Final = 12  # ordinary samples between two faults
_START: Final = 60  # ordinary samples before the first
_SLOWLY: Final = 6  # signals that go out of range slowly
_SLOW: Final = 28  # samples at too slow a rate
_STANDING: Final = 40  # samples between two times that the joints are to stand still
_FASTEST: Final = 0.3  # Hz
_LONGEST_STANDSTILL: Final = 300  # samples; a model whose limit is beyond goes without that fault


@dataclass(frozen=True, eq=False)
class Vector:
    """One sample and what comes of it."""

    t: float  # time stamp [s]
    sample: Array  # (n_signals,)
    action: int = NOTHING  # or another of the four, before the sample
    is_homed: bool = False  # for `SET_HOMING`
    homing_id: int = HOMING_UNKNOWN
    status: int = 0  # bits of `Status`
    position: Array = field(default_factory=lambda: np.empty(0))  # (n_joints,) [rad or m]
    half_width: Array = field(default_factory=lambda: np.empty(0))
    wanted: Array = field(default_factory=lambda: np.empty(0))  # (n_joints,), of a compensator
    setpoint: Array = field(default_factory=lambda: np.empty(0))  # and what it gives [rad or m]


def make_vectors(
    calibration: Calibration,
    data: CalibrationData[EstimatorData],
    limits: Limits,
    level: float | None,
    range_margin: float,
    dtype: type,
    compensator: Compensator | None = None,
) -> tuple[list[Vector], Array, Array, Array]:
    """Make samples like those of training, with every fault there is a status for, and answers.

    The calibration is given as itself and as plain data, `level` and `range_margin` as `Corrector`
    takes them; samples are numbers of type `dtype`. Gives the vectors, the offset (n_joints,)
    [rad or m] for `REZERO`, and how far positions and half-widths of each joint (n_joints,)
    [rad or m] move when all that the corrector keeps is rounded to `dtype` after every sample, and
    its largest position once more; then how far set-points of the `compensator` do. Raises
    ExportError if fewer than half of the samples are corrected: they would check little.
    """
    span = limits.correction_upper - limits.correction_lower
    offset = (0.1 * span).astype(dtype).astype(float)
    scale = 0.8
    while True:  # smaller motion is more like the middle of the training rows
        stream = [replace(v, sample=v.sample.astype(dtype).astype(float))
                  for v in _stream(data, limits, scale)]  # fmt: skip

        def run(kind: type[Corrector], stream: list[Vector] = stream) -> list[Vector]:
            corrector = kind(calibration, level=level, range_margin=range_margin)
            loop = None if compensator is None else compensator.around(corrector)
            return answer(corrector, calibration.metadata, stream, offset, loop)

        vectors = run(Corrector)
        good = sum(v.status == 0 for v in vectors)
        if 2 * good >= len(vectors):
            break
        scale /= 2
        if scale < 1e-2:
            raise ExportError(
                f"only {good} of {len(vectors)} samples would be corrected, too few to check the "
                "source by; calibrate with more data"
            )
    if dtype is np.float64:
        return vectors, offset, *np.zeros((2, len(offset)))
    pairs = list(zip(vectors, run(_RoundedCorrector, vectors), strict=True))
    moved = [_difference(a, b) for a, b in pairs if a.status == b.status == 0]
    measured = [data.signals.index(f"measured/{joint}") for joint in data.joints]
    bounds = np.abs([limits.signal_lower[measured], limits.signal_upper[measured]]).max(axis=0)
    nowhere = np.full_like(bounds, np.inf)
    rounding = np.finfo(np.float32).eps * bounds
    strayed = np.zeros_like(bounds)
    if compensator is not None:
        strayed = np.max([np.abs(a.setpoint - b.setpoint) for a, b in pairs], axis=0)
    return vectors, offset, np.max(moved or [nowhere], axis=0) + rounding, strayed + rounding


def _difference(a: Vector, b: Vector) -> Array:
    """Difference of positions or, if it is larger, of finite half-widths [rad or m]."""
    known = np.isfinite(a.half_width) & np.isfinite(b.half_width)
    widths = np.subtract(a.half_width, b.half_width, out=np.zeros_like(a.position), where=known)
    return np.maximum(np.abs(a.position - b.position), np.abs(widths))


class _RoundedCorrector(Corrector):
    """Corrector whose memory, but for time stamps, is rounded to float after every sample."""

    __slots__ = ("_kept",)

    def __init__(self, model: Calibration, *, level: float | None, range_margin: float) -> None:
        super().__init__(model, level=level, range_margin=range_margin)
        self._kept = np.ones(len(self._memory), dtype=np.bool_)
        for field_ in self._packed.layout.fields.values():
            if field_.is_time and field_.kind == "scalar":
                self._kept[field_.index] = False
            elif field_.is_time:
                start = int(self._numbers[field_.index])
                self._kept[start : start + self._packed.view(field_.name).size] = False

    def step(self, t: float, sample: Any) -> Any:
        """Correct one sample, with all numbers rounded before and after."""
        self._round()
        status = super().step(t, sample)
        self._round()
        return status

    def _round(self) -> None:
        with np.errstate(over="ignore"):
            self._memory[self._kept] = self._memory[self._kept].astype(np.float32)


def answer(
    corrector: Corrector,
    metadata: Mapping[str, Any],
    stream: list[Vector],
    offset: Array,
    compensator: Compensator | None = None,
) -> list[Vector]:
    """Fill in what a fresh `Corrector`, and a compensator around it, make of a stream.

    What is wanted is where the joints were last; where that is not known, nothing is. Every so many
    samples they are to stand still. Of a stream that was answered before, it is what was then.
    """
    ids = homing_ids(metadata)
    names = {HOMING_UNKNOWN: None, HOMING_OF_CALIBRATION: ids[0] if ids else "of the calibration"}
    answered: list[Vector] = []
    wanted = np.full(len(corrector.joints), np.nan)
    for number, vector in enumerate(stream):
        if vector.action == SET_HOMING:
            name = names.get(vector.homing_id, f"homing {vector.homing_id}")
            corrector.set_homing(vector.is_homed, name)
        elif vector.action == REZERO:
            corrector.rezero(offset)
        elif vector.action == ACKNOWLEDGE:
            corrector.acknowledge()
        told: dict[str, Any] = {}
        if compensator is None:
            status = int(corrector.step(vector.t, vector.sample))
        else:
            if number == 0:
                compensator.start(vector.sample[compensator.measured])
            if vector.wanted.size:
                wanted = vector.wanted
            setpoint = compensator.step(vector.t, vector.sample, wanted).copy()
            status = int(compensator.status)
            told = {"wanted": wanted, "setpoint": setpoint}
            if number % _STANDING > _STANDING // 4:
                wanted = np.where(status, np.nan, corrector.position)
        position, half_width = corrector.position.copy(), corrector.half_width.copy()
        answered.append(
            replace(vector, status=status, position=position, half_width=half_width, **told)
        )
    return answered


def _stream(data: CalibrationData[EstimatorData], limits: Limits, scale: float) -> list[Vector]:
    """Smooth motion about the middle of the training rows, broken by faults, and as much whole."""
    motion = _Motion(data, limits, scale)
    vectors = [replace(motion.next(), action=SET_HOMING, is_homed=True,
                       homing_id=HOMING_OF_CALIBRATION)]  # fmt: skip
    vectors += motion.run(_START)
    for fault in (_faulty_stamps, _faulty_signals, _standstill, _homings):
        for one in fault(motion):
            vectors += one
            vectors += [replace(motion.next(), action=ACKNOWLEDGE), *motion.run(_QUIET)]
    return vectors + motion.run(len(vectors))


class _Motion:
    """Samples of a smooth motion, one after the other."""

    def __init__(self, data: CalibrationData[EstimatorData], limits: Limits, scale: float) -> None:
        training_domain = data.training_domain
        assert training_domain is not None  # noqa: S101  # `limits_of` has refused it
        self.limits, self.parity = limits, data.parity
        if self.parity is not None:
            matrix = self.parity.matrix
            self.redundant = matrix.any(axis=0) & (limits.is_position_signal == 0)
            self.fitting = np.linalg.pinv(matrix[:, self.redundant])
        self.lower, self.upper = training_domain.signal_lower, training_domain.signal_upper
        self.middle = (self.lower + self.upper) / 2
        for feature, mean in zip(data.feature_set.features, limits.domain_mean, strict=True):
            if feature.operation == "value":
                self.middle[data.signals.index(feature.signal)] = mean
        room = np.minimum(self.middle - self.lower, self.upper - self.middle)
        self.amplitude = scale * room * (limits.moves > 0)
        reach = np.where(limits.moves > 0, training_domain.signal_step, 1.0) / limits.training_dt
        fastest = np.full(len(room), 2 * np.pi * _FASTEST)
        fastest *= 1 + 0.1 * np.arange(len(room)) / len(room)
        some = self.amplitude > 0
        fastest[some] = np.minimum(fastest[some], reach[some] / self.amplitude[some])
        self.speed = fastest
        self.t = 10.0
        self.count = 0

    def next(self, steps: float = 1.0) -> Vector:
        """Sample after a number of training time steps."""
        self.count += 1
        jitter = 1.0 + 0.1 * np.sin(self.count)
        self.t += steps * jitter * self.limits.training_dt
        phase = self.speed * self.t + np.arange(len(self.speed))
        return Vector(self.t, self.agreeing(self.middle + self.amplitude * np.sin(phase)))

    def agreeing(self, sample: Array) -> Array:
        """Sample with what is redundant to the measured positions changed so that it fits them."""
        if self.parity is None:
            return sample
        wrong = self.parity.matrix @ sample + self.parity.intercept
        agreeing = sample.copy()
        agreeing[self.redundant] -= self.fitting @ wrong
        return agreeing

    def run(self, n: int) -> list[Vector]:
        """Ordinary samples."""
        return [self.next() for _ in range(n)]

    def with_signal(self, index: int, value: float) -> Vector:
        """Ordinary sample but for one signal."""
        vector = self.next()
        vector.sample[index] = value
        return vector


def _faulty_stamps(motion: _Motion) -> Iterator[list[Vector]]:
    """Numbers not finite; stale stamps; too slow for a model; a gap; a clock that was set back."""
    n = len(motion.middle)
    yield [
        motion.with_signal(0, np.nan), motion.with_signal(n - 1, np.inf),
        motion.with_signal(n // 2, -np.inf), replace(motion.next(), t=np.nan),
        replace(motion.next(), t=np.inf),
    ]  # fmt: skip
    first, second = motion.next(), motion.next()
    yield [first, first, second, replace(motion.next(), t=first.t)]
    bridged, dt = motion.limits.longest, motion.limits.training_dt
    if np.isfinite(motion.limits.slowest):
        yield [motion.next(1.5 * motion.limits.slowest / dt) for _ in range(_SLOW)]
    yield [motion.next(3 * bridged / dt)]
    yield [motion.next(-5 * bridged / dt)]


def _faulty_signals(motion: _Motion) -> Iterator[list[Vector]]:
    """Of moving signals in turn: a spike; far out of range both ways; slowly out of it and back."""
    moving, span = np.flatnonzero(motion.limits.moves), motion.upper - motion.lower
    sides = (motion.upper, span), (motion.lower, -span)
    spikes = []
    for i in moving:
        vector, jump = motion.next(), 1.2 * motion.limits.reach[i]
        vector.sample[i] += jump if vector.sample[i] < motion.middle[i] else -jump
        spikes += [vector, motion.next()]
    yield spikes
    yield [motion.with_signal(int(i), at[i] + 1.1 * out[i]) for i in moving for at, out in sides]
    for at, out in sides:
        slowly = []
        for i in moving[:_SLOWLY]:
            way = at[i] + 0.3 * out[i] - motion.middle[i]
            for share in (*range(1, 9), *range(8, 0, -1)):
                vector = motion.next()
                vector.sample[i] += way * share / 8
                slowly.append(replace(vector, sample=motion.agreeing(vector.sample)))
        yield slowly


def _standstill(motion: _Motion) -> Iterator[list[Vector]]:
    """Hold a signal, but for its noise, while its partner moves, then all of them for long."""
    held, partner = motion.next(), np.flatnonzero(np.isfinite(motion.limits.travel))[:1]
    noise = 0.9 * motion.limits.flicker
    yield [held] + [
        motion.with_signal(i, held.sample[i] + n % 2 * noise[i])
        for i in partner
        for n in range(100)
    ]
    held, share = motion.next(), 0.5 * motion.limits.longest
    held_for = motion.limits.hold / share + 3.0
    n = int(held_for) if held_for <= _LONGEST_STANDSTILL else 0
    steps = share / motion.limits.training_dt
    yield [held, *(replace(motion.next(steps), sample=held.sample) for _ in range(n))]


def _homings(motion: _Motion) -> Iterator[list[Vector]]:
    """Not homed; homed again, unknown which; re-zeroed; another homing; that of the calibration."""
    actions = [
        (SET_HOMING, False, HOMING_UNKNOWN), (SET_HOMING, True, HOMING_UNKNOWN),
        (REZERO, False, HOMING_UNKNOWN), (SET_HOMING, True, 7), (REZERO, False, HOMING_UNKNOWN),
        (SET_HOMING, True, 7), (SET_HOMING, False, HOMING_UNKNOWN), (SET_HOMING, True, 7),
        (SET_HOMING, True, 8),
        (SET_HOMING, True, HOMING_OF_CALIBRATION),
    ]  # fmt: skip
    out = []
    for action, is_homed, homing_id in actions:
        first = replace(motion.next(), action=action, is_homed=is_homed, homing_id=homing_id)
        out += [first, *motion.run(3)]
    yield out
