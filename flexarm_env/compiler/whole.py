"""Kernels optimised once, as a whole, instead of once at every level of call.

Numba optimises and assembles every function on its own before it links it into its caller, which is then optimised
again with all that it contains: at five levels of call the innermost function goes through LLVM five times. Here a
kernel that Python calls is the only one that goes through; those that it calls are *parts*: their intermediate code is
handed on as it is. A part that Python calls after all is compiled once more. Functions that are no kernels, Numba's or
anybody's, are compiled as Numba always does: they may be called from elsewhere.
"""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import cache
from types import CodeType
from typing import Any

from llvmlite import ir
from llvmlite.binding import Linkage, parse_bitcode
from numba import types
from numba.core import sigutils
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import AnalysisPass, register_pass
from numba.core.registry import CPUDispatcher
from numba.core.runtime.context import NRTContext
from numba.core.targetconfig import ConfigStack
from numba.core.typed_passes import NopythonRewrites, NopythonTypeInference
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.core.untyped_passes import InlineClosureLikes
from numba.extending import lower_builtin

from .cache import KernelCache
from .waiting import announced

IDLE = NopythonRewrites, InlineClosureLikes
"""Passes that look for what kernels have none of: expressions of whole arrays, and functions within a function."""

_open = 0
"""How many kernels are being compiled at this moment, one within the other; changed under Numba's compiler lock."""

_parts: list[_Part] = []
"""Finished parts of the kernel that is being compiled."""

_apart: set[str] = set()
"""Symbols of parts that stay functions of their own."""


class _Engineless:
    """The code generator of a part, which has no address to write an environment to."""

    def __init__(self, codegen: Any) -> None:
        self._codegen = codegen

    def __getattr__(self, name: str) -> Any:
        return getattr(self._codegen, name)

    def set_env(self, name: str, env: Any) -> None:
        """Nothing: a part is never run by itself."""


class _Part(JITCodeLibrary):  # type: ignore[misc]
    """Code that is linked into a caller and never run by itself."""

    _packed: bytes | None = None

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self.called: list[Any] = []

    @property
    def codegen(self) -> Any:
        return _Engineless(self._codegen)

    def add_linking_library(self, library: Any) -> None:
        """What it calls, which is linked once, into the whole."""
        self.called.append(library)

    def finalize(self) -> None:
        """Left to the whole."""
        self._finalized = True

    def pack(self) -> None:
        """Keep the code in a tenth of the room, for callers that are compiled later."""
        self._packed = self.own().as_bitcode()
        self._final_module = self._shared_module = None

    def own(self) -> Any:
        """The code without what it calls."""
        return super()._get_module_for_linking() if self._packed is None else parse_bitcode(self._packed)

    def _get_module_for_linking(self) -> Any:
        """With what it calls, for a function that is no kernel."""
        module = self.own().clone()
        for library in dict.fromkeys(self.called):
            module.link_in(library._get_module_for_linking(), preserve=True)
        return module


class _Whole(JITCodeLibrary):  # type: ignore[misc]
    """Code that is optimised with all of its parts, which nothing else can call: what a part does not use of its
    arguments need not be handed to it."""

    def __init__(self, codegen: Any, name: str) -> None:
        super().__init__(codegen, name)
        self._called: list[_Part] = []

    def add_linking_library(self, library: Any) -> None:
        """What it calls."""
        if isinstance(library, _Part):
            self._called.append(library)
        else:
            super().add_linking_library(library)

    def finalize(self) -> None:
        """Link each part once, optimise, and make machine code."""
        for part in self._parts():
            self._final_module.link_in(part.own(), preserve=True)
        super().finalize()

    def _parts(self) -> list[_Part]:
        """All parts, each behind all that call it: what nothing has called yet the linker leaves out."""
        found: dict[_Part, None] = {}

        def visit(part: _Part) -> None:
            for inner in part.called:
                if not isinstance(inner, _Part):
                    super(_Whole, self).add_linking_library(inner)
                elif inner not in found:
                    visit(inner)
            found[part] = None

        for part in self._called:
            if part not in found:
                visit(part)
        return list(reversed(found))

    def _optimize_final_module(self) -> None:
        for function in self._final_module.functions:
            if function.is_declaration:
                assert not function.name.startswith("_ZN"), f"{function.name} is not linked"
            elif function.linkage == Linkage.linkonce_odr:
                function.linkage = Linkage.internal
                if function.name in _apart:
                    function.add_function_attribute("noinline")
        super()._optimize_final_module()


class PartMarker:
    """Stands where a compiled function of Python would: the key under which callers find the part."""

    def __call__(self, *args: Any) -> Any:
        raise RuntimeError("A part of a kernel has no code of its own")


class _Counts(NRTContext):  # type: ignore[misc]
    """References counted, without looking for any in what holds none.

    Numba takes a value apart down to its numbers to find what is counted, each time that it is handed on: of the
    intermediate code of a kernel, whose named tuples hold bare arrays, that is a good third, and none of it is used.
    """

    def get_meminfos(self, builder: Any, ty: Any, val: Any) -> Any:
        """The counted parts of a value."""
        return super().get_meminfos(builder, ty, val) if _counted(self._context.data_model_manager, ty) else []


