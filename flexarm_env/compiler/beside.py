"""Background compilation: a thread computes a value after a number of calls, so that it is ready when needed."""

import contextlib
import threading
from collections.abc import Callable
from typing import Generic, TypeVar

from .waiting import unannounced

T = TypeVar("T")


class Beside(Generic[T]):
    """A value that is computed once: by a thread after the method `count` was called `calls` times, or earlier by
    `get`.

    With calls = 0 only `get` computes the value. The thread is no daemon thread: LLVM cannot be interrupted, so the
    process waits for the thread before it exits.
    """

    def __init__(self, calls: int) -> None:
        """calls: number of calls of `count` before the thread starts."""
        self._left = calls
        self._found: T | None = None
        self._thread: threading.Thread | None = None

    def count(self, make: Callable[[], T]) -> None:
        """Count a call; the call with number `calls` starts the thread, which computes the value by calling `make`."""
        if self._left > 0:
            self._left -= 1
            if self._left == 0 and self._found is None:
                self._thread = threading.Thread(target=self._run, args=(make,), name="flexarm-compile")
                self._thread.start()

    def _run(self, make: Callable[[], T]) -> None:
        """Function of the thread: make the value without messages; drop an exception, because `get` will raise it
        again."""
        # no message and no error, because nobody waits for the result
        with unannounced(), contextlib.suppress(Exception):
            self._found = make()

    def get(self, make: Callable[[], T]) -> T:
        """Return the value: wait for the running thread, or compute the value now by calling `make`."""
        thread, self._thread = self._thread, None
        if thread is not None:
            thread.join()
        if self._found is None:
            self._found = make()
        return self._found
