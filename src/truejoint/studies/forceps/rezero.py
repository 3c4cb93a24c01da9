"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from truejoint.estimators.jaw_load import find_encoder_zero
from truejoint.evaluation.digits import fixed
from truejoint.models.jaw import RESET
from truejoint.motion.forceps_trajectories import RAMP
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.load import signals, unloaded_load
from truejoint.studies.forceps.motions import Plain, built, changed, record, title_of
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text


def parts(settings: Settings) -> Sequence[Part]:
    """One a wrong zero."""
    common = m.common_arguments(settings)
    return [
        Part(f"shift-{shift:g}um", home, {**common, "shift": shift / 1e6})
        for shift in settings["shifts_um"]
    ]


def home(forceps: Plain, methods: Sequence[str], seed: int, shift: float) -> PartResult:
    """Calibrate, home with ``x2`` off by `shift` [m], find that, and judge on (28)."""
    plant, zero = built(forceps), ZeroShift(reset=shift)
    models = m.calibrated(plant, tuple(methods), seed)
    cycle = record(plant, "cycle", seed=2 * seed + 50, zero_shift=zero)
    X, dt = signals(cycle.rows(cycle.t >= RAMP))
    found = find_encoder_zero(unloaded_load(plant, seed), X, dt).shift
    before = m.settled(record(plant, "verification", seed=2 * seed + 1, zero_shift=zero))
    after = changed(before, RESET, before.column(RESET) - found)
    judged = {"before": m.judge(models, before).errors(), "after": m.judge(models, after).errors()}
    return PartResult({"shift": shift, "found": found, **judged})


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """RMS error of each method before and after re-zeroing."""
    cases = [result.numbers for result in results.values()]
    methods = list(cases[0]["before"])
    rows = []
    for case in cases:
        both = [(case["before"][key]["rms"], case["after"][key]["rms"]) for key in methods]
        zeros = (f"{1e6 * case['shift']:.0f} um", f"{fixed(1e6 * case['found'], 1)} um")
        rows.append((*zeros, *(" -> ".join(map(degrees_text, pair)) for pair in both)))
    header = ("zero off by", "found", *(m.METHODS[key].title for key in methods))
    notes = (
        "RMS error in degrees on (28), before -> after re-zeroing from one unloaded cycle of "
        "(27) with no sensor at the jaw.",
        *m.left_out(settings, cases[0]["before"]),
    )
    title = f"Re-zeroing after homing, specimen {title_of(settings['specimen'])}"
    table = Table(title, header, tuple(rows), notes)
    return Summary((table,), {"forceps-rezero": _figure(cases, methods, title)})


def _figure(cases: Sequence[Mapping[str, Any]], methods: Sequence[str], title: str) -> Figure:
    shifts, found = (1e6 * np.array([case[key] for case in cases]) for key in ("shift", "found"))
    curves = []
    for key in methods:
        method = m.METHODS[key]
        for when, label, style in (("before", method.title, "o--"), ("after", "", "o-")):
            rms = np.degrees([case[when][key]["rms"] for case in cases])
            curves.append(Curve(shifts, rms, label, method.colour, style))
    zeros = [Curve(shifts, shifts, colour="k"), Curve(shifts, found, style="o")]
    panels = (
        Panel(curves, "zero off by [um]", "RMS error on (28) [deg]", "before (dashed) and after"),
        Panel(zeros, "zero off by [um]", "found [um]", "the zero found"),
    )
    caption = (
        "Left: what a wrong zero of x2 costs each method, and what re-zeroing leaves. Right: the "
        "zero that one unloaded cycle tells, and, as a line, the true one."
    )
    return Figure(title, (panels,), caption, height=4.4, legend=True)
