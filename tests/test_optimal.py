"""Optimal control: against Riccati, against known times, and what plans and the receding horizon promise."""

import dataclasses

import gymnasium as gym
import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from flexarm_env import Arm, Elbow, JointTorque, Link, Payload, Scene, Section, arms, control, shapes, simulate
from flexarm_env.control import ilqr, optimal, replay, time_optimal
from flexarm_env.control.arm_model import arm_model
from flexarm_env.control.dynamics import dynamics
from flexarm_env.time_functions import steps as stairs
from tests.differences import central
from tests.refusals import refuses

STRIP, TWO = arms.named("strip"), arms.named("de_luca_siciliano")
DT = 0.02


class Linear:
    """x' = A x + B u."""

    def __init__(self, A, B):
        self.A, self.B, (self.size, self.n_inputs) = A, B, B.shape

    def stage(self, k, x, u):
        return x @ self.A.T + u @ self.B.T

    def linear(self, x, u):
        return np.broadcast_to(self.A, (*x.shape, self.size)), np.broadcast_to(self.B, (*x.shape, self.n_inputs))


@pytest.fixture(scope="module")
def strip():
    return dynamics(STRIP, DT)


@pytest.fixture(scope="module")
def two():
    return dynamics(TWO, DT)


# ------------------------------------------------------------------ iLQR
def test_of_a_linear_quadratic_problem_one_iteration_is_riccatis_answer():
    rng = np.random.default_rng(0)
    A, B = rng.normal(size=(5, 5)) / 2.5, rng.normal(size=(5, 2))
    Q, R = np.diag([1.0, 2.0, 0.5, 0.1, 3.0]), np.array([40.0, 60.0])
    P = solve_discrete_are(A, B, Q, np.diag(R))
    K = np.linalg.solve(np.diag(R) + B.T @ P @ B, B.T @ P @ A)
    x = 0.2 * rng.normal(size=(3, 5))
    weight = np.concatenate([np.broadcast_to(Q, (12, 5, 5)), P[None]])
    cost = ilqr.Quadratic(np.zeros((3, 5)), weight)
    found = ilqr.solve(Linear(A, B), x, np.zeros((12, 3, 2)), [cost], R, iterations=2)
    assert np.abs(found.controls).max() < 1.0
    assert found.controls[0] == pytest.approx(-x @ K.T, abs=1e-12)
    assert found.gains[0] == pytest.approx(np.broadcast_to(-K, (3, 2, 5)), abs=1e-10)
    assert found.cost == pytest.approx(0.5 * np.einsum("ni,ij,nj->n", x, P, x), rel=1e-12)
    elsewhere = 0.2 * rng.normal(size=(3, 5))
    controls, states = ilqr.followed(Linear(A, B), elsewhere, found)  # is the best from there too
    again = ilqr.solve(Linear(A, B), elsewhere, found, [cost], R, iterations=2)
    assert np.abs(controls).max() < 1.0 and controls[0] == pytest.approx(-elsewhere @ K.T, abs=1e-12)
    assert again.controls == pytest.approx(controls, abs=1e-12) and again.states == pytest.approx(states, abs=1e-12)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_controls_within_limits_are_the_best_there(count):
    """Karush, Kuhn and Tucker: no control can move, or move back from its limit, at a gain."""
    rng = np.random.default_rng(count)
    half = rng.normal(size=(200, count, count))
    H, g = half @ half.swapaxes(1, 2) + 0.1 * np.eye(count), 3.0 * rng.normal(size=(200, count))
    low, high = -rng.uniform(0.1, 1.0, (200, count)), rng.uniform(0.1, 1.0, (200, count))
    u, gain = ilqr._within(H, g, rng.normal(size=(200, count, 4)), low, high)
    slope = g + np.einsum("nij,nj->ni", H, u)
    free = (u > low) & (u < high)
    assert np.abs(slope[free]).max() < 1e-6
    assert (slope[u <= low] >= -1e-6).all() and (slope[u >= high] <= 1e-6).all()
    assert not gain[~free].any()


