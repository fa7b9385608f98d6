"""Jacobians and cotangents of a control period: against differences of the period itself, and against one another."""

import dataclasses
from collections.abc import Sequence
from functools import partial
from typing import Any

import numpy as np
import pytest

from flexarm_env import arms as arms_by_name
from flexarm_env.compiler import SINGLE, kernel, size
from flexarm_env.derivatives import Arms, Jacobians
from flexarm_env.parameters import Payload
from flexarm_env.physics.joints.layout import PLACE, PLACES
from flexarm_env.physics.protocol import State, Weights, assemble, factor, solve, solve_transposed
from flexarm_env.validation import Array
from tests.differences import central
from tests.refusals import refuses


def case(name: str, env_id: str, tolerance: float = 1e-12, back: bool = False, **keywords: Any) -> Any:
    """back: cotangents have kernels of their own."""
    return pytest.param(env_id, {"tolerance": tolerance, **keywords}, back, id=name)


def rough(links: int = 1, **joint: Any) -> Any:
    """An arm behind gears with Coulomb friction; what else its joints have."""
    arm = arms_by_name.named("strip_geared" if links == 1 else "two_link_geared")
    return dataclasses.replace(arm, joints=[dataclasses.replace(own, **joint) for own in arm.joints])


def geared(links: int = 1) -> Any:
    """The same without it, whose kinks differences would step over."""
    return rough(links, friction_coulomb=0.0)


def bare(arm: Any) -> Any:
    """An arm without rigid ends."""
    none = {f"{end}_{what}": 0.0 for end in ("root", "tip") for what in ("offset", "mass", "inertia")}
    return dataclasses.replace(arm, links=[dataclasses.replace(link, **none) for link in arm.links])


def laden() -> Any:
    """Two links with rigid ends behind gears, and a payload off the tip."""
    arm = geared(2)
    return dataclasses.replace(arm, payload=dataclasses.replace(arm.payload, mass=0.1, offset=(0.03, 0.02)))


def heavy() -> Any:
    """One link with a payload that has inertia."""
    return dataclasses.replace(arms_by_name.named("strip"), payload=Payload(0.1, 1e-3))


def dragged() -> Any:
    """Two links with damping that goes with mass."""
    return dataclasses.replace(arms_by_name.named("de_luca_siciliano"), mass_damping=0.3)


_THREE = arms_by_name.named("three_dof")
SHORT = dataclasses.replace(
    _THREE, links=_THREE.links[:2], elbows=_THREE.elbows[:1], torque_limits=(_THREE.torque_limits or ())[:2]
)
"""Yaw and a strip that pitches, bends both ways and twists."""

FLOOR = {
    "obstacle": {"shape": "half_space", "point": [0.0, 0.0, 0.35], "normal": [0.0, 0.0, 1.0]}, "stiffness": 200.0,
    "exponent": 2.0, "damping": 0.3, "friction": 0.3, "creep": 0.05,
}  # fmt: skip
"""A soft floor that one of nine arms at their starts presses on: force and slope are continuous in the penetration."""

