"""Each flight on its own: the exact motion nearest to its frames, with no law of impact.

In flight a pose is p₀ + v t - g t²/2 ẑ and exp(ω t) R₀, twelve numbers. Small changes of them move the pose by

    δp(t) = δp + t δv,    δ(t) = exp(ω t) δ + t J(ω t) δω,

J the left Jacobian of exp (Barfoot, State Estimation for Robotics, 2017, Eq. 7.77). These fits give starting values,
say how large the errors of single frames really are, and set the mark that a model through the bounces must reach.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from ...model.throw import Flight, State, Throw
from ...model.world import GRAVITY_M_S2
from ..estimation import (
    CLEAN_FRAME,
    MEDIAN_FRAME,
    Sightings,
    cross_matrices,
    descend,
    huber,
    pose_errors,
    robust_variance,
    whitened,
    whitened_jacobian,
    with_noise,
)

Array = NDArray[np.float64]

FEWEST_FRAMES = 2
"""Two poses have twelve numbers, and so has a state."""

_OUTLIER = 45.0
"""|r|² of a frame, in units of its flight's variance, beyond which it does not show this die: 5e-8 of good ones."""

_MOST_TRIMS = 6

_BAD_START = 25.0
"""Variance of a free flight above which another start is tried: the motion measured there may be another flight's."""

_FIRST_NOISE = (1e-4, 5e-3)
"""[m], [rad] before any is known; position and rotation of a flight are fitted apart, so their ratio is no matter."""


@dataclass(frozen=True, eq=False)
class FreeFlight:
    """One flight fitted by itself."""

    flight: Flight
    """Its covariance is by the stated errors of the frames, not scaled."""
    frames: int
    sum_of_squares: float
    """Of the whitened residuals."""
    variance: float
    """Of a whitened residual, robustly; NaN for two frames, which leave nothing over."""


@dataclass(frozen=True, eq=False)
class FreeFlights:
    """All flights of a measured throw, fitted one by one."""

    sightings: Sightings
    """Without the outliers; every frame has a covariance."""
    flights: tuple[FreeFlight | None, ...]
    """None for a flight of fewer than two frames."""
    variance: float
    """Of a whitened residual over all flights: 1 when the frames' covariances are right."""
    outliers: int
    """Frames left out because they contradict their own flight."""
    noise_estimated: tuple[int, float, float] | None
    """Number of frames without a usable covariance, and the sigmas [m], [rad] that their flights gave them; NaN where
    no flight is long enough to tell, and those frames are then left out."""


def fit_flights(sightings: Sightings, measured: Throw) -> FreeFlights:
    """Fit every flight of a measured throw by itself, from the motion measured there."""
    missing = np.asarray(~np.isfinite(sightings.whitener).all((1, 2)))
    noise = None
    if missing.any():
        sigma_m, sigma_rad = _flight_noise(sightings, measured)
        noise = (int(missing.sum()), sigma_m, sigma_rad)
        if np.isfinite(sigma_m):
            sightings = with_noise(sightings, missing, sigma_m, sigma_rad)
        else:
            sightings = sightings.where(~missing)
    kept = np.ones(len(sightings), bool)
    fits: list[FreeFlight | None] = []
    for k, flight in enumerate(measured.flights):
        fit, kept[sightings.flight == k] = _consistent(sightings.where(sightings.flight == k), flight)
        fits.append(fit)
    return FreeFlights(sightings.where(kept), tuple(fits), _pooled_variance(fits), int((~kept).sum()), noise)


