"""Draw pictures of planar arms with pygame.

A picture shows the deformed links to scale, the rigid arm at the same joint angles in a pale color, the target, the
payload, hub and elbows, the recent path of the tip, the tip deflections, the joint torques, the time and a grid.
pygame is imported when the first `Renderer` is created. Rendering to arrays of pixels requires no display.
"""

import logging
import math
import os
import sys
from collections import deque
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.outlines import outline_of
from ..shapes import Shape
from ..validation import Array
from .drawing import (
    FAINT,
    INK,
    PAPER,
    SHADE,
    Color,
    Sheet,
    array_of,
    blend,
    length_of,
    pygame_module,
    round_step,
    scale_of,
    smooth,
    write,
)

MODES = ("human", "rgb_array")
MARGIN = 1.14
"""Length shown by half of the picture's shorter side, divided by the arm's reach."""
TRACE = 60
"""Number of instants for which the tip's path stays visible."""
FULL_SCALES = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
"""Possible full scales of the bars: deflections as shares of the link's length, torques as shares of the limit."""
DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")
"""Environment variables that name the display; on systems that use them, one must be set."""

WHITE: Color = (255, 255, 255)
GHOST: Color = (221, 226, 233)
GHOST_EDGE: Color = (188, 197, 208)
LINKS: tuple[Color, ...] = ((43, 88, 138), (38, 132, 140))
STEEL: Color = (92, 104, 120)
PAYLOAD: Color = (232, 134, 46)
TARGET: Color = (34, 152, 92)
TORQUE: Color = (122, 94, 172)
DEFLECTION: Color = (204, 84, 62)
BODY: Color = (203, 210, 219)
PANEL: Color = (120, 148, 190)
KEEP_OUT: Color = (196, 66, 66)
OBSTACLE: Color = (96, 104, 118)
FORCE: Color = (214, 40, 90)
ARROW = 0.5
"""Greatest length of a force's arrow, in multiples of the reach."""


