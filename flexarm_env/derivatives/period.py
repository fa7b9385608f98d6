"""Exact Jacobians and vector-Jacobian products of control periods."""

import math
import warnings
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .. import validation as check
from ..batch import Batch
from ..compiler import SINGLE, WIDEST, Crew, Placed, dual, entry, native, uncompiled
from ..physics import precision
from ..physics.model import NEWTON_FAILED, OK, OWN_IN_SPACE, STIFFNESSES, Jointed
from ..runtime import derivative
from ..runtime.adjoint import adjoint, recorded_step, room_of
from ..runtime.guided import unaccounted
from ..runtime.implicit import implicit
from ..runtime.layout import aligned, layout_of
from ..runtime.touch import contact_channels
from ..tasks.program import complete
from ..validation import Array
from .memory import Memory
from .methods import method_of
from .places import checked, laws_of, places_of

MOST_AT_ONCE = 3
"""Largest number of Jacobian columns per pass. More columns compile longer and are not cheaper per column."""


Found = TypeVar("Found", bound=tuple[Array, ...])


def _renamed(name: str, now: str) -> None:
    warnings.warn(f"{name}() is {now}() now", FutureWarning, stacklevel=3)


class Jacobians(NamedTuple):
    """Results of a control period of n arms, and their derivatives.

    A state has S entries, of which the first X = `Arms.moving` are variable. An action has A entries, an observation O
    entries. `moved` omits derivatives of and by constant entries of the state. A, B, C, D, r_x and r_u are the
    derivatives for complete states: constant entries do not change, and derivatives by them are zero.
    """

    state: Array  # (n, S): state one control period later
    observation: Array  # (n, O): observation one control period later
    reward: Array  # (n,): reward of the control period
    moved: Array  # (n, X + O + 1, X + A): rows for state, observation, reward; columns for state, action

    @property
    def _sizes(self) -> tuple[int, int, int, int]:
        entries, rows = self.observation.shape[1], self.moved.shape[1]
        moving = rows - entries - 1
        return moving, entries, self.state.shape[1], self.moved.shape[2] - moving

    def _whole(self, part: Array, *axes: int) -> Array:
        """Return a derivative with zeros inserted along its state axes for entries that do not move."""
        x, _, size, _ = self._sizes
        return np.pad(part, [(0, size - x if axis in axes else 0) for axis in range(part.ndim)])

    @property
    def A(self) -> Array:
        """Derivative of the next state by the state, (n, S, S)."""
        x, _, size, _ = self._sizes
        full = self._whole(self.moved[:, :x, :x], 1, 2)
        full[:, np.arange(x, size), np.arange(x, size)] = 1.0
        return full

    @property
    def B(self) -> Array:
        """Derivative of the next state by the action, (n, S, A)."""
        x = self._sizes[0]
        return self._whole(self.moved[:, :x, x:], 1)

    @property
    def C(self) -> Array:
        """Derivative of the observation by the state, (n, O, S)."""
        x, entries, _, _ = self._sizes
        return self._whole(self.moved[:, x : x + entries, :x], 2)

    @property
    def D(self) -> Array:
        """Derivative of the observation by the action, (n, O, A)."""
        x, entries, _, _ = self._sizes
        return self.moved[:, x : x + entries, x:]

    @property
    def r_x(self) -> Array:
        """Derivative of the reward by the state, (n, S)."""
        return self._whole(self.moved[:, -1, : self._sizes[0]], 1)

    @property
    def r_u(self) -> Array:
        """Derivative of the reward by the action, (n, A)."""
        return self.moved[:, -1, self._sizes[0] :]

    def jvp(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Multiply the Jacobians by tangents of state (n, S) and action (n, A).

        Returns the tangents of next state (n, S), observation (n, O) and reward (n,).
        """
        x, entries, _, _ = self._sizes
        both = np.concatenate([state[:, :x], action], axis=1)
        out = (self.moved @ both[:, :, None])[:, :, 0]
        after = np.concatenate([out[:, :x], state[:, x:]], axis=1)
        return after, out[:, x : x + entries], out[:, -1]

    def vjp(self, state: Array, observation: Array, reward: Array) -> tuple[Array, Array]:
        """Convert a scalar's derivatives by the results ("cotangents") to its derivatives by state and action.

        state (n, S), observation (n, O), reward (n,): derivatives by next state, observation and reward.
        """
        x = self._sizes[0]
        given = np.concatenate([state[:, :x], observation, reward[:, None]], axis=1)
        out = (given[:, None, :] @ self.moved)[:, 0]
        out[~given.any(axis=1)] = 0.0  # nothing is asked, also of a solver that failed
        return np.concatenate([out[:, :x], state[:, x:]], axis=1), out[:, x:]

    def push(self, *items: Any) -> tuple[Array, Array, Array]:
        """Deprecated name of `jvp`, for one release."""
        _renamed("push", "jvp")
        return self.jvp(*items)

    def pull(self, *items: Any) -> tuple[Array, Array]:
        """Deprecated name of `vjp`, for one release."""
        _renamed("pull", "vjp")
        return self.vjp(*items)


class Differentiable(Protocol):
    """Interface of n arms whose control periods have derivatives; `Arms` and `Periods` implement it.

    Attributes:
        n: number of arms. state_size, action_size, observation_size: lengths S, A, O of a state, an action and an
            observation.
        moving: number of variable entries at the beginning of a state; all other entries are constant.
        failed: array (n,), True for arms whose solver failed in the last call.
        past: array (n,), True for arms with a joint beyond its limits at the end of the last call.
    """

    n: int
    state_size: int
    action_size: int
    observation_size: int
    moving: int
    failed: NDArray[np.bool_]
    past: NDArray[np.bool_]

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Return next state (n, S), observation (n, O) and reward (n,)."""

    def jacobians(self, state: Array, action: Array) -> Jacobians:
        """Return the results of `step` with their derivatives."""

    def vjp(
        self, state: Array, action: Array, state_bar: Array, observation_bar: Array, reward_bar: Array
    ) -> tuple[Array, Array]:
        """Return the cotangents of state and action for cotangents of the results of `step`; see `Jacobians.vjp`."""

    def observe(self, state: Array) -> Array:
        """Return the observations (n, O) of states."""

    def observe_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return the observations (n, O) and their derivatives (n, O, S)."""


class Periods:
    """Control periods of the arms of a batch, with exact derivatives; see `Arms` for states, steps and failures.

    Args:
        batch: the `Batch` of arms. parameters: True to differentiate by parameters, too.
        kept: True if states contain accelerations and torques although each period recomputes the accelerations.
        guided: pair (index, `envs.motion.Guide`) of a single arm with prescribed motion, or None for all arms.
        alone: which arms are computed one at a time, with halved steps if Newton's iteration fails: "all", "none", or
            "failed". As in the environment, "failed" selects the arms whose iteration failed when all arms were
            computed together. whole: True to include the terms of parameters that are zero in the arm, such as the
            payload's mass.
    Attributes:
        n, state_size, action_size, observation_size, moving, names, failed, past: as in `Arms`.
        backwards: True if the model has kernels that compute `vjp`.
        step_ends: array (n, K), coordinates and rates at the ends of the last call's time steps; None in the plane."""

    def __init__(
        self, batch: Batch, parameters: bool = False, kept: bool = False, guided: tuple[int, Any] | None = None,
        alone: str = "failed", whole: bool = False,
    ) -> None:  # fmt: skip
        if WIDEST is SINGLE:
            raise RuntimeError("derivatives are compiled: there are none where compilation is disabled")
        self._batch, self.parameters, self._guided = batch, parameters, guided
        if batch.extras.instruments is not None and uncompiled(contact_channels)(batch.extras.instruments):
            what = "must be left out here: states have no contact forces in them"
            raise check.InvalidValue("sensors", "force or switch", what)
        task, program, extras = batch.task, batch.program._replace(watched=None), batch.extras
        motions = 0
        if guided is not None:
            own = guided[1].bind(batch, guided[0])
            program, motions = own._replace(watched=None, guide=unaccounted(own.guide)), own.guide.motions
        self.n = program.n
        if parameters or whole:
            program = complete(program)
        if parameters and isinstance(program.model, Jointed):
            # joint laws of each arm, whose cotangents the contributions' own functions leave out
            own = program.model.own or (0,) * len(batch.system.par)
            program = program._replace(model=program.model._replace(own=own, derived=(0,)))
        model, fitted = program.model, program.models is not None
        self.action_size = len(task.links)
        lanes, layout = len(batch.lane), batch.layout
        if guided is not None:
            lanes, layout = 1, program.layout
        self._own, names, core = places_of(batch, model, lanes, layout, parameters, kept)
        self._memory = Memory(batch, core)
        self.names, self.moving = self._memory.names(names), self._memory.moving
        self.state_size = len(self.names)
        method = method_of(model, program, extras, kept, alone)
        joined = model.algebraic is not None  # by multipliers, whose matrix has no lanes
        lane = SINGLE if joined or guided or alone == "all" else WIDEST
        lanes, columns = len(lane), core + self.action_size
        side_by_side = method.by_equations or len(lane) == 1
        at_once = -(-columns // -(-columns // MOST_AT_ONCE)) if side_by_side else 1
        chunks = -(-columns // at_once) if method.by_equations else 1
        self._derivative, self.backwards = implicit if method.by_equations else derivative.tangents, method.backwards
        both = dual(lane, at_once)
        layouts = [
            layout_of(k, batch.reading, model, task, batch.entries, extras, fitted, motions) for k in (lanes, len(both))
        ]
        seen, rows, size = self._memory.entries, core + self._memory.entries + 1, len(names)
        self.observation_size = self._memory.size
        stiff = "EI_factor", "EI_y_factor", "GJ_factor", "tau_d"
        self._stiff = [k for k, name in enumerate(self.names) if name in stiff or name[:10] == "stiffness["]
        self._last_stiff: list[float] = []
        self._least = [k for k, name in enumerate(self.names) if name in OWN_IN_SPACE]
        self._laws = None
        if parameters and isinstance(model, Jointed) and not batch.starts.laws:
            self._laws = laws_of(model, names)
        self._groups = -(-self.n // lanes)
        self.failed, self.past = np.zeros(self.n, np.bool_), np.zeros(self.n, np.bool_)
        blocks = [aligned(self._groups * k, layout.row) for k, layout in zip((1, chunks), layouts, strict=True)]
        self._blocks, room = blocks, 0
        if guided is None:
            room = lanes * int(uncompiled(room_of)(model, task, program.actuator, program.n_steps)) * self.backwards
        records = self.backwards and model.newton.rotations is not None
        recorded = 2 * self.n * program.n_steps * len(model.weight) if records else 0
        self._program = derivative.Derivative(
            lane=lane, dual=both, program=program, plain=layouts[0], both=layouts[1], columns=columns,
            moving=core, parameters=(0,) if parameters else None, passes=method.passes,
            places=places_of(batch, model, lanes, layouts[0], parameters, kept)[0],
            twice=places_of(batch, model, len(both), layouts[1], parameters, kept)[0],
            chosen=np.asarray(self._memory.chosen, np.int64), n=self.n,
            state=np.zeros(self.n * size), action=np.zeros(self.n * self.action_size),
            after=np.zeros(self.n * size), observation=np.zeros(self.n * seen),
            reward=np.zeros(self.n), failed=np.zeros(self.n, np.uint8), past=np.zeros(self.n, np.uint8),
            level=np.zeros(self.n), jacobian=np.zeros(self.n * rows * columns),
            state_bar=np.zeros(self.n * size), observation_bar=np.zeros(self.n * seen),
            reward_bar=np.zeros(self.n), action_bar=np.zeros(self.n * self.action_size),
            bars=aligned(self._groups, layouts[0].row).reshape(-1),
            step_ends=np.zeros(recorded), known=np.zeros(1), tape=aligned(self._groups, room).reshape(-1), room=room,
            block=blocks[0].reshape(-1), scratch=blocks[1].reshape(-1),
        )  # fmt: skip
        self._shape = (self.n, rows, columns)
        self._placed = Placed(self._program)
        self._kept, self._repeats, self._stuck = kept, alone == "failed" and len(lane) > 1, np.zeros(self.n, np.bool_)
        self._one: Periods | None = None
        self.step_ends: Array | None = None
        self._threads = 1 if guided else batch.threads
        self._crew = Crew(self._threads - 1)
        self._entries: dict[Any, Any] = {}

    # --- states ----------------------------------------------------------------------------------
    def states(self) -> Array:
        """Return the present states (n, S) of the batch's arms."""
        first = 0
        if self._guided is not None:
            first, guide = self._guided
            guide.bind(self._batch, first)
            rows = guide.block[None, self._own]
        else:
            lanes = len(self._batch.lane)
            rows = self._batch.block[:, (self._own[:, None] + np.arange(lanes)).ravel()]
            rows = rows.reshape(len(rows), len(self._own), lanes).transpose(0, 2, 1)
            rows = rows.reshape(-1, len(self._own))[: self.n].copy()
        if self._laws is not None:
            rows[:, self._laws[0]] = self._laws[1]  # of the arms' joints, which the batch has once
        return self._memory.with_past(rows, first)

    def observe(self, state: Array) -> Array:
        """Return the observations (n, O) of states (n, S)."""
        self._put(state, None)
        if self._memory.frames:
            return self._memory.shown(self._past)
        self._run(derivative.observe)
        return self._rows("observation", self.observation_size)

    def step(self, state: Array, action: Array) -> tuple[Array, Array, Array]:
        """Return state (n, S), observation (n, O) and reward (n,) after a period with actions (n, A) clipped to +-1."""
        self._put(state, action)
        records = self._program.step_ends.size > 0
        self._program.known[0] = 0.0
        self._run(recorded_step if records else derivative.step)
        self.step_ends = self._rows("step_ends", -1) if records else None
        return self._with_halved("step", self._outcome(), state, action)

    # --- derivatives -----------------------------------------------------------------------------
    def jacobians(self, state: Array, action: Array) -> Jacobians:
        """Return the results of `step` and their derivatives. Derivatives by a clipped action are zero."""
        given = self._put(state, action)
        self._run(self._derivative)
        moved = self._program.jacobian.reshape(self._shape).copy()
        moved[:, :, self._program.moving :] *= (np.abs(given) <= 1.0)[:, None, :]
        outcome, moved = self._outcome(), self._memory.whole(moved)
        moved[self.failed] = np.nan
        return self._with_halved("jacobians", Jacobians(*outcome, moved), state, action)

    def vjp(
        self, state: Array, action: Array, state_bar: Array, observation_bar: Array, reward_bar: Array,
        step_ends: Array | None = None,
    ) -> tuple[Array, Array]:  # fmt: skip
        """Return a scalar's derivatives by states (n, S) before a control period and by the period's actions (n, A).

        state_bar (n, S), observation_bar (n, O), reward_bar (n,): derivatives of the scalar by state, observation and
        reward after the control period. step_ends: attribute `step_ends` after this step, so that `vjp` need not solve
        the steps again. If the model has kernels for this function (`backwards`), a call takes a few times as long as
        the simulation of a period. For other models the function computes the Jacobians."""
        given = checked("state_bar", state_bar, (self.n, self.state_size))
        seen = checked("observation_bar", observation_bar, (self.n, self.observation_size))
        paid = checked("reward_bar", reward_bar, (self.n,))
        if not self.backwards:
            return self.jacobians(state, action).vjp(given, seen, paid)
        d, asked = self._program, self._put(state, action)
        own, past, last = self._memory.vjp(given, seen)
        d.state_bar[:], d.observation_bar[:], d.reward_bar[:] = own.ravel(), last.ravel(), paid
        d.known[0] = float(step_ends is not None and d.step_ends.size > 0)
        if d.known[0]:
            d.step_ends[:] = checked("step_ends", step_ends, (self.n, d.step_ends.size // self.n)).ravel()
        self._run(adjoint)
        self._note_failures()
        by_state = self._memory.joined(self._rows("state_bar", own.shape[1]), past)
        by_action = self._rows("action_bar", self.action_size)
        by_action *= np.abs(asked) <= 1.0
        if self.failed.any():
            lost = self.failed & (given.any(axis=1) | seen.any(axis=1) | (paid != 0.0))
            for values in (by_state, by_action):
                values[self.failed] = 0.0  # of an arm that is asked nothing, whatever became of it
                values[lost] = np.nan
        return self._with_halved("vjp", (by_state, by_action), state, action, given, seen, paid)

    def pull(self, *items: Any) -> tuple[Array, Array]:
        """Deprecated name of `vjp`, for one release."""
        _renamed("pull", "vjp")
        return self.vjp(*items)

    def observe_jacobian(self, state: Array) -> tuple[Array, Array]:
        """Return the observations (n, O) of states (n, S), and their derivatives (n, O, S)."""
        self._put(state, None)
        x, entries = self._program.moving, self.observation_size
        slopes = np.zeros((self.n, entries, self.state_size))
        if self._memory.frames:
            slopes[:, np.arange(entries), x + np.arange(entries)] = 1.0
            return self._memory.shown(self._past), slopes
        self._run(derivative.observation_tangents)
        slopes[:, :, :x] = self._program.jacobian.reshape(self._shape)[:, x : x + entries, :x]
        return self._rows("observation", entries), slopes

    def close(self) -> None:
        """Stop the threads that advance the arms."""
        self._crew.close()
        if self._one is not None:
            self._one.close()

    # --- inside ----------------------------------------------------------------------------------
    def _put(self, state: Array, action: Any) -> Array:
        d = self._program
        rows = checked("state", state, (self.n, self.state_size))
        if self.parameters:
            self._carried(rows)
        d.state.reshape(self.n, -1)[:], self._past = self._memory.parts(rows)
        given = np.zeros((self.n, self.action_size))
        if action is not None:
            given = checked("action", action, (self.n, self.action_size))
        taken = d.action.reshape(self.n, -1)
        np.clip(given, -1.0, 1.0, out=taken)
        taken[np.isinf(given)] = np.nan  # fails, as in the environment
        return given

    def _carried(self, rows: Array) -> None:
        """Raise ValueError for an infinite parameter, one too stiff for double precision, or a factor <= 0.

        Masses and tau_d near 0 may be negative, because differences need such values.
        """
        least = np.fmin.reduce(rows[:, self._least], axis=0)
        for k, value in zip(self._least, least.tolist(), strict=True):
            factor = self.names[k].endswith("_factor")
            low = factor and value <= 0.0
            if low or np.isinf(rows[:, k]).any():
                what = f"must be a {'positive' if factor else 'finite'} number"
                raise check.InvalidValue(f"state.{self.names[k]}", value if low else math.inf, what)
        most = np.fmax.reduce(rows[:, self._stiff], axis=0).tolist()
        if most != self._last_stiff:
            of = dict(zip((self.names[k] for k in self._stiff), most, strict=True))
            factors = {name: of[f"{name}_factor"] for name in STIFFNESSES if f"{name}_factor" in of}
            spring = max((of[name] for name in of if name.startswith("stiffness[")), default=0.0)
            precision.check_parameters(self._batch.arm, self._batch.settings, factors, of["tau_d"], spring, "state")
            self._last_stiff = most

    def _rows(self, name: str, size: int) -> Array:
        return np.array(getattr(self._program, name).reshape(self.n, size))

    def _outcome(self) -> tuple[Array, Array, Array]:
        d = self._program
        self._note_failures()
        past, seen = self._memory.after(self._past, self._rows("observation", self._memory.entries))
        after, reward = self._memory.joined(self._rows("after", len(self._own)), past), d.reward.copy()
        if self.failed.any():
            for values in (after, seen, reward):
                values[self.failed] = np.nan
        return after, seen, reward

    def _note_failures(self) -> None:
        self.failed, self.past = self._program.failed != OK, self._program.past.astype(np.bool_)
        if self.failed.any():
            d = self._program
            sound = [np.isfinite(rows.reshape(self.n, -1)).all(axis=1) for rows in (d.state, d.action)]
            self._stuck[:] = (d.failed == NEWTON_FAILED) & sound[0] & sound[1] & self._repeats
            for block in self._blocks:
                block[:] = 0.0
        else:
            self._stuck[:] = False

    def _with_halved(self, name: str, found: Found, *rows: Any) -> Found:
        """Return the results `found` of a method. Arms whose Newton iteration failed are repeated alone, with half the
        step, as the environment does."""
        for i in np.flatnonzero(self._stuck).tolist():
            if self._one is None:
                self._one = Periods(self._batch.alone(), self.parameters, self._kept, alone="all")
            own = getattr(self._one, name)(*(np.asarray(row)[i : i + 1] for row in rows))
            for values, value in zip(found, own, strict=True):
                values[i] = value[0]
            self.failed[i], self.past[i] = self._one.failed[0], self._one.past[0]
        return found

    def _run(self, function: Any) -> None:
        if function not in self._entries:
            made = entry(function, self._placed, 0, 0)
            self._entries[function] = made, native(function, self._placed, 0, 0) if self._threads > 1 else 0
        made, code = self._entries[function]
        if code:
            self._crew.run(code, self._placed.address, self._groups)
        else:
            made(self._placed.address, 0, self._groups)
