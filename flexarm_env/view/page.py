"""HTML page of the player: data, style and script in one file that needs no network."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from .. import validation as check
from ..files import write_text
from ..validation import Array
from .clip import Chart, Clip, packed, short
from .space import SpaceClip, check_alike

MOST_BYTES = 2_900_000
"""Largest size of a page; if all instants need more, instants are omitted evenly."""


class Player:
    """Page that plays clips in one picture or side by side.

    Args:
        clips: the clips to play, at least one, with different labels. title: title of the page; by default the labels
            of the clips.
        most_bytes: largest size of the page in bytes. If the clips exceed `most_bytes`, instants are omitted at equal
            intervals.
    Raises:
        ValueError: there is no clip, or the clips are too large even with two instants each.
    """

    def __init__(
        self, clips: Sequence[Clip | SpaceClip], title: str | None = None, most_bytes: int = MOST_BYTES
    ) -> None:
        """Pack clips for the page; omit instants until the page has at most most_bytes.

        Raises:
            ValueError: there is no clip, planar and spatial clips are mixed, or most_bytes is too small for two
                instants.
        """
        if not clips:
            raise check.InvalidValue("clips", clips, "must hold at least one")
        self.title = _listed([clip.label for clip in clips]) if title is None else title
        check_alike(clips)
        own = _apart(list(clips))
        step = 1
        while len(text := _json(own, step, self.title)) + len(_script(text)) + 20_000 > most_bytes:
            if all(len(clip.every(step).t) <= 2 for clip in own):
                raise check.InvalidValue("most_bytes", most_bytes, f"must be at least {len(text) + 100_000} here")
            step += 1 if step < 4 else step // 3
        self.data = text

    @classmethod
    def of(cls, runs: Sequence[Any], labels: Sequence[str] | None, *how: Any) -> Player:
        """Create a player of trajectories or episodes, which have a method `clip(label, *how)`.

        Raises ValueError if the number of labels is not the number of runs.
        """
        names = [None] * len(runs) if labels is None else list(labels)
        if len(names) != len(runs):
            raise check.InvalidValue("labels", labels, f"must be {len(runs)} names, one for each")
        return cls([run.clip(name, *how) for run, name in zip(runs, names, strict=True)])

    @property
    def html(self) -> str:
        """Return the page's HTML."""
        return page(self.data, self.title)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write the page to a file atomically, and create its folder if necessary. Raises OSError if writing fails."""
        target = Path(path)
        write_text(target, self.html)
        return target

    def _repr_html_(self) -> str:
        """Return the page in an isolated frame, for notebooks."""
        return frame(f'srcdoc="{html.escape(self.html)}"', self.title)


def frame(source: str, title: str) -> str:
    """Return the HTML of an iframe that shows a player. source: the iframe's attribute src or srcdoc."""
    style = 'style="width: 100%; height: 44rem; border: 1px solid #8884; border-radius: 8px"'
    name = f'title="{html.escape(f"Player: {title}")}"'
    return f'<iframe {source} {name} sandbox="allow-scripts" allow="fullscreen" loading="lazy" {style}></iframe>'


def page(data: str, title: str) -> str:
    """Return the HTML page of a `Player` with the given data."""
    style, script = _part("player.css"), _script(data)
    own = f"script-src {_hash(script)}; style-src {_hash(style)}"
    policy = f"default-src 'none'; {own}; base-uri 'none'; form-action 'none'"
    parts = {"title": html.escape(title), "policy": policy, "style": style, "script": script, "data": data}
    return re.sub(r"%(\w+)%", lambda found: parts[found.group(1)], _part("player.html"))


def _part(name: str) -> str:
    return (resources.files(__package__) / name).read_text("utf-8")


def _script(data: str) -> str:
    """Return the page's script; arms in space also need three.js."""
    stage = ("three.min.js", "space.js") if '"across":' in data else ("arm.js",)
    return "".join(_part(name) for name in ("clip.js", *stage, "player.js"))


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


# ------------------------------------------------------------------ numbers
def _json(clips: Sequence[Any], step: int, title: str) -> str:
    known = {"title": title, "clips": [_clip(clip.every(step)) for clip in clips]}
    return json.dumps(known, separators=(",", ":")).replace("<", "\\u003c")  # no </script> in it


def _clip(clip: Clip | SpaceClip) -> dict[str, Any]:
    return _common(clip) | clip.own_entries()


def _common(clip: Clip | SpaceClip) -> dict[str, Any]:
    """Return the entries of the page's data that all clips have: points (m), instants (s), torques, charts."""
    roots, optional = clip.points[:, :1], {"rigid": clip.rigid, "target": clip.target}
    return {
        "root": packed("f8", roots[:, 0]),
        "points": packed("f4", clip.points - roots),  # of the arm's size wherever it is: good to 1e-7 of it
        **{name: None if x is None else packed("f4", x) for name, x in optional.items()},
        **{name: getattr(clip, name) for name in ("cuts", "pinned", "payload")},
        "label": clip.label,
        "note": clip.note + (f", one instant of {clip.skipped}" if clip.skipped > 1 else ""),
        "t": packed("f8", clip.t),
        "pulls": [
            {"name": p.name, "point": p.point, "values": short(p.values), "most": _most(p.values, p.limit)}
            | ({} if p.axis is None else {"axis": packed("f4", p.axis)})
            for p in clip.pulls
        ],
        "charts": [
            {"title": chart.title, "series": {name: short(values) for name, values in chart.series.items()}}
            for chart in clip.charts
        ],
    }


def _most(values: Array, limit: float | None) -> float:
    size = np.linalg.norm(values, axis=1) if values.ndim == 2 else np.abs(values)
    known = limit if limit is not None and np.isfinite(limit) else 0.0
    return max(float(known), float(size.max()))  # a motion that is prescribed takes what it needs, beyond any limit


# -------------------------------------------------------------- many clips
def _listed(labels: Sequence[str]) -> str:
    *others, last = dict.fromkeys(labels)
    return f"{', '.join(others)} and {last}" if others else last


def _apart(clips: list[Any]) -> list[Any]:
    """Return clips with distinct labels.

    If no clip has a chart of the tip error, each gets a chart of its tip's distance from the first clip's tip.
    """
    seen: dict[str, int] = {}
    own = []
    for clip in clips:
        seen[clip.label] = seen.get(clip.label, 0) + 1
        label = clip.label if seen[clip.label] == 1 else f"{clip.label} ({seen[clip.label]})"
        own.append(replace(clip, label=label))
    if len(own) > 1 and not any(chart.title.startswith("tip error") for clip in own for chart in clip.charts):
        first = own[0]
        title = f"distance of the tip from that of {first.label} (m)"
        apart = [{}, *(_between(first, clip) for clip in own[1:])]
        own = [replace(c, charts=[Chart(title, far), *c.charts]) for c, far in zip(own, apart, strict=True)]
    return own


def _between(first: Any, other: Any) -> Mapping[str, Array]:
    tip, own = first.points[:, -1], other.points[:, -1]
    known = np.column_stack([np.interp(other.t, first.t, column) for column in tip.T])
    apart = np.linalg.norm(own - known, axis=1)
    return {"tip": np.where(other.t <= first.t[-1] * (1.0 + 1e-9), apart, np.nan)}
