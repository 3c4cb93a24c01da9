"""`truejoint datasets`: list and fetch public recordings of real joints."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING, Any

import typer

from truejoint.cli.console import out, progress
from truejoint.cli.options import Result
from truejoint.errors import RecordingError

if TYPE_CHECKING:
    from truejoint.recordings import datasets as sets


def datasets(context: typer.Context) -> Result | None:
    """List public recordings of real joints, and whether they are on this machine.

    `truejoint show NAME` describes one; `truejoint datasets fetch NAME` fetches it.
    """
    from rich.table import Table

    from truejoint.recordings import datasets as sets

    if context.invoked_subcommand is not None:
        return None
    table = Table("name", "what", "MB", "licence", "here")
    for dataset in sets.DATASETS.values():
        size, licence = f"{dataset.size / 1e6:.1f}", dataset.licence or "none stated"
        here = "yes" if _is_here(dataset) else "no"
        table.add_row(dataset.name, dataset.title, size, licence, here)
    out.print(table)
    return Result({"datasets": [dataset_facts(dataset) for dataset in sets.DATASETS.values()]})


def fetch(name: str, pattern: str = "*") -> Result:
    """Fetch a data set from its upstream repository and check the hash of every file."""
    from truejoint.recordings import datasets as sets

    dataset = sets.get_dataset(name)
    with progress(f"Fetching {name} from {dataset.repository}") as done:
        folder = sets.fetch(name, pattern, progress=done)
    out.print(f"{name} is in {folder}")
    return Result({"name": name, "folder": str(folder)})


def dataset_facts(dataset: sets.Dataset) -> dict[str, Any]:
    """Describe a data set: its source, how to cite it, how to judge on it."""
    return {
        "name": dataset.name,
        "robot": dataset.robot,
        "upstream": f"{dataset.repository} @ {dataset.commit}",
        "licence": dataset.licence or "none stated: evaluate it, do not pass it on",
        "notice": dataset.notice,
        "citation": dataset.citation,
        "here": _is_here(dataset),
        "recordings": [recording.name for recording in dataset.recordings],
        "features": list(dataset.features),
        "splits": [split.name for split in dataset.splits],
    }


def _is_here(dataset: sets.Dataset) -> bool:
    from truejoint.recordings import datasets as sets

    with suppress(RecordingError):
        return bool(sets.locate(dataset.name))
    return False