# ------------------------------------------------------------------ the arm as a function of its state
@pytest.mark.parametrize("env_id", ["FlexibleArm-v0", pytest.param("TwoLinkFlexArm-v0", marks=pytest.mark.slow)])
def test_a_period_is_the_environments_and_its_derivatives_are_differences(env_id, strip, two):
    plant = strip if env_id == "FlexibleArm-v0" else two
    env = gym.make_vec(env_id, num_envs=8, tolerance=plant.settings.tolerance)
    _, info = env.reset(seed=1)
    batch, rng = env.unwrapped.batch, np.random.default_rng(0)
    x = np.array([np.concatenate(batch.motion(i)[:2]) for i in range(8)])
    assert np.array_equal(plant.rest(x[:, plant.joints]), x)
    for _ in range(10):
        u = rng.uniform(-1.0, 1.0, (8, plant.n_inputs)).astype(np.float32)
        info, x = env.step(u)[-1], plant.advance(x, u)
    assert np.array_equal(x, [np.concatenate(batch.motion(i)[:2]) for i in range(8)])
    assert plant.tip(x)[0] == pytest.approx(info["tip_position"], abs=1e-7)
    assert plant.bends(x)[0] == pytest.approx(info["tip_deflection"].reshape(8, -1), abs=1e-7)
    u, way = 0.5 * np.ones((8, plant.n_inputs)), rng.normal(size=x.shape)
    A, B = plant.jacobians(x, u)
    slope = central(lambda s: plant.advance(x + s * way, u), 1e-3, 2)
    assert np.einsum("nij,nj->ni", A, way) == pytest.approx(slope, abs=2e-4 * np.abs(slope).max())
    slope = central(lambda s: plant.advance(x, u + s), 2.0**-8, 2)
    assert B.sum(-1) == pytest.approx(slope, abs=2e-4 * np.abs(slope).max())
    for of in (plant.tip, plant.bends):
        slope = central(lambda s, of=of: of(x + s * way)[0], 1e-5, 2)
        assert np.einsum("nij,nj->ni", of(x)[1], way) == pytest.approx(slope, abs=1e-7)
    env.close()


# ------------------------------------------------------------------ plans
@pytest.mark.slow
def test_of_a_rigid_arm_the_least_time_is_known():
    """2 sqrt(I angle / torque): within the period that a plan is a whole number of."""
    link = Link(1.0, Section(EI=50.0, EA=1e9, C=1e9, m=0.3))
    plant = dynamics(Arm("stiff", (link,), hub_inertia=0.3, torque_limits=(2.0,)), DT)
    angles = np.array([[0.3], [0.7], [-1.2]])
    motion = optimal.least_time(plant, plant.rest(np.zeros((3, 1))), plant.rest(angles))
    known = 2.0 * np.sqrt((0.3 + 0.3 / 3.0) * np.abs(angles[:, 0]) / 2.0) / DT
    assert motion.found.all()
    assert (motion.periods >= known).all() and (motion.periods <= np.ceil(known)).all()
    used = [np.abs(motion.controls[:count, i, 0]) for i, count in enumerate(motion.periods)]
    assert all((own > 0.99).mean() > 0.6 for own in used)


def test_of_one_link_the_least_time_is_that_of_linear_programming(strip):
    angle = np.array([[0.2], [0.8]])
    motion = optimal.least_time(strip, strip.rest(np.zeros((2, 1))), strip.rest(angle))
    model = arm_model(STRIP)
    A, B = model.discrete(DT)
    for i in range(2):
        start = model.state_of(np.array([-angle[i, 0], 0.0, 0.0, 0.0]))
        assert abs(time_optimal.plan(A, B, start, np.array([2.0])).periods - motion.periods[i]) <= 1
    assert np.abs(motion.controls).max() <= 1.0


