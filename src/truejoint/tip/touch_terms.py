"""Terms by which touches correct the joints, and what is expected of them before any touch."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.array_types import Array, Integers
from truejoint.errors import CalibrationError
from truejoint.estimators.polynomial.run import polynomial_factors
from truejoint.features.feature_set import FeatureSet
from truejoint.recordings import Recording
from truejoint.robots import Robot

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration

WIDTHS: Final = (1e-3, 5e-3, 2e-2)
"""Half-widths of each joint's own plays, as shares of its workspace."""
SPREAD: Final = {"rad": np.deg2rad(1.0), "m": 1e-3}
"""Scale of what is expected of the terms, widely: see `WIDE`."""
WIDE: Final = {"zero": 5.0, "slope": 2.0, "square": 0.5, "play": 0.3}
"""Standard deviations of the terms where no other calibration is known, in `SPREAD`."""
AGAIN: Final = {"zero": 1.0, "slope": 0.1, "square": 0.05, "play": 0.05}
"""By how much the terms of one arm differ from one calibration of it to the next, in `SPREAD`."""
LEFT: Final = 0.03
"""What the terms leave of each joint, before the touches say more, as a share of `SPREAD`."""
ALIKE: Final = 0.1
"""Of `AGAIN`, within which a few arms that are alike do not hold any term."""
FEWEST_ARMS: Final = 3
"""Calibrations of other arms that tell how much arms differ."""
_SHARES: Final = (1.0, 0.5, 0.25, 0.12, 0.06)  # of `WIDE`, of squares and plays
_GROWN: Final = (1.0, 2.0, 4.0)  # by which an arm may differ more than those that are known
_PROJECTED: Final = 2000  # rows of a recording on which a calibration is taken for its terms


