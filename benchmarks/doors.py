"""Test and time exported arms and controllers, and the packets of a served arm: docs/results/doors.md.

python -m benchmarks.doors [--periods N] [--page] [--out FOLDER]

Arms as C libraries are compared with Python; their steps are timed in C, and their memory allocations are counted. FMUs
run in FMPy, alone and as an arm with its controller. A served arm receives packets of all kinds. The script needs a C
compiler and the extra `fmi`, and takes a few minutes.
"""

import argparse
import hmac
import json
import math
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from benchmarks import pages
from benchmarks.machine import table
from benchmarks.pages import Found
from flexarm_env import Joint, arms, control
from flexarm_env.library import Built, write, write_controller_fmu, write_fmu
from flexarm_env.remote import Kind, Limits, Packet, Session, pack, unpack
from flexarm_env.remote.packet import ARM, DIGEST
from flexarm_env.validation import Array
from tests.c_arm import Arm

GEARED: dict[str, Any] = {"arm": "strip_geared"}
GEAR = Joint(stiffness=2000.0, damping=2.0, motor_inertia=1e-5, gear_ratio=50.0, friction_coulomb=0.2)
GEARED_IN_SPACE: dict[str, Any] = {"arm": replace(arms.named("three_dof"), joints=(GEAR,) * 3)}
ARMS: dict[str, tuple[str, dict[str, Any]]] = {
    "one link, elastica": ("FlexibleArm-v0", {}),
    "one link, exact beam": ("FlexibleArm-v0", {"formulation": "geometrically_exact"}),
    "one link, floating frame": ("FlexibleArm-v0", {"formulation": "floating_frame"}),
    "one link, gear and dry friction": ("FlexibleArm-v0", GEARED),
    "two links, elastica": ("TwoLinkFlexArm-v0", {}),
    "three joints in space, exact beam": ("SpatialFlexArm-v0", {}),
    "the same, gears and dry friction": ("SpatialFlexArm-v0", GEARED_IN_SPACE),
}
UNITS = ("one link, elastica", "one link, gear and dry friction", "three joints in space, exact beam")
"""Names of the arms that are also exported as FMUs."""
COMPARED = 10_000
"""Number of control periods whose results are compared."""
SHARE = 0.2
"""Amplitude of the actions, as a share of the torque limits."""
PERIOD, SECONDS, MANY = 0.00125, 0.8, (1, 2, 4, 8, 16)
"""Of the arm with its controller: control period, s, duration, s, and numbers of periods per communication step."""

KEY = b"a key that both ends know"
TIMING = Path(__file__).with_suffix(".c").read_text("utf-8")


def made(name: str) -> Any:
    """Make the environment of an arm of `ARMS`."""
    env_id, kwargs = ARMS[name]
    return gym.make(env_id, info_level="full", duration=1e6, disable_env_checker=True, **kwargs)


def asked(env: Any, k: int) -> Array:
    """Return the actions of period k, rounded to float32."""
    joints = np.arange(env.action_space.shape[0])
    return (SHARE * np.sin(2.0 * k * env.unwrapped.dt + joints)).astype(np.float32).astype(np.float64)


def same_bits(env: Any, built: Built) -> tuple[int, int]:
    """Compare all outputs of a library with Python in each period; return the numbers of compared and different
    outputs."""
    arm, plain, batch, compared, different = Arm(built), env.unwrapped, env.unwrapped.batch, 0, 0
    env.reset(seed=1)
    arm.seeded(1)
    for k in range(COMPARED):
        action = asked(env, k)
        plain.step(action.astype(np.float32))
        arm("step", action)
        wanted = {"info": batch.table[:, 0], "poses": batch.poses(0).ravel(), "observation": batch.observation[0]}
        for word, values in wanted.items():
            seen = arm.row(f"get_{word}", values.size, "f" if word == "observation" else "d")
            different += int((seen != values).sum() - (np.isnan(seen) & np.isnan(values)).sum())
            compared += values.size
    arm.destroy()
    return compared, different


def timed(folder: Path, periods: int) -> list[Found]:
    """Time the steps of a library in C, as an ordinary process and with first-in-first-out real-time priority."""
    (folder / "timing.c").write_text(TIMING)
    command = ["cc", "-O2", "timing.c", "-o", "timing", "-I.", "-L.", "-larm", "-Wl,-rpath,.", "-lm"]
    subprocess.run(command, cwd=folder, check=True)
    found = []
    for more in ((), ("first",)):
        done = subprocess.run(["./timing", str(periods), *more], cwd=folder, check=True, capture_output=True, text=True)
        found.append(json.loads(done.stdout))
    return found


