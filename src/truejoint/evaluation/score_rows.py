"""Rows of the page's tables: text, in deg and mm, with sensible digits."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from truejoint.array_types import Mask
from truejoint.evaluation.results import (
    OFFSET,
    Evaluation,
    estimator_phrase,
    estimator_title,
    known_loads,
)
from truejoint.evaluation.verdict import flags_text, limit_phrase
from truejoint.recordings import JointCoverage
from truejoint.tables import (
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
    "held_out": "Accuracy on recordings held out when it was made",
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


@dataclass(frozen=True)
class Row:
    """A row: its name, its cells, the unit for a person, and whether it is picked out."""

    name: str
    cells: Sequence[Any]
    unit: str = ""
    chosen: bool = False


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
        yield Row(
            comparison.joint, [estimator_title(comparison.estimator), comparison.outcome, extent]
        )


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

    A table is a list of objects, such as the sessions: its title, and its header and rows of text.
    """
    facts: list[tuple[str, str]] = []
    grids: list[tuple[str, Grid]] = []
    for key, value in metadata.items():
        label = _LABELS.get(key, key.replace("_", " "))
        if isinstance(value, list | tuple) and value and all(isinstance(v, Mapping) for v in value):
            grids.append((label, _grid(value)))
        else:
            facts.append((label, _text(key, value)))
    return [(label, text) for label, text in facts if text], grids


def _grid(rows: Sequence[Mapping[str, Any]]) -> Grid:
    """Header and text of a table; columns that are empty throughout are left out."""
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = {key: [_text(key, row.get(key)) for row in rows] for key in keys}
    filled = [key for key in keys if any(cells[key])]
    header = [_LABELS.get(key, key.replace("_", " ")) for key in filled]
    return [header, *([cells[key][i] for key in filled] for i in range(len(rows)))]


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
