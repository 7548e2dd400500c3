"""What free flights say of a centre of mass that is not the centroid: a loaded die.

In flight the centre of mass falls freely and the centroid, which tracking follows, circles about it. With s the centre of
mass from the centroid, in the body,

    p(t) = p₀ + v t - g t²/2 ẑ - R(t) s.

s is the same in all flights, each of which has twelve numbers of its own: a linear least squares, which no law of impact
enters. A die that turns by less than a radian in any flight leaves s open, and shows so by its covariance.

A flight whose poses are wrong, or that hides a weak impact, departs from a fall as well, and three numbers bend far enough to
follow it. But what bends one flight is then no part of the others: `Load.agreed` tells how far they bear each other out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import matrix_from_quat
from ..estimation import orthonormal, pose_errors, variance_inflation, whitened, whitened_jacobian
from .flights import FreeFlights, flight_jacobian

Array = NDArray[np.float64]

_SHIFT = 3
"""Numbers of a shift."""

_OPEN = 1e-6
"""Direction of a shift that a flight says nothing of, as a share of the one that it shows best."""


@dataclass(frozen=True, eq=False)
class Load:
    """A centre of mass off the centroid, and the evidence for it."""

    centre_of_mass_m: Array
    """(3,) from the centroid, body axes."""
    covariance_m2: Array
    """(3, 3), with the scatter of the frames and the frames over which they are alike."""
    gain: float
    """Fall of half the cost, in units of what is left over: units of log-likelihood."""
    agreed: float
    """The same fall as a share of what it would be with a load of its own in every flight: near 1 for a die that has one."""

    @property
    def values(self) -> dict[str, float]:
        """As parameters of a fit."""
        return dict(zip(LOAD, self.centre_of_mass_m.tolist(), strict=True))


LOAD = ("centre_of_mass_x_m", "centre_of_mass_y_m", "centre_of_mass_z_m")


def load_in_flight(free: FreeFlights) -> Load | None:
    """The centre of mass that the free flights show; None where they leave any direction of it open."""
    residuals, columns, flights = [np.empty((0, 6))], [np.empty((0, 6, _SHIFT))], [np.empty(0, np.int64)]
    for k, fit in enumerate(free.flights):
        own = free.sightings.where(free.sightings.flight == k)
        if fit is None or 6 * len(own) <= 12 + _SHIFT:
            continue
        errors = pose_errors(own, *fit.flight.poses(own.time_s))
        motion = whitened_jacobian(own, errors, flight_jacobian(fit.flight.start, own.time_s)).reshape(-1, 12)
        shift = own.whitener[:, :, :3] @ matrix_from_quat(own.quaternion)
        basis = orthonormal(motion, np.diag(np.linalg.norm(motion, axis=0)))
        apart = np.column_stack([whitened(own, errors).ravel(), shift.reshape(-1, _SHIFT)])
        apart -= basis @ (basis.T @ apart)
        residuals.append(apart[:, 0].reshape(-1, 6))
        columns.append(apart[:, 1:].reshape(-1, 6, _SHIFT))
        flights.append(own.flight)
    r, c, which = np.concatenate(residuals), np.concatenate(columns).reshape(-1, _SHIFT), np.concatenate(flights)
    freedom = r.size - 12 * len(np.unique(which)) - _SHIFT
    information = c.T @ c
    if freedom <= 0 or np.linalg.eigvalsh(information)[0] < 1e-9 * np.trace(information):
        return None
    centre = np.linalg.solve(information, -(c.T @ r.ravel())).astype(np.float64)
    left = r + (c @ centre).reshape(-1, 6)
    variance, tau = variance_inflation(left, freedom, which)
    scale = variance * tau
    fall = float((r**2).sum() - (left**2).sum())
    covariance = np.linalg.inv(information).astype(np.float64) * scale
    return Load(centre, covariance, 0.5 * fall / scale, fall / max(_fall_apart(r, c, which), fall))


def _fall_apart(residuals: Array, columns: Array, flight: NDArray[np.int64]) -> float:
    """By how much the sum of squares falls with a shift of its own in every flight. Directions that a flight leaves open gain
    it nothing."""
    fall = 0.0
    for k in np.unique(flight):
        r = residuals[flight == k].ravel()
        c = columns.reshape(len(residuals), 6, _SHIFT)[flight == k].reshape(-1, _SHIFT)
        shift = np.linalg.lstsq(c, r, rcond=_OPEN)[0]
        fall += float(r @ c @ shift)
    return fall
