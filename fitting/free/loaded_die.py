"""A loaded die: what free flights show of a centre of mass that is not the centroid.

In flight the centre of mass falls freely and the centroid, which tracking follows, circles about it. With s the centre
of mass from the centroid, in body axes,

    p(t) = p₀ + v t - g t²/2 ẑ - R(t) s.

s is the same in all flights, each of which has twelve parameters of its own: a linear least-squares problem without any
impact law. A die that turns by less than a radian in every flight leaves s undetermined, as its covariance shows.

A flight whose poses are wrong, or that hides a weak impact, departs from a fall as well, and three numbers can follow
such a departure. But what fits one flight does not recur in the others: `MassOffset.consistency` measures that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ...tracking.flights import pose_jacobian
from ..estimation import orthonormal_basis, pose_errors, residual_errors, whitened, whitened_jacobian
from .flights import FreeFlights

Array = NDArray[np.float64]

CENTRE_OF_MASS = ("centre_of_mass_x_m", "centre_of_mass_y_m", "centre_of_mass_z_m")
"""Names of the parameters of a loaded die."""

_OFFSET_NUMBERS = 3
"""Components of an offset."""

_SINGULAR = 1e-9
"""The same for the information of all flights together."""

_OPEN_DIRECTION = 1e-6
"""Singular value of a flight's derivative by the offset, relative to the largest, below which the flight leaves a
direction open."""


@dataclass(frozen=True, eq=False)
class MassOffset:
    """A centre of mass off the centroid, and the evidence for it."""

    centre_of_mass_m: Array
    """(3,) from the centroid, body axes."""
    covariance_m2: Array
    """(3, 3), scaled by the variance of the residuals and their correlation time."""
    gain: float
    """Fall of half the cost, in units of what is left: units of log-likelihood."""
    consistency: float
    """The same fall as a share of that with a separate offset in every flight: near 1 for a loaded die."""

    @property
    def values(self) -> dict[str, float]:
        """As parameters of a fit."""
        return dict(zip(CENTRE_OF_MASS, self.centre_of_mass_m.tolist(), strict=True))


def mass_offset_from_flights(free: FreeFlights) -> MassOffset | None:
    """The centre of mass that the free flights show; None where they leave any direction of it open."""
    residuals, columns, flights = [np.empty((0, 6))], [np.empty((0, 6, _OFFSET_NUMBERS))], [np.empty(0, np.int64)]
    times = [np.empty(0)]
    for k, fit in enumerate(free.flights):
        own = free.observations.where(free.observations.flight == k)
        if fit is None or 6 * len(own) <= 12 + _OFFSET_NUMBERS:
            continue
        errors = pose_errors(own, *fit.flight.poses(own.time_s))
        motion = whitened_jacobian(own, errors, pose_jacobian(fit.flight, own.time_s)).reshape(-1, 12)
        shift = own.whitener[:, :, :3] @ matrix_from_quat(own.quaternion)
        basis = orthonormal_basis(motion, np.diag(np.linalg.norm(motion, axis=0)))
        apart = np.column_stack([whitened(own, errors).ravel(), shift.reshape(-1, _OFFSET_NUMBERS)])
        apart -= basis @ (basis.T @ apart)
        residuals.append(apart[:, 0].reshape(-1, 6))
        columns.append(apart[:, 1:].reshape(-1, 6, _OFFSET_NUMBERS))
        flights.append(own.flight)
        times.append(own.time_s)
    r, c, which = (
        np.concatenate(residuals),
        np.concatenate(columns).reshape(-1, _OFFSET_NUMBERS),
        np.concatenate(flights),
    )
    freedom = r.size - 12 * len(np.unique(which)) - _OFFSET_NUMBERS
    information = c.T @ c
    if freedom <= 0 or np.linalg.eigvalsh(information)[0] < _SINGULAR * np.trace(information):
        return None
    centre = np.linalg.solve(information, -(c.T @ r.ravel())).astype(np.float64)
    left = r + (c @ centre).reshape(-1, 6)
    scale = residual_errors(left, np.concatenate(times), which, _OFFSET_NUMBERS).scale
    fall = float((r**2).sum() - (left**2).sum())
    covariance = np.linalg.inv(information).astype(np.float64) * scale
    return MassOffset(
        centre, covariance, 0.5 * fall / scale, fall / max(_fall_with_separate_offsets(r, c, which), fall)
    )


def _fall_with_separate_offsets(residuals: Array, columns: Array, flight: NDArray[np.int64]) -> float:
    """Fall of the sum of squares with a separate offset in every flight. Directions that a flight leaves open add
    nothing.
    """
    fall = 0.0
    for k in np.unique(flight):
        r = residuals[flight == k].ravel()
        c = columns.reshape(len(residuals), 6, _OFFSET_NUMBERS)[flight == k].reshape(-1, _OFFSET_NUMBERS)
        shift = np.linalg.lstsq(c, r, rcond=_OPEN_DIRECTION)[0]
        fall += float(r @ c @ shift)
    return fall
