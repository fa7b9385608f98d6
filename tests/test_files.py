"""Files that users give: a good object or a sentence that names the file, whatever is in them; counted by kind."""

import ast
import copy
import dataclasses
import gzip
import io
import json
import re
import shutil
import sys
import tomllib
import traceback
import warnings
import zipfile
from collections import Counter
from collections.abc import Callable, Iterator
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w

import flexarm_env
from flexarm_env import Trajectory, arms, control, scenes, time_functions
from flexarm_env.cli.parser import build_parser
from flexarm_env.cli.view import _kind, _shared
from flexarm_env.files import read_npz
from flexarm_env.identification import randomization
from flexarm_env.identification.config import read_config
from flexarm_env.identification.log import read_run
from flexarm_env.parameters import Arm
from flexarm_env.physics.assembly import assemble
from flexarm_env.physics.space.reading import read
from flexarm_env.recording import Episode, load_episodes, save_episodes
from flexarm_env.remote.client import Played
from flexarm_env.scene import Scene
from flexarm_env.suite import results
from flexarm_env.suite.data import tasks
from flexarm_env.suite.policies import choose
from flexarm_env.view import Player
from tests.cli_tools import refused
from tests.processes import python
from tests.refusals import says

BIG = 10**400
NASTY: tuple[Any, ...] = (
    None, True, -1, 0, 0.5, 3, BIG, -BIG, 2**63, float("nan"), float("inf"), 1e300, 1e-300, "", "x", "x\0y", "é" * 300,
    "\n", [], [1.0], [[]], {}, {"a": {"b": 1}}, [{}], ["a", 1, None],
)  # fmt: skip
CELLS = ("", "nan", "inf", "-inf", "1e300", "1e999", "x", "1,2", '"', "0x10", "9" * 5000, "é", "-1", "0", "true", "1_0")
HUGE = (200, 200_000_000)
"""Of 8 bytes each: 298 GiB."""


# --------------------------------------------------------------------------- good files, made without compiling
def trajectory(n: int = 12) -> Trajectory:
    """A run of two links that is none: numbers of the right shapes."""
    rng, scene = np.random.default_rng(0), scenes.named("two_link_motion")
    settings = scene.settings()
    names = assemble(scene, settings).names
    t = np.linspace(0.0, 1.0, n)
    shapes = np.cumsum(rng.uniform(0.0, 0.1, (n, 9, 2)), axis=1)
    row, table, angles = rng.normal(size=(n,)), rng.normal(size=(n, 3)), rng.normal(size=(n, 2))
    q = rng.normal(size=(n, len(names)))
    return Trajectory(
        scene=scene, settings=settings, t=t, start=table, tip=table, tip_velocity=table, hinges=shapes[:, 4:5],
        joint_angles=angles, joint_rates=angles, joint_torque=angles, tip_deflection=angles, kinetic=row,
        strain_energy=row, gravity=row, dissipated=row, work=row, shapes=shapes, q=q, v=q, names=names, status="ok",
        message="it is well", steps=3, iterations=4, factorizations=5, halvings=0, cpu_seconds=0.1,
        notes={"stretch": 1e-3}, motor_angles=angles, motor_rates=angles, link_angles=np.stack([angles] * 2, -1),
    )  # fmt: skip


def episodes() -> list[Episode]:
    """Two that nobody has played."""
    rng, made = np.random.default_rng(0), []
    for k, length in enumerate((3, 5)):
        ends = np.arange(length) == length - 1
        made.append(
            Episode(
                env_id="FlexibleArm-v0", env_kwargs={"duration": 2.0}, max_episode_steps=None, seed=None if k else 7,
                generator=dict(np.random.PCG64(1).state) if k else None, options={"target": 0.5} if k else None,
                observations=rng.normal(size=(length + 1, 6)).astype(np.float32),
                actions=rng.normal(size=(length, 1)).astype(np.float32), rewards=rng.normal(size=length),
                terminations=ends, truncations=np.zeros(length, np.bool_),
                infos={"tip_position": np.zeros((length + 1, 2)), "solver_status": np.array(["ok"] * (length + 1))},
            )
        )  # fmt: skip
    return made


