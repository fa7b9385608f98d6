"""Controllers: what they are derived from, and what they reach."""

import dataclasses
import itertools
import json
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms, control
from flexarm_env.control import lqr, shaping, time_optimal
from flexarm_env.control.arm_model import arm_model
from flexarm_env.control.catalogue import gains_from, tuned_gains
from flexarm_env.control.pd import PDGains
from flexarm_env.geometry import inverse, plane
from flexarm_env.rigid import coriolis, rigid_inertia
from flexarm_env.training import episodes, export_policy, tune
from tests.differences import central
from tests.env_tools import successes
from tests.refusals import refusal, refuses

STRIP, TWO = arms.named("strip"), arms.named("de_luca_siciliano")
IDS = {"slew": "FlexibleArm-v0", "reach": "TwoLinkFlexArm-v0"}


@pytest.fixture(scope="module")
def slew():
    env = gym.make_vec(IDS["slew"], num_envs=16)
    yield env
    env.close()


@pytest.fixture(scope="module")
def reach():
    env = gym.make_vec(IDS["reach"], num_envs=16)
    yield env
    env.close()


# ------------------------------------------------------------------ the arm as controllers know it
@pytest.mark.parametrize("elbow", [-2.0, 0.0, 1.0])
def test_rigid_inertia_is_that_of_the_linear_model(elbow):
    inertia = rigid_inertia(TWO, np.array([[0.3, elbow]]))[0]
    assert arm_model(TWO, (elbow,)).inertia == pytest.approx(inertia, rel=1e-6)


def test_coriolis_torques_follow_from_the_inertia():
    angles, rates = np.array([[-0.4, 0.7]]), np.array([[1.3, -0.6]])
    slope, v = central(lambda s: rigid_inertia(TWO, angles + s * np.array([0.0, 1.0]))[0], 1e-5, 2), rates[0]
    expected = slope @ v * v[1] - 0.5 * np.array([0.0, v @ slope @ v])
    assert coriolis(TWO, angles, rates)[0] == pytest.approx(expected, rel=1e-7)


def test_frequencies_of_the_free_strip():
    model = arm_model(STRIP, (), 2)
    section = STRIP.links[0].section
    assert model.frequencies[0] == pytest.approx(22.22, rel=1e-3)
    assert model.ratios == pytest.approx(0.5 * STRIP.tau_d * model.frequencies)
    assert pytest.approx(7.0, rel=1e-2) == section.EI


@pytest.mark.parametrize(("arm", "posture"), [(STRIP, ()), (TWO, (0.9,))])
def test_state_of_gives_the_outputs_back(arm, posture):
    model = arm_model(arm, posture, 3)
    outputs = np.random.default_rng(0).normal(size=(5, 4 * arm.n_links))
    assert model.state_of(outputs) @ model.C.T == pytest.approx(outputs, abs=1e-12)


# ------------------------------------------------------------------ geometry
def test_goal_angles_reach_the_target_within_limits():
    rng = np.random.default_rng(1)
    n = 200
    angles = np.stack([rng.uniform(-3, 3, n), rng.uniform(-2.5, 2.5, n)], axis=1)
    radius, bearing = rng.uniform(0.3, 0.95, n), rng.uniform(-3, 3, n)
    target = np.stack([radius * np.cos(bearing), radius * np.sin(bearing)], axis=1)
    goal = inverse.goal_angles(TWO, angles, target, np.ones((n, 2)))
    tip = plane.tip_in_hub_frame(TWO, goal[:, 1:], np.zeros((n, 2)))
    turn = goal[:, 0] - angles[:, 0]
    c, s = np.cos(turn), np.sin(turn)
    reached = np.stack([c * tip[:, 0] - s * tip[:, 1], s * tip[:, 0] + c * tip[:, 1]], axis=1)
    assert reached == pytest.approx(target, abs=1e-9)
    assert np.abs(goal[:, 1]).max() <= 2.8
    assert np.abs(turn).max() <= np.pi


@pytest.mark.slow
def test_the_goal_is_where_the_environment_has_its_target(slew, reach):
    for env in (slew, reach):
        observation, info = env.reset(seed=3)
        controller = control.make("pd", env)
        controller.reset(observation)
        if controller.setup.task == "slew":
            hub = np.arctan2(observation[:, 0], observation[:, 1])
            off = plane.wrapped(controller.goal[:, 0] - info["target"])
            assert off == pytest.approx(0.0, abs=1e-5)
            assert np.abs(controller.goal[:, 0] - hub).max() <= np.pi / 2 + 1e-5
        else:
            q = controller.goal
            tip = 0.5 * np.stack([np.cos(q[:, 0]) + np.cos(q.sum(1)), np.sin(q[:, 0]) + np.sin(q.sum(1))], axis=1)
            assert tip == pytest.approx(info["target"], abs=1e-5)


