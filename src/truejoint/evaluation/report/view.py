"""Rows of the page's tables: numbers as text, in deg and mm, with sensible digits."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

import numpy as np

from truejoint.evaluation.coverage import JointCoverage
from truejoint.evaluation.digits import decimals_for, fixed, percent_text, shown, spread_text
from truejoint.evaluation.results import (
    OFFSET,
    RAW,
    Evaluation,
    estimator_title,
    hung_masses,
)
from truejoint.evaluation.tables import coverage_text, half_width_texts
from truejoint.units import DisplayUnit, display_unit


@dataclass(frozen=True)
class Cell:
    """One cell of the main table."""

    rmse: str
    spread: str
    largest: str
    percent: str
    chosen: bool
    best: bool


@dataclass(frozen=True)
class Row:
    """One joint (or the tool) of the main table."""

    name: str
    unit: str
    cells: tuple[Cell, ...]


@dataclass(frozen=True)
class Headline:
    """One joint's number on the first screen."""

    name: str
    value: str
    unit: str
    percent: str
    limit: str
    interval: str
    passed: bool | None


def main_rows(evaluation: Evaluation) -> list[Row]:
    """Joints by estimator, then the tool's distance: RMSE, spread, largest, percent."""
    rows = []
    for joint, unit in zip(evaluation.joints, evaluation.units, strict=True):
        scores = [evaluation.score(name, joint) for name in evaluation.estimators]
        rows.append(_row(joint, display_unit(unit), scores, evaluation.chosen))
    if evaluation.cartesian:
        rows.append(
            _row("tool position", display_unit("m"), evaluation.cartesian, evaluation.chosen)
        )
    return rows


def _row(name: str, unit: DisplayUnit, scores: Sequence[Any], chosen: str) -> Row:
    values = [unit.scale * score.rmse for score in scores]
    decimals = decimals_for(values)
    best = min(values)
    cells = tuple(
        Cell(
            rmse=fixed(value, decimals),
            spread=spread_text(unit.scale * s.spread, decimals) if math.isfinite(s.spread) else "",
            largest=fixed(unit.scale * s.max_abs, max(decimals - 1, 1)),
            percent=percent_text(s.percent_of_offset),
            chosen=s.estimator == chosen,
            best=value == best,
        )
        for value, s in zip(values, scores, strict=True)
    )
    return Row(name, unit.name, cells)


def headlines(evaluation: Evaluation) -> list[Headline]:
    """Return the chosen model's RMSE of each joint, and of the tool."""
    found = []
    for verdict in evaluation.verdict.joints:
        score = evaluation.score(evaluation.chosen, verdict.joint)
        unit = display_unit(verdict.unit)
        value, limit = shown([unit.scale * verdict.rmse, unit.scale * verdict.limit])
        against = f"tolerance {limit}" if verdict.stated else f"fixed offset {limit}"
        found.append(
            Headline(
                verdict.joint,
                value,
                unit.name,
                percent_text(score.percent_of_offset),
                f"{against} {unit.name}",
                _interval_line(evaluation, verdict.joint),
                verdict.passed,
            )
        )
    for row in evaluation.cartesian:
        if row.estimator == evaluation.chosen:
            offset = next(r for r in evaluation.cartesian if r.estimator == OFFSET)
            value, limit = shown([1e3 * row.rmse, 1e3 * offset.rmse])
            found.append(
                Headline(
                    "tool position",
                    value,
                    "mm",
                    percent_text(row.percent_of_offset),
                    f"fixed offset {limit} mm",
                    "",
                    None,
                )
            )
    return found


def _interval_line(evaluation: Evaluation, joint: str) -> str:
    """Half-width of the band's level and its coverage; empty where none was judged."""
    for score in evaluation.intervals:
        if score.joint == joint and score.level == evaluation.interval_level:
            unit = display_unit(score.unit)
            (width,) = shown([unit.scale * score.half_width])
            return (
                f"± {width} {unit.name} stated at {100 * score.level:g} %; "
                f"{100 * score.coverage:.1f} % found inside"
            )
    return ""


