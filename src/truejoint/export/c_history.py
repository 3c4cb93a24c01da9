"""What the C templates of estimators that remember need to know of a fitted one."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from truejoint.errors import ExportError
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.friction_filter import FrictionFilter
from truejoint.estimators.gated_play import GatedPlay
from truejoint.estimators.jaw import MOTOR, RESET
from truejoint.estimators.jaw_filter import CompensatedJawFilter, JawFilter
from truejoint.estimators.play import BothPlay, CablesPlay, MotorPlay, ResetPlay
from truejoint.estimators.rational import _NEAREST
from truejoint.estimators.sequence import SequenceRegressor
from truejoint.filters import UnscentedFilter
from truejoint.filters.factors import _INDEFINITE, _PIVOT
from truejoint.filters.prediction import LIMIT
from truejoint.filters.state_space import covariance_factor
from truejoint.filters.status import FilterStatus

Array = NDArray[np.float64]

FILTER_MEANINGS: Final = {
    FilterStatus.OK: "everything measured was used",
    FilterStatus.MISSING: "nothing was measured: predicted only",
    FilterStatus.PARTIAL: "part of it is missing, as at first the speed: the rest was used",
    FilterStatus.INVALID_INPUT: "time step or input out of range: the state was held",
    FilterStatus.INVALID_MEASUREMENT: "an absurdly large measurement was treated as missing",
    FilterStatus.TRANSITION_FAILED: "the transition left the range: the state was held",
    FilterStatus.MEASUREMENT_FAILED: "the measurement function left the range: predicted only",
    FilterStatus.COVARIANCE_REPAIRED: "a negative term was left out of a covariance",
    FilterStatus.OUT_OF_RANGE: "the state would have left the range: this change was not made",
    FilterStatus.SINGULAR: "a predicted measurement has no variance: it was not used",
}
"""All bits but those of a gate, which no exported filter has."""


@dataclass(frozen=True)
class Field:
    """What the C of an estimator remembers between samples.

    Attributes
    ----------
    declaration : str
        Names and sizes in C.
    meaning : str
    type : str
        In C; the arithmetic's by default.
    """

    declaration: str
    meaning: str
    type: str = ""


def history_context(model: JointRegressor) -> tuple[str, dict[str, Any]]:
    """Template of a fitted estimator that remembers, and the values that it takes.

    The template defines ``static void predict(<prefix>_model *model, int fresh, real elapsed,
    const real *x, real *predicted)``. ``memory`` are the fields of the model's structure, ``room``
    is how many numbers it needs on the stack, ``is_filter`` says whether it has a
    `FilterStatus`.

    Raises
    ------
    ExportError
        If there is no template for the estimator.
    """
    family = model.family
    if isinstance(model, SequenceRegressor) and not model.causal:
        raise ExportError(f"estimator {family!r} uses later rows and cannot run in a controller")
    if family not in _CONTEXTS:
        raise ExportError(
            f"estimator {family!r:.60} has no C source; of those that remember, there are "
            f"{', '.join(_CONTEXTS)}"
        )
    template, context = _CONTEXTS[family]
    return template, context(model)


def filter_context(estimator: UnscentedFilter, spread: Array) -> dict[str, Any]:
    """Values of the template of the unscented filter.

    Parameters
    ----------
    estimator : UnscentedFilter
    spread : ndarray, shape (n, n)
        Covariance of the state that it starts from.

    Raises
    ------
    ExportError
        If the filter has an option that the C source does not know.
    """
    space, points = estimator.model, estimator.sigma_points
    n, m, inputs = len(space.states), len(space.measurements), len(space.inputs)
    plain = estimator.second_generation and not estimator.square_root and estimator.gate is None
    if not plain or space.angles or not callable(space.process_noise):
        raise ExportError(
            "only filters with second-generation sigma points and a process noise function have C "
            "source: no square-root form, no gate, no angles"
        )
    reach, correction = points.reach(n), points.centre_correction
    widest, rows = max(n, m), max(3 * n, 2 * n + m) + 1
    return {
        "n": n,
        "m": m,
        "inputs": inputs,
        "widest": widest,
        "stack_size": rows * widest,
        "theta": np.asarray(space.parameters),
        "pivot": _PIVOT,
        "indefinite": _INDEFINITE,
        "limit": LIMIT,
        "reach": reach,
        "root_weight": float(np.sqrt(0.5) / reach),
        "correction": correction,
        "root_correction": float(np.sqrt(abs(correction))),
        "sensor_factor": covariance_factor(np.asarray(space.measurement_noise)),
        "first_covariance": spread,
        "first_factor": covariance_factor(spread),
        "is_filter": True,
        "room": 6 * n + 4 * n * n + rows * widest + 3 * n * m + 3 * m * m + 3 * m + widest,
    }


def _filter_memory(n: int, m: int, states: str) -> list[Field]:
    return [
        Field("filter_status", "FILTER bits of the last sample that was used", "int"),
        Field(f"x[{n}]", f"state: {states}"),
        Field(f"covariance[{n * n}]", "of the state"),
        Field(f"factor[{n * n}]", "its lower factor"),
        Field(f"noise[{n * n}]", "lower factor of the last step's process noise"),
        Field(f"innovation[{m}]", "measured less predicted, NaN where nothing was measured"),
        Field("nis", "normalised innovation squared"),
    ]


def _jaw_filter(model: JawFilter) -> dict[str, Any]:
    mechanics = model.mechanics
    context: dict[str, Any] = {
        **filter_context(model._filter, model._spread()),
        "memory": [
            *_filter_memory(4, 2, "jaw [rad], its speed, reset cable [m], its speed"),
            Field("motor, reset", "motor angle [rad] and displacement [m] of the last sample"),
            Field("injected", "what (26) added to the state [rad]"),
        ],
        "reading": "constant",
        "drive_stiffness": mechanics.drive_stiffness,
        "reset_stiffness": mechanics.reset_stiffness,
        "wheel_radius": mechanics.wheel_radius,
        "gear_ratio": mechanics.gear_ratio,
        "angle_divisor": (mechanics.drive_stiffness + mechanics.reset_stiffness)
        * mechanics.jaw_radius,
        "nearest": _NEAREST,
    }
    if isinstance(model, CompensatedJawFilter):
        return context | {
            "reading": model.reading,
            "error_scale": model.error_model_.scale,
            "error_coefficient": model.error_model_.coefficients,
            "loop_gain": float(model.loop_gain_[0]),
        }
    return context | {"constant": float(model.constant_[0])}


def _friction_filter(model: FrictionFilter) -> dict[str, Any]:
    n = len(model.widths) + 1
    _mean, spread = model._prior()
    return {
        **filter_context(model._filter, spread),
        "memory": [
            *_filter_memory(n, 1, "elements, -1 to 1, then the load [Nm]"),
            Field("reset", "displacement of the last sample [m]"),
        ],
        "degree": len(model.angle_) - n,  # a constant, powers and n - 1 elements
        "angle": model.angle_,
        "scale": float(model.scale_[0]),
        "drive_factor": model.wheel_radius / model.gear_ratio,
    }


_Play = MotorPlay | ResetPlay | BothPlay | CablesPlay


def _regression(model: _Play, inputs: tuple[str, ...]) -> dict[str, Any]:
    """Values of one weighted sum on banks; `inputs` are the columns that it finds itself in."""
    signals = {
        "play_motor": (MOTOR,),
        "play_reset": (RESET,),
        "play_both": (RESET, MOTOR),
        "play_cables": (RESET, "cable/drive"),
    }[model.family]
    banks, first = [], 0
    for bank, signal in zip(model._banks(), signals, strict=True):
        banks.append(
            {
                "signal": signal,
                "column": inputs.index(signal),
                "factor": model.wheel_radius / model.gear_ratio
                if signal == MOTOR and not isinstance(model, (ResetPlay, CablesPlay))
                else None,
                "scale": bank.scale,
                "widths": bank.widths,
                "first": first,
            }
        )
        first += bank.size
    return {
        "banks": banks,
        "degree": int(model.degree),
        "pairs": model._pairs,
        "weights": model.weights_,
        "constant": float(model.constant_[0]),
    }


def _plays(regressions: list[dict[str, Any]], gate: float | None) -> dict[str, Any]:
    return {
        "regressions": regressions,
        "gate": gate,
        "memory": [
            Field(
                f"play_{k}_{i}[{len(bank['widths'])}]",
                f"outputs of the plays on {bank['signal']} [m]",
            )
            for k, regression in enumerate(regressions)
            for i, bank in enumerate(regression["banks"])
        ],
        "is_filter": False,
        "room": max(len(regression["weights"]) for regression in regressions),
    }


def _play(model: _Play) -> dict[str, Any]:
    return _plays([_regression(model, model.inputs)], None)


def _gated(model: GatedPlay) -> dict[str, Any]:
    parts = (model.reset_, model.both_)
    return _plays([_regression(part, model.inputs) for part in parts], model.gate_angle)


_CONTEXTS: Final[Mapping[str, tuple[str, Callable[[Any], dict[str, Any]]]]] = {
    "play_motor": ("play.c.j2", _play),
    "play_reset": ("play.c.j2", _play),
    "play_both": ("play.c.j2", _play),
    "play_cables": ("play.c.j2", _play),
    "play_gated": ("play.c.j2", _gated),
    "ukf": ("jaw_filter.c.j2", _jaw_filter),
    "ukf_compensated": ("jaw_filter.c.j2", _jaw_filter),
    "ukf_friction": ("friction_filter.c.j2", _friction_filter),
}
