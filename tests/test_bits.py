"""`benchmarks.bits` and its gate: derivatives are compared exactly; the record is whole; another machine compares with
the commit before."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import bits, bits_gate

COVERED = {
    "plane": {
        "scene": ("segments", "modes", "exact", "elastica", "paper", "multipliers", "root frames"),
        "env": ("FlexibleArm-v0, default, 1", "FlexibleArm-v0, exact, 1", "TwoLinkFlexArm-v0, floating, 1"),
        "batch": ("FlexibleArm-v0, default, 11", "TwoLinkFlexArm-v0, exact, 11", "FlexibleArm-v0, floating, 11"),
        "derivative": ("derivatives, one link", "derivatives, exact", "derivatives, floating"),
    },
    "space": {
        "scene": ("segments", "modes", "exact", "elastica"),
        "env": ("env, exact, 1", "env, segments, 1", "env, modes, 1"),
        "batch": ("env, exact, 11", "env, segments, 11", "env, modes, 11"),
        "derivative": ("derivatives, exact", "derivatives, segments", "derivatives, modes"),
    },
}
"""What the gate has of each formulation: ends of names."""


@pytest.mark.parametrize("change", [0.0, 1e-13, 1e-9])
def test_derivatives_are_compared_exactly_unless_within_is_given(
    change: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    file, x = tmp_path / "bits.json", 1.0

    def case() -> dict[str, Any]:
        return {"q": [1.0, np.nan], "d_q": [x, 2.0]}

    monkeypatch.setattr(bits, "cases", lambda: {"one": case})
    assert bits.main([str(file)]) == 0
    x += change
    assert bits.main([str(file), "--compare"]) == (change > 0.0)
    assert bits.main([str(file), "--compare", "--within", "1e-12"]) == (change > 1e-12)
    assert ("d_q: off by" in capsys.readouterr().out) == (change > 0.0)


def test_the_record_has_every_case_of_the_gate_and_none_is_refused() -> None:
    known = bits_gate.read(bits_gate.RECORD)
    assert list(known["cases"]) == list(bits_gate.GATE)
    assert set(bits_gate.GATE) <= set(bits.cases())
    assert set(known["computed with"]) == set(bits_gate.machine())
    for name, parts in known["cases"].items():
        assert len(parts) > 3, f"{name}: {parts}"
        assert all(re.fullmatch("[0-9a-f]{16}", one) for one in parts.values())


@pytest.mark.parametrize("where", COVERED)
def test_the_gate_has_scenes_environments_batches_and_derivatives_of_each_formulation(where: str) -> None:
    names = [name for name in bits_gate.GATE if name.startswith("space, ") == (where == "space")]
    for ends in COVERED[where].values():
        for end in ends:
            assert any(name.endswith(end) for name in names), f"{where}: {end}"
    kinds = "\n".join(name for name in bits.cases() if name.startswith("space, "))
    for word in ("gears", "rubbing", "play", "free flight", "events", "rigid, free", "guided", "controller"):
        assert where == "plane" or word in kinds


@pytest.fixture
def gate(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository of one commit, whose gate computes two cases as `numbers.json` says."""
    (tmp_path / "benchmarks").mkdir()
    (tmp_path / "benchmarks" / "bits_gate.py").write_text(
        "import shutil, sys\nshutil.copy('numbers.json', sys.argv[sys.argv.index('--write') + 1])\n"
    )
    record = tmp_path / "benchmarks" / "bits_record.json"
    monkeypatch.setattr(bits_gate, "ROOT", tmp_path)
    monkeypatch.setattr(bits_gate, "RECORD", record)
    monkeypatch.setattr(bits_gate, "GATE", ("one", "two"))
    numbers(tmp_path, record, "a", "b")
    numbers(tmp_path, tmp_path / "numbers.json", "a", "b")
    return tmp_path


def numbers(root: Path, file: Path, one: str, two: str) -> None:
    """Write a record of two cases by another machine."""
    file.write_text(json.dumps({"computed with": {}, "cases": {"one": {"q": one}, "two": {"q": two}}}))


def commit(root: Path) -> None:
    """All that is there."""
    own = ["git", "-c", "user.name=n", "-c", "user.email=e"]
    subprocess.run(["git", "init", "-q"], cwd=root, check=True)
    subprocess.run(["git", "add", "."], cwd=root, check=True)
    subprocess.run([*own, "commit", "-q", "-m", "m"], cwd=root, check=True)


def computing(monkeypatch: pytest.MonkeyPatch, one: str, two: str) -> None:
    """What this tree's cases come to."""
    found = {"one": {"q": one}, "two": {"q": two}}
    monkeypatch.setattr(bits_gate, "hashes", lambda names: {name: found[name] for name in names})


def test_on_the_records_machine_the_gate_compares_with_the_record(
    gate: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    computing(monkeypatch, "a", "b")
    assert bits_gate.main(["--write"]) == 0
    assert bits_gate.main([]) == 0
    assert "2 of 2 cases equal the record" in capsys.readouterr().out
    computing(monkeypatch, "a", "c")
    assert bits_gate.main([]) == 1
    assert "two: q" in capsys.readouterr().out


def test_without_a_commit_before_another_machine_compares_nothing(
    gate: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    computing(monkeypatch, "other", "bits")
    assert bits_gate.main([]) == 0
    assert "nothing is compared: there is no commit before" in capsys.readouterr().out


@pytest.mark.skipif(shutil.which("git") is None, reason="needs git")
def test_another_machine_compares_with_the_commit_before(
    gate: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    numbers(gate, gate / "numbers.json", "x", "y")  # the bits of this machine
    commit(gate)
    computing(monkeypatch, "x", "y")
    assert bits_gate.main([]) == 0
    assert "nothing is compared" in capsys.readouterr().out  # a first commit

    (gate / "file").write_text("changed")
    commit(gate)
    assert bits_gate.main([]) == 0
    assert "2 of 2 cases equal the commit before" in capsys.readouterr().out
    computing(monkeypatch, "x", "z")
    assert bits_gate.main([]) == 1
    assert "two: q" in capsys.readouterr().out

    # a commit that says so by its record
    numbers(gate, bits_gate.RECORD, "a", "c")
    commit(gate)
    assert bits_gate.main([]) == 0
    assert "1 of 1 cases equal the commit before" in capsys.readouterr().out