class Renderer:
    """Renderer of planar arms; each call of `frame` draws one picture.

    Args:
        mode: "rgb_array" returns pixels. "human" shows a window in real time; without a display, the renderer logs one
            warning and draws nothing.
        reach: largest distance of the tip from the root, m, which determines the scale.
        size: width and height, pixels. fps: pictures per second in the window.
        hub: True if a motor turns the root. payload: True if the tip carries a payload.
        deflection, torque: full scales of the bars for the tip deflection divided by the link's length and for the
            torque divided by its limit.
    Raises:
        ValueError: an unknown mode, or a reach that is not positive. gymnasium.error.DependencyNotInstalled: pygame is
            not installed.
    """

    def __init__(
        self,
        mode: str,
        reach: float,
        size: tuple[int, int] = (640, 640),
        fps: float = 50.0,
        hub: bool = True,
        payload: bool = True,
        deflection: float = 0.2,
        torque: float = 1.0,
    ) -> None:
        """Check the arguments, which the class describes; the window opens with the first frame.

        Raises:
            ValueError: an unknown mode, or a reach (m) that is not positive and finite.
        """
        if mode not in MODES:
            raise ValueError(f"render_mode = {mode!r}: must be one of {', '.join(MODES)}")
        if not 0.0 < reach < math.inf:
            raise ValueError(f"reach = {reach!r}: must be a positive number (m)")
        pygame_module()
        self.mode, self.reach, self.size, self.fps = mode, float(reach), (int(size[0]), int(size[1])), fps
        self.hub, self.payload, self.ends = hub, payload, (float(deflection), float(torque))
        self.links: list[str] | None = None
        """Names of the deflection bars, if not all links have a bar."""
        self.ghost = True
        """Whether the picture shows the rigid arm, with a caption."""
        self.keep_out: Sequence[Shape] = ()
        """Shapes that the arm must not enter; the picture shows them."""
        self.obstacles: Sequence[Shape] = ()
        """Obstacles that the arm may touch; the picture shows them."""
        self.touches: Array = np.zeros((0, 7))
        """`batch.View.touches` for the next picture: positions (m) of points that may touch; forces (N)."""
        self.force = 1.0
        """Force (N) whose arrow has half of the greatest length."""
        self.closed = False
        """True if the window was closed, by the user or by `close`."""
        self._cell = round_step(self.reach / 3.0)
        self._room: Any = 0.94 * MARGIN * self.reach * np.array(self.size) / min(self.size)
        self._window: Any = None
        self._clock: Any = None
        self._opened = False
        self._restart()

    def _restart(self) -> None:
        """Clear the trace and the view of the last episode."""
        self._time = -math.inf
        self._center = np.zeros(2)
        self._trace: deque[Array] = deque(maxlen=TRACE)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state without the window; a copy opens its own window when it draws."""
        return self.__dict__ | {"_window": None, "_clock": None, "_opened": False}

    # ------------------------------------------------------------ a picture
    def frame(
        self,
        shape_points: Sequence[ArrayLike],
        angles: ArrayLike,
        target: ArrayLike | None,
        time: float,
        torques: ArrayLike | None = None,
        deflection: ArrayLike | None = None,
        attitude: float | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw the arm at one instant.

        Args:
            shape_points: for each of the N links, the points (n, 2) of the link from root to tip, m.
            angles: (N, 2), angles of the tangents at the links' roots and tips, rad.
            target (2,): target point, m, or None. time: time of the episode, s; a time earlier than in the previous
                frame starts a new episode.
            torques (N,): torques divided by their limits, or None. deflection (N,): tip deflections divided by the
                link's length, or None.
            attitude: attitude of a floating base, rad, or None.
        Returns:
            The picture, (height, width, 3) uint8; None if a window shows it.
        """
        if not self.ready():
            return None
        points = [np.asarray(p, dtype=np.float64).reshape(-1, 2) for p in shape_points]
        ends = np.asarray(angles, dtype=np.float64).reshape(len(points), 2)
        good = bool(np.isfinite(ends).all() and all(np.isfinite(p).all() for p in points))
        self._go_on(time, np.concatenate(points) if good else None)
        sheet = Sheet(self.size, self.reach, MARGIN, self._center, self._cell)
        if good:
            chain = [smooth(line, root, tip) for line, (root, tip) in zip(points, ends.tolist(), strict=True)]
            for shape in self.keep_out:
                sheet.area(outline_of(shape, self._center, 3.0 * self.reach), blend(KEEP_OUT, PAPER, 0.82), KEEP_OUT)
            for shape in self.obstacles:
                sheet.area(outline_of(shape, self._center, 3.0 * self.reach), blend(OBSTACLE, PAPER, 0.72), OBSTACLE)
            if attitude is not None:
                _draw_base(sheet, chain[0][0], attitude)
            _draw_ghost(sheet, rigid_arm(chain, ends))
            _draw_trace(sheet, self._trace)
            if target is not None:
                _draw_target(sheet, np.asarray(target, dtype=np.float64), chain)
            self._draw_links(sheet, chain)
            for at, end in self.arrows():
                sheet.arrow(at[:2], end[:2], FORCE)
        picture = sheet.picture()
        if attitude is not None and good:
            u, angle = max(0.75, min(self.size) / 640.0), round(math.degrees(attitude), 1)
            turned = f"{angle:+.1f}°".replace("-", "−") if angle else "0°"
            write(picture, f"base {turned}", (14 * u, 69.5 * u), 17 * u, FAINT, "midleft")
        return self._with_panels(picture, time, torques, deflection, good)

    @property
    def visible(self) -> bool:
        """True if a window is open."""
        return self._window is not None

    def held(self, key: str) -> bool:
        """Return whether a key is pressed in the window. key: pygame's name, such as "left", "left shift", "escape"."""
        keys = pygame_module().key
        return self.visible and bool(keys.get_pressed()[keys.key_code(key)])

    def close(self) -> None:
        """Close the window; later calls of `frame` have no effect."""
        self.closed = True
        if self._window is not None:
            self._window = self._clock = None
            pygame_module().display.quit()

    # --------------------------------------------------------------- window
    def ready(self) -> bool:
        """Return whether a picture can be shown; the first call in "human" mode opens the window."""
        if self.mode == "human" and not self._opened:
            self._open()
        return not self.closed and (self.mode == "rgb_array" or self._window is not None)

    def _open(self) -> None:
        """Open the window; without a display, log one warning and draw nothing."""
        pg = pygame_module()
        self._opened = True
        try:
            if sys.platform.startswith("linux") and not any(os.environ.get(name) for name in DISPLAYS):
                raise pg.error("there is no display")  # SDL would look for one, and print what its libraries miss
            pg.display.init()
            if pg.display.get_driver() in ("dummy", "offscreen"):
                raise pg.error("there is no display")
            self._window = pg.display.set_mode(self.size)
            pg.display.set_caption("flexarm_env")
            self._clock = pg.time.Clock()
        except pg.error as reason:
            pg.display.quit()
            text = "render_mode 'human' shows nothing here: %s (render_mode 'rgb_array' needs no display)"
            logging.getLogger(__name__).warning(text, reason)

    def show(self, picture: Any) -> None:
        """Show a surface in the window, in real time."""
        pg = pygame_module()
        if any(event.type == pg.QUIT for event in pg.event.get()):
            self.close()
            return
        self._window.blit(picture, (0, 0))
        pg.display.flip()
        self._clock.tick(self.fps)

    def _go_on(self, time: float, points: Array | None) -> None:
        """Shift the view by the least distance that keeps the arm inside, and extend the trace to the arm's tip.

        points: (n, 2), in space (n, 3), from root to tip; None if a point is not finite.
        """
        if time < self._time:
            self._restart()
        if points is not None:
            low, high = points.max(axis=0) - self._room, points.min(axis=0) + self._room  # where the centre may be
            self._center = np.where(low > high, 0.5 * (low + high), np.clip(self._center, low, np.maximum(low, high)))
            if time > self._time:
                self._trace.append(points[-1].copy())
        self._time = time

    def arrows(self) -> list[tuple[Array, Array]]:
        """Return start and end (m) of an arrow for each force that an obstacle exerts on the arm.

        For a force F, N, the length of the arrow is `ARROW` times the reach times F / (F + `force`), so that both large
        and small forces are visible.
        """
        found = []
        for row in self.touches[self.touches[:, 6] > 0.0]:
            size = float(np.linalg.norm(row[3:6]))
            long = ARROW * self.reach * size / (size + self.force)
            found.append((row[:3], row[:3] + long / size * row[3:6]))
        return found

    # ----------------------------------------------------------------- arm
    def _draw_links(self, sheet: Sheet, chain: list[Array]) -> None:
        """Draw the links with their shadow, the motors and the payload. chain: points (n, 2), m, of each link."""
        widths = [stroke_widths(k, len(chain)) for k in range(len(chain))]
        for line, (root, tip) in zip(chain, widths, strict=True):
            sheet.band(line, root, tip, SHADE, shift=2.5)
        for k, (line, (root, tip)) in enumerate(zip(chain, widths, strict=True)):
            color = LINKS[k % len(LINKS)]
            sheet.band(line, root, tip, color)
            sheet.band(line, 0.28 * root, 0.28 * tip, blend(color, WHITE, 0.35))
        if self.hub:
            _draw_motor(sheet, chain[0], 19.0)
        for line in chain[1:]:
            _draw_motor(sheet, line, 12.0)
        if self.payload:
            sheet.disc(chain[-1][-1], 9.5, blend(PAYLOAD, INK, 0.3))
            sheet.disc(chain[-1][-1], 8.0, PAYLOAD)
            sheet.disc(chain[-1][-1], 3.0, blend(PAYLOAD, WHITE, 0.55))

    # --------------------------------------------------------------- panels
    def _with_panels(
        self, picture: Any, time: float, torques: ArrayLike | None, deflection: ArrayLike | None, good: bool
    ) -> NDArray[np.uint8] | None:
        """Draw time, scale, deflections and torques in the corners of the picture.

        Returns the pixels of the picture, or None if a window shows it.
        """
        pg, u = pygame_module(), max(0.75, min(self.size) / 640.0)
        width, height = self.size
        write(picture, f"{time:.2f} s", (14 * u, 12 * u), 28 * u, INK, "topleft")
        if good and self.ghost:
            key = pg.Rect(round(14 * u), round(46 * u), round(26 * u), max(3, round(7 * u)))
            pg.draw.rect(picture, GHOST_EDGE, key)
            pg.draw.rect(picture, GHOST, key.inflate(-2, -2))
            write(picture, "rigid arm, same joint angles", (46 * u, 49.5 * u), 17 * u, FAINT, "midleft")
        if len(self.touches) and good:
            normal = float(self.touches[:, 6].sum())
            text = f"contact {normal:.3g} N" if normal > 0.0 else "no contact"
            write(picture, text, (14 * u, 69.5 * u), 17 * u, FORCE if normal > 0.0 else FAINT, "midleft")
        if not good:
            write(picture, "the state is not finite", (width / 2, height / 2), 28 * u, DEFLECTION, "center")
        long = round(self._cell * scale_of(self.size, self.reach, MARGIN))
        right, top = round(width - 16 * u), round(32 * u)
        write(picture, f"{self._cell:g} m", (right - long / 2, top - 4 * u), 19 * u, FAINT, "midbottom")
        pg.draw.line(picture, FAINT, (right - long, top), (right, top))
        for x in (right - long, right):
            pg.draw.line(picture, FAINT, (x, top - round(3 * u)), (x, top + round(3 * u)))
        if deflection is not None:
            values = np.atleast_1d(np.asarray(deflection, dtype=np.float64))
            usual = [f"link {k + 1}" for k in range(len(values))] if len(values) > 1 else ["tip"]
            names = usual if self.links is None else self.links
            note = f"deflection, ±{100 * self.ends[0]:g} % of L"
            _draw_bars(picture, u, 14 * u, note, names, values / self.ends[0], values, DEFLECTION)
        if torques is not None:
            values = np.atleast_1d(np.asarray(torques, dtype=np.float64))
            names = ["hub", "elbow"] if len(values) <= 2 else [f"joint {k + 1}" for k in range(len(values))]
            note = f"torque, ±{100 * self.ends[1]:g} % of limit"
            _draw_bars(picture, u, width - 182 * u, note, names, values / self.ends[1], values, TORQUE)
        if self.mode == "rgb_array":
            return array_of(picture)
        self.show(picture)
        return None


