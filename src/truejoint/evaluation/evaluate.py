"""Evaluate calibrations on recordings that they never saw, always beside the baselines."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

from truejoint.calibration import Calibration, read_calibration
from truejoint.errors import CalibrationError, other_kind
from truejoint.evaluation.results import Evaluation
from truejoint.evaluation.tested import JointCalibration
from truejoint.evaluation.trial import Trial, estimator_of
from truejoint.recordings.judge.data_check import DataCheck
from truejoint.recordings.table.recording import Recording, as_recordings

Model = Calibration | str | os.PathLike[str]


def evaluate(
    models: Model | Sequence[Model] | Mapping[str, Model | Sequence[Model | JointCalibration]],
    recordings: Recording | Sequence[Recording],
    *,
    chosen: str | None = None,
    tolerance: Mapping[str, float] | None = None,
    window: float = 10.0,
    rezero: float = 0.0,
    check: DataCheck | None = None,
) -> Evaluation:
    """Accuracy of calibrations on test recordings, per joint, per recording and of the tool.

    Raw positions, the fixed offset, the linear and the polynomial model are always in the
    table, the latter three as fitted on the training rows of the chosen calibration. Models see
    whole recordings, so their history is right; only rows with truth are judged. The recordings
    themselves are checked (`check_data`), and judged row by row as the loop would.

    Parameters
    ----------
    models : Calibration, path of a model file, sequence of these, or mapping of str to these
        All must correct the same joints. Several of one estimator are seeds of it: curves and
        stretches show the first. A mapping is by estimator.
    recordings : Recording or sequence of Recording
        With ``truth/<joint>`` of every calibrated joint.
    chosen : str, optional
        Estimator that the verdict is about; the first of `models` by default.
    tolerance : mapping of str to float, optional
        Largest RMSE [rad or m] that the user accepts, by joint; see `judge`.
    window : float
        Length [s] of the worst stretches.
    rezero : float
        When above 0, the first `rezero` seconds of truth of every recording set the zero of every
        model and baseline, and are not judged: the accuracy of motions that begin so. Where a
        calibration has a fit for that, it is the one that is judged. The raw position stays as
        it comes; a calibration that is the raw position goes by ``raw, re-zeroed`` then.
    check : DataCheck, optional
        Of these recordings, where it was made already; a check that failed is a doubt.

    Raises
    ------
    CalibrationError
        If there is nothing to evaluate, calibrations differ in joints, or a tolerance or time is
        wrong.
    RecordingError
        If a recording lacks truth beyond what re-zeroes it, or is of another arm than the first.

    Examples
    --------
    >>> evaluation = truejoint.evaluate(model, test)
    >>> evaluation.verdict.passed
    True
    """
    _check_times(window, rezero)
    trial = Trial.of(_by_estimator(models), as_recordings(recordings), chosen, rezero)
    return trial.evaluation(tolerance or {}, window, check or trial.data_check())


def _check_times(window: float, rezero: float) -> None:
    if not (isinstance(rezero, Real) and 0.0 <= rezero < math.inf):
        raise CalibrationError(
            f"the time to re-zero from is {rezero!r:.40} s; it must be 0 s or more"
        )
    if not (isinstance(window, Real) and 0.0 < window < math.inf):
        raise CalibrationError(
            f"the window of worst stretches is {window!r:.40} s; it must be > 0 s"
        )


def _by_estimator(
    models: Model | Sequence[Model] | Mapping[str, Model | Sequence[Model | JointCalibration]],
) -> Mapping[str, Sequence[JointCalibration]]:
    if isinstance(models, Mapping):
        return {k: [_read(one) for one in _several(v)] for k, v in models.items()}
    found: dict[str, list[JointCalibration]] = {}
    for model in map(_read, _several(models)):
        found.setdefault(estimator_of(model) or type(model).__name__, []).append(model)
    return found


def _several(given: Any) -> Sequence[Any]:
    return given if isinstance(given, list | tuple) else [given]


def _read(given: Any) -> JointCalibration:
    """Give a model, or that of a file; raises CalibrationError for what is none."""
    model = read_calibration(given) if isinstance(given, str | os.PathLike) else given
    if not all(hasattr(model, name) for name in ("correct", "joints", "baselines", "metadata")):
        advice = "give what `calibrate` gives, or the path of a model file"
        raise CalibrationError(other_kind(model, "Calibration", advice))
    found: JointCalibration = model
    return found
