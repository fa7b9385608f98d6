"""The documentation: its code runs as printed, every public name has its place and its docstring."""

import ast
import inspect
import re
import shlex
from importlib import import_module
from pathlib import Path

import pytest

import flexarm_env
from tests.processes import python
from tests.test_architecture import PACKAGE, ROOMS, ROOT, python_files

DOCS = ROOT / "docs"
TRAINING = {"tutorials/train.md", "tutorials/circle.md", "tutorials/randomisation.md", "derivatives.md"}
TRAINING |= {"tutorials/wrappers.md", "hyperparameters.md"}
PAGES = ["index.md", "getting-started.md", "linearization.md", "scenes.md", "suite.md"]
PAGES += ["environments.md", "environments/options.md", "hyperparameters.md", "identification.md"]
PAGES += ["arm_files.md", "measures.md", "library.md", "remote.md", "coming_from_mujoco.md"]
PAGES += ["derivatives.md", *sorted(f"tutorials/{path.name}" for path in (DOCS / "tutorials").glob("*.md"))]
BLOCK = re.compile(
    r"(?:<!-- shortened in the tests: (?P<old>.*?) => (?P<new>.*?) -->\n\n)?```(?P<kind>python|sh)\n(?P<code>.*?)```",
    re.DOTALL,
)


def script_of(text: str) -> str:
    """A page's blocks as one Python script that defines no name itself; commands become calls that must succeed."""
    lines = []
    for block in BLOCK.finditer(text):
        code = block["code"]
        if block["old"]:
            assert block["old"] in code, f"{block['old']!r} is not in the block that is to be shortened"
            code = code.replace(block["old"], block["new"])
        if block["kind"] == "python":
            lines.append(code)
            continue
        for command in code.strip().splitlines():
            words = shlex.split(command)
            assert words[0] == "flexarm", command
            call = f"[__import__('sys').executable, '-m', 'flexarm_env', *{words[1:]!r}], check=True"
            lines.append(f"__import__('subprocess').run({call})")
    return "\n".join(lines)


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_code_runs_as_printed(page: str, tmp_path: Path) -> None:
    text = (DOCS / page).read_text("utf-8")
    if page == "coming_from_mujoco.md":
        pytest.importorskip("mujoco")
    if page in TRAINING:
        pytest.importorskip("stable_baselines3")
    (tmp_path / "page.py").write_text(script_of(text), "utf-8")
    python("page.py", cwd=tmp_path, PYTHONWARNINGS="ignore")


def test_every_page_defines_its_names(tmp_path: Path) -> None:
    """No page needs a name that only a test defines; and pages that no test here runs are run by their own."""
    pytest.importorskip("ruff")
    pages = [path for path in sorted(DOCS.rglob("*.md")) if "_build" not in path.parts]
    for path in pages:
        blocks = [block["code"] for block in BLOCK.finditer(path.read_text("utf-8")) if block["kind"] == "python"]
        name = path.relative_to(DOCS).as_posix()
        (tmp_path / f"{name.replace('/', '_')}.py").write_text("\n".join(blocks), "utf-8")
        assert not blocks or name in {*PAGES, "architecture.md", "doors.md", "ray.md"} or path.parent.name == "suite"
    python("-m", "ruff", "check", "--isolated", "--select", "F821,F823", tmp_path)


def test_every_page_has_code() -> None:
    without = [page for page in PAGES if not BLOCK.search((DOCS / page).read_text("utf-8"))]
    assert without == ["tutorials/index.md"]


def test_every_page_begins_with_what_it_is_for() -> None:
    """A sentence below the title, before anything else; and who wrote the page is not what it is for."""
    pages = [path for path in sorted(DOCS.rglob("*.md")) if "_build" not in path.parts]
    texts = {path: path.read_text("utf-8") for path in pages}
    own = {path: text for path, text in texts.items() if not text.startswith("```{include}")}
    begins = re.compile(r"# .+\n\n(?!Written by|Made by)[A-Z`*]\S* .*", re.MULTILINE)
    assert [path.relative_to(DOCS).as_posix() for path, text in own.items() if not begins.match(text)] == []


def test_hyperparameters_are_those_of_the_files() -> None:
    """Numbers in the tables of docs/hyperparameters.md, by environment and key."""
    yaml = pytest.importorskip("yaml")
    page = (DOCS / "hyperparameters.md").read_text("utf-8")
    for algorithm in ("ppo", "gradient", "sac"):
        file = f"configs/{algorithm}/default.yml"
        table = re.findall(r"^\|(.*)\|$", page.partition(f"(`{file}`)")[2].partition("\n## ")[0], re.MULTILINE)
        rows = [[cell.strip(" `") for cell in row.split("|")] for row in table]
        settings = yaml.safe_load((ROOT / file).read_text("utf-8"))
        compared = 0
        for k, env_id in enumerate(rows[0][1:], 1):
            own = settings[env_id]
            for row in rows[2:]:
                for key, cell in zip(re.findall(r"\w+", row[0]), row[k].split(", "), strict=False):
                    if key in own and key != "use_sde":
                        assert float(cell) == float(str(own[key]).removeprefix("lin_")), (file, env_id, key)
                        compared += 1
        assert compared > 6, file


# ----------------------------------------------------------------- the API
INSIDE = {"compiler", "layout", "physics", "runtime", "tasks", "batch", "curves", "rest", "rotations"}
INSIDE |= {"equations", "geometry", "records"}
INSIDE |= {"cli", "data", "__main__", "__init__", "accuracy_space", "meshing"}
"""Rooms that are not for use from outside."""


