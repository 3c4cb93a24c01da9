"""Which sensor to install where: strategies 1, 2 and 3 of yan2020, II-B."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pandas import DataFrame, concat

from truejoint.studies.forceps import loaded, unloaded
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import title_of
from truejoint.studies.rows import Cell, each, ecdf_figure, select, table_of
from truejoint.studies.study import Claim, Part, Results, Settings, Summary
from truejoint.tables import fixed


def parts(settings: Settings) -> Sequence[Part]:
    """Those of the unloaded experiment and of the load tests."""
    return (*unloaded.parts(settings), *loaded.parts(settings))


def summarise(results: Results) -> Summary:
    """Methods by strategy: RMS unloaded, and the worst loaded phase in each direction."""
    settings, rows = results.settings, results.rows
    verified, ways = select(rows, motion="verification"), settings["directions"]

    def worst(*directions: str) -> Cell:
        return lambda group: fixed(
            math.degrees(loaded.worst(rows, group.method.iloc[0], "IV", *directions)), 3
        )

    cells: dict[str, Cell] = {
        "strategy": lambda group: str(1 + len(m.METHODS[group.method.iloc[0]].cables)),
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
    cases = concat([verified.assign(case="unloaded, (28)"), select(rows, phase="IV")])
    cases = cases.fillna({"case": "still under a load"}).assign(name=cases.method.map(m.title))
    caption = "Share of the weights under which a method errs by less, and its error without one."
    figure = ecdf_figure(title, cases, "name", "case", caption, colours=m.COLOURS)
    return Summary((table,), {"forceps-strategies": figure}, _claims(verified))


def _claims(verified: DataFrame) -> list[Claim]:
    rms = {row.method: math.degrees(row.rms) for row in each(verified)}
    both = [rms[key] for key in m.PAPERS[:2] if key in rms]
    if m.PAPERS_BEST not in rms or not both:
        return []
    text = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
    found = f"{rms[m.PAPERS_BEST]:.3f} deg with x2; with x1 and x2 {min(both):.3f} deg"
    return [Claim(text, "yan2020, IV-C", bool(rms[m.PAPERS_BEST] < min(both)), found)]