ONE, TWO = "FlexibleArm-v0", "TwoLinkFlexArm-v0"
FLOATING, EXACT = {"formulation": "floating_frame"}, {"formulation": "geometrically_exact"}
FALL = {"gravity": (0.0, -9.81), "rules": 1}  # targets that the motors cannot hold, which rules 2 refuse
ROOT_MODES = {"frame": "root", "modes": 2, "segments": 1}
MULTIPLIERS = {"multipliers": True, **FLOATING}
GAUGE = {"strain_gauges": [{"place": 0.1, "gain": (0.9, 1.1), "delay": 0.02}]}
SENSORS = {
    **GAUGE,
    "encoders": {"low_pass": {"frequency": 15.0, "order": 2}, "delay": 0.03},
    "accelerometer": {"bias": 0.1, "low_pass": {"frequency": 10.0}},
    "camera": {"period": 0.06, "delay": 0.025},
}
EVENTS = {
    "pushes": {"wait": (0.02, 0.06), "force": (0.1, 0.3), "lasting": 0.2},
    "payload_change": {"time": (0.06, 0.06), "factor": (0.5, 2.0)},
}
"""A push in the period that is looked at, and a payload that changes at its start."""
PAID = {"success": {"position": 0.3, "speed": 1.0, "paid": True}, "reward": {"change": 0.3, "accuracy": 0.2}}
PD, MOTORS = {"action_mode": "residual_pd", "residual_share": 0.3}, {"actuator": {"lag": 0.01, "delay": 0.02}}
LATE = {"actuator": {"lag": 0.01, "delay": (0.0, 0.04)}}
LAWS = {"randomization": {"hub_inertia": (0.5, 2.0), "motor_inertia": (0.5, 2.0)}}
CASES = [
    case("one link", ONE, back=True),
    case("success that is paid, the change of actions", ONE, back=True, **PAID),
    case("motors with a drawn delay, controllers, the change of actions", TWO, back=True, **PAID, **PD, **LATE),
    case("three links", "MultiLinkFlexArm-v0", back=True),
    case("parameters", ONE, back=True, parameters=True, gravity=(0.0, -9.81), randomization={"payload": (0.5, 1.5)}),
    case("floating frame", ONE, back=True, formulation="floating_frame"),
    case("exact beam, period corrected", ONE, 1e-14, formulation="geometrically_exact", period_correction=True),
    case("gears", ONE, back=True, arm=geared()),
    case("gears, floating frame", TWO, back=True, arm=geared(2), **FLOATING),
    case("floating frame, modes, two links", TWO, back=True, modes=2, segments=1, **FLOATING),
    case("root frames, payload off the tip", TWO, back=True, arm=laden(), frame="root", **FALL, **MOTORS, **FLOATING),
    case("root frames, modes, drag", TWO, 1e-14, back=True, arm=dragged(), parameters=True, **ROOT_MODES, **FLOATING),
    case("motors and controllers, floating frame", TWO, back=True, **MOTORS, **PD, **FLOATING),
    case("motors and controllers, exact beam", TWO, 1e-14, back=True, **MOTORS, **PD, **EXACT),
    case("a hub and laws drawn, parameters", ONE, back=True, arm=geared(), parameters=True, **LAWS),
    case("a hub and laws drawn", TWO, back=True, arm=geared(2), **LAWS),
    case("a hub drawn, parameters", ONE, back=True, parameters=True, randomization={"hub_inertia": (0.5, 2.0)}),
    case("targets", TWO, back=True, task="track", sensors={"delay": 0.04}),
    case("strain gauges", TWO, back=True, sensors={"strain_gauges": [{"place": 0.1}]}),
    case("pushes", ONE, back=True, pushes=EVENTS["pushes"]),
    case("pushes, floating frame", TWO, back=True, pushes=EVENTS["pushes"], **FLOATING),
    case("targets, late, several at once", ONE, task="track", history=2, sensors={"delay": 0.04, **GAUGE}),
    case("sensors' gains and biases", ONE, parameters=True, observation="measured", sensors=SENSORS, history=2),
    case("targets, sensors", TWO, task="track", observation="measured", sensors=SENSORS, history=2),
    case("steps fitted", ONE, step_tolerance=1e-5),
    case("steps fitted, floating frame", TWO, step_tolerance=1e-5, **MOTORS, **FLOATING),
    case("pushes and payloads", ONE, **EVENTS),
    case("pushes and payloads, floating frame", TWO, **EVENTS, **FLOATING),
    case(
        "gravity, motors, exact beam", TWO, 1e-14, back=True, arm="two_link_upright", dt=0.0025,
        **FALL, **MOTORS, **EXACT,
    ),
    case("commands late by a period, exact beam", ONE, 1e-14, back=True, actuator={"delay": 0.02}, **EXACT),
    case("commands late by two steps, floating frame", ONE, back=True, actuator={"delay": 0.005}, **FLOATING),
    case("rigid ends, exact beam", ONE, 1e-14, back=True, arm=geared(), **EXACT),
    case("parameters, exact beam", ONE, 1e-14, back=True, parameters=True, arm=heavy(), **FALL, **EXACT),
    case("multipliers", ONE, parameters=True, gravity=(0.0, -9.81), **MULTIPLIERS),
    case("multipliers, motors and controllers", TWO, segments=1, elements=1, **MOTORS, **PD, **MULTIPLIERS),
]


def moving(arms: Arms, seed: int = 0, periods: int = 3) -> tuple[Array, Array]:
    """A state on the way, and an action."""
    rng, shape = np.random.default_rng(seed), (arms.n, arms.action_size)
    state = arms.reset(seed=seed)
    for _ in range(periods):
        state = arms.step(state, rng.uniform(-0.7, 0.7, shape))[0]
    state[:, [name.startswith(("asked", "motor")) for name in arms.names]] *= 0.9  # motors at their limits have a kink
    return state, rng.uniform(-0.7, 0.7, shape)