CONFIG = """
time = "t"
skip = 0.01
fit = ["stiffness"]
[inputs]
torque0 = {column = "u", unit = "N m", gain = 2.0, low_pass = 20.0}
[outputs]
hub_angle = {column = "y", unit = "deg", offset = "fit", shift = 0.001}
[parameters]
"links[0].section.EI" = {name = "stiffness", low = 1.0, high = 20.0, prior = [7.0, 1.0]}
[solver]
formulation = "elastica"
"""


def good(folder: Path) -> dict[str, Path]:
    """A good file of each kind."""
    data = resources.files("flexarm_env") / "data"
    made = {name: folder / file for name, file in FILES.items()}
    trajectory(24).to_npz(made["trajectory"])  # so that sensors' kernels read it
    trajectory_in_space().to_npz(made["run in space"])
    save_episodes(made["episodes"], episodes())
    shutil.copyfile(str(data / "policies" / "two_link" / "policy.npz"), made["policy"])
    made["run folder"].parent.mkdir()
    shutil.copyfile(made["policy"], made["run folder"].parent / "policy.npz")
    record = {"algorithm": "ppo", "steps": 1000, "wall_s": 3.0, "cpu_s": 4.0, "env_kwargs": {}}
    made["run folder"].write_text(json.dumps(record))
    for name, file in {
        "arm": "arms/two_link_geared.toml", "scene": "scenes/two_link_free_flight.toml",
        "arm in space": "arms/satellite_arm.toml", "scene in space": "scenes/right_angle_frame.toml",
    }.items():  # fmt: skip
        shutil.copyfile(str(data / file), made[name])
    fitted = {"arm": arms.to_table(arms.named("strip")), "randomization": {"EI": [0.9, 1.1]}}
    made["fitted arm"].write_text(tomli_w.dumps(fitted))
    made["config"].write_text(CONFIG)
    t = np.arange(40) * 0.01
    rows = [
        f"{a!r},{b!r},{c!r}" for a, b, c in zip(t.tolist(), np.sin(9 * t).tolist(), np.cos(t).tolist(), strict=True)
    ]
    made["log"].write_text("\n".join(["t,u,y", *rows]) + "\n")
    made["packed log"].write_bytes(gzip.compress(made["log"].read_bytes()))
    made["torques"].write_text("t,torque0\n" + "".join(f"{0.01 * k!r},{0.1 * k!r}\n" for k in range(9)))
    made["motion"].write_text("t,psi,psi_dot\n" + "".join(f"{k},{k * k},{2 * k}\n" for k in range(9)))
    made["reference"].write_text(",".join(scenes.COLUMNS) + "\n" + "".join(f"{k},1,2,3,4,5,6,7\n" for k in range(9)))
    entry = {
        "digest": tasks()[0].digest, "first_seed": 10_000, "episodes": 2, "returns": [1.0, 2.0], "successes": [1, 0],
        "costs": [0.0, 0.0], "lengths": [5, 6], "wall_s": 1.0, "cpu_s": 1.0, "decision_us": 2.0,
        "policy": {"kind": "policy", "source": "p", "fingerprint": "f"}, "training": record,
    }  # fmt: skip
    content = {"format": 1, "name": "a", "run": 0, "tasks": {tasks()[0].id: entry}, "refused": {}}
    made["results"].write_text(json.dumps(content))
    return made


FILES = {
    "trajectory": "run.npz", "run in space": "space.npz", "episodes": "episodes.npz", "policy": "mine.npz",
    "run folder": "run/run.json", "arm": "arm.toml", "arm in space": "arm_in_space.toml", "fitted arm": "fitted.toml",
    "scene": "scene.toml", "scene in space": "scene_in_space.toml", "config": "config.toml", "log": "log.csv",
    "packed log": "log.csv.gz", "torques": "torques.csv", "motion": "motion.csv", "reference": "reference.csv",
    "results": "results.json",
}  # fmt: skip


