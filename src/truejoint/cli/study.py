"""`truejoint study`: the experiments of the papers, and ours, each by its name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.table import Table
from rich.text import Text

from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.options import Force, Json, Seed
from truejoint.errors import StudyError
from truejoint.studies.catalogue import STUDIES, get_study
from truejoint.studies.study import PRESETS, Option

INTERRUPTED = 130


def _names(incomplete: str) -> list[tuple[str, str]]:
    return [(s.name, s.title) for s in STUDIES.values() if s.name.startswith(incomplete)]


def _presets(incomplete: str) -> list[str]:
    return [preset for preset in PRESETS if preset.startswith(incomplete)]


def _options(context: typer.Context, incomplete: str) -> list[tuple[str, str]]:
    known = STUDIES.get(context.params.get("name") or "")
    options = known.options if known else ()
    return [(f"{o.name}=", o.meaning) for o in options if o.name.startswith(incomplete)]


def study(
    name: Annotated[
        str | None,
        typer.Argument(help="Which study; all are listed without one.", autocompletion=_names),
    ] = None,
    preset: Annotated[
        str, typer.Option(help="full, or small for a first look.", autocompletion=_presets)
    ] = "full",
    seed: Seed = 0,
    chosen: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="OPTION=VALUE",
            help="An option of the study, for instance specimen=B; `truejoint study` lists them.",
            autocompletion=_options,
        ),
    ] = None,
    folder: Annotated[
        Path,
        typer.Option("--out", "-o", help="Folder that gets one folder a study, parts included."),
    ] = Path("studies"),
    jobs: Annotated[
        int | None, typer.Option(help="Processes; one for each core by default.")
    ] = None,
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Make the tables and figures of an experiment, beside the paper's numbers.

    Parts are kept as they are done: the same command goes on where it was stopped.
    """
    if name is None:
        _list(as_json=as_json)
        return
    experiment = get_study(name)
    settings = experiment.settings(preset, seed, _parsed(chosen or []))
    from truejoint.studies import page, runner  # noqa: PLC0415  # a list needs no arithmetic

    target = folder / name
    if not force:
        page.check_folder(experiment, settings, target)
    target.mkdir(parents=True, exist_ok=True)
    try:
        with progress(f"Study {name}") as done:
            result = runner.run_study(
                experiment,
                settings.options,
                preset=preset,
                seed=seed,
                folder=target,
                jobs=jobs or len(os.sched_getaffinity(0)),
                progress=done,
            )
    except KeyboardInterrupt:
        say(f"Stopped; what is done is kept in {target}, and the same command goes on from there")
        raise typer.Exit(INTERRUPTED) from None
    files = page.write_study(result, target, command=command_line(), overwrite=force)
    if as_json:
        result_json(result.to_dict())
    else:
        for table in result.summary.tables:
            out.print(table.rich())
        for claim in result.summary.claims:
            out.print(
                f"{claim.verdict}: {claim.text} ({claim.found})", highlight=False, markup=False
            )
    say(f"{result.computed} parts computed, {result.kept} kept from before")
    say(f"Written: {', '.join(str(path) for path in files)}")


def _parsed(texts: list[str]) -> dict[str, str]:
    options = {}
    for text in texts:
        option, separator, value = text.partition("=")
        if not separator:
            raise StudyError(f"--set {text!r:.60}: write OPTION=VALUE")
        options[option] = value
    return options


def _list(*, as_json: bool) -> None:
    options = {
        s.name: {o.name: Option.shown(o.default) for o in s.options} for s in STUDIES.values()
    }
    if as_json:
        result_json(
            {
                s.name: {"title": s.title, "source": s.source, "options": options[s.name]}
                for s in STUDIES.values()
            }
        )
        return
    table = Table(box=box.SIMPLE_HEAD)
    for column in ("study", "what it asks", "source", "options, --set NAME=VALUE"):
        table.add_column(column, overflow="fold")
    for s in STUDIES.values():
        shown = "\n".join(f"{name}={value}" for name, value in options[s.name].items())
        table.add_row(*(Text(cell) for cell in (s.name, s.title, s.source or "ours", shown)))
    out.print(table)
