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
from typing import Any, Final, TypeVar

import truejoint
from truejoint.errors import StudyError
from truejoint.extras import require

T = TypeVar("T")
R = TypeVar("R")

_ANSWER: Final = 20.0  # [s] for a scheduler or a worker to answer
_PATIENCE: Final = 20.0  # [s] for it to have workers
_LOOK: Final = 5.0  # [s] between two looks at whether there are workers
_PACKAGES: Final = ("truejoint", "numpy", "scipy", "numba", "scikit-learn", "pandas")


def on_cluster(call: Callable[[T], R], tasks: Sequence[T], address: str) -> Iterator[tuple[T, R]]:
    """Call a function of a module with each task on workers of a scheduler: both, as it is done.

    A worker that dies costs the task that it had, which another one does again; the results are
    those of this computer if the workers' processors add as this one's does.

    Parameters
    ----------
    call : callable
        Pure, of one task; by name, so the workers import it.
    tasks : sequence
    address : str
        Of the scheduler, such as ``tcp://10.0.0.5:8786``.

    Raises
    ------
    StudyError
        If the scheduler cannot be reached or is lost, has no workers or loses them, or one of them
        has more threads than one or other software than this computer, or dies of a task again and
        again.
    TruejointError
        If Dask is not installed.
    """
    distributed = require("distributed", "cluster", "a cluster")
    logging.getLogger("distributed").setLevel(logging.CRITICAL)  # one line says what went wrong
    if not address:
        raise StudyError("no scheduler at ''; give its address, such as tcp://10.0.0.5:8786")
    try:
        distributed.comm.resolve_address(address)  # before a thread is begun for it
        client = distributed.Client(address, timeout=_ANSWER)
    except (OSError, ValueError) as error:
        said = str(error).partition("\n")[0]
        raise StudyError(f"no scheduler at {address:.80}: {said:.120}; is it running?") from None
    with closing(client):
        _check_workers(client, address)
        wanted = software()
        futures = client.map(partial(_checked, call, wanted=wanted), tasks, pure=False)
        waiting = dict(zip(futures, tasks, strict=True))
        while waiting:
            for future in _some_done(distributed, client, list(waiting), address):
                yield waiting.pop(future), _result(distributed, future, address)
                future.release()


@cache
def software() -> str:
    """Versions that results depend on, and a digest of this package's source."""
    digest = hashlib.sha256()
    folder = Path(truejoint.__file__).parent
    for path in sorted(folder.rglob("*.py")):
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0" + path.read_bytes())
    packages = (f"{name} {version(name)}" for name in _PACKAGES)
    own = f"source {digest.hexdigest()[:12]}"
    return ", ".join((f"Python {platform.python_version()}", *packages, own))


def _checked(call: Callable[[T], R], task: T, wanted: str) -> R:
    """Do a task, on a worker; one that joined late was not asked for its software before."""
    _check_same("a worker", software(), wanted)
    return call(task)


def _check_same(worker: str, found: object, wanted: str) -> None:
    if found != wanted:
        here = wanted.split(", ")
        there = found.split(", ") if isinstance(found, str) else [f"no answer: {found!s:.80}"]
        other = [one for one in there if one not in here]
        raise StudyError(
            f"{worker} has other software: {'; '.join(other)} (here "
            f"{'; '.join(one for one in here if one not in there)}); install the same on all"
        )


def _check_workers(client: Any, address: str) -> None:
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError:
        raise StudyError(
            f"the scheduler at {address} has no workers; start some: dask worker {address} "
            "--nthreads 1"
        ) from None
    for worker, about in client.scheduler_info(n_workers=-1)["workers"].items():
        if about["nthreads"] != 1:
            raise StudyError(
                f"worker {worker} has {about['nthreads']} threads; start it with --nthreads 1, and "
                "one worker for each core"
            )
    try:
        # Run by the client's own loop, as only that can stop waiting for one that hangs.
        told = client.sync(client.run, software, on_error="return", callback_timeout=_ANSWER)
    except TimeoutError:
        raise StudyError(
            f"a worker of {address} did not say within {_ANSWER:g} s what software it has; is it "
            "stopped, or its computer overloaded? Restart it"
        ) from None
    for worker, found in told.items():
        _check_same(f"worker {worker}", found, software())


def _some_done(distributed: Any, client: Any, waiting: Sequence[Any], address: str) -> set[Any]:
    """Wait until one or more of the futures are done."""
    while True:
        try:
            done: set[Any] = distributed.wait(
                waiting, timeout=_LOOK, return_when="FIRST_COMPLETED"
            ).done
        except TimeoutError:
            if client.status != "running":
                raise StudyError(_lost(address)) from None
            try:
                client.wait_for_workers(1, timeout=_PATIENCE)
            except TimeoutError:
                raise StudyError(
                    f"the scheduler at {address} has lost its workers, with {len(waiting)} parts "
                    "left; what is done is kept: start workers, and run it again"
                ) from None
        except distributed.CancelledError:
            raise StudyError(_lost(address)) from None
        else:
            return done


def _result(distributed: Any, future: Any, address: str) -> Any:
    try:
        return future.result()
    except distributed.KilledWorker as error:
        raise StudyError(
            f"workers died of a part again and again ({error!s:.80}); is memory short? What is "
            "done is kept"
        ) from None
    except distributed.CancelledError:
        raise StudyError(_lost(address)) from None


def _lost(address: str) -> str:
    return f"the scheduler at {address} was lost; what is done is kept: run it again"
