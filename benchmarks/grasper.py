"""Jaw angle and torque of the da Vinci grasper from its motor side, as published and held out.

    python -m benchmarks.grasper [--part honest|calibrated|easy|sensors ...] [--estimators NAME ...]
        [--development]

honest   Whole recordings held out, causal: frequency index 3, or load indices 3 and 7.
calibrated  The same by models as `calibrate` makes them, of recordings at 100 Hz (``--estimators
         auto`` takes minutes); with ``--development`` on splits that none of these hold out.
easy     As published (O'Neill, Stephens, Kowalewski, RA-L 3(4), 2018;
         MRDLab/mis-tool-characterization:RAL-2018): every signal, truth included, filtered forward
         and backward; the first and last second left out; closing strokes only (driver at -0.25
         rad/s or faster); training and test samples drawn at random from the same strokes. It is
         not causal, and each test sample has training samples a millisecond away.
sensors  The filter on other sensors than the driver's, whole recordings held out.

Prints Markdown tables. Angle RMSE in deg, torque RMSE in mNm.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.signal import butter, sosfiltfilt

from benchmarks.automatic_choice import Split, recommended
from benchmarks.histories import RATE, development
from truejoint import calibrate
from truejoint.calibration import Calibration
from truejoint.estimators import (
    ElasticJointFilter,
    ElasticJointHybrid,
    JointRegressor,
    NeuralNetwork,
    Polynomial,
)
from truejoint.features import FeatureSet, time_steps
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, read_dataset
from truejoint.runtime import Corrector

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DATASET = DATASETS["davinci_grasper_umn"]
GAP = 0.01
"""Time without a sample [s] after which a history starts anew."""
STATIC = ("measured/jaw", "rate(measured/jaw, 0.05)", "effort/jaw", "current/jaw")
HISTORY = DATASET.features
FIT_RATE = 40.0
"""Rows fitted to [1/s] of each recording; features and filters see all."""
SEEDS = (0,)

# RAL-2018/compileData.m, segmentData.m and neuralNetDriver.m
CUTOFF = 50.0
CLOSING = -0.25
MARGIN = 1.0
TRAIN_SHARE, VALIDATION_SHARE = 0.70, 0.15
SURROGATES = {
    "driver torque": "effort/jaw",
    "measured current": "current/jaw",
    "gearbox differential": "differential/jaw",
    "commanded current": "command/jaw",
}
EASY_ROWS = 40_000
"""Training samples drawn of the 70 %, so that the networks take seconds."""


@dataclass(frozen=True)
class Bench:
    """Rows of some recordings: features by set, what the filter sees, and the truth."""

    features: dict[tuple[str, ...], Array]
    driver: Array
    dt: Array
    truth: Array
    measured: Array
    session: NDArray[np.str_]


def gather(recordings: list[Recording], sets: tuple[tuple[str, ...], ...]) -> Bench:
    """All rows of the recordings, in order."""

    def columns(*names: str) -> Array:
        return np.concatenate([r.table[list(names)].to_numpy(np.float64) for r in recordings])

    return Bench(
        {
            s: np.concatenate([FeatureSet.parse(s).compute(r, GAP) for r in recordings])
            for s in sets
        },
        columns("driver/jaw", "effort/jaw"),
        np.concatenate([time_steps(np.array(r.t), GAP) for r in recordings]),
        columns("truth/jaw", "truth_effort/jaw"),
        columns("measured/jaw"),
        np.concatenate([np.full(len(r.t), r.provenance.session) for r in recordings]),
    )


def scores(errors: Array) -> tuple[float, float]:
    """Angle [deg] and torque [mNm] RMSE of errors (n, 2)."""
    angle, torque = np.sqrt(np.mean(errors**2, axis=0))
    return float(np.degrees(angle)), float(1e3 * torque)


def regression(
    make: Callable[[int], JointRegressor],
    features: tuple[str, ...],
    bench: Bench,
    train: Mask,
    test: Mask,
    seeds: tuple[int, ...] = (0,),
) -> tuple[float, float]:
    """Fit one model to the position's error and one to the torque; RMSE, mean over seeds."""
    X = bench.features[features]
    targets = bench.truth - np.column_stack([bench.measured, np.zeros(len(bench.measured))])
    found = []
    for seed in seeds:
        errors = [
            make(seed).fit(X[train], target[train]).predict(X[test]) - target[test]
            for target in targets.T
        ]
        found.append(scores(np.column_stack(errors)))
    angle, torque = np.mean(found, axis=0)
    return float(angle), float(torque)