@pytest.mark.parametrize("name", ["pd", "zv", "zvd"])
@pytest.mark.parametrize("env", ["slew", "reach"])
def test_tuned_loops_leave_a_gain_margin(name, env, request):
    """6 dB; a derivative gain that flips the arm within a control period leaves none."""
    setup = control.Setup.of(request.getfixturevalue(env))
    gains = tuned_gains(name, setup.task)
    assert gains.stable(setup, tune.MARGIN)
    assert not dataclasses.replace(gains, ratio=tuple(50.0 * r for r in gains.ratio)).stable(setup)


@pytest.mark.parametrize("task", ["slew", "reach"])
def test_gains_for_drawn_arms_are_no_edges_of_the_search(task):
    """Each lies within its range by 1 % of it, on the scale of the search; an effort of 1 is all there is, no edge."""
    tables = tune.current(Path(__file__).parents[1] / "agents" / "robust" / f"{task}.toml")
    assert set(tables) == {"pd", "zv", "zvd", "lqr"}
    for name, table in tables.items():
        box = tune.SEARCHED[name] | (tune.WIDE if "ratio" in table else {})
        assert set(table) == set(tune.SEARCHED[name])
        for key, value in table.items():
            low, high = np.log(box[key])
            share = (np.log(value) - low) / (high - low)
            assert ((share > 0.01) & ((share < 0.99) | (key == "effort"))).all(), (name, key, value)
    if task == "slew":
        gains = gains_from("zvd", tables["zvd"])
        env = episodes.make_episodes("FlexibleArm-v0", 100, randomization=episodes.RANDOMIZED)
        assert episodes.run(env, control.make("zvd", control.Setup.of(env), gains)).success.mean() >= 0.99


# ------------------------------------------------------------------ shaping
@pytest.mark.parametrize(("frequency", "ratio"), [(22.0, 0.0), (5.0, 0.1)])
def test_shapers_leave_no_vibration(frequency, ratio):
    zv, zvd = shaping.zv(frequency, ratio), shaping.zvd(frequency, ratio)
    for shaper in (zv, zvd):
        assert sum(shaper.amplitudes) == pytest.approx(1.0)
        assert shaper.residual(frequency, ratio) == pytest.approx(0.0, abs=1e-12)
    assert zvd.residual(1.05 * frequency, ratio) < 0.15 * zv.residual(1.05 * frequency, ratio)


def test_shapers_in_a_row_serve_both_modes():
    both = shaping.zv(8.0, 0.02).then(shaping.zv(13.0, 0.05))
    assert both.residual(8.0, 0.02) == pytest.approx(0.0, abs=1e-12)
    assert both.residual(13.0, 0.05) == pytest.approx(0.0, abs=1e-12)


# ------------------------------------------------------------------ LQR and the plan
def test_lqr_and_its_observer_are_stable():
    gains = tuned_gains("lqr", "slew")
    d = lqr.design(STRIP, (2.0,), 0.02, gains)
    assert np.abs(np.linalg.eigvals(d.A - d.B @ d.K)).max() < 1.0
    assert np.abs(np.linalg.eigvals(d.A - d.A @ d.L @ d.C)).max() < 1.0


@pytest.mark.parametrize(("angle", "seconds"), [(0.2, 0.42), (0.8, 0.78), (1.57, 1.08)])
def test_the_plan_is_bang_bang_and_the_quickest(angle, seconds):
    model = arm_model(STRIP)
    A, B = model.discrete(0.02)
    start = model.state_of(np.array([-angle, 0.0, 0.0, 0.0]))
    found = time_optimal.plan(A, B, start, np.array([2.0]))
    assert found.periods * 0.02 == pytest.approx(seconds)
    assert np.abs(found.torques).max() <= 2.0 + 1e-9
    assert (np.abs(found.torques) > 1.99).mean() > 0.7
    x = start
    for torque in found.torques:
        x = A @ x + B @ torque
    assert x == pytest.approx(0.0, abs=1e-6)
    assert seconds > time_optimal.rigid_time(float(model.inertia[0, 0]), angle, 2.0)
    with pytest.raises(ValueError, match="no plan of so few periods"):
        time_optimal.plan(A, B, start, np.array([2.0]), most=found.periods - 1)


