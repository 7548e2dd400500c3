"""Impacts with Coulomb friction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import engine
from .impact_law import Array, check_restitution

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
        check_restitution(self.chi)
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
