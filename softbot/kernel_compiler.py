"""numba's compiler without what kernels over plain arrays do not need: half as long at work, the same code.

numba finds out anew what the product of two floats is for each product in a function, by asking in turn all who might
know; here it is asked once for each function. It also looks through each function a dozen times for closures, literal
loops, `with` blocks, array expressions and functions to inline, and puts it in order after each time: there are none.

Of numba this uses what `njit(pipeline_class=…)` is made for, and the names of its passes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable
from typing import Any

from softbot.kernel_cache import KernelCache  # before numba

# isort: split
from numba import njit
from numba.core import itanium_mangler, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.typed_passes import NopythonTypeInference, PreLowerStripPhis
from numba.core.types.misc import unliteral
from numba.core.untyped_passes import FixupArgs, GenericRewrites, IRProcessing, ReconstructSSA, TranslateByteCode


class _Remembering:
    """A typing context that is asked each question once."""

    def __init__(self, context: Any) -> None:
        self._context, self._known = context, {}  # type: ignore[var-annotated]

    def __getattr__(self, name: str) -> Any:
        return getattr(self._context, name)

    def _once(self, ask: Any, *question: Any) -> Any:
        try:
            return self._known[question]
        except TypeError:  # a slice has no hash
            return ask()
        except KeyError:
            answer = self._known[question] = ask()
            return answer

    def resolve_function_type(self, function: Any, arguments: Any, keywords: Any) -> Any:
        if isinstance(function, types.Dispatcher):  # not one more of it for each constant that it is called with
            arguments = [unliteral(one) for one in arguments]
        return self._once(
            lambda: self._context.resolve_function_type(function, arguments, keywords),
            function, tuple(arguments), tuple(dict(keywords).items()),
        )  # fmt: skip

    def resolve_setitem(self, target: Any, index: Any, value: Any) -> Any:
        return self._once(lambda: self._context.resolve_setitem(target, index, value), "setitem", target, index, value)

    def resolve_getattr(self, owner: Any, name: str) -> Any:
        return self._once(lambda: self._context.resolve_getattr(owner, name), "getattr", owner, name)


@register_pass(mutates_CFG=True, analysis_only=False)
class _TypeInference(NopythonTypeInference):
    _name = "type_inference_once"

    def run_pass(self, state: Any) -> bool:
        context = state.typingctx
        state.typingctx = _Remembering(context)
        try:
            return bool(super().run_pass(state))
        finally:
            state.typingctx = context


def _symbol(name: str, arguments: Iterable[Any], *, abi_tags: tuple[str, ...] = (), uid: Any = None) -> str:
    """A function's name in the machine code: with a digest of its arguments' types, which have pages of names."""
    digest = hashlib.sha256("; ".join(map(str, arguments)).encode()).hexdigest()[:16]
    return str(itanium_mangler.mangle(name, (), abi_tags=(*abi_tags, digest), uid=uid))


class _KernelLibrary(JITCodeLibrary):
    """Code whose functions are simplified by one pass manager, where numba makes one for each that is only named."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)


class _NotLoaded:
    """Where code is that was not loaded to be run."""

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing to set."""


class _PartLibrary(_KernelLibrary):
    """Code that is linked into that of its callers and nothing else."""

    @property
    def codegen(self) -> _NotLoaded:
        return _NotLoaded()

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0  # _Part is called instead

    def _optimize_final_module(self) -> None:
        """Together with what it calls it is optimised where it is called."""

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True


class KernelCompiler(CompilerBase):
    """For kernels that Python calls: plain loops over arrays and records."""

    library: type[JITCodeLibrary] = _KernelLibrary

    def define_pipelines(self) -> list[Any]:
        """One pipeline."""
        state = self.state
        state.targetctx.mangler = _symbol
        state.library = self.library(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        passes = PassManager("kernel")
        passes.add_pass(TranslateByteCode, "analyzing bytecode")
        passes.add_pass(FixupArgs, "fix up args")
        passes.add_pass(IRProcessing, "processing IR")
        passes.add_pass(GenericRewrites, "constant indices")
        passes.add_pass(ReconstructSSA, "ssa")
        passes.add_pass(_TypeInference, "type inference")
        passes.add_pass(PreLowerStripPhis, "remove phis nodes")
        passes.passes.extend(DefaultPassBuilder.define_nopython_lowering_pipeline(state).passes)
        passes.finalize()
        return [passes]


class PartCompiler(KernelCompiler):
    """For what is only called by other kernels, which take it into their own code.

    numba would also make it ready to be run by itself: optimised, and turned into machine code with all that it calls.
    """

    library = _PartLibrary


class _Part(CPUDispatcher):
    """A part. Called from Python it runs as Python, as what is only read and tested may."""

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        return self.py_func(*arguments, **keywords)


def part(**options: Any) -> Callable[[Callable[..., Any]], Any]:
    """`njit` for functions that only other kernels call."""
    compiled = njit(no_cpython_wrapper=True, no_cfunc_wrapper=True, pipeline_class=PartCompiler, **options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        dispatcher.__class__ = _Part
        return dispatcher

    return decorate


def kernel(*, cache: bool = True, **options: Any) -> Any:
    """`njit` for functions that Python calls."""
    compiled = njit(cache=cache, pipeline_class=KernelCompiler, **options)

    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        if cache:
            dispatcher._cache.__class__ = KernelCache
        return dispatcher

    return decorate
