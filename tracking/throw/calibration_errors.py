"""Pose errors that all frames share because cameras, die and clock are not known exactly.

A pose is found where the die's picture, as the camera is believed to show it, lies on the frame. If intrinsics, pose of the
camera or edge of the die are in truth others by δ, the die lies elsewhere. To first order, with U the derivative of the pixels
by the pose and V that by the parameters, both of a few points about the die,

    pose found - true pose = U⁺ V δ,

which is exact for the camera's pose, and for the others as far as a die's picture is small. Where a second of the clock lasts
1 + δ true seconds, a frame of time t shows the die where it is at t (1 + δ), and its pose is off by t δ (v, ω).

A single frame shows none of these errors. The flights show some: a die falls along the vertical with g, and touches the table
where it is. All are unknowns of the throw, with priors from what is known (`CalibrationErrors`), and those that no frame can show
widen every covariance. What is known exactly has no unknown.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import cross_matrix, matrix_from_quat, quat_from_rotvec, rotation_between
from ..camera import Camera
from ..covariance import covariance_root
from ..track import CALIBRATION, CLOCK, DIE, SharedErrors, Track

Array = NDArray[np.float64]

INTRINSICS = 9
"""fx, fy, cx, cy [px], k1, k2, p1, p2, k3."""
CAMERA_ERRORS = INTRINSICS + 6
"""The intrinsics, then (δθ [rad], δt [m]) in camera axes: rotation_true = exp(δθ) rotation, and translation_m."""

FOCAL_SHARE = 1e-3
"""Standard error of the focal length where the scene says nothing, as a share of it: that of a careful laboratory."""
CENTRE_SIGMA_PX = 0.5
"""The same of the principal point [px]."""
TURN_SIGMA_RAD = np.radians(0.05)
"""The same of the camera's orientation [rad], about each axis."""
PLACE_SIGMA_M = 3e-4
"""The same of the camera's place over the table [m], along each axis."""
EDGE_SHARE = 1e-3
"""The same of the die's edge, as a share of it."""
CLOCK_SHARE = 1e-5
"""The same of the frame rate, as a share of it: that of a quartz."""

LEAST_SIGMAS = 0.1
"""Length [sigmas of all frames together] below which an error of one standard deviation is left out: no mean over frames
shows it, and beside their noise it widens no covariance."""
POINTS = np.vstack([np.eye(3), -np.eye(3)])
"""(6, 3) directions of the points about the die's centre, at the circumradius."""
STEPS = np.array([0.1, 0.1, 0.1, 0.1, 1e-4, 1e-4, 1e-5, 1e-5, 1e-4, *[1e-5] * 3, *[1e-6] * 3])
"""(15,) steps of the central differences in the parameters of a camera."""


@dataclass(frozen=True, eq=False)
class CalibrationErrors:
    """How well cameras, die and clock are known."""

    cameras: tuple[Camera, ...]
    covariances: tuple[Array, ...]
    """(15, 15) for each camera, in the order of CAMERA_ERRORS; zero where it is exact."""
    edge_share: float
    """Standard error of the die's edge, as a share of it."""
    clock_share: float
    """Standard error of the frame rate, as a share of it."""


EXACT = CalibrationErrors((), (), 0.0, 0.0)
"""Everything is known."""


@dataclass(frozen=True, eq=False)
class UnknownErrors:
    """The errors of a track by what is not known exactly."""

    errors: SharedErrors
    by_camera: Array
    """(15 c, m) change of the parameters of c cameras by one standard deviation of each error."""


