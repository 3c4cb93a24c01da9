"""Which sensor to install where: strategies 1, 2 and 3 of yan2020, II-B."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps import loaded, unloaded
from truejoint.studies.forceps.methods import METHODS, PAPERS_BEST, in_degrees, left_out
from truejoint.studies.forceps.motions import title_of
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text

_SENSORS: Final = {1: "motor only", 2: "and x2", 3: "and x1, x2"}


def parts(settings: Settings) -> Sequence[Part]:
    """Those of the unloaded experiment and of the load tests."""
    return (*unloaded.parts(settings), *loaded.parts(settings))


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Methods by strategy: RMS unloaded, and the worst loaded phase in each direction."""
    name = title_of(settings["specimen"])
    errors = results["unloaded"].numbers["verification"]
    cases = [result.numbers for key, result in results.items() if key != "unloaded"]
    directions = settings["directions"]
    rows = tuple(
        (
            METHODS[key].title,
            str(METHODS[key].strategy),
            _SENSORS[METHODS[key].strategy],
            degrees_text(error["rms"]),
            *(degrees_text(loaded.worst(cases, key, "IV", d)) for d in directions),
        )
        for key, error in errors.items()
    )
    header = (
        "method", "strategy", "sensors", "RMS unloaded", *(f"worst IV {d}" for d in directions)
    )  # fmt: skip
    notes = (
        "RMS error in degrees against the reference encoder: unloaded on (28); IV is still "
        f"under a load of up to {max(settings['masses_g']):.0f} g.",
        *left_out(settings["methods"], errors),
    )
    plain = {key: in_degrees(error) for key, error in errors.items()}
    numbers = {
        "specimen": name,
        "unloaded": plain,
        "loaded": [loaded.plain_case(case) for case in cases],
    }
    methods = [f"{METHODS[k].title}  [{METHODS[k].strategy}]" for k in errors]
    worst = [loaded.worst(cases, key, "IV") for key in errors]
    points = {"unloaded, (28)": [e["rms"] for e in errors.values()], "worst under a load": worst}
    curves = [
        Curve(np.degrees(values), np.arange(len(values)), label, style="o")
        for label, values in points.items()
    ]
    panel = Panel(curves, "RMS error [deg]", log="x", rows=methods, legend=True)
    title = f"Sensor strategies, specimen {name}"
    caption = "RMS error of each method without a load and still under the worst; [strategy]."
    return Summary(
        (Table(title, header, rows, notes),),
        numbers,
        {"forceps-strategies": Figure(title, ((panel,),), caption, width=9.0, height=4.8)},
        _claims(plain),
    )


def _claims(errors: Mapping[str, Mapping[str, float]]) -> list[Claim]:
    both = {k: e["rms_deg"] for k, e in errors.items() if k in ("lsm", "lsm_compensated")}
    if PAPERS_BEST not in errors or not both:
        return []
    one = errors[PAPERS_BEST]["rms_deg"]
    what = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
    numbers = f"{one:.3f} deg with x2; with x1 and x2 {min(both.values()):.3f} deg"
    return [Claim(what, "yan2020, IV-C", one < min(both.values()), numbers)]
