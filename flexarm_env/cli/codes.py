"""Exit codes and error messages of all commands.

Exit codes: 0: success. 1: a simulation ended early (the output contains its status), or a check failed. 2: the input is
wrong, or a file or package is missing. 3: a simulation is inaccurate, and --strict was given. 4: `flexarm run` ended
early; `ended` in the output is the reason. 130: interrupted. An error message is one sentence on standard error.
"""

DONE, FAILED, BAD_INPUT, NOT_ACCURATE, ENDED_EARLY, INTERRUPTED = 0, 1, 2, 3, 4, 130


def sentence(error: BaseException) -> str:
    """Return an error as one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"not enough memory: {error}".removesuffix(": ")
    return " ".join(str(error).split()) or type(error).__name__
