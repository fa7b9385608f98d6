"""Draw the arms of a batch by `rendering.Renderer`."""

import math
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..batch import View
from ..geometry.ribbons import cuts_of, ribbons, ribbons_of, sides
from ..parameters import Arm
from ..physics.layout import POSE, ROOT, SPACE_POSE
from ..physics.space.reading import straight
from ..rigid import largest_force
from ..trajectory import Trajectory
from .drawing import PAPER, pygame_module
from .options import Plan
from .rendering import Renderer, end_of_scale
from .space_rendering import SpaceRenderer
from .task import LAND, PRESS

SIDE = 640
"""Width and height of a picture, pixels."""

MOST = 16
"""Largest number of arms that a window shows."""


def renderer(plan: Plan, mode: str, size: tuple[int, int] = (SIDE, SIDE)) -> Renderer:
    """Create the renderer of an environment.

    In the deflection display, a full bar stands for the deflection of a clamped link under the joint's full torque.
    """
    arm, limits = plan.arm, plan.arm.torque_limits
    assert limits is not None
    softest = [min(float(link.along(x * link.length).EI) for x in (0.0, 0.5, 1.0)) for link in arm.links]
    rows = zip(limits, arm.links, softest, strict=True)
    bend = max((t * link.span / (2.0 * EI) for t, link, EI in rows if not link.rigid), default=0.2)
    usual: dict[str, Any] = {"size": size, "fps": 1.0 / plan.period, "deflection": end_of_scale(bend)}
    usual["payload"] = arm.payload.mass > 0.0
    pen: Renderer = pictures_of(arm.axes).pen(arm, mode, **usual)
    pen.keep_out = plan.keep_out
    # impacts exceed the motors' static force several times; commanded forces are a share of it
    at_wall = plan.kind.task in (LAND, PRESS)
    pen.force = 0.5 * largest_force(arm) if at_wall else 5.0 * limits[0] / arm.total_length
    return pen


def bending(arm: Arm) -> list[str]:
    """Return the names of the flexible links."""
    return [f"link {k + 1}" for k, link in enumerate(arm.links) if not link.rigid]


