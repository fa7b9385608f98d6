"""Arms as C libraries: the same bits as Python's, no allocation after the first, clear refusals."""

import ctypes
import dataclasses
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from benchmarks.doors import GEARED_IN_SPACE
from flexarm_env import arms
from flexarm_env.cli import main
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.derivatives import Periods
from flexarm_env.library import build, write
from flexarm_env.library.source import _members
from flexarm_env.physics.model import OWN_IN_SPACE
from flexarm_env.rigid import reach
from flexarm_env.tasks.program import ACTION_NOT_FINITE, ENERGIES, INFO
from tests.c_arm import Arm
from tests.c_tools import STRICT, needs_c, run_c
from tests.cli_tools import refused
from tests.processes import ROOT, python
from tests.refusals import refuses

LINKED = ("-std=c99", *STRICT, "-I.", "-L.", "-larm", "-Wl,-rpath,.")
DRAWN = {
    "actuator": {"delay": (0.0, 0.04), "jitter": 0.04},
    "sensors": {"delay": (0.0, 0.06), "strain_gauges": [{"gain": (0.9, 1.1)}]},
}
TOUCHING: dict[str, Any] = {
    "obstacle": {"shape": "half_space", "point": [0.0, 0.02], "normal": [0.0, -1.0]}, "stiffness": 1e4, "damping": 0.3,
    "friction": 0.3,
}  # fmt: skip
FLOOR = {**TOUCHING, "obstacle": {"shape": "half_space", "point": [0.0, 0.0, 0.2], "normal": [0.0, 0.0, 1.0]}}
CASES: list[Any] = [
    pytest.param("flexarm/slew-geared-v2", {}, id="gears with friction, delay"),
    pytest.param("flexarm/reach-measured-v1", {}, id="noise"),
    pytest.param("TwoLinkFlexArm-v0", {"formulation": "geometrically_exact"}, id="exact"),
    pytest.param("TwoLinkFlexArm-v0", {"formulation": "floating_frame"}, id="floating"),
    pytest.param("FlexibleArm-v0", {"step_tolerance": 1e-4}, id="fitted steps"),
    pytest.param("MultiLinkFlexArm-v0", {"randomization": {"EI": (0.7, 1.3)}}, id="drawn"),
    pytest.param(
        "FlexibleArm-v0",
        {"arm": "strip_geared", "randomization": {"friction": (0.5, 2.0), "hub_inertia": (0.5, 2.0)}, **DRAWN},
        id="joints and delays drawn",
    ),
    pytest.param(
        "FlexibleArm-v0", {"contacts": TOUCHING, "sensors": {"force": {}, "switch": {}}}, id="touches, force sensor"
    ),
    pytest.param(
        "TwoLinkFlexArm-v0",
        {"contacts": {**TOUCHING, "bodies": ["tip", "joint1"]}, "formulation": "geometrically_exact"},
        id="touches, exact",
    ),
    pytest.param(
        "FlexibleArm-v0",
        {"contacts": {**TOUCHING, "displacement_y": {"kind": "sine", "amplitude": 0.1, "omega": 6.0}}},
        id="touched by a moving obstacle",
    ),
    pytest.param("SpatialFlexArm-v0", {"contacts": FLOOR, "elements": 1}, id="touches in space"),
    pytest.param(
        "FlexibleArm-v0", {"contacts": {**TOUCHING, "bodies": ["link0@0.5", "tip"]}}, id="touched along a link"
    ),
]


COUNTING = (ROOT / "tests/programs/counting.c").read_text("utf-8")


