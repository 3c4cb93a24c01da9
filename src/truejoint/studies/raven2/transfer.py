"""What a calibration is worth after a homing, on another day, with another tool, on another arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration, adapted
from truejoint.crtk import Arm
from truejoint.drawing import Curve, Figure, Panel
from truejoint.errors import CalibrationError
from truejoint.motion import designed_motion
from truejoint.recordings import Recording
from truejoint.studies.raven2 import sessions as s
from truejoint.studies.raven2.efficiency import features, relative, until
from truejoint.studies.study import (
    Claim,
    Part,
    PartResult,
    Settings,
    Summary,
    check_counts,
    check_names,
)
from truejoint.tables import Table, fixed

_OFFSET: Final = 1_000_000  # of the arms' seeds, so that no other study has the same
_MOTION_SEED: Final = 3_000_000  # between the seed of an arm and that of its motion
_SECONDS: Final = (3.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0)  # of the motion, followed again
_SHOWN: Final = (10.0, 60.0)  # of these, in the table
_NIGHT: Final = 15 * 3600.0  # [s] with the brakes on
_OTHER: Final = 0.2  # share by which another arm's parameters may differ
_HEAVIER: Final = 0.1  # [kg] of another tool
_STIFFER: Final = 1.5  # friction of another tool
_SAME: Final = 1.1  # of the error of a whole calibration, up to which the accuracy is the same
_MOST: Final = 0.8  # share of the sessions that shall be as accurate
_DRAWN: Final = 3.0  # of the error of a whole calibration, beyond which none is drawn

_REFERENCE: Final = "prior, reference"
_WAYS: Final = {_REFERENCE: "tab:blue", "prior": "tab:green", "anew": "tab:orange"}
"""What is made of the first motion, followed again: the prior adapted, beside its own recording or
without, or a fit of its own."""
CHANGES: Final = {"homing": 10.0, "day": 60.0, "tool": 60.0, "arm": None}
"""What is new, and the time [s] that the accuracy of a whole calibration is to take then."""


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen, change and session."""
    check_counts(settings, "sessions", "first", "test")
    check_names("change", settings["changes"], tuple(CHANGES))
    common = {
        "estimator": settings["estimator"],
        "features": features(settings["features"]),
        "first": 60.0 * settings["first"],
        "test": 60.0 * settings["test"],
    }
    cases = {change: {"change": change} for change in CHANGES}
    chosen = settings["changes"]
    return s.part_for_each(settings, go_over, _OFFSET, common, cases=cases, chosen=chosen)


def go_over(
    raven: s.Plain,
    change: str,
    seed: int,
    estimator: str,
    features: Sequence[str] | None,
    first: float,
    test: float,
) -> PartResult:
    """Calibrate, change something, and see what the first seconds of the same motion make of it.

    The day's `own` calibration is as long as the first, and of another motion.
    """
    arm, _ = s.homed(raven, seed)
    path = designed_motion(arm.robot, first, _MOTION_SEED + seed)
    reference = s.record(arm, path)
    prior = s.model_of(reference, estimator, features=features)
    before = _rmse(prior, s.random_test(arm, test, s.TEST_SEED + seed))
    arm = changed(arm, raven, change, seed)
    recording = s.record(arm, designed_motion(arm.robot, _SECONDS[-1], _MOTION_SEED + seed))
    judged = s.random_test(arm, test, 2 * s.TEST_SEED + seed)
    made: dict[str, list[list[float]]] = {way: [] for way in _WAYS}
    for seconds in _SECONDS:
        (brief,) = until([recording], seconds)
        made[_REFERENCE].append(_rmse(adapted(prior, brief, reference=reference), judged))
        made["prior"].append(_rmse(adapted(prior, brief), judged))
        try:
            anew = _rmse(s.model_of(brief, estimator, features=features), judged)
        except CalibrationError:  # too few rows, or a joint has not moved yet
            anew = [float("nan")] * len(s.JOINTS)
        made["anew"].append(anew)
    whole = s.record(arm, designed_motion(arm.robot, first, 2 * _MOTION_SEED + seed))
    own = _rmse(s.model_of(whole, estimator, features=features), judged)
    arrays = {way: np.array(rows) for way, rows in made.items()}
    return PartResult({"before": before, "as it was": _rmse(prior, judged), "own": own}, arrays)


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
            plain[section] = {
                name: _varied(value, random) for name, value in plain[section].items()
            }
    return s.homed(plain, seed + 1)[0]


