"""Prescribed functions of time for motions and loads, with exact first and second derivatives.

A :class:`TimeFunction` is defined piecewise: each piece is a cubic polynomial plus a sine. The value or a derivative
may jump from one piece to the next. The instant of a jump is called a *kink*, and a time step of the solver must end
there.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, overload

import numpy as np
import numpy.typing as npt

from flexarm_env import validation as check
from flexarm_env.files import csv_lines, listed, numbers

Array = npt.NDArray[np.float64]
Side = Literal["right", "left"]

KINK_TOLERANCE = 1e-9
"""Smallest jump that is a kink, as a fraction of the magnitude of the function or of the derivative that jumps."""
T0, C0, C1, C2, C3, AMPLITUDE, OMEGA, PHASE, PIECE = range(9)
"""Columns of ``TimeFunction.pieces``: start (s), cubic, amplitude, frequency (rad/s), phase. PIECE: column count."""


@dataclass(frozen=True, eq=False)
class TimeFunction:
    """Piecewise function of time; immutable, hashable, picklable.

    ``pieces`` is float64 (n, 8), rows ``[t0, c0, c1, c2, c3, A, w, p]`` in order of ``t0`` (s):

        value(t) = c0 + c1 s + c2 s^2 + c3 s^3 + A sin(w s + p),   s = t - t0,   for t0 <= t < next t0

    The first piece also applies before its ``t0``, and the last piece extends to infinity. ``kind`` and ``parameters``
    are the entries of the function in a TOML file. Two functions are equal if their pieces are equal.
    """

    pieces: Array
    kind: str = "pieces"
    parameters: tuple[tuple[str, Any], ...] = ()

    def __post_init__(self) -> None:
        """Validate the pieces and make them read-only; an `InvalidValue` names the piece."""
        try:
            pieces = np.array(self.pieces, dtype=np.float64, order="C")
        except (TypeError, ValueError, OverflowError):
            raise check.InvalidValue("pieces", self.pieces, "must be rows of 8 numbers") from None
        if pieces.ndim != 2 or pieces.shape[1] != 8 or not len(pieces):
            raise check.InvalidValue("pieces", self.pieces, "must be rows of 8 numbers, at least one row")
        for i, row in enumerate(pieces):
            if not np.all(np.isfinite(row)):
                raise check.InvalidValue(f"pieces[{i}]", row, f"must hold finite numbers, in row {i}")
        _increasing("pieces", pieces[:, T0])
        pieces += 0.0  # no -0.0: equal functions have equal bytes
        pieces.flags.writeable = False
        object.__setattr__(self, "pieces", pieces)
        if self.kind == "pieces":
            object.__setattr__(self, "parameters", (("pieces", tuple(map(tuple, pieces.tolist()))),))

    def __reduce__(self) -> tuple[Any, ...]:
        return (TimeFunction, (self.pieces, self.kind, self.parameters))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, TimeFunction):
            return NotImplemented
        return self.pieces.shape == other.pieces.shape and self.pieces.tobytes() == other.pieces.tobytes()

    def __hash__(self) -> int:
        return hash(self.pieces.tobytes())

    @overload
    def __call__(self, t: float, derivative: int = 0, side: Side = "right") -> float: ...
    @overload
    def __call__(self, t: npt.ArrayLike, derivative: int = 0, side: Side = "right") -> Array: ...
    def __call__(self, t: Any, derivative: int = 0, side: Side = "right") -> Any:
        """Return the value, or derivative 1 to 3, at ``t`` (s, number or array); at a kink the limit from ``side``."""
        times = np.asarray(t, dtype=np.float64)
        check.choice("side", side, ("right", "left"))
        row = np.searchsorted(self.pieces[:, T0], times, side=side) - 1
        result = _evaluate(self.pieces[np.maximum(row, 0)], times, derivative)
        return float(result) if result.ndim == 0 else result

    @property
    def start(self) -> float:
        """Value of the function at t = 0."""
        return self(0.0)

    @property
    def end(self) -> float:
        """Instant (s) at which the last piece starts."""
        return float(self.pieces[-1, T0])

    @cached_property
    def jumps(self) -> tuple[float, ...]:
        """Instants (s) at which the value jumps."""
        return self.kinks_up_to(0)

    @cached_property
    def load_kinks(self) -> tuple[float, ...]:
        """Kinks of a load: instants (s) at which the value or its slope jumps."""
        return self.kinks_up_to(1)

    @cached_property
    def kinks(self) -> tuple[float, ...]:
        """Kinks of a motion: instants (s) at which the value or its first or second derivative jumps."""
        return self.kinks_up_to(2)

    def kinks_up_to(self, order: int) -> tuple[float, ...]:
        """Return the instants (s) at which the value or a derivative up to ``order`` (at most 3) jumps."""
        before, after, at = self.pieces[:-1], self.pieces[1:], self.pieces[1:, T0]
        check.integer("order", order, minimum=0, maximum=3)
        if not len(at):
            return ()
        # compare both neighbors at each boundary, relative to the size of the derivative
        jumping = np.zeros(len(at), dtype=bool)
        for k in range(order + 1):
            jump = np.abs(_evaluate(after, at, k) - _evaluate(before, at, k))
            jumping |= jump > KINK_TOLERANCE * self._size(k)
        return tuple(at[jumping].tolist())

    def _size(self, order: int) -> float:
        """Return a derivative's magnitude: its largest term, or the value's magnitude over a power of the duration."""
        p, size = self.pieces, 0.0
        lengths = np.append(np.diff(p[:, T0]), 0.0)
        span = float(p[-1, T0] - p[0, T0])
        for k in (order, 0):
            # sum of magnitudes: |A| w^k and the k-th derivative of each power at the piece's end
            terms = np.abs(p[:, AMPLITUDE]) * np.abs(p[:, OMEGA]) ** k
            for j in range(k, 4):
                terms = terms + np.abs(p[:, C0 + j]) * math.perm(j, k) * lengths ** (j - k)
            size = max(size, float(terms.max()) / span ** (order - k))
        return size

    def plus(self, value: float) -> TimeFunction:
        """Return the function plus a constant."""
        pieces = self.pieces.copy()
        pieces[:, C0] += check.number("value", value)
        return TimeFunction(pieces)

    def with_times(self, times: Mapping[float, float]) -> TimeFunction:
        """Return a copy with changed start times of pieces. times: dict from old to new start times, s."""
        pieces = self.pieces.copy()
        pieces[:, T0] = [times.get(t, t) for t in pieces[:, T0].tolist()]
        return TimeFunction(pieces, self.kind, self.parameters)

    def check_no_jump(self) -> None:
        """Raise ValueError if the value jumps; the message names the row of ``pieces``."""
        for t in self.jumps:
            row = int(np.searchsorted(self.pieces[:, T0], t))
            change = f"from {self(t, side='left'):g} to {self(t):g}"
            raise check.InvalidValue(f"t[{row}]", t, f"a motion must not jump: row {row} goes {change} in no time")


def cubic(c0: Any, c1: Any, c2: Any, c3: Any, s: Any) -> tuple[Any, Any, Any, Any]:
    """Return c0 + c1 s + c2 s^2 + c3 s^3 and its first three derivatives by s, for numbers or arrays."""
    return c0 + s * (c1 + s * (c2 + s * c3)), c1 + s * (2.0 * c2 + 3.0 * s * c3), 2.0 * c2 + 6.0 * s * c3, 6.0 * c3


def wave(amplitude: Any, omega: Any, sine: Any, cosine: Any) -> tuple[Any, Any, Any, Any]:
    """Return amplitude sin(omega s + p) and its first three derivatives by s, given sine and cosine of omega s + p."""
    rate = amplitude * omega
    return amplitude * sine, rate * cosine, -(rate * omega * sine), -(rate * omega * omega * cosine)


def _evaluate(rows: Array, t: Array, order: int) -> Array:
    """Return the derivative of order ``order`` of each row of pieces at the row's time t (s), broadcast."""
    check.integer("derivative", order, minimum=0, maximum=3)
    # local time s and sine argument w s + p
    s = t - rows[..., T0]
    angle = rows[..., OMEGA] * s + rows[..., PHASE]
    smooth = cubic(rows[..., C0], rows[..., C1], rows[..., C2], rows[..., C3], s)[order]
    return np.asarray(smooth + wave(rows[..., AMPLITUDE], rows[..., OMEGA], np.sin(angle), np.cos(angle))[order])


