"""Pictures of planar arms of one or more links, drawn with pygame from points alone.

A picture shows the deformed links in true shape, the ghost of the rigid arm at the same joint angles, the target,
the payload, hub and elbows, a trace of the tip, the tip deflections, the joint torques, the time and a metric grid.
pygame is imported when the first `Renderer` is made; an array of pixels needs no display.
"""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Color = tuple[int, int, int]

MODES = ("human", "rgb_array")
SUPERSAMPLING = 3
"""The scene is drawn this many times as wide and high, and averaged down."""
MARGIN = 1.14
"""Half the picture's side, in reaches."""
TRACE = 60
"""Instants of the tip's path that stay visible."""
FULL_SCALES = (0.1, 0.2, 0.5, 1.0)
"""Ends of the deflection bars, share of the link's length; the picture takes the first that its episode stays within."""

PAPER: Color = (250, 251, 252)
SHADE: Color = (232, 235, 240)
GRID: Color = (237, 240, 244)
AXIS: Color = (218, 224, 231)
INK: Color = (52, 62, 76)
FAINT: Color = (126, 138, 152)
GHOST: Color = (221, 226, 233)
GHOST_EDGE: Color = (190, 199, 210)
LINKS: tuple[Color, ...] = ((43, 88, 138), (38, 132, 140))
STEEL: Color = (92, 104, 120)
PAYLOAD: Color = (232, 134, 46)
TARGET: Color = (34, 152, 92)
TORQUE: Color = (122, 94, 172)
DEFLECTION: Color = (204, 84, 62)


