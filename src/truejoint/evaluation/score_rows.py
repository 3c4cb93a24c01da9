"""Scores as tables, in deg and mm: rows of the page, of the terminal, of CSV and LaTeX."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd
from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint.array_types import Mask
from truejoint.errors import RecordingError
from truejoint.evaluation.results import (
    OFFSET,
    Evaluation,
    as_evaluation,
    estimator_phrase,
    estimator_title,
    known_loads,
)
from truejoint.evaluation.verdict import flags_text, limit_phrase
from truejoint.files import check_target, write_atomically
from truejoint.recordings import JointCoverage
from truejoint.tables import (
    DASH,
    Table,
    csv_text,
    decimals_for,
    fixed,
    percent_text,
    share_text,
    shown,
    spread_text,
)
from truejoint.units import display_unit

Grid = list[list[str]]  # header and rows

_LABELS: Final = {
    "accepted": "data checks that failed and were accepted",
    "created": "made",
    "sha256": "SHA-256",
    "rows": "rows trained on",
    "sessions": "Recordings trained on",
    "interval_sessions": "Recordings that made the interval",
    "homing_id": "homing",
    "homing_ids": "homings",
    "load": "load [kg]",
    "start": "start [s]",
    "first": "first row [s]",
    "last": "last row [s]",
    "data_sha256": "SHA-256 of the training data",
    "sample_dt": "time between rows [s]",
    "fit_seconds": "time of the fit [s]",
    "random_state": "seed",
    "command": "command line",
}


_COLUMNS: Final = {
    "RMSE": "rmse", "spread": "spread", "largest": "max_abs", "mean": "mean",
    "RMSE inside": "rmse_inside", "RMSE outside": "rmse_outside",
    "RMSE x": "x", "RMSE y": "y", "RMSE z": "z",
}  # fmt: skip
"""Attributes of scores by column; a column without a number is left out."""

_SIDES: Final = ("inside", "outside")


@dataclass(frozen=True)
class Row:
    """A row: its name, its cells, and the unit for a person."""

    name: str
    cells: Sequence[Any]
    unit: str = ""


def main_rows(evaluation: Evaluation) -> Iterator[Row]:
    """Joints and the tool by estimator: RMSE, spread, largest, percent."""
    for name, unit, scores in evaluation.shown_scores():
        values = [unit.scale * score.rmse for score in scores]
        decimals = decimals_for(values)
        cells = [
            {
                "rmse": fixed(value, decimals),
                "spread": spread_text(unit.scale * s.spread, decimals),
                "largest": fixed(unit.scale * s.max_abs, max(decimals - 1, 1)),
                "percent": percent_text(s.percent_of_offset),
                "chosen": s.estimator == evaluation.chosen,
                "best": value == min(values),
            }
            for value, s in zip(values, scores, strict=True)
        ]
        yield Row(name, cells, unit.name)


def headlines(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """Give the chosen model's RMSE of each joint, and of the tool, for the first screen."""
    verdicts = {verdict.joint: verdict for verdict in evaluation.verdict.joints}
    bands = {
        row["joint"]: f"± {row['widths'][0]} {row['unit']} stated at {row['level']}; "
        f"{row['coverage']} found inside"
        for row in interval_rows(evaluation)
        if row["chosen"]
    }
    for name, unit, scores in evaluation.shown_scores():
        rows = {score.estimator: score for score in scores}
        own, verdict = rows[evaluation.chosen], verdicts.get(name)
        limit = verdict.limit if verdict else rows[OFFSET].rmse
        value, beside = shown([unit.scale * own.rmse, unit.scale * limit])
        against = limit_phrase(verdict) if verdict else f"{estimator_phrase(OFFSET)}'s"
        percent = f"{percent_text(own.percent_of_offset)} of fixed offset"
        yield {
            "name": name,
            "value": value,
            "unit": unit.name,
            "percent": "" if evaluation.chosen == OFFSET else percent,
            "limit": f"{against} {beside} {unit.name}",
            "interval": bands.get(name, ""),
            "passed": verdict.passed if verdict else None,
        }


