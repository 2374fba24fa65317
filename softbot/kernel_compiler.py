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

from softbot.kernel_cache import KernelCache, Unit, units_of  # before numba
from softbot.kernel_source import source_digest

# isort: split
from llvmlite import binding as llvm
from numba import njit
from numba.core import itanium_mangler, types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import PassManager, register_pass
from numba.core.funcdesc import ExternalFunctionDescriptor, qualifying_prefix
from numba.core.registry import CPUDispatcher
from numba.core.sigutils import normalize_signature
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


_UNITS: dict[str, str] = {}
"""Digests of the source of units, by numba's names of their functions."""


_INTERNAL: dict[tuple[str, bool], dict[Any, Any]] = {}
"""What numba compiles on the way (a whole power, `math.hypot`), by the options of the function that asks for it. numba
keeps one version of each, with the options of who asked first: results would depend on what was compiled before."""


@register_pass(mutates_CFG=True, analysis_only=False)
class _ReadyToLower(PreLowerStripPhis):
    _name = "strip_phis_and_choose_internal"

    def run_pass(self, state: Any) -> bool:
        options = str(state.flags.fastmath), bool(state.flags.nrt)
        state.targetctx.cached_internal_func = _INTERNAL.setdefault(options, {})
        return bool(super().run_pass(state))


def _symbol(name: str, arguments: Iterable[Any], *, abi_tags: tuple[str, ...] = (), uid: Any = None) -> str:
    """A function's name in the machine code: with a digest of its arguments' types, which have pages of names.

    That of a unit is the same in all processes.
    """
    digest = hashlib.sha256("; ".join(map(str, arguments)).encode()).hexdigest()[:16]
    source = _UNITS.get(name.removeprefix(".NumbaEnv."))
    if source is not None:
        abi_tags, uid = (source,), None
    return str(itanium_mangler.mangle(name, (), abi_tags=(*abi_tags, digest), uid=uid))


class _KernelLibrary(JITCodeLibrary):
    """Code whose functions are simplified by one pass manager, where numba makes one for each that is only named."""

    def _optimize_functions(self, module: Any) -> None:
        module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _finalize_final_module(self) -> None:
        for unit in units_of(self):  # what is called has to be there before what calls it
            unit.made()
        super()._finalize_final_module()


class _NotLoaded:
    """Where code is that was not loaded to be run."""

    def set_env(self, name: str, environment: Any) -> None:
        """Nothing to set."""


def _unit_name(function: Any) -> str:
    """numba's name of a unit's function."""
    name = str(qualifying_prefix(function.__module__, function.__qualname__))
    _UNITS[name] = source_digest(function)
    return name


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


class _UnitLibrary(_KernelLibrary):
    """Code that others call where it is."""

    unit: Unit
    _shared_module: Any

    def _get_module_for_linking(self) -> Any:
        self._ensure_finalized()
        if self._shared_module is None:
            self._shared_module = llvm.parse_assembly(str(self._codegen._create_empty_module(self.name)))
        return self._shared_module


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
        passes.add_pass(_ReadyToLower, "remove phis nodes")
        passes.passes.extend(DefaultPassBuilder.define_nopython_lowering_pipeline(state).passes)
        passes.finalize()
        return [passes]


class PartCompiler(KernelCompiler):
    """For what is only called by other kernels, which take it into their own code.

    numba would also make it ready to be run by itself: optimised, and turned into machine code with all that it calls.
    """

    library = _PartLibrary


class UnitCompiler(KernelCompiler):
    """For what is compiled once and called by other kernels where it is."""

    library = _UnitLibrary

    def define_pipelines(self) -> list[Any]:
        """One pipeline."""
        made = super().define_pipelines()
        function, state = self.state.func_id.func, self.state
        _unit_name(function)
        state.library.unit = Unit(function.__module__, function.__name__, tuple(state.args))
        return made


class _Part(CPUDispatcher):
    """A part. Called from Python it runs as Python, as what is only read and tested may."""

    def __call__(self, *arguments: Any, **keywords: Any) -> Any:
        return self.py_func(*arguments, **keywords)


class _Promised:
    """A unit that is being compiled elsewhere, as far as its callers need to know it."""

    def __init__(self, function: Any, signature: Any, context: Any) -> None:
        symbol = _symbol(_unit_name(function), signature.args)
        self.signature, self.objectmode, self.entry_point = signature, False, self._not_here
        self.unit = Unit(function.__module__, function.__name__, signature.args)
        self.fndesc = ExternalFunctionDescriptor(symbol, signature.return_type, signature.args)
        self._context = context
        context.insert_user_function(self.entry_point, self.fndesc, [self])

    def _not_here(self) -> None:
        raise RuntimeError(f"{self.unit.name} was promised only")

    # what numba asks of a library that is linked to another
    _reload_init: frozenset[Any] = frozenset()

    def _ensure_finalized(self) -> None:
        pass

    def _get_module_for_linking(self) -> Any:
        return llvm.parse_assembly(str(self._context.codegen()._create_empty_module(self.unit.name)))


class _Unit(CPUDispatcher):
    """A unit. What is promised is not compiled here until it is needed, or the promise is not kept."""

    @property
    def _promises(self) -> dict[tuple[Any, ...], tuple[Any, Callable[[], object]]]:
        promises: dict[tuple[Any, ...], Any] = self.__dict__.setdefault("promises", {})
        return promises

    def promise(self, signature: Any, wait: Callable[[], object]) -> None:
        """Another process compiles this for a signature of numba's types, and `wait` returns when it has ended."""
        self._promises[signature.args] = signature, wait

    def compile(self, signature: Any) -> Any:
        """For arguments of these types; or only noted, where it is promised."""
        arguments, _ = normalize_signature(signature)
        promised = self._promises.get(tuple(arguments))
        if promised is None or tuple(arguments) in self.overloads:
            return super().compile(signature)
        self.overloads[tuple(arguments)] = _Promised(self.py_func, promised[0], self.targetctx)
        return self.overloads[tuple(arguments)].entry_point

    def made(self, arguments: tuple[Any, ...]) -> Any:
        """What it is compiled to, at the latest now."""
        promised = self._promises.pop(arguments, None)
        if promised is not None:
            promised[1]()
            self.withdraw(arguments)
        self.compile(arguments)
        return self.overloads[arguments]

    def withdraw(self, arguments: tuple[Any, ...]) -> None:
        """Promise these no longer: where they are needed they are compiled here."""
        self._promises.pop(arguments, None)
        if isinstance(self.overloads.get(arguments), _Promised):
            del self.overloads[arguments]


class _InnerUnit(_Unit, _Part):
    """A unit that Python does not call."""


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
    return _kept(njit(pipeline_class=KernelCompiler, **options), cache)


def unit(*, from_python: bool = False, **options: Any) -> Any:
    """`njit` for functions of a module that kernels call and do not take into their own code.

    Such a function is compiled once, by itself (in another process, it may be), and kept on disk by itself.
    from_python: whether Python calls it as well; else it runs there as Python.
    """
    alone = {} if from_python else {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return _kept(njit(pipeline_class=UnitCompiler, **alone, **options), True, _Unit if from_python else _InnerUnit)


def _kept(compiled: Any, cache: bool, kind: type[CPUDispatcher] = CPUDispatcher) -> Callable[..., Any]:
    def decorate(function: Callable[..., Any]) -> Any:
        dispatcher = compiled(function)
        dispatcher.__class__ = kind
        if cache:
            dispatcher._cache = KernelCache(function)
        return dispatcher

    return decorate
