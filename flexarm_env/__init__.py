"""Flexible robot arms in the plane and in space: simulation of scenes, and Gymnasium environments.

Importing the package registers FlexibleArm-v0, TwoLinkFlexArm-v0, MultiLinkFlexArm-v0, SpatialFlexArm-v0 and the tasks
of `flexarm_env.suite` with Gymnasium. The public names of the package are loaded when they are first used.
"""

from collections.abc import Mapping
from importlib import import_module
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from gymnasium.envs.registration import register, registry

__version__ = "0.2.0"

if TYPE_CHECKING:
    from .identification import identify
    from .parameters import Arm, Base, Elbow, Joint, Link, Motor, Payload, RigidLink, Section, Taper
    from .scene import Contact, JointTorque, Motion, PointLoad, Scene
    from .scenes import named
    from .sensors import Accelerometer, Camera, Encoder, Gyroscope, LowPass, Sensors, StrainGauge
    from .settings import Settings
    from .simulation import Simulation, simulate
    from .time_functions import TimeFunction
    from .trajectory import Trajectory

_HOME = {
    **dict.fromkeys(
        ("Arm", "Base", "Elbow", "Joint", "Link", "Motor", "Payload", "RigidLink", "Section", "Taper"), "parameters"
    ),
    **dict.fromkeys(("Contact", "JointTorque", "Motion", "PointLoad", "Scene"), "scene"),
    "named": "scenes",
    **dict.fromkeys(
        ("Accelerometer", "Camera", "Encoder", "Gyroscope", "LowPass", "Sensors", "StrainGauge"), "sensors"
    ),
    "identify": "identification",
    "Settings": "settings",
    **dict.fromkeys(("Simulation", "simulate"), "simulation"),
    "TimeFunction": "time_functions",
    "Trajectory": "trajectory",
}
"""Name of the module that defines each public name."""

__all__ = [
    "Accelerometer", "Arm", "Base", "Camera", "Contact", "Elbow", "Encoder", "Gyroscope", "Joint", "JointTorque",
    "Link", "LowPass", "Motion", "Motor", "Payload", "PointLoad", "RigidLink", "Scene", "Section", "Sensors",
    "Settings", "Simulation", "StrainGauge", "Taper", "TimeFunction", "Trajectory", "__version__", "identify",
    "named", "simulate",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that `import flexarm_env` stays light (PEP 562)."""
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOME[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOME})


_ENVIRONMENTS = {
    "FlexibleArm-v0": "flexible_arm:FlexibleArm",
    "TwoLinkFlexArm-v0": "two_link:TwoLinkFlexArm",
    "MultiLinkFlexArm-v0": "multi_link:MultiLinkFlexArm",
    "SpatialFlexArm-v0": "spatial:SpatialFlexArm",
}


def _register(env_id: str, environment: str, keywords: Mapping[str, Any]) -> None:
    if env_id not in registry:
        home = f"flexarm_env.envs.{_ENVIRONMENTS[environment]}"
        register(env_id, entry_point=f"{home}Env", vector_entry_point=f"{home}VectorEnv", kwargs=dict(keywords))


if "RemoteArm-v0" not in registry:
    register("RemoteArm-v0", entry_point="flexarm_env.remote.client:RemoteArmEnv")
for _id in _ENVIRONMENTS:
    _register(_id, _id, {})
if find_spec(f"{__name__}.suite"):  # the environments run without it
    from .suite.data import tasks as _tasks

    for _task in _tasks(earlier=True):
        _register(_task.registered, _task.environment, _task.arguments)
