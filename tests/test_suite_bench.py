"""Judging on the suite: policies of every kind, results files and their page."""

import dataclasses
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from flexarm_env import suite
from flexarm_env.cli import main
from flexarm_env.control.sources import FunctionPolicy, OnnxPolicy
from flexarm_env.plotting.scores import plot_scores
from flexarm_env.suite import policies, results, score
from flexarm_env.suite.judge import judge
from flexarm_env.suite.overview import figure_data
from flexarm_env.suite.page import pages
from tests.cli_tools import answer, refused
from tests.processes import python
from tests.refusals import refuses

FIRST_TASK = suite.tasks()[0]


# ------------------------------------------------------------------ judging
class Counting:
    """A vector environment in which arm i's episode lasts 3 + i % 3 periods, and pays what is done."""

    def __init__(self, n: int, cost: bool = True) -> None:
        self.num_envs, self.cost = n, cost
        self.action_space = SimpleNamespace(shape=(n, 1))
        self.single_observation_space = SimpleNamespace(shape=(2,))
        self.unwrapped = self
        self.ends = 3 + np.arange(n) % 3

    def reset(self, seed: int):
        self.first, self.k = seed, 0
        return self._seen(), {}

    def _seen(self) -> np.ndarray:
        return np.tile(self.first + np.arange(self.num_envs), (2, 1)).T.astype(np.float32)

    def step(self, actions: np.ndarray):
        assert actions.dtype == np.float32 and np.abs(actions).max() <= 1.0
        self.k += 1
        over = self.k == self.ends
        info = {"is_success": np.arange(self.num_envs) % 2 == 0}
        if self.cost:
            info["cost"] = np.full(self.num_envs, 0.5)
        return self._seen(), actions[:, 0].astype(float), over & (np.arange(self.num_envs) == 2), over, info

    def close(self) -> None:
        pass


def test_an_episode_counts_to_its_end_and_no_further():
    env = Counting(4)
    found = judge(env, SimpleNamespace(reset=lambda seen: None, act=lambda seen: np.full((4, 1), 7.0)), first=50)
    assert found.returns == [3.0, 4.0, 5.0, 3.0]  # actions are cut to 1
    assert found.lengths == [3, 4, 5, 3]
    assert found.settled == [1, 0, 0, 0]
    assert found.costs == [1.5, 2.0, 2.5, 1.5]
    assert found.successes == [True, False, False, False]  # the third ended early
    assert env.first == 50
    assert judge(Counting(4, cost=False), SimpleNamespace(reset=print, act=lambda s: s[:, :1] * 0.0)).costs == [0.0] * 4


def test_the_time_to_success_is_that_of_the_one_that_stayed():
    """Of success lost again the last one counts; a failure counts with the whole episode."""
    good = np.array([[0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 1, 0]], bool)
    env = Counting(3, cost=False)
    env.ends = np.full(3, 4)

    def step(actions):
        env.k += 1
        return env._seen(), np.zeros(3), np.zeros(3, bool), env.k == env.ends, {"is_success": good[:, env.k - 1]}

    env.step = step
    assert judge(env, SimpleNamespace(reset=print, act=lambda seen: np.zeros((3, 1)))).settled == [3, 4, 0]
    entry = {"settled": [30, 26, 0, 1]}  # of 125 periods of 0.02 s, after 25 of them within the bounds
    assert results.settling(FIRST_TASK, entry) == pytest.approx(0.02 * (5 + 1 + 125 + 0) / 4)
    assert results.settling(FIRST_TASK, {}) is None


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """A folder with policies of one's own, and tasks that need no compiling."""
    monkeypatch.setattr(results, "make_vec", lambda task_id, n: Counting(n))
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    for name in ("mine", "other", "broken", "exits", "reads"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "def rows(seen):\n    return np.full((len(seen), 1), 0.5)\n"
        "def one(seen):\n    assert seen.shape == (2,)\n    return [0.5]\n"
        "def number(seen):\n    return float(seen.ndim == 1) * 0.5\n"
        "def wide(seen):\n    return np.zeros(3)\n"
        "def lost(seen):\n    return np.full((len(seen), 1), np.nan)\n"
        "def angry(seen):\n    raise RuntimeError('no such luck')\n"
        "class Kept:\n"
        "    def reset(self, seen):\n        self.k = 0\n"
        "    def __call__(self, seen):\n        self.k += 1\n        return np.full((len(seen), 1), self.k == 1)\n"
        "kept = Kept()\n"
        "class Policy:\n"
        "    def reset(self, seen):\n        assert seen.ndim == 2\n        self.total = 0.0\n"
        "    def act(self, seen):\n"
        "        self.total = self.total + 0.125\n        return np.full((len(seen), 1), self.total)\n"
        "policy = Policy()\n"
        "class Needy(Policy):\n    def __init__(self, file):\n        pass\n"
        "def faulty(seen):\n    return undefined @ seen if seen.ndim == 2 else seen[9]\n"
        "def wrong(seen):\n    wrong.k += 1\n    return np.zeros((len(seen), 1) if wrong.k == 1 else (2, 1))\n"
        "wrong.k = 0\n"
        "class Taped:\n"
        "    shape = (100, 1)\n"
        "    def __array__(self, *words, **more):\n        raise RuntimeError('Use tensor.detach()')\n"
        "def taped(seen):\n    return Taped()\n"
        "def imaginary(seen):\n    return np.full((len(seen), 1), 1j)\n"
        "def leaving(seen):\n    raise SystemExit(7)\n"
        "word = 'no function'\n"
    )
    (tmp_path / "broken.py").write_text("raise OSError('not today')\n")
    (tmp_path / "exits.py").write_text("raise SystemExit(3)\n")
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *words: str) -> dict:
    return answer(capsys, "bench", "suite", *words)