def documented() -> set[str]:
    """Modules that the API pages take their names from."""
    texts = [path.read_text("utf-8") for path in (DOCS / "api").glob("*.md")]
    return {name for text in texts for name in re.findall(r"automodule:: ([\w.]+)", text)}


def test_every_public_room_is_in_the_api() -> None:
    rooms = {name.split(".")[1] for name in documented()}
    assert rooms == set(ROOMS) - INSIDE


WITHOUT = """
import importlib, sys
for name in ("torch", "stable_baselines3", "sb3_contrib"):
    sys.modules[name] = None
for name in sys.argv[1:]:
    importlib.import_module(name)
"""


def test_the_site_needs_no_pytorch() -> None:
    """Sphinx has stand-ins for two modules that are PyTorch's own; the others are imported without it."""
    own = documented() - {"flexarm_env.sb3", "flexarm_env.torch"}
    python("-c", WITHOUT, *sorted(own))


def shown() -> set[object]:
    """Functions and classes that the API pages show: a module's `__all__`, or what it defines itself."""
    out = set()
    for name in documented() - {"flexarm_env.sb3", "flexarm_env.torch"}:  # which take seconds to import
        module = import_module(name)
        given = getattr(module, "__all__", None)
        for word, item in vars(module).items():
            own = word in given if given is not None else getattr(item, "__module__", "") == name
            if own and not word.startswith("_") and callable(item):
                out.add(item)
    return out


def test_every_public_name_is_on_a_page() -> None:
    there = shown()
    names = {f"flexarm_env.{word}": getattr(flexarm_env, word) for word in flexarm_env.__all__}
    for room in sorted(set(ROOMS) - INSIDE - {"sb3", "torch"}):
        module = import_module(f"flexarm_env.{room}")
        names |= {f"{room}.{word}": getattr(module, word) for word in getattr(module, "__all__", ())}
    lost = [name for name, item in names.items() if inspect.isfunction(item) or inspect.isclass(item)]
    assert [name for name in lost if names[name] not in there] == []


def public(body: list[ast.stmt]) -> list[ast.FunctionDef | ast.ClassDef]:
    """Functions and classes whose names begin with a letter; of a property the getter, of overloads the last."""
    found = [node for node in body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    marks = {node: {getattr(d, "attr", getattr(d, "id", "")) for d in node.decorator_list} for node in found}
    return [node for node in found if not node.name.startswith("_") and not marks[node] & {"setter", "overload"}]


def test_every_public_name_has_a_docstring() -> None:
    overridden = {"torques", "initialise", "predict"}  # of `control.Controller`, which describes them
    overridden |= {"value", "slopes"}  # of a cost of `control.ilqr`
    overridden |= {"of", "finer"}  # of `control.dynamics.Dynamics`
    # of `envs.small_motions_models.SmallMotions`
    overridden |= {"postures", "reference", "on_mesh", "unsteady", "link_angles", "spin", "tolerance"}
    overridden |= {"forget", "pressing"}  # of `control.force.PressController`
    overridden |= {"read", "reached", "place", "entries", "ranges", "path", "check_ranges"}  # `envs.targets.Target`
    overridden |= {"requested", "request_size", "goal", "chain", "axis", "record"}  # `envs.targets`
    overridden |= {"pen", "of_view", "of_run"}  # of `envs.pictures.Pictures`
    # of `accuracy_space.Errors`
    overridden |= {"factor", "has_stubby_link", "gear_rate", "slowest_square", "share_of_step", "witness", "neglected"}
    bare = []
    for path in python_files(PACKAGE):
        if {"compiler", "physics", "runtime", "tasks"}.intersection(path.parts):
            continue
        tree = ast.parse(path.read_text("utf-8"))
        name = path.relative_to(ROOT).as_posix()
        if path.name != "__init__.py" and not ast.get_docstring(tree):
            bare.append(name)
        for node in public(tree.body):
            inner = public(node.body) if isinstance(node, ast.ClassDef) else []
            bare += [f"{name}:{n.lineno} {n.name}" for n in (node, *inner)
                     if not ast.get_docstring(n) and n.name not in overridden]  # fmt: skip
    assert not bare, "\n".join(bare)


def test_equations_that_the_code_cites_are_there() -> None:
    theory = (DOCS / "theory.md").read_text("utf-8")
    tags = set(re.findall(r"\\tag\{(\d+\.\d+)\}", theory))
    sections = set(re.findall(r"^## (\d+)\.", theory, re.MULTILINE))
    assert len(tags) > 10
    for path in python_files(PACKAGE):
        text = path.read_text("utf-8")
        for number in re.findall(r"theory, eqs?\. \(?(\d+\.\d+)", text):
            assert number in tags, f"{path}: equation {number}"
        for number in re.findall(r"theory(?:\.md)?,? sections? (\d+)", text):
            assert number in sections, f"{path}: section {number}"


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    pytest.importorskip("furo")
    python("-m", "sphinx", "-W", "--keep-going", "-q", "-b", "html", DOCS, tmp_path)
    assert "flexarm_env.simulation.simulate" in (tmp_path / "api" / "simulate.html").read_text("utf-8")
    theory = (tmp_path / "theory.html").read_text("utf-8")
    assert theory.count("\\tag{") >= 15
    assert not re.search(r"tag\{[\d.]+\}\s*\\end\{split\}", theory), "MathJax allows no tag there"
