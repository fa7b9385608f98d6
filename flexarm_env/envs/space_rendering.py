"""Draw pictures of arms in space with pygame, in perspective.

Shaded ribbons show bending and twist of the links. Shadows and vertical lines to the ground show the positions of the
arm's parts.
"""

import math
from collections.abc import Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..geometry.outlines import faces_of
from ..shapes import HalfSpace
from ..validation import Array
from .drawing import AXIS, FAINT, GRID, INK, PAPER, SHADE, SUPERSAMPLING, Color, blend, draw_arrow, pygame_module, write
from .rendering import (
    FORCE,
    GHOST,
    GHOST_EDGE,
    KEEP_OUT,
    LINKS,
    MARGIN,
    OBSTACLE,
    PAYLOAD,
    STEEL,
    TARGET,
    WHITE,
    Renderer,
)

AZIMUTH, ELEVATION = math.radians(-58.0), math.radians(20.0)
"""Direction from which the camera looks: angle about z from the x axis, and angle above the ground."""
FAR = 5.0
"""Distance of the camera, in multiples of the reach."""
LIGHT = np.array([-0.25, -0.55, 0.8]) / np.linalg.norm([-0.25, -0.55, 0.8])
GROUND: Color = (243, 245, 248)
SHADOW: Color = (214, 219, 227)
ROUND = 10
"""Number of corners of the polygon that represents a round bar."""


class Camera:
    """Perspective view with the position `center` (3,), m, in the middle of the picture."""

    def __init__(self, size: tuple[int, int], reach: float, center: Array) -> None:
        """Place a camera that looks at center (3,), m, from a distance of `FAR` times reach (m).

        size: width and height of the picture, pixels.
        """
        c, s, up = math.cos(AZIMUTH), math.sin(AZIMUTH), math.sin(ELEVATION)
        flat = math.cos(ELEVATION)
        self.toward = np.array([c * flat, s * flat, up])  # the eye, seen from the center
        self.axes = np.array([[-s, c, 0.0], [-up * c, -up * s, flat], self.toward])
        self.size, self.center, self.far = size, np.asarray(center, np.float64), FAR * reach
        self.scale = min(size) * SUPERSAMPLING / (2.0 * MARGIN * reach) * self.far
        self.point = min(size) / 640.0 * SUPERSAMPLING
        self.eye = self.center + self.far * self.toward

    def see(self, points: ArrayLike) -> tuple[Array, Array]:
        """Project points (..., 3), m, to canvas coordinates (..., 2).

        The second result contains the distances (...) of the points along the viewing direction, m.
        """
        x, y, z = np.moveaxis((np.asarray(points, np.float64) - self.center) @ self.axes.T, -1, 0)
        away = np.maximum(self.far - z, 0.05 * self.far)
        middle = 0.5 * SUPERSAMPLING * np.array(self.size)
        flat = middle + np.stack([x, -y], axis=-1) * (self.scale / away)[..., None]
        return np.clip(flat, -30000.0, 30000.0), away