@pytest.mark.parametrize(("name", "each"), [("rows", 0.5), ("one", 0.5), ("number", 0.5), ("kept", None)])
def test_functions_of_all_rows_of_one_and_with_a_memory(name: str, each, quick: Path, capsys):
    (found,) = told(capsys, "--policy", f"mine:{name}", "--task", FIRST_TASK.id, "--out", "out")["results"]
    values = found["tasks"][FIRST_TASK.id]
    lengths = 3 + np.arange(100) % 3
    assert values["value"] == pytest.approx(1.0 if each is None else each * lengths.mean())
    content = json.loads((quick / "out" / f"{name}-0.json").read_text())
    entry = content["tasks"][FIRST_TASK.id]
    assert (entry["digest"], entry["first_seed"], entry["episodes"]) == (FIRST_TASK.digest, 10_000, 100)
    assert len(entry["returns"]) == len(entry["successes"]) == len(entry["costs"]) == 100
    assert {"python", "machine", "numpy", "flexarm_env"} <= set(entry["versions"])
    assert entry["wall_s"] > 0.0 and entry["cpu_s"] >= 0.0 and entry["policy"]["kind"] == "function"


@pytest.mark.parametrize("name", ["policy", "Policy"])
def test_an_object_with_reset_and_act_or_its_class_is_a_policy(name: str, quick: Path, capsys):
    """What it remembers counts each period once: 0.125, 0.25, ..., in 3, 4 or 5 periods."""
    tasks = ",".join(task.id for task in suite.tasks()[:2])
    (found,) = told(capsys, "--policy", f"mine:{name}", "--task", tasks, "--out", "out")["results"]
    ends = 3 + np.arange(100) % 3
    expected = (0.125 * ends * (ends + 1) / 2).mean()
    assert [values["value"] for values in found["tasks"].values()] == pytest.approx([expected, expected])


def test_a_function_is_begun_anew_after_it_was_tried_with_all_rows():
    seen, begun = [], []

    def act(row):
        seen.append(row.shape)
        return row[:1] if row.ndim == 1 else [1.0, 2.0]

    act.reset = lambda rows: begun.append(len(seen))
    policy = FunctionPolicy("a:b", act).fitted(Counting(2))
    rows = np.ones((2, 2), np.float32)
    policy.reset(rows)
    assert policy.act(rows).shape == policy.act(rows).shape == (2, 1)
    assert seen == [(2, 2)] + 4 * [(2,)] and begun == [0, 1]


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("mine:wide", "must give (n, 1) for n observations, or (1,) for one"),
        ("mine:lost", "--policy mine:lost: action = [nan]: must be finite numbers"),
        ("mine:angry", "it raised RuntimeError: no such luck"),
        ("mine:taped", "Use tensor.detach()"),
        ("mine:imaginary", "must be numbers of shape (100, 1)"),
        ("mine:faulty", "at once it raised NameError: name 'undefined' is not defined; of one alone it raised Ind"),
        ("mine:leaving", "it raised SystemExit: 7"),
        ("mine:Needy", "cannot be made without arguments (TypeError"),
        ("mine:word", "must name a function of observations"),
        ("mine:none", "cannot be imported (AttributeError"),
        ("broken:act", "cannot be imported (OSError: not today)"),
        ("exits:act", "cannot be imported (SystemExit: 3)"),
        ("nowhere:act", "cannot be imported (ModuleNotFoundError"),
        ("nobody", "must be a run folder, a file (.npz, .zip, .onnx) that exists, module:name"),
        ("nobody.onnx", "must be a run folder, a file"),
        ("damaged.npz", "damaged, or no policy of this package"),
    ],
)
def test_what_cannot_be_judged_is_told_in_a_sentence(word: str, sentence: str, quick: Path, capsys):
    (quick / "damaged.npz").write_bytes(b"torn")
    assert sentence in refused(capsys, "bench", "suite", "--policy", word, "--task", FIRST_TASK.id, "--out", "out")
    assert not list(quick.glob("out/*"))


