"""What a task comes to, as one canonical text, and its hash."""

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
    """The checked environment of a task, without making it."""
    return plan(KINDS[one.environment], **one.keywords)


class Possible(NamedTuple):
    """What can come of an episode of a task: its most control periods, and between what its return lies."""

    periods: int
    least: float
    most: float


@cache
def possible(task_id: str) -> Possible:
    """Of a task by its id, from the bounds of the reward's terms (docs/suite.md): accuracy and settle pay 1 at most,
    distance, vibration and attitude take 1, effort 1 and change 4 a joint, each times its weight; a failure is once."""
    made = resolved(task(task_id))
    weight = dict(zip(made.kind.rewards, made.record.weights.tolist(), strict=True))
    paid = weight["accuracy"] + weight["settle"]
    joints = made.arm.n_links * (weight["effort"] + 4.0 * weight.get(CHANGE, 0.0))
    taken = weight["distance"] + joints + weight["vibration"] + weight.get(ATTITUDE, 0.0) + weight.get(COST, 0.0)
    return Possible(made.limit, -made.limit * taken - weight["failure"], made.limit * paid)


@cache
def instants(task_id: str) -> tuple[float, int]:
    """Of a task by its id: the control period, s, and over how many of them the bounds of success have to be kept."""
    made = resolved(task(task_id))
    return made.period, int(made.record.hold) - 1


def digest_of(one: Task) -> str:
    """See `flexarm_env.suite.digest`."""
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
    return hashlib.sha256(json.dumps(_plain(what), sort_keys=True).encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    """As JSON has it, every number as a text of ten digits: 1 and 1.0 are the same."""
    if isinstance(value, Mapping):
        return {str(key): _plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [_plain(entry) for entry in value]
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    return f"{float(value):.10g}"