class SpaceRenderer(Renderer):
    """Renderer of arms in space; each call of `frame_of` draws one picture.

    Args:
        sides: (N, 2), width and thickness of each link, m (`geometry.ribbons.Ribbons`). ground: height of the ground,
            m. links: names of the links, for the deflection bars. Other arguments: those of `rendering.Renderer`.
    """

    def __init__(
        self, mode: str, reach: float, size: tuple[int, int] = (640, 640), fps: float = 50.0, *,
        sides: Array, ground: float = 0.0, links: Sequence[str] = (), payload: bool = True, **more: Any,
    ) -> None:  # fmt: skip
        """Check the arguments, including those of the base class `Renderer`.

        sides (N, 2): width and thickness of each link, m, 0 for a rigid link. ground: height of the ground with the
        shadows, m. links: names of the links that have deflection bars.
        """
        super().__init__(mode, reach, size, fps, payload=payload, **more)
        least = np.array([0.03, 0.007]) * self.reach
        self.half = 0.5 * np.where(np.asarray(sides) > 0.0, np.maximum(sides, least), 0.06 * self.reach)
        self.ground, self.links, self._room = ground, list(links), 0.94 * MARGIN * self.reach

    def _restart(self) -> None:
        super()._restart()
        self._center = np.array([0.0, 0.0, 0.12 * self.reach])

    def frame_of(
        self,
        chain: Sequence[tuple[Array, Array]],
        target: ArrayLike | None,
        time: float,
        torques: ArrayLike | None = None,
        deflection: ArrayLike | None = None,
        rigid: ArrayLike | None = None,
    ) -> NDArray[np.uint8] | None:
        """Draw the arm at one instant.

        Args:
            chain: for each of the N links two arrays (P, 3): points of the link, m, and the directions of its width
                there. rigid: (N + 1, 3), positions of joints and tip of the rigid arm, m, or None. target (3,): target
                point, m, or None. Other arguments: as in `Renderer.frame`.
        Returns:
            The picture, (height, width, 3) uint8; None if a window shows it.
        """
        if not self.ready():
            return None
        good = bool(all(np.isfinite(points).all() and np.isfinite(across).all() for points, across in chain))
        self._go_on(time, np.concatenate([points for points, _ in chain]) if good else None)
        self.ghost = rigid is not None
        camera = Camera(self.size, self.reach, self._center)
        canvas = _empty(self.size, self.reach, tuple(self._center), self.ground, self._cell).copy()
        if good:
            self._draw_scene(canvas, camera, chain, target, rigid)
        picture = pygame_module().transform.smoothscale(canvas, self.size)
        return self._with_panels(picture, time, torques, deflection, good)

    # ---------------------------------------------------------------- the scene
    def _draw_scene(
        self, canvas: Any, camera: Camera, chain: Sequence[tuple[Array, Array]], target: ArrayLike | None, rigid: Any
    ) -> None:
        """Draw the scene from back to front: shadows, target, rigid arm, trace of the tip, shapes and the arm itself.

        chain: points and cross-section axes of each link (`ribbons`). target (3,), m, or None. rigid: points of the
        rigid arm, or None.
        """
        pg, tip = pygame_module(), chain[-1][0][-1]
        for (points, across), half in zip(chain, self.half, strict=True):
            flat = _quads(_ring(points, across, half))
            flat = flat[flat[..., 2].mean(axis=1) >= self.ground]
            flat[..., 2] = self.ground
            for quad in camera.see(flat)[0]:
                pg.draw.polygon(canvas, SHADOW, quad)
        self._plumb(canvas, camera, tip, PAYLOAD)
        if target is not None:
            self._plumb(canvas, camera, np.asarray(target, np.float64), TARGET)
        if rigid is not None:
            seen, width = camera.see(rigid)[0], round(5.0 * camera.point)
            for color, wide in ((GHOST_EDGE, width), (GHOST, width - round(1.6 * camera.point))):
                for a, b in pairwise(seen):
                    pg.draw.line(canvas, color, a, b, wide)
        if len(self._trace) > 1:
            seen = camera.see(np.array(self._trace))[0]
            for k, (a, b) in enumerate(pairwise(seen)):
                color = blend(PAPER, PAYLOAD, 0.2 + 0.5 * k / len(seen))
                pg.draw.line(canvas, color, a, b, round(2.0 * camera.point))
        if target is not None:
            self._draw_target(canvas, camera, np.asarray(target, np.float64))
        around = [face for shape in self.keep_out for face in faces_of(shape, self._center, 0.7 * self.reach)]
        solid = [
            _above(face, self.ground) if isinstance(shape, HalfSpace) else face
            for shape in self.obstacles for face in faces_of(shape, self._center, 0.7 * self.reach)
        ]  # fmt: skip
        self._draw_faces(canvas, camera, [face for face in around if not _facing(face, camera.eye)])
        self._draw_faces(canvas, camera, [face for face in solid if not _facing(face, camera.eye)], OBSTACLE)
        for _, draw in sorted(self._pieces(canvas, camera, chain), key=lambda piece: -piece[0]):
            draw()
        self._draw_faces(canvas, camera, [face for face in around if _facing(face, camera.eye)])
        self._draw_faces(canvas, camera, [face for face in solid if _facing(face, camera.eye)], OBSTACLE)
        for ends in self.arrows():
            start, end = camera.see(np.array(ends))[0]
            draw_arrow(canvas, start, end, FORCE, camera.point)

    def _draw_faces(self, canvas: Any, camera: Camera, faces: Sequence[Array], color: Color = KEEP_OUT) -> None:
        """Draw transparent faces of the shapes that the arm must not enter and of the obstacles that it may touch."""
        pygame_module()
        from pygame import gfxdraw

        for face in faces:
            seen = camera.see(face)[0].round().astype(int).tolist()
            gfxdraw.filled_polygon(canvas, seen, (*color, 46))
            gfxdraw.aapolygon(canvas, seen, (*color, 150 if len(faces) < 12 else 36))

    def _plumb(self, canvas: Any, camera: Camera, at: Array, color: Color) -> None:
        """Draw a dashed line from a point to the ground, and a cross there."""
        pg, foot = pygame_module(), np.array([at[0], at[1], self.ground])
        (a, b), wide = camera.see(np.stack([at, foot]))[0], max(1, round(1.1 * camera.point))
        pale = blend(color, GROUND, 0.45)
        count = max(1, round(float(np.hypot(*(b - a))) / (8.0 * camera.point)))
        for k in range(count):
            pg.draw.line(canvas, pale, a + (b - a) * (k / count), a + (b - a) * ((k + 0.5) / count), wide)
        for arm in 0.022 * self.reach * np.eye(3)[:2]:
            pg.draw.line(canvas, color, *camera.see(np.stack([foot - arm, foot + arm]))[0], round(1.8 * camera.point))

    def _draw_target(self, canvas: Any, camera: Camera, at: Array) -> None:
        pg, seen = pygame_module(), camera.see(at)[0]
        pg.draw.circle(canvas, PAPER, seen, 12.0 * camera.point)
        pg.draw.circle(canvas, TARGET, seen, 12.0 * camera.point, round(2.4 * camera.point))
        pg.draw.circle(canvas, TARGET, seen, 2.6 * camera.point)

    def _pieces(self, canvas: Any, camera: Camera, chain: Sequence[tuple[Array, Array]]) -> list[tuple[float, Any]]:
        """Return the arm's parts as pairs (distance from the camera, function that draws the part)."""
        pieces: list[tuple[float, Any]] = []
        for k, ((points, across), half) in enumerate(zip(chain, self.half, strict=True)):
            solid = half[0] == half[1]
            color = STEEL if solid else LINKS[k % len(LINKS)]
            ring = _ring(points, across, half, ROUND if solid else 4)
            faces = _quads(ring)
            seen, away = camera.see(faces)
            normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
            size = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
            normals /= size
            facing = ((camera.eye - faces.mean(axis=1)) * normals).sum(axis=1) > 0.0
            light = 0.5 + 0.5 * (normals @ LIGHT)
            sides = np.arange(len(faces)) % ring.shape[1]
            for f in np.flatnonzero(facing).tolist():
                own = blend(color, WHITE, 0.3) if not solid and sides[f] == 0 else color
                tone = _lit(own, float(light[f]))
                if faces[f, :, 2].mean() < self.ground:  # seen through the ground
                    tone = blend(tone, GROUND, 0.6)
                edge = 0.0 if solid or sides[f] % 2 == 0 else float(half[0])  # behind the faces that it borders
                pieces.append((float(away[f].mean()) + edge, _polygon(canvas, tone, seen[f])))
            for end in (0, -1):
                cap, distance = camera.see(ring[end])
                pieces.append((float(distance.mean()) + 1e-3 * self.reach, _polygon(canvas, _lit(color, 0.35), cap)))
        for k, (points, _) in enumerate(chain):
            if k or self.hub:
                pieces.append(self._ball(canvas, camera, points[0], 0.026 if k else 0.034, STEEL))
        if self.payload:
            pieces.append(self._ball(canvas, camera, chain[-1][0][-1], 0.026, PAYLOAD))
        return pieces

    def _ball(self, canvas: Any, camera: Camera, at: Array, share: float, color: Color) -> tuple[float, Any]:
        """Draw a sphere. share: radius divided by the arm's reach."""
        pg, (seen, away) = pygame_module(), camera.see(at)
        radius = share * self.reach * camera.scale / float(away)
        color = color if at[2] >= self.ground else blend(color, GROUND, 0.6)

        def draw() -> None:
            for part, shift, tone in ((1.0, 0.0, -0.45), (0.9, 0.0, -0.1), (0.66, 0.2, 0.12), (0.3, 0.38, 0.5)):
                own = blend(color, WHITE, tone) if tone > 0.0 else blend(color, INK, -tone)
                pg.draw.circle(canvas, own, seen + radius * shift * np.array([-0.6, -0.8]), part * radius)

        return float(away) - share * self.reach, draw


