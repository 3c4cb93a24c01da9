"""Compute the parts of a study, here or in a pool of processes, and keep each as it is done.

A part on disk is a hash and NumPy's archive without pickle, named after function and arguments, so
that studies share it. It carries digests of the sources that made it, and counts for nothing once
one of them has changed.
"""

import hashlib
import io
import json
import logging
import os
import platform
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from multiprocessing import get_context, parent_process
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING, Any, Final

import numpy as np

import truejoint
from truejoint._version import versions
from truejoint.errors import StudyError, TruejointError
from truejoint.extras import require
from truejoint.files import write_atomically
from truejoint.studies.study import Part, PartResult, Results, Study, get_study
from truejoint.summary import json_values
from truejoint.threads import one_thread

if TYPE_CHECKING:
    from pandas import DataFrame

    from truejoint.studies.study import Settings, Summary

Outcome = PartResult | TruejointError

_POOLS: Final = 3  # how often workers may die before it is given up
# Of all studies that run one after the other: a process takes as long to begin as a small part.
_workers: Final = cache(lambda n: ProcessPoolExecutor(n, get_context("spawn"), _begin_worker))
_ROWS: Final = "rows"
_SOURCES: Final = "sources"
_PACKAGE: Final = Path(truejoint.__file__).parent
_HERE: Final = Path(__file__).parent
_IDLE: Final = ("truejoint.cli", "truejoint.studies.claim_tests")  # which compute nothing
_DATA: Final = (".toml", ".csv")
_DIGEST: Final = 32  # bytes of a SHA-256
_ARRAY: Final = "array/"


@dataclass(frozen=True, eq=False)
class StudyResult:
    """A study that was run: its parts by key, and the tidy `rows` of all of them.

    `computed` is the number of parts that were not stored before, `aside` that of those among them
    that were, by other sources than today's.

    Examples
    --------
    >>> result = run_study("forceps-load", {"masses_g": "100"})  # doctest: +SKIP
    >>> result.rows.groupby("case").load_rms.median()  # doctest: +SKIP
    """

    study: Study
    settings: "Settings"
    parts: Mapping[str, PartResult]
    rows: "DataFrame"
    summary: "Summary"
    computed: int
    aside: int

    def to_dict(self) -> dict[str, Any]:
        """JSON values: settings, claims and tables for a person, rows of every part in SI."""
        return {
            "study": self.study.name,
            "settings": self.settings.to_dict(),
            "claims": [
                {**vars(c), "verdict": c.verdict, "look": c.look} for c in self.summary.claims
            ],
            "tables": [vars(table) for table in self.summary.tables],
            "parts": json_values({key: part.rows for key, part in self.parts.items()}),
        }


def run_study(
    study: str | Study,
    options: Mapping[str, object] | None = None,
    *,
    preset: str = "full",
    seed: int = 0,
    folder: str | Path | None = None,
    jobs: int = 1,
    cluster: str | None = None,
    progress: Callable[[float], None] | None = None,
) -> StudyResult:
    """Compute what is missing of a study, and summarise it.

    Results depend neither on `jobs` nor on what was computed before, nor on `cluster` where its
    processors add as this one does.

    Parameters
    ----------
    study : str or Study
        Name of one of `STUDIES`, or one of your own.
    options : mapping, optional
        Values, or their texts, by `Option.name`.
    preset : {"full", "small"}
    seed : int
    folder : str or Path, optional
        Folder in which parts are kept, in ``parts/``, as they are done; nothing is kept by default.
        A study that is run again takes them if the sources are the same, and so does another study
        with the same part.
    jobs : int
        Processes, one thread each; with 1 the parts are computed in this one. With more, a script
        must stand behind ``if __name__ == "__main__":``.
    cluster : str, optional
        Address of a Dask scheduler, such as ``tcp://10.0.0.5:8786``: its workers, one thread each
        and with the same software, compute the parts in place of processes here.
    progress : callable, optional
        Called with the fraction done of what is missing, 0 to 1.

    Raises
    ------
    StudyError
        If study, preset or option is unknown, the cluster cannot be used, or parts failed: the
        others are kept.

    Examples
    --------
    >>> few = {"specimen": "B", "methods": "lsm,play_gated", "draws": 1}
    >>> result = run_study("forceps-unloaded", few)
    >>> rms = result.rows.set_index(["motion", "method"]).rms
    >>> print(f"{rms['verification', 'play_gated']:.5f} rad")
    0.00060 rad
    """
    chosen = get_study(study) if isinstance(study, str) else study
    settings = chosen.settings(preset, seed, options)
    if jobs < 1:
        raise StudyError(f"{jobs} jobs; give 1 or more")
    parts = chosen.parts(settings)
    with TemporaryDirectory() as temporary:
        place = Path(folder or temporary) / "parts"
        files = {part.key: part_file(place, part) for part in parts}
        if not len(files) == len(parts) > 0:
            raise StudyError(f"{chosen.name}: no parts, or two of one key")
        before = {part.key: read_part(files[part.key]) for part in parts}
        missing = [part for part in parts if not _is_current(before[part.key])]
        aside = sum(before[part.key] is not None for part in missing)
        failed = []
        for count, (part, result) in enumerate(_computed(missing, jobs, cluster), 1):
            if isinstance(result, TruejointError):
                failed.append((part.key, result))
            else:
                write_part(files[part.key], result)
            if progress is not None:
                progress(count / len(missing))
        for key, error in failed:
            others = f" (and {len(failed) - 1} more)" if len(failed) > 1 else ""
            raise StudyError(f"{chosen.name}: part {key} failed{others}: {error}")
        # Read back even if computed just now, so that no result depends on when it was computed.
        stored = ((key, read_part(file)) for key, file in files.items())
        results = {key: part for key, part in stored if part is not None}
    if len(results) < len(parts):
        raise StudyError(f"{chosen.name}: a part cannot be read back")
    every = Results.of(settings, parts, results)
    summary, counts = chosen.summarise(every), (len(missing), aside)
    return StudyResult(chosen, settings, results, every.rows, summary, *counts)