def bent(arm: Arm, deflection: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the rows of `deflection` (N, 2), the links' deflections along y and z, that belong to flexible links."""
    y, z = deflection[[not link.rigid for link in arm.links]].T
    return np.asarray(np.hypot(y, z))


class Wall:
    """Window with pictures of at most MOST arms in rows and columns.

    Args:
        plan: plan of the environment. count: number of arms.
    """

    def __init__(self, plan: Plan, count: int) -> None:
        """Lay out tiles for up to `MOST` of count environments in a square, and open a window for them."""
        shown = min(count, MOST)
        self.columns = math.ceil(math.sqrt(shown))
        self.tile = SIDE if shown == 1 else max(240, 960 // self.columns)
        self.plan = plan
        self.pens = [renderer(plan, "rgb_array", (self.tile, self.tile)) for _ in range(shown)]
        rows = math.ceil(shown / self.columns)
        self.window = renderer(plan, "human", (self.columns * self.tile, rows * self.tile))

    def draw(self, view_of: Callable[[int], View]) -> None:
        """Draw the arms at the present time. view_of: function that returns the `View` of arm i."""
        if not self.window.ready():
            return
        pg = pygame_module()
        sheet = pg.Surface(self.window.size)
        sheet.fill(PAPER)
        for i, pen in enumerate(self.pens):
            pixels = draw(pen, self.plan, view_of(i))
            tile = pg.image.frombuffer(pixels.tobytes(), (self.tile, self.tile), "RGB")
            sheet.blit(tile, ((i % self.columns) * self.tile, (i // self.columns) * self.tile))
        self.window.show(sheet)

    def close(self) -> None:
        """Close the window with the pictures."""
        self.window.close()


def draw(pen: Renderer, plan: Plan, view: View) -> Any:
    """Draw an arm's present shape and return the picture."""
    pen.touches = view.touches
    pen.obstacles = [contact.obstacle_at(view.time) for contact in plan.contacts]
    return pictures_of(plan.arm.axes).of_view(pen, plan, view)


class Pictures:
    """Pictures of arms in the plane."""

    def pen(self, arm: Arm, mode: str, ground: float = 0.0, **usual: Any) -> Any:
        """Create a renderer. usual: further arguments of `Renderer`. ground: height of the floor, m, only in space."""
        return Renderer(mode, arm.total_length, **usual)

    def of_view(self, pen: Any, plan: Plan, view: View) -> Any:
        """Draw the arm of an environment at the instant `view`, and return the picture."""
        target = plan.kind.target.place(plan.arm, view.target)
        shapes = chain(view.points, view.poses)
        attitude = None
        if plan.arm.base is not None:  # its attitude is the last row but those of moving obstacles
            obstacles = sum(len(contact.displacements) for contact in plan.contacts)
            attitude, hub = float(view.q[-1 - obstacles]), view.points[0]
            target = hub + target if plan.kind.target.numbers == 1 else target
        angles, torques = view.poses[:, [POSE.angle, POSE.tip_angle]], view.torques / np.array(plan.arm.torque_limits)
        return pen.frame(shapes, angles, target, view.time, torques, view.deflection, attitude)

    def of_run(self, pen: Any, run: Trajectory) -> Callable[[int, Any], Any]:
        """Return a function that draws instant i of a run, with joint torques divided by their limits (or None)."""
        hinges = cuts_of(run.shapes, run.hinges)

        def draw(i: int, torques: Any) -> Any:
            links = [run.shapes[i, a : b + 1] for a, b in pairwise(hinges)]
            return pen.frame(links, run.link_angles[i], None, float(run.t[i]), torques, run.tip_deflection[i])

        return draw


class PicturesInSpace(Pictures):
    """Pictures of arms in space."""

    def pen(self, arm: Arm, mode: str, ground: float = 0.0, **usual: Any) -> Any:
        """Create a renderer in space with the floor at the height `ground`, m."""
        return SpaceRenderer(mode, arm.total_length, sides=sides(arm), links=bending(arm), ground=ground, **usual)

    def of_view(self, pen: Any, plan: Plan, view: View) -> Any:
        """Draw the arm of an environment at the instant `view` as ribbons, and return the picture."""
        target, ribbon = plan.kind.target.place(plan.arm, view.target), ribbons(plan.arm, plan.settings, view.q[None])
        off = bent(plan.arm, view.deflection.reshape(2, -1).T)
        rigid = straight(plan.arm, view.poses[:, SPACE_POSE.angle])
        torques = view.torques / np.array(plan.arm.torque_limits)
        return pen.frame_of(ribbon.chain(0), target, view.time, torques, off, rigid)

    def of_run(self, pen: Any, run: Trajectory) -> Callable[[int, Any], Any]:
        """Return a function that draws instant i of a run, with ribbons."""
        arm, found, held = run.scene.arm, ribbons_of(run), run.scene.root == "pinned"

        def draw(i: int, torques: Any) -> Any:
            rigid = straight(arm, run.joint_angles[i]) + run.start[i] if held else None
            off = bent(arm, run.tip_deflection[i])
            return pen.frame_of(found.chain(i), None, float(run.t[i]), torques, off, rigid)

        return draw


def pictures_of(axes: str) -> Pictures:
    """Return the `Pictures` of arms that move along the given axes (`Arm.axes`)."""
    return {"xy": Pictures(), "xyz": PicturesInSpace()}[axes]


def chain(points: NDArray[np.float64], poses: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """Split the points from root to tip into links, at the points nearest to the joints."""
    cuts = [0]
    for pose in poses[1:]:
        distance = np.hypot(*(points[cuts[-1] + 1 : -1] - pose[ROOT][:2]).T)
        cuts.append(cuts[-1] + 1 + int(distance.argmin()))
    cuts.append(len(points) - 1)
    return [points[a : b + 1] for a, b in pairwise(cuts)]