# ----------------------------------------------------------------------- parts
def end_of_scale(largest: float) -> float:
    """Return the smallest entry of FULL_SCALES that is at least `largest`, or the last entry if there is none."""
    return next((end for end in FULL_SCALES if end >= largest * (1.0 - 1e-9)), FULL_SCALES[-1])


def stroke_widths(k: int, n: int) -> tuple[float, float]:
    """Return the stroke widths, in points, of link k of n at root and tip; widths decrease along the whole arm."""
    return 12.0 - 6.0 * k / n, 12.0 - 6.0 * (k + 1) / n


def rigid_arm(chain: Sequence[Array], ends: Array) -> list[Array]:
    """Return the rigid arm's links at the deformed arm's joint angles, as straight lines (2, 2) with the links'
    lengths.

    chain: points of each deformed link. ends (N, 2): angles of the tangents at the links' roots and tips, rad.
    """
    at, angle, before = chain[0][0], 0.0, 0.0
    arm = []
    for line, (root, tip) in zip(chain, ends.tolist(), strict=True):
        angle, before = angle + (root - before), tip
        end = at + length_of(line) * np.array([math.cos(angle), math.sin(angle)])
        arm.append(np.array([at, end]))
        at = end
    return arm


def _draw_ghost(sheet: Sheet, arm: list[Array]) -> None:
    for edge, color in ((2.4, GHOST_EDGE), (0.0, GHOST)):
        for k, line in enumerate(arm):
            root, tip = stroke_widths(k, len(arm))
            sheet.band(line, 0.8 * root + edge, 0.8 * tip + edge, color)


