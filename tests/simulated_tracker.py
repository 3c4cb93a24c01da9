"""A tracker beside a simulated arm: noisy points or poses of a marker, on a clock of its own."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.robots.parts import Kinematics


@dataclass(frozen=True)
class SimulatedTracker:
    """How a tracker errs."""

    noise: float  # [m] per axis
    turn_noise: float = 0.0  # [rad] about each axis; 0: it sees points
    rate: float = 30.0  # [Hz]
    delay: float = 0.03  # [s] from a reading to its stamp
    lost: float = 0.05  # share of the time, in stretches of a second
    strays: float = 0.005  # share of the readings

    def see(
        self,
        kinematics: Kinematics,
        t: Array,
        joint: Array,
        tracker_from_base: Array,
        link_from_marker: Array,
        seed: int = 0,
    ) -> tuple[Array, Array, Array | None]:
        """Give readings of a marker that rides on the last link of `kinematics`."""
        random = np.random.default_rng([seed, 7])
        when = np.arange(t[0], t[-1], 1.0 / self.rate)
        then = np.column_stack([np.interp(when, t, column) for column in joint.T])
        pose = tracker_from_base @ kinematics.forward(then) @ link_from_marker
        m = len(when)
        position = pose[:, :3, 3] + self.noise * random.standard_normal((m, 3))
        stray = random.random(m) < self.strays
        position[stray] += random.uniform(-0.1, 0.1, (int(stray.sum()), 3))
        second = max(1, round(self.rate))
        hidden = random.random(-(-m // second)) < self.lost
        position[np.repeat(hidden, second)[:m]] = np.nan
        if not self.turn_noise:
            return when + self.delay, position, None
        wobble = Rotation.from_rotvec(self.turn_noise * random.standard_normal((m, 3)))
        turned = Rotation.from_matrix(pose[:, :3, :3]) * wobble
        return when + self.delay, position, turned.as_quat()


TRACKERS: Final[Mapping[str, SimulatedTracker]] = {
    "optical": SimulatedTracker(2.5e-4, rate=60.0),
    # Four spheres on a circle of 40 mm about the marker's origin: 0.25 mm / 40 mm / sqrt(2) each
    # way. [reasoned]
    "optical_pose": SimulatedTracker(2.5e-4, 4.4e-3, rate=60.0),
    "electromagnetic": SimulatedTracker(1e-3, rate=40.0),
    "rgbd": SimulatedTracker(7e-4, rate=30.0, delay=0.06),
}
"""By kind; how large their noise is, is usual for their kind; rates and delays are reasoned."""
