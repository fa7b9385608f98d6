"""Arms on a freely floating base: the keyword `base`, and the features that such arms do not support."""

from dataclasses import replace
from typing import Any

from .. import arms
from .. import validation as check
from ..parameters import Arm, Base
from .features import Frame
from .observation import MEASURED, goal_entries

_HELD = {
    "pushes": "the arm would drift away from its target for good",
    "payload_change": "what is gripped would bring momentum, and the arm drift away from its target for good",
    "initial_vibration": "modes are those of an arm whose root is held",
    "gravity": "the arm would fall away from its target",
}
"""Keywords that require a fixed root, and the reason for each."""


def with_base(arm: Arm, value: Any) -> Arm:
    """Return the arm on the floating base given by the keyword `base`, a Base or its table.

    value: keyword `base`: a `Base` or a dict with its fields. If `value` is None, the arm is returned unchanged.
    """
    if value is None:
        return arm
    arm.axes.check_planar("base", value, "must be left out in space, where the root is held")
    return replace(arm, base=value if isinstance(value, Base) else arms.base_of(value))


def check_afloat(frame: Frame, task: str, mode: str, wanted: Any, **arguments: Any) -> None:
    """Raise ValueError for keywords that an arm on a floating base does not support.

    arguments: values of the keywords that require a fixed root.
    """
    arm = frame.arm
    if arm.base is None:
        return
    goals = [name for name, _ in goal_entries(frame.kind, arm)]
    aimed = [name for name in ([] if isinstance(wanted, str) else wanted) if name in goals]
    why = "joint angles that reach a target are those of an arm whose root is held"
    if mode == "residual_pd":
        raise check.InvalidValue("action_mode", mode, f"must not be used on a floating base: {why}")
    if wanted == MEASURED or aimed:
        value = aimed[0] if aimed else wanted
        what = f'must be "full", or name none of these, on a base that floats: {why}'
        raise check.InvalidValue("observation", value, what)
    if task != frame.kind.task:
        raise check.InvalidValue("task", task, f'must be "{frame.kind.task}" on a base that floats')
    for name, why in _HELD.items():
        if check.several(arguments[name]) or arguments[name]:
            raise check.InvalidValue(name, arguments[name], f"must be left out on a base that floats: {why}")
    if arm.joint(0).moves:
        what = "must be an ideal Joint() on a base that floats"
        raise check.InvalidValue("arm.joints[0]", arm.joint(0), what)