def offset(bench: Bench, train: Mask, test: Mask) -> tuple[float, float]:
    """Add a constant to the measured position; take the torque's mean."""
    targets = bench.truth - np.column_stack([bench.measured, np.zeros(len(bench.measured))])
    return scores(targets[test] - targets[train].mean(axis=0))


def elastic(
    bench: Bench,
    train: Mask,
    test: Mask,
    filtered: Mask,
    *,
    smoothed: bool = False,
    unfitted: ElasticJointFilter | None = None,
) -> tuple[float, float]:
    """Fit the unscented filter to angle and torque of `train`; run it over rows `filtered`."""
    seen = np.isin(bench.session, np.unique(bench.session[train]))
    truth = np.where(train[:, None], bench.truth, np.nan)
    own = unfitted or ElasticJointFilter()
    angle, torque = truth[seen, :1], truth[seen, 1:]
    model = own.fit(bench.driver[seen], angle, dt=bench.dt[seen], loads=torque)
    estimate = model.estimate(bench.driver[filtered], bench.dt[filtered], smoothed=smoothed)
    return scores((estimate.outputs - bench.truth[filtered])[test[filtered]])


METHODS: dict[str, Callable[[Bench, Mask, Mask], tuple[float, float]]] = {
    "offset": offset,
    "linear": lambda *rows: regression(lambda _s: Polynomial(1), STATIC, *rows),
    "play, linear": lambda *rows: regression(lambda _s: Polynomial(1), HISTORY, *rows),
    "play, quadratic": lambda *rows: regression(lambda _s: Polynomial(), HISTORY, *rows),
    "dnn, play features": lambda *rows: regression(
        lambda seed: NeuralNetwork(**DATASET.settings["dnn"], random_state=seed),
        HISTORY,
        *rows,
        seeds=SEEDS,
    ),
}


def honest() -> None:
    """Whole recordings held out."""
    recordings = read_dataset(DATASET.name, "Tool_4_Maryland_L_4/*")
    bench = gather(recordings, (STATIC, HISTORY))
    stride = round(1000.0 / FIT_RATE)
    fitted = np.concatenate([np.arange(len(r.t)) % stride == 0 for r in recordings])
    found: dict[str, list[float]] = {}
    for split in DATASET.splits:
        held_out = [
            r.provenance.session for r in recordings if split.holds_out(r.provenance.session)
        ]
        test = np.isin(bench.session, held_out)
        for name, method in METHODS.items():
            found.setdefault(name, []).extend(method(bench, fitted & ~test, test))
        for own in (ElasticJointFilter(), ElasticJointHybrid()):
            reached = elastic(bench, fitted & ~test, test, test, unfitted=own)
            found.setdefault(own.name, []).extend(reached)
    table("honest: whole recordings held out, causal", [s.name for s in DATASET.splits], found)


def calibrated(estimators: Sequence[str], splits: Iterable[Split]) -> None:
    """Give what model files tell of angle and torque, and how often the latter's width holds."""
    print("\n| a model file, held out | angle [deg] | torque [mNm] | within its stated 90 % |")
    print("|---|---|---|---|")
    for split in splits:
        training, testing = split.sides(RATE)
        for name in estimators:
            model = calibrate(training, name, fit_rate=FIT_RATE)
            found = np.concatenate([misses(model, recording) for recording in testing])
            angle, torque = scores(found[:, :2])
            held = 100.0 * np.mean(np.abs(found[:, 1]) <= found[:, 2])
            told = "- | -" if np.isnan(torque) else f"{torque:.2f} | {held:.0f} %"
            cells = f"{angle:.3f} | {told}"
            print(f"| {name}, {split.name} | {cells} |", flush=True)


def misses(model: Calibration, recording: Recording) -> Array:
    """Errors of angle and torque, and half-width of the torque (n, 3); NaN where it tells none."""
    loop = Corrector(model)
    loop.set_homing(True)
    told = loop.run(recording).beside.get("torque", np.full((len(recording), 2), np.nan))
    angle = model.correct(recording) - recording.columns("truth", ("jaw",))
    return np.column_stack([angle, told[:, 0] - recording.column("truth_effort/jaw"), told[:, 1]])


def published(recording: Recording) -> tuple[Recording, Mask]:
    """Filter every signal as published, and tell which rows are closing strokes."""
    low_pass = butter(3, CUTOFF, fs=1000.0, output="sos")
    table = recording.table.copy()
    driver, motor = table["driver/jaw"].to_numpy(), table["motor/jaw"].to_numpy()
    table["differential/jaw"] = motor + 35.0 * driver
    for name in table.columns:
        if name != "t":
            table[name] = sosfiltfilt(low_pass, table[name].to_numpy())
    t = table["t"].to_numpy()
    table["velocity/jaw"] = np.gradient(table["driver/jaw"].to_numpy(), 1e-3)
    closing = table["velocity/jaw"].to_numpy() <= CLOSING
    units = dict(recording.units) | {"differential/jaw": "rad", "velocity/jaw": "rad/s"}
    inside = (t >= t[0] + MARGIN) & (t <= t[-1] - MARGIN)
    columns = {name: table[name].to_numpy() for name in table.columns}
    return Recording.from_columns(columns, recording.provenance, units), closing & inside


