"""What minutes of motion are worth: which reaches an accuracy soonest, and after a change."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np
from pandas import DataFrame, MultiIndex, Series, concat

from truejoint.array_types import Array
from truejoint.calibration import ENOUGH, Calibration, adapted, expected_gain
from truejoint.crtk import Arm
from truejoint.drawing import Figure, by_condition
from truejoint.errors import CalibrationError
from truejoint.motion import PROFILES, designed_motion, random_motion
from truejoint.recordings import Recording
from truejoint.studies.claim_tests import against, below
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.tables import in_order
from truejoint.studies.rows import frame_table, groups, select, unique
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import Table, fixed

_FINE: Final = (4, 5, 6)  # divisions of the zig-zags that are compared with, as in peng2024
_MOTION_SEED: Final = 2_000_000  # between the seed of an arm and that of its motion
_REFERENCE: Final = "zigzag"
_DESIGNED: Final = "designed"
_MOTIONS: Final = (_REFERENCE, "random", _DESIGNED)
FIRST, WHOLE, STOPPED = "first seconds", "whole", "stopped"
"""What a calibration is made of: the first seconds of a motion, all of it, or up to its stop."""
_MINUTES: Final = 2.5  # in which the designed motion is to reach the zig-zags' accuracy
_FIRST_LOOK: Final = 60.0  # [s], when it is first asked whether that is enough,
_LOOK: Final = 30.0  # [s], and how often
_NEAR: Final = 1.2  # of the least error of a session, which stopping may end with
_SHARE: Final = 0.7  # of the time of random motion that it may take


def efficiency_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, session and motion."""
    steps = max(1, round(60.0 * settings["longest"] / settings["every_s"]))
    more = {
        "seconds": [settings["every_s"] * (1 + k) for k in range(steps)],
        "features": features(settings["features"]),
        "test": 60.0 * settings["test"],
    }
    cases = {motion: {"motion": motion} for motion in _MOTIONS}
    return s.part_for_each(
        settings, learn, 900_000, "estimator", more=more, cases=cases, same_arm=True
    )


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


def shares(rows: DataFrame, base: DataFrame, *keys: str) -> Array:
    """RMSE of rows (n,) over that of `base` with the same `keys`, geometric mean over joints."""
    joints = list(s.JOINTS)
    whole = base.set_index([*keys])[joints].reindex(MultiIndex.from_frame(rows[[*keys]]))
    return np.asarray(np.exp(np.log(rows[joints].to_numpy() / whole.to_numpy()).mean(axis=1)))


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
    shown = concat([total, others.assign(name=name)]).sort_index()
    medians = {"share": "to the zig-zags'", "first": "as good from [min]", "good": "for good [min]"}
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion of the laboratory's profile after "
        f"the training, mean over {settings['sessions']} sessions with an arm's seed and a homing "
        f"each; {settings['estimator']}, features of {settings['features']} joints. "
        "The last three are medians over the sessions: of the geometric mean over the joints of "
        "the RMSE over that of the session's zig-zags, and of the minutes until that is 1 or "
        "below, for the first time and for good.",
    )
    table = accuracy_table("Accuracy against minutes of training", shown, medians, notes, "motion")
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
        for claim in _claims(str(title), times.loc[title], group)
    ]
    return Summary((table,), {"efficiency": figure}, claims)


def accuracy_table(
    title: str, rows: DataFrame, medians: Mapping[str, str], notes: Sequence[str], head: str
) -> Table:
    """Table of the mean RMSE of each joint [deg, deg, mm], and medians of columns, by ``name``."""
    by = rows.groupby("name", sort=False)
    means = (by[list(s.JOINTS)].mean() * s.SCALES).set_axis(s.TITLES, axis=1)
    middle = by[[*medians]].agg(_median_text)
    return frame_table(title, means.join(middle.rename(columns=medians)), notes, head=head)


def _median_text(values: Series) -> str:
    return fixed(float(np.median(values)), 2)


