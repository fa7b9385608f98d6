"""Medians, means and rates with bootstrap intervals, and their Markdown tables."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from flexarm_env.files import table
from flexarm_env.training.episodes import Episodes
from flexarm_env.validation import Array

RESAMPLES = 4000
LEVEL = 0.95


def bootstrap(values: Array, statistic: Callable[..., Any], seed: int = 0) -> tuple[float, float]:
    """Return the percentile bootstrap interval (95 %) of a statistic of the values (n,).

    statistic: NumPy function with an argument `axis`, such as np.median.
    """
    from scipy import stats

    if len(values) == 1:  # SciPy rejects a single value
        return float(values[0]), float(values[0])
    found = stats.bootstrap(
        (values,), statistic, n_resamples=RESAMPLES, confidence_level=LEVEL, method="percentile", random_state=seed
    ).confidence_interval
    return float(found.low), float(found.high)


QUANTITIES: dict[str, tuple[str, Callable[..., Any], Callable[[Episodes], Array]]] = {
    "success_rate": ("success", np.mean, lambda e: e.success.astype(float)),
    "settling_time_median": ("settling (s)", np.median, lambda e: e.settling),
    "settling_time_mean": ("settling, mean (s)", np.mean, lambda e: e.settling),
    "residual_vibration_median": ("residual vibration (mm)", np.median, lambda e: e.vibration * 1e3),
    "overshoot_median": ("overshoot (%)", np.median, lambda e: e.overshoot * 100.0),
    "effort_median": ("effort (s)", np.median, lambda e: e.effort),
    "return_mean": ("return", np.mean, lambda e: e.returns),
}
"""Quantities of a table by JSON key: heading, statistic, and function that returns the values of `Episodes`. Vibration
is in mm, overshoot in %."""


def summary(result: Episodes) -> dict[str, Any]:
    """Return a statistic and an interval (key + "_interval") for each of `QUANTITIES`, and two rates.

    The first rate is the share of episodes that settled; the second rate is the share of episodes that ended early.
    """
    out: dict[str, Any] = {"episodes": len(result.success)}
    for key, (_, statistic, values) in QUANTITIES.items():
        numbers = values(result)
        out[key] = float(statistic(numbers))
        out[f"{key}_interval"] = list(bootstrap(numbers, statistic))
    out["settled_rate"] = float(result.settled.mean())
    out["terminated_rate"] = float(result.terminated.mean())
    return out


def markdown(rows: Mapping[str, Mapping[str, Any]], bounds: Mapping[str, float] | None = None) -> str:
    """Format a Markdown table with a row per policy and intervals in brackets, and below it the times in `bounds`."""
    lines = []
    for name, row in rows.items():
        lines.append((name, *(_cell(key, row[key], row[f"{key}_interval"]) for key in QUANTITIES)))
    for name, value in (bounds or {}).items():
        shown = {"settling_time_median": f"{value:.2f}"}
        lines.append((f"*{name}*", *(shown.get(key, "") for key in QUANTITIES)))
    heads = " | ".join(["policy", *(head for head, _, _ in QUANTITIES.values())])
    return "\n".join(table(heads, lines, numbers=True)) + "\n"


def _cell(key: str, value: float, interval: Sequence[float]) -> str:
    """Format a value together with its interval."""
    if key == "success_rate":
        return f"{value:.0%} [{interval[0]:.0%}, {interval[1]:.0%}]"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2
    return f"{value:.{digits}f} [{interval[0]:.{digits}f}, {interval[1]:.{digits}f}]"
