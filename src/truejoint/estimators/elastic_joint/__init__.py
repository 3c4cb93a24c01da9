"""Unscented filter of an elastic joint with friction, measured at its motor side alone."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from truejoint.estimators.elastic_joint.filter import ElasticJointFilter, JointEstimate
    from truejoint.estimators.elastic_joint.model import ElasticJoint

__all__ = ["ElasticJoint", "ElasticJointFilter", "JointEstimate"]

# Imported on first use, so that a control loop gets the kernels without what fits them.
_HOMES = {"ElasticJoint": "model", "ElasticJointFilter": "filter", "JointEstimate": "filter"}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'truejoint.estimators.elastic_joint' has no {name!r}")
    return getattr(import_module(f"truejoint.estimators.elastic_joint.{_HOMES[name]}"), name)
