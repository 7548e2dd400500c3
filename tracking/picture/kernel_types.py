"""tracking.picture.kernel_types."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled

STRETCH_PX = 24.0
"""Length of edge that shares its intensities: short enough for shading and shadow to be constant along it."""
MAX_STRETCH_PIXELS = 2048
"""Pixels of one such stretch at the most."""
CURVED_PATH_PX = 0.005
"""Displacement of an edge by the curvature of its motion within the exposure from which that is taken into account."""
STRIP_CELLS = 5
"""Pieces of a rounded strip: with a radius of a few pixels each is narrower than the blur."""
LIGHT_DEGREE = 4
LIGHT_TERMS = (LIGHT_DEGREE + 1) ** 2
"""Degree of the polynomial of the normal that says how bright a surface looks, and number of its coefficients."""
GRAZING_COSINE = 0.04
"""Cosine below which a face is seen too much from the side for its edges to be told apart."""
BIWEIGHT_CUT = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""
BIWEIGHT_VARIANCE = 0.8281
"""Mean square of Gaussian residuals of unit variance under the biweight's own weights with that cut."""
REWEIGHTINGS = 3
"""Times that the intensities of a stretch are solved with weights from the last residuals."""
MEDIAN_TOLERANCE, MEDIAN_HALVINGS = 0.02, 16
"""Part of itself to which a median is found, and steps in which it is where most values are not nought; of 200 Gaussian residuals
it is known to a fifteenth."""
STEP_FACTOR = 1.4
"""Factor on the steps at the lens blur. With the weights of the last residuals kept, as here, the normal equations are steeper
than the robust cost, by 1.2 for Gaussian residuals and by 1.6 on grain: a plain step left 38 % of the way on wood. Up to twice
the step converges wherever they are steeper at all."""
FEWEST_STRETCHES = 4.0
"""Stretches beside a face from which it is known how much they differ."""
REFLECTION_MARGIN_PX = 2.0
"""Margin about the outline of a reflection (or of the die before its reflection) within which rows are left out."""
PARAMETERS = 8
"""Pose (6), contour error [px], blur [px]."""
BLUR = 7
COARSE_BLUR_AND_BAND_PX = ((4.0, 12.0), (3.0, 10.0), (2.2, 8.0), (1.6, 6.5), (1.2, 5.0))
"""Blur and band [px] of the first steps from an uncertain start."""
SQUARED_SIGMAS_CUT, SHADOW_SQUARED_SIGMAS_CUT = 16.0, 4.0
"""Squared sigmas at which a pixel's misfit is cut off; lower where the image is darker than the background, which a
shadow explains."""
WINDOW_PX, NARROW_WINDOW_PX = 20.0, 11.0
"""Margin of the window about the outline: the widest band, and what a prediction may be off; and where the lens blur does
at once, whose band is a few pixels wide."""
COARSE_RESTART_PX = 1.0
"""A refinement that moves the die by more than this began too far off to start at the lens blur: its band would have missed
what a coarser one sees."""
OCCLUDED_SHARE, OCCLUDER_HALF_WIDTH_PX, OCCLUDER_RMS_SIGMAS, OCCLUDER_CHANGED_SIGMAS = 0.04, 2, 1.2, 4.0
"""Share of the die that shows nothing but the background from which something is looked for that stands before it; half the
width of the square of pixels that must show no die at all, root mean square difference from the background there [noise],
and the difference that no pixel of something still ever reaches."""
ACCEPTED_EXCESS_COST, ACCEPTED_EXCESS_COST_ON_PATH = 0.35, 2.5
"""By how much a pose in flight may cost more than usual before other explanations are tried, and the same for a pose NEAR
where the motion leads whose contour is badly seen; where it is well seen, a changed light does not count."""
ON_PATH_CHI2 = 30.0
"""Squared sigmas of six numbers: one in 25 000 of honest poses lies further off."""
COVARIANCE_GROWTH = 1.06
"""Growth of a motion's covariance a frame."""


class Shape(NamedTuple):
    """The die as the kernels want it: the inner sharp body, and the ball rolled round it."""

    vertices: Any
    """(n, 3) [m]"""
    outer: Any
    """(n, 3) [m] vertices of the sharp polyhedron of the flat faces."""
    normals: Any
    """(faces, 3)"""
    offsets: Any
    """(faces,) [m]"""
    edges: Any
    """(edges, 2) vertices."""
    edge_faces: Any
    """(edges, 2)"""
    face_edges: Any
    """(faces, most) padded with -1."""
    radius: float
    """[m] of the ball; 0 for a sharp die."""


class CameraRig(NamedTuple):
    """All views of a scene, as stacks."""

    matrix: Any
    """(views, 3, 3) intrinsics [px]."""
    distortion: Any
    """(views, 5)"""
    rotation: Any
    """(views, 3, 3) world to camera; of determinant -1 for a view in the mirror."""
    translation: Any
    """(views, 3) [m]"""
    camera: Any
    """(views,) which camera's picture it is."""
    partner: Any
    """(views,) the view that shares the picture and may hide this one; -1 if there is none."""
    weight: Any
    """(views,) by which what its edges say is multiplied; a view of none still hides others."""


