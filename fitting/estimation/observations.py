"""Observations of a fit: the frames that show the die in free flight, each with its weight.

A residual is the observed minus the modelled pose: position [m], then the rotation vector [rad] from the modelled to
the observed orientation, in world axes. It is whitened with W, where Wᵀ W is the inverse of the frame's 6 × 6
covariance. Its six numbers then have unit variance and no correlation if covariance and model are right.

A frame is an average over its exposure, which lasts at most one frame interval. A frame closer than half an interval to
an impact may blend two flights and show a pose that the die never had; such frames are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from ...model.rotations import cross_matrix, rotation_between
from ...model.throw import Throw
from ...tracking.track import SharedErrors, Track

Array = NDArray[np.float64]

UNRESOLVED_FRAMES = 1.5
"""Frames on either side of an unresolved contact that may lie between the impacts hidden in it."""

_CLEARANCE_FRAMES = 0.5
"""Frame intervals between a usable frame and an impact: half, the longest exposure on one side of mid-exposure."""

_MIN_CORRELATION_EIGENVALUE = 1e-9
"""Smallest eigenvalue of a usable frame's correlation matrix; below it the covariance is singular to rounding."""

_SIGMA_FLOOR = np.array([1e-7] * 3 + [1e-6] * 3)
"""[m, rad] Smallest sigma estimated: a track printed with seven digits carries no smaller one."""


@dataclass(frozen=True, eq=False)
class FlightObservations:
    """Frames with a pose, in free flight, in order of time."""

    time_s: Array
    """(n,) of mid-exposure."""
    position_m: Array
    """(n, 3)."""
    quaternion: Array
    """(n, 4) wxyz."""
    whitener: Array
    """(n, 6, 6) W with Wᵀ W the inverse covariance; NaN where the track has no usable covariance."""
    flight: NDArray[np.int64]
    """(n,) index of the measured flight that contains the frame."""
    interval_s: float
    """Between frames of the track."""
    shared: SharedErrors | None = None
    """Errors of these frames by cameras, die and clock; None where these are exact."""
    shared_weight: float = 1.0
    """Of the prior of these errors: what multiplies the covariances of a fit to these frames."""

    def __len__(self) -> int:
        return len(self.time_s)

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.int64]) -> FlightObservations:
        """The chosen frames alone, by mask or by index."""
        return replace(
            self,
            time_s=self.time_s[chosen],
            position_m=self.position_m[chosen],
            quaternion=self.quaternion[chosen],
            whitener=self.whitener[chosen],
            flight=self.flight[chosen],
            shared=None if self.shared is None else self.shared.rows(chosen),
        )

    def count(self, flight: int) -> int:
        """Number of frames of one flight."""
        return int((self.flight == flight).sum())


def flight_observations(track: Track, measured: Throw) -> FlightObservations:
    """The usable frames of a track: tracked, finite, explained by a flight, and clear of every measured impact.

    Raises ValueError if the columns of the track have different lengths.
    """
    n = len(track)
    columns = (track.time_s, track.position_m, track.quaternion, track.covariance)
    shapes = [np.shape(column) for column in columns]
    if shapes != [(n,), (n, 3), (n, 4), (n, 6, 6)]:
        raise InputError(f"track columns of shapes {shapes}: wanted ({n},), ({n}, 3), ({n}, 4) and ({n}, 6, 6)")
    interval = float(np.median(np.diff(track.time_s))) if n > 1 else 0.0
    poses = np.hstack([track.position_m, track.quaternion])
    usable = track.tracked & np.isfinite(poses).all(1) & np.isfinite(track.time_s)
    if track.unexplained is not None:
        usable &= ~track.unexplained
    for impact in measured.impacts:
        frames = UNRESOLVED_FRAMES if impact.contact == "unresolved" else _CLEARANCE_FRAMES
        usable &= np.abs(track.time_s - impact.time_s) >= frames * interval
    times = track.time_s[usable]
    flights = measured.flights_at(times)
    weights = whiteners(track.covariance[usable])
    shared = None if track.shared_errors is None else track.shared_errors.rows(usable)
    usable_frames = FlightObservations(
        times, track.position_m[usable], track.quaternion[usable], weights, flights, interval, shared
    )
    return usable_frames.where(np.argsort(times, kind="stable"))


def whiteners(covariance: Array) -> Array:
    """W (n, 6, 6) of covariances (n, 6, 6), NaN where one is not finite or not positive definite."""
    found = np.full(covariance.shape, np.nan)
    for k, matrix in enumerate(covariance):
        if not np.isfinite(matrix).all():
            continue
        sigma = np.sqrt(np.clip(np.diag(matrix), 0.0, None))
        if not (sigma > 0.0).all():
            continue
        # Eigenvalues of the correlation matrix: in the covariance, metres and radians hide what is singular.
        values = np.linalg.eigvalsh(matrix / np.outer(sigma, sigma))
        if values[0] > _MIN_CORRELATION_EIGENVALUE:
            found[k] = np.linalg.inv(np.linalg.cholesky(matrix))
    return found


def with_noise(
    observations: FlightObservations, missing: NDArray[np.bool_], sigma_m: float, sigma_rad: float
) -> FlightObservations:
    """The same frames, with isotropic noise where `missing` (n,)."""
    sigma = np.maximum([sigma_m] * 3 + [sigma_rad] * 3, _SIGMA_FLOOR)
    filled = observations.whitener.copy()
    filled[missing] = np.diag(1.0 / sigma)
    return replace(observations, whitener=filled)


def pose_errors(observations: FlightObservations, positions: Array, quaternions: Array) -> Array:
    """Observed minus modelled poses (n, 6): position [m], rotation vector [rad], world axes; not whitened."""
    return np.hstack([observations.position_m - positions, rotation_between(quaternions, observations.quaternion)])


def whitened(observations: FlightObservations, errors: Array) -> Array:
    """Errors (n, 6) in units of their sigmas."""
    return np.einsum("nij,nj->ni", observations.whitener, errors)


def whitened_jacobian(observations: FlightObservations, errors: Array, jacobian: Array) -> Array:
    """Derivative (n, 6, m) of the whitened errors, from that of the modelled poses (n, 6, m).

    A modelled pose turned by δ leaves log(exp(e) exp(-δ)) = e - J⁻¹ δ, with J⁻¹ = 1 + [e]×/2 + [e]×²/12 + O(e⁴) the
    inverse right Jacobian. For the 0.5 rad of the worst initial guess the next term is 1e-4.
    """
    cross = cross_matrix(errors[:, 3:])
    turn = np.eye(3) + cross / 2.0 + cross @ cross / 12.0
    observed = np.concatenate([jacobian[:, :3], turn @ jacobian[:, 3:]], axis=1)
    return -observations.whitener @ observed
