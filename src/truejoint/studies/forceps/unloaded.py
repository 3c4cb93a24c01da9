"""Figure 6 and Table 2 of yan2020: calibrate on (27), verify on (28)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from truejoint.studies.figures import Curve, Figure, Panel
from truejoint.studies.forceps.methods import (
    BEST,
    METHODS,
    PAPERS,
    PAPERS_BEST,
    calibrated,
    in_degrees,
    judge,
    left_out,
    settled,
)
from truejoint.studies.forceps.motions import Plain, built, plain_specimen, record, title_of
from truejoint.studies.paper import reported
from truejoint.studies.study import Claim, Part, PartResult, Settings, Summary
from truejoint.studies.table import Table, degrees_text, reported_text

_RUNS: Final = {"calibration": "(27)", "verification": "(28)"}
_OURS: Final = (PAPERS_BEST, "ukf_friction", BEST)


def parts(settings: Settings) -> Sequence[Part]:
    """One: a specimen on both motions."""
    forceps = plain_specimen(settings["specimen"])
    arguments = {"forceps": forceps, "methods": settings["methods"], "seed": settings.seed}
    return (Part("unloaded", compare, arguments),)


def compare(forceps: Plain, methods: Sequence[str], seed: int) -> PartResult:
    """Calibrate methods on (27), and judge them there and on (28), with noise of its own."""
    plant = built(forceps)
    models = calibrated(plant, tuple(methods), seed)
    judged = {
        motion: judge(models, settled(record(plant, motion, seed=2 * seed + number)))
        for number, motion in enumerate(_RUNS)
    }
    arrays = {k: v for name, one in judged.items() for k, v in one.arrays(f"{name}/").items()}
    return PartResult({name: one.errors() for name, one in judged.items()}, arrays)


def summarise(settings: Settings, results: Mapping[str, PartResult]) -> Summary:
    """Table 2, figures 6 and 7, beside the paper's."""
    result, name = results["unloaded"], title_of(settings["specimen"])
    fitted, verified = result.numbers["calibration"], result.numbers["verification"]
    rows = []
    for key, error in verified.items():
        paper = reported("yan2020", "2", "trajectory 28", key)
        paper_fit = reported("yan2020", "figure 6", "trajectory 27", key)
        rows.append(
            (
                METHODS[key].title,
                degrees_text(error["rms"]),
                reported_text(paper.get("rms")),
                degrees_text(error["largest"], 2),
                reported_text(paper.get("max")),
                degrees_text(error["smallest"], 2),
                reported_text(paper.get("min")),
                degrees_text(fitted[key]["rms"]),
                reported_text(paper_fit.get("rms")),
                degrees_text(error["exact_rms"]),
            )
        )
    header = (
        "method", "RMS", "paper", "max", "paper", "min", "paper", "RMS on (27)", "paper",
        "RMS to the jaw",
    )  # fmt: skip
    notes = (
        "Degrees, on trajectory (28) against the reference encoder at the jaw, from 2.2 s on; "
        "fitted on (27).",
        "The last column is against the jaw itself: it holds the encoder's own error, which "
        "every calibrated method learns.",
        *left_out(settings["methods"], verified),
    )
    title = f"yan2020 Table 2 and figure 6, specimen {name}"
    plain = {
        run: {key: in_degrees(error) for key, error in result.numbers[run].items()} for run in _RUNS
    }
    return Summary(
        (Table(title, header, tuple(rows), notes),),
        {"specimen": name, **plain},
        {"forceps-unloaded": _figure(result, name)},
        _claims(plain["verification"]),
    )


def _claims(errors: Mapping[str, Mapping[str, float]]) -> list[Claim]:
    """Judge what the paper states of its methods on (28), of errors in degrees by method."""
    found = []
    if PAPERS_BEST in errors:
        error, table = errors[PAPERS_BEST], reported("yan2020", "2", "trajectory 28", PAPERS_BEST)
        worst = max(error["largest_deg"], -error["smallest_deg"])
        worst_there = max(table["max"], -table["min"])
        for what, value, limit, there in (
            ("RMS", error["rms_deg"], 0.2, table["rms"]),
            ("largest", worst, 0.5, worst_there),
        ):
            text = f"the filter's {what} error on (28) stays below {limit} deg"
            numbers = f"{value:.3f} deg; in the paper {there:.2f}"
            found.append(Claim(text, "yan2020, IV-B", value < limit, numbers))
    if set(PAPERS) <= set(errors):
        rms = [errors[key]["rms_deg"] for key in PAPERS]
        text = "least squares err more than compensated ones, and those more than the filter"
        numbers = ", ".join(f"{value:.3f}" for value in rms) + " deg RMS"
        found.append(Claim(text, "yan2020, Table 2", rms[0] > rms[1] > rms[2], numbers))
        saved = 1.0 - rms[2] / rms[1]
        text = "the filter's RMS error is about 54 % below that of compensated least squares"
        numbers = f"{100 * saved:.0f} % below; 44 to 64 % counts as about"
        found.append(Claim(text, "yan2020, IV-C", 0.44 <= saved <= 0.64, numbers))
    return found


def _figure(result: PartResult, name: str) -> Figure:
    angles: list[Panel] = []
    errors: dict[tuple[str, ...], list[Panel]] = {PAPERS: [], _OURS: []}
    for run, title in _RUNS.items():
        named = {k.removeprefix(f"{run}/"): v for k, v in result.arrays.items() if run in k}
        t, truth = named["t"], named["truth"]
        curves = [Curve(t, np.degrees(truth), "encoder", "k", width=1.0)]
        if PAPERS_BEST in named:
            estimate = np.degrees(named[PAPERS_BEST])
            curves.append(Curve(t, estimate, METHODS[PAPERS_BEST].title, style="--"))
        angles.append(Panel(curves, y=f"jaw on {title} [deg]", legend=True))
        for keys, panels in errors.items():
            lines = [
                Curve(
                    t,
                    np.degrees(named[key] - truth),
                    f"{METHODS[key].title}: {np.degrees(result.numbers[run][key]['rms']):.3f}",
                    METHODS[key].colour,
                    width=0.7,
                )
                for key in keys
                if key in named
            ]
            panels.append(Panel(lines, "time [s]", "error [deg]", legend=bool(lines)))
    caption = (
        "Angles and errors on both motions: the paper's methods in the middle, ours below; the "
        "legends give RMS errors in degrees."
    )
    title = f"yan2020 figures 6 and 7, specimen {name}"
    return Figure(title, (angles, errors[PAPERS], errors[_OURS]), caption, height=8.0)
