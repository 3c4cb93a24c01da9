"""truejoint.estimators."""
