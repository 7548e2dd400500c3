"""How evenly poses move: as a die in flight does, on a parabola and with an even rotation, or not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.rotations import quat_from_matrix, rotation_between
from ...model.throw import turning_of
from ..flights import WeightedPoses, fit_flight
from ..picture import View
from .clip_poses import ClipPoses
from .refine import covariances, weak_priors
from .refine_kernels import seen_distance_m

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

UNEVEN = 1.0
"""Unevenness from which a motion is that of no die in flight."""
UNEVEN_EDGES = 0.1
"""Rms departure from a parabola as the camera sees it, in edges, that no die in flight shows. A wrong hypothesis jumps, and so
does a pose drawn into a shadow."""
UNEVEN_SIGMAS = 2.0
"""Standard errors of the poses that count as much as these: what a picture leaves open is no departure."""
UNEVEN_RAD = np.radians(1.5)
"""Rms departure [rad] from an even rotation that no die in flight shows."""


def log_scatter(view: View, poses: ClipPoses, times_s: Array, rows: Rows) -> float:
    """Logarithm of the residual standard deviation of the poses on some rows about one flight, in units of their standard errors;
    0 at the least, and where fewer than three pictures determine a pose."""
    covariance = covariances(poses.H[rows, :6, :6])
    determined = np.isfinite(covariance[:, 0, 0])
    rows, covariance = rows[determined], covariance[determined]
    if len(rows) < 3:
        return 0.0
    position_m, quaternion = poses.position_m[rows], quat_from_matrix(poses.rotation[rows])
    exposed_s = times_s[rows] + view.exposure_delay_s(position_m)
    seen = WeightedPoses.from_poses(
        exposed_s, position_m, quaternion, covariance, gravity_m_s2=view.gravity_m_s2, turning=turning_of(view.die)
    )
    _, _, chi2 = fit_flight(seen)
    return 0.5 * float(np.log(max(chi2 / (6 * len(rows) - 12), 1.0)))


def unevenness(view: View, poses: ClipPoses, times_s: Array, since: int, until: int) -> float:
    """Departure of the poses from row `since` to before `until` from a parabola and an even rotation; UNEVEN if no die in flight
    moves like that."""
    known = since + np.flatnonzero(poses.known[since:until])
    if len(known) < 3:
        return 0.0
    middle = int(known[len(known) // 2])
    times_s = times_s[: len(poses.known)] + view.exposure_delay_s(poses.position_m)
    t = times_s[known] - times_s[middle]
    without_fall = poses.position_m[known] + np.outer(0.5 * view.gravity_m_s2 * t * t, [0.0, 0.0, 1.0])
    turns = rotation_between(quat_from_matrix(poses.rotation[middle]), quat_from_matrix(poses.rotation[known]))
    sigma_m, sigma_rad = _standard_errors(view, poses, known)
    off_m, p = _off_line(t, without_fall), poses.position_m[known]
    seen_m = np.array([seen_distance_m(view.rig, at, step, view.reach_m) for at, step in zip(p, off_m, strict=True)])
    turned = np.linalg.norm(_off_line(t, turns), axis=1)
    usual_m, usual_rad = UNEVEN_EDGES * view.die.solid.edge_m, UNEVEN_RAD
    return max(_rms(seen_m / np.hypot(usual_m, sigma_m)), _rms(turned / np.hypot(usual_rad, sigma_rad)))


def _standard_errors(view: View, poses: ClipPoses, rows: Rows) -> tuple[Array, Array]:
    """Standard errors of the poses on some rows (n,), across the line of sight [m] and of the rotation [rad], times
    UNEVEN_SIGMAS."""
    camera = view.camera
    covariance = np.linalg.inv(poses.H[rows, :6, :6] + weak_priors(view, poses.position_m[rows]))
    sight = poses.position_m[rows] - camera.centre_m
    sight /= np.linalg.norm(sight, axis=1)[:, None]
    across = np.trace(covariance[:, :3, :3], axis1=1, axis2=2) - np.einsum(
        "ni,nij,nj->n", sight, covariance[:, :3, :3], sight
    )
    turned = np.trace(covariance[:, 3:, 3:], axis1=1, axis2=2)
    return UNEVEN_SIGMAS * np.sqrt(across), UNEVEN_SIGMAS * np.sqrt(turned)


def _off_line(t: Array, values: Array) -> Array:
    """(n, 3) differences of values (n, 3) from the straight line over t (n,) that fits them best."""
    return np.asarray(values - np.stack([np.ones_like(t), t], 1) @ np.polynomial.polynomial.polyfit(t, values, 1))


def _rms(values: Array) -> float:
    return float(np.sqrt((values**2).mean()))