def compare(env: Any, arm: Arm, seed: int, periods: int, most: float = 0.7, forces: list[float] | None = None) -> int:
    """An episode of both, bit for bit: observations, info, poses, rewards; how many periods it took.

    forces: contact forces are appended to it.
    """
    batch, rng = env.unwrapped.batch, np.random.default_rng(seed)
    seen, _ = env.reset(seed=seed)
    assert arm.seeded(seed) == 0
    for k in range(periods):
        assert np.array_equal(arm.row("get_observation", seen.size, "f"), seen)
        numbers = batch.table[:, 0].copy()
        numbers[batch.info_at.truncated] = 0.0  # a library has no time limit
        assert np.array_equal(arm.row("get_info", len(numbers)), numbers, equal_nan=True)
        poses = batch.poses(0)
        assert np.array_equal(arm.row("get_poses", poses.size), poses.ravel())
        assert abs(arm("get_time") - k * env.unwrapped.dt) < 1e-9
        action = rng.uniform(-most, most, env.action_space.shape).astype(np.float32)
        seen, reward, ended, _, info = env.step(action)
        if forces is not None:
            forces.append(info.get("contact_force", 0.0))
        assert arm("step", action.astype(np.float64)) == (0 if not ended else numbers[batch.info_at.reason])
        assert arm("get_reward") == reward
        if ended:
            break
    return k + 1


@pytest.mark.slow
@needs_c
@pytest.mark.parametrize(("env_id", "keywords"), CASES)
def test_bits(env_id: str, keywords: dict[str, Any], tmp_path: Path) -> None:
    env = gym.make(env_id, info_level="full", **keywords)
    built = write(env, tmp_path, "arm", "native", derivatives=False)
    arm = Arm(built)
    forces: list[float] = []
    for seed in (1, 2):
        compare(env, arm, seed, 150, forces=forces)
    assert (max(forces) > 0.0) == ("contacts" in keywords)
    arm.destroy()
    env.close()


@needs_c
@pytest.mark.slow
@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        ("flexarm/slew-geared-v2", {}),
        ("FlexibleArm-v0", {"formulation": "floating_frame", "multipliers": True}),
        ("SpatialFlexArm-v0", GEARED_IN_SPACE),
    ],
    ids=["gears with friction", "multipliers", "gears with friction in space"],
)
def test_ten_thousand_periods(env_id: str, keywords: dict[str, Any], tmp_path: Path) -> None:
    env = gym.make(env_id, info_level="full", duration=1e4, **keywords)
    arm = Arm(write(env, tmp_path, "arm", "native", derivatives=False))
    assert compare(env, arm, 1, 10_000, 0.2 if env.unwrapped.plan.arm.spatial else 0.7) == 10_000
    arm.destroy()
    env.close()


def same_derivatives(env: Any, arm: Arm) -> None:
    """jvp and vjp of a period from where both are are Python's."""
    joints, rng = env.action_space.shape[0], np.random.default_rng(0)
    periods = Periods(env.unwrapped.batch)
    x, size = np.zeros(periods.state_size), periods.observation_size
    arm("get_states", x)
    assert np.array_equal(x[None], periods.states())
    action = rng.uniform(-0.5, 0.5, joints)
    found = periods.jacobians(x[None], action[None])
    dx, da = rng.normal(size=x.size), rng.normal(size=joints)
    after, seen, reward = np.zeros_like(x), np.zeros(size), np.zeros(1)
    assert arm("jvp", x, action, dx, da, after, seen, reward) == 0
    for one, wanted in zip((after, seen, reward), found.jvp(dx[None], da[None]), strict=True):
        assert abs(one - wanted.ravel()).max() <= 1e-12 * max(1.0, abs(wanted).max())
    bars = [rng.normal(size=part.shape) for part in found[:3]]
    x_bar, a_bar = np.zeros_like(x), np.zeros(joints)
    assert arm("vjp", x, action, bars[0], bars[1], ctypes.c_double(bars[2][0]), x_bar, a_bar) == 0
    for one, wanted in zip((x_bar, a_bar), periods.vjp(x[None], action[None], *bars), strict=True):
        assert abs(one - wanted.ravel()).max() <= 1e-12 * abs(wanted).max()
    periods.close()


