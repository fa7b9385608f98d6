"""Programs: a kernel with all that it calls, from its sources to machine code that C's rules can call.

Every program has one function of three whole numbers that returns one. It is given the address of the kernel's
arguments, or, called directly, of its one named tuple and two whole numbers (see `entry`).
"""

import ctypes
import gc
import os
import re
import struct
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import Any

from llvmlite import binding as llvm
from llvmlite import ir

from . import objects
from .arithmetic import number, whole
from .calls import call
from .decorator import Kernel
from .expressions import Expressions
from .front import SPARED, Module
from .kinds import WORD, Array, Integer, Layout, Narrow, Refused, Stored, Truth, is_static, is_tuple, told, width
from .lanes import EIGHT
from .source import source_of
from .symbols import Value, vector
from .waiting import announced

_LOCK = threading.RLock()

MAIN = "flexarm_main"


class Program:
    """Machine code. address: where it begins. call: it as a function of Python's. words: room that its result takes.

    made: whether it was compiled now, not read from the disk.
    """

    def __init__(self, code: bytes, spec: Any, made: bool) -> None:
        self.address = int(engine(code).get_function_address(MAIN))
        self.call: Callable[[int, int, int], int] = python_function(self.address)
        self.words, self.made, self._spec = _words(spec), made, spec

    def result(self, room: Any, begin: int) -> Any:
        """What was returned, from words that begin at a byte of a room."""
        found = iter(struct.unpack_from("q" * self.words, room, begin))
        return _value(self._spec, found)


def _words(spec: Any) -> int:
    if isinstance(spec, str):
        return 0 if spec == "none" else 1
    return 0 if spec[0] == "known" else sum(map(_words, spec[-1]))


def _tuples(known: Any) -> Any:
    """What JSON has made lists of, as it was."""
    return tuple(map(_tuples, known)) if isinstance(known, list | tuple) else known


def _value(spec: Any, found: Any) -> Any:
    if isinstance(spec, str):
        if spec == "none":
            return None
        word = next(found)
        if spec == "number":
            return struct.unpack("d", struct.pack("q", word))[0]
        return bool(word) if spec == "truth" else word % 2**64 if spec == "unsigned" else word
    if spec[0] == "known":
        return _tuples(spec[1])
    parts = [_value(part, found) for part in spec[-1]]
    return tuple(parts) if spec[0] == "tuple" else spec[1](*parts)


def program_of(kernel: Kernel, shapes: Sequence[Any], direct: bool) -> Program:
    """A kernel's program for arguments of such shapes (`kinds.described_as`): from the disk, or compiled now."""
    with _LOCK:
        key = objects.key_of(kernel.function, shapes, direct, *target_text())
        kept = objects.load(key)
        if kept is not None:
            return Program(*kept, made=False)
        with announced(kernel.function), _uncollected():
            code, spec, used = _compiled(kernel, shapes, direct, MAIN, machine())
        objects.save(key, code, spec, used)
        return Program(code, spec, made=True)


def _compiled(
    kernel: Kernel, shapes: Sequence[Any], direct: bool, name: str, made: Any
) -> tuple[bytes, Any, dict[Any, set[str]]]:
    """Machine code, under a name, what its result is, and the functions in it with the global names that they read."""
    module = Module(kernel.function.__name__, call, kernel.often)
    spec = _write(module, kernel, shapes, direct, name)
    module.spare()
    return machine_code(str(module.code), made), spec, module.used


def linkable(kernel: Kernel, layout: Layout, name: str, cpu: str | None) -> bytes:
    """A kernel's program as an object file to be linked: `name` (address of a placed named tuple, two whole numbers).

    cpu: by LLVM's name, its code anywhere in memory; None: this machine's. Bits are those of the program in Python.
    """
    shapes = [("placed", layout), "integer", "integer"]
    with _LOCK, announced(kernel.function), _uncollected():
        return _compiled(kernel, shapes, True, name, machine(cpu or target_text()[1], linked=True))[0]


@contextmanager
def _uncollected() -> Iterator[None]:
    """Python looks for no garbage: instructions are many and all in use, and looking would double what it takes.

    Afterwards it does once, and what LLVM and it have freed goes back to the system: tens of MB that no step needs."""
    before = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if before:
            gc.enable()
            gc.collect(0)
            _malloc_trim()(0)


@cache
def _malloc_trim() -> Callable[[int], int]:
    """glibc's; what does nothing where there is another C library."""
    library = ctypes.CDLL(None) if os.name == "posix" else None
    found: Callable[[int], int] = getattr(library, "malloc_trim", lambda room: 0)
    return found