def _claims(title: str, times: DataFrame, rows: DataFrame) -> list[Claim]:
    """Judge the minutes of each motion by session, and where the designed one was stopped."""
    ended = times.clip(upper=rows.minutes.max())  # what was never reached takes longer than that
    ours, theirs = ended.loc[_DESIGNED], ended.loc["random"]
    designed = select(rows, case=_DESIGNED)
    stops = select(designed, of=STOPPED)
    least = select(designed, of=(FIRST, STOPPED)).groupby("session", sort=False).share.min()
    shares = stops.share.to_numpy() / least.to_numpy()
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
        Claim(
            f"stopped when twice the time is expected to lower no error by {100 * ENOUGH:g} %, the "
            f"designed motion ends within {100 * (_NEAR - 1.0):.0f} % of the least error that it "
            "ever reaches",
            "ours", below(shares, _NEAR),
            f"{int((shares <= _NEAR).sum())} of {len(stops)} sessions, after "
            f"{stops.minutes.median():.1f} minutes ({stops.minutes.min():.1f} to "
            f"{stops.minutes.max():.1f})", title,
        ),
    ]  # fmt: skip


_CHANGE_SEED: Final = 3_000_000  # between the seed of an arm and that of its motion
_SECONDS: Final = (3.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0)  # of the motion, followed again
_IN_TABLE: Final = (10.0, 60.0)  # of these, in the table
_NIGHT: Final = 15 * 3600.0  # [s] with the brakes on
_OTHER: Final = 0.2  # share by which another arm's parameters may differ
_HEAVIER: Final = 0.1  # [kg] of another tool
_STIFFER: Final = 1.5  # friction of another tool
_SAME: Final = 1.1  # of the error of a whole calibration, up to which the accuracy is the same

_WITH_REFERENCE: Final = "prior, reference"
BEFORE, OWN = "before", "own"
"""The prior before the change, and a whole calibration after it."""
_WAYS: Final = (_WITH_REFERENCE, "prior", "anew")
"""What is made of the first motion, followed again: the prior adapted, beside its own recording or
without, or a fit of its own."""
CHANGES: Final = {"homing": 10.0, "day": 60.0, "tool": 60.0, "arm": None}
"""What is new, and the time [s] that the accuracy of a whole calibration is to take then."""


