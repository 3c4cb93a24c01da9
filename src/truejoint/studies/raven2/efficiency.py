"""Which motion reaches a stated accuracy soonest: zig-zags, random, or designed ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from pandas import DataFrame, Series

from truejoint.array_types import Array
from truejoint.calibration import ENOUGH, Calibration, expected_gain
from truejoint.drawing import Figure, by_condition
from truejoint.errors import CalibrationError
from truejoint.motion import PROFILES, designed_motion, random_motion
from truejoint.recordings import Recording
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.rows import groups, select, values
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed

_FINE: Final = (4, 5, 6)  # divisions of the zig-zags that are compared with, as in peng2024
_OFFSET: Final = 900_000  # of the arms' seeds, so that no other study has the same
_MOTION_SEED: Final = 2_000_000  # between the seed of an arm and that of its motion
_REFERENCE: Final = "zigzag"
_DESIGNED: Final = "designed"
_MOTIONS: Final = {_REFERENCE: "tab:gray", "random": "tab:orange", _DESIGNED: "tab:blue"}
FIRST, WHOLE, STOPPED = "first seconds", "whole", "stopped"
"""What a calibration is made of: the first seconds of a motion, all of it, or up to its stop."""
_MINUTES: Final = 2.5  # in which the designed motion is to reach the zig-zags' accuracy
_FIRST_LOOK: Final = 60.0  # [s], when it is first asked whether that is enough,
_LOOK: Final = 30.0  # [s], and how often
_NEAR: Final = 1.2  # of the least error of a session, which stopping may end with
_STOPS: Final = 0.8  # share of the sessions that shall
_SHARE: Final = 0.7  # of the time of random motion that it may take


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, session and motion."""
    settings.check_positive("sessions", "longest", "every_s", "test")
    steps = max(1, round(60.0 * settings["longest"] / settings["every_s"]))
    common = {
        "seconds": [settings["every_s"] * (1 + k) for k in range(steps)],
        "estimator": settings["estimator"],
        "features": features(settings["features"]),
        "test": 60.0 * settings["test"],
    }
    cases = {motion: {"motion": motion} for motion in _MOTIONS}
    return s.part_for_each(settings, learn, _OFFSET, common, cases=cases, same_arm=True)


def features(which: str) -> list[str] | None:
    """Features of the positioning joints alone, or of all channels."""
    if which == "all":
        return None
    return [f"{quantity}/{joint}" for quantity in ("measured", "effort") for joint in s.JOINTS]


def learn(
    raven: s.Plain,
    seed: int,
    motion: str,
    seconds: Sequence[float],
    estimator: str,
    features: Sequence[str] | None,
    test: float,
) -> Rows:
    """Calibrate on the first `seconds` of a motion, and judge on random motion after it.

    Zig-zags are judged whole too. A calibration that cannot be made has no accuracy.
    """
    arm, _ = s.homed(raven, seed)
    if motion == _REFERENCE:
        training = s.zigzags(arm, _FINE)
    elif motion == _DESIGNED:
        training = [s.record(arm, designed_motion(arm.robot, seconds[-1], _MOTION_SEED + seed))]
    else:
        path = random_motion(arm.robot, seconds[-1], _MOTION_SEED + seed, profile=PROFILES[1])
        training = [s.record(arm, path)]
    judged = s.random_test(arm, test, s.TEST_SEED + seed)

    def rmse(recordings: Sequence[Recording]) -> dict[str, float]:
        try:
            return rmse_of(s.model_of(recordings, estimator, features=features), judged)
        except CalibrationError:
            return dict.fromkeys(s.JOINTS, float("nan"))

    ends = np.cumsum([one.duration for one in training])
    cuts = {end: until(training, end) for end in seconds if end <= ends[-1] + 1.0}
    rows: Rows = [
        {"seconds": end, "total": float(ends[-1]), "of": FIRST, **rmse(brief)}
        for end, brief in cuts.items()
    ]
    rows.append({"seconds": float(ends[-1]), "of": WHOLE, **rmse(training)})
    if motion == _DESIGNED:
        end = stopped(training[0], estimator, features)
        rows.append({"seconds": end, "of": STOPPED, **rmse(until(training, end))})
    return rows


def rmse_of(model: Calibration, recording: Recording) -> dict[str, float]:
    """RMSE of a calibration on a recording [rad or m] by joint."""
    rows = s.judged({"model": [model]}, recording)
    return {row["joint"]: row["rmse"] for row in rows if row["method"] == "model"}


def errors(rows: DataFrame, **where: Any) -> Array:
    """RMSE (n, 3) of rows with a column for each joint."""
    return np.asarray(select(rows, **where)[list(s.JOINTS)].to_numpy(dtype=np.float64))


def stopped(recording: Recording, estimator: str, features: Sequence[str] | None) -> float:
    """Time [s] after which more of a motion is not expected to pay; all of it where it always is.

    It is asked as `truejoint collect --until-enough` does.
    """
    for end in np.arange(_FIRST_LOOK, recording.duration, _LOOK):
        gain = expected_gain(until([recording], end), estimator, features=features)
        if (gain < ENOUGH).all():
            return float(end)
    return recording.duration


def until(recordings: Sequence[Recording], seconds: float) -> list[Recording]:
    """Cut recordings, one after the other, after so much time of all [s]."""
    cut = []
    for recording in recordings:
        if seconds <= 0.0:
            break
        cut.append(recording.rows(recording.t - recording.t[0] <= seconds))
        seconds -= recording.duration
    return [recording for recording in cut if len(recording) > 1]


