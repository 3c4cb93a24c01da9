"""The rules of the elastic joint's filter: parameters and arrays, without what fits them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from truejoint.errors import CalibrationError
from truejoint.models.elastic_joint import NOISE, SCALES, count_terms
from truejoint.models.families import Family, Shape, is_integer, is_number

_FAMILY: Final = "ukf_elastic"


def _check(params: Mapping[str, Any]) -> None:
    rules = {
        "elements": (is_integer(params["elements"], 1, 12), "an integer from 1 to 12"),
        "load_drift": (is_number(params["load_drift"], 0.0, 1e3), "from 0 to 1000"),
        "torque_noise": (is_number(params["torque_noise"], 1e-6, 1e3), "from 1e-6 to 1000"),
    }
    for name, (good, rule) in rules.items():
        if not good:
            raise CalibrationError(f"{_FAMILY}: {name} is {params[name]!r:.60}; it must be {rule}")


def _shapes(params: Mapping[str, Any], n_features: int, n_outputs: int) -> dict[str, Shape]:
    if n_features != 2 or n_outputs > 2:
        raise CalibrationError(
            f"{_FAMILY} estimates a jaw's angle and torque from 2 features, not {n_outputs} "
            f"outputs from {n_features}"
        )
    elements = int(params["elements"])
    terms = count_terms(elements)
    return {
        "scales": (len(SCALES),),
        "noise": (len(NOISE),),
        "widths": (elements,),
        "torque": (terms,),
        "outputs": (n_outputs, terms + 2),
        "misfit": (n_outputs,),
    }


ELASTIC_FAMILIES: Final[Mapping[str, Family]] = {
    _FAMILY: Family(frozenset({"elements", "load_drift", "torque_noise"}), _check, _shapes)
}
"""Rules by the name that stands in model files."""
