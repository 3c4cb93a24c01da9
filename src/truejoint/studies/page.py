"""What a study leaves: a page that needs nothing else, table, numbers, pictures and recordings."""

from __future__ import annotations

import base64
import json
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from truejoint.drawing import png
from truejoint.errors import StudyError, other_kind
from truejoint.evaluation.report.page import render_page, versions
from truejoint.recordings import write_parquet
from truejoint.studies.runner import StudyResult, write_bytes
from truejoint.studies.study import Settings, Study

MAX_RESULT_BYTES: Final = 200_000_000


def check_folder(study: Study, settings: Settings, folder: str | Path) -> None:
    """Raise StudyError where `folder` holds results of the same study with other settings."""
    path, same = Path(folder) / f"{study.name}.json", False
    with suppress(ValueError, KeyError, TypeError, RecursionError, FileNotFoundError):
        known = path.stat().st_size <= MAX_RESULT_BYTES and json.loads(path.read_bytes())
        same = known and known["settings"] == settings.to_dict()
    if path.exists() and not same:
        raise StudyError(f"{path}: is of other settings; choose another --out, or --force")


def write_study(
    result: StudyResult, folder: str | Path, *, command: str = "", overwrite: bool = False
) -> list[Path]:
    """Write page (.html), tables (.md), numbers (.json), figures (.png) and recordings (.parquet).

    Results of the same study and settings are written over. Returns the files, the page first.

    Parameters
    ----------
    result : StudyResult
    folder : str or Path
        Made if it is not there.
    command : str
        Command line that makes the study again.
    overwrite : bool
        Whether results with other settings may be written over.

    Raises
    ------
    StudyError
        If results with other settings are there and may not be written over.

    Examples
    --------
    >>> result = run_study("forceps-rezero", {"shifts_um": "20"})  # doctest: +SKIP
    >>> write_study(result, "studies/forceps-rezero")[0]  # doctest: +SKIP
    PosixPath('studies/forceps-rezero/forceps-rezero.html')
    """
    if not isinstance(result, StudyResult):
        raise StudyError(other_kind(result, "StudyResult", "give what `run_study` gives"))
    if not overwrite:
        check_folder(result.study, result.settings, folder)
    name, summary, target = result.study.name, result.summary, Path(folder)
    created = f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC"
    pictures = {key: png(figure) for key, figure in summary.figures.items()}
    page = render_page(
        "study.html.j2",
        package="truejoint.studies",
        study=result.study,
        settings=result.settings.to_dict(),
        summary=summary,
        pictures={key: base64.b64encode(data).decode("ascii") for key, data in pictures.items()},
        created=created,
        command=command,
    )
    origin = {"command": command, "created": created, "versions": dict(versions())}
    numbers = json.dumps(result.to_dict() | {"origin": origin}, indent=2, allow_nan=False)
    files = {
        target / f"{name}.html": page.encode(),
        target / f"{name}.md": "\n".join(table.markdown() for table in summary.tables).encode(),
        target / f"{name}.json": numbers.encode() + b"\n",
        **{target / f"{key}.png": data for key, data in pictures.items()},
    }
    for file, data in files.items():
        write_bytes(file, data)
    recordings = {target / f"{key}.parquet": one for key, one in summary.recordings.items()}
    for file, recording in recordings.items():
        write_parquet(recording, file, overwrite=True)
    return [*files, *recordings]
