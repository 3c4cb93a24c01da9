"""Every estimator on public recordings of real joints, held out by file or by time.

Hwang et al. 2020 (IEEE RA-L 5(4)) learn from both motions of their da Vinci arm together, on a
window of four samples of all commanded joints, and look at the first tenth of the rows meanwhile
(BerkeleyAutomation/dvrkCalibration:modeling/train.py, whose slices leave those rows in the training
too; here they are held out). The trajectories that they finally judge on are not public.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Any, Final, get_args

import numpy as np
from pandas import DataFrame

from truejoint.calibration import calibrate, cross_interval
from truejoint.calibration.origin import ZeroOf
from truejoint.calibration.truth_zero import at_start, zeroed
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork, estimator_names
from truejoint.evaluation import compare, part_by_time
from truejoint.evaluation.evaluate import split_sides
from truejoint.evaluation.scoring import rmse
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, read_dataset
from truejoint.studies.rows import frame_table, mean_text, notes_on, reported, select, unique
from truejoint.studies.study import CLAIMS, Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import DASH, decimals_for, fixed
from truejoint.units import display_unit

HWANG: Final = "hwang"
"""Split of the da Vinci arm's set as its authors do it."""
_TITLE: Final = "Recordings of real joints"
_LEVEL: Final = 0.9
_COVERAGE: Final = "Share of the truth within a stated 90 % [%]"
_ALLOWED: Final = {"zero": ("usual", *get_args(ZeroOf)), "interval": ("none", "cross")}
_DVRK: Final = "dvrk_psm_berkeley"
_SEEN: Final = 0.1
_WINDOW: Final = 4
_OFFSET: Final = "offset"
_AUTO: Final = "auto"
_BASELINES: Final = ("raw", _OFFSET)
_SUITED: Final = ("linear", "poly2", "dnn")  # that take the features and settings of a data set


def parts(settings: Settings) -> Sequence[Part]:
    """One a data set, split and estimator."""
    settings.check_names("data set", "datasets", [n for n, d in DATASETS.items() if d.splits])
    names = [*(name for name in estimator_names() if name not in _BASELINES), _AUTO]
    settings.check_names("estimator", "estimators", names)
    for option, values in _ALLOWED.items():
        settings.check_names(option, option, values)
    how = {option: settings[option] for option in (*_ALLOWED, "rezero_s")}
    first, found = settings.seed, []
    for name in settings["datasets"]:
        splits = [split.name for split in DATASETS[name].splits] + [HWANG] * (name == _DVRK)
        for split, estimator in product(splits, settings["estimators"]):
            seeds = settings["networks"] if estimator == "dnn" else 1
            labels = {"dataset": name, "split": split, "estimator": estimator}
            arguments = {**labels, "seeds": [*range(first, first + seeds)], **how}
            found.append(Part(f"{name}-{split}-{estimator}", judge, arguments, labels))
    return found


def judge(
    dataset: str,
    split: str,
    estimator: str,
    seeds: Sequence[int],
    zero: str = "usual",
    rezero_s: float = 0.0,
    interval: str = "none",
) -> Rows:
    """Fit an estimator to the training side, and judge it on what was held out.

    One that refuses the recordings, as a filter of another robot does, has its reason as a result.
    """
    about = DATASETS[dataset]
    if split == HWANG:
        whole = read_dataset(dataset)
        training = [part_by_time(one, _SEEN, 1.0) for one in whole]
        testing = [part_by_time(one, 0.0, _SEEN) for one in whole]
    else:
        sides = about.split(split)
        training, testing = split_sides(read_dataset(about.name, sides.files), about, sides)
    features: Sequence[str] | None = None
    if estimator in _SUITED:
        features = _window(training[0]) if split == HWANG else about.features
    unfitted: list[Any] = [estimator]
    if estimator == "dnn":
        params = about.settings.get("dnn", {})
        unfitted = [NeuralNetwork(**params, random_state=seed) for seed in seeds]
    how: dict[str, Any] = {"features": features, "fit_rate": about.fit_rate}
    how |= {} if zero == "usual" else {"zero": zero}
    make = cross_interval if interval == "cross" else calibrate
    try:
        models = [make(training, one, **how) for one in unfitted]
    except CalibrationError as reason:
        return [{"refused": str(reason)}]
    judged: list[tuple[str, Any]] = [(estimator, model) for model in models]
    if estimator == "linear":
        judged += [(name, models[0].baselines.get(name)) for name in (_OFFSET, "raw")]
    joints, robot = models[0].joints, testing[0].robot
    rows: Rows = []
    for method, model in judged:
        errors, inside = [], []
        for one in (recording.with_truth(joints) for recording in testing):
            used = None if model is None else zeroed(model, one, rezero_s)
            estimate = one.columns("measured", joints) if used is None else used.correct(one)
            judged_rows = ~at_start(one.t, rezero_s)
            errors.append((estimate - one.columns("truth", joints))[judged_rows])
            if used is not None and used.interval is not None:
                inside.append(np.abs(errors[-1]) <= used.half_widths(one, _LEVEL)[judged_rows])
        coverage = np.concatenate(inside).mean(axis=0) if inside else [math.nan] * len(joints)
        for column, joint in enumerate(joints):
            own = [error[:, column] for error in errors]
            square = compare(own, [np.zeros_like(error) for error in own])
            bounds = np.sqrt(np.maximum([square.low, square.high], 0.0))
            least, most = bounds.tolist() if np.isfinite(square.high) else (math.nan, math.nan)
            labels = {"method": method, "joint": joint, "unit": robot.joint(joint).unit}
            sizes = {"rmse": float(rmse(np.concatenate(own))), "least": least, "most": most}
            rows.append({**labels, **sizes, "coverage": float(coverage[column])})
    return rows