def test_wrong_flags_are_told_in_a_sentence(quick: Path, capsys):
    assert "must be one of" in refused(capsys, "bench", "suite", "--task", "slew")
    for flag, words in (("--policy", ""), ("--policy", " ,"), ("--task", "")):
        assert f"{flag} = '{words}': must name at least one" in refused(capsys, "bench", "suite", flag, words)
    assert "from 1 to 100000" in refused(capsys, "bench", "suite", "--episodes", "0")
    assert "requires a single policy" in refused(capsys, "bench", "suite", "--policy", "pd,zv", "--name", "both")
    assert "must be letters" in refused(capsys, "bench", "suite", "--policy", "mine:one", "--name", "../up")
    assert "no results files" in refused(capsys, "bench", "page", "nothing")
    assert "must end in .md" in refused(capsys, "bench", "page", ".", "--out", "page.html")


def test_of_two_policies_that_are_refused_each_is_named(quick: Path, capsys):
    words = ("--policy", "mine:lost,mine:wrong", "--task", f"{FIRST_TASK.id},{FIRST_TASK.id}", "--out", "out")
    sentence = refused(capsys, "bench", "suite", *words)
    assert sentence == (
        f"flexarm bench: {FIRST_TASK.id}: --policy mine:lost: action = [nan]: must be finite numbers; "
        f"{FIRST_TASK.id}: --policy mine:wrong: action's shape = (2, 1): must be (100, 1): one row per observation\n"
    )


