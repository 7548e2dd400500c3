"""The error model of the frames: how large their errors about the flights are, and for how long they stay correlated.

Each of a frame's six whitened errors is the sum of a white part of variance σ² and an AR(1) part of variance σ² a and correlation
time T (`ErrorModel`). The three numbers maximise the restricted likelihood (Patterson & Thompson, Biometrika 58, 545, 1971),

    -2 l(a, T) = (N - P) ln σ² + Σ (ln |V| + ln |XᵀV⁻¹X|),     σ² = r V⁻¹ r/(N - P),

summed over the flights. V is the covariance of the errors for σ = 1, and X spans what a flight can follow. The restricted
likelihood is that of the part which flights cannot follow, so a correlated error that a flight has absorbed is not mistaken for
none. A plain likelihood, or the autocorrelation of the residuals, underestimates both size and correlation time. A flight has a
value and a rate for each of the six series, nearly its twelve numbers; so each series is fitted by itself with X = (1, t).

One clip determines a and T within a factor of two or three, and the maximum often has no correlated part although there is one.
Therefore the likelihood is evaluated on a logarithmic grid, and the logarithms of the variances are averaged with it. The six
series depend on the same marks and the same light, so each counts with a share in the likelihood of the others.

The sum of both parts is whitened by the innovations of its Kalman filter (Harvey, Forecasting, Structural Time Series Models and
the Kalman Filter, 1989, 3.4), with the gaps as they are, at a cost linear in the frames."""

from __future__ import annotations

from collections.abc import Sequence
from math import exp, log

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from ...model.throw import State
from .single_flights import ErrorModel, WeightedPoses, flight_residuals

Array = NDArray[np.float64]

MIN_FRAMES = 10
"""Fewest frames of a flight that carry information on correlation."""
MAX_FRAMES = 1000
"""Frames of the longest flight that are used, or up to twice as many. While an edge moves by part of a pixel its error stays the
same, for a thousand frames of a film far faster than the die, and dominates the error of a mean over a flight. The likelihood
however is determined by neighbours, and would then describe lags that hardly count."""
INLIER_WEIGHT = 0.3
"""Least weight (Tukey's biweight) of a frame that is used."""
PRIOR_FRAMES = 1.0
"""Weight of the stated sigmas: that of this many frames whose errors, of both parts together, are as stated. Where errors are
smaller than stated, more of them would have slow errors, which flights can follow, make up for the rest."""
LEAST_PRIOR_FRAMES = 1e-9
"""The same where nothing else is known: enough that residuals of exactly zero have a variance."""
LONGER = 4
"""Grid points added for flights long enough to determine them: longer correlation times, and as many smaller variance ratios,
which over so many frames count as much in a mean."""
VARIANCE_RATIOS = np.geomspace(0.05, 50.0, 11)
"""Grid of the variance ratio a, besides zero."""
SMALLER_RATIOS = 0.05 * 1000.0 ** (np.arange(-LONGER, 0) / 10.0)
"""The smaller variance ratios that LONGER adds."""
CORRELATION_FRAMES = np.append(np.geomspace(0.7, 60.0, 10), 60.0 * (60.0 / 0.7) ** (np.arange(1, LONGER + 1) / 9.0))
"""Grid of the correlation time T, in frames; the last are those that LONGER adds."""
POOLED = 0.8 * np.eye(6) + 0.2
"""With what weight the likelihood of each series counts in that of another: positions and rotations depend on the same light."""
POOLED_BY_KIND = 0.5 * np.eye(6) + 0.5 * np.kron(np.eye(2), np.ones((3, 3)))
"""The same where nothing is known of a track: what its positions show says nothing of its rotations."""
DETERMINED_SHARE = 3.0
"""The longest correlation time is the longest flight over this: a longer one cannot be distinguished from the flight itself."""


