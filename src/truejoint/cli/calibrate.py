"""`truejoint calibrate`: fit a calibration to recordings and keep it in a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Final

import typer

import truejoint
from truejoint.cli import options
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
from truejoint.cli.wanted import Prior, Unfitted, Wanted
from truejoint.errors import CalibrationError
from truejoint.units import display_unit

_CROSS: Final = "cross"  # in place of recordings for an interval


@dataclass(frozen=True)
class Stated:
    """What the file is to say of its accuracy, and of what recordings, an option each."""

    test: Annotated[
        list[str] | None,
        options.recordings("--test", "Recording to judge on; the accuracy goes into the file."),
    ] = None
    interval: Annotated[
        list[str] | None,
        options.recordings(
            "--interval",
            "Recording that the fit does not see, to state how far off positions may be: 9 "
            "or more for 90 %, each after a homing of its own if that is to hold after any homing. "
            "Or 'cross': state it from those that are fitted to, each left out of one fit.",
        ),
    ] = None
    interval_rezero_s: Annotated[
        float,
        typer.Option(help="State it for motions that begin with so much truth to re-zero from."),
    ] = 0.0

    def __post_init__(self) -> None:
        if self.interval_rezero_s and not self.interval:
            raise CalibrationError("--interval-rezero-s is of an interval; give --interval, too")

    @property
    def is_cross(self) -> bool:
        """Whether the interval is made of the recordings that are fitted to."""
        return self.interval == [_CROSS]

    @property
    def unseen(self) -> list[str]:
        """Recordings for the interval alone."""
        return [] if self.is_cross else self.interval or []


@takes(wanted=Wanted, prior=Prior, stated=Stated, files=Files, seen=Seen)
def calibrate(
    recordings: options.Recordings,
    output: Annotated[Path, typer.Option("--out", "-o", help="Model file to write.")],
    *,
    wanted: Wanted,
    prior: Prior,
    stated: Stated,
    accept: Accept = None,
    part: options.Part = None,
    split: options.Split = None,
    force: options.Force = False,
    as_json: options.Json = False,
    files: Files,
    seen: Seen,
) -> None:
    """Fit a calibration to recordings that hold the true joint positions."""
    check_model_target(output, force)
    if seen.is_given:
        beside = (prior.reference, accept, part, split)
        if any(beside) or (wanted, stated) != (Wanted(), Stated()):
            raise CalibrationError("touches or shots say what is fitted; leave out other options")
        calibrate_touched(
            recordings, seen, prior.prior, output, files, force=force, as_json=as_json
        )
        return
    accepted = check_names(accept)
    dataset = only_dataset(recordings)
    unfitted = wanted.unfitted(dataset)
    changed = prior.read(wanted, is_cross=stated.is_cross)
    wanted = wanted.suited_to(dataset)
    how = wanted.how()
    read_training = files.find(
        recordings, part=part, split=split, held_out=False, joints=wanted.joints or [],
        inputs=how["features"],
    )  # fmt: skip
    others = (stated.test or [], stated.unseen, prior.reference or [])
    read_others = [files.find(names) for names in others]
    training, (testing, unseen, before) = read_training(), (read() for read in read_others)
    check = checked(training, accepted, joints=wanted.joints)
    say_failed(check)
    if check.failed:
        if as_json:
            result_json({"model": None, "check": check.to_dict()})
        raise typer.Exit(CHECK_FAILED)
    how |= {"rezero": stated.interval_rezero_s} if stated.is_cross else {}
    fitted = (
        fit(training, unfitted, **how, is_cross=stated.is_cross)
        if changed is None
        else truejoint.calibration.adapted(
            changed, training, reference=before, fit_rate=wanted.fit_rate_hz
        ).with_metadata(command=command_line())
    )
    went_on = sorted({finding.name for finding in check.findings if finding.level == "fail"})
    fitted = fitted.with_metadata(accepted=went_on)
    fitted = with_accuracy(fitted, unseen, testing, stated.interval_rezero_s)
    truejoint.write_calibration(fitted, output, overwrite=force)
    if as_json:
        result_json({"model": str(output), "metadata": fitted.metadata, "check": check.to_dict()})
    else:
        if "choice" in fitted.metadata:
            print_choice(fitted)
        out.print(f"{output}: {fitted}", soft_wrap=True)


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
        took = f"{of['seconds']:.1f}" if "seconds" in of else ""
        n_features = str(len(of.get("features", ())) or "")
        return [name, n_features, ratio, *cells, took, of.get("note", "")]

    rows = [row(one["estimator"], one) for one in told["tried"]]
    rows.append(row("chosen", told["chosen"] | {"seconds": fitted.metadata["fit_seconds"]}))
    header = ["estimator", "features", f"to {told['reference']}"]
    header += [f"{joint} [{unit.name}]" for joint, unit in shown]
    if told["not_in_all"]:
        say(f"not in every recording, so not learnt of: {', '.join(told['not_in_all'])}")
    title = f"RMSE on {len(told['left_out'])} parts left out (share in what is chosen)"
    print_table([*header, "time [s]", "note"], rows, title=title)
    if "zero" in told:
        say(zeros_in_words(told["zero"]))


def zeros_in_words(judged: Mapping[str, Any]) -> str:
    """Tell whether a zero for each recording is kept beside, and how much better it was."""
    if "note" in judged:
        return f"a zero for each recording is not judged: {judged['note']}"
    verdict = "kept for recordings that are re-zeroed" if judged["kept"] else "not kept"
    return (
        f"a zero for each recording: {judged['ratio']:.2f} of the error of one for all, after "
        f"{judged['rezeroed_from']:g} s of truth, on {len(judged['left_out'])} parts left out; "
        f"{verdict}"
    )