@pytest.mark.slow
def test_least_effort_keeps_its_bounds_and_costs_more_for_them(two):
    start, goal = two.rest(np.array([[0.0, 0.2]])), two.rest(np.array([[0.8, -0.4]]))
    bounds = optimal.Bounds(torque=0.6, joints=[(-0.05, 0.85), (-0.45, 0.25)], deflection=0.06)
    free = optimal.least_effort(two, start, goal, 140)
    kept = optimal.least_effort(two, start, goal, 140, bounds)
    assert free.found.all() and kept.found.all()
    assert np.abs(kept.controls).max() <= 0.6
    bent, more = (np.abs(two.bends(motion.states)[0]).max() for motion in (kept, free))
    assert bent <= 0.06 * (1.0 + optimal.TOLERANCE) < more
    angles = kept.states[:, 0, two.joints]
    assert (angles >= np.array([-0.05, -0.45]) - optimal.TOLERANCE).all()
    assert (angles <= np.array([0.85, 0.25]) + optimal.TOLERANCE).all()
    assert kept.energy(DT)[0] > free.energy(DT)[0]
    assert kept.states[-1, 0] == pytest.approx(goal[0], abs=0.01)


@pytest.mark.slow
def test_a_plan_goes_round_a_disc_that_is_in_the_way(two):
    start, goal = two.rest(np.array([[0.0, 0.2]])), two.rest(np.array([[0.8, -0.4]]))
    free = optimal.least_effort(two, start, goal, 140)
    way = two.tip(free.states[70, 0])[0]
    disc = shapes.Sphere(tuple(way * (1.0 + 0.04 / np.linalg.norm(way))), 0.06)
    kept = optimal.least_effort(two, start, goal, 140, optimal.Bounds(keep_out=[disc]), guess=free.controls)
    near = [disc.distance(two.places(motion.states)).min() for motion in (free, kept)]
    assert kept.found.all() and near[0] < -0.019 and near[1] > -optimal.TOLERANCE * TWO.total_length
    assert kept.energy(DT)[0] > free.energy(DT)[0]
    rng, x = np.random.default_rng(0), kept.states[60]
    way = rng.normal(size=x.shape)
    slope = central(lambda s: two.places(x + s * way), 1e-5, 2)
    assert np.einsum("npds,ns->npd", two.points(x)[1], way) == pytest.approx(slope, abs=1e-7)


@pytest.mark.parametrize(("bound", "known"), [(0.03, 55), pytest.param(0.005, 128, marks=pytest.mark.slow)])
def test_a_bound_of_deflection_is_kept_to_a_share_of_itself(strip, bound, known):
    """`known`: the fewest periods of the linear model, by linear programmes with rows for all deflections."""
    motion = optimal.least_time(strip, strip.rest([[0.0]]), strip.rest([[0.6]]), optimal.Bounds(deflection=bound))
    assert motion.found.all() and abs(motion.periods[0] - known) <= 0.02 * known
    assert np.abs(strip.bends(motion.states)[0]).max() <= bound * (1.0 + optimal.TOLERANCE)


def test_what_cannot_be_kept_is_said_to_be_missed(strip):
    start, goal = strip.rest([[0.0]]), strip.rest([[0.6]])
    assert not optimal.least_effort(strip, start, goal, 80, optimal.Bounds(deflection=0.005)).found.any()
    tight = optimal.Bounds(deflection=1e-3)
    with pytest.raises(ValueError, match=r"^most = 60: must be more, or Bounds\(.*deflection=0\.001.*\) wider: arm 0"):
        optimal.least_time(strip, start, goal, tight, most=60)
    refuses(r"^most = 3: must be more: arm 0", lambda: optimal.least_time(strip, start, goal, most=3))


