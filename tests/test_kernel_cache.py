"""Compiled code on disk: nobody loads what is damaged or was written for something else, nobody has to have it."""

import ast
import errno
import hashlib
import json
import os
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from flexarm_env.cli.parser import main
from flexarm_env.compiler import UNCOMPILED, kernel, objects
from flexarm_env.compiler.kinds import described_as
from flexarm_env.compiler.objects import Key, load, save
from flexarm_env.layout import Layout
from tests.processes import ROOT, python

BASE, OWN = "rollout.advance-12", Layout.__init__
"""What a program's files are called; a function of the package, whose source the key's stamp covers."""


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty folder for programs, and no warning given yet."""
    monkeypatch.setenv(objects.VARIABLE, str(tmp_path / "cache"))
    monkeypatch.setattr(objects, "_said", False)
    return tmp_path / "cache"


def key(text: str, stamp: str = "sources", base: str = BASE) -> Key:
    return Key(base, stamp, text)


def keep(key: Key, code: bytes) -> Path:
    """Where a program is kept."""
    save(key, code, ["tuple", ["number", "none"]], {OWN: set()})
    return objects.folders()[0] / key.name


def kept(key: Key) -> bytes | None:
    found = load(key)
    assert found is None or found[1] == ["tuple", ["number", "none"]]
    return None if found is None else found[0]


# ------------------------------------------------------------------------------------------ files
def test_a_named_tuple_in_a_tuple_is_told_by_what_it_is() -> None:
    """Not by where it lies in this process, which no other would find."""
    told = repr(described_as((Key(1, 2, 3.0), (Key(4, 5, None), 6.0)), "pair"))
    assert told.count("compiler.objects.Key") == 2 and " at 0x" not in told


def test_processes_that_compile_at_once_keep_their_own_code() -> None:
    assert kept(key("one link")) is None and kept(key("two links")) is None
    keep(key("one link"), b"code for one link")
    keep(key("two links"), b"code for two links")
    assert kept(key("one link")) == b"code for one link"
    assert kept(key("two links")) == b"code for two links"


CROWD = """
import sys
from tests.test_kernel_cache import keep, kept, key
for k in range(300):
    keep(key("form"), bytes(sys.argv[1], "ascii") * 5000)
    found = kept(key("form"))
    assert found is not None and len(set(found)) == 1 and len(found) == 5000, "torn"
