"""The recipes of docs/architecture.md: each change is made in a copy of the package, and what it says holds there."""

import re
import shutil
from pathlib import Path

import pytest

from tests.processes import python
from tests.test_architecture import PACKAGE, ROOT

SECTION = (ROOT / "docs" / "architecture.md").read_text("utf-8").partition("\n## What a change touches\n")[2]
RECIPES = dict(re.findall(r"^### (.*?)\n(.*?)(?=^##|\Z)", SECTION, re.MULTILINE | re.DOTALL))


def change(folder: Path, diff: str) -> list[str]:
    """Make the changes of a diff without line numbers, whose old lines stand once in their file; the files' names."""
    files = re.split(r"^--- (.*)\n", diff, flags=re.MULTILINE)[1:]
    for name, hunks in zip(files[::2], files[1::2], strict=True):
        text = (folder / name).read_text("utf-8")
        for hunk in hunks.split("@@\n"):
            old, new = ("\n".join(line[1:] for line in hunk.splitlines() if line[:1] != left) for left in "+-")
            assert text.count(old) == 1, f"{name}: stands {text.count(old)} times:\n{old}"
            text = text.replace(old, new)
        (folder / name).write_text(text, "utf-8")
    return files[::2]


def test_there_is_a_recipe_for_each() -> None:
    assert list(RECIPES) == [
        "A law of a cross-section", "A nonlinear material", "A spring in a joint", "A contribution", "A sensor",
        "A reward term", "A task",
    ]  # fmt: skip


@pytest.mark.parametrize("name", RECIPES)
def test_the_diffs_of_a_recipe_apply(name: str, tmp_path: Path) -> None:
    shutil.copytree(ROOT / PACKAGE, tmp_path / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    for diff in re.findall(r"```diff\n(.*?)```", RECIPES[name], re.DOTALL):
        assert change(tmp_path, diff)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "mode"), [*((name, "python") for name in RECIPES), ("A task", "llvm"), ("A contribution", "llvm")]
)
def test_recipe(name: str, mode: str, tmp_path: Path) -> None:
    """Uncompiled, which takes seconds; a task, whose functions are a stranger's, and a contribution compiled too."""
    text = RECIPES[name]
    shutil.copytree(ROOT / PACKAGE, tmp_path / PACKAGE, ignore=shutil.ignore_patterns("__pycache__"))
    changed = [file for diff in re.findall(r"```diff\n(.*?)```", text, re.DOTALL) for file in change(tmp_path, diff)]
    assert len(changed) <= 3 and all(f"`{file}`" in text for file in changed)
    script = tmp_path / "own.py"
    script.write_text("\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL)), "utf-8")
    python(script, cwd=tmp_path, PYTHONPATH=str(tmp_path), FLEXARM_COMPILER=mode)