def transfer_parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, change and session."""
    settings.check_names("change", "changes", CHANGES)
    more = {
        "features": features(settings["features"]),
        "first": 60.0 * settings["first"],
        "test": 60.0 * settings["test"],
    }
    cases = {change: {"change": change} for change in CHANGES}
    chosen = settings["changes"]
    return s.part_for_each(
        settings, go_over, 1_000_000, "estimator", more=more, cases=cases, chosen=chosen
    )


def go_over(
    raven: s.Plain,
    change: str,
    seed: int,
    estimator: str,
    features: Sequence[str] | None,
    first: float,
    test: float,
) -> Rows:
    """Calibrate, change something, and see what the first seconds of the same motion make of it.

    The calibration after the change is as long as the first, and of another motion.
    """
    arm, _ = s.homed(raven, seed)
    path = designed_motion(arm.robot, first, _CHANGE_SEED + seed)
    reference = s.record(arm, path)
    prior = s.model_of(reference, estimator, features=features)
    before = rmse_of(prior, s.random_test(arm, test, s.TEST_SEED + seed))
    arm = changed(arm, raven, change, seed)
    recording = s.record(arm, designed_motion(arm.robot, _SECONDS[-1], _CHANGE_SEED + seed))
    judged = s.random_test(arm, test, 2 * s.TEST_SEED + seed)
    rows: Rows = []

    def fitted(made_by: str, seconds: float, model: Calibration | None) -> None:
        errors = rmse_of(model, judged) if model else dict.fromkeys(s.JOINTS, float("nan"))
        rows.append({"made_by": made_by, "seconds": seconds, **errors})

    for seconds in _SECONDS:
        (brief,) = until([recording], seconds)
        fitted(_WITH_REFERENCE, seconds, adapted(prior, brief, reference=reference))
        fitted("prior", seconds, adapted(prior, brief))
        anew = None
        with suppress(CalibrationError):  # too few rows, or a joint has not moved yet
            anew = s.model_of(brief, estimator, features=features)
        fitted("anew", seconds, anew)
    whole = s.record(arm, designed_motion(arm.robot, first, 2 * _CHANGE_SEED + seed))
    rows.append({"made_by": BEFORE, "seconds": 0.0, **before})
    fitted("as it was", 0.0, prior)
    fitted(OWN, first, s.model_of(whole, estimator, features=features))
    return rows


def changed(arm: Arm, raven: s.Plain, change: str, seed: int) -> Arm:
    """Arm after a change, homed."""
    if change in {"homing", "day"}:
        if change == "day":
            arm.disable()
            arm.wait(_NIGHT)
            arm.enable()
        arm.home()
        return arm
    plain: dict[str, dict[str, Any]] = {name: dict(values) for name, values in raven.items()}
    if change == "tool":
        plain["mass"]["instrument"] += _HEAVIER
        for name in ("coulomb", "viscous"):
            plain["tool"][name] = [_STIFFER * value for value in plain["tool"][name]]
    else:
        random = np.random.default_rng(seed)
        for section in ("joint_friction", "cable", "pulleys", "wrap", "motor_friction"):
            for name, value in plain[section].items():
                factor = random.uniform(1.0 - _OTHER, 1.0 + _OTHER, np.shape(value))
                plain[section][name] = (np.asarray(value) * factor).tolist()
    return s.homed(plain, seed + 1)[0]


def transfer_summary(results: Results) -> Summary:
    """Accuracy against seconds of the new motion, as a share of that of a whole calibration."""
    settings, rows, keys = results.settings, results.rows, ["specimen", "case", "session"]
    to = {base: shares(rows, select(rows, made_by=base), *keys) for base in (BEFORE, OWN)}
    again = rows.made_by.isin(_WAYS)
    title, at = rows.specimen + ", " + rows.case, rows.seconds.map(", {:g} s".format)
    rows = rows.assign(**to, title=title, name=title + ", " + rows.made_by + at.where(again, ""))
    every = (BEFORE, "as it was", OWN, *_WAYS)
    shown = in_order(rows[~again | rows.seconds.isin(_IN_TABLE)], "made_by", every)
    shown = in_order(shown, "title", unique(rows, "title"))
    medians = {BEFORE: "to before", OWN: "to own"}
    panels = [
        [
            by_condition(
                group, "seconds", OWN, "made_by", x="motion [s]", y="RMSE / own calibration",
                title=name, log="xy",
            )
            for name, group in groups(own, "title")
        ]
        for _, own in groups(rows[again], "specimen")
    ]  # fmt: skip
    claims = [
        _claim(str(title), change, group)
        for title, own in groups(rows, "specimen")
        for change, group in groups(own, "case")
        if CHANGES[change] is not None
    ]
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion, mean over {settings['sessions']} "
        f"sessions; {settings['estimator']}, features of {settings['features']} joints, first "
        f"fitted to {settings['first']:g} minutes of designed motion, which is followed again for "
        "so many seconds after the change. Own: as long a calibration after the change. The last "
        "columns: medians over the sessions of the geometric mean over the joints, as shares of "
        "the error before the change and of that of the own calibration.",
    )
    table = accuracy_table("After a change", shown, medians, notes, "what")
    caption = (
        "Medians over the sessions: the first calibration as the prior, beside its own recording "
        f"or without, and no prior. Up to {_SAME:g} counts as the same."
    )
    asked, height = "What is a calibration worth after a change?", 1.2 + 2.4 * len(panels)
    figure = Figure(asked, panels, caption, height=height, legend=True)
    return Summary((table,), {"transfer": figure}, claims)


def _claim(title: str, change: str, rows: DataFrame) -> Claim:
    seconds = CHANGES[change]
    rows = select(rows, made_by=_WITH_REFERENCE, seconds=seconds)
    same = int((rows[OWN] <= _SAME).sum())
    text = f"a new {change} takes {seconds:g} s for the accuracy of a whole calibration"
    found = (
        f"{same} of {len(rows)} sessions within {_SAME:g} of it, median {rows[OWN].median():.2f}; "
        f"of the error before the change {rows[BEFORE].median():.2f}"
    )
    return Claim(text, "ours", below(rows[OWN], _SAME), found, title)