def interval_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """One row a stated level and joint: coverage, and half-widths beside the fixed offset's."""
    rows = []
    scores = sorted(evaluation.intervals, key=lambda s: evaluation.joints.index(s.joint))
    texts = [
        pair
        for _, group in groupby(scores, key=lambda s: s.joint)
        for pair in half_width_texts(list(group))
    ]
    for score, widths in zip(scores, texts, strict=True):
        unit = display_unit(score.unit)
        ratio = score.half_width / score.offset_half_width if score.offset_half_width > 0 else 1.0
        worst = int(np.argmin(score.shares))
        rows.append(
            {
                "joint": score.joint,
                "unit": unit.name,
                "level": f"{100 * score.level:g} %",
                "coverage": coverage_text(score),
                "agreement": score.agreement or "\N{EN DASH}",
                "worst": f"{100 * score.shares[worst]:.1f} %",
                "worst_name": evaluation.interval_trajectories[worst],
                "widths": widths,
                "percent": percent_text(100 * ratio),
                "trajectories": len(score.shares),
                "band": score.level == evaluation.interval_level,
            }
        )
    return rows


def load_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """RMSE before and after by hung mass; empty unless the test has several known masses."""
    masses = hung_masses(evaluation.traces)
    rows = []
    for mass in masses:
        traces = [trace for trace in evaluation.traces if trace.provenance.get("load") == mass]
        for column, joint in enumerate(evaluation.joints):
            unit = display_unit(evaluation.units[column])
            numbers = []
            for name in (OFFSET, evaluation.chosen):
                error = unit.scale * np.concatenate(
                    [t.estimates[name][:, column] - t.truth[:, column] for t in traces]
                )
                numbers += [float(error.mean()), float(np.sqrt(np.mean(error**2)))]
            decimals = decimals_for((numbers[1], numbers[3]))
            rows.append(
                {
                    "load": f"{1e3 * mass:.0f} g",
                    "joint": joint,
                    "unit": unit.name,
                    "recordings": len(traces),
                    "values": [fixed(value, decimals) for value in numbers],
                }
            )
    return rows


def recording_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """One row a test recording, worst first: provenance and RMSE before and after, by joint."""
    scores = {(r.recording, r.estimator, r.joint): r for r in evaluation.recording_scores}
    limits = {v.joint: v.limit for v in evaluation.verdict.joints}
    digits = {
        joint: decimals_for(
            display_unit(r.unit).scale * r.rmse
            for r in evaluation.recording_scores
            if r.joint == joint and r.estimator == evaluation.chosen
        )
        for joint in evaluation.joints
    }
    rows = []
    for trace in evaluation.traces:
        cells, ratio = [], 0.0
        for joint in evaluation.joints:
            before = scores[trace.name, OFFSET, joint]
            after = scores[trace.name, evaluation.chosen, joint]
            scale = display_unit(after.unit).scale
            ratio = max(ratio, after.rmse / limits[joint] if limits[joint] > 0 else 0.0)
            values = [scale * before.rmse, scale * after.rmse, scale * after.max_abs]
            cells.append([fixed(value, min(digits[joint], 3)) for value in values])
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


