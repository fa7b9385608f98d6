"""Exchange of arms with other programs: chains of rigid bodies for MuJoCo (MJCF) and ROS (URDF), and arms from both.

chain_of        converts an arm to rigid bodies joined by hinges and springs
mjcf, urdf      write such a chain as the text of a file
import_arm      reads an arm from a robot's URDF or MJCF file
differences     compares a chain with its arm
"""

from .chain import Body, Chain, Hinge, chain_of
from .linear import chain_modes, tip_compliance
from .mjcf import choose_integrator, mjcf
from .reader import Imported, import_arm
from .report import calibrated, differences
from .urdf import urdf

__all__ = [
    "Body", "Chain", "Hinge", "Imported", "calibrated", "chain_modes", "chain_of", "choose_integrator", "differences",
    "import_arm", "mjcf", "tip_compliance", "urdf",
]  # fmt: skip
