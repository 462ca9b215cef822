"""Compilation of hot loops that numpy would need many passes for.

Compiled code is cached on disk, beside the package or else in the user's cache folder, so that only
the first run on a machine waits for it. Importing the compiler takes time too, so these modules are
imported where they are used; within an iteration by `import`, as `from` takes 1 µs longer.

Compile time depends on the number and length of functions. A scalar loop takes about 0.01 s,
whereas a slice assignment, `np.full`, `np.sort`, `np.dot` and array arithmetic take 0.1 to 0.2 s
each, and assigning an array to part of another 2 s, for the message if the shapes differ: use a
loop. `np.empty`, `np.zeros` and `np.ones` are made in place (`resolving.py`).
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from functools import cache, partial
from typing import Any, TypeVar, cast

import numba
from numba.core import event, types

from relmap.core.linalg.caching import Kept
from relmap.core.linalg.compiler import IS_KNOWN, KernelCompiler, PartCompiler, UnrolledCompiler

Function = TypeVar("Function", bound=Callable[..., object])

_njit: Any = numba.njit  # the annotations do not cover wrappers
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
NOT_KEPT = "in every run, unless NUMBA_CACHE_DIR names a folder that can be written"


def compiled(function: Function) -> Function:
    """Compile a function on its first call and cache the code if possible.

    A division by zero gives infinity or NaN, as in numpy. In other compiled functions, it is
    compiled as a `helper` is.
    """
    return _kept(function, pipeline_class=KernelCompiler)


def unrolled(function: Function) -> Function:
    """Compile as `compiled`, but with loops unrolled and vectorised, which takes longer."""
    return _kept(function, pipeline_class=UnrolledCompiler)


def _kept(function: Function, **options: Any) -> Function:
    try:
        kept = _njit(cache=True, **_OPTIONS, **options)(function)
    except RuntimeError:  # neither beside the package nor in the user's cache folder
        _WATCH.keeps = False
        return cast("Function", _njit(**_OPTIONS, **options)(function))
    if IS_KNOWN:
        Kept.keep_by_content(kept, repr(options))
        part: Callable[[], Any] = cache(partial(helper, function))
        kept.get_call_template = lambda args, kws: part().get_call_template(args, kws)
        kept.get_overload = lambda sig: part().get_overload(sig)
    return cast("Function", kept)


def helper(function: Function) -> Function:
    """Compile a function as a part of its callers, which must be compiled too.

    It cannot be called from Python. A constant among its arguments is an argument like others:
    by default numba would compile the function again for each constant.
    """
    part = _njit(pipeline_class=PartCompiler, **_OPTIONS)(function)
    by_types, plain = part.get_call_template, cast("Any", types).unliteral
    part.get_call_template = lambda args, kws: by_types([plain(one) for one in args], kws)
    return cast("Function", part)


class _Watch(event.Listener):
    """Logs once that compilation takes place, and disables the garbage collector meanwhile.

    Otherwise the collector would scan the compiler's objects repeatedly, a tenth of the time.
    """

    keeps = True
    """Whether the code can be cached."""

    def __init__(self) -> None:
        self._depth, self._collects, self._said = 0, False, False

    def on_start(self, event: event.Event) -> None:
        if not self._said:
            self._said = True
            when = "only on the first run of its kind on a machine" if self.keeps else NOT_KEPT
            logging.getLogger(__name__).info("compiling, %s: up to half a minute", when)
        if self._depth == 0:
            self._collects = gc.isenabled()
            gc.disable()
        self._depth += 1

    def on_end(self, event: event.Event) -> None:
        self._depth -= 1
        if self._depth == 0 and self._collects:
            gc.enable()


_WATCH = _Watch()
cast("Any", event).register("numba:compile", _WATCH)
