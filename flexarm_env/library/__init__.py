"""Export an arm as a C library or functional mock-up unit (FMU), with the same machine code that Python executes."""

from .build import Built, write
from .fmu import write_controller_fmu, write_fmu

__all__ = ["Built", "write", "write_controller_fmu", "write_fmu"]