def relative(rmse: Array, whole: Array | Sequence[float]) -> Array:
    """RMSE (n, 3) as a share (n,) of that of the zig-zags, geometric mean over the joints."""
    return np.asarray(np.exp(np.log(rmse / np.array(whole)).mean(axis=1)))


def reached(share: Array, seconds: Array) -> tuple[float, float]:
    """Give the `seconds` (n,) at which a share (k,) is 1 or below first, and from on for good.

    Infinite where that is never in the first k.
    """
    times, above = np.append(seconds[: len(share)], np.inf), np.append(~(share <= 1.0), False)
    first, last = np.argmin(above), np.flatnonzero(np.append(True, above[:-1]))[-1]
    return float(times[first]), float(times[last])


def summarise(results: Results) -> Summary:
    """Accuracy against minutes, and the minutes until that of the zig-zags."""
    settings = results.settings
    seconds = np.array(parts(settings)[0].arguments["seconds"])
    lines, claims, panels = [], [], []
    for title, rows in groups(results.rows, "specimen"):
        whole = errors(rows, case=_REFERENCE, of=WHOLE)
        total = np.median(select(rows, case=_REFERENCE, of=WHOLE).seconds)
        lines.append(_line(f"{title}, zig-zags", np.full(2, total), whole, 1.0))
        first = select(rows, of=FIRST)
        share = np.concatenate(
            [relative(errors(group), whole[n]) for n, group in groups(first, "session")]
        )
        order = np.concatenate([group.index for _, group in groups(first, "session")])
        first = first.assign(share=Series(share, order), minutes=first.seconds / 60.0)
        times = {}
        for motion, group in groups(first, "case"):
            shares = [one.share.to_numpy() for _, one in groups(group, "session")]
            times[motion] = np.array([reached(one, seconds) for one in shares])
            if motion == _REFERENCE:
                continue
            for minutes in (_MINUTES, float(seconds[-1]) / 60.0):
                end = seconds[np.abs(seconds - 60.0 * minutes).argmin()]
                name = f"{title}, {motion}, {end / 60:.1f} min"
                middle = np.median(values(group, "share", seconds=end))
                spent = np.median(times[motion], axis=0)
                lines.append(_line(name, spent, errors(group, seconds=end), float(middle)))
        panels.append(
            by_condition(
                first, "minutes", "share", "case", each="session", colours=_MOTIONS,
                x="minutes", y="RMSE / that of all zig-zags", title=str(title), log="xy",
            )
        )  # fmt: skip
        claims += [*_claims(str(title), times), _stopping(str(title), rows)]
    header = ("motion", *s.TITLES, "to the zig-zags'", "as good from [min]", "for good [min]")
    chosen = f"{settings['estimator']}, features of {settings['features']} joints"
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion of the laboratory's profile after "
        f"the training, mean over {settings['sessions']} sessions with an arm's seed and a homing "
        f"each; {chosen}. "
        "The last three are medians over the sessions: of the geometric mean over the joints of "
        "the RMSE over that of the session's zig-zags, and of the minutes until that is 1 or "
        "below, for the first time and for good.",
    )
    table = Table("Accuracy against minutes of training", header, tuple(lines), notes)
    caption = "Bold: median over the sessions, which are the thin lines. 1: all zig-zags."
    asked = "How soon is a calibration as good as by all zig-zags?"
    figure = Figure(asked, (panels,), caption, legend=True)
    return Summary((table,), {"efficiency": figure}, claims)


def _line(name: str, spent: Array, rmse: Array, share: float) -> tuple[str, ...]:
    means = (fixed(float(value), 3) for value in rmse.mean(axis=0) * s.SCALES)
    return (name, *means, fixed(share, 2), *(fixed(float(one) / 60.0, 2) for one in spent))


def _claims(title: str, times: Mapping[str, Array]) -> list[Claim]:
    """Judge times (n, 2) by motion: those from which a session is as good for good."""
    ours, theirs = (np.median(times[motion], axis=0) / 60.0 for motion in (_DESIGNED, "random"))
    against = f"{ours[1]:.2f} against {theirs[1]:.2f} minutes for good, median"
    return [
        Claim(
            f"the designed motion is as good as all zig-zags within {_MINUTES:g} minutes",
            "ours", bool(ours[1] <= _MINUTES), f"{ours[1]:.2f} minutes for good, median", title,
        ),
        Claim(
            f"it takes at most {100 * _SHARE:g} % of the time of random motion",
            "ours", bool(ours[1] <= _SHARE * theirs[1]),
            f"{against}; {ours[0]:.2f} against {theirs[0]:.2f} for the first time", title,
        ),
    ]  # fmt: skip


def _stopping(title: str, rows: DataFrame) -> Claim:
    near, minutes = 0, []
    for _, group in groups(select(rows, case=_DESIGNED), "session"):
        at_stop = select(group, of=STOPPED)
        reachable = np.vstack([errors(group, of=FIRST), errors(at_stop)])
        shares = relative(reachable, np.ones(3))
        near += bool(shares[-1] <= _NEAR * np.nanmin(shares))
        minutes.append(float(at_stop.seconds.iloc[0]) / 60.0)
    text = (
        f"stopped when twice the time is expected to lower no error by {100 * ENOUGH:g} %, the "
        f"designed motion ends within {100 * (_NEAR - 1.0):.0f} % of the least error that it ever "
        "reaches"
    )
    found = (
        f"{near} of {len(minutes)} sessions, after {np.median(minutes):.1f} minutes "
        f"({min(minutes):.1f} to {max(minutes):.1f})"
    )
    return Claim(text, "ours", near >= _STOPS * len(minutes), found, title)
