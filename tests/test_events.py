"""What befalls an arm in an episode: costs, pushes, payloads gripped and let go; each against its meaning."""

import dataclasses
import itertools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.rigid import inertia_beyond
from flexarm_env.sensors import surface
from tests.env_tools import ONE, TWO, assert_pair_same, assert_same, pair
from tests.refusals import refuses

STRIP = arms.named("strip")
STRIP = dataclasses.replace(STRIP, payload=dataclasses.replace(STRIP.payload, inertia=2e-3))
CALM = dataclasses.replace(STRIP, tau_d=0.05)
"""Its vibrations are gone within a second or two."""

GAUGES = [{"place": place, "unit": "strain"} for place in (0.0, 0.25, 0.5, 0.75)]
EVENTS: dict[str, Any] = {
    "arm": STRIP,
    "gravity": (0.0, 0.0),
    "sensors": {"strain_gauges": GAUGES},
    "cost": {"deflection": 0.05, "strain": 5e-4},
    "pushes": {"wait": (0.1, 0.4), "force": (0.5, 1.0), "lasting": 0.06},
    "payload_change": {"time": (0.4, 0.8), "factor": (0.2, 2.0)},
    "info_level": "full",
}
"""One compiled form for many tests."""

FORMULATIONS = [
    "elastica",
    pytest.param("geometrically_exact", marks=pytest.mark.slow),
    pytest.param("floating_frame", marks=pytest.mark.slow),
]


def quiet(**changes: Any) -> dict[str, Any]:
    """EVENTS with pushes of no force, and one change of the payload at 2 s, which is none."""
    return EVENTS | {
        "pushes": {"wait": (0.1, 0.4), "force": (0.0, 0.0), "lasting": 0.06},
        "payload_change": {"time": (2.0, 2.0), "factor": (1.0, 1.0)},
        "arm": CALM,
    } | changes  # fmt: skip


def energy(info: dict[str, Any]) -> float:
    return float(info["energy_kinetic"] + info["energy_strain"] + info["energy_gravity"])


def run(env: Any, action: Any, steps: int, seed: int = 0, **options: Any) -> list[dict[str, Any]]:
    """info at the reset and after each step; action: of the step's number."""
    infos = [env.reset(seed=seed, options=options or None)[1]]
    for k in range(steps):
        infos.append(env.step(np.array(action(k), np.float32).reshape(env.action_space.shape))[-1])
    return infos


# ---------------------------------------------------------------------------------------- payload
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize(
    ("gripped", "factor"),
    [("resting", 3.0), pytest.param("moving", 3.0, marks=pytest.mark.slow), ("resting", 0.25)],
)
def test_angular_momentum_through_gripping_and_letting_go(formulation: str, gripped: str, factor: float) -> None:
    """No torque acts about the hub: what the arm and what it grips have of angular momentum, they keep.

    It spins straight before, and once its vibrations have been damped, straight again.
    """
    change = {"time": (2.0, 2.0), "factor": (factor, factor), "gripped": gripped}
    env = gym.make(ONE, formulation=formulation, duration=6.0, **quiet(payload_change=change))
    rates = [
        float(env.unwrapped.batch.view(0).poses[0, 5]) for _ in _each_step(env, lambda k: 0.3 if k < 25 else 0.0, 300)
    ]
    heavier = dataclasses.replace(CALM.payload, mass=CALM.payload.mass * factor, inertia=CALM.payload.inertia * factor)
    before, after = inertia_beyond(CALM, 0), inertia_beyond(dataclasses.replace(CALM, payload=heavier), 0)
    stays = gripped == "moving" or factor < 1.0
    assert rates[-1] == pytest.approx(rates[99] * (1.0 if stays else before / after), rel=2e-4)


def _each_step(env: Any, action: Any, steps: int) -> Any:
    env.reset(seed=0)
    for k in range(steps):
        env.step(np.array([action(k)], np.float32))
        yield k


