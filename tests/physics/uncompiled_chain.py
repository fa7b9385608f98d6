"""Floating frames, in a chain or joined by multipliers, against their oracle, on plain Python numbers;
`test_floating_chain.py` runs this file.

The kernels are the very ones that are compiled elsewhere; here all meshes, frames and features come at no compile time.
"""

from typing import Any

import numpy as np
import pytest

from flexarm_env.compiler import UNCOMPILED
from flexarm_env.compiler.lanes import SINGLE
from flexarm_env.parameters import Arm, Elbow, Link, Payload, Section
from flexarm_env.physics.floating.build import build
from flexarm_env.physics.model import DIVERGED, OK
from flexarm_env.scene import PointLoad, Scene
from flexarm_env.settings import Settings
from flexarm_env.time_functions import constant
from tests.physics.oracle_chain import Chain
from tests.uncompiled_tools import Equations, States, close

pytestmark = pytest.mark.skipif(not UNCOMPILED, reason="runs uncompiled only")

SECTIONS = (
    Section(3.0, 40.0, 25.0, 0.7, 0.02),
    Section(2.0, 60.0, 1e3, 0.4, 0.01),
    Section(5.0, 90.0, 70.0, 0.9, 0.0),
)
LENGTHS = (1.0, 0.8, 0.5)


def scene_of(links: int, **features: Any) -> Scene:
    """A chain of unlike links with everything lumped that can be; features are left out by name."""
    elbows = (Elbow(0.2, 0.01, 0.02), Elbow(0.1, 0.005, 0.004))[: links - 1]
    arm = Arm(
        "chain",
        tuple(Link(length, section) for length, section in zip(LENGTHS[:links], SECTIONS[:links], strict=True)),
        hub_inertia=features.get("hub", 0.03),
        elbows=elbows if features.get("elbows", True) else (),
        payload=features.get("payload", Payload(0.3, 0.006)),
        tau_d=features.get("tau_d", 0.04),
        mass_damping=features.get("mass_damping", 0.0),
    )
    last = links - 1
    loads = (
        PointLoad(0, "tip", constant(1.0), constant(2.0), constant(0.5)),
        PointLoad(last, "root", constant(-1.0), constant(0.7), constant(0.2)),
        PointLoad(last, "tip", constant(0.3), constant(0.2), constant(-0.1)),
    )
    return Scene(
        "chain", arm, duration=1.0, dt=0.01, root=features.get("root", "pinned"), position=(0.3, -0.2),
        angles=(0.3, -0.2, 1.0)[:links], rigid_joints=features.get("rigid_joints", ()),
        gravity=features.get("gravity", (0.5, -9.81)), loads=loads if features.get("loads", True) else (),
    )  # fmt: skip


class Case(Equations):
    """Those of a mesh, and their oracle."""

    def __init__(self, links: int, features: dict[str, Any], stiffness: float = 1.0, **mesh: Any) -> None:
        self.scene, self.mesh = scene_of(links, **features), mesh
        super().__init__(build(self.scene, Settings.make("floating_frame", **mesh)))
        self.par[2] = stiffness
        self.free = [k for k in range(self.n) if k not in self.constrained]
        given = {"segments": 1, "elements": 1, "frame": "root", **mesh, "stiffness": stiffness}
        self.oracle = Chain(self.scene, joined=given.pop("multipliers", False), **given)
        # eigenvectors of the modes' mesh are known to nine digits
        self.tolerance = 1e-10 if mesh.get("modes") is None else 3e-8

    def state(self, seed: int = 1, size: float = 0.15) -> States:
        """q, v, a, u: deflections of `size`, everything moving; multipliers in q, none in v and a."""
        rng = np.random.default_rng(seed)
        q = self.system.q0 + size * rng.normal(size=self.n)
        v, a = rng.normal(size=self.n), rng.normal(size=self.n)
        q[self.constrained] = rng.normal(size=len(self.constrained))
        v[self.constrained] = a[self.constrained] = 0.0
        return q, v, a, rng.normal(size=self.n_inputs)


