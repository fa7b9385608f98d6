"""What the tests of the command line share."""

import pytest

from flexarm_env.cli import main


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
