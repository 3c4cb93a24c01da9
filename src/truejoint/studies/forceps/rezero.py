"""What a homing that sets the reset encoder's zero wrong costs, and what re-zeroing mends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truejoint.estimators.forceps import find_zero
from truejoint.evaluation.digits import fixed
from truejoint.motion.forceps_references import RAMP
from truejoint.simulation.forceps_sensors import ZeroShift
from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.load import signals, unloaded_load
from truejoint.studies.forceps.methods import (
    METHODS,
    RESET,
    calibrated,
    in_degrees,
    judge,
    left_out,
    settled,
)
from truejoint.studies.forceps.motions import (
    Plain,
    built,
    changed,
    plain_specimen,
    record,
    title_of,
)
from truejoint.studies.study import Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text


def parts(settings: Settings) -> Sequence[Part]:
    """One a wrong zero."""
    forceps, methods = plain_specimen(settings["specimen"]), settings["methods"]
    common = {"forceps": forceps, "methods": methods, "seed": settings.seed}
    return [
        Part(f"shift-{number}", home, {**common, "shift": shift / 1e6})
        for number, shift in enumerate(settings["shifts_um"])
    ]


def home(forceps: Plain, methods: Sequence[str], seed: int, shift: float) -> PartResult:
    """Calibrate, home with ``x2`` off by `shift` [m], find that, and judge on (28)."""
    plant, zero = built(forceps), ZeroShift(reset=shift)
    models = calibrated(plant, tuple(methods), seed)
    cycle = record(plant, "cycle", seed=2 * seed + 50, zero_shift=zero)
    X, steps = signals(cycle.rows(cycle.t >= RAMP))
    found = find_zero(unloaded_load(plant, seed), X, steps).shift
    before = settled(record(plant, "verification", seed=2 * seed + 1, zero_shift=zero))
    after = changed(before, RESET, before.column(RESET) - found)
    numbers = {
        "shift": shift,
        "found": found,
        "before": judge(models, before).errors(),
        "after": judge(models, after).errors(),
    }
    return PartResult(numbers)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """RMS error of each method before and after re-zeroing."""
    name, cases = title_of(settings["specimen"]), [result.numbers for result in results.values()]
    methods = list(cases[0]["before"])
    rows = tuple(
        (
            f"{1e6 * case['shift']:.0f} um",
            f"{fixed(1e6 * case['found'], 1)} um",
            *(
                " -> ".join(degrees_text(case[when][m]["rms"]) for when in ("before", "after"))
                for m in methods
            ),
        )
        for case in cases
    )
    header = ("zero off by", "found", *(METHODS[m].title for m in methods))
    notes = (
        "RMS error in degrees on (28), before -> after re-zeroing from one unloaded cycle of "
        "(27) with no sensor at the jaw.",
        *left_out(settings["methods"], cases[0]["before"]),
    )
    title = f"Re-zeroing after homing, specimen {name}"
    numbers = {
        "specimen": name,
        "cases": [
            {
                "shift_um": 1e6 * case["shift"],
                "found_um": 1e6 * case["found"],
                **{
                    when: {key: in_degrees(error) for key, error in case[when].items()}
                    for when in ("before", "after")
                },
            }
            for case in cases
        ],
    }
    shifts = np.array([1e6 * case["shift"] for case in cases])
    found = 1e6 * np.array([case["found"] for case in cases])
    panels = [
        Panel(
            [
                Curve(
                    shifts, np.degrees([case[when][m]["rms"] for case in cases]),
                    METHODS[m].title if when == "before" else "", METHODS[m].colour or None, style,
                )
                for m in methods
                for when, style in (("before", "o--"), ("after", "o-"))
            ],
            "zero off by [um]",
            "RMS error on (28) [deg]",
            "before (dashed) and after",
        ),
        Panel(
            [Curve(shifts, shifts, colour="k", width=0.8), Curve(shifts, found, style="o")],
            "zero off by [um]",
            "found [um]",
            "the zero found",
        ),
    ]  # fmt: skip
    caption = "What a wrong zero of x2 costs each method, what is left after re-zeroing, and it."
    return Summary(
        (Table(title, header, rows, notes),),
        numbers,
        {"forceps-rezero": Figure(title, (panels,), caption, height=4.4, legend=True)},
    )