MESHES: list[dict[str, Any]] = [
    {"segments": 1, "elements": 3},
    {"segments": 2, "elements": 1},
    {"segments": 3, "elements": 2},
    {"segments": 2, "elements": 2, "coupling": "paper"},
    {"segments": 2, "elements": 1, "coupling": "linear"},
    {"modes": 1},
    {"modes": 3},
    {"segments": 3, "modes": 2},
]
FRAMES = ("root", "chord")
FEATURES: list[dict[str, Any]] = [
    {},
    {"gravity": None, "tau_d": 0.0, "loads": False},
    {"elbows": False, "payload": Payload(), "hub": 0.0},
]


def named(mesh: dict[str, Any]) -> str:
    return ",".join(f"{name}={value}" for name, value in mesh.items())


def cases() -> list[Any]:
    found = []
    for frame in FRAMES:
        for mesh in MESHES:
            if frame == "chord" and mesh.get("modes") == 1:
                continue
            for links in (1, 3) if "coupling" not in mesh else (2,):
                slow = links == 3 and mesh not in ({"segments": 2, "elements": 1}, {"modes": 3})
                marks = [pytest.mark.slow] if slow else []
                name = f"{links}-{frame}-{named(mesh)}"
                found.append(pytest.param(links, {**mesh, "frame": frame}, id=name, marks=marks))
    return found


ALL = pytest.mark.parametrize(("links", "mesh"), cases())
JOINED: list[dict[str, Any]] = [
    {"segments": 1, "elements": 2}, {"segments": 2, "elements": 1}, {"segments": 1, "elements": 3, "coupling": "paper"},
    {"segments": 2, "elements": 1, "coupling": "linear"}, {"modes": 2},
]  # fmt: skip
BOTH = pytest.mark.parametrize(
    ("links", "mesh"),
    cases() + [pytest.param(3, {**m, "multipliers": True}, id=f"3-{named(m)}", marks=pytest.mark.slow) for m in JOINED],
)


def joined(mesh: dict[str, Any], **features: Any) -> dict[str, Any]:
    """Features of the three links, of which multipliers join the last one at an angle; drag belongs to one frame."""
    drag = {"mass_damping": 0.3} if mesh.get("segments", 1) == 1 else {}
    return {**drag, "rigid_joints": (2,), **features} if mesh.get("multipliers") else features


@BOTH
def test_equations_are_those_of_lagrange(links: int, mesh: dict[str, Any]) -> None:
    for features in FEATURES:
        case = Case(links, joined(mesh, **features), **mesh)
        assert (case.n, case.constrained) == (case.oracle.n, case.oracle.multipliers)
        betas = {f"joint{k}": case.oracle.betas + k - 1 for k in range(1, links)}
        assert mesh.get("multipliers") or case.system.coordinates == {"root_x": 0, "root_y": 1, "joint0": 2, **betas}
        for seed in (1, 2):
            state = case.state(seed)
            assert close(case.residual(*state), case.oracle.residual(*state), case.tolerance), features


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("mesh", [{"segments": 1, "elements": 3}, {"segments": 1, "modes": 3}], ids=named)
def test_drag_and_a_softer_arm(frame: str, mesh: dict[str, Any]) -> None:
    """mass_damping, and the factor on EI that an arm of a batch may have."""
    for features in ({"mass_damping": 0.3}, {"tau_d": 0.0, "mass_damping": 0.3}):
        case = Case(2, features, stiffness=0.7, frame=frame, **mesh)
        state = case.state()
        assert close(case.residual(*state), case.oracle.residual(*state), case.tolerance)


