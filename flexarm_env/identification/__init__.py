"""System identification: fit an arm's parameters to measured logs, and test the fitted arm on other logs."""

from .config import Channel, Config, Parameter, read_config
from .excite import Excitation, excite
from .log import BadLog, Run, read_run
from .report import Identification
from .result import identify, randomization
from .signals import Ringing, free_decay, nrmse, vaf
from .uncertainty import Direction, Uncertainty

__all__ = [
    "BadLog", "Channel", "Config", "Direction", "Excitation", "Identification", "Parameter", "Ringing", "Run",
    "Uncertainty", "excite", "free_decay", "identify", "nrmse", "randomization", "read_config", "read_run", "vaf",
]  # fmt: skip
