"""Figure 6 and Table 2 of yan2020: calibrate on (27), verify on (28)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, record, title_of
from truejoint.studies.paper_tables import reported, reported_text
from truejoint.studies.rows import frame_table, select
from truejoint.studies.study import Claim, Part, PartResult, Results, Rows, Settings, Summary
from truejoint.tables import fixed

_RUNS: Final = {"calibration": "(27)", "verification": "(28)"}
_OURS: Final = (m.PAPERS_BEST, "ukf_friction", m.BEST)


def parts(settings: Settings) -> Sequence[Part]:
    """One: a specimen on both motions."""
    return (Part("unloaded", compare, m.common_arguments(settings)),)


def compare(forceps: Plain, methods: Sequence[str], seed: int) -> PartResult:
    """Calibrate methods on (27), and judge them there and on (28), with noise of its own."""
    plant, rows = ForcepsParameters.from_dict(forceps), Rows()
    arrays: dict[str, Array] = {}
    models = m.calibrated(plant, tuple(methods), seed)
    for number, motion in enumerate(_RUNS):
        judged = m.judge(models, m.settled(record(plant, motion, seed=2 * seed + number)))
        rows += judged.errors(motion=motion)
        arrays |= judged.arrays(f"{motion}/")
    return PartResult(rows, arrays)


def summarise(results: Results) -> Summary:
    """Table 2, figures 6 and 7, beside the paper's."""
    settings, rows = results.settings, results.rows.set_index("method", drop=False)
    verified, name = select(rows, motion="verification"), title_of(settings["specimen"])

    def paper(table: str, motion: int, metric: str) -> list[str]:
        there = (reported("yan2020", table, f"trajectory {motion}", key) for key in verified.index)
        return [reported_text(printed.get(metric)) for printed in there]

    def degrees(rows: DataFrame, column: str, decimals: int = 3) -> list[str]:
        return [fixed(value, decimals) for value in np.degrees(rows[column])]

    cells = {
        "sensors": [", ".join(m.METHODS[key].sensors) for key in verified.index],
        "RMS": degrees(verified, "rms"),
        "paper": paper("2", 28, "rms"),
        "max": degrees(verified, "largest", 2),
        "paper ": paper("2", 28, "max"),
        "min": degrees(verified, "smallest", 2),
        "paper  ": paper("2", 28, "min"),
        "RMS on (27)": degrees(select(rows, motion="calibration").loc[verified.index], "rms"),
        " paper": paper("figure 6", 27, "rms"),
        "RMS to the jaw": degrees(verified, "exact_rms"),
    }
    notes = (
        "Degrees, on trajectory (28) against the reference encoder at the jaw, from 2.2 s on; "
        "fitted on (27).",
        "The last column is against the jaw itself: it holds the encoder's own error, which "
        "every calibrated method learns.",
        *m.note_left_out(settings, verified),
    )
    title = f"yan2020 Table 2 and figure 6, specimen {name}"
    table = frame_table(
        title, DataFrame(cells, [m.TITLES[key] for key in verified.index]), notes, head="method"
    )
    figure = _figure(results.arrays["unloaded"], name)
    return Summary((table,), {"forceps-unloaded": figure}, [*_claims(verified)])


def _claims(verified: DataFrame) -> Iterator[Claim]:
    """Judge what the paper states of its methods on (28)."""
    errors = verified[["rms", "largest", "smallest"]].map(np.degrees)
    if m.PAPERS_BEST in errors.index:
        rms, largest, smallest = map(float, errors.loc[m.PAPERS_BEST].to_numpy())
        there = reported("yan2020", "2", "trajectory 28", m.PAPERS_BEST)
        for what, value, limit, printed in (
            ("RMS", rms, 0.2, there["rms"]),
            ("largest", max(largest, -smallest), 0.5, max(there["max"], -there["min"])),
        ):
            text = f"the filter's {what} error on (28) stays below {limit} deg"
            found = f"{value:.3f} deg; in the paper {printed:.2f}"
            yield Claim(text, "yan2020, IV-B", bool(value < limit), found)
    if set(m.PAPERS) <= set(errors.index):
        one, two, best = map(float, errors.rms[list(m.PAPERS)].to_numpy())
        text = "least squares err more than compensated ones, and those more than the filter"
        found = f"{one:.3f}, {two:.3f}, {best:.3f} deg RMS"
        yield Claim(text, "yan2020, Table 2", bool(one > two > best), found)
        saved = 1.0 - best / two
        text = "the filter's RMS error is about 54 % below that of compensated least squares"
        found = f"{100 * saved:.0f} % below; 44 to 64 % counts as about"
        yield Claim(text, "yan2020, IV-C", bool(0.44 <= saved <= 0.64), found)
        text = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
        found = f"{best:.3f} deg with x2; with x1 and x2 {min(one, two):.3f} deg"
        yield Claim(text, "yan2020, IV-C", best < min(one, two), found)


def _figure(arrays: Mapping[str, Array], name: str) -> Figure:
    panels: list[list[Panel]] = [[], [], []]
    for run, motion in _RUNS.items():
        signals = {k.removeprefix(f"{run}/"): v for k, v in arrays.items() if run in k}
        t, truth = signals.pop("t"), signals.pop("truth")
        curves = [Curve(t, np.degrees(truth), "encoder", "k")]
        if m.PAPERS_BEST in signals:
            estimate = np.degrees(signals[m.PAPERS_BEST])
            curves.append(Curve(t, estimate, m.TITLES[m.PAPERS_BEST], style="--"))
        panels[0].append(Panel(curves, y=f"jaw on {motion} [deg]", legend=True))
        for line, keys in zip(panels[1:], (m.PAPERS, _OURS), strict=True):
            errors = [
                Curve(t, np.degrees(signals[key] - truth), m.TITLES[key], m.METHODS[key].colour)
                for key in keys
                if key in signals
            ]
            line.append(Panel(errors, "time [s]", "error [deg]", legend=bool(errors)))
    caption = "Angles and errors on both motions: the paper's methods in the middle, ours below."
    return Figure(f"yan2020 figures 6 and 7, specimen {name}", panels, caption, height=8.0)
