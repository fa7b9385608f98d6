"""Linear models of an arm about a point of its motion: state space, equilibrium, natural frequencies and shapes."""

from .equilibrium import NoEquilibrium, static_equilibrium
from .state_space import LinearModel, linearize, set_state, state_of
from .vibration import Modes, modes

__all__ = [
    "LinearModel",
    "Modes",
    "NoEquilibrium",
    "linearize",
    "modes",
    "set_state",
    "state_of",
    "static_equilibrium",
]
