"""Remote operation over UDP: a server that runs an arm in real time, a client environment, and policies that drive it.

The server is no safety system. A real arm needs its own hardware for safety.
"""

from .client import Played, RemoteArmEnv, Wire, run_policy
from .packet import MOST_NUMBERS, Kind, Packet, Refusal, pack, unpack
from .server import Limits, Server, Session

__all__ = [
    "MOST_NUMBERS", "Kind", "Limits", "Packet", "Played", "Refusal", "RemoteArmEnv", "Server", "Session", "Wire",
    "pack", "run_policy", "unpack",
]  # fmt: skip