@pytest.mark.parametrize("frame", FRAMES)
@pytest.mark.parametrize("mesh", [{"segments": 2, "elements": 2}, {"segments": 2, "modes": 2}], ids=named)
def test_numbers_that_are_none_are_out_of_range(frame: str, mesh: dict[str, Any]) -> None:
    case = Case(2, {}, frame=frame, **mesh)
    ask = case.functions["out_of_range"]
    assert ask(SINGLE, case.model, case.par, case.system.q0) == OK
    for wrong in (np.nan, np.inf):
        for k in range(3, case.oracle.betas):
            q = np.where(np.arange(case.n) == k, wrong, case.system.q0)
            with np.errstate(invalid="ignore"):
                assert ask(SINGLE, case.model, case.par, q) == DIVERGED


@ALL
def test_tangents_solve_what_differences_say(links: int, mesh: dict[str, Any]) -> None:
    """S = cm dr/da + cc dr/dv + ck dr/dq, factored and solved; the root's and the joints' coordinates can be pinned."""
    case = Case(links, {"mass_damping": 0.2 if mesh.get("segments", 1) == 1 else 0.0}, **mesh)
    joints = tuple(range(case.oracle.betas, case.n))
    pins = [(), (0, 1), (0, 1, 2), (0,), (2,), joints, (0, *joints)]
    for weights in ((1.0, 0.0, 0.0), (2.0, 0.7, 20.0)):
        state = case.state(3, 0.15 if mesh.get("modes") is None else 0.03)
        case.check_solutions(state, weights, pins, case.state(8))


@BOTH
def test_energies_and_losses(links: int, mesh: dict[str, Any]) -> None:
    case = Case(links, joined(mesh, mass_damping=0.2 if mesh.get("segments", 1) == 1 else 0.0), **mesh)
    q, v, x, _ = case.state(4)
    kinetic, strain, gravity = case.functions["energy"](SINGLE, case.model, case.par, q, v)
    assert kinetic == pytest.approx(float(case.oracle.kinetic(q, v)), rel=case.tolerance)
    assert gravity == pytest.approx(float(case.oracle.gravity(q)), rel=case.tolerance)
    if mesh.get("coupling") != "paper":
        assert strain == pytest.approx(float(case.oracle.strain(q)), rel=case.tolerance)
    loss = case.oracle.dissipation
    power = case.functions["damping_power"](SINGLE, case.model, case.par, q, v, x)
    assert power == pytest.approx(float(0.5 * (loss(q, v + x) - loss(q, v - x))), rel=10 * case.tolerance)


@BOTH
def test_places(links: int, mesh: dict[str, Any]) -> None:
    """Poses of roots and tips with rates, what inputs work on, and the curve that is drawn."""
    case = Case(links, joined(mesh), **mesh)
    q, v, _, _ = case.state(6)
    poses, y = np.full((links, 12), np.nan), np.full(case.n_inputs, np.nan)
    case.functions["link_poses"](SINGLE, case.model, case.par, q, v, poses.reshape(-1))
    assert close(poses, np.array([np.concatenate(pair) for pair in case.oracle.places(q, v)]), case.tolerance)
    case.functions["input_displacements"](SINGLE, case.model, case.par, q, y)
    assert close(y, case.oracle.ports(q), case.tolerance)
    points = np.full((4000, 2), np.nan)
    points = points[: case.functions["centerline"](SINGLE, case.model, q, points)]
    assert np.isfinite(points).all()
    bodies = len(case.oracle.bodies)
    assert (len(points) - 1) % bodies == 0
    stations = (len(points) - 1) // bodies
    for b in range(bodies):
        first = 1 if b and case.constrained else 0  # a gap between tip and root is drawn as the tip
        assert first or close(points[b * stations], case.oracle.root(b, q, v)[:2], case.tolerance)
        assert close(points[(b + 1) * stations], case.oracle.tip(b, q, v)[:2], case.tolerance)
        wanted = case.oracle.curve(b, stations, q)[first:]
        assert close(points[b * stations + first : (b + 1) * stations + 1], wanted, case.tolerance)
    assert case.functions["centerline"](SINGLE, case.model, q, np.zeros((2, 2))) == 2