def trajectory_in_space(n: int = 6) -> Trajectory:
    """The same of the arm `three_dof`."""
    rng, scene = np.random.default_rng(0), scenes.named("three_dof_slew")
    settings = scene.settings()
    names = assemble(scene, settings).names
    row, joints, q = rng.normal(size=n), rng.normal(size=(n, 3)), rng.normal(size=(n, len(names)))
    return Trajectory(
        scene=scene, settings=settings, t=np.linspace(0.0, 1.0, n), joint_torque=joints, kinetic=row, strain_energy=row,
        gravity=row, dissipated=row, work=row, q=q, v=q, names=names, status="ok", message="it is well", steps=3,
        iterations=4, factorizations=5, halvings=0, cpu_seconds=0.1, **read(scene.arm, settings, q, q),
    )  # fmt: skip


# --------------------------------------------------------------------------- reading, and using what was read
def _shown(path: Path) -> None:
    assert _kind(str(path)) in ("trajectory", "episodes", "player")
    run = Trajectory.from_npz(path)
    Player([run.clip()])


def _acts(path: Path) -> None:
    policy = control.load_policy(path)
    action = policy.act(np.linspace(-1.0, 1.0, 2 * len(policy.weights[0][0])).reshape(2, -1))
    assert np.isfinite(action).all() and np.abs(action).max() <= 1.0


def _replayed(path: Path) -> None:
    for episode in load_episodes(path):
        repr(episode)
        assert len(episode.observations) == len(episode) + 1 == len(next(iter(episode.infos.values()))) >= 2


def _described(path: Path) -> None:
    assert isinstance(arms.from_toml(arms.to_toml(arms.from_toml(path))), Arm)


def _told(path: Path) -> None:
    scene = Scene.from_toml(path)
    assert Scene.from_toml(scene.to_toml()) == scene


def _configured(path: Path) -> None:
    repr(read_config(path, arms.named("strip")))


def _logged(path: Path) -> None:
    run = read_run(path, read_config(CONFIG, arms.named("strip")))
    assert all(np.isfinite(x).all() for x in (run.t, *run.inputs.values(), *run.outputs.values()))
    assert run.period > 0.0


READERS: dict[str, Callable[[Path], Any]] = {
    "trajectory": _shown, "episodes": _replayed, "policy": _acts, "arm": _described, "scene": _told,
    "run folder": lambda path: repr(choose(str(path.parent), tasks()[0]).training),
    "fitted arm": lambda path: (arms.from_toml(path), randomization(path)), "config": _configured, "log": _logged,
    "run in space": lambda path: Trajectory.from_npz(path).columns(), "arm in space": _described,
    "scene in space": _told, "torques": lambda path: Played(path, 0.01, np.ones(1)),
    "packed log": _logged, "motion": lambda path: time_functions.from_csv(path)(np.linspace(0.0, 9.0, 5)),
    "reference": lambda path: (scenes.read_trajectory(path), scenes.read_reference(path)), "results": results.read,
}  # fmt: skip


