"""A general unscented Kalman filter and smoother in compiled kernels."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.filters.filter import (
        FilterResult,
        FilterState,
        Gate,
        SmoothedResult,
        UnscentedFilter,
    )
    from truejoint.filters.sigma_points import (
        FilterError,
        LambdaSigmaPoints,
        ScaledSigmaPoints,
    )
    from truejoint.filters.state_space import (
        StateSpaceModel,
        discretise,
        linear_model,
        van_loan,
    )
    from truejoint.filters.status import FilterStatus

__all__ = [
    "FilterError",
    "FilterResult",
    "FilterState",
    "FilterStatus",
    "Gate",
    "LambdaSigmaPoints",
    "ScaledSigmaPoints",
    "SmoothedResult",
    "StateSpaceModel",
    "UnscentedFilter",
    "discretise",
    "linear_model",
    "van_loan",
]

_HOMES = {
    **dict.fromkeys(
        ("FilterResult", "FilterState", "Gate", "SmoothedResult", "UnscentedFilter"), "filter"
    ),
    **dict.fromkeys(("FilterError", "LambdaSigmaPoints", "ScaledSigmaPoints"), "sigma_points"),
    **dict.fromkeys(("StateSpaceModel", "discretise", "linear_model", "van_loan"), "state_space"),
    "FilterStatus": "status",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
