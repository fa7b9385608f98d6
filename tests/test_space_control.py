"""LQR and LQG of arms in space: their model of the arm, and what they reach."""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.space_control import MEASURED
from flexarm_env import arms, control, shapes
from flexarm_env.control import lqg, optimal
from flexarm_env.control.catalogue import tuned_gains
from flexarm_env.control.dynamics import SpatialDynamics, dynamics
from flexarm_env.control.replay import finer
from flexarm_env.control.space import held_model, rest
from flexarm_env.linear.state_space import held
from flexarm_env.physics.space.reading import tips
from flexarm_env.rigid import frames, tip_at, weight_and_inertia
from tests.differences import central

ID = "SpatialFlexArm-v0"
COARSE: dict[str, Any] = {"elements": 1, "dt": 0.005}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "keywords"), [("lqr", {}), ("lqg", MEASURED)])
def test_regulator_and_filter_about_a_bent_rest(name: str, keywords: dict[str, Any]) -> None:
    controller, angles = control.make(name, gym.make(ID, **keywords)), np.array([0.3, 0.7, -0.5])
    assert isinstance(controller, lqg.SpatialLQG)
    own, y = lqg.plant_in_space(controller.setup, controller.gravity, angles)
    d, size = controller.design(own), len(own.A)
    joints, rates = (np.array([own.rows[f"joint{k}{end}"] for k in range(3)]) for end in ("", "_rate"))
    assert joints @ own.rigid == pytest.approx(np.eye(3), abs=1e-6)
    arm, gravity = controller.setup.arm, controller.gravity
    turned = central(lambda s: weight_and_inertia(arm, gravity, angles + s * np.eye(3))[0], 1e-4, 2)
    weight, left = own.B @ turned.T, own.A @ own.rigid - own.rigid
    for rows in (joints, rates):  # its weight is held wherever it is turned to, but for what it bends by
        assert np.linalg.norm(rows @ left) < 0.3 * np.linalg.norm(rows @ weight)
    assert [y[f"joint{k}"] for k in range(3)] == pytest.approx(angles)
    assert np.abs(np.linalg.eigvals(own.A - own.B @ d.K[:, :size])).max() < 1.0
    fading = np.abs(np.linalg.eigvals(d.A - d.A @ d.L[-1] @ d.C))  # all but biases, which are given none to walk
    assert np.sort(fading)[size + 2] < 0.9999


def test_inertia_of_the_rigid_arm_is_that_of_its_boxes() -> None:
    """Kinetic energy of points all over pillar and strips, their velocities by differences."""
    arm, rng, eps = arms.named("three_dof"), np.random.default_rng(1), 1e-6
    x, w = np.polynomial.legendre.leggauss(3)
    strip = np.array([(a, b, c) for a in x for b in x for c in x])
    weights = np.array([a * b * c for a in w for b in w for c in w]) / 8.0
    angles, rates = rng.uniform(-1.0, 1.0, (2, 3))
    pillar = arm.links[0]
    energy = 0.0
    ends = [frames(arm, angles + sign * eps * rates) for sign in (1.0, -1.0)]
    spin = 0.5 * (ends[0][2][0] - ends[1][2][0]) / eps @ frames(arm, angles)[2][0].T
    omega = np.array([spin[2, 1], spin[0, 2], spin[1, 0]])
    A = frames(arm, angles)[2][0]
    velocity = np.cross(omega, A @ np.array(pillar.centre))
    energy += 0.5 * pillar.mass * velocity @ velocity + 0.5 * (A.T @ omega) @ np.array(pillar.inertia) @ (A.T @ omega)
    for k in (1, 2):
        link = arm.links[k]
        half = 0.5 * np.array([link.length, 0.05, 0.002])  # whose thickness lies in the plane that it bends in most
        for flat in (half[[0, 1, 2]], half[[0, 2, 1]]):
            if (flat[1] < flat[2]) == (link.section.J_y > link.section.J):
                points = strip * flat + [0.5 * link.length, 0.0, 0.0]
        there = [places[k] + points @ axes[k].T for places, _, axes, _ in ends]
        speeds = 0.5 * (there[0] - there[1]) / eps
        energy += 0.5 * link.mass * weights @ (speeds**2).sum(axis=1)
    inertia = weight_and_inertia(arm, np.zeros(3), angles[None])[1][0]
    assert 0.5 * rates @ inertia @ rates == pytest.approx(energy, rel=1e-6)


