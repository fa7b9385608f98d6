"""Compute static equilibria, and linear models about a state: state-space models, natural frequencies, mode shapes."""

from ..rest import NoEquilibrium
from .campbell import Campbell, campbell
from .equilibrium import Equilibrium, UnstableEquilibrium, static_equilibrium
from .many import LinearModels
from .stability import Stability
from .state_space import LinearModel, linearize, set_state, state_of
from .vibration import Modes, modes

__all__ = [
    "Campbell",
    "Equilibrium",
    "LinearModel",
    "LinearModels",
    "Modes",
    "NoEquilibrium",
    "Stability",
    "UnstableEquilibrium",
    "campbell",
    "linearize",
    "modes",
    "set_state",
    "state_of",
    "static_equilibrium",
]
