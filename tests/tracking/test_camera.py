"""Laws of the camera: OpenCV's, to rounding."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from footage_of_throws import studio

from diethrow.tracking.camera import Camera

CAMERA = studio().camera
DISTORTIONS = {
    "none": (0.0, 0.0, 0.0, 0.0, 0.0),
    "barrel": (-0.25, 0.08, 0.0, 0.0, -0.01),
    "pincushion": (0.3, -0.1, 0.0, 0.0, 0.02),
    "decentred": (0.0, 0.0, 3e-3, -2e-3, 0.0),
    "all": (-0.2, 0.05, 1e-3, 2e-3, -0.02),
}


def with_lens(name: str, skew: float = 0.0) -> Camera:
    matrix = CAMERA.matrix.copy()
    matrix[0, 1] = skew
    matrix[1, 1] *= 1.01
    return replace(CAMERA, matrix=matrix, distortion=np.array(DISTORTIONS[name]))


@pytest.mark.parametrize("name", DISTORTIONS)
def test_points_fall_where_opencv_puts_them(name: str) -> None:
    camera = with_lens(name)
    points = np.random.default_rng(0).uniform(-0.08, 0.08, (200, 3))
    turn, _ = cv2.Rodrigues(camera.rotation)
    theirs, _ = cv2.projectPoints(points, turn, camera.translation_m, camera.matrix, camera.distortion)
    # Both in double precision; the rotation goes through a vector of three numbers and back.
    np.testing.assert_allclose(camera.project(points), theirs[:, 0], atol=1e-9)


def test_a_point_behind_the_camera_has_no_pixel() -> None:
    ahead, behind = (CAMERA.centre_m + sign * 0.1 * CAMERA.rotation[2] for sign in (1.0, -1.0))
    assert np.isfinite(CAMERA.project(ahead)).all()
    assert np.isnan(CAMERA.project(behind)).all()
    assert np.isnan(CAMERA.project(CAMERA.centre_m)).all()


def test_projecting_many_is_projecting_each() -> None:
    points = np.random.default_rng(1).uniform(-0.02, 0.02, (3, 4, 3))
    together = CAMERA.project(points)
    assert together.shape == (3, 4, 2)
    np.testing.assert_array_equal(together[1, 2], CAMERA.project(points[1, 2]))


def test_skewed_pixels_shift_sideways_in_proportion_to_height() -> None:
    points = np.random.default_rng(2).uniform(-0.02, 0.02, (20, 3))
    straight, skewed = with_lens("none").project(points), with_lens("none", skew=50.0).project(points)
    camera = with_lens("none")
    seen = points @ camera.rotation.T + camera.translation_m
    np.testing.assert_allclose(skewed[:, 0] - straight[:, 0], 50.0 * seen[:, 1] / seen[:, 2], atol=1e-10)
    np.testing.assert_array_equal(skewed[:, 1], straight[:, 1])


def test_the_centre_is_where_all_rays_meet() -> None:
    np.testing.assert_allclose(CAMERA.rotation @ CAMERA.centre_m + CAMERA.translation_m, 0.0, atol=1e-15)


@pytest.mark.parametrize("name", DISTORTIONS)
def test_rays_invert_the_projection(name: str) -> None:
    camera = with_lens(name, skew=0.7)
    pixels = np.random.default_rng(1).uniform((0, 0), (camera.width_px, camera.height_px), (200, 2))
    rays = np.column_stack([camera.rays(pixels), np.ones(len(pixels))])
    points = (0.3 * rays - camera.translation_m) @ camera.rotation
    # The stated tolerance of a ray, times the focal length.
    np.testing.assert_allclose(camera.project(points), pixels, atol=1e-5)