def after(arms: Arms, state: Array, action: Array) -> Array:
    """What moves a period later, the observation and the reward."""
    out = arms.step(state, action)
    return np.concatenate([out[0][:, : arms.moving], out[1], out[2][:, None]], axis=1)


def differences(arms: Arms, state: Array, action: Array, found: Array, share: float = 1.0) -> Array:
    """(n, X + O + 1, X + A) by sixth-order differences; `found` says how far each number may be moved, by a share."""
    there, columns = np.maximum(1e-2, np.abs(after(arms, state, action)).max(axis=0)), []
    both = np.concatenate([state, action], axis=1)
    for j, k in enumerate([*range(arms.moving), *range(arms.state_size, both.shape[1])]):
        e = share * 1e-3 / max(1e-3, (np.abs(found[:, :, j]).max(axis=0) / there).max())
        if arms.environment.batch.extras.payload_change is not None:
            e *= 100.0  # what damping leaves of an impact is asked for at a thousandth of the velocity (`impact`)
        settings, actuator = arms.environment.plan.settings, arms.environment.plan.extras.actuator
        stiff = settings.formulation == "geometrically_exact" and not arms.environment.plan.arm.spatial
        if stiff and not settings.period_correction:
            # accelerations are as fine as the solver's tolerance makes them, less so where torques jump in each step
            e = min((300.0 if actuator is None else 3000.0) * e, 1e-3)
        if settings.multipliers:
            e = max(e, 1e-6)  # likewise
        if stiff and [*arms.names, ""][min(k, arms.state_size)] in ("payload_inertia", "tau_d"):
            e = min(e, 0.02 * abs(both[:, k]).min())  # what is small is not moved through zero

        def moved(way: float, k: int = k) -> Array:
            x = both.copy()
            x[:, k] += way
            return after(arms, x[:, : arms.state_size], x[:, arms.state_size :])

        column = central(moved, e)
        if not np.isfinite(column).all():  # moved so far that the solver failed
            column = central(moved, e / 4.0)
        columns.append(column)
    return np.stack(columns, axis=2)


def off(found: Array, wanted: Array) -> float:
    """The largest of the arms' errors (n, ...) over the size of what is wanted."""
    axes = tuple(range(1, wanted.ndim))
    return float((np.sqrt(((found - wanted) ** 2).sum(axes)) / np.sqrt((wanted**2).sum(axes))).max())


def as_a_step(arms: Arms, state: Array, action: Array) -> Jacobians:
    """The Jacobians, whose values are those of a step."""
    found = arms.jacobians(state, action)
    for one, other in zip(found[:3], arms.step(state, action), strict=True):
        assert np.array_equal(one, other)
    return found


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "keywords", "back"), CASES)
def test_a_period_against_differences_and_backwards(env_id: str, keywords: dict[str, Any], back: bool) -> None:
    """Relative error below 1e-6 for each arm; the values are those of a step and of the environment, bit for bit;
    cotangents are what the Jacobians give, to 1e-12 of the elastica's and 1e-10 of stiff arms."""
    arms = Arms(env_id, 9, **keywords)
    assert arms.backwards == back
    as_in_the_environment(arms)
    state, action = moving(arms)
    found = as_a_step(arms, state, action)
    assert off(found.moved, differences(arms, state, action, found.moved)) < 1e-6

    as_the_jacobians(arms, (state, arms.reset(seed=1)), action, 1e-10 if "formulation" in keywords else 1e-12)
    along(arms, state, 10, 1e-3, 1e-6)
    along(arms, arms.reset(seed=2), 200, 1e-5, 1e-4)
    arms.close()


