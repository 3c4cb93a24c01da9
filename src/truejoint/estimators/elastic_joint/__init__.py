"""Unscented filter of an elastic joint with friction, measured at its motor side alone."""

from truejoint.estimators.elastic_joint.filter import ElasticJointFilter, JointEstimate
from truejoint.estimators.elastic_joint.model import ElasticJoint

__all__ = ["ElasticJoint", "ElasticJointFilter", "JointEstimate"]
