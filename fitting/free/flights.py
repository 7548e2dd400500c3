"""Free flights: each flight of a throw fitted by itself, with no impact law.

In flight the pose is p₀ + v t - g t²/2 ẑ and exp(ω t) R₀, which has twelve parameters. Small changes of them move it by

    δp(t) = δp + t δv,    δ(t) = exp(ω t) δ + t J(ω t) δω,

with J the left Jacobian of exp (Barfoot, State Estimation for Robotics, 2017, Eq. 7.77). These fits give initial
values, measure the actual errors of single frames, and set the residuals that a model of the whole throw must reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import rotation_between
from ...model.throw import Flight, State, Throw
from ...tracking.flights import left_jacobians, perturbed, pose_jacobian
from ..estimation import (
    HUBER_THRESHOLD,
    MEDIAN_SQUARE,
    FlightObservations,
    covariance_of,
    huber,
    levenberg_marquardt,
    pose_errors,
    robust_variance,
    whitened,
    whitened_jacobian,
    with_noise,
)
from ..results import USUAL_CHOICES, Choices

Array = NDArray[np.float64]

MIN_FRAMES = 2
"""Frames of a flight that can be fitted: two poses have twelve numbers, and so has a state."""

_OUTLIER = 45.0
"""|r|² of a frame, in units of its flight's variance, beyond which it is an outlier: 5e-8 of good frames."""

_MAX_TRIMS = 6
"""Rounds of removing outliers and fitting again."""

_MIN_FOR_TRIMS = 5
"""Frames from which outliers are looked for; with fewer, an outlier bends the flight more than it departs from it."""

_MIN_AGREEING = 0.8
"""Share of frames that must agree with a flight; if fewer do, the flight is wrong."""

_MIN_AGREEING_AT_ONE_END = 0.5
"""The same if all others lie at one end of it."""

_UNDERSTATED = 1.5
"""Variance of the residuals above which the flight is fitted again with a threshold in units of the actual scatter."""

_BAD_START = 25.0
"""Variance of a free flight above which another start is tried: the motion measured there may belong to another
flight."""

_MEDIAN_SQUARE_OF_THREE = 2.366
"""Median of the sum of three squared normal numbers."""

_SIGMA_FLOOR = (1e-7, 1e-6)
"""[m], [rad] smallest noise estimated: a track printed with seven digits carries no smaller one."""

_STEPS = (1e-3, 1e-2)
"""[m], [rad] scales of the unknowns of a flight; those of the velocities are these over its duration."""

_FIRST_NOISE = (1e-4, 5e-3)
"""[m], [rad] before any is known; their ratio is irrelevant, since position and rotation of a flight are fitted
apart."""


@dataclass(frozen=True, eq=False)
class FreeFlight:
    """One flight fitted by itself."""

    flight: Flight
    """Its covariance follows from the stated errors of the frames, without scaling."""
    frames: int
    variance: float
    """Of a whitened residual, robust; NaN for two frames, which leave no degrees of freedom."""


@dataclass(frozen=True, eq=False)
class FreeFlights:
    """All flights of a measured throw, fitted one by one."""

    observations: FlightObservations
    """Without the outliers; every frame has a covariance."""
    flights: tuple[FreeFlight | None, ...]
    """None for a flight of fewer than two frames."""
    variance: float
    """Of a whitened residual over all flights: 1 if the frames' covariances are right."""
    outliers: int
    """Frames left out because they contradict their own flight."""
    noise_estimated: tuple[int, float, float] | None
    """Number of frames without a usable covariance, and the sigmas [m], [rad] estimated from their flights. NaN where
    no flight is long enough; those frames are then left out."""

    choices: Choices = USUAL_CHOICES
    """What fits of a law to them assume or decide."""

    @property
    def huber_threshold(self) -> float:
        """k² of the robust loss: bad frames are bad relative to the actual scatter of the frames."""
        return HUBER_THRESHOLD * max(1.0, self.variance)