def as_the_jacobians(
    arms: Arms, states: Sequence[Array], action: Array, most: float, rng: np.random.Generator | None = None
) -> Jacobians:
    """Cotangents are what the Jacobians give, in an episode's first period too, where accelerations are solved for; the
    last state's Jacobians."""
    rng = np.random.default_rng(1) if rng is None else rng
    for state in states:
        found = arms.jacobians(state, action)
        bars = [rng.normal(size=values.shape) for values in found[:3]]
        arms.step(state, action)
        for step_ends in (None, arms.step_ends):
            back = arms.vjp(state, action, *bars, step_ends=step_ends)
            for one, other in zip(back, found.vjp(*bars), strict=True):
                assert abs(one - other).max() < most * abs(other).max()
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "keywords",
    [
        {"parameters": True},
        {**PAID, **MOTORS, **PD},
        {"task": "track", "arm": "three_dof"},
        {"geared": True, **MOTORS},
        {"segments": 1, "parameters": True, **FLOATING},
        {"modes": 3, "dt": 0.0025, **FLOATING},
        {"contacts": FLOOR, "rules": 1},
    ],
    ids=["parameters", "motors", "targets", "gears", "floating frame", "modes", "contact"],
)
def test_in_space(keywords: dict[str, Any]) -> None:
    """Of `SHORT`: relative error of a period below 3e-6 for each arm, by
    one of two steps of the differences (forces are cut off in Newton's matrix, which is a kink of 1e-4 that one of them
    may step over; accelerations have round-off of 1e-6), of five periods' observations below 1e-5. Cotangents
    have their own kernels, and are what the Jacobians give to 1e-10."""
    arm = dataclasses.replace(SHORT, joints=geared(2).joints) if keywords.pop("geared", False) else SHORT
    mesh = {} if "formulation" in keywords else {"elements": 1}
    arms = Arms("SpatialFlexArm-v0", 9, tolerance=1e-14, **mesh, **{"arm": arm, "dt": 0.0025, **keywords})
    assert arms.backwards
    as_in_the_environment(arms)
    state, action = moving(arms)
    touching = [float(arms.environment.batch.view(i).touches[:, 6].sum()) > 1.0 for i in range(arms.n)]
    assert any(touching) == ("contacts" in keywords)
    found = as_a_step(arms, state, action)
    errors = []
    for share in (1.0, 0.1):
        wanted = differences(arms, state, action, found.moved, share)
        errors.append(np.linalg.norm(found.moved - wanted, axis=(1, 2)) / np.linalg.norm(wanted, axis=(1, 2)))
    assert np.minimum(*errors).max() < 3e-6
    as_the_jacobians(arms, (state, arms.reset(seed=1)), action, 1e-10)
    along(arms, state, 5, 1e-5, 1e-5)
    arms.close()


@pytest.mark.slow
def test_factors_in_space_are_those_on_sections() -> None:
    """Periods of an arm with a factor are those of an arm made with it, to round-off; so are derivatives by it, whose
    columns are differences between such arms."""

    def made(**stiffer: float) -> Arms:
        sections = [{name: f * getattr(link.section, name) for name, f in stiffer.items()} for link in SHORT.links[1:]]
        links = [dataclasses.replace(link, section=dataclasses.replace(link.section, **fields))
                 for link, fields in zip(SHORT.links[1:], sections, strict=True)]  # fmt: skip
        arm = dataclasses.replace(SHORT, links=(SHORT.links[0], *links))
        return Arms("SpatialFlexArm-v0", 3, tolerance=1e-14, elements=2, arm=arm, parameters=True)

    arms = made()
    state, action = moving(arms)
    found = arms.jacobians(state, action)
    for name in ("EI", "EI_y", "GJ"):
        k, e = arms.names.index(f"{name}_factor"), 1e-3
        state[:, k], there = 1.1, made(**{name: 1.1})
        own, state[:, k] = arms.step(state, action)[1], 1.0
        assert abs(own - there.step(state, action)[1]).max() < 1e-10
        there.close()
        assert abs(own - found.observation).max() > 1e-5

        def stiffer(way: float, name: str = name) -> Array:
            there = made(**{name: 1.0 + way})
            moved = after(there, state, action)
            there.close()
            return moved

        total = central(stiffer, e, 2)
        total[:, k] = 1.0  # the factor itself
        assert np.linalg.norm(found.moved[:, :, k] - total) < 1e-5 * np.linalg.norm(total)
    arms.close()


@kernel
def _solved(lane, model, par, state, u, r, S, plain, transposed):  # type: ignore[no-untyped-def]
    """Replace the rows of both matrices by S^-1 and S^-T times them."""
    assemble(lane, model, par, state, u, Weights(1.0, 0.01, 1e-4, newton_share=1.0), r, S)
    factor(lane, model, S)
    for k in range(plain.shape[0]):
        solve(lane, model, S, plain[k])
        solve_transposed(lane, model, S, transposed[k])


