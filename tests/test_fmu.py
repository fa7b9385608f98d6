"""Arms as functional mock-up units, by the standard's own functions: the bits of Python, states, refusals."""

import ctypes
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import gymnasium as gym
import numpy as np
import pytest

from flexarm_env import control
from flexarm_env.cli import main
from flexarm_env.compiler import UNCOMPILED
from flexarm_env.library import build, fmu, write_controller_fmu, write_fmu
from flexarm_env.library.fmu import FORMS
from flexarm_env.library.source import Source
from flexarm_env.physics.layout import SPACE_POSE
from tests.c_tools import needs_c
from tests.refusals import refuses

Array = np.ndarray[Any, Any]


WALL: dict[str, Any] = {
    "obstacle": {"shape": "half_space", "point": [0.0, 0.4], "normal": [0.0, -1.0]}, "stiffness": 1e4, "damping": 0.3,
    "friction": 0.3,
}  # fmt: skip


MOVING = {**WALL, "displacement_y": {"kind": "sine", "amplitude": 0.1, "omega": 6.0}, "bodies": ["link0@0.5", "tip"]}


class Unit:
    """A unit that a file holds, called as an importing tool does."""

    def __init__(self, path: Path, folder: Path, form: str) -> None:
        with zipfile.ZipFile(path) as file:
            file.extractall(folder)
        self.form, self.tree = form[0], ElementTree.parse(folder / "modelDescription.xml").getroot()
        name = str(self.tree.attrib["modelName"])
        self.code = ctypes.CDLL(str(folder / "binaries" / FORMS[form] / f"{name}.so"))
        variables = self.tree.findall("ModelVariables/*")
        self.places = {one.attrib["name"]: int(one.attrib["valueReference"]) for one in variables}
        self.said: list[str] = []

        def listen(*items: Any) -> None:
            self.said.append(items[-1].decode())

        void, text, whole = ctypes.c_void_p, ctypes.c_char_p, ctypes.c_int
        token = self.tree.attrib["instantiationToken" if form == "3.0" else "guid"].encode()
        if form == "3.0":
            self._listen = ctypes.CFUNCTYPE(None, void, whole, text, text)(listen)
            make = self.code.fmi3InstantiateCoSimulation
            items = (b"arm", token, None, *[ctypes.c_ubyte(0)] * 4, None, ctypes.c_size_t(0), None, self._listen, None)
        else:
            self._listen = ctypes.CFUNCTYPE(None, void, text, whole, text, text, text)(listen)
            self._calls = (void * 5)(ctypes.cast(self._listen, void).value, None, None, None, None)
            make = self.code.fmi2Instantiate
            items = (b"arm", 1, token, None, self._calls, 0, 0)
        make.restype = void
        self.at = ctypes.c_void_p(make(*items))
        assert self.at.value
        assert not make(b"arm", *((b"x",) if form == "3.0" else (1, b"x")), *items[2 if form == "3.0" else 3 :])
        assert "not that of this unit's modelDescription.xml" in self.said[-1]
        unnamed = make(None, *items[1:])
        assert unnamed
        getattr(self.code, f"fmi{self.form}FreeInstance")(ctypes.c_void_p(unnamed))

    def __call__(self, word: str, *items: Any) -> int:
        return int(getattr(self.code, f"fmi{self.form}{word}")(self.at, *items))

    def _values(self, word: str, names: Sequence[str], values: Array) -> int:
        which = (ctypes.c_uint32 * len(names))(*[self.places[name] for name in names])
        count = ctypes.c_size_t(len(names))
        more = (count,) if self.form == "3" else ()
        kind = "Float64" if self.form == "3" else "Real"
        return self(f"{word}{kind}", which, count, values.ctypes.data_as(ctypes.c_void_p), *more)

    def get(self, *names: str) -> Array:
        values = np.zeros(len(names))
        assert self._values("Get", names, values) == 0
        return values

    def set(self, **values: float) -> int:
        names = [word.replace("__", "[") + "]" if "__" in word else word for word in values]
        return self._values("Set", names, np.array(list(values.values()), np.float64))

    def start(self, at: float = 0.0) -> int:
        if self.form == "3":
            none, zero = ctypes.c_ubyte(0), ctypes.c_double(0.0)
            assert self("EnterInitializationMode", none, zero, ctypes.c_double(at), none, zero) == 0
        else:
            assert self("SetupExperiment", 0, ctypes.c_double(0.0), ctypes.c_double(at), 0, ctypes.c_double(0.0)) == 0
            assert self("EnterInitializationMode") == 0
        return self("ExitInitializationMode")

    def step(self, at: float, length: float) -> int:
        items: tuple[Any, ...] = (ctypes.c_double(at), ctypes.c_double(length), ctypes.c_ubyte(0))
        if self.form == "3":
            flags = (ctypes.c_ubyte * 3)()
            places = [ctypes.byref(flags, k) for k in range(3)]
            items += (*places, ctypes.byref(ctypes.c_double()))
        return self("DoStep", *items)

    def state(self) -> ctypes.c_void_p:
        kept = ctypes.c_void_p()
        assert self("GetFMUState" if self.form == "3" else "GetFMUstate", ctypes.byref(kept)) == 0
        return kept


