"""No derivative is zero where a difference is not: features, formulations and parameters of a control period.

`test_derivatives.py` measures the error of a whole Jacobian, which hides a small column that is missing. This table
looks at each column by itself: of state, action and every parameter.
"""

import dataclasses
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms as arms_by_name
from flexarm_env.derivatives import Arms
from flexarm_env.parameters import Base, Payload
from flexarm_env.validation import Array
from tests.differences import central
from tests.test_derivatives import SHORT, after, bare, geared, moving

ONE, TWO, SPACE = "FlexibleArm-v0", "TwoLinkFlexArm-v0", "SpatialFlexArm-v0"

FORMULATIONS: dict[str, tuple[str, dict[str, Any]]] = {
    "elastica": (ONE, {}),
    "elastica, two links": (TWO, {}),
    "floating frame": (TWO, {"formulation": "floating_frame", "segments": 2}),
    "modes": (TWO, {"formulation": "floating_frame", "modes": 2, "segments": 1}),
    "root frames": (ONE, {"formulation": "floating_frame", "frame": "root", "segments": 2}),
    "multipliers": (TWO, {"formulation": "floating_frame", "multipliers": True, "segments": 1, "elements": 1}),
    "exact beam": (ONE, {"formulation": "geometrically_exact", "elements": 2}),
    "exact beam in space": (SPACE, {"formulation": "geometrically_exact", "elements": 1, "dt": 0.0025}),
    "floating frame in space": (SPACE, {"formulation": "floating_frame", "segments": 1, "dt": 0.0025}),
    "modes in space": (SPACE, {"formulation": "floating_frame", "modes": 2, "segments": 1, "dt": 0.0025}),
}
"""Environment and keywords of each formulation."""

FALL = {"gravity": (0.0, -9.81), "rules": 1}
PD, MOTORS = {"action_mode": "residual_pd", "residual_share": 0.3}, {"actuator": {"lag": 0.01, "delay": 0.02}}
SENSORS = {
    "strain_gauges": [{"place": 0.1, "gain": (0.9, 1.1), "delay": 0.02}],
    "encoders": {"low_pass": {"frequency": 15.0, "order": 2}, "delay": 0.03},
    "accelerometer": {"bias": 0.1, "low_pass": {"frequency": 10.0}},
}


def plain(env_id: str) -> Any:
    """The environment's arm without rigid ends, its payload with inertia; in space yaw and a strip."""
    if env_id == SPACE:
        return SHORT
    arm = bare(arms_by_name.named("strip" if env_id == ONE else "de_luca_siciliano"))
    return dataclasses.replace(arm, payload=Payload(0.1, 1e-3), tau_d=2e-3)


def with_gears(env_id: str, **joint: Any) -> Any:
    """The same behind elastic gears."""
    arm, own = plain(env_id), geared(2).joints
    joints = [dataclasses.replace(one, **joint) for one in own[: len(arm.links)]]
    return dataclasses.replace(arm, joints=joints)


def lever(env_id: str) -> Any:
    """With rigid ends and a payload off the tip."""
    arm = plain(env_id)
    ends = {"root_offset": 0.02, "tip_offset": 0.03, "tip_mass": 0.05}
    links = [link if link.rigid else dataclasses.replace(link, **ends) for link in arm.links]
    offset = (0.03, 0.02, 0.01) if env_id == SPACE else (0.03, 0.02)
    return dataclasses.replace(arm, links=links, payload=dataclasses.replace(arm.payload, offset=offset))


FEATURES: dict[str, Any] = {
    "none": lambda env_id: {"arm": plain(env_id)},
    "gravity": lambda env_id: {"arm": plain(env_id)} | ({} if env_id == SPACE else FALL),
    "gears": lambda env_id: {"arm": with_gears(env_id)},
    "gears, viscous friction": lambda env_id: {"arm": with_gears(env_id, friction_viscous=0.05)},
    "gears, dry friction": lambda env_id: {"arm": with_gears(env_id, friction_coulomb=0.02)},
    "gears with play": lambda env_id: {"arm": with_gears(env_id, backlash=0.01)},
    "rigid gears, rotors": lambda env_id: {"arm": with_gears(env_id, stiffness=float("inf"), damping=0.0)},
    "levers": lambda env_id: {"arm": lever(env_id)},
    "floating base": lambda env_id: {"arm": dataclasses.replace(plain(env_id), base=Base(5.0, 0.5))},
    "motors": lambda env_id: {"arm": plain(env_id), **MOTORS},
    "controllers": lambda env_id: {"arm": plain(env_id), **PD},
    "sensors": lambda env_id: {"arm": plain(env_id), "observation": "measured", "sensors": SENSORS},
    "targets that move": lambda env_id: {"arm": plain(env_id), "task": "track"},
}
"""What an arm or an environment has: keywords, by environment."""

QUICK = {("none", "elastica"), ("gears", "elastica"), ("motors", "elastica")}

