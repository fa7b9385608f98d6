"""Programs: a kernel with all its callees, compiled to machine code with C's calling convention.

Each program has one function int64(int64, int64, int64). The function's arguments are the addresses of the kernel's
arguments and of the kernel's result. In a direct call the arguments are the address of the kernel's one named tuple and
up to two integers (see `entry`).
"""

import ctypes
import gc
import os
import struct
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
from .front import Module
from .kinds import (
    WORD,
    Array,
    Integer,
    Layout,
    Narrow,
    Record,
    Refused,
    Stored,
    Truth,
    is_static,
    is_tuple,
    told,
    width,
)
from .source import source_of
from .symbols import Value, declared_function
from .target import NEAR, checked_machine, machine, machine_code, target_text
from .waiting import announced

_LOCK = threading.RLock()
"""Held while a program is compiled or loaded: all LLVM modules of a process share one context."""


def _renew_lock() -> None:
    """Replace the lock by a new one in a forked child process."""
    global _LOCK
    _LOCK = threading.RLock()


# a fork waits for a compilation to end, since its threads do not exist in the child
if hasattr(os, "register_at_fork"):
    os.register_at_fork(
        before=lambda: _LOCK.acquire(), after_in_parent=lambda: _LOCK.release(), after_in_child=_renew_lock
    )

MAIN = "flexarm_main"


class Program:
    """Machine code of one kernel for one specialization.

    address: address of the machine code.
    call: the machine code as a Python function of three integers.
    words: number of 8-byte words of the result.
    made: True if compiled by this process, False if loaded from disk.
    """

    def __init__(self, code: bytes, spec: Any, made: bool) -> None:
        """Load the object file `code` into memory; spec: type of the result."""
        self.address = int(engine(code).get_function_address(MAIN))
        self.call: Callable[[int, int, int], int] = python_function(self.address)
        self.words, self.made, self._spec = _words(spec), made, spec

    def result(self, room: Any, begin: int) -> Any:
        """Return the kernel's result, decoded from the buffer `room`, where the result begins at byte `begin`."""
        found = iter(struct.unpack_from("q" * self.words, room, begin))
        return _value(self._spec, found)


def _words(spec: Any) -> int:
    """Return the number of 8-byte words of a result with this spec (type description)."""
    if isinstance(spec, str):
        return 0 if spec == "none" else 1
    return 0 if spec[0] == "known" else sum(map(_words, spec[-1]))


def _tuples(known: Any) -> Any:
    """Convert JSON's lists back to tuples, at all depths."""
    return tuple(map(_tuples, known)) if isinstance(known, list | tuple) else known


def _value(spec: Any, found: Any) -> Any:
    """Decode a value of a result spec (see `_given`) from the iterator `found` of 64-bit words."""
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
    """Return a kernel's program for the argument types `shapes` (`kinds.described_as`): from disk or compiled now."""
    with _LOCK:
        key = objects.key_of(kernel.function, shapes, direct, *target_text())
        kept = objects.load(key)
        if kept is not None:
            return Program(*kept, made=False)
        with announced(kernel.function), _uncollected():
            code, spec, used = _compiled(kernel, shapes, direct, MAIN, checked_machine())
        objects.save(key, code, spec, used)
        return Program(code, spec, made=True)


def _compiled(
    kernel: Kernel, shapes: Sequence[Any], direct: bool, name: str, made: Any
) -> tuple[bytes, Any, dict[Any, set[str]]]:
    """Compile a kernel to an object file with one function `name`; return (bytes, result spec, global names read)."""
    module = Module(kernel.function.__name__, call, kernel.often)
    spec = _write(module, kernel, shapes, direct, name)
    module.spare()
    try:
        return machine_code(module.text(), made), spec, module.used
    except RuntimeError as error:
        source = source_of(kernel.function)
        raise source.placed(Refused(f"LLVM: {error}"), source.tree.lineno) from error


def linkable(kernel: Kernel, layout: Layout, name: str, cpu: str | None) -> bytes:
    """Return an object file for linking, with the function `name`(address of the kernel's named tuple, two integers).

    cpu: LLVM's name of the target processor; None for this machine's. Results have the same bits as in Python.
    """
    shapes = [("placed", layout), "integer", "integer"]
    with _LOCK, announced(kernel.function), _uncollected():
        made = machine(cpu, linked=True) if cpu else checked_machine(linked=True)
        return _compiled(kernel, shapes, True, name, made)[0]


@contextmanager
def _uncollected() -> Iterator[None]:
    """Pause Python's garbage collection while LLVM code is built, because its many objects are all in use.

    The collection would double the compile time. After compilation Python's garbage is collected once, which frees tens
    of MB of memory.
    """
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
    """Return glibc's `malloc_trim`; a no-op with any other C library."""
    library = ctypes.CDLL(None) if os.name == "posix" else None
    found: Callable[[int], int] = getattr(library, "malloc_trim", lambda room: 0)
    return found


def _write(module: Any, kernel: Kernel, shapes: Sequence[Any], direct: bool, name: str) -> Any:
    """Emit the program's function, which unpacks the arguments, calls the kernel and packs the result; return the spec.

    direct: the arguments are (address of a named tuple, integers), and the result is the returned integer. Otherwise
    they are (address of the packed arguments, address of the result).
    """
    code = ir.Function(module.code, ir.FunctionType(WORD, [WORD] * 3), name)
    writer = Expressions(module, code)
    b = writer.b
    if direct:
        # arguments are passed in registers
        layout = shapes[0][1]
        items = [Stored(b.inttoptr(code.args[0], WORD.as_pointer()), layout), *map(Integer, code.args[1 : len(shapes)])]
    else:
        # arguments lie in a row of words; a placed named tuple is an address among them
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
        spec, _ = _given(b, _whole(writer, found), out, 0)
    except Refused as error:
        source = source_of(kernel.function)
        raise source.placed(error, source.tree.lineno) from None
    b.ret(ir.Constant(WORD, 0))
    return spec


