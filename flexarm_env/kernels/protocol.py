"""What a formulation provides to the integrator, chosen by the type of its Model when a kernel is compiled.

A formulation's Model is a NamedTuple of arrays and numbers, never written after assembly. Every Model has

    n          int, or a tuple of n zeros where n is to be a compile-time constant: rows of the system
    n_factor   likewise: float64 entries per arm that the iteration matrix and its factors need
    n_inputs   likewise: entries of u (joint torques first, then force x, force y, torque of each point load)
    fixed      int64 (n_fixed,), may be empty: coordinates that never move (a ground pin)
    algebraic  int64 (n_multipliers,) or None: rows of q that hold Lagrange multipliers
    weight     float64 (n,): one over the size that matters of each coordinate (1/L for lengths, 1 for angles)
    predictor  float: 1 starts Newton from the last acceleration, 0 from none; (that, kappa): the first increment is
               trusted to leave an error of kappa times its square; None: from none, then `predict`
    correction float: twice the share kappa of (omega h)^2 by which the integrator makes a period longer, which steps
               are then corrected for (`period`); None: they are not

and registers these functions (kernels; `lane` is a lane tag, arrays hold lanes, `par` the arm's own parameters):

    predict(lane, model, start, q)   only where predictor is None: a better q than the given one to start Newton from;
        its first increment is then trusted to leave an error of 10 times its square
    assemble(lane, model, par, q, v, a, u, cm, cc, ck, r, S)
        r = M(q) a + h(q, v) + Phi_q^T lambda - B u  and  S = cm dr/da + cc dr/dv + ck dr/dq, eqs. [64]-[78];
        rows of multipliers belong to `constrain`, except that columns of multipliers are scaled by cm;
        cm = 0 asks for the residual alone and must leave S as it is
    inertia(lane, model, par, a, r)  only where correction is not None: r = M a, M being constant
    turn(lane, model, start, q, share, x)   likewise: turn each vector in x by a share of what the body there turns by
        from start to q
    constrain(lane, model, psi, q, v, a, level, scale, r)
        the constraint rows of r: scale * Phi (level 0), its velocity (1) or acceleration (2) form, eq. [65]
    pin(lane, model, S, k)           replace row and column k of S by those of the identity
    factor(lane, model, S)           factor S in place
    solve(lane, model, S, x)         x <- S^-1 x in place
    ports(lane, model, par, q, y)    y[i]: the displacement that input i works on (angle or position)
    dissipation(lane, model, par, q, v)  power lost in material damping, W
    energy(lane, model, par, q, v)   (kinetic, strain, gravity), J
    link_poses(lane, model, par, q, v, out)   12 numbers a link: root x, y, angle and rates, tip x, y, angle and rates
    out_of_range(lane, model, par, q)  0 where the model holds, otherwise the status code (as float64 lanes)
    shape(model, q, points)          SINGLE only: node positions along the chain, (n_points, 2)
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import types
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import lower_builtin, overload

from .jit import kernel

REGISTRY: dict[type, dict[str, Callable[..., Any]]] = {}


@kernel
def _no_guess(lane, model, start, q):  # type: ignore[no-untyped-def]
    """`predict` of a formulation that has none."""


def register(model_class: type, **functions: Callable[..., Any]) -> None:
    """Bind a formulation's functions to its Model class."""
    REGISTRY[model_class] = {"predict": _no_guess, **functions}


def _dispatched(name: str, arguments: str) -> Callable[..., Any]:
    """A function that calls the one registered under `name` for the class of its argument `model`.

    Typed and lowered directly as a call of that kernel: an overload would be one more library to compile.
    """
    place = [word.strip() for word in arguments.split(",")].index("model")

    def function(*args: Any) -> Any:
        return REGISTRY[type(args[place])][name](*args)

    function.__name__ = function.__qualname__ = name
    globals()[name] = function  # Numba wants to find it in its module

    def kernel_of(kinds: Any) -> Any:
        return types.Dispatcher(REGISTRY[kinds[place].instance_class][name])

    @infer_global(function)
    class _Template(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            return kernel_of(args).get_call_type(self.context, args, kws)

    @lower_builtin(function, types.VarArg(types.Any))  # type: ignore[untyped-decorator]
    def _lower(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        call = context.get_function(kernel_of(signature.args), signature)
        context.add_linking_libs(getattr(call, "libs", ()))
        return call(builder, args)

    return function


assemble = _dispatched("assemble", "lane, model, par, q, v, a, u, cm, cc, ck, r, S")
inertia = _dispatched("inertia", "lane, model, par, a, r")
turn = _dispatched("turn", "lane, model, start, q, share, x")
predict = _dispatched("predict", "lane, model, start, q")
constrain = _dispatched("constrain", "lane, model, psi, q, v, a, level, scale, r")
pin = _dispatched("pin", "lane, model, S, k")
factor = _dispatched("factor", "lane, model, S")
solve = _dispatched("solve", "lane, model, S, x")
ports = _dispatched("ports", "lane, model, par, q, y")
dissipation = _dispatched("dissipation", "lane, model, par, q, v")
energy = _dispatched("energy", "lane, model, par, q, v")
link_poses = _dispatched("link_poses", "lane, model, par, q, v, out")
out_of_range = _dispatched("out_of_range", "lane, model, par, q")
shape = _dispatched("shape", "model, q, points")


def size(n: int | tuple[int, ...]) -> int:
    """The number that a Model's size field stands for: itself, or the length of a tuple tag."""
    return n if isinstance(n, int) else len(n)


@overload(size)  # type: ignore[untyped-decorator]
def _size(n):  # type: ignore[no-untyped-def]
    if isinstance(n, types.BaseTuple):
        count = len(n)
        return lambda n: count
    return lambda n: n
