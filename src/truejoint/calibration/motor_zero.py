"""A jaw's zero by its motor side."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from truejoint.calibration.calibration import as_calibration
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.learn import EncoderZero, FrictionFilter, find_encoder_zero
from truejoint.estimators.registry import name_of

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


def motor_zero(
    calibration: Calibration, recording: Recording, by: Calibration | None = None
) -> tuple[Zero, EncoderZero]:
    """Zero of a jaw by its motor side: by how much this homing set the reset encoder's zero wrong.

    No sensor at the jaw is needed; see `find_encoder_zero`.

    Parameters
    ----------
    calibration : Calibration
        Calibration of any estimator that reads ``cable/reset``.
    recording : Recording
        Whole cycles about zero after the homing, without a load.
    by : Calibration, optional
        Calibration of ``ukf_friction``, made of the same motion; `calibration` itself by default.

    Returns
    -------
    Zero, EncoderZero
        The zero for `Calibration.at`, which moves nothing where a correction would be as likely to
        harm, and what it rests on.

    Raises
    ------
    CalibrationError
        If either calibration is not as it must be, or the motion determines no zero.

    Examples
    --------
    >>> motor_zero(model, test)
    Traceback (most recent call last):
        ...
    truejoint.errors.CalibrationError: linear finds no zero; calibrate with -e ukf_friction
    """
    by = calibration if by is None else by
    model = as_calibration(by).model
    if not isinstance(model, FrictionFilter):
        wanted = name_of(FrictionFilter())
        raise CalibrationError(f"{by.estimator} finds no zero; calibrate with -e {wanted}")
    if RESET not in calibration.signals or calibration.target != "position":
        raise CalibrationError(
            f"{calibration.estimator} takes no jaw's position from {RESET}; there is no zero of it"
        )
    if calibration.for_rezeroing.moves is not None:
        raise CalibrationError(
            "the calibration has its own zeros already; give the one that calibrate wrote"
        )
    rows = by.rows(recording)
    found = find_encoder_zero(model, rows.X, rows.dt)
    origin = recording.provenance
    if origin.load > 0.0:
        raise CalibrationError(
            f"{source_of(recording)}: a load of {1e3 * origin.load:g} g on the jaw; its zero is "
            "that of a motion without one"
        )
    # A zero of the jaw that moves x2 by as much as it is off.
    moves = np.zeros((len(calibration.signals), len(calibration.joints)))
    moves[calibration.signals.index(RESET)] = model.jaw_radius
    offset = np.full(len(calibration.joints), -found.correction / model.jaw_radius)
    zero = Zero(
        offset, source="motor", file=origin.source, homing_id=origin.homing_id, rows=len(rows),
        duration=recording.duration, moves=moves, details=vars(found),
    )  # fmt: skip
    return zero, found
