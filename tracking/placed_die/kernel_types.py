"""Records that the compiled kernels of a picture pass to each other.

Numbers that always travel together are one NamedTuple, which costs a compiled kernel nothing. `PictureModel` is
everything about a picture except the pose; `PoseState` is the pose with its motion; `NormalEquations` is what the
pixels say about that pose; `Workspace` is scratch memory that is allocated once for many frames.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ...model.compiled import compiled, inner_no_memory, inner_nogil

MAX_STRETCH_PIXELS = 2048
"""Capacity of the workspace for pixels of one stretch of edge; pixel lines beyond it are left out."""
MAX_STRETCH_ROWS = 514
"""Capacity for pixel lines of one stretch."""
STRIP_CELLS = 5
"""Pieces of equal turn that a rounded strip is drawn in: with a corner radius of a few pixels each is narrower than the
blur."""
LIGHT_DEGREE = 4
"""Degree of the polynomial of the surface normal that gives the brightness of a surface."""
LIGHT_TERMS = (LIGHT_DEGREE + 1) ** 2
"""Number of its coefficients on the sphere, where z² is 1 - x² - y²."""

PARAMETERS = 9
"""Columns of the normal equations: position (3) [m], rotation vector (3) [rad], contour error [px], blur [px], exponent of the
response."""
CONTOUR = 6
"""Column of the contour error: how far out the contour is drawn [px]."""
BLUR = 7
"""Column of the blur."""
RESPONSE = 8
"""Column of the response, grey = light ** exponent: by how much its exponent is above that of the clip's levels."""

STATISTICS = 17
"""Numbers that the kernels count beside the normal equations; their places follow."""
ROBUST_COST = 0
"""Sum over edge pixels of the truncated cost, 0 to 1 each."""
WEIGHT_SUM = 1
"""Sum over edge pixels of the robust weights."""
PIXELS = 2
"""Number of edge pixels."""
CONTOUR_PX = 3
"""Length [px] of visible contour inside the image."""
CLEAR_PX = 4
"""Length [px] of it with a clear step of intensity."""
STRETCHES = 5
"""Number of stretches of edge."""
LOG_NOISE = 6
"""Sum over edge pixels of the logarithm of the residual noise [grey]."""
BACKGROUND_SHARE = 7
"""Share of the die's own pixels that show nothing but the background."""
LINES = 8
"""Number of pixel lines across edges. Of each follows a shift of the edge and its standard error, as if errors of pixels were
independent; the next numbers are of the ratios of both."""
LINE_SQUARES = 9
"""Sum of their squares."""
LINE_LAGS = 3
"""Distances, from one line on, at which lines are compared: what the errors of pixels share does not reach farther, and what
whole edges share is an error of the model."""
LINE_PAIRS = 10
"""Number of pairs of lines at each of these distances."""
LINE_PRODUCTS = 13
"""Sums over these pairs of the products of their ratios."""
EXPECTED_CLEAR_PX = 16
"""Length [px] of the visible contour that shows a clear step in the mean if the pose is right: of a well-rounded die on a table
nearly as bright, less than all. Of edges, whose brightness is not predicted, it is all."""


class Shape(NamedTuple):
    """The die's geometry: an inner sharp polyhedron, and the ball rolled round it."""

    vertices: Any
    """(n, 3) [m] of the inner body."""
    outer: Any
    """(n, 3) [m] vertices of the sharp polyhedron of the flat faces."""
    normals: Any
    """(faces, 3) outward."""
    offsets: Any
    """(faces,) [m] distance of the inner body's faces from the centre."""
    edges: Any
    """(edges, 2) vertices."""
    edge_faces: Any
    """(edges, 2) faces that meet at each edge."""
    face_edges: Any
    """(faces, most) edges of each face, padded with -1."""
    radius: float
    """[m] of the ball; 0 for a sharp die."""


