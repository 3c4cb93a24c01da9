"""One page over all studies in a folder: what each claim of the papers came to."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from truejoint.errors import StudyError
from truejoint.evaluation.report.page import render_page
from truejoint.studies.catalogue import STUDIES
from truejoint.studies.page import MAX_RESULT_BYTES
from truejoint.studies.runner import write_bytes

NAME: Final = "index.html"
VERDICTS: Final = ("agrees", "does not agree", "cannot be told")
_SHOWN: Final = ("text", "source", "on", "found")  # of a claim, beside its verdict


def found_results(folder: str | Path) -> dict[str, dict[str, Any]]:
    """Results by study, in the order of the catalogue, of those that `write_study` left there."""
    found = {}
    for name in STUDIES:
        path = Path(folder) / name / f"{name}.json"
        with suppress(OSError, ValueError, RecursionError):
            if path.stat().st_size <= MAX_RESULT_BYTES:
                result = json.loads(path.read_bytes())
                if _is_shown(result):
                    found[name] = result
    return found


def _is_shown(result: Any) -> bool:
    """Whether a result has all that the page shows of one."""
    with suppress(KeyError, TypeError, AttributeError):
        settings, claims = result["settings"], result["claims"]
        settings["options"].items()
        shown = all({"verdict", *_SHOWN} <= set(claim) for claim in claims)
        return shown and {"preset", "seed"} <= set(settings)
    return False


def _unusual(name: str, settings: Mapping[str, Any]) -> list[str]:
    """Options of a result that are not those of its preset."""
    with suppress(StudyError, TypeError):
        usual = STUDIES[name].settings(settings["preset"], settings["seed"]).to_dict()["options"]
        own = settings["options"].items()
        return [f"{option} {value}" for option, value in own if usual.get(option) != value]
    return []


def write_overview(folder: str | Path, *, command: str = "") -> Path:
    """Write the page over all results in a folder, one folder a study; returns its path.

    Every claim of the papers with its verdict and number, and which studies are not there yet.
    Raises RecordingError or OSError where it cannot be written.

    Examples
    --------
    >>> write_overview("studies")  # doctest: +SKIP
    PosixPath('studies/index.html')
    """
    results = found_results(folder)
    counts = {
        name: Counter(claim["verdict"] for claim in result["claims"])
        for name, result in results.items()
    }
    page = render_page(
        "overview.html.j2",
        package="truejoint.studies",
        studies=STUDIES,
        results=results,
        counts=counts,
        unusual={name: _unusual(name, one["settings"]) for name, one in results.items()},
        verdicts=VERDICTS,
        total=sum(counts.values(), Counter()),
        created=f"{datetime.now(UTC):%Y-%m-%d %H:%M} UTC",
        command=command,
    )
    path = Path(folder) / NAME
    write_bytes(path, page.encode())
    return path
