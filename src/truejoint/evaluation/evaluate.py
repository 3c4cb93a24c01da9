"""Evaluate calibrations on recordings that they never saw, always beside the baselines.

What is held out are whole recordings, or blocks of time with a gap; never shuffled samples.
Neighbouring samples of a motion are almost copies of each other: a split that shuffles them puts
the copies on both sides and measures memory rather than accuracy.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import chain, product
from numbers import Real
from pathlib import PurePath
from typing import Any, Final

import numpy as np
import pandas as pd
from pandas import DataFrame

from truejoint.calibration import Calibration, read_calibration
from truejoint.calibration.calibration import as_calibration
from truejoint.calibration.compatibility import common_robot
from truejoint.calibration.conditions import conditions_of
from truejoint.errors import CalibrationError, RecordingError, unknown
from truejoint.evaluation import scoring
from truejoint.evaluation.paired_test import compare, cycle_rows
from truejoint.evaluation.results import BASELINES, OFFSET, RAW, Evaluation, by_recording
from truejoint.evaluation.verdict import (
    PLAIN,
    advise,
    doubts_about,
    judge,
    objections_to,
    rezero_remarks,
)
from truejoint.recordings import check_data
from truejoint.recordings.datasets import Dataset, HeldOut
from truejoint.recordings.judge.data_check import DataCheck
from truejoint.recordings.table.recording import Recording, as_recording, as_recordings
from truejoint.summary import json_values

Model = Calibration | str | os.PathLike[str]
Models = Mapping[str, Sequence[Calibration]]

_GAP: Final = 1.0  # s between the two sides, so that no row of one has a neighbour on the other
_COMPARED: Final = ["model", "estimator", "joint", "outcome", "stretches", "seconds"]
_REZEROED_RAW: Final = f"{RAW}, re-zeroed"  # a chosen raw position, beside the baseline


def evaluate(
    models: Model | Sequence[Model] | Mapping[str, Model | Sequence[Model]],
    recordings: Recording | Sequence[Recording],
    *,
    chosen: str | None = None,
    tolerance: Mapping[str, float] | None = None,
    rezero: float = 0.0,
    check: DataCheck | None = None,
) -> Evaluation:
    """Accuracy of calibrations on test recordings, per joint, per recording and of the tool.

    Raw positions, the fixed offset, the linear and the polynomial model are always in the table.
    The latter three are fitted on the training rows of the chosen calibration. Models see whole
    recordings, so their history is right; only rows with truth are judged. The recordings
    themselves are checked (`check_data`), and judged row by row as the loop would.

    Parameters
    ----------
    models : Calibration, path of a model file, sequence of these, or mapping of str to these
        All must correct the same joints. Several of one estimator are seeds of it: errors and
        stretches show the first. A mapping is by estimator.
    recordings : Recording or sequence of Recording
        With ``truth/<joint>`` of every calibrated joint.
    chosen : str, optional
        Estimator that the verdict is about, and that the advice keeps where nothing better is
        certain; the first of `models` by default, and of several none is kept.
    tolerance : mapping of str to float, optional
        Largest RMSE [rad or m] that the user accepts, by joint; see `judge`.
    rezero : float
        When above 0, the first `rezero` seconds of truth of every recording set the zero of every
        model and baseline, and are not judged: the accuracy of motions that begin so. If a
        calibration has a fit for that, this one is judged. The raw position stays unchanged; a
        calibration that is the raw position goes by ``raw, re-zeroed`` then.
    check : DataCheck, optional
        Data check of these recordings, where it was made already; a check that failed is a doubt.

    Raises
    ------
    CalibrationError
        If there is nothing to evaluate, calibrations differ in joints or recordings in arms, or a
        tolerance or time is wrong.
    RecordingError
        If a recording lacks truth beyond what re-zeroes it.

    Examples
    --------
    >>> evaluation = truejoint.evaluate(model, test)
    >>> evaluation.verdict.passed
    True
    """
    if not (isinstance(rezero, Real) and 0.0 <= rezero < math.inf):
        raise CalibrationError(
            f"the time to re-zero from is {rezero!r:.40} s; it must be 0 s or more"
        )
    # A raw position that is re-zeroed is no correction, but not as it comes: another row.
    renamed = {RAW: _REZEROED_RAW} if rezero > 0.0 else {}
    by_estimator = {renamed.get(name, name): own for name, own in _by_estimator(models).items()}
    recordings, chosen = as_recordings(recordings), renamed.get(chosen or "", chosen)
    in_use = chosen or (next(iter(by_estimator)) if len(by_estimator) == 1 else "")
    calibrations = {
        name: [seed.for_rezeroing if rezero > 0.0 else seed for seed in seeds]
        for name, seeds in by_estimator.items()
    }
    chosen, joints = _checked_models(calibrations, chosen)
    robot, model = common_robot(recordings), calibrations[chosen][0]
    check = check or check_data(recordings, joints=joints, model=model)
    units = {joint: robot.joint(joint).unit for joint in joints}
    note = scoring.why_no_cartesian(robot, recordings)
    against = _with_baselines(calibrations, chosen)
    names = unique_names([recording.provenance.source for recording in recordings])
    judged = [
        scoring.judge_recording(
            recording, name, against, joints, None if note else robot, chosen, rezero
        )
        for recording, name in zip(recordings, names, strict=True)
    ]
    by_seed, rows = (pd.concat(parts, join="inner") for parts in zip(*judged, strict=True))
    errors = by_seed.xs(0, axis=1, level="seed")
    domain = scoring.domain_of(rows)
    scores = scoring.score_errors(by_seed, rows, units)
    pairs = [(chosen, name) for name in errors.columns.unique("estimator") if name != chosen]
    comparisons = compare_models(errors, rows, joints, pairs).drop(columns="model")
    of_plain = {name for name, seeds in calibrations.items() if seeds[0].estimator in PLAIN}
    verdict = judge(
        scores,
        chosen,
        tolerance=tolerance,
        comparisons=comparisons,
        advice=advise(
            errors,
            rows,
            in_use,
            plain=PLAIN | of_plain,
            automatic=any("choice" in own.metadata for own in chain(*calibrations.values())),
        ),
        objections=tuple(dict.fromkeys(objections_to(model.origin, recordings, domain))),
        doubts=tuple(doubts_about(model.origin, model.zero, recordings, domain, check, rezero)),
    )
    remarks: list[str] = []
    if rezero > 0.0:
        plain = by_estimator[chosen][0]
        plain_errors = [
            plain.correct(recording)[np.isin(recording.t, own["t"])] - own["truth"].to_numpy()
            for recording, (_, own) in zip(recordings, judged, strict=True)
        ]
        as_they_come = scoring.rmse(np.concatenate(plain_errors))
        remarks += rezero_remarks(verdict.joints, as_they_come, rezero)
    tested = {n: conditions_of(r, joints) for n, r in zip(names, recordings, strict=True)}
    learnt = [c for session in model.origin.sessions for c in session.conditions]
    remarks += list(scoring.unlike(learnt, tested, recordings[0].units)) or scoring.warned(rows)
    return Evaluation(
        robot=robot.name,
        arm=robot.arm,
        title=robot.title,
        joints=joints,
        units=tuple(units.values()),
        chosen=chosen,
        estimators=tuple(errors.columns.unique("estimator")),
        baseline_notes=dict(model.origin.baseline_notes),
        errors=errors,
        scores=scores,
        recording_scores=scoring.score_recordings(by_seed, rows, units),
        cartesian_note=note,
        worst=scoring.worst_stretches(rows, errors[chosen], verdict.joints),
        rezero=rezero,
        verdict=replace(verdict, remarks=tuple(remarks)),
        check=check,
        domain=domain,
        comparisons=comparisons,
        training=json_values(model.facts),
        test=tuple(
            {"name": name, "rows": len(own), "rows_total": len(r), **r.provenance.to_dict()}
            for r, name, (own, _) in zip(recordings, names, judged, strict=True)
        ),
        effort_units={j: recordings[0].units[f"effort/{j}"] for j in rows.get("effort", ())},
        **scoring.judge_interval(by_estimator[chosen][0], recordings, rows),
    )


def compare_models(
    errors: DataFrame, rows: DataFrame, joints: Sequence[str], pairs: Sequence[tuple[str, str]]
) -> DataFrame:
    """Compare each ``"model"`` with an ``"estimator"``: see `Evaluation.comparisons`."""
    parts, t = by_recording(rows.index), rows["t"].to_numpy()
    step = float(np.median(np.concatenate([np.diff(t[part]) for part in parts])))
    least = cycle_rows([rows["direction"].to_numpy()[part] for part in parts])
    compared = []
    for joint, names in product(joints, pairs):
        own, other = ([errors[name, joint].to_numpy()[part] for part in parts] for name in names)
        difference = compare(own, other, least)
        seconds = difference.rows * step
        compared.append((*names, joint, difference.outcome, difference.stretches, seconds))
    return DataFrame(compared, columns=_COMPARED)


def _by_estimator(models: Any) -> dict[str, list[Calibration]]:
    """Calibrations, read where they are files; raises CalibrationError for what is none."""
    grouped: dict[str, list[Calibration]] = {}
    for name, several in models.items() if isinstance(models, Mapping) else [(None, models)]:
        if name is not None:
            grouped[name] = []
        for item in several if isinstance(several, list | tuple) else [several]:
            is_path = isinstance(item, str | os.PathLike)
            model = read_calibration(item) if is_path else as_calibration(item)
            grouped.setdefault(model.estimator if name is None else name, []).append(model)
    return grouped


def _checked_models(calibrations: Models, chosen: str | None) -> tuple[str, tuple[str, ...]]:
    if not calibrations or not all(calibrations.values()):
        raise CalibrationError("there is no calibration to evaluate; give at least one")
    chosen = chosen or next(iter(calibrations))
    if chosen not in calibrations:
        raise CalibrationError(f"the verdict: {unknown('calibration', chosen, calibrations)}")
    joints = tuple(calibrations[chosen][0].joints)
    for name, seed in ((name, seed) for name, seeds in calibrations.items() for seed in seeds):
        if tuple(seed.joints) != joints:
            raise CalibrationError(
                f"{name} corrects {', '.join(seed.joints)} but {chosen} corrects "
                f"{', '.join(joints)}; compare calibrations of the same joints"
            )
    return chosen, joints


def _with_baselines(calibrations: Models, chosen: str) -> Models:
    """Models by estimator, baselines first; one that is given, by any name, replaces its baseline.

    The fixed offset stays, as the yardstick.
    """
    given = {seed.estimator for seeds in calibrations.values() for seed in seeds} - {OFFSET}
    baselines = calibrations[chosen][0].baselines.items()
    models = {name: [model] for name, model in baselines if name not in given} | dict(calibrations)
    if OFFSET not in models:
        raise CalibrationError(
            f"the calibration {chosen} carries no fixed offset, the yardstick; calibrate it again"
        )
    return {n: models[n] for n in dict.fromkeys((*BASELINES, *calibrations)) if n in models}


def unique_names(sources: Sequence[str]) -> list[str]:
    """Short names of recordings: the file's name, with its folder where two are the same."""
    short = [PurePath(source).name or "recording" for source in sources]
    longer = [
        "/".join(PurePath(source).parts[-2:]) if short.count(name) > 1 and source else name
        for source, name in zip(sources, short, strict=True)
    ]
    return [
        name if longer.count(name) == 1 else f"{name} #{longer[: i + 1].count(name)}"
        for i, name in enumerate(longer)
    ]


