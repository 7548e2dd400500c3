"""Impact laws: what the table does to the die when a vertex strikes it.

An impact is instantaneous: the die keeps its place and an impulse S acts at the vertex, at r from the centre. So
Δv = S/m and Δω = r × S/J, and a law has only S to say. A new law is a class here, a branch in `kernels.impulse`,
and a line in the list that the law tests run on.

Which of them: `SmoothImpact` is the paper's, and the fastest. `CoulombImpact` rubs, at two to four microseconds an
impact. `RestitutionBySpeed` lets the restitution of either fade as impacts get harder, `FrictionBySpeed` the friction.

**Impact** (Routh 1905; Darboux 1880; Keller, J. Appl. Mech. 53, 1, 1986). The impact takes no time, and the normal
impulse p is its clock. The contact velocity c = (s ŝ, w), slip s along the unit vector ŝ and normal velocity w, obeys

    dc/dp = M (ẑ - μ ŝ),    M = [[T, b], [bᵀ, a]]    (contact matrix: c changes by M S when the impulse S acts)

    dw/dp = a - μ b·ŝ = h,    ds/dp = ŝ·b - μ ŝᵀT ŝ = f,    s dφ/dp = t̂·b - μ t̂ᵀT ŝ = g    (φ the angle of ŝ, t̂ ⊥ ŝ).

The last is singular at s = 0. With dp = s dτ the slip vector v = s ŝ obeys v' = |v| b - μ T v, which is analytic as
long as v ≠ 0 and nearly linear. It is solved by Taylor series in τ (order `_ORDER`), whose steps are set by rounding:
they cover a fixed part of the distance to the nearest singularity, and the same polynomials locate every event.
Steps in φ would be fewer, but they divide by g, which is zero for every planar impact.

- Slip neglects to turn once s |g| is lost in rounding: displaced across its course by v⊥, an invariant direction
  (g = 0) answers with v⊥' = -μ (t̂ᵀT t̂) v⊥, stable or not, so v⊥ never comes to exceed s g/(μ t̂ᵀT t̂). From there on,
  and from the beginning in planar impacts, the course is straight and everything has a closed form. Straight on where
  the slip grows (f > 0) means along the one direction below: along ŝ itself an error would grow with it.
- Towards a stop τ goes to infinity while p does not. Within a dozen degrees of the direction in which it will stop the
  rest of the way is one power series in the angle (`_way_to_stop`), taken whole if no event lies on it; by steps in τ
  alone an impact that sticks takes twice the time.
- Slip that has stopped sticks if the impulse that holds it, -T⁻¹b per unit p, lies within the cone, |T⁻¹b| ≤ μ. Else
  it goes on along the ŝ with (μT + f) ŝ = b and f > 0. |(μT + f)⁻¹ b| falls with f from |T⁻¹b|/μ > 1 to 0: there is
  exactly one.
- h < 0 (a jam: the contact is driven into the table) does not last: T a ≥ b bᵀ makes f < 0 wherever h < 0, so the slip
  stops, and then h is positive, stuck (a - bᵀT⁻¹b) or sliding (f > 0).

The end: Newton, w = -χ w(0). Poisson, the impulse of restitution is χ times that of compression. Stronge (Proc. R.
Soc. A 431, 169, 1990), the work of the normal force in restitution is -χ² times that in compression: since friction
only takes, energy is never created, whatever the slip does. `benchmarks/impact_energy.py` counts how often Newton's
does. Where w passes zero more than once, every stretch with w < 0 counts as compression and every other as
restitution.

**Held contact**: `friction_step`, a time step of the scheme of Moreau (1988), Jean (1999) and Stewart & Trinkle
(Int. J. Numer. Meth. Eng. 39, 2673, 1996) with no restitution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from .. import engine

Array = NDArray[np.float64]


class ImpactLaw(Protocol):
    """What the event loop asks of a law."""

    @property
    def code(self) -> int:
        """The branch of the kernel that computes it.

        SMOOTH 0, COULOMB 1, SMOOTH_BY_SPEED 2, COULOMB_BY_SPEED 3, COULOMB_FADING 4.
        """
        ...

    @property
    def parameters(self) -> Array:
        """(k,) numbers of the law, the coefficient of restitution (of the slowest impacts) first.

        SMOOTH (χ), COULOMB (χ, μ, ending), SMOOTH_BY_SPEED (χ₀, scale, exponent), COULOMB_BY_SPEED (χ₀, μ, ending,
        scale, exponent), COULOMB_FADING (the same with μ₀, then scale and exponent of μ); the ending is 0 for Newton's,
        1 for Poisson's, 2 for Stronge's restitution, the scales in m/s.
        """
        ...


@dataclass(frozen=True)
class SmoothImpact:
    """The smooth impact of a vertex (Kapitaniak et al., Chaos 22, 047504, 2012, Eqs 6 to 8), for any χ in [0, 1].

    Nothing rubs, so the impulse is vertical, and the vertical velocity u of the vertex goes to -χ u:
    S = -(1 + χ) u / (1/m + (r_x² + r_y²)/J). The horizontal velocity and ω_z never change.
    """

    chi: float
    """Coefficient of restitution: 0 for a vertex that stays down, 1 for an impact that keeps the energy."""

    def __post_init__(self) -> None:
        _check_chi(self.chi)

    @property
    def code(self) -> int:
        """SMOOTH."""
        return engine.SMOOTH

    @property
    def parameters(self) -> Array:
        """(1,) χ."""
        return np.array([self.chi], float)


Restitution = Literal["newton", "poisson", "stronge"]
_ENDINGS: dict[str, int] = {"newton": engine.NEWTON, "poisson": engine.POISSON, "stronge": engine.STRONGE}


@dataclass(frozen=True)
class CoulombImpact:
    """Coulomb friction integrated along the normal impulse (Routh, Dynamics of a System of Rigid Bodies I, 1905,
    ch. 5; Keller, J. Appl. Mech. 53, 1, 1986): the slip turns, may stop, stick, or set out again another way, while
    the normal impulse grows. The equations stand above.

    Holds for hard bodies that touch in a point: the impact is over before the die has moved, the tangential compliance
    of the contact is small (a superball's is not), and μ is one number for sticking and sliding. Restitution ends it:

    - "stronge", energetic (Stronge, Proc. R. Soc. A 431, 169, 1990; Impact Mechanics, 2000): the work of the normal
      force in restitution is χ² of what it took in compression. Never creates energy.
    - "poisson", kinetic: the impulse in restitution is χ times that in compression.
    - "newton", kinematic: the normal velocity u goes to -χ u.

    The three agree where the slip keeps its direction (Batlle, J. Appl. Mech. 63, 168, 1996), and at μ = 0, where all are
    `SmoothImpact`. Where it stops or turns on the way, Newton's can create energy (Kane & Levinson, Dynamics, 1985):
    in 2 % of random impacts, up to more than there was. Poisson's did in none of 10⁶.
    """

    chi: float
    """Coefficient of restitution, 0 to 1, in the sense of `restitution`."""
    mu: float
    """Coefficient of friction, 0 or more."""
    restitution: Restitution = "stronge"

    def __post_init__(self) -> None:
        _check_chi(self.chi)
        if not (np.isfinite(self.mu) and self.mu >= 0.0):
            raise ValueError(f"mu = {self.mu}: wanted a coefficient of friction, 0 or more and finite")
        if self.restitution not in _ENDINGS:
            raise ValueError(f"restitution = {self.restitution!r}: wanted one of {', '.join(map(repr, _ENDINGS))}")

    @property
    def code(self) -> int:
        """COULOMB."""
        return engine.COULOMB

    @property
    def parameters(self) -> Array:
        """(3,) χ, μ, ending."""
        return np.array([self.chi, self.mu, _ENDINGS[self.restitution]], float)


@dataclass(frozen=True)
class RestitutionBySpeed:
    """A law whose restitution fades with the speed u of the impact: χ(u) = χ₀ (1 + |u|/u_s)^-exponent.

    Where the contact yields plastically, χ falls as u^-1/4 (Johnson, Contact Mechanics, 1985, section 11.5): for metal
    and hard plastics from the speed u_s on at which yielding begins, well below that of sound. The form here goes over
    into the constant χ₀ of slow, elastic impacts. Other exponents describe, they do not explain.
    """

    law: SmoothImpact | CoulombImpact
    """Its chi is χ₀, that of the slowest impacts."""
    speed_scale_m_s: float
    """u_s, above 0: where the restitution begins to fade."""
    exponent: float = 0.25
    """0 or more; 1/4 for full plasticity."""

    def __post_init__(self) -> None:
        if not isinstance(self.law, SmoothImpact | CoulombImpact):
            raise ValueError(f"law = {self.law}: wanted a SmoothImpact or a CoulombImpact")
        if not (np.isfinite(self.speed_scale_m_s) and self.speed_scale_m_s > 0.0):
            raise ValueError(f"speed_scale_m_s = {self.speed_scale_m_s}: wanted a finite speed above 0")
        if not (np.isfinite(self.exponent) and self.exponent >= 0.0):
            raise ValueError(f"exponent = {self.exponent}: wanted 0 or more; Johnson's is 0.25")

    @property
    def code(self) -> int:
        """SMOOTH_BY_SPEED or COULOMB_BY_SPEED."""
        return engine.SMOOTH_BY_SPEED if isinstance(self.law, SmoothImpact) else engine.COULOMB_BY_SPEED

    @property
    def parameters(self) -> Array:
        """Those of the law (k,), then the speed scale [m/s] and the exponent."""
        return np.array([*self.law.parameters, self.speed_scale_m_s, self.exponent])

    def chi_at(self, speed_m_s: float) -> float:
        """χ of an impact at that speed [m/s]."""
        return float(engine.faded_at_speed(self.law.chi, speed_m_s, self.speed_scale_m_s, self.exponent))


@dataclass(frozen=True)
class FrictionBySpeed:
    """A law whose friction fades with the normal speed u of the impact: μ(u) = μ₀ (1 + |u|/u_s)^-exponent.

    Where soft bodies touch elastically the friction goes with the area, which grows as the load to the power 2/3, so
    that μ falls as its power -1/3 (Bowden & Tabor, The Friction and Lubrication of Solids, 1950, ch. 5 for plastics); and
    the peak load of a Hertzian impact grows as u^6/5 (Johnson, Contact Mechanics, 1985, section 11.4): μ ~ u^-2/5. In
    held contact, where nothing strikes, it is μ₀. Other exponents describe, they do not explain.
    """

    law: CoulombImpact | RestitutionBySpeed
    """Its mu is μ₀, that of the slowest impacts."""
    speed_scale_m_s: float
    """u_s, above 0: where friction begins to fade."""
    exponent: float = 0.4
    """0 or more."""

    def __post_init__(self) -> None:
        if not isinstance(self.rough, CoulombImpact):
            raise ValueError(f"law = {self.law}: wanted a law with a CoulombImpact in it")
        if not (np.isfinite(self.speed_scale_m_s) and self.speed_scale_m_s > 0.0):
            raise ValueError(f"speed_scale_m_s = {self.speed_scale_m_s}: wanted a finite speed above 0")
        if not (np.isfinite(self.exponent) and self.exponent >= 0.0):
            raise ValueError(f"exponent = {self.exponent}: wanted 0 or more; 0.4 is that of soft plastics")

    @property
    def rough(self) -> CoulombImpact | SmoothImpact:
        """The law of the slowest impacts."""
        return self.law.law if isinstance(self.law, RestitutionBySpeed) else self.law

    @property
    def code(self) -> int:
        """COULOMB_FADING."""
        return engine.COULOMB_FADING

    @property
    def parameters(self) -> Array:
        """(7,) χ₀, μ₀, ending, scale [m/s] and exponent of χ, scale and exponent of μ."""
        faded = [] if isinstance(self.law, RestitutionBySpeed) else [1.0, 0.0]
        return np.array([*self.law.parameters, *faded, self.speed_scale_m_s, self.exponent])

    def mu_at(self, speed_m_s: float) -> float:
        """μ of an impact at that speed [m/s]."""
        mu0 = float(self.parameters[1])
        return float(engine.faded_at_speed(mu0, speed_m_s, self.speed_scale_m_s, self.exponent))


def _check_chi(chi: float) -> None:
    if not 0.0 <= chi <= 1.0:
        raise ValueError(f"chi = {chi}: wanted a coefficient of restitution from 0 to 1")
