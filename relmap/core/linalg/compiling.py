"""The hot loops, compiled: what numpy can only do in many passes.

Compiled code is cached on disk, so that only the first run on a machine waits for it.  Loading the
compiler takes a moment too, so these modules are imported where they are used.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

import numba

Function = TypeVar("Function", bound=Callable[..., object])


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and cache the code where there is a place for it.

    A division by zero gives infinity or NaN, as in numpy.
    """
    try:
        return cast("Function", numba.njit(cache=True, error_model="numpy")(function))
    except RuntimeError:  # neither beside the package nor in the user's cache folder
        return cast("Function", numba.njit(error_model="numpy")(function))
