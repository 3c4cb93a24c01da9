"""truejoint.simulation."""
