"""The hot loops, compiled: what numpy can only do in many passes.

Compiled code is cached on disk, beside the package or else in the user's cache folder, so that only
the first run on a machine waits for it.  Loading the compiler takes a moment too, so these modules
are imported where they are used.

How long the first run waits depends on the number of functions, on their lines, and on how often a
function is compiled anew within those that call it.  A loop over numbers takes a hundredth of a
second, where one slice assigned to another, `np.full`, `np.sort`, `np.dot` and arithmetic of whole
arrays take a tenth to two.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event

Function = TypeVar("Function", bound=Callable[..., object])

_njit: Any = numba.njit  # whose annotations know nothing of wrappers
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}


def compiled(function: Function) -> Function:
    """Compile a function on its first call, and cache the code where there is a place for it.

    A division by zero gives infinity or NaN, as in numpy.
    """
    try:
        return cast("Function", _njit(cache=True, **_OPTIONS)(function))
    except RuntimeError:  # neither beside the package nor in the user's cache folder
        return cast("Function", _njit(**_OPTIONS)(function))


def helper(function: Function) -> Function:
    """Compile a function with those that call it, whose code holds it: they must be compiled too.

    It cannot be called from Python, which takes a fifth of the time to compile small functions.
    """
    return cast("Function", _njit(no_cpython_wrapper=True, **_OPTIONS)(function))


class _Watch(event.Listener):
    """Says once that something is compiled, and keeps the garbage collector out meanwhile.

    It would look through all that the compiler holds again and again, a tenth of the time.
    """

    def __init__(self) -> None:
        self._depth, self._collects, self._said = 0, False, False

    def on_start(self, event: event.Event) -> None:
        if not self._said:
            self._said = True
            logging.getLogger(__name__).info(
                "compiling, as on the first run on a machine: up to half a minute"
            )
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


cast("Any", event).register("numba:compile", _Watch())
