"""Terms by which the joints are corrected, and what is expected of them before any point."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Final, NamedTuple

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.compatibility import check_columns
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial.run import polynomial_factors
from truejoint.features.feature_set import FeatureSet, default_gap_limit
from truejoint.recordings import Recording
from truejoint.robots import Robot

# Half-widths of each joint's plays: for touches, as shares of its workspace; for a tracker, of half
# its way. Friction turns at once, cables later.
WIDTHS: Final = (1e-3, 5e-3, 2e-2)
TRACKED_WIDTHS: Final = (0.002, 0.02)
SPREAD: Final = {"rad": np.deg2rad(1.0), "m": 1e-3}
"""Scale of the coefficients for touches; by as much a homing moves a zero, widely."""
# Standard deviations of the terms. For touches in `SPREAD`, for a tracker as shares of half a
# joint's way, but for its zero [rad or m].
WIDE: Final = {"zero": 5.0, "slope": 2.0, "square": 0.5, "play": 0.3}
"""Touches of an arm of which no other calibration is known."""
AGAIN: Final = {"zero": 1.0, "slope": 0.1, "square": 0.05, "play": 0.05}
"""Differences of one arm's terms from one calibration to the next, for touches."""
TRACKED: Final = {"slope": 0.15, "square": 0.05, "play": 0.03}  # what cables may do, for a tracker
TRACKED_ZERO: Final = {"rad": 0.2, "m": 0.02}
LEFT: Final = 0.03
"""What the terms leave of each joint, before the touches say more, as a share of `SPREAD`."""
# Shares of `WIDE`, of each kind by itself: cables that slip much may stretch little.
_SHARES: Final = (
    (1.0,), (1.0, 0.4, 0.15), (1.0, 0.5, 0.25, 0.12, 0.06, 0.03), (1.0, 0.5, 0.25, 0.12, 0.06),
)  # fmt: skip
_GROWN: Final = (1.0, 2.0, 4.0)  # factors by which an arm may have changed more
_PROJECTED: Final = 2000  # rows of a recording on which a calibration is taken for its terms


def spread_of(robot: Robot, joints: Sequence[str]) -> Array:
    """`SPREAD` of joints (n_joints,) [rad or m]."""
    return np.array([SPREAD[robot.joint(joint).unit] for joint in joints])