@pytest.mark.slow
@pytest.mark.parametrize("modes", [None, 2])
def test_the_transposed_solution_in_space(modes: int | None) -> None:
    """The columns of S^-T are the rows of S^-1, with modes within segments and without, two segments a link."""
    mesh = {"segments": 2, **FLOATING, **({} if modes is None else {"modes": modes})}
    arms = Arms("SpatialFlexArm-v0", 1, arm=SHORT, dt=0.0025, **mesh)
    system, rng = arms.environment.batch.system, np.random.default_rng(0)
    model, n = system.model, len(system.q0)
    state = State(system.q0 + 0.1 * rng.normal(size=n), rng.normal(size=n), rng.normal(size=n))
    u, S = np.zeros(int(size(model.n_inputs))), np.zeros(int(size(model.n_factor)))
    plain, transposed = np.eye(n), np.eye(n)
    _solved(SINGLE, model, system.par, state, u, np.zeros(n), S, plain, transposed)
    assert abs(plain - plain.T).max() > 1e-3 * abs(plain).max()  # S is not symmetric
    assert abs(plain - transposed.T).max() < 1e-12 * abs(plain).max()
    arms.close()


@pytest.mark.slow
def test_dry_friction_in_space() -> None:
    """Joints stick and slide as they did, backwards as forwards; differences would step over the kinks."""
    arm = dataclasses.replace(SHORT, joints=rough(2).joints)
    arms = Arms("SpatialFlexArm-v0", 9, tolerance=1e-14, elements=1, dt=0.0025, arm=arm)
    assert arms.backwards
    state, action = moving(arms)
    found = as_the_jacobians(arms, (state, arms.reset(seed=1)), action, 1e-10)
    # an arm whose step failed has no step_ends; its neighbors in the lanes have theirs
    bars = np.ones_like(found.state), np.ones_like(found.observation), np.ones(9)
    arms.step(state, action)
    steps, whole = arms.step_ends, arms.vjp(state, action, *bars, step_ends=arms.step_ends)[0]
    arms._repeats, steps[2] = False, np.nan
    part = arms.vjp(state, action, *bars, step_ends=steps)[0]
    assert arms.failed.tolist() == [k == 2 for k in range(9)] and np.isnan(part[2]).all()
    assert np.array_equal(np.delete(part, 2, 0), np.delete(whole, 2, 0))
    arms.close()


@pytest.mark.slow
def test_steps_that_are_halved_where_newton_fails() -> None:
    """Two iterations do not suffice for all arms: the environment repeats these alone, in halved steps. Values are its,
    bit for bit, derivatives those of differences of what it does."""
    arms = Arms(ONE, 3, max_iterations=2, tolerance=1e-12)
    as_in_the_environment(arms)
    rng, state = np.random.default_rng(0), arms.reset(seed=0)
    for _ in range(2):
        state = arms.step(state, np.sign(rng.uniform(-1.0, 1.0, (3, 1))))[0]
    action = 0.9 * np.sign(rng.uniform(-1.0, 1.0, (3, 1)))
    found = arms.jacobians(state, action)
    assert not arms.failed.any() and arms._stuck.any()
    assert np.array_equal(found.state, arms.step(state, action)[0])
    assert off(found.moved, differences(arms, state, action, found.moved)) < 1e-8
    as_the_jacobians(arms, (state, arms.reset(seed=1)), action, 1e-12)
    none = np.zeros_like(found.state), np.zeros_like(found.observation), np.where(arms._stuck, 0.0, 1.0)
    assert np.isfinite(arms.vjp(state, action, *none)[0]).all() and not arms.failed.any()  # of arms asked nothing, too
    arms.close()


@pytest.mark.slow
def test_former_names_warn() -> None:
    arms = Arms(ONE, 2)
    state, action = moving(arms)
    found = arms.jacobians(state, action)
    with pytest.warns(FutureWarning, match=r"push\(\) is jvp\(\) now"):
        assert np.array_equal(found.push(state, action)[0], found.jvp(state, action)[0])
    with pytest.warns(FutureWarning, match=r"pull\(\) is vjp\(\) now"):
        assert np.array_equal(arms.pull(state, action, *found[:3])[1], arms.vjp(state, action, *found[:3])[1])
    arms.close()


def as_in_the_environment(arms: Arms) -> None:
    """Through the vector environment's own steps (actions float32) the same numbers; what was seen is float32 there."""
    rng, state = np.random.default_rng(0), arms.reset(seed=3)
    told = np.array([name.startswith("seen") for name in arms.names])
    assert np.array_equal(arms.observe(state).astype(np.float32), arms.environment.batch.observation)
    for _ in range(4):
        action = rng.uniform(-1.0, 1.0, (arms.n, arms.action_size)).astype(np.float32)
        state, seen, reward = arms.step(state, action)
        observation, paid, *_ = arms.environment.step(action)
        assert np.array_equal(seen.astype(np.float32), observation) and np.array_equal(reward, paid)
        there = arms.states()
        assert np.array_equal(state[:, ~told], there[:, ~told]) and np.allclose(state, there, rtol=0.0, atol=1e-6)