def direction_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Bias and RMSE of the chosen model by joint and direction of motion."""
    rows = []
    for column, joint in enumerate(evaluation.joints):
        unit = display_unit(evaluation.units[column])
        moves = np.concatenate([t.direction[:, column] for t in evaluation.traces])
        errors = {
            name: unit.scale
            * np.concatenate(
                [t.estimates[name][:, column] - t.truth[:, column] for t in evaluation.traces]
            )
            for name in (OFFSET, evaluation.chosen)
        }
        for title, way in (("up", 1), ("down", -1), ("standing", 0)):
            mask = moves == way
            if not mask.any():
                continue
            before, after = errors[OFFSET][mask], errors[evaluation.chosen][mask]
            values = [np.sqrt(np.mean(before**2)), np.sqrt(np.mean(after**2))]
            decimals = decimals_for(values)
            rows.append(
                {
                    "joint": joint,
                    "unit": unit.name,
                    "direction": title,
                    "share": f"{100 * mask.mean():.0f} %",
                    "before": [fixed(float(before.mean()), decimals), fixed(values[0], decimals)],
                    "after": [fixed(float(after.mean()), decimals), fixed(values[1], decimals)],
                }
            )
    return rows


def cartesian_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Tool position errors [mm] by estimator: x, y, z, distance, largest, percent."""
    every = [1e3 * v for r in evaluation.cartesian if r.estimator != RAW for v in (r.x, r.y, r.z)]
    decimals = decimals_for(every)
    return [
        {
            "name": estimator_title(row.estimator),
            "chosen": row.estimator == evaluation.chosen,
            "values": [
                fixed(1e3 * value, decimals)
                for value in (row.x, row.y, row.z, row.rmse, row.max_abs)
            ],
            "percent": percent_text(row.percent_of_offset),
        }
        for row in evaluation.cartesian
    ]


def bias_rows(evaluation: Evaluation) -> list[dict[str, Any]]:
    """Every score in full: RMSE, spread, largest, bias and percent by joint and estimator."""
    rows = []
    for joint, si in zip(evaluation.joints, evaluation.units, strict=True):
        unit = display_unit(si)
        scores = [evaluation.score(name, joint) for name in evaluation.estimators]
        decimals = decimals_for(unit.scale * score.rmse for score in scores)
        for score in scores:
            numbers = (score.rmse, score.spread, score.max_abs, score.mean)
            rows.append(
                {
                    "joint": joint,
                    "unit": unit.name,
                    "name": estimator_title(score.estimator),
                    "chosen": score.estimator == evaluation.chosen,
                    "values": [fixed(unit.scale * value, decimals) for value in numbers],
                    "percent": percent_text(score.percent_of_offset),
                    "seeds": score.seeds if score.estimator != RAW else "\N{EN DASH}",
                }
            )
    return rows


def coverage_rows(coverage: Sequence[JointCoverage]) -> list[list[str]]:
    """Coverage of each joint as text: range, travel, filled, directions, speed, effort, truth."""
    rows = []
    for row in coverage:
        unit = display_unit(row.unit)
        effort = display_unit(row.effort_unit)
        low, high = shown([unit.scale * row.lowest, unit.scale * row.highest], most=2)
        speed = shown([unit.scale * row.speed_median, unit.scale * row.speed_high], most=3)
        force = shown([effort.scale * row.effort_low, effort.scale * row.effort_high], most=3)
        effort_unit = "" if effort.name == "1" else f" {effort.name}"
        rows.append(
            [
                row.joint,
                f"{low} to {high} {unit.name}",
                percent_text(100 * row.share_of_limits),
                percent_text(100 * row.filled),
                " / ".join(f"{100 * share:.0f}" for share in (row.up, row.down, row.standing)),
                f"{speed[0]} / {speed[1]} {unit.name}/s",
                f"{force[0]} to {force[1]}{effort_unit}"
                if math.isfinite(row.effort_low)
                else "\N{EN DASH}",
                percent_text(100 * row.truth_missing),
                f"{row.rows:,}",
                duration(row.duration),
            ]
        )
    return rows


def duration(seconds: float) -> str:
    """Length of time for a person, such as ``"20 min 4 s"``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def flattened(values: Mapping[str, Any], prefix: str = "") -> list[tuple[str, str]]:
    """Nested JSON values as (name, text) pairs; long lists are cut short and say so."""
    pairs: list[tuple[str, str]] = []
    for key, value in values.items():
        name = f"{prefix}{key}"
        if isinstance(value, Mapping):
            pairs += flattened(value, f"{name}.")
        elif isinstance(value, list | tuple):
            text = ", ".join(str(item) for item in value[:24])
            pairs.append(
                (name, text + (f", and {len(value) - 24} more" if len(value) > 24 else ""))
            )
        elif value is not None and value != "":
            pairs.append((name, f"{value:.6g}" if isinstance(value, float) else str(value)))
    return pairs
