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
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from ...model.throw import State
from .flights import ErrorModel, Observations, seen_minus_motion

Array = NDArray[np.float64]

FEWEST = 10
"""Frames of a flight that say anything of how errors go together."""
MOST = 1000
"""Frames of the longest flight that are looked at, or twice as many. What errs alike while an edge moves by part of a pixel does
so for a thousand frames of a film far faster than the die, and is most of what a mean over a flight errs; but likelihood is all
about neighbours, and were they so near, about what hardly counts."""
INLIER = 0.3
"""Weight (of Tukey's biweight) from which a frame counts as one amid the others."""
PRIOR_FRAMES = 4.0
"""The stated sigmas count for as much as so many frames that scatter as stated."""
FURTHER = 4
"""Memories beyond the usual ones, and wanders below them, that are looked for where flights are long enough to tell."""
WANDERS, SMALLER = np.geomspace(0.05, 50.0, 11), 0.05 * 1000.0 ** (np.arange(-FURTHER, 0) / 10.0)
MEMORIES = np.append(np.geomspace(0.7, 60.0, 10), 60.0 * (60.0 / 0.7) ** (np.arange(1, FURTHER + 1) / 9.0))
"""The grid, besides no wander; memories in frames. As many of the SMALLER wanders are looked for as of the FURTHER memories: over
so many frames they count for as much in a mean."""
NEIGHBOURS = 0.2
"""Share with which each of the five other series counts."""


