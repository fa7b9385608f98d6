"""Exit codes and error messages of all commands.

Exit codes: 0 success. 1 the run ended early (its status is in the output), or a check failed. 2 the input is wrong, or
something is missing. 3 a run is inaccurate, and --strict was given. 4 `flexarm run` ended early; `ended` in the output
gives the reason (the watchdog expired, a limit holds the arm, ...). 130 interrupted. An error message is one sentence
on standard error.
"""

DONE, FAILED, BAD_INPUT, NOT_ACCURATE, ENDED_EARLY, INTERRUPTED = 0, 1, 2, 3, 4, 130


def sentence(error: BaseException) -> str:
    """Return an error as one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}".removesuffix(": ")
    return " ".join(str(error).split()) or type(error).__name__
