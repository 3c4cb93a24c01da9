"""`truejoint calibrate`: fit a calibration to recordings and keep it in a model file."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from truejoint import calibration
from truejoint.calibration import Calibration, Interval
from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.inputs import load_recordings, only_dataset
from truejoint.cli.options import Arm, Columns, Force, Format, Json, Part, Recordings, Seed, Split
from truejoint.errors import CalibrationError, ModelFileError
from truejoint.estimators import JointRegressor, estimator_names, get_estimator
from truejoint.evaluation import DataCheck, check_data, evaluate
from truejoint.models.family import Target
from truejoint.recordings import Recording
from truejoint.recordings.datasets import DATASETS, get_dataset
from truejoint.units import display_unit


def calibrate(
    recordings: Recordings,
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    estimator: Annotated[
        str, typer.Option("--estimator", "-e", help=f"One of {', '.join(estimator_names())}.")
    ] = "dnn",
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Parameter of the estimator."),
    ] = None,
    features: Annotated[
        list[str] | None,
        typer.Option(
            "--feature",
            metavar="FEATURE",
            help="Input of the model, such as 'measured/jaw' or 'play(measured/jaw, 0.02)'; give "
            "it once for each, or the name of a public data set for the features that suit it. "
            "Default: measured position and effort of every channel.",
        ),
    ] = None,
    joints: Annotated[
        list[str] | None, typer.Option("--joint", help="Joint to correct; default: all with truth.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="What the model predicts: error (the default) or position."),
    ] = None,
    fit_rate_hz: Annotated[
        float | None,
        typer.Option(help="Fit to rows at most at this rate [Hz]; features still see every row."),
    ] = None,
    test: Annotated[
        list[str] | None,
        typer.Option("--test", help="Recording to judge on; the accuracy goes into the file."),
    ] = None,
    interval: Annotated[
        list[str] | None,
        typer.Option(
            "--interval",
            help="Recording that the fit does not see, to state how far off positions may be: 9 "
            "or more for 90 %, each after a homing of its own if that is to hold after any homing.",
        ),
    ] = None,
    interval_rezero_s: Annotated[
        float,
        typer.Option(help="State it for motions that begin with so much truth to re-zero from."),
    ] = 0.0,
    reader: Format = None,
    columns: Columns = None,
    robot: Annotated[str | None, typer.Option("--robot", help="For plain CSV files.")] = None,
    arm: Arm = "",
    part: Part = None,
    split: Split = None,
    seed: Seed = 0,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Fit a calibration to recordings that hold the true joint positions."""
    if output.exists() and not force:
        raise ModelFileError(f"{output}: is there already; choose another --out, or --force")
    context: dict[str, Any] = {"reader": reader, "columns": columns, "robot": robot, "arm": arm}
    training = load_recordings(recordings, part=part, split=split, held_out=False, **context)
    testing = load_recordings(test, **context) if test else []
    unseen = load_recordings(interval, **context) if interval else []
    dataset = only_dataset(recordings)
    if dataset is not None:
        features = features or [dataset]
        fit_rate_hz = fit_rate_hz or get_dataset(dataset).fit_rate
    fitted, check = fit(
        training,
        configured(estimator, settings or [], dataset),
        features=resolved_features(features),
        joints=joints,
        target=target,
        fit_rate=fit_rate_hz,
        seed=seed,
    )
    if unseen:
        with progress(f"Making an interval of {len(unseen)} recordings"):
            fitted = calibration.with_interval(fitted, unseen, rezero=interval_rezero_s)
    if testing:
        scores = evaluate({estimator: [fitted]}, testing).to_dict()["scores"]
        fitted = fitted.with_metadata(held_out=scores)
    fitted.save(output, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata, "check": check.to_dict()})
    else:
        _show(fitted, output)


def fit(
    training: Sequence[Recording],
    estimator: JointRegressor,
    *,
    features: Sequence[str] | None = None,
    joints: Sequence[str] | None = None,
    target: str | None = None,
    fit_rate: float | None = None,
    seed: int = 0,
) -> tuple[Calibration, DataCheck]:
    """Check the recordings, say what was found, and fit, showing progress."""
    check = check_data(training)
    for finding in check.findings:
        if finding.level != "info":
            say(f"{finding.level}: {finding.where}: {finding.what}; {finding.advice}")
    with progress(f"Fitting {estimator.name}") as done:
        fitted = calibration.calibrate(
            training,
            estimator,
            features=features,
            joints=joints,
            target=target,
            fit_rate=fit_rate,
            random_state=seed,
            progress=done,
        )
    return fitted.with_metadata(command=command_line()), check


def resolved_features(features: Sequence[str] | None) -> list[str] | None:
    """Features by text, where the name of a data set stands for the features that suit it."""
    if not features:
        return None
    chosen: list[str] = []
    for text in features:
        chosen += get_dataset(text).features if text in DATASETS else [text]
    return chosen


def configured(name: str, settings: Sequence[str], dataset: str | None = None) -> JointRegressor:
    """Estimator with parameters set by texts like ``"epochs=400"``.

    Where the recordings are a public data set, the parameters that suit it come first.

    Raises
    ------
    CalibrationError
        If there is no such estimator or parameter, or the value is of another kind.
    """
    estimator = get_estimator(name)
    known = estimator.get_params()
    if dataset is not None:
        estimator.set_params(**get_dataset(dataset).settings.get(name, {}))
    for setting in settings:
        key, separator, text = setting.partition("=")
        if not separator or key not in known:
            raise CalibrationError(
                f"--set {setting!r}: {name} has no such parameter; write NAME=VALUE with one of "
                f"{', '.join(known) or 'none'}"
            )
        estimator.set_params(**{key: _value(text, known[key], setting)})
    return estimator


def _value(text: str, default: Any, setting: str) -> Any:
    try:
        if isinstance(default, tuple):
            return tuple(type(default[0])(part) for part in text.split(","))
        return type(default)(text)
    except ValueError:
        raise CalibrationError(
            f"--set {setting!r}: {text!r} is not of the kind of the default {default!r}"
        ) from None


def _show(fitted: Calibration, output: Path) -> None:
    facts = fitted.metadata
    out.print(
        f"{output}: {fitted.estimator} for {', '.join(fitted.joints)} of {fitted.title}, "
        f"{len(fitted.feature_set)} features, {facts['rows']} rows, "
        f"{facts['duration'] / 60:.1f} min",
        highlight=False,
    )
    if fitted.interval is not None:
        _show_interval(fitted, fitted.interval)
    for score in facts.get("held_out", []):
        if score["estimator"] != fitted.estimator:
            continue
        shown = display_unit(score["unit"])
        out.print(
            f"  {score['joint']}: {score['rmse'] * shown.scale:.3f} {shown.name} RMSE held out",
            highlight=False,
        )


def _show_interval(fitted: Calibration, interval: Interval) -> None:
    for row, level in enumerate(interval.levels):
        parts = []
        for joint, width in zip(fitted.joints, interval.half_widths[row], strict=True):
            shown = display_unit(fitted.units[f"measured/{joint}"])
            parts.append(f"{joint} ± {width * shown.scale:.3f} {shown.name}")
        out.print(f"  {100 * level:g} %: {', '.join(parts)}", highlight=False)
    out.print(f"  {interval.meaning}", highlight=False)