def _varied(value: Any, random: np.random.Generator) -> Any:
    """Give a number or several, each up to a fifth off."""
    several = np.asarray(value) * random.uniform(1.0 - _OTHER, 1.0 + _OTHER, np.shape(value))
    return several.tolist()


def _rmse(model: Calibration, recording: Recording) -> list[float]:
    return s.judged({"model": [model]}, recording)["model"][0]


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Accuracy against seconds of the new motion, as a share of that of a whole calibration."""
    rows, claims = [], []
    panels: list[list[Panel]] = []
    for title in s.specimens(settings["specimens"]):
        line: list[Panel] = []
        for change in (name for name in CHANGES if name in settings["changes"]):
            parts = s.sessions_of(settings, results, title, change)
            found = _by_what(parts)
            rows += [_row(f"{title}, {change}, {what}", one, found) for what, one in found.items()]
            if CHANGES[change] is not None:
                claims.append(_claim(title, change, found))
            curves = []
            for way, colour in _WAYS.items():
                shares = [relative(part.arrays[way], part.numbers["own"]) for part in parts]
                middle = np.median(shares, axis=0)
                near = np.where(middle <= _DRAWN, middle, np.nan)
                curves.append(Curve(_SECONDS, near, way, colour, "-o"))
            curves.append(Curve(_SECONDS, np.full(len(_SECONDS), _SAME), "", "0.5", ":"))
            name = f"{title}, {change}"
            line.append(Panel(curves, "motion [s]", "RMSE / own calibration", name, log="xy"))
        panels.append(line)
    count = settings["sessions"]
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion, mean over {count} sessions; "
        f"{settings['estimator']}, features of {settings['features']} joints, first fitted to "
        f"{settings['first']:g} minutes of designed motion, which is followed again for so many "
        "seconds after the change. Own: as long a calibration after the change. The last columns: "
        "medians over the sessions of the geometric mean over the joints, as shares of the error "
        "before the change and of that of the own calibration.",
    )
    header = ("what", *s.TITLES, "to before", "to own")
    table = Table("After a change", header, tuple(rows), notes)
    caption = (
        "Medians over the sessions. Blue: the first calibration as the prior, beside its own "
        "recording; green: without that; orange: without a prior. Dotted: "
        f"{_SAME:g}, what counts as the same. Above {_DRAWN:g} nothing is drawn."
    )
    asked, height = "What is a calibration worth after a change?", 1.2 + 2.4 * len(panels)
    figure = Figure(asked, panels, caption, height=height, legend=True)
    return Summary((table,), {"transfer": figure}, claims)


def _by_what(parts: Sequence[PartResult]) -> dict[str, Array]:
    """RMSE (sessions, 3) before and after a change, by what was made of how many seconds."""
    found = {
        what: np.array([part.numbers[what] for part in parts])
        for what in ("before", "as it was", "own")
    }
    for way in _WAYS:
        for seconds in _SHOWN:
            at = _SECONDS.index(seconds)
            found[_what(way, seconds)] = np.array([part.arrays[way][at] for part in parts])
    return found


def _what(way: str, seconds: float) -> str:
    return f"{way}, {seconds:g} s"


def _shares(rmse: Array, whole: Array) -> Array:
    """RMSE (sessions, 3) as shares (sessions,) of another, geometric mean over the joints."""
    return np.concatenate([relative(a[None], b) for a, b in zip(rmse, whole, strict=True)])


def _row(name: str, rmse: Array, found: Mapping[str, Array]) -> tuple[str, ...]:
    errors = (fixed(float(value), 3) for value in rmse.mean(axis=0) * s.SCALES)
    shares = (float(np.median(_shares(rmse, found[what]))) for what in ("before", "own"))
    return (name, *errors, *(fixed(share, 2) for share in shares))


def _claim(title: str, change: str, found: Mapping[str, Array]) -> Claim:
    wanted = CHANGES[change]
    assert wanted is not None  # noqa: S101  # nothing is claimed of another arm
    rmse = found[_what(_REFERENCE, wanted)]
    shares = _shares(rmse, found["own"])
    same, before = int((shares <= _SAME).sum()), np.median(_shares(rmse, found["before"]))
    text = f"a new {change} takes {wanted:g} s for the accuracy of a whole calibration"
    said = (
        f"{same} of {len(shares)} sessions within {_SAME:g} of it, median {np.median(shares):.2f}; "
        f"of the error before the change {before:.2f}"
    )
    return Claim(text, "ours", same >= _MOST * len(shares), said, title)
