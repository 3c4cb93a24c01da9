"""`truejoint datasets`: public recordings of real joints."""

from __future__ import annotations

from contextlib import suppress
from typing import Annotated

import typer

import truejoint
from truejoint.cli.console import out, print_facts, progress, result_json
from truejoint.cli.options import DatasetName, Json
from truejoint.errors import RecordingError

app = typer.Typer(help="List, describe and fetch public recordings of real joints.")


@app.callback(invoke_without_command=True)
def listing(context: typer.Context, as_json: Json = False) -> None:
    """List the public data sets, and whether they are on this machine."""
    if context.invoked_subcommand is not None:
        return
    known = truejoint.recordings.datasets.DATASETS.values()
    if as_json:
        result_json({"datasets": [_facts(dataset) for dataset in known]})
        return
    from rich.table import Table  # noqa: PLC0415  # as in console

    table = Table("name", "what", "MB", "licence", "here")
    for dataset in known:
        size, licence = f"{dataset.size / 1e6:.1f}", dataset.licence or "none stated"
        here = "yes" if _here(dataset) else "no"
        table.add_row(dataset.name, dataset.title, size, licence, here)
    out.print(table)


@app.command("show", epilog="Example: `truejoint datasets show davinci_grasper_umn`")
def show(name: DatasetName, as_json: Json = False) -> None:
    """Describe a data set: where it comes from, how to cite it, how to judge on it."""
    dataset = truejoint.recordings.datasets.get_dataset(name)
    facts = _facts(dataset)
    if as_json:
        result_json(facts)
        return
    texts = {
        key: "\n".join(map(str, value)) if isinstance(value, list) else str(value)
        for key, value in facts.items()
    }
    print_facts(dataset.title, texts.items())


@app.command("fetch", epilog="Example: `truejoint datasets fetch davinci_grasper_umn`")
def get(
    name: DatasetName,
    pattern: Annotated[str, typer.Option(help="Only recordings whose name fits.")] = "*",
    as_json: Json = False,
) -> None:
    """Fetch a data set from its upstream repository, checking every file's hash."""
    dataset = truejoint.recordings.datasets.get_dataset(name)
    with progress(f"Fetching {name} from {dataset.repository}") as done:
        folder = truejoint.recordings.datasets.fetch(name, pattern, progress=done)
    if as_json:
        result_json({"name": name, "folder": str(folder)})
    else:
        out.print(f"{name} is in {folder}")


def _here(dataset: truejoint.recordings.datasets.Dataset) -> bool:
    with suppress(RecordingError):
        return bool(truejoint.recordings.datasets.locate(dataset.name))
    return False


def _facts(dataset: truejoint.recordings.datasets.Dataset) -> dict[str, object]:
    return {
        "name": dataset.name,
        "robot": dataset.robot,
        "upstream": f"{dataset.repository} @ {dataset.commit}",
        "licence": dataset.licence or "none stated: evaluate it, do not pass it on",
        "notice": dataset.notice,
        "citation": dataset.citation,
        "here": _here(dataset),
        "recordings": [recording.name for recording in dataset.recordings],
        "features": list(dataset.features),
        "splits": [split.name for split in dataset.splits],
    }