@pytest.mark.slow
@needs_c
@pytest.mark.parametrize(
    ("env_id", "keywords"),
    [
        ("FlexibleArm-v0", {}),
        ("TwoLinkFlexArm-v0", {"formulation": "geometrically_exact"}),
        ("FlexibleArm-v0", {"actuator": {"lag": 0.03}, "step_tolerance": 1e-4}),
        ("SpatialFlexArm-v0", {}),
    ],
)
def test_everything(env_id: str, keywords: dict[str, Any], tmp_path: Path) -> None:
    """Built for every x86-64: episodes, states kept and put back, parameters, derivatives, refusals, the example."""
    env = gym.make(env_id, info_level="full", **keywords)
    built = write(env, tmp_path, "arm")
    assert {"arm.h", "arm.c", "example.c", "CMakeLists.txt", "arm.pc", "libarm.so"} <= set(built.files)
    arm, other, joints = Arm(built), Arm(built), env.action_space.shape[0]
    zero, poses = np.zeros(joints), env.unwrapped.batch.poses(0).size
    assert arm("step", zero) == -1 and arm.status(-1).startswith("the episode has ended")
    compare(env, arm, 3, 100)

    if built.source.periods is not None:
        same_derivatives(env, arm)
    action = np.random.default_rng(0).uniform(-0.5, 0.5, joints)
    state = np.zeros(told_by(tmp_path / "arm.h", "STATE_BYTES"), np.uint8)
    arm("get_state", state)
    for _ in range(5):
        arm("step", action)
    assert other("set_state", state) == 0
    for _ in range(5):
        other("step", action)
    assert np.array_equal(arm.row("get_poses", poses), other.row("get_poses", poses))

    own, names = np.zeros(told_by(tmp_path / "arm.h", "PARAMETERS")), [one.name for one in built.source.parameters]
    arm("get_parameters", own)
    nominal = dict(zip(OWN_IN_SPACE, env.unwrapped.batch.parameters(0), strict=False))
    assert own.tolist() == [nominal.get(name, 1.0) for name in names] and names[-1] == "torque_factor"
    assert arm("set_parameters", own * 1.1) == 0
    wrongs = ("payload_mass", -1.0), ("EI_factor", np.nan), ("EI_factor", 0.0), ("EI_factor", 1e15), ("tau_d", np.inf)
    for name, value in wrongs:
        wrong = own.copy()
        wrong[names.index(name)] = value
        assert arm("set_parameters", wrong) == -2
    assert arm("reset", ctypes.c_uint64(1), np.full(joints, np.inf), None, ctypes.c_double(0.0)) == -2
    none, far = ctypes.c_double(np.nan), np.full(joints, 1e300)
    assert arm("reset", ctypes.c_uint64(1), None, far, none) == arm.reset(1, 0.6) == -2
    assert [arm(word, None) for word in ("step", "step_torques", "set_state", "set_parameters")] == [-2] * 4
    assert arm.reset(1) == 0 and arm("step", np.full(joints, np.nan)) == 100
    assert arm("step", zero) == -1

    limits = np.array(env.unwrapped.plan.arm.torque_limits)
    assert arm.reset(1) == 0 and other.reset(1) == 0
    arm("step_torques", action * limits)
    other("step", action * limits / limits)
    assert np.array_equal(arm.row("get_poses", poses), other.row("get_poses", poses))

    told = run_c(tmp_path, "example", *LINKED)
    assert told.count("tip") == 10 and told.endswith("\nok\n")
    (tmp_path / "counting.c").write_text(COUNTING)
    first, later = map(int, run_c(tmp_path, "counting", *LINKED).split())
    assert first > 0 and later == 0  # allocations before the first reset, and in 2000 periods, jvp and vjp
    arm.destroy()
    other.destroy()
    env.close()