@dataclass(frozen=True, eq=False)
class CalibrationEstimate:
    """What a throw shows of the errors of cameras, die and clock."""

    errors: SharedErrors
    """With what the poses have had subtracted: all but the error of the clock, which displaces no frame."""
    covariance: Array
    """(m, m) of the estimate, in the standard deviations of what was known before."""
    clock: float
    """δ, where a second of the clock lasts 1 + δ true seconds."""
    cameras: tuple[Camera, ...]
    """With what the throw shows: the poses lie on their pictures as these cameras show them."""

    @staticmethod
    def of(unknown: UnknownErrors, known: CalibrationErrors, estimate: Array, covariance: Array) -> CalibrationEstimate:
        """From an estimate (m,) of errors and its covariance (m, m); both empty where the throw contradicts what is known, and
        nothing is estimated."""
        errors, m = unknown.errors, len(unknown.errors.sources)
        if not len(estimate):
            return CalibrationEstimate(errors, np.eye(m), 0.0, known.cameras)
        is_clock = np.array([source == CLOCK for source in errors.sources], bool)
        subtracted = np.where(is_clock, 0.0, estimate)
        clock = known.clock_share * float(estimate[is_clock].sum())
        changes = (unknown.by_camera @ estimate).reshape(-1, CAMERA_ERRORS)
        cameras = tuple(displaced(camera, change) for camera, change in zip(known.cameras, changes, strict=True))
        return CalibrationEstimate(replace(errors, subtracted=subtracted), covariance, clock, cameras)

    @property
    def pose_covariances(self) -> Array:
        """(n, 6, 6) of the errors that remain in the poses; 0 without a pose."""
        jacobian = np.nan_to_num(self.errors.jacobian)
        return np.asarray(jacobian @ self.covariance @ np.swapaxes(jacobian, 1, 2))

    def at_frames(self, track: Track) -> Track:
        """The track with the true instants of its frames."""
        if self.clock == 0.0:
            return track
        return replace(track, time_s=track.time_s + self.clock * (track.time_s - _middle_s(track)))


def usual_covariance(camera: Camera) -> Array:
    """(15, 15) covariance of a camera's parameters as a careful laboratory knows them. Both focal lengths share their error:
    pixels are squares."""
    covariance = np.zeros((CAMERA_ERRORS, CAMERA_ERRORS))
    focal = np.array([camera.matrix[0, 0], camera.matrix[1, 1]])
    covariance[:2, :2] = FOCAL_SHARE**2 * np.outer(focal, focal)
    sigmas = np.repeat([CENTRE_SIGMA_PX, TURN_SIGMA_RAD, PLACE_SIGMA_M], [2, 3, 3])
    which = [2, 3, *range(INTRINSICS, CAMERA_ERRORS)]
    covariance[which, which] = sigmas**2
    return covariance


def unknown_errors(known: CalibrationErrors, track: Track, die: Die) -> UnknownErrors:
    """The errors of a track by what is not known exactly. Those that move no pose by as much as the frames can show are left out.
    Rows without a pose are NaN."""
    use = np.flatnonzero(track.tracked)
    found, sources = [np.zeros((len(use), 6, 0))], []
    parameters = CAMERA_ERRORS * len(known.cameras)
    by_camera = np.zeros((parameters, 0))
    if known.edge_share or any(bool(covariance.any()) for covariance in known.covariances):
        change, by_edge = _changes(known.cameras, track.position_m[use], die)
        root = np.zeros((parameters, parameters))
        for k, covariance in enumerate(known.covariances):
            own = slice(k * CAMERA_ERRORS, (k + 1) * CAMERA_ERRORS)
            root[own, own] = _scaled_root(covariance)
        by_camera = root @ _principal(change @ root, track.covariance[use])
        found.append(change @ by_camera)
        sources += [CALIBRATION] * by_camera.shape[1]
        if known.edge_share:
            found.append(known.edge_share * by_edge)
            sources.append(DIE)
    if known.clock_share and len(use) > 1:
        found.append(known.clock_share * _by_clock(track, use)[:, :, None])
        sources.append(CLOCK)
    jacobian = np.full((len(track), 6, len(sources)), np.nan)
    jacobian[use] = np.concatenate(found, axis=2)
    others = np.zeros((parameters, len(sources) - by_camera.shape[1]))
    return UnknownErrors(SharedErrors(jacobian, tuple(sources), np.zeros(len(sources))), np.hstack([by_camera, others]))


def _scaled_root(covariance: Array) -> Array:
    """L with L Lᵀ a covariance whose parameters have units of their own."""
    unit = np.sqrt(np.diag(covariance))
    safe = np.where(unit > 0.0, unit, 1.0)
    return np.asarray(unit[:, None] * covariance_root(covariance / np.outer(safe, safe)))