@pytest.mark.parametrize(
    ("bounds", "message"),
    [
        *(({"torque": value}, r"^bounds\.torque = .*above 0 and at most 1") for value in (2, 0, -1.0, np.nan, "a")),
        *(({"deflection": value}, r"^bounds\.deflection = .*positive") for value in (np.nan, 0, -np.inf, "a")),
        ({"joints": (1,)}, r"^bounds\.joints\[0\] = 1: must be a sequence of two numbers \(rad\), \(low, high\)"),
        ({"joints": [(1, -1)]}, r"^bounds\.joints\[0\] = \(1.0, -1.0\): must be \(low, high\)"),
        ({"joints": [(np.nan, 1.0)]}, r"^bounds\.joints\[0\]\[0\] = nan: must be a finite number"),
        ({"joints": [(0, 1), (0, 1)]}, r"^bounds\.joints = .*must be a sequence of 1 pairs"),
        ({"joints": [(0.0, 0.3)]}, r"deflections of goal\[1\] = \(\[0\.6\], \[.*must be within Bounds\(.*0\.3"),
        ({"joints": [(0.1, 0.7)]}, r"deflections of start\[0\]"),
    ],
)
def test_bounds_that_no_motion_keeps_are_refused(strip, bounds, message):
    start, goal = strip.rest([[0.0], [0.0]]), strip.rest([[0.2], [0.6]])
    refuses(message, lambda: optimal.least_time(strip, start, goal, optimal.Bounds(**bounds)))


def test_what_does_not_fit_the_arm_is_refused(strip):
    start, goal, path = strip.rest([[0.0]]), strip.rest([[0.6]]), np.ones((41, 1, 2))
    nothing = np.array([[np.nan] * strip.size])
    for made, message in [
        (lambda: optimal.least_time(strip, start, goal, most=-1), r"^most = -1: must be a whole number, at least 1"),
        (lambda: optimal.least_time(strip, start, goal, most=50.5), r"^most = 50\.5: must be a whole number"),
        (lambda: optimal.least_time(strip, start[0], goal), r"^shape of start = \(8,\): must be \(n, 8\), .*rest"),
        (lambda: optimal.least_time(strip, start, [[0.6]]), r"^shape of goal = \(1, 1\): must be \(1, 8\)"),
        (lambda: optimal.least_time(strip, start, "far"), r"^goal = 'far': must be numbers of shape \(1, 8\)"),
        (lambda: optimal.least_effort(strip, nothing, goal, 20), r"^start\[0, 0\] = nan: must be a finite number"),
        (lambda: optimal.least_effort(strip, start, nothing, 20), r"^goal\[0, 0\] = nan"),
        (lambda: optimal.least_effort(strip, start, strip.rest([[0.1], [0.2]]), 20), r"^shape of goal = \(2, 8\)"),
        (lambda: optimal.least_effort(strip, start, goal, 20, guess=np.zeros((9, 1, 1))), r"^shape of guess = \(9"),
        (lambda: optimal.follow(strip, start, path[:1]), r"^shape of path = .*T at least 1"),
        (lambda: optimal.follow(strip, start, path[:, 0]), r"^shape of path = \(41, 2\): must be \(T \+ 1, 1, 2\)"),
        (lambda: optimal.follow(strip, start, path * np.inf), r"^path\[0, 0, 0\] = inf"),
        (lambda: strip.rest([[0.0, 1.0]]), r"^shape of joint angles = \(1, 2\): must be \(m, 1\)"),
        (lambda: optimal.least_time(strip, start, goal, (1.0,)), r"^bounds = \(1\.0,\): must be a Bounds"),
        (lambda: dynamics("stripe", DT), r"^arm = 'stripe': must be one of .*\"strip\""),
        (lambda: dynamics(STRIP, np.nan), r"^period = nan: must be a positive number \(s\)"),
        (lambda: dynamics(STRIP, DT, 2), r"^nodes = 2"),
        (lambda: dynamics(STRIP, DT, 0), r"^nodes = 0: must be a whole number, from 3 to 12"),
        (lambda: dynamics(dataclasses.replace(STRIP, torque_limits=None), DT), r"^arm\.torque_limits: missing"),
    ]:
        refuses(message, made)
    assert dynamics("strip", DT) is strip
    assert optimal.least_effort(strip, start.tolist(), goal.tolist(), 60).found.all()