class OccluderMask(NamedTuple):
    """What stands before the die, a rod or a frame: it is in the background, and stays as it is where the die must be."""

    still: Any
    """(cameras, height, width) float32, the background without gaps."""
    changed: Any
    """(cameras, height, width) uint8, 1 where some picture differed from the background."""
    core: Any
    """(cameras, height, width) uint8, 1 where the die was and was not seen, and nothing ever changed."""
    found: Any
    """(1,) pixels of the core."""


class FrameWindows(NamedTuple):
    """Pixels of one frame, a window of each camera's picture."""

    pixels: Any
    """(cameras, rows, columns) float32."""
    corner: Any
    """(cameras, 2) x, y of pixel [0, 0]."""
    size: Any
    """(cameras, 2) width and height of the window; 0 where the camera does not see the die."""


class RefinementSettings(NamedTuple):
    """What the refinement of every frame of a clip shares."""

    exposure: float
    """[s]; 0 where it is not known."""
    blur: float
    """[px] of the lens."""
    floor_grey: float
    """Least noise [grey] that a stretch of edge is given."""
    noise: float
    """[grey] of the still background."""
    loose_m: float
    loose_rad: float
    """Standard deviations of the prior where nothing is known of the motion."""
    tight_m: float
    tight_rad: float
    """Least standard deviations of the prior: a bounce must not be held back by it, nor a face seen alone be free to tip
    over."""
    fine_steps: int
    """Most steps at the lens blur."""
    enough: float
    """Squared sigmas: a step that gains less is the last. The next would gain a small part of it."""
    settled_px: float
    """A step that moves no point of the die by more than this is the last as well."""
    stride: int
    """One pixel line in so many is walked."""
    full: bool
    """Whether the normal equations shall have their column of the blur."""
    samples: int
    """Pixels that judge a pose as a whole; none where nobody asks."""
    band: float
    """[px] least half-width of the band about an edge at the lens blur."""
    rounding_grey: float
    """Step between the grey levels of a clip whose noise is too small for it: rounding then errs alike all along an edge. 0 where
    it does not."""
    strip_share: float
    """Standard deviation of the prior on α, β, γ, δ of a rounded strip, as a share of the mean intensity beside the edge."""
    light: Any
    """(views, LIGHT_TERMS + 2) how bright a surface looks by where it turns, see `light`: coefficients of `_brightness`
    [grey], the least of it that is believed, and one sigma by which strips differ from it; 0 where nothing is known."""


class Workspace(NamedTuple):
    """Room to work in, taken once for many frames."""

    px: Any
    cam: Any
    arm: Any
    normal: Any
    facing: Any
    J: Any
    across: Any
    lines: Any
    strip: Any
    """(CELLS + 1, 4) what each line of a rounded strip adds to the basis functions."""
    turned: Any
    hull: Any
    phi: Any
    slope: Any
    spread: Any
    grey: Any
    weight: Any
    left: Any
    size: Any
    rise: Any
    beside: Any
    begin: Any
    rows: Any
    A: Any
    L: Any
    C: Any
    y: Any
    c: Any
    solved: Any
    greys: Any
    """(views, faces + 1, 5) of the stretches beside each face, and beside the background: their number, and sums of p, p², p c
    and p c² of their intensities c and the information p about each."""
    usual: Any
    """(views, faces + 1, 2) the grey of each face, and beside the background, that its stretches share, and the inverse square
    of how far they differ from it; 0 where they share none."""
    shared: Any
    """(views, faces + 1, faces + 1) normal matrix of those greys; what `eliminate` leaves is its factor, of those that count."""
    by_shared: Any
    """(views, faces + 1, PARAMETERS) of pose, contour and blur by those greys."""
    pull: Any
    """(views, faces + 1) right side of those greys."""
    which: Any
    """(views, faces + 2) how many greys are shared, and whose."""


@compiled(nogil=True)
def new_workspace(shape: Shape, rig: CameraRig) -> Workspace:
    """An empty workspace for dice of this shape."""
    nv, ne, nf = shape.vertices.shape[0], shape.edges.shape[0], shape.normals.shape[0]
    views, most = rig.camera.shape[0], MAX_STRETCH_PIXELS
    return Workspace(
        np.zeros((nv, 2)), np.zeros((nv, 3)), np.zeros((nv, 3)), np.zeros((nf, 3)), np.zeros(nf), np.zeros((2, 3)),
        np.zeros(3), np.zeros(STRIP_CELLS + 1), np.zeros((STRIP_CELLS + 1, 4)), np.zeros(3), np.zeros((ne, 3)),
        np.zeros((4, most)), np.zeros((4, most)), np.zeros((4, most)), np.zeros(most), np.zeros(most), np.zeros(most),
        np.zeros(most), np.zeros(most), np.zeros((2, shape.face_edges.shape[1], 5)), np.zeros(514, np.int64),
        np.zeros((514, PARAMETERS)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((PARAMETERS, 4)), np.zeros(4), np.zeros(4),
        np.zeros(nf + 1), np.zeros((views, nf + 1, 5)), np.zeros((views, nf + 1, 2)), np.zeros((views, nf + 1, nf + 1)),
        np.zeros((views, nf + 1, PARAMETERS)), np.zeros((views, nf + 1)), np.zeros((views, nf + 2), np.int64),
    )  # fmt: skip
