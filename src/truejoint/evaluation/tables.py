"""A table for each joint and the tool, as CSV and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pandas as pd

from truejoint.errors import RecordingError
from truejoint.evaluation.results import (
    CartesianScore,
    Evaluation,
    Score,
    as_evaluation,
    estimator_title,
)
from truejoint.files import check_target, write_atomically
from truejoint.tables import decimals_for
from truejoint.units import DisplayUnit, display_unit

_OF_JOINTS: Final = {
    "RMSE": "rmse",
    "spread": "spread",
    "largest": "max_abs",
    "mean": "mean",
    "RMSE inside": "rmse_inside",
    "RMSE outside": "rmse_outside",
}
_OF_TOOL: Final = {
    "RMSE": "rmse",
    "spread": "spread",
    "largest": "max_abs",
    "RMSE x": "x",
    "RMSE y": "y",
    "RMSE z": "z",
}


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

    def csv(self) -> str:
        """All digits, one row per estimator."""
        return self.data.to_csv(index=False, lineterminator="\n")

    def latex(self) -> str:
        """Table as `booktabs` draws it, with as many decimals as the page shows."""
        text = self.data.copy()
        lengths = [name for name in text.columns if f"[{self.unit}]" in name]
        decimals = decimals_for(text[lengths[0]])
        for name in text.columns[1:]:
            digits = decimals if name in lengths else 0
            text[name] = [
                "--" if pd.isna(value) else f"{value:.{digits}f}" for value in self.data[name]
            ]
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
    for _, joint, unit in as_evaluation(evaluation).shown_joints():
        scores = [evaluation.score(name, joint) for name in evaluation.estimators]
        yield _table(evaluation, joint, unit, scores, _OF_JOINTS)
    if evaluation.cartesian:
        yield _table(evaluation, "tool position", display_unit("m"), evaluation.cartesian, _OF_TOOL)


def _table(
    evaluation: Evaluation,
    name: str,
    unit: DisplayUnit,
    scores: Sequence[Score | CartesianScore],
    lengths: Mapping[str, str],
) -> ScoreTable:
    """Lay out attributes of scores that are `lengths`, by column; those without a number go."""
    columns: dict[str, Any] = {"estimator": [estimator_title(s.estimator) for s in scores]}
    for title, attribute in lengths.items():
        columns[f"{title} [{unit.name}]"] = [unit.scale * getattr(s, attribute) for s in scores]
    columns["percent of fixed offset"] = [s.percent_of_offset for s in scores]
    columns["seeds"] = [s.seeds for s in scores]
    data = pd.DataFrame(columns).dropna(axis="columns", how="all")
    return ScoreTable(name, evaluation.title, unit.name, data)


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
