"""How far the frames scatter about their flights, and for how long their errors stay alike.

Each of a frame's six whitened errors is the sum of a white part of variance σ² and a slow one of variance σ² a and memory
T (`flights`). The three numbers are those of greatest restricted likelihood (Patterson & Thompson, Biometrika 58, 545,
1971),

    -2 l(a, T) = (N - P) ln σ² + Σ (ln |V| + ln |XᵀV⁻¹X|),     σ² = r V⁻¹ r/(N - P),

summed over the flights: V is the covariance of the errors for σ = 1, and X what a flight can follow. It is the likelihood
of what the flights cannot follow, so that a slow error that a flight has swallowed is not taken for none: a plain
likelihood, or the residuals' own correlation, would find errors too small and too quick. A flight has a place and a
velocity for each of the six, which are nearly its twelve numbers: each of the six is a series of its own, X = (1, t).

w + c is whitened by the innovations of its Kalman filter (Harvey, Forecasting, Structural Time Series Models and the
Kalman Filter, 1989, 3.4), gaps as they are, at a cost linear in the frames.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from ..model.motion import State
from .flights import Scatter, Sightings, seen_minus_motion

Array = NDArray[np.float64]

FEWEST = 10
"""Frames of a flight that say anything of how errors go together."""
INLIER = 0.3
"""Weight (of Tukey's biweight) from which a frame counts as one amid the others."""
SEPARATE = 4.0
"""By how much -2 l must fall for a slow part to be believed in: two numbers more."""
PRIOR_FRAMES = 4.0
"""The stated sigmas count for as much as so many frames that scatter as stated."""
WANDERS = np.geomspace(0.05, 50.0, 8)
MEMORIES = np.geomspace(0.7, 60.0, 8)
"""Where the maximum is looked for first, in frames; then between neighbours."""


def estimate_scatter(
    seen: Sightings, parts: Sequence[slice], states: Sequence[State], shared: Array, weights: Array
) -> Scatter:
    """The scatter of frames (n,) about flights, each given by its rows and its fitted state; frames of little weight
    are left out. White and as stated where no flight has frames enough.

    A memory longer than a third of the longest flight cannot be told from the flight, and is not looked for.
    """
    times, series, ends = [], [], [0]
    for rows, state in zip(parts, states, strict=True):
        inside = np.flatnonzero(weights[rows] > INLIER) + rows.start
        if len(inside) >= FEWEST:
            part = seen.rows(inside)
            leaning = part.whitener @ (part.lean @ shared)[:, :, None]
            times.append(part.time_s)
            series.append(seen_minus_motion(part, state) - leaning[:, :, 0])
            ends.append(ends[-1] + len(part))
    if not times:
        return Scatter.white()
    time_s = np.concatenate(times)
    spacing = float(np.median(np.concatenate([np.diff(t) for t in times])))
    longest = max(float(t[-1] - t[0]) for t in times) / 3.0
    found = np.array(
        [_likeliest(time_s, np.ascontiguousarray(r), np.array(ends), spacing, longest) for r in np.vstack(series).T]
    )
    return Scatter(found[:, 0], found[:, 1], found[:, 2])


def _likeliest(time_s: Array, series: Array, ends: NDArray[np.int64], spacing: float, longest: float) -> Array:
    """σ, a and T [s] of one series of residuals."""
    white, scale = _likelihood(time_s, series, ends, 0.0, spacing)
    memories = MEMORIES[MEMORIES * spacing < longest] * spacing
    best, at = white - SEPARATE, (0.0, spacing)
    for wanders, near in ((WANDERS, memories), (np.empty(0), np.empty(0))):
        if not len(near):
            # Between the neighbours of the best of the coarse grid.
            if at[0] == 0.0:
                break
            wanders, near = at[0] * np.geomspace(0.4, 2.5, 7), at[1] * np.geomspace(0.6, 1.7, 7)
        for memory in near:
            for wander in wanders:
                value, sigma = _likelihood(time_s, series, ends, wander, memory)
                if value < best and memory <= longest:
                    best, at, scale = value, (float(wander), float(memory)), sigma
    return np.array([scale, *at])


@njit(cache=True, nogil=True)
def _likelihood(
    time: Array, series: Array, ends: NDArray[np.int64], wander: float, memory_s: float
) -> tuple[float, float]:
    """-2 l but for a constant, and σ, of flights that lie one after the other."""
    squares, volume = PRIOR_FRAMES, 0.0
    free = PRIOR_FRAMES
    row, carried = np.empty(3), np.empty(3)
    for flight in range(len(ends) - 1):
        begin, end = ends[flight], ends[flight + 1]
        middle = 0.5 * (time[begin] + time[end - 1])
        half = 0.5 * (time[end - 1] - time[begin])
        carried[:] = 0.0
        spread = wander
        a11, a12, a22, b1, b2, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(begin, end):
            if k > begin and wander > 0.0:
                keep = np.exp(-(time[k] - time[k - 1]) / memory_s)
                spread = keep * keep * spread + (1.0 - keep * keep) * wander
                carried *= keep
            row[0], row[1], row[2] = 1.0, (time[k] - middle) / half, series[k]
            variance = spread + 1.0
            gain = spread / variance
            for j in range(3):
                row[j] -= carried[j]
                carried[j] += gain * row[j]
            a11 += row[0] * row[0] / variance
            a12 += row[0] * row[1] / variance
            a22 += row[1] * row[1] / variance
            b1 += row[0] * row[2] / variance
            b2 += row[1] * row[2] / variance
            cost += row[2] * row[2] / variance
            volume += np.log(variance)
            spread -= spread * gain
        determinant = max(a11 * a22 - a12 * a12, 1e-300)
        squares += cost - (a22 * b1 * b1 - 2.0 * a12 * b1 * b2 + a11 * b2 * b2) / determinant
        free += end - begin - 2.0
        volume += np.log(determinant)
    return free * np.log(squares / free) + volume, np.sqrt(squares / free)
