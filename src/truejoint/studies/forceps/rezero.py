"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from pandas import DataFrame

from truejoint.drawing import Curve, Figure, Panel, by_condition
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.encoder_zero import find_encoder_zero
from truejoint.motion.forceps_trajectories import RAMP
from truejoint.simulation.forceps.sensors import ZeroShift
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.load import signals, unloaded_filter
from truejoint.studies.forceps.motions import Plain, built, changed, drawn_specimens, record
from truejoint.studies.rows import Cell, select, table_of, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import fixed

BEFORE, AFTER = "before", "after"
_HARM: Final = np.radians(0.002)  # by which an error must grow to count as harm


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and wrong zero."""
    settings.check_names("method", "methods", m.METHODS)
    return [
        Part(
            f"{name}-shift-{shift:g}um",
            home,
            {"forceps": plant, "methods": settings["methods"], "seed": seed, "shift": shift / 1e6},
            {"specimen": name},
        )
        for name, plant, seed in drawn_specimens(settings)
        for shift in settings["shifts_um"]
    ]


def home(forceps: Plain, methods: Sequence[str], seed: int, shift: float) -> Rows:
    """Calibrate, home with ``x2`` off by `shift` [m], estimate that, and judge on (28).

    The estimate is taken off only where it is more than it may be off by.
    """
    plant, zero = built(forceps), ZeroShift(reset=shift)
    models = m.calibrated(plant, tuple(methods), seed)
    cycle = record(plant, "cycle", seed=2 * seed + 50, zero_shift=zero)
    X, dt = signals(cycle.rows(cycle.t >= RAMP))
    estimate = find_encoder_zero(unloaded_filter(plant, seed), X, dt)
    before = m.settled(record(plant, "verification", seed=2 * seed + 1, zero_shift=zero))
    after = changed(before, RESET, before.column(RESET) - estimate.correction)
    labels = {
        "shift": shift, "estimate": estimate.shift, "deviation": estimate.deviation,
        "taken_off": estimate.correction,
    }  # fmt: skip
    return [
        row
        for when, run in ((BEFORE, before), (AFTER, after))
        for row in m.judge(models, run).errors(when=when, **labels)
    ]


def summarise(results: Results) -> Summary:
    """RMS error of each method before and after re-zeroing, by zero: medians over the specimens."""
    settings = results.settings
    rows = results.rows.sort_values("shift", kind="stable")
    count = len(results.arrays)
    methods = [key for key in unique(rows, "method") if len(select(rows, method=key)) == 2 * count]

    def rms_of(key: str) -> Cell:
        return lambda group: " -> ".join(
            m.degrees(select(group, method=key, when=when)) for when in (BEFORE, AFTER)
        )

    cells: dict[str, Cell] = {
        "found": lambda group: f"{_micro(group.estimate.median())} um",
        "off, RMS": lambda group: (
            f"{_micro(_rms(group.estimate - group['shift']))} "
            f"(stated {_micro(group.deviation.median())})"
        ),
        "taken off": lambda group: f"{(group.taken_off != 0.0).sum()} of {len(group)}",
    }
    cases = rows.drop_duplicates("part")
    first = {
        name: (lambda group, cell=cell: cell(group.drop_duplicates("part")))
        for name, cell in cells.items()
    }
    grown = select(rows, when=AFTER).rms.to_numpy() - select(rows, when=BEFORE).rms.to_numpy()
    ratio = (cases.estimate - cases["shift"]) / cases.deviation
    shifts = unique(rows, "shift")
    notes = (
        f"{len(cases) // len(shifts)} specimens; RMS error in degrees on (28), before -> after "
        "re-zeroing from one unloaded cycle of (27) with no sensor at the jaw; medians. A shift "
        "within two of its stated deviations is left alone.",
        f"Off by {_rms(ratio):.2f} stated deviations RMS. Worse afterwards by more than "
        f"{fixed(np.degrees(_HARM), 3)} deg: {(grown > _HARM).sum()} of {len(grown)}.",
        *m.note_left_out(settings, rows),
    )
    table = table_of(
        "Re-zeroing after homing", rows, "shift",
        first | {m.title(key): rms_of(key) for key in methods}, notes,
        names=lambda shift: f"{_micro(shift, 0)} um", head="zero off by",
    )  # fmt: skip
    return Summary((table,), {"forceps-rezero": _figure(rows, cases, methods)})


def _micro(metres: Any, decimals: int = 1) -> str:
    return fixed(1e6 * float(metres), decimals)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _figure(rows: DataFrame, cases: DataFrame, methods: Sequence[str]) -> Figure:
    rows = select(rows, method=methods)
    rows = rows.assign(um=1e6 * rows["shift"], name=rows.method.map(m.title) + ", " + rows.when)
    shifts = [min(rows.um), max(rows.um)]
    zeros = [
        Curve(shifts, shifts, colour="k"),
        Curve(1e6 * cases["shift"], 1e6 * cases.estimate, style="."),
    ]
    panels = (
        by_condition(
            rows, "um", "rms", "name", scale=np.degrees(1.0), x="zero off by [um]",
            y="RMS error on (28) [deg]", title="before and after",
        ),
        Panel(zeros, "zero off by [um]", "found [um]", "the zero found"),
    )  # fmt: skip
    caption = (
        "Left: what a wrong zero of x2 costs each method, and what re-zeroing leaves; medians "
        "over the specimens. Right: the zero that one unloaded cycle tells, and the true line."
    )
    return Figure("Re-zeroing after homing", (panels,), caption, height=4.4, legend=True)
