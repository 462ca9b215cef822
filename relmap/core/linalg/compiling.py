"""Compilation of hot loops that numpy would need many passes for.

Compiled code is cached on disk, beside the package or else in the user's cache folder, so that only
the first run on a machine waits for it. Importing the compiler takes time too, so these modules are
imported where they are used.

Compile time depends on the number and length of functions. A scalar loop takes about 0.01 s,
whereas a slice assignment, `np.full`, `np.sort`, `np.dot` and array arithmetic take 0.1 to 0.2 s
each, and assigning an array to part of another 2 s, for the message if the shapes differ. Each
form of a call counts: `np.empty(n, dtype=kind)` beside `np.empty(n, kind)` takes twice as long.
"""

from __future__ import annotations

import gc
import logging
from collections.abc import Callable
from functools import cache
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
from numba.core import event
from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import FunctionPass, register_pass
from numba.core.typed_passes import NopythonRewrites

Function = TypeVar("Function", bound=Callable[..., object])

_njit: Any = numba.njit  # the annotations do not cover wrappers
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "no_cfunc_wrapper": True}
NOT_KEPT = "in every run, unless NUMBA_CACHE_DIR names a folder that can be written"


@cache
def _machine() -> Any:
    """Return the processor for which code is optimised."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    features = cast("Any", get_host_cpu_features)()
    return target.create_target_machine(llvm.get_host_cpu_name(), features)


class _Unoptimised(cast("Any", JITCodeLibrary)):  # type: ignore[misc]
    """Code that is optimised once, with everything that it calls.

    By default numba would also optimise each function before that.
    """

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = str(self._codegen.target_data)


class _KernelLibrary(_Unoptimised):
    """The code of a function that Python calls; its loops are neither unrolled nor vectorised."""

    def _optimize_final_module(self) -> None:
        try:
            options = llvm.create_pipeline_tuning_options(2)
            options.loop_unrolling = False
            options.loop_vectorization = options.loop_interleaving = False
            builder = llvm.create_pass_builder(_machine(), options)
            passes = builder.getModulePassManager()
            passes.add_refprune_pass()
        except (AttributeError, TypeError):  # another version of numba
            super()._optimize_final_module()
        else:
            passes.run(self._final_module, builder)


class _PartLibrary(_Unoptimised):
    """The code of a helper, simplified, to be inlined into its callers.

    By default numba would also generate stand-alone machine code that is never called.
    """

    def _optimize_final_module(self) -> None:
        try:
            options = llvm.create_pipeline_tuning_options(1)
            builder = llvm.create_pass_builder(_machine(), options)
            passes = llvm.create_new_module_pass_manager()
            passes.add_sroa_pass()
            passes.add_instruction_combine_pass()
            passes.add_simplify_cfg_pass()
        except (AttributeError, TypeError):  # another version of numba
            return  # the callers optimise
        passes.run(self._final_module, builder)

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, _name: str) -> int:
        return 0  # as for functions not callable from Python

    @property
    def codegen(self) -> _PartLibrary:
        return self

    def set_env(self, *_: object) -> None:
        """Do nothing: only functions callable from Python have an environment."""


class _AsKernel(FunctionPass):
    _name = "as_kernel"

    def __init__(self) -> None:
        """Do nothing; required by numba's abstract base class."""

    def run_pass(self, state: Any) -> bool:
        state.library = _KernelLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return False


class _AsPart(_AsKernel):
    _name = "as_part"

    def run_pass(self, state: Any) -> bool:
        state.library = _PartLibrary(state.targetctx.codegen(), state.func_id.func_qualname)
        state.flags.no_cpython_wrapper = True
        return False


class _KernelCompiler(CompilerBase):
    library: Any = _AsKernel

    def define_pipelines(self) -> list[Any]:
        passes = cast("Any", DefaultPassBuilder).define_nopython_pipeline(self.state)
        # Typed with the same options as its callers, so that they share functions that numba itself
        # compiles, such as `np.empty`.
        passes.add_pass_after(self.library, NopythonRewrites)
        passes.finalize()
        return [passes]


class _PartCompiler(_KernelCompiler):
    library = _AsPart


for _one in _AsKernel, _AsPart:
    cast("Any", register_pass)(mutates_CFG=False, analysis_only=True)(_one)


def compiled(function: Function) -> Function:
    """Compile a function on its first call and cache the code if possible.

    A division by zero gives infinity or NaN, as in numpy.
    """
    return _kept(function, pipeline_class=_KernelCompiler)


def unrolled(function: Function) -> Function:
    """Compile as `compiled`, but with loops unrolled and vectorised, which takes longer."""
    return _kept(function)


def _kept(function: Function, **options: Any) -> Function:
    try:
        return cast("Function", _njit(cache=True, **_OPTIONS, **options)(function))
    except RuntimeError:  # neither beside the package nor in the user's cache folder
        _WATCH.keeps = False
        return cast("Function", _njit(**_OPTIONS, **options)(function))


def helper(function: Function) -> Function:
    """Compile a function as a part of its callers, which must be compiled too.

    It cannot be called from Python.
    """
    return cast("Function", _njit(pipeline_class=_PartCompiler, **_OPTIONS)(function))


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