@pytest.mark.slow
def test_shaped_commands_leave_the_arm_still() -> None:
    """Without weight, from rest: what the strips still move by behind the reference, beside that of one impulse."""
    env: Any = gym.make(ID, gravity=(0.0, 0.0, 0.0), dt=0.0025)
    rates = [k for k, entry in enumerate(env.unwrapped.plan.names) if entry.startswith("tip_deflection_rate")]
    left = []
    for name, gains in (("zv", {}), ("zvd", {}), ("zv", {"modes": 0})):
        controller: Any = control.make(name, env, replace(tuned_gains(name, "space"), **gains))
        start = np.array([[0.0, 0.6, 0.5], [0.2, -0.4, -0.9], [0.0, 0.3, 1.2]])
        way, left_here = np.array([0.05, -0.06, 0.08]), []
        for i in range(3):
            target = tip_at(controller.setup.arm, start[i] + way)
            seen, _ = env.reset(seed=0, options={"start": start[i].tolist(), "target": target.tolist()})
            controller.reset(seen)
            end = int((controller.period[0] + controller.delays[0].max()) / 0.01) + 1
            moved = []
            for _ in range(end + 30):
                seen, *_ = env.step(controller.act(seen))
                moved.append(np.abs(seen[rates]).max())
            left_here.append(max(moved[end:]))
        left.append(left_here)
    once = np.array(left[2])
    assert (np.array(left[0]) < 0.05 * once).all() and (np.array(left[1]) < 0.01 * once).all()
    assert controller.delays.max() == 0.0


@pytest.mark.slow
def test_gains_of_pd_have_a_margin() -> None:
    """On the linear arm about drawn goals, torques held over control periods: gains 1.6 times as large are stable."""
    controller: Any = control.make("pd", gym.make(ID))
    gains, gravity, arm, passed = controller.gains, controller.gravity, controller.setup.arm, controller.passed
    rng = np.random.default_rng(0)
    for goal in rng.uniform([-2.0, -1.2, -1.2], [2.0, 1.2, 1.2], (6, 3)):
        free, joints, A = held_model(arm, gravity, goal)
        rates = np.array([free.C[free.outputs.index(f"joint{k}_rate")] for k in range(3)])
        inertia = np.diag(np.diag(weight_and_inertia(arm, gravity, goal[None])[1][0]))
        A, B = held(A, free.B, controller.setup.control_dt)
        for more in (1.0, 1.6):
            spring, damper = more * gains.rate**2 * inertia, more * 2.0 * gains.ratio * gains.rate * inertia
            top = np.hstack([A - B @ (spring @ joints + passed * damper @ rates), -(1.0 - passed) * B @ damper])
            loop = np.vstack([top, np.hstack([passed * rates, (1.0 - passed) * np.eye(3)])])
            assert np.abs(np.linalg.eigvals(loop)).max() < 1.0 + 1e-9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "keywords", "periods"),
    [("lqr", COARSE, 280), ("lqg", MEASURED, 280), ("mpc", {}, 200), ("pd", {}, 500)],
)
def test_reaches_settle(name: str, keywords: dict[str, Any], periods: int) -> None:
    """Sooner than under PD, which has few that do within 2.8 s; one arm's actions are those it has among others."""
    env: Any = gym.make_vec(ID, num_envs=3, **keywords)
    controller, alone = control.make(name, env), control.make(name, env)
    seen, _ = env.reset(seed=400)
    controller.reset(seen)
    alone.reset(seen[1])
    for k in range(periods):
        actions = controller.act(seen)
        if k < 5:
            # plans end after some iterations, which carry round-off as far: 0 to 3e-5, by where arrays lie in memory
            assert alone.act(seen[1]) == pytest.approx(actions[1], abs=1e-4)
        seen, *_, info = env.step(actions)
    assert info["is_success"].all()