def part_by_time(recording: Recording, begin: float, end: float) -> Recording:
    """Part of a recording between two fractions of its duration.

    Parameters
    ----------
    recording : Recording
    begin, end : float
        Fractions with ``0 <= begin < end <= 1``; a row at `begin` belongs to the part, a row at
        `end` only if `end` is 1, so that parts that meet share no row.

    Raises
    ------
    RecordingError
        If the fractions are out of range or the part would hold fewer than 2 rows.

    Examples
    --------
    >>> part_by_time(test, 0.0, 0.25).duration
    0.99
    """
    name = as_recording(recording).provenance.source or "recording"
    if not 0.0 <= begin < end <= 1.0:
        raise RecordingError(
            f"{name}: part {begin:g} to {end:g} is not within 0 to 1, in this order; choose other "
            "fractions of the duration"
        )
    done = (recording.t - recording.t[0]) / recording.duration
    rows = (done >= begin) & ((done < end) if end < 1.0 else True)
    if rows.sum() < 2:
        raise RecordingError(
            f"{name}: the part from {begin:g} to {end:g} of {recording.duration:.1f} s holds "
            f"{int(rows.sum())} rows; choose a longer part"
        )
    return recording.rows(rows)


def split_sides(
    recordings: Sequence[Recording], dataset: Dataset, split: HeldOut
) -> tuple[list[Recording], list[Recording]]:
    """Training and held-out side of all recordings of a data set's split, in its order."""
    if split.test:
        out = [split.holds_out(name) for name in dataset.match(split.files)]
        pairs = list(zip(recordings, out, strict=True))
        return [r for r, held in pairs if not held], [r for r, held in pairs if held]
    training, testing = [], []
    for recording in recordings:
        boundary = recording.t[0] + (1.0 - split.test_fraction) * recording.duration
        training.append(recording.rows(recording.t < boundary))
        testing.append(recording.rows(recording.t >= boundary + _GAP))
    return training, testing
