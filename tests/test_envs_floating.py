"""Arms on a base that floats freely in the plane: momentum, closed forms, the environments, what there is not."""

import dataclasses
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import flexarm_env as fx
from flexarm_env import arms, control
from flexarm_env.compiler import SINGLE, uncompiled
from flexarm_env.derivatives import Arms
from flexarm_env.linear import linearize
from flexarm_env.parameters import Payload
from flexarm_env.physics.protocol import energy
from flexarm_env.recording import EpisodeRecorder
from flexarm_env.remote.server import Session
from flexarm_env.rigid import centre_shift
from flexarm_env.time_functions import pulse, steps
from flexarm_env.validation import Array
from flexarm_env.view import Player
from tests.env_tools import ONE, TWO, assert_pair_same, assert_same, episode, pair, turned
from tests.refusals import refuses

BASE = {"mass": 8.0, "inertia": 0.5}
ON_BASE: dict[str, Any] = {"base": BASE, "info_level": "full", "success": {"attitude": 0.2}}
FORMULATIONS = {
    "elastica": {"nodes": 4}, "geometrically_exact": {"elements": 3}, "floating_frame": {"segments": 2},
}  # fmt: skip


def made(env_id: str = TWO, **more: Any) -> Any:
    return gym.make(env_id, **(ON_BASE | more)).unwrapped


def rigid_motions(names: tuple[str, ...], q: Array) -> Array:
    """Rates (3, rows) of all rows where the whole moves along x, along y, or turns about the origin."""
    t = np.zeros((3, len(names)))
    for k, name in enumerate(names):
        inner = name.count(".") > 1  # relative to the ends of its element
        if name.endswith("_x") or ".x" in name:
            t[0, k], t[2, k] = float(not inner), -q[k + 1]
        elif name.endswith("_y") or ".y" in name:
            t[1, k], t[2, k] = float(not inner), q[k - 1]
        elif name in ("joint0", "base") or name.startswith("phi") or (".psi" in name and not inner):
            t[2, k] = 1.0
    return t


def momentum(system: Any, par: Array, q: Array, v: Array) -> Array:
    """Linear momentum and angular momentum about the origin, (3,): slopes of the kinetic energy by rigid motions."""

    def kinetic(rates: Array) -> float:
        return float(uncompiled(energy)(SINGLE, system.model, par, q, rates)[0])

    moves = rigid_motions(system.names, q)
    return np.array([0.5 * (kinetic(v + t) - kinetic(v - t)) for t in moves])


GEARED = fx.Joint(stiffness=4.0, damping=0.01, motor_inertia=1e-5, gear_ratio=30.0, friction_coulomb=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("formulation", "geared"), [*((name, False) for name in FORMULATIONS), ("elastica", True)])
def test_momentum_is_kept_over_an_episode_of_random_torques(formulation: str, geared: bool) -> None:
    """Nothing acts from outside: linear momentum, and angular momentum about any point, are and stay 0."""
    more: dict[str, Any] = {"randomization": {"payload": (0.3, 3.0)}} if formulation == "elastica" else {}
    if geared:
        more["arm"] = dataclasses.replace(arms.named("de_luca_siciliano"), joints=(fx.Joint(), GEARED))
    env, rng = made(formulation=formulation, **more), np.random.default_rng(3)
    env.reset(seed=5)
    off, size, over = np.zeros(3), np.zeros(3), False
    while not over:
        _, _, failed, over, info = env.step(rng.uniform(-1.0, 1.0, 2).astype(np.float32))
        assert not failed
        q, v, _, par = (rows[0] for rows in env.batch.motions())
        off = np.maximum(off, np.abs(momentum(env.batch.system, par, q, v)))
        hub = np.abs(env.batch.poses(0)[0, 3:5]).max()
        size = np.maximum(size, [BASE["mass"] * hub, BASE["mass"] * hub, BASE["inertia"] * abs(v[-1])])
    assert size.min() > 0.2  # kg m/s, kg m^2/s: what base and arm take from each other
    assert (off < 1e-9 * size).all(), off / size
    gained = info["energy_kinetic"] + info["energy_strain"] + info["energy_dissipated"] - info["work"]
    assert abs(gained) < 0.02 * max(info["work"], info["energy_dissipated"])


