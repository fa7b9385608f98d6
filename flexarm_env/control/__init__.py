"""Model-based controllers, and trained policies that need only NumPy.

    from flexarm_env.control import make
    env = gymnasium.make("FlexibleArm-v0")
    controller = make("lqr", env)
    observation, _ = env.reset(seed=0)
    controller.reset(observation)
    action = controller.act(observation)

All controllers read only the environment's observation. The controllers are designed for the nominal arm, and their
torques stay within the arm's torque limits.
"""

from .base import Controller, Setup
from .catalogue import FORCE_NAMES, NAMES, make
from .force import ForceGains, HybridForce, Impedance, ImpedanceGains
from .lqg import LQG, LQGGains
from .lqr import LQR, LQRGains
from .lqr_force import LQRForce, LQRForceGains
from .mpc import MPC, MPCGains
from .mpc_force import MPCForce, MPCForceGains
from .pd import PD, PDGains
from .policy import AroundPolicy, NumpyPolicy
from .policy import names as policy_names
from .shaping import ShapedGains, ShapedPD, Shaper, zv, zvd
from .sources import NamedPolicy, find_policy, load_policy
from .time_optimal import Plan, TimeOptimal, TimeOptimalGains, plan, rigid_time

__all__ = [
    "FORCE_NAMES", "LQG", "LQR", "MPC", "NAMES", "PD", "AroundPolicy", "Controller", "ForceGains", "HybridForce",
    "Impedance", "ImpedanceGains", "LQGGains", "LQRForce", "LQRForceGains", "LQRGains", "MPCForce", "MPCForceGains",
    "MPCGains", "NamedPolicy", "NumpyPolicy", "PDGains", "Plan", "Setup", "ShapedGains", "ShapedPD", "Shaper",
    "TimeOptimal", "TimeOptimalGains", "find_policy", "load_policy", "make", "plan", "policy_names", "rigid_time", "zv",
    "zvd",
]  # fmt: skip