def unit(env: Any, form: str, folder: Path, periods: int = COMPARED) -> Found:
    """Validate an FMU with FMPy, simulate it, and compare its outputs with Python."""
    from fmpy import simulate_fmu
    from fmpy.validation import validate_fmu

    plain, path, joints = env.unwrapped, folder / "unit.fmu", range(env.action_space.shape[0])
    dt, space, goal = plain.dt, plain.plan.arm.spatial, [0.5] * len(joints)
    write_fmu(env, path, "arm", form)
    messages = validate_fmu(str(path))
    torque, t = plain.plan.action_mode == "torque", dt * np.arange(periods + 1)
    word, scale = ("torque", plain.plan.arm.torque_limits) if torque else ("action", (1.0,) * len(joints))
    inputs = np.zeros(len(t), [("time", float), *((f"{word}[{i}]", float) for i in joints)])
    inputs["time"] = t
    actions = np.array([asked(env, k) for k in range(periods + 1)])
    for i in joints:
        inputs[f"{word}[{i}]"] = actions[:, i] * scale[i]
    words = [*(f"energy.{word}" for word in ("kinetic", "strain", "gravity", "dissipated", "work"))]
    words += [f"tip[{k}]" for k in range(3 if space else 2)] + [f"applied_torque[{k}]" for k in joints]
    words += ["deflection[1,2]"] if space else [f"deflection[{k}]" for k in joints]
    run = simulate_fmu(
        str(path), stop_time=float(t[-1]), output_interval=dt, input=inputs, output=words, set_stop_time=False,
        start_values={f"start_angle[{i}]": 0.2 for i in joints} | {f"target[{i}]": goal[i] for i in joints},
    )  # fmt: skip
    env.reset(seed=0)
    target = np.array(goal if space else [*goal, 0.0][:2])
    plain.batch.ask(np.full(len(joints), 0.2), target, np.zeros(1))  # by the joint angles there, in space
    plain.batch.start((0,), (0,), limit=10**9)
    at, rows = plain.batch.info_at, []
    places = [*range(at.energies, at.energies + 5), *range(at.tip, at.deflection)]
    places += range(at.torque, at.torque + len(joints))
    places += [at.deflection + 5] if space else range(at.deflection, at.deflection + len(joints))
    for k in range(periods + 1):
        rows.append(plain.batch.table[places, 0].tolist())
        if k < periods:
            plain.step(actions[k].astype(np.float32))
    told, wanted = np.array([run[word] for word in words]).T, np.array(rows)
    env.close()
    return {
        "form": form, "messages": messages, "periods": periods, "numbers": int(told.size),
        "different": int((told != wanted).sum()) if told.shape == wanted.shape else -1,
    }  # fmt: skip


class Slave:
    """FMU of version 3.0 that FMPy steps."""

    def __init__(self, path: Path, folder: Path) -> None:
        from fmpy import extract, read_model_description
        from fmpy.fmi3 import FMU3Slave

        about = read_model_description(str(path))
        self.places = {one.name: one.valueReference for one in about.modelVariables}
        self.unit = FMU3Slave(
            guid=about.guid, unzipDirectory=extract(str(path), str(folder)), instanceName="it",
            modelIdentifier=about.coSimulation.modelIdentifier,
        )  # fmt: skip
        self.unit.instantiate()

    def begin(self, **values: float) -> None:
        self.unit.reset()
        self.put({name.replace("__", "[") + "]": value for name, value in values.items()})
        self.unit.enterInitializationMode()
        self.unit.exitInitializationMode()

    def put(self, values: dict[str, float]) -> None:
        if values:
            self.unit.setFloat64([self.places[name] for name in values], list(values.values()))

    def get(self, names: list[str]) -> list[float]:
        return list(self.unit.getFloat64([self.places[name] for name in names]))


