"""Test vectors of an exported calibration: samples, and what `Corrector` makes of them."""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.errors import ExportError
from truejoint.runtime.compensator import Compensator
from truejoint.runtime.correction import MANY_LATE, SET_BACK, tell_homing
from truejoint.runtime.corrector import Corrector
from truejoint.runtime.fields import (
    HOMING_OF_CALIBRATION,
    HOMING_UNKNOWN,
    IS_HOMED,
    TOLD_ID,
    OnFault,
    Reaction,
)
from truejoint.runtime.limits import Limits

NOTHING, SET_HOMING, REZERO, ACKNOWLEDGE = 0, 1, 2, 3
"""What is done before a sample."""

_QUIET: Final = 12  # ordinary samples between two faults
_START: Final = 60  # ordinary samples before the first
_SLOWLY: Final = 6  # signals that go out of range slowly
_SLOW: Final = 28  # samples at too slow a rate
_TRAVEL: Final = 80  # samples in which the joints go by their range and more
_STANDING: Final = 40  # samples between two times that the joints are to stand still
_FASTEST: Final = 0.3  # Hz
_LONGEST_STANDSTILL: Final = 300  # samples; a model whose limit is beyond goes without that fault


@dataclass(frozen=True, eq=False)
class Vectors:
    """Samples in the order of time."""

    t: Array  # (n,) time stamps [s]
    sample: Array  # (n, n_signals)
    action: Integers  # (n,) one of the four, before the sample
    is_homed: Integers  # (n,) and
    homing_id: Integers  # (n,) for `SET_HOMING`

    def __len__(self) -> int:
        return len(self.t)


@dataclass(frozen=True, eq=False)
class Answers:
    """What comes of vectors."""

    status: Integers  # (n,) bits of `Status`
    unlearnt: Integers  # (n,) bits of `Unlearnt`
    position: Array  # (n, n_joints) [rad or m]
    half_width: Array  # (n, n_joints) [rad or m]
    desired: Array  # (n, n_joints), of a compensator: where the joints are to be
    setpoint: Array  # (n, n_joints) and what it gives [rad or m]


def make_vectors(
    calibration: Calibration,
    limits: Limits,
    level: float | None,
    range_margin: float,
    on_fault: OnFault | Reaction,
    dtype: type,
    compensator: Compensator | None = None,
) -> tuple[Vectors, Answers, Array, Array, Array]:
    """Make samples like those of training, with every fault there is a status for, and answers.

    `level`, `range_margin` and `on_fault` are as `Corrector` takes them; samples are of `dtype`.
    Gives the vectors, the answers, the offset (n_joints,) [rad or m] for `REZERO`, and how far
    positions and half-widths of each joint (n_joints,) [rad or m] move when all that the corrector
    keeps is rounded to `dtype` after every sample, and its largest position once more; then how far
    set-points of the `compensator` do. Raises ExportError if fewer than half are corrected.
    """
    span = limits.correction_upper - limits.correction_lower
    offset = (0.1 * span).astype(dtype).astype(float)

    def run(kind: type[Corrector], desired: Array | None = None) -> Answers:
        corrector = kind(calibration, level=level, range_margin=range_margin, on_fault=on_fault)
        loop = None if compensator is None else compensator.around(corrector)
        return _answer(corrector, vectors, offset, loop, desired)

    for halvings in range(7):  # smaller motion is more like the middle of the training rows
        vectors = _vectors(calibration, limits, 0.8 / 2**halvings)
        vectors = replace(vectors, sample=vectors.sample.astype(dtype).astype(float))
        answers = run(Corrector)
        good = int((answers.status == 0).sum())
        if 2 * good >= len(vectors):
            break
    else:
        raise ExportError(
            f"only {good} of {len(vectors)} samples would be corrected, too few to check the "
            "source by; calibrate with more data"
        )
    if dtype is np.float64:
        return vectors, answers, offset, *np.zeros((2, len(offset)))
    rounded = run(_RoundedCorrector, answers.desired)
    rows = (answers.status == 0) & (rounded.status == 0)
    widths = np.stack([answers.half_width, rounded.half_width])[:, rows]
    widths[:, ~np.isfinite(widths).all(axis=0)] = 0.0
    moved = np.maximum(
        np.abs(answers.position[rows] - rounded.position[rows]), np.abs(widths[0] - widths[1])
    )
    measured = [calibration.signals.index(f"measured/{joint}") for joint in calibration.joints]
    bounds = np.abs([limits.signal_lower[measured], limits.signal_upper[measured]]).max(axis=0)
    rounding = np.finfo(np.float32).eps * bounds
    error = moved.max(axis=0) if len(moved) else np.full_like(bounds, np.inf)
    strayed = np.zeros_like(bounds)
    if compensator is not None:
        strayed = np.abs(answers.setpoint - rounded.setpoint).max(axis=0)
    return vectors, answers, offset, error + rounding, strayed + rounding


