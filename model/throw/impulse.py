"""model.throw.impulse."""

from __future__ import annotations

import numpy as np

from .. import engine
from ..die import Die
from ..laws import Array, ImpactLaw
from .touch import Touch


def impulse_N_s(die: Die, touch: Touch, law: ImpactLaw) -> Array:
    """Impulse (3,) [N s] of the table on the die, world axes."""
    state = touch.state
    packed = np.concatenate([state.position_m, state.quaternion, state.velocity_m_s, state.omega_rad_s])
    arm = (float(touch.arm_m[0]), float(touch.arm_m[1]), float(touch.arm_m[2]))
    return np.array(
        engine.impulse(engine.law_of(law.code, law.parameters), die.mass_kg, die.inertia_kg_m2, arm, 0.0, packed)
    )
