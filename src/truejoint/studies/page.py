"""What a study leaves: a page that needs nothing else, table, numbers, pictures and recordings."""

from __future__ import annotations

import base64
import json
from datetime import UTC, datetime
from pathlib import Path

from truejoint.errors import StudyError
from truejoint.evaluation.report.page import render_page, versions
from truejoint.recordings import write_parquet
from truejoint.studies.figures import png
from truejoint.studies.runner import StudyResult
from truejoint.studies.store import write_bytes
from truejoint.studies.study import Settings, Study

MAX_RESULT_BYTES = 200_000_000


def check_folder(study: Study, settings: Settings, folder: str | Path) -> None:
    """Raise StudyError where `folder` holds results of the same study with other settings."""
    path = Path(folder) / f"{study.name}.json"
    if not path.exists():
        return
    try:
        known = path.stat().st_size <= MAX_RESULT_BYTES and json.loads(path.read_bytes())
        same = known and known["settings"] == settings.to_dict()
    except (ValueError, KeyError, TypeError):
        same = False
    if not same:
        raise StudyError(f"{path}: is of other settings; choose another --out, or --force")


def write_study(
    result: StudyResult, folder: str | Path, *, command: str = "", overwrite: bool = False
) -> list[Path]:
    """Write page (.html), tables (.md), numbers (.json), figures (.png) and recordings (.parquet).

    Results of the same study and settings are written over.

    Parameters
    ----------
    result : StudyResult
    folder : str or Path
        Made if it is not there.
    command : str
        Command line that makes the study again.
    overwrite : bool
        Whether results with other settings may be written over.

    Returns
    -------
    list of Path
        Files, the page first.

    Raises
    ------
    StudyError
        If results with other settings are there and may not be written over.
    """
    if not overwrite:
        check_folder(result.study, result.settings, folder)
    name, summary, made = result.study.name, result.summary, datetime.now(UTC)
    pictures = {key: png(figure) for key, figure in summary.figures.items()}
    origin = {"command": command, "created": made.isoformat(timespec="seconds")}
    values = result.to_dict() | {"origin": origin | {"versions": dict(versions())}}
    texts = {
        f"{name}.html": _rendered(result, pictures, f"{made:%Y-%m-%d %H:%M} UTC", command),
        f"{name}.md": "\n".join(table.markdown() for table in summary.tables),
        f"{name}.json": json.dumps(values, indent=2, allow_nan=False) + "\n",
    }
    contents = {file: text.encode() for file, text in texts.items()}
    contents |= {f"{key}.png": data for key, data in pictures.items()}
    for file, data in contents.items():
        write_bytes(Path(folder) / file, data)
    for key, recording in summary.recordings.items():
        write_parquet(recording, Path(folder) / f"{key}.parquet", overwrite=True)
    return [
        Path(folder) / file for file in (*contents, *(f"{k}.parquet" for k in summary.recordings))
    ]


def _rendered(result: StudyResult, pictures: dict[str, bytes], created: str, command: str) -> str:
    return render_page(
        "study.html.j2",
        package="truejoint.studies",
        study=result.study,
        settings=result.settings.to_dict(),
        summary=result.summary,
        pictures={key: base64.b64encode(data).decode("ascii") for key, data in pictures.items()},
        created=created,
        command=command,
    )
