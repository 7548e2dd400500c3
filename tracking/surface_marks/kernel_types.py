"""Constants and records of the kernels that measure a pose on surface marks.

Face coordinates (a, b) [m] are counted from the foot of the perpendicular from the die's centre onto the face, along
two axes of the body frame; the third axis is the outward normal. The grey level of a pixel on a face is modelled as

    I = c₀ T + c₁ + c₂ a + c₃ b + c₄ a T + c₅ b T,

with T(a, b) the face's texture, about one on bare paint, and six light coefficients c for each face and frame. Light
that the paint scatters is proportional to T, light that it mirrors lies over it; either changes linearly over the
face.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, int64, truth
from ..picture import PoseState

LIGHT_COEFFICIENTS = 6
"""Of T, 1, a, b, aT, bT."""
FIRST_GRADIENT = 4
"""Index of the first of the two gradients of the scattered light, which have a prior. A face of unknown texture has the
coefficients of 1, a and b alone: its T is 1 everywhere."""
LIGHT_GRADIENT_SIGMA = 0.3
"""Prior standard deviation of the change of the scattered light from the middle of a face to its border, as a share:
a small mark in much noise does not determine it."""
WARPS = 9
"""Parameters of a texture's misplacement on its face: shift (2), linear map (4), the two perspective terms of a
plane, and blur. Pose errors common to all frames warp the learned texture in the first eight ways."""
STEEP_SHARE = 0.3
"""Share of the steepest slope on a face from which a pixel counts as steep."""
FLAT_DECIMATION = 3
"""One in so many pixels is used on flat ground beside marks: enough for the light coefficients."""
NEGLIGIBLE_BLUR_TEXEL2 = 0.02
"""Variance [texel²] of a frame's blur relative to its texture below which it is neglected: a texture's own is about
one."""
STENCIL_BLUR_TEXEL2 = 2.0
"""Largest variance [texel²] that a stencil of three adjacent values blurs by, in several passes. Larger variances use
values twice as far apart from four times as much on, four times as far apart from sixteen times, and so on, each
after one pass of the finer ones, because values far apart leave those between them unchanged. The stencil (1/6, 2/3,
1/6) with values √3 standard deviations apart blurs a quintic exactly as a normal distribution does; passes here are
about as wide, and exact for cubics."""
SCALE_DECIMATION = 3
"""One in so many residuals determines the noise scale before the last iteration."""
DECIMATED_FROM = 600
"""Number of pixels on a face from which SCALE_DECIMATION is applied."""
MOST_PIXELS = 60_000
"""Most pixels of one face; larger faces are sampled on every second, third, ... row."""
FEWEST_PIXELS = 40
"""Pixels of a face below which the frame says nothing about it."""
LEAST_VIEW_COSINE = 0.2
"""Least cosine between a face's normal and the direction to the camera. Below it the image of the face is compressed
more than five times, and blurred by more than its marks are apart."""
MARGIN_BLURS = 2.5
"""Distance, in lens blurs and beside half a pixel, of the used pixels from the border of a face's flat part: 0.6 % of
the step beyond the border remain there."""
CONVERGED_PX = 0.1
"""A refinement step that moves every point of the die by less ends the iteration: marks are blurred over five times
as much at least, and the next step is of second order in that share."""
CONVERGED_GAIN = 0.1
"""A refinement step that gains less [squared sigmas] ends the iteration: it moves by a third of a sigma, the next one
by a tenth of that."""
OVERRELAXATION = 1.2
"""Factor on the refinement steps. With the robust weights held fixed the normal equations are steeper than the robust
cost, by the ratio of the means of the biweight and of the slope of its influence function: 0.915 to 0.758 for
Gaussian residuals. A plain step left a sixth of the distance."""
MOST_OCCLUDED = 0.5
"""Share of a face's pixels, or texels, that may disagree with its texture before the face is left out of a frame."""

ZERO = int64(0)
"""Start of a counter. Like the constants below, it is typed so that kernels are not compiled again for a literal."""
ALL_LIGHT = int64(LIGHT_COEFFICIENTS)
"""Size of the light's normal equations."""
POSE_PARAMETERS = int64(6)
"""Size of the pose's normal equations."""
LEARNING_ITERATIONS = int64(4)
"""Reweighted least-squares iterations of the light where textures are learned."""
REFINING_ITERATIONS = int64(3)
"""The same where poses are refined."""
WITHOUT_WARPS = truth(False)
TEXTURE_KNOWN = truth(True)
WORKSPACE_PIXELS = int64(MOST_PIXELS)


