"""Scores as tables: on the page and in the terminal, and of each joint as CSV and LaTeX."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final

import pandas as pd
from rich import box
from rich import table as rich_table
from rich.text import Text

from truejoint.errors import RecordingError
from truejoint.evaluation.results import Evaluation, as_evaluation, estimator_title
from truejoint.evaluation.score_rows import interval_rows, main_rows
from truejoint.files import check_target, write_atomically
from truejoint.tables import DASH, Table, decimals_for, fixed

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
        return self.data.to_csv(index=False, lineterminator="\n")

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
        text, pair = (
            table.texts(),
            [f"RMSE {side} [{table.unit}]" for side in ("inside", "outside")],
        )
        if pair[1] in text:
            joint = f"{table.name} [{table.unit}]"
            rows += [
                (joint, *cells)
                for cells in text.reindex(columns=["estimator", *pair], fill_value=DASH).to_numpy()
            ]
    header = ("joint", "estimator", "inside", "outside")
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
    rows = [
        (
            f"{row['joint']} [{row['unit']}]",
            row["level"],
            row["coverage"],
            *row["widths"],
            row["agreement"],
        )
        for row in interval_rows(evaluation)
    ]
    return Table(title, header, tuple(rows)).rich()