def _principal(changes: Array, covariance: Array) -> Array:
    """Orthonormal mixtures (k, m) of independent errors that change poses by (n, 6, k), the largest first, without those below
    LEAST_SIGMAS; frames have covariances (n, 6, 6)."""
    sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
    known = np.isfinite(sigma).all(axis=1) & (sigma > 0.0).all(axis=1)
    whitened = (changes[known] / sigma[known][:, :, None]).reshape(-1, changes.shape[2])
    values, vectors = np.linalg.eigh(whitened.T @ whitened)
    return np.asarray(vectors[:, np.flatnonzero(values > LEAST_SIGMAS**2)[::-1]])


def _changes(cameras: tuple[Camera, ...], position_m: Array, die: Die) -> tuple[Array, Array]:
    """Changes of poses at (n, 3) by the parameters of c cameras (n, 6, 15 c), and by the share of the edge (n, 6, 1)."""
    size = die.solid.circumradius
    points = position_m[:, None] + size * POINTS
    n, count = len(points), len(cameras)
    by_pose, by_edge = np.empty((n, count, 2 * len(POINTS), 6)), np.empty((n, count, 2 * len(POINTS), 1))
    by_camera = np.zeros((n, count, 2 * len(POINTS), CAMERA_ERRORS * count))
    # A turn by δθ about the centre moves a point at r by δθ × r.
    turned = -cross_matrix(size * POINTS)
    for c, camera in enumerate(cameras):
        by_point = _by_point(camera, points)
        by_pose[:, c, :, :3] = by_point.reshape(n, -1, 3)
        by_pose[:, c, :, 3:] = (by_point @ turned).reshape(n, -1, 3)
        by_edge[:, c] = (by_point @ (size * POINTS)[:, :, None]).reshape(n, -1, 1)
        own = slice(c * CAMERA_ERRORS, (c + 1) * CAMERA_ERRORS)
        for j, step in enumerate(np.diag(STEPS)):
            ahead, behind = (displaced(camera, sign * step).project(points) for sign in (1.0, -1.0))
            by_camera[:, c, :, own][:, :, j] = ((ahead - behind) / (2.0 * STEPS[j])).reshape(n, -1)
    # Turns in units of the size, so that all columns of U are of one kind.
    unit = np.repeat([1.0, 1.0 / size], 3)
    U = by_pose.reshape(n, -1, 6) * unit
    V = np.concatenate([by_camera, by_edge], axis=3).reshape(n, U.shape[1], -1)
    transposed = np.swapaxes(U, 1, 2)
    change = unit[:, None] * np.linalg.solve(transposed @ U, transposed @ V)
    return change[:, :, :-1], change[:, :, -1:]


def _by_point(camera: Camera, points_m: Array) -> Array:
    """(..., 2, 3) derivative of the pixels of points (..., 3) by the points, by central differences."""
    step = 1e-6
    sides = [camera.project(points_m + sign * step * axis) for axis in np.eye(3) for sign in (1.0, -1.0)]
    return np.stack([(sides[2 * k] - sides[2 * k + 1]) / (2.0 * step) for k in range(3)], axis=-1)


def displaced(camera: Camera, change: Array) -> Camera:
    """The camera with its parameters changed by (15,), in the order of CAMERA_ERRORS."""
    matrix = camera.matrix.copy()
    matrix[[0, 1, 0, 1], [0, 1, 2, 2]] += change[:4]
    turn = matrix_from_quat(quat_from_rotvec(change[INTRINSICS : INTRINSICS + 3]))
    return replace(
        camera,
        matrix=matrix,
        distortion=camera.distortion + change[4:INTRINSICS],
        rotation=turn @ camera.rotation,
        translation_m=camera.translation_m + change[INTRINSICS + 3 :],
    )


def _middle_s(track: Track) -> float:
    """The instant that a wrong rate leaves as it is."""
    return float(track.time_s[track.tracked].mean())


def _by_clock(track: Track, use: NDArray[np.int64]) -> Array:
    """(n, 6) change of the poses of some rows by the share by which the true seconds are longer, from differences between
    neighbours."""
    time_s, n = track.time_s[use], len(use)
    before, behind = np.maximum(np.arange(n) - 1, 0), np.minimum(np.arange(n) + 1, n - 1)
    apart_s = (time_s[behind] - time_s[before])[:, None]
    q, p = track.quaternion[use], track.position_m[use]
    rates = np.hstack([p[behind] - p[before], rotation_between(q[before], q[behind])]) / apart_s
    return np.asarray(rates * (time_s - _middle_s(track))[:, None])
