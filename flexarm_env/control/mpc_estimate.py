"""Choice of the weight of the model in the state estimate of planar receding-horizon control (`MPCGains.memory`).

Near the goal the controller is the regulator u = -K (x_hat - x_goal). The estimate x_hat is a weighted mean of the
model's prediction and of a static shape, corrected so that it has the measured outputs. For small deviations the
prediction and the static shape are linear, so the eigenvalues of the loop of arm, estimate and regulator show how fast
deviations decay.
"""

import math
import warnings

import numpy as np

from ..parameters import Arm
from ..validation import Array
from .dynamics import Dynamics

SMALL = 1e-6
"""Deviation of states and outputs, rad and rad/s, for the derivative of the estimate."""
KEPT = 0.75
"""Least decay rate of the loop, divided by the decay rate of the regulator that knows the state."""
TRIED = (0.8, 0.65, 0.5, 0.25, 0.0)
"""Weights that are tried if the given weight lets deviations decay too slowly."""


def estimate_maps(plant: Dynamics, memory: float) -> tuple[Array, Array]:
    """Return derivatives of the estimate (S,) at rest by the prediction (S, S) and by the measured outputs (S, O)."""
    (home,), _ = plant.still(np.zeros((1, plant.n_inputs)))
    y = plant.outputs(home[None])[0][0]
    size, seen = len(home), len(y)
    moved = SMALL * np.concatenate([np.eye(size + seen), -np.eye(size + seen)])
    predicted, outputs = home + moved[:, :size], y + moved[:, size:]
    static = plant.corrected(plant.unbent(outputs[:, : plant.n_inputs]), outputs)
    found = plant.corrected(memory * predicted + (1.0 - memory) * static, outputs)
    slope = (found[: size + seen] - found[size + seen :]).T / (2.0 * SMALL)
    return slope[:, :size], slope[:, size:]


def loop_radius(plant: Dynamics, K: Array, memory: float) -> float:
    """Return the spectral radius, per control period, of the loop of arm, estimate and regulator about rest.

    K (N, S): gains of the regulator. The state of the loop consists of the arm's state and the predicted state.
    """
    A, B, C = _linear(plant)
    by_prediction, by_outputs = estimate_maps(plant, memory)
    estimate = np.hstack([by_outputs @ C, by_prediction])
    arm = np.hstack([A, np.zeros_like(A)]) - B @ K @ estimate
    return _radius(np.vstack([arm, (A - B @ K) @ estimate]))


def memory_for(arm: Arm, plant: Dynamics, K: Array, memory: float) -> float:
    """Return the weight `memory` if the loop decays fast enough with it, otherwise the first of `TRIED` that suffices.

    If no weight suffices, the function returns the weight with the fastest decay, and warns if deviations grow even
    with this weight.
    """
    A, B, _ = _linear(plant)
    wanted = KEPT * math.log(_radius(A - B @ K))
    found = {}
    for value in (memory, *(value for value in TRIED if value < memory)):
        found[value] = loop_radius(plant, K, value)
        if math.log(found[value]) <= wanted:
            return value
    best = min(found, key=lambda value: found[value])
    if found[best] >= 1.0:
        what = f"mpc: on arm {arm.name!r} with a control period of {plant.period:g} s the state estimate is unstable"
        warnings.warn(f"{what}: take lqr, or another control_dt", UserWarning, stacklevel=5)
    return best


def _linear(plant: Dynamics) -> tuple[Array, Array, Array]:
    """Return A (S, S), B (S, N) and C (O, S) of the straight arm at rest: x' = A x + B u, y = C x."""
    home, held = plant.still(np.zeros((1, plant.n_inputs)))
    (A,), (B,) = plant.jacobians(home, held)
    return A, B, plant.outputs(home)[1][0]


def _radius(matrix: Array) -> float:
    """Return the largest absolute value of the eigenvalues."""
    return float(np.abs(np.linalg.eigvals(matrix)).max())
