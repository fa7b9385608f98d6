"""Target of machine code: LLVM's description of a processor, and LLVM's optimization for it."""

import os
import platform
import re
import subprocess
import sys
from functools import cache
from typing import Any

from llvmlite import binding as llvm

from .front import SPARED
from .lanes import EIGHT
from .symbols import vector

NEAR = sys.platform == "linux" and platform.machine() == "x86_64"
"""Whether machine code addresses its constants relative to the instruction, within 2 GB (LLVM's code model "small").

LLVM's default for code in memory loads each constant's 64-bit address first, which takes an instruction more.
"""


@cache
def target_text() -> tuple[str, str, str]:
    """Return the target of machine code as text: target triple, processor, processor features.

    FLEXARM_CPU names another processor to compile for, by LLVM's name ("x86-64-v3").
    """
    chosen = os.environ.get("FLEXARM_CPU")
    if chosen:
        return llvm.get_process_triple(), chosen, ""
    try:
        features = str(llvm.get_host_cpu_features().flatten())
    except RuntimeError:
        # LLVM cannot query this processor
        features = ""
    return llvm.get_process_triple(), llvm.get_host_cpu_name(), features


def machine(cpu: str | None = None, linked: bool = False) -> Any:
    """Make an LLVM target machine for the processor `cpu`; if `linked`, for position-independent code.

    Each execution engine takes ownership of its own machine.
    """
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    _, own, features = target_text()
    where = {"reloc": "default", "codemodel": "jitdefault"}
    if linked or NEAR:
        where = {"reloc": "pic", "codemodel": "default" if linked else "small"}
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=cpu or own, features=features if cpu in (None, own) else "", opt=3, jit=not linked, **where
    )


def checked_machine(linked: bool = False) -> Any:
    """Make the LLVM target machine for programs. Raises ValueError if LLVM does not know the processor FLEXARM_CPU."""
    _check_chosen(os.environ.get("FLEXARM_CPU"))
    return machine(linked=linked)


@cache
def _check_chosen(cpu: str | None) -> None:
    """Raise ValueError if LLVM does not know the processor that FLEXARM_CPU names."""
    if cpu and not is_processor(cpu):
        raise ValueError(
            f"FLEXARM_CPU = {cpu!r}: must be a processor's name that LLVM knows, 'x86-64-v3' for example, or not set"
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
    """Return whether LLVM generates code for a processor name; tested in a child process, because LLVM may exit."""
    if not re.fullmatch(r"[\w.+-]{1,64}", cpu, flags=re.ASCII) or cpu.startswith("-"):
        return False
    done = subprocess.run([sys.executable, "-c", _ASKED, cpu], capture_output=True, check=False)
    return done.returncode == 0 and not done.stderr and not done.stdout


def machine_code(text: str, made: Any) -> bytes:
    """Optimize LLVM assembly and return the object file, without fast-math or contraction of products and sums."""
    module = llvm.parse_assembly(text)
    module.triple, module.data_layout = made.triple, str(made.target_data)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    lanes = str(vector(len(EIGHT))) in text
    # lanes fill the vector registers already; SLP only for programs with large `superword` kernels
    options.loop_vectorization, options.slp_vectorization = not lanes, f" {SPARED}" in text
    builder = llvm.create_pass_builder(made, options)
    builder.getModulePassManager().run(module, builder)
    # the attribute is meant for the vectorizer only; code generation is better without it
    if options.slp_vectorization:
        module = llvm.parse_assembly(str(module).replace(f" {SPARED}", ""))
    return bytes(made.emit_object(module))
