"""Restitution and friction that fade with the speed of the impact."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import engine
from .coulomb import CoulombImpact
from .impact_law import Array
from .smooth import SmoothImpact


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
        return float(engine.coefficient_at_speed(self.law.chi, speed_m_s, self.speed_scale_m_s, self.exponent))


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
        return float(engine.coefficient_at_speed(mu0, speed_m_s, self.speed_scale_m_s, self.exponent))
