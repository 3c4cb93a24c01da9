"""Where a calibration moves: ranges and speeds of some of a robot's joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from truejoint.array_types import Array


@dataclass(frozen=True, eq=False)
class Workspace:
    """Box of joint positions that a calibration covers; all arrays are (n_joints,).

    Attributes
    ----------
    joints : tuple of str
        In the order of every array.
    lower, upper : ndarray
        Range of each joint [rad or m].
    speed : ndarray
        Speed caps while following a path [rad/s or m/s].
    margin : ndarray, optional
        A random motion turns within this distance of either end [rad or m]; by default a tenth
        of the range.
    slowest, fastest : ndarray, optional
        Range of a random motion's peak speeds [rad/s or m/s]; by default from half of `speed`
        up to it.

    Examples
    --------
    >>> truejoint.get_robot("raven2").workspace.joints
    ('shoulder', 'elbow', 'insertion')
    """

    joints: tuple[str, ...]
    lower: Array
    upper: Array
    speed: Array
    margin: Array | None = None
    slowest: Array | None = None
    fastest: Array | None = None

    @property
    def centre(self) -> Array:
        """Middle of each range [rad or m] (peng2024 eq. 4)."""
        return np.asarray((self.lower + self.upper) / 2)

    @property
    def extent(self) -> Array:
        """Width of each range [rad or m] (peng2024 eq. 5)."""
        return np.asarray(self.upper - self.lower)

    @property
    def swings(self) -> Array:
        """Margin, slowest and fastest peak speed of a random motion (3, n_joints)."""
        margin = 0.1 * self.extent if self.margin is None else self.margin
        slowest = 0.5 * self.speed if self.slowest is None else self.slowest
        return np.stack([margin, slowest, self.speed if self.fastest is None else self.fastest])
