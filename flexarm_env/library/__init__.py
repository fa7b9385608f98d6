"""An arm as a C library: the very programs that Python steps, linked; see `build.write`."""

from .build import Built, write

__all__ = ["Built", "write"]