@pytest.mark.slow
def test_goals_that_encoders_tell_are_those_of_the_targets_place() -> None:
    """From the upright arm, by joint errors and by the way to the target; they hold the sagging tip there."""
    goals, errors = [], np.array([0.3, 0.7, -0.5])
    arm = control.Setup.of(gym.make(ID)).arm
    way = (tip_at(arm, errors) - tip_at(arm, np.zeros(3))) @ frames(arm, np.zeros((1, 3)))[2][0, 0]
    told = {f"{joint}_error": x for joint, x in zip(arm.joint_names, errors, strict=True)}
    told |= {f"to_target_{axis}": x for axis, x in zip("xyz", way, strict=True)}
    for observation in ("full", "measured"):
        keywords: dict[str, Any] = {} if observation == "full" else {"observation": observation}
        controller = control.make("pd", gym.make(ID, **keywords))
        known = told | {name: 1.0 for name in controller.setup.names if name.endswith("_cos")}
        controller.reset(np.array([known.get(name, 0.0) for name in controller.setup.names]) / controller.setup.scales)
        goals.append(controller.goal)
    assert goals[0] == pytest.approx(goals[1], abs=1e-9)
    assert np.abs(goals[0] - errors).max() > 1e-3


def test_what_is_not_there_is_refused_by_name() -> None:
    env = gym.make(ID, **COARSE)
    with pytest.raises(ValueError, match="LQG needs the entry hub_error"):
        control.make("lqg", env)
    with pytest.raises(ValueError, match=r"^gains = .*: must be a LQGGains"):
        control.make("lqr", env, tuned_gains("pd", "space"))


# ------------------------------------------------------------------ plans on the elastica
@pytest.fixture(scope="module")
def plant() -> Any:
    return dynamics("three_dof", 0.02, gravity=(0.0, 0.0, -9.81))


@pytest.mark.slow
def test_periods_of_the_elastica_rest_where_the_arm_does_and_their_derivatives_are_differences(plant: Any) -> None:
    angles, rng, arm = np.array([[0.3, 0.7, -0.5], [-1.0, -0.4, 1.1]]), np.random.default_rng(0), plant.arm
    plant = SpatialDynamics(arm, 0.02, 3, plant.gravity)
    plant.settings = replace(plant.settings, tolerance=1e-11)  # whose differences are those of steps that are solved
    x, u = plant.still(angles)
    assert plant.advance(x, u) == pytest.approx(x, abs=2e-6) and x[:, plant.joints] == pytest.approx(angles)
    for own, held_by, joints in zip(x, u, angles, strict=True):
        found = rest(arm, np.array(plant.gravity), joints)
        assert held_by * plant.limits == pytest.approx(np.array(found.joint_torques()), abs=1e-3)
        tip = tips(arm, found.settings, found.work.q[None])[0, 0]
        assert plant.tip(own)[0] == pytest.approx(tip, abs=1e-4)
    u = u + rng.uniform(-0.2, 0.2, u.shape)
    x = plant.advance(x, u)
    A, B = plant.jacobians(x, u)
    way, pull = rng.normal(size=x.shape) * np.repeat([0.1, 1.0], plant.half), rng.normal(size=u.shape)
    slope = central(lambda s: plant.advance(x + s * way, u + s * pull), 1e-4, 2)
    found = np.einsum("nij,nj->ni", A, way) + np.einsum("nij,nj->ni", B, pull)
    assert found == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())
    for of in (plant.points, plant.bends, plant.tip):
        slope = central(lambda s, of=of: of(x + s * way)[0], 1e-4, 2)
        assert np.einsum("n...s,ns->n...", of(x)[1], way) == pytest.approx(slope, abs=1e-6)


