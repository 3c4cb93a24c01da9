"""How long one step of the exported C takes, for every estimator, at -O2 on one core.

    python -m benchmarks.exported_c_speed [--compiler gcc] [--precision double]

Fits RAVEN-II calibrations with the 16 inputs of peng2024 to a simulated session (the network for a
few epochs only: its speed does not depend on its weights), exports and compiles them, checks
them against their vectors, and times them on samples of that session. The median is taken over
batches of 64 calls, because reading the clock takes as long as a linear model; the 99th percentile
over single calls, clock included.

The estimators that remember are fitted to a virtual forceps, that of an instrument's cables to a
virtual wrist. The filter of yan2020, with 4 states and 2 measurements, is timed without the checks
too, beside the same filter called from Python. `benchmarks.filter_speed` times a linear model of
that size beside other packages.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from truejoint.calibration import Calibration, calibrate
from truejoint.calibration.interval import Interval
from truejoint.crtk import simulated_arm
from truejoint.estimators import NeuralNetwork
from truejoint.estimators.jaw.learn import JawFilter
from truejoint.estimators.jaw.run import ForcepsModel, jaw_filter
from truejoint.estimators.jaw.signals import MOTOR, RESET
from truejoint.export.c_source import Precision, table
from truejoint.export.export_c import export_c
from truejoint.motion import follow, zigzag
from truejoint.motion.forceps_trajectories import calibration_trajectory
from truejoint.recordings import Recorder, Recording
from truejoint.simulation.forceps.specimens import specimen
from truejoint.simulation.wrist.twin import WristTwin
from truejoint.studies.forceps.record_forceps import record_forceps
from truejoint.studies.wrist import motions

ESTIMATORS = ("offset", "linear", "poly2", NeuralNetwork(epochs=5))
JAW_ESTIMATORS = ("play_reset", "play_gated", "ukf", "ukf_compensated", "ukf_friction")
WRIST_ESTIMATORS = ("ukf_cables",)
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
SAMPLES = 512

TIMING = """#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "{source}"
#define BATCHES 3000
#define CALLS 64
static double taken[BATCHES * CALLS];
static double now(void)
{{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1e6 * (double)t.tv_sec + 1e-3 * (double)t.tv_nsec;
}}
static int compare(const void *a, const void *b)
{{
    const double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}}
"""
MAIN = (
    TIMING
    + """static const double stamps[] = {stamps};