@pytest.mark.slow
@pytest.mark.parametrize("formulation", FORMULATIONS)
def test_a_push_is_all_that_changes_the_momentum_of_a_scene(formulation: str) -> None:
    """Force times time, and its moment about the origin over time, summed by the trapezoidal rule over the samples."""
    arm = dataclasses.replace(arms.named("de_luca_siciliano"), base=fx.Base(**BASE))
    push = fx.PointLoad(1, "tip", force_y=pulse(2.0, 0.2))
    scene = fx.Scene("pushed", arm, root="free", duration=0.4, dt=0.005, angles=(0.4, 1.4), loads=(push,))
    run = fx.simulate(scene, formulation, estimate_error=False, **FORMULATIONS[formulation])
    sim = fx.Simulation(scene, run.settings)
    had = np.array([momentum(sim.system, sim.par, q, v) for q, v in zip(run.q, run.v, strict=True)])
    force = np.array([2.0 if t <= 0.2 + 1e-9 else 0.0 for t in run.t])
    moment = force * run.tip[:, 0]
    pushed = run.t <= 0.2 + 1e-9
    brought = np.concatenate([[0.0], np.cumsum(0.5 * (moment[1:] + moment[:-1]) * np.diff(run.t))])
    assert np.abs(had[:, 0]).max() < 1e-12
    assert np.abs(had[-1, 1] - 0.4) < 1e-12
    assert np.abs(had[pushed, 2] - brought[pushed]).max() < 1e-11
    assert np.abs(np.diff(had[~pushed, 2])).max() < 1e-12


@pytest.mark.slow
@pytest.mark.parametrize("payload", [0.0, 0.2])
def test_a_stiff_link_turns_its_base_by_the_closed_form(payload: float) -> None:
    """J psi' + I (psi' + theta') = 0: psi = -theta I / (J + I), with I = I_hub - (m c)^2 / M of a rigid link about the
    centre of mass of all: m c its first moment about the hub, M all the mass. theta is the hub's angle."""
    strip = arms.named("strip")
    link = strip.links[0]
    stiff = dataclasses.replace(
        link.section, EI=1e5 * link.section.EI, EA=1e5 * link.section.EA, C=1e5 * link.section.C
    )
    arm = dataclasses.replace(
        strip, links=(dataclasses.replace(link, section=stiff),), base=fx.Base(**BASE), tau_d=0.0,
        payload=Payload(payload, 0.0),
    )  # fmt: skip
    hub_inertia, length, own = strip.hub_inertia, link.length, link.mass
    inertia = hub_inertia + own * length**2 / 3.0 + link.section.J * length + payload * length**2
    first = own * length / 2.0 + payload * length
    inertia -= first**2 / (own + payload + BASE["mass"])
    assert abs(centre_shift(arm) * (own + payload + BASE["mass"]) - first) < 1e-12
    aside = dataclasses.replace(arm, payload=Payload(payload, 0.0, (0.0, 0.03)))
    assert abs((centre_shift(aside) - centre_shift(arm)) * (own + payload + BASE["mass"]) - 0.03 * payload) < 1e-12
    env = gym.make(ONE, arm=arm, base=BASE, dt=0.0005, tolerance=1e-9).unwrapped
    env.reset(seed=1, options={"start": 0.3, "target": 0.0})
    for k in range(60):
        _, _, failed, _, info = env.step(np.full(1, 0.4 if k < 40 else -0.7, np.float32))
        assert not failed
    psi = info["base_attitude"]
    theta = env.batch.poses(0)[0, 2] - psi - 0.3
    assert theta > 1.0
    assert abs(psi / theta + inertia / (BASE["inertia"] + inertia)) < 1e-6
    slid = math.hypot(*info["base_position"]) / (2.0 * math.sin(0.5 * (theta + psi)))
    assert abs(slid - first / (own + payload + BASE["mass"])) < 1e-6  # about the centre of mass, which stays


