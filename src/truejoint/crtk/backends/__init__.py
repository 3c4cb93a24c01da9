"""What may stand behind an `Arm`: a file for each kind of robot."""
