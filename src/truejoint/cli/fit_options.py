"""Options of `truejoint calibrate` that say what is fitted, and the estimator they name."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal, TypeAlias

import typer

import truejoint
from truejoint.cli import complete, options
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.registry import AUTO, DEFAULT, OWN

Unfitted: TypeAlias = "truejoint.estimators.JointRegressor | truejoint.calibration.Automatic"
"""What is fitted, or chosen."""

_NONE: Final = "none"  # in place of redundant columns


@dataclass(frozen=True)
class FitOptions:
    """Estimator, features and joints to fit, an option each."""

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
    ] = None
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="NAME=VALUE",
            help="Its parameter, as epochs=400 or hidden_layer_sizes=50,50.",
            autocompletion=complete.settings,
        ),
    ] = None
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
    ] = None
    joints: Annotated[
        list[str] | None,
        typer.Option(
            "--joint",
            help="Joint to correct; default: all with truth.",
            autocompletion=complete.joints,
        ),
    ] = None
    target: Annotated[
        Literal["error", "position"] | None,
        typer.Option(help="What the model predicts: error (the default) or position."),
    ] = None
    redundant: Annotated[
        list[str] | None,
        typer.Option(
            "--redundant",
            metavar="COLUMN",
            help="Column, such as 'motor/elbow', by which the loop checks measured positions; give "
            "it once for each, or 'none'. Default: every motor, driver and setpoint that tells.",
            autocompletion=complete.features,
        ),
    ] = None
    fit_rate_hz: options.FitRateHz = None
    zero: Annotated[
        Literal["shared", "recording", "homing"] | None,
        typer.Option(
            help="Whether the recordings share one zero, or a second fit, for motions that begin "
            "with re-zeroing, takes one for each recording (truth) or homing (measured positions). "
            f"Default: shared; with {AUTO}, one for each recording where that is better."
        ),
    ] = None
    seed: options.Seed = 0

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
        settings = self.settings or []
        if self.estimator == AUTO:
            suited = dataset is not None and not self.features
            return choice(settings, dataset, default_features=suited)
        return configured(self.estimator or DEFAULT, settings, dataset)

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