class Optics(NamedTuple):
    """The camera, and what blurs its images."""

    rays: Any
    """(height, width, 2) undistorted camera rays x/z, y/z of all pixels."""
    matrix: Any
    """(3, 3) [px]"""
    distortion: Any
    """(5,)"""
    rotation: Any
    """(3, 3) world to camera."""
    translation: Any
    """(3,) [m]"""
    exposure: float
    """[s]"""
    blur: float
    """Standard deviation of the lens blur [px], where it is in focus."""
    aperture: float
    """[m] and depth [m] of focus, see `CameraRig`."""
    focus: float
    row_s: float
    """[s] from the exposure of one row to that of the next; 0 for a global shutter."""


class RowDrift(NamedTuple):
    """The motion of the die from pixel row to pixel row under a rolling shutter, in camera axes."""

    row_s: float
    """[s] from the exposure of one row to that of the next; 0 for a global shutter."""
    row: float
    """Row of the die's centre, at whose exposure the pose holds."""
    centre: Any
    """(3,) [m]"""
    velocity: Any
    """(3,) [m/s]"""
    omega: Any
    """(3,) [rad/s]"""


class Faces(NamedTuple):
    """The die's faces with their textures, and how pixels are compared with them."""

    axes: Any
    """(faces, 3, 3) rows a, b and the outward normal, body axes."""
    offsets: Any
    """(faces,) distances of the face planes from the centre [m]."""
    corners: Any
    """(faces, most, 2) corners of the flat part in (a, b) [m], padded."""
    counts: Any
    """(faces,) corners of each face."""
    learned: Any
    """(faces,) whether the texture is known."""
    texture_blur: Any
    """(faces, 2, 3) [m²] blur of the textures, see `blur_on_face`."""
    coefficients: Any
    """(faces, n, n) of the cubic B-splines."""
    use: Any
    """(faces, n, n) 0 where no pixel is used, 1 where one in FLAT_DECIMATION is because the texture is flat, 2 where
    all are."""
    usual_grey: Any
    """(faces,) usual residual of a pixel; 0 for a face without marks."""
    margin: float
    """Distance of the used pixels from the border of the flat part [px]."""
    texel: float
    """Side of a texel [m]."""
    saturation: float
    """Grey level from which pixels are left out."""
    floor_grey: float
    """Least noise scale."""
    cut: float
    """Cut of the robust weights [sigmas]."""


class Frame(NamedTuple):
    """A window of one frame round the die, and the die's pose and motion then."""

    image: Any
    """(height, width) grey levels, float32."""
    x0: int
    """Column of the whole picture at which the window begins."""
    y0: int
    """Row of the whole picture at which the window begins."""
    pose: PoseState


class Workspace(NamedTuple):
    """Scratch arrays for the pixels of one face, allocated once for many frames."""

    grey: Any
    texture: Any
    a: Any
    """Face coordinate over half the grid's width: -1 to 1."""
    b: Any
    steep: Any
    """Slope of the texture over the steepest one."""
    weight: Any
    residual: Any
    size: Any
    """Absolute residuals of steep pixels."""
    texel_index: Any
    slope: Any
    """(2, most) of the texture by a and b [1/m]."""
    ray: Any
    """(2, most)"""
    by_blur: Any
    """(most,) derivative of the texture by its own variance [1/texel²]."""
    derivatives: Any
    """(6 + WARPS, most) of the grey levels by all parameters."""
    weighted: Any
    """(most,) one of them, times its weight."""
    blurred: Any
    """(2, n, n) textures that are being blurred."""
    line: Any
    """(2, most) face coordinates of the pixels of one image row [texel]."""


@compiled(nogil=True)
def new_workspace(most: int, side: int) -> Workspace:
    """Scratch arrays for `most` pixels of a face, and textures of `side` texels a side."""
    return Workspace(
        np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most), np.empty(most),
        np.empty(most), np.empty(most, np.int64), np.empty((2, most)), np.empty((2, most)), np.empty(most),
        np.empty((6 + WARPS, most)), np.empty(most), np.empty((4, side, side)), np.empty((2, most)),
    )  # fmt: skip
