"""Count the floating-point operations of a time step, by running the kernels uncompiled on numbers that count them.

    FLEXARM_COMPILER=python python -m benchmarks.operations      prints the counts as JSON

Additions, multiplications and divisions that involve the state count as one each. Loads, comparisons, integer
operations and products of the model's constants alone are not counted.
"""

from __future__ import annotations

import json
import math
import operator
import sys
from typing import Any

import numpy as np

from flexarm_env import arms
from flexarm_env.batch import standing_scene
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.physics.model import scheme
from flexarm_env.settings import Settings
from flexarm_env.simulation import Simulation

CASES: dict[str, tuple[str, str, dict[str, Any]]] = {
    "elastica, 4 nodes": ("strip", "elastica", {"nodes": 4}),
    "elastica, 5 nodes": ("strip", "elastica", {"nodes": 5}),
    "elastica, two links, 5 nodes": ("de_luca_siciliano", "elastica", {"nodes": 5}),
    "exact, 3 quadratic elements": ("strip", "geometrically_exact", {"elements": 3}),
    "exact, 5 quadratic elements": ("strip", "geometrically_exact", {"elements": 5}),
    "exact, two links, 3 each": ("de_luca_siciliano", "geometrically_exact", {"elements": 3}),
    "floating frame, 3 modes": ("strip", "floating_frame", {"modes": 3}),
    "floating frame, 5 segments": ("strip", "floating_frame", {"segments": 5, "elements": 1}),
}
"""Counted and timed cases: arm, formulation, options."""

STEP, STEPS = 0.005, 8
COUNTS = {"add": 0, "multiply": 0, "divide": 0}


class Counted:
    """Float that counts the operations on it."""

    __slots__ = ("x",)

    def __init__(self, x: float) -> None:
        self.x = float(x)

    def __float__(self) -> float:
        return self.x

    def __int__(self) -> int:
        return int(self.x)

    def __neg__(self) -> Counted:
        return Counted(-self.x)

    def __abs__(self) -> Counted:
        return Counted(abs(self.x))

    __hash__ = None

    def cos(self) -> Counted:
        """Return the cosine, which np.cos calls; its count is that of the package's own sine and cosine."""
        COUNTS["multiply"] += 8
        COUNTS["add"] += 8
        return Counted(math.cos(self.x))

    def sin(self) -> Counted:
        """Return the sine, which np.sin calls."""
        self.cos()
        return Counted(math.sin(self.x))

    def sqrt(self) -> Counted:
        """Return the square root and count a division; np.sqrt calls this method."""
        COUNTS["divide"] += 1
        return Counted(math.sqrt(self.x))


def _counting(word: str, name: str, operation: Any) -> None:
    """Define the operator `word` of `Counted`; each use adds one to the count `name`."""

    def counted(a: Any, b: Any) -> Counted:
        COUNTS[name] += 1
        return Counted(operation(float(a), float(b)))

    setattr(Counted, f"__{word}__", counted)
    setattr(Counted, f"__r{word}__", lambda self, other: counted(other, self))


def _prepare() -> None:
    """Make the kernels' arithmetic functions and scratch arrays accept counting numbers."""

    def divided(a: float, b: float) -> float:
        return a / b if b else math.inf

    _counting("add", "add", operator.add)
    _counting("sub", "add", operator.sub)
    _counting("mul", "multiply", operator.mul)
    _counting("truediv", "divide", divided)
    for test in (operator.lt, operator.le, operator.gt, operator.ge, operator.eq):
        setattr(Counted, f"__{test.__name__}__", lambda a, b, test=test: test(a.x, float(b)))

    def square_root(x: Any) -> Counted:
        COUNTS["divide"] += 1
        return Counted(math.sqrt(max(float(x), 0.0)))

    def room(lane: Any, sizes: Any) -> Any:
        return np.full(len(sizes), 0.0, dtype=object)

    replaced = {"square_root": square_root, "stack": room, "round_even": lambda x: Counted(float(np.rint(float(x))))}
    for name, module in list(sys.modules.items()):
        if name.startswith("flexarm_env.physics"):
            for key, value in replaced.items():
                if hasattr(module, key) and callable(getattr(module, key)):
                    setattr(module, key, value)


def thrown(arm_name: str, formulation: str, options: dict[str, Any]) -> Simulation:
    """Return an arm that its torque limits have accelerated from rest for four steps of 5 ms."""
    arm = arms.resolve(arm_name)
    settings = Settings.make(formulation, dt=STEP, tolerance=1e-6, **options)
    simulation = Simulation(standing_scene(arm, STEP, None), settings)
    assert arm.torque_limits is not None
    simulation.set_torques(np.array(arm.torque_limits))
    simulation.advance_to(4 * STEP, account=False)
    return simulation


def count(arm_name: str, formulation: str, options: dict[str, Any]) -> dict[str, float]:
    """Count the operations and Newton iterations per step: means over STEPS steps of 5 ms under constant torques."""
    from flexarm_env.physics.integrator.step import advance

    simulation = thrown(arm_name, formulation, options)
    settings = simulation.settings
    flat = np.array([Counted(x) for x in simulation._flat], dtype=object)
    par = np.array([Counted(x) for x in simulation.par], dtype=object)
    limits = (settings.tolerance, settings.max_iterations, settings.max_halvings, False)
    before = float(simulation.work.counts[0])
    COUNTS.update(dict.fromkeys(COUNTS, 0))
    advance(
        SINGLE, simulation.model, None, par, flat, 0, 0.0, STEP, STEPS,
        scheme(settings.rho_inf, settings.newmark, *limits), None,
    )  # fmt: skip
    counts = {name: number / STEPS for name, number in COUNTS.items()}
    simulation._flat[:] = flat.astype(float)
    iterations = (float(simulation.work.counts[0]) - before) / STEPS
    return counts | {"operations": sum(counts.values()), "iterations": iterations, "state_bytes": 8.0 * flat.size}


def main() -> None:
    """Print the counts of all cases as JSON."""
    if not UNCOMPILED:
        raise SystemExit("Run with FLEXARM_COMPILER=python: compiled kernels cannot be counted")
    _prepare()
    print(json.dumps({name: count(*case) for name, case in CASES.items()}))


if __name__ == "__main__":
    main()
