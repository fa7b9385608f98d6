"""The house's rules, held by a walk over the syntax trees.

ROOMS says which room of the package may import which. A room is a module or a subpackage directly under
`flexarm_env`; a new one has to be declared here.
"""

from __future__ import annotations

import ast
import json
import re
import shutil
import subprocess
from collections import Counter
from collections.abc import Iterator
from importlib.util import resolve_name
from inspect import signature
from pathlib import Path
from typing import Any

import gymnasium as gym
import pytest

from flexarm_env import suite
from flexarm_env.physics import contributions, protocol
from tests.processes import ROOT, python

PACKAGE = "flexarm_env"

# ------------------------------------------------------------------ the table
_BASICS = {
    "validation", "records", "curves", "meshing", "rotations", "sections", "bodies", "parameters", "sensors", "rigid",
    "settings", "files", "time_functions",
}  # fmt: skip
_DESCRIPTION = {*_BASICS, "arms", "scene", "scenes", "shapes"}
_COMPILED = {"compiler", "physics", "runtime", "tasks"}
_PHYSICS = {
    *_DESCRIPTION, "physics", "geometry", "trajectory", "accuracy", "accuracy_space", "simulation", "batch",
    "equations", "linear",
}  # fmt: skip
_PUBLIC = {
    *_PHYSICS - {"physics"}, "around", "comparison", "control", "derivatives", "envs", "episodes", "exchange",
    "goals", "identification", "library", "plotting", "recording", "remote", "sb3", "suite", "torch", "training",
    "view", "__init__",
}  # fmt: skip

# room -> rooms it may import, apart from itself ("__init__" is the bare package: its version and public names)
ROOMS: dict[str, set[str]] = {
    "validation": set(),
    "records": {"validation"},
    "curves": {"validation"},
    "meshing": {"validation"},
    "sections": {"validation", "records", "curves", "meshing"},
    "rotations": {"validation"},
    "bodies": {"validation", "records", "rotations", "sections"},
    "sensors": {"validation", "records", "bodies"},
    "shapes": {"validation", "bodies"},
    "parameters": {"validation", "records", "sections", "bodies", "sensors"},
    "rigid": {"validation", "curves", "rotations", "sections", "bodies", "parameters"},
    "settings": {"validation", "records"},
    "files": {"validation"},
    "time_functions": {"validation", "files"},
    "arms": {"validation", "records", "files", "bodies", "sections", "parameters", "sensors"},
    "scene": {
        "validation",
        "records",
        "files",
        "curves",
        "meshing",
        "bodies",
        "sections",
        "parameters",
        "settings",
        "time_functions",
        "arms",
        "shapes",
    },
    "scenes": {"validation", "parameters", "settings", "files", "scene", "arms"},
    "data": set(),
    "compiler": set(),
    "layout": set(),
    "physics": {*_DESCRIPTION, "compiler", "layout"},
    "tasks": {"compiler", "layout", "physics"},
    "runtime": {"compiler", "layout", "physics", "tasks"},
    "view": {*_DESCRIPTION, "geometry", "physics"},
    "geometry": {*_DESCRIPTION, "physics", "tasks"},
    "trajectory": {*_DESCRIPTION, "geometry", "physics", "runtime", "view"},
    "accuracy": {*_DESCRIPTION, "accuracy_space"},
    "accuracy_space": {*_DESCRIPTION},
    "rest": {"validation", "compiler", "physics", "scene", "settings", "time_functions"},
    "simulation": {*_DESCRIPTION, *_COMPILED, "trajectory", "accuracy", "rest"},
    "batch": {*_DESCRIPTION, *_COMPILED, "geometry", "layout", "trajectory", "simulation"},
    "equations": {*_DESCRIPTION, *_COMPILED, "geometry", "simulation"},
    "linear": {*_DESCRIPTION, *_COMPILED, "equations", "geometry", "trajectory", "simulation", "rest"},
    "comparison": {"validation", "accuracy"},
    "derivatives": {*_COMPILED, "batch", "simulation", "trajectory", "validation"},
    "control": {*_PHYSICS, "tasks", "derivatives"},
    "episodes": {"validation", "control"},
    "exchange": {*_DESCRIPTION, "simulation", "linear"},
    "envs": {*_PHYSICS, "compiler", "tasks"},
    "around": {"control"},
    "goals": {"validation"},
    "torch": {"derivatives", "validation"},
    "plotting": {*_PHYSICS, "comparison", "view"},
    "recording": {*_DESCRIPTION, "trajectory", "batch", "envs", "episodes", "view"},
    "sb3": {*_DESCRIPTION, "around", "envs"},
    "suite": {*_DESCRIPTION, "control", "envs", "episodes", "trajectory"},
    "remote": {"validation", "files", "control", "envs"},
    "training": {*_DESCRIPTION, "around", "control", "derivatives", "envs", "episodes", "plotting", "sb3", "suite"},
    "library": {*_DESCRIPTION, *_COMPILED, "layout", "batch", "control", "derivatives"},
    "identification": {*_PHYSICS - {"batch"}, "derivatives", "plotting"},
    "cli": {*_PUBLIC, "data", "compiler"},
    "__main__": {"cli"},
    "__init__": {*_PHYSICS, "control", "envs", "identification", "suite"},
}