def _increasing(path: str, t: Array) -> None:
    """Raise InvalidValue at the first time that is not later than the previous one."""
    for i in range(1, len(t)):
        if not t[i] > t[i - 1]:
            raise check.InvalidValue(f"{path}[{i}]", t[i], f"must be later than {t[i - 1]:g}, the time of row {i - 1}")


def _row(t0: float, c0: float = 0.0, c1: float = 0.0, c2: float = 0.0, c3: float = 0.0, *sine: float) -> list[float]:
    """Return one row of `pieces`. sine: amplitude, angular frequency and phase of the sine, if the row has one."""
    return [t0, c0, c1, c2, c3, *(sine or (0.0, 0.0, 0.0))]


def _of_pieces(kind: str, rows: Any, **parameters: Any) -> TimeFunction:
    """Create a function from one row per piece, and record its kind and the parameters that are not None."""
    kept = tuple((k, tuple(v.tolist()) if isinstance(v, np.ndarray) else v) for k, v in parameters.items())
    return TimeFunction(np.array(rows, dtype=np.float64), kind, tuple((k, v) for k, v in kept if v is not None))


# ---------------------------------------------------------------------------- closed forms
def constant(value: float) -> TimeFunction:
    """Return the constant function ``value``."""
    value = check.number("value", value)
    return _of_pieces("constant", [_row(0.0, value)], value=value)


