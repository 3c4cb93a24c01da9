"""What minutes of motion are worth: which motion reaches an accuracy soonest."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from pandas import DataFrame, MultiIndex, Series, concat

from truejoint.array_types import Array
from truejoint.drawing import Figure, by_condition
from truejoint.errors import CalibrationError
from truejoint.motion import PROFILES, designed_motion, random_motion
from truejoint.recordings import Recording
from truejoint.studies.claim_tests import against, below
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import frame_table, groups, select
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import fixed

_FINE: Final = (4, 5, 6)  # divisions of the zig-zags that are compared with, as in peng2024
_MOTION_SEED: Final = 2_000_000  # between the seed of an arm and that of its motion
_REFERENCE, _DESIGNED = "zigzag", "designed"
_MOTIONS: Final = (_REFERENCE, "random", _DESIGNED)
FIRST, WHOLE = "first seconds", "whole"
"""What a calibration is made of: the first seconds of a motion, or all of it."""
FEATURES: Final = [
    f"{quantity}/{joint}" for quantity in ("measured", "effort") for joint in s.JOINTS
]
"""Of the joints that move: those that rest teach nothing."""
_MINUTES: Final = 2.5  # in which the designed motion is to reach the zig-zags' accuracy
_SHARE: Final = 0.7  # of the time of random motion that it may take


def efficiency_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, session and motion."""
    steps = max(1, round(60.0 * settings["longest"] / settings["every_s"]))
    seconds = [settings["every_s"] * (1 + k) for k in range(steps)]
    more = {"seconds": seconds, "test": 60.0 * settings["test"]}
    cases = {motion: {"motion": motion} for motion in _MOTIONS}
    return s.part_for_each(
        settings, learn, 900_000, "estimator", more=more, cases=cases, same_arm=True
    )


def learn(
    raven: s.Plain, seed: int, motion: str, seconds: Sequence[float], estimator: str, test: float
) -> Rows:
    """Calibrate on the first `seconds` of a motion, and judge on random motion after it.

    Zig-zags are judged whole too. A calibration that cannot be made has no accuracy.
    """
    arm, _ = s.homed(raven, seed)
    length, motion_seed = seconds[-1], _MOTION_SEED + seed
    if motion == _REFERENCE:
        training = s.zigzags(arm, _FINE)
    elif motion == _DESIGNED:
        training = [s.record(arm, designed_motion(arm.robot, length, motion_seed))]
    else:
        path = random_motion(arm.robot, length, motion_seed, profile=PROFILES[1])
        training = [s.record(arm, path)]
    judged = s.random_test(arm, test, s.TEST_SEED + seed)

    def rmse(recordings: Sequence[Recording]) -> dict[str, float]:
        try:
            model = s.model_of(recordings, estimator, features=FEATURES)
        except CalibrationError:
            return dict.fromkeys(s.JOINTS, float("nan"))
        return {row["joint"]: row["rmse"] for row in s.judged({"model": [model]}, judged)[:3]}

    ends = np.cumsum([one.duration for one in training])
    total = float(ends[-1])
    rows: Rows = [
        {"seconds": end, "total": total, "of": FIRST, **rmse(until(training, end))}
        for end in seconds
        if end <= total + 1.0
    ]
    rows.append({"seconds": total, "of": WHOLE, **rmse(training)})
    return rows


