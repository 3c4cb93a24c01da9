"""Speed of all that runs in a loop or is waited for, each beside a peer in the same run.

    python -m benchmarks.speed [--parts steps filter training twins] [--estimators NAME ...]

steps     A step of every registered estimator, from Python and in the exported C (gcc -O2), of 1,
          3 and 6 joints: checks, features, model and interval [us], the median of the quickest
          tenth of the calls from Python, and of batches of 64 in C. Networks are fitted for two
          epochs: weights do not change the speed. Then scikit-learn with a network of the same
          layers, and the time of a fresh process to its first corrected sample.
filter    A step of the unscented filter of 4 states and 2 measurements (yan2020, 13), in either
          form, and of filterpy's [us].
training  Fits of 30,000 rows of 16 features and 3 joints [s], and of scikit-learn's network.
twins     How many times faster than real time the twins run, against the other twins.

Prints Markdown tables; what is above a bar is bold.
"""

import importlib.util
import statistics
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import cont2discrete
from sklearn.compose import TransformedTargetRegressor
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from tests.filters.linear import linear_model

from benchmarks import head, parsed, row
from benchmarks.loop import HOMING, Samples, simulated_session
from truejoint.array_types import Array
from truejoint.calibration import Calibration, calibrate, write_calibration
from truejoint.calibration.interval import Interval
from truejoint.errors import TruejointError
from truejoint.estimators import (
    JointRegressor,
    NeuralNetwork,
    Polynomial,
    estimator_names,
    get_estimator,
)
from truejoint.export.export_c import export_c, table
from truejoint.filters import UnscentedFilter
from truejoint.filters.state_space import StateSpaceModel
from truejoint.motion.forceps_trajectories import calibration_trajectory
from truejoint.recordings import Provenance, Recording
from truejoint.robots import get_robot
from truejoint.runtime import Corrector, Status
from truejoint.simulation import make_twin
from truejoint.simulation.forceps.specimens import specimen
from truejoint.studies.forceps.methods import record_forceps

PARTS = 10
GCC = "/usr/bin/gcc"
FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-O2")
SAMPLES = 512
BARS = {"Python": 25.0, "C": 12.0}  # us
QUICK = {"epochs": 2}
LEAST_CORRECTED = 90.0  # %
SIX = 6
PEER_CALLS = 3000
DT = 1e-3  # [s] of the filter
FILTER_ROWS, PEER_ROWS = 20_000, 1_000
PRIOR = {"x0": np.zeros(4), "P0": np.diag([1e-2, 1e-2, 1e-8, 1e-4])}
ROWS, UNSEEN, FEATURES, JOINTS = 30_000, 10_000, 16, 3
PEER = "scikit-learn MLPRegressor, 200 epochs"
NOISE = 0.05  # of the targets, which no model can know
BLOCK, BLOCKS = 10.0, 30  # [s] of simulated time
AMPLITUDES = {
    "raven2": np.array([np.radians(8.0), np.radians(10.0), 0.02]),
    "wrist": np.radians([30.0, 8.0, 8.0]),
}

FIRST_SAMPLE = """
import time
start = time.perf_counter()
from truejoint.runtime import Corrector
corrector = Corrector({path!r})
corrector.set_homing(True, {homing!r})
status = corrector.step({t!r}, {row!r})
print(time.perf_counter() - start, int(status))
"""

MAIN = """#define _POSIX_C_SOURCE 199309L
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include "m.h"
#define BATCHES 3000
#define CALLS 64
static double taken[BATCHES];
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
static const double stamps[] = {stamps};
static const double samples[] = {samples};
static m_state state;
static long calls, good;
static double position[M_JOINTS], half_width[M_JOINTS];
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
    printf("%.3f %.1f\\n", taken[BATCHES / 2], 100.0 * (double)good / (double)calls);
    return 0;
}}
"""