def fit_flight(sightings: Sightings, guess: Flight) -> FreeFlight | None:
    """The exact motion nearest to the frames, started from a guess; None for fewer than two frames."""
    n = len(sightings)
    if n < FEWEST_FRAMES:
        return None
    k2 = CLEAN_FRAME
    state, residuals, jacobian = _nearest(sightings, _start(sightings, guess), k2)
    freedom = 6.0 * (n - 2)
    if freedom and robust_variance(residuals, freedom) > _BAD_START:
        again = _nearest(sightings, _straight_start(sightings, state.time_s), k2)
        if robust_variance(again[1], freedom) < robust_variance(residuals, freedom):
            state, residuals, jacobian = again
    if freedom and (variance := robust_variance(residuals, freedom)) > 1.5:
        # Frames with too small a covariance would all look bad: measure badness in what they really scatter.
        state, residuals, jacobian = _nearest(sightings, state, k2 * variance)
    covariance = np.linalg.pinv(np.einsum("nij,nik->jk", jacobian, jacobian), rcond=1e-15, hermitian=True)
    variance = robust_variance(residuals, freedom) if freedom else np.nan
    flight = Flight(state, guess.end_s, covariance)
    return FreeFlight(flight, n, float((residuals**2).sum()), variance)


def moved_state(state: State, change: Array) -> State:
    """The state displaced by (12,): position, rotation vector, velocity, angular velocity, world axes."""
    return State(
        state.time_s,
        state.position_m + change[:3],
        quat_multiply(quat_from_rotvec(change[3:6]), state.quaternion),
        state.velocity_m_s + change[6:9],
        state.omega_rad_s + change[9:],
    )


def left_jacobian(rotvecs: Array) -> Array:
    """J (..., 3, 3) with exp(v + δ) = exp(J δ) exp(v) for small δ; its limit below 1e-4 rad."""
    angle = np.linalg.norm(rotvecs, axis=-1)[..., None, None]
    safe = np.where(angle > 1e-4, angle, 1.0)
    cross = cross_matrices(rotvecs)
    first = np.where(angle > 1e-4, 2.0 * np.sin(safe / 2.0) ** 2 / safe**2, 0.5)
    # (θ - sin θ)/θ³ still has eight digits at 1e-4 and is multiplied by θ²; below it the limit is exact to 1e-9.
    second = np.where(angle > 1e-4, (safe - np.sin(safe)) / safe**3, 1.0 / 6.0)
    return np.asarray(np.eye(3) + first * cross + second * cross @ cross)


def flight_jacobian(state: State, times_s: Array) -> Array:
    """Derivative (n, 6, 12) of the poses of a flight by its state."""
    dt = times_s - state.time_s
    jacobian = np.zeros((len(dt), 6, 12))
    jacobian[:, :3, :3] = np.eye(3)
    jacobian[:, :3, 6:9] = dt[:, None, None] * np.eye(3)
    turns = np.outer(dt, state.omega_rad_s)
    jacobian[:, 3:, 3:6] = matrix_from_quat(quat_from_rotvec(turns))
    jacobian[:, 3:, 9:] = dt[:, None, None] * left_jacobian(turns)
    return jacobian


def _nearest(sightings: Sightings, start: State, k2: float) -> tuple[State, Array, Array]:
    """The state with least squares, its whitened residuals (n, 6) and their derivative (n, 6, 12)."""
    span = max(float(np.ptp(sightings.time_s)), 1e-9)
    scale = np.repeat([1e-3, 1e-2, 1e-3 / span, 1e-2 / span], 3)

    def evaluate(x: Array) -> tuple[Array, Array]:
        state = moved_state(start, x)
        errors = pose_errors(sightings, *Flight(state, state.time_s).poses(sightings.time_s))
        jacobian = flight_jacobian(state, sightings.time_s)
        # The change is counted from the start, the derivative from where it has led.
        jacobian[:, :, 3:6] = jacobian[:, :, 3:6] @ left_jacobian(x[3:6])
        residuals, jacobian = huber(whitened(sightings, errors), whitened_jacobian(sightings, errors, jacobian), k2)
        return residuals.ravel(), jacobian.reshape(-1, 12)

    free = np.full(12, np.inf)
    state = moved_state(start, descend(evaluate, np.diag(1.0 / scale), -free, free, steps=30))
    errors = pose_errors(sightings, *Flight(state, state.time_s).poses(sightings.time_s))
    jacobian = whitened_jacobian(sightings, errors, flight_jacobian(state, sightings.time_s))
    return state, whitened(sightings, errors), jacobian