def pulse(value: float, t_end: float, t_start: float = 0.0) -> TimeFunction:
    """Return a pulse for loads: ``value`` from ``t_start`` to ``t_end`` (s), otherwise 0. Motions must not jump."""
    value = check.number("value", value)
    t_start = check.number("t_start", t_start, "s", minimum=0.0)
    t_end = check.number("t_end", t_end, "s", above=t_start)
    # a leading zero piece if the pulse starts later than 0
    rows = [_row(t_start, value), _row(t_end)]
    return _of_pieces("pulse", [_row(0.0), *rows] if t_start > 0.0 else rows, value=value, t_end=t_end, t_start=t_start)


def ramp(rise: float, duration: float, offset: float = 0.0) -> TimeFunction:
    """Return a linear ramp from ``offset`` to ``offset + rise`` in ``duration`` (s), followed by a constant."""
    rise, duration, offset = _motion(rise, duration, offset)
    rows = [_row(0.0, offset, rise / duration), _row(duration, offset + rise)]
    return _of_pieces("ramp", rows, rise=rise, duration=duration, offset=offset)


def cycloid(rise: float, duration: float, offset: float = 0.0) -> TimeFunction:
    """Return offset + rise (t/T - sin(2 pi t/T)/(2 pi)) until T = ``duration`` (s), then offset + rise; no kinks."""
    rise, duration, offset = _motion(rise, duration, offset)
    # line and sine of opposite rate: at rest at both ends
    first = _row(0.0, offset, rise / duration, 0.0, 0.0, -rise / (2 * math.pi), 2 * math.pi / duration, 0.0)
    return _of_pieces("cycloid", [first, _row(duration, offset + rise)], rise=rise, duration=duration, offset=offset)


def spin_up(rate: float, duration: float, offset: float = 0.0) -> TimeFunction:
    """Return the angle of a spin-up to ``rate`` (rad/s) in T = ``duration`` (s), without kinks (Kane et al. 1987).

    psi = offset + (rate/T) (t^2/2 + (T/2 pi)^2 (cos(2 pi t/T) - 1)) until T, then psi = offset + rate (t - T/2).
    """
    rate = check.number("rate", rate, "rad/s")
    _, duration, offset = _motion(0.0, duration, offset)
    # the cosine is a sine of phase pi/2 with amplitude A
    A = rate * duration / (2 * math.pi) ** 2
    first = _row(0.0, offset - A, 0.0, rate / (2 * duration), 0.0, A, 2 * math.pi / duration, math.pi / 2)
    rows = [first, _row(duration, offset + rate * duration / 2, rate)]
    return _of_pieces("spin_up", rows, rate=rate, duration=duration, offset=offset)


