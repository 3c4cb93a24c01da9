"""`truejoint study`: the experiments of the papers, and ours, each by its name."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from truejoint.cli.console import command_line, out, progress, result_json, say
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
    as_json: bool = False,
) -> None:
    """Make the tables and figures of an experiment, beside the paper's numbers.

    Parts are kept as they are done: the same command goes on where it was stopped.
    """
    if name is None:
        _list(as_json=as_json)
        return
    options, studies, several = _parsed(chosen or []), _named(name), name not in STUDIES
    if several and options:
        raise StudyError(f"--set is of one study; name it in place of {name!r:.60}")
    where = _where(jobs, cluster)
    from truejoint.studies import page

    made, failed = {}, []
    for study in studies:
        try:
            settings = study.settings(preset, seed, options)
            made[study.name] = _made(study, settings, folder / study.name, where, force=force)
        except TruejointError as error:
            if not several:
                raise
            failed.append(study.name)
            say(f"{study.name}: {error}")
        else:
            page.write_overview(folder, command=command_line())
            if not as_json:
                _show(made[study.name])
    if as_json:
        plain = {key: result.to_dict() for key, result in made.items()}
        result_json(plain if several else plain[name])
    say(f"All studies on one page: {folder / page.OVERVIEW}")
    if failed:
        raise StudyError(f"not done: {', '.join(failed)}; what is wrong with each stands above")


def _named(name: str) -> list[Study]:
    """Give the study of that name, else all of them, or those whose names begin with it."""
    if name == ALL:
        return list(STUDIES.values())
    if name in STUDIES:  # which other names may begin with, too
        return [STUDIES[name]]
    family = [study for study in STUDIES.values() if study.name.startswith(f"{name}-")]
    return family if len(family) > 1 else [get_study(name)]


def _where(jobs: int | None, cluster: str | None) -> dict[str, Any]:
    if jobs is not None and cluster is not None:
        raise StudyError("--jobs is for processes on this computer; give it or --cluster")
    return {"jobs": jobs or len(os.sched_getaffinity(0)), "cluster": cluster}


def _made(
    study: Study, settings: Settings, target: Path, where: Mapping[str, Any], *, force: bool
) -> StudyResult:
    """Run a study where it is to be computed, and write what it leaves."""
    from truejoint.studies import page, runner

    check_folder(target, error=StudyError)
    if not force:
        page.check_folder(study, settings, target)
    common = {"preset": settings.preset, "seed": settings.seed, "folder": target, **where}
    try:
        with progress(f"Study {study.name}") as done:
            result = runner.run_study(study, settings.options, progress=done, **common)
    except KeyboardInterrupt:
        say(f"Stopped; what is done is kept in {target}, and the same command goes on from there")
        raise
    files = page.write_study(result, target, command=command_line(), overwrite=force)
    say(f"{study.name}: parts: {len(result.parts)}, computed now: {result.computed}")
    say(f"Written: {', '.join(str(path) for path in files)}")
    return result


def _show(result: StudyResult) -> None:
    for table in result.summary.tables:
        out.print(table.rich())
    for claim in result.summary.claims:
        on = f" ({claim.on})" if claim.on else ""
        out.print(f"{claim.verdict}: {claim.text}{on}: {claim.found}")


def _parsed(texts: list[str]) -> dict[str, str]:
    pairs = [text.partition("=") for text in texts]
    for (option, separator, _), text in zip(pairs, texts, strict=True):
        if not separator or sum(option == other[0] for other in pairs) > 1:
            raise StudyError(f"--set {text!r:.60}: write OPTION=VALUE, each option once")
    return {option: value for option, _, value in pairs}


def _list(*, as_json: bool) -> None:
    listed = {}
    for s in STUDIES.values():
        options, source = {o.name: shown(o.default) for o in s.options}, s.source or "ours"
        listed[s.name] = {"title": s.title, "source": source, "options": options}
        if not as_json:
            out.print(f"{s.name}: {s.title} ({source})", style="bold")
            for option in s.options:
                text = f"    --set {option.name}={options[option.name]}  {option.meaning}"
                out.print(text, soft_wrap=True)
    if as_json:
        result_json(listed)
