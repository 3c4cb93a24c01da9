"""Compute the parts of a study, here or in a pool of processes, and keep each as it is done."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from truejoint.errors import StudyError, TruejointError
from truejoint.studies.catalogue import get_study
from truejoint.studies.store import part_file, read_part, write_part
from truejoint.studies.study import Part, PartResult, Settings, Study, Summary

PARTS: Final = "parts"
"""Folder, within a study's, of the parts that are done."""
_POOLS: Final = 3  # how often workers may die before it is given up


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study that was run.

    Attributes
    ----------
    study : Study
    settings : Settings
    summary : Summary
    computed : int
        Parts that were computed now.
    kept : int
        Parts that had been computed before.
    """

    study: Study
    settings: Settings
    summary: Summary
    computed: int
    kept: int

    def to_dict(self) -> dict[str, Any]:
        """Plain values: settings, claims with their verdicts, numbers."""
        claims = [{**vars(claim), "verdict": claim.verdict} for claim in self.summary.claims]
        return {
            "study": self.study.name,
            "settings": self.settings.to_dict(),
            "claims": claims,
            "numbers": dict(self.summary.numbers),
        }


def run_study(
    study: str | Study,
    options: Mapping[str, object] | None = None,
    *,
    preset: str = "full",
    seed: int = 0,
    folder: str | Path | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> StudyResult:
    """Compute what is missing of a study, and summarise it.

    Results do not depend on `jobs`, nor on what was computed before.

    Parameters
    ----------
    study : str or Study
        Name of one of `STUDIES`, or one of your own.
    options : mapping, optional
        Values, or their texts, by `Option.name`.
    preset : {"full", "small"}
    seed : int
    folder : str or Path, optional
        Where parts are kept as they are done, in ``parts/``, and taken from when the study is run
        again; nothing is kept by default.
    jobs : int
        Processes, one thread each; with 1 the parts are computed in this one. With more, a script
        must stand behind ``if __name__ == "__main__":``.
    progress : callable, optional
        Called with the fraction done of what is missing, 0 to 1.

    Raises
    ------
    StudyError
        If study, preset or option is unknown, or parts failed: the others are kept.

    Examples
    --------
    >>> result = run_study("forceps-unloaded", {"specimen": "B", "methods": "lsm,play_gated"})
    >>> print(f"{result.summary.numbers['verification']['play_gated']['rms_deg']:.3f} deg")
    0.035 deg
    """
    chosen = get_study(study) if isinstance(study, str) else study
    settings = chosen.settings(preset, seed, options)
    if jobs < 1:
        raise StudyError(f"{jobs} jobs; give 1 or more")
    if folder is None:
        with TemporaryDirectory() as temporary:
            return _run(chosen, settings, Path(temporary), jobs, progress)
    return _run(chosen, settings, Path(folder) / PARTS, jobs, progress)


def _run(
    study: Study,
    settings: Settings,
    folder: Path,
    jobs: int,
    progress: Callable[[float], None] | None,
) -> StudyResult:
    parts = study.parts(settings)
    files = {part.key: part_file(folder, study, part) for part in parts}
    missing = [part for part in parts if read_part(files[part.key]) is None]
    failed: dict[str, TruejointError] = {}
    for count, (part, result) in enumerate(_computed(missing, jobs), 1):
        if isinstance(result, TruejointError):
            failed[part.key] = result
        else:
            write_part(files[part.key], result)
        if progress is not None:
            progress(count / len(missing))
    if failed:
        key, error = next(iter(failed.items()))
        others = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
        raise StudyError(f"{study.name}: part {key} failed{others}: {error}")
    # What was computed now is read back too, so that no result depends on when it was computed.
    results = {key: read_part(file) for key, file in files.items()}
    lost = [key for key, result in results.items() if result is None]
    if lost:
        raise StudyError(f"{study.name}: part {lost[0]} cannot be read back from {folder}")
    return StudyResult(
        study,
        settings,
        study.summarise(settings, {k: r for k, r in results.items() if r is not None}),
        len(missing),
        len(parts) - len(missing),
    )


def _computed(
    parts: Sequence[Part], jobs: int
) -> Iterator[tuple[Part, PartResult | TruejointError]]:
    """Each part with its result, or with what is wrong with it, as it is done."""
    if min(jobs, len(parts)) <= 1:
        yield from ((part, compute(part)) for part in parts)
        return
    left = list(parts)
    for _ in range(_POOLS):
        try:
            for part, result in _pooled(left, jobs):
                left.remove(part)
                yield part, result
        except BrokenProcessPool:
            continue
        return
    raise StudyError(
        f"workers died {_POOLS} times with {len(left)} parts left; is memory short? Run it again "
        "with fewer --jobs: what is done is kept"
    )


def _pooled(parts: Sequence[Part], jobs: int) -> Iterator[tuple[Part, PartResult | TruejointError]]:
    pool = ProcessPoolExecutor(
        min(jobs, len(parts)), mp_context=get_context("spawn"), initializer=_die_on_interrupt
    )
    with pool:
        futures = {pool.submit(compute, part): part for part in parts}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BaseException:  # Ctrl-C among them: what has not begun shall not
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def compute(part: Part) -> PartResult | TruejointError:
    """Compute a part with one thread, wherever it is; an error of the caller's is returned."""
    try:
        with threadpool_limits(1):
            return part.compute(**part.arguments)
    except TruejointError as error:
        return error


def _die_on_interrupt() -> None:
    """Let Ctrl-C end a worker without a word: the parent says what is to be said."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