class CameraRig(NamedTuple):
    """All views of a scene, as stacks: every camera, then every camera as the table mirrors it."""

    matrix: Any
    """(views, 3, 3) intrinsics [px]."""
    distortion: Any
    """(views, 5) k1 k2 p1 p2 k3."""
    rotation: Any
    """(views, 3, 3) world to camera; of determinant -1 for a mirrored view."""
    translation: Any
    """(views, 3) [m]"""
    camera: Any
    """(views,) index of the camera whose picture a view uses."""
    partner: Any
    """(views,) the view that shares the picture and may hide this one; -1 if there is none."""
    weight: Any
    """(views,) factor on the information of its edges; a view of weight 0 still hides others."""
    row_s: Any
    """(views,) [s] from the exposure of one row to that of the next; 0 for a global shutter."""
    middle_row: Any
    """(views,) [px] row whose exposure is the time of the frame."""
    aperture: Any
    """(views,) [m] diameter of the lens; 0 where all depths are taken for equally sharp."""
    focus: Any
    """(views,) [m] depth at which the picture is sharpest."""


class FrameWindows(NamedTuple):
    """Pixels of one frame: a window of each camera's picture."""

    pixels: Any
    """(cameras, rows, columns) float32 [grey]."""
    corner: Any
    """(cameras, 2) x, y of pixel [0, 0]."""
    size: Any
    """(cameras, 2) width and height of the window; 0 if the camera does not show the die."""


class RefinementSettings(NamedTuple):
    """What the refinement of every frame of a clip shares."""

    exposure_s: float
    """0 if it is not known."""
    blur_px: float
    """Standard deviation of the lens blur, where it is in focus."""
    noise_floor_grey: float
    """Least noise that a stretch of edge is given."""
    noise_grey: float
    """Noise of the still background."""
    loose_m: float
    loose_rad: float
    """Standard deviations of the prior on a pose if nothing is known of the motion."""
    tight_m: float
    tight_rad: float
    """Least standard deviations of the prior: it must neither hold back a bounce, nor leave a face seen alone free to
    tip over."""
    fine_steps: int
    """Most Gauss-Newton steps at the lens blur."""
    min_gain: float
    """Squared sigmas: a step that gains less is the last. The next would gain a small part of it."""
    min_step_px: float
    """A step that moves no point of the die by more than this is the last as well."""
    line_stride: int
    """One pixel line in so many is used."""
    with_blur: bool
    """Whether the normal equations get their column of the blur."""
    with_response: bool
    """Whether they get their column of the response."""
    region_pixels: int
    """Pixels that the region cost of a pose is taken over; 0 to leave it out."""
    band_px: float
    """Least half-width of the band about an edge at the lens blur."""
    rounding_grey: float
    """Step between the grey levels of a clip whose noise is too small to dither them: rounding errors are then
    correlated along an edge. 0 otherwise."""
    strip_prior_share: float
    """Standard deviation of the prior on α, β, γ, δ of a rounded strip, as a share of the mean intensity beside the
    edge, where no light is assumed."""
    light: Any
    """What is known of the light before a frame is looked at, a `surface_light.LightPrior`."""
    whole_surface: bool
    """Whether all pixels of a well-rounded die are compared, or its edges alone."""
    surface_from_px: float
    """Radius of the ball in the picture from which a die counts as well rounded."""
    contour_stretch_px: float
    """Length of contour of a sharp die that shares one shade of the background."""
    shade_change: float
    """Standard deviation of the change of the shade on the background over a circumradius, beside a contour on the table; above
    it the slope falls with the square of height and circumradius (`picture.shade`)."""
    response: float
    """Exponent of the response, grey = light ** response, if the statistics shall state the noise in the file's grey levels, in
    which clips that were mapped by different responses compare; 0: the noise in the clip's own levels."""
    full_scale: float
    """Largest level of the clip."""
    file_scale: float
    """Largest grey level of the file."""
    saturation_grey: float
    """Level of a saturated pixel, which says that it is at least this bright; infinite if none is."""


class PictureModel(NamedTuple):
    """Everything that the expected picture depends on, except the pose."""

    backgrounds: Any
    """(cameras, height, width) float32: whole pictures without the die [grey], NaN where something stands before the
    die."""
    rig: CameraRig
    shape: Shape
    settings: RefinementSettings