class _RoundedCorrector(Corrector):
    """Corrector whose memory, but for time stamps, is rounded to float after every sample."""

    __slots__ = ("_rounded",)

    def __init__(self, model: Calibration, **options: Any) -> None:
        super().__init__(model, **options)
        self._rounded = np.ones(len(self._memory), dtype=np.bool_)
        for f in self._packed.layout.fields.values():
            if f.is_time and f.kind == "scalar":
                self._rounded[f.index] = False
            elif f.is_time:
                start = int(self._numbers[f.index])
                self._rounded[start : start + self._packed.view(f.name).size] = False

    def step(self, t: float, sample: Any) -> Any:
        """Correct one sample, with all numbers rounded before and after."""
        self._round()
        status = super().step(t, sample)
        self._round()
        return status

    def _round(self) -> None:
        with np.errstate(over="ignore"):
            self._memory[self._rounded] = self._memory[self._rounded].astype(np.float32)


def _answer(
    corrector: Corrector,
    vectors: Vectors,
    offset: Array,
    compensator: Compensator | None,
    desired: Array | None,
) -> Answers:
    """Give what a fresh `Corrector`, and a compensator around it, make of vectors.

    The joints are to be where they were last, if that is known, and stand still now and then;
    with `desired` (n, n_joints) [rad or m] they are to be there.
    """
    n, m = len(vectors), len(corrector.joints)
    loop = np.empty((2, n, m if compensator else 0))
    answers = Answers(*np.empty((2, n), np.int64), *np.full((2, n, m), np.nan), *loop)
    target = np.full(m, np.nan)
    for i, (t, sample) in enumerate(zip(vectors.t.tolist(), vectors.sample, strict=True)):
        _act(corrector, vectors, i, offset)
        if compensator is None:
            answers.status[i] = corrector.step(t, sample)
        else:
            if i == 0:
                compensator.start(sample[compensator.measured])
            answers.desired[i] = target if desired is None else desired[i]
            answers.setpoint[i] = compensator.step(t, sample, answers.desired[i])
            status = answers.status[i] = int(compensator.status)
            if i % _STANDING > _STANDING // 4:
                target = np.where(status, np.nan, corrector.position)
        answers.unlearnt[i] = corrector.unlearnt
        answers.position[i], answers.half_width[i] = corrector.position, corrector.half_width
    return answers


def _act(corrector: Corrector, vectors: Vectors, i: int, offset: Array) -> None:
    """Do what comes before sample `i`."""
    action, numbers = vectors.action[i], corrector._numbers
    if action == SET_HOMING:  # by number, as in C
        numbers[IS_HOMED], numbers[TOLD_ID] = vectors.is_homed[i], vectors.homing_id[i]
        tell_homing(numbers, corrector._memory)
    elif action == REZERO:
        corrector.rezero(offset)
    elif action == ACKNOWLEDGE:
        corrector.acknowledge()


def _vectors(data: Calibration, limits: Limits, scale: float) -> Vectors:
    """Smooth motion about the middle of the training rows, broken by faults, and as much whole."""
    motion = _Motion(data, limits, scale)
    motion.run(1, SET_HOMING, is_homed=True, homing_id=HOMING_OF_CALIBRATION)
    motion.run(_START)
    for fault in (_unlearnt_motion, _faulty_stamps, _faulty_signals, _standstill, _homings):
        for _ in fault(motion):
            motion.run(1, ACKNOWLEDGE)
            motion.run(_QUIET)
    motion.run(sum(map(len, motion.parts)))
    columns = ([getattr(part, f.name) for part in motion.parts] for f in fields(Vectors))
    return Vectors(*map(np.concatenate, columns))


class _Motion:
    """Samples of a smooth motion, part by part, which a fault then changes."""

    def __init__(self, data: Calibration, limits: Limits, scale: float) -> None:
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
        self.speed = np.full(len(room), 2 * np.pi * _FASTEST)
        self.speed *= 1 + 0.1 * np.arange(len(room)) / len(room)
        some = self.amplitude > 0
        self.speed[some] = np.minimum(self.speed[some], reach[some] / self.amplitude[some])
        self.t, self.count = 10.0, 0
        self.parts: list[Vectors] = []

    def run(
        self,
        n: int,
        action: int = NOTHING,
        *,
        steps: float = 1.0,
        is_homed: bool = False,
        homing_id: int = HOMING_UNKNOWN,
    ) -> Vectors:
        """Add `n` samples so many training time steps apart, an action before the first."""
        count = self.count + 1 + np.arange(n)
        t = self.t + np.cumsum(steps * (1.0 + 0.1 * np.sin(count)) * self.limits.training_dt)
        if n:
            self.t, self.count = float(t[-1]), int(count[-1])
        phase = np.outer(t, self.speed) + np.arange(len(self.speed))
        sample = self.agreeing(self.middle + self.amplitude * np.sin(phase))
        first = (np.arange(n) == 0).astype(np.int64)
        part = Vectors(t, sample, action * first, is_homed * first, homing_id * first)
        self.parts.append(part)
        return part

    def agreeing(self, samples: Array) -> Array:
        """Change the redundant signals of samples (n, n_signals) so that they fit the positions."""
        if self.parity is not None:
            wrong = samples @ self.parity.matrix.T + self.parity.intercept
            samples[:, self.redundant] -= wrong @ self.fitting.T
        return samples

    def each(self, signals: Integers, values: Array) -> None:
        """Add ordinary samples but for one signal each."""
        part = self.run(len(signals))
        part.sample[np.arange(len(part)), signals] = values


