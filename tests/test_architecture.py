"""The house's rules, held by a walk over the syntax trees.

ROOMS says which room of the package may import which. A room is a module or a subpackage directly under
`flexarm_env`; a new one has to be declared here.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = "flexarm_env"

# ------------------------------------------------------------------ the table
_DESCRIPTION = {"validation", "parameters", "rigid", "settings", "time_functions", "arms", "scene", "scenes"}
_COMPILED = {"compiler", "physics", "runtime", "tasks"}
_PHYSICS = {*_DESCRIPTION, "physics", "trajectory", "accuracy", "simulation", "batch", "linear"}
_PUBLIC = {*_PHYSICS - {"physics"}, "comparison", "control", "envs", "plotting", "recording", "sb3", "__init__"}

# room -> rooms it may import, apart from itself ("__init__" is the bare package: its version and public names)
ROOMS: dict[str, set[str]] = {
    "validation": set(),
    "parameters": {"validation"},
    "rigid": {"validation", "parameters"},
    "settings": {"validation"},
    "time_functions": {"validation"},
    "arms": {"validation", "parameters"},
    "scene": {"validation", "parameters", "settings", "time_functions", "arms"},
    "scenes": {"validation", "parameters", "settings", "time_functions", "scene", "arms"},
    "data": set(),
    "compiler": set(),
    "layout": set(),
    "physics": {*_DESCRIPTION, "compiler", "layout"},
    "tasks": {"compiler", "layout", "physics"},
    "runtime": {"compiler", "layout", "physics", "tasks"},
    "trajectory": {*_DESCRIPTION, "physics"},
    "accuracy": {*_DESCRIPTION},
    "simulation": {*_DESCRIPTION, *_COMPILED, "trajectory", "accuracy"},
    "batch": {*_DESCRIPTION, *_COMPILED, "layout", "trajectory", "simulation"},
    "linear": {*_DESCRIPTION, *_COMPILED, "trajectory", "simulation"},
    "comparison": {*_DESCRIPTION, "trajectory", "simulation"},
    "control": {*_PHYSICS, "tasks"},
    "envs": {*_PHYSICS, "compiler", "control"},
    "plotting": {*_PHYSICS, "comparison"},
    "recording": {*_DESCRIPTION, "trajectory", "envs"},
    "sb3": {*_DESCRIPTION, "envs"},
    "cli": {*_PUBLIC, "data", "compiler"},
    "__main__": {"cli"},
    "__init__": {*_PHYSICS, "control", "envs"},
}

# other packages that only some rooms may import, anywhere in their code
EXTERNALS: dict[str, set[str]] = {
    "torch": {"sb3"},
    "stable_baselines3": {"sb3"},
    "numba": {"compiler"},
    "llvmlite": {"compiler"},
    "gymnasium": {"__init__", "envs", "recording", "sb3", "cli"},
    "pygame": {"envs"},
    "matplotlib": {"plotting"},
    "minari": {"recording"},
    "ray": set(),
}

# code outside of the package uses the public rooms only
OUTSIDE = ("agents", "benchmarks")

# what `import flexarm_env` must not load
HEAVY = {"torch", "stable_baselines3", "pygame", "matplotlib", "scipy", "minari", "moviepy", "ray"}

MAX_LINES = 450
LONGER: dict[str, int] = {}  # path -> its own limit; to be kept short

# Compiled code gives the same bits everywhere, and brings its own threads.
FORBIDDEN_KEYWORDS = ("fastmath", "parallel")

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


def imports_of(source: str, module: str, is_package: bool, known: set[str]) -> Iterator[tuple[int, str]]:
    """Line and absolute dotted name of every import in `source`, those inside functions included.

    `from a import b` counts as `a.b` where b is a room of the package, as `a` elsewhere.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield node.lineno, alias.name
        elif isinstance(node, ast.ImportFrom):
            base = node.module or ""
            if node.level:
                here = module.split(".")
                here = here[: len(here) - node.level + is_package]
                base = ".".join([*here, base]) if base else ".".join(here)
            for alias in node.names:
                inside = base == PACKAGE and alias.name in known
                yield node.lineno, f"{base}.{alias.name}" if inside else base


def package_faults(source: str, module: str, is_package: bool, known: set[str]) -> list[str]:
    """Imports of a module of the package that its room may not make."""
    room = room_of(module)
    if room not in ROOMS:
        return [f"{module}: the room '{room}' is not declared in ROOMS"]
    faults = []
    for line, name in imports_of(source, module, is_package, known):
        top = name.split(".")[0]
        if top == PACKAGE:
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


