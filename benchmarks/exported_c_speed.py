"""How long one step of the exported C takes, for every estimator, at -O2 on one core.

    python -m benchmarks.exported_c_speed [--compiler gcc] [--precision double]

Fits RAVEN-II calibrations with the 16 inputs of peng2024 to a simulated session (the network for a
few epochs only: its speed does not depend on its weights), exports and compiles them, checks
them against their vectors, and times them on samples of that session. The median is taken over
batches of 64 calls, because reading the clock takes as long as a linear model; the 99th percentile
over single calls, clock included.
"""

from __future__ import annotations

import argparse
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np

from truejoint.crtk import simulated_arm
from truejoint.estimators import Calibration, NeuralNetwork, calibrate
from truejoint.estimators.interval import Interval
from truejoint.motion import follow, zigzag
from truejoint.recordings import Recorder, Recording
from truejoint.runtime.c_source import Precision, table
from truejoint.runtime.export_c import export_c

ESTIMATORS = ("offset", "linear", "poly2", NeuralNetwork(epochs=5))
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
SAMPLES = 512

MAIN = """#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "m.h"
#define BATCHES 3000
#define CALLS 64
static const double stamps[] = {stamps};
static const {real} samples[] = {samples};
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
static m_state state;
static long calls, good;
static {real} position[M_JOINTS], half_width[M_JOINTS];
static void step(void)
{{
    const long row = calls % {rows}, round = calls / {rows};
    good += m_step(&state, stamps[row] + {period} * (double)round, samples + row * M_SIGNALS,
        position, half_width) == M_OK;
    calls++;
}}
int main(void)
{{
    int i, k;
    m_init(&state);
    m_set_homing(&state, 1, M_HOMING_OF_CALIBRATION);
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


def session() -> Recording:
    """Record some minutes of zig-zags of the simulated left arm."""
    arm = simulated_arm("raven2", "left")
    arm.enable()
    arm.home()
    with Recorder(arm, homing_id="0") as recorder:
        follow(arm, zigzag(arm.robot, "J1-J2-J3", 1 / 4))
    return recorder.recording()


def some_interval() -> Interval:
    """Make an interval of no meaning: computing with it takes as long as with any other."""
    widths = np.full((1, 3), 0.01)
    return Interval(np.array([0.9]), widths, widths, widths, 2.0, 0.0, 9, 9)


def build(
    calibration: Calibration, recording: Recording, folder: Path, precision: Precision, cc: str
) -> Path:
    """Export, compile and check a calibration; returns the program that times it."""
    export_c(calibration, folder, prefix="m", precision=precision)
    first = len(recording) // 2
    rows = recording.table.iloc[first : first + SAMPLES]
    stamps = rows["t"].to_numpy()
    text = MAIN.format(
        real=precision,
        stamps=table(stamps, "double"),
        samples=table(rows[list(calibration.signals)].to_numpy(), precision),
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
    recording = session()
    for estimator in ESTIMATORS:
        calibration = replace(calibrate(recording, estimator), interval=some_interval())
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            program = build(calibration, recording, folder, options.precision, options.compiler)
            done = subprocess.run([str(program)], check=True, capture_output=True, text=True)
        print(f"{calibration.estimator:8s} {options.precision}: {done.stdout.strip()}", flush=True)


if __name__ == "__main__":
    main()
