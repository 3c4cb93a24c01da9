"""truejoint.evaluation."""
