"""A table for each joint and the tool, as CSV and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pandas as pd

from truejoint.errors import RecordingError
from truejoint.evaluation.results import Evaluation, as_evaluation, estimator_title
from truejoint.files import check_target, write_atomically
from truejoint.tables import decimals_for

_COLUMNS: Final = {
    "RMSE": "rmse", "spread": "spread", "largest": "max_abs", "mean": "mean",
    "RMSE inside": "rmse_inside", "RMSE outside": "rmse_outside",
    "RMSE x": "x", "RMSE y": "y", "RMSE z": "z",
}  # fmt: skip
"""Attributes of scores by column; a column without a number is left out."""


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