@pytest.mark.slow
def test_the_environment_moves_as_a_scene_beside_it() -> None:
    """The same torques, held over each period, as loads of a `Scene` of the same arm on the same base."""
    rng, env = np.random.default_rng(8), made(formulation="geometrically_exact", tolerance=1e-10)
    env.reset(seed=2, options={"start": [0.4, -0.8], "target": [0.5, 0.2]})
    actions = rng.uniform(-1.0, 1.0, (40, 2)).astype(np.float32)
    places = []
    for action in actions:
        info = env.step(action)[4]
        places.append([*info["tip_position"], info["base_attitude"], *info["base_position"]])
    arm, times = env.plan.arm, 0.02 * np.arange(41)
    torque = actions.astype(np.float64) * np.array(arm.torque_limits)
    loads = [fx.JointTorque(k, steps(times[:-1].tolist(), torque[:, k].tolist())) for k in range(2)]
    scene = fx.Scene("beside", arm, root="free", duration=0.8, dt=0.0025, sample=0.02, angles=(0.4, -0.4), loads=loads)
    options = {"elements": 3, "tolerance": 1e-10}
    run = fx.simulate(scene, "geometrically_exact", estimate_error=False, **options)
    beside = np.column_stack([run.tip[1:, :2], run.base_angle[1:], run.start[1:, :2]])
    assert np.abs(np.array(places) - beside).max() < 1e-7
    finer = fx.simulate(scene, "elastica", nodes=5, dt=0.001, estimate_error=False)
    assert np.abs(np.column_stack([finer.tip[1:, :2], finer.base_angle[1:]]) - np.array(places)[:, :3]).max() < 1e-4


def test_what_is_observed_of_the_base() -> None:
    env = made(observation="full")
    rng, plan = np.random.default_rng(1), env.plan
    env.reset(seed=3)
    for _ in range(60):
        observation, reward, _, _, info = env.step(rng.uniform(-1.0, 1.0, 2).astype(np.float32))
    seen = dict(zip(plan.names, observation * np.array(plan.scales), strict=True))
    poses, (q, v) = env.batch.poses(0), (rows[0] for rows in env.batch.motions()[:2])
    psi, rate, link = q[-1], v[-1], poses[0, 2]
    assert info["base_attitude"] == psi and (info["base_position"] == poses[0, :2]).all()
    expected = {
        "base_sin": math.sin(psi), "base_cos": math.cos(psi), "base_rate": rate, "hub_sin": math.sin(link - psi),
        "hub_cos": math.cos(link - psi), "hub_rate": poses[0, 5] - rate,
    }  # fmt: skip
    for name, vector in (("base_velocity", poses[0, 3:5]), ("base_offset", poses[0, :2])):
        expected |= dict(zip((f"{name}_x", f"{name}_y"), turned(link, vector), strict=True))
    way = turned(link, info["target"] - info["tip_position"])
    expected |= {"to_target_x": way[0], "to_target_y": way[1]}
    for name, value in expected.items():
        assert abs(seen[name] - value) < 3e-6, name
    assert info["reward_attitude"] == pytest.approx(0.5 - 0.5 * min(psi * psi, 1.0), rel=1e-12)
    assert reward == pytest.approx(sum(value for name, value in info.items() if name.startswith("reward_")))
    arm = plan.arm
    scales = dict(zip(plan.names, plan.scales, strict=True))
    share = arm.mass / (arm.mass + 8.0)
    assert scales["base_rate"] == pytest.approx(math.sqrt(arm.torque_limits[0] * math.pi / 2.0 / 0.5))
    assert scales["base_offset_x"] == pytest.approx(0.5 * share * arm.total_length)


FEATURES: dict[str, Any] = {
    "keep_out": [{"shape": "sphere", "center": [0.5, 0.5], "radius": 0.1}], "cost": {"deflection": 0.05}, "history": 2,
    "sensors": {"encoders": {"counts": 4096}, "accelerometer": {}, "camera": {}, "noise": 0.01, "delay": 0.04},
    "actuator": {"lag": 0.01, "delay": 0.02 / 3}, "reward": {"change": 0.1, "cost": 0.2},
    "randomization": {"payload": (0.5, 2.0), "EI": (0.8, 1.2), "torque_constant": (0.9, 1.1)},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("env_id", "more"), [(ONE, {}), (TWO, {}), (TWO, FEATURES)])
