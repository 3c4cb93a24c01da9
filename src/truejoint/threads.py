"""How threads share the processor: one for linear algebra, short turns where a loop keeps time."""

import gc
import sys
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import lru_cache
from typing import Any, Final

from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]

_TURN: Final = 1e-4  # [s]; Python's own is 5 ms, for which a loop at 1 kHz would miss five periods


@contextmanager
def short_turns() -> Iterator[None]:
    """Context in which a thread waits 0.1 ms for its turn, and no search for garbage takes long.

    Objects that exist at its beginning are not searched: of all modules that takes 0.1 to 0.2 s.
    """
    interval, is_frozen = sys.getswitchinterval(), gc.get_freeze_count() > 0
    sys.setswitchinterval(min(interval, _TURN))
    if not is_frozen:
        gc.freeze()
    try:
        yield
    finally:
        if not is_frozen:
            gc.unfreeze()
        sys.setswitchinterval(interval)


def one_thread() -> AbstractContextManager[Any]:
    """Context in which libraries such as BLAS and OpenMP use a single thread.

    Problems of a few thousand rows are too small to be shared.
    """
    context: AbstractContextManager[Any] = _libraries(len(sys.modules)).limit(limits=1)
    return context


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Look for the libraries, which takes milliseconds: again only once modules were imported."""
    return ThreadpoolController()
