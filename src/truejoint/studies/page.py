"""What a study leaves: page, tables, numbers, pictures; one page over all studies."""

from __future__ import annotations

import base64
import json
from collections import Counter
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from truejoint.drawing import png
from truejoint.errors import StudyError, other_kind
from truejoint.evaluation.report.page import render_page, versions
from truejoint.studies.runner import StudyResult, write_bytes
from truejoint.studies.study import STUDIES, VERDICTS, Settings, Study

OVERVIEW: Final = "index.html"
_MAX_BYTES: Final = 200_000_000  # of results that are read
_CLAIM: Final = ("verdict", "text", "source", "on", "found", "look")


def check_folder(study: Study, settings: Settings, folder: str | Path) -> None:
    """Raise StudyError where `folder` holds results of the same study with other settings."""
    path = Path(folder) / f"{study.name}.json"
    if path.exists() and _read(path).get("settings") != settings.to_dict():
        raise StudyError(f"{path}: is of other settings; choose another --out, or --force")


def _read(path: Path) -> dict[str, Any]:
    """Results in a file; empty where there are none, or they are damaged."""
    with suppress(OSError, ValueError, RecursionError):
        if path.stat().st_size <= _MAX_BYTES:
            result = json.loads(path.read_bytes())
            return result if isinstance(result, dict) else {}
    return {}


def write_study(
    result: StudyResult, folder: str | Path, *, command: str = "", overwrite: bool = False
) -> list[Path]:
    """Write page (.html), tables (.md), numbers (.json) and figures (.png).

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
    >>> result = run_study("forceps-load", {"masses_g": "100"})  # doctest: +SKIP
    >>> write_study(result, "studies/forceps-load")[0]  # doctest: +SKIP
    PosixPath('studies/forceps-load/forceps-load.html')
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
    return list(files)


def write_overview(folder: str | Path, *, command: str = "") -> Path:
    """Write the page over all results in a folder, one folder a study; returns its path.

    Every claim of the papers with its verdict and number, and which studies are not there yet.
    Raises RecordingError or OSError where it cannot be written.

    Examples
    --------
    >>> write_overview("studies")  # doctest: +SKIP
    PosixPath('studies/index.html')
    """
    results, counts, unusual, better = {}, {}, {}, {}
    for name, study in STUDIES.items():
        result = _read(Path(folder) / name / f"{name}.json")
        with suppress(KeyError, TypeError, AttributeError, StudyError):  # as if it were not there
            settings, claims = result["settings"], result["claims"]
            usual = study.settings(settings["preset"], settings["seed"]).to_dict()["options"]
            options = settings["options"].items()
            unusual[name] = [f"{key} {value}" for key, value in options if usual.get(key) != value]
            shown = [tuple(claim[key] for key in _CLAIM) for claim in claims]
            counts[name] = Counter(verdict for verdict, *_ in shown)
            better[name] = sum(own[0] == VERDICTS[2] and own[-1] != "fail" for own in shown)
            results[name] = result
    page = render_page(
        "overview.html.j2",
        package="truejoint.studies",
        studies=STUDIES,
        results=results,
        counts=counts,
        unusual=unusual,
        better=better,
        verdicts=VERDICTS,
        total=sum(counts.values(), Counter()),
        created=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        command=command,
    )
    path = Path(folder) / OVERVIEW
    write_bytes(path, page.encode())
    return path
