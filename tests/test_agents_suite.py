"""The reference results: what is run in which order, how it goes on, the best known, references from results."""

import dataclasses
import itertools
import json
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from agents import foresight, payoff, record, ship
from agents import suite as reference
from flexarm_env import control, derivatives, suite
from flexarm_env.suite import best, results
from flexarm_env.suite.policies import choose
from flexarm_env.suite.score import FIRST
from flexarm_env.training import config, export_policy
from flexarm_env.training.train import Arguments as Training
from tests.agents_tools import told
from tests.test_suite_bench import entry_of

TASKS = suite.tasks()
LEARNT = [method for method in reference.METHODS if method.algorithm not in ("", "foresight")]


def entry(task: suite.Task, mean: float, **changes) -> dict:
    """Of a controller."""
    return entry_of(task, mean, **{"costs": [2.0] * 100, "training": None} | changes)


@pytest.mark.parametrize("method", LEARNT, ids=[method.name for method in LEARNT])
def test_each_method_has_hyper_parameters_for_its_tasks(method: reference.Method):
    if method.algorithm in ("tqc", "recurrent_ppo"):
        pytest.importorskip("sb3_contrib")
    path = reference.ROOT / "configs" / method.algorithm / f"{method.config}.yml"
    for task in TASKS:
        if task.id in (method.tasks or (task.id,)):
            assert config.load(path, method.algorithm, task.registered).n_timesteps > 0
    assert set(method.tasks or ()) <= {task.id for task in TASKS}


def test_controllers_first_then_each_seed_in_turn():
    todo = list(reference.jobs(reference.Arguments(only="ppo,pd,tqc", seeds=2)))
    names = [(job.method.name, job.seed) for job in todo]
    few = len(reference.FEW)
    free = len(reference.FREE)
    expected = [("pd", 0)] * len(TASKS) + [("ppo", 0)] * free + [("tqc", 0)] * few
    assert names == expected + [("ppo", 1)] * free + [("tqc", 1)] * few
    assert free == len(TASKS) - len(reference.PRESSED)


def test_what_is_done_is_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    kept = {TASKS[0].id: entry(TASKS[0], 1.0), TASKS[1].id: entry(TASKS[1], 1.0, digest="another")}
    results.Results("pd", 0, kept, {TASKS[2].id: "not made for it"}).write(tmp_path / "suite")
    monkeypatch.setattr(reference, "MANY", {TASKS[1].id: 200})
    ran = []
    monkeypatch.setattr(reference, "run", lambda job, arguments: ran.append(job.task.id) or job.name)
    monkeypatch.setattr("sys.argv", ["suite", "--only", "pd", "--results", str(tmp_path / "suite")])
    assert reference.main() == 0
    assert ran == [TASKS[1].id, *(task.id for task in TASKS[3:])]
    assert (tmp_path / "suite.md").read_text().startswith("# Results on the suite")
    assert (tmp_path / "suite.png").is_file()  # the figure of docs/results stays as it is
    job = reference.Job(reference.METHODS[0], 0, TASKS[0])
    assert job.done(tmp_path / "suite")
    monkeypatch.setattr(reference, "MANY", {TASKS[0].id: 200})  # its hundred alone is not enough
    assert not job.done(tmp_path / "suite")
    monkeypatch.setattr(reference, "MANY", {})
    monkeypatch.setattr("sys.argv", ["suite", "--plan", "--only", "pd,ppo", "--results", str(tmp_path / "suite")])
    capsys.readouterr()
    assert reference.main() == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"pd: 2 of {len(TASKS)} runs done"
    assert lines[1].startswith(f"ppo: 0 of {5 * len(reference.FREE)} runs")


def test_references_are_pd_and_the_best_of_what_was_judged(monkeypatch: pytest.MonkeyPatch):
    task = dataclasses.replace(next(one for one in TASKS if one.price), id=TASKS[0].id, digest=TASKS[0].digest)
    assert results.value(task, entry(task, 10.0)) == 10.0 - 2.0 * task.price
    first = TASKS[0]
    found = [
        results.Results("pd", 0, {first.id: entry(first, 10.0), TASKS[1].id: entry(TASKS[1], 10.0)}),
        results.Results("ppo", 3, {first.id: entry_of(first, 30.0)}),
        results.Results("zv", 0, {first.id: entry(first, 20.0), TASKS[1].id: entry(TASKS[1], 5.0)}),
    ]
    frozen = reference.frozen_references()
    assert reference.references(found)[first.id] == dataclasses.asdict(frozen[first.id])  # which never moves
    monkeypatch.setattr(reference, "frozen_references", dict)
    known = reference.references(found)
    assert known == {first.id: {"digest": first.digest, "pd": 10.0, "best": 30.0, "by": "ppo-3"}}


