"""What all commands share: exit codes, errors in one sentence, the ArgumentParser.

Exit codes: 0 done; 1 the run ended early (its status is in the output) or a check failed; 2 the input is wrong or
something is missing; 3 a run is inaccurate, asked for by --strict; 130 interrupted. An error is one sentence on
standard error.
"""

import argparse
import sys
from typing import Any, NoReturn

DONE, FAILED, BAD_INPUT, NOT_ACCURATE, INTERRUPTED = 0, 1, 2, 3, 130


class Parser(argparse.ArgumentParser):
    """An ArgumentParser whose errors are one sentence, and whose help keeps its line breaks."""

    def __init__(self, **options: Any) -> None:
        options.setdefault("formatter_class", argparse.RawDescriptionHelpFormatter)
        super().__init__(allow_abbrev=False, **options)

    def error(self, message: str) -> NoReturn:
        """Leave with code 2 and a sentence that says where help is."""
        sys.stderr.write(f"{self.prog}: {message} (see {self.prog} --help)\n")
        sys.exit(BAD_INPUT)


def sentence(error: BaseException) -> str:
    """An error in one line."""
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    if isinstance(error, MemoryError):
        return f"more than this machine's memory holds: {error}".removesuffix(": ")
    return " ".join(str(error).split()) or type(error).__name__
