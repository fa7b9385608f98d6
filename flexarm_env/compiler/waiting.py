"""One line for who waits for the compiler.

It goes to the logger `flexarm_env`, which writes to standard error unless told otherwise;
`logging.getLogger("flexarm_env").setLevel("ERROR")` silences it.
"""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

LOG = logging.getLogger("flexarm_env")

AFTER, PAUSE = 0.5, 3.0
"""s that a compilation lasts before it is worth a line; s without one after which another wait begins."""

ENVIRONMENT = ("entry", "episode", "starts", "work")
"""Modules whose kernels an environment calls; those of the others move or look at the arm of a scene."""

_ended = float("-inf")
"""When the last compilation of a wait that has been announced ended (`time.monotonic`)."""


@contextmanager
def announced(function: Callable[..., Any]) -> Iterator[None]:
    """While a kernel is compiled: say so, once for kernels that are compiled one after the other."""
    global _ended
    said, begun = threading.Event(), time.monotonic()

    def say() -> None:
        said.set()
        what = "environment" if function.__module__.rpartition(".")[2] in ENVIRONMENT else "arm of the scene"
        LOG.warning("flexarm_env: compiling the %s, on first use ('flexarm compile' does it beforehand)", what)

    timer = threading.Timer(AFTER, say)
    timer.daemon = True
    if begun - _ended < PAUSE:
        said.set()
    else:
        timer.start()
    try:
        yield
    finally:
        timer.cancel()
        if timer.ident is not None:
            timer.join()
            if not said.is_set() and time.monotonic() - begun >= AFTER:  # the timer's thread had no turn
                say()
        if said.is_set():
            _ended = time.monotonic()