@pytest.mark.parametrize(("kind", "word"), [("FLOAT16", "float16"), ("INT64", "int64")])
def test_a_model_of_another_type_is_refused_when_it_is_opened(kind: str, word: str, tmp_path: Path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    of = getattr(onnx.TensorProto, kind)
    ends = [onnx.helper.make_tensor_value_info(name, of, ["n", 2]) for name in ("seen", "action")]
    node = onnx.helper.make_node("Identity", ["seen"], ["action"])
    model = onnx.helper.make_model(
        onnx.helper.make_graph([node], "g", ends[:1], ends[1:]), opset_imports=[onnx.helper.make_opsetid("", 17)]
    )
    model.ir_version = 8
    path = tmp_path / "half.onnx"
    path.write_bytes(model.SerializeToString())
    with pytest.raises(ValueError, match=rf"half\.onnx: takes tensor\({word}\); a policy takes tensor\(float\) or"):
        OnnxPolicy(path)


def test_what_has_been_judged_is_kept_and_what_has_changed_is_not(quick: Path, capsys, monkeypatch):
    made = []
    policy = SimpleNamespace(reset=len, act=lambda seen: np.full((len(seen), 1), 0.5))
    monkeypatch.setattr(policies, "controller", lambda name, env: made.append(name) or policy)
    words = ("--policy", "pd", "--task", FIRST_TASK.id, "--out", "out")
    assert told(capsys, *words)["results"][0]["tasks"][FIRST_TASK.id]["note"] == ""
    first = json.loads(Path("out/pd-0.json").read_text())["tasks"][FIRST_TASK.id]
    kept = told(capsys, *words)["results"][0]["tasks"][FIRST_TASK.id]
    assert kept["note"] == f"kept from {first['date']}; --again repeats it"
    assert made == ["pd"] * 4  # on both hundreds, PD beside it
    both = [task.id for task in suite.tasks()[:2]]
    found = told(capsys, "--policy", "pd", "--task", ",".join(both), "--out", "out")["results"][0]["tasks"]
    assert list(found) == both and made == ["pd"] * 8
    assert told(capsys, *words, "--again")["results"][0]["tasks"][FIRST_TASK.id]["note"] == "" and made == ["pd"] * 12
    monkeypatch.setattr(policies.metadata, "version", lambda name: "9.9")
    assert told(capsys, *words)["results"][0]["tasks"][FIRST_TASK.id]["note"] == "" and made == ["pd"] * 16


def test_further_episodes_are_added_to_what_has_been_judged(quick: Path, capsys, monkeypatch):
    """In lots, and none twice; J and the score stay those of the hundred."""
    made = []
    policy = SimpleNamespace(reset=len, act=lambda seen: np.full((len(seen), 1), 0.5))
    monkeypatch.setattr(policies, "controller", lambda name, env: made.append(env.num_envs) or policy)
    monkeypatch.setattr(results, "LOT", 40)
    words = ("--policy", "pd", "--task", FIRST_TASK.id, "--out", "out")

    def entry(*more: str) -> dict:
        told(capsys, *words, *more)
        return results.read(Path("out/pd-0.json")).tasks[FIRST_TASK.id]

    first = entry()
    assert first["further"] is None and results.length(first) == 100 and made == [100] * 4
    more = entry("--episodes", "150")
    lot = [0.5 * (3 + i % 3) for i in range(40)]
    assert made[4:] == [40, 10] and more == first | {"further": lot + lot[:10]}
    assert entry("--episodes", "120") == more == entry() and len(made) == 6
    assert entry("--episodes", "151")["further"] == more["further"] + lot[:1] and made[6:] == [1]
    again = entry("--again")
    assert made[7:] == [100] * 4 + [40, 11] and again["further"] == lot + lot[:11]
    assert results.summary(FIRST_TASK, again)["value"] == results.summary(FIRST_TASK, first)["value"]


def test_a_function_whose_text_is_the_same_is_judged_anew(quick: Path, capsys):
    """What it reads may have changed, and what it imports."""
    (quick / "reads.py").write_text(
        "import numpy as np\ndef act(seen):\n    return np.load('w.npy') + 0 * seen[:, :1]\n"
    )
    for number in (0.5, 0.25):
        np.save("w.npy", number)
        (found,) = told(capsys, "--policy", "reads:act", "--task", FIRST_TASK.id, "--out", "out")["results"]
        assert found["tasks"][FIRST_TASK.id]["value"] == pytest.approx(number * (3 + np.arange(100) % 3).mean())


def test_a_models_weights_may_lie_beside_it(tmp_path: Path):
    model = tmp_path / "m.onnx"
    model.write_bytes(b"graph")
    alone = policies.choose(str(model), FIRST_TASK).fingerprint
    (tmp_path / "m.onnx.data").write_bytes(b"weights")
    assert policies.choose(str(model), FIRST_TASK).fingerprint != alone


def test_a_look_replaces_no_result_on_all_episodes(quick: Path, capsys):
    words = ("--policy", "mine:rows", "--task", FIRST_TASK.id, "--out", "out")
    entry = told(capsys, *words, "--episodes", "2")["results"][0]["tasks"][FIRST_TASK.id]
    assert entry["note"] == "" and results.read(Path("out/rows-0.json")).tasks[FIRST_TASK.id]["episodes"] == 2
    told(capsys, *words)
    whole = Path("out/rows-0.json").read_bytes()
    (quick / "mine.py").write_text((quick / "mine.py").read_text().replace("0.5", "0.25"))
    del sys.modules["mine"]
    entry = told(capsys, *words, "--episodes", "2")["results"][0]["tasks"][FIRST_TASK.id]
    assert entry["value"] == 0.25 * 3.5 and entry["score"] is None
    assert entry["note"] == "a look; out/rows-0.json keeps its result on 100 episodes"
    assert Path("out/rows-0.json").read_bytes() == whole
    assert main(["bench", "suite", *words, "--episodes", "2"]) == 0
    assert "no score, success 50%, cost 1.75 (a look; out/rows-0.json keeps" in capsys.readouterr().out


def test_a_result_of_before_is_not_shown_as_that_of_a_policy_that_fails(quick: Path, capsys):
    words = ("--policy", "mine:rows", "--task", FIRST_TASK.id, "--out", "out")
    told(capsys, *words)
    (quick / "mine.py").write_text("def rows(seen):\n    return 'nothing'\n")
    del sys.modules["mine"]
    assert FIRST_TASK.id in refused(capsys, "bench", "suite", *words)
    assert results.read(Path("out/rows-0.json")).tasks[FIRST_TASK.id]["episodes"] == 100


def test_two_policies_of_one_name_are_not_taken_for_one(quick: Path, capsys):
    first, second = (task.id for task in suite.tasks()[:2])
    (quick / "other.py").write_text("def rows(seen):\n    return seen[:, :1] * 0.0\n")
    told(capsys, "--policy", "mine:rows", "--task", first, "--out", "out")
    sentence = refused(capsys, "bench", "suite", "--policy", "other:rows", "--task", second, "--out", "out")
    assert "other:rows: out/rows-0.json has results of mine:rows; give one of them another --name" in sentence
    assert list(results.read(Path("out/rows-0.json")).tasks) == [first]
    words = ("--task", second, "--out", "out", "--name")
    assert told(capsys, "--policy", "other:rows", *words, "others")["results"][0]["file"] == "out/others-0.json"
    told(capsys, "--policy", "other:rows", *words, "rows")  # as one wishes
    assert list(results.read(Path("out/rows-0.json")).tasks) == [first, second]


def test_one_policy_a_task_is_one_method(quick: Path, capsys):
    first, second = (task.id for task in suite.tasks()[:2])
    for task in (first, second):
        (quick / task).mkdir()
        (quick / task / "net.onnx").write_bytes(task.encode())
    policy = SimpleNamespace(reset=len, act=lambda seen: np.zeros((len(seen), 1)))

    def chosen(word, task):
        return dataclasses.replace(policies.choose(word, task), make=lambda env: policy)

    def judged(word, *wanted):
        return results.judged(word, [suite.task(one) for one in wanted], Path("out"), choose=chosen)

    assert judged("{task}/net.onnx", first, second)[1] == judged("./{task}/net.onnx", second)[1] == []
    (sentence,) = judged(f"{first}/net.onnx", second)[1]
    assert f"has results of {second}/net.onnx" in sentence


def test_each_task_may_have_a_policy_of_its_own():
    task = SimpleNamespace(id="slew-measured-v2")
    refuses("runs/slew-measured-v2/policy", lambda: policies.choose("runs/{task}/policy", task))
    assert policies.default_name("runs/{task}-ppo/policy.npz") == "ppo"
    assert policies.default_name("mine:act") == "act"
    assert policies.default_name("a/b.onnx") == "b"


# ------------------------------------------------------------------ files and pages
def entry_of(task: suite.Task, mean: float, **changes) -> dict:
    """As a results file has it, of a trained policy that succeeds in all episodes."""
    return {
        "digest": task.digest, "first_seed": 10_000, "episodes": 100, "returns": [mean] * 100,
        "successes": [True] * 100, "costs": [0.0] * 100, "lengths": [4] * 100, "wall_s": 1.0, "cpu_s": 1.0,
        "decision_us": 2.0, "policy": {"kind": "policy", "source": "", "fingerprint": "x"}, "versions": {"numpy": "2"},
        "training": {"algorithm": "ppo", "steps": 1000.0, "wall_s": 7200.0, "cpu_s": 3600.0}, "date": "2026-01-01",
    } | changes  # fmt: skip


def written(folder: Path, name: str, run: int, mean: float, **changes) -> Path:
    return results.Results(name, run, {FIRST_TASK.id: entry_of(FIRST_TASK, mean, **changes)}).write(folder)


def test_the_page_is_made_of_all_files_in_a_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys):
    known = {FIRST_TASK.id: score.Reference(FIRST_TASK.digest, 50.0, 150.0, "best")}
    monkeypatch.setattr(score, "references", lambda: known)
    for run, mean in enumerate((100.0, 120.0, 140.0)):
        written(tmp_path, "ppo", run, mean)
    written(tmp_path, "pd", 0, 50.0, training=None)
    written(
        tmp_path, "short", 0, 1e6, episodes=3, **{key: [1] * 3 for key in ("returns", "successes", "costs", "lengths")}
    )
    refused = dict.fromkeys((FIRST_TASK.id, "swing-up-v1"), "needs what is not seen, which is not among a, b")
    results.Results("zv", refused=refused).write(tmp_path)
    assert main(["bench", "page", str(tmp_path), "--out", str(tmp_path / "page.md")]) == 0
    texts = {name: (tmp_path / f"page{name}.md").read_text() for name in ("", "-tasks", "-missing")}
    first, text = texts[""], texts["-tasks"]
    assert "| ppo | 3 | 0.70 [0.50, 0.90] | 0.70 |" in text
    assert "| pd | 1 | 0.00 | 0.00 |" in text
    assert "| *range of scores* |  |  | 0.70 |" in text and "| *1 - highest score* |  |  | 0.30 |" in text
    assert "| 0% | 3600 |" in text  # of the budget
    assert "4.00 CPU hours of training" in first
    assert f"- short-0.json: {FIRST_TASK.id}" in texts["-missing"]
    assert f"- zv on `{FIRST_TASK.id}`, `swing-up-v1`: needs what is not seen\n" in texts["-missing"]
    # ppo is below its budget of training
    finding = (
        "Trained policies have the highest score on 0 of 1 tasks, controllers on 1. The highest score of a task is"
    )
    assert first.startswith(f"# Results on the suite\n\n{finding} 0.00 (`{FIRST_TASK.id}`) to 0.00,")
    assert "| pd **0.00** (100%) | *0.70* (100%) |" in first
    data = figure_data(results.folder_of(tmp_path))
    assert data == ([f"{FIRST_TASK.id}  1"], {"best controller": [0.0], "PPO": [pytest.approx(0.7)]})
    plot_scores(*data, tmp_path / "scores.png")
    assert (tmp_path / "scores.png").read_bytes()[:4] == b"\x89PNG"
    assert pages(results.folder_of(tmp_path), "page") == {f"page{name}.md": text for name, text in texts.items()}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"returns": [1.0]}, "must be a sequence of numbers"),
        ({"returns": ["1"] * 100}, "returns[0] = '1': must be a finite number"),
        (
            {"returns": [1.0, 150.1] + [1.0] * 98},
            "returns[1] = 150.1: must be a finite number, at least -131.25 and at most 150",
        ),
        ({"returns": [-131.5] * 100}, "returns[0] = -131.5: must be"),
        ({"successes": [5.0] * 100}, "successes[0] = 5.0: must be true or false"),
        ({"costs": [float("nan")] * 100}, "costs[0] = nan: must be"),
        ({"costs": [-1e9] * 100}, "costs[0] = -1000000000.0: must be"),
        ({"lengths": [-3.5] * 100}, "lengths[0] = -3.5: must be a whole number, from 1 to 125"),
        ({"settled": [5] * 100}, "settled[0] = 5: must be a whole number, from 0 to 4"),
        ({"settled": [3, 0] * 50}, "settled[1] = 0: must be 0 for failed episodes only"),
        ({"lengths": [126] * 100}, "lengths[0] = 126: must be a whole number, from 1 to 125"),
        ({"further": [0.0, float("nan")]}, "further[1] = nan: must be a finite number"),
        ({"further": [150.1]}, "further[0] = 150.1: must be a finite number, at most 150"),
        ({"digest": "0" * 16}, f"digest = '0000000000000000': must be {FIRST_TASK.digest}"),
        ({"episodes": -1}, "must be a whole number"),
        ({"wall_s": "long"}, "wall_s = 'long'"),
        ({"policy": 3}, "must be a table"),
        ({"policy": {"fingerprint": "a", "source": 3}}, "policy.source = 3: must be a text"),
        ({"versions": 3}, "versions = 3: must be a table"),
        ({"versions": {"numpy": 2}}, "versions.numpy = 2: must be a text"),
        ({"training": {"steps": 1}}, "training.wall_s"),
    ],
)
def test_damaged_results_are_told_in_a_sentence(changes: dict, sentence: str, tmp_path: Path, capsys):
    path = written(tmp_path, "ppo", 0, 1.0, **changes)
    told_ = refused(capsys, "bench", "page", str(tmp_path))
    assert sentence in told_ and path.name in told_
    refusal = '{"format": 1, "name": "ppo", "run": 0, "tasks": {}, "refused": {"a": []}}'
    for text in ("{", "[]", "{}", '{"format": 9, "name": "a", "run": 0, "tasks": {}}', refusal):
        path.write_text(text)
        assert path.name in refused(capsys, "bench", "page", str(tmp_path))


