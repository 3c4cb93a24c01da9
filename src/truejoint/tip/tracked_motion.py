"""What a recording says of the tool that a tracker sees, and how its joints may be off."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from truejoint.array_types import Array, Mask
from truejoint.errors import CalibrationError
from truejoint.features.feature_set import Feature, FeatureSet
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.signals import GAP_STEPS
from truejoint.robots.parts import Kinematics
from truejoint.tip.tip_rows import TipRows

# What cables may do, as standard deviations: a zero, then shares of half a joint's way that a
# slope and a square of any joint's position may be worth at its end, then a play's height.
_ZERO_SD: Final = {"rad": 0.2, "m": 0.02}
_SLOPE_SD, _SQUARE_SD, _PLAY_SD = 0.15, 0.05, 0.03
# A joint that moves less is held: what its motor shows is its cable, and no motion of the tool.
_HELD: Final = {"rad": 0.1, "m": 5e-3}
_OTHER_SD: Final = {"rad": 0.02, "m": 1e-3}  # of a joint that is not to be found, on its motor
PLAYS: Final = (0.002, 0.02)
"""Half-widths of a joint's plays, as shares of half its way: friction turns at once, cables later.
"""
_DELAY_SD: Final = 10.0  # s


@dataclass(frozen=True, eq=False)
class TrackedMotion:
    """What a recording says of the tool, and the terms of the joints' corrections, by row."""

    t: Array
    kinematics: Kinematics
    columns: tuple[int, ...]
    units: tuple[str, ...]
    joint: Array  # (n, all joints of the kinematics)
    common: Array  # (n, k) terms that every joint has
    plays: Array  # (n, plays of each joint)
    velocity: Array  # (n, n_joints)
    others_sd: Array  # (all joints,) of those that are not to be found; 0 of the others
    centre: Array  # (n_joints,)
    half: Array

    @classmethod
    def of(
        cls, recording: Recording, kinematics: Kinematics, joints: Sequence[str]
    ) -> TrackedMotion:
        """Motion of a recording; raises CalibrationError if one of the `joints` stands still."""
        robot = recording.robot
        known = recording.joints_of("measured")
        joint = np.tile(robot.home, (len(recording), 1))
        for k, name in enumerate(robot.joint_names):
            if name in known:
                joint[:, k] = recording.column(f"measured/{name}")
                if name not in joints and np.ptp(joint[:, k]) < _HELD[robot.joint(name).unit]:
                    joint[:, k] = joint[:, k].mean()
        columns = tuple(robot.index(joints))
        q = recording.columns("measured", joints)
        lower, upper = q.min(axis=0), q.max(axis=0)
        centre, half = (lower + upper) / 2, (upper - lower) / 2
        still = [name for name, way in zip(joints, half, strict=True) if not way > 0.0]
        if still:
            raise CalibrationError(
                f"{', '.join(still)} stand still: nothing tells their truth; move them, or name "
                "the joints to be found"
            )
        # Each from -1 to 1, a joint's one after the other.
        widths = np.outer(half, PLAYS).ravel()
        signals = [f"measured/{name}" for name in joints for _ in PLAYS]
        own = [Feature(s, "play", float(w)) for s, w in zip(signals, widths, strict=True)]
        plays = FeatureSet(tuple(own)).compute(recording)
        return cls(
            recording.t,
            kinematics,
            columns,
            tuple(robot.joint(name).unit for name in joints),
            joint,
            polynomial((q - centre) / half),
            (plays - np.repeat(q, len(PLAYS), axis=1)) / widths,
            np.gradient(q, recording.t, axis=0),
            np.array([0.0 if j.name in joints else _OTHER_SD[j.unit] for j in robot.joints]),
            centre,
            half,
        )

    @property
    def path(self) -> Array:
        """Where the tool is by the measured joints (n, 3) [m]."""
        return np.asarray(self.kinematics.forward(self.joint)[:, :3, 3])

    @property
    def sd(self) -> Array:
        """What cables may do to the coefficients of the terms, and the delay [s], (k,)."""
        count = len(self.half)
        shares = np.full(self.common.shape[1], _SQUARE_SD)
        shares[1 : 1 + count] = _SLOPE_SD
        rows = []
        for k, unit in enumerate(self.units):
            row = shares * self.half[k]
            row[0] = _ZERO_SD[unit]
            rows.append([*row, *[_PLAY_SD * self.half[k]] * len(PLAYS)])
        return np.append(np.ravel(rows), _DELAY_SD)

    @property
    def is_play(self) -> Mask:
        """Which coefficients, the delay left out, are plays' (k,)."""
        own = np.zeros(self.common.shape[1] + len(PLAYS), dtype=np.bool_)
        own[-len(PLAYS) :] = True
        return np.tile(own, len(self.half))

    def basis(self, stamps: Array) -> Array:
        """Correction per coefficient (m, n_joints, k) at stamps (m,) [s]."""
        count, shared = len(self.half), self.common.shape[1]
        terms = shared + len(PLAYS)
        basis = np.zeros((len(stamps), count, count * terms + 1))
        common = at_stamps(stamps, self.t, self.common)
        plays, velocity = (
            at_stamps(stamps, self.t, self.plays),
            at_stamps(stamps, self.t, self.velocity),
        )
        for k in range(count):
            own = k * terms
            basis[:, k, own : own + shared] = common
            basis[:, k, own + shared : own + terms] = plays[:, k * len(PLAYS) :][:, : len(PLAYS)]
        basis[:, :, -1] = velocity
        return basis

    def inside(self, stamps: Array) -> Mask:
        """Which stamps (m,) lie within the recording, and in no gap of it."""
        after = np.clip(np.searchsorted(self.t, stamps), 1, len(self.t) - 1)
        step = self.t[after] - self.t[after - 1]
        within = (stamps >= self.t[0]) & (stamps <= self.t[-1])
        return np.asarray(within & (step <= GAP_STEPS * np.median(np.diff(self.t))))

    def rows(self, stamps: Array, points: Array) -> TipRows:
        """Rows of points (m, 3) [m] that were seen at stamps (m,) [s]."""
        return TipRows(
            self.kinematics,
            at_stamps(stamps, self.t, self.joint),
            self.columns,
            self.basis(stamps),
            points,
            np.ones(len(stamps)),
            np.zeros(len(self.columns)),
        )


def at_stamps(stamps: Array, t: Array, values: Array) -> Array:
    """Columns of `values` (n, k), which are of stamps `t` (n,) [s], at others (m,): (m, k)."""
    return np.column_stack([np.interp(stamps, t, column) for column in values.T])


def polynomial(u: Array) -> Array:
    """One, positions (n, k) and their products by two."""
    first, second = np.triu_indices(u.shape[1])
    return np.column_stack([np.ones(len(u)), u, u[:, first] * u[:, second]])