# ------------------------------------------------------------------ in the environment
TO_TARGETS = [name for name in control.NAMES if name not in control.FORCE_NAMES]  # forces: test_force_control.py
FULL = [name for name in TO_TARGETS if name not in ("lqg", "mpc")]  # lqg: test_lqg.py; mpc: test_optimal.py


@pytest.mark.parametrize("name", FULL)
def test_controllers_slew_and_settle(name, slew):
    assert successes(slew, control.make(name, slew), 50) == 1.0


@pytest.mark.parametrize("name", [n for n in FULL if n != "time_optimal"])
def test_controllers_reach_and_settle(name, reach):
    assert successes(reach, control.make(name, reach), 50) >= 0.9


@pytest.mark.parametrize("name", [*FULL, "mpc"])
def test_one_arm_or_many_is_the_same(name, slew):
    many, one = control.make(name, slew), control.make(name, slew)
    observation, _ = slew.reset(seed=9)
    many.reset(observation)
    one.reset(observation[2])
    for _ in range(3):
        actions = many.act(observation)
        action = one.act(observation[2])
        assert action.shape == (1,)
        assert actions[2] == pytest.approx(action, abs=1e-6)
        observation = slew.step(actions)[0]


def test_single_environments_are_known_too():
    env = gym.make(IDS["slew"])
    setup = control.Setup.of(env)
    assert (setup.task, setup.n_joints, setup.control_dt, setup.torque_limits) == ("slew", 1, 0.02, (2.0,))
    assert control.make("lqr", setup).setup is setup


# ------------------------------------------------------------------ what is refused
def test_errors_say_what_is_allowed(reach):
    refuses(r"pid.*zvd", lambda: control.make("pid", reach))
    refuses(r"pd\.kp.*bandwidth", lambda: gains_from("pd", {"kp": 3.0}))
    refuses("flexarm_env", lambda: control.make("pd", gym.make("Pendulum-v1")))
    refuses(r"^env = 3: must be an environment of flexarm_env", lambda: control.make("pd", 3))
    refuses(r"^gains = 3: must be a PDGains", lambda: control.make("pd", reach, 3))
    gains = tuned_gains("lqr", "slew")
    refuses(r"^lqr\.flexible = 1.5: must be a whole", lambda: gains_from("lqr", {**vars(gains), "flexible": 1.5}))
    refuses(r"^flexible = 99: must be at most 6", lambda: arm_model(STRIP, (), 99))
    wrong = {"angle": np.nan, "rate": 1e200, "bend": -1.0, "noise": "x", "flexible": 0}
    for field, value in wrong.items():
        with pytest.raises(ValueError, match=rf"^{field} = .*: must be a (whole|finite) number, at least"):
            dataclasses.replace(gains, **{field: value})
    for field, value in {"effort": 0.0, "bandwidth": (np.inf,), "ratio": "x"}.items():
        with pytest.raises(ValueError, match=rf"^{field} = .*: must be a finite number"):
            dataclasses.replace(tuned_gains("zv", "slew"), **{field: value})
    refuses(r"^ratio = 1.0: must be .* at most 0.99", lambda: control.zv(5.0, 1.0))
    refuses(r"^frequency = 0.0: must be a positive number \(rad/s\)", lambda: control.zvd(0.0))
    double = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[0.0], [1.0]])
    assert control.plan(*double, np.array([3e5, 0.0]), np.ones(1), 1090).periods == 1096  # over a thousand
    refuses(r"^limits = \[0.0\]: must be positive", lambda: control.plan(*double, np.ones(2), np.zeros(1)))
    refuses(r"^start\[0\] = nan", lambda: control.plan(*double, np.full(2, np.nan), np.ones(1)))
    three = PDGains((0.2,) * 3, (0.7,))
    refuses(r"^pd\.bandwidth = .*: must be one number, or 2, one per joint", lambda: control.make("pd", reach, three))
    with pytest.raises(ValueError, match=r"^controller = 'time_optimal': must be one of \"pd\".* for task=\"reach\""):
        control.make("time_optimal", reach)
    refuses("one link", lambda: control.make("time_optimal", reach, tuned_gains("time_optimal", "slew")))


