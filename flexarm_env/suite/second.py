"""A policy's second 100 evaluation episodes, whose seeds depend on the policy, so that no policy can memorize them.

The first seed is 2^32 plus the number in the first eight hexadecimal digits of SHA-256(digest of the task, numbers of
the policy). The numbers of the policy are a network's arrays and observation statistics, or a controller's name and
gains, without metadata. Somebody could still modify a policy many times and publish the variant whose seeds happen to
be easy. Policies without such numbers (Python functions, ONNX models, actions optimized in advance) are evaluated only
on the 100 public episodes.

A permutation test compares the public and the second 100 episodes. The data of the test are the policy's value minus
the value of PD control in each of the 200 episodes. The test assigns the 200 differences at random to two groups of
100. The p value is the share of assignments in which the group means differ at least as much as the measured means.
Holm's method (1979) adjusts p for multiple tests.
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
"""Smallest possible first seed."""

LEVEL = 0.01
"""Significance level of a difference."""

FEW, MANY, ENOUGH = 2000, 100_000, 10
"""Number of permutations of a test: FEW, or MANY if the means differ at least as much in fewer than ENOUGH of FEW
permutations."""


def first_seed(task: Task, canonical: bytes) -> int:
    """Return the first seed of a policy's second 100 episodes. canonical: the policy's numbers as bytes."""
    return BEGIN + int(hashlib.sha256(task.digest.encode() + canonical).hexdigest()[:8], 16)


def of_arrays(policy: NumpyPolicy) -> bytes:
    """Return a network's numbers as bytes: its arrays, observation statistics and the controller inside the policy."""
    arrays: list[Any] = [array for pair in policy.weights for array in pair]
    if policy.normaliser is not None:
        arrays += [policy.normaliser[name] for name in ("mean", "variance", "clip", "epsilon")]
    values = [np.ascontiguousarray(array, "<f8") for array in arrays]
    inside = policy.meta.get("around")
    own = b"" if inside is None else json.dumps(inside, sort_keys=True).encode()
    return own + b"".join(part for one in values for part in (str(one.shape).encode(), one.tobytes()))


def of_controller(name: str, task: Task) -> bytes:
    """Return a controller's name and tuned gains on a task as bytes; the gain `rests` is omitted at its default."""
    made = resolved(task)
    gains = dataclasses.asdict(tuned_gains(name, made.arm.axes.table_of_gains(made.kind.task), made.arm.n_links))
    if gains.get("rests") == 1:  # seeds published before the field existed
        del gains["rests"]
    return json.dumps({"name": name, **gains}, sort_keys=True).encode()


def chance(one: NDArray[np.float64], other: NDArray[np.float64], seed: int = 0) -> float:
    """Return the p value, in (0, 1], of the difference between two means by a permutation test."""
    values = np.concatenate([one, other])
    seen, rng = abs(float(np.mean(one) - np.mean(other))) * (1.0 - 1e-12), np.random.default_rng(seed)
    # few permutations decide clear cases
    few = _as_large(values, len(one), seen, FEW, rng)
    if few >= ENOUGH:
        return (1 + few) / (1 + FEW)
    many = sum(_as_large(values, len(one), seen, FEW, rng) for _ in range(MANY // FEW))
    return (1 + many) / (1 + MANY)


def _as_large(values: NDArray[np.float64], count: int, seen: float, deals: int, rng: np.random.Generator) -> int:
    """Count random permutations in which the two means differ by at least `seen`. count: size of the first group."""
    dealt = rng.permuted(np.broadcast_to(values, (deals, len(values))), axis=1)
    return int((np.abs(dealt[:, :count].mean(axis=1) - dealt[:, count:].mean(axis=1)) >= seen).sum())


def holm(found: Sequence[float]) -> list[float]:
    """Adjust the p values of multiple tests by Holm's method (1979)."""
    p, out, least = np.asarray(found, float), np.ones(len(found)), 0.0
    # step down: p_(k) (m - k) from the smallest on, monotone
    for rank, k in enumerate(np.argsort(p, kind="stable")):
        least = max(least, min(1.0, (len(p) - rank) * float(p[k])))
        out[k] = least
    return [float(value) for value in out]
