"""A second hundred of episodes, whose seeds follow from the policy: nobody can have learnt them by heart.

They begin at 2^32 and the first eight hexadecimal digits of SHA-256(digest of the task, what the policy computes with):
of a network its arrays and its normaliser, of a controller its name and gains, neither metadata nor a file's bytes. A
policy that is changed until its seeds suit it (each try another policy) is not defended against. What is no such policy
(functions of Python, ONNX models, actions found beforehand) has the public hundred alone.

A difference between both hundreds beyond chance is found by a permutation test: the values less PD's on the same seeds
are dealt anew to two hundreds, and p is the share of deals whose means differ by as much. Of many tests at once p is as
Holm (1979) has it.
"""

import dataclasses
import hashlib
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..control import NumpyPolicy
from ..control.catalogue import tuned_gains
from .data import Task
from .frozen import resolved

BEGIN = 2**32
"""The least first seed."""

LEVEL = 0.01
"""A difference with a smaller p is marked."""

FEW, MANY, ENOUGH = 2000, 100_000, 10
"""Deals of a permutation test; the many are made where fewer than so many of the few differ by as much."""


def first_seed(task: Task, canonical: bytes) -> int:
    """Where a policy's second hundred begins."""
    return BEGIN + int(hashlib.sha256(task.digest.encode() + canonical).hexdigest()[:8], 16)


def of_arrays(policy: NumpyPolicy) -> bytes:
    """What a network computes with: the shape and the float64 of each array, and those of its normaliser."""
    arrays: list[Any] = [array for pair in policy.weights for array in pair]
    if policy.normaliser is not None:
        arrays += [policy.normaliser[name] for name in ("mean", "variance", "clip", "epsilon")]
    values = [np.ascontiguousarray(array, "<f8") for array in arrays]
    return b"".join(part for one in values for part in (str(one.shape).encode(), one.tobytes()))


def of_controller(name: str, task: Task) -> bytes:
    """A controller's name and the gains that it has on a task."""
    made = resolved(task)
    gains = tuned_gains(name, "space" if made.kind.space else made.kind.task, made.arm.n_links)
    return json.dumps({"name": name, **dataclasses.asdict(gains)}, sort_keys=True).encode()


def chance(one: NDArray[np.float64], other: NDArray[np.float64], seed: int = 0) -> float:
    """p of the difference of two means, by deals of all values into two lots of these sizes; in (0, 1]."""
    values = np.concatenate([one, other])
    seen, rng = abs(float(np.mean(one) - np.mean(other))) * (1.0 - 1e-12), np.random.default_rng(seed)
    few = _as_large(values, len(one), seen, FEW, rng)
    if few >= ENOUGH:
        return (1 + few) / (1 + FEW)
    many = sum(_as_large(values, len(one), seen, FEW, rng) for _ in range(MANY // FEW))
    return (1 + many) / (1 + MANY)


def _as_large(values: NDArray[np.float64], count: int, seen: float, deals: int, rng: np.random.Generator) -> int:
    """Of so many deals, those whose means differ by as much."""
    dealt = rng.permuted(np.broadcast_to(values, (deals, len(values))), axis=1)
    return int((np.abs(dealt[:, :count].mean(axis=1) - dealt[:, count:].mean(axis=1)) >= seen).sum())


def holm(found: Sequence[float]) -> list[float]:
    """p of each test, adjusted for how many there are (Holm 1979)."""
    p, out, least = np.asarray(found, float), np.ones(len(found)), 0.0
    for rank, k in enumerate(np.argsort(p, kind="stable")):
        least = max(least, min(1.0, (len(p) - rank) * float(p[k])))
        out[k] = least
    return [float(value) for value in out]