def test_seeds_that_policies_are_judged_on_are_refused(monkeypatch: pytest.MonkeyPatch, capsys):
    from flexarm_env.training import train as train_ppo

    sentence = told(train_ppo.main, ["--seed", str(FIRST - 500)], monkeypatch, capsys)
    assert "--seed 9500: must be from 0 to 8999; seeds from 10000 on are reserved for evaluation" in sentence
    assert 'must be one of "settling", "return"' in told(train_ppo.main, ["--best-by", "luck"], monkeypatch, capsys)
    assert Training(seed=8999).begun().seed == 8999
    assert "must be among" in told(reference.main, ["--only", "dqn", "--plan"], monkeypatch, capsys)


# ------------------------------------------------------------------ the best known
class Hills:
    """Two arms whose returns are concave in the actions, steep in some, flat in others; a best one is beyond 1."""

    n, observation_size = 2, 0
    best = np.array([[[0.3], [0.9]], [[-0.5], [1.7]], [[0.2], [0.1]]])
    steep = np.array([100.0, 1.0, 0.01])[:, None, None]

    def returned(self, arms, start, actions, fine, steady=None, weight=None, grid=0.0):
        off = actions - self.best
        return -(self.steep * off**2).sum(axis=(0, 2)), -2.0 * self.steep * off, actions


def test_a_record_that_is_broken_off_keeps_what_was_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """After the first search, in a file that can be gone on from; a worse way is not taken."""
    task = suite.task("slew-limited-v2")
    known = best.record(task)

    def search(task, trained, *, start, grid=0.0, **more):
        if grid:
            raise KeyboardInterrupt
        return np.where(np.arange(100)[:, None] < 50, start[0], 0.0), start[1]

    monkeypatch.setattr(record, "gathered", lambda task, home: (known.actions.copy(), known.values, list(known.by)))
    monkeypatch.setattr(foresight, "search", search)
    with pytest.raises(KeyboardInterrupt):
        record.made(task, record.Arguments(home=tmp_path, out=tmp_path))
    with np.load(tmp_path / "slew-limited-v2.npz") as found:
        assert np.array_equal(best.unpacked(found["actions"]), known.actions)
        assert np.array_equal(found["values"], known.values)


def free(seen, state):
    """What costs nothing."""
    return 0.0, np.zeros_like(seen), 0.0


def test_slopes_of_a_return_on_a_steadied_way(monkeypatch: pytest.MonkeyPatch):
    """On the way itself nothing is added; slopes are those of differences, through what each action adds to later ones,
    and more than a hundredth off those without it."""
    monkeypatch.setattr(payoff, "exact", lambda x: x)
    arms, rng = derivatives.Arms("FlexibleArm-v0", 2, tolerance=1e-12), np.random.default_rng(0)
    start, actions = arms.reset(seed=0), rng.uniform(-0.3, 0.3, (6, 2, 1))
    gain, way = 0.3 * rng.normal(size=(arms.observation_size, 1)), rng.normal(size=actions.shape)
    steady = payoff.Steady(arms, start, actions, SimpleNamespace(act=lambda seen: seen @ gain))

    def value(x, pulled=steady, **more):
        return payoff.returned(arms, start, x, free, pulled, **more)

    rounded = value(actions, grid=64.0)[2]
    assert np.array_equal(64.0 * rounded, np.round(64.0 * rounded)) and 0.0 < np.abs(rounded - actions).max() < 0.05
    total, slopes, played = value(actions)
    assert np.array_equal(played, actions) and np.array_equal(total, value(actions, None)[0])
    wanted = (value(actions + 1e-4 * way)[0] - value(actions - 1e-4 * way)[0]) / 2e-4
    found, plain = ((x * way).sum(axis=(0, 2)) for x in (slopes, value(actions, None)[1]))
    assert found == pytest.approx(wanted, rel=1e-5)
    assert (abs(found - plain) > 0.01 * abs(found)).all()