_ENTRANCES = {"__init__", "cli"}

# other packages that only some rooms may import, anywhere in their code
EXTERNALS: dict[str, set[str]] = {
    "torch": {"sb3", "torch", "training"},
    "stable_baselines3": {"sb3", "training"},
    "numba": set(),
    "llvmlite": {"compiler"},
    "gymnasium": {
        *_ENTRANCES, "around", "derivatives", "envs", "goals", "recording", "remote", "sb3", "suite", "training",
    },
    "pygame": {"envs"},
    "matplotlib": {"plotting"},
    "minari": {"recording"},
    "onnx": {"control"},
    "onnxruntime": {"control"},
    "mujoco": {"exchange"},
    "ray": set(),
}

# the core: environments, and all rooms that they need
CORE = {
    *_DESCRIPTION, *_COMPILED, "__init__", "accuracy", "accuracy_space", "batch", "data", "envs", "equations",
    "geometry", "layout", "rest", "simulation", "trajectory",
}  # fmt: skip

# methods of the core that need a room beyond it when they are called: clips of runs, linear models of environments
BEYOND_THE_CORE = {("flexarm_env.trajectory.recorded", "view"), ("flexarm_env.envs.states", "linear")}

# code outside of the package uses the public rooms only
OUTSIDE = ("agents", "benchmarks")

# what `import flexarm_env` must not load
HEAVY = {"torch", "stable_baselines3", "pygame", "matplotlib", "scipy", "minari", "moviepy", "ray"}

MAX_LINES = 450

# Compiled code gives the same bits everywhere, and brings its own threads.
FORBIDDEN_KEYWORDS = re.compile(r"\b(?:fastmath|parallel) *= *(?!False\b)\w")

# Addresses of registries and paths of one machine have no place in the repository (split, not to find themselves).
FORBIDDEN_TEXT = re.compile(
    "|".join(
        [
            r"py" r"pi\.(org|python)",
            r"python" r"hosted\.org",
            r"download\.py" r"torch\.org",
            r"anaconda" r"\.org",
            r"registry\.npm" r"js",
            r"deb\.deb" r"ian\.org",
            r"archive\.ub" r"untu\.com",
            r"index" r"-url",
            r"(?<![\w.:/])/" r"(?:home|root|work|Users)/\w",
        ]
    )
)


