"""The frame of errors of every model on the test, and what is made of it.

An error is the estimated position minus the true one, in the joint's SI unit (rad or m).
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import PurePath
from typing import Any, Final, cast

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas import DataFrame
from scipy.special import stdtrit

from truejoint.array_types import Array, floats
from truejoint.calibration.calibration import Calibration
from truejoint.calibration.conditions import Condition
from truejoint.calibration.interval import Interval
from truejoint.calibration.truth_zero import at_start, zeroed
from truejoint.errors import CalibrationError, RecordingError, other_kind
from truejoint.evaluation.results import AXES, OFFSET, RAW, TOOL, Domain, JointVerdict, by_recording
from truejoint.recordings.table.recording import Recording
from truejoint.recordings.table.stream import direction, velocity
from truejoint.robots import Kinematics, Robot
from truejoint.runtime import Status, Unlearnt
from truejoint.runtime.corrector import corrector_for
from truejoint.runtime.limits import believable_corrections
from truejoint.tables import share_text
from truejoint.toml_file import shipped_table
from truejoint.units import shown, shown_range

WINDOW: Final = 10.0  # s, length of the worst stretches
_STILL = 1e-9  # m per rad or m per m; below, a joint does not move the tool
_PROBES = 20
_COUNT = 3  # worst windows of each joint
_WORST: Final = ["joint", "unit", "recording", "start", "end", "rmse", "max_abs", "ratio"]
_HOMING = ~int(Status.NOT_HOMED | Status.HOMED_AGAIN)
_NAMED: Final = 4  # recordings that a sentence names
_LEVELS = ["estimator", "seed", "joint"]  # of the columns of a frame of errors


def rmse(error: ArrayLike) -> Array:
    """Root mean square of errors over time, shape () or (n_joints,): ``sqrt(mean(error**2))``.

    Parameters
    ----------
    error : array_like, shape (n,) or (n, n_joints)
        Estimated minus true position [rad or m].

    Raises
    ------
    CalibrationError
        If there is no row, or a value that is not finite.

    Examples
    --------
    >>> print(rmse([0.3, -0.4, 0.0]).round(3))
    0.289
    """
    values = floats(error, "errors", CalibrationError)
    if values.shape[:1] in ((), (0,)):
        raise CalibrationError(
            "no row has both an estimate and a true position; evaluate on recordings with truth"
        )
    if not np.isfinite(values).all():
        raise CalibrationError(
            "an error is not finite; select the rows with truth before computing metrics"
        )
    return np.asarray(np.sqrt(np.mean(np.square(values), axis=0)))


def tool_error(kinematics: Kinematics, estimated: ArrayLike, true: ArrayLike) -> Array:
    """Error (n, 3) of the tool position [m], x, y, z in the base frame, by errors of the joints.

    Both joint vectors go through the same forward kinematics, so errors of the geometry itself
    cancel, as in peng2024, Table IV.

    Parameters
    ----------
    kinematics : Kinematics
    estimated, true : array_like, shape (n, n_joints)
        Joint positions [rad or m] of all joints of the robot; joints without truth hold the
        same value in both.

    Raises
    ------
    CalibrationError
        If the kinematics are none.

    Examples
    --------
    >>> robot = truejoint.get_robot("raven2")
    >>> moved = robot.home + [0, 0, 0.001, 0, 0, 0, 0]
    >>> print(np.linalg.norm(tool_error(robot.kinematics, moved, robot.home)).round(6))
    0.001
    """
    if not hasattr(kinematics, "forward"):
        advice = "give the `kinematics` of a robot of which they are known"
        raise CalibrationError(other_kind(kinematics, "Kinematics", advice))
    error = kinematics.forward(estimated) - kinematics.forward(true)
    return error[..., :3, 3]


def judge_recording(
    recording: Recording,
    name: str,
    models: Mapping[str, Sequence[Calibration]],
    joints: tuple[str, ...],
    robot: Robot | None,
    chosen: str,
    rezero: float,
) -> tuple[DataFrame, DataFrame]:
    """`Evaluation.errors` and `Evaluation.rows` of a recording; of the tool too with a `robot`.

    The first `rezero` seconds of truth set every zero, and are not judged. Raises RecordingError if
    fewer than two rows are left, CalibrationError if a model gives no number for one.
    """
    truth, measured = (recording.columns(key, joints) for key in ("truth", "measured"))
    judged = np.asarray(np.isfinite(truth).all(axis=1))
    if judged.any():
        judged[judged] = ~at_start(recording.t[judged], rezero)
    if judged.sum() < 2:
        besides = f" after the {rezero:g} s that re-zero it" if rezero > 0.0 else ""
        raise RecordingError(
            f"{recording.provenance.source or 'recording'}: {int(judged.sum())} rows have the "
            f"truth of {', '.join(joints)}{besides}; a test needs at least 2"
        )
    positions, inputs = {(RAW, 0): measured}, models[chosen][0].rows(recording)
    for key, seeds in models.items():
        for number, seed in enumerate(seeds):
            seed.check_recording(recording)  # rows that several see alike may be of another robot
            positions[key, number] = zeroed(seed, inputs, rezero).correct(inputs)
    for (key, _), position in positions.items():
        if (bad := ~np.isfinite(position).all(axis=1)).any():
            raise CalibrationError(
                f"{key} gives no number for row {int(np.argmax(bad))} of {name}; the model "
                "does not apply to this recording"
            )
    index = pd.Index([name] * int(judged.sum()), name="recording")
    true = truth[judged]
    errors = {key: position[judged] - true for key, position in positions.items()}
    columns, tables = list(joints), {"truth": DataFrame(true, index, joints)}
    if robot is not None and robot.kinematics is not None:
        columns += [*AXES, TOOL]
        joint, moved = all_joints(recording, robot)[judged], robot.index(list(joints))
        joint[:, moved] = true
        at = robot.kinematics.forward(joint)[..., :3, 3]
        tables["tool"] = DataFrame(at, index, AXES)
        for which, position in positions.items():
            joint[:, moved] = position[judged]
            off = robot.kinematics.forward(joint)[..., :3, 3] - at
            errors[which] = np.column_stack([errors[which], off, np.linalg.norm(off, axis=1)])
    frames = {key: DataFrame(error, index, columns) for key, error in errors.items()}
    model = zeroed(models[chosen][0], inputs, rezero)
    about = _facts(recording, model, truth - measured)
    for quantity, values in about.items():
        names = joints if values.ndim > 1 else [""]
        tables[quantity] = DataFrame(values[judged], index, names)
    efforts = [joint for joint in joints if joint in recording.joints_of("effort")]
    tables["effort"] = DataFrame(recording.columns("effort", efforts)[judged], index, efforts)
    return (
        pd.concat(frames, axis=1, names=_LEVELS),
        pd.concat(tables, axis=1, names=["quantity", "joint"]),
    )


def _facts(recording: Recording, model: Calibration, error: Array) -> dict[str, Array]:
    """Time, load, motion, and what the loop says of rows whose truth less measured is `error`."""
    # An estimator that uses later rows runs in no loop; its training domain is judged by alone.
    try:
        corrector = corrector_for(model, recording)
    except CalibrationError:
        corrector = corrector_for(model.baselines[OFFSET], recording)
    corrector.set_homing(True)
    # A moved zero is another matter than rows unlike the training.
    trace = corrector.run(recording)
    status = trace.status & _HOMING
    assert model.training_domain is not None  # noqa: S101  # its corrector refuses others
    (lower, upper), t = believable_corrections(model.training_domain), recording.t
    measured = recording.columns("measured", model.joints)
    return {
        "t": t,
        "load": np.full(len(t), recording.provenance.load),
        "measured": measured,
        "velocity": velocity(t, measured),
        "direction": direction(t, measured),
        "status": status,
        "unlearnt": trace.unlearnt,
        "inside": status & ~int(Status.ZERO_SUSPECT) == 0,
        "believable": np.all((error >= lower) & (error <= upper), axis=1),
    }


def why_no_cartesian(robot: Robot, recordings: Sequence[Recording]) -> str:
    """Why tool positions cannot be computed; empty when no joint that moves the tool is missing."""
    if robot.kinematics is None:
        return f"The kinematics of {robot.name} are not known, so errors stay in joint space."
    for recording in recordings:
        measured = recording.joints_of("measured")
        missing = [joint for joint in robot.joint_names if joint not in measured]
        rows = np.linspace(0, len(recording) - 1, _PROBES).astype(np.int64)
        probes = all_joints(recording, robot)[rows]
        linear = robot.kinematics.jacobian(probes)[..., :3, :]
        needed = [j for j in missing if np.abs(linear[..., robot.index([j])]).max() > _STILL]
        if needed:
            return (
                f"{PurePath(recording.provenance.source).name or 'A recording'} lacks the "
                f"measured position of {', '.join(needed)}, which moves the tool."
            )
    return ""


def all_joints(recording: Recording, robot: Robot) -> Array:
    """Measured positions (n, n_joints) [rad or m] of all joints; home where there is no column."""
    measured = recording.joints_of("measured")
    joints = [joint for joint in robot.joint_names if joint in measured]
    positions = np.tile(robot.home, (len(recording), 1))
    positions[:, robot.index(joints)] = recording.columns("measured", joints)
    return positions


def domain_of(rows: DataFrame) -> Domain:
    """Say what the loop would correct of the test, why not the rest, and whether truth fits it."""
    status = rows["status"].to_numpy()
    shares = [(float(np.mean(status & bit != 0)), str(bit.name)) for bit in Status if bit]
    return Domain(
        inside=float(rows["inside"].mean()),
        flags={name: share for share, name in sorted(shares, reverse=True) if share},
        beyond=1.0 - float(rows["believable"].mean()),
    )


def score_errors(
    errors: DataFrame, rows: DataFrame, units: Mapping[str, str], recording: str = ""
) -> DataFrame:
    """Score a frame of errors by estimator and joint, in `units`: see `Evaluation.scores`."""
    inside, squares = rows["inside"].to_numpy(), errors.pow(2)
    columns = {
        "rmse": squares.mean().pow(0.5),
        "max_abs": errors.abs().max(),
        "mean": errors.mean(),
        "rmse_inside": squares[inside].mean().pow(0.5),
        "rmse_outside": squares[~inside].mean().pow(0.5),
    }
    by_seed = pd.concat(columns, axis=1).groupby(level=["joint", "estimator"], sort=False)
    scores = by_seed.mean()
    scores["max_abs"] = by_seed["max_abs"].max()
    scores["spread"], scores["seeds"] = by_seed["rmse"].std(), by_seed.size()
    offset = scores["rmse"].xs(OFFSET, level="estimator")
    offset = offset[offset > 0.0].reindex(scores.index, level="joint")
    scores["percent_of_offset"] = 100.0 * scores["rmse"] / offset
    for letter, axis in zip("xyz", AXES, strict=True):
        scores[letter] = math.nan
        if axis in scores.index:
            scores.loc[TOOL, letter] = np.asarray(scores.loc[axis, "rmse"])
    scores = scores.drop(index=list(AXES), level="joint", errors="ignore").reset_index()
    scores["unit"], scores["recording"] = scores["joint"].map(units).fillna("m"), recording
    scores.loc[scores["joint"] == TOOL, "mean"] = math.nan  # a distance has none
    return scores


def score_recordings(errors: DataFrame, rows: DataFrame, units: Mapping[str, str]) -> DataFrame:
    """Score each recording of a frame of errors: see `Evaluation.recording_scores`."""
    parts = [
        score_errors(errors[part], rows[part], units, rows.index[part][0])
        for part in by_recording(rows.index)
    ]
    scores = pd.concat(parts, ignore_index=True)
    return scores[scores["joint"] != TOOL]


def worst_windows(
    t: Array, error: Array, window: float, count: int
) -> list[tuple[int, int, float]]:
    """Windows of one recording with the largest RMSE, at most `count`, worst first, apart.

    Each is (first, end, rmse): rows ``first:end`` of the stamps `t` (n,) [s] and the `error` (n,).
    One covers at least half of `window` [s], so that a few rows beside a gap do not count.
    """
    n = len(t)
    first = np.arange(n)
    end = np.searchsorted(t, t + window, side="right")
    total = np.concatenate(([0.0], np.cumsum(np.square(error))))
    mean_square = (total[end] - total[first]) / (end - first)
    long_enough = t[end - 1] - t >= 0.5 * min(window, float(t[-1] - t[0]))
    candidates = np.flatnonzero(long_enough) if long_enough.any() else first
    order = candidates[np.argsort(-mean_square[candidates], kind="stable")]
    free = np.ones(n, dtype=bool)
    windows: list[tuple[int, int, float]] = []
    for row in order:
        if len(windows) == count:
            break
        if free[row] and free[end[row] - 1]:
            free[row : end[row]] = False
            windows.append((int(row), int(end[row]), float(np.sqrt(max(mean_square[row], 0.0)))))
    return windows


def worst_stretches(
    rows: DataFrame, errors: DataFrame, joints: Sequence[JointVerdict]
) -> DataFrame:
    """Worst windows of each joint over all recordings, by RMSE as a multiple of its limit.

    `errors` (n, joints) are of one model. See `Evaluation.worst`.
    """
    windows = []
    for verdict in joints:
        limit = verdict.limit if verdict.limit > 0 else 1.0
        for part in by_recording(rows.index):
            t, error = rows["t"].to_numpy()[part], errors[verdict.joint].to_numpy()[part]
            for first, end, root in worst_windows(t, error, WINDOW, _COUNT):
                where = verdict.joint, verdict.unit, rows.index[part][0], t[first], t[end - 1]
                windows.append((*where, root, np.abs(error[first:end]).max(), root / limit))
    worst = DataFrame(windows, columns=_WORST).sort_values("ratio", ascending=False, kind="stable")
    return worst.groupby("joint").head(_COUNT).drop(columns="ratio").reset_index(drop=True)


def judge_interval(
    calibration: Calibration, recordings: Sequence[Recording], rows: DataFrame
) -> dict[str, Any]:
    """Judge the interval of a calibration on recordings that no part of it saw.

    Recordings on which it would mislead are left out and named. A recording counts as one
    trajectory; where the interval holds after any homing, all recordings after one homing do.
    Gives what `Evaluation` says of intervals, by attribute, and its `rows` with bounds.
    """
    interval = calibration.interval
    if interval is None:
        return {"rows": rows}
    level = calibration.usual_level
    homings, bounds, judged = _own_homings(calibration), list[Array](), list[Recording]()
    names_of: dict[str, list[str]] = {}  # recordings, by why they are left out
    units: dict[str, list[tuple[Array, Array]]] = {}  # errors and widenings, by trajectory
    for recording, part in zip(recordings, by_recording(rows.index), strict=True):
        inputs, homing = calibration.rows(recording), recording.provenance.homing_id
        has_truth = inputs.has_truth
        scored = ~at_start(recording.t[has_truth], interval.rezero)
        model = zeroed(calibration, inputs, interval.rezero)
        position = model.correct(inputs)[has_truth]
        widening = 1.0 + interval.growth * model.range_excess(inputs)[has_truth]
        holds = _allows_offset(interval) or not homings or not homing or homing in homings
        half = np.where(scored & holds, widening, math.nan)[:, None] * interval.half_width(level)
        shown = np.isin(recording.t[has_truth], rows["t"].iloc[part])
        bounds.append(np.hstack([position - half, position + half])[shown])
        reason = ""
        if model.origin.includes(recording):
            reason = "used in the fit"
        elif model.origin.includes(recording, in_interval=True):
            reason = "used to make the interval"
        elif not holds:
            named = ", ".join(sorted(homings))
            reason = f"the interval holds after the homing {named}, not after another"
        elif not scored.any():
            reason = f"all truth lies within the {interval.rezero:g} s that re-zero the model"
        if reason:
            names_of.setdefault(reason, []).append(rows.index[part][0])
            continue
        judged.append(recording)
        shared = homing and interval.any_homing
        unit = units.setdefault(f"homing {homing}" if shared else rows.index[part][0], [])
        unit.append(((inputs.truth[has_truth] - position)[scored], widening[scored]))
    objections = [
        f"Coverage is not judged on {_listed(names, _NAMED, '; ')}: {reason}."
        for reason, names in names_of.items()
    ]
    places = pd.MultiIndex.from_product([("lower", "upper"), calibration.joints])
    bounded = DataFrame(np.concatenate(bounds), rows.index, places)
    return {
        "intervals": DataFrame(_scores(calibration, list(units.values()))),
        "interval_trajectories": tuple(units),
        "interval_level": level,
        "interval_note": _note(calibration, level, judged),
        "interval_objections": tuple(objections),
        "rows": pd.concat([rows, bounded], axis=1),
    }


def _listed(names: Sequence[str], most: int, between: str = ", ") -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return between.join(names[:most]) + more


def _allows_offset(interval: Interval) -> bool:
    """Whether the interval holds after a fresh homing, which brings an offset."""
    return interval.rezero > 0.0 or interval.any_homing


def _own_homings(calibration: Calibration) -> set[str]:
    """Homings of the interval's recordings or, where the model was re-zeroed since, that one."""
    if calibration.zero is not None:
        return {calibration.zero.homing_id} - {""}
    return {session.homing_id for session in calibration.origin.interval_sessions} - {""}