class PoseState(NamedTuple):
    """A pose at mid-exposure and the motion that blurs it; with a rolling shutter, at mid-exposure of the row in which the
    first camera sees the centre."""

    position: Any
    """(3,) [m] of the centre, world axes."""
    rotation: Any
    """(3, 3) body to world."""
    velocity: Any
    """(3,) [m/s]"""
    omega: Any
    """(3,) [rad/s], world axes."""


class EdgeSampling(NamedTuple):
    """How one step of a refinement samples the edges."""

    blur_px: float
    """Lens blur that is assumed at the depth of the die's centre."""
    band_px: float
    """Half-width of the band of pixels about an edge."""
    with_blur: bool
    """Whether the equations get their column of the blur."""
    with_response: bool
    """Whether they get their column of the response."""


class NormalEquations(NamedTuple):
    """Normal equations of one frame about one pose, filled in place: H x = g at unit noise."""

    H: Any
    """(PARAMETERS, PARAMETERS); kernels that add to it fill the lower half."""
    g: Any
    """(PARAMETERS,)"""
    statistics: Any
    """(STATISTICS,) see ROBUST_COST and those beside it."""


class PoseRows(NamedTuple):
    """Poses of several frames, one row each, filled in place."""

    position: Any
    """(n, 3) [m]"""
    rotation: Any
    """(n, 3, 3)"""
    motion: Any
    """(n, 6) velocity and angular velocity that the blur is computed with."""
    H: Any
    """(n, PARAMETERS, PARAMETERS)"""
    statistics: Any
    """(n, STATISTICS)"""
    cost: Any
    """(n,) pose cost, see `pose_costs`."""


class LightSpace(NamedTuple):
    """The light on a die as an unknown of one picture (`surface_light`), and what the pictures before showed of it."""

    level: Any
    """(views,) [grey] mean brightness; 0 as long as nothing is known."""
    deviation: Any
    """(views,) [grey] standard deviation of intensities from the brightness by normal."""
    mean: Any
    """(views, LIGHT_TERMS) [grey] coefficients after the last step."""
    prior_mean: Any
    """(views, LIGHT_TERMS) [grey] before the picture."""
    information: Any
    """(views, LIGHT_TERMS, LIGHT_TERMS) [1/grey²] of that."""
    sums: Any
    """(views, 2) number of stretches beside faces, and the sum of their greys."""
    matrix: Any
    """(views, LIGHT_TERMS, LIGHT_TERMS) normal matrix of the coefficients, lower half."""
    factor: Any
    """(views, LIGHT_TERMS, LIGHT_TERMS) its Cholesky factor."""
    coupling: Any
    """(views, LIGHT_TERMS, PARAMETERS) coupling of the parameters to the coefficients."""
    right: Any
    """(views, LIGHT_TERMS) right side."""
    solved: Any
    """(views,) whether the factor exists."""
    kept_level: Any
    """(views,) the level, coefficients and information that earlier pictures leave; 0 if there were none."""
    kept_mean: Any
    kept_information: Any
    rows: Any
    """(4, LIGHT_TERMS) intensities of a stretch by the coefficients."""
    expected: Any
    """(4,) [grey] these intensities."""
    spread: Any
    """(2,) [grey²] variances of the last two of them."""
    stretch: Any
    """(4, 4)"""
    monomials: Any
    """(LIGHT_TERMS,)"""
    solution: Any
    """(LIGHT_TERMS,)"""
    course: Any
    """(STRIP_CELLS + 1,) [grey] brightness at the nodes of a strip."""
    left: Any
    """(STRIP_CELLS + 1,) [grey] what the four basis functions leave of it."""
    surface_cost: Any
    """(views, 4) of the whole surface compared last: sum of truncated squared sigmas, pixels of that sum, pixels of the die
    alone, and how many of them differ from the background; all 0 where edges were compared."""
    part_deviation: Any
    """(views, parts) [grey] what each part of the surface deviates from the light, after the last step."""
    part_matrix: Any
    """(views, parts, parts) [1/grey²] Cholesky factor of the normal matrix of these; 0 where nothing is known of them."""
    part_coupling: Any
    """(views, parts, PARAMETERS + LIGHT_TERMS) coupling of the parameters and the light to them."""
    part_right: Any
    """(views, parts) right side."""


