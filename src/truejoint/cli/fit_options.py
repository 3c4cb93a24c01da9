"""Options of `truejoint calibrate` that say what is fitted, and the estimator they name."""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias

import truejoint
from truejoint.cli import options
from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.registry import AUTO, DEFAULT

Unfitted: TypeAlias = "truejoint.estimators.JointRegressor | truejoint.calibration.Automatic"
"""What is fitted, or chosen."""

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

    def suited_to(self, dataset: str | None) -> "FitOptions":
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

    def inputs(self) -> "truejoint.features.FeatureSet | None":
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


def configured(
    name: str, settings: Sequence[str] | None = None, dataset: str | None = None
) -> "truejoint.estimators.JointRegressor":
    """Estimator with parameters set by texts like ``"epochs=400"``, after those of a data set."""
    estimator = truejoint.estimators.get_estimator(name)
    defaults = estimator.get_params()
    estimator.set_params(**_suited(name, dataset))
    for key, text in options.split_pairs("--set", settings, "NAME=VALUE").items():
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