def test_bounds_that_are_none_change_nothing(strip):
    start, goal = strip.rest([[0.0]]), strip.rest([[0.6]])
    endless = optimal.Bounds(torque=1, joints=np.array([[-np.inf, np.inf]]), deflection=np.inf)
    free, kept = optimal.least_effort(strip, start, goal, 60), optimal.least_effort(strip, start, goal, 60, endless)
    assert free.found.all() and free.controls == pytest.approx(kept.controls, abs=1e-12)


def test_the_tip_follows_a_path(strip):
    """A smooth turn: the tip keeps within a millimetre, where the hub's own angle is hundredths of a radian off."""
    t = np.linspace(0.0, 1.0, 61)
    angle = 0.6 * (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5)
    path = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:, None]
    motion = optimal.follow(strip, strip.rest(np.zeros((1, 1))), path)
    assert np.linalg.norm(strip.tip(motion.states)[0] - path, axis=2).max() < 1e-3
    assert np.abs(motion.states[:, 0, 0] - angle).max() > 0.02
    assert np.array_equal(motion.missed, [0.0]) and np.array_equal(motion.found, [True])


# ------------------------------------------------------------------ the receding horizon
def run(env_id, seed, periods, **keywords):
    """Tip errors (periods, 4), m, under `mpc`, and whether it planned, or left the arm to its regulator."""
    env = gym.make_vec(env_id, num_envs=4, **keywords)
    observation, info = env.reset(seed=seed)
    controller = control.make("mpc", env)
    controller.reset(observation)
    errors = []
    for _ in range(periods):
        action = controller.act(observation)
        assert np.abs(action).max() <= 1.0
        observation, *_, info = env.step(action)
        target = info["target"]
        target = target if target.ndim == 2 else np.stack([np.cos(target), np.sin(target)], axis=1)
        errors.append(np.linalg.norm(target - info["tip_position"], axis=1))
    env.close()
    off = controller.x - controller.home
    return np.array(errors), np.einsum("ni,nij,nj->n", off, controller.P, off) <= controller.reach


def test_it_slews_and_hands_over_to_its_regulator():
    errors, regulated = run("FlexibleArm-v0", 5, 90)
    assert errors[60:].max() < 0.035 and errors[-1].max() < 0.01 and regulated.all()


@pytest.mark.slow
def test_arms_that_the_model_loses_do_not_hold_the_others_up(monkeypatch):
    """Two plans are made at once with theirs, and are as without it; one of no arm is given up."""
    env = gym.make_vec("TwoLinkFlexArm-v0", num_envs=3)
    observation, _ = env.reset(seed=3)
    lost, kept = (control.make("mpc", env) for _ in range(2))
    for controller in (lost, kept):
        controller.reset(observation)
    lost.x[1] = 1e30
    solved, solve = [], ilqr.solve
    monkeypatch.setattr(ilqr, "solve", lambda *given, **more: solved.append(len(given[1])) or solve(*given, **more))
    others = np.array([True, False, True])
    missed = lost._improve(np.ones(3, np.bool_), 1)
    assert solved == [3, 2] and missed[1] == np.inf and np.all(lost.plan.controls[:, 1] == 0.0)
    assert np.array_equal(missed[others], kept._improve(others, 1))
    assert np.array_equal(lost.plan.controls[:, others], kept.plan.controls[:, others])
    env.close()


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 0.7])
def test_it_reaches_with_links_less_stiff_than_it_thinks(factor):
    errors, _ = run("TwoLinkFlexArm-v0", 5, 250, randomization={"EI": [factor, factor]})
    assert errors[-50:].max() < 0.02


@pytest.mark.slow
def test_an_arrival_is_not_put_off_for_ever():
    """Reaches of an arm with a quarter of the damping, which for ever a few periods before their arrival would swing up
    (0.06 m at the end)."""
    errors, _ = run("TwoLinkFlexArm-v0", [10_027, 10_074, 10_092, 10_096], 400, randomization={"damping": [0.25, 0.25]})
    assert errors[-100:].max() < 0.02