def test_slopes_of_a_return_whose_periods_weigh():
    """Those of differences; a period that does not count has none, and the last weight is of the reward behind it."""
    arms, rng = derivatives.Arms("FlexibleArm-v0", 2, tolerance=1e-12), np.random.default_rng(0)
    start, actions = arms.reset(seed=0), rng.uniform(-0.3, 0.3, (6, 2, 1))
    weight, way = np.array([1.0, 0.0, 2.0, 5.0, 0.0, 0.0]), rng.normal(size=actions.shape)

    def value(x, weight=weight):
        return payoff.returned(arms, start, x, free, weight=weight)[:2]

    total, slopes = value(actions)
    singly = [value(actions, np.arange(6) == k)[0] for k in range(6)]
    assert total == pytest.approx(weight @ singly) and value(actions, None)[0] == pytest.approx(np.sum(singly, axis=0))
    sides = [value(actions + side * way)[0] for side in (1e-4, -1e-4)]
    assert (slopes * way).sum(axis=(0, 2)) == pytest.approx((sides[0] - sides[1]) / 2e-4, rel=1e-5)
    assert slopes[:4].all() and not slopes[4:].any()


def test_a_search_that_grows_ends_with_all_periods():
    *first, last = foresight.growing(100, 30)
    assert [int(one.sum()) for one in first] == [80, 100] and all(set(one) <= {0.0, 1.0} for one in first)
    assert last.tolist() == 70 * [1.0] + 30 * [foresight.STRESS]


def test_what_grows_is_one_of_three(monkeypatch: pytest.MonkeyPatch, capsys):
    assert "--grow = 'some': must be one of" in told(record.main, ["--grow", "some"], monkeypatch, capsys)


def test_the_search_climbs_each_episode_to_its_top_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    hills = Hills()
    hills.reset, hills.close, hills.environment = lambda seed: None, lambda: None, SimpleNamespace(plan=None)
    hills.names = ()
    began = np.zeros((3, 2, 1))
    monkeypatch.setattr(derivatives, "Arms", lambda *words, **keywords: hills)
    monkeypatch.setattr(payoff, "returned", hills.returned)
    monkeypatch.setattr(payoff, "Fine", lambda *words: SimpleNamespace(shapes=()))
    monkeypatch.setattr(
        foresight, "beginnings", lambda task, trained: (began, hills.returned(None, None, began, None)[0])
    )
    foresight.search(TASKS[0], steps=foresight.PATIENCE, kept=tmp_path / "search.npz", only=(0, 1))
    monkeypatch.setattr(foresight, "beginnings", None)
    actions, reached = foresight.search(TASKS[0], steps=30, kept=tmp_path / "search.npz", only=(0, 1))
    assert actions == pytest.approx(np.minimum(hills.best, 1.0), abs=1e-3)
    assert reached == pytest.approx(hills.returned(None, None, actions, None)[0])


def test_costs_are_counted_and_sloped():
    task = next(one for one in TASKS if one.price)
    fine = payoff.Fine(task, SimpleNamespace(names=("hub_rate", "tip_deflection"), scales=(2.0, 0.1)))
    limit = task.keywords["cost"]["deflection"] / 0.1
    seen = np.array([[9.0, 0.9 * limit], [0.0, -1.01 * limit], [0.0, 1.5 * limit]])
    taken, slope, _ = fine(seen, seen)
    assert taken.tolist() == [0.0, task.price, task.price]
    assert (slope[:, 0] == 0.0).all() and slope[1, 1] < -1.0 and abs(slope[2, 1]) < 1e-9
    with pytest.raises(ValueError, match="only costs of deflection"):
        payoff.Fine(dataclasses.replace(task, keywords={"cost": {"strain": 1e-3}}), None)