def _above(face: Array, ground: float) -> Array:
    """Return the part of a wall's face (n, 3), m, that is above the ground; the whole face if no part is above."""
    kept = []
    for a, b in zip(face, np.roll(face, -1, axis=0), strict=True):
        if a[2] >= ground:
            kept.append(a)
        if (a[2] - ground) * (b[2] - ground) < 0.0:
            kept.append(a + (b - a) * ((ground - a[2]) / (b[2] - a[2])))
    return np.array(kept) if len(kept) > 2 else face


def _facing(face: Array, eye: Array) -> bool:
    """Return whether the camera sees a face from outside; for the single square of a wall, from behind."""
    return bool(np.cross(face[1] - face[0], face[2] - face[1]) @ (eye - face[0]) > 0.0)


def _polygon(canvas: Any, color: Color, corners: Array) -> Any:
    return lambda: pygame_module().draw.polygon(canvas, color, corners)


def _lit(color: Color, light: float) -> Color:
    """Return the color of a surface that receives a share of light from 0 to 1."""
    over = (light - 0.6) / 0.4 if light > 0.6 else (0.6 - light) / 0.6
    return blend(color, WHITE, 0.45 * over) if light > 0.6 else blend(color, INK, 0.75 * over)


def _ring(points: Array, across: Array, half: Array, corners: int = 4) -> Array:
    """Return section outlines (P, corners, 3) along a line; with four corners, the first side is the +y side."""
    along = np.gradient(points, axis=0) if len(points) > 2 else np.repeat(points[1:] - points[:1], len(points), axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=1), 1e-300)[:, None]
    up = np.cross(across, along)
    if corners == 4:
        turn = np.array([(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)])
    else:
        angle = 2.0 * math.pi * np.arange(corners) / corners
        turn = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray(
        points[:, None] + across[:, None] * (half[0] * turn[:, :1]) + up[:, None] * (half[1] * turn[:, 1:])
    )


