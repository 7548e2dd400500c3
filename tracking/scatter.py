"""How far the frames scatter about their flights, and for how long their errors stay alike.

Each of a frame's six whitened errors is the sum of a white part of variance σ² and a slow one of variance σ² a and memory
T (`flights`). The three numbers are those of greatest restricted likelihood (Patterson & Thompson, Biometrika 58, 545,
1971),

    -2 l(a, T) = (N - P) ln σ² + Σ (ln |V| + ln |XᵀV⁻¹X|),     σ² = r V⁻¹ r/(N - P),

summed over the flights: V is the covariance of the errors for σ = 1, and X what a flight can follow. It is the likelihood
of what the flights cannot follow, so that a slow error that a flight has swallowed is not taken for none: a plain
likelihood, or the residuals' own correlation, would find errors too small and too quick. A flight has a place and a
velocity for each of the six, which are nearly its twelve numbers: each of the six is a series of its own, X = (1, t).

One clip determines a and T within a factor of two or three, and the likeliest often says that there is no slow part where
there is one. So the likelihood is computed on a grid, even in the logarithms, the logarithms of the variances are
averaged with it, and the six series, which are moved by the same marks and the same light, speak for each other by a
share.

w + c is whitened by the innovations of its Kalman filter (Harvey, Forecasting, Structural Time Series Models and the
Kalman Filter, 1989, 3.4), gaps as they are, at a cost linear in the frames.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log, sqrt

import numpy as np
from numpy.typing import NDArray

from ..model.compiled import compiled, inner
from ..model.motion import State
from .flights import Scatter, Sightings, seen_minus_motion

Array = NDArray[np.float64]

FEWEST = 10
"""Frames of a flight that say anything of how errors go together."""
INLIER = 0.3
"""Weight (of Tukey's biweight) from which a frame counts as one amid the others."""
PRIOR_FRAMES = 4.0
"""The stated sigmas count for as much as so many frames that scatter as stated."""
WANDERS = np.append(0.0, np.geomspace(0.05, 50.0, 11))
MEMORIES = np.geomspace(0.7, 60.0, 10)
"""The grid; memories in frames."""
NEIGHBOURS = 0.2
"""Share with which each of the five other series counts."""


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
    spacing = float(np.median(np.concatenate([np.diff(t) for t in times])))
    longest = max(float(t[-1] - t[0]) for t in times) / 3.0
    memories = MEMORIES[: max(1, int((MEMORIES * spacing < longest).sum()))] * spacing
    likelihood, variance = np.empty((2, 6, len(memories), len(WANDERS)))
    residuals = np.ascontiguousarray(np.vstack(series).T)
    _fill(np.concatenate(times), residuals, np.array(ends), WANDERS, memories, likelihood, variance)
    pooled = (1.0 - NEIGHBOURS) * likelihood + NEIGHBOURS * likelihood.sum(axis=0)
    odds = np.exp(-0.5 * (pooled - pooled.min(axis=(1, 2), keepdims=True)))
    odds /= odds.sum(axis=(1, 2), keepdims=True)
    return _mean_scatter(odds, variance, memories, spacing)


def _mean_scatter(odds: Array, variance: Array, memories_s: Array, spacing: float) -> Scatter:
    """The scatter whose white, single and lasting variance are the geometric means over scatters (6, memories, wanders)
    of these odds. Arithmetic means would be those of the few with the longest memory."""
    keep = np.exp(-spacing / memories_s)[:, None]
    forms = (np.ones_like(WANDERS), 1.0 + WANDERS, 1.0 + WANDERS * (1.0 + keep) / (1.0 - keep))
    white, single, lasting = (np.exp((odds * np.log(variance * form)).sum(axis=(1, 2))) for form in forms)
    wander = single / white - 1.0
    ratio = np.maximum((lasting / white - 1.0) / np.maximum(wander, 1e-12), 1.0 + 1e-6)
    return Scatter(np.sqrt(white), wander, spacing / np.log((ratio + 1.0) / (ratio - 1.0)))


@compiled(nogil=True)
def _fill(
    time: Array, series: Array, ends: NDArray[np.int64], wanders: Array, memories_s: Array, likelihood: Array,
    variance: Array,
) -> None:  # fmt: skip
    """-2 l and σ² of each series (6, n) at each memory and wander."""
    for i in range(len(series)):
        for j in range(len(memories_s)):
            for k in range(len(wanders)):
                value, sigma = _likelihood(time, series[i], ends, wanders[k], memories_s[j])
                likelihood[i, j, k], variance[i, j, k] = value, sigma * sigma


@inner
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
        for j in range(3):
            carried[j] = 0.0
        spread = wander
        a11, a12, a22, b1, b2, cost = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(begin, end):
            if k > begin and wander > 0.0:
                keep = exp(-(time[k] - time[k - 1]) / memory_s)
                spread = keep * keep * spread + (1.0 - keep * keep) * wander
                for j in range(3):
                    carried[j] *= keep
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
            volume += log(variance)
            spread -= spread * gain
        determinant = max(a11 * a22 - a12 * a12, 1e-300)
        squares += cost - (a22 * b1 * b1 - 2.0 * a12 * b1 * b2 + a11 * b2 * b2) / determinant
        free += end - begin - 2.0
        volume += log(determinant)
    return free * log(squares / free) + volume, sqrt(squares / free)