@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("factor", [2.5, 0.0])
def test_books_close_through_gripping_letting_go_and_pushes(formulation: str, factor: float) -> None:
    """In a field of gravity, with a torque, an arm that bends: what the balance lacks is a small part of what the
    impact took, and goes with the step: short enough, for the exact beam, to see its stiff modes being damped."""
    lacking = []
    for dt in (0.0025, 0.0025 / 32):
        changes = {"payload_change": {"time": (0.5, 0.5), "factor": (factor, factor)}, "gravity": (0.0, -3.0)}
        env = gym.make(ONE, formulation=formulation, dt=dt, **(EVENTS | changes))
        infos = run(env, lambda k: math.sin(k / 10), 60)
        away = [energy(i) - energy(infos[0]) - i["work"] + i["energy_dissipated"] for i in infos]
        jump = infos[26]["energy_dissipated"] - infos[25]["energy_dissipated"]
        lacking.append(max(abs(x) for x in away))
        assert (jump > 0.05) == (factor > 1.0)
        assert infos[25]["payload_mass"] == 0.2 and infos[26]["payload_mass"] == pytest.approx(0.2 * factor)
    assert lacking[0] < 2e-3 and lacking[1] < max(0.5 * lacking[0], 1e-5)


def test_a_rigid_arm_loses_what_two_bodies_lose() -> None:
    """A stiff arm: I w is kept, and 1/2 I w^2 (1 - I/I+) is lost, at once and by what damping makes of the shock; let
    go, the payload takes its own along."""
    link = dataclasses.replace(
        STRIP.links[0], section=dataclasses.replace(STRIP.links[0].section, EI=7e5, EA=7e9, C=7e9), length=1.0
    )
    stiff = dataclasses.replace(STRIP, links=(link,), tau_d=1e-3)
    inertia = inertia_beyond(stiff, 0)
    for factor in (2.0, 0.5):
        change = {"time": (0.5, 0.5), "factor": (factor, factor)}
        infos = run(gym.make(ONE, **quiet(arm=stiff, payload_change=change)), lambda k: 0.5 if k < 20 else 0.0, 30)
        kinetic, lost = infos[25]["energy_kinetic"], infos[30]["energy_dissipated"] - infos[25]["energy_dissipated"]
        carried = (0.2 + 2e-3) * (factor - 1.0)  # L is 1 m
        if factor > 1.0:
            assert infos[30]["energy_kinetic"] == pytest.approx(kinetic * inertia / (inertia + carried), rel=1e-4)
            assert lost == pytest.approx(kinetic * carried / (inertia + carried), rel=1e-3)
            assert infos[26]["work"] == pytest.approx(infos[25]["work"], abs=1e-6)
        else:
            gone = kinetic * -carried / inertia
            assert infos[26]["work"] - infos[25]["work"] == pytest.approx(-gone, rel=1e-4)
            assert lost == pytest.approx(0.0, abs=1e-6)


def test_a_change_that_is_none_changes_nothing() -> None:
    """The same payload at 0.5 s, with the same compiled form; but for round-off in velocities and accelerations."""
    ends = []
    for time in (0.5, 5.0):
        change = {"time": (time, time), "factor": (1.0, 1.0)}
        env = gym.make(ONE, **(EVENTS | {"payload_change": change}))
        ends.append(run(env, lambda k: math.sin(k / 5), 60)[-1]["tip_position"])
    np.testing.assert_allclose(ends[0], ends[1], atol=1e-9)


# ---------------------------------------------------------------------------------------- pushes
def test_work_of_pushes_is_force_times_way() -> None:
    """The force is dead and steady over a period: its work is what the tip goes along it. No torque acts."""
    change = {"time": (3.9, 3.9), "factor": (1.0, 1.0)}
    infos = run(gym.make(ONE, **(EVENTS | {"payload_change": change})), lambda k: 0.0, 150)
    pushed = 0
    for before, info in itertools.pairwise(infos):
        way = info["tip_position"] - before["tip_position"]
        assert info["work"] - before["work"] == pytest.approx(float(info["push"] @ way), abs=1e-12)
        pushed += bool(info["push"].any())
    assert 15 < pushed < 100