@pytest.mark.parametrize("name", TO_TARGETS)
def test_what_controllers_cannot_read_is_told(name):
    env = gym.make(IDS["slew"], **({"observation": "measured"} if name == "lqg" else {}))
    controller, again = (control.make(name, env) for _ in range(2))
    size = controller.setup.size
    observation = np.full(size, 0.1, np.float32)
    refuses(r"call the controller's reset\(observation\) first", lambda: controller.act(observation), RuntimeError)
    refuses(rf"^shape of observation = \(3,\): must be \(n, {size}\)", lambda: controller.reset(observation[:3]))
    refuses("^observation = 'x': must be numbers", lambda: controller.reset("x"))
    for value in (np.nan, np.inf, 1e300):
        with pytest.raises(ValueError, match=r"^observation\[0\] = .*must be finite numbers"):
            controller.reset(np.where(np.arange(size) == size - 1, value, observation.astype(float)))
    controller.reset(observation)
    again.reset(observation)
    for wrong in (observation * np.nan, observation[None, None], np.tile(observation, (2, 1))):
        with pytest.raises(ValueError, match=r"^(observation\[0\]|shape of observation|rows of observation = 2)"):
            controller.act(wrong)
    assert np.array_equal(controller.act(observation), again.act(observation))  # remembered is what was before
    env.close()


# ------------------------------------------------------------------ policies without a learning library
def small_policy(setup, **changes):
    rng = np.random.default_rng(0)
    sizes = [len(setup.names), 8, setup.n_joints]
    weights = [
        (rng.normal(size=(a, b)).astype(np.float32), rng.normal(size=b).astype(np.float32))
        for a, b in itertools.pairwise(sizes)
    ]
    meta = {
        "format": 1, "layers": 2, "activation": "tanh", "squash": False, "env_id": IDS[setup.task], "env_kwargs": {},
        "layout": setup.layout, **changes,
    }  # fmt: skip
    return control.NumpyPolicy(meta, weights)


def test_a_policy_file_gives_the_same_actions(tmp_path: Path, slew):
    policy = small_policy(control.Setup.of(slew))
    export_policy.save(policy, tmp_path / "policy.npz")
    again = control.load_policy(tmp_path)
    again.check(control.Setup.of(slew))
    observation, _ = slew.reset(seed=0)
    assert np.array_equal(again.act(observation), policy.act(observation))
    assert policy.act(observation[0]).shape == (1,)
    assert np.abs(policy.act(100.0 * observation)).max() <= 1.0
    refuses(r"^shape of observation = \(3,\): must be \(n, 6\)", lambda: policy.act(observation[0, :3]))


def test_policies_that_do_not_fit_are_refused(tmp_path: Path, slew, reach):
    path = tmp_path / "policy.npz"
    refuses("must be a run folder, a file", lambda: control.load_policy(path))
    path.write_bytes(b"PK nonsense")
    refuses("damaged", lambda: control.load_policy(path))
    export_policy.save(small_policy(control.Setup.of(slew), format=99), path)
    refuses(r"meta\.format = 99: must be 1", lambda: control.load_policy(path))
    whole = small_policy(control.Setup.of(slew))
    export_policy.save(whole, path)
    path.write_bytes(path.read_bytes()[:-200])
    refuses("damaged", lambda: control.load_policy(path))
    refuses("observation layout", lambda: whole.check(control.Setup.of(reach)))


def test_a_policy_reads_another_arms_entries_by_its_own_scales(slew):
    """What it would see of the arm that it was trained on; not where its actions would stand for other torques."""
    setup = control.Setup.of(slew)
    scales = {name: 2.0 * scale for name, scale in zip(setup.names, setup.scales, strict=True)}
    policy = small_policy(setup, layout="that of another arm", scales=scales, torque_limits=list(setup.torque_limits))
    observation, _ = slew.reset(seed=0)
    plain = policy.act(0.5 * observation)
    policy.check(setup)
    np.testing.assert_allclose(policy.act(observation), plain, rtol=1e-6)
    policy.meta["torque_limits"] = [9.0]
    refuses("observation layout", lambda: policy.check(setup))


