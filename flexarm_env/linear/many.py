"""Linear models of many arms that differ only in parameters and state, computed in one compiled call.

The formulation must be elastica, and the joints must be ideal: without elastic gears, rotors or friction.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..compiler import SINGLE, WIDEST, Placed, dual, entry, size, uncompiled
from ..physics import assembly
from ..physics.integrator.work import unpack, work_size
from ..physics.layout import POSE
from ..physics.model import Elastica, System
from ..runtime import linearized
from ..runtime.layout import aligned
from ..settings import Settings, steps_in
from ..tasks.program import PARAMETERS
from ..validation import Array
from .state_space import LinearModel

AT_ONCE = 3
"""Number of columns of each arm's matrices, one tangent for each column, that one pass computes."""


@dataclass(frozen=True)
class LinearModels:
    """Linear models of k arms: the attributes of `LinearModel` except `growing`, each with a first axis of length k.

    If the solver of an arm fails within the period, the entries of this arm are NaN.
    """

    A: Array
    B: Array
    C: Array
    D: Array
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    x: Array = field(repr=False)
    u: Array = field(repr=False)
    y: Array = field(repr=False)
    rate: Array = field(repr=False)
    dt: float | None

    def __len__(self) -> int:
        return len(self.A)


def stacked(models: Sequence[LinearModel]) -> LinearModels:
    """Combine models with equal states, inputs and outputs into one `LinearModels`."""
    first = models[0]
    arrays = {k: np.stack([getattr(model, k) for model in models]) for k in ("A", "B", "C", "D", "x", "u", "y", "rate")}
    return LinearModels(**arrays, states=first.states, inputs=first.inputs, outputs=first.outputs, dt=first.dt)


def compiled(system: System) -> bool:
    """Return whether a `Linearizer` supports the arm."""
    model = system.model
    own = isinstance(model, Elastica) and isinstance(model.n, tuple) and model.root is None and model.loads is None
    return own and WIDEST is not SINGLE


class Linearizer:
    """Compute linear models of n arms that differ only in state and parameters.

    The constructor takes an assembled system, its solver settings (with dt), the number n of arms, the number of links,
    and the period, s, of discrete models (None for continuous models).
    """

    def __init__(self, system: System, settings: Settings, n: int, links: int, discrete: float | None) -> None:
        assert settings.dt is not None
        model = system.model if discrete is not None else assembly.physical(system.model)
        lanes = len(WIDEST)
        if discrete is not None:
            discrete = check.number("discrete", discrete, "s", above=0.0)
        self.system, self.links, self.n, self.discrete = system, links, n, discrete
        rows = size(model.n)
        steps = 0 if discrete is None else steps_in(discrete, settings.dt)
        columns, shown = 2 * rows + links, int(uncompiled(linearized.outputs_of)(links))
        wide, work = dual(WIDEST, AT_ONCE), int(uncompiled(work_size)(1, model, 0))
        chunks, room = -(-columns // AT_ONCE), uncompiled(linearized.room)
        self._shape = (n, 2 * rows + shown, columns)
        rates = "qv" if steps else "va"
        self._rows = linearized.Linearization(
            lane=WIDEST, dual=wide, model=model, scheme=assembly.scheme_of(settings, settings.tolerance),
            links=(0,) * links,
            h=settings.dt if discrete is None else discrete / steps, n_steps=steps, n=n, work=work,
            given=np.zeros(n * (columns + PARAMETERS)), places=_places(model, work, lanes, "qvu", PARAMETERS),
            twice=_places(model, work, len(wide), "qvu", PARAMETERS),
            read=_places(model, work, len(wide), rates, shown, PARAMETERS + POSE.end * links),
            values=np.zeros(n * (2 * rows + shown)), slopes=np.zeros(math.prod(self._shape)),
            block=aligned(1, room(work * lanes, lanes, links)).reshape(-1),
            scratch=aligned(chunks, room(work * len(wide), len(wide), links)).reshape(-1),
        )  # fmt: skip
        self._placed = Placed(self._rows)
        self._made = entry(linearized.linearize, self._placed, 0, 0)

    def __call__(self, q: Array, v: Array, u: Array, par: Array) -> LinearModels:
        """Return the models at coordinates q, rates v (n, rows), torques u (n, N) and parameters par (n, 4)."""
        d, n = self._rows, self.n
        d.given.reshape(n, -1)[:] = np.concatenate([q, v, u, par], axis=1)
        self._made(self._placed.address, 0, -(-n // len(d.lane)))
        half = q.shape[1]
        slopes = d.slopes.reshape(self._shape)
        values = d.values.reshape(n, -1)
        after, outputs = values[:, : 2 * half].copy(), values[:, 2 * half :].copy()
        A, B = slopes[:, : 2 * half, : 2 * half].copy(), slopes[:, : 2 * half, 2 * half :].copy()
        lost = np.isnan(after).any(axis=1)
        for numbers in (A, B, after):
            numbers[lost] = np.nan
        given = {row: name for name, row in self.system.coordinates.items()}
        names = [given.get(row, self.system.names[row]) for row in range(half)]
        links = range(self.links)
        shown = [f"{what}{k}{end}" for what in ("joint", "deflection") for end in ("", "_rate") for k in links]
        return LinearModels(
            A, B, slopes[:, 2 * half :, : 2 * half].copy(), np.zeros((n, len(shown) + 2, self.links)),
            states=(*names, *(f"{name}_rate" for name in names)), inputs=tuple(f"torque{k}" for k in links),
            outputs=(*shown, "tip_x", "tip_y"), x=np.concatenate([q, v], axis=1), u=u.copy(),
            y=outputs, rate=after, dt=self.discrete,
        )  # fmt: skip


def _places(model: Any, work: int, stride: int, names: str, count: int, skip: int = 0) -> NDArray[np.int64]:
    """Return the indices of rows of a work array in a memory block with `stride` lanes.

    The indices of `count` numbers that follow the array at a distance `skip` are also returned.
    """
    w = uncompiled(unpack)((0,) * stride, model, np.arange(work * stride, dtype=np.float64), 0)
    rows = [getattr(w, name)[::stride].astype(np.int64) for name in names]
    return np.concatenate([*rows, (work + skip + np.arange(count)) * stride])