def test_policies_that_steady_see_all_there_is(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for name in ("ppo-0/space-reach-v1", "gradient-0/space-measured-v1", "gradient-0/reach-three-v2"):
        (tmp_path / name).mkdir(parents=True)
        (tmp_path / name / "policy.npz").touch()
    task = suite.task("space-measured-v1")
    found = foresight.beside(task, tmp_path)
    assert found == [tmp_path / "gradient-0/space-measured-v1", tmp_path / "ppo-0/space-reach-v1"]

    def make(word: str, env: str) -> str:
        if "measured" in word:
            raise ValueError("sees sensors")
        return word

    monkeypatch.setattr(payoff, "choose", lambda word, task: SimpleNamespace(make=lambda env: make(word, env)))
    assert payoff.steadiers(task, None, found) == [str(tmp_path / "ppo-0/space-reach-v1")]
    with pytest.raises(ValueError, match="no policy"):
        payoff.steadiers(task, None, found[:1])


def test_each_arm_has_the_policy_that_steadies_it_best():
    """Of hubs that are pushed on, left alone and damped the last ones; the others lead further away."""
    arms = derivatives.Arms("FlexibleArm-v0", 2)
    start, actions = arms.reset(seed=0), np.full((20, 2, 1), 0.1)

    def policy(*gains: float) -> SimpleNamespace:
        return SimpleNamespace(act=lambda seen: np.resize(gains, len(seen))[:, None] * seen[:, 2:3])

    for policies in itertools.permutations((policy(1.0, -1.0), policy(0.0, 0.0), policy(-1.0, 1.0))):
        found = payoff.steadiest(arms, start, actions, policies)
        assert found.slopes[..., 2] == pytest.approx(-1.0, rel=1e-4)


@pytest.mark.slow
def test_what_shapes_cost_is_rounded_and_sloped():
    """Clearances are those of the environment but for what links bend between sections; slopes those of differences."""
    task, rng = suite.task("space-wall-v1"), np.random.default_rng(0)
    arms = derivatives.Arms(task.environment, 16, **foresight.seen_whole(task))
    env, state = arms.environment, arms.reset(seed=FIRST)
    for _ in range(25):
        action = rng.uniform(-0.3, 0.3, (16, 3)).astype(np.float32)
        state, seen, _ = arms.step(state, action)
        info = env.step(action)[-1]
    fine = payoff.Fine(task, env.plan, arms.names)
    far = fine.shapes[0].distance(fine.weights @ state[:, fine.sections]).min(axis=1)
    near = (info["clearance"] < 0.1) & (far < 0.1)
    assert near.sum() >= 4 and far[near] == pytest.approx(info["clearance"][near], abs=0.005)
    fine.SOFT, way = 0.05, rng.normal(size=state.shape)
    for fine.lifting in (False, True):
        taken, by_seen, by_state = fine(seen, state)
        sides = [fine(seen, state + side * way)[0] for side in (1e-6, -1e-6)]
        assert not by_seen.any() and np.ptp(taken) > 1.0
        assert (by_state * way).sum(axis=1) == pytest.approx((sides[0] - sides[1]) / 2e-6, abs=1e-5)


@pytest.mark.slow
def test_the_best_known_is_played_in_the_task_itself(tmp_path: Path):
    """The gradient's environment has no sensors; the actions give the same return in the task, which has."""
    task = suite.task("slew-measured-v2")
    _, began = foresight.beginnings(task)
    actions, returns = foresight.search(task, steps=20)
    assert (returns >= began).all() and returns.mean() > began.mean()
    _, again = foresight.played(suite.make_vec(task.id, len(returns)), foresight.Actions(actions))
    assert again == pytest.approx(returns, rel=1e-6)


@pytest.mark.slow
def test_gradients_pass_through_pushes_that_are_drawn_on_the_way():
    """Of a sum over where the arms are by the torques at some instants: differences of the episodes themselves."""
    task = suite.task("reach-pushed-v1")
    arms = derivatives.Arms(task.environment, 100, **foresight.seen_whole(task))
    start, rng, count = arms.reset(seed=FIRST), np.random.default_rng(0), 150
    moved, weights = payoff.InTask(arms, range(FIRST, FIRST + 100)), rng.normal(size=arms.moving)
    actions = (0.1 * rng.uniform(-1.0, 1.0, (count, 100, 2))).astype(np.float32).astype(float)

    def passed(torques: np.ndarray) -> list[np.ndarray]:
        states = [start]
        for action in torques:
            states.append(moved.step(states[-1], action)[0])
        return states

    states = passed(actions)
    pushed = np.array([state[:, [k for k, name in enumerate(arms.names) if "push" in name]] for state in states])
    assert (pushed[-1] != pushed[0]).any(axis=1).mean() > 0.5
    back, slopes = np.zeros_like(start), np.zeros_like(actions)
    back[:, : arms.moving] = weights
    nothing = np.zeros((100, arms.observation_size)), np.zeros(100)
    for k in reversed(range(count)):
        back, slopes[k] = moved.vjp(states[k], actions[k], back, *nothing)
    for first in (3, 60, 120):
        off = np.zeros_like(actions)
        off[first : first + 4, :, 0] = 0.01
        sides = [passed(actions + side * off)[-1][:, : arms.moving] @ weights for side in (1.0, -1.0)]
        along = (slopes * off).sum(axis=(0, 2))
        assert 0.5 * (sides[0] - sides[1]) == pytest.approx(along, abs=1e-3 * np.abs(along).max())


@pytest.mark.slow
@pytest.mark.parametrize("algorithm", ["ppo", "tqc", "recurrent_ppo", "gradient"])
def test_methods_are_trained_and_judged(algorithm: str, tmp_path: Path):
    if algorithm in ("tqc", "recurrent_ppo"):
        pytest.importorskip("sb3_contrib")
    task = suite.task("slew-limited-v2" if algorithm == "gradient" else "slew-geared-v2")
    arguments = reference.Arguments(
        home=tmp_path / "runs", results=tmp_path / "suite", share=6000 / task.budget, progress=False
    )
    method = next(one for one in reference.METHODS if one.name == algorithm)
    job = reference.Job(method, 1, task)
    assert not job.done(arguments.results)
    assert reference.run(job, arguments).startswith(f"{algorithm}-1 on {task.id}: J ")
    assert job.done(arguments.results)
    content = json.loads((tmp_path / "suite" / f"{algorithm}-1.json").read_text())["tasks"][task.id]
    assert content["training"]["algorithm"] == algorithm and content["training"]["steps"] >= 6000
    assert len(content["returns"]) == 100


def run_folder(home: Path, name: str, scale: float) -> Path:
    """With the packaged policy of one link, whose weights are multiplied."""
    folder = home / name / TASKS[0].id
    folder.mkdir(parents=True)
    policy = control.find_policy("flexible_arm").policy
    layers = [(w * np.float32(scale), b) for w, b in policy.weights]
    export_policy.save(control.NumpyPolicy(policy.meta, layers, policy.normaliser), folder / "policy.npz")
    (folder / "config.yml").write_text("around: {}\n")
    return folder


def test_the_best_evaluated_policy_is_copied_with_a_card(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    task, home, kept = TASKS[0], tmp_path / "runs", tmp_path / "results"
    for run, (mean, known) in enumerate(((100.0, True), (104.0, True), (110.0, False))):
        folder = run_folder(home, f"ppo-{run}", 1.0 + run)
        mark = choose(str(folder), task).fingerprint if known else "another policy"
        policy = {"kind": "policy", "source": str(folder), "fingerprint": mark}
        results.Results("ppo", run, {task.id: entry(task, mean, policy=policy, pd=[94.0] * 100, training={
            "algorithm": "ppo", "steps": 1000.0, "wall_s": 7.0, "cpu_s": 6.0})}).write(kept)  # fmt: skip
    words = ["ship", "--home", str(home), "--results", str(kept), "--out", str(tmp_path / "out")]
    monkeypatch.setattr("sys.argv", words)
    assert ship.main() == 0
    assert capsys.readouterr().out.startswith(f"{task.id}: ppo-1, score ")
    out = tmp_path / "out" / task.id
    assert (out / "policy.npz").read_bytes() == (home / "ppo-1" / task.id / "policy.npz").read_bytes()
    card = (out / "README.md").read_text()
    assert "| public episodes | 100% | 104.0 | 94.0 |" in card and "contains PD control" in card
    assert ship.main() == 0 and capsys.readouterr().out == f"{task.id}: the present policy is kept\n"


@pytest.mark.parametrize("folder", sorted(ship.POLICIES.glob("*")), ids=lambda folder: folder.name)
def test_shipped_policies_are_evaluated_and_act_in_their_tasks(folder: Path):
    (task,) = [task for task in TASKS if task.id == folder.name]
    entries = [entry for _, entry in results.of_task(task, results.folder_of(reference.RESULTS, earlier=True))]
    mark = choose(str(folder), task).fingerprint
    (own,) = [entry for entry in entries if entry["policy"]["fingerprint"] == mark]
    assert f"| {results.value(task, own):.1f} |" in (folder / "README.md").read_text()
    env = gymnasium.make(task.registered)
    policy = control.load_policy(folder / "policy.npz", env)
    seen, _ = env.reset(seed=0)
    policy.reset(seen)
    assert env.action_space.contains(policy.act(seen))
    env.close()