def along(arms: Arms, state: Array, periods: int, e: float, most: float) -> None:
    """Along a motion, by its actions: each arm's error against differences of steps e over the size of what its
    observations change by; and tangent against adjoint by the dot product, to 1e-12 or, of floating frames, 1e-10."""
    rng = np.random.default_rng(2)
    actions, way = rng.uniform(-0.4, 0.4, (2, periods, arms.n, arms.action_size))
    run = arms.rollout(state, actions)
    found, total = run.jvp(actions=way), central(lambda s: arms.rollout(state, actions + s * way).observations, e)
    error = np.sqrt(((found.observations - total) ** 2).sum((0, 2)) / (total**2).sum((0, 2)))
    assert error.max() < most
    bars = [rng.standard_normal(part.shape) for part in found]
    other = float((run.vjp(*bars).actions * way).sum())
    one = sum(float((bar * part).sum()) for bar, part in zip(bars, found, strict=True))
    size = sum(np.linalg.norm(bar) * np.linalg.norm(part) for bar, part in zip(bars, found, strict=True))
    floating = arms.environment.plan.settings.formulation == "floating_frame"  # solved once for, which rounds
    assert abs(one - other) <= (1e-10 if floating else 1e-12) * size


@pytest.mark.slow
def test_whole_matrices_say_what_push_and_pull_do() -> None:
    """A, B, C, D, r_x and r_u of whole states; what does not move passes through; by the action beyond +-1 zeros."""
    arms = Arms(TWO, 3)
    state, action = moving(arms)
    action[0] = 1.5
    found = arms.jacobians(state, action)
    rng = np.random.default_rng(2)
    dx, du = rng.normal(size=state.shape), rng.normal(size=action.shape)
    dx[:, arms.moving :] = 0.0
    pushed = found.jvp(dx, du)
    assert np.allclose(pushed[0], np.einsum("nij,nj->ni", found.A, dx) + np.einsum("nij,nj->ni", found.B, du))
    assert np.allclose(pushed[1], np.einsum("nij,nj->ni", found.C, dx) + np.einsum("nij,nj->ni", found.D, du))
    assert np.allclose(pushed[2], (found.r_x * dx).sum(1) + (found.r_u * du).sum(1))
    assert not found.B[0].any() and found.B[1].any()
    seen, slopes = arms.observe_jacobian(state)
    assert np.array_equal(seen, arms.observe(state)) and slopes[:, :, : arms.moving].any()
    arms.close()


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "arm"), [(ONE, "strip_geared"), (TWO, "two_link_geared")])
def test_friction_over_periods(env_id: str, arm: str) -> None:
    """Along a motion from its start, by its actions and by the joints' laws."""
    arms = Arms(env_id, 9, tolerance=1e-12, arm=arm, parameters=True)
    rng, start = np.random.default_rng(4), arms.reset(seed=0)
    actions = 0.7 + rng.uniform(0.0, 0.2, (4, 9, arms.action_size))
    way, turned = np.zeros_like(start), rng.uniform(-1.0, 1.0, actions.shape)
    laws = [
        k for k, name in enumerate(arms.names) if name.split("[")[0] in ("stiffness", "damping", "viscous", "coulomb")
    ]
    way[:, laws] = start[:, laws] * rng.uniform(-1.0, 1.0, (9, len(laws)))
    assert len(laws) == 4 * arms.action_size and start[:, laws].all()
    for dx, du in ((way, 0.0 * turned), (0.0 * way, turned)):
        found = arms.rollout(start, actions).jvp(dx, du).states[-1]
        wanted = central(lambda s, dx=dx, du=du: arms.rollout(start + s * dx, actions + s * du).states[-1], 1e-5)
        assert off(found[:, : arms.moving], wanted[:, : arms.moving]) < 1e-6
    arms.close()


def rows_of_friction(arms: Arms) -> list[int]:
    """Rows of the angles that friction acts on."""
    return list(arms.environment.batch.program.model.table.reshape(-1, PLACES)[:, PLACE.friction])