@needs_c
@pytest.mark.slow
def test_joints_numbers_are_set(tmp_path: Path) -> None:
    """A library that is given another arm's stiffness, friction, ... moves as that arm does, to the last bit."""
    base: Any = arms.named("strip_geared")
    joint = base.joints[0]
    factors = {"stiffness": 0.9, "damping": 1.2, "friction_viscous": 0.7, "friction_coulomb": 1.4}
    given = {"info_level": "full", "randomization": {"torque_constant": (0.8, 0.8)}}
    built = write(gym.make("FlexibleArm-v0", arm=base, **given), tmp_path, "arm", "native")
    arm, names = Arm(built), [one.name for one in built.source.parameters]
    arm.reset(1)
    nominal = arm_parameters(arm, len(names))
    own = np.array(nominal)
    assert own[names.index("torque_factor")] == 0.8
    for rotor in (1.3, 1.0):  # of which the scales of an observation are, too
        all_ = factors | {"motor_inertia": rotor}
        changed = dataclasses.replace(joint, **{name: getattr(joint, name) * by for name, by in all_.items()})
        laws = {"stiffness": changed.stiffness, "damping": changed.damping, "rotor": changed.rotor}
        laws |= {"viscous": changed.friction_viscous, "coulomb": changed.friction_coulomb}
        for name, value in laws.items():
            own[names.index(f"{name}[0]")] = value
        env: Any = gym.make("FlexibleArm-v0", arm=dataclasses.replace(base, joints=(changed,)), **given)
        env.reset(seed=4)
        arm.seeded(4)
        assert arm_parameters(arm, len(names)) == nominal  # a reset puts them back
        assert arm("set_parameters", own) == 0
        for k in range(150):
            action = np.float32([0.7 * np.sin(0.3 * k)])
            env.step(action)
            assert arm("step", action.astype(np.float64)) == 0
        poses = env.unwrapped.batch.poses(0)
        assert np.array_equal(arm.row("get_poses", poses.size), poses.ravel())
    same_derivatives(env, arm)
    own[names.index("stiffness[0]")] = 0.0
    assert arm("set_parameters", own) == -2
    arm.destroy()
    env.close()


def arm_parameters(arm: Arm, count: int) -> list[float]:
    """As the library says them."""
    own = np.zeros(count)
    arm("get_parameters", own)
    return list(own.tolist())


def told_by(header: Path, word: str) -> int:
    """A number that a header says."""
    line = next(line for line in header.read_text().splitlines() if line.startswith(f"#define ARM_{word} "))
    return int(line.split()[2])


@pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")
def test_without_a_compiler(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(build.shutil, "which", lambda word: None)
    env = gym.make("FlexibleArm-v0")
    built = write(env, tmp_path, "arm", derivatives=False)
    assert built.library is None and "no C compiler" in built.why and "cmake" in built.why
    assert {"arm.h", "arm.c", "arm_step_program.o", "CMakeLists.txt"} <= {path.name for path in tmp_path.iterdir()}


def test_comments_of_the_header_are_sentences() -> None:
    """`double further[29]; /* a , or nothing */`"""
    sizes = {"links": 2, "targets": 2, "terms": 3, "further": 29}
    text = _members(INFO, sizes, {"energies": ENERGIES})
    assert "double further[29]; /* costs, payload, push, drawn factors, ...: flexarm_env.tasks" in text
    assert "`" not in text and ", or nothing" not in text


@pytest.mark.slow
@needs_c
def test_what_a_users_own_build_met(tmp_path: Path) -> None:
    """The example's own command lacked -lm; NAME.pc in /usr of Debian named usr/lib/include; an arm of 0.94 m took a
    target 1.27 m away; a torque of 1e308 N m was "not finite"."""
    env = gym.make("TwoLinkFlexArm-v0")
    built = write(env, tmp_path, "arm", derivatives=False)
    first = (tmp_path / "example.c").read_text().splitlines()[0]
    assert subprocess.run(first[first.index("cc ") : -3], shell=True, cwd=tmp_path, check=False).returncode == 0
    arm, far = Arm(built), float(reach(env.unwrapped.plan.arm)[1])

    def reset(*target: float) -> int:
        return int(arm("reset", ctypes.c_uint64(1), None, np.array(target), ctypes.c_double(np.nan)))

    with pytest.raises(ValueError, match="must be within reach"):
        env.reset(options={"target": (0.95 * far, 0.95 * far)})
    assert reset(0.95 * far, 0.95 * far) == reset(0.0, -1.001 * far) == -2
    assert reset(0.6 * far, 0.6 * far) == reset(np.nan, np.nan) == 0
    wrong = int(ACTION_NOT_FINITE)
    for torque, status in ((1e308, 0), (-1e300, 0), (np.inf, wrong), (np.nan, wrong)):
        arm.reset(1)
        assert arm("step_torques", np.array([torque, 0.0])) == status
    assert arm.status(wrong) == "the action is not finite"
    arm.destroy()
    if not (shutil.which("cmake") and shutil.which("pkg-config")):
        return
    for folder in ("lib/x86_64-linux-gnu", "lib", "lib64"):
        made = tmp_path / folder.replace("/", "-")
        words = ["-DCMAKE_INSTALL_PREFIX=/usr", f"-DCMAKE_INSTALL_LIBDIR={folder}"]
        subprocess.run(["cmake", "-S", tmp_path, "-B", made, *words], check=True, capture_output=True)
        place = tmp_path / "root" / "usr" / folder / "pkgconfig"
        place.mkdir(parents=True)
        shutil.copyfile(made / "arm.pc", place / "arm.pc")
        found = {"PKG_CONFIG_PATH": str(place), "PATH": os.environ["PATH"]}
        for word, wanted in (("includedir", "root/usr/include"), ("libdir", f"root/usr/{folder}")):
            asked = ["pkg-config", f"--variable={word}", "arm"]
            told = subprocess.run(asked, env=found, check=True, capture_output=True, text=True).stdout.strip()
            assert Path(os.path.normpath(told)) == tmp_path / wanted


@needs_c
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "my-strip"
    assert main(["export", "strip", "--to", "library", "--out", str(out)]) == 0
    assert "libmy_strip.so" in capsys.readouterr().out and (out / "my_strip.h").is_file()
    file = str(out / "my_strip.h")
    assert "my_strip.h: File exists" in refused(capsys, "export", "strip", "--to", "library", "--out", file)


@pytest.mark.skipif(UNCOMPILED, reason="nothing is compiled")
@pytest.mark.parametrize("cpu", ["nope", "i386", "help", "", "native ", "-x", "z" * 5000, "a\0"])
def test_a_processor_that_llvm_does_not_make_code_for(tmp_path: Path, cpu: str) -> None:
    """LLVM ended Python by an abort for the first, and listed what it knows for the third."""
    with pytest.raises(ValueError, match=r"cpu = .*: must be native, or x86-64-v3"):
        write(gym.make("FlexibleArm-v0"), tmp_path / "arm", "arm", cpu=cpu)
    assert not list(tmp_path.iterdir())


FULL = """
import resource, signal
from pathlib import Path
import gymnasium as gym
import flexarm_env
from flexarm_env.library import write
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
try:
    write(gym.make("FlexibleArm-v0"), Path("full"), "arm", derivatives=False)
except OSError as error:
    print(error.filename, "|", error.strerror, "|", *Path("full").iterdir())
"""


@pytest.mark.slow
@needs_c
def test_a_disk_that_is_full_and_a_compiler_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = python("-c", FULL, cwd=tmp_path)
    assert done.stdout == "full/arm_step_program.o | File too large |\n", done.stderr
    (tmp_path / "cc").write_text("#!/bin/sh\necho 'ld: error: no room' >&2\necho collect2 >&2\nexit 1\n")
    (tmp_path / "cc").chmod(0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}:/usr/bin:/bin")
    with pytest.raises(OSError, match="cc ends with ld: error: no room") as error:
        build.linked(tmp_path, "libarm.so", ["arm.c"])
    assert error.value.filename == str(tmp_path / "libarm.so")


def test_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuses("must be a single environment", lambda: write(gym.make_vec("FlexibleArm-v0", num_envs=2), tmp_path, "arm"))
    monkeypatch.setattr(build.platform, "machine", lambda: "arm64")
    refuses("built on Linux x86-64", lambda: write(gym.make("FlexibleArm-v0"), tmp_path, "arm"))
    assert not list(tmp_path.iterdir())
