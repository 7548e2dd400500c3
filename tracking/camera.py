"""A calibrated camera, in OpenCV's conventions.

x_cam = rotation · X_world + translation, and with x = x_cam / z_cam, y = y_cam / z_cam and r² = x² + y² (Brown-Conrady)

    x' = x (1 + k1 r² + k2 r⁴ + k3 r⁶) + 2 p1 x y + p2 (r² + 2 x²)
    y' = y (1 + k1 r² + k2 r⁴ + k3 r⁶) + p1 (r² + 2 y²) + 2 p2 x y
    pixel = matrix (x', y', 1), with pixel centres at integers.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]

RAY_TOLERANCE = 1e-9
"""Largest error, as a slope, of a ray after the distortion is inverted: a millionth of a pixel at a focal length of
1000 px."""
MOST_ITERATIONS = 100
"""Of the inversion. The distortion of a usable lens is a contraction, and each iteration gains one to two digits."""


@dataclass(frozen=True, eq=False)
class Camera:
    """Intrinsics and pose of one camera."""

    width_px: int
    height_px: int
    matrix: Array
    """(3, 3) intrinsics [px]."""
    distortion: Array
    """(5,) k1 k2 p1 p2 k3."""
    rotation: Array
    """(3, 3) world to camera."""
    translation_m: Array
    """(3,) position of the world's origin in camera axes."""

    @property
    def centre_m(self) -> Array:
        """(3,) [m] optical centre, in world axes."""
        return np.asarray(-self.rotation.T @ self.translation_m)

    def project(self, points_m: ArrayLike) -> Array:
        """Pixel coordinates (..., 2) of world points (..., 3), lens distortion included; NaN behind the camera."""
        cam = np.asarray(points_m, float) @ self.rotation.T + self.translation_m
        depth = np.where(cam[..., 2] > 0, cam[..., 2], np.nan)
        x, y = cam[..., 0] / depth, cam[..., 1] / depth
        k1, k2, p1, p2, k3 = self.distortion
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        K = self.matrix
        return np.stack([K[0, 0] * xd + K[0, 1] * yd + K[0, 2], K[1, 1] * yd + K[1, 2]], axis=-1)

    def contains(self, pixels_px: Array) -> NDArray[np.bool_]:
        """(...,) whether pixels (..., 2) lie within the picture; NaN does not."""
        last = np.array([self.width_px - 1, self.height_px - 1])
        return np.asarray(((pixels_px >= 0) & (pixels_px <= last)).all(-1))

    def rays(self, pixels_px: ArrayLike) -> Array:
        """Undistorted rays x/z, y/z (..., 2) of pixels (..., 2), to RAY_TOLERANCE; the inverse of the distortion in
        `project`."""
        pixels, K = np.asarray(pixels_px, float), self.matrix
        y = (pixels[..., 1] - K[1, 2]) / K[1, 1]
        distorted = np.stack([(pixels[..., 0] - K[0, 2] - K[0, 1] * y) / K[0, 0], y], axis=-1)
        if not self.distortion.any():
            return distorted
        # OpenCV 4 has a function of its own for a given criterion.
        undistort = getattr(cv2, "undistortPointsIter", None)
        points, stop = (
            distorted.reshape(-1, 1, 2),
            (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, MOST_ITERATIONS, RAY_TOLERANCE),
        )
        if undistort is None:
            rays = cv2.undistortPoints(points, np.eye(3), self.distortion, criteria=stop)
        else:
            rays = undistort(points, np.eye(3), self.distortion, None, None, stop)
        return np.asarray(rays.reshape(distorted.shape))
