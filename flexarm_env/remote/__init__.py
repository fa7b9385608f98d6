"""An arm at the other end of a wire: served in real time, driven by policies, an environment of what answers.

This is no safety system: what a real arm needs to be safe belongs into its own hardware.
"""

from .client import Played, RemoteArmEnv, Wire, run_policy
from .packet import MOST_NUMBERS, Kind, Packet, Refusal, pack, unpack
from .server import Limits, Server, Session

__all__ = [
    "MOST_NUMBERS", "Kind", "Limits", "Packet", "Played", "Refusal", "RemoteArmEnv", "Server", "Session", "Wire",
    "pack", "run_policy", "unpack",
]  # fmt: skip