def _draw_trace(sheet: Sheet, trace: deque[Array]) -> None:
    if len(trace) > 1:
        first = TRACE - len(trace)
        colors = [blend(PAPER, PAYLOAD, 0.1 + 0.5 * (first + k) / TRACE) for k in range(1, len(trace))]
        sheet.trace(np.array(trace), colors, 2.0)


def _draw_target(sheet: Sheet, at: Array, chain: list[Array]) -> None:
    """Draw the target; for an arm of one link, also the direction from the root to the target."""
    if len(chain) == 1:
        root = chain[0][0]
        sheet.dashes(root, root + (at - root) * 1.07, 1.4, TARGET)
    sheet.disc(at, 13.0, PAPER)
    sheet.ring(at, 13.0, 2.4, TARGET)
    sheet.disc(at, 2.6, TARGET)


def _draw_base(sheet: Sheet, hub: Array, attitude: float) -> None:
    """Draw a floating base with two panels and a mark of its attitude, rad."""
    turn = np.array([[math.cos(attitude), math.sin(attitude)], [-math.sin(attitude), math.cos(attitude)]])
    box = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * sheet.point / sheet.scale
    fold = np.array([[0.0, -1.0], [0.0, 1.0]]) * sheet.point / sheet.scale
    for side in (-1.0, 1.0):
        sheet.area(hub + (box * (9.0, 22.0) + (0.0, side * 57.0 * fold[1, 1])) @ turn, PANEL, blend(PANEL, INK, 0.5))
    sheet.area(hub + box * (3.0, 36.0) @ turn, STEEL, STEEL)
    sheet.area(hub + box * 29.0 @ turn, BODY, blend(STEEL, INK, 0.3))
    sheet.dashes(hub, hub + np.array([31.0 * fold[1, 1], 0.0]) @ turn, 2.4, STEEL)