def _write(module: Any, kernel: Kernel, shapes: Sequence[Any], direct: bool, name: str) -> Any:
    """The program's one function, under a name; returns what its result is."""
    code = ir.Function(module.code, ir.FunctionType(WORD, [WORD] * 3), name)
    writer = Expressions(module, code)
    b = writer.b
    if direct:
        layout = shapes[0][1]
        items = [Stored(b.inttoptr(code.args[0], WORD.as_pointer()), layout), *map(Integer, code.args[1 : len(shapes)])]
    else:
        at, items = 0, []
        address = b.inttoptr(code.args[0], WORD.as_pointer())
        for shape in shapes:
            if is_tuple(shape) and shape[0] == "placed":
                word = b.load(b.gep(address, [ir.Constant(WORD, at)], inbounds=True), align=8)
                items.append(Stored(b.inttoptr(word, WORD.as_pointer()), shape[1]))
                at += 1
            else:
                items.append(writer.loaded(address, shape, at))
                at += width(shape)
    found = call(writer, kernel, items, {})
    writer.closed()
    if direct:
        b.ret(ir.Constant(WORD, 0) if found is None else whole(b, found))
        return "none"
    out = b.inttoptr(code.args[1], WORD.as_pointer())
    try:
        spec, _ = _given(b, found, out, 0)
    except Refused as error:
        source = source_of(kernel.function)
        raise source.placed(error, source.tree.lineno) from None
    b.ret(ir.Constant(WORD, 0))
    return spec


def _given(b: Any, item: Any, out: Any, at: int) -> tuple[Any, int]:
    """Write a result to where Python reads it; what it is, and where the next one begins."""

    def put(word: Any) -> int:
        b.store(word, b.gep(out, [ir.Constant(WORD, at)], inbounds=True), align=8)
        return at + 1

    if item is None:
        return "none", at
    if isinstance(item, Truth):
        return "truth", put(b.zext(item.value, WORD))
    if isinstance(item, Integer):
        return "unsigned" if item.unsigned else "integer", put(item.value)
    if isinstance(item, Narrow) and item.letter == "b":
        return "integer", put(b.zext(item.value, WORD))
    if isinstance(item, Value | Narrow):
        value = number(b, item)
        if value.count > 1 or value.tangents:
            raise Refused(f"{told(value)} as a result: lanes are of use to kernels alone, which store them")
        return "number", put(b.bitcast(value.value, WORD))
    if isinstance(item, Array):
        raise Refused("an array as a result: give the kernel the array to write to")
    if is_static(item):
        return ["known", item], at
    values = item.values if hasattr(item, "values") else list(item)
    specs = []
    for value in values:
        spec, at = _given(b, value, out, at)
        specs.append(spec)
    return (["record", item.instance_class, specs] if hasattr(item, "values") else ["tuple", specs]), at


# --- LLVM ------------------------------------------------------------------------------------------


@cache
def target_text() -> tuple[str, str, str]:
    """What machine code depends on beside its sources: triple, processor, its features. FLEXARM_CPU names another
    processor to build for, by LLVM's name ("x86-64-v3")."""
    chosen = os.environ.get("FLEXARM_CPU")
    if chosen:
        return llvm.get_process_triple(), chosen, ""
    try:
        features = str(llvm.get_host_cpu_features().flatten())
    except RuntimeError:  # a processor that LLVM does not know to ask
        features = ""
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features


def machine(cpu: str | None = None, linked: bool = False) -> Any:
    """A target machine, this one where no processor is named; an engine takes one for itself. linked: its code goes
    into a shared library."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    _, own, features = target_text()
    where = {"reloc": "pic", "codemodel": "default"} if linked else {"reloc": "default", "codemodel": "jitdefault"}
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu or own, features=features if cpu in (None, own) else "", opt=3, jit=not linked, **where
    )


_ASKED = """
import sys
import llvmlite.binding as llvm
llvm.initialize_native_target()
llvm.initialize_native_asmprinter()
made = llvm.Target.from_default_triple().create_target_machine(cpu=sys.argv[1])
module = llvm.parse_assembly("define double @f(double %x) { ret double %x }")
module.triple, module.data_layout = made.triple, str(made.target_data)
made.emit_object(module)
"""


def is_processor(cpu: str) -> bool:
    """Whether LLVM makes code for a processor of this name, asked by a process of its own: another's name ends one."""
    if not re.fullmatch(r"[\w.+-]{1,64}", cpu, flags=re.ASCII) or cpu.startswith("-"):
        return False
    done = subprocess.run([sys.executable, "-c", _ASKED, cpu], capture_output=True, check=False)
    return done.returncode == 0 and not done.stderr and not done.stdout


