"""truejoint.cli."""