RUBS = [
    pytest.param(ONE, {"arm": rough()}, 1e-12, id="one link"),
    pytest.param(ONE, {"arm": rough(friction_side="link")}, 1e-12, id="link's side"),
    pytest.param(ONE, {"arm": rough(backlash=0.01)}, 1e-12, id="backlash"),
    pytest.param(TWO, {"arm": rough(2), **MOTORS}, 3e-12, id="two links, motors"),
    pytest.param(ONE, {"arm": rough(), "parameters": True}, 1e-12, id="parameters"),
    pytest.param(ONE, {"arm": rough(), "segments": 2, **FLOATING}, 1e-10, id="floating frame"),
    pytest.param(ONE, {"arm": bare(rough()), "tolerance": 1e-15, **EXACT}, 1e-9, id="exact beam"),
    pytest.param(ONE, {"arm": bare(rough()), "tolerance": 1e-15, **MOTORS, **EXACT}, 5e-9, id="exact beam, motors"),
]


SLIDES = [
    pytest.param(ONE, {"arm": "strip_geared", "parameters": True}, id="one link"),
    pytest.param(TWO, {"arm": rough(2)}, id="two links"),
    pytest.param(ONE, {"arm": bare(rough()), "tolerance": 1e-15, **EXACT}, id="exact beam"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "keywords"), SLIDES)
def test_sliding_joints_from_both_sides(env_id: str, keywords: dict[str, Any]) -> None:
    """Where joints slide a period is smooth: differences ahead alone and behind alone, of sixth order (of second where
    accelerations are as fine as the solver's tolerance makes them), are both the Jacobian to 1e-6 of it; cotangents are
    pulled back to what it gives."""
    stiff = "formulation" in keywords
    weights = (-90.0, 120.0, -30.0) if stiff else (-147.0, 360.0, -450.0, 400.0, -225.0, 72.0, -10.0)
    arms, rng = Arms(env_id, 9, **{"tolerance": 1e-12, **keywords}), np.random.default_rng(4)
    rates = [arms.names.index(f"v[{row}]") for row in rows_of_friction(arms)]
    state, push = arms.reset(seed=0), 0.7 + rng.uniform(0.0, 0.2, (5, 9, arms.action_size))
    for action in push[:4]:
        state = arms.step(state, action)[0]
    found = arms.jacobians(state, push[4])
    assert abs(state[:, rates]).min() > 0.1 and abs(found.state[:, rates]).min() > 0.1
    both, sides = np.concatenate([state, push[4]], axis=1), np.zeros((2, *found.moved.shape))
    there = np.maximum(1e-2, np.abs(after(arms, state, push[4])).max(axis=0))
    for j, k in enumerate([*range(arms.moving), *range(arms.state_size, both.shape[1])]):
        e = 1e-4 / max(1e-3, (np.abs(found.moved[:, :, j]).max(axis=0) / there).max())
        if stiff:
            e = min(900.0 * e, 1e-6)
        for side, way in zip(sides, (e, -e), strict=True):
            for m, weight in enumerate(weights):
                x = both.copy()
                x[:, k] += m * way
                moved = after(arms, x[:, : arms.state_size], x[:, arms.state_size :])
                side[:, :, j] += weight / (60.0 * way) * moved
    for side in sides:
        assert off(side, found.moved) < 1e-6
    if arms.backwards:
        as_the_jacobians(arms, (state,), push[4], 1e-9 if stiff else 1e-11, rng)
    arms.close()


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "keywords", "most"), RUBS)
def test_friction_backwards(env_id: str, keywords: dict[str, Any], most: float) -> None:
    """Of joints that stay at rest, begin to slide, slide and stop: each period's cotangents are those of its Jacobians,
    but for round-off (two links: 1e-12) and what an exact beam's solver leaves of these (4e-10; with motors whose
    torques jump eight times a period 1e-9, sixteen times 3e-9); and along a motion from its start those of differences,
    whose steps are so small that no joint stops in another one."""
    arms, rng = Arms(env_id, 33, **{"tolerance": 1e-12, **keywords}), np.random.default_rng(0)
    assert arms.backwards
    rates = [arms.names.index(f"v[{row}]") for row in rows_of_friction(arms)]

    def drawn(periods: int) -> Array:
        """Four of five, by chance, are hardly more than friction."""
        size = np.where(rng.random((periods, arms.n, 1)) < 0.8, 0.04, 0.9)
        return size * rng.uniform(-1.0, 1.0, (periods, arms.n, arms.action_size))

    state, met = arms.reset(seed=0), np.zeros((2, 2), np.int64)
    for action in drawn(40):
        found = as_the_jacobians(arms, (state,), action, most, rng)
        slides = [(abs(rows[:, rates]) > 1e-6).astype(np.int64) for rows in (state, found.state)]
        np.add.at(met, tuple(slides), 1)
        state = found.state
    assert met.min() >= 5 and met.sum() == 40 * arms.n * len(rates)

    actions, way = drawn(10), rng.uniform(-1.0, 1.0, (10, arms.n, arms.action_size))
    start = arms.reset(seed=0)
    run = arms.rollout(start, actions)
    weights = [rng.normal(size=values.shape) for values in (run.observations, run.rewards)]
    back = (run.vjp(None, *weights).actions * way).sum((0, 2))

    def worth(s: float) -> Array:
        moved = arms.rollout(start, actions + s * way)
        found: Array = (weights[0] * moved.observations).sum((0, 2)) + (weights[1] * moved.rewards).sum(0)
        return found

    wanted = central(worth, 2e-6)
    assert abs(back - wanted).max() < 1e-6 * np.sqrt((wanted**2).mean())
    arms.close()


