"""Errors for inputs that break a rule: one line that a user can act on."""

import re
from collections.abc import Iterable
from difflib import get_close_matches
from typing import Final

__all__ = [
    "CalibrationError", "CommandRefused", "ExportError", "ModelFileError", "MotionStopped",
    "NotArrived", "RecordingError", "RobotError", "RosError", "StudyError", "TrajectoryError",
    "TruejointError",
]  # fmt: skip

# Control characters but tab and line end, marks that turn the direction of text, half characters.
_UNSAFE: Final = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def unknown(kind: str, name: str, choices: Iterable[str]) -> str:
    """Say that no `kind` is called `name`, which one may be meant, and which there are."""
    names = list(choices)
    return f"no {kind} called {name!r:.60};{meant(name, names)} known: {', '.join(names) or 'none'}"


def meant(name: str, choices: Iterable[str]) -> str:
    """Ask whether the known name nearest to `name` is meant, after a blank; empty if none is."""
    asked, names = str(name), list(choices)
    near = get_close_matches(asked, names, max(1, len(names)))
    if asked.isdecimal():
        alike = [name for name in near if name.isdecimal() and len(name) == len(asked)]
        near = sorted(alike, key=lambda number: abs(int(number) - int(asked))) or near
    return f" did you mean {near[0]!r}?" if near else ""


def printable(text: str) -> str:
    r"""Text of anyone's as a person may see it: what could steer a terminal becomes an escape.

    So does a byte of a file's name that is no UTF-8. Terminal and pages pass all text through here.
    """
    return _UNSAFE.sub(_escape, text)


def _escape(match: re.Match[str]) -> str:
    code = ord(match[0])
    byte = code - 0xDC00 if 0xDC80 <= code <= 0xDCFF else code  # as `os.fsdecode` keeps bytes
    return chr(byte).encode("unicode_escape").decode()


def shown_text(value: object) -> object:
    """Give what a template shows of a value: `printable` text, unless it is markup already."""
    return printable(value) if isinstance(value, str) and not hasattr(value, "__html__") else value


def words(error: BaseException, most: int = 100) -> str:
    """Give what an exception says in one line, at most so many characters; its kind if nothing."""
    return (" ".join(str(error).split()) or type(error).__name__)[:most]


def other_kind(value: object, wanted: str, advice: str) -> str:
    """Say in one line that a value is not what is wanted, and what to do."""
    what = repr(value) if isinstance(value, str) else "this"
    kind, other = (
        f"{'an' if name[0] in 'AEIOaeio' else 'a'} {name}"
        for name in (type(value).__name__, wanted)
    )
    return f"{what:.60} is {kind}, not {other}; {advice}"


class TruejointError(ValueError):
    """Base of every error that a caller can cause; the message is one line and says what to do.

    The command line prints it without a traceback and exits with code 2.

    Examples
    --------
    >>> try:
    ...     truejoint.get_robot("raven3")
    ... except TruejointError as error:
    ...     print(str(error)[:50])
    no robot called 'raven3'; did you mean 'raven2'? k
    """


class RobotError(TruejointError):
    """A robot, an arm, a joint or a pose that does not exist or cannot be reached.

    Examples
    --------
    >>> get_robot("raven2", "middle")
    Traceback (most recent call last):
    truejoint.errors.RobotError: ...
    """


class CommandRefused(TruejointError):
    """An arm refused a command; the message says which rule the command broke.

    Examples
    --------
    >>> arm.move_jp([0.0])
    Traceback (most recent call last):
    truejoint.errors.CommandRefused: ...
    """


class NotArrived(CommandRefused):
    """A motion that is over, with a joint that is not where it was sent; the message says how far.

    Examples
    --------
    >>> str(NotArrived("move_jp is over, but elbow is 0.3 deg away from where it was sent"))[:18]
    'move_jp is over, b'
    """


class MotionStopped(CommandRefused):
    """A motion that was stopped before its end; the message says when, and how far along.

    Examples
    --------
    >>> motion = arm.move_jp(arm.robot.home + 0.1)
    >>> motion.cancel()
    >>> motion.wait()
    Traceback (most recent call last):
    truejoint.errors.MotionStopped: ...
    """


class RosError(TruejointError):
    """ROS, its master or a topic is not there, or a topic has come to a stop.

    Examples
    --------
    >>> truejoint.crtk.open_transport(3)
    Traceback (most recent call last):
    truejoint.errors.RosError: ...
    """


class TrajectoryError(TruejointError):
    """A trajectory that is malformed or leaves a robot's limits.

    Examples
    --------
    >>> truejoint.motion.zigzag(get_robot("raven2"), "J9")
    Traceback (most recent call last):
    truejoint.errors.TrajectoryError: ...
    """


class RecordingError(TruejointError):
    """A recording that cannot be read or does not hold what is asked of it.

    Examples
    --------
    >>> test.column("truth/elbow")
    Traceback (most recent call last):
    truejoint.errors.RecordingError: ...
    """


class ModelFileError(TruejointError):
    """A model file that is damaged, from a newer version or made for something else.

    Examples
    --------
    >>> read_calibration("none.safetensors")
    Traceback (most recent call last):
    truejoint.errors.ModelFileError: ...
    """


class CalibrationError(TruejointError):
    """A calibration that cannot be fitted to, or applied to, the recordings given.

    Examples
    --------
    >>> calibrate(training, "lienar")
    Traceback (most recent call last):
    truejoint.errors.CalibrationError: ...
    """


class StudyError(TruejointError):
    """A study that does not exist, cannot be run as asked, or of which a part failed.

    Examples
    --------
    >>> truejoint.studies.get_study("forceps")
    Traceback (most recent call last):
    truejoint.errors.StudyError: ...
    """


class ExportError(TruejointError):
    """A calibration that cannot be written as asked for use outside of Python.

    Examples
    --------
    >>> truejoint.export.export_c(model, "controller", prefix="2")
    Traceback (most recent call last):
    truejoint.errors.ExportError: ...
    """