def _scores(
    calibration: Calibration, units: Sequence[Sequence[tuple[Array, Array]]]
) -> Iterator[dict[str, Any]]:
    """Score every level and joint on errors and widenings of trajectories, by recording."""
    interval, pairs = calibration.required_interval(), []
    for unit in units:
        errors, widenings = (np.concatenate(parts) for parts in zip(*unit, strict=True))
        pairs.append((np.abs(errors), widenings[:, None]))
    for level, base in zip(interval.levels, interval.half_widths, strict=True) if units else ():
        shares = np.array([(size <= wide * base).mean(axis=0) for size, wide in pairs])
        half_width = base * np.mean([wide.mean() for _, wide in pairs])
        for k, joint in enumerate(calibration.joints):
            yield {
                "joint": joint,
                "unit": calibration.units[f"measured/{joint}"],
                "level": float(level),
                **coverage_of(shares[:, k], level),
                "half_width": half_width[k],
                "shares": tuple(shares[:, k].tolist()),
            }


def coverage_of(shares: Array, level: float) -> dict[str, Any]:
    """Mean of the shares (n,) inside, its sampling error, and whether it agrees with the level.

    It cannot be told of a single trajectory: NaN, and an empty text.
    """
    coverage, n = float(shares.mean()), len(shares)
    error, agreement = math.nan, ""
    if n > 1:
        error = float(shares.std(ddof=1)) / math.sqrt(n)
        margin = float(stdtrit(n - 1, 0.975)) * error
        agreement = "agrees"
        if abs(coverage - level) > margin:
            agreement = "too few inside" if coverage < level else "more inside"
    return {"coverage": coverage, "standard_error": error, "agreement": agreement}


