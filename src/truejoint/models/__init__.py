"""What runs: features and fitted estimators as compiled rows over plain arrays."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.models.features import (
        Feature,
        FeatureSet,
        default_features,
        default_gap_limit,
        run_starts,
        sample_interval,
        time_steps,
    )

__all__ = [
    "Feature",
    "FeatureSet",
    "default_features",
    "default_gap_limit",
    "run_starts",
    "sample_interval",
    "time_steps",
]

_HOMES = {
    "Feature": "truejoint.models.features",
    "FeatureSet": "truejoint.models.features",
    "default_features": "truejoint.models.features",
    "default_gap_limit": "truejoint.models.features",
    "run_starts": "truejoint.models.features",
    "sample_interval": "truejoint.models.features",
    "time_steps": "truejoint.models.features",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.models' has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
