"""An arm as a C library or a functional mock-up unit (FMU), linked from the compiled programs that Python steps."""

from .build import Built, write
from .fmu import write_controller_fmu, write_fmu

__all__ = ["Built", "write", "write_controller_fmu", "write_fmu"]