def _note(calibration: Calibration, level: float, judged: Sequence[Recording]) -> str:
    interval = calibration.required_interval()
    note = f"Stated {interval.meaning}."
    if judged:
        n = interval.whole or interval.trajectories
        inside = min(n, math.ceil(level * (n + 1) - 1e-9))
        # Coverage given the set is Beta(inside, n + 1 - inside) when trajectories lie wholly
        # inside or outside (Vovk, arXiv:1209.2673); samples that vary on their own average out.
        scatter = math.sqrt(inside * (n + 1 - inside) / ((n + 1) ** 2 * (n + 2)))
        counted = "recordings" if interval.whole else "trajectories"
        note += (
            f" From one set of {n} {counted} to another its coverage scatters by up to about "
            f"{100 * scatter:.0f} %, which the sampling error of this test does not include."
        )
    if interval.rezero > 0.0:
        note += (
            f" Coverage and bands are of positions re-zeroed from the first {interval.rezero:g} s "
            "of each recording, whatever other numbers are of."
        )
    stated = [session.load for session in calibration.origin.interval_sessions]
    learnt = [load for load in stated if not math.isnan(load)]
    loads = {recording.provenance.load for recording in judged}
    beyond = sorted(load for load in loads if learnt and (load < min(learnt) or load > max(learnt)))
    if beyond:
        masses = ", ".join(f"{1e3 * load:.0f} g" for load in beyond)
        note += f" The test hangs masses on the tool that the interval has not seen ({masses})."
    named = _own_homings(calibration) and all(r.provenance.homing_id for r in judged)
    if not (named or _allows_offset(interval)):
        note += " Not all recordings name their homing; it is taken to be the same one."
    return note