WRONG = {
    "activation": ({"activation": "gelu"}, {}, 'meta.activation = \'gelu\': must be one of "tanh", "relu"'),
    "env_kwargs": ({"env_kwargs": "x"}, {}, "meta.env_kwargs = 'x': must be a table"),
    "env_id": ({"env_id": 3}, {}, "meta.env_id = 3: must be a text that is not empty"),
    "squash": ({"squash": "no"}, {}, "meta.squash = 'no': must be True or False"),
    "layers": ({"layers": 0}, {}, "meta.layers = 0: must be a whole number, from 1 to 100"),
    "too many layers": ({"layers": 3}, {}, "w2: missing; must be an array of shape (1, actions)"),
    "a wrong matrix": ({}, {"w1": np.zeros((5, 1))}, "shape of w1 = (5, 1): must be (8, actions), to fit"),
    "a wrong bias": ({}, {"b0": np.zeros(3)}, "shape of b0 = (3,): must be (8,), to fit the other arrays"),
    "not a matrix": ({}, {"w0": np.zeros(6)}, "shape of w0 = (6,): must be (entries, units 0), to fit"),
    "text": ({}, {"b1": np.array(["x"])}, "dtype of b1 = '<U1': must be that of numbers"),
    "nan": ({}, {"b1": np.array([np.nan])}, "b1[0] = nan: must be a finite number"),
    "mean": ({}, {"mean": np.zeros(4)}, "shape of mean = (4,): must be (6,), to fit the other arrays"),
    "no variance": ({}, {"mean": np.zeros(6)}, "variance: missing; must be an array of shape (6,)"),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_policy_file_is_told_in_a_sentence(tmp_path: Path, slew, name: str):
    changes, arrays, sentence = WRONG[name]
    policy = small_policy(control.Setup.of(slew), **changes)
    content = {"meta": np.array(json.dumps(policy.meta))}
    for k, (w, b) in enumerate(policy.weights):
        content |= {f"w{k}": w, f"b{k}": b}
    path = tmp_path / "policy.npz"
    np.savez(path, **{**content, **arrays})
    assert refusal(lambda: control.load_policy(path)).startswith(f"{path}: {sentence}")


def test_a_policy_file_runs_no_code(tmp_path: Path):
    """An array of Python objects is a pickle: it is not read."""

    class Spy:
        """Makes a file when it is unpickled."""

        def __reduce__(self):
            return open, (str(tmp_path / "made"), "w")

    np.savez(tmp_path / "policy.npz", meta=np.array(Spy(), dtype=object))
    refuses("damaged, or no policy", lambda: control.load_policy(tmp_path))
    assert not (tmp_path / "made").exists()


def test_a_policy_of_another_size_is_refused(slew):
    setup = control.Setup.of(slew)
    policy = small_policy(setup)
    policy.weights[0] = (np.zeros((5, 8), np.float32), policy.weights[0][1])
    refuses(r"makes 1 actions of 5 entries .* are 1 and 6", lambda: policy.check(setup))


def test_pd_that_is_unstable_says_so(tmp_path, recwarn):
    """Gains of the package's arms on one whose hub is light: the torque flipped in every period, without a word. Tuned
    for it they are stable."""
    light = dataclasses.replace(arms.named("strip"), name="light", hub_inertia=5e-4)
    env = gym.make("FlexibleArm-v0", arm=light)
    for name in ("pd", "zvd"):
        with pytest.warns(UserWarning, match="PD gains are unstable on arm 'light' in periods of 0.02 s: tune them"):
            control.make(name, env)
    refuses("pd.bandwith: unknown key .did you mean bandwidth", lambda: control.make("pd", env, {"bandwith": 1.0}))
    file, path = tmp_path / "gains.toml", tmp_path / "light.toml"
    path.write_text(arms.to_toml(light), "utf-8")
    words = ["--env", "FlexibleArm-v0", "--env-kwargs", json.dumps({"arm": str(path)}), "--controllers", "pd"]
    words += ["--refinements", "1", "--episodes", "2", "--out", str(file)]
    recwarn.clear()
    assert tune.main(words=[*words, "--samples", "64"]) == 0 and not recwarn
    found = tune.current(file)["pd"]
    assert control.make("pd", env, found).kp == control.make("pd", env, gains_from("pd", found)).kp and not recwarn
    assert f"--env-kwargs '{json.dumps({'arm': str(path)})}'" in file.read_text("utf-8")
    assert tune.main(words=[*words, "--samples", "1", "--margin", "1000"]) == 2
    assert tune.current(file)["pd"] == found


def test_tune_tries_the_gains_that_come_with_the_package(tmp_path):
    """Where nothing is on file; of so few points drawn none leaves the gain margin."""
    file = tmp_path / "gains.toml"
    words = ["--env", "FlexibleArm-v0", "--controllers", "pd", "--samples", "2", "--refinements", "2"]
    assert tune.main(words=[*words, "--home", str(tmp_path / "none"), "--out", str(file)]) == 0
    assert gains_from("pd", tune.current(file)["pd"]).stable(control.Setup.of(gym.make("FlexibleArm-v0")), tune.MARGIN)