def _window(recording: Recording) -> list[str]:
    """All measured joints, and where they were the samples before."""
    now = [f"measured/{joint}" for joint in recording.joints_of("measured")]
    return now + [f"lag({name}, {k})" for k in range(1, _WINDOW) for name in now]


def summarise(results: Results) -> Summary:
    """RMSE of every estimator by data set, split and joint."""
    settings, rows = results.settings, results.rows
    refused = rows.assign(refused=rows.get("refused")).dropna(subset="refused")
    rows = rows.drop(refused.index)
    scale = rows.unit.map(lambda unit: display_unit(unit).scale)
    names = rows.unit.map(lambda unit: display_unit(unit).name)
    name = rows.dataset + ", " + rows.split + ": " + rows.joint + " [" + names + "]"
    sizes = {column: scale * rows[column] for column in ("rmse", "least", "most")}
    rows = rows.assign(**sizes, name=name)
    why = dict(zip(refused.estimator + " on " + refused.dataset, refused.refused, strict=True))
    notes = (
        *notes_on("real"),
        *[f"{HWANG}: both motions together, four samples of all joints, the first tenth held out."]
        * (_DVRK in settings["datasets"]),
        *(f"{what}: {reason}" for what, reason in why.items()),
        *(DATASETS[name].notice for name in settings["datasets"] if DATASETS[name].notice),
    )
    errors = rows.groupby(["name", "method"], sort=False).rmse
    texts = errors.agg(lambda own: mean_text(own, decimals_for([own.mean()], most=4))).unstack()
    texts = texts.reindex(unique(rows, "name"), columns=(*_BASELINES, *settings["estimators"]))
    tables = [frame_table(_TITLE, texts.astype(object).fillna(DASH), notes, head="held out")]
    if rows.coverage.notna().any():
        shares = rows.assign(coverage=100.0 * rows.coverage).pivot_table(
            "coverage", "name", "method", sort=False
        )
        shares = shares.map(lambda share: fixed(share, 0))
        tables.append(frame_table(_COVERAGE, shares, head="held out"))
    means = rows.pivot_table("rmse", "name", "method", sort=False)
    curves = [
        Curve(means[name] / means[_OFFSET], np.arange(len(means)), name, f"C{n % 10}", "o")
        for n, name in enumerate(settings["estimators"])
        if {name, _OFFSET} <= set(means)
    ]
    panel = Panel(curves, "RMSE over the fixed offset's", log="x", rows=list(means.index))
    figure = Figure(_TITLE, ((panel,),), "", 11.0, 2.0 + 0.3 * len(means), legend=True)
    return Summary(tables, {"real": figure}, _claims(rows))


def _claims(rows: DataFrame) -> list[Claim]:
    """Set the best estimator beside what the set's authors report of theirs, joints 1 to 3."""
    rows = select(rows, dataset=_DVRK, split=HWANG)
    rows = rows[~rows.method.isin(_BASELINES)]
    claims = []
    for number, joint in enumerate(unique(rows, "joint")[:3], 1):
        paper = "dVRK left arm Hwang 2022"
        there = reported("peng2024", "III", paper, "rnn", f"joint{number}")["rmse"]
        errors = select(rows, joint=joint).groupby("method", sort=False).mean(numeric_only=True)
        best = errors.nsmallest(1, "rmse")
        value, least, most = best[["rmse", "least", "most"]].to_numpy()[0].tolist()
        found = (
            f"{best.index[0]} {value:.3f} ({least:.3f} to {most:.3f} at 95 % over stretches), the "
            f"best of {len(errors)} on the very rows that judge them; other rows of the same arm "
            "than theirs"
        )
        holds = True if most < there else False if least > there else None
        claims.append(CLAIMS[f"hwang-{number}"].claim(holds, found))
    return claims