def _draw_motor(sheet: Sheet, line: Array, radius: float) -> None:
    """Draw a joint with a mark on the side of its link; radius in points."""
    at, along = line[0], line[1] - line[0]
    for share, color in ((1.0, INK), (0.86, STEEL), (0.5, blend(STEEL, WHITE, 0.75)), (0.2, INK)):
        sheet.disc(at, radius * share, color)
    direction = along / max(float(np.hypot(along[0], along[1])), 1e-30)
    sheet.disc(at + direction * (0.68 * radius * sheet.point / sheet.scale), 0.13 * radius, PAPER)


def _draw_bars(
    picture: Any, u: float, left: float, note: str, names: list[str], shares: Array, values: Array, color: Color
) -> None:
    """Draw rows that each contain a name, a bar (share -1 to 1) and a percentage, above the lower edge of the picture.

    A point marks a bar that exceeds the scale.
    """
    pg = pygame_module()
    top = picture.get_height() - (30 + 18 * len(values)) * u
    write(picture, note, (left, top), 17 * u, FAINT, "topleft")
    for name, share, value, row in zip(names, shares, values, range(len(values)), strict=False):
        y = top + (26 + 18 * row) * u
        write(picture, name, (left, y), 18 * u, INK, "midleft")
        bar = pg.Rect(round(left + 46 * u), round(y - 4 * u), 2 * round(34 * u), max(3, round(8 * u)))
        pg.draw.rect(picture, SHADE, bar)
        if math.isfinite(share):
            end = bar.centerx + round(0.5 * bar.width * min(1.0, max(-1.0, share)))
            pg.draw.rect(picture, color, (min(bar.centerx, end), bar.top, abs(end - bar.centerx), bar.height))
            if abs(share) > 1.0:
                tip = end + math.copysign(5.0 * u, share)
                pg.draw.polygon(picture, color, [(end, bar.top - 2), (end, bar.bottom + 1), (tip, bar.centery)])
        pg.draw.line(picture, FAINT, (bar.centerx, bar.top - 2), (bar.centerx, bar.bottom + 1))
        digits = 1 if abs(value) < 0.9995 else 0  # wider numbers would touch the bar
        per_cent = round(100 * value, digits) if math.isfinite(value) else math.nan
        number = "–" if per_cent != per_cent else f"{per_cent:+.{digits}f} %".replace("-", "−") if per_cent else "0 %"
        write(picture, number, (left + 168 * u, y), 18 * u, INK, "midright")
