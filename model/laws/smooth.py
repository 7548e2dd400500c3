"""The smooth impact: without friction, so that the impulse is vertical."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import engine
from .impact_law import Array, check_restitution


@dataclass(frozen=True)
class SmoothImpact:
    """The smooth impact of a vertex (Kapitaniak et al., Chaos 22, 047504, 2012, Eqs 6 to 8), for any χ in [0, 1].

    The vertical velocity u of the vertex becomes -χ u, by the vertical impulse

        S = -(1 + χ) u / (1/m + (r_x² + r_y²)/J).

    The horizontal velocity and ω_z never change.
    """

    chi: float
    """Coefficient of restitution: 0 for a vertex that stays down, 1 for an impact that conserves energy."""

    def __post_init__(self) -> None:
        check_restitution(self.chi)

    @property
    def code(self) -> int:
        """SMOOTH."""
        return engine.SMOOTH

    @property
    def parameters(self) -> Array:
        """(1,) χ."""
        return np.array([self.chi], float)
