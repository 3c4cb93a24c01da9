"""What correcting one sample costs from Python: ours, scikit-learn, onnxruntime, PyTorch.

    python -m benchmarks.corrector_speed [--calls 20000] [--epochs 5]

Fits models to a simulated RAVEN-II session on the 16 inputs of peng2024, with an interval, and
times single calls at 1 kHz stamps in a plain Python loop with garbage collection on, the clock
included, on one thread (`python -m benchmarks.step_speed` times every estimator). The others
predict with the very same network (16-100-100-3, checked) and check nothing of what we check. The
median is over all calls; its least over ten parts says what an undisturbed machine does. Last, the
time from a fresh interpreter to the first sample.
"""

from __future__ import annotations

import argparse
import importlib.util
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

from benchmarks.loop_session import HOMING, Samples, simulated_session
from truejoint.calibration import Calibration, write_calibration
from truejoint.estimators import NeuralNetwork
from truejoint.runtime import Corrector, Status

PARTS = 10
LIMIT = 1000.0  # us, one period
SLOW_CALLS = 3000

FIRST_SAMPLE = """
import time
start = time.perf_counter()
from truejoint.runtime import Corrector
corrector = Corrector({path!r})
corrector.set_homing(True, {homing!r})
status = corrector.step({t!r}, {row!r})
print(time.perf_counter() - start, int(status))
"""


def time_calls(call: Callable[[int], object], calls: int) -> NDArray[np.float64]:
    """Time of each call [us]."""
    clock = time.perf_counter_ns
    laps = np.empty(calls)
    for i in range(min(calls, 200)):
        call(i)
    for i in range(calls):
        start = clock()
        call(i)
        laps[i] = clock() - start
    return laps * 1e-3


def time_corrector(model: Calibration, samples: Samples, calls: int) -> NDArray[np.float64]:
    """Time of each step [us]; every sample must come out corrected."""
    corrector = Corrector(model)
    corrector.set_homing(True)
    rows = list(samples.rows)
    stamps, step, clock = samples.t, corrector.step, time.perf_counter_ns
    laps = np.empty(calls)
    flagged = 0
    for i in range(calls):
        t, row = stamps[i], rows[i]
        start = clock()
        status = step(t, row)
        laps[i] = clock() - start
        flagged += status != Status.OK
    if flagged:
        print(f"  ({flagged} of {calls} samples were flagged)")
    return laps[200:] * 1e-3


def sklearn_network(model: Calibration) -> Callable[[NDArray[np.float64]], NDArray[np.float64]]:
    """`predict` of scikit-learn's scaler and network with the weights of ours."""
    arrays = model.model.arrays_
    n_layers = sum(name.startswith("weight_") for name in arrays)
    weights = [arrays[f"weight_{i}"] for i in range(n_layers)]
    network = MLPRegressor(
        hidden_layer_sizes=[w.shape[1] for w in weights[:-1]], activation="logistic",
        solver="sgd", batch_size=20, max_iter=1,
    )  # fmt: skip
    pipeline = make_pipeline(StandardScaler(), network)
    rng = np.random.default_rng(0)
    width, outputs = len(weights[0]), weights[-1].shape[1]
    with warnings.catch_warnings(category=ConvergenceWarning, action="ignore"):
        pipeline.fit(rng.normal(size=(20, width)), rng.normal(size=(20, outputs)))
    scale = arrays["inverse_scale"]
    pipeline[0].mean_, pipeline[0].scale_ = arrays["mean"], 1.0 / np.where(scale > 0, scale, 1.0)
    # A feature that never changed has no weight here, and scale 1 in the scaler.
    weights[0] = weights[0] * (scale > 0)[:, None]
    network.coefs_ = [*weights[:-1], weights[-1] * arrays["target_scale"]]
    biases = [arrays[f"bias_{i}"] for i in range(n_layers)]
    last = biases[-1] * arrays["target_scale"] + arrays["target_mean"]
    network.intercepts_ = [*biases[:-1], last]
    return pipeline.predict


