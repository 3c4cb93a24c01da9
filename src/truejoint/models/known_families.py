"""The rules of every family of estimators, by the name that stands in model files."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from truejoint.errors import CalibrationError
from truejoint.models.elastic_families import ELASTIC_FAMILIES
from truejoint.models.families import (
    REGRESSORS,
    EstimatorData,
    Family,
    check_arrays,
    check_names,
)
from truejoint.models.jaw_families import JAW_FAMILIES

FAMILIES: Final[Mapping[str, Family]] = {**REGRESSORS, **JAW_FAMILIES, **ELASTIC_FAMILIES}
"""Every family; nothing here imports scikit-learn."""


def family_of(data: EstimatorData) -> Family:
    """Rules of a fitted estimator's family; raises CalibrationError naming the known ones."""
    family = FAMILIES.get(data.family)
    if family is None:
        raise CalibrationError(
            f"no estimator family {data.family!r:.60}; known: {', '.join(FAMILIES)}"
        )
    return family


def check_data(data: EstimatorData, n_features: int, n_outputs: int) -> None:
    """Raise CalibrationError when parameters or arrays are not those of the family.

    Parameters
    ----------
    data : EstimatorData
    n_features, n_outputs : int
    """
    family = family_of(data)
    check_names(data.family, data.params, family.parameters)
    family.check(data.params)
    check_arrays(data.family, data.arrays, family.shapes(data.params, n_features, n_outputs))
