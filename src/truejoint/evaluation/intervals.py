"""How often the truth of the test lay within the interval that the calibration states."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import PurePath

from truejoint.errors import CalibrationError
from truejoint.estimators.calibration import Calibration
from truejoint.estimators.interval_checks import measure_coverage
from truejoint.estimators.uncertainty import made_interval_of
from truejoint.evaluation.results import IntervalScore
from truejoint.recordings.recording import Recording


def interval_scores(
    calibration: object, recordings: Sequence[Recording]
) -> tuple[tuple[IntervalScore, ...], str]:
    """Coverage of each stated level in each joint, and what a reader has to know about it.

    Parameters
    ----------
    calibration : object
        A `Calibration` with an interval; of anything else there is nothing to tell.
    recordings : sequence of Recording
        Of the test.

    Returns
    -------
    scores : tuple of IntervalScore
        Empty where the note says why.
    note : str
    """
    interval = calibration.interval if isinstance(calibration, Calibration) else None
    if not isinstance(calibration, Calibration) or interval is None:
        return (), "The model states no interval: it was not given recordings to make one of."
    scores = []
    for level in interval.levels:
        try:
            found = measure_coverage(calibration, recordings, float(level))
        except CalibrationError as error:
            return (), f"The interval could not be judged: {error}."
        scores += [
            IntervalScore(
                joint=joint,
                unit=calibration.units[f"measured/{joint}"],
                level=float(level),
                coverage=float(found.mean[k]),
                standard_error=float(found.standard_error[k]),
                half_width=float(found.half_width[k]),
                offset_half_width=float(found.offset_half_width[k]),
            )
            for k, joint in enumerate(calibration.joints)
        ]
    seen = [r for r in recordings if made_interval_of(calibration.metadata, r)]
    note = f"Stated {interval.meaning}."
    if seen:
        name = PurePath(seen[0].provenance.source).name or "a recording"
        note += f" It was made of {name}, which it is judged on here: coverage is flattered."
    return tuple(scores), note