class Workspace(NamedTuple):
    """Scratch arrays, allocated once for many frames."""

    vertex_px: Any
    """(vertices, 2) in one view."""
    vertex_camera: Any
    """(vertices, 3) [m] in camera axes."""
    vertex_arm: Any
    """(vertices, 3) [m] from the die's centre, in world axes."""
    face_normal: Any
    """(faces, 3) in world axes."""
    face_cosine: Any
    """(faces,) about the cosine at which a face is seen; negative for those that face away."""
    J: Any
    """(2, 3) derivative of a pixel by its point in camera axes [px/m]."""
    edge_gradient: Any
    """(3,) derivative of the signed distance d by a world displacement of the edge [px/m]."""
    strip_lines: Any
    """(STRIP_CELLS + 1,) [px] signed distances of the lines of a rounded strip."""
    strip_slopes: Any
    """(STRIP_CELLS + 1, 5) [1/px] changes of slope, at each of these lines, of the four basis functions and of what they
    leave of the brightness."""
    strip_jump: Any
    """(5,) jumps of these at the last line."""
    strip_end: Any
    """(3,) direction towards which the normal turns on a strip."""
    hull: Any
    """(edges, 5) lines (a, b, c) of an outline, and the ends of its edge on each, as values of b x - a y."""
    value: Any
    """(MAX_STRETCH_PIXELS,) what the pixels of a stretch show, known parts included."""
    basis: Any
    """(4, MAX_STRETCH_PIXELS) φ: what each pixel gets of each intensity of a stretch."""
    basis_slope: Any
    """(4, MAX_STRETCH_PIXELS) dφ/dd."""
    basis_blur: Any
    """(4, MAX_STRETCH_PIXELS) dφ/dσ."""
    ramp: Any
    """(MAX_STRETCH_PIXELS,) what each pixel beside a contour gets of the slope of the shade on the background [px]."""
    ramp_by_intensities: Any
    """(4,) coupling of the slope to the intensities of a stretch."""
    ramp_by_parameters: Any
    """(PARAMETERS,) coupling of the parameters to the slope."""
    grey: Any
    """(MAX_STRETCH_PIXELS,) observed; the next four alike."""
    weight: Any
    residual: Any
    size: Any
    """Absolute residuals."""
    grey_slope: Any
    """dI/dd of the fitted intensities."""
    response_slope: Any
    """dI by the exponent of the response, with the greys on both sides held."""
    known_slope: Any
    """dI/dd of what the basis functions of a rounded edge leave of the brightness."""
    neighbours: Any
    """(2, most, 5) other edges of the two faces beside an edge."""
    row_begin: Any
    """(MAX_STRETCH_ROWS,) first pixel of each pixel line of a stretch."""
    row_jacobian: Any
    """(MAX_STRETCH_ROWS, PARAMETERS) derivative of d by the parameters on each line."""
    A: Any
    """(4, 4) normal matrix of the intensities of a stretch."""
    L: Any
    """(4, 4) its Cholesky factor."""
    C: Any
    """(PARAMETERS, 4) coupling of the parameters to these intensities."""
    y: Any
    """(4,) right side."""
    c: Any
    """(4,) intensities."""
    solved: Any
    """(faces + 1,)"""
    grey_sums: Any
    """(views, faces + 1, 5) of the stretches beside each face, and beside the background: their number, and sums of p,
    p², p c and p c² of their intensities c and the information p about each."""
    shared_grey: Any
    """(views, faces + 1, 2) grey of each face, and beside the background, that its stretches share, and the inverse
    variance of their differences from it; 0 if they share none."""
    shared_matrix: Any
    """(views, faces + 1, faces + 1) normal matrix of those greys; `eliminate_shared_greys` leaves its Cholesky
    factor."""
    shared_coupling: Any
    """(views, faces + 1, PARAMETERS) coupling of the parameters to those greys."""
    shared_right: Any
    """(views, faces + 1) right side of those greys."""
    shared_faces: Any
    """(views, faces + 2) number of greys that are shared, and whose."""
    light: LightSpace
    """Of a rounded die."""
    tie: Any
    """(4,) information that ties the intensities of a stretch to the light."""