@pytest.mark.slow
def test_a_plan_in_space_goes_round_a_ball_that_is_in_the_way() -> None:
    plant: Any = dynamics("three_dof", 0.02, gravity=(0.0, 0.0, -9.81), step=6.25e-4)
    start, goal = plant.rest([[0.0, 0.5, 0.3]]), plant.rest([[0.9, 0.5, 0.3]])
    free = optimal.least_effort(plant, start, goal, 40)
    ball = shapes.Sphere(tuple(plant.tip(free.states[28, 0])[0] + [0.0, 0.0, 0.04]), 0.06)
    aside = optimal.Bounds(keep_out=[ball], margin=0.02)  # between control instants the tip goes 13 cm
    kept = optimal.least_effort(plant, start, goal, 40, aside, guess=free.controls)
    near = [float(ball.distance(plant.places(motion.states)).min()) for motion in (free, kept)]
    assert free.found.all() and (kept.missed <= optimal.TOLERANCE).all()
    assert near[0] < -0.019 and near[1] > 0.02 - optimal.TOLERANCE * plant.arm.total_length
    # a quarter of the step, between control instants too: the free plan goes through the ball, the other clears it
    fine = finer(plant)
    between: list[float] = []
    for motion in (free, kept):
        x, least = start, np.inf
        for u in motion.controls:
            for _ in range(round(plant.period / fine.period)):
                x = fine.advance(x, u)
                least = min(least, float(ball.distance(fine.places(x)).min()))
        between.append(least)
        assert x[:, fine.joints] == pytest.approx(goal[:, plant.joints], abs=2e-3)
    assert between[0] < -0.05 and 0.0 < between[1] < 0.02
    # there the margin is not kept, and `found` says so
    assert not kept.found.any()
    assert kept.replay.missed[0] == pytest.approx((0.02 - between[1]) / plant.arm.total_length, rel=1e-6)
    assert kept.energy(0.02)[0] > free.energy(0.02)[0]
    soon = optimal.least_time(plant, start, goal, most=60)
    assert soon.found.all() and soon.periods[0] <= 14 and np.abs(soon.controls).max() <= 1.0
    last = soon.periods[0] - 1
    assert plant.advance(soon.states[last], soon.controls[last]) == pytest.approx(soon.states[last + 1], abs=1e-12)


@pytest.mark.slow
def test_the_receding_horizon_begins_with_a_plan_round_what_it_is_kept_out_of() -> None:
    """A ball on the way of the regulator's tip."""
    ball = shapes.Sphere((0.457, 0.624, 0.781), 0.06)
    env: Any = gym.make_vec(ID, num_envs=1, keep_out=ball)
    controller: Any = control.make("mpc", env)
    target = tip_at(controller.setup.arm, np.array([0.9, 0.5, 0.3]))
    controller.reset(env.reset(options={"start": [0.0, 0.5, 0.3], "target": target.tolist()})[0])
    assert controller.arrival[0] < 60 and ball.distance(controller.plant.places(controller.plan.states)).min() > 0.0


def test_goals_of_the_rigid_arm_take_no_static_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    """The rigid tip is at the target, rigid weight is held there, and observed goal angles are used as they are."""

    def no_rest(*_: Any) -> None:
        raise AssertionError("a static rest was computed")

    monkeypatch.setattr("flexarm_env.control.space.rest", no_rest)
    gains = {"rate": 5.5, "ratio": 1.0, "lag": 0.06, "rests": 0}
    env = gym.make_vec(ID, num_envs=8, **COARSE)
    pd = control.make("pd", env, gains)
    observation, _ = env.reset(seed=3)
    pd.reset(observation)
    signals = pd.read(observation)
    assert np.linalg.norm(tip_at(pd.setup.arm, pd.goal) - pd.targets(signals), axis=1).max() < 1e-6
    holding = weight_and_inertia(pd.setup.arm, pd.gravity, pd.goal)[0]
    assert pd.forward(np.zeros((8, 3))) == pytest.approx(holding, abs=1e-12)
    distance, angles, torques = pd.rest_at(pd.targets(signals)[0], signals.angles[0])
    assert distance < 1e-6 and angles == pytest.approx(pd.goal[0]) and torques == pytest.approx(holding[0])
    env.close()
    env = gym.make_vec(ID, num_envs=4, **MEASURED, **COARSE)
    pd = control.make("pd", env, gains)
    observation, _ = env.reset(seed=3)
    pd.reset(observation)
    signals = pd.read(observation)
    assert pd.goal == pytest.approx(signals.angles + signals.to_go)
    env.close()
