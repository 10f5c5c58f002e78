"""Numba's pipeline, changed: parts are linked before they are optimised, and only then.

By itself Numba takes each function through all of LLVM when another first calls it, and then
again as a part of that one, and of what calls that; and it makes each callable from Python.
Here a function's code is only made ready to be linked into what calls it, and LLVM works on the
whole once, which takes half as long. This reaches into Numba (`compiling` says which versions of
it are known to bear that).
"""

from __future__ import annotations

from typing import Any, cast

from llvmlite import binding
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.typed_passes import NativeLowering


class _Part(JITCodeLibrary):
    """The code of a part, to be linked into another's; it is not optimised, and never executed."""

    def finalize(self) -> None:
        for library in dict.fromkeys(self._linking_libraries):
            self._final_module.link_in(library._get_module_for_linking(), preserve=True)
        self._finalized = True


class _Whole(JITCodeLibrary):
    """The code of a function with all its parts.

    Most of its loops go over few modes, rows or components: unrolled they would be slower.
    """

    def _optimize_final_module(self) -> None:
        tuning = binding.create_pipeline_tuning_options(speed_level=2)
        tuning.loop_unrolling = False
        tuning.loop_interleaving = False
        tuning.loop_vectorization = False
        tuning.slp_vectorization = False
        builder = binding.create_pass_builder(self._codegen._tm, tuning)
        passes = builder.getModulePassManager()
        passes.add_refprune_pass()
        passes.run(self._final_module, builder)


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _LowerPart(NativeLowering):
    """From typed code to a `_Part`."""

    _name = "imm_tdoa_lower_part"

    def run_pass(self, state: Any) -> bool:
        context, part = state.targetctx, cast(Any, _Part)
        state.library = part(context.codegen(), state.func_id.func_qualname)
        state.flags.no_compile = True
        cast(Any, super()).run_pass(state)
        # Numba knows a function by what Python would call, written in C; this takes no arguments
        name = object().__dir__
        context.insert_user_function(name, state.cr.fndesc, [state.library])
        state.cr = state.cr._replace(cfunc=name)
        return True


@register_pass(mutates_CFG=True, analysis_only=False)  # type: ignore[no-untyped-call]
class _LowerWhole(NativeLowering):
    """From typed code to a `_Whole`."""

    _name = "imm_tdoa_lower_whole"

    def run_pass(self, state: Any) -> bool:
        context, whole = state.targetctx, cast(Any, _Whole)
        state.library = whole(context.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        cast(Any, super()).run_pass(state)
        return True


class _Compiler(CompilerBase):
    """Numba's own pipeline, but for the last step to machine code."""

    lower: Any

    def define_pipelines(self) -> Any:
        pipeline = cast(Any, DefaultPassBuilder).define_nopython_pipeline(self.state)
        pipeline.add_pass_after(self.lower, NativeLowering)
        pipeline.passes = [p for p in pipeline.passes if p[0] is not NativeLowering]
        pipeline.finalize()
        return [pipeline]


class PartCompiler(_Compiler):
    """Compiles a part: to code that is ready to be linked into what calls it."""

    lower = _LowerPart


class WholeCompiler(_Compiler):
    """Compiles a function with all its parts, to machine code."""

    lower = _LowerWhole
