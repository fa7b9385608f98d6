"""Material laws: stress resultants of a cross-section as functions of its strains, their energy and damping.

Each stress resultant is a stiffness (EA, C, EI) times a function of its strain (Gamma_1, Gamma_2, kappa) with slope 1
at zero strain; Kelvin-Voigt damping adds stiffness times tau_d times the strain rate (theory, 5.1). The exact beam
reads all three laws, the elastica that of M; floating frames use only the stiffnesses. The laws of this module are
linear:

    N = EA Gamma_1,   Q = C Gamma_2,   M = EI kappa.

Arguments of a law: e, its strain times a length l; length, l (m); own, the section's fields beyond stiffnesses
(`NORMAL_AND_SHEAR`, `BENDING`). A law returns an `Answer`. docs/architecture.md shows two other laws.
"""

from typing import Any, NamedTuple

from ..compiler import kernel

NORMAL_AND_SHEAR: tuple[str, ...] = ()
BENDING: tuple[str, ...] = ()
"""Fields of a `Section`, beyond its stiffnesses, that the laws of N and Q, and the law of M, read as `own`, in this
order. A formulation without the law rejects a section where they are not at their defaults."""


class Answer(NamedTuple):
    """Stress resultant, its slope and its energy for the strain e, divided by the stiffness at zero strain."""

    force: Any  # f(e), in the unit of e
    slope: Any  # f'(e); None: 1
    energy: Any  # 2 int_0^e f de


@kernel
def normal(e, length, own):
    """Return the law of the normal force N (N), f(e) = l N / EA with e = l Gamma_1 (m), as an `Answer`: linear, f = e.

    length: l (m); own: further constants of the section. The linear law reads neither `length` nor `own`.
    """
    return Answer(e, None, e * e)


@kernel
def shear(e, length, own):
    """Return the law of the shear force Q (N), f(e) = l Q / C with e = l Gamma_2 (m), as an `Answer`: linear, f = e.

    length: l (m); own: further constants of the section. The linear law reads neither `length` nor `own`.
    """
    return Answer(e, None, e * e)


bending: Any = None
"""Law of the bending moment M (N m): l M / EI as a function of e = l kappa. None stands for M = EI kappa."""


@kernel
def viscoelastic(force, rate, tau):
    """Return force + tau * rate: a stress resultant with Kelvin-Voigt damping, divided by its stiffness.

    force: `Answer.force`, in the unit of the strain e; rate: of e, per s; tau: tau_d (s), or None without damping.
    """
    if tau is None:
        return force
    return force + tau * rate


@kernel
def viscoelastic_slope(slope, tau, damping, stiffness):
    """Return stiffness df/de + damping df/d(rate) of the law f + tau_d d(e)/dt: its slope in a matrix with two weights.

    slope: df/de, `Answer.slope` (None: 1); tau: tau_d (s), or None without damping; damping, stiffness: weights of the
    derivatives by rates and by coordinates (`protocol.Weights`).
    """
    own = stiffness
    if slope is not None:
        own = slope * stiffness
    if tau is None:
        return own
    return tau * damping + own