def driven_jaw(seed: int) -> Recording:
    """Make a minute at 200 Hz of a jaw that rubs and gives, under one load."""
    rng = np.random.default_rng(seed)
    t = np.arange(12_000) / 200.0
    driver = 0.5 + 0.45 * np.cos(2.0 * np.pi * 0.3 * t) * (0.8 + 0.2 * np.sin(0.3 * t))
    load = 0.02 + 0.02 * seed
    friction = np.tanh(np.gradient(driver, t) / 0.05)
    effort = load + 0.03 * friction + 0.01 * driver + 0.002 * rng.standard_normal(len(t))
    columns = {
        "t": t,
        "measured/jaw": 1.0 - 0.9 * driver,
        "driver/jaw": driver,
        "effort/jaw": effort,
        "truth/jaw": 1.1 - 0.88 * driver - 0.9 * load - 0.01 * friction,
        "truth_effort/jaw": -1.1 * load - 0.01 * friction,
    }
    origin = Provenance("davinci_grasper", session=str(seed))
    units = dict.fromkeys(("effort/jaw", "truth_effort/jaw"), "Nm")
    return Recording.from_columns(columns, origin, units)


def six_joints(seed: int) -> Recording:
    """Make five minutes at 50 Hz of an arm whose joints lag behind their motors by a play."""
    robot, rng = get_robot("dvrk_psm"), np.random.default_rng(seed)
    t = np.arange(15_000) / 50.0
    columns = {"t": t}
    for joint in robot.joints[:SIX]:
        waves = np.sin(np.outer(t, rng.uniform(0.2, 1.5, 3)) + rng.uniform(0.0, 6.0, 3)).mean(1)
        columns[f"measured/{joint.name}"] = joint.lower + (joint.upper - joint.lower) * (
            0.5 + 0.4 * waves
        )
    for joint in robot.joints[:SIX]:
        q = columns[f"measured/{joint.name}"]
        friction = np.tanh(np.gradient(q, t) / (0.1 * np.ptp(q)))
        columns[f"effort/{joint.name}"] = friction + 0.1 * rng.standard_normal(len(t))
        columns[f"truth/{joint.name}"] = q - 0.01 * np.ptp(q) * friction
    units = {f"effort/{j.name}": "N" if j.unit == "m" else "Nm" for j in robot.joints[:SIX]}
    return Recording.from_columns(columns, Provenance("dvrk_psm", session=str(seed)), units)


def recordings() -> dict[int, tuple[list[Recording], Recording]]:
    """Training, and a motion that is not in it, by the number of joints; 0: of a jaw's cables."""
    jaws = [driven_jaw(seed) for seed in range(5)]
    raven = simulated_session()
    six = [six_joints(seed) for seed in range(3)]
    angles = calibration_trajectory().positions[:, 0]
    cables = record_forceps(specimen("B"), angles, seed=0)
    return {
        0: ([cables], cables),
        1: (jaws[:4], jaws[4]),
        3: (raven.training, raven.held_back[0]),
        SIX: (six[:2], six[2]),
    }


def unfitted(name: str) -> JointRegressor:
    """Estimator of that name, quick to fit."""
    estimator = get_estimator(name)
    own = estimator.get_params()
    return estimator.set_params(**{k: v for k, v in QUICK.items() if k in own})


def build(calibration: Calibration, recording: Recording, folder: Path) -> Path:
    """Export, compile and check a calibration; returns the program that times it."""
    export_c(calibration, folder, prefix="m")
    first = len(recording) // 2
    rows = recording.table.iloc[first : first + SAMPLES]
    stamps = rows["t"].to_numpy()
    text = MAIN.format(
        stamps=table(stamps, "double"),
        samples=table(rows[list(calibration.loop_signals)].to_numpy(), "double"),
        rows=SAMPLES,
        period=float(stamps[-1] - stamps[0] + np.median(np.diff(stamps))),
    )
    (folder / "time.c").write_text(text, encoding="ascii")
    for name in ("m_check", "time"):
        sources = [str(folder / f"{source}.c") for source in ("m", name)]
        subprocess.run([GCC, *FLAGS, *sources, "-lm", "-o", str(folder / name)], check=True)
    subprocess.run([str(folder / "m_check")], check=True, stdout=subprocess.DEVNULL)
    return folder / "time"


