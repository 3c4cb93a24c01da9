"""Points of a tool at rest that a frame has seen: a block's dimples, or a tracker's shots."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.errors import CalibrationError
from truejoint.robots.parts import Kinematics
from truejoint.robots.robot import Robot
from truejoint.tip.plate import Plate
from truejoint.tip.registration import Registration
from truejoint.tip.tip_rows import TipPrior, TipRows, TipState, align
from truejoint.tip.touches import Touches, known_kinematics, read_rows
from truejoint.tip.tracking import carrier

SHOT_SD: Final = 2.5e-4
"""How far off a tracker sees a marker at rest, per axis [m]."""


@dataclass(frozen=True, eq=False)
class Shots:
    """Where a tracker saw the marker, once at each rest.

    Attributes
    ----------
    t : tuple of float
        End of each rest, on the clock of the recording [s].
    point : ndarray, shape (m, 3)
        In the tracker's frame [m].
    source : str
        File that says so.

    Raises
    ------
    CalibrationError
        If there are none, they are not as many points, time does not advance, or a point is not
        finite.

    Examples
    --------
    >>> len(Shots((4.0, 9.5), np.zeros((2, 3))).rests)
    2
    """

    t: tuple[float, ...]
    point: Array
    source: str = "shots"

    def __post_init__(self) -> None:
        point = floats(self.point, f"{self.source}: points", CalibrationError)
        object.__setattr__(self, "point", point)
        if self.point.shape != (len(self.t), 3) or not np.isfinite(self.point).all():
            raise CalibrationError(f"{self.source}: want a point of three numbers for each time")
        self.rests  # noqa: B018  # checks the times

    @property
    def rests(self) -> Touches:
        """The same as touches, numbered from 1 on."""
        return Touches(self.t, tuple(str(k + 1) for k in range(len(self.t))), self.source, "shot")


def read_shots(path: str | os.PathLike[str]) -> Shots:
    r"""Shots of a CSV file with a header: ``t`` [s], ``x_mm``, ``y_mm``, ``z_mm``.

    Raises CalibrationError naming line and value.

    Examples
    --------
    >>> _ = Path("shots.csv").write_text("t,x_mm,y_mm,z_mm\n4.0,1,2,800\n9.5,1,3,800\n")
    >>> read_shots(Path("shots.csv")).point[1]
    array([0.001, 0.003, 0.8  ])
    """
    columns, want = ("t", "x_mm", "y_mm", "z_mm"), "a time [s] and three numbers"
    rows = read_rows(Path(path), columns, "shots", want)
    table = np.array([[float(text) for text in row] for row in rows]).reshape(-1, 4)
    return Shots(tuple(table[:, 0].tolist()), table[:, 1:] / 1e3, str(path))


@dataclass(frozen=True, eq=False)
class Sighted:
    """Points that a frame has seen of the tool at rest, and what is known of that frame.

    Attributes
    ----------
    rests : Touches
        When, and the name of each.
    point : ndarray, shape (m, 3)
        In the frame, as stated [m].
    sd : float
        How far off the tool is from it, per axis [m].
    kinematics : Kinematics
        Of what carries the point that is seen.
    scale, scale_sd : float
        How much larger the frame's points are than stated.
    marker, marker_sd : ndarray, shape (3,)
        Place of the point that is seen, in the frame of what carries it [m].
    pose : ndarray, shape (6, 6), optional
        Inverse covariance of the frame's pose in the robot's base, about the identity; None where
        nothing is known of it.
    stated : ndarray, shape (4, 4)
        Pose of the frame in which the points were stated in that of `point`.
    what, frame : str
        What they are, and what has seen them, for a person.
    """

    rests: Touches
    point: Array
    sd: float
    kinematics: Kinematics
    scale: float = 1.0
    scale_sd: float = 0.0
    marker: Array = field(default_factory=lambda: np.zeros(3))
    marker_sd: Array = field(default_factory=lambda: np.zeros(3))
    pose: Array | None = None
    stated: Array = field(default_factory=lambda: np.eye(4))
    what: str = "touches"
    frame: str = "block"

    def prior(self, rows: TipRows, mean: Array, sd: Array) -> TipPrior:
        """Prior of coefficients, `mean` and `sd` (k,), and of what is known of the frame.

        The fit starts where the tool, as it is measured, meets the points. Raises CalibrationError
        if they lie in a line.
        """
        turn, shift = np.eye(3), np.zeros(3)
        if self.pose is None:
            tool = rows.kinematics.forward(rows.joint)
            tip = tool[:, :3, 3] + tool[:, :3, :3] @ self.marker
            turn, shift = align(tip, rows.point * self.scale)
        start = TipState(mean, turn, shift, self.marker, self.scale)
        prior = TipPrior.of(start, [*sd, *[np.inf] * 6, *self.marker_sd, self.scale_sd])
        return prior if self.pose is None else prior.with_pose(self.pose)


def touched(touches: Touches, plate: Plate, robot: Robot, touch_sd: float) -> Sighted:
    """Touches of a block that may stand anywhere; raises CalibrationError for a strange dimple."""
    return Sighted(
        touches, plate.at(touches.dimple), touch_sd, known_kinematics(robot), plate.scale,
        plate.scale_sd,
    )  # fmt: skip


def shot(shots: Shots, registration: Registration, robot: Robot, shot_sd: float) -> Sighted:
    """Shots of a tracker of which `registration` says what is known.

    Where it says nothing of the marker, the tracker sees the tool's tip. Raises CalibrationError if
    it states stops, which take motion up to them, or as `carrier`.
    """
    if registration.stops:
        raise CalibrationError(
            "registration: stops are of a motion that goes there; leave them out with single shots"
        )
    kinematics, _ = carrier(robot, registration.link)
    base, known = registration.known_base()
    stated = np.eye(4) if base is None else base
    point = shots.point @ stated[:3, :3].T + stated[:3, 3]
    is_tip = registration.marker is None and not registration.link
    marker = np.zeros(3) if registration.marker is None else registration.marker
    return Sighted(
        shots.rests, point, shot_sd, kinematics,
        marker=marker, marker_sd=np.zeros(3) if is_tip else registration.marker_sd,
        pose=None if base is None else known, stated=stated, what="shots", frame="tracker",
    )  # fmt: skip