def _computed(
    parts: Sequence[Part], jobs: int, cluster: str | None
) -> Iterator[tuple[Part, Outcome]]:
    """Each part with its result, or with what is wrong with it, as it is done."""
    if cluster is not None:
        yield from on_cluster(compute, parts, cluster) if parts else ()
        return
    if min(jobs, len(parts)) <= 1:
        yield from ((part, compute(part)) for part in parts)
        return
    remaining = {part.key: part for part in parts}
    for _ in range(_POOLS):
        with suppress(BrokenProcessPool):
            for part, result in _pooled([*remaining.values()], jobs):
                del remaining[part.key]
                yield part, result
            return
    raise StudyError(
        f"workers died {_POOLS} times with {len(remaining)} parts left; is memory short? Run it "
        "again with fewer --jobs: what is done is kept"
    )


def _pooled(parts: Sequence[Part], jobs: int) -> Iterator[tuple[Part, Outcome]]:
    pool = _workers(jobs)
    try:
        futures = {pool.submit(compute, part): part for part in parts}
        for future in as_completed(futures):
            yield futures[future], future.result()
    except BaseException:  # after Ctrl-C, what has not begun shall not; the dead do nothing more
        pool.shutdown(wait=False, cancel_futures=True)
        _workers.cache_clear()
        raise


def _begin_worker() -> None:
    """End without a word where Ctrl-C comes, which the parent says, or the parent was killed."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)

    def follow() -> None:
        if parent := parent_process():
            parent.join()
            os._exit(1)

    Thread(target=follow, daemon=True).start()


def compute(part: Part) -> Outcome:
    """Compute a part with one thread, wherever it is; an error of the caller's is an outcome."""
    try:
        with one_thread():
            result = part.compute(**part.arguments)
    except TruejointError as error:
        return error
    result = result if isinstance(result, PartResult) else PartResult(result)
    return replace(result, sources=_sources(part.compute.__module__))


def _sources(module: str) -> dict[str, str]:
    """Digests of a module, of every file of truejoint that this process runs, and of their data.

    Modules are imported when they are needed, so those that are there are those that made a result,
    and more where the process did something before.
    """
    files = [
        Path(str(loaded.__file__))
        for name, loaded in list(sys.modules.items())
        if name.partition(".")[0] == "truejoint" and not name.startswith(_IDLE)
        if getattr(loaded, "__file__", None)
    ]
    data = {
        file
        for folder in {file.parent for file in files} - {_PACKAGE, _HERE}  # which compute nothing
        for file in folder.rglob("*")
        if file.suffix in _DATA
    }
    names = [file.relative_to(_PACKAGE).as_posix() for file in (*files, *data)]
    return {name: _digest_of(name) for name in sorted({*names, module})}


@cache
def _digest_of(name: str) -> str:
    """Digest of a file of truejoint, or of an imported module's; empty where there is none."""
    path = Path(getattr(sys.modules.get(name), "__file__", None) or _PACKAGE / name)
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16] if path.is_file() else ""


def _is_current(part: PartResult | None) -> bool:
    """Whether a part was made by the sources of today."""
    return part is not None and all(
        _digest_of(name) == digest for name, digest in (part.sources or {"": "none"}).items()
    )


def part_file(folder: Path, part: Part) -> Path:
    """Where a part is kept: another function, argument or seed is another file."""
    function = f"{part.compute.__module__}.{part.compute.__name__}"
    origin = (function, part.key, part.arguments)
    digest = hashlib.sha256(json.dumps(origin, sort_keys=True).encode()).hexdigest()
    return folder / f"{part.key}-{digest[:16]}.part"