def estimate_error_model(
    observations: WeightedPoses, parts: Sequence[slice], states: Sequence[State], shared: Array, weights: Array
) -> ErrorModel:
    """The error model of frames (n,) about flights, each given by its rows and its fitted state.

    `shared` (m,) are the shared errors [px], `weights` (n,) those of a robust fit: frames below INLIER_WEIGHT are left out. If no
    flight has MIN_FRAMES, errors are taken as white and as stated.
    """
    times, series = [], []
    every = max(1, max(rows.stop - rows.start for rows in parts) // MAX_FRAMES)
    for rows, state in zip(parts, states, strict=True):
        inside = np.flatnonzero(weights[rows] > INLIER_WEIGHT)[::every] + rows.start
        if len(inside) >= MIN_FRAMES:
            part = observations.rows(inside)
            bias = part.whitener @ (part.bias_jacobian @ shared)[:, :, None]
            times.append(part.time_s)
            series.append(flight_residuals(part, state) - bias[:, :, 0])
    return _of_series(times, series, POOLED, PRIOR_FRAMES, 1.0) if times else ErrorModel.white()


def error_model_of(times_s: Sequence[Array], residuals: Sequence[Array]) -> ErrorModel:
    """The error model of whitened residuals (n, 6) of flights, at their times (n,) [s], of which nothing else is known.

    White errors of any size, and the correlated ones of the grid together, are as likely as each other beforehand. Flights with
    fewer than MIN_FRAMES frames are left out; without any other the errors are taken as white and as stated."""
    chosen = [k for k, time_s in enumerate(times_s) if len(time_s) >= MIN_FRAMES]
    if not chosen:
        return ErrorModel.white()
    every = max(1, max(len(times_s[k]) for k in chosen) // MAX_FRAMES)
    times, series = [times_s[k][::every] for k in chosen], [residuals[k][::every] for k in chosen]
    return _of_series(times, series, POOLED_BY_KIND, LEAST_PRIOR_FRAMES, np.inf)


def _of_series(
    times: Sequence[Array], series: Sequence[Array], pooled: Array, prior_frames: float, white_odds: float
) -> ErrorModel:
    """The error model of the residuals (n, 6) of one flight or more; `pooled` (6, 6) as POOLED.

    As many frames as `prior_frames` count as if their errors, white and correlated together, were as stated. `white_odds` are
    those of white errors beforehand, in grid points of correlated ones; inf for as many as there are.
    """
    ends = np.cumsum([0, *map(len, times)])
    spacing_s = float(np.median(np.concatenate([np.diff(t) for t in times])))
    longest_s = max(float(t[-1] - t[0]) for t in times) / DETERMINED_SHARE
    frames, ratios = _grid(longest_s / spacing_s)
    correlation_times_s = frames * spacing_s
    likelihood, variance = np.empty((2, 6, len(correlation_times_s), len(ratios)))
    residuals = np.vstack(series)
    _fill(np.concatenate(times), residuals, ends, ratios, correlation_times_s, prior_frames, likelihood, variance)
    joint = np.einsum("ij,jkl->ikl", pooled, likelihood)
    odds = np.exp(-0.5 * (joint - joint.min(axis=(1, 2), keepdims=True)))
    odds[:, :, 0] *= min(white_odds, len(ratios) - 1.0)
    odds /= odds.sum(axis=(1, 2), keepdims=True)
    return _mean_model(odds, variance, correlation_times_s, ratios, spacing_s)


def _grid(longest_frames: float) -> tuple[Array, Array]:
    """Correlation times [frames] below the longest that can be determined, at least the first, and variance ratios."""
    frames = CORRELATION_FRAMES[: max(1, int((longest_frames > CORRELATION_FRAMES).sum()))]
    smaller = SMALLER_RATIOS[min(LONGER, len(CORRELATION_FRAMES) - len(frames)) :]
    return frames, np.concatenate([[0.0], smaller, VARIANCE_RATIOS])


def _mean_model(
    odds: Array, variance: Array, correlation_times_s: Array, ratios: Array, spacing_s: float
) -> ErrorModel:
    """The error model whose white, single-frame and long-run variances are the geometric means over the grid (6, times, ratios)
    with these odds. Arithmetic means would be those of the few models with the longest correlation time."""
    keep = np.exp(-spacing_s / correlation_times_s)[:, None]
    forms = (np.ones_like(ratios), 1.0 + ratios, 1.0 + ratios * (1.0 + keep) / (1.0 - keep))
    white, single, long_run = (np.exp((odds * np.log(variance * form)).sum(axis=(1, 2))) for form in forms)
    variance_ratio = single / white - 1.0
    excess = np.maximum((long_run / white - 1.0) / np.maximum(variance_ratio, 1e-12), 1.0 + 1e-6)
    return ErrorModel(np.sqrt(white), variance_ratio, spacing_s / np.log((excess + 1.0) / (excess - 1.0)))


@compiled(nogil=True)
def _fill(
    time: Array, series: Array, ends: NDArray[np.int64], ratios: Array, correlation_times_s: Array, prior_frames: float,
    likelihood: Array, variance: Array,
) -> None:  # fmt: skip
    """Fill -2 l, up to a constant, and σ² of each of the six series (n, 6) at each correlation time and variance ratio.

    Flights lie one after the other in `series`. The filter depends on the times alone, and is the same for all six."""
    keep, found = np.zeros(len(time)), np.empty((6, 2))
    for j in range(len(correlation_times_s)):
        for k in range(1, len(time)):
            keep[k] = exp(-(time[k] - time[k - 1]) / correlation_times_s[j])
        for k in range(len(ratios)):
            _likelihoods(time, series, ends, ratios[k], keep, prior_frames, found)
            for i in range(6):
                likelihood[i, j, k], variance[i, j, k] = found[i, 0], found[i, 1]


@inner
def _likelihoods(
    time: Array, series: Array, ends: NDArray[np.int64], ratio: float, keep: Array, prior_frames: float, found: Array
) -> None:
    """Fill -2 l and σ² (6, 2) for one variance ratio and one correlation time, whose decay over each interval is `keep` (n,)."""
    # A prior on the white part instead of the whole would make correlated errors too large wherever the white part is small.
    log_determinant, free = prior_frames * log(1.0 + ratio), prior_frames
    squares = np.full(6, prior_frames / (1.0 + ratio))
    row, predicted, moments = np.empty(8), np.empty(8), np.empty((3, 6))
    for flight in range(len(ends) - 1):
        begin, end = ends[flight], ends[flight + 1]
        middle = 0.5 * (time[begin] + time[end - 1])
        half = 0.5 * (time[end - 1] - time[begin])
        for j in range(8):
            predicted[j] = 0.0
        for j in range(6):
            moments[0, j], moments[1, j], moments[2, j] = 0.0, 0.0, 0.0
        state_variance, product = ratio, 1.0
        a11, a12, a22 = 0.0, 0.0, 0.0
        for k in range(begin, end):
            kept = 1.0
            if k > begin:
                kept = keep[k]
                state_variance = kept * kept * state_variance + (1.0 - kept * kept) * ratio
            inverse = 1.0 / (state_variance + 1.0)
            gain = state_variance * inverse
            row[0], row[1] = 1.0, (time[k] - middle) / half
            for j in range(6):
                row[2 + j] = series[k, j]
            for j in range(8):
                before = kept * predicted[j]
                row[j] -= before
                predicted[j] = before + gain * row[j]
            first, second = row[0] * inverse, row[1] * inverse
            a11 += row[0] * first
            a12 += row[1] * first
            a22 += row[1] * second
            for j in range(6):
                moments[0, j] += first * row[2 + j]
                moments[1, j] += second * row[2 + j]
                moments[2, j] += inverse * row[2 + j] * row[2 + j]
            # One logarithm for many frames: the variances of the grid stay below 51.
            product *= state_variance + 1.0
            if product > 1e200:
                log_determinant += log(product)
                product = 1.0
            state_variance -= state_variance * gain
        determinant = max(a11 * a22 - a12 * a12, 1e-300)
        for j in range(6):
            b1, b2, cost = moments[0, j], moments[1, j], moments[2, j]
            squares[j] += cost - (a22 * b1 * b1 - 2.0 * a12 * b1 * b2 + a11 * b2 * b2) / determinant
        free += end - begin - 2.0
        log_determinant += log(product) + log(determinant)
    for j in range(6):
        found[j, 1] = squares[j] / free
        found[j, 0] = free * log(found[j, 1]) + log_determinant
