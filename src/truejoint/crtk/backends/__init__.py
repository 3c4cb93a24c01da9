"""What may stand behind an `Arm`: the protocol, and a file for each kind of robot."""
