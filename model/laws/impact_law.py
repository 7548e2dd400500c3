"""The interface of an impact law: one impulse for each vertex that strikes the table.

An impact is instantaneous. The die keeps its place, and an impulse S acts at the vertex, at r from the centre:

    Δv = S/m,    Δω = r × S/J,

with m the mass and J the moment of inertia. The law only gives S.

A new law is a file in this folder with a frozen dataclass that satisfies `ImpactLaw`, a code in `engine/types.py`, a
branch in `engine.impulse`, one in `engine.derivatives.impulse_gradient`, and a line in the list of laws that the tests run on.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError

Array = NDArray[np.float64]


class ImpactLaw(Protocol):
    """A law as the compiled kernels see it: a code and an array of numbers."""

    @property
    def code(self) -> int:
        """The branch of the kernel that computes the impulse.

        SMOOTH 0, COULOMB 1, SMOOTH_BY_SPEED 2, COULOMB_BY_SPEED 3, COULOMB_FADING 4.
        """
        ...

    @property
    def parameters(self) -> Array:
        """(k,) numbers of the law, beginning with the coefficient of restitution (of the slowest impacts).

        SMOOTH: χ. COULOMB: χ, μ, kind. SMOOTH_BY_SPEED: χ₀, scale, exponent. COULOMB_BY_SPEED: χ₀, μ, kind, scale,
        exponent. COULOMB_FADING: χ₀, μ₀, kind, scale and exponent of χ, scale and exponent of μ. The kind of restitution is
        0 for Newton's, 1 for Poisson's, 2 for Stronge's, 3 for the algebraic one; scales are in m/s.
        """
        ...


def check_restitution(chi: float) -> None:
    """Raise ValueError unless `chi` is a coefficient of restitution, from 0 to 1."""
    if not 0.0 <= chi <= 1.0:
        raise InputError(f"chi = {chi}: wanted a coefficient of restitution from 0 to 1")