def measured_joints(recording: Recording) -> Array:
    """Positions (n, n_joints) of all joints; raises CalibrationError where one is missing."""
    names = recording.robot.joint_names
    check_columns(recording, [f"measured/{name}" for name in names], "tip's place takes")
    return recording.columns("measured", names)


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of each joint's correction: a zero, slopes and squares of all, plays of its own."""

    joints: tuple[str, ...]
    centre: Array  # (n_joints,), middle of the range of each [rad or m]
    half: Array  # (n_joints,), half of that range [rad or m]
    scale: Array  # (n_joints,), correction per coefficient [rad or m]
    widths: Array  # (n_joints, n_widths), half-widths of the plays [rad or m]

    @classmethod
    def of_workspace(cls, robot: Robot) -> "Terms":
        """Terms over a robot's workspace; raises CalibrationError where none is known."""
        space = robot.workspace
        if space is None:
            raise CalibrationError(f"no workspace of {robot.title} is known; state it in its file")
        scale, widths = spread_of(robot, space.joints), np.outer(space.extent, WIDTHS)
        return cls(space.joints, space.centre, space.extent / 2, scale, widths)

    @classmethod
    def of_motion(cls, recording: Recording, joints: Sequence[str]) -> "Terms":
        """Terms over the way of `joints`; raises CalibrationError if one of them stands still."""
        measured = recording.columns("measured", joints)
        lower, upper = measured.min(axis=0), measured.max(axis=0)
        half = (upper - lower) / 2
        still = [name for name, way in zip(joints, half, strict=True) if not way > 0.0]
        if still:
            raise CalibrationError(
                f"{', '.join(still)} stand still; move them, or name the joints to be found"
            )
        return cls(tuple(joints), (lower + upper) / 2, half, half, np.outer(half, TRACKED_WIDTHS))

    @property
    def features(self) -> FeatureSet:
        """Features that the terms are made of: positions, then the plays of each joint."""
        plays = [
            f"play(measured/{joint}, {float(width)!r})"
            for joint, widths in zip(self.joints, self.widths, strict=True)
            for width in widths
        ]
        return FeatureSet.parse([*(f"measured/{joint}" for joint in self.joints), *plays])

    def normalised(self, positions: Array) -> Array:
        """Positions (m, n_joints) [rad or m] as 1, shares of half the range, and their products."""
        z = (positions - self.centre) / self.half
        first, second = np.triu_indices(z.shape[1])
        return np.column_stack([np.ones(len(z)), z, z[:, first] * z[:, second]])

    def columns(self, features: Array) -> tuple[Array, Array]:
        """Terms of features (m, k), of about size 1.

        Those that all joints share (m, n_shared), and the plays (m, n_joints, n_widths).
        """
        n, widths = self.widths.shape
        plays = features[:, n:].reshape(len(features), n, widths) - features[:, :n, None]
        return self.normalised(features[:, :n]), plays / self.widths

    def columns_of(self, recording: Recording) -> tuple[Array, Array]:
        """`columns` of a recording; raises CalibrationError where it lacks a joint."""
        measured_joints(recording)
        return self.columns(self.features.compute(recording, default_gap_limit([recording])))

    def basis(self, shared: Array, plays: Array) -> Array:
        """Correction per coefficient (m, n_joints, k) [rad or m], from `columns`."""
        n, widths = self.widths.shape
        m, count = shared.shape
        basis = np.zeros((m, n, n, count + widths))
        for k in range(n):
            basis[:, k, k, :count] = shared * self.scale[k]
            basis[:, k, k, count:] = plays[:, k] * self.scale[k]
        return basis.reshape(m, n, -1)

    def basis_at(self, joint: Array, side: Array | float = 0.0) -> Array:
        """`basis` at positions (m, n_joints) [rad or m], come to from sides (m, n_joints, 1).

        They are -1 or 1, and 0 where no play has been gone through.
        """
        plays = side * np.ones((len(joint), *self.widths.shape))
        return self.basis(self.normalised(joint), plays)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kind of each coefficient (k,): ``zero``, ``slope``, ``square`` or ``play``."""
        n, widths = len(self.joints), self.widths.shape[1]
        counts = {"zero": 1, "slope": n, "square": n * (n + 1) // 2, "play": widths}
        return n * tuple(kind for kind, count in counts.items() for _ in range(count))

    @property
    def zeros(self) -> Integers:
        """Places of the joints' constants among the coefficients."""
        return np.array([k for k, kind in enumerate(self.kinds) if kind == "zero"])

    def sds(self, by_kind: Mapping[str, float]) -> Array:
        """Give the standard deviations (k,) of the coefficients, of one for each kind."""
        return np.array([by_kind[kind] for kind in self.kinds])

    def of_calibration(self, calibration: Calibration, recording: Recording) -> Array:
        """Coefficients (k,) that correct a recording as a calibration does, as nearly as they can.

        Least squares, held by `WIDE` where the motion tells nothing. Raises CalibrationError as
        `Calibration.correct`, or if it corrects other joints.
        """
        if set(calibration.joints) != set(self.joints):
            theirs, ours = (", ".join(each.joints) for each in (calibration, self))
            raise CalibrationError(
                f"the prior {calibration.title} corrects {theirs}; touches correct {ours}"
            )
        rows = slice(None, None, max(1, len(recording) // _PROJECTED))
        order = [calibration.joints.index(joint) for joint in self.joints]
        error = calibration.predict_error(recording)[rows, order] / self.scale
        features = self.features.compute(recording, calibration.gap_limit)[rows]
        basis = self.basis(*self.columns(features)) / self.scale[:, None]
        normal = np.einsum("mja,mjb->ab", basis, basis, optimize=True)
        normal += np.diag(self.sds(WIDE) ** -2.0) * LEFT**2
        return np.linalg.solve(normal, np.einsum("mja,mj->a", basis, error))

    def arrays(self, coefficients: Array) -> dict[str, Array]:
        """Arrays of a polynomial of degree 2 in the features, of the coefficients (k,)."""
        n, widths = self.widths.shape
        k = n + n * widths
        place = {tuple(pair): i for i, pair in enumerate(polynomial_factors(k, 2).tolist())}
        values = coefficients.reshape(n, -1) * self.scale[:, None]
        coef = np.zeros((len(place), n))
        coef[[place[i, k] for i in range(n)]] = values[:, 1 : 1 + n].T
        pairs = [place[i, j] for i in range(n) for j in range(i, n)]
        coef[pairs] = values[:, 1 + n : 1 + n + len(pairs)].T
        for joint, w in product(range(n), range(widths)):
            # Of (play - position) / width.
            per = values[joint, 1 + n + len(pairs) + w] * self.half[joint] / self.widths[joint, w]
            coef[place[n + joint * widths + w, k], joint] += per
            coef[place[joint, k], joint] -= per
        half, centre = (
            np.concatenate([ends, np.repeat(ends, widths)]) for ends in (self.half, self.centre)
        )
        intercept = values[:, 0].copy()
        return {"mean": centre, "inverse_scale": 1.0 / half, "coef": coef, "intercept": intercept}


class TermsPrior(NamedTuple):
    """Expected coefficients (k,) of the terms, and their standard deviations (k,)."""

    mean: Array
    sd: Array


def wide_priors(terms: Terms) -> list[TermsPrior]:
    """Expect little of any arm, with all but the zeros smaller from one prior to the next."""
    nothing, wide = np.zeros(len(terms.kinds)), terms.sds(WIDE)
    shares = (dict(zip(WIDE, share, strict=True)) for share in product(*_SHARES))
    return [TermsPrior(nothing, wide * terms.sds(share)) for share in shares]


def learned_priors(terms: Terms, known: Calibration, recording: Recording) -> list[TermsPrior]:
    """Expect what an older calibration of the arm says, within what differs from day to day.

    No zero is expected within less than a homing moves it. The later priors expect less. Raises
    CalibrationError as `Terms.of_calibration`, or if it is of another arm, or a calibration by
    touches that does not state the deviation of its zeros.
    """
    known.check_robot(recording.robot)
    sd, unsure = terms.sds(AGAIN), np.zeros(len(terms.joints))
    if "touch" in known.metadata:
        try:
            unsure = np.array(known.metadata["touch"]["zero_sd"], dtype=np.float64)
        except (KeyError, TypeError, ValueError):
            unsure = np.empty(0)
        if unsure.shape != terms.scale.shape or not (unsure >= 0.0).all():
            raise CalibrationError(
                f"the prior {known.title} does not say how surely it knows its zeros; make it again"
            )
    sd[terms.zeros] = np.hypot(sd[terms.zeros], unsure / terms.scale)
    mean = terms.of_calibration(known, recording)
    return [TermsPrior(mean, factor * sd) for factor in _GROWN]
