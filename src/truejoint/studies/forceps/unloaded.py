"""Figure 6 and Table 2 of yan2020: calibrate on (27), verify on (28)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.array_types import Array
from truejoint.drawing import Curve, Figure, Panel
from truejoint.studies.forceps import methods as m
from truejoint.studies.forceps.motions import Plain, built, record, title_of
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import degrees_text, reported, reported_text
from truejoint.tables import Table

_RUNS: Final = {"calibration": "(27)", "verification": "(28)"}
_OURS: Final = (m.PAPERS_BEST, "ukf_friction", m.BEST)
_COMPARED: Final = (("rms", "rms", 3), ("largest", "max", 2), ("smallest", "min", 2))
_HEADER: Final = (
    "method", "RMS", "paper", "max", "paper", "min", "paper", "RMS on (27)", "paper",
    "RMS to the jaw",
)  # fmt: skip


def parts(settings: Settings) -> Sequence[Part]:
    """One: a specimen on both motions."""
    return (Part("unloaded", compare, m.common_arguments(settings)),)


def compare(forceps: Plain, methods: Sequence[str], seed: int) -> PartResult:
    """Calibrate methods on (27), and judge them there and on (28), with noise of its own."""
    plant = built(forceps)
    numbers: dict[str, m.Errors] = {}
    arrays: dict[str, Array] = {}
    models = m.calibrated(plant, tuple(methods), seed)
    for number, motion in enumerate(_RUNS):
        judged = m.judge(models, m.settled(record(plant, motion, seed=2 * seed + number)))
        numbers[motion] = judged.errors()
        arrays |= judged.arrays(f"{motion}/")
    return PartResult(numbers, arrays)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table 2, figures 6 and 7, beside the paper's."""
    result, name = results["unloaded"], title_of(settings["specimen"])
    fitted, verified = (result.numbers[run] for run in _RUNS)
    rows = []
    for key, error in verified.items():
        paper = reported("yan2020", "2", "trajectory 28", key)
        paper_fit = reported("yan2020", "figure 6", "trajectory 27", key)
        cells = [m.METHODS[key].title]
        for ours, theirs, decimals in _COMPARED:
            cells += [degrees_text(error[ours], decimals), reported_text(paper.get(theirs))]
        cells += [degrees_text(fitted[key]["rms"]), reported_text(paper_fit.get("rms"))]
        rows.append((*cells, degrees_text(error["exact_rms"])))
    notes = (
        "Degrees, on trajectory (28) against the reference encoder at the jaw, from 2.2 s on; "
        "fitted on (27).",
        "The last column is against the jaw itself: it holds the encoder's own error, which "
        "every calibrated method learns.",
        *m.left_out(settings, verified),
    )
    title = f"yan2020 Table 2 and figure 6, specimen {name}"
    table = Table(title, _HEADER, tuple(rows), notes)
    return Summary((table,), {"forceps-unloaded": _figure(result, name)}, [*_claims(verified)])


def _claims(errors: m.Errors) -> Iterator[Claim]:
    """Judge what the paper states of its methods on (28)."""
    if m.PAPERS_BEST in errors:
        error = errors[m.PAPERS_BEST]
        there = reported("yan2020", "2", "trajectory 28", m.PAPERS_BEST)
        largest = max(error["largest"], -error["smallest"])
        for what, value, limit, printed in (
            ("RMS", np.degrees(error["rms"]), 0.2, there["rms"]),
            ("largest", np.degrees(largest), 0.5, max(there["max"], -there["min"])),
        ):
            text = f"the filter's {what} error on (28) stays below {limit} deg"
            numbers = f"{value:.3f} deg; in the paper {printed:.2f}"
            yield Claim(text, "yan2020, IV-B", bool(value < limit), numbers)
    if set(m.PAPERS) <= set(errors):
        rms = [float(np.degrees(errors[key]["rms"])) for key in m.PAPERS]
        text = "least squares err more than compensated ones, and those more than the filter"
        numbers = ", ".join(f"{value:.3f}" for value in rms) + " deg RMS"
        yield Claim(text, "yan2020, Table 2", rms[0] > rms[1] > rms[2], numbers)
        saved = 1.0 - rms[2] / rms[1]
        text = "the filter's RMS error is about 54 % below that of compensated least squares"
        numbers = f"{100 * saved:.0f} % below; 44 to 64 % counts as about"
        yield Claim(text, "yan2020, IV-C", 0.44 <= saved <= 0.64, numbers)


def _figure(result: PartResult, name: str) -> Figure:
    rows: list[list[Panel]] = [[], [], []]
    for run, motion in _RUNS.items():
        signals = {k.removeprefix(f"{run}/"): v for k, v in result.arrays.items() if run in k}
        t, truth = signals.pop("t"), signals.pop("truth")
        curves = [Curve(t, np.degrees(truth), "encoder", "k")]
        if m.PAPERS_BEST in signals:
            estimate = np.degrees(signals[m.PAPERS_BEST])
            curves.append(Curve(t, estimate, m.METHODS[m.PAPERS_BEST].title, style="--"))
        rows[0].append(Panel(curves, y=f"jaw on {motion} [deg]", legend=True))
        for row, keys in zip(rows[1:], (m.PAPERS, _OURS), strict=True):
            lines = []
            for key in (key for key in keys if key in signals):
                error, rms = signals[key] - truth, np.degrees(result.numbers[run][key]["rms"])
                method, label = m.METHODS[key], f"{m.METHODS[key].title}: {rms:.3f}"
                lines.append(Curve(t, np.degrees(error), label, method.colour, width=0.7))
            row.append(Panel(lines, "time [s]", "error [deg]", legend=bool(lines)))
    caption = (
        "Angles and errors on both motions: the paper's methods in the middle, ours below; the "
        "legends give RMS errors in degrees."
    )
    return Figure(f"yan2020 figures 6 and 7, specimen {name}", rows, caption, height=8.0)
