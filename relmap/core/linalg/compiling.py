"""The hot loops, compiled: what numpy can only do in many passes.

Compiled code is cached on disk, beside the package or else in the user's cache folder, so that only
the first run on a machine waits for it.  Loading the compiler takes a moment too, so these modules
are imported where they are used.

How long the first run waits depends on the number of functions and on their lines.  A loop over
numbers takes a hundredth of a second, where one slice assigned to another, `np.full`, `np.sort`,
`np.dot` and arithmetic of whole arrays take a tenth to two.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
from numba.core import event
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonRewrites

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


class _PartLibrary(cast("Any", JITCodeLibrary)):  # type: ignore[misc]
    """The code of a helper, as it is before optimising: it becomes part of what calls it.

    numba would optimise it and turn it into machine code by itself, which nothing ever calls.
    """

    def _optimize_final_module(self) -> None:
        """Leave that to the caller, which is optimised as a whole."""

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        return 0  # as of what cannot be called from Python

    @property
    def codegen(self) -> _PartLibrary:
        return self

    def set_env(self, *_: object) -> None:
        """Set nothing: only what Python calls has an environment."""


class _AsPart(FunctionPass):
    _name = "as_part"

    def __init__(self) -> None:
        """Numba's base class is abstract without one."""

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_cpython_wrapper = True
        return False


class _PartCompiler(CompilerBase):
    def define_pipelines(self) -> list[Any]:
        passes = cast("Any", DefaultPassBuilder).define_nopython_pipeline(self.state)
        # Typed by now with the same options as its callers, with which it shares what numba
        # compiles of its own, as `np.empty`.
        passes.add_pass_after(_AsPart, NopythonRewrites)
        passes.finalize()
        return [passes]


cast("Any", register_pass)(mutates_CFG=False, analysis_only=True)(_AsPart)


def helper(function: Function) -> Function:
    """Compile a function as a part of those that call it: they must be compiled too.

    It cannot be called from Python.
    """
    return cast("Function", _njit(pipeline_class=_PartCompiler, **_OPTIONS)(function))


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