def sine(
    amplitude: float, omega: float, phase: float = 0.0, t_end: float | None = None, offset: float = 0.0
) -> TimeFunction:
    """Return offset + amplitude sin(omega t + phase), omega in rad/s; from ``t_end`` (s) on, return ``offset``."""
    amplitude, phase = check.number("amplitude", amplitude), check.number("phase", phase, "rad")
    omega, offset = check.number("omega", omega, "rad/s", above=0.0), check.number("offset", offset)
    rows = [_row(0.0, offset, 0.0, 0.0, 0.0, amplitude, omega, phase)]
    if t_end is not None:
        t_end = check.number("t_end", t_end, "s", above=0.0)
        rows.append(_row(t_end, offset))
    return _of_pieces("sine", rows, amplitude=amplitude, omega=omega, phase=phase, t_end=t_end, offset=offset)


def _motion(rise: object, duration: object, offset: object) -> tuple[float, float, float]:
    """Validate rise, duration (s) and offset of a motion."""
    T = check.number("duration", duration, "s", above=0.0)
    if not 1.0 / check.LARGEST <= T <= check.LARGEST:
        raise check.InvalidValue("duration", T, f"must be from {1.0 / check.LARGEST:g} to {check.LARGEST:g} s")
    return check.number("rise", rise), T, check.number("offset", offset)


# -------------------------------------------------------------------------------- tables
def _columns(t: object, least: int, **values: object) -> tuple[Array, ...]:
    """Validate the columns of a table, times first: at least ``least`` rows, with increasing times from 0 on."""
    times = check.column("t", t, "s")
    if len(times) < least:
        raise check.InvalidValue("t", times, f"must hold at least {least} rows")
    if times[0] < 0.0:
        raise check.InvalidValue("t[0]", times[0], "must be a time from 0 on (s)")
    _increasing("t", times)
    if len(times) > 1 and np.diff(times).min() < 1.0 / check.LARGEST:
        raise check.InvalidValue("t", times, f"must be at least {1.0 / check.LARGEST:g} s apart")
    columns = [times]
    for name, value in values.items():
        columns.append(check.column(name, value))
        if len(columns[-1]) != len(times):
            raise check.InvalidValue(name, value, f"must hold {len(times)} rows as t does, not {len(columns[-1])}")
    for name, column in zip(("t", *values), columns, strict=True):
        at = int(np.argmax(np.abs(column)))
        if abs(column[at]) > check.LARGEST:
            raise check.InvalidValue(f"{name}[{at}]", column[at], f"must be at most {check.LARGEST:g} in size")
    return tuple(columns)


def _with_ends_held(t: Array, y: Array, rows: list[list[float]]) -> list[list[float]]:
    """Return the pieces of a table, with its first value held before and its last value held after it."""
    before = [_row(0.0, y[0])] if t[0] > 0.0 else []
    return [*before, *rows, _row(t[-1], y[-1])]


def linear_table(t: Sequence[float] | Array, y: Sequence[float] | Array) -> TimeFunction:
    """Return the linear interpolation of y (n,) over t (n,), s, n >= 2; y[0] before t[0], y[-1] after t[-1]. Each row
    is a kink. Raises ValueError for too few rows, times that do not increase, or values that are not finite.
    """
    time, value = _columns(t, 2, y=y)
    slopes = np.diff(value) / np.diff(time)
    rows = [_row(*row) for row in zip(time[:-1], value[:-1], slopes, strict=True)]
    return _of_pieces("linear_table", _with_ends_held(time, value, rows), t=time, y=value)


def steps(t: Sequence[float] | Array, y: Sequence[float] | Array) -> TimeFunction:
    """Return a step function for loads: y[k] from time t[k] (s) to t[k + 1], 0 before t[0]; motions must not jump."""
    time, value = _columns(t, 1, y=y)
    rows = [_row(*row) for row in zip(time, value, strict=True)]
    return _of_pieces("steps", [_row(0.0), *rows] if time[0] > 0.0 else rows, t=time, y=value)


