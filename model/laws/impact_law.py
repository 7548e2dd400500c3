"""What the event loop asks of an impact law: one impulse for each vertex that strikes the table.

An impact is instantaneous. The die keeps its place, and an impulse S acts at the vertex, at r from the centre:

    Δv = S/m,    Δω = r × S/J,

with m the mass and J the moment of inertia. A law only says S.

A new law is a file in this folder, a code in `engine/types.py`, a branch in `engine.impulse`, and a line in the list of
laws that the tests run on. A law is a frozen dataclass that satisfies `ImpactLaw`.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

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


def check_restitution(chi: float) -> None:
    if not 0.0 <= chi <= 1.0:
        raise ValueError(f"chi = {chi}: wanted a coefficient of restitution from 0 to 1")