def coupled(folder: Path) -> Found:
    """Couple the FMUs of an arm and of its controller with communication steps of several lengths; compare with Python.

    Each result is the largest difference of the hub angle from Python's, rad.
    """
    env = gym.make("FlexibleArm-v0", control_dt=PERIOD, dt=PERIOD, duration=1e6, disable_env_checker=True)
    own = control.make("pd", env)
    write_fmu(env, folder / "arm.fmu", "arm")
    write_controller_fmu(own, folder / "pd.fmu", "pd")
    arm, pd = (Slave(folder / f"{word}.fmu", folder / word) for word in ("arm", "pd"))
    names, each = [name for name in pd.places if name.startswith("observation")], PERIOD * MANY[-1]
    found: dict[int, Array] = {}
    for many in MANY:
        arm.begin(start_angle__0=0.0, target__0=0.8)
        pd.begin()
        length, angles = many * PERIOD, []
        for k in range(round(SECONDS / length)):
            pd.put(dict(zip(names, arm.get(names), strict=True)))
            pd.unit.doStep(k * length, length)
            arm.put({"torque[0]": pd.get(["torque[0]"])[0]})
            arm.unit.doStep(k * length, length)
            if (k + 1) * many % MANY[-1] == 0:
                angles.append(arm.get(["link[0].root_angle"])[0])
        found[many] = np.array(angles)
    seen, _ = env.reset(options={"start": 0.0, "target": 0.8, "vibration": 0.0})
    own.reset(seen)
    wanted = []
    for k in range(round(SECONDS / PERIOD)):
        seen = env.step(own.act(seen))[0]
        if (k + 1) % MANY[-1] == 0:
            wanted.append(float(env.unwrapped.batch.poses(0)[0, 2]))
    assert len(wanted) == round(SECONDS / each)
    env.close()
    return {
        "python": float(np.abs(found[1] - wanted).max()),
        "errors": [[1e3 * many * PERIOD, float(np.abs(found[many] - found[1]).max())] for many in MANY[1:]],
    }


def met(session: Session, peer: tuple[str, int], hello: int = 5) -> Packet:
    """Perform the handshake of a peer with a served arm, and return the WELCOME packet.

    The peer sends HELLO, and a second HELLO with the cookie of the received CHALLENGE.
    """
    found = Packet(Kind.CHALLENGE, hello, 0, 0.0, (0.0, 0.0))
    for kind in (Kind.CHALLENGE, Kind.WELCOME):
        content = session.receive(pack(Packet(Kind.HELLO, hello, 0, 0.0, found.numbers), session.key), peer)
        answer = unpack(content or b"", session.key)
        assert isinstance(answer, Packet) and answer.kind is kind, answer
        found = answer
    return found


def packets(count: int, key: bytes | None = KEY) -> Found:
    """Send random valid and invalid packets to a served arm; return how many of each kind were sent and counted.

    Invalid packets are truncated, extended, corrupted, replayed, from another connection or version, or noise. The
    function asserts that the arm never applies a torque other than its peer's.
    """
    env = gym.make("FlexibleArm-v0", control_dt=0.01, duration=1e6, disable_env_checker=True)
    peer, rng = ("127.0.0.1", 1), np.random.default_rng(1)
    session = Session(env, Limits(watchdog=10**6), key, seed=0)
    welcome = met(session, peer)
    first = Packet(Kind.COMMAND, welcome.connection, 1, 0.0, (0.0,), ARM)
    sent: Counter[str] = Counter({"sound": 2, "HELLO without a cookie": 1})
    session.receive(pack(first, key), peer)
    sequence, ways = 1, ["sound", "cut", "grown", "a bit turned over", "old", "of another connection", "not finite",
                         "of another size", "of another version", "HELLO of another peer", "noise", "lost"]  # fmt: skip
    taken = {0.0}
    if key is None:
        ways.remove("a bit turned over")
    for k in range(count):
        way = str(rng.choice(ways))
        good = Packet(Kind.COMMAND, welcome.connection, sequence + 1, 0.0, (float(rng.uniform(-1.0, 1.0)),))
        content = pack(good, key)
        at = int(rng.integers(len(content)))
        sent[way] += 1
        if way in ("sound", "lost"):
            sequence += 1
        if way == "lost":
            continue
        if way == "sound":
            taken.add(good.numbers[0])
        made: dict[str, bytes] = {
            "sound": content,
            "cut": content[:at],
            "grown": content + bytes(1 + at),
            "a bit turned over": content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :],
            "old": pack(good._replace(sequence=int(rng.integers(0, session.last + 1))), key),
            "of another connection": pack(good._replace(connection=int(rng.integers(2**63))), key),
            "not finite": pack(good._replace(numbers=(float(rng.choice([math.nan, math.inf])),)), key),
            "of another size": pack(good._replace(numbers=(0.1,) * int(rng.choice([0, 2, 7]))), key),
            "of another version": _of_version(1 + 2 * (at % 9), content, key),
            "HELLO of another peer": pack(Packet(Kind.HELLO, at, 0, 0.0, (float(at), 1.0)), key),
            "noise": rng.bytes(6 * at),
        }
        session.receive(made[way], ("127.0.0.1", 2) if way == "HELLO of another peer" else peer)
        if k % 500 == 0:
            session.advance()
            assert float(session.torque[0]) in taken
    session.receive(pack(first._replace(sequence=sequence + 1, flags=0), key), peer)
    sent["sound"] += 1
    return {"sent": dict(sent), "counts": dict(session.counts)}