@inner_nogil
def _new_light_space(views: int, parts: int) -> LightSpace:
    """Of pictures of which nothing is known."""
    n = LIGHT_TERMS
    return LightSpace(
        np.zeros(views), np.zeros(views), np.zeros((views, n)), np.zeros((views, n)), np.zeros((views, n, n)),
        np.zeros((views, 2)), np.zeros((views, n, n)), np.zeros((views, n, n)), np.zeros((views, n, PARAMETERS)),
        np.zeros((views, n)), np.zeros(views, np.int64), np.zeros(views), np.zeros((views, n)), np.zeros((views, n, n)),
        np.zeros((4, n)), np.zeros(4), np.zeros(2), np.zeros((4, 4)), np.zeros(n), np.zeros(n),
        np.zeros(STRIP_CELLS + 1), np.zeros(STRIP_CELLS + 1), np.zeros((views, 4)), np.zeros((views, parts)),
        np.zeros((views, parts, parts)), np.zeros((views, parts, PARAMETERS + n)), np.zeros((views, parts)),
    )  # fmt: skip


@compiled(nogil=True, shared=True)
def new_workspace(shape: Shape, rig: CameraRig) -> Workspace:
    """An empty workspace for dice of this shape."""
    nv, ne, nf = shape.vertices.shape[0], shape.edges.shape[0], shape.normals.shape[0]
    views, most = rig.camera.shape[0], MAX_STRETCH_PIXELS
    light = _new_light_space(views if shape.radius > 0.0 else 0, nf + ne + nv)
    return Workspace(
        np.zeros((nv, 2)), np.zeros((nv, 3)), np.zeros((nv, 3)), np.zeros((nf, 3)), np.zeros(nf), np.zeros((2, 3)),
        np.zeros(3), np.zeros(STRIP_CELLS + 1),
        np.zeros((STRIP_CELLS + 1, 5)), np.zeros(5), np.zeros(3), np.zeros((ne, 5)), np.zeros(most),
        np.zeros((4, most)), np.zeros((4, most)), np.zeros((4, most)), np.zeros(most), np.zeros(4), np.zeros(PARAMETERS),
        np.zeros(most), np.zeros(most), np.zeros(most),
        np.zeros(most), np.zeros(most), np.zeros(most), np.zeros(most), np.zeros((2, shape.face_edges.shape[1], 5)),
        np.zeros(MAX_STRETCH_ROWS, np.int64),
        np.zeros((MAX_STRETCH_ROWS, PARAMETERS)), np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((PARAMETERS, 4)), np.zeros(4),
        np.zeros(4), np.zeros(nf + 1), np.zeros((views, nf + 1, 5)), np.zeros((views, nf + 1, 2)),
        np.zeros((views, nf + 1, nf + 1)), np.zeros((views, nf + 1, PARAMETERS)), np.zeros((views, nf + 1)),
        np.zeros((views, nf + 2), np.int64), light, np.zeros(4),
    )  # fmt: skip


@inner_no_memory
def used_columns(sampling: EdgeSampling) -> int:
    """Leading columns of the normal equations that are filled."""
    if sampling.with_response:
        return PARAMETERS
    return BLUR + 1 if sampling.with_blur else BLUR


@compiled(nogil=True)
def new_equations() -> NormalEquations:
    """Normal equations of no pixel."""
    return NormalEquations(np.zeros((PARAMETERS, PARAMETERS)), np.zeros(PARAMETERS), np.zeros(STATISTICS))
