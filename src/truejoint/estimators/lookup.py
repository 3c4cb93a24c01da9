"""Estimators found by name, and by what runs them."""

from __future__ import annotations

from truejoint.errors import CalibrationError, unknown
from truejoint.estimators.base import JointRegressor
from truejoint.estimators.registry import OWN, estimator_names, plugged_in, registered
from truejoint.estimators.wrapped import WrappedRegressor, joint_regressor
from truejoint.plugins import call_plugin, load_plugin


def get_estimator(name: str) -> JointRegressor:
    """Unfitted estimator called `name`; raises CalibrationError naming the known ones.

    Examples
    --------
    >>> get_estimator("poly2").degree
    2
    """
    if name not in estimator_names():
        raise CalibrationError(unknown("estimator", name, estimator_names()))
    if name in OWN:
        return joint_regressor(registered(name))
    point = plugged_in()[name]
    return joint_regressor(call_plugin(point, load_plugin(point, type)))


def class_of(family: str) -> type[JointRegressor]:
    """Class of estimators whose family is called so: one by name, or what runs any family."""
    classes = (type(registered(name)) for name in OWN)
    return next((cls for cls in classes if cls.family.name == family), WrappedRegressor)
