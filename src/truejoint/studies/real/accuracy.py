"""Every estimator on public recordings of real joints, held out by file or by time.

Hwang et al. 2020 (IEEE RA-L 5(4)) learn from both motions of their da Vinci arm together, on a
window of four samples of all commanded joints, and look at the first tenth of the rows meanwhile
(BerkeleyAutomation/dvrkCalibration:modeling/train.py, whose slices leave those rows in the training
too; here they are held out). The trajectories that they finally judge on are not public.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.calibration import Calibration, calibrate
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import CalibrationError
from truejoint.estimators import NeuralNetwork, estimator_names, get_estimator
from truejoint.evaluation import part_by_time
from truejoint.evaluation.metrics import rmse
from truejoint.evaluation.splits import recommended_sides
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, read_dataset
from truejoint.studies.study import (
    Claim,
    Part,
    PartResult,
    Settings,
    Summary,
    check_counts,
    check_names,
)
from truejoint.studies.table import reported
from truejoint.tables import Table, decimals_for, fixed
from truejoint.units import display_unit

Groups = dict[tuple[str, str], dict[str, Any]]
"""What was found on each data set and split."""

HWANG: Final = "hwang"
"""Split of the da Vinci arm's set as its authors do it."""
FEATURES: Final = ("suited", "plain")
"""Of linear, poly2 and dnn: those of the data set, or measured positions and efforts alone."""
_TITLE: Final = "Recordings of real joints"
_DVRK: Final = "dvrk_psm_berkeley"
_COLOURS: Final = 10  # of the cycle that "C0" begins; then marks change
_SEEN: Final = 0.1
_WINDOW: Final = 4
_OFFSET: Final = "offset"
_BASELINES: Final = ("raw", _OFFSET)
_SUITED: Final = ("linear", "poly2", "dnn")  # that take the features and settings of a data set


def parts(settings: Settings) -> Sequence[Part]:
    """One a data set, split and estimator."""
    check_counts(settings, "networks")
    check_names("data set", settings["datasets"], tuple(_judged_sets()))
    known = [name for name in estimator_names() if name not in _BASELINES]
    check_names("estimator", settings["estimators"], known)
    check_names("kind of features", (settings["features"],), FEATURES)
    found = []
    for name in settings["datasets"]:
        splits = [split.name for split in DATASETS[name].splits] + [HWANG] * (name == _DVRK)
        for split in splits:
            for estimator in settings["estimators"]:
                seeds = settings["networks"] if estimator == "dnn" else 1
                arguments = {
                    "dataset": name,
                    "split": split,
                    "estimator": estimator,
                    "suited": settings["features"] == FEATURES[0],
                    "seeds": list(range(settings.seed, settings.seed + seeds)),
                }
                found.append(Part(f"{name}-{split}-{estimator}", judge, arguments))
    return found


def _judged_sets() -> list[str]:
    return [name for name, dataset in DATASETS.items() if dataset.splits]


def judge(
    dataset: str, split: str, estimator: str, seeds: Sequence[int], suited: bool = True
) -> PartResult:
    """Fit an estimator to the training side, and judge it on what was held out.

    One that refuses the recordings, as a filter of another robot does, has its reason as a result.
    """
    about = DATASETS[dataset]
    if split == HWANG:
        whole = read_dataset(dataset)
        training = [part_by_time(one, _SEEN, 1.0) for one in whole]
        testing = [part_by_time(one, 0.0, _SEEN) for one in whole]
    else:
        training, testing = recommended_sides(about, about.split(split))
    features: Sequence[str] | None = None
    if suited and estimator in _SUITED:
        features = _window(training[0]) if split == HWANG else about.features
    unfitted = [_unfitted(about, estimator, seed) for seed in seeds]
    rate = about.fit_rate
    try:
        models = [calibrate(training, one, features=features, fit_rate=rate) for one in unfitted]
    except CalibrationError as reason:
        return PartResult({"dataset": dataset, "estimator": estimator, "refused": str(reason)})
    joints = models[0].joints
    found = {estimator: [_left(model, testing) for model in models]}
    if estimator == "linear":
        found[_OFFSET] = [_left(models[0].baselines[_OFFSET], testing)]
        error = np.concatenate([one.with_truth(joints).error(joints) for one in testing])
        found["raw"] = [rmse(error).tolist()]
    units = [testing[0].robot.joint(joint).unit for joint in joints]
    about_it = {"dataset": dataset, "split": split, "joints": list(joints), "units": units}
    return PartResult({**about_it, "rmse": found})


def _window(recording: Recording) -> list[str]:
    """All measured joints, and where they were the samples before."""
    now = [f"measured/{joint}" for joint in recording.joints_of("measured")]
    return now + [f"lag({name}, {k})" for k in range(1, _WINDOW) for name in now]


