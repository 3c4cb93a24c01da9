"""A simulated joint sensor stream at any rate, and a calibration trained on it at 30 Hz."""

import tracemalloc
from collections.abc import Callable, Iterable, Sequence
from functools import cache
from typing import Any

import numpy as np

from truejoint.calibration import Calibration, calibrate
from truejoint.estimators import JointRegressor
from truejoint.recordings import Provenance, Recording
from truejoint.runtime import Corrector

MINUTE = np.arange(0.0, 60.0, 1 / 30)
RATE = 1000
T = np.arange(0.0, 8.0, 1 / RATE)
"""Stamps of a loop [s]."""
JOINTS = ("shoulder", "elbow")
SIGNALS = ("measured/shoulder", "effort/shoulder", "measured/elbow", "effort/elbow")
EFFORTS = ("effort/shoulder", "effort/elbow", "effort/unused")
HISTORY = (
    *SIGNALS, "lag(effort/elbow, 3)", "rate(measured/shoulder, 0.05)",
    "lowpass(effort/elbow, 0.05)", "play(measured/elbow, 0.03)",
)  # fmt: skip
FEATURES = tuple(feature for feature in HISTORY if "lag" not in feature)
"""Every operation but the one that counts samples, which needs the rate of training."""
MEASURED = [0, 2]
"""Signals that are measured positions."""


def stream(t: np.ndarray, seed: int = 0) -> np.ndarray:
    """Signals (n, 4) at stamps: smooth positions, and efforts that follow them but for noise."""
    noise = np.random.default_rng(seed).uniform(-0.02, 0.02, (len(t), 2))
    positions = 0.5 + 0.2 * np.sin(np.outer(t, [0.9, 1.3]) + np.array([0.0, 1.0]))
    efforts = 0.4 * np.cos(positions * 3.0) + noise
    return np.column_stack([positions[:, 0], efforts[:, 0], positions[:, 1], efforts[:, 1]])


def recording(t: np.ndarray, seed: int = 0, homing_id: str = "h1") -> Recording:
    """Recording of the stream with truth: off by an offset, a slope and some effort."""
    signals = stream(t, seed)
    columns = {"t": t} | dict(zip(SIGNALS, signals.T, strict=True))
    columns["effort/unused"] = np.zeros(len(t))
    for i, joint in enumerate(JOINTS):
        q, effort = signals[:, 2 * i], signals[:, 2 * i + 1]
        columns[f"truth/{joint}"] = q + 0.02 + 0.05 * (q - 0.5) - 0.01 * effort
    origin = Provenance("raven2", arm="left", source="stream", homing_id=homing_id)
    return Recording.from_columns(columns, origin, dict.fromkeys(EFFORTS, "Nm"))


def trained(
    estimator: str | JointRegressor = "linear",
    features: tuple[str, ...] = SIGNALS,
    target: str = "error",
    homing_id: str = "h1",
    recordings: Sequence[Recording] | None = None,
    zero: str = "shared",
) -> Calibration:
    """Calibration of a minute at 30 Hz, unless of other `recordings`."""
    return calibrate(
        recordings or recording(MINUTE, homing_id=homing_id), estimator,
        features=features, joints=JOINTS, target=target, zero=zero,
    )  # fmt: skip


@cache
def remembering() -> Calibration:
    """Calibration whose features remember, and count no samples."""
    return trained(features=FEATURES)


def faulty(t, samples, seed: int, kinds=range(8)):
    """Stamps (n,) and samples (n, n_signals) with faults here and there, of `kinds`."""
    rng = np.random.default_rng(seed)
    t, samples, n = np.array(t), np.array(samples), len(t)
    period, span = float(np.median(np.diff(t))), np.ptp(samples, axis=0)
    for row in rng.choice(np.arange(20, n - 20), n // 40, replace=False):
        kind, column = rng.choice(kinds), rng.integers(samples.shape[1])
        if kind == 0:
            samples[row : row + rng.integers(1, 5), column] = rng.choice([np.nan, np.inf, -np.inf])
        elif kind == 1:
            t[row] = rng.choice([np.nan, t[row - 1], t[row - 3]])
        elif kind == 2:
            t[row:] += period * rng.uniform(2.0, 90.0)
        elif kind == 3:
            t[row:] -= period * rng.uniform(2.0, 90.0)
        elif kind == 4:
            samples[row, column] += rng.normal(0, 0.5) * span[column]
        elif kind == 5:
            samples[row : row + 15, column] = samples[row, column]
        elif kind == 6:
            samples[row : row + 15] = samples[row]
        else:
            samples[row : row + 10, column] += 0.05 * span[column] * np.arange(10)
    return t, samples


FAULT = 1500
"""Row at which a fault of `changed` begins."""


def changed(where: Any, change: Callable[[Any], Any], rows: int | None = None):
    """What puts a fault into stamps and samples: so many rows of ``"t"``, or of some signals."""

    def put(t: np.ndarray, samples: np.ndarray) -> None:
        span = slice(FAULT, None if rows is None else FAULT + rows)
        array, place = (t, span) if where == "t" else (samples, (span, where))
        array[place] = change(array[place])

    return put


def ready(model: Any, **options: Any) -> Corrector:
    """Corrector (also of a file) of a robot that is homed as in training."""
    corrector = Corrector(model, **options)
    corrector.set_homing(True)
    return corrector


def run(corrector, t, samples, before: Callable[[int], object] = bool):
    """Status bits (n,), positions, half-widths and corrections (n, n_joints) of a stream.

    `before` is called with the number of each row.
    """
    status = np.empty(len(t), dtype=np.int32)
    outputs = np.empty((3, len(t), len(corrector.joints)))
    for row in range(len(t)):
        before(row)
        status[row] = int(corrector.step(float(t[row]), samples[row]))
        outputs[:, row] = corrector.position, corrector.half_width, corrector.correction
    return status, *outputs


def least_memory(passes: Iterable[Callable[[], object]]) -> tuple[int, int]:
    """Memory [bytes] that one of several passes takes meanwhile, and keeps: the least of all.

    Other threads of the process allocate too.
    """
    used = []
    tracemalloc.start()
    try:
        for one in passes:
            before = tracemalloc.get_traced_memory()[0]
            tracemalloc.reset_peak()
            one()
            used.append([now - before for now in tracemalloc.get_traced_memory()])
    finally:
        tracemalloc.stop()
    kept, peaks = zip(*used, strict=True)
    return min(peaks), min(kept)


class OneByOne:
    """A fitted estimator's row in the loop, with what it remembers and its own half-widths."""

    def __init__(self, model: JointRegressor, deviations: float | None = None) -> None:
        self.memory, n = model.memory(), model.n_outputs_
        self.out, self.half_width, self._row = np.empty(n), np.full(n, np.inf), model.family.row
        if deviations is not None:
            self.memory.memory[self.memory.layout.fields["deviations"].index] = deviations

    def step(self, dt: float, row: np.ndarray) -> np.ndarray:
        memory = self.memory
        self._row(memory.numbers, memory.memory, dt, row, self.out, self.half_width)
        return self.out.copy()


def stepped(
    model: JointRegressor, X: np.ndarray, dt: np.ndarray, deviations: float | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Predict one row after the other: outputs (n, n_outputs), and half-widths of its own."""
    loop = OneByOne(model, deviations)
    rows = [(loop.step(dt[i], X[i]), loop.half_width.copy()) for i in range(len(X))]
    outputs, widths = zip(*rows, strict=True)
    return np.array(outputs), np.array(widths)
