"""Compiled code on disk: nobody loads what is damaged or was written for something else, nobody has to have it."""

from __future__ import annotations

import errno
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from numba import config
from numba.core import caching

from flexarm_env.compiler import cache
from flexarm_env.compiler import decorator as jit
from flexarm_env.compiler.cache import KernelCache, Shelf
from flexarm_env.compiler.private import MODE
from tests.processes import python


def shelf(folder: Path, stamp: str = "sources", base: str = "rollout.advance-12.py311") -> Shelf:
    """One process's view of the forms of one function."""
    return Shelf([folder], base, stamp)


def same(data: Any) -> Any:
    return data


def test_processes_that_compile_at_once_keep_their_own_code(tmp_path: Path) -> None:
    one, other = shelf(tmp_path), shelf(tmp_path)
    assert one.load("one link", same) is None and other.load("two links", same) is None
    one.save("one link", "code for one link")
    other.save("two links", "code for two links")
    for reader in (one, other, shelf(tmp_path)):
        assert reader.load("one link", same) == "code for one link"
        assert reader.load("two links", same) == "code for two links"


def test_code_of_other_sources_is_never_loaded(tmp_path: Path) -> None:
    """A process that started before an edit goes on saving; the files change hands in between."""
    old, new = shelf(tmp_path, "before"), shelf(tmp_path, "after")
    old.save("form", "old code")
    assert new.load("form", same) is None
    new.save("form", "new code")
    assert old.load("form", same) is None
    old.save("form", "old code")
    old.save("another", "old code too")
    assert new.load("form", same) is None
    new.save("form", "new code")
    assert shelf(tmp_path, "after").load("form", same) == "new code"
    assert len(list(tmp_path.iterdir())) == 1, "files of other sources are cleared away"


def test_other_functions_files_stay(tmp_path: Path) -> None:
    near = shelf(tmp_path, base="rollout.advance-123.py311")
    near.save("form", "near")
    shelf(tmp_path).save("form", "mine")
    assert near.load("form", same) == "near"


@pytest.mark.parametrize("harm", [lambda b: b[:100], lambda b: b[:80] + bytes([b[80] ^ 1]) + b[81:], lambda b: b""])
def test_a_damaged_file_is_dropped(harm: Callable[[bytes], bytes], tmp_path: Path) -> None:
    """Cut short, one bit wrong (which would run), empty."""
    own = shelf(tmp_path)
    own.save("form", "x" * 200)
    (path,) = tmp_path.iterdir()
    path.write_bytes(harm(path.read_bytes()))
    assert own.load("form", same) is None and not path.exists()
    own.save("form", "anew")
    assert own.load("form", same) == "anew"


def test_what_lies_beside_the_sources_is_read_too(tmp_path: Path) -> None:
    """Compiled by an administrator, where the user may not write."""
    shelf(tmp_path / "installed").save("form", "code")
    user = Shelf([tmp_path / "home", tmp_path / "installed"], "rollout.advance-12.py311", "sources")
    assert user.load("form", same) == "code"
    user.save("another", "mine")
    assert [path.parent.name for path in tmp_path.rglob("*.nbc")].count("home") == 1


def twice(x):
    return 2.0 * x


def full(*_: Any) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


compiled_only = pytest.mark.skipif(bool(config.DISABLE_JIT) or MODE == "plain", reason="nothing is kept")


@compiled_only
@pytest.mark.parametrize("trouble", ["no folder", "full", "renamed", "renamed form", "other interface"])
def test_without_a_cache_it_runs(trouble: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Uncached, with one warning a process: nowhere to write, a full disk, a Numba whose inner names have changed."""
    monkeypatch.setattr(cache, "_said", False)
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    if trouble == "no folder":
        monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "file" / "cache"))
        monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
        monkeypatch.setattr(Path, "mkdir", lambda self, **_: (tmp_path / "file" / "no").write_text(""))
    elif trouble == "full":
        monkeypatch.setattr(Path, "write_bytes", full)
    elif trouble == "renamed":
        monkeypatch.delattr(caching, "CompileResultCacheImpl")
    elif trouble == "renamed form":
        monkeypatch.delattr(cache.CompileResult, "_reduce")
    else:
        monkeypatch.delattr(KernelCache, "load_overload")
        monkeypatch.delattr(KernelCache, "save_overload")
    for expected in (trouble != "other interface", False):
        function = jit.kernel(twice)
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            assert function(3.0) == 6.0
        told = [str(w.message) for w in said if "flexarm_env" in str(w.message)]
        assert len(told) == expected
        assert all("compiled code cannot be kept" in text and "NUMBA_CACHE_DIR" in text for text in told)
        assert not function._cache_hits
    assert not list((tmp_path / "cache").rglob("*.nbc")), "nothing is half kept"


@compiled_only
def test_an_edited_source_is_compiled_anew(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A kernel outside the package, whose own file changes."""
    lines = "import sys; from flexarm_env.compiler.decorator import kernel\n@kernel\ndef f(x):\n    return x + {}\n"
    lines += "print(f(1.0), sum(f._cache_hits.values()))"
    script, told = tmp_path / "script.py", []
    for added in ("1.0", "1.0", "5.0"):
        script.write_text(lines.format(added), encoding="utf-8")
        told.append(python(script, NUMBA_CACHE_DIR=str(tmp_path)).stdout.split())
    assert told == [["2.0", "0"], ["2.0", "1"], ["6.0", "0"]]
