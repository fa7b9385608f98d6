"""Controllers as C: the numbers of the Python classes, over whole episodes."""

import ctypes
import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.cli import main
from flexarm_env.control.in_c import controller_source
from flexarm_env.control.space import AboutRest
from tests.c_tools import needs_compiler, shared
from tests.refusals import refuses

CLOSE = 1e-6
NOISY: dict[str, Any] = {
    "observation": "measured", "history": 2,
    "sensors": {"encoders": {"counts": 2000}, "strain_gauges": [{"noise": 0.0029, "bias": 0.0057}]},
}  # fmt: skip
IN_SPACE: dict[str, Any] = {
    "observation": "measured",
    "sensors": {"encoders": {"counts": 2**16}, "strain_gauges": [(1, 0.0), {"link": 2, "measures": "xz"}]},
}
CASES: list[Any] = [
    ("pd", "FlexibleArm-v0", {}),
    ("zv", "FlexibleArm-v0", {}),
    ("zvd", "FlexibleArm-v0", {}),
    ("lqr", "FlexibleArm-v0", {}),
    ("time_optimal", "FlexibleArm-v0", {}),
    ("lqg", "FlexibleArm-v0", NOISY),
    ("lqg", "FlexibleArm-v0", {"observation": "measured", "arm": "strip_geared"}),
    ("pd", "TwoLinkFlexArm-v0", {"observation": "measured"}),
    ("pd", "MultiLinkFlexArm-v0", {}),
    ("zvd", "TwoLinkFlexArm-v0", {}),
    ("lqr", "TwoLinkFlexArm-v0", {}),
    ("lqr", "MultiLinkFlexArm-v0", {}),
    ("lqg", "TwoLinkFlexArm-v0", {"observation": "measured", "history": 2, "arm": "two_link_geared"}),
    ("pd", "SpatialFlexArm-v0", {}),
    ("pd", "SpatialFlexArm-v0", {"observation": "measured"}),
    ("zv", "SpatialFlexArm-v0", {}),
    ("zvd", "SpatialFlexArm-v0", {"observation": "measured"}),
    ("lqr", "SpatialFlexArm-v0", {}),
    ("lqg", "SpatialFlexArm-v0", IN_SPACE),
]
ELBOWS = {("lqr", 3): [(-1.1, -0.9), (-0.8, -0.6)], ("lqg", 2): [(0.3, 1.3)]}
"""Angles that gains are held for, where it is not all of them."""
TARGETS = [(-0.5, 0.2, 0.6), (0.5, -0.4, 0.6)]
"""Of an arm in space."""
STARTS: dict[str, Any] = {
    "SpatialFlexArm-v0": {"start": [0.0, 0.0, 0.0], "target": TARGETS[1]},
    "TwoLinkFlexArm-v0": {"start": [0.2, 0.4], "target": [0.7, 0.45]},
    "MultiLinkFlexArm-v0": {"start": [0.1, -0.3, -0.2], "target": [0.5, -0.6]},
}


