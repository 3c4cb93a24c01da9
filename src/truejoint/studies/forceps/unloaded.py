"""Figure 6 and Table 2 of yan2020: calibrate on (27), verify on (28)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np
from pandas import DataFrame

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.simulation.forceps.parameters import ForcepsParameters
from truejoint.studies.claim_tests import RULE, about, against, below, below_all
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, record, title_of
from truejoint.studies.paper_tables import reported, reported_text
from truejoint.studies.rows import frame_table, groups, select
from truejoint.studies.study import Claim, Part, PartResult, Results, Rows, Settings, Summary
from truejoint.tables import fixed

_RUNS: Final = {"calibration": "(27)", "verification": "(28)"}
_OURS: Final = (m.PAPERS_BEST, "ukf_friction", m.BEST)


def parts(settings: Settings) -> Sequence[Part]:
    """One a draw of the sensors' noise: a specimen on both motions."""
    common = m.common_arguments(settings)
    seeds = range(settings.seed, settings.seed + settings["draws"])
    return [
        Part(f"unloaded-{draw}", compare, {**common, "seed": seed}, {"draw": draw})
        for draw, seed in enumerate(seeds)
    ]


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
    settings, name = results.settings, title_of(results.settings["specimen"])
    rows = select(results.rows, draw=0).set_index("method", drop=False)
    verified = select(rows, motion="verification")

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
        "fitted on (27). Of the first draw of the sensors' noise; claims are judged over all "
        f"{settings['draws']}.",
        RULE,
        "The last column is against the jaw itself: it holds the encoder's own error, which "
        "every calibrated method learns.",
        *m.note_left_out(settings, verified),
    )
    title = f"yan2020 Table 2 and figure 6, specimen {name}"
    table = frame_table(
        title, DataFrame(cells, [m.TITLES[key] for key in verified.index]), notes, head="method"
    )
    figure = _figure(results.arrays["unloaded-0"], name)
    claims = _claims(select(results.rows, motion="verification"))
    return Summary((table,), {"forceps-unloaded": figure}, [*claims])


def _claims(verified: DataFrame) -> Iterator[Claim]:
    """Judge what the paper states of its methods on (28), over the draws."""
    errors = {
        str(method): own[["rms", "largest", "smallest"]].map(np.degrees)
        for method, own in groups(verified, "method")
    }
    if m.PAPERS_BEST in errors:
        own, there = errors[m.PAPERS_BEST], reported("yan2020", "2", "trajectory 28", m.PAPERS_BEST)
        largest = np.maximum(own.largest, -own.smallest)
        for what, values, limit, printed in (
            ("RMS", own.rms, 0.2, there["rms"]),
            ("largest", largest, 0.5, max(there["max"], -there["min"])),
        ):
            text = f"the filter's {what} error on (28) stays below {limit} deg"
            found = f"{values.mean():.3f} deg{against(values, limit)}; in the paper {printed:.2f}"
            yield Claim(text, "yan2020, IV-B", below(values, limit), found)
    if set(m.PAPERS) <= errors.keys():
        one, two, best = (errors[method].rms.to_numpy() for method in m.PAPERS)
        text = "least squares err more than compensated ones, and those more than the filter"
        found = f"{one.mean():.3f}, {two.mean():.3f}, {best.mean():.3f} deg RMS"
        yield Claim(text, "yan2020, Table 2", below_all([(two, one), (best, two)]), found)
        saved = 1.0 - best / two
        text = "the filter's RMS error is about 54 % below that of compensated least squares"
        found = f"{100 * saved.mean():.0f} % below; 44 to 64 % counts as about"
        yield Claim(text, "yan2020, IV-C", about(saved, 0.44, 0.64), found)
        text = "one sensor, on the reset cable, is enough: its filter beats least squares on both"
        both = np.minimum(one, two)
        found = f"{best.mean():.3f} deg with x2{against(best, both)}; with x1 and x2 "
        yield Claim(text, "yan2020, IV-C", below(best, both), f"{found}{both.mean():.3f} deg")


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
