"""Mechanics of arms: for each formulation the assembly (in NumPy) and compiled equations; time integration for all."""

from .elastica import equations as _elastica
from .exact import equations as _exact
from .floating import chain as _floating
from .floating import multipliers as _joined
from .joints import equations as _jointed
from .space import adjoint as _space_adjoint
from .space import equations as _space

__all__: list[str] = []
FORMULATIONS = (_elastica, _exact, _floating, _joined, _jointed, _space, _space_adjoint)
"""Modules of the formulations; the import of a module registers its formulation's kernels (`protocol.register`)."""