@pytest.mark.slow
@needs_compiler
@pytest.mark.parametrize(("name", "env_id", "kwargs"), CASES, ids=[f"{c[0]}-{c[1]}-{len(c[2])}" for c in CASES])
def test_c_acts_as_python_does(name: str, env_id: str, kwargs: dict[str, Any], tmp_path: Path) -> None:
    """Two episodes of the closed loop, in which C sees what Python saw, from observations and from SI values."""
    env = gym.make(env_id, **kwargs)
    own = control.make(name, env)
    slew = float(np.float32(0.9)) if name == "time_optimal" else None
    options = STARTS.get(env_id) if slew is None else {"start": [0.0], "target": slew}
    seen, targets = own.read(env.reset(seed=0, options=options)[0]), None
    if isinstance(own, AboutRest):  # rests at the point that float32 leaves of the target
        targets = [TARGETS[0], own.targets(seen)[0]]
    elbows = None if targets else ELBOWS.get((name, own.setup.n_joints))
    source = controller_source(own, "it", slew, elbows, targets)
    assert not re.search(r"\b(malloc|main)\b", source)
    library, memory = shared(tmp_path, source, "-std=c99", "-O2"), ctypes.create_string_buffer(4096)
    joints, scales = own.setup.n_joints, np.array(own.setup.scales)
    for episode, decide in enumerate((library.it_decide, library.it_act)):
        observation, _ = env.reset(seed=episode, options=options)
        own.reset(observation)
        library.it_reset(memory)
        moved = 0.0
        for k in range(150):
            wanted, found = own.act(observation), np.ones(joints, np.float32)
            seen = np.ascontiguousarray(observation, np.float32)
            if episode:
                seen = np.ascontiguousarray(observation[-len(scales) :].astype(np.float64) * scales)
            if k in (0, 50):  # a broken sensor: no torque, nothing remembered of it
                broken = np.full_like(seen, np.nan if k else np.inf)
                decide(memory, broken.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
                assert not found.any()
            decide(memory, seen.ctypes.data_as(ctypes.c_void_p), found.ctypes.data_as(ctypes.c_void_p))
            assert np.abs(found - wanted).max() <= CLOSE
            moved = max(moved, float(np.abs(wanted).max()))
            observation, *_ = env.step(wanted)
        assert moved > 0.05
    env.close()


@pytest.mark.slow
def test_what_cannot_leave_is_a_sentence() -> None:
    env = gym.make("FlexibleArm-v0")
    refuses("controller = 'MPC': must be pd,", lambda: controller_source(control.make("mpc", env), "it"))
    refuses("slew: missing; the angle, rad", lambda: controller_source(control.make("time_optimal", env), "it"))
    three = control.make("lqr", gym.make("MultiLinkFlexArm-v0"))
    for elbows, sentence in (
        (None, "elbows = None: must be 2 pairs"), ([(0.0, 1.0)], "2 pairs"),
        ([(0.0, 1.0), (1.0, 0.0)], "low at most high"),
        ([(0.0, 1.0), (0.0, np.nan)], "= nan: must be"), ([(-3.0, 3.0), (-3.0, 3.0)], "elbows = '3721 postures'"),
    ):  # fmt: skip
        refuses(sentence, lambda elbows=elbows: controller_source(three, "it", elbows=elbows))
    pd = control.make("pd", gym.make("MultiLinkFlexArm-v0"))
    refuses("must be left out: gains of PD", lambda: controller_source(pd, "it", elbows=[(0.0, 1.0), (0.0, 1.0)]))
    refuses("requires an arm in space", lambda: controller_source(pd, "it", targets=TARGETS))
    env = gym.make("SpatialFlexArm-v0")
    lqr = control.make("lqr", env)
    refuses("elbows = .*: must be left out: gains in space", lambda: controller_source(lqr, "it", elbows=[(0.0, 1.0)]))
    refuses("targets = None: must be the controller's targets, points", lambda: controller_source(lqr, "it"))
    space = control.make("pd", env)
    refuses("targets = None: must be the controller's targets, points", lambda: controller_source(space, "it"))
    refuses(
        "targets.0. = .*: must be where the tip can rest", lambda: controller_source(space, "it", targets=[(9, 9, 9)])
    )


@needs_compiler
def test_from_the_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = str(tmp_path / "lqr.c")
    assert main(["export", "lqr", "--to", "c", "--env", "FlexibleArm-v0", "--out", out]) == 0
    assert "function: lqr_decide" in capsys.readouterr().out
    assert shared(tmp_path, Path(out).read_text()).lqr_reset
    words = ["export", "time_optimal", "--to", "c", "--env", "FlexibleArm-v0", "--out", out]
    assert main([*words, "--slew", "1.2"]) == 0
    capsys.readouterr()
    words = ["export", "zv", "--to", "c", "--env", "TwoLinkFlexArm-v0", "--out", out]
    assert main([*words, "--elbows", "0:0.5"]) == 0
    assert "6 postures, the elbows from 0 to 0.5 rad" in Path(out).read_text()