@dataclass(frozen=True, eq=False)
class Terms:
    """Terms of the correction of each joint, and the features that they are made of."""

    joints: tuple[str, ...]
    centre: Array  # (n_joints,) of the workspace [rad or m]
    half: Array
    scale: Array  # (n_joints,), `SPREAD` of each [rad or m]
    features: FeatureSet

    @classmethod
    def of(cls, robot: Robot) -> Terms:
        """Terms of a robot; raises CalibrationError where no workspace of it is known."""
        space = robot.workspace
        if space is None:
            raise CalibrationError(f"no workspace of {robot.title} is known; state it in its file")
        names = [f"measured/{joint}" for joint in space.joints]
        names += [
            f"play(measured/{joint}, {float(width * extent)!r})"
            for joint, extent in zip(space.joints, space.extent, strict=True)
            for width in WIDTHS
        ]
        scale = np.array([SPREAD[robot.joint(joint).unit] for joint in space.joints])
        half = space.extent / 2
        return cls(space.joints, space.centre, half, scale, FeatureSet.parse(names))

    def per_joint(self, features: Array) -> list[Array]:
        """Columns (m, n_terms) of each joint, of features (m, k), all of about size 1."""
        n = len(self.joints)
        z = (features[:, :n] - self.centre) / self.half
        plays = features[:, n:].reshape(len(z), n, len(WIDTHS)) - features[:, :n, None]
        plays /= (2 * self.half[:, None]) * WIDTHS
        pairs = [z[:, i] * z[:, j] for i in range(n) for j in range(i, n)]
        shared = np.column_stack([np.ones(len(z)), z, *pairs])
        return [np.column_stack([shared, plays[:, k]]) for k in range(n)]

    def basis(self, features: Array) -> Array:
        """Correction per coefficient (m, n_joints, k) [rad or m]."""
        columns = self.per_joint(features)
        each, n = columns[0].shape[1], len(columns)
        basis = np.zeros((len(features), n, n * each))
        for k, own in enumerate(columns):
            basis[:, k, k * each : (k + 1) * each] = own * self.scale[k]
        return basis

    @property
    def kinds(self) -> tuple[str, ...]:
        """What each coefficient (k,) is of: ``zero``, ``slope``, ``square`` or ``play``."""
        n = len(self.joints)
        counts = {"zero": 1, "slope": n, "square": n * (n + 1) // 2, "play": len(WIDTHS)}
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

        The recording is of the calibration's robot, of whatever arm. Least squares, held by `WIDE`
        where the motion tells nothing. Raises CalibrationError as `Calibration.correct`, or if it
        corrects other joints.
        """
        if set(calibration.joints) != set(self.joints):
            raise CalibrationError(
                f"the prior {calibration.title} corrects {', '.join(calibration.joints)}; touches "
                f"correct {', '.join(self.joints)}"
            )
        own = replace(calibration, arm=recording.robot.arm)
        chosen = slice(None, None, max(1, len(recording) // _PROJECTED))
        order = [calibration.joints.index(joint) for joint in self.joints]
        error = own.predict_error(recording)[chosen, order]
        basis = self.basis(self.features.compute(recording, own.gap_limit)[chosen])
        held = np.diag(self.sds(WIDE) ** -2.0) * LEFT**2
        normal, right = held, np.zeros(len(held))
        for k, scale in enumerate(self.scale):
            normal = normal + basis[:, k].T @ basis[:, k] / scale**2
            right = right + basis[:, k].T @ error[:, k] / scale**2
        return np.asarray(np.linalg.solve(normal, right))

    def arrays(self, coefficients: Array) -> dict[str, Array]:
        """Arrays of a polynomial of degree 2 in the features, of the coefficients (k,)."""
        n, widths = len(self.joints), len(WIDTHS)
        k = len(self.features)
        factors = polynomial_factors(k, 2).tolist()
        place = {tuple(factor): i for i, factor in enumerate(factors)}
        coef, intercept = np.zeros((len(factors), n)), np.zeros(n)
        half = np.concatenate([self.half, np.repeat(self.half, widths)])
        centre = np.concatenate([self.centre, np.repeat(self.centre, widths)])
        pairs = [(i, j) for i in range(n) for j in range(i, n)]
        for joint, own in enumerate(coefficients.reshape(n, -1) * self.scale[:, None]):
            intercept[joint] = own[0]
            for i in range(n):
                coef[place[i, k], joint] += own[1 + i]
            for value, (i, j) in zip(own[1 + n :], pairs, strict=False):
                coef[place[i, j], joint] = value
            for w, value in enumerate(own[1 + n + len(pairs) :]):
                per = value / (2 * WIDTHS[w])  # (p - q) / w, both scaled by half the workspace
                coef[place[n + joint * widths + w, k], joint] += per
                coef[place[joint, k], joint] -= per
        return {"mean": centre, "inverse_scale": 1.0 / half, "coef": coef, "intercept": intercept}


@dataclass(frozen=True, eq=False)
class TermsPrior:
    """What is expected of the terms' coefficients: `mean` and `sd`, each (k,), in their scale."""

    mean: Array
    sd: Array


def wide_priors(terms: Terms) -> list[TermsPrior]:
    """Expect little: of any arm, squares and plays the smaller from one to the next."""
    nothing = np.zeros(len(terms.kinds))
    shares = [{"square": share, "play": share} for share in _SHARES]
    kinds = [{kind: sd * own.get(kind, 1.0) for kind, sd in WIDE.items()} for own in shares]
    return [TermsPrior(nothing, terms.sds(by_kind)) for by_kind in kinds]


def learned_priors(
    terms: Terms, known: Sequence[Calibration], recording: Recording
) -> list[TermsPrior]:
    """Expect what calibrations say: one of this arm, or at least three of other arms.

    Of other arms the mean, and the deviation from it that each kind of term has, over all joints
    and arms. Of this arm its own coefficients, and by how much they differ from day to day. Zeros
    are never expected within less than a homing moves them: three arms are no measure of that. Nor
    do arms that are alike, or copies of one, hold the other terms. The later ones expect less.
    Raises CalibrationError as `Terms.of_calibration`, or if a calibration by touches does not say
    how surely it knows its zeros.
    """
    rows = np.array([terms.of_calibration(one, recording) for one in known])
    if len(rows) == 1:
        mean, by_kind = rows[0], dict(AGAIN)
    else:
        mean, kinds = rows.mean(axis=0), np.array(terms.kinds)
        # Of a further arm against the mean of these.
        square = ((rows - mean) ** 2).sum(axis=0) / (len(rows) - 1) * (1.0 + 1.0 / len(rows))
        least = {kind: sd if kind == "zero" else ALIKE * sd for kind, sd in AGAIN.items()}
        by_kind = {k: max(float(np.sqrt(square[kinds == k].mean())), least[k]) for k in WIDE}
    sd = terms.sds(by_kind)
    unsure = np.array([_zero_sd(one, len(terms.joints)) for one in known]) / terms.scale
    sd[terms.zeros] = np.sqrt(sd[terms.zeros] ** 2 + np.square(unsure).mean(axis=0))
    return [TermsPrior(mean, factor * sd) for factor in _GROWN]


def _zero_sd(calibration: Calibration, count: int) -> Array:
    """Deviation (count,) of its zeros [rad or m], which one that touches made does not know."""
    if "touch" not in calibration.metadata:
        return np.zeros(count)
    try:
        sd = np.array(calibration.metadata["touch"]["zero_sd"], dtype=np.float64)
    except (KeyError, TypeError, ValueError):
        sd = np.empty(0)
    if sd.shape != (count,) or not (sd >= 0.0).all():
        raise CalibrationError(
            f"the prior {calibration.title} was made by touches and does not say how surely it "
            "knows its zeros; make it again"
        )
    return sd


def check_known(known: Sequence[Calibration], robot: Robot) -> None:
    """Refuse calibrations that say nothing of a robot's arm, or too few to say how arms differ."""
    for one in known:
        if one.robot != robot.name:
            raise CalibrationError(
                f"the prior is of {one.title}, the touches are of {robot.title}; give one of the "
                "same robot"
            )
    if len(known) == 1 and known[0].arm != robot.arm:
        raise CalibrationError(
            f"the prior is of {known[0].title}, the touches are of {robot.title}; give one of this "
            f"arm, or a folder of {FEWEST_ARMS} or more of others"
        )
    if 1 < len(known) < FEWEST_ARMS:
        raise CalibrationError(
            f"{len(known)} calibrations do not tell how much arms differ; give {FEWEST_ARMS} or "
            "more, or the one of this arm"
        )
