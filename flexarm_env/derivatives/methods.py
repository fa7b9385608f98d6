"""Choose the method that differentiates the control periods of a batch.

The following table lists transitions of an arm's state and two ways to differentiate them. Implicit differentiation
uses the equation of a transition. Forward differentiation executes the program with dual numbers in SIMD lanes.

| transition | by its equation, forward and backward | as executed, in dual lanes |
|---|---|---|
| jump of accelerations with the torques | `integrator.transitions` | `integrator.start`, `integrator.switching` |
| time step | `integrator.step_derivatives` | `integrator.newton`, with one more solution at the end |
| stick and slip of joints | `joints.friction_derivatives`, for the branch of the values | `joints.friction` |
| change of the payload | – | `integrator.impact`: a fixed number of solutions |
| kinks of prescribed motions | – | `runtime.guided`, as in the environment |

The computations between two transitions (commands, motors, observation, reward) are explicit; dual numbers or
`compiler.vjp_of` differentiate them.
"""

from typing import Any, NamedTuple

from ..physics.model import Elastica, ExactBeam, Floating, FloatingChain
from ..physics.space.chain import SpatialBeam, SpatialElastica

PASSES, MOST_PASSES = 5, 20
"""PASSES is the number of iterations for a step's tangents if the step's matrix differs from the derivative by about a
thousandth (exact beams in the plane, elasticas in space, contact). MOST_PASSES is the largest number for exact beams in
space, whose iteration runs to convergence.
"""


class Method(NamedTuple):
    """Method by which control periods are differentiated.

    by_equations: True if Jacobians are computed from the equations of steps and jumps (`runtime.implicit`), False if
    dual numbers are used (`runtime.derivative`).
    backwards: True if `runtime.adjoint` computes vector-Jacobian products, False if they are computed from Jacobians.
    passes: number of linear systems solved for the derivative of a step; 1 if the Newton matrix is the exact derivative
    of the residual.
    """

    by_equations: bool
    backwards: bool
    passes: int


def method_of(model: Any, program: Any, extras: Any, kept: bool, alone: str) -> Method:
    """Return the `Method` by which the control periods of a model are differentiated.

    program: the batch's program.
    extras: sensors, motors and payload changes of the batch.
    kept: True if motions are prescribed.
    alone: "all" if each arm is computed alone.
    """
    # parts of a period that the equations of its steps and jumps do not contain
    beside = (
        program.models is not None,  # numbers of halvings are found by the run
        model.algebraic is not None,  # multipliers: the step is projected onto the constraints
        model.newton.period_correction is not None,
        any(isinstance(part, Floating) for part in getattr(model, "contributions", ())),  # momentum moves a step's end
        kept,  # motions: kinks within the period
        alone == "all",  # steps that are halved where Newton's iteration fails
    )
    by_equations = not any(beside)
    # memory of sensors and impacts have no cotangents
    forwards_alone = extras.instruments is not None or extras.payload_change is not None
    backwards = by_equations and not forwards_alone and _goes_back(model)
    return Method(by_equations, backwards, _passes(model))


OF_KIND = {SpatialBeam: MOST_PASSES, ExactBeam: PASSES, SpatialElastica: PASSES}
"""Number of iterations for a step's tangents, by the kind of model; 1, and `PASSES` with contacts, for all others."""


def _passes(model: Any) -> int:
    # the matrix leaves out how contacts' normals and velocities change with the coordinates
    touches = model.newton.contact is not None
    return OF_KIND.get(type(getattr(model, "arm", model)), PASSES if touches else 1)


def _goes_back(model: Any) -> bool:
    """Return whether a model has kernels for cotangents.

    Large elasticas and floating frames in the plane have no such kernels: the loops of their kernels are not unrolled,
    and these formulations register no reverse derivatives of their own.
    """
    arm = getattr(model, "arm", model)
    if isinstance(arm, Elastica):
        return isinstance(arm.n, tuple)
    if isinstance(arm, FloatingChain):
        return isinstance(arm.mesh.n, tuple)
    return isinstance(arm, ExactBeam | SpatialBeam)