def interval_rows(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """One row a joint and stated level: coverage, and half-widths beside the fixed offset's."""
    for _, joint, unit in evaluation.shown_joints():
        scores = [score for score in evaluation.intervals if score.joint == joint]
        pairs = [(unit.scale * s.half_width, unit.scale * s.offset_half_width) for s in scores]
        decimals = decimals_for(value for pair in pairs for value in pair)
        for score, widths in zip(scores, pairs, strict=True):
            offset = score.offset_half_width
            error = f" ± {100 * score.standard_error:.1f}" if len(score.shares) > 1 else ""
            worst = int(np.argmin(score.shares))
            yield {
                "joint": joint,
                "unit": unit.name,
                "level": f"{100 * score.level:g} %",
                "coverage": f"{100 * score.coverage:.1f}{error} %",
                "agreement": score.agreement,
                "worst": f"{100 * score.shares[worst]:.1f} %",
                "worst_name": evaluation.interval_trajectories[worst],
                "widths": [fixed(width, decimals) for width in widths],
                "percent": percent_text(100 * (score.half_width / offset if offset > 0 else 1)),
                "chosen": score.level == evaluation.interval_level,
            }


def comparison_rows(evaluation: Evaluation) -> Iterator[Row]:
    """Tell what the chosen model is beside every other, by joint, and over how many stretches."""
    for comparison in evaluation.comparisons:
        extent = f"{comparison.stretches} of up to {duration(comparison.seconds)}"
        cells = [estimator_title(comparison.estimator), comparison.outcome, extent]
        yield Row(comparison.joint, cells)


def domain_line(evaluation: Evaluation) -> str:
    """Share of the test that the loop would correct, and why not the rest."""
    domain = evaluation.domain
    flags = f"; it flags {flags_text(domain)}." if domain.flags else "."
    return f"The loop would correct {share_text(domain.inside)} of the rows{flags}"


def load_rows(evaluation: Evaluation) -> Iterator[Row]:
    """RMSE before and after by hung mass; empty unless the test has several known masses."""
    masses = known_loads(evaluation.traces)
    loads = [trace.provenance.get("load") for trace in evaluation.traces]
    sizes = [len(trace.t) for trace in evaluation.traces]
    for mass in masses if len(masses) > 1 else ():
        rows = np.repeat([load == mass for load in loads], sizes)
        for column, joint, _ in evaluation.shown_joints():
            cells = [joint, loads.count(mass)]
            yield _before_after(evaluation, column, rows, f"{1e3 * mass:.0f} g", cells)


def direction_rows(evaluation: Evaluation) -> Iterator[Row]:
    """Bias and RMSE of the chosen model by joint and direction of motion."""
    for column, joint, _ in evaluation.shown_joints():
        moves = np.concatenate([trace.direction[:, column] for trace in evaluation.traces])
        for title, way in (("up", 1), ("down", -1), ("standing", 0)):
            if (rows := moves == way).any():
                cells = [title, f"{100 * rows.mean():.0f} %"]
                yield _before_after(evaluation, column, rows, joint, cells)


def _before_after(
    evaluation: Evaluation, column: int, rows: Mask, name: str, cells: Sequence[Any]
) -> Row:
    """Row with mean error and RMSE of the fixed offset and of the chosen model in some rows."""
    unit = display_unit(evaluation.units[column])
    numbers: list[float] = []
    for estimator in (OFFSET, evaluation.chosen):
        error = unit.scale * evaluation.error(estimator, column)[rows]
        numbers += [error.mean(), np.sqrt(np.mean(error**2))]
    decimals = decimals_for(numbers[1::2])
    return Row(name, [*cells, *(fixed(value, decimals) for value in numbers)], unit.name)


def recording_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """One row a test recording, worst first: provenance and RMSE before and after, by joint."""
    scores = {(r.recording, r.estimator, r.joint): r for r in evaluation.recording_scores}
    limits = {v.joint: v.limit for v in evaluation.verdict.joints}
    chosen, rows = evaluation.chosen, []
    digits = {}
    for _, joint, unit in evaluation.shown_joints():
        rmse = (scores[trace.name, chosen, joint].rmse for trace in evaluation.traces)
        digits[joint] = decimals_for(unit.scale * value for value in rmse)
    for trace in evaluation.traces:
        cells, ratio = [], 0.0
        for _, joint, unit in evaluation.shown_joints():
            before, after = (scores[trace.name, name, joint] for name in (OFFSET, chosen))
            ratio = max(ratio, after.rmse / limits[joint] if limits[joint] > 0 else 0.0)
            values = (before.rmse, after.rmse, after.max_abs)
            cells.append([fixed(unit.scale * value, min(digits[joint], 3)) for value in values])
        load = trace.provenance.get("load")
        rows.append(
            {
                "name": trace.name,
                "session": trace.provenance.get("session") or "",
                "homing": trace.provenance.get("homing_id") or "",
                "load": "" if load is None else f"{1e3 * load:.0f} g",
                "rows": f"{len(trace.t):,}",
                "duration": duration(float(trace.t[-1] - trace.t[0])),
                "cells": cells,
                "ratio": ratio,
            }
        )
    return sorted(rows, key=lambda row: -row["ratio"])


def coverage_rows(coverage: Sequence[JointCoverage]) -> Iterator[Row]:
    """Coverage of each joint as text: range, travel, filled, directions, speed, effort, truth."""
    for row in coverage:
        unit, effort = display_unit(row.unit), display_unit(row.effort_unit)
        low, high = shown([unit.scale * row.lowest, unit.scale * row.highest], most=2)
        speed = shown([unit.scale * row.speed_median, unit.scale * row.speed_high])
        force = shown([effort.scale * row.effort_low, effort.scale * row.effort_high])
        effort_text = f"{force[0]} to {force[1]} {effort.name}".removesuffix(" 1")
        cells = [
            f"{low} to {high} {unit.name}",
            percent_text(100 * row.share_of_limits),
            percent_text(100 * row.filled),
            " / ".join(f"{100 * share:.0f}" for share in (row.up, row.down, row.standing)),
            f"{speed[0]} / {speed[1]} {unit.name}/s",
            effort_text if math.isfinite(row.effort_low) else "\N{EN DASH}",
            percent_text(100 * row.truth_missing),
            f"{row.rows:,}",
            duration(row.duration),
        ]
        yield Row(row.joint, cells)


def duration(seconds: float) -> str:
    """Length of time for a person, such as ``"20 min 4 s"``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def origin(metadata: Mapping[str, Any]) -> tuple[list[tuple[str, str]], list[tuple[str, Grid]]]:
    """Tell what a model says of its training: facts by label, and what are tables.

    A table is a list of objects, such as the sessions: its title, and its header and rows of text,
    without columns that are empty throughout.
    """
    facts: list[tuple[str, str]] = []
    grids: list[tuple[str, Grid]] = []
    for key, value in metadata.items():
        label = _LABELS.get(key, key.replace("_", " "))
        if isinstance(value, list | tuple) and value and all(isinstance(v, Mapping) for v in value):
            keys = list(dict.fromkeys(key for row in value for key in row))
            cells = {key: [_text(key, row.get(key)) for row in value] for key in keys}
            filled = [key for key in keys if any(cells[key])]
            header = [_LABELS.get(key, key.replace("_", " ")) for key in filled]
            grid = [header, *([cells[key][i] for key in filled] for i in range(len(value)))]
            grids.append((label, grid))
        else:
            facts.append((label, _text(key, value)))
    return [(label, text) for label, text in facts if text], grids


def _text(key: str, value: Any) -> str:
    """One JSON value for a person; long lists are cut short and say so."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(name, item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        more = f", and {len(value) - 24} more" if len(value) > 24 else ""
        return ", ".join(_text("", item) for item in value[:24]) + more
    if isinstance(value, bool | None):
        return {None: "", True: "yes", False: "no"}[value]
    if isinstance(value, int | float):
        plain = f"{value:,}" if isinstance(value, int) else f"{value:.6g}"
        return duration(float(value)) if key == "duration" else plain
    return str(value)


@dataclass(frozen=True)
class ScoreTable:
    r"""Scores of all estimators in one joint, or of the tool, in its `unit` for a person.

    Examples
    --------
    >>> table = next(score_tables(evaluation))
    >>> table.name, list(table.data.columns[:2])
    ('jaw', ['estimator', 'RMSE [deg]'])
    >>> print(table.latex().splitlines()[0])
    % davinci_grasper: jaw; needs \usepackage{booktabs}
    """

    name: str
    title: str
    unit: str
    data: pd.DataFrame

    @property
    def stem(self) -> str:
        """Name for a file: letters, digits, dashes and underscores."""
        return re.sub(r"[^\w-]+", "_", self.name)

    def texts(self, dash: str = DASH) -> pd.DataFrame:
        """Cells with sensible digits, those of one unit with the same; `dash` where none is."""
        text = self.data.astype(object)
        lengths = [name for name in text.columns if f"[{self.unit}]" in name]
        decimals = decimals_for(self.data[lengths[0]])
        for name in text.columns[1:]:
            digits = decimals if name in lengths else 0
            text[name] = [dash if pd.isna(v) else fixed(v, digits) for v in self.data[name]]
        return text

    def csv(self) -> str:
        """All digits, one row per estimator."""
        return csv_text(self.data)

    def latex(self) -> str:
        """Table as `booktabs` draws it, with as many decimals as the page shows."""
        text = self.texts("--").replace("\N{MINUS SIGN}", "-", regex=True)
        places = "l" + "r" * (text.shape[1] - 1)
        body = text.to_latex(index=False, escape=True, column_format=places)
        about = " ".join(f"{self.title}: {self.name}".split())
        return f"% {about}; needs \\usepackage{{booktabs}}\n{body}"


def score_tables(evaluation: Evaluation) -> Iterator[ScoreTable]:
    """Yield a table per joint, then that of the tool where its position is known.

    Examples
    --------
    >>> [table.name for table in score_tables(evaluation)]
    ['jaw']
    """
    for name, unit, scores in as_evaluation(evaluation).shown_scores():
        columns: dict[str, Any] = {"estimator": [estimator_title(s.estimator) for s in scores]}
        for title, attribute in _COLUMNS.items():
            values = [unit.scale * getattr(score, attribute) for score in scores]
            columns[f"{title} [{unit.name}]"] = values
        columns["percent of fixed offset"] = [score.percent_of_offset for score in scores]
        columns["seeds"] = [score.seeds for score in scores]
        data = pd.DataFrame(columns).dropna(axis="columns", how="all")
        yield ScoreTable(name, evaluation.title, unit.name, data)


def write_tables(
    evaluation: Evaluation, folder: str | Path, *, overwrite: bool = False
) -> list[Path]:
    """Write ``<joint>.csv`` and ``<joint>.tex`` of every joint, and of the tool, into a folder.

    Parameters
    ----------
    evaluation : Evaluation
    folder : str or Path
        Made if it is not there.
    overwrite : bool
        Whether files of these names may be replaced.

    Raises
    ------
    RecordingError
        If one is there and may not be replaced, or `folder` is a file, before any is written.

    Examples
    --------
    >>> [path.name for path in write_tables(evaluation, "tables")]
    ['jaw.csv', 'jaw.tex']
    """
    target = Path(folder)
    if target.exists() and not target.is_dir():
        raise RecordingError(f"{target}: is a file; name a folder for the tables")
    texts = {}
    for table in score_tables(evaluation):
        texts[target / f"{table.stem}.csv"] = table.csv()
        texts[target / f"{table.stem}.tex"] = table.latex()
    target.mkdir(parents=True, exist_ok=True)
    for path in texts:
        check_target(path, overwrite=overwrite, error=RecordingError)
    for path, text in texts.items():
        write = partial(Path.write_text, data=text, encoding="utf-8")
        write_atomically(path, write, overwrite=overwrite, error=RecordingError)
    return list(texts)


def score_table(evaluation: Evaluation) -> rich_table.Table:
    """Joints (and the tool) by estimator: RMSE, spread over seeds; the smallest of a row is bold.

    For the chosen estimator also the percentage of the fixed offset's.

    Examples
    --------
    >>> score_table(evaluation).row_count
    1
    """
    title = f"{as_evaluation(evaluation).title}: RMSE on the test (percent: of the fixed offset's)"
    table = rich_table.Table(title=title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("joint", overflow="fold")
    for name in evaluation.estimators:
        style = "cyan" if name == evaluation.chosen else ""
        table.add_column(estimator_title(name), justify="right", style=style, overflow="fold")
    for row in main_rows(evaluation):
        cells = []
        for cell in row.cells:
            text = Text(cell["rmse"], style="bold" if cell["best"] else "")
            percent = f"{cell['percent']:>6}" if cell["chosen"] else ""
            for small in filter(None, (cell["spread"], percent)):
                text.append(f" {small}", style="not bold dim")
            cells.append(text)
        table.add_row(Text(f"{row.name.removesuffix(' position')} [{row.unit}]"), *cells)
    return table


def domain_table(evaluation: Evaluation) -> rich_table.Table:
    """RMSE inside and outside the trained domain; without a row where all lies inside.

    Examples
    --------
    >>> domain_table(evaluation).row_count
    0
    """
    rows: list[tuple[str, ...]] = []
    for table in score_tables(evaluation):
        text, columns = table.texts(), [f"RMSE {side} [{table.unit}]" for side in _SIDES]
        if columns[1] in text:
            cells = text.reindex(columns=["estimator", *columns], fill_value=DASH).to_numpy()
            rows += [(f"{table.name} [{table.unit}]", *row) for row in cells]
    header = ("joint", "estimator", *_SIDES)
    return Table("RMSE inside and outside the trained domain", header, tuple(rows)).rich()


def interval_table(evaluation: Evaluation) -> rich_table.Table:
    """Stated levels by joint: share of the test inside, and half-widths beside the offset's.

    Examples
    --------
    >>> interval_table(evaluation).row_count
    2
    """
    count = len(evaluation.interval_trajectories)
    title = f"Stated interval, on {count} test {'trajectories' if count != 1 else 'trajectory'}"
    header = ("joint", "stated", "found inside", "half-width", "fixed offset's", "")
    rows = []
    for row in interval_rows(evaluation):
        name = f"{row['joint']} [{row['unit']}]"
        rows.append((name, row["level"], row["coverage"], *row["widths"], row["agreement"]))
    return Table(title, header, tuple(rows)).rich()
