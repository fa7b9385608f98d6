"""What all commands share: exit codes, errors in one sentence.

Exit codes: 0 done; 1 the run ended early (its status is in the output) or a check failed; 2 the input is wrong or
something is missing; 3 a run is inaccurate, asked for by --strict; 130 interrupted. An error is one sentence on
standard error.
"""

DONE, FAILED, BAD_INPUT, NOT_ACCURATE, INTERRUPTED = 0, 1, 2, 3, 130


def sentence(error: BaseException) -> str:
    """An error in one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"more than this machine's memory holds: {error}".removesuffix(": ")
    return " ".join(str(error).split()) or type(error).__name__
