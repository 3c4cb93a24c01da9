"""Six hours on the digital twin: at rest, at work, and at work under 500 g.

    python -m benchmarks.staleness [--hours 6] [--estimators linear dnn]

Each session begins with the same homing and calibration motions (zig-zags of sparsity 1/4, 1/5 and
1/6), then goes on for six hours as in peng2024, II-G. "Hour 0" is the RMSE over the first hour, as
there. Prints Markdown tables: accuracy by hour, what the monitors say, and when the error has
doubled (RMSE over ten minutes against the first ten).
"""

from __future__ import annotations

import argparse
import math

import numpy as np
from numpy.typing import NDArray

from benchmarks.interval_coverage import record, training_session
from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.crtk import Arm, SimulatedBackend
from truejoint.motion import random_motion
from truejoint.recordings import Recording
from truejoint.runtime import Alarm, Monitor, Reason
from truejoint.simulation.raven2 import Raven2Twin
from truejoint.units import display_unit

Array = NDArray[np.float64]

HOUR = 3600.0
WINDOW = 600.0  # s, for the doubling of the error
LOAD = 0.5  # kg


def calibrated_arm() -> tuple[Arm, Raven2Twin, list[Recording]]:
    """Arm after homing and the calibration motions; the same each time."""
    twin = Raven2Twin(seed=0)
    arm = Arm(SimulatedBackend(twin))
    arm.enable()
    arm.home()
    return arm, twin, training_session(arm, 0)


def work(hours: float, load: float) -> Recording:
    """Random motion without a break."""
    arm, twin, _ = calibrated_arm()
    twin.load = load
    return record(arm, random_motion(arm.robot, hours * HOUR, 7), "h0", rate=10.0)


def rest(hours: float) -> list[Recording]:
    """Idleness with five minutes of motion at the end of every hour."""
    arm, _, _ = calibrated_arm()
    motions = []
    for hour in range(round(hours) + 1):
        motions.append(record(arm, random_motion(arm.robot, 300.0, 50 + hour), "h0", rate=10.0))
        if hour < round(hours):
            arm.disable()
            arm.wait(HOUR - 300.0)
            arm.enable()
    return motions


def errors(calibration: Calibration, recording: Recording) -> tuple[Array, Array, Array]:
    """Time since the start, corrected positions, and errors of the rows with truth."""
    corrected = calibration.correct(recording)
    error = recording.columns("truth", calibration.joints) - corrected
    known = np.isfinite(error).all(axis=1)
    return (recording.t - recording.t[0])[known], corrected[known], error[known]


def rms_between(t: Array, error: Array, start: float, end: float) -> Array:
    """RMSE of a stretch of time, per joint."""
    return np.asarray(np.sqrt(np.mean(error[(t >= start) & (t < end)] ** 2, axis=0)))


def doubling_time(t: Array, error: Array, first: Array) -> float:
    """End of the first window in which a joint's RMSE is above twice `first`; NaN if none is."""
    for end in np.arange(WINDOW, t[-1] + 1.0, WINDOW / 10):
        if (rms_between(t, error, end - WINDOW, end) > 2.0 * first).any():
            return float(end)
    return math.nan


def shown(calibration: Calibration, values: Array) -> str:
    """Lengths of all joints for a person."""
    units = [display_unit(calibration.units[f"measured/{j}"]) for j in calibration.joints]
    return " / ".join(f"{v * u.scale:.3f}" for v, u in zip(values, units, strict=True))


def minutes(seconds: float) -> str:
    """Time for a person."""
    return "never" if math.isnan(seconds) else f"{seconds / 60:.1f} min"


def by_hour(calibration: Calibration, name: str, t: Array, error: Array, hours: int) -> None:
    """Print RMSE in the first and the last hour, and over all."""
    first, last = rms_between(t, error, 0.0, HOUR), rms_between(t, error, t[-1] - HOUR, t[-1])
    overall = rms_between(t, error, 0.0, hours * HOUR + 1.0)
    cells = " | ".join(shown(calibration, value) for value in (first, last, overall))
    print(f"| {calibration.estimator} | {name} | {cells} |", flush=True)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=int, default=6)
    parser.add_argument("--estimators", nargs="+", default=["linear", "dnn"])
    options = parser.parse_args()
    training = calibrated_arm()[2]
    unloaded, loaded = work(options.hours, 0.0), work(options.hours, LOAD)
    idle = rest(options.hours)
    models = [calibrate(training, name, random_state=0) for name in options.estimators]
    print("RMSE, shoulder [deg] / elbow [deg] / insertion [mm]\n")
    print("| estimator | session | hour 0 | last hour | all |\n|---|---|---|---|---|")
    for model in models:
        for name, recording in (("unloaded", unloaded), ("500 g", loaded)):
            t, _, error = errors(model, recording)
            by_hour(model, name, t, error, options.hours)
    print_alarms(models, unloaded, loaded, idle)


def print_alarms(
    models: list[Calibration], unloaded: Recording, loaded: Recording, idle: list[Recording]
) -> None:
    """Print what the monitors said, and when the error had doubled."""
    monitor = Monitor(models[0])
    print(f"\nEfforts watched: {', '.join(monitor.watched)}\n")
    print(
        "| session | highest shift, friction, range (alarm at 1, 1, 0.1) | effort alarm after "
        "| work alarm after | error doubled against its start | against unloaded |"
    )
    print("|---|---|---|---|---|---|")
    for name, recording in (("unloaded", unloaded), ("500 g", loaded)):
        trace = monitor.run(recording)
        doubled = []
        for reference in (recording, unloaded):
            times = []
            for model in models:
                t, _, error = errors(model, recording)
                first = rms_between(*errors(model, reference)[::2], 0.0, WINDOW)
                times.append(f"{minutes(doubling_time(t, error, first))} ({model.estimator})")
            doubled.append(", ".join(times))
        seen = ", ".join(f"{v:.2f}" for v in trace.measures[:, :3].max(axis=0))
        effort = minutes(trace.first(Alarm.CHECK, Reason.SHIFT | Reason.FRICTION))
        worked = minutes(trace.first(Alarm.CHECK, Reason.WORK))
        print(f"| {name} | {seen} | {effort} | {worked} | {doubled[0]} | {doubled[1]} |")
    monitor.reset()
    highest, alarm = np.zeros(3), Alarm.NONE
    for motion in idle:  # one monitor that runs on, as in a loop
        samples = np.column_stack([motion.column(signal) for signal in models[0].signals])
        for t, sample in zip(motion.t, samples, strict=True):
            alarm = max(alarm, Alarm(monitor.step(t, sample)))
            highest = np.maximum(highest, monitor.measures[:3])
    seen = ", ".join(f"{v:.2f}" for v in highest)
    print(f"| idle | {seen} | highest alarm: {alarm.name.lower()} | | | |")


if __name__ == "__main__":
    main()
