"""Convert keywords of environments to data of tasks: costs, pushes, payload changes, initial states, success."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from .. import validation as check
from ..batch import FURTHER, Cost, Extras, KeepOut, PayloadChange, Pushes, Starts, contact_length, gauge_table, packed
from ..parameters import Arm
from ..physics.reading import reading_of
from ..scene import touching_points
from ..sensors import surface
from ..shapes import Shape, shape_of
from ..validation import Array
from .features import Frame, for_each, table_of
from .targets import joint_range
from .task import Kind, at_zero

Pair = tuple[float, float]

STATIONS = (0.0, 0.25, 0.5, 0.75)
"""Stations for strain along each link, from its root (0) to its tip (1); the strain at the tip itself is 0."""

TURNS = ("exact", "any")
GRIPPED = ("resting", "moving")
PARTS = ("arm", "tip")
EVENTS = ("cost", "pushes", "payload_change", "keep_out")
"""Keywords and fields of `Extras` that add entries to info."""


def cost(frame: Frame, value: Any) -> Cost | None:
    """Validate the keyword `cost`: limits of tip deflections (divided by the link's length) and of surface strains."""
    if value is None:
        return None
    table = table_of("cost", value, ("deflection", "strain"))
    if not table:
        raise check.MissingKey("cost.deflection", "a cost needs a limit: deflection (over a link's length) or strain")
    limits = rows = None
    if "deflection" in table:
        limits = for_each("cost.deflection", table["deflection"], frame.arm.n_links, above=0.0)
    if "strain" in table:
        rows = _strains(frame, check.number("cost.strain", table["strain"], above=0.0)).ravel()
    return Cost(deflection=limits, strain=rows)


def _strains(frame: Frame, limit: float) -> Array:
    """Return rows for `protocol.strain_gauge`: surface strain, divided by its limit, at each link's stations.

    limit: strain, without unit. In the plane the rows (4 N, n) belong to 4 stations on each of N flexible links, and a
    row times q is strain over limit. In space each station has two rows of a `GAUGE` record, for bending in the link's
    x-y and x-z planes.
    """
    reading = reading_of(frame.arm)
    bending = [k for k, link in enumerate(frame.arm.links) if not link.rigid]
    places = [(k, place, plane) for k in bending for place in STATIONS for plane in reading.planes]
    distances = []
    for k, place, plane in places:
        link = frame.arm.links[k]
        s, name = np.array(place * link.length), "J" if plane == "xy" else "J_y"
        m, J = float(link.along(s).m), float(link.along(s).J if plane == "xy" else link.across(s)[name])
        if J <= 0.0:
            what = "must be given (kg m) for cost.strain: with m it defines the link's thickness"
            raise check.InvalidValue(f"arm.links[{k}].section.{name}", J, what)
        distances.append(surface(m, J))
    table = gauge_table(frame.arm, frame.settings, frame.gravity, places)
    return reading.strain_rows(table, np.array(distances), limit)


def shapes_of(kind: Kind, value: Any) -> tuple[Shape, ...]:
    """Return the shapes of `keep_out`; () without shapes."""
    if value is None:
        return ()
    rows = value.get("shapes") if isinstance(value, Mapping) and "shapes" in value else value
    rows, path = [rows] if isinstance(rows, Shape | Mapping) else rows, "keep_out"
    what = "shapes (flexarm_env.shapes, or tables such as {'shape': 'sphere', 'center': ..., 'radius': ...})"
    rows = check.sequence(path, rows, what)
    if not rows:
        raise check.InvalidValue(path, value, f"must hold {what}")
    return tuple(shape_of(f"{path}[{k}]", row, len(kind.axes)) for k, row in enumerate(rows))


def keep_out(frame: Frame, value: Any) -> KeepOut | None:
    """Read `keep_out`: shapes that the arm or its tip must not enter."""
    shapes = shapes_of(frame.kind, value)
    if not shapes:
        return None
    table = dict(value) if isinstance(value, Mapping) and "shapes" in value else {}
    check.known_keys("keep_out", table, ("shapes", "margin", "of"))
    margin = check.number("keep_out.margin", table.get("margin", 0.0), "m", minimum=0.0)
    only_tip = check.choice("keep_out.of", table.get("of", PARTS[0]), PARTS) == "tip"
    return KeepOut(packed(shapes), margin, (0,) if only_tip else None)


def pushes(frame: Frame, value: Any) -> Pushes | None:
    """Validate the keyword `pushes`: forces on the tip at random times."""
    if value is None:
        return None
    table = table_of("pushes", value, ("wait", "force", "lasting", "until"))
    wait, force = _range("pushes", table, "wait", "s"), _range("pushes", table, "force", "N")
    lasting = check.number("pushes.lasting", table.get("lasting", frame.period), "s", above=0.0)
    periods = round(lasting / frame.period)
    if periods < 1 or abs(lasting / frame.period - periods) > 1e-6 * periods:
        what = f"must be a whole number of control_dt = {frame.period:g} s"
        raise check.InvalidValue("pushes.lasting", lasting, what)
    until = math.inf if "until" not in table else check.number("pushes.until", table["until"], "s", minimum=0.0)
    # 1e-6: numbers of whole periods are compared with `until`, which may be a whole number but for round-off
    return Pushes(wait=wait / frame.period, force=force, lasting=float(periods), until=until / frame.period + 1e-6)


def _range(path: str, table: dict[str, Any], key: str, unit: str, minimum: float = 0.0) -> Array:
    """Return the value (low, high) of a table's key; the key is required."""
    value = check.needed(path, table, key, f"must be two numbers{f' ({unit})' if unit else ''}, (low, high)")
    return np.array(check.limits(f"{path}.{key}", value, unit, minimum=minimum))


def payload_change(frame: Frame, value: Any) -> PayloadChange | None:
    """Validate the keyword `payload_change`: a payload that the arm grips or releases once in an episode.

    value: table with `time` (s), `factor` (on the nominal payload's mass and inertia) and `gripped`; or None. In the
    result the time is in control periods. The field `resting` of the result is (0,) if the gripped body is at rest
    before the change; velocities then jump at the change. The field `resting` is None if the body already moves with
    the tip.
    """
    if value is None:
        return None
    table = table_of("payload_change", value, ("time", "factor", "gripped"))
    time = _range("payload_change", table, "time", "s", frame.period)
    factor = _range("payload_change", table, "factor", "")
    if frame.arm.payload.mass <= 0.0:
        what = "must be positive for payload_change, whose factors are on this payload"
        raise check.InvalidValue("arm.payload.mass", frame.arm.payload.mass, what)
    gripped = check.choice("payload_change.gripped", table.get("gripped", GRIPPED[0]), GRIPPED)
    return PayloadChange(time=time / frame.period, factor=factor, resting=(0,) if gripped == GRIPPED[0] else None)


def aims(frame: Frame, extras: Extras, success: Any, turns: Any, absolute: bool, drawn: int) -> dict[str, Any]:
    """Return the compiled task's fields for success, turns and info whose values differ from the defaults.

    success, turns: values of the environment's keywords `success` and `turns`. absolute: True if target angles are
    absolute, False if they are relative to the initial angle. drawn: index in info of the last random factor; -1
    without factors.
    """
    kind = frame.kind
    table = table_of("success", success, (*kind.bands, "hold", "once", "paid"))
    paid = check.flag("success.paid", table.get("paid", False))
    if paid and not set(table) & set(kind.bands):
        raise check.MissingKey("success.position", f"a reward for success needs bounds: {', '.join(kind.bands)}")
    bands = [
        check.number(f"success.{name}", table[name], unit, above=0.0) if name in table else math.inf if paid else usual
        for name, (usual, unit) in kind.bands.items()
    ]
    changes: dict[str, Any] = {"bands": np.array(bands)}
    if "hold" in table:
        time = check.number("success.hold", table["hold"], "s", minimum=0.0)
        changes["hold"] = float(math.ceil(time / frame.period - 1e-9) + 1)
    if check.flag("success.once", table.get("once", False)):
        changes["once"] = (0,)
    if paid:
        changes["paid"] = (0,)
    if check.choice("turns", turns, TURNS) == "any":
        seen = extras.instruments is not None and extras.instruments.goals is not None
        if kind.target.numbers != 1:
            raise check.InvalidValue("turns", turns, f'must be "exact" for {kind.id}, whose target is a point')
        if extras.controller is not None or seen:
            what = 'must be "exact" where joint errors are used: action_mode="residual_pd", observation="measured"'
            raise check.InvalidValue("turns", turns, what)
        changes["turns"] = (0,)
    if absolute:
        changes["relative"] = 0.0
    if extras.reference is not None:
        changes |= kind.target.chain(frame.arm)
    fitted = frame.settings.step_tolerance is not None
    events = any(getattr(extras, name) is not None for name in EVENTS)
    if drawn >= 0 or fitted or frame.arm.base or events or frame.contacts:
        points = len(touching_points(frame.contacts, frame.arm))
        count = max(FURTHER.drawn + drawn + 1, FURTHER.end) + contact_length(points)
        changes["further"] = (0,) * count
    return changes


def starts(kind: Kind, arm: Arm, value: Any, rules: int) -> tuple[Starts, bool]:
    """Return ranges of initial states, and whether target angles are absolute (True) or relative to the initial
    angle."""
    usual = kind.starts(arm, rules)
    if value is None:
        return usual, False
    table, n = table_of("starts", value, ("angles", "target", "straight", "absolute")), arm.n_links
    changes: dict[str, Any] = {}
    if "angles" in table:
        rows = check.sequence("starts.angles", table["angles"], f"{n} pairs (low, high), rad", n)
        changes["start"] = [joint_range(arm, k, row) for k, row in enumerate(rows)]
        changes["straight"] = 0.0
    if "target" in table:
        changes["target"] = kind.target.start_ranges(arm, table["target"])
    if "straight" in table:
        changes["straight"] = share = check.number("starts.straight", table["straight"], minimum=0.0, maximum=1.0)
        if share > at_zero(arm) == 0.0:
            raise check.InvalidValue("starts.straight", share, "must be 0 where a joint's limits leave out the angle 0")
    absolute = check.flag("starts.absolute", table.get("absolute", False))
    if absolute and kind.target.numbers != 1:
        raise check.InvalidValue("starts.absolute", True, f"must be left out for {kind.id}, with points as targets")
    return dataclasses.replace(usual, **changes), absolute


def only_with(name: str, value: Any, task: str, wanted: str) -> None:
    """Raise `InvalidValue` if the user gives a keyword that belongs to another task."""
    if value is not None and task != wanted:
        raise check.InvalidValue(name, value, f'must be given with task="{wanted}" only')


def unguided(extras: Extras, path: str, value: Any) -> None:
    """Raise `InvalidValue` if a prescribed motion is combined with one of the keywords in `EVENTS`."""
    for name in EVENTS:
        if getattr(extras, name) is not None:
            raise check.InvalidValue(path, value, f"must not be given in an environment with {name}")
