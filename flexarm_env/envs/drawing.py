"""Draw strokes, discs and text on a supersampled pygame surface, for pictures of arms."""

import math
from functools import lru_cache
from typing import Any

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import ArrayLike, NDArray

from .. import validation as check
from ..validation import Array

Color = tuple[int, int, int]

SUPERSAMPLING = 3
"""Supersampling factor: strokes are drawn on a canvas larger by this factor in width and height, then averaged."""

PAPER: Color = (250, 251, 252)
SHADE: Color = (229, 233, 239)
GRID: Color = (236, 239, 244)
AXIS: Color = (214, 221, 229)
INK: Color = (52, 62, 76)
FAINT: Color = (120, 132, 147)


def pygame_module() -> Any:
    """Import pygame and return the module. If pygame is missing, DependencyNotInstalled is raised."""
    try:
        import pygame
    except ImportError as error:
        raise DependencyNotInstalled(check.lacking("rendering", "pygame-ce", "render")) from error
    return pygame


class Sheet:
    """Canvas of one picture of an arm, on which the methods draw.

    Args:
        size: width and height of the picture, pixels. reach: arm's reach, m. margin: half of the picture's shorter
            side, in m, divided by the reach.
        center (2,): position at the middle of the picture, m. cell: side of a grid square, m.
    A "point", the unit of strokes and radii, is 1/640 of the picture's shorter side.
    """

    def __init__(self, size: tuple[int, int], reach: float, margin: float, center: Array, cell: float) -> None:
        """Draw paper of size (width, height), pixels, around `center` (2,), m, with grid squares of `cell` m.

        reach: the arm's reach, m; half of the picture's shorter side shows the length margin * reach (`scale_of`).
        """
        self.pg = pygame_module()
        self.size, self.center = size, center
        self.scale = scale_of(size, reach, margin) * SUPERSAMPLING
        self.point = min(size) / 640.0 * SUPERSAMPLING
        self.canvas = _paper(size, reach, self.scale, (float(center[0]), float(center[1])), cell).copy()

    def pixels(self, points: ArrayLike) -> Array:
        """Convert points (..., 2), m, to canvas coordinates (..., 2)."""
        return _pixels(points, self.size, self.scale, self.center)

    def disc(self, at: ArrayLike, radius: float, color: Color) -> None:
        """Draw a filled disc; its radius is in points."""
        self.pg.draw.circle(self.canvas, color, self.pixels(at), radius * self.point)

    def ring(self, at: ArrayLike, radius: float, width: float, color: Color) -> None:
        """Draw a circle; outer radius and width in points."""
        self.pg.draw.circle(self.canvas, color, self.pixels(at), radius * self.point, max(1, round(width * self.point)))

    def band(self, points: Array, root: float, tip: float, color: Color, shift: float = 0.0) -> None:
        """Draw a stroke along points (n, 2) with round ends; its width changes from `root` to `tip`, both in points."""
        line = self.pixels(points) + shift * self.point
        widths = np.linspace(root, tip, len(line)) * self.point
        self.pg.draw.polygon(self.canvas, color, ribbon(line, widths))
        for end in (0, -1):
            self.pg.draw.circle(self.canvas, color, line[end], 0.5 * widths[end])

    def area(self, corners: Array, color: Color, edge: Color) -> None:
        """Draw a filled polygon (n, 2) with a thin edge."""
        seen = self.pixels(corners)
        self.pg.draw.polygon(self.canvas, color, seen)
        self.pg.draw.lines(self.canvas, edge, True, seen, max(1, round(1.4 * self.point)))

    def trace(self, points: Array, colors: list[Color], width: float) -> None:
        """Draw a line through points (n, 2), with one color for each of its n - 1 pieces."""
        line = self.pixels(points)
        for k, color in enumerate(colors):
            self.pg.draw.line(self.canvas, color, line[k], line[k + 1], max(1, round(width * self.point)))

    def arrow(self, start: ArrayLike, end: ArrayLike, color: Color) -> None:
        """Draw an arrow with a dot at its start and with a pale edge."""
        a, b = self.pixels(start), self.pixels(end)
        draw_arrow(self.canvas, a, b, color, self.point)

    def dashes(self, start: Array, end: Array, width: float, color: Color) -> None:
        """Draw a dashed line; its width is in points."""
        a, b = self.pixels(start), self.pixels(end)
        count = max(1, round(float(np.hypot(*(b - a))) / (9.0 * self.point)))
        wide = max(1, round(width * self.point))
        for k in range(count):
            self.pg.draw.line(self.canvas, color, a + (b - a) * (k / count), a + (b - a) * ((k + 0.5) / count), wide)

    def picture(self) -> Any:
        """Return the picture: the supersampled canvas, averaged to the picture's size."""
        return self.pg.transform.smoothscale(self.canvas, self.size)