def _unlearnt_motion(motion: _Motion) -> Iterator[None]:
    """Motion as fast as the first, then twice as fast, then slower at as many samples a swing."""
    learnt = motion.speed.copy()
    for factor, steps in ((1.0, 1.0), (2.0, 1.0), (0.25, 4.0)):
        motion.speed = factor * learnt
        motion.run(_TRAVEL, steps=steps)
    motion.speed = learnt
    yield


def _faulty_stamps(motion: _Motion) -> Iterator[None]:
    """Numbers not finite; stale stamps; too slow for a model; a gap; a clock that was set back."""
    n = len(motion.middle)
    motion.each(np.array([0, n - 1, n // 2]), np.array([np.nan, np.inf, -np.inf]))
    motion.run(2).t[:] = np.nan, np.inf
    yield
    part = motion.run(MANY_LATE + 4)
    part.t[1:-2], part.sample[1:-2] = part.t[0], part.sample[0]
    part.t[-2] = part.t[0]
    yield
    bridged, dt = motion.limits.longest, motion.limits.training_dt
    if np.isfinite(motion.limits.slowest):
        motion.run(_SLOW, steps=1.5 * motion.limits.slowest / dt)
        yield
    motion.run(1, steps=3 * bridged / dt)
    yield
    motion.run(1, steps=-max(5 * bridged, 2 * SET_BACK) / dt)
    yield


def _faulty_signals(motion: _Motion) -> Iterator[None]:
    """Of moving signals in turn: a spike; far out of range both ways; slowly out of it and back."""
    moving, span = np.flatnonzero(motion.limits.moves), motion.upper - motion.lower
    part = motion.run(2 * len(moving))
    rows, jump = np.arange(0, len(part), 2), 1.2 * motion.limits.reach[moving]
    below = part.sample[rows, moving] < motion.middle[moving]
    part.sample[rows, moving] += np.where(below, jump, -jump)
    yield
    far = np.stack([motion.upper + 1.1 * span, motion.lower - 1.1 * span], axis=1)
    motion.each(np.repeat(moving, 2), far[moving].ravel())
    yield
    share = np.array([*range(1, 9), *range(8, 0, -1)]) / 8
    for end, out in ((motion.upper, span), (motion.lower, -span)):
        for i in moving[:_SLOWLY]:
            part = motion.run(len(share))
            part.sample[:, i] += (end[i] + 0.3 * out[i] - motion.middle[i]) * share
            motion.agreeing(part.sample)
        yield


def _standstill(motion: _Motion) -> Iterator[None]:
    """Hold a signal, but for its noise, while its partner moves, then all of them for long."""
    first, noise = motion.run(1).sample[0], 0.9 * motion.limits.flicker
    for i in np.flatnonzero(np.isfinite(motion.limits.travel))[:1]:
        motion.each(np.full(100, i), first[i] + np.arange(100) % 2 * noise[i])
    yield
    first, share = motion.run(1).sample[0], 0.5 * motion.limits.longest
    samples = motion.limits.hold / share + 3.0
    n = int(samples) if samples <= _LONGEST_STANDSTILL else 0
    motion.run(n, steps=share / motion.limits.training_dt).sample[:] = first
    yield


def _homings(motion: _Motion) -> Iterator[None]:
    """Not homed; homed again, unknown which; re-zeroed; another homing; that of the calibration."""
    for action, is_homed, homing_id in (
        (SET_HOMING, False, HOMING_UNKNOWN), (SET_HOMING, True, HOMING_UNKNOWN),
        (REZERO, False, HOMING_UNKNOWN), (SET_HOMING, True, 7), (REZERO, False, HOMING_UNKNOWN),
        (SET_HOMING, True, 7), (SET_HOMING, False, HOMING_UNKNOWN), (SET_HOMING, True, 7),
        (SET_HOMING, True, 8), (SET_HOMING, True, HOMING_OF_CALIBRATION),
    ):  # fmt: skip
        motion.run(4, action, is_homed=is_homed, homing_id=homing_id)
    yield
