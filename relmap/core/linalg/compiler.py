# mypy: disable-error-code="no-untyped-call"
"""How numba compiles the loops: its own steps, with shorter code and less optimisation."""

from __future__ import annotations

from functools import cache
from typing import Any, cast

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba.core import typed_passes
from numba.core.codegen import JITCodeLibrary, get_host_cpu_features
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower

IS_KNOWN = (0, 61) <= numba.version_info.short <= (0, 68)
"""Whether the tests have passed with this version of numba. Others use their own code, which takes
longer."""
_NEEDLESS = {
    "IRProcessing",
    "WithLifting",
    "InlineClosureLikes",
    "RewriteDynamicRaises",
    "MakeFunctionToJitFunction",
    "InlineInlinables",
    "FindLiterallyCalls",
    "LiteralUnroll",
    "LiteralPropagationSubPipelinePass",
    "InlineOverloads",
    "NopythonRewrites",
    "DumpParforDiagnostics",
}
"""Steps for what loops do not contain, such as closures and array arithmetic."""


@cache
def _machine() -> Any:
    """Return the processor for which code is optimised."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    features = cast("Any", get_host_cpu_features)()
    return target.create_target_machine(llvm.get_host_cpu_name(), features)


class _Library(cast("Any", JITCodeLibrary)):  # type: ignore[misc]
    """Code that everything it calls is linked into, once.

    By default numba would also link a helper into each helper that calls it.
    """

    _linking_libraries: list[Any]
    links = True
    """Whether what it calls is linked into it, not into its callers."""

    def finalize(self) -> None:
        if IS_KNOWN:
            self.called: dict[Any, None] = {}  # each after what it calls itself
            for one in self._linking_libraries:
                self.called |= one.called if isinstance(one, _PartLibrary) else {}
                self.called[one] = None
            # Of each, the linker takes only what is called already.
            self._linking_libraries = list(reversed(self.called)) if self.links else []
        super().finalize()

    def serialize_using_object_code(self) -> Any:
        """Return machine code, and of LLVM's code only the names: nothing is linked to it."""
        if not IS_KNOWN:
            return super().serialize_using_object_code()
        names = ir.Module()
        for one in self.get_defined_functions():
            stub = ir.Function(names, ir.FunctionType(ir.VoidType(), []), one.name)
            ir.IRBuilder(stub.append_basic_block()).ret_void()
        stubs = llvm.parse_assembly(str(names)).as_bitcode()
        return self.name, "object", (self._get_compiled_object(), stubs)

    def add_ir_module(self, ir_module: Any) -> None:
        """Take over code as text, and empty the blocks: cycles of many objects."""
        super().add_ir_module(ir_module)
        for function in ir_module.functions:
            for block in function.blocks:
                block.instructions.clear()


class _Unoptimised(_Library):
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

    links = False

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


class _AsKernel(typed_passes.NativeLowering):
    _name = "as_kernel"
    library: Any = _KernelLibrary

    @property
    def lowering_class(self) -> type[Lower]:
        if not IS_KNOWN:
            return Lower
        from relmap.core.linalg.lowering import ShortLower

        return ShortLower

    def run_pass(self, state: Any) -> bool:
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        return cast("bool", super().run_pass(state))


class _AsUnrolled(_AsKernel):
    library = _Library


class _AsPart(_AsKernel):
    _name = "as_part"
    library = _PartLibrary

    def run_pass(self, state: Any) -> bool:
        # Typed with the same options as its callers, so that they share functions that numba itself
        # compiles, such as `np.empty`.
        state.flags.no_cpython_wrapper = True
        return super().run_pass(state)


class KernelCompiler(CompilerBase):
    """For a function that Python calls."""

    lowering: Any = _AsKernel

    def define_pipelines(self) -> list[Any]:
        """Return numba's steps, less the needless ones and with the code of loops."""
        if IS_KNOWN:
            from relmap.core.linalg.resolving import Resolved

            self.state.typingctx = Resolved(self.state.typingctx)
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (self.lowering if one is typed_passes.NativeLowering else one, name)
            for one, name in passes.passes
            if not (IS_KNOWN and one.__name__ in _NEEDLESS)
        ]
        passes.finalize()
        return [passes]


class UnrolledCompiler(KernelCompiler):
    """The same, with loops unrolled and vectorised, which takes longer."""

    lowering = _AsUnrolled


class PartCompiler(KernelCompiler):
    """For a function that only compiled functions call."""

    lowering = _AsPart


for _one in _AsKernel, _AsUnrolled, _AsPart:
    cast("Any", register_pass)(mutates_CFG=True, analysis_only=False)(_one)