def machine_code(text: str, made: Any) -> bytes:
    """The object file that intermediate code comes to on a machine. No fast-math, nothing contracted."""
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = made.triple, str(made.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    lanes = str(vector(len(EIGHT))) in text  # they fill the registers already
    options.loop_vectorization, options.slp_vectorization = not lanes, f" {SPARED}" in text
    builder = llvm.create_pass_builder(made, options)
    builder.getModulePassManager().run(module, builder)
    if options.slp_vectorization:  # the attribute was for the vectoriser; code is generated better without it
        module = llvm.parse_assembly(str(module).replace(f" {SPARED}", ""))
    return bytes(made.emit_object(module))


_engines: list[Any] = []
"""Machine code lives as long as the process."""


def engine(code: bytes) -> Any:
    """Object code, loaded."""
    empty = llvm.parse_assembly("")
    made = llvm.create_mcjit_compiler(empty, machine())
    made.add_object_file(llvm.ObjectFileRef.from_data(code))
    made.finalize_object()
    _engines.append(made)
    return made


# --- Python ----------------------------------------------------------------------------------------


class _Method(ctypes.Structure):
    """PyMethodDef of Python's C interface."""

    _fields_ = [("name", ctypes.c_char_p), ("call", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p)]


METH_FASTCALL = 0x0080


@cache
def _door() -> tuple[Any, Any]:
    """The definition of a function of Python's that calls an address, its own `self`, with three whole numbers; one
    of machine code, since a call through ctypes costs more than a control period of a small arm."""
    key = objects.key_of(_door_text, [], True, *target_text())
    kept = objects.load(key)
    code = kept[0] if kept else machine_code(_door_text(), machine())
    if not kept:
        objects.save(key, code, "none", {})
    address = engine(code).get_function_address("door")
    method = _Method(b"program", address, METH_FASTCALL, None)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes, make.restype = [ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p], ctypes.py_object
    return method, make


def python_function(address: int) -> Callable[[int, int, int], int]:
    """What calls the code at an address with three whole numbers (0 where they are missing), no lock held."""
    method, make = _door()
    made: Callable[[int, int, int], int] = make(ctypes.addressof(method), address, None)
    return made


def _door_text() -> str:
    """Machine code of the door: PyObject *door(PyObject *self, PyObject *const *args, Py_ssize_t nargs)."""
    module = ir.Module("door")
    thing = ir.IntType(8).as_pointer()

    def known(name: str, result: Any, *arguments: Any) -> Any:
        return ir.Function(module, ir.FunctionType(result, arguments), name)

    as_number = known("PyLong_AsLongLong", WORD, thing)
    made = known("PyLong_FromLongLong", thing, WORD)
    wrong = known("PyErr_Occurred", thing)
    save, restore = known("PyEval_SaveThread", thing), known("PyEval_RestoreThread", ir.VoidType(), thing)
    code = known("door", thing, thing, thing.as_pointer(), WORD)
    b = ir.IRBuilder(code.append_basic_block("entry"))
    failed = code.append_basic_block("failed")

    def read(item: Any) -> Any:
        """A whole number; an error of Python's where it is none."""
        value = b.call(as_number, [item])
        odd, go = code.append_basic_block("odd"), code.append_basic_block("go")
        b.cbranch(b.icmp_signed("==", value, ir.Constant(WORD, -1)), odd, go)
        b.position_at_end(odd)
        b.cbranch(b.icmp_unsigned("!=", b.call(wrong, []), ir.Constant(thing, None)), failed, go)
        b.position_at_end(go)
        return value

    address = read(code.args[0])
    rooms = [b.alloca(WORD) for _ in range(3)]
    for k, room in enumerate(rooms):
        b.store(ir.Constant(WORD, 0), room)
        there, on = code.append_basic_block("there"), code.append_basic_block("on")
        b.cbranch(b.icmp_signed(">", code.args[2], ir.Constant(WORD, k)), there, on)
        b.position_at_end(there)
        b.store(read(b.load(b.gep(code.args[1], [ir.Constant(WORD, k)]))), room)
        b.branch(on)
        b.position_at_end(on)
    function = b.inttoptr(address, ir.FunctionType(WORD, [WORD] * 3).as_pointer())
    state = b.call(save, [])
    result = b.call(function, [b.load(room) for room in rooms])
    b.call(restore, [state])
    b.ret(b.call(made, [result]))
    b.position_at_end(failed)
    b.ret(ir.Constant(thing, None))
    return str(module)