# -------------------------------------------------------------------- the walk
def room_of(module: str) -> str:
    """`flexarm_env.physics.model` -> `physics`; the package itself -> `__init__`."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else "__init__"


def imports_of(text: str, package: str, modules: set[str]) -> Iterator[tuple[int, str]]:
    """Line and dotted name of every import in a text of a package, inside functions and for types alone included.

    `from a import b` counts as `a.b` where that is one of the modules, as `a` elsewhere. `import_module` of a text
    counts too; a name that is composed at run time counts as `?`.
    """
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = resolve_name("." * node.level + (node.module or ""), package)
            for alias in node.names:
                inner = f"{base}.{alias.name}"
                yield node.lineno, inner if inner in modules else base
        elif isinstance(node, ast.Call) and "import_module" in (getattr(node.func, key, "") for key in ("id", "attr")):
            name, *packages = node.args
            if isinstance(name, ast.Constant):
                yield node.lineno, resolve_name(name.value, package) if name.value.startswith(".") else name.value
            elif packages:
                yield node.lineno, f"{PACKAGE}.?"


def imports_in(path: Path, modules: set[str]) -> Iterator[tuple[int, str]]:
    """Those of a file."""
    return imports_of(path.read_text(encoding="utf-8"), module_name(path.parent), modules)


def package_faults(path: Path, known: set[str]) -> list[str]:
    """Imports of a module of the package that its room may not make."""
    module = module_name(path)
    room = room_of(module)
    if room not in ROOMS:
        return [f"{module}: the room '{room}' is not declared in ROOMS"]
    faults = []
    for line, name in imports_in(path, known):
        top = name.split(".")[0]
        if name.endswith("?"):
            faults += [] if room == "__init__" else [f"{module}:{line}: a relative import must name its module"]
        elif top == PACKAGE:
            target = room_of(name)
            if target != room and target not in ROOMS[room]:
                faults.append(f"{module}:{line}: '{room}' may not import '{target}'")
        elif top in OUTSIDE or top == "tests":
            faults.append(f"{module}:{line}: the package may not import '{top}'")
        elif room not in EXTERNALS.get(top, {room}):
            faults.append(f"{module}:{line}: '{room}' may not import {top}")
    return faults


_INSIDE = {"benchmarks.operations", "benchmarks.cost_model"}
"""What measures the kernels themselves."""


def outside_faults(path: Path, known: set[str]) -> list[str]:
    """Imports of code outside of the package that reach past the public rooms."""
    module = module_name(path)
    allowed = _PUBLIC | _COMPILED if module in _INSIDE else _PUBLIC
    return [
        f"{module}:{line}: imports '{name}', which is not public"
        for line, name in imports_in(path, known)
        if name.split(".")[0] == PACKAGE and room_of(name) not in allowed
    ]


def text_faults(text: str, path: object, words: re.Pattern[str]) -> list[str]:
    """Words that have no place in a text."""
    return [
        f"{path}:{number}: {found.group()!r}"
        for number, line in enumerate(text.splitlines(), start=1)
        for found in words.finditer(line)
    ]


def python_files(top: str) -> list[Path]:
    return sorted((ROOT / top).rglob("*.py"))


def module_name(path: Path) -> str:
    """Dotted name of a file below ROOT."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


def existing_rooms() -> set[str]:
    """Their dotted names."""
    return {f"{PACKAGE}.{room_of(module_name(path))}" for path in python_files(PACKAGE)}


def repository_texts() -> Iterator[tuple[str, str]]:
    """Path and content of every text file that belongs to the repository."""
    words = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    listed = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    if listed.returncode == 0:
        paths = [ROOT / name for name in listed.stdout.split("\0") if name]
    else:  # a source distribution
        tops = (PACKAGE, *OUTSIDE, "configs", "docs", "tests")
        paths = [path for top in tops for path in (ROOT / top).rglob("*") if "__pycache__" not in path.parts]
        paths += list(ROOT.glob("*.*"))
    for path in paths:
        if path.is_file():
            data = path.read_bytes()
            if b"\0" not in data[:8192]:
                yield str(path.relative_to(ROOT)), data.decode("utf-8", errors="replace")


# ------------------------------------------------------------------- the rules
def test_the_table_is_sound() -> None:
    named = set().union(*ROOMS.values(), *EXTERNALS.values(), _PUBLIC)
    assert named <= set(ROOMS), f"not declared: {sorted(named - set(ROOMS))}"
    assert python_files(PACKAGE), "the package was not found"

    done: set[str] = set()
    low = set(ROOMS) - {"__init__", "cli", "__main__"}  # the package itself is an entrance, as is the command line
    while ready := {room for room in low - done if ROOMS[room] <= done}:
        done |= ready
    assert done == low, f"rooms that import each other in a circle: {sorted(low - done)}"