def write_part(path: Path, result: PartResult) -> None:
    """Write a part whole or not at all; raises RecordingError or OSError where it cannot."""
    content = io.BytesIO()
    texts = {_ROWS: list(result.rows), _SOURCES: dict(result.sources)}
    packed = {key: np.frombuffer(json.dumps(v).encode(), np.uint8) for key, v in texts.items()}
    arrays = {_ARRAY + name: values for name, values in result.arrays.items()}
    np.savez(content, allow_pickle=False, **packed, **arrays)
    write_bytes(path, hashlib.sha256(content.getvalue()).digest() + content.getvalue())


def read_part(path: Path) -> PartResult | None:
    """Part that was kept; None if there is none, or it is not as it was written."""
    data = path.read_bytes() if path.is_file() else b""
    digest, content = data[:_DIGEST], data[_DIGEST:]
    if hashlib.sha256(content).digest() != digest:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name.removeprefix(_ARRAY): archive[name] for name in archive.files}
    rows, sources = (json.loads(arrays.pop(name).tobytes()) for name in (_ROWS, _SOURCES))
    return PartResult(rows, arrays, sources)


def write_bytes(path: Path, data: bytes) -> None:
    """Write a file whole or not at all, over what is there; makes its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, data, overwrite=True)


_ANSWER: Final = 20.0  # [s] for a scheduler to answer
_PATIENCE: Final = 20.0  # [s] for it to have workers
_LOOK: Final = 5.0  # [s] between two looks at whether there are workers


def on_cluster(
    call: Callable[[Any], Any], tasks: Sequence[Any], address: str
) -> Iterator[tuple[Any, Any]]:
    """Give each task and what a pure function of a module makes of it, as workers are done with it.

    A worker that dies costs the task that it had, which another one does again; the results are
    those of this computer if the workers' processors add as this one's does.

    Raises StudyError if the scheduler at `address` cannot be reached or is lost, has no workers or
    loses them, or if a worker has several threads or other software than this computer, or dies of
    a task again and again; TruejointError if Dask is not installed.
    """
    distributed = require("distributed", "cluster", "a cluster")
    for logger in [*logging.root.manager.loggerDict]:  # several of Dask have levels of their own
        if logger.partition(".")[0] in ("distributed", "tornado", "asyncio"):
            logging.getLogger(logger).setLevel(logging.CRITICAL)  # one line says what went wrong
    if not address:
        raise StudyError("no scheduler at ''; give its address, such as tcp://10.0.0.5:8786")
    try:
        distributed.comm.resolve_address(address)  # before a thread is begun for it
        client = distributed.Client(address, timeout=_ANSWER)
    except (OSError, ValueError) as error:
        reason = str(error).partition("\n")[0]
        raise StudyError(f"no scheduler at {address:.80}: {reason:.120}; is it running?") from None
    kept = "what is done is kept: run it again"
    with closing(client):
        _check_workers(client, address)
        futures = client.map(partial(_checked, call, software()), tasks, pure=False)
        waiting = dict(zip(futures, tasks, strict=True))
        while waiting:
            try:
                done = distributed.wait([*waiting], timeout=_LOOK, return_when="FIRST_COMPLETED")
                for future in done.done:
                    yield waiting[future], future.result()
                    del waiting[future]
            except TimeoutError:
                _check_workers(client, address)
            except distributed.CancelledError:
                raise StudyError(f"the scheduler at {address} was lost; {kept}") from None
            except distributed.KilledWorker as error:
                text = f"workers died of a part again and again ({error!s:.80}); is memory short?"
                raise StudyError(f"{text} {kept.capitalize()}") from None


@cache
def software() -> str:
    """Versions that results depend on, and a digest of this package's source."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*.py")):
        digest.update(path.relative_to(_PACKAGE).as_posix().encode() + b"\0" + path.read_bytes())
    software = [f"{name} {number}" for name, number in versions()]
    return ", ".join([*software, f"source {digest.hexdigest()[:12]}"])


def _checked(call: Callable[[Any], Any], expected: str, task: Any) -> Any:
    """Do a task on a worker, if it has the software of the computer that asks."""
    here, there = software().split(", "), expected.split(", ")
    if here != there:
        raise StudyError(
            f"a worker on {platform.node()} has other software: "
            f"{'; '.join(name for name in here if name not in there)} (here "
            f"{'; '.join(name for name in there if name not in here)}); install the same on all"
        )
    return call(task)


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise StudyError(
            f"the scheduler at {address} has no workers; what is done is kept: start some, dask "
            f"worker {address} --nthreads 1"
        ) from None
    for worker, about in client.scheduler_info(n_workers=-1)["workers"].items():
        if about["nthreads"] != 1:
            raise StudyError(
                f"worker {worker} has {about['nthreads']} threads; start it with --nthreads 1, and "
                "one worker for each core"
            )