def test_single_and_vector_give_the_same_bits(env_id: str, more: dict[str, Any]) -> None:
    assert_pair_same(pair(env_id, 9, threads=2, duration=0.6, **ON_BASE, **more), 45)


@pytest.mark.slow
def test_encoders_read_the_hub_from_the_base() -> None:
    """Ideal ones read what there is."""
    both = episode(made(sensors={"encoders": {}}), 3, 20), episode(made(), 3, 20)
    for one, other in zip(*both, strict=True):
        assert np.abs(one[0][:4] - other[0][:4]).max() < 1e-6


def test_the_multi_link_environment_is_the_same_to_the_last_bit() -> None:
    one, other = made(), made("MultiLinkFlexArm-v0", arm="de_luca_siciliano", duration=8.0)
    assert_same(episode(one, 4, 20), episode(other, 4, 20))


def test_gymnasium_has_nothing_to_say_against_it() -> None:
    check_env(made(), skip_render_check=True)
    check_env(made(ONE), skip_render_check=True)


@pytest.mark.slow
def test_what_is_not_finite_or_far_too_much_ends_one_episode_at_most() -> None:
    env = gym.make_vec(TWO, num_envs=3, **ON_BASE)
    calm = gym.make_vec(TWO, num_envs=3, **ON_BASE)
    env.reset(seed=1)
    calm.reset(seed=1)
    for k in range(30):
        actions = np.zeros((3, 2), np.float32)
        actions[2] = 0.3
        expected = calm.step(actions.copy())
        actions[0] = 1e30
        actions[1] = np.nan if k == 20 else 0.0
        observation, _, terminated, _, info = env.step(actions)
        assert np.isfinite(observation).all()
        assert (observation[2] == expected[0][2]).all()
        if k == 20:
            assert terminated[1] and info["termination_reason"][1] == "action_not_finite"
    assert not terminated[0]
    env = made(arm=dataclasses.replace(arms.named("de_luca_siciliano"), torque_limits=(1e5, 1e5)))
    env.reset(seed=1)
    for _ in range(50):
        observation, reward, failed, _, info = env.step(np.ones(2, np.float32))
        assert np.isfinite(observation).all() and math.isfinite(reward)
        if failed:
            break
    assert failed and info["termination_reason"] in ("newton_failed", "diverged", "joint_limit", "not_finite")


def test_success_asks_for_the_attitude_where_it_is_bounded() -> None:
    """Where it starts, at its target and at rest, an arm succeeds by the bound of an attitude that is 0."""
    for bound, action, wanted in ((0.2, 0.0, True), (1e-9, 1e-4, False)):
        env = made(success={"attitude": bound, "position": 0.5, "speed": 10.0, "hold": 0.1})
        env.reset(seed=1, options={"start": [0.0, 0.5], "target": [0.8, 0.3]})
        for _ in range(10):
            info = env.step(np.full(2, action, np.float32))[4]
        assert info["is_success"] is wanted


def test_limits_of_the_hub_are_those_of_the_angle_from_the_base() -> None:
    env = made(joint_limits=[(-0.2, 0.2), None])
    env.reset(seed=1, options={"start": [0.0, 0.0], "target": [0.5, 0.3]})
    for _ in range(200):
        _, _, failed, _, info = env.step(np.array([0.5, 0.0], np.float32))
        if failed:
            break
    assert info["termination_reason"] == "joint_limit"
    q = env.batch.motions()[0][0]
    assert abs(env.batch.poses(0)[0, 2] - q[-1]) >= 0.2 > env.batch.poses(0)[0, 2]