class Renderer:
    """Draws arms, one picture a call.

    Args:
        mode: "rgb_array" returns pixels, "human" shows a window in real time (where there is no display it says so
            once and shows nothing).
        reach: largest distance of the tip from the root, m; sets the scale.
        size: width and height, pixels. fps: pictures a second of the window.
        hub, payload: whether the root stands on a motor, whether the tip carries a payload.
    Raises:
        ValueError: a mode that there is not, a reach that is not positive. DependencyNotInstalled: no pygame.
    """

    def __init__(
        self,
        mode: str,
        reach: float,
        size: tuple[int, int] = (640, 640),
        fps: float = 50,
        *,
        hub: bool = True,
        payload: bool = True,
    ) -> None:
        if mode not in MODES:
            raise ValueError(f"render_mode = {mode!r}: must be one of {', '.join(MODES)}")
        if not 0.0 < reach < math.inf:
            raise ValueError(f"reach = {reach!r}: must be a positive number (m)")
        self.mode, self.reach, self.size, self.fps = mode, float(reach), (int(size[0]), int(size[1])), fps
        self.hub, self.payload = hub, payload
        self.closed = False
        """Whether the window was closed, by the user or by `close`."""
        self._pg = _pygame()
        self._unit = min(self.size) / 640.0 * SUPERSAMPLING
        self._scale = min(self.size) * SUPERSAMPLING / (2.0 * MARGIN * self.reach)
        self._cell = round_step(self.reach / 3.0)
        self._canvas = self._pg.Surface((self.size[0] * SUPERSAMPLING, self.size[1] * SUPERSAMPLING), 0, 32)
        self._paper = self._canvas.copy()
        self._paper_at: tuple[float, float] | None = None
        self._fonts: dict[int, Any] = {}
        self._window: Any = None
        self._clock: Any = None
        if mode == "human":
            self._open()
        self._restart()

    def _restart(self) -> None:
        """Forget the episode: trace, view and scale of the bars."""
        self._time = -math.inf
        self._center = np.zeros(2)
        self._trace: deque[Array] = deque(maxlen=TRACE)
        self._full = FULL_SCALES[0]

    # ------------------------------------------------------------ a picture
    def frame(
        self,
        shape_points: Sequence[ArrayLike],
        poses: ArrayLike,
        target: ArrayLike | None,
        time: float,
        torques: ArrayLike | None = None,
        deflection: ArrayLike | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw one instant.

        Args:
            shape_points: for each of the N links its points (n, 2) from root to tip, m.
            poses: (N, 12): x, y, angle and their rates of each link's root, then of its tip (m, rad).
            target: (2,) m, or None. time: s; an earlier time than before starts a new episode.
            torques: (N,) in shares of the limit, or None. deflection: (N,) tip deflections over L, or None.
        Returns:
            (height, width, 3) uint8, or None in a window.
        """
        if self.closed:
            return None
        points = [np.asarray(p, dtype=np.float64).reshape(-1, 2) for p in shape_points]
        pose = np.asarray(poses, dtype=np.float64).reshape(len(points), 12)
        goal = None if target is None else np.asarray(target, dtype=np.float64)
        good = np.isfinite(pose[:, [0, 1, 2, 6, 7, 8]]).all() and all(np.isfinite(p).all() for p in points)
        if time < self._time:
            self._restart()
        if good and time > self._time:
            self._trace.append(points[-1][-1])
        self._time = time

        if good:
            self._follow(np.concatenate(points))
        self._draw_paper()
        if good:
            chain = [smooth(p, pose[k, 2], pose[k, 8]) for k, p in enumerate(points)]
            self._draw_ghost(rigid_arm(chain, pose))
            self._draw_trace()
            if goal is not None:
                self._draw_target(goal, chain[0][0] if len(chain) == 1 else None)
            self._draw_links(chain)
        picture = self._pg.transform.smoothscale(self._canvas, self.size)
        self._draw_panels(picture, time, torques, deflection, good)
        return self._show(picture)

    def close(self) -> None:
        """Close the window, if there is one, and give the pictures back."""
        self.closed = True
        if self._window is not None:
            self._window, self._clock = None, None
            self._pg.display.quit()

    # --------------------------------------------------------------- window
    def _open(self) -> None:
        pg = self._pg
        try:
            pg.display.init()
            if pg.display.get_driver() in ("dummy", "offscreen"):
                raise pg.error("no display")
            self._window = pg.display.set_mode(self.size)
            pg.display.set_caption("flexarm_env")
            self._clock = pg.time.Clock()
        except pg.error as reason:
            pg.display.quit()
            logging.getLogger(__name__).warning(
                "render_mode 'human': no window (%s); render_mode 'rgb_array' needs no display", reason
            )

    def _show(self, picture: Any) -> NDArray[np.uint8] | None:
        pg = self._pg
        if self.mode == "rgb_array":
            return np.ascontiguousarray(pg.surfarray.array3d(picture).transpose(1, 0, 2))
        if self._window is not None:
            if any(event.type == pg.QUIT for event in pg.event.get()):
                self.close()
                return None
            self._window.blit(picture, (0, 0))
            pg.display.flip()
            self._clock.tick(self.fps)
        return None

    # ----------------------------------------------------------------- view
    def _follow(self, points: Array) -> None:
        """Move the view as little as it takes to keep the arm inside."""
        half = 0.94 * np.array(self.size) * SUPERSAMPLING / (2.0 * self._scale)
        low, high = points.min(axis=0) + half, points.max(axis=0) - half
        self._center = np.where(
            low < high, 0.5 * (low + high), np.minimum(np.maximum(self._center, high), low)
        )

    def _pixels(self, points: ArrayLike) -> Array:
        """Canvas coordinates (..., 2) of points in m."""
        middle = 0.5 * np.array(self.size) * SUPERSAMPLING
        offset = (np.asarray(points, dtype=np.float64) - self._center) * self._scale
        return np.clip(middle + offset * (1.0, -1.0), -30000.0, 30000.0)

    def _draw_paper(self) -> None:
        """The grid, drawn anew where the view has moved."""
        place = (float(self._center[0]), float(self._center[1]))
        if place != self._paper_at:
            self._paper_at = place
            paper, pg = self._paper, self._pg
            paper.fill(PAPER)
            width, height = paper.get_size()
            half = np.array([width, height]) / (2.0 * self._scale)
            thin = max(1, round(1.1 * self._unit))
            first = np.floor((self._center - half) / self._cell).astype(int)
            last = np.ceil((self._center + half) / self._cell).astype(int)
            for axis in (0, 1):
                for k in sorted(range(first[axis], last[axis] + 1), key=lambda k: k == 0):
                    at = round(self._pixels(np.full(2, k * self._cell))[axis])
                    ends = ((at, 0), (at, height)) if axis == 0 else ((0, at), (width, at))
                    pg.draw.line(paper, GRID if k else AXIS, *ends, thin)
            self._ring(paper, np.zeros(2), self.reach * self._scale, AXIS, thin)
        self._canvas.blit(self._paper, (0, 0))

    # ------------------------------------------------------------- strokes
    def _disc(self, at: ArrayLike, radius: float, color: Color) -> None:
        """A filled disc; radius in pixels of the picture of 640."""
        self._pg.draw.circle(self._canvas, color, self._pixels(at), radius * self._unit)

    def _ring(self, surface: Any, at: ArrayLike, radius: float, color: Color, width: int) -> None:
        self._pg.draw.circle(surface, color, self._pixels(at), radius, max(1, width))

    def _band(self, points: Array, root: float, tip: float, color: Color, shift: float = 0.0) -> None:
        """A stroke along `points` whose width goes from `root` to `tip`, with round ends."""
        line = self._pixels(points) + shift * self._unit
        widths = np.linspace(root, tip, len(line)) * self._unit
        self._pg.draw.polygon(self._canvas, color, ribbon(line, widths))
        for end, width in ((0, widths[0]), (-1, widths[-1])):
            self._pg.draw.circle(self._canvas, color, line[end], 0.5 * width)

    def _dashes(self, start: Array, end: Array, color: Color, width: float) -> None:
        a, b = self._pixels(start), self._pixels(end)
        count = max(1, round(float(np.hypot(*(b - a))) / (9.0 * self._unit)))
        for k in range(count):
            ends = a + (b - a) * (k / count), a + (b - a) * ((k + 0.5) / count)
            self._pg.draw.polygon(self._canvas, color, ribbon(np.array(ends), np.full(2, width * self._unit)))

    def _widths(self, k: int, n: int) -> tuple[float, float]:
        """Stroke of link k of n at its root and tip: one taper along the whole arm."""
        return 12.0 - 6.0 * k / n, 12.0 - 6.0 * (k + 1) / n

    def _draw_ghost(self, arm: list[Array]) -> None:
        for edge, color in ((2.4, GHOST_EDGE), (0.0, GHOST)):
            for k, line in enumerate(arm):
                root, tip = self._widths(k, len(arm))
                self._band(line, 0.8 * root + edge, 0.8 * tip + edge, color)

    def _draw_trace(self) -> None:
        line = list(self._trace)
        for k, (a, b) in enumerate(zip(line[:-1], line[1:], strict=True), start=TRACE - len(line)):
            share = 0.55 * k / TRACE
            color = tuple(round(p + (q - p) * share) for p, q in zip(PAPER, PAYLOAD, strict=True))
            self._band(np.array([a, b]), 2.2, 2.2, color)  # type: ignore[arg-type]

    def _draw_target(self, at: Array, root: Array | None) -> None:
        """The target; for an arm of one link also its direction from the root."""
        if root is not None:
            self._dashes(root, root + (at - root) * 1.06, TARGET, 1.4)
        self._disc(at, 13.0, PAPER)
        self._ring(self._canvas, at, 13.0 * self._unit, TARGET, round(2.4 * self._unit))
        self._disc(at, 2.6, TARGET)

    def _draw_links(self, chain: list[Array]) -> None:
        n = len(chain)
        for k, line in enumerate(chain):
            self._band(line, *self._widths(k, n), SHADE, shift=2.5)
        for k, line in enumerate(chain):
            root, tip = self._widths(k, n)
            color = LINKS[k % len(LINKS)]
            self._band(line, root, tip, color)
            self._band(line, 0.28 * root, 0.28 * tip, lighter(color, 0.35))
        if self.hub:
            self._motor(chain[0][0], chain[0][1], 19.0)
        for line in chain[1:]:
            self._motor(line[0], line[1], 12.0)
        if self.payload:
            for radius, color in ((9.5, lighter(PAYLOAD, -0.25)), (8.0, PAYLOAD), (3.0, lighter(PAYLOAD, 0.55))):
                self._disc(chain[-1][-1], radius, color)

    def _motor(self, at: Array, towards: Array, radius: float) -> None:
        """A joint, with a mark on the side to which its link goes."""
        for share, color in ((1.0, INK), (0.86, STEEL), (0.5, lighter(STEEL, 0.75)), (0.2, INK)):
            self._disc(at, radius * share, color)
        direction = (towards - at) / max(float(np.hypot(*(towards - at))), 1e-30)
        self._disc(at + direction * 0.68 * radius * self._unit / self._scale, 0.13 * radius, PAPER)

    # --------------------------------------------------------------- panels
    def _text(self, picture: Any, text: str, at: tuple[float, float], height: float, color: Color, side: str) -> None:
        """Words at a corner or the middle of a side (`side` names a pygame.Rect attribute) of their box."""
        pixels = max(8, round(height * self._unit / SUPERSAMPLING))
        if pixels not in self._fonts:
            self._pg.font.init()
            self._fonts[pixels] = self._pg.font.Font(None, pixels)
        image = self._fonts[pixels].render(text, True, color)
        picture.blit(image, image.get_rect(**{side: (round(at[0]), round(at[1]))}))

    def _draw_panels(
        self, picture: Any, time: float, torques: ArrayLike | None, deflection: ArrayLike | None, good: bool
    ) -> None:
        u = self._unit / SUPERSAMPLING
        width, height = self.size
        self._text(picture, f"{time:.2f} s", (14 * u, 12 * u), 28, INK, "topleft")
        if not good:
            self._text(picture, "state not finite", (width / 2, height / 2), 28, DEFLECTION, "center")
        long = self._cell * self._scale / SUPERSAMPLING
        right, top = width - 16 * u, 30 * u
        self._text(picture, f"{self._cell:g} m", (right - long / 2, top - 3 * u), 19, FAINT, "midbottom")
        for x0, y0, x1, y1 in ((0, 0, long, 0), (0, -3 * u, 0, 3 * u), (long, -3 * u, long, 3 * u)):
            self._pg.draw.line(picture, FAINT, (right - x0, top + y0), (right - x1, top + y1))
        if deflection is not None:
            values = np.atleast_1d(np.asarray(deflection, dtype=np.float64))
            names = [f"link {k + 1}" for k in range(len(values))] if len(values) > 1 else ["tip"]
            largest = float(np.nanmax(np.abs(values), initial=0.0))
            self._full = max(self._full, next((s for s in FULL_SCALES if s >= largest), FULL_SCALES[-1]))
            note = f"deflection, ±{100 * self._full:g} % of L"
            self._bars(picture, 14 * u, note, names, values / self._full, values, DEFLECTION)
        if torques is not None:
            values = np.atleast_1d(np.asarray(torques, dtype=np.float64))
            names = ["hub", "elbow"] if len(values) <= 2 else [f"joint {k + 1}" for k in range(len(values))]
            self._bars(picture, width - 174 * u, "torque, % of limit", names, values, values, TORQUE)

    def _bars(
        self, picture: Any, left: float, note: str, names: list[str], shares: Array, values: Array, color: Color
    ) -> None:
        """Rows of a name, a bar from the middle (share -1 to 1) and a number in per cent, above the lower edge."""
        u, pg = self._unit / SUPERSAMPLING, self._pg
        rows = len(values)
        top = self.size[1] - (16 + 17 * rows) * u
        self._text(picture, note, (left, top), 17, FAINT, "topleft")
        for k, (name, share, value) in enumerate(zip(names, shares, values, strict=False)):
            y = top + (22 + 17 * k) * u
            self._text(picture, name, (left, y), 18, INK, "midleft")
            bar = pg.Rect(round(left + 40 * u), round(y - 4 * u), round(72 * u), max(3, round(8 * u)))
            pg.draw.rect(picture, SHADE, bar, border_radius=round(4 * u))
            if math.isfinite(share):
                middle, end = bar.centerx, bar.centerx + round(0.5 * bar.width * min(1.0, max(-1.0, share)))
                filled = pg.Rect(min(middle, end), bar.top, abs(end - middle), bar.height)
                pg.draw.rect(picture, color, filled)
            pg.draw.line(picture, FAINT, (bar.centerx, bar.top - 1), (bar.centerx, bar.bottom))
            number = f"{100 * value:+.1f} %".replace("-", "−") if math.isfinite(value) else "–"
            self._text(picture, number, (left + 160 * u, y), 18, INK, "midright")


# -------------------------------------------------------------------- geometry
def smooth(points: Array, root_angle: float, tip_angle: float, pieces: int = 6) -> Array:
    """A C1 cubic through points (n, 2) that leaves the first and reaches the last in the given directions (rad)."""
    n = len(points)
    if n < 2:
        return np.repeat(points, 2, axis=0)
    steps = np.hypot(*np.diff(points, axis=0).T)
    slopes = np.empty_like(points)
    slopes[1:-1] = 0.5 * (points[2:] - points[:-2])
    slopes[0] = steps[0] * np.array([math.cos(root_angle), math.sin(root_angle)])
    slopes[-1] = steps[-1] * np.array([math.cos(tip_angle), math.sin(tip_angle)])
    s = np.linspace(0.0, 1.0, pieces + 1)[:-1, None]
    a, b, c, d = (2 * s - 3) * s * s + 1, ((s - 2) * s + 1) * s, (3 - 2 * s) * s * s, (s - 1) * s * s
    inner = a * points[:-1, None] + b * slopes[:-1, None] + c * points[1:, None] + d * slopes[1:, None]
    return np.concatenate([inner.reshape(-1, 2), points[-1:]])


def ribbon(line: Array, widths: Array) -> Array:
    """Outline (2 n, 2) of a stroke of the given widths (n,) along a line (n, 2)."""
    along = np.gradient(line, axis=0)
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) * (0.5 * widths / length)[:, None]
    return np.concatenate([line + normal, (line - normal)[::-1]])


def rigid_arm(chain: Sequence[Array], poses: Array) -> list[Array]:
    """Straight links (2, 2) of the chain's lengths at the joint angles of `poses` (N, 12)."""
    at, angle = chain[0][0], float(poses[0, 2])
    arm = []
    for k, line in enumerate(chain):
        if k:
            angle += float(poses[k, 2] - poses[k - 1, 8])
        length = float(np.hypot(*np.diff(line, axis=0).T).sum())
        end = at + length * np.array([math.cos(angle), math.sin(angle)])
        arm.append(np.array([at, end]))
        at = end
    return arm


def round_step(value: float) -> float:
    """The largest of 1, 2, 5 times a power of ten that is not above value."""
    power = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return next(m * power for m in (5.0, 2.0, 1.0) if m * power <= value * (1.0 + 1e-9))


def lighter(color: Color, share: float) -> Color:
    """A colour moved towards white by a share of the way (towards black where negative)."""
    goal = 255 if share > 0.0 else 0
    red, green, blue = (round(c + (goal - c) * abs(share)) for c in color)
    return red, green, blue


def _pygame() -> Any:
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled('rendering needs pygame: pip install "flexarm_env[render]"') from error
    return pygame
