"""What a calibration is worth after a homing, on another day, with another tool, on another arm."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.calibration import Calibration, adapted
from truejoint.crtk import Arm
from truejoint.drawing import Figure, Panel, by_condition
from truejoint.errors import CalibrationError
from truejoint.motion import designed_motion
from truejoint.studies.claim_tests import below
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.efficiency import accuracy_line, features, rmse_of, shares, until
from truejoint.studies.rows import groups, select
from truejoint.studies.study import Claim, Part, Results, Rows, Settings, Summary
from truejoint.tables import Table

_MOTION_SEED: Final = 3_000_000  # between the seed of an arm and that of its motion
_SECONDS: Final = (3.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0)  # of the motion, followed again
_SHOWN: Final = (10.0, 60.0)  # of these, in the table
_NIGHT: Final = 15 * 3600.0  # [s] with the brakes on
_OTHER: Final = 0.2  # share by which another arm's parameters may differ
_HEAVIER: Final = 0.1  # [kg] of another tool
_STIFFER: Final = 1.5  # friction of another tool
_SAME: Final = 1.1  # of the error of a whole calibration, up to which the accuracy is the same

_REFERENCE: Final = "prior, reference"
BEFORE, OWN = "before", "own"
"""The prior before the change, and a whole calibration after it."""
_WAYS: Final = (_REFERENCE, "prior", "anew")
"""What is made of the first motion, followed again: the prior adapted, beside its own recording or
without, or a fit of its own."""
CHANGES: Final = {"homing": 10.0, "day": 60.0, "tool": 60.0, "arm": None}
"""What is new, and the time [s] that the accuracy of a whole calibration is to take then."""


def parts(settings: Settings) -> Sequence[Part]:
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
    path = designed_motion(arm.robot, first, _MOTION_SEED + seed)
    reference = s.record(arm, path)
    prior = s.model_of(reference, estimator, features=features)
    before = rmse_of(prior, s.random_test(arm, test, s.TEST_SEED + seed))
    arm = changed(arm, raven, change, seed)
    recording = s.record(arm, designed_motion(arm.robot, _SECONDS[-1], _MOTION_SEED + seed))
    judged = s.random_test(arm, test, 2 * s.TEST_SEED + seed)
    rows: Rows = []

    def fitted(made_by: str, seconds: float, model: Calibration | None) -> None:
        errors = rmse_of(model, judged) if model else dict.fromkeys(s.JOINTS, float("nan"))
        rows.append({"made_by": made_by, "seconds": seconds, **errors})

    for seconds in _SECONDS:
        (brief,) = until([recording], seconds)
        fitted(_REFERENCE, seconds, adapted(prior, brief, reference=reference))
        fitted("prior", seconds, adapted(prior, brief))
        anew = None
        with suppress(CalibrationError):  # too few rows, or a joint has not moved yet
            anew = s.model_of(brief, estimator, features=features)
        fitted("anew", seconds, anew)
    whole = s.record(arm, designed_motion(arm.robot, first, 2 * _MOTION_SEED + seed))
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


def summarise(results: Results) -> Summary:
    """Accuracy against seconds of the new motion, as a share of that of a whole calibration."""
    settings, rows, keys = results.settings, results.rows, ("specimen", "case", "session")
    to = {base: shares(rows, select(rows, made_by=base), *keys) for base in (BEFORE, OWN)}
    rows = rows.assign(**to)
    drawn = select(rows, made_by=_WAYS)
    brief = [{"made_by": way, "seconds": seconds} for way in _WAYS for seconds in _SHOWN]
    chosen: list[dict[str, Any]] = [*({"made_by": m} for m in (BEFORE, "as it was", OWN)), *brief]
    lines, claims = [], []
    panels: list[list[Panel]] = []
    for title, of_title in groups(rows, "specimen"):
        panels.append([])
        for change, group in groups(of_title, "case"):
            name = f"{title}, {change}"
            for where in chosen:
                what = where["made_by"] + (f", {where['seconds']:g} s" if len(where) > 1 else "")
                one = select(group, **where)
                lines.append(accuracy_line(f"{name}, {what}", one, one[BEFORE], one[OWN]))
            if CHANGES[change] is not None:
                claims.append(_claim(str(title), change, group))
            panels[-1].append(
                by_condition(
                    select(drawn, specimen=title, case=change), "seconds", OWN, "made_by",
                    x="motion [s]", y="RMSE / own calibration", title=name, log="xy",
                )
            )  # fmt: skip
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion, mean over {settings['sessions']} "
        f"sessions; {settings['estimator']}, features of {settings['features']} joints, first "
        f"fitted to {settings['first']:g} minutes of designed motion, which is followed again for "
        "so many seconds after the change. Own: as long a calibration after the change. The last "
        "columns: medians over the sessions of the geometric mean over the joints, as shares of "
        "the error before the change and of that of the own calibration.",
    )
    header = ("what", *s.TITLES, "to before", "to own")
    table = Table("After a change", header, tuple(lines), notes)
    caption = (
        "Medians over the sessions: the first calibration as the prior, beside its own recording "
        f"or without, and no prior. Up to {_SAME:g} counts as the same."
    )
    asked, height = "What is a calibration worth after a change?", 1.2 + 2.4 * len(panels)
    figure = Figure(asked, panels, caption, height=height, legend=True)
    return Summary((table,), {"transfer": figure}, claims)


def _claim(title: str, change: str, rows: DataFrame) -> Claim:
    seconds = CHANGES[change]
    rows = select(rows, made_by=_REFERENCE, seconds=seconds)
    same = int((rows[OWN] <= _SAME).sum())
    text = f"a new {change} takes {seconds:g} s for the accuracy of a whole calibration"
    found = (
        f"{same} of {len(rows)} sessions within {_SAME:g} of it, median {rows[OWN].median():.2f}; "
        f"of the error before the change {rows[BEFORE].median():.2f}"
    )
    return Claim(text, "ours", below(rows[OWN], _SAME), found, title)
