"""`truejoint calibrate`: fit a calibration to recordings with truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal, TypeAlias

import truejoint
from truejoint.cli.console import command_line, out, print_table, progress, say
from truejoint.cli.options import Result, split_pairs
from truejoint.cli.recording_options import DataCheck, Files, NewModel, only_dataset, say_failed
from truejoint.cli.show import is_model
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.registry import AUTO, DEFAULT
from truejoint.units import display_unit

Unfitted: TypeAlias = "truejoint.estimators.JointRegressor | truejoint.calibration.Automatic"
"""What is fitted, or chosen."""
_CROSS: Final = "cross"  # in place of recordings for an interval
_NONE: Final = "none"  # in place of redundant columns


@dataclass(frozen=True)
class FitOptions:
    """Estimator, features and joints to fit, an option each."""

    estimator: str | None = None
    settings: list[str] | None = None
    features: list[str] | None = None
    joints: list[str] | None = None
    target: Literal["error", "position"] | None = None
    redundant: list[str] | None = None
    fit_rate_hz: float | None = None
    zero: Literal["shared", "recording"] | None = None
    seed: int = 0

    def suited_to(self, dataset: str | None) -> FitOptions:
        """Take for what is not said what suits a public data set, if it is of one.

        An estimator that takes features of its own keeps these.
        """
        if dataset is None:
            return self
        named = self.estimator or DEFAULT
        free = named == AUTO or truejoint.estimators.get_estimator(named).family.inputs is None
        rate = truejoint.recordings.datasets.DATASETS[dataset].fit_rate
        stated = self.fit_rate_hz
        return replace(
            self,
            features=self.features or ([dataset] if free else None),
            fit_rate_hz=rate if stated is None else stated,
        )

    def unfitted(self, dataset: str | None) -> Unfitted:
        """Say what is fitted, with the parameters that were given or suit a data set."""
        named = self.estimator or DEFAULT
        if named != AUTO:
            return configured(named, self.settings, dataset)
        if self.settings:
            text = self.settings[0]
            raise CalibrationError(f"--set {text!r} needs one estimator; name it with -e")
        candidates = truejoint.estimators.candidates()
        for candidate in candidates:
            candidate.set_params(**_suited(candidate.name, dataset))
        return truejoint.calibration.Automatic(candidates)

    def inputs(self) -> truejoint.features.FeatureSet | None:
        """Features of their texts, where the name of a data set stands for those that suit it."""
        if not self.features:
            return None
        sets = truejoint.recordings.datasets.DATASETS
        chosen = (sets[text].features if text in sets else (text,) for text in self.features)
        return truejoint.features.FeatureSet.parse(feature for part in chosen for feature in part)

    def arguments(self) -> dict[str, Any]:
        """Arguments of `truejoint.calibrate` beside recordings and estimator."""
        return {
            "features": self.inputs(),
            "joints": self.joints,
            "target": self.target,
            "redundant": [] if self.redundant == [_NONE] else self.redundant,
            "fit_rate": self.fit_rate_hz,
            "random_state": self.seed,
            "zero": self.zero,
        }


def calibrate(
    recordings: list[str],
    new: NewModel,
    how: FitOptions,
    *,
    interval: list[str] | None = None,
    data_check: DataCheck,
    files: Files,
    part: str | None = None,
    split: str | None = None,
    like: list[str] | None = None,
) -> Result:
    """Fit a calibration to recordings that hold the true joint positions."""
    recordings, models = _like(like, recordings)
    is_cross = interval == [_CROSS]
    if models and is_cross:
        raise CalibrationError("--like goes with recordings for --interval; leave out cross")
    dataset = only_dataset(recordings)
    unfitted = how.unfitted(dataset)
    suited = how.suited_to(dataset).arguments()
    read_training = files.find(
        recordings, part=part, split=split, held_out=False, joints=how.joints or [],
        inputs=suited["features"],
    )  # fmt: skip
    read_unseen = files.find([] if is_cross else interval or [])
    training, unseen = read_training(), read_unseen()
    check = data_check.run(training, joints=how.joints)
    if check.failed:
        say_failed(check)
        return Result({"model": None, "check": check.to_dict()}, passed=False)
    fitted = fit(training, unfitted, **suited, is_cross=is_cross, models=models)
    if models:
        _print_like(fitted)
    if unseen:
        with progress(f"Making an interval of {len(unseen)} recordings"):
            fitted = truejoint.calibration.with_interval(fitted, unseen)
    overridden = sorted({finding.name for finding in check.findings if finding.level == "fail"})
    fitted = replace(fitted, origin=replace(fitted.origin, accepted=tuple(overridden)))
    new.write(fitted)
    if "choice" in fitted.metadata:
        print_choice(fitted)
    out.print(f"{new.output}: {fitted}", soft_wrap=True)
    return Result({"model": str(new.output), "metadata": fitted.facts, "check": check.to_dict()})


def _like(
    like: list[str] | None, recordings: list[str]
) -> tuple[list[str], list[truejoint.Calibration]]:
    """Read models of like instruments, files or folders; some may stand among the recordings."""
    if like is None:
        return recordings, []
    among = [name for name in recordings if is_model(Path(name))]
    paths = []
    for path in map(Path, [*like, *among]):
        paths += sorted(filter(is_model, path.iterdir())) if path.is_dir() else [path]
    if not paths:
        raise CalibrationError(f"--like {' '.join(like)}: no model file is there")
    rest = [name for name in recordings if name not in among]
    if not rest:
        raise CalibrationError(f"{' '.join(among)}: models alone; name a recording beside them")
    return rest, [truejoint.read_calibration(path) for path in paths]


def _print_like(fitted: truejoint.Calibration) -> None:
    """Print how much each of the models of like instruments weighs, or why they were left aside."""
    facts = fitted.metadata["like"]
    if "left_aside" in facts:
        say(f"left aside what --like names: {facts['left_aside']}")
        return
    names, weights = facts["models"], facts["weights"]
    rows = [[n, *(f"{100 * w[k]:.0f} %" for w in weights.values())] for k, n in enumerate(names)]
    print_table(["model", *weights], rows, title="Weights of models of like instruments")


def fit(
    training: Sequence[truejoint.Recording],
    estimator: Unfitted,
    *,
    is_cross: bool = False,
    models: Sequence[truejoint.Calibration] = (),
    **how: Any,
) -> truejoint.Calibration:
    """Fit, showing progress; `how` as `calibrate` or, if `is_cross`, `cross_interval` takes it.

    With `models` as `calibrate_like` does.
    """
    automatic = truejoint.calibration.Automatic
    named = "Choosing" if isinstance(estimator, automatic) else f"Fitting {estimator.name}"
    make: Any = truejoint.calibration.cross_interval if is_cross else truejoint.calibrate
    if models:
        named = f"Weighing {len(models)} models"
        make = partial(truejoint.calibration.calibrate_like, models=models)
    with progress(named) as done:
        if isinstance(estimator, automatic):
            estimator = replace(estimator, tell=done.say)
        fitted: truejoint.Calibration = make(training, estimator=estimator, progress=done, **how)
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


def configured(
    name: str, settings: Sequence[str] | None = None, dataset: str | None = None
) -> truejoint.estimators.JointRegressor:
    """Estimator with parameters set by texts like ``"epochs=400"``, after those of a data set."""
    estimator = truejoint.estimators.get_estimator(name)
    defaults = estimator.get_params()
    estimator.set_params(**_suited(name, dataset))
    for key, text in split_pairs("--set", settings, "NAME=VALUE").items():
        if key not in defaults:
            raise CalibrationError(f"--set {unknown(f'parameter of {name}', key, defaults)}")
        estimator.set_params(**{key: _value(text, defaults[key], f"{key}={text}")})
    estimator.check_params()
    return estimator


def _suited(name: str, dataset: str | None) -> Mapping[str, Any]:
    """Parameters of an estimator that suit a data set, if one is named."""
    if dataset is None:
        return {}
    return truejoint.recordings.datasets.DATASETS[dataset].settings.get(name, {})


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


def print_choice(fitted: truejoint.Calibration) -> None:
    """Print what an automatic choice tried: RMSE on what was left out, and what was chosen."""
    choice = fitted.metadata["choice"]
    columns = [(j, display_unit(fitted.units[f"measured/{j}"])) for j in fitted.joints]

    def row(name: str, of: Mapping[str, Any]) -> list[str]:
        rmse, weights = of.get("rmse", {}), of.get("weights", {})
        cells = [
            (f"{rmse[joint] * unit.scale:.3g}" if rmse else "-")
            + (f" ({weights[joint]:.0%})" if weights.get(joint) else "")
            for joint, unit in columns
        ]
        ratio = f"{of['ratio']:.2f}" if "ratio" in of else "-"
        took = f"{of['seconds']:.1f}" if "seconds" in of else ""
        n_features = str(len(of.get("features", ())) or "")
        step = f"{1e6 * of['step']:.2f}" if of.get("step") else ""
        size = f"{1e-3 * of['bytes']:.1f}" if of.get("step") else ""
        return [name, n_features, ratio, *cells, took, step, size]

    rows = [row(candidate["estimator"], candidate) for candidate in choice["tried"]]
    chosen = choice["chosen"]
    rows.append(row("chosen", chosen | {"seconds": fitted.metadata["fit_seconds"]}))
    for where in ("inside", "beyond"):  # what was learnt: parts of recordings, and whole ones
        rows += [row(f"chosen, {where}", {"rmse": chosen[where]})] if where in chosen else []
    header = ["estimator", "features", f"to {choice['reference']}"]
    header += [f"{joint} [{unit.name}]" for joint, unit in columns]
    if choice["not_in_all"]:
        say(f"not in every recording, so not learnt of: {', '.join(choice['not_in_all'])}")
    if choice.get("not_judged"):
        say(f"cut, as time ran short: parts left out {', '.join(choice['not_judged'])}")
    title = f"RMSE on {len(choice['left_out'])} parts left out (share in what is chosen)"
    header += ["time [s]", "step [us]", "[kB]"]
    print_table(header, rows, title=title)
    for candidate in choice["tried"]:
        if candidate["note"]:
            say(f"{candidate['estimator']}: {candidate['note']}")
    judged = choice.get("zero", {})
    if "note" in judged:
        say(f"a zero for each recording is not judged: {judged['note']}")
    elif judged:
        verdict = "kept for recordings that are re-zeroed" if judged["kept"] else "not kept"
        say(
            f"a zero for each recording: {judged['ratio']:.2f} of the error of one for all, after "
            f"{judged['rezeroed_from']:g} s of truth, on {len(judged['left_out'])} parts left out; "
            f"{verdict}"
        )