_FACTOR: Final = 1.25  # beyond the least and the largest that were learnt, of what is a size
_SHIFT: Final = 0.25  # of the shortest range that was learnt, beyond the middles that were learnt
_SLOPE: Final = 0.02  # beyond the slopes that were learnt
_LISTED: Final = 3  # recordings
_WARNED: Final = 0.02  # of the rows, of which motions like those of the training have fewer
_WORDS: Final = shipped_table(__package__, "words.toml")["beyond"]


def unlike(
    learnt: Sequence[Condition], tested: Mapping[str, Sequence[Condition]], units: Mapping[str, str]
) -> Iterator[str]:
    """Say which conditions of recordings, by their names, lie beyond all that were learnt.

    `units` are those of the columns ``measured/<joint>`` and ``effort/<joint>``.
    """
    least, most = _ends(learnt)
    low, high = least / _FACTOR, most * _FACTOR
    margins: dict[str, Any] = {"middle": _SHIFT * least["range"], "slope": _SLOPE}
    for kind, margin in margins.items():
        low[kind], high[kind] = least[kind] - margin, most[kind] + margin
    frames = {name: DataFrame(list(each)).set_index("joint") for name, each in tested.items()}
    values, ranges = pd.concat(frames, names=["recording"]), learnt_texts(learnt, units)
    for joint, kind in product(least.index.intersection(values.index.unique("joint")), _WORDS):
        column, at = values.xs(joint, level="joint")[kind], (joint, kind)
        sides = column[column < low.at[at]], column[column > high.at[at]]
        for words, beyond in zip(_WORDS[kind], sides, strict=True):
            if len(beyond):
                names = _listed(list(map(str, beyond.index)), _LISTED)
                text = _range_text([beyond.min(), beyond.max()], kind, joint, units)
                learnt_text = ranges[f"{kind} of {joint}"]
                yield f"{joint} {words} than in training in {names}: {text}, learnt {learnt_text}."