def onnx_network(model: Calibration, folder: Path) -> Callable[[NDArray[np.float64]], object]:
    """Run the exported graph in onnxruntime, one thread."""
    import onnxruntime  # noqa: PLC0415

    from truejoint.export.export_onnx import export_onnx  # noqa: PLC0415

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    path = export_onnx(model, folder / "model.onnx")
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    name = session.get_inputs()[0].name
    return lambda row: session.run(None, {name: row})[0]


def torch_network(model: Calibration) -> Callable[[NDArray[np.float64]], object]:
    """Run the same layers in PyTorch, float64, no gradients."""
    import torch  # noqa: PLC0415

    torch.set_num_threads(1)
    arrays = {k: torch.from_numpy(v.copy()) for k, v in model.model.arrays_.items()}
    n_layers = sum(name.startswith("weight_") for name in arrays)

    def call(row: NDArray[np.float64]) -> object:
        with torch.inference_mode():
            x = (torch.from_numpy(row) - arrays["mean"]) * arrays["inverse_scale"]
            for i in range(n_layers):
                x = torch.addmm(arrays[f"bias_{i}"], x, arrays[f"weight_{i}"])
                x = torch.sigmoid(x) if i < n_layers - 1 else x
            return (x * arrays["target_scale"] + arrays["target_mean"]).numpy()

    return call


def others(model: Calibration, folder: Path) -> dict[str, Callable[[NDArray[np.float64]], object]]:
    """Find what else is installed and predicts with the same network."""
    found = {"scikit-learn predict": sklearn_network(model)}
    if importlib.util.find_spec("onnxruntime") and importlib.util.find_spec("onnx"):
        found["onnxruntime"] = onnx_network(model, folder)
    if importlib.util.find_spec("torch"):
        found["PyTorch"] = torch_network(model)
    return found


def show(name: str, laps: NDArray[np.float64]) -> float:
    """Print a row; returns the median [us]."""
    median, p99, p999 = np.percentile(laps, [50, 99, 99.9])
    best = min(float(np.median(part)) for part in np.array_split(laps, PARTS))
    over = 100 * np.mean(laps > LIMIT)
    print(
        f"| {name} | {median:.2f} | {best:.2f} | {p99:.2f} | {p999:.2f} | {over:.3f} % |",
        flush=True,
    )
    return float(median)


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


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--calls", type=int, default=20_000)
    parser.add_argument("--epochs", type=int, default=5, help="weights do not change the speed")
    options = parser.parse_args()
    session = simulated_session()
    network = session.fit(NeuralNetwork(epochs=options.epochs))
    samples = session.samples(network.loop_signals, options.calls / 1000 + 1)
    models = [session.fit(name) for name in ("offset", "linear", "poly2")] + [network]
    calls = min(options.calls, len(samples.t))
    print(f"{calls} calls each (others than ours: {SLOW_CALLS}), us\n")
    print("| one sample | median | least of 10 | p99 | p99.9 | over 1 ms |")
    print("|---|---|---|---|---|---|")
    for model in models:
        ours = show(f"truejoint {model.estimator}", time_corrector(model, samples, calls))
    inputs = samples.rows[:SLOW_CALLS, : len(network.signals)]
    rows = [row[None] for row in inputs]
    with tempfile.TemporaryDirectory() as folder, threadpool_limits(1):
        expected = network.model.predict(inputs[:5])
        for name, call in others(network, Path(folder)).items():
            result = np.array([np.ravel(call(row)) for row in rows[:5]])
            if name == "onnxruntime":  # its graph gives positions
                result = result - inputs[:5, :3]
            np.testing.assert_allclose(result, expected, rtol=0, atol=1e-6)
            laps = time_calls(lambda i, call=call: call(rows[i]), len(rows))
            theirs = show(f"{name}, network alone", laps)
            print(f"  {theirs / ours:.1f} times ours", flush=True)
        time_first_sample(network, samples, Path(folder))


if __name__ == "__main__":
    main()
