"""Impact laws: what the table does to the die when a vertex strikes it.

An impact is instantaneous: the die keeps its place and an impulse S acts at the vertex, at r from the centre. So
Δv = S/m and Δω = r × S/J, and a law has only S to say. A new law is a class here, a branch in `kernels.impulse`, and a
line in the list that the law tests run on.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from . import kernels
from .solids import Die
from .touch import Touch

Array = NDArray[np.float64]


class ImpactLaw(Protocol):
    """What the event loop asks of a law."""

    @property
    def code(self) -> int:
        """The branch of `kernels.impulse` that computes it."""
        ...

    @property
    def parameters(self) -> Array:
        """(k,) numbers of the law, the coefficient of restitution first."""
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
        if not 0.0 <= self.chi <= 1.0:
            raise ValueError(f"chi = {self.chi}: wanted a coefficient of restitution from 0 to 1")

    @property
    def code(self) -> int:
        """The branch of `kernels.impulse`."""
        return kernels.SMOOTH

    @property
    def parameters(self) -> Array:
        """(1,) χ."""
        return np.array([self.chi], float)


def impulse_N_s(die: Die, touch: Touch, law: ImpactLaw) -> Array:
    """Impulse (3,) [N s] of the table on the die, world axes."""
    state = touch.state
    packed = np.concatenate([state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])
    arm = (float(touch.arm_m[0]), float(touch.arm_m[1]), float(touch.arm_m[2]))
    return np.array(kernels.impulse(law.code, law.parameters, die.mass_kg, die.inertia_kg_m2, arm, packed))
