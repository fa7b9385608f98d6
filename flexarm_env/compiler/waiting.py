"""Progress messages of the compiler: which program of how many is compiled, and the time spent so far.

Each program that takes longer than half a second gets a line in the logger `flexarm_env`, which writes to standard
error unless configured otherwise; `logging.getLogger("flexarm_env").setLevel("ERROR")` silences the logger. On a
terminal a counter of seconds appears below the line.
"""

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

LOG = logging.getLogger("flexarm_env")

AFTER, PAUSE, TICK = 0.5, 3.0, 1.0
"""Three times in seconds. AFTER: duration of a compilation before a message is written. PAUSE: time without compilation
after which messages count programs and seconds anew. TICK: time between two updates of the counter on a terminal.
"""

PARTS = {
    "step": "a control period", "start_episodes": "starts of episodes", "guided_period": "a period with motions",
    "observe_arm": "the arm's shape", "sample_rows": "the run of a scene", "restart": "the start of a motion",
    "equations": "the equations of motion", "linearize": "linear models",
}  # fmt: skip
"""Purpose of each kernel that Python calls, by name. The kernels of an environment are first, in the order of
compilation.
"""


class Task(NamedTuple):
    """Name of a compilation for messages, and the number of programs that it compiles (0: unknown)."""

    what: str = ""
    programs: int = 0


_task: ContextVar[Task | None] = ContextVar("_task", default=None)
_silent = ContextVar("_silent", default=False)
"""True if compilation in this context is not announced, because nobody waits for it."""

_began, _ended, _count = float("-inf"), float("-inf"), 0
"""The last wait: its start, the end of its last compilation (`time.monotonic`, s), its number of programs so far."""


@contextmanager
def compiling(what: str, programs: int = 0) -> Iterator[None]:
    """Context manager that sets the name of the current compilation in messages. If contexts are nested, messages use
    the name of the outermost one.

    what: name of the compilation. programs: number of programs that it compiles; PARTS has their names.
    """
    mark = _task.set(_task.get() or Task(what, programs))
    try:
        yield
    finally:
        _task.reset(mark)


@contextmanager
def unannounced() -> Iterator[None]:
    """Context manager that suppresses messages about compilation in this context."""
    before = _silent.set(True)
    try:
        yield
    finally:
        _silent.reset(before)


@contextmanager
def announced(function: Callable[..., Any]) -> Iterator[None]:
    """Announce the compilation of a kernel if it lasts longer than AFTER seconds, and count seconds on a terminal.

    A thread writes the messages, because the compiler does not return before it has finished.
    """
    global _began, _ended, _count
    if _silent.get():
        yield
        return
    start, over = time.monotonic(), threading.Event()
    # a new wait begins after a pause
    if start - _ended >= PAUSE:
        _began, _count = start, 0
    _count += 1
    line, said = _line(function, start), threading.Event()

    def say() -> None:
        said.set()
        LOG.warning("%s", line)

    def tick() -> None:
        """Log the line after AFTER seconds, then update the counter every TICK seconds (a thread's function)."""
        if over.wait(AFTER):
            return
        say()
        # the counter is shown on terminals only
        shown = sys.stderr is not None and sys.stderr.isatty() and LOG.isEnabledFor(logging.WARNING)
        while not over.wait(TICK):
            if shown:
                sys.stderr.write(f"\r  {time.monotonic() - start:.0f} s ")
                sys.stderr.flush()
        if shown:
            sys.stderr.write("\r" + " " * 12 + "\r")
            sys.stderr.flush()

    teller = threading.Thread(target=tick, daemon=True)
    teller.start()
    try:
        yield
    finally:
        over.set()
        teller.join()
        # the thread was not scheduled in time
        if not said.is_set() and time.monotonic() - start >= AFTER:
            say()
        _ended = time.monotonic()


def _line(function: Callable[..., Any], start: float) -> str:
    """Return the message about a kernel whose compilation began at the time `start` (`time.monotonic`, s)."""
    name, (what, programs) = function.__name__, _task.get() or Task()
    # purpose of the kernel, and its place among the programs of an environment
    part, place = PARTS.get(name, name.strip("_").replace("_", " ")), [*PARTS, name].index(name) + 1
    which = f"program {place} of {programs}" if place <= programs else f"program {_count}"
    spent = f", {start - _began:.0f} s so far" if _count > 1 else ""
    hint = " (once; 'flexarm compile' does it beforehand)" if _count == 1 else ""
    return f"flexarm_env: compiling {what + ', ' if what else ''}{which}: {part}{spent}{hint}"
