"""Re-zero a calibration in the loop, from truth that is sparse and noisy."""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike

from truejoint.array_types import Array, floats
from truejoint.calibration.efforts import AT, IN_MOTION, N_MOTION, go_on_in_motion
from truejoint.calibration.encoding import CalibrationData, as_calibration
from truejoint.calibration.zero import CORRELATION_MARGIN, believed_zero
from truejoint.compiled import compiled
from truejoint.errors import CalibrationError
from truejoint.robots import get_robot
from truejoint.tip.block import TOUCH_SD, BlockPose

DRIFT: Final = 2.0
"""How far an offset wanders within an hour, in standard deviations of the calibration's errors."""
GATE: Final = 4.0
"""A reading further off than this many standard deviations is left out."""
PATIENCE: Final = 10
"""So many readings left out on end, all on one side, are believed after all."""
PRIOR: Final = 1e3
"""Standard deviation of the offset before any truth, in those of the calibration's errors."""
_WORST_CONDITION: Final = 1e6  # of what three joints do to the tip [m/rad, m/m]

# Rows of the state of each joint; those of its motion come last.
OFFSET, LOCAL, VAR_OFFSET, COVARIANCE, VAR_LOCAL, REJECTED, SIDE, LAST = 0, 1, 2, 3, 4, 5, 6, 7
MOTION: Final = 8
N_STATE: Final = MOTION + N_MOTION


