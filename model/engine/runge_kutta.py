"""The integrator of the engine: the explicit Runge-Kutta method of order 8 of Dormand and Prince, in steps of given length.

With the stages kᵣ = f(t + cᵣ Δt, y + Δt Σₙ aᵣₙ kₙ), n < r < 12, a step is y + Δt Σ bᵣ kᵣ (Hairer, Nørsett, Wanner, Solving
Ordinary Differential Equations I, 1993, II.5). The coefficients are those of `scipy.integrate.DOP853`. The steps have no
error control: the motions here have no rates but those of the spin and of √(g/R), and each caller limits the turn in a step.

A caller evaluates its own right side:

    for stage in range(STAGES):
        stage_values(start, rates, stage, dt, values)
        ...                                     # fill rates[stage] from values, at the time t + NODES[stage] dt
    stage_values(start, rates, STAGES, dt, values)
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

from ..compiled import inner, int64
from .types import Array

STAGES = int64(12)
NODES = DOP853.C[:STAGES].copy()
"""cᵣ (12,)."""
_WEIGHTS = np.vstack([DOP853.A[:STAGES, :STAGES], DOP853.B])
"""aᵣₙ (12, 12), and bₙ as the last row."""


@inner
def stage_values(start: Array, rates: Array, stage: int, dt: float, values: Array) -> None:
    """Fill `values` (n,) with the argument of a stage of the step from `start` (n,), or for STAGES with the end of the step.

    `rates` (12 or more, n) has the rates of the stages before.
    """
    n = start.shape[0]
    for k in range(n):
        values[k] = start[k]
    for r in range(stage):
        weight = dt * _WEIGHTS[stage, r]
        if weight != 0.0:
            for k in range(n):
                values[k] += weight * rates[r, k]
