"""Compiled code of a user's own files: it is loaded for the same functions, classes and values alone."""

import importlib.util
import linecache
import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED, objects, source
from tests.processes import python

pytestmark = pytest.mark.skipif(UNCOMPILED, reason="nothing is kept")

HEAD = "import numpy as np\nfrom typing import NamedTuple\nfrom flexarm_env.compiler import *\n"


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr(sys, "dont_write_bytecode", True)  # files change within a second, by which .pyc are told apart
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    monkeypatch.setenv(objects.VARIABLE, str(tmp_path / "cache"))
    return tmp_path / "cache"


def module(path: Path, text: str, name: str, monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """A module of such text and name, imported from a file of its own."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    made = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, name, made)
    spec.loader.exec_module(made)
    return made


def made(kernel: Any) -> list[bool]:
    """Whether each form of a kernel was compiled, not loaded."""
    return [form.made for form in kernel.forms.values()]


def test_modules_of_one_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two folders with a module `mod`, each with another kernel in the same line, and a copied script that calls it."""
    user = HEAD + "import mod\n@kernel\ndef f(x):\n    return mod.g(x)\n"
    for again in (False, True):
        for folder, text, found in (("a", "x + 1.0", 3.0), ("b", "x * 50.0", 100.0)):
            own = module(
                tmp_path / folder / "mod.py", f"{HEAD}@kernel\ndef g(x):\n    return {text}\n", "mod", monkeypatch
            )
            script = module(tmp_path / folder / "script.py", user, "script", monkeypatch)
            assert own.g(2.0) == script.f(2.0) == found
            assert made(own.g) == made(script.f) == [not again], "each folder's code is kept"


CLASSES = [
    ("x: float\n    n: int = 3\n    Z = 2.0", 5.0, 6.0, -1.0),
    ("x: float\n    n: int = 4\n    Z = 2.0", 6.0, 6.0, -1.0),  # another default
    ("x: float\n    n: int = 4\n    Z = 5.0", 9.0, 15.0, -1.0),  # another constant
    ("n: int = 4\n    x: float = 0.0\n    Z = 5.0", 9.0, 15.0, 1.0),  # another order
]  # fmt: skip


def test_a_named_tuple_of_another_file_changes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its defaults, its constants, the order of its fields; what is the same is loaded."""
    text = HEAD + "from cls import Pair\n@kernel\ndef defaults(x):\n    p = Pair(x=x)\n    return p.n + p.Z\n"
    text += "@kernel\ndef constants(p):\n    return p.x * p.Z\n"
    text += "@kernel\ndef order(x):\n    p = Pair(1.0, 2)\n    return 1.0 * p.x - p.n\n"
    text += "@kernel\ndef result(x):\n    return Pair(x=x)\n"
    for body, *found in CLASSES:
        for again in (False, True):
            own = module(
                tmp_path / "cls.py",
                f"from typing import NamedTuple\nclass Pair(NamedTuple):\n    {body}\n",
                "cls",
                monkeypatch,
            )
            user = module(tmp_path / "user.py", text, "user", monkeypatch)
            assert [user.defaults(1.0), user.constants(own.Pair(x=3.0)), user.order(1.0)] == found
            assert user.result(7.0) == own.Pair(x=7.0) and type(user.result(7.0)) is own.Pair
            if again:
                assert not any(made(one)[0] for one in (user.defaults, user.constants, user.order, user.result))


def test_annotations_and_operators_of_another_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code is loaded only where the same fields hold lanes and the operators are the same."""
    text = HEAD + "from own import Pair\n@kernel\ndef f(lane, p: Pair):\n    return (p + p).x + p.a[1] * 0.0\n"
    body = "x: float\n    a: {}\n    def __add__(self, b):\n        return Pair(self.x {} b.x, self.a)\n"
    for holds, sign, found in (("Lanes", "+", 6.0), ("np.ndarray", "+", 6.0), ("np.ndarray", "*", 9.0)):
        for again in (False, True):
            own_text = f"{HEAD}class Pair(NamedTuple):\n    {body.format(holds, sign)}"
            own = module(tmp_path / "own.py", own_text, "own", monkeypatch)
            linecache.checkcache()
            user = module(tmp_path / "user.py", text, "user", monkeypatch)
            assert user.f((0,), own.Pair(3.0, np.ones(2))) == found
            assert made(user.f) == [not again]


def test_values_around_a_kernel_and_of_numpy_are_kept_apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Kernels made in a function are loaded as well, each with its own numbers; so is one that reads an np.int64."""
    text = HEAD + "N = np.int64(3)\ndef made(c):\n    @kernel\n    def f(x):\n        return c * x\n    return f\n"
    text += "@kernel\ndef g(x):\n    return x * N\none, two = made(2.0), made(3.0)\n"
    for again in (False, True):
        user = module(tmp_path / "user.py", text, "user", monkeypatch)
        assert (user.one(1.0), user.two(1.0), user.g(2.0)) == (2.0, 3.0, 6.0)
        assert made(user.one) == made(user.two) == made(user.g) == [not again]


def test_a_cotangents_names_are_a_part_of_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`vjp_of` of another file with other names, and Python functions called while a kernel is compiled."""
    text = HEAD + "from other import pulled, helper\n@traced\ndef t(lane, x):\n    return (x * helper(),)\n"
    text += "@kernel\ndef f(x):\n    a, b, da, db = stack(SINGLE, (0,)), stack(SINGLE, (0,)), "
    text += "stack(SINGLE, (0,)), stack(SINGLE, (0,))\n"
    text += "    a[0], b[0], da[0], db[0] = x, 0.0, 0.0, 1.0\n    pulled(a, b, 2.0, da, db)\n"
    text += "    return da[0] + t(SINGLE, x)[0]\n"
    other = HEAD + "def deeper():\n    return {0}\ndef helper():\n    return deeper()\n"
    other += "@kernel\ndef square(a, b, c):\n    b[0] = a[0] * a[0] * c\npulled = vjp_of(square, {1})\n"
    for number, names, found in ((1.0, '("a", "b")', 15.0), (2.0, '("a", "b")', 18.0)):
        module(tmp_path / "other.py", other.format(number, names), "other", monkeypatch)
        user = module(tmp_path / "user.py", text, "user", monkeypatch)
        assert user.f(3.0) == found and made(user.f) == [True]


def test_what_is_not_kept_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """An object of a class of one's own, and a constant of a module by a local name."""
    text = HEAD + "import numbers_of\nclass Some: pass\nsome = Some()\nsome.k = 2.0\n"
    text += "@kernel\ndef f(x):\n    return x * some.k\n@kernel\ndef g(x):\n    m = numbers_of\n    return x * m.K\n"
    monkeypatch.setattr(objects, "_sentences", set())
    module(tmp_path / "numbers_of.py", "K = 4.0\n", "numbers_of", monkeypatch)
    for _ in range(2):
        user = module(tmp_path / "user.py", text, "user", monkeypatch)
        assert (user.f(1.0), user.g(1.0)) == (2.0, 4.0) and made(user.f) == made(user.g) == [True]
    told = [record.getMessage() for record in caplog.records if "every process" in record.getMessage()]
    assert told == [
        "flexarm_env: user.f is compiled anew in every process: f reads 'some', which is of user.Some",
        "flexarm_env: user.g is compiled anew in every process: g reads 'm.K of a local name', which is no global name",
    ]


def test_a_process_that_imported_an_older_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Code of the file's new text is not given to the functions of its old one."""
    old = module(tmp_path / "user.py", f"{HEAD}@kernel\ndef f(x):\n    return x + 1.0\n", "user", monkeypatch)
    new = module(tmp_path / "user.py", f"{HEAD}@kernel\ndef f(x):\n    return x + 2.0\n", "user", monkeypatch)
    assert new.f(1.0) == 3.0
    with pytest.raises(TypeError, match="has changed since it was imported"):
        old.f(1.0)


def test_a_kernel_is_parsed_without_the_rest_of_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Which takes a part of the time; a text whose end is misjudged is found in the whole file."""
    text = f"""import math
{HEAD}
@kernel
def f(
    x,
):
    # a comment

    y = math.floor(x)
# in the first column
    return y + 0.5


@kernel
def g(x):
    \"\"\"Docstring.
With a line in the first column.
\"\"\"
    return f(x)
"""
    user, parsed, whole = module(tmp_path / "user.py", text, "user", monkeypatch), source._parsed, list[str]()
    monkeypatch.setattr(source, "_parsed", lambda text: whole.append(text) or parsed(text))
    assert user.f(2.25) == 2.5 and not whole
    assert user.g(2.25) == 2.5 and len(whole) == 1
    assert source.source_of(user.f.function).tree.lineno == text[: text.index("def f")].count("\n") + 1


@pytest.mark.slow
def test_scripts_of_one_name(tmp_path: Path) -> None:
    """Two scripts `s.py`, each in its folder, whose kernels stand in the same line."""
    for again in (False, True):
        for folder, text, found in (("A", "x + 1.0", "3.0"), ("B", "x * 50.0", "100.0")):
            (tmp_path / folder).mkdir(exist_ok=True)
            script = tmp_path / folder / "s.py"
            lines = f"{HEAD}@kernel\ndef f(x):\n    return {text}\nprint(f(2.0), *[p.made for p in f.forms.values()])\n"
            script.write_text(lines, encoding="utf-8")
            assert python("-B", script).stdout.split() == [found, str(not again)]
