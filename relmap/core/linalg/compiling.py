"""The hot loops, compiled: what numpy can only do in many passes.

Compiled code is cached on disk, so that only the first run on a machine waits for it.  Loading the
compiler takes a moment too, so these modules are imported where they are used.

What the first run waits for is the number of functions, the lines of each, and how often each is
compiled anew within those that call it.  So what only compiled code calls is a `helper`; and a
loop over numbers takes a hundredth of a second where an assignment of one slice to another, `np.full`,
`np.sort`, `np.dot` or arithmetic of whole arrays takes a tenth to two.
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
        return cast("Function", numba.njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:  # neither beside the package nor in the user's cache folder
        return cast("Function", numba.njit(**_OPTIONS)(function))


def helper(function: Function) -> Function:
    """Compile a function that is called by compiled code alone; the caller's cache holds it too."""
    return cast("Function", numba.njit(no_cpython_wrapper=True, **_OPTIONS)(function))


_OPTIONS = {"error_model": "numpy", "no_cfunc_wrapper": True}