def in_circles(imports: dict[str, set[str]]) -> list[str]:
    """The modules that are on a circle of imports, or between two circles: those that nothing frees."""
    left = {module: set(others) for module, others in imports.items()}
    while free := {m for m, others in left.items() if not others or not any(m in other for other in left.values())}:
        left = {module: others - free for module, others in left.items() if module not in free}
    return sorted(left)


def test_no_modules_import_each_other_in_a_circle() -> None:
    """Within a room as between rooms."""
    paths = {module_name(path): path for path in python_files(PACKAGE)}
    imports = {
        module: {name for _, name in imports_in(path, set(paths))} & set(paths) - {module}
        for module, path in paths.items()
    }
    assert in_circles(imports) == []


def test_a_circle_is_found() -> None:
    """Also where one of its imports is inside a function, for types alone, or a call of `import_module`."""
    assert in_circles({"a": {"b"}, "b": {"c"}, "c": {"b", "d"}, "d": set()}) == ["b", "c"]
    modules = {"package", "package.room", "package.room.a", "package.b"}
    for text in ("def f():\n    from ..b import x\n", "if TYPE_CHECKING:\n    import package.b\n", "from .. import b"):
        assert [name for _, name in imports_of(text, "package.room", modules)] == ["package.b"]
    for text in ("import_module('..b', __package__)", "def f():\n    importlib.import_module('package.b')\n"):
        assert [name for _, name in imports_of(text, "package.room", modules)] == ["package.b"]
    assert [name for _, name in imports_of("import_module(f'.{x}', __package__)", "p", modules)] == ["flexarm_env.?"]
    found = imports_of("from . import a\nfrom .a import f", "package.room", modules)
    assert list(found) == [(1, "package.room.a"), (2, "package.room.a")]


