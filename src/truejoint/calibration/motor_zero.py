"""A jaw's zero by its motor side, and the stiffness of its drive cable by weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from truejoint.calibration.calibration import as_calibration
from truejoint.calibration.compatibility import source_of
from truejoint.calibration.zero import Zero
from truejoint.errors import CalibrationError
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.learn import (
    EncoderZero,
    FrictionFilter,
    Stiffness,
    find_encoder_zero,
    identify_stiffness,
)
from truejoint.estimators.registry import name_of
from truejoint.units import GRAVITY

if TYPE_CHECKING:
    from truejoint.calibration.calibration import Calibration
    from truejoint.recordings import Recording


def with_stiffness(
    calibration: Calibration, recordings: Sequence[Recording], arm: float, last: float = 5.0
) -> tuple[Calibration, Stiffness]:
    """Identify the drive cable's stiffness by weights, for loads that are right in size.

    Parameters
    ----------
    calibration : Calibration
        Of ``ukf_friction``, made of a motion without a load.
    recordings : sequence of Recording
        One a weight, whose mass is the `load` of its provenance; which way it pulls is seen.
    arm : float
        Lever of the weights [m].
    last : float
        Time at the end of each recording for which the weight hangs freely [s]: on a jaw that
        goes slowly there and back, whole cycles, or one that stands, which tells less.

    Returns
    -------
    Calibration, Stiffness
        The calibration with what was found, and what that is.

    Raises
    ------
    CalibrationError
        If the calibration tells no load, a recording states no weight, arm or time is not above 0,
        or the weights tell no stiffness: see `identify_stiffness`.

    Examples
    --------
    >>> with_stiffness(model, [test], arm=0.0135)
    Traceback (most recent call last):
        ...
    truejoint.errors.CalibrationError: linear tells no load; calibrate with -e ukf_friction
    """
    model = _friction_filter(calibration, "tells no load")
    for name, value in (("arm", arm), ("time at the end", last)):
        if not value > 0.0:
            raise CalibrationError(f"{name} of the weights is {value!r:.40}; it must be above 0")
    inputs, steps, torques = [], [], []
    for recording in recordings:
        mass = recording.provenance.load
        if not mass > 0.0:
            raise CalibrationError(
                f"{source_of(recording)}: its weight is not stated; say it with "
                "--metadata load_grams=, or as the load of its provenance"
            )
        rows = calibration.rows(recording)
        hangs = rows.t > rows.t[-1] - last
        side = -np.sign(float(model.states(rows.X, rows.dt).states[hangs, -1].mean())) or 1.0
        torques.append(np.where(hangs, side * mass * GRAVITY * arm, np.nan))
        inputs.append(rows.X)
        steps.append(rows.dt)
    if not inputs:
        raise CalibrationError("no recording of a weight; give one at least")
    X, torque, dt = map(np.concatenate, (inputs, torques, steps))
    stiffness = identify_stiffness(model, X, torque, dt)
    stiff = model.with_stiffness(stiffness)
    weighed = replace(calibration, fitted=stiff.data, learnt=stiff)
    return weighed.with_metadata(stiffness=vars(stiffness)), stiffness


def motor_zero(
    calibration: Calibration, recording: Recording, by: Calibration | None = None
) -> tuple[Zero, EncoderZero]:
    """Zero of a jaw by its motor side: by how much this homing set the reset encoder's zero wrong.

    No sensor at the jaw is needed; see `find_encoder_zero`.

    Parameters
    ----------
    calibration : Calibration
        Of any estimator that reads ``cable/reset``.
    recording : Recording
        Whole cycles about zero after the homing, without a load.
    by : Calibration, optional
        Of ``ukf_friction``, made of the same motion; `calibration` itself by default.

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
    model = _friction_filter(by, "finds no zero")
    if RESET not in calibration.signals or calibration.target != "position":
        raise CalibrationError(
            f"{calibration.estimator} takes no jaw's position from {RESET}; there is no zero of it"
        )
    if calibration.for_rezeroing.moves is not None:
        raise CalibrationError(
            "the calibration has zeros of its own already; give the one that calibrate wrote"
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


def _friction_filter(calibration: Calibration, lacks: str) -> FrictionFilter:
    model = as_calibration(calibration).model
    if not isinstance(model, FrictionFilter):
        wanted = name_of(FrictionFilter())
        raise CalibrationError(f"{calibration.estimator} {lacks}; calibrate with -e {wanted}")
    return model
