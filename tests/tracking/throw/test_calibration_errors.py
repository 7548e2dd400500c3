"""Laws of the errors by cameras, die and clock that are known only so far."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import studio
from numpy.typing import NDArray
from scipy.optimize import least_squares
from throws import FPS, random_release, seen, true_throw

from diethrow.model.die.die import make_die
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec, quat_multiply, rotation_between
from diethrow.model.throw.motion import Throw
from diethrow.tracking.camera import Camera
from diethrow.tracking.covariance import covariance_root
from diethrow.tracking.throw.calibration_errors import (
    CAMERA_ERRORS,
    EXACT,
    INTRINSICS,
    CalibrationErrors,
    displaced,
    unknown_errors,
    usual_covariance,
)
from diethrow.tracking.throw.measurement import measure
from diethrow.tracking.track import CALIBRATION, CLOCK, DIE, Track

Array = NDArray[np.float64]

CUBE = make_die("cube", 0.016, 0.0048)
CAMERA = studio(384, 384, 2000.0, 0.5).camera
NAMES = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "turn x", "turn y", "turn z", "x", "y", "z")
SIZES = np.array([2.0, 2.0, 0.5, 0.5, 0.01, 0.1, 1e-4, 1e-4, 1.0, *[1e-3] * 3, *[3e-4] * 3])
"""Errors of a calibration, one of each kind."""


def found_poses(throw: Throw, times_s: Array, true: Camera, edge_share: float = 0.0) -> tuple[Array, Array]:
    """Poses (n, 3), (n, 4) at which CAMERA shows the corners of CUBE where the true camera shows those of a die whose edge is
    longer by a share: by least squares in the picture."""
    corners = CUBE.solid.vertices
    positions, quaternions = throw.poses(times_s)
    for k, R in enumerate(matrix_from_quat(quaternions)):
        pixels = true.project((1.0 + edge_share) * corners @ R.T + positions[k])

        def off(x: Array, R: Array, p: Array, pixels: Array) -> Array:
            turned = matrix_from_quat(quat_from_rotvec(1e-3 * x[3:])) @ R
            return (CAMERA.project(corners @ turned.T + p + 1e-3 * x[:3]) - pixels).ravel()

        fixed = (R, positions[k].copy(), pixels)
        x = least_squares(off, np.zeros(6), method="lm", xtol=1e-14, ftol=1e-14, args=fixed).x
        positions[k] += 1e-3 * x[:3]
        quaternions[k] = quat_multiply(quat_from_rotvec(1e-3 * x[3:]), quaternions[k])
    return positions, quaternions


def some_throw(seed: int = 3, impacts: int = 2) -> Throw:
    return true_throw(CUBE, random_release(CUBE, np.random.default_rng(seed)), 0.6, impacts=impacts)


def change_of(track: Track, positions: Array, quaternions: Array) -> Array:
    """(n, 6) from the poses of a track to others."""
    return np.hstack([positions - track.position_m, rotation_between(track.quaternion, quaternions)])


@pytest.mark.parametrize("which", range(CAMERA_ERRORS), ids=NAMES)
def test_a_camera_that_is_off_displaces_poses_as_stated(which: int) -> None:
    throw = some_throw()
    track = seen(throw, np.random.default_rng(1), noise=1e-4)
    variance = np.zeros(CAMERA_ERRORS)
    variance[which] = SIZES[which] ** 2
    found = unknown_errors(CalibrationErrors((CAMERA,), (np.diag(variance),), 0.0, 0.0), track, CUBE).errors
    assert found.sources == (CALIBRATION,)
    rows = np.arange(0, len(track), 12)
    change = np.zeros(CAMERA_ERRORS)
    change[which] = SIZES[which]
    poses = found_poses(throw, track.time_s[rows], displaced(CAMERA, change))
    wanted = change_of(some(track, rows), *poses)
    stated = found.jacobian[rows, :, 0] * np.sign((found.jacobian[rows, :, 0] * wanted).sum())
    size = np.abs(wanted).max(axis=0)
    # A rigid displacement is exact to first order. What the corners of a cube show of a lens differs a little from what points
    # about it show: they lie at other places of the picture.
    allowed = 0.002 if which >= INTRINSICS else 0.005 if which < 4 else 0.05
    # A turn of a die by so much moves its corners as far as a shift by so much.
    shift_m = max(float(size[:3].max()), 0.5 * CUBE.solid.circumradius * float(size[3:].max()))
    scale = np.repeat([shift_m, shift_m / CUBE.solid.circumradius], 3)
    assert (np.abs(stated - wanted) <= allowed * scale).all()


def some(track: Track, rows: NDArray[np.int64]) -> Track:
    """Some rows of a track."""
    return Track(
        *(
            getattr(track, name)[rows]
            for name in ("frame", "time_s", "position_m", "quaternion", "covariance", "status")
        )
    )


def test_a_longer_edge_looks_nearer_and_a_fast_clock_ahead() -> None:
    throw = some_throw()
    track = seen(throw, np.random.default_rng(1), noise=1e-4)
    found = unknown_errors(CalibrationErrors((CAMERA,), (np.zeros((15, 15)),), 1e-3, 1e-4), track, CUBE).errors
    assert found.sources == (DIE, CLOCK)
    rows = np.arange(0, len(track), 20)
    by_edge = change_of(some(track, rows), *found_poses(throw, track.time_s[rows], CAMERA, 1e-3))
    # A die that is larger by a share looks nearer by that share of its distance.
    away = throw.poses(track.time_s[rows])[0] - CAMERA.centre_m
    np.testing.assert_allclose(by_edge[:, :3], -1e-3 * away, atol=2e-6)
    np.testing.assert_allclose(found.jacobian[rows, :3, 0], -1e-3 * away, rtol=0.02, atol=2e-6)
    clear = np.array([np.abs(track.time_s - impact.time_s).min() for impact in throw.impacts])
    assert clear.max() < 1.0 / FPS
    near = np.min([np.abs(track.time_s - impact.time_s) for impact in throw.impacts], axis=0) < 1.5 / FPS
    shift_s = 1e-4 * (track.time_s - track.time_s.mean())
    ahead = change_of(some(track, np.flatnonzero(~near)), *throw.poses((track.time_s + shift_s)[~near]))
    moved = np.hstack([found.jacobian[~near, :3, 1], found.jacobian[~near, 3:, 1]])
    noise_free = change_of(some(track, np.flatnonzero(~near)), *throw.poses(track.time_s[~near]))
    np.testing.assert_allclose(moved, ahead - noise_free, atol=3e-6)


def test_what_is_exact_has_no_unknown() -> None:
    track = seen(some_throw(), np.random.default_rng(1))
    assert unknown_errors(EXACT, track, CUBE).errors.sources == ()
    exact = CalibrationErrors((CAMERA,), (np.zeros((15, 15)),), 0.0, 0.0)
    with_exact, plain = (measure(track, CUBE, CAMERA, known=known) for known in (exact, None))
    np.testing.assert_array_equal(with_exact.smoothed_frames.position_m, plain.smoothed_frames.position_m)
    np.testing.assert_array_equal(with_exact.smoothed_frames.covariance, plain.smoothed_frames.covariance)
    assert with_exact.independent_frames.shared_errors is None


def test_poses_lie_on_their_pictures_as_the_estimated_camera_shows_them() -> None:
    rng = np.random.default_rng(8)
    throw, usual = some_throw(8), usual_covariance(CAMERA)
    # A camera that is off by far more than usual, which the fall shows: seen from the true one, off poses lie beside the truth.
    true = displaced(CAMERA, 2.0 * covariance_root(usual) @ rng.standard_normal(15))
    track = seen(throw, rng, noise=0.1)
    every = np.arange(0, len(track), 4)
    positions, quaternions = found_poses(throw, track.time_s[every], true)
    few = replace(some(track, every), position_m=positions, quaternion=quaternions)
    known = CalibrationErrors((CAMERA,), (usual,), 0.0, 0.0)
    found = measure(few, CUBE, CAMERA, known=known)
    corners = CUBE.solid.vertices

    def pixels(camera: Camera, track: Track) -> Array:
        return camera.project(
            corners @ np.swapaxes(matrix_from_quat(track.quaternion), 1, 2) + track.position_m[:, None]
        )

    seen_px = pixels(CAMERA, few)
    off_px, on_px = (
        np.abs(pixels(camera, found.frames) - seen_px) for camera in (CAMERA, found.calibration.cameras[0])
    )
    # The contour's own error, which is estimated as well, moves poses by some hundredths of a pixel.
    assert np.median(off_px) > 10.0 * np.median(on_px)
    assert np.median(on_px) < 0.1


def test_two_cameras_leave_less_open_than_one() -> None:
    other = displaced(CAMERA, np.zeros(15))
    turn = matrix_from_quat(quat_from_rotvec(np.array([0.0, 0.0, 1.2])))
    other = replace(other, rotation=CAMERA.rotation @ turn)
    track = seen(some_throw(), np.random.default_rng(1))
    usual = [usual_covariance(camera) for camera in (CAMERA, other)]

    def variances(cameras: tuple[Camera, ...], covariances: list[Array]) -> Array:
        found = unknown_errors(CalibrationErrors(cameras, tuple(covariances), 0.0, 0.0), track, CUBE).errors
        squares = (found.jacobian**2).sum(axis=2).mean(axis=0)
        return np.array([squares[:3].sum(), squares[3:].sum()])

    assert (variances((CAMERA, other), usual) < 0.8 * variances((CAMERA,), usual[:1])).all()


def test_errors_drawn_from_what_is_stated_lie_within_the_covariances() -> None:
    nees, without, of_errors = [], [], []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        throw = some_throw(seed)
        usual = usual_covariance(CAMERA)
        change = covariance_root(usual) @ rng.standard_normal(15)
        edge_share = 1e-3 * float(rng.standard_normal())
        true = displaced(CAMERA, change)
        track = seen(throw, rng)
        every = np.arange(0, len(track), 4)
        exact_p, exact_q = throw.poses(track.time_s[every])
        off_p, off_q = found_poses(throw, track.time_s[every], true, edge_share)
        few = some(track, every)
        turn = rotation_between(exact_q, off_q)
        few = replace(
            few,
            position_m=few.position_m + off_p - exact_p,
            quaternion=quat_multiply(quat_from_rotvec(turn), few.quaternion),
        )
        known = CalibrationErrors((CAMERA,), (usual,), 1e-3, 0.0)
        for errors, distances in ((known, nees), (None, without)):
            smoothed = measure(few, CUBE, CAMERA, known=errors).smoothed_frames
            off = change_of(smoothed, exact_p, exact_q)
            squares = np.einsum("ni,nij,nj->n", off, np.linalg.inv(smoothed.covariance), off)
            distances.append(float(np.median(squares)))
        of_errors.append(len(measure(few, CUBE, CAMERA, known=known).calibration.errors.sources))
    # A mean of twenty χ² of six numbers each has a standard deviation of 0.8; poses of one clip are one draw.
    assert 3.5 < np.mean(nees) < 9.0
    assert np.mean(without) > 30.0
    assert min(of_errors) >= 3
