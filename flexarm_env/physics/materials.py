"""Material laws: stress resultants of a cross-section as functions of its strains, their energy and damping.

Each stress resultant is a stiffness (EA, C, EI) times a function of a strain (Gamma_1, Gamma_2, kappa). The function
has slope 1 at zero strain. Kelvin-Voigt damping adds stiffness times tau_d times the strain rate (theory, 5.1). The
exact beam uses all three laws, the elastica only the law of M. Floating frames use only the stiffnesses. The laws of
this module are linear:

    N = EA Gamma_1,   Q = C Gamma_2,   M = EI kappa.

Arguments of a law are the strain times a length l (argument e), the length l in m (length), and further fields of the
section besides its stiffnesses (own; see `NORMAL_AND_SHEAR`, `BENDING`). A law returns an `Answer`.
docs/architecture.md shows two other laws.
"""

from typing import Any, NamedTuple

from ..compiler import kernel

NORMAL_AND_SHEAR: tuple[str, ...] = ()
BENDING: tuple[str, ...] = ()
"""Names of `Section` fields, besides stiffnesses, that the laws of N and Q (first tuple) and the law of M read, in the
order of `own`. A formulation without the law rejects a section in which such a field differs from its default."""


class Answer(NamedTuple):
    """Stress resultant, its derivative and its energy at the strain e, divided by the stiffness at zero strain."""

    force: Any  # stress resultant f(e), in the unit of e
    slope: Any  # derivative f'(e); None stands for 1
    energy: Any  # energy 2 int_0^e f de


@kernel
def normal(e, length, own):
    """Return the law of the normal force N (N) as an `Answer`: f(e) = l N / EA with e = l Gamma_1 (m); here f = e.

    length: l (m); own: further constants of the section. The linear law reads neither `length` nor `own`.
    """
    return Answer(e, None, e * e)


@kernel
def shear(e, length, own):
    """Return the law of the shear force Q (N) as an `Answer`: f(e) = l Q / C with e = l Gamma_2 (m); here f = e.

    length: l (m); own: further constants of the section. The linear law reads neither `length` nor `own`.
    """
    return Answer(e, None, e * e)


bending: Any = None
"""Law of the bending moment M (N m): l M / EI as a function of e = l kappa. None stands for the law M = EI kappa."""


@kernel
def viscoelastic(force, rate, tau):
    """Return force + tau * rate: a stress resultant with Kelvin-Voigt damping, divided by its stiffness.

    force: `Answer.force`, in the unit of the strain e.
    rate: rate of e, per s.
    tau: tau_d (s), or None without damping.
    """
    if tau is None:
        return force
    return force + tau * rate


@kernel
def viscoelastic_slope(slope, tau, damping, stiffness):
    """Return stiffness df/de + damping df/d(rate) for f + tau_d d(e)/dt: the weighted derivative of a law in a matrix.

    slope: df/de, the field `slope` of an `Answer`; None stands for 1.
    tau: tau_d (s), or None without damping.
    damping, stiffness: weights of the derivatives by rates and by coordinates (`protocol.Weights`).
    """
    own = stiffness
    if slope is not None:
        own = slope * stiffness
    if tau is None:
        return own
    return tau * damping + own