def warned(rows: DataFrame) -> Iterator[str]:
    """Say in which of the `rows` of an evaluation the loop would warn of unlearnt motion."""
    for warning in Unlearnt:
        share = float(np.mean(rows["unlearnt"].to_numpy() & warning != 0))
        if share > _WARNED:
            yield f"In {share_text(share)} of the rows {warning.words}."


def learnt_texts(learnt: Sequence[Condition], units: Mapping[str, str]) -> dict[str, str]:
    """Say the range of each condition that was learnt, by joint and condition."""
    least, most = _ends(learnt)
    return {
        f"{kind} of {joint}": _range_text([least.at[joint, kind], high], kind, joint, units)
        for joint, kind in product(least.index, _WORDS)
        if math.isfinite(high := cast("float", most.at[joint, kind]))
    }


def _ends(learnt: Sequence[Condition]) -> tuple[DataFrame, DataFrame]:
    """Least and largest of each condition, by joint."""
    by_joint = DataFrame(list(learnt), columns=["joint", *_WORDS]).groupby("joint", sort=False)
    return by_joint.min(), by_joint.max()


def _range_text(ends: Sequence[Any], kind: str, joint: str, units: Mapping[str, str]) -> str:
    (low, high), quantity = map(float, ends), "effort" if kind == "effort" else "measured"
    unit = units.get(f"{quantity}/{joint}", "")
    unit = {"speed": f"{unit}/s", "slope": ""}.get(kind, unit)
    return (shown_range(low, high, unit) if low < high else shown(low, unit)).strip()
