"""`truejoint study`: the experiments of the papers, and ours, each by its name."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from truejoint.cli.console import command_line, out, progress, result_json, say
from truejoint.cli.options import Result, split_pairs
from truejoint.errors import StudyError, TruejointError
from truejoint.files import check_folder
from truejoint.studies.study import STUDIES, Settings, Study, get_study, shown

if TYPE_CHECKING:
    from truejoint.studies.runner import StudyResult

ALL: Final = "all"


def study(
    name: str | None = None,
    preset: str = "full",
    seed: int = 0,
    chosen: list[str] | None = None,
    folder: Path = Path("studies"),
    jobs: int | None = None,
    cluster: str | None = None,
    force: bool = False,
) -> Result:
    """Make the tables and figures of an experiment, beside the paper's numbers.

    Finished parts are kept: the same command continues where it was stopped.
    """
    if name is None:
        return _listed()
    options = split_pairs("--set", chosen, "OPTION=VALUE")
    studies, several = _named(name), name not in STUDIES
    if several and options:
        raise StudyError(f"--set is of one study; name it in place of {name!r:.60}")
    settings = [study.settings(preset, seed, options) for study in studies]
    check_folder(folder, error=StudyError)
    where = {"jobs": jobs or len(os.sched_getaffinity(0)), "cluster": cluster}
    from truejoint.studies import page

    made, failed = {}, []
    for study, its_settings in zip(studies, settings, strict=True):
        try:
            made[study.name] = _made(study, its_settings, folder, where, force=force)
        except TruejointError as error:
            if not several:
                raise
            failed.append(study.name)
            say(f"{study.name}: {error}")
        else:
            page.write_overview(folder, command=command_line())
            _show(made[study.name])
    say(f"All studies on one page: {folder / page.OVERVIEW}")
    values = {key: result.to_dict() for key, result in made.items()}
    if failed:
        result_json(values)
        raise StudyError(f"not done: {', '.join(failed)}; what is wrong with each stands above")
    return Result(values if several else values[name])


def _named(name: str) -> list[Study]:
    """Give the study of that name, else all of them, or those whose names begin with it."""
    if name == ALL:
        return list(STUDIES.values())
    if name in STUDIES:  # which other names may begin with, too
        return [STUDIES[name]]
    family = [study for study in STUDIES.values() if study.name.startswith(f"{name}-")]
    return family if len(family) > 1 else [get_study(name)]


def _made(
    study: Study, settings: Settings, folder: Path, where: Mapping[str, Any], *, force: bool
) -> "StudyResult":
    """Run a study where it is to be computed, and write what it leaves."""
    from truejoint.studies import page, runner

    target = folder / study.name
    check_folder(target, error=StudyError)
    if not force:
        page.check_folder(study, settings, target)
    common = {"preset": settings.preset, "seed": settings.seed, "folder": folder, **where}
    try:
        with progress(f"Study {study.name}") as done:
            result = runner.run_study(study, settings.options, progress=done, **common)
    except KeyboardInterrupt:
        say(f"Stopped; what is done is kept in {folder}, and the same command goes on from there")
        raise
    files = page.write_study(result, target, command=command_line(), overwrite=force)
    aside = f" ({result.aside} of other sources left aside)" if result.aside else ""
    say(f"{study.name}: parts: {len(result.parts)}, computed now: {result.computed}{aside}")
    say(f"Written: {', '.join(str(path) for path in files)}")
    return result


def _show(result: "StudyResult") -> None:
    for table in result.summary.tables:
        out.print(table.rich())
    for claim in result.summary.claims:
        on = f" ({claim.on})" if claim.on else ""
        out.print(f"{claim.verdict}: {claim.text}{on}: {claim.found}")


def _listed() -> Result:
    listed = {}
    for study in STUDIES.values():
        options, source = {o.name: shown(o.default) for o in study.options}, study.source or "ours"
        listed[study.name] = {"title": study.title, "source": source, "options": options}
        out.print(f"{study.name}: {study.title} ({source})", style="bold")
        for option in study.options:
            text = f"    --set {option.name}={options[option.name]}  {option.meaning}"
            out.print(text, soft_wrap=True)
    return Result(listed)