def until(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Cut recordings, one after the other, after so much time of all [s]."""
    cut = []
    for recording in recordings:
        if seconds <= 0.0:
            break
        cut.append(recording.rows(recording.t - recording.t[0] <= seconds))
        seconds -= recording.duration
    return [recording for recording in cut if len(recording) > 1]


def shares(rows: DataFrame, base: DataFrame, *keys: str) -> Array:
    """RMSE of rows (n,) over that of `base` with the same `keys`, geometric mean over joints."""
    joints = list(s.JOINTS)
    whole = base.set_index([*keys])[joints].reindex(MultiIndex.from_frame(rows[[*keys]]))
    return np.asarray(np.exp(np.log(rows[joints].to_numpy() / whole.to_numpy()).mean(axis=1)))


def reached(rows: DataFrame) -> Series:
    """Give the minutes at which a ``share`` is 1 or below ``first``, and from on for ``good``.

    Infinite where that is never.
    """
    times = np.append(rows.minutes, np.inf)
    above = np.append(~(rows.share <= 1.0), False)
    last = np.flatnonzero(np.append(True, above[:-1]))[-1]
    return Series({"first": times[np.argmin(above)], "good": times[last]})


def efficiency_summary(results: Results) -> Summary:
    """Accuracy against minutes, and the minutes until that of the zig-zags."""
    settings, rows, keys = results.settings, results.rows, ["specimen", "case", "session"]
    whole = select(rows, case=_REFERENCE, of=WHOLE)
    share = shares(rows, whole, "specimen", "session")
    rows = rows.assign(share=share, minutes=rows.seconds / 60.0)
    first, total = select(rows, of=FIRST), select(rows, case=_REFERENCE, of=WHOLE)
    times = first.groupby(keys, sort=False)[["share", "minutes"]].apply(reached)
    grid = np.unique(first.minutes)
    ends = grid[[np.abs(grid - end).argmin() for end in (_MINUTES, grid[-1])]]
    others = first[first.case.ne(_REFERENCE) & first.minutes.isin(ends)].join(times, on=keys)
    name = others.specimen + ", " + others.case + others.minutes.map(", {:.1f} min".format)
    total = total.assign(
        name=total.specimen + ", zig-zags", first=total.minutes, good=total.minutes
    )
    shown = concat([total, others.assign(name=name)]).sort_index().groupby("name", sort=False)
    medians = {"share": "to the zig-zags'", "first": "as good from [min]", "good": "for good [min]"}
    middle = shown[[*medians]].agg(_median_text)
    means = (shown[list(s.JOINTS)].mean() * s.SCALES).set_axis(s.TITLES, axis=1)
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion of the laboratory's profile after "
        f"the training, mean over {settings['sessions']} sessions with an arm's seed and a homing "
        f"each; {settings['estimator']}, features of the positioning joints. "
        "The last three are medians over the sessions: of the geometric mean over the joints of "
        "the RMSE over that of the session's zig-zags, and of the minutes until that is 1 or "
        "below, for the first time and for good.",
    )
    table = frame_table(
        "Accuracy against minutes of training", means.join(middle.rename(columns=medians)), notes,
        head="motion",
    )  # fmt: skip
    panels = [
        by_condition(
            group, "minutes", "share", "case", each="session", x="minutes",
            y="RMSE / that of all zig-zags", title=str(title), log="xy",
        )
        for title, group in groups(first, "specimen")
    ]  # fmt: skip
    caption = "Bold: median over the sessions, which are the thin lines. 1: all zig-zags."
    asked = "How soon is a calibration as good as by all zig-zags?"
    figure = Figure(asked, (panels,), caption, legend=True)
    claims = [
        claim
        for title, group in groups(rows, "specimen")
        for claim in _claims(str(title), times.loc[title], group.minutes.max())
    ]
    return Summary((table,), {"efficiency": figure}, claims)


def _median_text(values: Series) -> str:
    return fixed(float(np.median(values)), 2)


def _claims(title: str, times: DataFrame, longest: float) -> list[Claim]:
    """Judge the minutes of each motion by session; the longest took `longest` [min]."""
    ended = times.clip(upper=longest)  # what was never reached takes longer than that
    ours, theirs = ended.loc[_DESIGNED], ended.loc["random"]
    return [
        Claim(
            f"the designed motion is as good as all zig-zags within {_MINUTES:g} minutes",
            "ours", below(ours.good, _MINUTES),
            f"{ours.good.median():.2f} minutes for good, median{against(ours.good, _MINUTES)}",
            title,
        ),
        Claim(
            f"it takes at most {100 * _SHARE:g} % of the time of random motion",
            "ours", below(ours.good, _SHARE * theirs.good),
            f"{ours.good.median():.2f} against {theirs.good.median():.2f} minutes for good, "
            f"median; {ours['first'].median():.2f} against {theirs['first'].median():.2f} for the "
            "first time", title,
        ),
    ]  # fmt: skip
