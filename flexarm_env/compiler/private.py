"""What the compiler uses of Numba that Numba does not promise to keep, and which compiler serves here.

*Whole* is fast to compile and rests on the names below, in `whole.py` and `cache.py` alone; *plain* does without them:
everything else in this room uses `numba`, `numba.extending`, what the two hand to an intrinsic, and `llvmlite.ir`.
`FLEXARM_COMPILER=plain|whole` chooses. Not set, it is whole, and plain where `selfcheck` misses something.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import logging
import os
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numba

VARIABLE = "FLEXARM_COMPILER"
MODES = ("whole", "plain")

JIT, NONE = "`numba.jit`: every function optimised at every level", "nothing is kept on disk"
CALL = "`numba.extending.overload`: one library more for each choice"

NAMES: dict[str, tuple[str, str]] = {
    "numba.core.compiler.Compiler.define_pipelines": ("passes of a kernel", JIT),
    "numba.core.compiler.Compiler.compile_extra": ("to say who is being waited for", "no line is logged"),
    "numba.core.compiler_lock.global_compiler_lock": ("to count how deep a compilation is", JIT),
    "numba.core.compiler_machinery.AnalysisPass": ("a pass that chooses whole or part", JIT),
    "numba.core.compiler_machinery.register_pass": ("the same", JIT),
    "numba.core.compiler_machinery.PassManager.add_pass_after": ("the same", JIT),
    "numba.core.compiler_machinery.PassManager.finalize": ("the same", JIT),
    "numba.core.typed_passes.NopythonTypeInference": ("the pass after which it is chosen", JIT),
    "numba.core.typed_passes.NopythonRewrites": ("a pass that finds nothing in a kernel, left out", JIT),
    "numba.core.untyped_passes.InlineClosureLikes": ("the same", JIT),
    "numba.core.targetconfig.ConfigStack.top": (
        "what a kernel calls does not inherit its error model",
        "Numba's rule: a function without an error model of its own takes that of whoever calls it first",
    ),
    "numba.core.compiler.Flags.no_compile": ("a part has no machine code", JIT),
    "numba.core.compiler.Flags.no_cpython_wrapper": ("nor a form that Python calls", JIT),
    "numba.core.codegen.JITCodeLibrary.codegen": ("a library of code that is not optimised by itself", JIT),
    "numba.core.codegen.JITCodeLibrary.enable_object_caching": ("the same", JIT),
    "numba.core.codegen.JITCodeLibrary._optimize_final_module": ("the same", JIT),
    "numba.core.codegen.JITCodeLibrary.finalize": ("the same", JIT),
    "numba.core.codegen.JITCodeLibrary.add_linking_library": ("to link a part once, into the whole", JIT),
    "numba.core.codegen.JITCodeLibrary._get_module_for_linking": ("the same, and to keep a part packed", JIT),
    "numba.core.codegen.JITCPUCodegen.set_env": ("a part's environment has no address", JIT),
    "numba.core.registry.CPUDispatcher": ("a kernel, callable from Python and from kernels", JIT),
    "numba.core.dispatcher._FunctionCompiler.compile": ("to compile a part", JIT),
    "numba.core.compiler.CompileResult._replace": ("to file a part among the compiled forms", JIT),
    "numba.core.cpu.CPUContext.insert_user_function": ("to let callers find a part", JIT),
    "numba.core.runtime.context.NRTContext.get_meminfos": ("not to look for references where there are none", JIT),
    "numba.core.base.BaseContext.nrt": ("the same", JIT),
    "numba.core.sigutils.normalize_signature": ("argument types of a signature", JIT),
    "numba.core.registry.CPUDispatcher.compile": ("a kernel's form for types (`entry`)", "a call of the dispatcher"),
    "numba.core.codegen.JITCodeLibrary.get_pointer_to_function": ("where a form's code begins", "`numba.cfunc`"),
    "numba.core.funcdesc.PythonFunctionDescriptor.llvm_func_name": ("the same", "`numba.cfunc`"),
    "numba.core.callconv.CPUCallConv.get_function_type": ("the calling convention is checked by it", "C's own"),
    "numba.core.typing.templates.AbstractTemplate": ("the type of a call by class or kind of an argument", CALL),
    "numba.core.typing.templates.infer_global": ("the same", CALL),
    "numba.core.types.Dispatcher.get_call_type": ("the same", CALL),
    "numba.core.typing.context.BaseContext.resolve_value_type": ("the same", CALL),
    "numba.core.base.BaseContext.get_function": ("the call itself", CALL),
    "numba.core.base.BaseContext.add_linking_libs": ("the same", CALL),
    "numba.core.caching.NullCache": ("what a dispatcher asks for compiled forms", NONE),
    "numba.core.caching.CompileResultCacheImpl": ("the folder that Numba would choose", NONE),
    "numba.core.compiler.CompileResult._reduce": ("a compiled form as data", NONE),
    "numba.core.compiler.CompileResult._rebuild": ("and back", NONE),
    "numba.core.serialize.dumps": ("the data as bytes", NONE),
    "numba.core.codegen.JITCPUCodegen.magic_tuple": ("the processor that a form is for", NONE),
    "numba.core.codegen.JITCodeLibrary.has_dynamic_globals": ("whether a form holds addresses", NONE),
    "numba.core.cpu.CPUContext.refresh": ("before a form is loaded", NONE),
}
"""Dotted name: what whole mode uses it for, and what stands for it in plain mode."""

MEMBERS: dict[str, tuple[str, str]] = {
    "_cache": ("where a dispatcher asks for compiled forms", NONE),
    "_compiler": ("what compiles", JIT),
    "_compiling_counter": ("to notice recursion", JIT),
    "overloads": ("compiled forms by argument types", "a call of the dispatcher"),
    "targetctx": ("the context of compilation", JIT),
    "py_func": ("the function itself (Numba documents it)", "the same"),
}
"""Attributes of a dispatcher: the same."""

CONVENTION = "i32 (i64*, {i8*, i32, i8*, i8*, i32}**, i64, i64)"
"""A compiled function of two whole numbers, as LLVM has it: status; where the result and the error go; numbers."""


def _found(dotted: str) -> Any:
    """The object of a dotted name; AttributeError or ImportError where there is none."""
    parts = dotted.split(".")
    for length in range(len(parts) - 1, 0, -1):
        try:
            found: Any = importlib.import_module(".".join(parts[:length]))
        except ModuleNotFoundError as error:
            if error.name is not None and not dotted.startswith(error.name):
                raise
            continue
        for name in parts[length:]:
            found = getattr(found, name)
        return found
    raise ImportError(dotted)


def _takes(dotted: str, *names: str) -> bool:
    """Whether a function's first parameters (after self) have these names."""
    own = [name for name in inspect.signature(_found(dotted)).parameters if name not in ("self", "cls")]
    return tuple(own[: len(names)]) == names


