"""The commands and programs of docs/doors.md, as they are printed there."""

import re
import shutil
import subprocess
import sys
import time
import types
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env.control import load_policy
from flexarm_env.remote import Limits, Server, Session
from tests.c_tools import needs_c
from tests.env_tools import steered
from tests.processes import ROOT, served

PAGE = (ROOT / "docs" / "doors.md").read_text("utf-8")


def blocks(kind: str) -> list[str]:
    """The page's blocks of a language, in order."""
    return re.findall(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL)


def shell(folder: Path, text: str) -> str:
    """What a block of commands prints, in a folder, with this Python's `flexarm`."""
    text = re.sub(r"^flexarm ", f"{sys.executable} -m flexarm_env ", text, flags=re.MULTILINE)
    done = subprocess.run(["sh", "-ec", text], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture
def one() -> Iterator[tuple[str, int, Session]]:
    """An arm that answers packets on this machine."""
    env = gym.make("FlexibleArm-v0", control_dt=0.01, duration=1e6)
    session = Session(env, Limits(watchdog=100), seed=3)
    with served(Server(session)) as address:
        yield *address, session


@pytest.mark.slow
@needs_c
def test_an_arm_and_its_policy_in_c(tmp_path: Path) -> None:
    """The numbers of Python's episode, but for what float32 sums of the policy leave."""
    (tmp_path / "closed.c").write_text(blocks("c")[0])
    printed = shell(tmp_path, blocks("sh")[0]).splitlines()[-1].split()
    env, policy = gym.make("FlexibleArm-v0"), load_policy("flexible_arm")
    *_, (*_, info) = steered(env, policy, seed=7)
    assert printed[2] == "1" and info["is_success"]
    assert np.array(printed[:2], float) == pytest.approx(info["tip_position"], abs=1e-6)
    if shutil.which("cmake"):
        assert "ok" in shell(tmp_path, blocks("sh")[1]).splitlines()[-1]


@needs_c
def test_a_served_arm_is_driven_from_c(tmp_path: Path, one: tuple[str, int, Session]) -> None:
    host, port, session = one
    shutil.copyfile(ROOT / "docs" / "examples" / "wire.c", tmp_path / "wire.c")
    text = blocks("sh")[2].replace("127.0.0.1 7070", f"{host} {port}").replace("cc ", "cc -Wall -Wextra -Werror ")
    runs = 1
    while abs(float(shell(tmp_path, text)) - 0.5) > 0.02:  # where the machine was too busy for its last periods
        assert runs < 5
        runs += 1
    for _ in range(1000):  # the last packet, a farewell, may still be on its way as the program ends
        if session.peer is not None:
            time.sleep(0.01)
    assert session.counts["accepted"] == 202 * runs and set(session.counts) == {"challenged", "accepted", "missing"}
    assert session.counts["missing"] == 0


def test_the_node_of_ros_moves_an_arm(monkeypatch: pytest.MonkeyPatch, one: tuple[str, int, Session]) -> None:
    """Against a stand-in of rclpy: what it publishes is what the arm reads, what it is sent acts."""
    sent: list[Any] = []

    class Node:
        """Of rclpy, as much as the page uses."""

        def __init__(self, name: str) -> None:
            self.name = name

        def create_publisher(self, kind: Any, topic: str, depth: int) -> Any:
            return types.SimpleNamespace(publish=sent.append)

        def create_subscription(self, *given: Any) -> None:
            pass

        def create_timer(self, period: float, tick: Any) -> None:
            self.period = period

        def get_clock(self) -> Any:
            return types.SimpleNamespace(now=lambda: types.SimpleNamespace(to_msg=lambda: 0))

    known = {
        "rclpy": {}, "rclpy.node": {"Node": Node}, "sensor_msgs": {}, "std_msgs": {},
        "sensor_msgs.msg": {"JointState": lambda: types.SimpleNamespace(header=types.SimpleNamespace())},
        "std_msgs.msg": {"Float64MultiArray": types.SimpleNamespace},
    }  # fmt: skip
    for name, words in known.items():
        module = types.ModuleType(name)
        vars(module).update(words)
        monkeypatch.setitem(sys.modules, name, module)
    scope: dict[str, Any] = {"__name__": "node"}
    exec(blocks("python")[0], scope)
    host, port, session = one
    node = scope["ArmNode"](host, port)
    node.asked(types.SimpleNamespace(data=[0.3]))
    for _ in range(30):
        node.tick()
    node.wire.close()
    assert node.period == 0.01 and len(sent) == 30 and sent[-1].effort == [pytest.approx(0.3, rel=1e-6)]
    assert sent[-1].position[0] > sent[0].position[0] and session.counts["accepted"] >= 31