static const {real} samples[] = {samples};
static m_state state;
static long calls, good;
static {real} position[M_JOINTS], half_width[M_JOINTS];
static void step(void)
{{
    const long row = calls % {rows}, round = calls / {rows};
    if (row == 0) {{  /* a recording that begins anew jumps, which makes a zero suspect */
        m_init(&state);
        m_set_homing(&state, 1, M_HOMING_OF_CALIBRATION);
    }}
    good += m_step(&state, stamps[row] + {period} * (double)round, samples + row * M_SIGNALS,
        position, half_width) == M_OK;
    calls++;
}}
int main(void)
{{
    int i, k;
    for (i = 0; i < BATCHES; i++) {{
        const double start = now();
        for (k = 0; k < CALLS; k++) step();
        taken[i] = (now() - start) / CALLS;
    }}
    qsort(taken, BATCHES, sizeof taken[0], compare);
    printf("median %.3f us, ", taken[BATCHES / 2]);
    for (i = 0; i < BATCHES * CALLS; i++) {{
        const double start = now();
        step();
        taken[i] = now() - start;
    }}
    qsort(taken, BATCHES * CALLS, sizeof taken[0], compare);
    printf("p99 %.3f us, p99.9 %.3f us; %.1f %% of the samples corrected\\n",
        taken[BATCHES * CALLS / 100 * 99], taken[BATCHES * CALLS / 1000 * 999],
        100.0 * (double)good / (double)calls);
    return 0;
}}
"""
)
FILTER_MAIN = (
    TIMING
    + """static const double rows[][4] = {{
{rows}
}};
static m_state state;
int main(void)
{{
    long calls = 0;
    int i, k, status = 0;
    m_init(&state);
    for (i = 0; i < BATCHES; i++) {{
        const double start = now();
        for (k = 0; k < CALLS; k++) {{
            const double *row = rows[calls++ % {count}];
            m_model_filter_state *filter = &state.model.filter;
            filter->z[0] = row[0];
            filter->z[1] = row[1];
            filter->u[0] = row[2];
            filter->dt = {dt};
            status |= step(filter);
        }}
        taken[i] = (now() - start) / CALLS;
    }}
    qsort(taken, BATCHES, sizeof taken[0], compare);
    printf("median %.3f us, status bits %d\\n", taken[BATCHES / 2], status);
    return 0;
}}
"""
)


def session() -> Recording:
    """Record some minutes of zig-zags of the simulated left arm."""
    arm = simulated_arm("raven2", "left")
    arm.enable()
    arm.home()
    with Recorder(arm, homing_id="0") as recorder:
        follow(arm, zigzag(arm.robot, "J1-J2-J3", 1 / 4))
    return recorder.recording()


def some_interval(n_joints: int) -> Interval:
    """Make an interval of no meaning: computing with it takes as long as with any other."""
    widths = np.full((1, n_joints), 0.01)
    return Interval(np.array([0.9]), widths, widths, widths, 2.0, 0.0, 9, 9)


def forceps_session() -> Recording:
    """Record the calibration motion of yan2020 on a virtual forceps."""
    angles = calibration_trajectory().positions[:, 0]
    return record_forceps(specimen("B"), angles, seed=0)


def wrist_sessions() -> list[Recording]:
    """Record half a minute of a virtual wrist, free and under loads."""
    twin = WristTwin(seed=1)
    twin.home()
    return [motions.record(twin, motions.paused_sines, 30.0, 1, load) for load in (False, True)]


def filter_step(model: JawFilter, recording: Recording, folder: Path, cc: str) -> str:
    """Time the filter's step alone, in C (exported into `folder`) and from Python."""
    rows = slice(2000, 2000 + SAMPLES)
    dt = float(np.median(np.diff(recording.t)))
    motor, reset = (recording.column(name)[rows] for name in (MOTOR, RESET))
    z = np.column_stack([reset, np.gradient(reset, dt)])
    u = motor[:, None]
    lines = [f"{{ {', '.join(map(float.hex, row))} }}," for row in np.hstack([z, u])]
    text = FILTER_MAIN.format(source="m.c", rows="\n".join(lines), count=SAMPLES, dt=dt)
    (folder / "filter.c").write_text(text, encoding="ascii")
    command = [cc, *FLAGS, str(folder / "filter.c"), "-lm", "-o", str(folder / "filter")]
    subprocess.run(command, check=True)
    done = subprocess.run([str(folder / "filter")], check=True, capture_output=True, text=True)
    estimator = jaw_filter(model.model_params())
    forceps_model = ForcepsModel.from_params(model.model_params())
    prior = {"x0": np.zeros(4), "P0": forceps_model.rest_covariance()}
    state = estimator.initial_state(**prior)
    laps, records = [], []
    for k in range(40 * SAMPLES):
        start = time.perf_counter_ns()
        estimator.step(state, z[k % SAMPLES], u[k % SAMPLES], dt)
        laps.append(time.perf_counter_ns() - start)
    for _ in range(40):
        start = time.perf_counter_ns()
        estimator.run(np.tile(z, (8, 1)), np.tile(u, (8, 1)), **prior, dt=dt)
        records.append((time.perf_counter_ns() - start) / (8 * SAMPLES))
    step, record = 1e-3 * np.median(laps), 1e-3 * np.median(records)
    return (
        f"4 states, 2 measurements, step alone: C {done.stdout.strip()}; "
        f"from Python {step:.2f} us, in a whole record {record:.2f} us"
    )


def build(
    calibration: Calibration, recording: Recording, folder: Path, precision: Precision, cc: str
) -> Path:
    """Export, compile and check a calibration; returns the program that times it."""
    export_c(calibration, folder, prefix="m", precision=precision)
    first = len(recording) // 2
    rows = recording.table.iloc[first : first + SAMPLES]
    stamps = rows["t"].to_numpy()
    text = MAIN.format(
        source="m.h",
        real=precision,
        stamps=table(stamps, "double"),
        samples=table(rows[list(calibration.loop_signals)].to_numpy(), precision),
        rows=SAMPLES,
        period=float(stamps[-1] - stamps[0] + np.median(np.diff(stamps))),
    )
    (folder / "time.c").write_text(text, encoding="ascii")
    for name in ("m_check", "time"):
        sources = [str(folder / f"{source}.c") for source in ("m", name)]
        subprocess.run([cc, *FLAGS, *sources, "-lm", "-o", str(folder / name)], check=True)
    subprocess.run([str(folder / "m_check")], check=True, stdout=subprocess.DEVNULL)
    return folder / "time"


def main() -> None:
    """Print a line for each estimator."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--compiler", default="gcc")
    parser.add_argument("--precision", default="double", choices=["double", "float"])
    options = parser.parse_args()
    sessions = [
        (ESTIMATORS, [session()]),
        (JAW_ESTIMATORS, [forceps_session()]),
        (WRIST_ESTIMATORS, wrist_sessions()),
    ]
    for estimators, recordings in sessions:
        recording = recordings[-1]
        for estimator in estimators:
            calibration = calibrate(recordings, estimator)
            calibration = replace(calibration, interval=some_interval(len(calibration.joints)))
            with tempfile.TemporaryDirectory() as name:
                folder = Path(name)
                program = build(calibration, recording, folder, options.precision, options.compiler)
                done = subprocess.run([str(program)], check=True, capture_output=True, text=True)
                print(
                    f"{calibration.estimator:15s} {options.precision}: {done.stdout.strip()}",
                    flush=True,
                )
                if calibration.estimator == "ukf" and options.precision == "double":
                    print(filter_step(calibration.model, recording, folder, options.compiler))


if __name__ == "__main__":
    main()