def _calls() -> bool:
    from numba.core import registry, types

    kind = registry.cpu_target.target_context.call_conv.get_function_type(types.int64, (types.int64,) * 2)
    return str(kind) == CONVENTION


def _passes() -> bool:
    from numba.core.compiler import DefaultPassBuilder, Flags
    from numba.core.typed_passes import NopythonTypeInference

    passes = DefaultPassBuilder.define_typed_pipeline(SimpleNamespace(flags=Flags())).passes
    return any(kind is NopythonTypeInference for kind, _ in passes)


def _counts() -> bool:
    from numba.core.base import BaseContext

    kept = isinstance(inspect.getattr_static(BaseContext, "nrt"), functools.cached_property)
    return kept and _takes("numba.core.runtime.context.NRTContext.__init__", "context", "enabled")


_DISPATCHER, _CACHE = "numba.core.registry.CPUDispatcher", "numba.core.caching.NullCache"
CONVENTIONS: dict[str, Callable[[], bool]] = {
    f"a compiled function is {CONVENTION}": _calls,
    "type inference is one of the passes": _passes,
    "a dispatcher is made of py_func, locals, targetoptions and pipeline_class": lambda: _takes(
        f"{_DISPATCHER}.__init__", "py_func", "locals", "targetoptions", "pipeline_class"
    ),
    "references are counted by an object of context and enabled, kept in a context's nrt": _counts,
    "a dispatcher compiles a signature": lambda: _takes(f"{_DISPATCHER}.compile", "sig"),
    "a part is compiled from args and return_type": lambda: _takes(
        "numba.core.dispatcher._FunctionCompiler.compile", "args", "return_type"
    ),
    "a library is made of codegen and name": lambda: _takes(
        "numba.core.codegen.CodeLibrary.__init__", "codegen", "name"
    ),
    "forms are asked for by sig and target_context": lambda: _takes(f"{_CACHE}.load_overload", "sig", "target_context"),
    "forms are handed over as sig and cres": lambda: _takes(f"{_CACHE}.save_overload", "sig", "cres"),
    "a form is made again of a target_context and its data": lambda: _takes(
        "numba.core.compiler.CompileResult._rebuild", "target_context"
    ),
}
"""What is relied upon beside names, in words, and whether it holds."""


def selfcheck() -> list[str]:
    """A sentence for each name or convention of Numba that whole mode relies on and that does not hold; [] is good."""
    return list(_faults())


def _faults() -> Iterator[str]:
    version = f"Numba {numba.__version__}"
    for dotted, (use, _) in NAMES.items():
        try:
            _found(dotted)
        except Exception as error:  # whatever an import may raise
            yield f"{version} has no {dotted} ({use}): {type(error).__name__}"
    made = numba.njit(_nothing)
    for name, (use, _) in MEMBERS.items():
        if not hasattr(made, name):
            yield f"a dispatcher of {version} has no {name} ({use})"
    for words, holds in CONVENTIONS.items():
        try:
            good = holds()
        except Exception:  # whatever a changed Numba may raise
            good = False
        if not good:
            yield f"with {version} it is not so that {words}"


def _nothing() -> None:
    """A function for a dispatcher that is never called."""


def _choose() -> tuple[str, str]:
    """The mode, and a sentence that says why."""
    chosen = os.environ.get(VARIABLE, "")
    if numba.config.DISABLE_JIT:
        return "whole", "nothing is compiled (NUMBA_DISABLE_JIT)"
    if chosen == "plain":
        return "plain", f"plain ({VARIABLE}): public Numba alone; every process compiles anew"
    if chosen not in ("", *MODES):
        raise ValueError(f"{VARIABLE} = {chosen!r}: must be 'whole' or 'plain'")
    faults = selfcheck()
    if not faults:
        return "whole", "whole: a kernel is optimised once"
    if chosen:
        raise RuntimeError(f"{VARIABLE} = 'whole': {'; '.join(faults)}; leave it unset for the plain compiler")
    why = f"{faults[0]}{f' (and {len(faults) - 1} more)' if len(faults) > 1 else ''}"
    text = f"plain, because {why}; compiling takes longer, and every process compiles anew"
    logging.getLogger("flexarm_env").warning("flexarm_env: the compiler is %s", text)
    return "plain", text


MODE, WHY = _choose()
"""The compiler that serves in this process, "whole" or "plain", and the sentence of `flexarm doctor`."""