def time_corrector(model: Calibration, samples: Samples, calls: int) -> Array:
    """Time of each step [us]; every sample must come out corrected."""
    corrector, statuses = Corrector(model), [0] * calls
    corrector.set_homing(True)
    stamps, rows, step = samples.t, list(samples.rows), corrector.step

    def correct(k: int) -> None:
        statuses[k] = step(stamps[k], rows[k])

    laps = laps_of(correct, calls)
    if flagged := np.count_nonzero(statuses):
        print(f"  ({flagged} of {calls} samples were flagged)")
    return laps[200:]


def steps(model: Calibration, unseen: Recording, calls: int) -> dict[str, float]:
    """Cost of a step [us] from Python and in C; TruejointError if samples are mostly flagged."""
    rows = unseen.table[list(model.loop_signals)].to_numpy()
    laps = time_corrector(
        model, Samples(model.loop_signals, unseen.t.tolist(), rows), min(calls, len(rows))
    )
    least = min(float(np.median(part)) for part in np.array_split(laps, PARTS))
    with tempfile.TemporaryDirectory() as folder:
        program = build(model, unseen, Path(folder))
        printed = subprocess.run([str(program)], check=True, capture_output=True, text=True).stdout
    median, corrected = map(float, printed.split())
    if corrected < LEAST_CORRECTED:
        raise TruejointError(f"{corrected} % of the samples were corrected, too few to time")
    return {"Python": least, "C": median}


def cells(
    name: str, recorded: dict[int, tuple[list[Recording], Recording]], joints: list[int], calls: int
) -> Iterator[tuple[dict[str, float], str]]:
    """Give costs for each number of joints, or none and the reason."""
    estimator = unfitted(name)
    if estimator.family.row is None:
        yield from (({}, f"it {estimator.family.offline}") for _ in joints)
        return
    for n in joints:
        training, unseen = recorded[n]
        own = estimator.family.inputs
        if n == 1 and own and not set(own(estimator.model_params())) <= set(unseen.table.columns):
            training, unseen = recorded[0]
        positions = [f"measured/{joint}" for joint in unseen.joints_of("measured")]
        features = positions if n == SIX and not own else None
        try:
            model = calibrate(training, estimator, features=features)
            widths = np.full((1, len(model.joints)), 0.01)  # any take as long to compute with
            interval = Interval(np.array([0.9]), widths, 2.0, 0.0, 9, 9)
            yield steps(replace(model, interval=interval), unseen, calls), ""
        except TruejointError as reason:
            yield {}, f"{n} joints: {reason}"


def sklearn_network(model: Calibration) -> Callable[[Array], Array]:
    """`predict` of scikit-learn's scaler and a network with the layers of ours."""
    first = model.model.arrays_["weight_0"].shape[0]
    rng = np.random.default_rng(0)
    network = MLPRegressor(
        hidden_layer_sizes=(100, 100), activation="logistic", batch_size=20, max_iter=1
    )
    with warnings.catch_warnings(category=ConvergenceWarning, action="ignore"):
        pipeline = make_pipeline(StandardScaler(), network)
        pipeline.fit(rng.normal(size=(20, first)), rng.normal(size=(20, 3)))
    return pipeline.predict


def time_first_sample(model: Calibration, samples: Samples, folder: Path) -> None:
    """Print the time of a fresh process to its first corrected sample, cache warm."""
    path = folder / "model.safetensors"
    write_calibration(model, path)
    code = FIRST_SAMPLE.format(
        path=str(path), homing=HOMING, t=samples.t[0], row=samples.rows[0].tolist()
    )
    times = []
    for _ in range(5):
        start = time.perf_counter()
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, check=True)
        whole = time.perf_counter() - start
        seconds, status = done.stdout.split()
        times.append((float(seconds), whole))
        if int(status) != Status.OK:
            raise SystemExit(f"the first sample came out as {Status(int(status))!r}")
    inner, whole = np.median(times, axis=0)
    print(f"\nImport, load, first corrected sample: {inner:.2f} s ({whole:.2f} s whole process).")


def laps_of(call: Callable[[int], object], calls: int) -> Array:
    """Time of each call [us]."""
    laps = np.empty(calls)
    for k in range(calls):
        start = time.perf_counter_ns()
        call(k)
        laps[k] = time.perf_counter_ns() - start
    return laps * 1e-3