# --------------------------------------------------------------------------- what is done to them
def bytes_of(path: Path, other: bytes) -> Iterator[bytes]:
    """Of every kind of file: another kind's, empty, cut short, torn, text and none."""
    whole, rng = path.read_bytes(), np.random.default_rng(len(path.name))
    yield from (b"", b"\0", b"hello\n", other, whole + whole, whole[::-1], b"PK\3\4 torn", b"\xef\xbb\xbf" + whole)
    yield from (whole.replace(b"\n", b"\r\n"), "a = 1\n".encode("utf-16"), b"\xff" + whole, b"\x1f\x8b\x08" + whole)
    yield from (b"[" * 100_000, b'{"a":' * 100_000, b"x = " + b"[" * 100_000, b"a" + b".a" * 3000 + b" = 1\n")
    yield from (whole[: len(whole) * k // 7] for k in range(1, 7))
    yield from (whole[:-k] for k in (1, 22, 100))
    for _ in range(12):
        torn = bytearray(whole)
        for at in rng.integers(len(torn), size=3):
            torn[at] ^= int(rng.integers(1, 256))
        yield bytes(torn)
    empty = io.BytesIO()
    zipfile.ZipFile(empty, "w").close()
    yield empty.getvalue()


def header(shape: tuple[int, ...] | str, descr: str = "'<f8'") -> bytes:
    """What stands before the numbers of an array, as NumPy writes it."""
    text = f"{{'descr': {descr}, 'fortran_order': False, 'shape': {shape}, }}\n"
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text.encode()


def member(values: np.ndarray) -> bytes:
    """An array as a file of its own."""
    out = io.BytesIO()
    np.lib.format.write_array(out, np.asanyarray(values), allow_pickle=True)
    return out.getvalue()


def archive(entries: dict[str, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip of these."""
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", method, compresslevel=1) as file:
        for name, content in entries.items():
            file.writestr(name, content)
    return out.getvalue()


def arrays_of(path: Path) -> Iterator[bytes]:
    """An archive with each of its arrays in turn cut, grown, cast, not finite, of another header."""
    with zipfile.ZipFile(path) as file:
        whole = {name: file.read(name) for name in file.namelist()}
    for name, content in whole.items():
        values = np.load(io.BytesIO(content))
        for changed in (*forms(values), *(json_forms(values) if values.dtype.kind == "U" and not values.ndim else ())):
            yield archive({**whole, name: member(changed)})
        raw = content[content.index(b"\n") + 1 :]
        for head in (
            header(HUGE), header((10**17,)), header("(" * 3000 + ")" * 3000), header("(3, -4)"), header("9" * 5000),
            header((2, 2), "'|O'"), header((4,), "[('a', '<f8')]"), header((4,), "'<f7'"), header((0, 10**17)),
            header((1,) * 70), header((), "'<U9'"), header("__import__('os').getpid()"), b"\x93NUMPY\x09\x00", b"",
        ):  # fmt: skip
            yield archive({**whole, name: head + raw})
        yield archive({key: value for key, value in whole.items() if key != name})
    yield archive(whole, zipfile.ZIP_STORED)
    yield archive(whole, zipfile.ZIP_BZIP2)
    yield archive({**whole, "policy.pth": b"a pickle"})
    locked = bytearray(archive(whole))
    at = locked.index(b"PK\1\2")
    locked[at + 8] |= 1  # encrypted, says the directory
    yield bytes(locked)


def forms(values: np.ndarray) -> Iterator[np.ndarray]:
    """An array in other forms."""
    yield from (values[None], values.ravel()[:1], np.zeros((3, 3, 3)), np.float64(3.0), np.array("x"))
    yield from (np.array([None]), np.array({"a": 1}), values.astype("U9"), values.astype("S9"))
    if values.ndim:
        yield from (
            values[:2],
            values[..., :0],
            values[: len(values) // 2],
            values[:-1],
            np.concatenate([values, values[-1:]]),
        )
        yield from (np.concatenate([values, values]), np.asfortranarray(values), values[..., :-1], values.T)
    if values.dtype.kind in "fiub":
        numbers, whole = values.astype(np.float64), np.nan_to_num(values).astype(np.int64)
        yield from (numbers * np.nan, numbers + np.inf, numbers + 1e300, -numbers, numbers * 0.0, numbers.round())
        yield from (
            whole,
            numbers.astype(">f4"),
            numbers.astype(np.float16),
            numbers + 1j,
            numbers > 0.0,
            numbers - 5e17,
        )
        if numbers.size:
            one = numbers.copy()
            one.flat[-1] = np.nan
            yield one


def json_forms(text: np.ndarray) -> Iterator[np.ndarray]:
    """Text in an archive: of a JSON table every value in turn another."""
    content = str(text)
    yield from (np.array(content[: len(content) // 2]), np.array("[" * 50_000), np.array('{"a":' * 50_000))
    yield from (np.array("[]"), np.array("3"), np.array("\ud800"))
    try:
        table = json.loads(content)
    except ValueError:
        return
    for changed in tables(table):
        yield np.array(json.dumps(changed))


def tables(table: Any) -> Iterator[Any]:
    """A table with every value in it in turn another, or left out."""

    def places(inner: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
        for key, value in inner.items() if isinstance(inner, dict) else enumerate(inner[:2]):
            yield (*path, key)
            if isinstance(value, dict | list):
                yield from places(value, (*path, key))

    for k, path in enumerate(places(table)):
        for i, value in enumerate((*NASTY, "gone")):
            if len(path) > 2 and (i + k) % 5:  # of what lies deep every fifth
                continue
            changed = copy.deepcopy(table)
            inner = changed
            for key in path[:-1]:
                inner = inner[key]
            if value == "gone":
                del inner[path[-1]]
            else:
                inner[path[-1]] = value
            yield changed


def toml_forms(path: Path) -> Iterator[bytes]:
    """A TOML file with every value in turn another."""
    for k, table in enumerate(tables(tomllib.loads(path.read_text("utf-8")))):
        try:
            text = tomli_w.dumps(table)
        except (TypeError, ValueError):  # TOML knows no None
            continue
        yield (text if k % 50 else f"deep = {'[' * 5000}{']' * 5000}\nlong = 0x{'f' * 5000}\n{text}").encode()


def csv_forms(path: Path) -> Iterator[bytes]:
    """A CSV file with a cell in turn another, rows and columns cut or twice."""
    packed = path.name.endswith(".gz")
    text = (gzip.decompress(path.read_bytes()) if packed else path.read_bytes()).decode()
    lines = text.splitlines()

    def made(rows: list[str]) -> bytes:
        return gzip.compress("\n".join(rows).encode()) if packed else "\n".join(rows).encode()

    for cell in CELLS:
        for at in (0, 1, 5, len(lines) - 1):
            for column in (0, 1):
                cells = lines[at].split(",")
                cells[column] = cell
                yield made([*lines[:at], ",".join(cells), *lines[at + 1 :]])
    yield from (made(lines[:k]) for k in (0, 1, 2, 3))
    yield from (made([lines[0], *lines[:0:-1]]), made(lines + lines), made([line.partition(",")[2] for line in lines]))
    for factor in (1e-320, 1e-30, 1e30, 1e300):
        scaled = [",".join(repr(factor * float(c)) for c in line.split(",")) for line in lines[1:]]
        yield made([lines[0], *scaled])


def changed(path: Path, other: bytes) -> Iterator[bytes]:
    """All that is done to a file."""
    yield from bytes_of(path, other)
    if path.suffix == ".npz":
        yield from arrays_of(path)
    elif path.suffix == ".toml":
        yield from toml_forms(path)
    elif path.suffix in (".csv", ".gz"):
        yield from csv_forms(path)
    else:
        yield from (json.dumps(table).encode() for table in tables(json.loads(path.read_text("utf-8"))))


# --------------------------------------------------------------------------- the tests
FORBIDDEN = re.compile(r"pickle|unsafe|allow_|Traceback|flexarm_env/")


def outcome(kind: str, path: Path) -> str:
    """ "good", or "refused" in the package's own kind of sentence; AssertionError for all else."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            READERS[kind](path)
            return "good"
        except (ValueError, OSError) as error:
            own = type(error) is ValueError or type(error).__module__.startswith("flexarm_env.")
            own |= isinstance(error, OSError) and error.filename is not None
            text = str(error)
            assert own, f"{type(error).__name__}: {text}"
        except Exception as error:  # whatever it is: it is to be shown
            raise AssertionError("".join(traceback.format_exception(error))[-3000:]) from error
    assert path.name in text or path.parent.name in text, text
    assert not FORBIDDEN.search(text), text
    assert len(text) < 1500, text
    return "refused"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return good(tmp_path_factory.mktemp("good"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", FILES)
def test_whatever_is_in_a_file_it_is_good_or_refused_in_a_sentence(
    kind: str, kept: dict[str, Path], tmp_path: Path
) -> None:
    """All that `changed` does to it; prints what came of it."""
    found: Counter[str] = Counter()
    assert outcome(kind, kept[kind]) == "good"
    shutil.copytree(kept[kind].parent, tmp_path / "in")
    path, other = tmp_path / "in" / kept[kind].name, kept["arm" if kind != "arm" else "log"].read_bytes()
    for k, content in enumerate(changed(kept[kind], other)):
        path.write_bytes(content)
        try:
            found[outcome(kind, path)] += 1
        except AssertionError as error:
            raise AssertionError(f"{kind}, file {k}, {path}: {error}") from error
    print(f"\n{kind}: {found.total()} files, {found['good']} good, {found['refused']} refused")
    assert found["refused"] > 5 or kind == "run folder"  # where training is told, and no more
    assert kind != "trajectory" or found["good"] > 2  # what kernels read, they read no further than arrays reach


@pytest.mark.parametrize(
    ("name", "value", "sentence"),
    [
        ("t", lambda x: x[:2], "shape of start = (12, 3): must be (2, 3), to fit the other arrays"),
        ("t", lambda x: x * np.nan, "t[0] = nan: must be a finite number"),
        ("t", lambda x: -x, "t[1] = -"),
        ("kinetic", lambda x: x[:5], "shape of kinetic = (5,): must be (12,)"),
        ("work", lambda x: np.append(x, 1.0), "shape of work = (13,): must be (12,)"),
        ("joint_torque", lambda x: x[:, :1], "shape of joint_torque = (12, 1): must be (12, 2)"),
        ("tip", lambda x: x.astype("U"), "dtype of tip = '<U32': must be that of numbers"),
    ],
)
def test_no_kernel_gets_a_trajectory_that_does_not_fit(name: str, value: Any, sentence: str) -> None:
    run = trajectory()
    wrong = dataclasses.replace(run, **{name: value(getattr(run, name))})
    for use in (wrong.measured, wrong.clip):
        says(sentence, use)


def test_a_header_that_claims_298_gib_is_refused_before_any_room_is_made(tmp_path: Path) -> None:
    path = tmp_path / "big.npz"
    path.write_bytes(archive({"w0.npy": header(HUGE)}))
    with pytest.raises(
        ValueError, match=r"big\.npz: damaged, .*w0.npy says it is \(200, 200000000\) of float64, 320000"
    ):
        read_npz(path, "policy")


def test_a_policy_that_unpacks_to_hundreds_of_megabytes_is_not_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "bomb.npz"
    path.write_bytes(archive({f"w{k}.npy": bytes(2**24) for k in range(17)}))
    says("unpacks to 285212672 bytes, and no policy has more than 268435456", lambda: control.load_policy(path))


def test_a_header_is_not_evaluated() -> None:
    """It may hold any expression: of those modules that read files none knows how."""
    root = Path(flexarm_env.__file__).parent
    for name in ("files.py", "trajectory/recorded.py", "recording.py", "control/policy.py"):
        calls = {n.attr for n in ast.walk(ast.parse((root / name).read_text())) if isinstance(n, ast.Attribute)}
        assert not calls & {"literal_eval", "load", "loadtxt", "genfromtxt"}, name


# --------------------------------------------------------------------------- the command line
def test_view_tells_what_is_wrong_with_a_file(
    kept: dict[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    whole = kept["trajectory"].read_bytes()
    for name, content in (("cut", whole[:900]), ("empty", b""), ("text", b"hello"), ("deep", b"(" * 9999)):
        Path(f"{name}.npz").write_bytes(content)
        told = refused(capsys, "view", f"{name}.npz")
        assert f"{name}.npz: damaged, or no trajectory, episodes or policy of this package (" in told
        assert not FORBIDDEN.search(told)
    shutil.copyfile(kept["reference"], "run.csv")
    assert "(from simulate --out RUN.npz): a .csv file lacks data for the page" in refused(
        capsys, "view", "run.csv"
    )


def test_a_text_with_no_character_and_a_broken_scene_are_refused_by_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """One flipped bit made a text that Python itself cannot print; of a broken scene no file was named."""
    monkeypatch.chdir(tmp_path)
    run = trajectory()
    run.to_npz(tmp_path / "good.npz")
    with zipfile.ZipFile("good.npz") as whole:
        members = {name: whole.read(name) for name in whole.namelist()}
    scene = members["scene.npy"]
    at = len(scene) - 4 * 40
    flipped = bytearray(scene)
    flipped[at + 2] ^= 0x20  # of a character's four bytes the third: beyond the last one that there is
    broken = scene[:at] + "[[[\n".encode("utf-32-le") + scene[at + 16 :]
    for name, content, sentence in (
        ("flipped", bytes(flipped), "flipped.npz: damaged, or no trajectory of this package (scene.npy contains "),
        ("broken", broken, "broken.npz: scene: not a TOML file: "),
    ):
        Path(f"{name}.npz").write_bytes(archive(members | {"scene.npy": content}))
        assert sentence in refused(capsys, "view", f"{name}.npz")


def test_a_zip_that_is_no_model_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("model.zip").write_bytes(archive({"data": b"{}", "policy.pth": b""}))
    for words in (
        ("bench", "suite", "--task", tasks()[0].id, "--policy"),
        ("view",),
        ("play", "--headless", "--policy"),
    ):
        told = refused(capsys, *words, "model.zip")
        assert "model.zip: no model of Stable-Baselines3 that can be read" in told


def test_a_policy_is_known_by_what_it_holds(kept: dict[str, Path]) -> None:
    """And not by its file's name: a page of it alone is played in its own environment."""
    words = [str(kept["policy"])]
    args = build_parser().parse_args(["view", *words])
    assert _shared(args, [_kind(word) for word in words], 0)["env"] == "TwoLinkFlexArm-v0"


FULL = """
import resource, signal, sys
from flexarm_env.files import write_whole
from flexarm_env.view import Player
from tests.test_files import trajectory
from pathlib import Path
player = Player([trajectory().clip()])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
for path in ("page.html", "/proc/page.html"):
    try:
        player.save(path)
    except OSError as error:
        print(error.filename, "|", error.strerror, "|", *(p.name for p in Path().iterdir()))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the size of files as Linux does")
def test_a_page_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    done = python("-c", FULL, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    full, proc = done.stdout.splitlines()
    assert full == "page.html | File too large |"
    assert proc.startswith("/proc/page.html | ")


# --------------------------------------------------------------------------- numbers that no float holds
def test_numbers_of_no_use_are_refused_without_a_warning(tmp_path: Path) -> None:
    strip = arms.named("strip")
    link = strip.links[0]
    wrong: list[tuple[Callable[[], Any], str]] = [
        (lambda: dataclasses.replace(strip, torque_limits=(1e300,)), "torque_limits[0] = 1e+300"),
        (lambda: dataclasses.replace(link, length=1e300), "length = 1e+300: must be at least 1e-09 and at most 1e+09"),
        (lambda: dataclasses.replace(link, length=1e-300), "length = 1e-300"),
        (lambda: dataclasses.replace(link.section, EI=BIG), "EI = 1000"),
        (lambda: time_functions.table(t=[0.0, 1e300], psi=[0.0, 1.0]), "t[1] = 1e+300"),
        (lambda: time_functions.TimeFunction([[BIG] * 8]), "pieces"),  # type: ignore[arg-type]
        (lambda: time_functions.table(t=[0, 1, 2, 1e20], psi=[0, 1, 0, 1], interpolation="spline"), "for a spline"),
        (lambda: flexarm_env.simulate(scenes.named("spin_up"), duration=1e-12), "duration = 1e-12"),
        (lambda: flexarm_env.simulate(scenes.named("spin_up"), dt=1e-12), "dt = 1e-12: must be at least 2e-08 s"),
        (lambda: Scene.from_toml(f"name = 'a'\narm = 'strip'\ndt = 1\nduration = 0x{'f' * 5000}\n"), "many digits"),
        (lambda: Scene.from_toml(f"x = {'[' * 9999}{']' * 9999}\n"), "nested more than 64 deep"),
        (lambda: Scene.from_toml(f"a{'.a' * 3000} = 1\n"), "nested more than 64 deep"),
    ]  # fmt: skip
    for make, sentence in wrong:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            says(sentence, make)
