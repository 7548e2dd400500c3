"""The impact with Coulomb friction, and the kinds of restitution that end it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .. import engine
from ..errors import InputError
from .impact_law import Array, check_restitution

Restitution = Literal["newton", "poisson", "stronge", "algebraic"]

_RESTITUTION_CODES: dict[str, int] = {
    "newton": engine.NEWTON,
    "poisson": engine.POISSON,
    "stronge": engine.STRONGE,
    "algebraic": engine.ALGEBRAIC,
}


@dataclass(frozen=True)
class CoulombImpact:
    """Coulomb friction integrated along the normal impulse (Routh, Dynamics of a System of Rigid Bodies I, 1905, ch. 5;
    Keller, J. Appl. Mech. 53, 1, 1986).

    While the normal impulse grows, the slip turns, may stop, may stick, and may start again in another direction. The
    equations and their solution are those of `engine/friction_impulse.py`.

    The law holds for hard bodies that touch in a point. The impact is over before the die has moved, the tangential
    compliance of the contact is small (a superball's is not), and one μ serves for sticking and sliding. The impact ends by
    one of three kinds of restitution:

    - "stronge", energetic (Stronge, Proc. R. Soc. A 431, 169, 1990; Impact Mechanics, 2000): the work of the normal
      force in restitution is χ² times its work in compression. It never creates energy.
    - "poisson", kinetic: the impulse in restitution is χ times that in compression.
    - "newton", kinematic: the normal velocity u becomes -χ u.

    The fourth, "algebraic" (Chatterjee & Ruina, J. Appl. Mech. 65, 939, 1998), follows no course of the slip. u becomes -χ u,
    and the impulse stops the slip as far as the friction cone allows, with a tangential restitution of 0. It never creates
    energy. The body need not be rigid while the impact lasts; it must only hardly move.

    The first three agree if the slip keeps its direction (Batlle, J. Appl. Mech. 63, 168, 1996). At μ = 0 all four are
    `SmoothImpact`. If the slip stops or turns, Newton's can create energy (Kane & Levinson, Dynamics, 1985): in 2 % of
    random impacts, up to more than there was. Poisson's did so in none of 10⁶.
    """

    chi: float
    """Coefficient of restitution, 0 to 1, in the sense of `restitution`."""
    mu: float
    """Coefficient of friction, 0 or more."""
    restitution: Restitution = "stronge"

    def __post_init__(self) -> None:
        check_restitution(self.chi)
        if not (np.isfinite(self.mu) and self.mu >= 0.0):
            raise InputError(f"mu = {self.mu}: wanted a coefficient of friction, 0 or more and finite")
        if self.restitution not in _RESTITUTION_CODES:
            known = ", ".join(map(repr, _RESTITUTION_CODES))
            raise InputError(f"restitution = {self.restitution!r}: wanted one of {known}")

    @property
    def code(self) -> int:
        """COULOMB."""
        return engine.COULOMB

    @property
    def parameters(self) -> Array:
        """(3,) χ, μ, kind of restitution."""
        return np.array([self.chi, self.mu, _RESTITUTION_CODES[self.restitution]], float)
