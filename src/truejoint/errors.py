"""What truejoint raises when an input breaks a rule: one line that a user can act on."""


class TruejointError(ValueError):
    """Base of every error that a caller can cause; the message is one line and says what to do.

    The command line prints it without a traceback and exits with code 2.
    """


class RobotError(TruejointError):
    """A robot, an arm, a joint or a pose that does not exist or cannot be reached."""


class CommandRefused(TruejointError):
    """An arm refused a command; the message says which rule the command broke."""


class TrajectoryError(TruejointError):
    """A trajectory that is malformed or leaves a robot's limits."""


class RecordingError(TruejointError):
    """A recording that cannot be read or does not hold what is asked of it."""


class ModelFileError(TruejointError):
    """A model file that is damaged, from a newer version or made for something else."""


class CalibrationError(TruejointError):
    """A calibration that cannot be fitted to, or applied to, the recordings given."""


class StudyError(TruejointError):
    """A study that does not exist, cannot be run as asked, or of which a part failed."""


class ExportError(TruejointError):
    """A calibration that cannot be written as asked for use outside of Python."""