def test_every_room_is_drawn_and_told() -> None:
    """`python docs/figures/architecture.py` draws it."""
    rooms = set(ROOMS) - {"validation", "data", "__main__", "__init__"}
    drawn = re.sub(r"<[^>]*>", " ", (ROOT / "docs/figures/architecture.svg").read_text("utf-8"))
    table = re.findall(r"^\|(.*?)\|", (ROOT / "docs/architecture.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(rooms - set(re.findall(r"\w+", drawn))) == []
    assert sorted(rooms - set(re.findall(r"`(\w+)`", " ".join(table)))) == []


def test_imports_point_one_way() -> None:
    known = existing_rooms()
    faults = [fault for path in python_files(PACKAGE) for fault in package_faults(path, known)]
    assert not faults, "\n".join(faults)


def test_the_core_imports_no_other_room() -> None:
    known, beyond = existing_rooms(), set()
    for path in python_files(PACKAGE):
        module = module_name(path)
        if room_of(module) in CORE - {"__init__"}:
            rooms = {room_of(name) for _, name in imports_in(path, known) if name.split(".")[0] == PACKAGE}
            beyond |= {(module, room) for room in rooms - CORE}
    assert beyond == BEYOND_THE_CORE


BRANCHES = 15
"""Largest number of places outside of `physics` that ask whether an arm, scene or kind of environment is in space.

What differs is a method or a constant of `bodies.Axes`, `physics.reading.Reading` or an environment's `Kind`."""

ASKING = {"spatial", "space", "axes"}


def branches_of(text: str) -> list[int]:
    """Lines of a text with conditions or tables that ask whether something is in space.

    A condition is the test of `if` (also of an expression or comprehension), `while`, `and` and `or`. A table is
    indexed by the axes or the flag. Classes whose name begins with "Spatial" count in `isinstance`. The number of axes
    (`len`) and properties of the axes (`arm.axes.measures`) do not ask.
    """
    tree, found = ast.parse(text), set[int]()
    parents = {child: node for node in ast.walk(tree) for child in ast.iter_child_nodes(node)}

    def asks(node: ast.AST) -> bool:
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "isinstance":
            return any(getattr(name, "id", "").startswith("Spatial") for name in ast.walk(node.args[1]))
        if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "len":
            return False
        if isinstance(node, ast.Attribute) and node.attr in ASKING and not isinstance(parents[node], ast.Attribute):
            return True
        return any(map(asks, ast.iter_child_nodes(node)))

    for node in ast.walk(tree):
        tests: list[ast.expr] = []
        if isinstance(node, ast.If | ast.IfExp | ast.While | ast.BoolOp):
            tests = [node if isinstance(node, ast.BoolOp) else node.test]
        elif isinstance(node, ast.comprehension):
            tests = list(node.ifs)
        elif isinstance(node, ast.Subscript) and not isinstance(node.slice, ast.Slice):
            named = isinstance(node.slice, ast.Name) and node.slice.id in ASKING and isinstance(node.value, ast.Dict)
            found |= {node.lineno} if named else set()
            tests = [node.slice]
        found |= {test.lineno for test in tests if asks(test)}
    return sorted(found)


def test_a_branch_on_plane_and_space_is_found() -> None:
    """In all forms that `branches_of` lists; what an arm's axes know is no branch."""
    asking = [
        "if arm.spatial: pass", "x = 1 if scene.axes == 'xyz' else 2", "x = TABLE[arm.axes]", "x = arm.spatial and y",
        "x = [y for y in z if kind.space]", "x = {'xy': 1, 'xyz': 2}[axes]", "if isinstance(x, SpatialBeam): pass",
    ]  # fmt: skip
    assert [branches_of(text) for text in asking] == [[1]] * len(asking)
    for text in ("x = v[: len(arm.axes)]", "if a not in arm.axes.measures: pass", "for a in arm.axes: pass"):
        assert branches_of(text) == []


def test_few_places_above_the_mechanics_ask_for_plane_or_space() -> None:
    """The properties that answer the question are not counted."""
    found = []
    for path in python_files(PACKAGE):
        if room_of(module_name(path)) == "physics":
            continue
        text = path.read_text(encoding="utf-8")
        functions = [one for one in ast.walk(ast.parse(text)) if isinstance(one, ast.FunctionDef)]
        own = [range(one.lineno, (one.end_lineno or 0) + 1) for one in functions if one.name in ("spatial", "axes")]
        found += [(str(path.relative_to(ROOT)), line) for line in branches_of(text) if not any(line in o for o in own)]
    assert len(found) <= BRANCHES, found


def test_the_page_says_how_large_the_core_is() -> None:
    """In thousands of lines, to 3 %."""
    lines = Counter[str]()
    for path in python_files(PACKAGE):
        lines[room_of(module_name(path))] += len(path.read_text(encoding="utf-8").splitlines())
    page = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    said = re.search(r"The core has ([\d,]+) of the package's ([\d,]+) lines", page)
    assert said
    core, package = (int(word.replace(",", "")) for word in said.groups())
    assert sum(lines[room] for room in CORE) == pytest.approx(core, rel=0.03)
    assert sum(lines.values()) == pytest.approx(package, rel=0.03)


@pytest.mark.slow
def test_a_copy_of_the_core_steps_every_environment(tmp_path: Path) -> None:
    """Those of the package, and the suite's tasks by their keywords."""
    own = [n for n, spec in gym.registry.items() if str(spec.entry_point).startswith(f"{PACKAGE}.envs.")]
    environments: dict[str, list[Any]] = {name: [name, {}] for name in own if "/" not in name}
    assert len(environments) == 4
    environments |= {task.id: [task.environment, dict(task.arguments)] for task in suite.tasks(earlier=True)}
    package = tmp_path / PACKAGE
    shutil.copytree(ROOT / PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in [*package.iterdir(), package / "data" / "suite"]:
        if path.stem not in CORE:
            shutil.rmtree(path) if path.is_dir() else path.unlink()
    (tmp_path / "environments.json").write_text(json.dumps(environments, default=list))
    program = """
import json, sys
sys.path.insert(0, sys.argv[1])
import gymnasium as gym
import flexarm_env
assert flexarm_env.__file__.startswith(sys.argv[1]), flexarm_env.__file__
for name, (env_id, keywords) in sorted(json.load(open(sys.argv[1] + "/environments.json")).items()):
    env = gym.make(env_id, **keywords)
    env.reset(seed=0)
    steps = [env.step(env.action_space.sample()) for _ in range(3)]
    assert all(env.observation_space.contains(step[0]) for step in steps)
    print(name)
"""
    assert python("-c", program, str(tmp_path), cwd=tmp_path).stdout.split() == sorted(environments)


def test_agents_and_benchmarks_use_public_rooms() -> None:
    known = existing_rooms()
    faults = [fault for top in OUTSIDE for path in python_files(top) for fault in outside_faults(path, known)]
    assert not faults, "\n".join(faults)


def test_compiled_code_is_reproducible() -> None:
    faults = [
        fault
        for room in sorted(_COMPILED)
        for path in python_files(f"{PACKAGE}/{room}")
        for fault in text_faults(path.read_text(encoding="utf-8"), path, FORBIDDEN_KEYWORDS)
    ]
    assert not faults, "\n".join(faults)


REVERSE = {
    "solve_transposed", "vjp_residual", "multiply", "vjp_product", "vjp_poses", "note_inverse", "noted_inverse",
}  # fmt: skip
"""Functions of the contract that serve reverse derivatives alone."""


def test_contracts_are_small_and_told() -> None:
    """At most 20 functions of a formulation, and of a contribution; docstrings of the modules have their arguments."""
    for module, family in ((protocol, protocol.FORMULATIONS), (contributions, contributions.CONTRIBUTIONS)):
        assert len(family.names - REVERSE) <= 20
        for name in sorted(family.names):
            written = re.search(rf"\b{name}\((.*?)\)", module.__doc__ or "")
            assert written, name
            given = [word.split("=")[0].strip() for word in written[1].split(",")]
            assert given == list(signature(getattr(module, name)).parameters), name


def test_files_stay_readable() -> None:
    lengths = {path: len(path.read_text(encoding="utf-8").splitlines()) for path in python_files(PACKAGE)}
    assert not {path: n for path, n in lengths.items() if n > MAX_LINES}


def test_no_registry_and_no_machine_is_named() -> None:
    texts = dict(repository_texts())
    assert "pyproject.toml" in texts
    faults = [fault for path, text in texts.items() for fault in text_faults(text, path, FORBIDDEN_TEXT)]
    assert not faults, "\n".join(faults)


def loaded_after(statement: str) -> set[str]:
    """Modules that a fresh interpreter has loaded after `statement`."""
    return set(python("-c", f"{statement}\nimport sys\nprint(*sorted(sys.modules))").stdout.split())


def test_importing_the_package_is_light() -> None:
    assert HEAVY & loaded_after(f"import {PACKAGE}") == set()


def test_environments_load_no_controllers_linear_models_or_players() -> None:
    """Together they would add a tenth to the time until the first step of an environment with compiled programs."""
    loaded = loaded_after(f"import {PACKAGE}.envs.flexible_arm, {PACKAGE}.envs.spatial")
    assert f"{PACKAGE}.envs.spatial" in loaded
    unused = {"control.catalogue", "control.policy", "linear", "derivatives", "view.page", "view.sources"}
    assert {f"{PACKAGE}.{name}" for name in unused} & loaded == set()


@pytest.mark.slow
def test_processes_of_a_run_draw_by_one_seed_and_leave_out_what_comes_too_late() -> None:
    """Of the whole check: processes that ordered files by seeds of their own would be told that they differ."""
    files = [f"tests/test_{name}.py" for name in ("parameters", "scene", "scene_toml", "shapes", "time_functions")]
    words = ["-m", "pytest", "-n", "2", "--dist", "worksteal", "-q", "-p", "no:cacheprovider", *files]
    late = python(*words, "--within", "0", CI="1").stdout.splitlines()[-1]
    assert "skipped" in late and "passed" not in late
    assert "skipped" not in python(*words[:-3], "--within", "600", CI="1").stdout
