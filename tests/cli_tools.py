"""What the tests of the command line share."""

import json
from typing import Any

import pytest

from flexarm_env.cli import main


def answer(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> Any:
    """The JSON that a command prints, which must end with this code."""
    capsys.readouterr()
    assert main([*words, "--json"]) == code
    return json.loads(capsys.readouterr().out)


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """The sentence on standard error of a command that must end with code 2."""
    try:
        code = main(list(words))
    except SystemExit as stop:
        code = int(stop.code or 0)
    printed = capsys.readouterr()
    assert code == 2
    assert printed.out == ""
    assert printed.err.startswith("flexarm")
    assert printed.err.count("\n") == 1
    assert "Traceback" not in printed.err
    return printed.err