def spline_table(
    t: Sequence[float] | Array, psi: Sequence[float] | Array, boundary: str = "not-a-knot"
) -> TimeFunction:
    """Return the cubic spline through the points (t, psi); after the last point the function is constant.

    Args:
        t (n,): increasing instants, s. psi (n,): values, rad or m. boundary: "not-a-knot" (default), "natural" (second
            derivative 0 at both ends) or "clamped" (first derivative 0 at both ends).
    Raises:
        ValueError: a row or the boundary is invalid; the message names the invalid row or `boundary`.
    """
    from scipy.interpolate import CubicSpline

    time, value = _columns(t, 2, psi=psi)
    check.choice("boundary", boundary, ("not-a-knot", "natural", "clamped"))
    steps = np.diff(time)
    if steps.max() > 1e9 * steps.min():
        raise check.InvalidValue("t", t, "must have no interval longer than 1e9 times the shortest, for a spline")
    spline = CubicSpline(time, value, bc_type=boundary)
    # SciPy's coefficients are ordered from the cubic term down
    rows = [_row(t0, *c[::-1]) for t0, c in zip(time[:-1], spline.c.T, strict=True)]
    return _of_pieces("spline_table", _with_ends_held(time, value, rows), t=time, psi=value, boundary=boundary)


_THIRDS = np.array([[1.0, 1.0, 1.0], [2.5, 1.5, 0.5], [19 / 6, 7 / 6, 1 / 6]])
"""Matrix that maps third derivatives in three equal sub-intervals to acceleration, rate and value at the end."""


def hermite_table(
    t: Sequence[float] | Array,
    psi: Sequence[float] | Array,
    psi_dot: Sequence[float] | Array,
    psi_ddot: Sequence[float] | Array | None = None,
) -> TimeFunction:
    """Return the piecewise cubic function with given values and rates, and, if given, accelerations at the instants t.

    Args:
        t (n,): increasing instants, s. psi (n,): values, rad or m. psi_dot (n,): rates. psi_ddot (n,): accelerations.
            With psi_ddot an interval has three cubics; otherwise an interval has one cubic, and accelerations jump.
    After the last instant the value is constant. A ValueError names an invalid row.
    """
    if psi_ddot is None:
        time, y, v = _columns(t, 2, psi=psi, psi_dot=psi_dot)
        # Hermite cubic of values y and rates v on an interval h
        h, mean = np.diff(time), np.diff(y) / np.diff(time)
        c2, c3 = (3 * mean - 2 * v[:-1] - v[1:]) / h, (v[:-1] + v[1:] - 2 * mean) / h**2
        rows = [_row(*row) for row in zip(time[:-1], y[:-1], v[:-1], c2, c3, strict=True)]
        return _of_pieces("hermite_table", _with_ends_held(time, y, rows), t=time, psi=y, psi_dot=v)
    time, y, v, a = _columns(t, 2, psi=psi, psi_dot=psi_dot, psi_ddot=psi_ddot)
    rows = []
    for i, h in enumerate(np.diff(time)):
        # remainders that three third derivatives (jerks) must add to acceleration, rate and value
        d, x, (y0, v0, a0) = h / 3, time[i], (y[i], v[i], a[i])
        missing = [a[i + 1] - a0, v[i + 1] - v0 - a0 * h, y[i + 1] - y0 - v0 * h - a0 * h**2 / 2]
        for jerk in np.linalg.solve(_THIRDS, np.array(missing) / [d, d**2, d**3]):
            rows.append(_row(x, y0, v0, a0 / 2, jerk / 6))
            x, y0 = x + d, y0 + v0 * d + a0 * d**2 / 2 + jerk * d**3 / 6
            v0, a0 = v0 + a0 * d + jerk * d**2 / 2, a0 + jerk * d
    return _of_pieces("hermite_table", _with_ends_held(time, y, rows), t=time, psi=y, psi_dot=v, psi_ddot=a)