def _of_version(version: int, content: bytes, key: bytes | None) -> bytes:
    """Return a packet with another version number in its header and a valid signature."""
    body = content[:4] + version.to_bytes(2, "little") + content[6 : len(content) - (0 if key is None else DIGEST)]
    return body if key is None else body + hmac.new(key, body, "sha256").digest()


def measure(options: argparse.Namespace) -> Found:
    """Measure all tables of the page."""
    found: Found = {"arms": [], "units": []}
    for name in ARMS:
        env = made(name)
        with tempfile.TemporaryDirectory() as folder:
            built = write(env, Path(folder), "arm", derivatives=False)
            assert built.library is not None, built.why
            compared, different = same_bits(env, built)
            one = {"arm": name, "compared": compared, "different": different}
            found["arms"].append(one | {"runs": timed(Path(folder), options.periods)})
        env.close()
        print(found["arms"][-1], flush=True)
    for name in UNITS:
        for form in ("2.0", "3.0"):
            with tempfile.TemporaryDirectory() as folder:
                found["units"].append({"unit": name, **unit(made(name), form, Path(folder))})
            print(found["units"][-1], flush=True)
    with tempfile.TemporaryDirectory() as folder:
        found["coupled"] = coupled(Path(folder))
    found["packets"] = packets(100_000)
    counts, told = found["packets"]["counts"], found["packets"]["sent"]
    errors = [error for _, error in found["coupled"]["errors"]]
    found["verdicts"] = {
        "libraries return the same bits as Python": not any(one["different"] for one in found["arms"]),
        "no library allocates memory after its start": not any(
            run["allocations"] for one in found["arms"] for run in one["runs"]
        ),
        "FMPy finds no fault in a unit": not any(one["messages"] for one in found["units"]),
        "units return the same bits as Python": not any(one["different"] for one in found["units"]),
        "arm unit and controller unit with steps of one period agree with Python's loop within 1e-5 rad":
            found["coupled"]["python"] < 1e-5,
        "with longer steps their error grows at most in proportion":
            all(later < 3.5 * one for one, later in pairwise(errors)),
        "packets accepted, dropped and missing are those sent": sum(counts.values()) == sum(told.values()),
    }  # fmt: skip
    return found


def blocks(found: Found) -> pages.Blocks:
    """Format the tables of the page."""
    steps, bits = [], []
    for one in found["arms"]:
        bits.append((one["arm"], f"{COMPARED:,}", f"{one['compared']:,}", one["different"]))
        for run, how in zip(one["runs"], ("ordinary", "`SCHED_FIFO`"), strict=True):
            if how != "ordinary" and not run["urgent"]:
                how = "`SCHED_FIFO` is not permitted here"
            wall, spent = (" / ".join(f"{us:.3g}" for us in run[word]) for word in ("wall", "spent"))
            steps.append((one["arm"], how, wall, spent, run["allocations"], run["faults"], run["ended"]))
    units = []
    for one in found["units"]:
        counted = f"{one['periods']:,}", f"{one['numbers']:,}", one["different"]
        units.append((one["unit"], one["form"], "; ".join(one["messages"]) or "none", *counted))
    errors, rows = found["coupled"]["errors"], []
    for k, (length, error) in enumerate(errors):
        rows.append((f"{length:g}", f"{error:.3g}", f"{error / errors[k - 1][1]:.2f}" if k else ""))
    counts = dict(sorted(found["packets"]["counts"].items()))
    told = [(key, f"{count:,}") for key, count in found["packets"]["sent"].items()]
    sent = sum(found["packets"]["sent"].values())
    total = f"The arm counts {sum(counts.values()):,} of {sent:,} sent packets: "
    heads = "communication step, ms | largest hub error against Python's loop, rad | ratio to the row above"
    exact = (f"With a communication step of one period ({1e3 * PERIOD:g} ms) the hub angle agrees with Python's loop "
             "within")  # fmt: skip
    return {
        "bits": table("arm | periods | compared numbers | differing numbers", bits),
        "steps": table(
            "arm | scheduling | wall time, µs | processor time, µs | allocations | page faults | episodes that ended "
                "early", steps,
        ),
        "units": table("unit | FMI | FMPy's messages | periods | compared numbers | differing numbers", units),
        "coupled": [
            f"{exact} {found['coupled']['python']:.1e} rad.", "", *table(heads, rows),
        ],
        "packets": [
            total + ", ".join(f"{key} {count:,}" for key, count in counts.items()) + ".", "",
            *table("kind of packet sent | number", told),
        ],
    }  # fmt: skip


if __name__ == "__main__":
    sys.exit(pages.run("doors", __doc__, measure, blocks, packages=("fmpy",), periods=100_000))