def _unfitted(about: Any, estimator: str, seed: int) -> Any:
    if estimator == "dnn":
        return NeuralNetwork(**about.settings.get("dnn", {}), random_state=seed)
    return get_estimator(estimator)


def _left(model: Calibration, testing: Sequence[Recording]) -> list[float]:
    """RMSE (n_joints,) over all rows with truth."""
    errors = []
    for recording in testing:
        truth = recording.columns("truth", model.joints)
        known = np.isfinite(truth).all(axis=1)
        errors.append((model.correct(recording) - truth)[known])
    return [float(value) for value in rmse(np.concatenate(errors))]


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """RMSE of every estimator by data set, split and joint."""
    groups: Groups = {}
    refused = {}
    for numbers in (part.numbers for part in results.values()):
        if "refused" in numbers:
            refused[f"{numbers['estimator']} on {numbers['dataset']}"] = numbers["refused"]
            continue
        key = numbers["dataset"], numbers["split"]
        group = groups.setdefault(key, {**numbers, "rmse": {}})
        group["rmse"] |= numbers["rmse"]
    estimators = settings["estimators"]
    methods = [*_BASELINES, *estimators]
    rows, shares = [], dict[str, list[float]]()
    for (dataset, split), group in groups.items():
        for k, joint in enumerate(group["joints"]):
            unit, name = display_unit(group["units"][k]), f"{dataset}, {split}: {joint}"
            values = {one: np.array(seeds)[:, k] for one, seeds in group["rmse"].items()}
            cells = (_cell(values.get(method), unit.scale) for method in methods)
            rows.append((f"{name} [{unit.name}]", *cells))
            whole = float(np.mean(values.get(_OFFSET, np.nan)))
            shares[name] = [float(np.mean(values.get(one, np.nan))) / whole for one in estimators]
    networks = settings["networks"] if "dnn" in estimators else 1
    notes = (
        "RMSE on whole recordings, or the last part by time, that no fit saw; all features are "
        "causal. "
        + (f"dnn: mean ± standard deviation over {networks} seeds. " if networks > 1 else "")
        + (
            "linear, poly2 and dnn take the features of the data set, the others what it measures."
            if settings["features"] == FEATURES[0]
            else "All take measured positions and efforts as they come."
        ),
        f"{HWANG}: both motions together, four samples of all joints, the first tenth held out.",
        *(f"{what}: {reason}" for what, reason in refused.items()),
        *(DATASETS[name].notice for name in settings["datasets"] if DATASETS[name].notice),
    )
    table = Table(_TITLE, ("held out", *methods), tuple(rows), notes)
    return Summary((table,), {"real": _figure(estimators, shares)}, _claims(groups))


def _figure(estimators: Sequence[str], shares: Mapping[str, Sequence[float]]) -> Figure:
    """Draw the estimators' shares of the fixed offset's error by what was held out."""
    place, of_each = np.arange(len(shares)), np.array(list(shares.values())).T
    curves = [
        Curve(own, place, name, f"C{i % _COLOURS}", "os"[i // _COLOURS % 2])
        for i, (name, own) in enumerate(zip(estimators, of_each, strict=True))
    ]
    panel = Panel(curves, "RMSE over the fixed offset's", log="x", rows=list(shares))
    caption = "Every estimator on what was held out; 1: no better than a fixed offset."
    return Figure(_TITLE, ((panel,),), caption, 11.0, 2.0 + 0.3 * len(shares), legend=True)


def _cell(values: Any, scale: float) -> str:
    if values is None:
        return fixed(np.nan, 3)
    values = scale * values
    decimals = decimals_for([float(values.mean())], most=4)
    spread = f" ± {fixed(float(values.std(ddof=1)), decimals)}" if len(values) > 1 else ""
    return fixed(float(values.mean()), decimals) + spread


def _claims(groups: Groups) -> list[Claim]:
    """Set the best estimator beside what the set's authors report of theirs, joints 1 to 3."""
    group = groups.get((_DVRK, HWANG))
    if group is None:
        return []
    scales = [display_unit(unit).scale for unit in group["units"]]
    errors = {
        method: np.mean(seeds, axis=0) * scales
        for method, seeds in group["rmse"].items()
        if method not in _BASELINES
    }
    found = []
    for k, name in enumerate(("joint 1", "joint 2", "joint 3")):
        there = reported("peng2024", "III", "dVRK left arm Hwang 2022", "rnn", f"joint{k + 1}")[
            "rmse"
        ]
        best = min(errors, key=lambda method: float(errors[method][k]))
        text = f"{name}: a model of the arm's history reaches {there:g} deg or mm"
        number = (
            f"{best} {errors[best][k]:.3f}, the best of {len(errors)} on the very rows that judge "
            "them; other rows of the same arm than theirs"
        )
        found.append(
            Claim(
                text,
                "Hwang et al. 2022, in peng2024, Table III",
                bool(errors[best][k] <= there),
                number,
            )
        )
    return found