def _start(sightings: Sightings, guess: Flight) -> State:
    """The guess where it is finite, else a start from the frames themselves."""
    s = guess.start
    if all(np.isfinite(part).all() for part in (s.position_m, s.quaternion, s.velocity_m_s, s.omega_rad_s)):
        return s
    return _straight_start(sightings, s.time_s)


def _straight_start(sightings: Sightings, time_s: float) -> State:
    """Straight from the first pose to the last, turning as neighbouring frames do in the median."""
    t, p, q = sightings.time_s, sightings.position_m, sightings.quaternion
    dt = t[-1] - t[0]
    velocity = (p[-1] - p[0]) / dt + np.array([0.0, 0.0, 0.5 * GRAVITY_M_S2 * dt])
    turns = rotation_between(q[:-1], q[1:]) / np.diff(t)[:, None]
    first = State(float(t[0]), p[0], q[0], velocity, np.median(turns, axis=0))
    return Flight(first, first.time_s).at(time_s) if np.isfinite(time_s) else first


def _consistent(sightings: Sightings, guess: Flight) -> tuple[FreeFlight | None, NDArray[np.bool_]]:
    """The flight that most frames make, and which of them (n,) agree with it.

    The worst are taken away first and the flight is fitted again: many that err alike, as while the die comes into view,
    bend it so much that the less wrong ones among them do not stand out.
    """
    n = len(sightings)
    kept = np.ones(n, bool)
    whole = fit = fit_flight(sightings, guess)
    if fit is None or n < 5:  # with fewer, an outlier bends the flight more than it stands out from it
        return fit, kept
    for _ in range(_MOST_TRIMS):
        assert fit is not None
        errors = pose_errors(sightings, *fit.flight.poses(sightings.time_s))
        s = (whitened(sightings, errors) ** 2).sum(1)
        agree = s <= _OUTLIER * max(1.0, float(np.median(s[kept])) / MEDIAN_FRAME)
        if (agree == kept).all() or agree.sum() < 5:
            break
        kept = agree
        fit = fit_flight(sightings.where(kept), guess)
    return (fit, kept) if _is_credible(kept) else (whole, np.ones(n, bool))


def _is_credible(kept: NDArray[np.bool_]) -> bool:
    """Whether the frames that were not kept are wrong, rather than the flight: no more than a fifth of them, or, up to a
    half, all of them at one end, where a die comes into view or leaves it."""
    share = float(kept.mean())
    ends = np.flatnonzero(np.diff(kept.astype(int)))
    return share >= 0.8 or (share >= 0.5 and len(ends) == 1)


def _flight_noise(sightings: Sightings, measured: Throw) -> tuple[float, float]:
    """Sigmas [m], [rad] of a frame, one for all axes, from how frames scatter about their own flights; NaN unknown."""
    even = with_noise(sightings, np.ones(len(sightings), bool), *_FIRST_NOISE)
    squares, freedom = np.zeros(2), 0.0
    for k, guess in enumerate(measured.flights):
        mine = even.where(even.flight == k)
        fit = fit_flight(mine, guess)
        if fit is None or len(mine) < 3:
            continue
        errors = pose_errors(mine, *fit.flight.poses(mine.time_s))
        # The median of three squared normal numbers is 2.366: one bad frame must not set the noise of all.
        n = 3.0 * len(mine)
        squares += np.median((errors**2).reshape(-1, 2, 3).sum(2), axis=0) / 2.366 * n
        freedom += n - 6.0
    if freedom <= 0.0:
        return np.nan, np.nan
    sigma_m, sigma_rad = np.maximum(np.sqrt(squares / freedom), [1e-7, 1e-6])
    return float(sigma_m), float(sigma_rad)


def _pooled_variance(fits: Sequence[FreeFlight | None]) -> float:
    """Variance of a whitened residual in most flights: the median, each weighted by its frames; 1 where none has any.

    The median, because a flight in which tracking missed a bounce scatters without measure.
    """
    found = sorted((fit.variance, fit.frames - 2) for fit in fits if fit is not None and fit.frames > 2)
    if not found:
        return 1.0
    share = np.cumsum([weight for _, weight in found])
    return float(found[int(np.searchsorted(share, 0.5 * share[-1]))][0])