def outside_faults(source: str, module: str, known: set[str]) -> list[str]:
    """Imports of code outside of the package that reach past the public rooms."""
    allowed = _PUBLIC | _COMPILED if module in _INSIDE else _PUBLIC
    return [
        f"{module}:{line}: imports '{name}', which is not public"
        for line, name in imports_of(source, module, False, known)
        if name.split(".")[0] == PACKAGE and room_of(name) not in allowed
    ]


def keyword_faults(source: str, module: str) -> list[str]:
    """Calls that switch on what compiled code must do without."""
    return [
        f"{module}:{node.lineno}: {keyword.arg}= is not to be used"
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Call)
        for keyword in node.keywords
        if keyword.arg in FORBIDDEN_KEYWORDS
        and not (isinstance(keyword.value, ast.Constant) and not keyword.value.value)
    ]


def text_faults(text: str, path: str) -> list[str]:
    """Words that have no place in the repository."""
    return [
        f"{path}:{number}: {found.group()!r}"
        for number, line in enumerate(text.splitlines(), start=1)
        for found in FORBIDDEN_TEXT.finditer(line)
    ]


def python_files(top: str) -> list[Path]:
    return sorted((ROOT / top).rglob("*.py"))


def module_name(path: Path) -> tuple[str, bool]:
    """Dotted name of a file below ROOT, and whether it is a package's `__init__`."""
    parts = list(path.relative_to(ROOT).with_suffix("").parts)
    if parts[-1] == "__init__":
        return ".".join(parts[:-1]), True
    return ".".join(parts), False


def existing_rooms() -> set[str]:
    return {room_of(module_name(path)[0]) for path in python_files(PACKAGE)}


def repository_texts() -> Iterator[tuple[str, str]]:
    """Path and content of every text file that belongs to the repository."""
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
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


def test_imports_point_one_way() -> None:
    known = existing_rooms()
    faults = [
        fault
        for path in python_files(PACKAGE)
        for fault in package_faults(path.read_text(encoding="utf-8"), *module_name(path), known)
    ]
    assert not faults, "\n".join(faults)


def test_agents_and_benchmarks_use_public_rooms() -> None:
    known = existing_rooms()
    faults = [
        fault
        for top in OUTSIDE
        for path in python_files(top)
        for fault in outside_faults(path.read_text(encoding="utf-8"), module_name(path)[0], known)
    ]
    assert not faults, "\n".join(faults)


def test_compiled_code_is_reproducible() -> None:
    faults = [
        fault
        for room in sorted(_COMPILED)
        for path in python_files(f"{PACKAGE}/{room}")
        for fault in keyword_faults(path.read_text(encoding="utf-8"), module_name(path)[0])
    ]
    assert not faults, "\n".join(faults)


def test_files_stay_readable() -> None:
    lengths = {
        str(path.relative_to(ROOT)): len(path.read_text(encoding="utf-8").splitlines())
        for path in python_files(PACKAGE)
    }
    long = [
        f"{name}: {n} lines, at most {LONGER.get(name, MAX_LINES)}"
        for name, n in lengths.items()
        if n > LONGER.get(name, MAX_LINES)
    ]
    assert not long, "\n".join(long)
    assert set(LONGER) <= set(lengths), f"no such file: {sorted(set(LONGER) - set(lengths))}"


def test_no_registry_and_no_machine_is_named() -> None:
    texts = dict(repository_texts())
    assert "pyproject.toml" in texts
    faults = [fault for path, text in texts.items() for fault in text_faults(text, path)]
    assert not faults, "\n".join(faults)


def heavy_after(statement: str) -> set[str]:
    """Which of HEAVY a fresh interpreter has loaded after `statement`.

    Numba loads the bare name `scipy` to read its version, so SciPy counts once one of its public parts is there.
    """
    code = f"{statement}\nimport sys\nprint(*sorted(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True, timeout=300
    )
    loaded = done.stdout.split()
    heavy = {name for name in HEAVY - {"scipy"} if name in loaded}
    if any(re.match(r"scipy\.(?!version)[a-z]", name) for name in loaded):
        heavy.add("scipy")
    return heavy


def test_importing_the_package_is_light() -> None:
    assert heavy_after(f"import {PACKAGE}") == set()
