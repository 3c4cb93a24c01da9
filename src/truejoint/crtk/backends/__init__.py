"""Back ends of an `Arm`: a file for each kind of robot."""