"""


@pytest.mark.slow
def test_processes_that_write_one_file_never_tear_it(folder: Path) -> None:
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    crowd = [subprocess.Popen([sys.executable, "-c", CROWD, letter], cwd=ROOT, env=environment) for letter in "abc"]
    assert [one.wait(timeout=300) for one in crowd] == [0, 0, 0]
    assert len(list(folder.iterdir())) == 1


def test_code_of_other_sources_is_never_loaded(folder: Path) -> None:
    """A process that started before an edit goes on saving; the files change hands in between."""
    old, new = key("form", "before"), key("form", "after")
    keep(old, b"old code")
    assert kept(new) is None
    keep(new, b"new code")
    assert kept(old) is None
    keep(old, b"old code")
    keep(key("another", "before"), b"old code too")
    assert kept(new) is None
    keep(new, b"new code")
    assert kept(new) == b"new code"
    assert len(list(folder.iterdir())) == 1, "files of other sources are cleared away"


def test_other_functions_files_stay() -> None:
    near = key("form", base="rollout.advance-123")
    keep(near, b"near")
    keep(key("form"), b"mine")
    assert kept(near) == b"near"


def test_a_file_under_anothers_name_is_not_taken() -> None:
    """Of another processor, say: what it was made for stands in the file too."""
    path = keep(key("form for this processor"), b"code")
    path.rename(path.with_name(key("form for another").name))
    assert kept(key("form for another")) is None


def harmed_head(content: bytes) -> bytes:
    """Whole by its digest, but no JSON."""
    rest = b"{'key': 1}\ncode"
    return hashlib.sha256(rest).digest() + rest


@pytest.mark.parametrize(
    "harm", [lambda b: b[:100], lambda b: b[:80] + bytes([b[80] ^ 1]) + b[81:], lambda b: b"", harmed_head]
)
def test_a_damaged_file_is_dropped(harm: Callable[[bytes], bytes]) -> None:
    """Cut short, one bit wrong (which would run), empty, of another form."""
    path = keep(key("form"), b"x" * 200)
    path.write_bytes(harm(path.read_bytes()))
    assert kept(key("form")) is None and not path.exists()
    keep(key("form"), b"anew")
    assert kept(key("form")) == b"anew"


@pytest.mark.skipif(not hasattr(os, "kill"), reason="no signals")
def test_killed_half_way(folder: Path) -> None:
    """Nothing that a process was writing when it was killed is read, and the next one writes it."""
    lines = "import os, pathlib; from tests.test_kernel_cache import keep, key"
    lines += "; pathlib.Path.replace = lambda *_: os.kill(os.getpid(), 9); keep(key('form'), b'code')"
    python("-c", lines, code=-9)
    (part,) = folder.iterdir()
    assert kept(key("form")) is None
    keep(key("form"), b"code")
    assert kept(key("form")) == b"code" and part.exists(), "another process may be at it"
    os.utime(part, (0.0, 0.0))
    keep(key("form"), b"code")
    assert [path.name for path in folder.iterdir()] == [key("form").name], "what was left is cleared away later"


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_what_is_no_plain_file_is_not_read(folder: Path) -> None:
    """A named pipe in the place of a file, which would be waited for, and a folder; a pipe is replaced."""
    path = keep(key("form"), b"code")
    path.unlink()
    os.mkfifo(path, 0o644)
    assert kept(key("form")) is None
    keep(key("form"), b"code")
    assert kept(key("form")) == b"code"
    path.unlink()
    path.mkdir()
    assert kept(key("form")) is None


STAMP = "0123456789abcdef"


def file_of(folder: Path, name: str, stamp: str, size: int, days: float) -> Path:
    """A file that is called as one of a program is, last loaded so many days ago."""
    path = folder / f"{name}-1.{stamp}.{'0' * 24}.o"
    path.write_bytes(bytes(size))
    os.utime(path, (time.time() - days * 86400.0,) * 2)
    return path


def test_the_folder_is_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Files of other versions go that were not loaded for long, then those that were not for the longest time; what is
    no program stays."""
    monkeypatch.setenv(objects.ROOM, "1.0")
    monkeypatch.setattr(objects, "_known_size", {})
    objects.prepare(folder)
    old = file_of(folder, "a.f", "f" * 16, 10, 40.0)  # of another version
    recent = file_of(folder, "a.g", "f" * 16, 10, 1.0)
    files = [file_of(folder, f"a.h{k}", STAMP, 2**18, days) for k, days in enumerate((3.0, 50.0, 2.0, 20.0))]
    other = folder / "notes.o"
    other.write_bytes(bytes(2**20))
    own = keep(key("form", STAMP * 4), b"code")
    left = [path for path in (*files, old, recent, own, other) if path.exists()]
    assert left == [files[0], files[2], files[3], recent, own, other]
    keep(key("form two", STAMP * 4), bytes(2**18))  # counted by this process
    assert [path for path in files if path.exists()] == [files[0], files[2]]


def test_a_file_that_is_loaded_is_the_last_to_go() -> None:
    path = keep(key("form"), b"code")
    os.utime(path, (time.time() - 5000.0,) * 2)
    assert kept(key("form")) == b"code" and path.stat().st_mtime > time.time() - 60.0


def test_a_limit_that_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    for text in ("-1", "much", "nan"):
        monkeypatch.setenv(objects.ROOM, text)
        with pytest.raises(ValueError, match=f"FLEXARM_CACHE_MB = '{text}': must be a number of megabytes"):
            objects.limit()
    monkeypatch.delenv(objects.ROOM)
    assert objects.limit() == 512 * 2**20