TABLE: dict[str, tuple[str, ...]] = {
    "elastica": (
        "none", "gravity", "gears", "gears, viscous friction", "gears, dry friction", "gears with play",
        "rigid gears, rotors", "levers", "motors", "sensors", "targets that move",
    ),
    "elastica, two links": ("floating base", "controllers"),
    "floating frame": ("none", "gears, viscous friction"),
    "modes": ("none", "gears, viscous friction", "motors"),
    "root frames": ("none",),
    "multipliers": ("none",),
    "exact beam": (
        "none", "gears, viscous friction", "gears, dry friction", "motors", "floating base", "levers", "controllers",
    ),
    "exact beam in space": ("none", "gears, viscous friction", "levers", "motors", "controllers"),
    "floating frame in space": ("none",),
    "modes in space": ("none", "motors"),
}  # fmt: skip
"""Features that each formulation is tried with."""

CASES = [
    pytest.param(feature, formulation, marks=() if (feature, formulation) in QUICK else pytest.mark.slow)
    for formulation, features in TABLE.items()
    for feature in features
]


def columns(arms: Arms, state: Array, action: Array, found: Array, share: float) -> tuple[Array, Array]:
    """(n, X + O + 1, X + A) by fourth-order differences, each column by a step that changes what follows by `share`.

    Second result: the steps (X + A,).
    """
    there = np.maximum(1e-2, np.abs(after(arms, state, action)).max(axis=0))
    both, parts, steps = np.concatenate([state, action], axis=1), [], []
    for j, k in enumerate([*range(arms.moving), *range(arms.state_size, both.shape[1])]):
        size = float((np.abs(found[:, :, j]).max(axis=0) / there).max())
        # a number is not moved through zero, and a column that was found to be zero by a step as for a number of size 1
        e = min(share / max(size, 1e-3), 0.02 * max(1e-3, float(np.abs(both[:, k]).min())))
        if arms.environment.plan.settings.multipliers:
            e = max(e, 1e-6)  # smaller changes of a dependent coordinate drown in the constraint's round-off

        def moved(way: float, k: int = k) -> Array:
            x = both.copy()
            x[:, k] += way
            return after(arms, x[:, : arms.state_size], x[:, arms.state_size :])

        parts.append(central(moved, e, 4))
        steps.append(e)
    return np.stack(parts, axis=2), np.array(steps)


@pytest.mark.parametrize(("feature", "formulation"), CASES)
def test_no_derivative_is_missing(feature: str, formulation: str) -> None:
    """Forward: each column agrees with differences to 1e-5 of its largest entry (1e-3 of stiff beams), by one of their
    steps. Backward: each entry that a unit cotangent gives is the Jacobian's, to the same share of its column."""
    env_id, keywords = FORMULATIONS[formulation]
    stiff = "formulation" in keywords or env_id == SPACE
    arms = Arms(
        env_id, 2, tolerance=1e-14 if stiff else 1e-12, parameters=True, **keywords, **FEATURES[feature](env_id)
    )  # fmt: skip
    state, action = moving(arms)
    names = [*arms.names[: arms.moving], *(f"action[{k}]" for k in range(arms.action_size))]
    found = arms.jacobians(state, action)
    assert np.isfinite(found.moved).all()
    there = np.maximum(1e-2, np.abs(after(arms, state, action)).max(axis=0))[:, None]
    # forward, by columns; accelerations of stiff beams are as fine as the solver's tolerance makes them
    most = 1e-3 if stiff else 1e-5
    error = np.full(found.moved.shape[::2], np.inf)
    for share in (1e-3, 1e-5) if not stiff else (1e-1, 1e-3, 1e-5):
        known, steps = columns(arms, state, action, found.moved, share)
        size, off = np.abs(known / there).max(axis=1), np.abs((found.moved - known) / there).max(axis=1)
        if arms.environment.plan.settings.multipliers:
            # a dependent coordinate changes nothing but the round-off of the constraints, which stiff columns amplify
            off = np.maximum(off - 1e-15 * np.abs(found.moved / there).max() / steps, 0.0)
        error = np.minimum(error, off / np.maximum(size, 1e-6))
    wrong = {name: float(x) for name, x in zip(names, error.max(axis=0), strict=True) if not x < most}
    assert not wrong, f"columns that differ from differences, and by how much: {wrong}"
    # backward, by rows: a unit cotangent of each number of the outcome
    x, entries = arms.moving, found.observation.shape[1]
    for i in range(x + entries + 1):
        bars = np.zeros_like(state), np.zeros_like(found.observation), np.zeros(arms.n)
        if i < x:
            bars[0][:, i] = 1.0
        elif i < x + entries:
            bars[1][:, i - x] = 1.0
        else:
            bars[2][:] = 1.0
        back = np.concatenate([part[:, :n] for part, n in zip(
            arms.vjp(state, action, *bars), (x, arms.action_size), strict=True
        )], axis=1)  # fmt: skip
        row = found.moved[:, i]
        scale = np.abs(found.moved).max(axis=1)  # of each column
        apart = np.abs(back - row) / np.maximum(scale, 1e-300)
        assert (apart < most).all(), (i, [names[j] for j in np.flatnonzero((apart >= most).any(axis=0))])
    arms.close()
