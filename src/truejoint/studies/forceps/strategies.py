"""Which sensor to install where: strategies 1, 2 and 3 of yan2020, II-B."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from pandas import DataFrame

from truejoint.drawing import Curve, Figure, Panel
from truejoint.studies.forceps import loaded, unloaded
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import title_of
from truejoint.studies.paper_tables import degrees_text
from truejoint.studies.rows import Cell, each, select, table_of, unique
from truejoint.studies.study import Claim, Part, Results, Settings, Summary


def parts(settings: Settings) -> Sequence[Part]:
    """Those of the unloaded experiment and of the load tests."""
    return (*unloaded.parts(settings), *loaded.parts(settings))


def summarise(results: Results) -> Summary:
    """Methods by strategy: RMS unloaded, and the worst loaded phase in each direction."""
    settings, rows = results.settings, results.rows
    verified, ways = select(rows, motion="verification"), settings["directions"]

    def worst(*directions: str) -> Cell:
        return lambda group: degrees_text(
            loaded.worst(rows, group.method.iloc[0], "IV", *directions)
        )

    cells: dict[str, Cell] = {
        "strategy": lambda group: str(m.METHODS[group.method.iloc[0]].strategy),
        "sensors": lambda group: ", ".join(("motor", *m.METHODS[group.method.iloc[0]].cables)),
        "RMS unloaded": m.degrees,
        **{f"worst IV {way}": worst(way) for way in ways},
    }
    notes = (
        "RMS error in degrees against the reference encoder: unloaded on (28); IV is still "
        f"under a load of up to {max(settings['masses_g']):.0f} g.",
        *m.note_left_out(settings, verified),
    )
    title = f"Sensor strategies, specimen {title_of(settings['specimen'])}"
    table = table_of(title, verified, "method", cells, notes, names=m.title)
    keys = unique(verified, "method")
    points = {
        "unloaded, (28)": verified.rms,
        "still under a load, worst": [loaded.worst(rows, key, "IV", *ways) for key in keys],
    }
    place = np.arange(len(keys))
    curves = [
        Curve(np.degrees(np.array(values)), place, k, style="o") for k, values in points.items()
    ]
    names = [f"{m.title(key)}  [{m.METHODS[key].strategy}]" for key in keys]
    panel = Panel(curves, "RMS error [deg]", log="x", rows=names, legend=True)
    caption = "RMS error of each method without a load and still under the worst; [strategy]."
    figure = Figure(title, ((panel,),), caption, width=9.0, height=4.8)
    return Summary((table,), {"forceps-strategies": figure}, _claims(verified))


def _claims(verified: DataFrame) -> list[Claim]:
    rms = {row.method: math.degrees(row.rms) for row in each(verified)}
    both = [rms[key] for key in m.PAPERS[:2] if key in rms]
    if m.PAPERS_BEST not in rms or not both:
        return []
    text = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
    found = f"{rms[m.PAPERS_BEST]:.3f} deg with x2; with x1 and x2 {min(both):.3f} deg"
    return [Claim(text, "yan2020, IV-C", bool(rms[m.PAPERS_BEST] < min(both)), found)]
