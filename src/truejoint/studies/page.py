"""What a study leaves: page, tables, numbers, pictures; one page over all studies."""

import json
from base64 import b64encode
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final

from truejoint._version import versions
from truejoint.drawing import png
from truejoint.errors import StudyError, other_kind
from truejoint.evaluation.report.page import now_text, render_page
from truejoint.studies.claim_tests import RULE
from truejoint.studies.runner import StudyResult, software, write_bytes
from truejoint.studies.study import CLAIMS, STUDIES, VERDICTS, Settings, Study
from truejoint.tables import Table

OVERVIEW: Final = "index.html"
_MAX_BYTES: Final = 200_000_000  # of results that are read
CLAIMS_PAGE: Final = "claims.md"
_CLAIM: Final = ("verdict", "text", "source", "on", "found", "number", "test", "look")


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
    created = now_text()
    pictures = {key: png(figure) for key, figure in summary.figures.items()}
    page = render_page(
        "study.html.j2",
        package="truejoint.studies",
        study=result.study,
        settings=result.settings.to_dict(),
        summary=summary,
        pictures={key: b64encode(data).decode() for key, data in pictures.items()},
        created=created,
        command=command,
    )
    origin = {"command": command, "created": created, "versions": dict(versions())}
    origin["source"] = software().rpartition(", ")[2]
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

    Every claim of the papers with its verdict and number, tables and figures of each study, and
    which studies are not there yet. The claims alone, in their order, are ``claims.md`` beside it.
    Raises RecordingError or OSError where it cannot be written.

    Examples
    --------
    >>> write_overview("studies")  # doctest: +SKIP
    PosixPath('studies/index.html')
    """
    results = {}
    for name, study in STUDIES.items():
        result = _read(Path(folder) / name / f"{name}.json")
        with suppress(KeyError, TypeError, AttributeError, StudyError):  # as if it were not there
            settings, claims = result["settings"], result["claims"]
            usual = study.settings(settings["preset"], settings["seed"]).to_dict()["options"]
            options = settings["options"].items()
            shown = [tuple(claim[key] for key in _CLAIM) for claim in claims]
            drawn = sorted((Path(folder) / name).glob("*.png"))
            results[name] = {
                "tables": [],
                **result,
                "origin": {"created": "", "source": "", "versions": {}, **result["origin"]},
                "unusual": [f"{key} {value}" for key, value in options if usual.get(key) != value],
                "counts": Counter(verdict for verdict, *_ in shown),
                "better": sum(own[0] == VERDICTS[2] and own[-1] != "fail" for own in shown),
                "pictures": [b64encode(file.read_bytes()).decode() for file in drawn],
            }
    page = render_page(
        "overview.html.j2",
        package="truejoint.studies",
        studies=STUDIES,
        results=results,
        verdicts=VERDICTS,
        created=now_text(),
        command=command,
    )
    path = Path(folder) / OVERVIEW
    write_bytes(path, page.encode())
    write_bytes(path.with_name(CLAIMS_PAGE), _claims_page(results, command).encode())
    return path


def _claims_page(results: Mapping[str, Any], command: str) -> str:
    """Every claim of the papers by its number, as Markdown, with what each study found."""
    judged: dict[str, list[list[str]]] = {}
    for name, result in results.items():
        for claim in result["claims"]:
            where = f"`{name}`" + (f", {claim['on']}" if claim["on"] else "")
            row = [where, claim["verdict"], claim["found"], claim["test"]]
            judged.setdefault(claim["number"], []).append(row)
    rows = [
        (stated.number, stated.text, stated.source, *row)
        for stated in CLAIMS.values()
        for row in judged.get(stated.number, [[f"`{stated.study}`", "not run", "", ""]])
    ]
    made = [
        f"`{name}`: preset {result['settings']['preset']}, seed {result['settings']['seed']}, "
        f"{result['origin']['created']}, {result['origin']['source']}"
        for name, result in results.items()
    ]
    counts = Counter(row[4] for row in rows)
    notes = ("; ".join(f"{verdict}: {count}" for verdict, count in counts.items()) + ".", *made)
    header = ("no.", "claim", "source", "judged by", "verdict", "found here", "test")
    table = Table("Claims, their verdicts and tests", header, tuple(rows), notes)
    intro = f"# Every claim of the two papers\n\nThis page is made by `{command}`.\n\n"
    return f"{intro}{RULE}\n\n{table.markdown()}"