def test_clean(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """`flexarm compile --clean` deletes programs of all versions, and nothing else."""
    objects.prepare(folder)
    file_of(folder, "a.f", "f" * 16, 2**20, 1.0)
    file_of(folder, "a.<locals>.g", STAMP, 2**20, 1.0)
    (folder / "notes.o").touch()
    assert main(["compile", "--clean", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told == {"cache_folder": str(folder), "files_deleted": 2, "MB_deleted": 2.0}
    assert [path.name for path in folder.iterdir()] == ["notes.o"]


def test_locked(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a file that another process has open cannot be replaced, it is as good, and nobody is warned."""

    def locked(*_: Any) -> None:
        raise PermissionError(errno.EACCES, "Access is denied")

    keep(key("form"), b"code")
    with monkeypatch.context() as patch, warnings.catch_warnings():
        warnings.simplefilter("error")
        patch.setattr(Path, "replace", locked)
        keep(key("form"), b"code")
    assert kept(key("form")) == b"code" and len(list(folder.iterdir())) == 1


def test_what_lies_beside_the_sources_is_read_too(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Compiled by an administrator, where the user may not write."""
    installed = tmp_path / "installed" / "flexarm_env"
    installed.mkdir(parents=True)
    monkeypatch.setattr(objects, "PACKAGE", installed)
    monkeypatch.delenv(objects.VARIABLE)
    keep(key("form"), b"code")
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    assert kept(key("form")) == b"code"
    keep(key("another"), b"mine")
    assert [path.parent.name for path in (tmp_path / "home").rglob("*.o")] == ["flexarm_env"]


# -------------------------------------------------------------------------------------- who may write
@pytest.mark.skipif(os.name != "posix", reason="no owners and modes")
@pytest.mark.parametrize(("what", "mode"), [("file", 0o664), ("file", 0o646), ("folder", 0o775), ("folder", 0o757)])
def test_what_others_can_write_is_not_read(what: str, mode: int, folder: Path) -> None:
    path = keep(key("form"), b"code")
    (path if what == "file" else folder).chmod(mode)
    assert kept(key("form")) is None
    if what == "folder":
        with pytest.warns(RuntimeWarning, match="others than you can write there"):
            keep(key("another"), b"code")
        folder.chmod(0o700)
        assert kept(key("form")) == b"code" and kept(key("another")) is None


@pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root can give a file away")
def test_what_another_owns_is_not_read(folder: Path) -> None:
    path = keep(key("form"), b"code")
    os.chown(path, 12345, -1)
    assert kept(key("form")) is None
    os.chown(path, 0, -1)
    os.chown(folder, 12345, -1)
    assert kept(key("form")) is None


@pytest.mark.skipif(os.name != "posix", reason="no modes")
def test_what_a_generous_umask_makes_is_read() -> None:
    """Where new folders can be written by a group, those of programs cannot."""
    before = os.umask(0)
    try:
        keep(key("form"), b"code")
    finally:
        os.umask(before)
    assert kept(key("form")) == b"code"


def test_nothing_is_a_pickle() -> None:
    """Nothing that is read runs before its machine code does."""
    for path in (ROOT / "flexarm_env" / "compiler").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [str(node.module)] if isinstance(node, ast.ImportFrom) else []
            assert not {"pickle", "marshal", "shelve", "dill", "cloudpickle"} & set(names), path
    path = keep(key("form"), b"code")
    assert path.read_bytes()[hashlib.sha256().digest_size :].startswith(b'{"key": "form"')


# ------------------------------------------------------------------------------------------ kernels
def twice(x):
    return 2.0 * x


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


compiled_only = pytest.mark.skipif(UNCOMPILED, reason="nothing is kept")


@compiled_only
@pytest.mark.parametrize("trouble", ["no folder", "full"])
def test_without_a_cache_it_runs(trouble: str, monkeypatch: pytest.MonkeyPatch, folder: Path, tmp_path: Path) -> None:
    """Uncached, with one warning a process: nowhere to write (a read-only system, say), a full disk."""
    if trouble == "no folder":
        (tmp_path / "file").write_text("no folder")
        monkeypatch.setenv(objects.VARIABLE, str(tmp_path / "file" / "cache"))
    else:
        monkeypatch.setattr(Path, "write_bytes", full)
    for expected in (True, False):
        function = kernel(twice)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert function(3.0) == 6.0
        told = [str(w.message) for w in said if "flexarm_env" in str(w.message)]
        assert len(told) == expected
        assert all("compiled code cannot be kept" in text and "FLEXARM_CACHE_DIR" in text for text in told)
        assert [form.made for form in function.forms.values()] == [True]
    assert not folder.exists() or not list(folder.iterdir()), "nothing is half kept"


@pytest.mark.slow
@compiled_only
def test_an_edited_source_is_compiled_anew(tmp_path: Path) -> None:
    """A kernel outside the package, whose own file changes, or that of one that it calls, or a number that it reads."""
    script, other, told = tmp_path / "script.py", tmp_path / "other.py", []
    for added, factor, number in ((1, 1, 1), (1, 1, 1), (5, 1, 1), (5, 3, 1), (5, 3, 2), (5, 3, 2)):
        begin = "from flexarm_env.compiler import kernel\n"
        other.write_text(f"{begin}@kernel\ndef g(x):\n    return {factor}.0 * x\n", encoding="utf-8")
        script.write_text(
            f"import sys\nsys.dont_write_bytecode = True\n{begin}from other import g\n"
            f"READ = float(sys.argv[1])\n@kernel\ndef f(x):\n    return READ * g(x) + {added}.0\n"
            "print(f(1.0), *(form.made for form in f.forms.values()))",
            encoding="utf-8",
        )
        told.append(python(script, str(number), FLEXARM_CACHE_DIR=str(tmp_path / "cache")).stdout.split())
    assert told == [
        ["2.0", "True"], ["2.0", "False"], ["6.0", "True"], ["8.0", "True"], ["11.0", "True"], ["11.0", "False"],
    ]  # fmt: skip


@compiled_only
def test_every_source_that_kernels_are_made_of_is_in_the_stamp() -> None:
    """An edit of any of them names other files; kernels made by `exec` are declared in one of them."""
    lines = "import gc; from flexarm_env import batch, linear; from flexarm_env.compiler.decorator import "
    lines += "Kernel; found = {x.function.__code__.co_filename for x in gc.get_objects() if isinstance(x, Kernel)}"
    found = python("-c", lines + "; print(*found, sep='\\n')").stdout.splitlines()
    sources = {str(path) for pattern in objects.COMPILED for path in objects.PACKAGE.glob(pattern)}
    assert len(found) > 50 and {file for file in found if not file.startswith("<layout ")} <= sources


@pytest.mark.slow
def test_former_names_work_with_a_warning(tmp_path: Path) -> None:
    """Those of Numba, which earlier releases were compiled by."""
    lines = "from tests.test_kernel_cache import twice; from flexarm_env.compiler import *"
    lines += "; print(MODE, kernel(twice)(1.5))"
    clean = {"FLEXARM_CACHE_DIR": "", "FLEXARM_COMPILER": ""}
    former = python("-c", lines, **clean, NUMBA_DISABLE_JIT="1")
    assert former.stdout.split() == ["python", "3.0"]
    assert "FutureWarning: NUMBA_DISABLE_JIT: is FLEXARM_COMPILER=python now" in former.stderr
    former = python("-c", lines, **clean, NUMBA_CACHE_DIR=str(tmp_path / "former"))
    assert former.stdout.split() == ["llvm", "3.0"] and list((tmp_path / "former").glob("*.o"))
    assert "FutureWarning: NUMBA_CACHE_DIR: is FLEXARM_CACHE_DIR now" in former.stderr
    both = python("-c", lines, FLEXARM_CACHE_DIR=str(tmp_path / "now"), NUMBA_CACHE_DIR=str(tmp_path / "not"))
    assert both.stderr == "" and not (tmp_path / "not").exists() and list((tmp_path / "now").glob("*.o"))
    wrong = python("-c", lines, FLEXARM_COMPILER="plain", code=1)
    assert "FLEXARM_COMPILER = 'plain': must be 'llvm' or 'python'" in wrong.stderr


@pytest.mark.slow
@compiled_only
def test_what_a_kernel_reads_of_other_files(tmp_path: Path) -> None:
    """Of another file: a constant of a module, a default, a constant of a class, one that Python reads while the kernel
    is compiled, a global array, a choice of a family: none is remembered too long."""
    text = (
        "import consts\nfrom consts import C, D, G\nfrom flexarm_env.compiler import *\nfrom typing import NamedTuple\n"
    )
    text += "class Kind(NamedTuple):\n    x: float\n@kernel\ndef one(p):\n    return p.x\n"
    text += "@kernel\ndef two(p):\n    return p.x + 1.0\nfamily = Family('p')\nchosen = family.function('f', 'p')\n"
    text += "@traced\ndef g(lane, x):\n    return (x * consts.T,)\n"
    text += "family.register(Kind, f=two if consts.T > 7.0 else one)\n"
    text += "@kernel\ndef f(x, y=D):\n    return x * consts.K + C.Z + y + g(SINGLE, x)[0] + G[1] + chosen(Kind(x))\n"
    (tmp_path / "kern.py").write_text(text, encoding="utf-8")
    script = tmp_path / "script.py"
    script.write_text("import kern\nprint(kern.f(1.0), *[p.made for p in kern.f.forms.values()])\n", encoding="utf-8")
    last, numbers = None, [2.0, 0.5, 0.25, 1.0, 4.0]
    for k, number in enumerate((2.0, 2.0, 1.5, 9.0, 3.0, 5.0, 8.0)):
        numbers[(0, 0, 1, 2, 3, 4, 3)[k]] = number
        lines = "import numpy as np\nK, D, T, G = {0}, {1}, {3}, np.array([0.0, {4}])\nclass C:\n    Z = {2}\n"
        (tmp_path / "consts.py").write_text(lines.format(*numbers), encoding="utf-8")
        told = python("-B", script, FLEXARM_CACHE_DIR=str(tmp_path / "objects")).stdout.split()
        assert told == [str(sum(numbers) + 1.0 + (numbers[3] > 7.0)), str(numbers != last)]
        last = list(numbers)