@pytest.mark.slow
@needs_c
@pytest.mark.parametrize(
    ("form", "contacts"),
    [
        *((form, None) for form in FORMS),
        pytest.param("3.0", WALL, id="3.0, touches"),
        pytest.param("3.0", MOVING, id="3.0, touched by a moving wall"),
    ],
)
def test_unit(form: str, contacts: dict[str, Any] | None, tmp_path: Path) -> None:
    env = gym.make("FlexibleArm-v0", info_level="full", duration=1000.0, contacts=contacts)
    write_fmu(env, tmp_path / "arm.fmu", "arm", form)
    unit, rng = Unit(tmp_path / "arm.fmu", tmp_path / "unit", form), np.random.default_rng(1)
    outputs = [one.attrib["name"] for one in unit.tree.findall(".//*[@causality='output']")]
    if form == "3.0":
        listed = [int(one.attrib["valueReference"]) for one in unit.tree.findall("ModelStructure/Output")]
    else:
        listed = [int(one.attrib["index"]) - 1 for one in unit.tree.findall("ModelStructure/Outputs/Unknown")]
    assert [unit.places[name] for name in outputs] == listed and len(listed) > 20

    assert unit.set(start_angle__0=0.4, target__0=0.9) == 0 and unit.start() == 0
    env.reset(seed=0, options={"start": 0.4, "target": 0.9})
    names = ["tip[0]", "tip[1]", "deflection[0]", "energy.strain", "energy.work", "applied_torque[0]"]
    told = ("tip_position", "tip_deflection", "energy_strain", "work", "joint_torque")
    limit, at, touched = env.unwrapped.plan.arm.torque_limits[0], 0.0, 0
    for _ in range(200):
        action = np.float32(rng.uniform(-0.6, 0.6))
        info = env.step(np.array([action]))[-1]
        touched += info.get("contact_force", 0.0) > 0.0
        assert unit.set(torque__0=float(action) * limit) == 0 and unit.step(at, 0.02) == 0
        at += 0.02
        assert np.array_equal(unit.get(*names), np.concatenate([np.ravel(info[word]) for word in told]))
    assert abs(unit.get("time")[0] - at) < 1e-9
    assert (touched > 0) == (contacts is not None)

    kept = unit.state()
    assert unit.step(at, 0.1) == 0  # five periods
    once = unit.get(*outputs)
    assert unit("SetFMUState" if form == "3.0" else "SetFMUstate", kept) == 0
    for k in range(5):
        assert unit.step(at + 0.02 * k, 0.02) == 0
    assert np.array_equal(unit.get(*outputs), once)

    assert unit.step(0.0, 0.02) == 3 and "communication point" in unit.said[-1]
    at = unit.get("time")[0]
    assert unit.step(at, 0.013) == 3 and "whole number" in unit.said[-1]
    assert unit.set(torque__0=np.nan) == 3 and "torque[0] = nan: must be a number from" in unit.said[-1]
    assert unit.set(EI_factor=0.0) == 3 and "EI_factor = 0: must be a number from 1e-30 to" in unit.said[-1]
    assert unit.set(start_angle__0=1.0) == 3 and "before it starts" in unit.said[-1]
    assert unit.set(payload_mass=0.3, torque_factor=0.5) == 0 and unit.get("payload_mass")[0] == 0.3
    assert unit.set(torque__0=0.3) == 0 and unit.step(at, 0.02) == 0
    assert unit.get("applied_torque[0]")[0] == 0.15
    assert unit("Reset") == 0 and unit.set(EI_factor=0.8) == 0 and unit.start(7.0) == 0
    assert unit.get("time")[0] == 7.0 and unit.step(7.0, 0.02) == 0 and unit.get("EI_factor")[0] == 0.8
    assert unit("Reset") == 0
    enemy(unit, {"target[0]": 1e300, "start_angle[0]": -1e7, "start_vibration": 0.1, "payload_mass": -1.0})
    getattr(unit.code, f"fmi{unit.form}FreeInstance")(unit.at)
    env.close()


