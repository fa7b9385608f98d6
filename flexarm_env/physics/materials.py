"""Material laws, in one place: what a cross-section answers its strains with, its energy, and what is damped of it.

Each stress resultant is a stiffness (EA, C, EI) times a function of its strain (Gamma_1, Gamma_2, kappa), of slope 1
without strain; Kelvin-Voigt damping adds that stiffness times tau_d times the strain's rate. The exact beam reads
all three laws, the elastica that of M; floating frames take stiffnesses alone. Here all are linear:

    N = EA Gamma_1,   Q = C Gamma_2,   M = EI kappa.

A law is given its strain times a length l, then l, then what its section has beyond stiffnesses (`NORMAL_AND_SHEAR`,
`BENDING`), and returns an `Answer`. docs/architecture.md shows two others.
"""

from typing import Any, NamedTuple

from ..compiler import kernel

NORMAL_AND_SHEAR: tuple[str, ...] = ()
BENDING: tuple[str, ...] = ()
"""Fields of a `Section`, beyond its stiffnesses, that the laws of N and Q read, and that of M: in this order they are
what a law is given as `own`. A formulation without the law refuses a section where they are not at their defaults."""


class Answer(NamedTuple):
    """A stress resultant by its strain e, over its stiffness without strain."""

    force: Any  # f(e)
    slope: Any  # f'(e); None: 1
    energy: Any  # 2 int f de, from no strain on


@kernel
def normal(e, length, own):
    """N: l N / EA by e = l Gamma_1."""
    return Answer(e, None, e * e)


@kernel
def shear(e, length, own):
    """Q: l Q / C by e = l Gamma_2."""
    return Answer(e, None, e * e)


bending: Any = None
"""M: a law like these, l M / EI by e = l kappa; None: M = EI kappa, which is integrated beforehand."""


@kernel
def viscoelastic(force, rate, tau):
    """An `Answer.force` with what the strain's rate adds; tau: tau_d, None without damping."""
    if tau is None:
        return force
    return force + tau * rate


@kernel
def viscoelastic_slope(slope, tau, damping, stiffness):
    """Slope of `viscoelastic` by the strain times the weight `stiffness`, and by its rate times `damping`."""
    own = stiffness
    if slope is not None:
        own = slope * stiffness
    if tau is None:
        return own
    return tau * damping + own
