"""The integrator of the engine: the explicit Runge-Kutta method of order 8 of Dormand and Prince, in steps of given length.

With the stages kᵣ = f(t + cᵣ Δt, y + Δt Σₙ aᵣₙ kₙ), n < r < 12, a step is y + Δt Σ bᵣ kᵣ (Hairer, Nørsett, Wanner, Solving
Ordinary Differential Equations I, 1993, II.5). The coefficients are those of `scipy.integrate.DOP853`. The steps have no
error control: the motions here have no rates but those of the spin and of √(g/R), and each caller limits the turn in a step.

A caller has a workspace (14, n), whose rows are the rates of the twelve stages, the start (START), and the argument of the
present stage (VALUES), and evaluates its own right side:

    for stage in range(STAGES + 1):
        stage_values(room, stage, dt, n)
        if stage < STAGES:
            ...                     # fill room[stage] from room[VALUES], at the time t + NODES[stage] dt

The last pass leaves the end of the step in room[VALUES].
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

from ..compiled import inner
from .types import Array

STAGES = 12
START, VALUES = 12, 13
"""Rows of a workspace."""

NODES = DOP853.C[:STAGES].copy()
"""cᵣ (12,)."""
_WEIGHTS = np.vstack([DOP853.A[:STAGES, :STAGES], DOP853.B])
"""aᵣₙ (12, 12), and bₙ as the last row."""


@inner
def stage_values(room: Array, stage: int, dt: float, size: int) -> None:
    """Fill room[VALUES, :size] with the argument of a stage or, for STAGES, with the end of the step of dt [s].

    A literal `size` is best: the loops over it are unrolled then, which halves the time of a step.
    """
    for k in range(size):
        room[VALUES, k] = room[START, k]
    for r in range(stage):
        weight = dt * _WEIGHTS[stage, r]
        if weight != 0.0:
            for k in range(size):
                room[VALUES, k] += weight * room[r, k]
