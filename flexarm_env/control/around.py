"""Policies that add a network's torques to a classical controller's torques.

The network learns a correction of the controller: action = clip(controller + share * network). All terms are joint
torques divided by the torque limits. Controller and network read the same observation of the environment.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..files import read_toml
from ..validation import Array32
from .base import RESIDUAL_SHARE, Controller, Setup
from .catalogue import NAMES, Following, controller, gains_from, tuned_gains


@dataclass(frozen=True)
class Inside:
    """Description of the controller in a policy that also contains a network.

    Args:
        controller: name of the controller. share: factor on the network's actions, equal to the network's largest
            torque divided by the torque limit. gains: values of the controller's gains by name.
    """

    controller: str
    share: float
    gains: Mapping[str, Any]

    @classmethod
    def of(cls, word: str, env: Any, share: float | None = None) -> Inside:
        """Return the description of a named controller with its gains for an environment.

        word: name of the controller, such as "pd", or "pd@FILE" for gains from a file that `flexarm tune` wrote. share:
        as in the class; None means `base.RESIDUAL_SHARE`. Raises ValueError for an unknown word or file, or an invalid
        share.
        """
        name, at, file = word.partition("@")
        check.choice("around", name, NAMES)
        part = RESIDUAL_SHARE if share is None else check.number("share", share, above=0.0)
        setup = Setup.of(env)
        if at:
            try:
                tables, _ = read_toml(Path(file))
            except OSError as error:
                raise ValueError(f"around = {word}: {file}: {error.strerror}") from error
            gains = gains_from(name, check.table_of(f"{file}: {name}", tables.get(name)), setup.gains)
        else:
            gains = tuned_gains(name, setup.gains, setup.n_joints)
        table = {key: list(v) if isinstance(v, tuple) else v for key, v in dataclasses.asdict(gains).items()}
        return cls(name, part, table)

    @classmethod
    def read(cls, table: Any) -> Inside:
        """Create the description from the entry `around` in a policy's file.

        Raises ValueError with a message that names the field, its value and the rule.
        """
        with check.under("around"):
            entry = check.table_of("", table)
            check.known_keys("", entry, [field.name for field in dataclasses.fields(cls)])
            fields = ("controller", "share", "gains")
            name, share, gains = (check.needed("", entry, key, "must be given") for key in fields)
            name = check.choice("controller", name, NAMES)
            return cls(name, check.number("share", share, above=0.0), dict(check.table_of("gains", gains)))

    def table(self) -> dict[str, Any]:
        """Return the entry `around` for a policy's file."""
        return dataclasses.asdict(self)

    def made(self, env: Any) -> Controller | Following:
        """Create the controller for an environment.

        Raises ValueError if the controller does not support the environment.
        """
        return controller(self.controller, env, self.gains)

    def actions(self, own: Controller | Following, observation: NDArray[np.floating], action: Any) -> Array32:
        """Add the controller's actions to the network's actions, and clip the sum to [-1, 1].

        own: the controller, which reads the observation. action: actions of the network, (n, N) or (N,), which are
        clipped to [-1, 1] and multiplied by `share`.
        """
        beside = self.share * np.clip(np.asarray(action, np.float64), -1.0, 1.0)
        found: Array32 = own.act(observation, beside)
        return found


def restarting(inside: Inside, env: Any) -> Controller | Following:
    """Create the controller for a vector environment whose environments begin their episodes at different times.

    Raises ValueError for a controller that can only be reset in all environments together.
    """
    found = inside.made(env)
    if not found.restarts:
        what = "must be pd or a controller of the contact force: the memory of other controllers begins"
        what += " for all environments together"
        raise check.InvalidValue("around", inside.controller, what)
    return found


def linear_law(controller: Controller | Following) -> NDArray[np.float64]:
    """Return the matrix K (entries, N) of a controller whose unsaturated actions are observation @ K.

    Raises ValueError for a controller with a memory, or if the observation lacks the goal's joint angles.
    """
    law = getattr(controller, "linear", None)
    found = None if law is None else law()
    if found is None:
        what = 'must be pd of an arm in the plane with observation="measured": no other is a matrix of the observation'
        raise check.InvalidValue("around", type(controller).__name__, what)
    return np.asarray(found, np.float64)
