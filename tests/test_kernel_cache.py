"""Compiled code on disk: nobody may load what another process has written for something else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from numba.core.caching import IndexDataCacheFile

from flexarm_env.kernels.jit import _told_apart


def index(folder: Path, stamp: str = "sources") -> Any:
    """One process's view of the forms of one function."""
    made = IndexDataCacheFile(str(folder), "advance-12.py311", stamp)
    made.save = _told_apart(made)
    return made


def test_processes_that_compile_at_once_keep_their_own_code(tmp_path: Path) -> None:
    """Both have found an empty index, and each saves another form: Numba itself gives both the same file."""
    one, other = index(tmp_path), index(tmp_path)
    read = one._load_index
    one._load_index = other._load_index = dict
    one.save("one link", "code for one link")
    other.save("two links", "code for two links")
    one._load_index = other._load_index = read
    for reader in (one, other, index(tmp_path)):
        assert reader.load("one link") in (None, "code for one link")
        assert reader.load("two links") == "code for two links"


def test_code_of_other_sources_is_never_loaded(tmp_path: Path) -> None:
    """A process that started before an edit goes on saving; the index and the files change hands in between."""
    old, new = index(tmp_path, "before"), index(tmp_path, "after")
    old.save("form", "old code")
    assert new.load("form") is None
    new.save("form", "new code")
    assert old.load("form") is None
    old.save("form", "old code")
    old.save("another", "old code too")
    assert new.load("form") is None
    new.save("form", "new code")
    assert new.load("form") == "new code"
    assert index(tmp_path, "after").load("form") == "new code"
    assert len(list(tmp_path.glob("*.nbc"))) == 1, "files of other sources are cleared away"


def test_other_functions_files_stay(tmp_path: Path) -> None:
    near = IndexDataCacheFile(str(tmp_path), "advance-123.py311", "sources")
    near.save = _told_apart(near)
    near.save("form", "near")
    index(tmp_path).save("form", "mine")
    assert near.load("form") == "near"
