"""Progress bar on a terminal, and the common output format of results."""

import json
import math
import sys
import time
from collections.abc import Mapping
from typing import Any, TextIO


class ProgressBar:
    """Progress bar on a terminal; call it with the completed fraction, 0 to 1. It appears after half a second."""

    def __init__(self, label: str, stream: TextIO | None = None, after: float = 0.5) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._visible = self._stream.isatty()
        self._label, self._start, self._after = label, time.monotonic(), after
        self._drawn = ""

    def __call__(self, share: float) -> None:
        """Draw the bar at a fraction (0 to 1) of the work, with the remaining time; silent for the first half
        second.
        """
        spent = time.monotonic() - self._start
        if not self._visible or spent < self._after:
            return
        width = 30
        full = int(width * share)
        left = f", {spent / share - spent:.0f} s left" if share > 0.02 else ""
        text = f"{self._label} [{'#' * full}{'.' * (width - full)}] {share:4.0%}{left}"
        if text != self._drawn:
            self._write(text)

    def _write(self, text: str) -> None:
        self._stream.write("\r" + text.ljust(len(self._drawn)))
        self._stream.flush()
        self._drawn = text

    def close(self) -> None:
        """Erase the bar."""
        if self._drawn:
            self._stream.write("\r" + " " * len(self._drawn) + "\r")
            self._stream.flush()
            self._drawn = ""


def show(values: Mapping[str, Any], as_json: bool) -> None:
    """Print results as `name: value` lines, or as one JSON object."""
    if as_json:
        print(json.dumps({name: _plain(value) for name, value in values.items()}, indent=2))
        return
    for name, value in values.items():
        print(f"{name}: {_text(value)}")


def _text(value: Any) -> str:
    """Format a value for a line of text: six digits, nested values joined by commas."""
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, Mapping):
        return ", ".join(f"{key}={_text(item)}" for key, item in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(_text(item) for item in value)
    return str(value)


def _plain(value: Any) -> Any:
    """Replace infinite and NaN numbers, which JSON lacks, by null."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, Mapping):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value
