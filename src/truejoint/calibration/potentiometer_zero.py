"""A zero by potentiometers: how far a power-on preloaded the encoders from that of the training."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from truejoint.calibration.calibration import Calibration, as_calibration
from truejoint.calibration.compatibility import check_columns, source_of
from truejoint.calibration.potentiometers import PotentiometerReference, by_stretch
from truejoint.calibration.zero import Zero, believed
from truejoint.errors import CalibrationError

if TYPE_CHECKING:
    from truejoint.recordings import Recording

_FEWEST: Final = 6  # stretches that a joint moves through at least
_LEAST_ROWS: Final = 2  # readings of a stretch that counts
_ROUNDS: Final = 3
_DISAGREE: Final = 2.0  # deviations of a reading, by which stretches may differ in what moved


def potentiometer_zero(calibration: Calibration, recording: Recording) -> Zero:
    """Zero of a calibration by potentiometers: by how much this power-on preloaded encoders anew.

    A potentiometer's own offset, scale and linearity error are in the reference of the same stretch
    of its range. The mean difference to that over the stretches is how far the encoders moved. Its
    deviation comes from how much stretches differ, and resemble the next ones. A potentiometer
    whose offset itself drifted is taken for an encoder that moved.

    The recording is of a slow motion with ``pot/<joint>``, as the training recordings were, through
    a quarter of each joint's trained range at least. A joint that moved less, or lacks it, keeps
    its zero; its deviation is NaN. Raises CalibrationError if the calibration keeps no reference or
    was re-zeroed before, the recording does not fit, all joints hardly moved, or the stretches of a
    joint disagree.

    Examples
    --------
    >>> potentiometer_zero(model, test)
    Traceback (most recent call last):
        ...
    truejoint.errors.CalibrationError: the calibration of davinci_grasper keeps no reference ...
    """
    reference = as_calibration(calibration).potentiometers
    if reference is None:
        raise CalibrationError(
            f"the calibration of {calibration.title} keeps no reference of potentiometers; "
            "calibrate anew from recordings with pot/<joint>"
        )
    if calibration.zero is not None:
        raise CalibrationError("it was re-zeroed before; give the model that calibrate wrote")
    calibration.check_recording(recording)
    joints = [calibration.joints[k] for k in np.flatnonzero(reference.rows.any(axis=1))]
    joints = [joint for joint in joints if f"pot/{joint}" in recording.units] or joints
    check_columns(recording, [f"pot/{j}" for j in joints], "reference of the potentiometers needs")
    offset, deviation = np.zeros(len(reference.lower)), np.full(len(reference.lower), math.nan)
    for joint in joints:
        k = calibration.joints.index(joint)
        move = _moved(reference, k, recording, joint)
        if move is not None:
            offset[k], deviation[k] = move
    if np.isnan(deviation).all():
        raise CalibrationError(
            f"{source_of(recording)}: {', '.join(joints)} hardly moved; move each through a "
            "quarter of its trained range, slowly, there and back"
        )
    origin = recording.provenance
    return Zero(
        offset, deviation, np.where(np.isnan(deviation), 0.0, believed(offset, deviation)),
        source="potentiometers", file=origin.source, homing_id=origin.homing_id,
        rows=len(recording), duration=recording.duration,
    )  # fmt: skip


def _moved(
    reference: PotentiometerReference, k: int, recording: Recording, joint: str
) -> tuple[float, float] | None:
    """How far a potentiometer's difference moved, and its deviation; None if the joint rested."""
    pot, offset = recording.column(f"pot/{joint}"), 0.0
    for _ in range(_ROUNDS):  # a reading belongs to the stretch that it lay in before the move
        position = recording.column(f"measured/{joint}") + offset
        lower, upper = reference.lower[k], reference.upper[k]
        inside = (position >= lower) & (position <= upper)
        _, rows, now = by_stretch(position[inside], (pot - position)[inside], lower, upper)
        usable = np.minimum(rows, reference.rows[k]) >= _LEAST_ROWS
        if usable.sum() < _FEWEST:
            return None
        weight = 1.0 / (1.0 / rows[usable] + 1.0 / reference.rows[k][usable])
        residual = (now - reference.difference[k])[usable]
        moved = float(np.average(residual, weights=weight))
        offset, residual = offset + moved, residual - moved
    square = float(np.average(residual**2, weights=weight))
    ratio = math.sqrt(square) / reference.residual[k]
    if ratio > _DISAGREE:
        raise CalibrationError(
            f"{source_of(recording)}: the potentiometer of {joint} disagrees with its reference by "
            f"{ratio:.1f} standard deviations of a reading along its range; look whether it slips, "
            "and calibrate anew"
        )
    # Neighbours that are alike count for less than one each.
    alike = float(
        np.clip((residual[1:] * residual[:-1]).sum() / max((residual**2).sum(), 1e-300), 0.0, 0.9)
    )
    freedom = (len(residual) - 1) * (1.0 - alike) / (1.0 + alike)
    return offset, math.sqrt(square / max(freedom, 1.0))
