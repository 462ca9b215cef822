"""Results do not depend on the number of cores."""

from __future__ import annotations

from contextlib import AbstractContextManager
from functools import cache
from typing import Any, cast


@cache
def _libraries() -> Any:
    """Return the BLAS libraries, which takes a millisecond to find."""
    import scipy.linalg  # noqa: F401  has its own, which numba uses too
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def one_thread() -> AbstractContextManager[Any]:
    """Return a context in which BLAS uses one thread: several add up long sums in other orders."""
    limited = _libraries().limit(limits=1, user_api="blas")
    return cast("AbstractContextManager[Any]", limited)
