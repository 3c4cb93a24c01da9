"""Where a tracker stands beside a robot: what a person states of it, and what the fit says."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from scipy.spatial.transform import Rotation

from truejoint.array_types import Array
from truejoint.errors import CalibrationError
from truejoint.recordings.join.joining import ClockOffset
from truejoint.summary import Summarised
from truejoint.tip.rows import align, cross_matrix
from truejoint.units import display_unit

_MARKER_SD: Final = 0.05  # m, of a marker of which nothing is stated


@dataclass(frozen=True, eq=False)
class Registration:
    """What a person knows of a tracker beside a robot.

    Attributes
    ----------
    base : ndarray, shape (4, 4), optional
        Pose of the robot's base frame in the tracker's [m]; None where it is to be found.
    base_sd : ndarray, shape (6,)
        Standard deviations of it about and along the axes of the base [rad, then m].
    touched : ndarray, shape (n, 2, 3)
        Points of the base that the tracker has seen, in the base's frame and in the tracker's [m].
    touched_sd : float
        Per axis [m].
    link : str
        Joint whose link carries the marker; empty for the tool behind the last one.
    marker : ndarray, shape (3,), optional
        Place of the marker in the frame of that link [m].
    marker_sd : ndarray, shape (3,)
        [m].
    stops : mapping
        By joint, its measured and its true position where that is known, at a hard stop or in a
        fixture, and the standard deviation [rad or m].

    Examples
    --------
    >>> Registration(marker=np.zeros(3), stops={"shoulder": (0.01, 0.0, 0.001)}).base is None
    True
    """

    base: Array | None = None
    base_sd: Array = field(default_factory=lambda: np.full(6, np.inf))
    touched: Array = field(default_factory=lambda: np.empty((0, 2, 3)))
    touched_sd: float = 1e-3
    link: str = ""
    marker: Array | None = None
    marker_sd: Array = field(default_factory=lambda: np.full(3, _MARKER_SD))
    stops: Mapping[str, tuple[float, float, float]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        shapes = {"base": (4, 4), "base_sd": (6,), "marker": (3,), "marker_sd": (3,)}
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is not None and np.shape(value) != shape:
                raise CalibrationError(
                    f"registration: {name} is of shape {np.shape(value)}; it must be {shape}"
                )
        if len(self.touched) and self.base is not None:
            raise CalibrationError(
                "registration: it states the base's pose and touched points; leave one of them out"
            )

    def known_base(self) -> tuple[Array | None, Array]:
        """Pose (4, 4) of the tracker in the robot's base [m], None where nothing says it.

        And what is known of it, the inverse covariance (6, 6) of a turn about and a shift along the
        axes of the base. Raises CalibrationError if touched points lie in a line.
        """
        if self.base is not None:
            return np.asarray(np.linalg.inv(self.base)), np.diag(self.base_sd**-2.0)
        if not len(self.touched):
            return None, np.zeros((6, 6))
        ours, theirs = self.touched[:, 0], self.touched[:, 1]
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = align(ours, theirs)
        rows = np.concatenate([cross_matrix(ours), -np.tile(np.eye(3), (len(ours), 1, 1))], axis=2)
        return pose, np.einsum("mia,mib->ab", rows, rows) / self.touched_sd**2


@dataclass(frozen=True)
class Stretch:
    """A time in which most readings of a tracker are off, so that all are left out.

    Attributes
    ----------
    begin, end : float
        Time in the recording [s].
    readings : int
    distance : float
        From where the marker is expected, in the median [m].
    alike : bool
        Whether all are off by the same on the marker's link, as another marker there would be.

    Examples
    --------
    >>> from truejoint.tip.registration import Stretch
    >>> print(Stretch(12.0, 31.5, 585, 0.0301, alike=True))
    12.0 to 31.5 s: 585 readings 30.1 mm off, all alike: another marker
    """

    begin: float
    end: float
    readings: int
    distance: float
    alike: bool

    def __str__(self) -> str:
        what = "all alike: another marker" if self.alike else "each otherwise"
        return (
            f"{self.begin:.1f} to {self.end:.1f} s: {self.readings} readings "
            f"{1e3 * self.distance:.1f} mm off, {what}"
        )


@dataclass(frozen=True, eq=False, repr=False)
class Registered(Summarised):
    """Where a tracker stands, what it sees, and how sure that is.

    Attributes
    ----------
    base_from_tracker : ndarray, shape (4, 4)
        Pose of the tracker's frame in the robot's base [m].
    base_sd : ndarray, shape (6,)
        Standard deviations of the turn about and the shift along the base's axes at its origin
        [rad, then m].
    link : str
        Joint whose link carries the marker.
    link_from_marker : ndarray, shape (4, 4)
        Pose of the marker on it [m]; its turn is the identity for points.
    marker_sd : ndarray, shape (3,)
        [m].
    clock : ClockOffset
        What to add to the tracker's stamps to have the robot's; its delay is part of it.
    noise : float
        Standard deviation per axis of the points about the fit [m].
    joints : tuple of str
        Whose truth was found.
    noise_deviation : ndarray, shape (n_joints,)
        What that noise makes of a single truth, root mean square over the motion [rad or m].
    pose_deviation : ndarray, shape (n_joints,)
        What all truths may be off by together, as the transforms are known no better [rad or m].
    readings, strays : int
        Readings that fit, and those that were left out one by one as they do not.
    stretches : tuple of Stretch
        Times that were left out whole.

    Examples
    --------
    >>> one, place = np.ones(1), np.eye(4)
    >>> known = place, np.ones(6), "roll", place, np.ones(3), truejoint.recordings.ClockOffset(0.0)
    >>> Registered(*known, 3e-4, ("elbow",), ("rad",), one, one, 90, 2).summary()["readings"]
    '90, 2 strays left out, noise 0.3 mm per axis'
    """

    base_from_tracker: Array
    base_sd: Array
    link: str
    link_from_marker: Array
    marker_sd: Array
    clock: ClockOffset
    noise: float
    joints: tuple[str, ...]
    units: tuple[str, ...]
    noise_deviation: Array
    pose_deviation: Array
    readings: int
    strays: int
    stretches: tuple[Stretch, ...] = ()

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        plain = {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in vars(self).items()}
        sd = None if math.isnan(self.clock.sd) else self.clock.sd
        return plain | {
            "clock": {"seconds": self.clock.seconds, "sd": sd},
            "stretches": [asdict(stretch) for stretch in self.stretches],
        }

    def summary(self) -> dict[str, str]:
        """Give transforms with their deviations, delay, noise, and the deviation of each truth."""
        turn = Rotation.from_matrix(self.base_from_tracker[:3, :3]).as_rotvec(degrees=True)
        shift = 1e3 * self.base_from_tracker[:3, 3]
        marker = 1e3 * self.link_from_marker[:3, 3]
        deviations = []
        rows = zip(self.joints, self.units, self.noise_deviation, self.pose_deviation, strict=True)
        for joint, unit, noise, pose in rows:
            shown = display_unit(unit)
            deviations.append(
                f"{joint} {noise * shown.scale:.2g} and {pose * shown.scale:.2g} {shown.name}"
            )
        return {
            "tracker": f"at {_listed(shift, '.2f')} mm of the base, turned {_listed(turn, '.3f')} "
            "deg",
            "± (1 sd)": f"{_listed(1e3 * self.base_sd[3:], '.2g')} mm, "
            f"{_listed(np.rad2deg(self.base_sd[:3]), '.2g')} deg",
            "marker": f"at {_listed(marker, '.2f')} mm ± {_listed(1e3 * self.marker_sd, '.2g')} mm "
            f"of the link that {self.link} moves",
            "clock": repr(self.clock).partition("(")[2].removesuffix(")"),
            "readings": f"{self.readings}, {self.strays} strays left out, noise "
            f"{1e3 * self.noise:.2g} mm per axis",
            **({"left out": "; ".join(map(str, self.stretches))} if self.stretches else {}),
            "truth ±": "; ".join(deviations) + " (of one reading, and of all together)",
        }


def _listed(values: Array, form: str) -> str:
    return f"({', '.join(format(float(v), form) for v in values)})"
