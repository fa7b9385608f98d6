"""Policies for other machines: what C and ONNX decide beside NumPy."""

import ctypes
import dataclasses
import itertools
import json
import re
import shlex
from contextlib import closing
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import arms
from flexarm_env.control import NumpyPolicy, load_policy, make
from flexarm_env.control.export import Entries, c_comment, c_name, c_named, c_source, harmless, onnx_bytes
from flexarm_env.control.in_c import controller_source
from tests.c_tools import needs_compiler, shared
from tests.cli_tools import answer, refused

CLOSE = 1e-6
N = 10_000


def drawn(activation: str, squash: bool, normalised: bool, widths=(10, 24, 17, 2), history: int = 2) -> NumpyPolicy:
    """A policy of random numbers, its entries far from zero where they are normalised."""
    rng = np.random.default_rng(len(activation) + 2 * squash + normalised)
    weights = [
        ((rng.normal(size=(a, b)) * 1.5 / np.sqrt(a)).astype(np.float32), rng.normal(size=b).astype(np.float32) * 0.2)
        for a, b in itertools.pairwise(widths)
    ]
    names = {f"entry_{k}": 0.3 + 0.17 * k for k in range(widths[0] // history)}
    meta = {
        "format": 1, "env_id": "Arm */ /* \\\n-v0", "env_kwargs": {}, "layout": "x", "layers": 3, "scales": names,
        "torque_limits": [1.5, 0.5], "activation": activation, "squash": squash,
    }  # fmt: skip
    size = widths[0]
    statistics = {
        "mean": rng.normal(size=size) * 2.0, "variance": 10.0 ** rng.uniform(-4.0, 0.5, size), "clip": np.float64(5.0),
        "epsilon": np.float64(1e-8),
    }  # fmt: skip
    return NumpyPolicy(meta, weights, statistics if normalised else None)


POLICIES = {
    "tanh": drawn("tanh", False, False), "relu": drawn("relu", False, True), "squashed": drawn("relu", True, False),
    "normal": drawn("tanh", True, True), "one_layer": drawn("relu", False, False, (4, 1), 1),
}  # fmt: skip


def observations(policy: NumpyPolicy) -> np.ndarray:
    """Near what a normaliser knows, and out to the clip of the environment."""
    rng = np.random.default_rng(7)
    size = policy.weights[0][0].shape[0]
    wide = np.where(np.arange(N) % 2 == 0, 1.0, 10.0)[:, None] * rng.uniform(-1.0, 1.0, (N, size))
    if policy.normaliser is not None:
        wide = policy.normaliser["mean"] + np.sqrt(policy.normaliser["variance"]) * wide
    return wide.astype(np.float32)


def by_c(function, rows: np.ndarray, actions: int, *before) -> np.ndarray:
    """What a function of the file makes of each row in turn."""
    rows, out = np.ascontiguousarray(rows, np.float32), np.zeros((len(rows), actions), np.float32)
    function.restype = None
    here, there = rows.ctypes.data, out.ctypes.data
    for k in range(len(rows)):
        at, to = ctypes.c_void_p(here + 4 * rows.shape[1] * k), ctypes.c_void_p(there + 4 * actions * k)
        function(*before, at, to)
    return out


def source_of(policy: NumpyPolicy, name: str = "policy") -> str:
    entries = Entries.of(policy)
    assert entries is not None
    return c_source(policy, entries, name)


@needs_compiler
@pytest.mark.parametrize("flags", [("-O0", "-std=c99"), ("-O3", "-march=native")], ids=["plain", "fused"])
@pytest.mark.parametrize("name", POLICIES)
def test_c_decides_as_numpy_does(name: str, flags: tuple[str, ...], tmp_path: Path):
    policy = POLICIES[name]
    seen = observations(policy)
    wanted = policy.act(seen)
    assert (np.abs(wanted) < 0.99).mean() > 0.2  # not all of them at the limit
    found = by_c(shared(tmp_path, source_of(policy), *flags).policy_decide, seen, wanted.shape[1])
    assert np.abs(found - wanted).max() <= CLOSE


@needs_compiler
def test_c_scales_clips_and_remembers_what_is_measured(tmp_path: Path):
    policy = POLICIES["tanh"]
    library = shared(tmp_path, source_of(policy))
    scales = np.array(list(policy.meta["scales"].values()), np.float32)
    rng = np.random.default_rng(3)
    measured = (rng.normal(size=(200, 5)) * 6.0).astype(np.float32)
    now = np.clip(measured / scales, np.float32(-10.0), np.float32(10.0))
    memory = ctypes.create_string_buffer(4 * 10 + 4)
    for first in (0, 100):  # two episodes
        library.policy_reset(memory)
        here = now[first : first + 100]
        before = np.vstack([here[:1], here[:-1]])
        found = by_c(library.policy_act, measured[first : first + 100], 2, memory)
        assert np.abs(found - policy.act(np.hstack([before, here]))).max() <= CLOSE


@needs_compiler
def test_c_forgets_a_reading_that_is_not_finite(tmp_path: Path):
    """A NaN stayed in the history: actions were NaN for as many periods. A controller's file gives 0 and forgets it."""
    policy = POLICIES["tanh"]
    library = shared(tmp_path, source_of(policy))
    measured = np.random.default_rng(3).normal(size=(20, 5)).astype(np.float32)
    memory = ctypes.create_string_buffer(4 * 10 + 4)
    library.policy_reset(memory)
    wanted = by_c(library.policy_act, measured, 2, memory)
    for k, bad in ((0, np.nan), (7, np.nan), (12, np.inf), (20, -np.inf)):
        wrong = np.insert(measured, k, measured[0], axis=0)
        wrong[k, 2] = bad
        library.policy_reset(memory)
        found = by_c(library.policy_act, wrong, 2, memory)
        assert not found[k].any() and np.array_equal(np.delete(found, k, axis=0), wanted)


@needs_compiler
@pytest.mark.parametrize("name", POLICIES)
def test_c_decides_as_numpy_does_of_numbers_without_measure(name: str, tmp_path: Path):
    """One entry of 1e36, or infinite, made NaN of the float32 that a product is cut in two by."""
    policy = POLICIES[name]
    seen, joints = observations(policy)[:40], policy.weights[-1][0].shape[1]
    decide = shared(tmp_path, source_of(policy)).policy_decide
    for k, value in enumerate((1e9, -1e12, 1e30, 1e36, -3e38, np.inf, -np.inf)):
        rows = seen.copy()
        rows[np.arange(40), (np.arange(40) + k) % seen.shape[1]] = value
        found = by_c(decide, rows, joints)
        with np.errstate(invalid="ignore"):  # rectified infinities of either sign, added, are NaN in Python too
            wanted = policy.act(rows)
        good = np.isfinite(wanted)
        assert np.isfinite(found).all() and (good.all() or np.isinf(value))
        assert (np.abs(found - wanted)[good] <= CLOSE).all(), value
    rows[:, 1] = np.nan
    assert not by_c(decide, rows, joints).any()


@needs_compiler
def test_no_name_writes_code(tmp_path: Path):
    """`name = "x */ int pwned(void){return 1;} /*"` of an arm was a function of the controller's file."""
    rng = np.random.default_rng(1)
    words = ("*/", "/*", "*", "/", "??/", "?", "\\", "\n", "\r", "\0", "x", '"', "é", "//", " ")
    names = ["x */ int pwned(void){return 1;} /*", "*??/\n/ int pwned(void){return 1;} /*", "*\\\n/ int pwned(void);"]
    names += ["".join(rng.choice(words, 12)) for _ in range(200)]
    lines = [harmless(name) for name in names]
    for line in lines:
        assert not re.search(r"\*/|/\*|\\|\?\?|[^ -~]", line), line
    # in one comment, each at the end of its line, under a compiler that knows trigraphs and treats warnings as errors
    text = f"{c_comment(names)}\nint one(void);\nint one(void) {{ return 1; }}\n"
    library = shared(tmp_path, text, "-std=c99", "-Wcomment", "-Wtrigraphs")
    assert library.one() == 1 and not hasattr(library, "pwned")
    arm = dataclasses.replace(arms.named("strip"), name=names[0])
    with closing(gym.make("FlexibleArm-v0", arm=arm)) as env:
        text = controller_source(make("pd", env), "pd")
    assert "for the arm x * / int pwned(void){return 1;} / *\n" in text
    (tmp_path / "pd").mkdir()
    assert not hasattr(shared(tmp_path / "pd", text), "pwned")
    for name in ("x */", "a b", "", "1a", "a\n", "é", 5):
        with pytest.raises(ValueError, match="must be a C identifier"):
            c_named("NAME", name)  # type: ignore[arg-type]


@needs_compiler
@pytest.mark.parametrize("name", [pytest.param("two_link", marks=pytest.mark.slow), "flexible_arm"])
def test_packaged_policies_in_c_decide_as_numpy_does(name: str, tmp_path: Path, capsys):
    found = answer(capsys, "export", name, "--to", "c", "--out", str(tmp_path / "policy.c"))
    assert found["function"] == "policy_decide"
    source = (tmp_path / "policy.c").read_text()
    assert not re.search(r"\b(malloc|double|main)\b", source)
    policy = load_policy(name)
    joints = policy.weights[-1][0].shape[1]
    seen = observations(policy)
    wanted = policy.act(seen)
    assert np.abs(by_c(shared(tmp_path, source, "-O2").policy_decide, seen, joints) - wanted).max() <= CLOSE


@pytest.mark.parametrize("name", POLICIES)
def test_onnx_decides_as_numpy_does(name: str):
    pytest.importorskip("onnx")
    runtime = pytest.importorskip("onnxruntime")
    policy = POLICIES[name]
    seen = observations(policy)
    session = runtime.InferenceSession(onnx_bytes(policy))
    (found,) = session.run(["action"], {"observation": seen})
    assert found.dtype == np.float32
    assert np.abs(found - policy.act(seen)).max() <= CLOSE
    assert json.loads(session.get_modelmeta().custom_metadata_map["flexarm_env"])["layout"] == "x"


def test_an_action_does_not_depend_on_how_many_are_asked_for():
    policy = load_policy("two_link")
    seen = observations(policy)[:500]
    assert np.abs(np.array([policy.act(one) for one in seen]) - policy.act(seen)).max() <= 1e-7


PD, ZV = "pd --env FlexibleArm-v0 --to", "zv --env TwoLinkFlexArm-v0 --to"


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("two_link --to onnx --out policy.c", "must end in .onnx"),
        ("nobody --to c --out policy.c", "must be a run folder"),
        ("two_link --to ada --out policy.c", "invalid choice"),
        ("two_link --to c --env X --out policy.c", "must not be given"),
        ("two_link --to c --out policy.c --cpu native", "requires --to library or fmu"),
        ("lqr --to c --out lqr.c", "--env"),
        ("lqr --env FlexibleArm-v0 --to onnx --out lqr.onnx", "must be c"),
        ("time_optimal --env FlexibleArm-v0 --to c --out time.c", "--slew: missing; time_optimal plans slews"),
        (f"{ZV} c --out zv.c --elbows 1", "--elbows = '1'"),
        (f"{ZV} c --out zv.c --elbows 0:x", "must be LOW:HIGH"),
        (f"{ZV} c --out zv.c --elbows 0:1,0:1", "sequence of 1 p"),
        (f"{PD} library --out pd", "must be c or fmu for a controller"),
        (f"{PD} fmu --out pd.c", "must end in .fmu"),
        (f"{PD} fmu --out pd.fmu --name 1", "must be a C identifier"),
        ("mpc --env FlexibleArm-v0 --to fmu --out mpc.fmu", "must be pd"),
        ("strip --to fmu --out strip.zip", "must end in .fmu"),
        ("nobody --to library --out x", "nobody"),
        ("strip --to library --out ''", "--out = '': must be a path"),
        ("strip --to library --out x --env-kwargs {", "must be JSON"),
        *((f"strip --to library --out x --name '{name}'", "must be a C identifier")
          for name in ("1x", "", "a b", "x" * 61, "../x", "a\nb")),
    ],
)  # fmt: skip
def test_what_cannot_be_exported_is_refused_in_a_sentence(
    words: str, sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(tmp_path)
    assert sentence in refused(capsys, "export", *shlex.split(words))
    assert not list(tmp_path.iterdir())


def test_what_c_has_no_words_for():
    policy = POLICIES["tanh"]
    with pytest.raises(ValueError, match="must be a divisor of 10"):
        c_source(policy, dataclasses.replace(Entries.of(policy), names=("a",) * 3, scales=(1.0,) * 3), "policy")
    assert c_name("2-link arm") == "_2_link_arm"
