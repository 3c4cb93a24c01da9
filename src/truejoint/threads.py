"""One thread of linear algebra: problems of a few thousand rows are too small to be shared."""

import sys
from contextlib import AbstractContextManager
from functools import lru_cache
from typing import Any

from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]


def one_thread() -> AbstractContextManager[Any]:
    """Context in which libraries such as BLAS and OpenMP use a single thread.

    Examples
    --------
    >>> with one_thread():
    ...     float(np.linalg.det(np.eye(2)))
    1.0
    """
    context: AbstractContextManager[Any] = _libraries(len(sys.modules)).limit(limits=1)
    return context


@lru_cache(maxsize=1)
def _libraries(_modules: int) -> ThreadpoolController:
    """Look for the libraries, which takes milliseconds: again only once modules were imported."""
    return ThreadpoolController()
