"""Save and restore complete states of environments; compute linear models of environments."""

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import validation as check
from ..batch import FRESH, GUIDED, MODE, OVER, REASONS, RUNNING, Batch, standing_scene
from ..physics import precision
from ..physics.assembly import assemble
from ..physics.model import STIFFNESSES, TAU_D
from ..simulation import Simulation
from .motion import Guide
from .options import Plan

if TYPE_CHECKING:
    from ..linear.many import Linearizer as Linearizer
    from ..linear.many import LinearModels as LinearModels
    from ..linear.state_space import LinearModel as LinearModel
else:
    LinearModel = LinearModels = Linearizer = Any

Array = np.ndarray[Any, np.dtype[np.float64]]

MODES = (RUNNING, OVER, FRESH, GUIDED)
KEYS = ("arm", "generator", "seed", "guide")


def state_of(
    batch: Batch, i: int, generator: np.random.Generator, seed: int | None, guide: Guide | None
) -> dict[str, Any]:
    """Return a copy of the complete state of arm i."""
    return {
        "arm": batch.get_state(i),
        "generator": copy.deepcopy(generator),
        "seed": seed,
        "guide": copy.deepcopy(guide),
    }


def check_state(batch: Batch, state: Any) -> None:
    """Raise ValueError if a state belongs to another kind of arm."""
    table = check.table_of("state", state)
    check.known_keys("state", table, KEYS)
    for key in KEYS:
        if key not in table:
            raise check.MissingKey(f"state.{key}", "must be what get_state gave")
    own = batch.get_state(0)
    arm = check.table_of("state.arm", table["arm"])
    for name, value in own.items():
        given = check.needed("state.arm", arm, name, "must be what get_state gave")
        if np.shape(given) != np.shape(value):
            what = f"must be the state of an environment made alike ({np.size(value)} numbers)"
            raise check.InvalidValue(f"state.arm.{name}", f"{np.size(given)} numbers", what)
        if np.asarray(given).dtype.kind not in ("b" if isinstance(value, bool) else "fiu"):
            kind = "True or False" if isinstance(value, bool) else "numbers"
            raise check.InvalidValue(f"state.arm.{name}", given, f"must be {kind}, as get_state gave")
    check.integer("state.arm.stream", arm["stream"], minimum=0, maximum=2**64 - 1)
    check.array("state.arm.observation", arm["observation"], np.shape(own["observation"]))
    _check_block(batch, np.asarray(arm["block"], np.float64))
    check.instance("state.generator", table["generator"], np.random.Generator)
    if table["seed"] is not None:
        check.integer("state.seed", table["seed"], minimum=-1)  # Gymnasium's -1: not known
    if table["guide"] is not None:
        check.instance("state.guide", table["guide"], Guide)


def _check_block(batch: Batch, block: Array) -> None:
    """Raise ValueError if an arm's `block` is inconsistent.

    The causes are: an unknown mode or reason; a record (memory of sensors and motors) that is not finite; parameters
    that are too stiff for double precision.
    """
    at, lanes = batch.layout, len(batch.lane)
    par = len(block) - (at.end - at.par) // lanes
    for section, number, known in ((at.record, MODE, MODES), (at.info, batch.info_at.reason, tuple(REASONS))):
        k = par + (section - at.par) // lanes + number
        if block[k] not in known:
            what = f"must be one of {', '.join(f'{code:g}' for code in known)}, as get_state gave"
            raise check.InvalidValue(f"state.arm.block[{k}]", block[k], what)
    first, last = (par + (section - at.par) // lanes for section in (at.record, at.action))
    for k in first + np.flatnonzero(~(np.abs(block[first:last]) <= check.LARGEST)):
        raise check.InvalidValue(f"state.arm.block[{k}]", block[k], "must be a finite number, as get_state gave")
    factors = {name: block[par + k] for name, k in STIFFNESSES.items() if name in batch.reading.stiffnesses}
    precision.check_parameters(batch.arm, batch.settings, factors, block[par + TAU_D], 0.0, "state.arm")


def put_state(batch: Batch, i: int, state: dict[str, Any]) -> tuple[np.random.Generator, Any, Guide | None]:
    """Set arm i to a state; return the state's random generator, seed and guide (prescribed motion)."""
    batch.set_state(i, state["arm"])
    return copy.deepcopy(state["generator"]), state["seed"], copy.deepcopy(state["guide"])


def _check_linear(batch: Batch, arms: Sequence[int]) -> None:
    """Raise ValueError if an arm touches an obstacle or if joint parameters are drawn.

    Linear models do not include drawn joint parameters.
    """
    for i in arms if batch.contacts else ():
        if batch.view(i).touches[:, 6].any():
            what = "must not be touched by an arm whose linear model is computed: it has no contacts"
            raise check.InvalidValue("contacts", f"arm {i} touches", what)
    if batch.starts.laws:
        what = "must not be drawn for linear models"
        raise check.InvalidValue("randomization", "friction, backlash, motor_inertia or hub_inertia", what)


def linear_model(plan: Plan, batch: Batch, i: int, guide: Guide | None, discrete: float | None) -> LinearModel:
    """Return the linear model of arm i at its present state and torques."""
    from ..linear.state_space import linearize

    _check_linear(batch, [i])
    if guide is not None:
        return linearize(guide.simulation, discrete=discrete)
    assert plan.settings.dt is not None
    settings, method = plan.settings.dividing(discrete), "solver" if plan.arm.base is None else "zoh"
    simulation = Simulation(standing_scene(plan.arm, plan.settings.dt, plan.gravity), settings, False)
    q, v, u, simulation.par[:] = (rows[i] for rows in batch.motions())
    # the last rows of the batch are displacements of obstacles, which the scene lacks
    simulation.work.q[:], simulation.work.v[:] = q[: len(simulation.work.q)], v[: len(simulation.work.v)]
    simulation.set_torques(u)
    return linearize(simulation, discrete=discrete, method=method)


def linear_models(
    plan: Plan, batch: Batch, guides: dict[int, Guide], discrete: float | None, kept: dict[float | None, Linearizer]
) -> LinearModels:
    """Return the linear models of all arms. kept: cache of `Linearizer` objects by `discrete`, a period, s, or None."""
    from ..linear.many import Linearizer, compiled, stacked

    _check_linear(batch, range(batch.n))
    moves = any(contact.displacements for contact in batch.contacts)
    if guides or moves or not compiled(batch.system):
        return stacked([linear_model(plan, batch, i, guides.get(i), discrete) for i in range(batch.n)])
    if discrete not in kept:
        kept.clear()
        system, settings, dt = batch.system, plan.settings.dividing(discrete), plan.settings.dt
        assert dt is not None
        if settings.dt != dt:
            system = assemble(standing_scene(batch.arm, dt, plan.gravity), settings)
        kept[discrete] = Linearizer(system, settings, batch.n, batch.arm.n_links, discrete)
    return kept[discrete](*batch.motions())
