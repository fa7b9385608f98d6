"""How the whole check is run (`.ci/run`): what its processes share."""

import pytest

from tests.processes import python


@pytest.mark.slow
def test_processes_of_a_run_draw_by_one_seed_and_leave_out_what_comes_too_late() -> None:
    """Two processes that ordered files by seeds of their own would be told that they differ."""
    files = [f"tests/test_{name}.py" for name in ("parameters", "scene", "scene_toml", "shapes", "time_functions")]
    words = ["-m", "pytest", "-n", "2", "--dist", "loadfile", "-q", "-p", "no:cacheprovider", *files]
    late = python(*words, "--within", "0", CI="1").stdout.splitlines()[-1]
    assert "skipped" in late and "passed" not in late
    assert "skipped" not in python(*words[:-3], "--within", "600", CI="1").stdout
