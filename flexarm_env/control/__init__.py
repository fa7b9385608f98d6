"""Model-based controllers, and trained policies run with NumPy alone.

    from flexarm_env.control import make
    env = gymnasium.make("FlexibleArm-v0")
    controller = make("lqr", env)
    observation, _ = env.reset(seed=0)
    controller.reset(observation)
    action = controller.act(observation)

All controllers read only the environment's observation, are designed for the nominal arm, and keep its torque limits.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .base import Controller, Setup
    from .catalogue import NAMES, make
    from .force import ForceGains, HybridForce
    from .lqg import LQG, LQGGains
    from .lqr import LQR, LQRGains
    from .mpc import MPC, MPCGains
    from .pd import PD, PDGains
    from .policy import AroundPolicy, NumpyPolicy, policy_names
    from .shaping import ShapedGains, ShapedPD, Shaper, zv, zvd
    from .sources import NamedPolicy, find_policy, load_policy
    from .time_optimal import Plan, TimeOptimal, TimeOptimalGains, plan, rigid_time

_HOME = {
    **dict.fromkeys(("Controller", "Setup"), "base"),
    **dict.fromkeys(("NAMES", "make"), "catalogue"),
    **dict.fromkeys(("ForceGains", "HybridForce"), "force"),
    **dict.fromkeys(("LQG", "LQGGains"), "lqg"),
    **dict.fromkeys(("LQR", "LQRGains"), "lqr"),
    **dict.fromkeys(("MPC", "MPCGains"), "mpc"),
    **dict.fromkeys(("PD", "PDGains"), "pd"),
    **dict.fromkeys(("AroundPolicy", "NumpyPolicy", "policy_names"), "policy"),
    **dict.fromkeys(("ShapedGains", "ShapedPD", "Shaper", "zv", "zvd"), "shaping"),
    **dict.fromkeys(("NamedPolicy", "find_policy", "load_policy"), "sources"),
    **dict.fromkeys(("Plan", "TimeOptimal", "TimeOptimalGains", "plan", "rigid_time"), "time_optimal"),
}
"""Module that defines each public name. Environments use some modules of this package, but no controller."""

__all__ = [
    "LQG", "LQR", "MPC", "NAMES", "PD", "AroundPolicy", "Controller", "ForceGains", "HybridForce", "LQGGains",
    "LQRGains", "MPCGains", "NamedPolicy", "NumpyPolicy", "PDGains", "Plan", "Setup", "ShapedGains", "ShapedPD",
    "Shaper", "TimeOptimal", "TimeOptimalGains", "find_policy", "load_policy", "make", "plan", "policy_names",
    "rigid_time", "zv", "zvd",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    globals()[name] = getattr(import_module(f".{_HOME[name]}", __name__), name)
    return globals()[name]