def steps_part(names: list[str], calls: int = 6000) -> None:
    """Print the cost of a step of every estimator, of a peer's, and of a process's first sample."""
    joints = [1, 3, SIX]
    head("estimator", *(f"{n} joints, {where} [us]" for n in joints for where in BARS))
    recorded, reasons = recordings(), []
    for name in names:
        shown = [name]
        for found, reason in cells(name, recorded, joints, calls):
            for where, bar in BARS.items():
                took = found.get(where)
                text = "-" if took is None else f"{took:.2f}"
                shown.append(f"**{text}**" if took is not None and took > bar else text)
            reasons += [f"{name}: {reason}"] * bool(reason)
        row(*shown)
    print("\n" + "\n".join(reasons))
    session = simulated_session()
    network = session.fit(NeuralNetwork(epochs=2))
    samples = session.samples(network.loop_signals, PEER_CALLS / 1000 + 1)
    ours = float(np.median(time_corrector(network, samples, PEER_CALLS)))
    inputs = samples.rows[:PEER_CALLS, : len(network.signals)]
    predict = sklearn_network(network)
    laps = laps_of(lambda k: predict(inputs[k : k + 1]), len(inputs))
    theirs = float(np.median(laps))
    print(f"scikit-learn, the same layers alone: {theirs:.1f} us, {theirs / ours:.1f} x ours")
    with tempfile.TemporaryDirectory() as folder:
        time_first_sample(network, samples, Path(folder))


def forceps() -> StateSpaceModel:
    """Spring-coupled jaw and slider with stiffnesses of the order of yan2020's Table 1."""
    A, B, C = np.zeros((4, 4)), np.zeros((4, 1)), np.eye(4)[2:]
    A[[0, 2], [1, 3]], A[1, [0, 2]], A[3, [0, 2]] = 1.0, (-4.0e5, 1.5e8), (1.0e3, -4.5e5)
    B[1] = 2.0e5
    F, G, *_ = cont2discrete((A, B, C, np.zeros((2, 1))), DT)
    Q = F @ np.diag([0.0, 2e3 * DT, 0.0, 1e-2 * DT]) @ F.T
    return linear_model(F, G, C, Q, np.diag([1.6e-13, 1e-8]))


def filterpy_laps(model: StateSpaceModel, z: Array, u: Array) -> Array:
    """Time of each of filterpy's predictions and updates [us]."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter  # noqa: PLC0415

    parameters = np.asarray(model.parameters)
    F, G = parameters[:16].reshape(4, 4), parameters[16:20]
    points = MerweScaledSigmaPoints(4, alpha=1.0, beta=2.0, kappa=0.0)

    def transition(x: Array, _dt: float, u: float) -> Array:
        return np.asarray(F @ x + G * u)

    theirs = UnscentedKalmanFilter(4, 2, DT, hx=lambda x: x[2:], fx=transition, points=points)
    theirs.x, theirs.P = PRIOR["x0"].copy(), PRIOR["P0"].copy()
    theirs.Q, theirs.R = np.asarray(model.process_noise), np.asarray(model.measurement_noise)

    def step(k: int) -> None:
        theirs.predict(u=u[k, 0])
        theirs.update(z[k])

    return laps_of(step, PEER_ROWS)


def filter_part() -> None:
    """Print the cost of a filter's step [us]."""
    model, rng = forceps(), np.random.default_rng(0)
    u = 0.5 * np.sin(2 * np.pi * 0.5 * DT * np.arange(FILTER_ROWS))[:, None]
    z = rng.normal(size=(FILTER_ROWS, 2)) * [4e-7, 1e-4]
    head("one step [us]", "median", "p99", "of ours", "a row of a record")
    estimator = UnscentedFilter(model)
    state = estimator.initial_state(**PRIOR)
    laps = laps_of(lambda k: estimator.step(state, z[k], u[k], DT), FILTER_ROWS)
    estimator.run(z[:2], u[:2], **PRIOR, dt=DT)  # compiles
    start = time.perf_counter()
    estimator.run(z, u, **PRIOR, dt=DT)
    record = (time.perf_counter() - start) / FILTER_ROWS * 1e6
    best = np.median(laps)
    row("ours", f"{best:.2f}", f"{np.quantile(laps, 0.99):.2f}", "", f"{record:.2f}")
    if importlib.util.find_spec("filterpy") is None:
        row("filterpy is not installed", *[""] * 4)
        return
    median, p99 = np.quantile(filterpy_laps(model, z, u), [0.5, 0.99])
    row("filterpy", f"{median:.2f}", f"{p99:.2f}", f"{median / best:.0f} x", "")


