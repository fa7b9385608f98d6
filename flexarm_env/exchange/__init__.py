"""Export arms to MuJoCo (MJCF) and ROS (URDF) as chains of rigid bodies, and import arms from files of both formats.

chain_of        approximates an arm by rigid bodies that hinges and springs connect
mjcf, urdf      return such a chain as the text of an MJCF or URDF file
import_arm      reads an arm from a robot's URDF or MJCF file
differences     compares a chain with the arm that it approximates
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