def enemy(unit: Unit, wrong: dict[str, float]) -> None:
    """Calls out of order, values out of range, steps without end, damaged states: an error and a sentence, no more."""

    def refuses(status: int, words: str) -> None:
        assert status == 3 and words in unit.said[-1]

    for name, value in wrong.items():
        refuses(unit.set(**{name: value}), f"{name} = {value:g}: must be a number from")
    for at in (np.nan, np.inf, 1e300):
        with pytest.raises(AssertionError):
            unit.start(at)
        assert "start time" in unit.said[-1]
    refuses(unit.step(0.0, 0.02), "DoStep is for between")
    refuses(unit("ExitInitializationMode"), "after EnterInitializationMode")
    refuses(unit("Terminate"), "after ExitInitializationMode")
    assert unit.start() == 0
    refuses(unit("ExitInitializationMode"), "after EnterInitializationMode")
    for length in (np.inf, np.nan, 1e300, 1e9, 0.0, -0.02):
        refuses(unit.step(0.0, length), "a million at most")
    for at in (np.nan, np.inf):
        refuses(unit.step(at, 0.02), "communication point")
    states = "FMUState" if unit.form == "3" else "FMUstate"
    kept, size, other = unit.state(), ctypes.c_size_t(), ctypes.c_void_p()
    assert unit(f"Serialized{states}Size", kept, ctypes.byref(size)) == 0
    held = (ctypes.c_ubyte * size.value)()
    assert unit(f"Serialize{states}", kept, held, size) == 0
    held[size.value // 2] ^= 1
    read = "DeserializeFMUState" if unit.form == "3" else "DeSerializeFMUstate"
    refuses(unit(read, held, size, ctypes.byref(other)), "a damaged one")
    refuses(unit(f"Set{states}", None), "a damaged one")
    refuses(unit("GetString", None, ctypes.c_size_t(0), None), "GetString is not there")
    assert unit.step(0.0, 0.02) == 0 and unit("Terminate") == 0
    refuses(unit.step(0.02, 0.02), "DoStep is for between")
    refuses(unit.set(**dict.fromkeys(wrong, 0.0)), "after Terminate")
    at, unit.at = unit.at, ctypes.c_void_p()
    assert unit.step(0.0, 0.02) == unit("Reset") == unit(f"Set{states}", kept) == 3  # of no unit
    unit.at = at


def test_outputs_of_two_links_are_where_they_lie() -> None:
    """Each joint's and each link's number by its own name; bits are compared where FMPy is (`make test-fmi`)."""
    env: Any = gym.make("TwoLinkFlexArm-v0").unwrapped
    source = Source(env, "arm", (), None, "", (), "")
    found = {one.name: one.at for one in fmu._variables(source, env.plan) if one.kind == "INFO"}
    at = env.batch.info_at
    wanted = {"tip[1]": at.tip + 1, "deflection[1]": at.deflection + 1, "applied_torque[1]": at.torque + 1}
    wanted["energy.strain"] = at.energies + 1
    assert {name: found[name] for name in wanted} == wanted


@pytest.mark.slow
def test_units_are_defined() -> None:
    env: Any = gym.make("FlexibleArm-v0", arm="strip_geared").unwrapped
    found = list(fmu._variables(Source(env, "arm", (), None, "", (), ""), env.plan))
    assert {"stiffness[0]", "rotor[0]", "coulomb[0]", "torque_factor"} <= {one.name for one in found}
    assert {one.unit for one in found} <= {"", *fmu.UNITS}


def test_variables_of_an_arm_in_space() -> None:
    """Three components, both planes, a target by joint angles; what its programs do not read is not there."""
    env: Any = gym.make("SpatialFlexArm-v0").unwrapped
    source = Source(env, "arm", (), None, "", (), "")
    found = {one.name: (one.kind, one.at, one.unit) for one in fmu._variables(source, env.plan)}
    at, posed = env.batch.info_at, SPACE_POSE
    assert found["tip[2]"] == ("INFO", at.tip + 2, "m") and found["deflection[1,2]"] == ("INFO", at.deflection + 5, "")
    assert found["twist[1]"][1] == at.twist + 1 and found["energy.work"][1] == at.energies + 4
    assert found["link[2].axes[1,0]"] == ("POSE", 2 * posed.end + posed.axes + 3, "")
    assert found["link[1].rate"] == ("POSE", posed.end + posed.rate, "rad/s")
    assert found["target[2]"] == ("TARGET", 2, "rad") and found["payload_mass"][2] == "kg"
    assert found["payload_inertia"][2] == "" and "observation.twist_2" in found


def coupled(arm: Unit, controller: Unit, period: float, length: float, seconds: float) -> Array:
    """Where the hub is after each 0.08 s, the controller stepped before the arm; units as just begun."""
    names = [name for name in controller.places if name.startswith("observation")]
    angles = []
    for k in range(round(seconds / length)):
        at = k * length
        assert controller.set(**dict(zip(names, arm.get(*names).tolist(), strict=True))) == 0
        assert controller.step(at, length) == 0
        assert arm.set(torque__0=float(controller.get("torque[0]")[0])) == 0 and arm.step(at, length) == 0
        if abs((at + length) / 0.08 - round((at + length) / 0.08)) < 1e-6:
            angles.append(arm.get("link[0].root_angle")[0])
    return np.array(angles)


@needs_c
@pytest.mark.parametrize("form", ["3.0", pytest.param("2.0", marks=pytest.mark.slow)])
def test_an_arm_and_its_controller_are_two_units(form: str, tmp_path: Path) -> None:
    """Over communication steps of one period they are Python's closed loop; longer steps err by their length."""
    period, seconds = 0.00125, 0.8
    env: Any = gym.make("FlexibleArm-v0", control_dt=period, dt=period, duration=1000.0)
    own = control.make("pd", env)
    write_fmu(env, tmp_path / "arm.fmu", "arm", form)
    write_controller_fmu(own, tmp_path / "pd.fmu", "pd", form)
    arm, controller = (Unit(tmp_path / f"{name}.fmu", tmp_path / name, form) for name in ("arm", "pd"))
    found = {}
    for many in (1, 2, 4, 8):
        for unit in (arm, controller):
            assert unit("Reset") == 0
        assert arm.set(start_angle__0=0.0, target__0=0.8) == 0 and arm.start() == 0 and controller.start() == 0
        found[many] = coupled(arm, controller, period, many * period, seconds)
    seen, _ = env.reset(options={"start": 0.0, "target": 0.8, "vibration": 0.0})
    own.reset(seen)
    wanted = []
    for k in range(round(seconds / period)):
        seen = env.step(own.act(seen))[0]
        if (k + 1) % 64 == 0:
            wanted.append(env.unwrapped.batch.poses(0)[0, 2])
    assert abs(found[1] - wanted).max() < 1e-5
    errors = [float(abs(found[many] - found[1]).max()) for many in (2, 4, 8)]
    assert errors[0] > 1e-5 and 2.5 < errors[1] / errors[0] < 3.5 and 2.0 < errors[2] / errors[1] < 2.7

    controller.set(**{"observation.hub_sin": 0.1})
    kept, at = controller.state(), controller.get("time")[0]
    assert controller.step(at, period) == 0
    once = controller.get("torque[0]", "time").tolist()
    assert controller("SetFMUState" if form == "3.0" else "SetFMUstate", kept) == 0
    assert controller.step(at, period) == 0 and controller.get("torque[0]", "time").tolist() == once
    assert controller.step(0.0, period) == 3 and "communication point" in controller.said[-1]
    assert controller.set(**{"observation.hub_sin": np.inf}) == 3 and "hub_sin = inf" in controller.said[-1]
    assert controller.set(torque__0=1.0) == 3 and "cannot be set" in controller.said[-1]
    env.close()


@pytest.mark.slow
@needs_c
def test_shaped_commands_drive_an_arm_in_space(tmp_path: Path) -> None:
    """Python's closed loop, to a target that is held; from the same start to another, the loop to what is nearest."""
    env: Any = gym.make("SpatialFlexArm-v0")
    own: Any = control.make("zv", env)
    start = {"start": [0.0, 0.0, 0.0], "target": [0.5, -0.4, 0.6]}
    held = own.targets(own.read(env.reset(options=start)[0]))[0]
    write_controller_fmu(own, tmp_path / "zv.fmu", "zv", targets=[(-0.5, 0.2, 0.6), held])
    unit = Unit(tmp_path / "zv.fmu", tmp_path / "zv", "3.0")
    names = [f"observation.{name}" for name in own.setup.names]

    def driven(by_unit: bool, target: list[float]) -> list[Array]:
        seen, _ = env.reset(seed=0, options=start | {"target": target})
        assert unit("Reset") == 0 and unit.start() == 0
        own.reset(seen)
        tips = []
        for k in range(200):
            action = own.act(seen)
            if by_unit:
                assert unit.set(**dict(zip(names, seen.tolist(), strict=True))) == 0 and unit.step(0.01 * k, 0.01) == 0
                action = unit.get(*[f"torque[{j}]" for j in range(3)]) / own.limits
            seen, *_, info = env.step(action.astype(np.float32))
            tips.append(info["tip_position"])
        return tips

    wanted, found, beside = (driven(*one) for one in ((False, held), (True, held), (True, [0.52, -0.38, 0.58])))
    assert np.abs(np.subtract(found, wanted)).max() < 1e-6
    assert np.linalg.norm(wanted[-1] - held) < 0.01 and np.linalg.norm(beside[-1] - held) < 0.01
    env.close()


@needs_c
def test_command_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "strip.fmu"
    assert main(["export", "strip", "--to", "fmu", "--out", str(out), "--fmi", "2.0"]) == 0
    assert zipfile.is_zipfile(out) and str(out) in capsys.readouterr().out
    assert main(["export", "pd", "--env", "FlexibleArm-v0", "--to", "fmu", "--out", str(tmp_path / "pd.fmu")]) == 0
    assert zipfile.is_zipfile(tmp_path / "pd.fmu") and "pd.fmu" in capsys.readouterr().out


def test_refusals(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    env = gym.make("FlexibleArm-v0")
    refuses(r"form = '1\.0': must be 2\.0 or 3\.0", lambda: write_fmu(env, tmp_path / "x.fmu", "x", "1.0"))
    if not UNCOMPILED:
        monkeypatch.setattr(build.shutil, "which", lambda word: None)
        refuses("no C compiler", lambda: write_fmu(env, tmp_path / "x.fmu", "x"))
    assert not list(tmp_path.iterdir())