def table(
    t: Sequence[float] | Array,
    psi: Sequence[float] | Array,
    psi_dot: Sequence[float] | Array | None = None,
    psi_ddot: Sequence[float] | Array | None = None,
    interpolation: str | None = None,
) -> TimeFunction:
    """Return a function through the rows of a table: times t (s), values psi (rad or m) and, if known, rates psi_dot
    and accelerations psi_ddot. Without rates ``interpolation`` selects "spline" (default) or "linear"; with rates
    :func:`hermite_table` is used, and ``interpolation`` must be None.
    """
    if psi_dot is None:
        if psi_ddot is not None:
            raise check.MissingKey("psi_dot", "psi_ddot needs it too")
        chosen = check.choice("interpolation", interpolation or "spline", ("spline", "linear"))
        return spline_table(t, psi) if chosen == "spline" else linear_table(t, psi)
    if interpolation is not None:
        raise check.InvalidValue("interpolation", interpolation, "must not be given where the table holds psi_dot")
    return hermite_table(t, psi, psi_dot, psi_ddot)


COLUMNS = ("t", "psi", "psi_dot", "psi_ddot")


def from_array(data: npt.ArrayLike, interpolation: str | None = None) -> TimeFunction:
    """Return a function from an array with the columns t, psi and, if known, psi_dot, psi_ddot; see :func:`table`."""
    rows = np.asarray(data)
    if rows.ndim != 2 or not 2 <= rows.shape[1] <= 4 or rows.dtype.kind not in "fiu":
        what = f"{rows.dtype} of shape {rows.shape}"
        raise check.InvalidValue("table", what, "must be numbers of shape (n, 2 to 4): t, psi[, psi_dot[, psi_ddot]]")
    columns = dict(zip(COLUMNS, rows.astype(np.float64).T, strict=False))
    return table(**columns, interpolation=interpolation)


def from_csv(
    path: str | os.PathLike[str],
    interpolation: str | None = None,
    *,
    column: str | None = None,
    time: str = "t",
    rate: str | None = None,
    acceleration: str | None = None,
    scale: float = 1.0,
) -> TimeFunction:
    """Return a function from columns of a CSV file, whose first line has the columns' names; see :func:`table`.

    Args:
        path: the CSV file. interpolation: as in :func:`table`.
        column: name of the column with the values (rad, m, N or N m); other columns are ignored. If `column` is None,
            the file must have the columns t, psi and optionally psi_dot and psi_ddot, and no others.
        time: name of the column with the times, s. rate, acceleration: names of the columns with derivatives, or None.
        scale: factor on values and derivatives, for example a change of units or a gear ratio.
    Raises:
        ValueError: invalid content; the message names file, column and row. OSError: the file cannot be read.
    """
    header, lines = csv_lines(path)
    with check.in_file(path):
        scale = check.number("scale", scale)
        if column is None:
            for name, given in (("time", time != "t"), ("rate", rate), ("acceleration", acceleration)):
                if given:
                    raise check.MissingKey("column", f"{name} names a column beside it")
            if len(header) < 2 or header != COLUMNS[: len(header)]:
                what = "must be t,psi[,psi_dot[,psi_ddot]] in the first line; otherwise name a column"
                raise check.InvalidValue("columns", header, what)
            wanted: dict[str, str] = dict(zip(header, header, strict=True))
        else:
            chosen = {"time": time, "column": column, "rate": rate, "acceleration": acceleration}
            wanted = {word: name for word, name in zip(COLUMNS, chosen.values(), strict=True) if name is not None}
            for key, value in chosen.items():
                if value is not None and header.count(value) != 1:
                    what = f"must name one column; the file has {listed(header)}"
                    raise check.InvalidValue(key, value, what)
        values = {word: numbers(header.index(name), name, lines, len(header)) for word, name in wanted.items()}
        if not lines:
            raise check.InvalidValue("rows", 0, "must be at least two")
        scaled = {word: cells if word == "t" else scale * cells for word, cells in values.items()}
        return table(**scaled, interpolation=interpolation)