@pytest.mark.slow
def test_derivatives_of_a_period_are_those_of_what_it_does() -> None:
    """Against central differences of the period itself, the momentum that steps keep among what it does."""
    own = Arms(TWO, 1, tolerance=1e-12, **ON_BASE)
    state, action = own.reset(seed=2), np.array([[0.3, -0.2]])
    for _ in range(10):
        state = own.step(state, np.array([[0.7, -0.6]]))[0]
    assert not own.backwards
    moved, by = own.jacobians(state, action).moved[0], 1e-6
    for j in range(moved.shape[1]):
        sides = []
        for sign in (1.0, -1.0):
            given = state.copy(), action.copy()
            row, k = (given[0], j) if j < own.moving else (given[1], j - own.moving)
            row[0, k] += sign * by
            after, seen, reward = own.step(*given)
            sides.append(np.concatenate([after[0, : own.moving], seen[0], reward]))
        slope = (sides[0] - sides[1]) / (2.0 * by)
        assert np.abs(slope - moved[:, j]).max() < 1e-7 * max(1.0, np.abs(slope).max()), j


@pytest.mark.slow
def test_linear_models_turn_the_base() -> None:
    env = made()
    env.reset(seed=1, options={"start": [0.2, 0.9], "target": [0.5, 0.3]})
    model = env.linearize(discrete=0.02)
    q, v = (rows[0] for rows in env.batch.motions()[:2])
    torque = np.array([1e-4, -2e-4])
    env.step((torque / np.array(env.plan.arm.torque_limits)).astype(np.float32))
    after = np.concatenate([rows[0] for rows in env.batch.motions()[:2]])
    named = {name: k for k, name in enumerate(model.states)}
    assert {"base", "base_rate"} <= set(named)
    assert model.inputs == ("torque0", "torque1")
    foreseen = model.rate + model.B @ torque
    start = np.concatenate([q, v])
    rate = named["base_rate"]
    assert foreseen[rate] == pytest.approx(-0.02 * torque[0] / BASE["inertia"], rel=1e-6)
    assert np.abs(foreseen - after).max() < 0.05 * np.abs(after - start).max()
    vector = gym.make_vec(TWO, num_envs=2, **ON_BASE)
    vector.reset(seed=1, options={"start": [0.2, 0.9], "target": [0.5, 0.3]})
    assert np.allclose(vector.unwrapped.linearize(discrete=0.02).A[0], model.A, atol=1e-12)


def test_a_base_that_is_held_changes_nothing() -> None:
    arm = arms.named("de_luca_siciliano")
    loads = (fx.JointTorque(0, pulse(0.5, 0.2)),)
    both = (arm, dataclasses.replace(arm, base=fx.Base(**BASE)))
    scenes = [fx.Scene("held", one, duration=0.3, dt=0.01, loads=loads) for one in both]
    runs = [fx.simulate(scene, "elastica", nodes=4, estimate_error=False) for scene in scenes]
    assert (runs[0].q == runs[1].q).all()


def test_bases_in_files() -> None:
    arm = dataclasses.replace(arms.named("de_luca_siciliano"), base=fx.Base(3.0, 0.25))
    assert arms.from_toml(arms.to_toml(arm)) == arm
    scene = fx.Scene("s", arm, root="free", duration=1.0, dt=0.01)
    assert fx.Scene.from_toml(scene.to_toml()) == scene