def _quads(ring: Array) -> Array:
    """Return the faces (F, 4, 3) between consecutive outlines, one segment after the other."""
    after = np.roll(ring, -1, axis=1)
    return np.stack([ring[:-1], ring[1:], after[1:], after[:-1]], axis=2).reshape(-1, 4, 3)


@lru_cache(maxsize=4)
def _empty(size: tuple[int, int], reach: float, center: tuple[float, ...], ground: float, cell: float) -> Any:
    """Return the picture without an arm: a round piece of ground with a grid and the axes."""
    pg, camera = pygame_module(), Camera(size, reach, np.array(center))
    canvas = pg.Surface((size[0] * SUPERSAMPLING, size[1] * SUPERSAMPLING), 0, 32)
    canvas.fill(PAPER)
    turn = np.linspace(0.0, 2.0 * math.pi, 97)
    middle, radius = np.array([center[0], center[1], ground]), 1.02 * reach
    rim = camera.see(middle + radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1))[0]
    pg.draw.polygon(canvas, GROUND, rim)
    for axis in (0, 1):
        first, last = (math.ceil((center[axis] + way * radius) / cell) for way in (-1.0, 1.0))
        for k in range(first, last):
            off = k * cell - center[axis]
            long = math.sqrt(max(radius * radius - off * off, 0.0))
            ends = np.array([middle, middle])
            ends[:, axis] += off
            ends[:, 1 - axis] += [-long, long]
            wide = round((1.6 if k == 0 else 1.0) * camera.point)
            pg.draw.line(canvas, AXIS if k == 0 else blend(GRID, SHADE, 0.6), *camera.see(ends)[0], wide)
    pg.draw.lines(canvas, AXIS, True, rim, round(1.4 * camera.point))
    for name, way in (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0))):
        at = camera.see(middle + 1.05 * radius * np.array(way))[0]
        write(canvas, name, (float(at[0]), float(at[1])), 17.0 * camera.point, FAINT, "center")
    return canvas