def test_plans_keep_a_margin_from_joint_limits():
    """At the limit itself a hair of an error ends an episode; of a range of less than ten margins it is a tenth."""
    env = gym.make("TwoLinkFlexArm-v0", joint_limits=[(-0.05, 0.05), (-0.3, 1.6)])
    joints = np.array(control.make("mpc", env).bounds.joints)
    assert joints == pytest.approx(np.array([(-0.04, 0.04), (-0.28, 1.58)]))
    env.close()


def test_what_is_read_is_in_the_state(two):
    rng = np.random.default_rng(2)
    outputs = np.hstack([rng.uniform(-2, 2, (5, 4)), rng.uniform(-0.1, 0.1, (5, 2)), rng.normal(size=(5, 2))])
    x = two.corrected(two.rest(np.zeros((5, 2))), outputs)
    bends, slope = two.bends(x)
    rates = np.einsum("mns,ms->mn", slope[..., : two.half], x[:, two.half :])
    read = np.concatenate([x[:, two.joints], x[:, two.half + two.joints], bends, rates], axis=1)
    assert read == pytest.approx(outputs, abs=1e-5)


# ------------------------------------------------------------------ replays
LIMP = Arm(
    "limp",
    tuple(Link(length, Section.rectangle(0.03, h, 7e10, 2700.0, 2.6e10)) for length, h in ((0.5, 0.003), (0.4, 0.002))),
    hub_inertia=0.01, elbows=(Elbow(0.1, 1e-4, 1e-4),), payload=Payload(0.05, 1e-5), torque_limits=(1.0, 0.3),
)  # fmt: skip


def on_the_exact_beam(arm, motion):
    """Largest deflections (N,), final joint angles and rates (N,) of the first plan by `simulate`."""
    t, limits = DT * np.arange(len(motion.controls)), np.array(arm.torque_limits)
    loads = tuple(JointTorque(k, stairs(t, u * limits[k])) for k, u in enumerate(motion.controls[:, 0].T))
    scene = Scene("plan", arm, duration=DT * int(motion.ends[0]), dt=5e-4, sample=2.5e-3, loads=loads)
    run = simulate(scene, "geometrically_exact", elements=8, estimate_error=False)
    return np.abs(run.tip_deflection).max(axis=0), run.joint_angles[-1], np.abs(run.joint_rates[-1])


@pytest.mark.slow
def test_a_plan_that_the_arm_breaks_is_not_found():
    """On four nodes the arm rests at the goal, deflected by at most 0.02 on its way; on the exact beam it does not."""
    plant = dynamics(LIMP, DT)
    start, goal = plant.rest(np.zeros((1, 2))), plant.rest(np.array([[0.6, -0.4]]))
    motion = optimal.least_time(plant, start, goal, optimal.Bounds(deflection=0.02))
    assert motion.missed[0] <= optimal.TOLERANCE and not motion.found[0]
    bends, angles, rates = on_the_exact_beam(LIMP, motion)
    assert bends.max() > 0.026 and abs(angles[1] + 0.4) > 0.01 and rates.max() > 0.2
    assert motion.replay.deflection[0] == pytest.approx(bends, rel=0.05)
    assert abs(motion.replay.off[0, 1]) > 0.01 and np.abs(motion.replay.rates[0]).max() > 0.2


def test_an_arm_at_rest_stays_beside_arms_that_whip():
    """Steps of arms that whip are refused for their energy; an arm at rest has none, and is not refused beside them."""
    plant, rng = dynamics(LIMP, DT), np.random.default_rng(0)
    x, refused = plant.rest(np.zeros((8, 2))), 0
    for _ in range(60):
        u = np.sign(rng.uniform(-1.0, 1.0, (8, 2)))
        u[0] = 0.0
        x = plant.advance(x, u)
        assert not x[0].any()
        lost = ~np.isfinite(x).all(axis=1)
        refused += int(lost.sum())
        x[lost] = plant.rest(np.zeros((1, 2)))
    assert refused > 3



