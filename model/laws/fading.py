"""Restitution and friction that fall with the speed of the impact.

Both coefficients have the form c(u) = c₀ (1 + |u|/u_s)^-exponent, with u the normal speed of the impact. It is the
constant c₀ for impacts much slower than u_s, and a power law for faster ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import engine
from ..errors import InputError
from .coulomb import CoulombImpact
from .impact_law import Array
from .smooth import SmoothImpact

FULL_PLASTICITY_EXPONENT = 0.25
"""Of χ, for a contact that yields plastically (Johnson, Contact Mechanics, 1985, section 11.5)."""

SOFT_PLASTIC_EXPONENT = 0.4
"""Of μ, for soft bodies in elastic contact; derived in `FrictionBySpeed`."""


@dataclass(frozen=True)
class RestitutionBySpeed:
    """A law whose restitution falls with the speed u of the impact: χ(u) = χ₀ (1 + |u|/u_s)^-exponent.

    If the contact yields plastically, χ falls as u^-1/4 (Johnson, Contact Mechanics, 1985, section 11.5). For metal and
    hard plastics that begins at the speed u_s at which yielding begins, well below the speed of sound. Other exponents
    are descriptive and have no such derivation.
    """

    law: SmoothImpact | CoulombImpact
    """Its chi is χ₀, that of the slowest impacts."""
    speed_scale_m_s: float
    """u_s, above 0: the speed at which the restitution begins to fall."""
    exponent: float = FULL_PLASTICITY_EXPONENT
    """0 or more; 1/4 for full plasticity."""

    def __post_init__(self) -> None:
        if not isinstance(self.law, SmoothImpact | CoulombImpact):
            raise InputError(f"law = {self.law}: wanted a SmoothImpact or a CoulombImpact")
        _check_speed_dependence(self.speed_scale_m_s, self.exponent, FULL_PLASTICITY_EXPONENT)

    @property
    def code(self) -> int:
        """SMOOTH_BY_SPEED or COULOMB_BY_SPEED."""
        return engine.SMOOTH_BY_SPEED if isinstance(self.law, SmoothImpact) else engine.COULOMB_BY_SPEED

    @property
    def parameters(self) -> Array:
        """Those of the law (k,), then the speed scale [m/s] and the exponent."""
        return np.array([*self.law.parameters, self.speed_scale_m_s, self.exponent])

    def chi_at(self, speed_m_s: float) -> float:
        """χ of an impact at a normal speed [m/s]."""
        return float(engine.coefficient_at_speed(self.law.chi, speed_m_s, self.speed_scale_m_s, self.exponent))


@dataclass(frozen=True)
class FrictionBySpeed:
    """A law whose friction falls with the normal speed u of the impact: μ(u) = μ₀ (1 + |u|/u_s)^-exponent.

    In elastic contact of soft bodies, friction is proportional to the area of contact, which grows as the load to the power
    2/3, so that μ falls as its power -1/3 (Bowden & Tabor, The Friction and Lubrication of Solids, 1950, ch. 5 for
    plastics). The peak load of a Hertzian impact grows as u^6/5 (Johnson, Contact Mechanics, 1985, section 11.4), which
    gives μ ~ u^-2/5. Held contact has no impact speed and the coefficient μ₀. Other exponents are descriptive and have
    no such derivation.
    """

    law: CoulombImpact | RestitutionBySpeed
    """Its mu is μ₀, that of the slowest impacts."""
    speed_scale_m_s: float
    """u_s, above 0: the speed at which friction begins to fall."""
    exponent: float = SOFT_PLASTIC_EXPONENT
    """0 or more."""

    def __post_init__(self) -> None:
        slowest = self.law.law if isinstance(self.law, RestitutionBySpeed) else self.law
        if not isinstance(slowest, CoulombImpact):
            raise InputError(f"law = {self.law}: wanted a CoulombImpact, or a RestitutionBySpeed of one")
        _check_speed_dependence(self.speed_scale_m_s, self.exponent, SOFT_PLASTIC_EXPONENT)

    @property
    def code(self) -> int:
        """COULOMB_FADING."""
        return engine.COULOMB_FADING

    @property
    def parameters(self) -> Array:
        """(7,) χ₀, μ₀, kind of restitution, scale [m/s] and exponent of χ, scale [m/s] and exponent of μ."""
        constant_chi = [] if isinstance(self.law, RestitutionBySpeed) else [1.0, 0.0]
        return np.array([*self.law.parameters, *constant_chi, self.speed_scale_m_s, self.exponent])

    def mu_at(self, speed_m_s: float) -> float:
        """μ of an impact at a normal speed [m/s]."""
        mu0 = float(self.parameters[1])
        return float(engine.coefficient_at_speed(mu0, speed_m_s, self.speed_scale_m_s, self.exponent))


def _check_speed_dependence(speed_scale_m_s: float, exponent: float, usual_exponent: float) -> None:
    """Raise ValueError for a speed scale that is not above 0 and finite, or an exponent below 0."""
    if not (np.isfinite(speed_scale_m_s) and speed_scale_m_s > 0.0):
        raise InputError(f"speed_scale_m_s = {speed_scale_m_s}: wanted a finite speed above 0")
    if not (np.isfinite(exponent) and exponent >= 0.0):
        raise InputError(f"exponent = {exponent}: wanted 0 or more; the usual value is {usual_exponent:g}")