def test_a_push_may_begin_at_the_last_instant_that_is_allowed() -> None:
    """Whatever 0.58 / 0.02 rounds to."""
    for at in (0.3, 0.58):
        env = gym.make(ONE, pushes={"wait": (at, at), "force": (1.0, 1.0), "until": at})
        env.reset(seed=0)
        forces = [env.step(np.zeros(1, np.float32))[-1]["push"].any() for _ in range(40)]
        assert np.flatnonzero(forces).tolist() == [round(at / 0.02)]


@pytest.mark.slow
def test_pushes_come_as_asked() -> None:
    """Waits, durations and forces lie within their ranges and fill them; directions all around; none after `until`."""
    asked = {"wait": (0.1, 0.4), "force": (0.5, 1.0), "lasting": 0.06, "until": 4.0}
    vector = gym.make_vec(ONE, num_envs=16, duration=6.0, threads=1, **(EVENTS | {"pushes": asked}))
    vector.reset(seed=0)
    actions = np.zeros(vector.action_space.shape, np.float32)
    forces = np.array([vector.step(actions)[-1]["push"] for _ in range(299)])
    waits, sizes, angles = [], [], []
    for i in range(16):
        on = np.r_[False, forces[:, i].any(axis=1), False]
        starts, ends = np.flatnonzero(on[1:] & ~on[:-1]), np.flatnonzero(~on[1:] & on[:-1])
        assert set(ends - starts) == {3} and starts.max() <= 200
        waits += [starts[0], *(starts[1:] - ends[:-1])]
        assert all((forces[s:e, i] == forces[s, i]).all() for s, e in zip(starts, ends, strict=True))
        sizes += np.hypot(*forces[starts, i].T).tolist()
        angles += np.arctan2(*forces[starts, i].T).tolist()
    assert (min(waits), max(waits)) == (5, 20)
    assert 0.5 <= min(sizes) < 0.55 and 0.95 < max(sizes) <= 1.0
    assert np.histogram(angles, 4, (-math.pi, math.pi))[0].min() > 0.15 * len(angles)


# ---------------------------------------------------------------------------------------- cost
def test_cost_is_one_beyond_a_limit() -> None:
    """Of the tip's deflection, and of the surface's strain at any of four stations, told by gauges there."""
    section = STRIP.links[0].section
    assert surface(section.m, section.J) == pytest.approx(0.5 * 0.00342)
    cases = (0.03, 1.0), (1.0, 3e-4), (0.06, 6e-4)
    for limits in ({"deflection": bend, "strain": strain} for bend, strain in cases):
        env = gym.make(ONE, **(EVENTS | {"cost": limits}))
        env.reset(seed=1)
        total, seen = 0.0, set()
        scales = np.array(env.unwrapped.plan.scales[6:])
        for k in range(100):
            observation, *_, info = env.step(np.array([math.sin(k / 6)], np.float32))
            strain = np.abs(observation[6:] * scales).max()
            past = abs(info["tip_deflection"]) > limits["deflection"] or strain > limits["strain"]
            assert info["cost"] == float(past), k
            total += info["cost"]
            assert info["episode_cost"] == total
            seen.add(past)
        assert seen == {False, True}
        assert env.reset(seed=2)[1]["episode_cost"] == 0.0


# ---------------------------------------------------------------------------------------- all of them
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("env_id", [ONE, pytest.param(TWO, marks=pytest.mark.slow)])
def test_single_and_vector_agree_to_the_last_bit(env_id: str, formulation: str) -> None:
    changes = {"formulation": formulation, "duration": 0.9, "randomization": {"payload": (0.5, 2.0)}}
    changes |= {} if env_id == ONE else {"arm": "de_luca_siciliano", "sensors": {}}
    both = pair(env_id, 5, **(EVENTS | changes))
    assert assert_pair_same(both, 100) >= 5


def test_states_go_back_with_all_that_is_to_come() -> None:
    env = gym.make(ONE, **EVENTS)
    run(env, lambda k: 0.5, 15)
    state = env.unwrapped.get_state()
    first = [env.step(np.array([0.5], np.float32)) for _ in range(60)]
    env.unwrapped.set_state(state)
    assert_same(first, [env.step(np.array([0.5], np.float32)) for _ in range(60)])
    assert {o[-1]["payload_mass"] for o in first} > {0.2}


