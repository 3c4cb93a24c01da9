"""Scores as tables of text, in deg and mm, for the page and the terminal."""

import math
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from pandas import DataFrame
from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint import tables
from truejoint.array_types import Mask
from truejoint.evaluation.results import (
    OFFSET,
    Evaluation,
    as_evaluation,
    each,
    estimator_phrase,
    estimator_title,
)
from truejoint.evaluation.scoring import rmse
from truejoint.evaluation.verdict import flags_text, limit_phrase
from truejoint.recordings import JointCoverage
from truejoint.toml_file import shipped_table
from truejoint.units import display_unit

_WORDS: Final = shipped_table(__package__, "words.toml")
_UNSHOWN: Final = ["conditions", "probes"]  # of a session: rows of numbers, for the program


def main_rows(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """RMSE, spread, largest error and percentage of each estimator, by joint and of the tool."""
    for name, unit, scores in as_evaluation(evaluation).shown_scores():
        decimals = tables.decimals_for(unit.scale * scores["rmse"])
        cells = [
            {
                "rmse": tables.fixed(unit.scale * score.rmse, decimals),
                "spread": tables.spread_text(unit.scale * score.spread, decimals),
                "largest": tables.fixed(unit.scale * score.max_abs, max(decimals - 1, 1)),
                "percent": tables.percent_text(score.percent_of_offset),
                "chosen": score.estimator == evaluation.chosen,
                "best": score.rmse == scores["rmse"].min(),
            }
            for score in each(scores)
        ]
        yield {"name": name, "unit": unit.name, "cells": cells}


def headlines(evaluation: Evaluation) -> Iterator[dict[str, Any]]:
    """Give the chosen model's RMSE of each joint, and of the tool, for the first screen."""
    verdicts = {verdict.joint: verdict for verdict in evaluation.verdict.joints}
    level = f"{100 * evaluation.interval_level:g} %"
    bands = {
        row["joint"]: f"± {row['half-width']} {row['unit']} stated at {level}; "
        f"{row['found inside']} found inside"
        for row in intervals(evaluation).to_dict("records")
        if row["stated"] == level
    }
    for name, unit, _ in evaluation.shown_scores():
        own, verdict = evaluation.score(evaluation.chosen, name), verdicts.get(name)
        limit = verdict.limit if verdict else evaluation.score(OFFSET, name).rmse
        value, beside = tables.shown([unit.scale * own.rmse, unit.scale * limit])
        against = limit_phrase(verdict) if verdict else f"{estimator_phrase(OFFSET)}'s"
        percent = f"{tables.percent_text(own.percent_of_offset)} of fixed offset"
        yield {
            "name": name,
            "value": value,
            "unit": unit.name,
            "percent": "" if evaluation.chosen == OFFSET else percent,
            "limit": f"{against} {beside} {unit.name}",
            "interval": bands.get(name, ""),
            "passed": verdict.passed if verdict else None,
        }


def intervals(evaluation: Evaluation) -> DataFrame:
    """Coverage and half-width of each joint and stated level."""
    rows = []
    for _, joint, unit in evaluation.shown_joints():
        scores = [s for s in each(evaluation.intervals) if s.joint == joint]
        widths = tables.shown([unit.scale * score.half_width for score in scores])
        for score, width in zip(scores, widths, strict=True):
            error = f" ± {100 * score.standard_error:.1f}" if len(score.shares) > 1 else ""
            rows.append(
                {
                    "joint": joint,
                    "within sampling error": score.agreement or tables.DASH,
                    "stated": f"{100 * score.level:g} %",
                    "found inside": f"{100 * score.coverage:.1f}{error} %",
                    "half-width": width,
                    "unit": unit.name,
                }
            )
    return DataFrame(rows)


def comparisons(evaluation: Evaluation) -> DataFrame:
    """Tell what the chosen model is beside each other, and over how many stretches, by joint."""
    found = evaluation.comparisons
    cells = found["outcome"] + found["stretches"].map(" ({})".format)
    by = cells.groupby([found["joint"], found["estimator"].map(estimator_title)], sort=False)
    return by.first().unstack(sort=False).reset_index()


def domain_line(evaluation: Evaluation) -> str:
    """Share of the test that the loop would correct, and why not the rest."""
    domain = evaluation.domain
    flags = f"; it flags {flags_text(domain)}." if domain.flags else "."
    return f"The loop would correct {tables.share_text(domain.inside)} of the rows{flags}"


def by_direction(evaluation: Evaluation) -> DataFrame:
    """Bias and RMSE before and after by joint and direction of motion."""
    rows = []
    for column, joint, _ in evaluation.shown_joints():
        moves = evaluation.known("direction")[:, column]
        for title, way in (("up", 1), ("down", -1), ("standing", 0)):
            if (at := moves == way).any():
                first = {"joint": joint, "direction": title, "rows": f"{100 * at.mean():.0f} %"}
                rows.append(first | _before_after(evaluation, column, at))
    return DataFrame(rows)


def by_load(evaluation: Evaluation) -> DataFrame:
    """Bias and RMSE before and after by hung mass; empty unless several known masses were hung."""
    loads = evaluation.rows["load"]
    recordings = loads.groupby(level=0).first().value_counts()
    rows = [
        {"mass": f"{1e3 * mass:.0f} g", "joint": joint, "recordings": str(recordings[mass])}
        | _before_after(evaluation, column, loads.to_numpy() == mass)
        for mass in sorted(recordings.index)
        for column, joint, _ in evaluation.shown_joints()
    ]
    return DataFrame(rows if len(recordings) > 1 else [])


def _before_after(evaluation: Evaluation, column: int, rows: Mask) -> dict[str, str]:
    """Mean error and RMSE of the fixed offset and of the chosen model in some rows, by title."""
    _, joint, unit = evaluation.shown_joints()[column]
    numbers: dict[str, float] = {}
    for title, name in (("offset", OFFSET), ("after", evaluation.chosen)):
        error = unit.scale * evaluation.error(name, joint)[rows]
        numbers |= {f"{title}: mean": error.mean(), f"{title}: RMSE": rmse(error).item()}
    decimals = tables.decimals_for([value for title, value in numbers.items() if "RMSE" in title])
    return {title: tables.fixed(v, decimals) for title, v in numbers.items()} | {"unit": unit.name}


def worst_first(evaluation: Evaluation) -> list[str]:
    """Name the recordings of the test by RMSE as a multiple of the limit, the worst first."""
    scores = evaluation.recording_scores
    own = scores[scores["estimator"] == evaluation.chosen]
    limit = own["joint"].map({joint.joint: joint.limit for joint in evaluation.verdict.joints})
    ratio = (own["rmse"] / limit.where(limit > 0, np.inf)).groupby(own["recording"], sort=False)
    return ratio.max().sort_values(ascending=False, kind="stable").index.tolist()


def recordings(evaluation: Evaluation) -> DataFrame:
    """One row a test recording, worst first: provenance and RMSE before and after, by joint."""
    scores = evaluation.recording_scores.set_index("recording")
    t, table = evaluation.rows["t"].groupby(level=0), DataFrame(evaluation.test).set_index("name")
    table = table[["session", "homing_id", "load", "rows"]].rename(columns={"homing_id": "homing"})
    table["load"] = [
        "" if kg is None else f"{1e3 * kg:.0f} g" for kg in table["load"].replace({np.nan: None})
    ]
    table["rows"] = table["rows"].map("{:,}".format)
    table["duration"] = (t.max() - t.min()).map(duration)
    for _, joint, unit in evaluation.shown_joints():
        own = scores[scores["joint"] == joint]
        before, after = (own[own["estimator"] == key] for key in (OFFSET, evaluation.chosen))
        decimals = min(tables.decimals_for(unit.scale * after["rmse"]), 3)
        text = partial(tables.fixed, decimals=decimals)
        pair = [(unit.scale * one["rmse"]).map(text) for one in (before, after)]
        table[f"{joint} [{unit.name}]"] = pair[0] + " → " + pair[1]
        table[f"{joint}: max"] = (unit.scale * after["max_abs"]).map(text)
    table = table.loc[worst_first(evaluation), (table != "").any()]
    return table.rename_axis("recording").reset_index()


def coverage(joints: Sequence[JointCoverage]) -> DataFrame:
    """Coverage of each joint as text: range, travel, filled, directions, speed, effort, truth."""
    rows = []
    for row in joints:
        unit, effort = display_unit(row.unit), display_unit(row.effort_unit)
        low, high = tables.shown([unit.scale * row.lowest, unit.scale * row.highest], most=2)
        speed = tables.shown([unit.scale * row.speed_median, unit.scale * row.speed_high])
        force = tables.shown([effort.scale * row.effort_low, effort.scale * row.effort_high])
        effort_text = f"{force[0]} to {force[1]} {effort.name}".removesuffix(" 1")
        rows.append(
            {
                "joint": row.joint,
                "range": f"{low} to {high} {unit.name}",
                "of travel": tables.percent_text(100 * row.share_of_limits),
                "filled": tables.percent_text(100 * row.filled),
                "up / down / still %": " / ".join(
                    f"{100 * share:.0f}" for share in (row.up, row.down, row.standing)
                ),
                "speed": f"{speed[0]} / {speed[1]} {unit.name}/s",
                "effort": effort_text if math.isfinite(row.effort_low) else tables.DASH,
                "no truth": tables.percent_text(100 * row.truth_missing),
                "rows": f"{row.rows:,}",
                "duration": duration(row.duration),
            }
        )
    return DataFrame(rows)


def duration(seconds: float) -> str:
    """Length of time for a person, such as ``"20 min 4 s"``."""
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min"


def origin(
    metadata: Mapping[str, Any],
) -> tuple[list[tuple[str, str]], list[tuple[str, DataFrame]]]:
    """Tell what a model says of its training: facts by label, and what are tables, by title.

    A table is a list of objects, such as the sessions, without columns that are empty throughout.
    """
    facts: list[tuple[str, str]] = []
    framed: list[tuple[str, DataFrame]] = []
    choice = metadata.get("choice") or {}
    for key, value in {**metadata, "choice": "", **choice}.items():
        if isinstance(value, list | tuple) and value and all(isinstance(v, Mapping) for v in value):
            rows = [{name: _text(name, cell) for name, cell in row.items()} for row in value]
            table = DataFrame(rows).fillna("").drop(columns=_UNSHOWN, errors="ignore")
            framed.append((_label(key), table.loc[:, (table != "").any()].rename(columns=_label)))
        elif text := _text(key, value):
            facts.append((_label(key), text))
    return facts, framed


def _label(key: str) -> str:
    return str(_WORDS["labels"].get(key, key.replace("_", " ")))


def _text(key: str, value: Any) -> str:
    """One JSON value for a person; long lists are cut short and say so."""
    if isinstance(value, Mapping):
        return ", ".join(f"{name} {_text(name, item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        more = f", and {len(value) - 6} more" if len(value) > 6 else ""
        return ", ".join(_text("", item) for item in value[:6]) + more
    if isinstance(value, bool | None):
        return {None: "", True: "yes", False: "no"}[value]
    if isinstance(value, int | float):
        plain = f"{value:,}" if isinstance(value, int) else f"{value:.6g}"
        return duration(float(value)) if key == "duration" else plain
    return str(value)


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
        for cell in row["cells"]:
            text = Text(cell["rmse"], style="bold" if cell["best"] else "")
            percent = f"{cell['percent']:>6}" if cell["chosen"] else ""
            for small in filter(None, (cell["spread"], percent)):
                text.append(f" {small}", style="not bold dim")
            cells.append(text)
        table.add_row(Text(f"{row['name'].removesuffix(' position')} [{row['unit']}]"), *cells)
    return table


def domain_table(evaluation: Evaluation) -> rich_table.Table:
    """RMSE inside and outside the trained domain; without a row where all lies inside.

    Examples
    --------
    >>> domain_table(evaluation).row_count
    0
    """
    rows: list[tuple[str, ...]] = []
    for name, unit, scores in evaluation.shown_scores():
        if scores["rmse_outside"].notna().any():
            text = partial(tables.fixed, decimals=tables.decimals_for(unit.scale * scores["rmse"]))
            for score in each(scores):
                both = (text(unit.scale * v) for v in (score.rmse_inside, score.rmse_outside))
                rows.append((f"{name} [{unit.name}]", estimator_title(score.estimator), *both))
    header = ("joint", "estimator", "inside", "outside")
    return tables.Table("RMSE inside and outside the trained domain", header, tuple(rows)).rich()


def interval_table(evaluation: Evaluation) -> rich_table.Table:
    """Stated levels by joint: share of the test inside, and half-widths.

    Examples
    --------
    >>> interval_table(evaluation).row_count
    2
    """
    count = len(evaluation.interval_trajectories)
    title = f"Stated interval, on {count} test {'trajectories' if count != 1 else 'trajectory'}"
    table = intervals(evaluation)
    if not table.empty:
        table["joint"] += " [" + table.pop("unit") + "]"
    rows = tuple(map(tuple, table.to_numpy().tolist()))
    return tables.Table(title, tuple(map(str, table)), rows).rich()