def easy() -> None:
    """As published."""
    pairs = [published(r) for r in read_dataset(DATASET.name, "Tool_4_Maryland_L_4/*")]
    inputs = {name: ("driver/jaw", "velocity/jaw", s) for name, s in SURROGATES.items()}
    bench = gather([r for r, _ in pairs], (STATIC, HISTORY, *inputs.values()))
    strokes = np.flatnonzero(np.concatenate([mask for _, mask in pairs]))
    order = np.random.default_rng(0).permutation(strokes)
    first, second = (round(s * len(order)) for s in (TRAIN_SHARE, TRAIN_SHARE + VALIDATION_SHARE))
    train, test = np.zeros(len(bench.truth), bool), np.zeros(len(bench.truth), bool)
    train[order[:first][:EASY_ROWS]], test[order[second:]] = True, True
    found: dict[str, list[float]] = {}
    for name, method in METHODS.items():
        found[name] = list(method(bench, train, test))
    for name, features in inputs.items():
        found[f"network of 30 on angle, velocity, {name}"] = list(
            regression(
                lambda seed: NeuralNetwork(
                    hidden_layer_sizes=(30,), weight_decay=0.0, learning_rate=5e-3,
                    random_state=seed,
                ),
                features, bench, train, test,
            )
        )  # fmt: skip
    every = np.ones_like(test)
    found["ukf_elastic"] = list(elastic(bench, train, test, every))
    found["ukf_elastic, smoothed"] = list(elastic(bench, train, test, every, smoothed=True))
    found["published, network of 30"] = [0.37, 4.42]
    table(f"easy: as published, {len(order)} samples, not causal", ["strokes"], found)


def sensors() -> None:
    """Give the filter other sensors, by way of `calibrate`; angle only."""
    recordings = read_dataset(DATASET.name, "Tool_4_Maryland_L_4/*")
    layouts = [
        ("driver/jaw", "effort/jaw"), ("motor/jaw", "effort/jaw"),
        ("driver/jaw", "current/jaw"), ("motor/jaw", "current/jaw"),
    ]  # fmt: skip
    print("\n| the filter's sensors | " + " | ".join(s.name for s in DATASET.splits) + " |")
    print("|---|" + "---|" * len(DATASET.splits))
    for layout in layouts:
        cells = []
        for split in DATASET.splits:
            out = [split.holds_out(r.provenance.session) for r in recordings]
            training = [r for r, held in zip(recordings, out, strict=True) if not held]
            model = calibrate(training, "ukf_elastic", features=layout, fit_rate=FIT_RATE)
            errors = [
                (model.correct(r) - r.columns("truth", ("jaw",)))[:, 0]
                for r, held in zip(recordings, out, strict=True)
                if held
            ]
            rmse = float(np.degrees(np.sqrt(np.mean(np.concatenate(errors) ** 2))))
            cells.append(f"{rmse:.2f}")
        print(f"| {', '.join(layout)} | " + " | ".join(cells) + " |", flush=True)


def table(title: str, parts: list[str], found: dict[str, list[float]]) -> None:
    """Print angle and torque of each part."""
    print(f"\n| {title} | " + " | ".join(f"{p} [deg] | {p} [mNm]" for p in parts) + " |")
    print("|---|" + "---|---|" * len(parts))
    for name, values in found.items():
        print(f"| {name} | " + " | ".join(f"{v:.2f}" for v in values) + " |", flush=True)


def main() -> None:
    """Print the tables."""
    names = ("honest", "calibrated", "easy", "sensors")
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--part", nargs="+", choices=names, default=names)
    parser.add_argument(
        "--estimators", nargs="+", default=["ukf_elastic", "hybrid"], help="calibrated"
    )
    parser.add_argument("--development", action="store_true", help="calibrated: other splits")
    options = parser.parse_args()
    every = development() if options.development else recommended()
    splits = [one for one in every if one.dataset == DATASET.name]
    parts = (honest, partial(calibrated, options.estimators, splits), easy, sensors)
    for name, part in zip(names, parts, strict=True):
        if name in options.part:
            part()


if __name__ == "__main__":
    main()
