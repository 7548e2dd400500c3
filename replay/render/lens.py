"""The image of a real lens, computed from that of an ideal pinhole camera, because a renderer has no lens distortion.

The point spread function is a Gaussian that includes the pixel's area. A camera without distortion or skew is rendered
directly, with this Gaussian as its pixel filter. For any other camera, an ideal image of twice the resolution is rendered,
resampled at the real pixels with cubic splines, blurred by the rest of the Gaussian, and averaged.

**Depth of field.** A thin lens of aperture diameter A, focused at the distance s along its axis, blurs a point at the distance z
into a disc of the diameter

    c = f A |1/z - 1/s|     (f: focal length in pixels)

It is the mean over pinhole cameras at all points a of the aperture, each with its principal point moved by f a / s, so that all
of them see the plane of focus at the same pixels (Haeberli and Akeley 1990, The accumulation buffer).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from ...model.errors import InputError
from ...tracking.camera import Camera
from .image_boxes import BOX_STEP_PX, Box

Array = NDArray[np.float64]

FINER = 2
"""Resolution of the ideal image of a distorted camera, as a multiple of the real one."""
FINE_FILTER_PX = 0.5
"""Standard deviation of the fine image's pixel filter, in fine pixels: a cubic spline can still interpolate it."""
MAX_INVERSION_ERROR_PX = 1e-4
"""Error of the inverted distortion above which it counts as not invertible; real lenses have a thousandth of it."""
MAX_POINTS = 96
"""Points of the aperture; at 1 px from each other they fill a disc of 11 px, and wider ones show some grain."""
PLASTIC = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of the plane's low-discrepancy sequence (powers of the plastic number): any run of its points covers the aperture."""


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


@dataclass(frozen=True)
class Aperture:
    """The opening of a thin lens; of diameter 0 everything is in focus."""

    diameter_m: float = 0.0
    focus_m: float = 1.0
    """Distance of the plane of focus from the camera, along its axis."""

    def __post_init__(self) -> None:
        if not (
            np.isfinite(self.diameter_m) and self.diameter_m >= 0 and np.isfinite(self.focus_m) and self.focus_m > 0
        ):
            raise InputError(
                f"aperture_m = {self.diameter_m}, focus_m = {self.focus_m}: wanted a diameter of 0 or more and a distance above 0"
            )

    def blur_px(self, camera: Camera, points_m: Array) -> float:
        """Diameter of the largest disc into which one of the points (n, 3) of the world is blurred."""
        depth = points_m @ camera.rotation[2] + camera.translation_m[2]
        focal = float(max(camera.matrix[0, 0], camera.matrix[1, 1]))
        seen = depth[depth > 0]
        return float(focal * self.diameter_m * np.abs(1.0 / seen - 1.0 / self.focus_m).max(initial=0.0))

    def points(self, camera: Camera, points_m: Array) -> int:
        """Number of points of the aperture: 1 px apart in the largest disc, which a lens blur of 0.6 px hides."""
        return int(np.clip(np.ceil(np.pi / 4 * self.blur_px(camera, points_m) ** 2), 1, MAX_POINTS))

    def offsets_m(self, count: int) -> Array:
        """(count, 2) points that cover the aperture evenly, as does every run of them; to the right and down in the image."""
        if count == 1 or self.diameter_m == 0:
            return np.zeros((count, 2))
        share, turn = ((np.arange(count)[:, None] + 0.5) * PLASTIC % 1.0).T
        angle = 2.0 * np.pi * turn
        spread = np.sqrt(share)[:, None] * np.stack([np.cos(angle), np.sin(angle)], 1)
        return np.asarray(self.diameter_m / 2 * (spread - spread.mean(0)))

    def seen_from(self, optics: Optics, offset_m: Array) -> Optics:
        """The ideal camera at a point (2,) of the aperture, which sees the plane of focus at the same pixels."""
        pose = optics.pose.copy()
        pose[:3, 3] += optics.pose[:3, :2] @ (-offset_m)  # Mitsuba's axes point left and up
        x, y = np.array(optics.middle_px) + optics.focal_px * offset_m / self.focus_m
        return replace(optics, pose=pose, middle_px=(float(x), float(y)))


PINHOLE = Aperture()


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
    raise InputError(
        f"distortion = {camera.distortion.tolist()}: the distortion is not invertible within the frame; "
        "wanted one that maps every pixel to one direction"
    )