class ReZero:
    """Estimates the offset of each joint, and only that, whenever a true position is known.

    A Kalman filter with two states per joint. The offset drifts as a random walk; it is what is
    given back. The other is the calibration's own error here and now, which has the size and three
    times the correlation time that the model file states: it keeps ten seconds of truth in one
    corner of the workspace from being taken for a thousand independent readings. That time runs
    while the joint moves: a rest is one reading, however long. A reading that does not fit is left
    out, until ten on end do not fit on the same side. What was before the first reading the
    calibration does not know: no offset is known better than `find_zero` has it of a recording that
    begins there.

    Parameters
    ----------
    calibration : CalibrationData
        Its `effort_baseline` states the errors of the corrected positions. Where it holds a fit for
        this, give `fitted_for(rezeroing=True)`, which ``Corrector(..., rezeroing=True)`` runs.
    truth_sd : float or array_like, shape (n_joints,)
        Standard deviation of the truth's own noise [rad or m].
    drift : float
        How far an offset wanders within an hour, in standard deviations of the errors.

    Attributes
    ----------
    offset : ndarray, shape (n_joints,)
        How far true positions are from corrected ones [rad or m]; 0 before any truth.
    sd : ndarray, shape (n_joints,)
        Its standard deviation [rad or m]; infinite before any truth.
    believed : ndarray, shape (n_joints,)
        By how much to move the zero [rad or m], for `Corrector.rezero`: what `sd` leaves to be
        believed of `offset`, as `Zero.believed`.
    rejected : ndarray, shape (n_joints,)
        How many readings on end were left out.

    Raises
    ------
    CalibrationError
        If it is no calibration or has no effort baseline, or a number is out of range.

    Examples
    --------
    >>> rezero = ReZero(model, truth_sd=1e-4)
    >>> rezero.update(0.0, model.correct(test)[0], test.columns("truth", ["jaw"])[0])
    >>> rezero.offset.shape
    (1,)
    """

    def __init__(
        self, calibration: CalibrationData[Any], *, truth_sd: ArrayLike = 0.0, drift: float = DRIFT
    ) -> None:
        baseline = as_calibration(calibration).effort_baseline
        if baseline is None:
            raise CalibrationError(
                f"the calibration of {calibration.robot} does not say how large its errors are; "
                "calibrate it again"
            )
        self._calibration, self._baseline = calibration, baseline
        self._arm, self._joints = (calibration.robot, calibration.arm), calibration.joints
        n_joints = len(calibration.joints)
        noise = floats(truth_sd, "truth_sd", CalibrationError)
        if noise.shape not in ((), (n_joints,)) or not (np.isfinite(noise) & (noise >= 0.0)).all():
            raise CalibrationError(
                f"truth_sd {truth_sd!r:.80}: give one standard deviation of 0 or more, or one for "
                f"each of {', '.join(calibration.joints)}"
            )
        if not 0.0 <= drift < math.inf:
            raise CalibrationError(f"drift {drift!r}: give a finite number of 0 or more")
        self._residual = residual = baseline.residual
        # Truth without any noise would make the two states one.
        noise = np.maximum(np.broadcast_to(noise, n_joints), 1e-2 * residual)
        correlation = CORRELATION_MARGIN * baseline.correlation
        wander = (drift * residual) ** 2 / 3600.0
        self._noise = np.stack([residual, correlation, noise, wander, baseline.step])
        self._state = np.zeros((N_STATE, n_joints))
        self.offset = np.zeros(n_joints)
        self.sd = np.full(n_joints, math.inf)
        self.rejected = self._state[REJECTED]
        self.reset()
        self.update(0.0, np.zeros(n_joints), np.zeros(n_joints))  # compiles
        self.reset()

    def reset(self) -> None:
        """Forget all truth: after a homing, for instance."""
        self._state[:] = 0.0
        self._state[VAR_OFFSET] = (PRIOR * self._residual) ** 2
        self._state[VAR_LOCAL] = self._residual**2
        self._state[[LAST, MOTION + AT]] = np.nan
        self.offset[:] = 0.0
        self.sd[:] = np.inf
        self._running = np.zeros(len(self.offset))

    @property
    def believed(self) -> Array:
        """By how much to move the zero (n_joints,) [rad or m]."""
        return believed_zero(self._calibration, self.offset, self.sd)

    def update(self, t: float, corrected: ArrayLike, truth: ArrayLike) -> None:
        """Take a reading of the truth at `t` [s]; changes `offset` and `sd` in place.

        `corrected` (n_joints,) is what the calibration gave there, without any offset of this class
        [rad or m], `truth` (n_joints,) the true position, NaN for joints where it is not known:
        readings without a truth tell whether the arm is in motion. Those that go back in time are
        left out. Raises CalibrationError if a shape is wrong.
        """
        here = np.asarray(corrected, dtype=np.float64)
        true = np.asarray(truth, dtype=np.float64)
        if here.shape != self.offset.shape or true.shape != self.offset.shape:
            raise CalibrationError(
                f"corrected {here.shape} and truth {true.shape} must hold {len(self.offset)} joints"
            )
        self._take(float(t), here, true, self._noise)

    def _take(self, t: float, here: Array, true: Array, noise: Array) -> None:
        take_truth(t, here, true, noise, self._state, self.offset, self.sd)
        read = np.isfinite(true - here) & (self._state[LAST] == t)  # and not too old
        np.copyto(self._running, self._state[MOTION + IN_MOTION], where=read)
        np.maximum(self.sd, self._baseline.beginning_sd(self._running), out=self.sd)

    def touch(
        self,
        t: float,
        corrected: ArrayLike,
        measured: ArrayLike,
        dimple: str,
        block: BlockPose,
        *,
        touch_sd: float = TOUCH_SD,
    ) -> None:
        """Take a touch of a bolted block at `t` [s]: the tip rests in `dimple`.

        `corrected` (n_joints,) is as for `update`, `measured` (n_robot_joints,) the positions of
        all the robot's joints [rad or m]; `touch_sd` [m] is how far off its dimple a tip rests, per
        axis. The point becomes a truth of each joint, its deviation what touch and pose leave of
        it. The pose's error is the same at each touch, of which `sd` knows nothing.

        Raises CalibrationError if the block is another robot's or has no such dimple, a shape is
        wrong or a number not finite, or the tip does not tell the calibrated joints: it tells
        three, of which none may turn about it.
        """
        robot = get_robot(*self._arm)
        if self._arm != (block.robot, block.arm):
            raise CalibrationError(f"the block is {block.title}, the calibration of {robot.title}")
        here, joint = (np.array(a, dtype=np.float64) for a in (corrected, measured))
        if here.shape != self.offset.shape or joint.shape != (len(robot.joints),):
            raise CalibrationError(
                f"corrected {here.shape} and measured {joint.shape} must hold {len(self.offset)} "
                f"and {len(robot.joints)} joints"
            )
        if not (np.isfinite([*here, *joint]).all() and 0.0 < touch_sd < math.inf):
            raise CalibrationError(
                f"positions at a touch must be finite, and touch_sd {touch_sd!r} m above 0"
            )
        columns, chain = robot.index(self._joints), robot.kinematics
        joint[columns] = here
        slope = np.zeros((3, 0)) if chain is None else chain.jacobian(joint)[:3, columns]
        if chain is None or slope.shape != (3, 3) or np.linalg.cond(slope) > _WORST_CONDITION:
            raise CalibrationError(
                f"a touch of {robot.title} does not tell {', '.join(self._joints)}: it takes known "
                "kinematics, and three joints that move the tip each in its own way"
            )
        point = block.scale * block.block.at((dimple,))[0]
        place = block.rotation @ point
        x, y, z = point
        turned = -block.rotation @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        by_pose = np.hstack([turned, np.eye(3)])
        spread = touch_sd**2 * np.eye(3) + by_pose @ block.covariance @ by_pose.T
        spread += (block.scale_sd / block.scale) ** 2 * np.outer(place, place)
        inverse = np.linalg.inv(slope)
        miss = block.translation + place - chain.forward(joint)[:3, 3]
        noise = self._noise.copy()
        noise[2] = np.maximum(noise[2], np.sqrt(np.diag(inverse @ spread @ inverse.T)))
        true = here + inverse @ miss
        self._take(float(t), here, true, noise)

    def advance(self, t: float) -> None:
        """Let time pass with nothing known: `sd` grows by the drift; `offset` stays."""
        no_truth = np.full(len(self.offset), np.nan)
        self.update(t, no_truth, no_truth)


