"""An arm as a C library, or as a functional mock-up unit: the very programs that Python steps, linked."""

from .build import Built, write
from .fmu import write_controller_fmu, write_fmu

__all__ = ["Built", "write", "write_controller_fmu", "write_fmu"]
