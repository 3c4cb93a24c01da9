"""Which sensor to install where: strategies 1, 2 and 3 of yan2020, II-B."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from truejoint.drawing import Curve, Figure, Panel
from truejoint.studies.forceps import loaded, unloaded
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import title_of
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text
from truejoint.tables import Table


def parts(settings: Settings) -> Sequence[Part]:
    """Those of the unloaded experiment and of the load tests."""
    return (*unloaded.parts(settings), *loaded.parts(settings))


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Methods by strategy: RMS unloaded, and the worst loaded phase in each direction."""
    errors = results["unloaded"].numbers["verification"]
    cases = [result.numbers for key, result in results.items() if key != "unloaded"]
    ways = settings["directions"]
    rows = []
    for key, error in errors.items():
        method, rms = m.METHODS[key], degrees_text(error["rms"])
        worst = [degrees_text(loaded.worst(cases, key, "IV", way)) for way in ways]
        sensors = ", ".join(("motor", *method.cables))
        rows.append((method.title, str(method.strategy), sensors, rms, *worst))
    header = ("method", "strategy", "sensors", "RMS unloaded", *(f"worst IV {way}" for way in ways))
    notes = (
        "RMS error in degrees against the reference encoder: unloaded on (28); IV is still "
        f"under a load of up to {max(settings['masses_g']):.0f} g.",
        *m.left_out(settings, errors),
    )
    title = f"Sensor strategies, specimen {title_of(settings['specimen'])}"
    points = {
        "unloaded, (28)": [error["rms"] for error in errors.values()],
        "still under a load, worst": [loaded.worst(cases, key, "IV", *ways) for key in errors],
    }
    place = np.arange(len(errors))
    curves = [Curve(np.degrees(values), place, k, style="o") for k, values in points.items()]
    names = [f"{m.METHODS[key].title}  [{m.METHODS[key].strategy}]" for key in errors]
    panel = Panel(curves, "RMS error [deg]", log="x", rows=names, legend=True)
    caption = "RMS error of each method without a load and still under the worst; [strategy]."
    figure = Figure(title, ((panel,),), caption, width=9.0, height=4.8)
    table = Table(title, header, tuple(rows), notes)
    return Summary((table,), {"forceps-strategies": figure}, _claims(errors))


def _claims(errors: m.Errors) -> list[Claim]:
    both = [float(np.degrees(errors[k]["rms"])) for k in m.PAPERS[:2] if k in errors]
    if m.PAPERS_BEST not in errors or not both:
        return []
    one = float(np.degrees(errors[m.PAPERS_BEST]["rms"]))
    text = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
    numbers = f"{one:.3f} deg with x2; with x1 and x2 {min(both):.3f} deg"
    return [Claim(text, "yan2020, IV-C", one < min(both), numbers)]
