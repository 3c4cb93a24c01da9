"""Points of a tool at rest that a frame has seen: a block's dimples, or a tracker's shots."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np

from truejoint.array_types import Array, floats
from truejoint.calibration.compatibility import source_of
from truejoint.errors import CalibrationError, other_kind
from truejoint.recordings import Recording
from truejoint.robots.chain import SerialChain
from truejoint.robots.parts import Kinematics
from truejoint.robots.robot import Robot
from truejoint.tip.block import Block
from truejoint.tip.registration import Registration
from truejoint.tip.rows import TipPrior, TipRows, TipState, align
from truejoint.units import shown

SHOT_SD: Final = 2.5e-4
"""Standard deviation of a marker at rest that a tracker sees, per axis [m]."""
REST: Final = 0.3
"""Time before a touch's stamp over which positions are averaged [s]."""
_SLACK: Final = {"rad": 5e-4, "m": 5e-5}  # by which positions may move within `REST`


@dataclass(frozen=True)
class Touches:
    """When the tip rested in which dimple.

    Attributes
    ----------
    t : tuple of float
        End of each rest, on the clock of the recording [s].
    dimple : tuple of str
        Its number on the block.
    source : str
        File of the touches, for messages.
    kind : str
        What is counted, for a person: ``dimple``, or ``shot`` of a tracker.

    Raises
    ------
    CalibrationError
        If there are none, or time does not advance.

    Examples
    --------
    >>> len(Touches((4.0, 9.5), ("3", "17")))
    2
    """

    t: tuple[float, ...]
    dimple: tuple[str, ...]
    source: str = "touches"
    kind: str = "dimple"

    def __post_init__(self) -> None:
        t = floats(self.t, f"{self.source}: times", CalibrationError)
        if not t.size or t.shape != (len(self.dimple),):
            raise CalibrationError(
                f"{self.source}: no {self.kind}s; write a line for each: a time and a name"
            )
        if not (np.isfinite(t).all() and (np.diff(t) > 0.0).all()):
            raise CalibrationError(f"{self.source}: the times must go up")

    def __len__(self) -> int:
        return len(self.t)

    @property
    def doubt(self) -> str:
        """Likely cause of one that does not fit, for a person."""
        if self.kind == "dimple":
            return "badly seated, or another number?"
        return "moved meanwhile, or another marker?"


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
        File of the shots, for messages.

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


