"""Digest of a task: hash of a canonical text with all its values. Bounds of a task's returns."""

import dataclasses
import hashlib
import json
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from .. import arms
from ..envs.options import Plan, plan
from ..envs.space import SPACE
from ..envs.task import ATTITUDE, CHAIN, CHANGE, COST, REACH, SLEW
from .data import Task, task

KINDS = {kind.id: kind for kind in (SLEW, REACH, CHAIN, SPACE)}


def resolved(one: Task) -> Plan:
    """Return the validated environment plan of a task, without creating the environment."""
    return plan(KINDS[one.environment], **one.arguments)


class Possible(NamedTuple):
    """Bounds of an episode of a task: largest number of control periods, smallest return, and largest return."""

    periods: int
    least: float
    most: float


@cache
def possible(task_id: str) -> Possible:
    """Compute the largest length and the bounds of the return of a task's episodes from its reward terms.

    In each period the terms `accuracy`, `settle` and `force` are at most 1, and the penalties `impulse`, `distance`,
    `vibration` and `attitude` are at most 1. The penalty `effort` is at most 1 per joint, and the penalty `change` is
    at most 4 per joint. Each term is multiplied by its weight. The failure penalty is subtracted at most once in an
    episode. If the task's `rules` are 2, `distance` and `attitude` can be rewards of at most 1 instead of penalties.
    """
    made = resolved(task(task_id))
    weight = dict(zip(made.kind.rewards, made.record.weights.tolist(), strict=True))
    paid = weight["accuracy"] + weight["settle"] + weight.get("force", 0.0)
    joints = made.arm.n_links * (weight["effort"] + 4.0 * weight.get(CHANGE, 0.0))
    taken = weight["distance"] + joints + weight["vibration"] + weight.get(ATTITUDE, 0.0) + weight.get(COST, 0.0)
    taken += weight.get("impulse", 0.0)
    # rules 2: distance and attitude may also pay
    if made.record.nearness is not None:
        paid += weight["distance"] + weight.get(ATTITUDE, 0.0)
    return Possible(made.limit, -made.limit * taken - weight["failure"], made.limit * paid)


@cache
def instants(task_id: str) -> tuple[float, int]:
    """Return a task's control period, s, and the number of periods for which the success bounds must be met."""
    made = resolved(task(task_id))
    return made.period, int(made.record.hold) - 1


def digest_of(one: Task) -> str:
    """Hash a resolved task: 16 hexadecimal digits; see `flexarm_env.suite.digest`."""
    made = resolved(one)
    arm = {key: value for key, value in arms.to_table(made.arm, made.arm.spatial).items() if key != "source"}
    starts = {key: getattr(made.starts, key) for key in ("start", "target", "straight", "vibration")}
    starts["factors"] = [made.starts.drawn[name] for name in ("payload", "EI", "damping", "torque_constant")]
    what = {
        "environment": one.environment,
        "keywords": one.keywords,
        "price": one.price,
        "arm": arm,
        "solver": {key: value for key, value in dataclasses.asdict(made.settings).items() if value is not None},
        "period": made.period,
        "limit": made.limit,
        "gravity": made.gravity,
        "weights": dict(zip(made.kind.rewards, made.record.weights.tolist(), strict=True)),
        "starts": starts,
        "success": dict(zip((*made.kind.bands, "hold"), (*made.record.bands, made.record.hold), strict=True)),
        "observation": [list(pair) for pair in zip(made.names, made.scales, strict=True)],
        "history": made.history,
    }
    if made.contacts:
        what["contacts"] = [contact.to_table() for contact in made.contacts]
    if made.contacts and made.extras.reference is not None:
        what["reference"] = made.extras.reference.ranges
    if one.rules != 1:
        what["rules"] = one.rules
    return hashlib.sha256(json.dumps(_plain(what), sort_keys=True).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    """Convert a value to JSON types with every number as text of ten digits, so that 1 and 1.0 are equal."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(entry) for entry in value]
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    return f"{float(value):.10g}"