def draw_arrow(canvas: Any, start: Array, end: Array, color: Color, point: float) -> None:
    """Draw an arrow between two canvas points, pixels, with a dot at its start.

    point: length of a "point" (see `Sheet`), pixels.
    """
    pg, way = pygame_module(), end - start
    long = float(np.hypot(*way))
    if long > 0.0:
        along = way / long
        across, head = np.array([-along[1], along[0]]), min(11.0 * point, long)
        for more, own in ((1.3 * point, PAPER), (0.0, color)):
            neck, half = end - head * along, 1.5 * point + more
            shaft = [start + half * across, neck + half * across, neck - half * across, start - half * across]
            pg.draw.polygon(canvas, own, shaft)
            wide = 5.0 * point + more
            back = neck - more * along
            pg.draw.polygon(canvas, own, [end + more * along, back + wide * across, back - wide * across])
    pg.draw.circle(canvas, PAPER, start, 5.2 * point)
    pg.draw.circle(canvas, color, start, 3.9 * point)


def write(picture: Any, text: str, at: tuple[float, float], height: float, color: Color, side: str) -> None:
    """Write text on a surface at the position `at`.

    side: point of the text's rectangle that is at `at`: an attribute of pygame.Rect, for example "topleft".
    """
    image = _label(text, max(7, round(height)), color)
    picture.blit(image, image.get_rect(**{side: (round(at[0]), round(at[1]))}))


def array_of(picture: Any) -> NDArray[np.uint8]:
    """Return the pixels (height, width, 3) of a surface as a new array."""
    data = pygame_module().image.tobytes(picture, "RGB")
    return np.frombuffer(data, dtype=np.uint8).reshape(picture.get_height(), picture.get_width(), 3).copy()


def scale_of(size: tuple[int, int], reach: float, margin: float) -> float:
    """Return the scale of a picture, pixels per m."""
    return min(size) / (2.0 * margin * reach)


def _pixels(points: ArrayLike, size: tuple[int, int], scale: float, center: ArrayLike) -> Array:
    middle = 0.5 * np.array(size) * SUPERSAMPLING
    offset = (np.asarray(points, dtype=np.float64) - np.asarray(center)) * scale
    return np.asarray(np.clip(middle + offset * (1.0, -1.0), -30000.0, 30000.0))


@lru_cache(maxsize=4)
def _paper(size: tuple[int, int], reach: float, scale: float, center: tuple[float, float], cell: float) -> Any:
    """Return an empty sheet with grid, axes and a circle of radius `reach` about the origin."""
    pg = pygame_module()
    width, height = size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING
    paper = pg.Surface((width, height), 0, 32)
    paper.fill(PAPER)
    half = np.array([width, height]) / (2.0 * scale)
    first = np.floor((np.array(center) - half) / cell).astype(int)
    last = np.ceil((np.array(center) + half) / cell).astype(int)
    lines = [(axis, k) for axis in (0, 1) for k in range(first[axis], last[axis] + 1)]
    for axis, k in sorted(lines, key=lambda line: line[1] == 0):  # the axes last
        at = float(_pixels(np.full(2, k * cell), size, scale, center)[axis])
        at = SUPERSAMPLING * math.floor(at / SUPERSAMPLING)  # one whole pixel of the picture
        box = (at, 0, SUPERSAMPLING, height) if axis == 0 else (0, at, width, SUPERSAMPLING)
        pg.draw.rect(paper, AXIS if k == 0 else GRID, box)
    pg.draw.circle(paper, AXIS, _pixels((0.0, 0.0), size, scale, center), reach * scale, SUPERSAMPLING)
    return paper


@lru_cache(maxsize=512)
def _label(text: str, height: int, color: Color) -> Any:
    """Render a text of a given height, pixels: draw it four times as large and average it down."""
    pg = pygame_module()
    if not pg.font.get_init():
        _font.cache_clear()
        pg.font.init()
    large = _font(4 * height).render(text, True, color)
    width, height = large.get_size()
    return pg.transform.smoothscale(large, (max(1, round(width / 4)), max(1, round(height / 4))))


@lru_cache(maxsize=16)
def _font(pixels: int) -> Any:
    return pygame_module().font.Font(None, pixels)


# -------------------------------------------------------------------- geometry
def smooth(points: Array, root_angle: float, tip_angle: float, pieces: int = 6) -> Array:
    """Return points of a smooth (C1) cubic curve through points (n, 2), with given directions (rad) at its ends.

    pieces: number of straight pieces that approximate the curve between two given points.
    """
    if len(points) < 2:
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
    """Return the outline (2 n, 2) of a stroke with widths (n,) along a line (n, 2)."""
    along = np.empty_like(line)
    along[1:-1] = line[2:] - line[:-2]
    along[0], along[-1] = line[1] - line[0], line[-1] - line[-2]
    length = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-12)
    normal = np.column_stack([-along[:, 1], along[:, 0]]) * (0.5 * widths / length)[:, None]
    return np.concatenate([line + normal, (line - normal)[::-1]])


def length_of(line: Array) -> float:
    """Return the length of a line (n, 2)."""
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def round_step(value: float) -> float:
    """Return the largest number of the form 1, 2 or 5 times a power of ten that does not exceed `value`."""
    power = 10.0 ** math.floor(math.log10(value) + 1e-9)
    return next(m * power for m in (5.0, 2.0, 1.0) if m * power <= value * (1.0 + 1e-9))


def blend(first: Color, second: Color, share: float) -> Color:
    """Return a color between two colors; share: 0 gives the first color, 1 the second."""
    red, green, blue = (round(a + (b - a) * share) for a, b in zip(first, second, strict=True))
    return red, green, blue
