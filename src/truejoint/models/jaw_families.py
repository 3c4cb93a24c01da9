"""The rules of the jaw's estimators: parameters and arrays, without what fits them."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, Final, Literal, get_args

from truejoint.errors import CalibrationError
from truejoint.models.families import Family, Shape, is_integer, is_number
from truejoint.models.friction_filter import DEGREE
from truejoint.models.jaw_kernels import COEFFICIENTS, OBSERVED
from truejoint.models.play_banks import BANK_WIDTHS, count_columns, default_widths

Method = Literal["projection", "quasi_newton", "global"]
Reading = Literal["output", "scaled", "signed", "literal"]
Params = Mapping[str, Any]

METHODS: Final = get_args(Method)
READINGS: Final = get_args(Reading)
LARGEST: Final = 1e12
"""Largest parameter, and the inverse of the smallest: squares of their products stay finite."""

_PHYSICAL: Final = (
    "drive_stiffness", "reset_stiffness", "spring_stiffness", "jaw_inertia", "slider_mass",
    "gear_ratio", "wheel_radius", "jaw_radius", "jaw_friction", "slider_friction",
    "correlation_time", "displacement_noise", "speed_noise",
)  # fmt: skip
_FRICTION: Final = (
    "drive_stiffness", "load_drift", "friction_drift", "error_time", "gear_ratio", "wheel_radius",
    "jaw_radius",
)  # fmt: skip
_GEAR: Final = ("gear_ratio", "wheel_radius")


def check_numbers(owner: str, positive: Params, *, zero: bool = False) -> None:
    """Raise CalibrationError unless all values are numbers above 0 (or 0, if allowed)."""
    for name, value in positive.items():
        if not is_number(value, 1.0 / LARGEST, LARGEST) and not (zero and value == 0.0):
            rule = "0 or more" if zero else "above 0"
            raise CalibrationError(
                f"{owner}: {name} is {value!r:.60}; give a number {rule}, {1 / LARGEST:g} to "
                f"{LARGEST:g}"
            )


def _check_method(params: Params) -> None:
    if params["fit_method"] not in METHODS:
        raise CalibrationError(
            f"fit method {params['fit_method']!r:.60}; choose one of {', '.join(METHODS)}"
        )


def _check_filter(family: str, params: Params) -> None:
    check_numbers(family, {name: params[name] for name in _PHYSICAL})
    if not is_number(params["lambda_"], -4.0 + 1e-6, 1e6):
        raise CalibrationError(f"{family}: lambda_ is {params['lambda_']!r:.60}; give it above -4")


def _check_compensated(params: Params) -> None:
    _check_filter("ukf_compensated", params)
    if params["reading"] not in READINGS:
        raise CalibrationError(
            f"reading {params['reading']!r:.60} of (26); choose one of {', '.join(READINGS)}"
        )
    _check_method(params)


def _check_friction(family: str, params: Params) -> None:
    check_numbers(family, {name: params[name] for name in _FRICTION})
    widths = params["widths"]
    good = isinstance(widths, tuple) and 1 <= len(widths) <= 16
    if not good or not all(is_number(w, 1e-9, 1.0) for w in widths):
        raise CalibrationError(
            f"{family}: widths is {widths!r:.60}; give 1 to 16 lengths in metres"
        )


def _check_play(family: str, params: Params) -> None:
    if not is_integer(params["degree"], 1, 8):
        raise CalibrationError(
            f"{family}: degree {params['degree']!r:.60} is not an integer from 1 to 8"
        )
    check_numbers(family, {"penalty": params["penalty"]}, zero=True)
    for name in BANK_WIDTHS[family]:
        value = params[name]
        good = isinstance(value, tuple) and 1 <= len(value) <= 64
        if not good or not all(is_number(w, 1e-9, 1.0) for w in value):
            raise CalibrationError(
                f"{family}: {name} is {value!r:.60}; give 1 to 64 half-widths in metres"
            )
    check_numbers(family, {name: params[name] for name in _GEAR if name in params})


def _check_nothing(_params: Params) -> None:
    """There are no parameters."""


def _sized(
    family: str,
    inputs: int,
    shapes: Mapping[str, Shape],
    _params: Params,
    n_features: int,
    n_outputs: int,
) -> dict[str, Shape]:
    """Shapes that do not depend on the parameters."""
    check_size(family, inputs, n_features, n_outputs)
    return dict(shapes)


def check_size(family: str, inputs: int, n_features: int, n_outputs: int) -> None:
    """Raise CalibrationError unless a model is for one jaw, with as many features as it takes."""
    if (n_features, n_outputs) != (inputs, 1):
        raise CalibrationError(
            f"{family} estimates one jaw from {inputs} features, not {n_outputs} joints from "
            f"{n_features}"
        )


def _friction_shapes(
    family: str, params: Params, n_features: int, n_outputs: int
) -> dict[str, Shape]:
    check_size(family, 2, n_features, n_outputs)
    count = 1 + DEGREE + len(params["widths"])
    return {
        "angle": (count,),
        "drive": (count,),
        "scale": (1,),
        "misfit": (2,),
        "interval": (1,),
    }


def _play_shapes(family: str, params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    banks = BANK_WIDTHS[family]
    check_size(family, len(banks), n_features, n_outputs)
    count = count_columns(int(params["degree"]), [len(params[name]) for name in banks])
    return {"scale": (len(banks),), "weights": (count,), "constant": (1,)}


def _check_gated(params: Params) -> None:
    check_numbers("play_gated", params)


def _gated_shapes(_params: Params, n_features: int, n_outputs: int) -> dict[str, Shape]:
    check_size("play_gated", 2, n_features, n_outputs)
    reset = _play_shapes("play_reset", default_widths("play_reset"), 1, 1)
    both = _play_shapes("play_both", default_widths("play_both"), 2, 1)
    return {
        **{f"reset_{name}": shape for name, shape in reset.items()},
        **{f"both_{name}": shape for name, shape in both.items()},
        "gate_angle": (1,),
    }


def _play(family: str, *others: str) -> Family:
    return Family(
        frozenset({"degree", "penalty", *BANK_WIDTHS[family], *others}),
        partial(_check_play, family),
        partial(_play_shapes, family),
    )


def _friction(family: str, *, causal: bool = True) -> Family:
    return Family(
        frozenset({*_FRICTION, "widths"}),
        partial(_check_friction, family),
        partial(_friction_shapes, family),
        causal=causal,
    )


_LEAST_SQUARES: Final = {"coef": (OBSERVED,), "constant": (1,)}
_ERROR_MODEL: Final = {"scale": (2,), "coefficients": (COEFFICIENTS,), "loop_gain": (1,)}

JAW_FAMILIES: Final[Mapping[str, Family]] = {
    "lsm": Family(
        frozenset(), _check_nothing, partial(_sized, "lsm", 2, _LEAST_SQUARES), counts_samples=True
    ),
    "lsm_intercept": Family(
        frozenset(),
        _check_nothing,
        partial(_sized, "lsm_intercept", 2, _LEAST_SQUARES),
        counts_samples=True,
    ),
    "lsm_compensated": Family(
        frozenset({"fit_method"}),
        _check_method,
        partial(
            _sized,
            "lsm_compensated",
            3,
            {**_LEAST_SQUARES, "scale": (2,), "error_coef": (COEFFICIENTS,)},
        ),
        counts_samples=True,
    ),
    "ukf": Family(
        frozenset({*_PHYSICAL, "lambda_"}),
        partial(_check_filter, "ukf"),
        partial(_sized, "ukf", 2, {"constant": (1,)}),
        counts_samples=True,
    ),
    "ukf_compensated": Family(
        frozenset({*_PHYSICAL, "lambda_", "reading", "fit_method"}),
        _check_compensated,
        partial(_sized, "ukf_compensated", 2, _ERROR_MODEL),
        counts_samples=True,
    ),
    "play_motor": _play("play_motor", *_GEAR),
    "play_reset": _play("play_reset"),
    "play_both": _play("play_both", *_GEAR),
    "play_cables": _play("play_cables"),
    "play_gated": Family(frozenset({"gate", "smallest_gate"}), _check_gated, _gated_shapes),
    "ukf_friction": _friction("ukf_friction"),
    "ukf_friction_smoothed": _friction("ukf_friction_smoothed", causal=False),
}
"""Rules by the name that stands in model files."""