def fit_flights(observations: FlightObservations, measured: Throw, choices: Choices = USUAL_CHOICES) -> FreeFlights:
    """Fit every flight of a measured throw by itself, started from the measured motion."""
    missing = np.asarray(~np.isfinite(observations.whitener).all((1, 2)))
    noise = None
    if missing.any():
        sigma_m, sigma_rad = _flight_noise(observations, measured)
        noise = (int(missing.sum()), sigma_m, sigma_rad)
        if np.isfinite(sigma_m):
            observations = with_noise(observations, missing, sigma_m, sigma_rad)
        else:
            observations = observations.where(~missing)
    kept = np.ones(len(observations), bool)
    fits: list[FreeFlight | None] = []
    for k, flight in enumerate(measured.flights):
        fit, kept[observations.flight == k] = _without_outliers(observations.where(observations.flight == k), flight)
        fits.append(fit)
    outliers = int((~kept).sum())
    return FreeFlights(observations.where(kept), tuple(fits), _pooled_variance(fits), outliers, noise, choices)


def fit_flight(observations: FlightObservations, guess: Flight) -> FreeFlight | None:
    """The exact motion nearest to the frames, started from a guess; None for fewer than two frames."""
    n = len(observations)
    if n < MIN_FRAMES:
        return None
    k2 = HUBER_THRESHOLD
    state, residuals, jacobian = _nearest(observations, _start(observations, guess), k2, guess)
    freedom = 6.0 * (n - 2)
    if freedom and robust_variance(residuals, freedom) > _BAD_START:
        again = _nearest(observations, _start_from_frames(observations, guess, state.time_s), k2, guess)
        if robust_variance(again[1], freedom) < robust_variance(residuals, freedom):
            state, residuals, jacobian = again
    if freedom and (variance := robust_variance(residuals, freedom)) > _UNDERSTATED:
        # Frames whose covariances are too small would all look bad: the threshold follows their actual scatter.
        state, residuals, jacobian = _nearest(observations, state, k2 * variance, guess)
    variance = robust_variance(residuals, freedom) if freedom else np.nan
    flight = replace(_flight(guess, state), end_s=guess.end_s, covariance=covariance_of(jacobian))
    return FreeFlight(flight, n, variance)


def _flight(guess: Flight, state: State) -> Flight:
    """The flight of the same die in the same place, from a state on."""
    return Flight(state, state.time_s, gravity_m_s2=guess.gravity_m_s2, turning=guess.turning)


def _nearest(observations: FlightObservations, start: State, k2: float, guess: Flight) -> tuple[State, Array, Array]:
    """The state of least squares, its whitened residuals (n, 6) and their derivative (n, 6, 12)."""
    span = max(float(np.ptp(observations.time_s)), 1e-9)
    step_m, step_rad = _STEPS
    scale = np.repeat([step_m, step_rad, step_m / span, step_rad / span], 3)

    def evaluate(x: Array) -> tuple[Array, Array]:
        state = perturbed(start, x)
        flight = _flight(guess, state)
        errors = pose_errors(observations, *flight.poses(observations.time_s))
        jacobian = pose_jacobian(flight, observations.time_s)
        # The unknown rotation is about the orientation of `start`, the derivative about the displaced one.
        jacobian[:, :, 3:6] = jacobian[:, :, 3:6] @ left_jacobians(x[None, 3:6])[0]
        residuals, jacobian = huber(
            whitened(observations, errors), whitened_jacobian(observations, errors, jacobian), k2
        )
        return residuals.ravel(), jacobian.reshape(-1, 12)

    free = np.full(12, np.inf)
    state = perturbed(start, levenberg_marquardt(evaluate, np.diag(1.0 / scale), -free, free, max_steps=30))
    flight = _flight(guess, state)
    errors = pose_errors(observations, *flight.poses(observations.time_s))
    jacobian = whitened_jacobian(observations, errors, pose_jacobian(flight, observations.time_s))
    return state, whitened(observations, errors), jacobian


def _start(observations: FlightObservations, guess: Flight) -> State:
    """The guess if it is finite, else a start from the frames themselves."""
    s = guess.start
    if all(np.isfinite(part).all() for part in (s.position_m, s.quaternion, s.velocity_m_s, s.omega_rad_s)):
        return s
    return _start_from_frames(observations, guess, s.time_s)


