"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from pandas import DataFrame

from truejoint.drawing import Figure, by_condition
from truejoint.estimators.jaw.signals import RESET
from truejoint.estimators.jaw_load.identify import find_encoder_zero
from truejoint.motion.forceps_trajectories import RAMP
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.simulation.forceps.twin import ZeroShift
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.load import unloaded_filter
from truejoint.studies.forceps.motions import Plain, changed, drawn_specimens, record, signals
from truejoint.studies.rows import frame_table, groups, select, unique
from truejoint.studies.study import Part, Results, Rows, Settings, Summary
from truejoint.tables import fixed

BEFORE, AFTER = "before", "after"
_HARM: Final = np.radians(0.002)  # by which an error must grow to count as harm


def parts(settings: Settings) -> Sequence[Part]:
    """One a specimen and wrong zero."""
    settings.check_names("method", "methods", m.METHODS)
    homings = []
    for name, plant, seed in drawn_specimens(settings):
        common = {"forceps": plant, "methods": settings["methods"], "seed": seed}
        for shift in settings["shifts_um"]:
            key, arguments = f"{name}-shift-{shift:g}um", {**common, "shift": shift / 1e6}
            homings.append(Part(key, home, arguments, {"specimen": name}))
    return homings


def home(forceps: Plain, methods: Sequence[str], seed: int, shift: float) -> Rows:
    """Calibrate, home with ``x2`` off by `shift` [m], estimate that, and judge on (28).

    The estimate is taken off only where it is more than it may be off by.
    """
    plant, zero = ForcepsParameters.from_dict(forceps), ZeroShift(reset=shift)
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
    rows = results.rows.sort_values("shift", kind="stable")
    rows = rows.assign(
        name=rows.method.map(m.TITLES), zero=(1e6 * rows["shift"]).map("{:.0f} um".format)
    )
    cases = rows.drop_duplicates("part")
    cases = cases.assign(off=cases.estimate - cases["shift"])
    table = DataFrame(
        {
            zero: {
                "found": f"{_micro(group.estimate.median())} um",
                "off, RMS": f"{_micro(m.rms(group.off))} "
                f"(stated {_micro(group.deviation.median())})",
                "taken off": f"{(group.taken_off != 0.0).sum()} of {len(group)}",
            }
            for zero, group in groups(cases, "zero")
        }
    ).T
    medians = rows.groupby(["zero", "name", "when"], sort=False).rms.median().unstack()
    text = (np.rad2deg(1.0) * medians).map("{:.3f}".format)
    table = table.join((text[BEFORE] + " -> " + text[AFTER]).unstack()[unique(rows, "name")])
    grown = select(rows, when=AFTER).rms.to_numpy() - select(rows, when=BEFORE).rms.to_numpy()
    notes = (
        f"{len(cases) // len(table)} specimens; RMS error in degrees on (28), before -> after "
        "re-zeroing from one unloaded cycle of (27) with no sensor at the jaw; medians. A shift "
        "within two of its stated deviations is left alone.",
        f"Off by {m.rms(cases.off / cases.deviation):.2f} stated deviations RMS. Worse afterwards "
        f"by more than {np.degrees(_HARM):.3f} deg: {(grown > _HARM).sum()} of {len(grown)}.",
        *m.note_left_out(results.settings, rows),
    )
    title = "Re-zeroing after homing"
    rows = rows.assign(um=1e6 * rows["shift"], name=rows["name"] + ", " + rows.when)
    panel = by_condition(
        rows, "um", "rms", "name", scale=np.degrees(1.0), x="zero off by [um]",
        y="RMS error on (28) [deg]",
    )  # fmt: skip
    caption = "What a wrong zero of x2 costs each method, and what re-zeroing leaves; medians."
    return Summary(
        (frame_table(title, table, notes, head="zero off by"),),
        {"forceps-rezero": Figure(title, ((panel,),), caption, height=4.4, legend=True)},
    )


def _micro(metres: float) -> str:
    return fixed(1e6 * float(metres), 1)