@compiled
def take_truth(
    t: float, corrected: Array, truth: Array, noise: Array, state: Array, offset: Array, sd: Array
) -> None:
    """Advance every joint's filter to `t` and take its reading, if there is one.

    At `t` [s], of each joint (n_joints,): `corrected` and `truth` [rad or m], NaN where not known.
    `noise` (5, n_joints): size [rad or m] and correlation [s] of the local error, deviation of the
    truth [rad or m], by what the offset's variance grows per second, and by what a joint that is in
    motion goes at least [rad or m]. `state` (12, n_joints) is changed in place; `offset` and `sd`
    [rad or m] receive the estimate.
    """
    motion = state[MOTION:]
    for j in range(offset.shape[0]):
        s, residual, correlation = state[:, j], noise[0, j], noise[1, j]
        elapsed = t - s[LAST]
        if not np.isfinite(t) or elapsed < 0.0:  # false for the first: NaN
            continue
        before = motion[IN_MOTION, j]
        moved = go_on_in_motion(j, t, corrected[j], noise[4, j], motion) - before
        if elapsed > 0.0:
            keep = np.exp(-moved / correlation)
            s[LOCAL] *= keep
            s[VAR_OFFSET] += noise[3, j] * elapsed
            s[COVARIANCE] *= keep
            s[VAR_LOCAL] = keep * keep * s[VAR_LOCAL] + (1.0 - keep * keep) * residual**2
        s[LAST] = t
        innovation = truth[j] - corrected[j] - s[OFFSET] - s[LOCAL]
        if np.isfinite(innovation):
            _take_reading(innovation, noise[2, j] ** 2, s)
        if not np.isinf(sd[j]) or np.isfinite(innovation):
            offset[j] = s[OFFSET]
            sd[j] = np.sqrt(s[VAR_OFFSET])


@compiled
def _take_reading(innovation: float, noise: float, s: Array) -> None:
    """Gate, and Joseph-free update of a joint's two states by one reading."""
    gain_offset = s[VAR_OFFSET] + s[COVARIANCE]
    gain_local = s[COVARIANCE] + s[VAR_LOCAL]
    variance = gain_offset + gain_local + noise
    if not innovation * innovation <= GATE * GATE * variance:
        side = 1.0 if innovation > 0.0 else -1.0
        s[REJECTED] = s[REJECTED] + 1.0 if side == s[SIDE] else 1.0
        s[SIDE] = side
        if s[REJECTED] < PATIENCE:
            return
        # The offset has jumped: by how much is as good as unknown.
        s[VAR_OFFSET] += innovation * innovation
        gain_offset += innovation * innovation
        variance += innovation * innovation
    s[REJECTED] = 0.0
    gain_offset /= variance
    gain_local /= variance
    s[OFFSET] += gain_offset * innovation
    s[LOCAL] += gain_local * innovation
    # P - K S K', written for two states; what rounding may make negative is kept at zero.
    s[VAR_OFFSET] = max(0.0, s[VAR_OFFSET] - gain_offset * gain_offset * variance)
    s[COVARIANCE] -= gain_offset * gain_local * variance
    s[VAR_LOCAL] = max(0.0, s[VAR_LOCAL] - gain_local * gain_local * variance)