@cache
def _counted(models: Any, kind: Any) -> bool:
    return bool(models[kind].contains_nrt_meminfo())


@register_pass(mutates_CFG=False, analysis_only=True)
class _ChooseLibrary(AnalysisPass):  # type: ignore[misc]
    """The outermost kernel gets a library that is optimised and run; one within it is a part."""

    _name = "flexarm_env_choose_library"

    def __init__(self) -> None:
        AnalysisPass.__init__(self)

    def run_pass(self, state: Any) -> bool:
        whole = _open == 1
        state.targetctx.nrt = _Counts(state.targetctx, state.targetctx.enable_nrt)  # of this compilation alone
        state.library = (_Whole if whole else _Part)(state.targetctx.codegen(), state.func_id.func_qualname)
        state.library.enable_object_caching()
        state.flags.no_compile = state.flags.no_cpython_wrapper = not whole
        return False


class _Compiler(Compiler):  # type: ignore[misc]
    def compile_extra(self, func: Any) -> Any:
        """Compile; who waits for it is told."""
        with announced(func) if _open == 1 else nullcontext():
            return super().compile_extra(func)

    def define_pipelines(self) -> Any:
        """The passes. What a kernel calls that is not a kernel is compiled as if anybody had called it first.

        Numba would have it inherit the caller's error model, and keep that for whoever calls it later.
        """
        ConfigStack().top().error_model = "python"
        pipelines = super().define_pipelines()
        nested = any(isinstance(constant, CodeType) for constant in self.state.func_id.code.co_consts)
        for pipeline in pipelines:
            pipeline.passes[:] = [one for one in pipeline.passes if one[0] not in ((IDLE[0],) if nested else IDLE)]
            pipeline.add_pass_after(_ChooseLibrary, NopythonTypeInference)
            pipeline.finalize()
        return pipelines


@contextmanager
def _outermost() -> Iterator[None]:
    """Without a search for garbage, since a compilation makes millions of objects, nearly all of which it still needs;
    its parts are packed at the end."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
        for part in _parts:
            part.pack()
    finally:
        _parts.clear()
        if was:
            gc.enable()


class KernelDispatcher(CPUDispatcher):  # type: ignore[misc]
    """A compiled function that is whole where Python calls it and a part where another kernel does."""

    def __init__(self, py_func: Any, locals: Any = None, targetoptions: Any = None) -> None:
        super().__init__(py_func, locals or {}, targetoptions or {}, pipeline_class=_Compiler)

    def enable_caching(self) -> None:
        """Keep compiled forms on disk."""
        self._cache = KernelCache(self.py_func)

    def compile(self, sig: Any) -> Any:
        """The entry point for argument types, from memory, from the disk or compiled now."""
        global _open
        with global_compiler_lock:
            args = tuple(sigutils.normalize_signature(sig)[0])
            found = self.overloads.get(args)
            if found is not None and (_open or not isinstance(found.entry_point, PartMarker)):
                return found.entry_point
            self.overloads.pop(args, None)
            _open += 1
            try:
                with _outermost() if _open == 1 else nullcontext():
                    return super().compile(sig) if _open == 1 else self._compile_part(args)
            finally:
                _open -= 1

    def _compile_part(self, args: Any) -> Any:
        with self._compiling_counter:
            made = self._compiler.compile(args, None)
            _parts.append(made.library)
            if getattr(self, "apart", False):
                _apart.add(made.fndesc.llvm_func_name)
            marker = PartMarker()
            self.targetctx.insert_user_function(marker, made.fndesc, [made.library])
            self.overloads[args] = made._replace(entry_point=marker, type_annotation="")  # all of the source is in it
            return marker


def form(function: Any, kinds: tuple[Any, ...]) -> tuple[Callable[..., Any], int]:
    """The compiled form for argument types: what Python calls without a look at the types, and its address."""
    function.compile(kinds)
    made = function.overloads[kinds]
    return made.entry_point, int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def call_native(builder: Any, function: Any, args: list[Any], failed: int) -> Any:
    """The call of a form's address with whole numbers, by Numba's calling convention; `failed` where it raises."""
    word, status, error = ir.IntType(64), ir.IntType(32), ir.IntType(8).as_pointer()
    kind = ir.FunctionType(status, [word.as_pointer(), error.as_pointer(), *[word for _ in args]])
    result, raised = builder.alloca(word), builder.alloca(error)
    code = builder.call(builder.inttoptr(function, kind.as_pointer()), [result, raised, *args])
    fine = builder.icmp_signed("==", code, status(0))
    return builder.select(fine, builder.load(result), word(failed))


def lower_as_call(function: Any, chosen: Callable[[Any], Any]) -> None:
    """Type and lower calls of `function` as calls of what `chosen` gives for the arguments' types."""

    def _type(context: Any, kinds: Any) -> Any:
        target = chosen(kinds)
        return types.Dispatcher(target) if isinstance(target, CPUDispatcher) else context.resolve_value_type(target)

    @infer_global(function)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            return _type(self.context, args).get_call_type(self.context, args, kws)

    @lower_builtin(function, types.VarArg(types.Any))
    def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        call = context.get_function(_type(context.typing_context, signature.args), signature)
        context.add_linking_libs(getattr(call, "libs", ()))
        return call(builder, args)
