"""The inverse of a calibration along the way that is wanted: what will be lost, before it is.

At a reversal, motors run through play before a joint follows. A loop that only makes up for what
is lost already lets the joint stand meanwhile; one that is told where its set-points will lose how
much takes the motors through at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array
from truejoint.calibration.encoding import as_calibration
from truejoint.errors import CommandRefused
from truejoint.robots import Robot

if TYPE_CHECKING:  # what learns is given
    from truejoint.calibration import Calibration
    from truejoint.calibration.calibration import OnlineState

_GAIN: Final = 0.4  # share of what is missing that it moves on by, at every step


class FeedForward:
    """What a calibration of positions alone says is lost, at set-points and where motors are.

    At every step a set-point goes on by most of what a joint, by the calibration, would be missing
    there; its plays remember the way that it has gone. A `Compensator` makes up at once for what is
    lost at that set-point, and by its corrector for what differs from that where the motors are.

    Parameters
    ----------
    calibration : Calibration
        Whose inputs are of ``measured/<joint>`` of the joints that it corrects, and of
        ``motor/<joint>`` where the robot's transmission makes these of them: play operators say
        most, and a line nothing.
    robot : Robot

    Attributes
    ----------
    joints : tuple of str
    expected, forward : ndarray, shape (n_joints,)
        True less measured positions [rad or m] where the motors are, and at the set-points.

    Raises
    ------
    CommandRefused
        If an input is of anything else, such as an effort: nothing tells what that will be.
    CalibrationError
        If it is none, or of another arm.

    Examples
    --------
    >>> still = calibrate(training, "linear", features=["measured/jaw"])
    >>> FeedForward(still, training[0].robot).joints
    ('jaw',)
    """

    def __init__(self, calibration: Calibration, robot: Robot) -> None:
        as_calibration(calibration).check_robot(robot)
        self.joints: Final = calibration.joints
        self._calibration = calibration
        self._signals = _signals(calibration, robot)
        self.start(np.zeros(len(self.joints)))

    def start(self, setpoint: ArrayLike) -> None:
        """Begin at rest at set-points (n_joints,) [rad or m]; what friction holds is forgotten."""
        # New arrays and states: of a copy that is started, nothing is shared with the original.
        self.expected, self.forward, self._setpoint = np.zeros((3, len(self.joints)))
        self._setpoint[:] = setpoint
        self._now, self._ahead = self._calibration.start(), self._calibration.start()
        self._t = 0.0

    def step(self, dt: float, measured: ArrayLike, wanted: ArrayLike) -> None:
        """Go on by `dt` [s], to where joints are `measured` and `wanted` (n_joints,) [rad or m].

        Where one of them is no number, all stays as it was.
        """
        here, there = np.asarray(measured, dtype=np.float64), np.asarray(wanted, dtype=np.float64)
        if not (np.isfinite(here).all() and np.isfinite(there).all()):
            return
        self._t += dt
        self.expected[:] = self._joint(self._now, here) - here
        if self._t > dt:
            self._setpoint += _GAIN * (there - self._setpoint - self.forward)
        self.forward[:] = self._joint(self._ahead, self._setpoint) - self._setpoint

    def _joint(self, state: OnlineState, motor: Array) -> Array:
        """Where the joints are (n_joints,) when the measured positions have come to `motor`."""
        return self._calibration.step(state, self._t, self._signals @ motor)


def _signals(calibration: Calibration, robot: Robot) -> Array:
    """Each signal of a calibration (n_signals, n_joints) per position of its joints."""
    joints, rows = list(calibration.joints), []
    for signal in calibration.signals:
        quantity, _, name = signal.partition("/")
        whole = np.zeros(len(robot.joints))
        if quantity == "measured" and name in robot.joint_names:
            whole[robot.joint_names.index(name)] = 1.0
        elif quantity == "motor" and name in robot.joint_names and robot.transmission is not None:
            whole = robot.transmission.matrix[robot.joint_names.index(name)]
        own = whole[robot.index(joints)]
        if not own.any() or np.count_nonzero(own) < np.count_nonzero(whole):
            raise CommandRefused(
                f"feed-forward: {signal} does not follow from where {', '.join(joints)} are; "
                "calibrate on measured positions, and motors, of these joints alone"
            )
        rows.append(own)
    return np.array(rows)