@pytest.mark.slow
def test_counts_have_the_slope_of_what_is_counted() -> None:
    """The sine that an encoder of few counts shows changes as the angle does, times the cosine that it shows."""
    arms = Arms(ONE, 9, observation="measured", sensors={"encoders": {"counts": 500}})
    found = arms.jacobians(*moving(arms))
    sine, hub = (found.moved[:, arms.moving + arms.environment.plan.names.index("hub_sin")], found.moved[:, 0])
    assert arms.names[0] == "q[0]" and np.allclose(sine, found.observation[:, 1, None] * hub, rtol=1e-12, atol=1e-14)
    assert np.allclose(
        found.observation[:, 0], np.sin(2.0 * np.pi / 500 * np.round(found.state[:, 0] / (2.0 * np.pi / 500)))
    )
    arms.close()


ABSENT = [
    ("payload_inertia", {"payload": Payload(0.2, 0.0)}, {}), ("payload_mass", {"payload": Payload(0.0, 0.0)}, {}),
    *(("tau_d", {"tau_d": 0.0}, {"formulation": way}) for way in ("elastica", "geometrically_exact")),
    ("tau_d", {"tau_d": 0.0}, {"formulation": "floating_frame", "segments": 2, "dt": 0.0025}),
]  # fmt: skip


@pytest.mark.parametrize(("name", "arm", "options"), ABSENT)
def test_parameters_that_an_arm_has_none_of(name: str, arm: dict[str, Any], options: dict[str, Any]) -> None:
    """Their derivatives were 0, and values set in a state did nothing: the arm is that which is built with them."""
    strip = dataclasses.replace(arms_by_name.named("strip"), **arm)
    options = options | {"joint_limits": None, "tolerance": 1e-12}
    own = Arms(ONE, 1, parameters=True, arm=strip, **options)
    state, actions, e = own.reset(seed=0, options={"start": 0.0}), np.full((12, 1, 1), 0.8), 1e-6
    k, run = own.names.index(name), own.rollout(state, actions)
    moved = state.copy()
    moved[:, k] = e
    more = own.rollout(moved, actions).rewards.sum() - run.rewards.sum()
    slope = run.vjp(rewards=np.ones((12, 1))).state[0, k]
    assert abs(more) > 1e-7 and slope * e == pytest.approx(more, rel=0.01)
    payload = Payload(0.2, e) if name == "payload_inertia" else Payload(e, 0.0)
    changed: dict[str, Any] = {"tau_d": e} if name == "tau_d" else {"payload": payload}
    built = Arms(ONE, 1, parameters=True, arm=dataclasses.replace(strip, **changed), **options)
    found = built.rollout(built.reset(seed=0, options={"start": 0.0}), actions).rewards.sum() - run.rewards.sum()
    assert found == pytest.approx(more, rel=1e-3)


def test_parameters_that_no_arm_has() -> None:
    own = Arms(ONE, 2, parameters=True)
    state = own.reset(seed=0)
    for name, value, what in (
        ("EI_factor", np.inf, "positive number"), ("EI_factor", 0.0, "positive number"),
        ("EI_factor", -1.0, "positive number"), ("payload_inertia", np.inf, "finite number"),
    ):  # fmt: skip
        wrong = state.copy()
        wrong[1, own.names.index(name)] = value
        refuses(f"state.{name} = {value}: must be a {what}", partial(own.step, wrong, np.zeros((2, 1))))