def training_rows(seed: int = 0) -> tuple[Array, Array]:
    """Features and targets of a smooth function with noise, those that no fit sees last."""
    rng = np.random.default_rng(seed)
    X = rng.normal(size=(ROWS + UNSEEN, FEATURES))
    mixed = X @ rng.normal(size=(FEATURES, JOINTS)) / 4
    return X, np.sin(mixed) + 0.1 * mixed**2 + rng.normal(0, NOISE, mixed.shape)


def peer(X: Array, y: Array) -> Any:
    """Fit scikit-learn's network, as peng2024 sets it up."""
    network = MLPRegressor(
        (100, 100), activation="logistic", alpha=5e-4 * JOINTS * 1024, batch_size=1024,
        max_iter=200, tol=0.0, n_iter_no_change=10**6, random_state=0,
    )  # fmt: skip
    scaled = TransformedTargetRegressor(
        make_pipeline(StandardScaler(), network), transformer=StandardScaler(), check_inverse=False
    )
    return scaled.fit(X.astype(np.float32), y.astype(np.float32))


def timed(fit: Callable[[], Any], repeats: int) -> tuple[float, Any]:
    """Median wall time [s] of a fit, and what it gave."""
    times = []
    for _ in range(repeats):
        began = time.perf_counter()
        fitted = fit()
        times.append(time.perf_counter() - began)
    return statistics.median(times), fitted


def training_part(repeats: int = 3) -> None:
    """Print how long fits take, and how exact they are."""
    X, y = training_rows()
    taught, targets = X[:ROWS], y[:ROWS]
    NeuralNetwork(epochs=1).fit(X[:2048], y[:2048])  # libraries loaded, kernels compiled
    fits: dict[str, Callable[[], Any]] = {
        "linear": lambda: Polynomial(1).fit(taught, targets),
        "poly2": lambda: Polynomial().fit(taught, targets),
        "dnn, 200 epochs": lambda: NeuralNetwork(random_state=0).fit(taught, targets),
        PEER: lambda: peer(taught, targets),
    }
    found = {name: timed(fit, repeats) for name, fit in fits.items()}
    base = found[PEER][0]
    exact = f"RMSE on {UNSEEN} rows not seen (noise {NOISE})"
    head(f"fit to {ROWS} x {FEATURES}", f"median of {repeats} [s]", "of scikit-learn", exact)
    for name, (seconds, fitted) in found.items():
        error = np.sqrt(np.mean((fitted.predict(X[ROWS:]) - y[ROWS:]) ** 2))
        row(name, f"{seconds:.2f}", f"{seconds / base:.3f}", f"{error:.4f}")


def twin_speed(robot: str) -> None:
    """Time a twin and print one line."""
    twin = make_twin(robot)
    twin.home()
    t = np.arange(round(BLOCK * 1000)) * 1e-3
    goal = np.tile(twin.robot.home, (len(t), 1))
    goal[:, :3] += AMPLITUDES[robot] * np.sin(2 * np.pi * t[:, None] / BLOCK)
    twin.run(goal)
    factors = []
    for _ in range(BLOCKS):
        start = time.process_time()  # other programs on the machine do not count
        twin.run(goal)
        factors.append(BLOCK / (time.process_time() - start))
    print(
        f"{robot} twin, 1 kHz: {np.median(factors):.0f} times real time "
        f"({min(factors):.0f} to {max(factors):.0f} over {BLOCKS} blocks of {BLOCK:g} s)"
    )


def main() -> None:
    """Print the tables that are asked for."""
    parts = ("steps", "filter", "training", "twins")
    options = parsed(__doc__, parts=parts, estimators=estimator_names())
    if "steps" in options.parts:
        steps_part(options.estimators)
    if "filter" in options.parts:
        filter_part()
    if "training" in options.parts:
        training_part()
    if "twins" in options.parts:
        for robot in AMPLITUDES:
            twin_speed(robot)


if __name__ == "__main__":
    main()