def _whole(writer: Any, item: Any) -> Any:
    """Replace named tuples in memory within a result by `Record`s of their fields."""
    if isinstance(item, Stored | Record):
        return Record(item.instance_class, [_whole(writer, part) for part in writer.parts(item)])
    return tuple(_whole(writer, part) for part in item) if is_tuple(item) and not is_static(item) else item


def _given(b: Any, item: Any, out: Any, at: int) -> tuple[Any, int]:
    """Emit code that stores a result in `out`, from element `at` on; return the result's spec and the next free index.

    Specs: "none", "truth", "integer", "unsigned", "number", ["known", value], ["tuple", specs],
    ["record", class, specs].
    """

    def put(word: Any) -> int:
        """Emit the store of a word; return the index of the next word."""
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
    named = isinstance(item, Record)
    specs = []
    for value in item.values if named else item:
        spec, at = _given(b, value, out, at)
        specs.append(spec)
    return (["record", item.instance_class, specs] if named else ["tuple", specs]), at


_engines: list[Any] = []
"""LLVM execution engines of this process, whose machine code must remain in memory until the process ends."""


def engine(code: bytes) -> Any:
    """Load an object file into memory; return its LLVM execution engine."""
    empty = llvm.parse_assembly("")
    # llvmlite's memory manager places code and constants in one block
    made = llvm.create_mcjit_compiler(empty, machine(), use_lmm=NEAR or None)
    made.add_object_file(llvm.ObjectFileRef.from_data(code))
    made.finalize_object()
    _engines.append(made)
    return made


# --- Python ----------------------------------------------------------------------------------------


class _Method(ctypes.Structure):
    """The structure PyMethodDef of Python's C API."""

    _fields_ = [("name", ctypes.c_char_p), ("call", ctypes.c_void_p), ("flags", ctypes.c_int), ("doc", ctypes.c_char_p)]


METH_FASTCALL = 0x0080


@cache
def _door() -> tuple[Any, Any]:
    """Return (PyMethodDef, PyCFunction_NewEx): with them `python_function` makes a callable of machine code.

    The C function of the PyMethodDef, `_door_text`, calls the address in its `self`, a Python int. `_door_text` is
    machine code, because a call through ctypes takes longer than the computation of a small arm's control period.
    """
    key = objects.key_of(_door_text, [], True, *target_text())
    kept = objects.load(key)
    code = kept[0] if kept else machine_code(_door_text(), checked_machine())
    if not kept:
        objects.save(key, code, "none", {})
    address = engine(code).get_function_address("door")
    method = _Method(b"program", address, METH_FASTCALL, None)
    make = ctypes.pythonapi.PyCFunction_NewEx
    make.argtypes, make.restype = [ctypes.c_void_p, ctypes.py_object, ctypes.c_void_p], ctypes.py_object
    return method, make


def python_function(address: int) -> Callable[[int, int, int], int]:
    """Return a function of up to three integers (default 0) that runs the code at an address without the GIL."""
    method, make = _door()
    made: Callable[[int, int, int], int] = make(ctypes.addressof(method), address, None)
    return made


def _door_text() -> str:
    """Return LLVM assembly of PyObject *door(PyObject *self, PyObject *const *args, Py_ssize_t nargs).

    The door converts self (an address) and the arguments to int64, calls the address without the GIL, returns int64.
    """
    module = ir.Module("door")
    thing = ir.IntType(8).as_pointer()

    def known(name: str, result: Any, *arguments: Any) -> Any:
        """Add the declaration of an external function to the LLVM module."""
        return declared_function(module, name, ir.FunctionType(result, arguments))

    as_number = known("PyLong_AsLongLong", WORD, thing)
    made = known("PyLong_FromLongLong", thing, WORD)
    wrong = known("PyErr_Occurred", thing)
    save, restore = known("PyEval_SaveThread", thing), known("PyEval_RestoreThread", ir.VoidType(), thing)
    code = known("door", thing, thing, thing.as_pointer(), WORD)
    b = ir.IRBuilder(code.append_basic_block("entry"))
    failed = code.append_basic_block("failed")

    def read(item: Any) -> Any:
        """Convert a Python int to int64; branch to `failed` if that raised an exception."""
        value = b.call(as_number, [item])
        odd, go = code.append_basic_block("odd"), code.append_basic_block("go")
        b.cbranch(b.icmp_signed("==", value, ir.Constant(WORD, -1)), odd, go)
        b.position_at_end(odd)
        b.cbranch(b.icmp_unsigned("!=", b.call(wrong, []), ir.Constant(thing, None)), failed, go)
        b.position_at_end(go)
        return value

    address = read(code.args[0])
    # arguments beyond nargs are 0
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
    # release the GIL during the call
    state = b.call(save, [])
    result = b.call(function, [b.load(room) for room in rooms])
    b.call(restore, [state])
    b.ret(b.call(made, [result]))
    b.position_at_end(failed)
    b.ret(ir.Constant(thing, None))
    return str(module)
