"""`truejoint calibrate`: fit a calibration to recordings and keep it in a model file."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import Files, check_model_free, only_dataset, takes_files
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.registry import DEFAULT


@takes_files
def calibrate(
    recordings: options.Recordings,
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    estimator: Annotated[
        str,
        typer.Option(
            "--estimator",
            "-e",
            help=f"One of {', '.join(truejoint.estimators.estimator_names())}.",
            autocompletion=truejoint.estimators.estimator_names,
        ),
    ] = DEFAULT,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Its parameter, as epochs=400 or hidden_layer_sizes=50,50.",
        ),
    ] = None,
    features: Annotated[
        list[str] | None,
        typer.Option(
            "--feature",
            metavar="FEATURE",
            help="Input of the model, such as 'measured/jaw' or 'play(measured/jaw, 0.02)'; give "
            "it once for each, or the name of a public data set for the features that suit it. "
            "Default: measured position and effort of every channel.",
            autocompletion=complete.features,
        ),
    ] = None,
    joints: Annotated[
        list[str] | None,
        typer.Option(
            "--joint",
            help="Joint to correct; default: all with truth.",
            autocompletion=complete.joints,
        ),
    ] = None,
    target: Annotated[
        Literal["error", "position"] | None,
        typer.Option(help="What the model predicts: error (the default) or position."),
    ] = None,
    fit_rate_hz: Annotated[
        float | None,
        typer.Option(help="Fit to rows at most at this rate [Hz]; features still see every row."),
    ] = None,
    test: Annotated[
        list[str] | None,
        options.recordings("--test", "Recording to judge on; the accuracy goes into the file."),
    ] = None,
    interval: Annotated[
        list[str] | None,
        options.recordings(
            "--interval",
            "Recording that the fit does not see, to state how far off positions may be: 9 "
            "or more for 90 %, each after a homing of its own if that is to hold after any homing.",
        ),
    ] = None,
    interval_rezero_s: Annotated[
        float,
        typer.Option(help="State it for motions that begin with so much truth to re-zero from."),
    ] = 0.0,
    part: options.Part = None,
    split: options.Split = None,
    seed: options.Seed = 0,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
) -> None:
    """Fit a calibration to recordings that hold the true joint positions."""
    check_model_free(output, force)
    dataset = only_dataset(recordings)
    unfitted = configured(estimator, settings or [], dataset)
    if dataset is not None:
        features = features or [dataset]
        fit_rate_hz = fit_rate_hz or truejoint.recordings.datasets.DATASETS[dataset].fit_rate
    inputs = chosen_features(features)
    read_training = files.find(
        recordings, part=part, split=split, held_out=False, joints=joints or [], inputs=inputs
    )
    read_testing, read_unseen = files.find(test or []), files.find(interval or [])
    training, testing, unseen = read_training(), read_testing(), read_unseen()
    how = {"features": inputs, "joints": joints, "target": target, "fit_rate": fit_rate_hz}
    fitted, check = fit(training, unfitted, **how, random_state=seed)
    if unseen:
        with progress(f"Making an interval of {len(unseen)} recordings"):
            fitted = truejoint.calibration.with_interval(fitted, unseen, rezero=interval_rezero_s)
    if testing:
        scores = truejoint.evaluate(fitted, testing).to_dict()["scores"]
        fitted = fitted.with_metadata(held_out=scores)
    truejoint.write_calibration(fitted, output, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata, "check": check.to_dict()})
    else:
        out.print(f"{output}: {fitted}", soft_wrap=True)


def fit(
    training: Sequence[truejoint.Recording],
    estimator: truejoint.estimators.JointRegressor,
    **how: Any,
) -> tuple[truejoint.Calibration, truejoint.evaluation.DataCheck]:
    """Check the recordings, say what was found, and fit, showing progress.

    `how` is as `truejoint.calibrate` takes it.
    """
    check = truejoint.evaluation.check_data(training)
    for finding in check.findings:
        if finding.level != "info":
            say(f"{finding.level}: {finding.where}: {finding.what}; {finding.advice}")
    with progress(f"Fitting {estimator.name}") as done:
        fitted = truejoint.calibrate(training, estimator, progress=done, **how)
    without = tuple(f"/{channel}" for channel in training[0].robot.unused_channels)
    constant = [name for name in fitted.metadata["unused_features"] if not name.endswith(without)]
    if constant:
        say(
            f"left out: {', '.join(constant)} never change in the training rows; the model does "
            "not know what they do"
        )
    return fitted.with_metadata(command=command_line()), check


def chosen_features(texts: Sequence[str] | None) -> truejoint.models.FeatureSet | None:
    """Features of their texts, where the name of a data set stands for those that suit it."""
    if not texts:
        return None
    sets = truejoint.recordings.datasets.DATASETS
    chosen = (sets[text].features if text in sets else (text,) for text in texts)
    return truejoint.models.FeatureSet.parse(feature for part in chosen for feature in part)


def configured(
    name: str, settings: Sequence[str], dataset: str | None = None
) -> truejoint.estimators.JointRegressor:
    """Estimator with parameters set by texts like ``"epochs=400"``, after those of a data set."""
    estimator = truejoint.estimators.get_estimator(name)
    known = estimator.get_params()
    if dataset is not None:
        suited = truejoint.recordings.datasets.DATASETS[dataset].settings
        estimator.set_params(**suited.get(name, {}))
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator or key not in known:
            raise CalibrationError(
                f"--set {setting!r}: {unknown(f'parameter of {name}', key, known)}; "
                "write NAME=VALUE"
            )
        estimator.set_params(**{key: _value(text, known[key], setting)})
    estimator.check_params()
    return estimator


def _value(text: str, default: Any, setting: str) -> Any:
    """Value of the kind of the default; several as ``50,50``, ``(50, 50)`` or ``[50, 50]``."""
    if isinstance(default, str):
        return text
    if isinstance(default, bool):
        if text.lower() not in {"true", "false"}:
            raise CalibrationError(f"--set {setting!r}: {text!r} is neither true nor false")
        return text.lower() == "true"
    several = isinstance(default, tuple)
    with suppress(ValueError):
        kind = type(default[0] if several else default)
        values = tuple(kind(value) for value in text.strip("()[], ").split(","))
        if several or len(values) == 1:
            return values if several else values[0]
    raise CalibrationError(
        f"--set {setting!r}: {text!r} is not of the kind of the default {default!r}"
    )
