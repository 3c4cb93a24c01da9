"""What a calibration is worth after a homing, on another day, with another tool, on another arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.array_types import Array
from truejoint.calibration import Calibration, adapted, calibrate, rezeroed
from truejoint.crtk import Arm
from truejoint.errors import CalibrationError
from truejoint.evaluation.digits import fixed
from truejoint.motion import designed_motion
from truejoint.recordings import Recording
from truejoint.studies.figures import Curve, Figure, Panel
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
from truejoint.studies.table import Table

_SEED: Final = 1000  # between the seeds of studies
_OFFSET: Final = 1_000_000  # of the arms' seeds, so that no other study has the same
_MOTION_SEED: Final = 3_000_000  # between the seed of an arm and that of its motion
_SECONDS: Final = (3.0, 5.0, 10.0, 20.0, 30.0, 60.0, 120.0)  # of the new motion
_NIGHT: Final = 15 * 3600.0  # [s] with the brakes on
_OTHER: Final = 0.2  # share by which another arm's parameters may differ
_HEAVIER: Final = 0.1  # [kg] of another tool
_STIFFER: Final = 1.5  # friction of another tool
_SAME: Final = 1.1  # of the first accuracy that counts as the same

_WAYS: Final = {"prior": "tab:blue", "re-zeroed": "tab:green", "anew": "tab:orange"}
"""What is made of the new motion: the prior adapted, its zero moved, or a fit of its own."""
CHANGES: Final = {"homing": 10.0, "day": 60.0, "tool": 60.0, "arm": None}
"""What is new, and the time [s] that the first accuracy is to take then."""


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
    found = []
    for title, raven in s.specimens(settings["specimens"]).items():
        for number, change in enumerate(CHANGES):
            for session in range(settings["sessions"]):
                seed = _OFFSET + _SEED * settings.seed + len(CHANGES) * session + number
                if change in settings["changes"]:
                    arguments = {"raven": raven, "change": change, "seed": seed, **common}
                    found.append(Part(f"{title}-{change}-{session}", go_over, arguments))
    return found


def go_over(
    raven: s.Plain,
    change: str,
    seed: int,
    estimator: str,
    features: Sequence[str] | None,
    first: float,
    test: float,
) -> PartResult:
    """Calibrate, change something, and see what so many seconds of a new motion make of it."""
    arm, _ = s.homed(raven, seed)
    path = designed_motion(arm.robot, first, _MOTION_SEED + seed)
    prior = calibrate(s.record(arm, path), estimator, features=features)
    before = _rmse(prior, s.random_test(arm, test, s.TEST_SEED + seed))
    arm = changed(arm, raven, change, seed)
    path = designed_motion(arm.robot, _SECONDS[-1], 2 * _MOTION_SEED + seed)
    recording = s.record(arm, path)
    judged = s.random_test(arm, test, 2 * s.TEST_SEED + seed)
    made: dict[str, list[list[float]]] = {way: [] for way in _WAYS}
    for seconds in _SECONDS:
        (brief,) = until([recording], seconds)
        made["prior"].append(_rmse(adapted(prior, brief), judged))
        made["re-zeroed"].append(_rmse(rezeroed(prior, brief), judged))
        try:
            anew = _rmse(calibrate(brief, estimator, features=features), judged)
        except CalibrationError:  # too few rows, or a joint has not moved yet
            anew = [float("nan")] * len(s.JOINTS)
        made["anew"].append(anew)
    arrays = {way: np.array(rows) for way, rows in made.items()}
    return PartResult({"before": before, "as it was": _rmse(prior, judged)}, arrays)


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
    """Accuracy against seconds of the new motion, as a share of the first accuracy."""
    count = range(settings["sessions"])
    rows, claims = [], []
    panels: list[list[Panel]] = []
    for title in s.specimens(settings["specimens"]):
        line: list[Panel] = []
        for change in (name for name in CHANGES if name in settings["changes"]):
            own = [results[f"{title}-{change}-{k}"] for k in count]
            before = [part.numbers["before"] for part in own]
            kept = [part.numbers["as it was"] for part in own]
            start = [relative(np.array([k]), b)[0] for k, b in zip(kept, before, strict=True)]
            shares = {
                way: np.array(
                    [relative(p.arrays[way], b) for p, b in zip(own, before, strict=True)]
                )
                for way in _WAYS
            }
            rows.append(_row(f"{title}, {change}, before", np.array(before), np.ones(1)))
            rows.append(_row(f"{title}, {change}, as it was", np.array(kept), np.array(start)))
            wanted = CHANGES[change]
            for way, share in shares.items():
                for seconds in (10.0, 60.0):
                    at = _SECONDS.index(seconds)
                    here = np.array([part.arrays[way][at] for part in own])
                    rows.append(
                        _row(f"{title}, {change}, {way}, {seconds:g} s", here, share[:, at])
                    )
            if wanted is not None:
                claims.append(_claim(title, change, wanted, shares["prior"]))
            curves = [
                Curve(_SECONDS, np.median(share, axis=0), way, _WAYS[way], "-o")
                for way, share in shares.items()
            ]
            curves.append(Curve(_SECONDS, np.full(len(_SECONDS), _SAME), "", "0.5", ":"))
            name = f"{title}, {change}"
            line.append(Panel(curves, "new motion [s]", "RMSE / first", name, log="xy"))
        panels.append(line)
    notes = (
        f"RMSE on {settings['test']:g} minutes of random motion, mean over {len(count)} sessions; "
        f"{settings['estimator']}, features of {settings['features']} joints, first fitted to "
        f"{settings['first']:g} minutes of designed motion. The last column: median over the "
        "sessions of the geometric mean over the joints, as a share of that before the change.",
    )
    table = Table("After a change", ("what", *s.TITLES, "to before"), tuple(rows), notes)
    caption = (
        "Medians over the sessions. Blue: the first calibration as the prior; green: only its zero "
        f"is found anew; orange: without it. Dotted: {_SAME:g}, what counts as the same."
    )
    asked, height = "What is a calibration worth after a change?", 1.2 + 2.4 * len(panels)
    figure = Figure(asked, panels, caption, height=height, legend=True)
    return Summary((table,), {"transfer": figure}, claims)


def _row(name: str, rmse: Array, share: Array) -> tuple[str, ...]:
    errors = (fixed(float(value), 3) for value in rmse.mean(axis=0) * s.SCALES)
    return (name, *errors, fixed(float(np.median(share)), 2))


def _claim(title: str, change: str, wanted: float, shares: Array) -> Claim:
    at = _SECONDS.index(wanted)
    same = int((shares[:, at] <= _SAME).sum())
    middle = float(np.median(shares[:, at]))
    found = f"{same} of {len(shares)} sessions within {_SAME:g} of it, median {middle:.2f}"
    text = f"a new {change} takes {wanted:g} s for the same accuracy"
    return Claim(text, "ours", same >= len(shares) / 2, found, title)