def test_what_there_is_not_is_refused_by_name() -> None:
    arm = arms.named("de_luca_siciliano")
    afloat = dataclasses.replace(arm, base=fx.Base(**BASE))
    refuses(r"^base.inertia = 0.0: must be a positive number", lambda: made(base={"mass": 1.0, "inertia": 0.0}))
    refuses(r"^base.mass", lambda: made(base={"inertia": 1.0}))
    refuses(r"^base = .*: must be left out in space", lambda: gym.make("SpatialFlexArm-v0", base=BASE))
    refuses(r"^action_mode = 'residual_pd': must not be used on", lambda: made(action_mode="residual_pd"))
    refuses(r"^observation = 'measured': must be", lambda: made(observation="measured"))
    refuses(r"^observation = 'hub_error': must be", lambda: made(observation=["hub_sin", "hub_error"]))
    for name, value in (
        ("task", "track"), ("task", "replay"), ("gravity", np.zeros(2)), ("initial_vibration", 0.1),
        ("pushes", {"wait": (0.1, 0.2), "force": (1.0, 1.0)}),
        ("payload_change", {"time": (1.0, 2.0), "factor": (1.0, 2.0)}),
    ):  # fmt: skip
        refuses(f"^{name} = ", lambda name=name, value=value: made(**{name: value}))
    refuses(r"^actuator.viscous = 0.1: must be 0 at the hub on a base", lambda: made(actuator={"viscous": 0.1}))
    refuses(r"^randomization.hub_inertia = ", lambda: made(randomization={"hub_inertia": (0.5, 2.0)}))
    refuses(r"^multipliers = True", lambda: made(formulation="floating_frame", multipliers=True))
    refuses(r"^options.motion = ", lambda: made().reset(options={"motion": "two_link_motion"}))
    refuses(r"^mass_damping = 0.1", lambda: made(arm=dataclasses.replace(arm, mass_damping=0.1)))
    ends = (dataclasses.replace(arm.links[0], root_offset=0.1), *arm.links[1:])
    refuses(r"^links\[0\].root_offset = 0.1", lambda: made(arm=dataclasses.replace(arm, links=ends)))
    refuses(r"^arm.base = ", lambda: control.make("pd", made()))
    refuses(r"^env = ", lambda: Session(gym.make(TWO, **ON_BASE)))
    scene = fx.Scene("s", afloat, root="free", duration=0.1, dt=0.01)
    refuses(r"^base = .*: is not taken into account by", lambda: fx.simulate(dataclasses.replace(scene, space=True)))
    refuses(r"^method = 'solver'", lambda: linearize(scene, discrete=0.02))
    turn, torque = fx.Motion("joint0", pulse(0.0, 1.0)), fx.JointTorque(0, pulse(1.0, 1.0))
    refuses(r"^motions\[0\].coordinate", lambda: dataclasses.replace(scene, motions=(turn,)))
    refuses(r"^loads\[0\].joint", lambda: dataclasses.replace(scene, arm=arm, loads=(torque,)))
    held = dataclasses.replace(scene, arm=arm, root="pinned", loads=(torque,))
    refuses("must be a Base", lambda: fx.simulate(held, "elastica", nodes=4, estimate_error=False).base_angle)


def test_a_picture_shows_where_the_base_points() -> None:
    env = made(render_mode="rgb_array")
    env.reset(seed=1)
    before = env.render()
    for _ in range(20):
        env.step(np.array([1.0, 0.0], np.float32))
    after = env.render()
    panel = np.array([120, 148, 190])
    places = [np.argwhere(np.abs(image.astype(int) - panel).max(axis=2) < 6) for image in (before, after)]
    slopes = []
    for found in places:
        assert len(found) > 200
        centred = found - found.mean(axis=0)
        slopes.append(np.linalg.eigh(centred.T @ centred)[1][:, 1])
    turned_by = math.acos(min(1.0, abs(float(slopes[0] @ slopes[1]))))
    assert abs(turned_by - abs(env.snapshot().q[-1])) < 0.03


@pytest.mark.slow
def test_a_player_shows_the_base() -> None:
    env = EpisodeRecorder(gym.make(TWO, **ON_BASE))
    env.reset(seed=1)
    for _ in range(7):
        attitude = env.step(np.array([1.0, -0.5], np.float32))[4]["base_attitude"]
    env.close()
    clip = env.episodes[0].clip()
    assert clip.base is not None and clip.base[0] == 0.0 and clip.base[-1] == attitude
    assert (clip.every(3).base == clip.base[[0, 3, 6, 7]]).all()
    assert '"base":{' in Player([clip]).data and clip.charts[1].series["base"] is clip.base
    arm = dataclasses.replace(arms.named("de_luca_siciliano"), base=fx.Base(**BASE))
    loads = (fx.JointTorque(0, pulse(0.5, 0.2)),)
    scenes = (fx.Scene("s", arm, root=root, duration=0.1, dt=0.01, loads=loads) for root in ("free", "pinned"))
    runs = [fx.simulate(scene, "elastica", nodes=4, estimate_error=False) for scene in scenes]
    assert (runs[0].clip().base == runs[0].base_angle).all() and runs[1].clip().base is None