def test_the_list_of_tasks(capsys: pytest.CaptureFixture[str]):
    listed = told(capsys, "--list")
    assert [entry["id"] for entry in listed["tasks"]] == [task.id for task in suite.tasks()]
    keys = {"id", "env_id", "title", "environment", "budget", "price", "digest", "pd", "best"}
    assert keys == set(listed["tasks"][0])
    python("-c", f"import gymnasium; gymnasium.make({listed['tasks'][0]['env_id']!r})")  # nothing else imported
    assert main(["bench", "suite", "--list"]) == 0
    assert f'gymnasium.make("{listed["tasks"][0]["env_id"]}")' in capsys.readouterr().out


def test_a_task_that_is_not_what_it_was_is_refused():
    refuses("the task has changed", lambda: results.frozen(dataclasses.replace(FIRST_TASK, digest="0" * 16)))


# ------------------------------------------------------------------ with the real thing
@pytest.mark.slow
def test_controllers_files_and_models_on_a_real_task(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    """A policy.npz, the same as ONNX and as a function give the same returns; PD those of single environments."""
    pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from flexarm_env.control import NumpyPolicy, Setup, make
    from flexarm_env.control.export import onnx_bytes
    from flexarm_env.training.export_policy import save

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    env = suite.make(FIRST_TASK.id)
    setup, rng = Setup.of(env), np.random.default_rng(0)
    weights = [(rng.normal(size=(setup.size, 1)).astype(np.float32) * 0.1, np.zeros(1, np.float32))]
    meta = {
        "format": 1, "env_id": FIRST_TASK.registered, "env_kwargs": {}, "layout": setup.layout, "layers": 1, "seed": 4,
        "activation": "tanh", "squash": False,
    }  # fmt: skip
    save(NumpyPolicy(meta, weights), tmp_path / "linear.npz")
    (tmp_path / "linear.onnx").write_bytes(onnx_bytes(NumpyPolicy(meta, weights)))
    (tmp_path / "own.py").write_text(
        "from flexarm_env.control import load_policy\ndef act(seen):\n    return load_policy('linear.npz').act(seen)\n"
    )
    words = ("--policy", "linear.npz,linear.onnx,own:act,pd", "--task", FIRST_TASK.id, "--episodes", "4", "--out", "o")
    found = {one["policy"]: one for one in told(capsys, *words)["results"]}
    returns = {name: one["tasks"][FIRST_TASK.id]["value"] for name, one in found.items()}
    assert found["linear"]["run"] == 0 and (tmp_path / "o" / "linear-4.json").exists()
    assert returns["act"] == pytest.approx(returns["linear"], abs=1e-3)
    totals = []
    controller = make("pd", env)
    for seed in range(10_000, 10_004):
        observation, _ = env.reset(seed=seed)
        controller.reset(observation)
        total, over = 0.0, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(controller.act(observation))
            total, over = total + reward, terminated or truncated
        totals.append(total)
    assert json.loads((tmp_path / "o" / "pd-0.json").read_text())["tasks"][FIRST_TASK.id]["returns"] == totals
    for name, sentence in (("flexible_arm", "observation layout"), ("two_link", "this environment's is 'torque'")):
        assert sentence in refused(capsys, "bench", "suite", "--policy", name, "--task", FIRST_TASK.id)


@pytest.mark.slow
def test_cleanrl_style_ppo_learns_and_is_judged(tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch):
    """One file with PyTorch and the vector environment alone; its function is judged as anybody's."""
    pytest.importorskip("torch")
    from agents import cleanrl_ppo

    agent = tmp_path / "agent.pt"
    words = ["--env-id", FIRST_TASK.env_id, "--out", str(agent), "--total-timesteps", "98304"]
    curve = cleanrl_ppo.train(cleanrl_ppo.arguments(words))
    assert np.mean(curve[-2:]) > np.mean(curve[:2]) + 5.0
    capsys.readouterr()
    monkeypatch.setenv("AGENT", str(agent))
    words = ["--policy", "agents.cleanrl_ppo:act", "--task", FIRST_TASK.id, "--episodes", "5", "--out", str(tmp_path)]
    (found,) = told(capsys, *words)["results"]
    assert found["policy"] == "act" and np.isfinite(found["tasks"][FIRST_TASK.id]["value"])