@pytest.mark.slow
def test_what_is_left_out_draws_nothing() -> None:
    """Starts, targets and randomised arms of a seed are the same with events and without."""
    plain = gym.make(ONE, initial_vibration=0.02)
    eventful = gym.make(ONE, initial_vibration=0.02, **(EVENTS | {"arm": "strip"}))
    for seed in range(3):
        assert_same(plain.reset(seed=seed)[0], eventful.reset(seed=seed)[0][:6])
    assert set(plain.reset(seed=0)[1]) & {"cost", "episode_cost", "push", "payload_mass"} == set()


def test_starts_are_drawn_from_what_is_given() -> None:
    asked = {"angles": [(0.5, 0.75)], "target": (2.0, 2.25), "absolute": True}
    for starts, low in ((asked, 2.0), (asked | {"absolute": False}, 2.5)):
        vector = gym.make_vec(ONE, num_envs=64, threads=1, starts=starts, **EVENTS)
        observation, info = vector.reset(seed=0)
        angles = np.arctan2(observation[:, 0], observation[:, 1])
        assert 0.5 <= angles.min() < 0.51 and 0.74 < angles.max() <= 0.75
        assert low <= info["target"].min() and info["target"].max() <= low + 0.5 and np.ptp(info["target"]) > 0.2


@pytest.mark.parametrize(
    ("keywords", "words"),
    [
        ({"cost": {}}, "cost.deflection: missing"),
        ({"cost": {"bend": 1}}, "cost.bend"),
        ({"cost": {"deflection": [0.1, 0.1]}}, r"cost.deflection = \[0.1, 0.1\]: must be a sequence of 1"),
        ({"cost": {"strain": 0.0}}, "cost.strain = 0.0: must be a positive number"),
        ({"pushes": {"force": (0, 1)}}, "pushes.wait: missing"),
        ({"pushes": {"wait": (1, 0), "force": (0, 1)}}, "pushes.wait = .*low at most high"),
        ({"pushes": {"wait": (0, 1), "force": (0, 1), "lasting": 0.03}}, "whole number of control_dt = 0.02 s"),
        ({"payload_change": {"time": (1, 2)}}, "payload_change.factor: missing"),
        ({"payload_change": {"time": (0, 2), "factor": (1, 2)}}, r"time\[0\] = 0: must be .* at least 0.02"),
        ({"payload_change": {"time": (1, 2), "factor": (1, 2), "gripped": "x"}}, '"resting", "moving"'),
        ({"success": {"position": 0.0}}, "success.position = 0.0"),
        ({"success": {"patience": 1.0}}, "success.patience"),
        ({"success": {"paid": True, "hold": 0.2}}, "success.position: missing; .* for success needs bounds"),
        ({"success": {"paid": 1}}, "success.paid = 1: must be"),
        ({"turns": "all"}, '"exact", "any"'),
        ({"turns": "any", "action_mode": "residual_pd"}, "joint errors"),
        ({"starts": {"angles": [(0.0, 1.0), (0.0, 1.0)]}}, "starts.angles"),
        ({"starts": {"target": (1.0, 0.0)}}, "starts.target"),
        ({"task": "track", "reference": {"path": "spiral"}}, '"swing", "line"'),
        ({"task": "track", "reference": {"period": (0.0, 1.0)}}, "reference.period"),
        ({"task": "replay", "cost": {"deflection": 0.1}}, 'task = .replay.: must not be given .* with cost'),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(keywords: dict[str, Any], words: str) -> None:
    refuses(words, lambda: gym.make(ONE, **keywords))


def test_an_arm_without_a_payload_has_none_to_change() -> None:
    bare = dataclasses.replace(STRIP, payload=type(STRIP.payload)())
    with pytest.raises(ValueError, match=r"arm.payload.mass = 0.0: must be positive for payload_change"):
        gym.make(ONE, arm=bare, payload_change=EVENTS["payload_change"])


def test_prescribed_motions_meet_no_events() -> None:
    env = gym.make(ONE, cost={"deflection": 0.1})
    refuses(r"options.motion = .* with cost", lambda: env.reset(options={"motion": "spin_up"}))
