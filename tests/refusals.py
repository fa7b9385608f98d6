"""What is refused, and how the refusal reads."""

from collections.abc import Callable
from typing import Any

import pytest


def refuses(words: str, call: Callable[[], Any], kind: type[Exception] = ValueError) -> None:
    """The call raises an error of this kind, and the regular expression is found in its sentence."""
    with pytest.raises(kind, match=words):
        call()


def refusal(call: Callable[[], Any], kind: type[Exception] = ValueError) -> str:
    """The sentence of the error of this kind that the call raises."""
    with pytest.raises(kind) as caught:
        call()
    return str(caught.value)


def says(words: str, call: Callable[[], Any], kind: type[Exception] = ValueError) -> None:
    """The call raises an error of this kind with these words in its sentence, as they stand here."""
    assert words in refusal(call, kind)
