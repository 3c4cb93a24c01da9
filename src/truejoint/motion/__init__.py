"""truejoint.motion."""
