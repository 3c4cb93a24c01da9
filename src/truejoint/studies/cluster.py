"""Parts of a study on the workers of a Dask scheduler that is there already."""

from __future__ import annotations

import hashlib
import logging
import platform
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

import truejoint
from truejoint.errors import StudyError
from truejoint.extras import require

_ANSWER: Final = 20.0  # [s] for a scheduler to answer
_PATIENCE: Final = 20.0  # [s] for it to have workers
_LOOK: Final = 5.0  # [s] between two looks at whether there are workers
_PACKAGES: Final = ("truejoint", "numpy", "scipy", "numba", "scikit-learn", "pandas")


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
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # one line says what went wrong
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
    folder = Path(truejoint.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    packages = (f"{name} {version(name)}" for name in _PACKAGES)
    source = f"source {digest.hexdigest()[:12]}"
    return ", ".join((f"Python {platform.python_version()}", *packages, source))


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