def test_a_replay_sees_what_is_between_control_instants(strip):
    """Of a plan whose bound holds at control instants: the exact beam's deflection, to 1 % of it."""
    start, goal = strip.rest(np.zeros((1, 1))), strip.rest(np.array([[0.6]]))
    motion = optimal.least_effort(strip, start, goal, 60, optimal.Bounds(deflection=0.04))
    assert motion.found.all() and motion.replay.missed[0] < replay.BENT
    bends, _, rates = on_the_exact_beam(STRIP, motion)
    assert motion.replay.deflection[0] == pytest.approx(bends, rel=0.01)
    assert abs(motion.replay.rates[0, 0]) < 0.01 and rates[0] < 0.02
    held = dataclasses.replace(motion, replay=dataclasses.replace(motion.replay, kept=np.array([False])))
    assert not held.found.any() and dataclasses.replace(motion, replay=None).found.all()


def test_states_on_more_nodes_are_the_same_shape(two):
    """Tips, joints and deflections of bent, moving arms: polynomials of degree 3 on eight nodes."""
    fine = replay.finer(two)
    x = 0.02 * np.random.default_rng(1).normal(size=(5, two.size))
    y = replay.refined(two, fine, x)
    assert y[:, fine.joints] == pytest.approx(x[:, two.joints]) and fine.period == pytest.approx(two.settings.dt / 4)
    assert y[:, fine.half + fine.joints] == pytest.approx(x[:, two.half + two.joints])
    assert fine.tip(y)[0] == pytest.approx(two.tip(x)[0], abs=1e-4)
    assert fine.deflections(y) == pytest.approx(two.deflections(x), abs=1e-4)


@pytest.mark.slow
def test_plans_in_space_are_made_again_in_shorter_steps(monkeypatch):
    """At 5 ms the replay of this plan misses its goal by 0.03 rad."""
    plant = dynamics("three_dof", DT, gravity=(0.0, 0.0, -9.81))
    start, goal = (plant.rest(np.array([angles])) for angles in ([0.0, 0.0, 0.0], [-0.063, -0.408, 0.375]))
    motion = optimal.least_time(plant, start, goal)
    assert motion.found.all() and motion.step < plant.step
    monkeypatch.setattr(type(plant), "halvings", 0)
    coarse = optimal.least_time(plant, start, goal)
    assert not coarse.found.any() and coarse.replay.missed[0] > 2.0 * motion.replay.missed[0]


class Stepped:
    """A plant in space with a step alone."""

    step, halvings = 0.005, 3

    def __init__(self, step=None):
        self.step = self.step if step is None else step
        self.arm = arms.named("three_dof")

    def in_steps(self, step):
        return Stepped(step)


@pytest.mark.parametrize(("step", "kept_from", "last"), [
    (None, 0.005, 0.005), (None, 0.00125, 0.00125), (None, 0.0, 0.000625), (0.004, 0.001, 0.004),
])  # fmt: skip
def test_only_a_default_step_is_halved_until_replays_keep_their_limits(step, kept_from, last):
    """In the longest step the solver fails."""
    tried = []

    def solve(plant, before):
        tried.append((plant.step, before))
        if plant.step == 0.005 and kept_from < 0.005:
            raise ilqr.Astray(np.ones(1, bool))
        kept = np.array([plant.step <= kept_from])
        one = np.zeros((1, 1))
        found = replay.Replay(one, one, one, np.zeros(1), kept)
        when = np.ones(1, np.int64)
        return optimal.Motion(np.zeros((1, 1, 3)), np.zeros((2, 1, 4)), when, np.zeros(1), when, found)

    motion = optimal._refined(Stepped(step), solve)
    assert motion.step == last and motion.found.all() == (last <= kept_from)
    assert tried[0][1] is None and len(tried) <= 1 + optimal.HALVINGS
