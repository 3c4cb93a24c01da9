"""`truejoint calibrate`: fit a calibration to recordings and keep it in a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypeAlias

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.cli.console import (
    command_line,
    out,
    print_table,
    progress,
    result_json,
    say,
)
from truejoint.cli.data import CHECK_FAILED, Accept, check_names, checked, say_failed
from truejoint.cli.inputs import Files, check_model_target, only_dataset, takes
from truejoint.cli.touched import Seen, calibrate_touched
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.registry import AUTO, DEFAULT, OWN
from truejoint.units import display_unit

Unfitted: TypeAlias = "truejoint.estimators.JointRegressor | truejoint.calibration.Automatic"
"""What is fitted, or chosen."""

_CROSS: Final = "cross"  # in place of recordings for an interval
_NONE: Final = "none"  # in place of redundant columns


@takes(files=Files, seen=Seen)
def calibrate(
    recordings: options.Recordings,
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    estimator: Annotated[
        str | None,
        typer.Option(
            "--estimator",
            "-e",
            help=f"One of {', '.join(OWN)}, or of an installed package; or {AUTO}: what is best "
            "on recordings that are left out in turn, the linear model where nothing is. Default: "
            f"{DEFAULT}.",
            autocompletion=complete.estimators,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Its parameter, as epochs=400 or hidden_layer_sizes=50,50.",
            autocompletion=complete.settings,
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
    redundant: Annotated[
        list[str] | None,
        typer.Option(
            "--redundant",
            metavar="COLUMN",
            help="Column, such as 'motor/elbow', by which the loop checks measured positions; give "
            "it once for each, or 'none'. Default: every motor, driver and setpoint that tells.",
            autocompletion=complete.features,
        ),
    ] = None,
    fit_rate_hz: Annotated[
        float | None,
        typer.Option(help="Fit to rows at most at this rate [Hz]; features still see every row."),
    ] = None,
    zero: Annotated[
        Literal["shared", "recording", "homing"],
        typer.Option(
            help="Whether the recordings share one zero, or a second fit, for motions that begin "
            "with re-zeroing, takes one for each recording (truth) or homing (measured positions)."
        ),
    ] = "shared",
    prior: Annotated[
        Path | None,
        typer.Option(
            metavar="MODEL",
            help="Calibration of another day, tool or arm of the robot, by linear, poly2, "
            "poly2_ridge or rich_play, to be changed as far as a minute of recording says, or, "
            "whatever it is by, its zero as far as a few seconds do: estimator, features, joints "
            "and target are its own. With --touches or --points: an older model of this arm by any "
            "estimator, or a folder of three or more of other arms.",
        ),
    ] = None,
    reference: Annotated[
        list[str] | None,
        options.recordings(
            "--reference",
            "With --prior: recording that it was made from. What it leaves there is its own "
            "shortcoming and no change; ten seconds of the same motion are enough then.",
        ),
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
            "or more for 90 %, each after a homing of its own if that is to hold after any homing. "
            "Or 'cross': state it from those that are fitted to, each left out of one fit.",
        ),
    ] = None,
    interval_rezero_s: Annotated[
        float,
        typer.Option(help="State it for motions that begin with so much truth to re-zero from."),
    ] = 0.0,
    accept: Accept = None,
    part: options.Part = None,
    split: options.Split = None,
    seed: options.Seed = 0,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    files: Files,
    seen: Seen,
) -> None:
    """Fit a calibration to recordings that hold the true joint positions."""
    check_model_target(output, force)
    if seen.is_given:
        beside = (
            estimator, settings, features, joints, target, redundant, fit_rate_hz, test, interval,
            accept, part, split, interval_rezero_s, reference, zero != "shared", seed,
        )  # fmt: skip
        if any(beside):
            raise CalibrationError("touches or shots say what is fitted; leave out other options")
        calibrate_touched(recordings, seen, prior, output, files, force=force, as_json=as_json)
        return
    accepted = check_names(accept)
    is_cross = interval == [_CROSS]
    dataset = only_dataset(recordings)
    own = (
        estimator, settings, features, joints, target, redundant, zero != "shared", is_cross, seed,
    )  # fmt: skip
    unfitted = start(estimator, settings or [], dataset, features)
    changed = checked_prior(prior, reference, own)
    if dataset is not None:
        features = features or [dataset]
        fit_rate_hz = fit_rate_hz or truejoint.recordings.datasets.DATASETS[dataset].fit_rate
    inputs = chosen_features(features)
    read_training = files.find(
        recordings, part=part, split=split, held_out=False, joints=joints or [], inputs=inputs
    )
    others = (test or [], [] if is_cross else interval or [], reference or [])
    read_others = [files.find(names) for names in others]
    training, (testing, unseen, before) = read_training(), (read() for read in read_others)
    check = checked(training, accepted, joints=joints)
    say_failed(check)
    if check.failed:
        if as_json:
            result_json({"model": None, "check": check.to_dict()})
        raise typer.Exit(CHECK_FAILED)
    how = {"features": inputs, "joints": joints, "target": target, "fit_rate": fit_rate_hz}
    how["redundant"] = [] if redundant == [_NONE] else redundant
    how |= {"rezero": interval_rezero_s} if is_cross else {}
    fitted = (
        fit(training, unfitted, **how, zero=zero, random_state=seed, is_cross=is_cross)
        if changed is None
        else truejoint.calibration.adapted(
            changed, training, reference=before, fit_rate=fit_rate_hz
        ).with_metadata(command=command_line())
    )
    went_on = sorted({finding.name for finding in check.findings if finding.level == "fail"})
    fitted = fitted.with_metadata(accepted=went_on)
    fitted = with_accuracy(fitted, unseen, testing, interval_rezero_s)
    truejoint.write_calibration(fitted, output, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata, "check": check.to_dict()})
    else:
        if "choice" in fitted.metadata:
            print_choice(fitted)
        out.print(f"{output}: {fitted}", soft_wrap=True)


def checked_prior(
    prior: Path | None, reference: Sequence[str] | None, own: Sequence[object]
) -> truejoint.Calibration | None:
    """Read the prior, if there is one.

    Raises CalibrationError where any of what is its `own` was given beside it, or a reference
    without one.
    """
    if prior is None:
        if reference:
            raise CalibrationError("--reference: it is that of a prior; give --prior MODEL, too")
        return None
    if any(own):
        raise CalibrationError(
            "--prior: estimator, features, joints, target and zero are the prior's, and it "
            "takes no --interval cross and no --seed; leave these options out"
        )
    return truejoint.read_calibration(prior)


def start(
    estimator: str | None,
    settings: Sequence[str],
    dataset: str | None,
    features: Sequence[str] | None,
) -> Unfitted:
    """Say what is fitted, with the parameters that were given or suit a data set."""
    if estimator == AUTO:
        return choice(settings, dataset, default_features=dataset is not None and not features)
    return configured(estimator or DEFAULT, settings, dataset)


def fit(
    training: Sequence[truejoint.Recording],
    estimator: Unfitted,
    *,
    is_cross: bool = False,
    **how: Any,
) -> truejoint.Calibration:
    """Fit, showing progress; `how` as `calibrate` or, if `is_cross`, `cross_interval` takes it."""
    automatic = truejoint.calibration.Automatic
    named = "Choosing" if isinstance(estimator, automatic) else f"Fitting {estimator.name}"
    make = truejoint.calibration.cross_interval if is_cross else truejoint.calibrate
    with progress(named) as done:
        if isinstance(estimator, automatic):
            estimator = replace(estimator, tell=done.say)
        fitted = make(training, estimator, progress=done, **how)
    if fitted.metadata["outliers"]:
        say(f"  left out as gross outliers of the truth: {fitted.metadata['outliers']} rows")
    without = tuple(f"/{channel}" for channel in training[0].robot.unused_channels)
    constant = [name for name in fitted.metadata["unused_features"] if not name.endswith(without)]
    if constant:
        say(
            f"left out: {', '.join(constant)} never change in the training rows; the model does "
            "not know what they do"
        )
    return fitted.with_metadata(command=command_line())


def with_accuracy(
    fitted: truejoint.Calibration,
    unseen: Sequence[truejoint.Recording],
    testing: Sequence[truejoint.Recording],
    rezero: float,
) -> truejoint.Calibration:
    """State an interval by `unseen` recordings, and the accuracy on those to judge on, if any."""
    if unseen:
        with progress(f"Making an interval of {len(unseen)} recordings"):
            fitted = truejoint.calibration.with_interval(fitted, unseen, rezero=rezero)
    if not testing:
        return fitted
    judged = truejoint.evaluate(fitted, testing)
    if judged.domain is not None and judged.domain.inside < 1.0:
        flags = ", ".join(judged.domain.flags)
        say(f"outside the training: {1.0 - judged.domain.inside:.1%} of the test ({flags})")
    return fitted.with_metadata(held_out=judged.to_dict()["scores"])


def choice(
    settings: Sequence[str], dataset: str | None, *, default_features: bool
) -> truejoint.calibration.Automatic:
    """Say what `auto` tries, with the parameters that suit a data set."""
    if settings:
        raise CalibrationError(f"--set {settings[0]!r} needs one estimator; name it with -e")
    tried = truejoint.estimators.candidates()
    if dataset is not None:
        suited = truejoint.recordings.datasets.DATASETS[dataset].settings
        for one in tried:
            one.set_params(**suited.get(one.name, {}))
    return truejoint.calibration.Automatic(tried, default_features)


def print_choice(fitted: truejoint.Calibration) -> None:
    """Print what an automatic choice tried: RMSE on what was left out, and what was chosen."""
    told = fitted.metadata["choice"]
    units = [display_unit(fitted.units[f"measured/{joint}"]) for joint in fitted.joints]
    shown = list(zip(fitted.joints, units, strict=True))

    def row(name: str, of: Mapping[str, Any]) -> list[str]:
        rmse, weights = of.get("rmse", {}), of.get("weights", {})
        cells = [
            (f"{rmse[joint] * unit.scale:.3g}" if rmse else "-")
            + (f" ({weights[joint]:.0%})" if weights.get(joint) else "")
            for joint, unit in shown
        ]
        ratio = f"{of['ratio']:.2f}" if "ratio" in of else "-"
        return [name, str(len(of.get("features", ())) or ""), ratio, *cells, of.get("note", "")]

    rows = [row(one["estimator"], one) for one in told["tried"]]
    rows.append(row("chosen", told["chosen"]))
    header = ["estimator", "features", f"to {told['reference']}"]
    header += [f"{joint} [{unit.name}]" for joint, unit in shown]
    title = f"RMSE on {len(told['left_out'])} parts left out (share in what is chosen)"
    print_table([*header, "note"], rows, title=title)


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
    """Value of the kind of the default; several as ``50,50``, ``(50, 50)`` or ``[50, 50]``.

    What is found out where nothing is stated, None, is a whole number.
    """
    if isinstance(default, str):
        return text
    if isinstance(default, bool):
        if text.lower() not in {"true", "false"}:
            raise CalibrationError(f"--set {setting!r}: {text!r} is neither true nor false")
        return text.lower() == "true"
    several = isinstance(default, tuple)
    with suppress(ValueError):
        kind = int if default is None else type(default[0] if several else default)
        values = tuple(kind(value) for value in text.strip("()[], ").split(","))
        if several or len(values) == 1:
            return values if several else values[0]
    raise CalibrationError(
        f"--set {setting!r}: {text!r} is "
        + ("no whole number" if default is None else f"not of the kind of the default {default!r}")
    )