@dataclass(frozen=True, eq=False)
class RestPoints:
    """Points that a frame has seen of the tool at rest, and what is known of that frame.

    Attributes
    ----------
    rests : Touches
        When, and the name of each.
    point : ndarray, shape (m, 3)
        In the frame, as stated [m].
    sd : float
        Standard deviation of the tool from it, per axis [m].
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
        Names of the points and of the frame, for a person.
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

    @classmethod
    def of_touches(cls, touches: Touches, block: Block, robot: Robot, sd: float) -> RestPoints:
        """Touches of a block that may stand anywhere; raises CalibrationError as `Block.at`."""
        point, kinematics = block.at(touches.dimple), known_kinematics(robot)
        return cls(touches, point, sd, kinematics, block.scale, block.scale_sd)

    @classmethod
    def of_shots(
        cls, shots: Shots, registration: Registration, robot: Robot, sd: float
    ) -> RestPoints:
        """Shots of a tracker of which `registration` says what is known.

        Where it says nothing of the marker, the tracker sees the tool's tip. Raises
        CalibrationError if it states stops, which need motion up to them, or as `carrier`.
        """
        if registration.stops:
            raise CalibrationError(
                "registration: stops need a motion that goes there; leave them out with single "
                "shots"
            )
        base, precision = registration.known_base()
        stated = np.eye(4) if base is None else base
        is_tip = registration.marker is None and not registration.link
        return cls(
            shots.rests,
            shots.point @ stated[:3, :3].T + stated[:3, 3],
            sd,
            carrier(robot, registration.link)[0],
            marker=np.zeros(3) if registration.marker is None else registration.marker,
            marker_sd=np.zeros(3) if is_tip else registration.marker_sd,
            pose=None if base is None else precision,
            stated=stated,
            what="shots",
            frame="tracker",
        )

    def prior(self, rows: TipRows, mean: Array, sd: Array) -> TipPrior:
        """Prior of coefficients, `mean` and `sd` (k,), and of what is known of the frame.

        The fit starts where the tool, as it is measured, meets the points. Raises CalibrationError
        if they lie in a line.
        """
        start = TipState(mean, marker=self.marker, scale=self.scale)
        if self.pose is None:
            tip = rows.kinematics.forward(rows.joint) @ [*self.marker, 1.0]
            turn, shift = align(tip[:, :3], rows.point * self.scale)
            start = TipState(mean, turn, shift, self.marker, self.scale)
        return TipPrior.of(
            start, sd, marker=self.marker_sd, scale=self.scale_sd, pose_precision=self.pose
        )


def resting(recording: Recording, touches: Touches) -> list[slice]:
    """Rows of a recording in which the tip rests, of each touch.

    Raises CalibrationError if there is no row, or the arm moves.
    """
    stamps, rests = np.array(recording.t), []
    joints = [j for j in recording.robot.positioning if f"measured/{j}" in recording.units]
    measured = recording.columns("measured", joints)
    units = [recording.robot.joint(joint).unit for joint in joints]
    slack = np.array([_SLACK[unit] for unit in units])
    for t, dimple in zip(touches.t, touches.dimple, strict=True):
        first, last = np.searchsorted(stamps, [t - REST, t], side="right")
        if last - first < 2:
            raise CalibrationError(
                f"{touches.source}: {touches.kind} {dimple} is of {t:g} s, but "
                f"{source_of(recording)} runs from {stamps[0]:.1f} to {stamps[-1]:.1f} s with "
                f"{last - first} rows there; is it their recording?"
            )
        span = np.ptp(measured[first:last], axis=0)
        if (span > slack).any():
            k = int(np.argmax(span / slack))
            raise CalibrationError(
                f"{touches.source}: {joints[k]} moves by {shown(float(span[k]), units[k])} while "
                f"{touches.kind} {dimple} is taken, at {t:g} s; rest for {REST:g} s before the "
                "stamp"
            )
        rests.append(slice(int(first), int(last)))
    return rests


def at_rest(recording: Recording, touches: Touches, values: Array) -> Array:
    """Means (m, ...) of `values` (n, ...), a row of the recording each, at each rest."""
    return np.array([values[rows].mean(axis=0) for rows in resting(recording, touches)])


def check_count(touches: Touches, fewest: int, what: str) -> None:
    """Refuse touches of fewer dimples, or fewer shots; `what` they are for, in the message."""
    if not isinstance(touches, Touches):
        raise CalibrationError(other_kind(touches, "Touches", "read_touches(path) gives them"))
    different = len(set(touches.dimple))
    if different < fewest:
        raise CalibrationError(
            f"{touches.source}: {different} different {touches.kind}s; to {what} it takes {fewest} "
            "or more"
        )


def known_kinematics(robot: Robot) -> Kinematics:
    """Kinematics of a robot; raises CalibrationError where they are not known."""
    if robot.kinematics is None:
        raise CalibrationError(
            f"the kinematics of {robot.title} are not known, so a point of its tool says nothing "
            "of its joints; give its robot file a table [kinematics] (docs/robots.md)"
        )
    return robot.kinematics


def carrier(robot: Robot, link: str) -> tuple[Kinematics, str]:
    """Kinematics of what carries a marker, and the joint that moves it; the tool without a `link`.

    Raises CalibrationError where kinematics are not known, or are not those of a chain.
    """
    kinematics = known_kinematics(robot)
    if not link:
        return kinematics, robot.joint_names[-1]
    if not isinstance(kinematics, SerialChain):
        raise CalibrationError(f"{robot.title}: only the tool of its kinematics can carry a marker")
    return kinematics.up_to(robot.index([link])[0]), link
