"""Export policies that contain a network and a controller (`control.around`) as C code or for ONNX."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from .around import linear_law
from .base import Controller
from .catalogue import Following
from .export import Entries, c_comment, c_named, c_part, c_source
from .in_c import Pairs, Points, controller_source
from .policy import AroundPolicy


def around_c_source(
    policy: AroundPolicy, entries: Entries, name: str, elbows: Pairs | None = None, targets: Points | None = None
) -> str:
    """Generate one C99 file of a policy whose actions are the sum of a network's and a controller's actions.

    Args:
        policy: policy bound to an environment.
        entries: entries of the observation at one instant.
        name: prefix of the file's functions NAME_reset, NAME_act (from values in SI units to actions) and NAME_decide
            (from the environment's observation to actions). Each function has an argument of the type NAME_memory.
        elbows, targets: arguments of `in_c.controller_source`.
    Raises:
        ValueError: `export.c_source` or `in_c.controller_source` raises it, or the controller is a `Following` of
            `control.catalogue`.
    """
    own = bound_controller(policy)
    if isinstance(own, Following):
        what = "must be of an environment with targets and a root at rest: C code cannot restart it in each period"
        raise check.InvalidValue("around", policy.inside.controller, what)
    head = c_comment([
        f"NAME: a policy with the controller {policy.inside.controller} inside.",
        f"action = controller + {policy.inside.share:g} * network, saturated at the torque limits.",
        "",
        "  void NAME_reset(NAME_memory *memory)",
        "      before an episode",
        "  void NAME_act(NAME_memory *memory, const float measured[], float action[])",
        "      what is measured now, in SI units, to actions; once a control period",
        "  void NAME_decide(NAME_memory *memory, const float observation[], float action[])",
        "      the environment's observation, the newest instant last, to actions; once a control period",
        "      (0 where a number is not finite)",
    ])  # fmt: skip
    network = c_source(policy, entries, f"{name}_network")
    inside = controller_source(own, f"{name}_inside", elbows=elbows, targets=targets, inside=True)
    total = c_part("policy_around").replace("SHARE", repr(policy.inside.share))
    return "\n".join([c_named(head, name), network, inside, c_named(total, name)])


def onnx_law(policy: AroundPolicy) -> NDArray[np.float64]:
    """Return the controller's matrix K (entries, N): its unsaturated actions are observation @ K.

    Raises ValueError for a controller with a memory, which ONNX files of this package do not have.
    """
    return linear_law(bound_controller(policy))


def bound_controller(policy: AroundPolicy) -> Controller | Following:
    """Return the controller; raise ValueError for a policy that is not bound to an environment."""
    found: Any = policy.controller
    if found is None:
        raise check.InvalidValue("policy", policy.meta.get("env_id"), "must be bound to its environment: bound(env)")
    return found  # type: ignore[no-any-return]
