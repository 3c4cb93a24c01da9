"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from truejoint.drawing import Curve, Figure, Panel
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.stiffness import find_encoder_zero
from truejoint.motion.forceps_trajectories import RAMP
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.load import signals, unloaded_filter
from truejoint.studies.forceps.motions import Plain, built, changed, drawn_specimens, record
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table, fixed

Case = Mapping[str, Any]

_WHEN: Final = ("before", "after")
_HARM: Final = np.radians(0.002)  # by which an error must grow to count as harm


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and wrong zero."""
    m.check_methods(settings["methods"])
    return [
        Part(
            f"{name}-shift-{shift:g}um",
            home,
            {"forceps": plant, "methods": settings["methods"], "seed": seed, "shift": shift / 1e6},
        )
        for name, plant, seed in drawn_specimens(settings)
        for shift in settings["shifts_um"]
    ]


def home(forceps: Plain, methods: Sequence[str], seed: int, shift: float) -> PartResult:
    """Calibrate, home with ``x2`` off by `shift` [m], find that, and judge on (28).

    What is found is taken off only where it is more than it may be off by.
    """
    plant, zero = built(forceps), ZeroShift(reset=shift)
    models = m.calibrated(plant, tuple(methods), seed)
    cycle = record(plant, "cycle", seed=2 * seed + 50, zero_shift=zero)
    X, dt = signals(cycle.rows(cycle.t >= RAMP))
    found = find_encoder_zero(unloaded_filter(plant, seed), X, dt)
    before = m.settled(record(plant, "verification", seed=2 * seed + 1, zero_shift=zero))
    after = changed(before, RESET, before.column(RESET) - found.correction)
    judged = {"before": m.judge(models, before).errors(), "after": m.judge(models, after).errors()}
    told = {"found": found.shift, "deviation": found.deviation, "taken_off": found.correction}
    return PartResult({"shift": shift, **told, **judged})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """RMS error of each method before and after re-zeroing, by zero: medians over the specimens."""
    cases = [result.numbers for result in results.values()]
    methods = [key for key in cases[0]["before"] if all(key in case["before"] for case in cases)]
    by_shift = {shift: [c for c in cases if c["shift"] == shift] for shift in _shifts(cases)}
    rows = []
    for shift, own in by_shift.items():
        found = f"{_micro(np.median([c['found'] for c in own]))} um"
        off = f"{_micro(_rms(own))} (stated {_micro(np.median([c['deviation'] for c in own]))})"
        taken = f"{sum(c['taken_off'] != 0.0 for c in own)} of {len(own)}"
        pairs = [[_median(own, when, key) for when in _WHEN] for key in methods]
        errors = [" -> ".join(map(degrees_text, pair)) for pair in pairs]
        rows.append((f"{_micro(shift, 0)} um", found, off, taken, *errors))
    harmed = [
        case for case in cases for key in methods
        if case["after"][key]["rms"] > _HARM + case["before"][key]["rms"]
    ]  # fmt: skip
    ratio = np.array([(c["found"] - c["shift"]) / c["deviation"] for c in cases])
    header = (
        "zero off by",
        "found",
        "off, RMS",
        "taken off",
        *(m.METHODS[k].title for k in methods),
    )
    notes = (
        f"{len(cases) // len(by_shift)} specimens; RMS error in degrees on (28), before -> after "
        "re-zeroing from one unloaded cycle of (27) with no sensor at the jaw; medians. A shift "
        "within two of its stated deviations is left alone.",
        f"Off by {np.sqrt(np.mean(ratio**2)):.2f} stated deviations RMS. Worse afterwards by more "
        f"than {degrees_text(_HARM)} deg: {len(harmed)} of {len(cases) * len(methods)}.",
        *m.left_out(settings, cases[0]["before"]),
    )
    table = Table("Re-zeroing after homing", header, tuple(rows), notes)
    return Summary((table,), {"forceps-rezero": _figure(by_shift, methods)})


def _shifts(cases: Sequence[Case]) -> list[float]:
    return sorted({float(case["shift"]) for case in cases})


def _micro(metres: Any, decimals: int = 1) -> str:
    return fixed(1e6 * float(metres), decimals)


def _rms(cases: Sequence[Case]) -> float:
    return float(np.sqrt(np.mean([(case["found"] - case["shift"]) ** 2 for case in cases])))


def _median(cases: Sequence[Case], when: str, method: str) -> float:
    return float(np.median([case[when][method]["rms"] for case in cases]))


def _figure(by_shift: Mapping[float, Sequence[Case]], methods: Sequence[str]) -> Figure:
    shifts, curves = 1e6 * np.array(list(by_shift)), []
    for key in methods:
        method = m.METHODS[key]
        for when, label, style in zip(_WHEN, (method.title, ""), ("o--", "o-"), strict=True):
            rms = np.degrees([_median(own, when, key) for own in by_shift.values()])
            curves.append(Curve(shifts, rms, label, method.colour, style))
    cases = [case for own in by_shift.values() for case in own]
    true, found = (1e6 * np.array([case[key] for case in cases]) for key in ("shift", "found"))
    zeros = [Curve(shifts, shifts, colour="k"), Curve(true, found, style=".")]
    panels = (
        Panel(curves, "zero off by [um]", "RMS error on (28) [deg]", "before (dashed) and after"),
        Panel(zeros, "zero off by [um]", "found [um]", "the zero found"),
    )
    caption = (
        "Left: what a wrong zero of x2 costs each method, and what re-zeroing leaves; medians "
        "over the specimens. Right: the zero that one unloaded cycle tells, and the true line."
    )
    return Figure("Re-zeroing after homing", (panels,), caption, height=4.4, legend=True)