def _start_from_frames(observations: FlightObservations, guess: Flight, time_s: float) -> State:
    """Straight from the first pose to the last, with the median angular velocity between neighbouring frames."""
    t, p, q = observations.time_s, observations.position_m, observations.quaternion
    dt = t[-1] - t[0]
    velocity = (p[-1] - p[0]) / dt + np.array([0.0, 0.0, 0.5 * guess.gravity_m_s2 * dt])
    turns = rotation_between(q[:-1], q[1:]) / np.diff(t)[:, None]
    first = State(float(t[0]), p[0], q[0], velocity, np.median(turns, axis=0))
    falling = _flight(guess, first)
    return falling.at(time_s) if np.isfinite(time_s) else first


def _without_outliers(observations: FlightObservations, guess: Flight) -> tuple[FreeFlight | None, NDArray[np.bool_]]:
    """The flight that most frames agree on, and which of them (n,) agree with it.

    The worst frames are removed first and the flight is fitted again. Many frames with the same error, as while the die
    comes into view, bend the flight so much that the less wrong ones among them do not stand out.
    """
    n = len(observations)
    kept = np.ones(n, bool)
    whole = fit = fit_flight(observations, guess)
    if fit is None or n < _MIN_FOR_TRIMS:
        return fit, kept
    for _ in range(_MAX_TRIMS):
        assert fit is not None
        errors = pose_errors(observations, *fit.flight.poses(observations.time_s))
        s = (whitened(observations, errors) ** 2).sum(1)
        agree = s <= _OUTLIER * max(1.0, float(np.median(s[kept])) / MEDIAN_SQUARE)
        if (agree == kept).all() or agree.sum() < _MIN_FOR_TRIMS:
            break
        kept = agree
        fit = fit_flight(observations.where(kept), guess)
    return (fit, kept) if _is_credible(kept) else (whole, np.ones(n, bool))


def _is_credible(kept: NDArray[np.bool_]) -> bool:
    """Whether the removed frames are wrong, not the flight.

    At most a fifth of the frames may be removed, or up to a half if all lie at one end, where a die enters or leaves
    the view.
    """
    share = float(kept.mean())
    ends = np.flatnonzero(np.diff(kept.astype(int)))
    return share >= _MIN_AGREEING or (share >= _MIN_AGREEING_AT_ONE_END and len(ends) == 1)


def _flight_noise(observations: FlightObservations, measured: Throw) -> tuple[float, float]:
    """Sigmas [m], [rad] of a frame, one for all axes, from the scatter of frames about their own flights; NaN if
    unknown.
    """
    even = with_noise(observations, np.ones(len(observations), bool), *_FIRST_NOISE)
    squares, freedom = np.zeros(2), 0.0
    for k, guess in enumerate(measured.flights):
        mine = even.where(even.flight == k)
        fit = fit_flight(mine, guess)
        if fit is None or len(mine) < 3:
            continue
        errors = pose_errors(mine, *fit.flight.poses(mine.time_s))
        # The median, so that one bad frame does not set the noise of all.
        n = 3.0 * len(mine)
        squares += np.median((errors**2).reshape(-1, 2, 3).sum(2), axis=0) / _MEDIAN_SQUARE_OF_THREE * n
        freedom += n - 6.0
    if freedom <= 0.0:
        return np.nan, np.nan
    sigma_m, sigma_rad = np.maximum(np.sqrt(squares / freedom), _SIGMA_FLOOR)
    return float(sigma_m), float(sigma_rad)


def _pooled_variance(fits: Sequence[FreeFlight | None]) -> float:
    """Variance of a whitened residual: the median over the flights, weighted by their frames; 1 where none has any.

    The median, because a flight in which tracking missed a bounce has an arbitrarily large variance.
    """
    found = sorted((fit.variance, fit.frames - 2) for fit in fits if fit is not None and fit.frames > 2)
    if not found:
        return 1.0
    share = np.cumsum([weight for _, weight in found])
    return float(found[int(np.searchsorted(share, 0.5 * share[-1]))][0])
