"""The image of a real lens, computed from that of an ideal pinhole camera, because a renderer has no lens distortion.

The point spread function is a Gaussian that includes the pixel's area. A camera without distortion or skew is rendered
directly, with this Gaussian as its pixel filter. For any other camera, an ideal image of twice the resolution is rendered,
resampled at the real pixels with cubic splines, blurred by the rest of the Gaussian, and averaged.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ...tracking.camera import Camera
from .image_boxes import BOX_STEP_PX, Box

Array = NDArray[np.float64]

FINER = 2
"""Resolution of the ideal image of a distorted camera, as a multiple of the real one."""
FINE_FILTER_PX = 0.5
"""Standard deviation of the fine image's pixel filter, in fine pixels: a cubic spline can still interpolate it."""
MAX_INVERSION_ERROR_PX = 1e-4
"""Error of the inverted distortion above which it counts as not invertible; real lenses have a thousandth of it."""


@dataclass(frozen=True, eq=False)
class Optics:
    """The ideal camera behind a real one, and how the real image follows from the ideal one."""

    width_px: int
    height_px: int
    focal_px: float
    middle_px: tuple[float, float]
    """Principal point of the ideal camera, pixel centres at integers."""
    filter_px: float
    """Standard deviation of the ideal camera's pixel filter, in its own pixels."""
    pose: Array
    """(4, 4) camera to world, in Mitsuba's axes: x left, y up, z forward."""
    source_px: Array | None = field(default=None, repr=False)
    """(2, FINER height, FINER width) row and column in the ideal image of every fine point of the real one; None if the
    ideal camera is the real one."""
    blur_px: float = 0.0
    """Standard deviation of the additional blur, in fine pixels."""

    def rendered_box(self, box: Box) -> Box:
        """The box of the ideal image from which a box of the real one is computed."""
        if self.source_px is None:
            return box
        rows, columns = self.source_px[:, *_fine(box, _blur_margin(self.blur_px), self.source_px.shape)]
        left, top = int(columns.min()) - 4, int(rows.min()) - 4
        width, height = (
            -(-(int(c.max()) + 6 - low) // BOX_STEP_PX) * BOX_STEP_PX for c, low in ((columns, left), (rows, top))
        )
        return left, top, left + width, top + height

    def to_real_image(self, ideal: Array, box: Box, fine: Box) -> Array:
        """The real image in a box, from the ideal one in its box."""
        if self.source_px is None:
            return ideal
        margin = _blur_margin(self.blur_px)
        window = _fine(box, margin, self.source_px.shape)
        source_px = self.source_px[:, *window] - np.array([fine[1], fine[0]])[:, None, None]
        bent = map_coordinates(ideal, source_px, order=3, mode="nearest")
        soft = cv2.GaussianBlur(bent, (0, 0), self.blur_px, borderType=cv2.BORDER_REPLICATE)
        top, left = box[1] * FINER - window[0].start, box[0] * FINER - window[1].start
        height, width = box[3] - box[1], box[2] - box[0]
        own = soft[top : top + height * FINER, left : left + width * FINER]
        return np.asarray(own.reshape(height, FINER, width, FINER).mean((1, 3)))


def _blur_margin(blur_px: float) -> int:
    """Margin that a blur needs on every side, in fine pixels."""
    return FINER * int(np.ceil(4.0 * blur_px / FINER))


def _fine(box: Box, margin: int, shape: tuple[int, ...]) -> tuple[slice, slice]:
    """Rows and columns of the fine image in a box of the real one, with a margin for the blur."""
    return (
        slice(max(box[1] * FINER - margin, 0), min(box[3] * FINER + margin, shape[1])),
        slice(max(box[0] * FINER - margin, 0), min(box[2] * FINER + margin, shape[2])),
    )


def optics_of(camera: Camera, blur_px: float) -> Optics:
    """The ideal camera behind a real one."""
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ np.diag([-1.0, -1.0, 1.0])
    pose[:3, 3] = camera.centre_m
    K = camera.matrix
    if K[0, 0] == K[1, 1] and K[0, 1] == 0 and not camera.distortion.any():
        middle = (float(K[0, 2]), float(K[1, 2]))
        return Optics(camera.width_px, camera.height_px, float(K[0, 0]), middle, blur_px, pose)
    directions = undistorted(camera)
    focal = FINER * float(max(K[0, 0], K[1, 1]))
    low, high = focal * directions.min((0, 1)), focal * directions.max((0, 1))
    middle_px = -np.floor(low) + 8.0
    width, height = (np.ceil(high + middle_px) + 9.0).astype(int)
    source_px = np.stack([focal * directions[..., 1] + middle_px[1], focal * directions[..., 0] + middle_px[0]])
    # Variances add: the fine filter, the mean over FINER points per pixel, and the rest as a blur of the fine image.
    rest = (FINER * blur_px) ** 2 - FINE_FILTER_PX**2 - (FINER**2 - 1) / 12.0
    centre = (float(middle_px[0]), float(middle_px[1]))
    return Optics(int(width), int(height), focal, centre, FINE_FILTER_PX, pose, source_px, float(np.sqrt(rest)))


def undistorted(camera: Camera) -> Array:
    """Undistorted x/z and y/z (rows, columns, 2) of FINER × FINER points in every pixel.

    Raises ValueError if the distortion cannot be inverted within the frame.
    """
    x = (np.arange(camera.width_px * FINER) + 0.5) / FINER - 0.5
    y = (np.arange(camera.height_px * FINER) + 0.5) / FINER - 0.5
    pixels = np.stack(np.meshgrid(x, y), axis=-1)
    rays = camera.rays(pixels)
    in_camera = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    projected = camera.project((in_camera - camera.translation_m) @ camera.rotation)
    if np.abs(projected - pixels).max() < MAX_INVERSION_ERROR_PX:
        return rays
    raise ValueError(
        f"distortion = {camera.distortion.tolist()}: the distortion is not invertible within the frame; "
        "wanted one that maps every pixel to one direction"
    )