def estimate_error_model(
    seen: Observations, parts: Sequence[slice], states: Sequence[State], shared: Array, weights: Array
) -> ErrorModel:
    """The scatter of frames (n,) about flights, each given by its rows and its fitted state; frames of little weight
    are left out. White and as stated where no flight has frames enough.

    A memory longer than a third of the longest flight cannot be told from the flight, and is not looked for.
    """
    times, series, ends = [], [], [0]
    every = max(1, max(rows.stop - rows.start for rows in parts) // MOST)
    for rows, state in zip(parts, states, strict=True):
        inside = np.flatnonzero(weights[rows] > INLIER)[::every] + rows.start
        if len(inside) >= FEWEST:
            part = seen.rows(inside)
            leaning = part.whitener @ (part.lean @ shared)[:, :, None]
            times.append(part.time_s)
            series.append(seen_minus_motion(part, state) - leaning[:, :, 0])
            ends.append(ends[-1] + len(part))
    if not times:
        return ErrorModel.white()
    spacing = float(np.median(np.concatenate([np.diff(t) for t in times])))
    longest = max(float(t[-1] - t[0]) for t in times) / 3.0
    frames, wanders = _grid(longest / spacing)
    memories = frames * spacing
    likelihood, variance = np.empty((2, 6, len(memories), len(wanders)))
    residuals = np.vstack(series)
    _fill(np.concatenate(times), residuals, np.array(ends), wanders, memories, likelihood, variance)
    pooled = (1.0 - NEIGHBOURS) * likelihood + NEIGHBOURS * likelihood.sum(axis=0)
    odds = np.exp(-0.5 * (pooled - pooled.min(axis=(1, 2), keepdims=True)))
    odds /= odds.sum(axis=(1, 2), keepdims=True)
    return _mean_scatter(odds, variance, memories, wanders, spacing)


def _grid(longest: float) -> tuple[Array, Array]:
    """Memories below the longest [frames] that can be told, the first in any case, and wanders."""
    memories = MEMORIES[: max(1, int((longest > MEMORIES).sum()))]
    smaller = SMALLER[min(FURTHER, len(MEMORIES) - len(memories)) :]
    return memories, np.concatenate([[0.0], smaller, WANDERS])


def _mean_scatter(odds: Array, variance: Array, memories_s: Array, wanders: Array, spacing: float) -> ErrorModel:
    """The scatter whose white, single and lasting variance are the geometric means over scatters (6, memories, wanders)
    of these odds. Arithmetic means would be those of the few with the longest memory."""
    keep = np.exp(-spacing / memories_s)[:, None]
    forms = (np.ones_like(wanders), 1.0 + wanders, 1.0 + wanders * (1.0 + keep) / (1.0 - keep))
    white, single, lasting = (np.exp((odds * np.log(variance * form)).sum(axis=(1, 2))) for form in forms)
    wander = single / white - 1.0
    ratio = np.maximum((lasting / white - 1.0) / np.maximum(wander, 1e-12), 1.0 + 1e-6)
    return ErrorModel(np.sqrt(white), wander, spacing / np.log((ratio + 1.0) / (ratio - 1.0)))


@compiled(nogil=True)
def _fill(
    time: Array, series: Array, ends: NDArray[np.int64], wanders: Array, memories_s: Array, likelihood: Array,
    variance: Array,
) -> None:  # fmt: skip
    """-2 l, but for a constant, and σ² of each of the six series (n, 6) at each memory and wander, of flights that lie one
    after the other. The filter depends on the times alone, and is the same for all six."""
    keep, found = np.zeros(len(time)), np.empty((6, 2))
    for j in range(len(memories_s)):
        for k in range(1, len(time)):
            keep[k] = exp(-(time[k] - time[k - 1]) / memories_s[j])
        for k in range(len(wanders)):
            _likelihoods(time, series, ends, wanders[k], keep, found)
            for i in range(6):
                likelihood[i, j, k], variance[i, j, k] = found[i, 0], found[i, 1]


@inner
def _likelihoods(time: Array, series: Array, ends: NDArray[np.int64], wander: float, keep: Array, found: Array) -> None:
    volume, free = 0.0, PRIOR_FRAMES
    squares = np.full(6, PRIOR_FRAMES)
    row, carried, pulls = np.empty(8), np.empty(8), np.empty((3, 6))
    for flight in range(len(ends) - 1):
        begin, end = ends[flight], ends[flight + 1]
        middle = 0.5 * (time[begin] + time[end - 1])
        half = 0.5 * (time[end - 1] - time[begin])
        for j in range(8):
            carried[j] = 0.0
        for j in range(6):
            pulls[0, j], pulls[1, j], pulls[2, j] = 0.0, 0.0, 0.0
        spread, product = wander, 1.0
        a11, a12, a22 = 0.0, 0.0, 0.0
        for k in range(begin, end):
            kept = 1.0
            if k > begin:
                kept = keep[k]
                spread = kept * kept * spread + (1.0 - kept * kept) * wander
            inverse = 1.0 / (spread + 1.0)
            gain = spread * inverse
            row[0], row[1] = 1.0, (time[k] - middle) / half
            for j in range(6):
                row[2 + j] = series[k, j]
            for j in range(8):
                before = kept * carried[j]
                row[j] -= before
                carried[j] = before + gain * row[j]
            first, second = row[0] * inverse, row[1] * inverse
            a11 += row[0] * first
            a12 += row[1] * first
            a22 += row[1] * second
            for j in range(6):
                pulls[0, j] += first * row[2 + j]
                pulls[1, j] += second * row[2 + j]
                pulls[2, j] += inverse * row[2 + j] * row[2 + j]
            # One logarithm for many frames: the variances of the grid stay below 51.
            product *= spread + 1.0
            if product > 1e200:
                volume += log(product)
                product = 1.0
            spread -= spread * gain
        determinant = max(a11 * a22 - a12 * a12, 1e-300)
        for j in range(6):
            b1, b2, cost = pulls[0, j], pulls[1, j], pulls[2, j]
            squares[j] += cost - (a22 * b1 * b1 - 2.0 * a12 * b1 * b2 + a11 * b2 * b2) / determinant
        free += end - begin - 2.0
        volume += log(product) + log(determinant)
    for j in range(6):
        found[j, 1] = squares[j] / free
        found[j, 0] = free * log(found[j, 1]) + volume
