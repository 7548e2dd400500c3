"""What the pixels say about the edges of a die: the normal equations of one pose, and the steps that solve them.

Every visible edge is walked along whole pixel rows or columns, each real pixel once and without interpolation, so that
the noise of neighbouring samples stays independent and the covariance honest. Across an edge, at signed distance d [px]
from its projection, the image is modelled as

    I(d) = c0 [1 - a] + c1 b a,      a = Φ(d / σ)

where c0 is the face on the near side and c1 the other face (b = 1), or the shade on the known background (b = B, the
background without the die: c1 = 1 in full light and less in the die's own shadow). The intensities of a short stretch
of edge are eliminated from the equations (variable projection), and no model of the light is needed. Where the stretches beside
one face of a sharp die, or beside the background, are much alike, each also knows the others' grey (`_share_greys`).

A rounded die is a smaller sharp body with a ball rolled round it. Its contour is that body's contour pushed out by the
radius, and what lies between a flat face and the contour, or between two flat faces, is a strip on which the surface
normal turns from one to the other. With u from 0 to 1 along that turn, the strip's intensity is c0 + α u + β u² at the
contour and c0 (1 - u) + c1 u + γ p(u) + δ q(u) between two faces, p = 4u(1 - u) and q the cubic that is nought at both ends
and in the middle: what light from afar on a dull surface gives to second order, and to third over the wider turn, which
passes through the light's direction and into the shade. The strip is drawn in CELLS pieces of equal turn, each between its own
two lines of the image; α, β, γ, δ are held near zero by a weak prior, because a strip seen too narrow does not show them.

Where the clip shows how bright a surface looks by where it turns (`light`), B(u) along the strip, c0 B(u)/B(0) takes the place of
c0, and the straight line between two faces is multiplied by B(u) over what lies straight between B(0) and B(1). α, β, γ, δ then
are no larger than what faces differ from B.

Where a clip has few grey levels, rounding to steps s wider than its noise errs alike on all pixels of one grey. The two greys
beside an edge are each off by s/√12, and the pixels between, which take all levels, by nothing in the mean: it is as if these
were off by e = s/√24 from the others, and the whole edge is shifted by e Σ|I'| / Σ I'², some 0.7 σ s/|c1 b - c0|. Its stretches
count for as much less as leaves the edge no surer than that.

The blur σ is that of the lens, and on every row also that of the motion: an edge that moves by m pixels across itself
during the exposure is spread by a box of variance m²/12, and what its path bends within the exposure T shifts its mean
place by T²/24 of the second derivative of d, which counts where the die turns by some hundredths of a radian. Marks and
shadows are left to a redescending weight (Tukey's biweight) whose scale comes from the residuals of the same stretch of
edge, because the grain on a die's faces is several times the noise of the still background.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R. Beside
them the equations have two columns that belong to a whole clip and not to a frame: the contour taken δ [px] too far out
(a bevel or a glare that the model does not know), and the blur. They are not solved for here; they say what such an error
does to the pose (`lean`), and let the blur be estimated over many frames.

What stands before the die (a rod, a frame) is in the background, and its borders look like contours of the die. Where a
pose well borne out puts the die before pixels that show the background and never change, the background becomes NaN, and
every row that touches it is left out: the pose is then as unsure as what is left makes it, and the motion carries it.

Several views add up their equations: cameras, and for a table that reflects, each camera seen in the mirror (its pose
times diag(1, 1, -1): the die's reflection is what the mirrored camera sees). Where the die and its reflection hide each
other, or one is the background of the other, the rows are left out.
"""

from __future__ import annotations

from math import acos, atan2, ceil, cos, floor, hypot, isnan, log, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from ..model.compiled import compiled, inner
from ..model.motion import GRAVITY_M_S2

SEGMENT_PX = 24.0
"""Length of edge that shares its intensities: short enough for shading and shadow to be constant along it."""
BUFFER = 2048
"""Pixels of one such stretch at the most."""
CURVED_PX = 0.005
"""Displacement of an edge by the curvature of its motion within the exposure from which that is taken into account."""
CELLS = 5
"""Pieces of a rounded strip: with a radius of a few pixels each is narrower than the blur."""
LIGHT_DEGREE = 4
LIGHT_TERMS = (LIGHT_DEGREE + 1) ** 2
"""Degree of the polynomial of the normal that says how bright a surface looks, and number of its coefficients."""
SLIVER = 0.04
"""Cosine below which a face is seen too much from the side for its edges to be told apart."""
TUKEY = 4.685
"""Cut of the biweight in sigmas: 95 % efficient on clean Gaussian residuals."""
BIWEIGHT_VARIANCE = 0.8281
"""Mean square of Gaussian residuals of unit variance under the biweight's own weights with that cut."""
ROBUST_TURNS = 3
"""Times that the intensities of a stretch are solved with weights from the last residuals."""
MEDIAN_TO, MOST_HALVINGS = 0.02, 16
"""Part of itself to which a median is found, and steps in which it is where most values are not nought; of 200 Gaussian residuals
it is known to a fifteenth."""
OVERSTEP = 1.4
"""Factor on the steps at the lens blur. With the weights of the last residuals kept, as here, the normal equations are steeper
than the robust cost, by 1.2 for Gaussian residuals and by 1.6 on grain: a plain step left 38 % of the way on wood. Up to twice
the step converges wherever they are steeper at all."""
FEWEST_ALIKE = 4.0
"""Stretches beside a face from which it is known how much they differ."""
APART_PX = 2.0
"""Margin about the outline of a reflection (or of the die before its reflection) within which rows are left out."""
COLUMNS = 8
"""Pose (6), contour error [px], blur [px]."""
BLUR = 7
COARSE = ((4.0, 12.0), (3.0, 10.0), (2.2, 8.0), (1.6, 6.5), (1.2, 5.0))
"""Blur and band [px] of the first steps from an uncertain start."""
FACE_CUT, SHADOW_CUT = 16.0, 4.0
"""Squared sigmas at which a pixel's misfit is cut off; lower where the image is darker than the background, which a
shadow explains."""
WINDOW_PX, NARROW_PX = 20.0, 11.0
"""Margin of the window about the outline: the widest band, and what a prediction may be off; and where the lens blur does
at once, whose band is a few pixels wide."""
NEARBY_PX = 1.0
"""A refinement that moves the die by more than this began too far off to start at the lens blur: its band would have missed
what a coarser one sees."""
SCREENED, SCREEN_PX, SCREEN_SIGMAS, CHANGED_SIGMAS = 0.04, 2, 1.2, 4.0
"""Share of the die that shows nothing but the background from which something is looked for that stands before it; half the
width of the square of pixels that must show no die at all, root mean square difference from the background there [noise],
and the difference that no pixel of something still ever reaches."""
DEARER, MUCH_DEARER = 0.35, 2.5
"""By how much a pose in flight may cost more than usual before other explanations are tried, and the same for a pose NEAR
where the motion leads whose contour is badly seen; where it is well seen, a changed light does not count."""
NEAR = 30.0
"""Squared sigmas of six numbers: one in 25 000 of honest poses lies further off."""
FADE = 1.06
"""Growth of a motion's covariance a frame."""
GRAVITY = GRAVITY_M_S2

_FINE, _FAR = 128, 5.0
_STEP = np.arange(-_FAR * _FINE, _FAR * _FINE + 2) / _FINE
_PHI = np.asarray(ndtr(_STEP))
_BELL = np.exp(-0.5 * _STEP**2) / np.sqrt(2.0 * np.pi)
"""Φ and its derivative, tabulated: linear interpolation is right to 2e-6, a thousandth of what a grey level shows."""


def _strip_weights() -> Any:
    """(2, CELLS + 1, 4) what each line of a rounded strip adds to the basis functions, at the contour and between two
    faces: the change there of the intensity as a function of the turn u."""
    u = (np.arange(CELLS) + 0.5) / CELLS
    flat, none = np.ones(CELLS), np.zeros(CELLS)
    contour = np.stack([flat, none, u, u * u]), np.eye(4)[1]
    humps = 4.0 * u * (1.0 - u), 6.0 * np.sqrt(3.0) * u * (1.0 - u) * (1.0 - 2.0 * u)
    between = np.stack([1.0 - u, u, *humps]), np.eye(4)[1]
    return np.stack(
        [np.diff(inside, axis=1, prepend=np.eye(4)[:, :1], append=far[:, None]).T for inside, far in (contour, between)]
    )


_STRIP = np.ascontiguousarray(_strip_weights())
_inner = inner(nogil=True)
_free = inner(nogil=True, _nrt=False)
_free_sums = inner(nogil=True, _nrt=False, fastmath={"reassoc", "contract", "nsz"})
"""For kernels that only others call. The free ones take no memory and count no references to arrays: counting took a quarter of
the time. Of the last, plain sums over pixels, the order is left to the compiler: four times the speed and no other figure."""


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


class Eyes(NamedTuple):
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


class Screen(NamedTuple):
    """What stands before the die, a rod or a frame: it is in the background, and stays as it is where the die must be."""

    still: Any
    """(cameras, height, width) float32, the background without gaps."""
    changed: Any
    """(cameras, height, width) uint8, 1 where some picture differed from the background."""
    core: Any
    """(cameras, height, width) uint8, 1 where the die was and was not seen, and nothing ever changed."""
    found: Any
    """(1,) pixels of the core."""


class Sight(NamedTuple):
    """Pixels of one frame, a window of each camera's picture."""

    pixels: Any
    """(cameras, rows, columns) float32."""
    corner: Any
    """(cameras, 2) x, y of pixel [0, 0]."""
    size: Any
    """(cameras, 2) width and height of the window; 0 where the camera does not see the die."""


class Lens(NamedTuple):
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


class Desk(NamedTuple):
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
    """(views, faces + 1, faces + 1) normal matrix of those greys; what `_eliminate` leaves is its factor, of those that count."""
    by_shared: Any
    """(views, faces + 1, COLUMNS) of pose, contour and blur by those greys."""
    pull: Any
    """(views, faces + 1) right side of those greys."""
    which: Any
    """(views, faces + 2) how many greys are shared, and whose."""


@compiled(nogil=True)
def new_desk(shape: Shape, eyes: Eyes) -> Desk:
    """An empty desk for dice of this shape."""
    nv, ne, nf = shape.vertices.shape[0], shape.edges.shape[0], shape.normals.shape[0]
    views = eyes.camera.shape[0]
    return Desk(
        np.zeros((nv, 2)), np.zeros((nv, 3)), np.zeros((nv, 3)), np.zeros((nf, 3)), np.zeros(nf), np.zeros((2, 3)),
        np.zeros(3), np.zeros(CELLS + 1), np.zeros((CELLS + 1, 4)), np.zeros(3), np.zeros((ne, 3)), np.zeros((4, BUFFER)),
        np.zeros((4, BUFFER)), np.zeros((4, BUFFER)), np.zeros(BUFFER), np.zeros(BUFFER), np.zeros(BUFFER), np.zeros(BUFFER),
        np.zeros(BUFFER), np.zeros((2, shape.face_edges.shape[1], 5)), np.zeros(514, np.int64), np.zeros((514, COLUMNS)),
        np.zeros((4, 4)), np.zeros((4, 4)), np.zeros((COLUMNS, 4)),
        np.zeros(4), np.zeros(4), np.zeros(nf + 1), np.zeros((views, nf + 1, 5)), np.zeros((views, nf + 1, 2)),
        np.zeros((views, nf + 1, nf + 1)), np.zeros((views, nf + 1, COLUMNS)), np.zeros((views, nf + 1)),
        np.zeros((views, nf + 2), np.int64),
    )  # fmt: skip


@_free
def _project(K: Any, dist: Any, x: float, y: float, z: float, J: Any) -> tuple[float, float]:
    """Pixel of a camera point and, in J (2, 3), its derivative."""
    iz = 1.0 / z
    a, b = x * iz, y * iz
    k1, k2, p1, p2, k3 = dist[0], dist[1], dist[2], dist[3], dist[4]
    r2 = a * a + b * b
    g = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    dg = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    ad = a * g + 2.0 * p1 * a * b + p2 * (r2 + 2.0 * a * a)
    bd = b * g + p1 * (r2 + 2.0 * b * b) + 2.0 * p2 * a * b
    aa = g + 2.0 * a * a * dg + 2.0 * p1 * b + 6.0 * p2 * a
    ab = 2.0 * a * b * dg + 2.0 * p1 * a + 2.0 * p2 * b
    bb = g + 2.0 * b * b * dg + 6.0 * p1 * b + 2.0 * p2 * a
    ua, ub = K[0, 0] * aa + K[0, 1] * ab, K[0, 0] * ab + K[0, 1] * bb
    va, vb = K[1, 1] * ab, K[1, 1] * bb
    J[0, 0], J[0, 1], J[0, 2] = ua * iz, ub * iz, -(ua * a + ub * b) * iz
    J[1, 0], J[1, 1], J[1, 2] = va * iz, vb * iz, -(va * a + vb * b) * iz
    return K[0, 0] * ad + K[0, 1] * bd + K[0, 2], K[1, 1] * bd + K[1, 2]


@_free
def _factor(A: Any, K: int, L: Any, least: float) -> bool:
    """Cholesky factor of the leading K × K of A, in L; False where a pivot keeps no more than the part `least` of its
    diagonal."""
    for i in range(K):
        for j in range(i + 1):
            s = A[i, j]
            for k in range(j):
                s -= L[i, k] * L[j, k]
            if i == j:
                if not s > least * A[i, i]:
                    return False
                L[i, i] = sqrt(s)
            else:
                L[i, j] = s / L[j, j]
    return True


@_free
def _back(L: Any, K: int, y: Any, out: Any) -> None:
    """Solve L Lᵀ out = y."""
    for i in range(K):
        s = y[i]
        for k in range(i):
            s -= L[i, k] * out[k]
        out[i] = s / L[i, i]
    for i in range(K - 1, -1, -1):
        s = out[i]
        for k in range(i + 1, K):
            s -= L[k, i] * out[k]
        out[i] = s / L[i, i]


@_free_sums
def _median(values: Any, n: int) -> float:
    """Median of the first n of some sizes, to MEDIAN_TO of it: by halving an interval, whose counts are done eight at a time,
    where sorting waits at every comparison."""
    total = 0.0
    for i in range(n):
        total += values[i]
    # Half of them at the least lie below twice their mean.
    low, high = 0.0, 2.0 * total / n
    for _ in range(MOST_HALVINGS):
        if high - low <= MEDIAN_TO * high:
            break
        middle, below = 0.5 * (low + high), 0.0
        for i in range(n):
            below += 1.0 if values[i] < middle else 0.0
        if 2.0 * below < n:
            low = middle
        else:
            high = middle
    return 0.5 * (low + high)


@_free_sums
def _two_sums(
    n: int, icut: float, near: Any, far: Any, grey: Any, res: Any, w: Any
) -> tuple[float, float, float, float, float]:
    """Normal matrix (a00, a10, a11) and right side of two intensities, with weights from the last residuals (all one for
    `icut` zero)."""
    a00, a10, a11, y0, y1 = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        wi = q * q
        w[i] = wi
        w0, w1 = wi * near[i], wi * far[i]
        a00 += w0 * near[i]
        a10 += w1 * near[i]
        a11 += w1 * far[i]
        y0 += w0 * grey[i]
        y1 += w1 * grey[i]
    return a00, a10, a11, y0, y1


@_free
def _two_left(n: int, c0: float, c1: float, near: Any, far: Any, grey: Any, res: Any, size: Any) -> None:
    """What two intensities leave of the grey levels, and its size."""
    for i in range(n):
        res[i] = grey[i] - c0 * near[i] - c1 * far[i]
        size[i] = abs(res[i])


@_free_sums
def _four_sums(n: int, icut: float, phi: Any, grey: Any, res: Any, w: Any, A: Any, y: Any) -> None:
    """The same for the four intensities of a rounded edge, as normal matrix A (lower half) and right side y."""
    p0, p1, p2, p3 = phi[0], phi[1], phi[2], phi[3]
    a00, a10, a11, a20, a21, a22, a30, a31, a32, a33 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    y0, y1, y2, y3 = 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        wi = q * q
        w[i] = wi
        w0, w1, w2, w3 = wi * p0[i], wi * p1[i], wi * p2[i], wi * p3[i]
        a00 += w0 * p0[i]
        a10 += w1 * p0[i]
        a11 += w1 * p1[i]
        a20 += w2 * p0[i]
        a21 += w2 * p1[i]
        a22 += w2 * p2[i]
        a30 += w3 * p0[i]
        a31 += w3 * p1[i]
        a32 += w3 * p2[i]
        a33 += w3 * p3[i]
        y0 += w0 * grey[i]
        y1 += w1 * grey[i]
        y2 += w2 * grey[i]
        y3 += w3 * grey[i]
    A[0, 0], A[1, 0], A[1, 1], A[2, 0], A[2, 1], A[2, 2] = a00, a10, a11, a20, a21, a22
    A[3, 0], A[3, 1], A[3, 2], A[3, 3] = a30, a31, a32, a33
    y[0], y[1], y[2], y[3] = y0, y1, y2, y3


@_free_sums
def _four_left(n: int, c: Any, phi: Any, grey: Any, res: Any, size: Any) -> None:
    """What four intensities leave of the grey levels, and its size."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    p0, p1, p2, p3 = phi[0], phi[1], phi[2], phi[3]
    for i in range(n):
        res[i] = grey[i] - c0 * p0[i] - c1 * p1[i] - c2 * p2[i] - c3 * p3[i]
        size[i] = abs(res[i])


@_free_sums
def _scale_left(n: int, icut: float, res: Any) -> float:
    """Scale of residuals, given the inverse cut of the biweight about an earlier one: one step of an M-estimate, three
    times as efficient as the median that it starts from."""
    total, weights = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        q = q * q
        total += q * res[i] * res[i]
        weights += q
    return sqrt(total / (BIWEIGHT_VARIANCE * max(weights, 1.0)))


@_free_sums
def _rises(n: int, K: int, c: Any, icut: float, slope: Any, res: Any, rise: Any, w: Any) -> tuple[float, float]:
    """Derivative of the grey levels by d; robust cost and sum of the weights."""
    c0, c1, c2, c3 = c[0], c[1], c[2], c[3]
    s0, s1, s2, s3 = slope[0], slope[1], slope[2], slope[3]
    if K == 2:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i]
    else:
        for i in range(n):
            rise[i] = c0 * s0[i] + c1 * s1[i] + c2 * s2[i] + c3 * s3[i]
    cost, used = 0.0, 0.0
    for i in range(n):
        q = res[i] * icut
        q = max(1.0 - q * q, 0.0)
        cost += 1.0 - q * q * q
        used += w[i]
    return cost, used


@_free_sums
def _shift_alike(n: int, rise: Any, w: Any) -> float:
    """(Σ w |r|)² / Σ w r², with r the derivatives of grey levels by d: by how much the variance of d is greater where n
    pixels err alike, and not each for itself."""
    total, squares = 0.0, 0.0
    for i in range(n):
        total += w[i] * abs(rise[i])
        squares += w[i] * rise[i] * rise[i]
    return total * total / max(squares, 1e-30)


@_free
def _stretch(
    desk: Desk, n: int, m: int, sharp: bool, interior: bool, under_sum: float, walked: float, floor_grey: float,
    weight: float, rounding_grey: float, strip_share: float, strip_grey: float, alike: float, full: bool, view: int,
    near: int, far: int, H: Any, g: Any, stats: Any,
) -> None:  # fmt: skip
    """Add one stretch of edge, n pixels in m rows over `walked` pixels of its length, to the normal equations.

    On the desk: `phi` (4, n), the basis functions of the intensities (near, far, and those of a rounded strip), with
    their derivatives `slope` by d and `spread` by the blur (the last is needed where `full`); `begin` (m + 1) the first
    pixel of each row and `rows` (m, 8) the derivative of d by pose and contour error. `under_sum` is the sum of the far
    side's known background (n between two faces); `weight` multiplies what is added. `near` and `far` are the faces whose greys
    it may share.
    """
    stats[2] += n
    stats[5] += 1.0
    if not interior:
        stats[3] += walked
    if n < 12:
        return
    phi, slope, spread, grey, w, res = desk.phi, desk.slope, desk.spread, desk.grey, desk.weight, desk.left
    A, L, y, c, C, size, rise = desk.A, desk.L, desk.y, desk.c, desk.C, desk.size, desk.rise
    K = 2 if sharp else 4
    base = under_sum / n
    scale, icut = floor_grey, 0.0
    greys, usual = desk.greys[view], desk.usual[view]
    known_near, known_far = 0.0, 0.0
    c[2], c[3] = 0.0, 0.0
    res[:n] = 0.0
    for turn_number in range(ROBUST_TURNS):
        if sharp:
            A[0, 0], A[1, 0], A[1, 1], y[0], y[1] = _two_sums(n, icut, phi[0], phi[1], grey, res, w)
            if turn_number == ROBUST_TURNS - 1:
                _note_greys(A, y, scale, greys[near], greys[far])
            known_near, known_far = usual[near, 1] * scale * scale, usual[far, 1] * scale * scale
            A[0, 0] += known_near
            A[1, 1] += known_far
            y[0] += known_near * usual[near, 0]
            y[1] += known_far * usual[far, 0]
        else:
            _four_sums(n, icut, phi, grey, res, w, A, y)
            if strip_grey > 0.0:
                prior = (scale / strip_grey) ** 2
            else:
                level = 0.5 * (abs(y[0] / max(A[0, 0], 1e-9)) + abs(y[1] / max(A[1, 1], 1e-9)) * base) + 1.0
                prior = (max(scale, 2.0) / (strip_share * level)) ** 2
            A[2, 2] += prior
            A[3, 3] += prior
        if not _factor(A, K, L, 1e-9):
            return
        _back(L, K, y, c)
        if sharp:
            _two_left(n, c[0], c[1], phi[0], phi[1], grey, res, size)
        else:
            _four_left(n, c, phi, grey, res, size)
        if turn_number < ROBUST_TURNS - 1:
            scale = max(floor_grey, 1.4826 * _median(size, n))
        else:
            scale = max(floor_grey, _scale_left(n, icut, res))
        icut = 1.0 / (TUKEY * scale)
    iv = weight / (scale * scale)
    cost, used = _rises(n, K, c, icut, slope, res, rise, w)
    if rounding_grey > 0.0:
        iv /= 1.0 + alike * iv * rounding_grey * rounding_grey / 24.0 * _shift_alike(n, rise, w)
    begin, rows = desk.begin, desk.rows
    C[:] = 0.0
    for k in range(m):
        # All pixels of a row share the derivative of d: sums over the row first, the pose once a row.
        rr, re, r0, r1, r2, r3, rs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(begin[k], begin[k + 1]):
            wr = w[i] * rise[i]
            rr += wr * rise[i]
            re += wr * res[i]
            r0 += wr * phi[0, i]
            r1 += wr * phi[1, i]
        if not sharp:
            for i in range(begin[k], begin[k + 1]):
                wr = w[i] * rise[i]
                r2 += wr * phi[2, i]
                r3 += wr * phi[3, i]
        if full:
            for i in range(begin[k], begin[k + 1]):
                widen = c[0] * spread[0, i] + c[1] * spread[1, i]
                if not sharp:
                    widen += c[2] * spread[2, i] + c[3] * spread[3, i]
                ws = w[i] * widen
                rs += ws * rise[i]
                H[BLUR, BLUR] += iv * ws * widen
                g[BLUR] += iv * ws * res[i]
                for a in range(K):
                    C[BLUR, a] += iv * ws * phi[a, i]
        j0, j1, j2, j3 = rows[k, 0], rows[k, 1], rows[k, 2], rows[k, 3]
        j4, j5, j6, j7 = rows[k, 4], rows[k, 5], rows[k, 6], rows[k, 7]
        for a in range(BLUR):
            ja = iv * rows[k, a]
            g[a] += ja * re
            C[a, 0] += ja * r0
            C[a, 1] += ja * r1
            C[a, 2] += ja * r2
            C[a, 3] += ja * r3
            # The whole row, though the lower half would do: eight sums at once, and none that the compiler must take for an
            # overlap of H and `rows`.
            jr, h = ja * rr, H[a]
            h[0] += jr * j0
            h[1] += jr * j1
            h[2] += jr * j2
            h[3] += jr * j3
            h[4] += jr * j4
            h[5] += jr * j5
            h[6] += jr * j6
            h[7] += jr * j7
            H[BLUR, a] += ja * rs
    # The intensities are eliminated: H -= C S⁻¹ Cᵀ, with S = A iv their own normal matrix.
    top = COLUMNS if full else BLUR
    sharing = known_near > 0.0 or known_far > 0.0
    by_near, by_far = desk.by_shared[view, near], desk.by_shared[view, far]
    for b in range(top):
        _back(L, K, C[b], y)
        for a in range(b, top):
            lost = C[a, 0] * y[0] + C[a, 1] * y[1]
            if not sharp:
                lost += C[a, 2] * y[2] + C[a, 3] * y[3]
            H[a, b] -= lost / iv
        if sharing:
            by_near[b] += known_near * y[0]
            by_far[b] += known_far * y[1]
    if sharing:
        shared, pull = desk.shared[view], desk.pull[view]
        det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
        shared[near, near] += iv * (known_near - known_near * known_near * A[1, 1] / det)
        shared[far, far] += iv * (known_far - known_far * known_far * A[0, 0] / det)
        both = iv * known_near * known_far * A[1, 0] / det
        shared[near, far] += both
        shared[far, near] += both
        pull[near] += iv * known_near * (c[0] - usual[near, 0])
        pull[far] += iv * known_far * (c[1] - usual[far, 0])
    stats[0] += cost
    stats[1] += used
    stats[6] += n * log(scale)
    contrast = abs(c[1] * base - c[0])
    if not interior and (contrast > 3.0 * scale or (contrast > 1.0 * scale and used > 30)):
        stats[4] += walked


@_free
def _note_greys(A: Any, y: Any, scale: float, near: Any, far: Any) -> None:
    """Add the two intensities that a stretch alone shows, with their information, to the sums of either side."""
    det = A[0, 0] * A[1, 1] - A[1, 0] * A[1, 0]
    if not det > 1e-9 * A[0, 0] * A[1, 1]:
        return
    iv = 1.0 / (scale * scale)
    c0, c1 = (A[1, 1] * y[0] - A[1, 0] * y[1]) / det, (A[0, 0] * y[1] - A[1, 0] * y[0]) / det
    p0, p1 = iv * det / A[1, 1], iv * det / A[0, 0]
    near[0] += 1.0
    near[1] += p0
    near[2] += p0 * p0
    near[3] += p0 * c0
    near[4] += p0 * c0 * c0
    far[0] += 1.0
    far[1] += p1
    far[2] += p1 * p1
    far[3] += p1 * c1
    far[4] += p1 * c1 * c1


@_free
def _eliminate(desk: Desk, view: int, top: int, H: Any, g: Any) -> None:
    """Eliminate the greys that the stretches of one view share from its normal equations: the `top` leading rows of H (lower
    half) and g. Those greys are `usual` so far; what they become waits for the step of the pose, see `_share_greys`."""
    M, X, pull, which, y = desk.shared[view], desk.by_shared[view], desk.pull[view], desk.which[view], desk.solved
    count = np.int64(0)
    for f in range(pull.shape[0]):
        if M[f, f] > 0.0:
            count += 1
            which[count] = f
    # Those that count are moved together; their order stays, so that nothing is written before it was read.
    for i in range(count):
        for j in range(i + 1):
            M[i, j] = M[which[i + 1], which[j + 1]]
        pull[i] = pull[which[i + 1]]
        for a in range(top):
            X[i, a] = X[which[i + 1], a]
    which[0] = count if _factor(M, count, M, 1e-12) else 0
    for a in range(top):
        for i in range(which[0]):
            y[i] = X[i, a]
        _back(M, which[0], y, y)
        for i in range(which[0]):
            g[a] -= y[i] * pull[i]
            for b in range(a, top):
                H[b, a] -= y[i] * X[i, b]


@_free
def _share_greys(desk: Desk, step: Any) -> None:
    """After a step (6,) of the pose: the greys that stretches share, and how far the stretches beside a face differ from theirs
    beyond their own noise (DerSimonian and Laird, Control. Clin. Trials 7, 177, 1986). A face of one grey helps every edge
    of it; light, shadow and grain make its stretches differ, and each is left to itself."""
    greys, usual, y = desk.greys, desk.usual, desk.solved
    for view in range(greys.shape[0]):
        which = desk.which[view]
        for i in range(which[0]):
            y[i] = desk.pull[view, i]
            for a in range(6):
                y[i] -= desk.by_shared[view, i, a] * step[a]
        _back(desk.shared[view], which[0], y, y)
        for i in range(which[0]):
            usual[view, which[i + 1], 0] += y[i]
        for f in range(greys.shape[1]):
            count, p, pp, pc, pcc = (
                greys[view, f, 0],
                greys[view, f, 1],
                greys[view, f, 2],
                greys[view, f, 3],
                greys[view, f, 4],
            )
            known = usual[view, f, 1] > 0.0
            usual[view, f, 1] = 0.0
            if count >= FEWEST_ALIKE:
                mean = pc / p
                beyond = pcc - mean * pc - (count - 1.0)
                spread = max(beyond, sqrt(2.0 * (count - 1.0))) / (p - pp / p)
                if not known:
                    usual[view, f, 0] = mean
                usual[view, f, 1] = 1.0 / spread
            for a in range(5):
                greys[view, f, a] = 0.0
        which[0] = 0


@_free
def _strip_turn(aw: Any, n0: Any, n1: Any, interior: bool, turned: Any) -> float:
    """The angle through which the normal turns on a rounded strip, from n0 to n1 or to the contour, and in `turned` (3,) the
    direction it turns to, at a right angle to n0. `aw` is the derivative of d by a world displacement."""
    size = sqrt(aw[0] * aw[0] + aw[1] * aw[1] + aw[2] * aw[2])
    e0, e1, e2 = (n1[0], n1[1], n1[2]) if interior else (aw[0] / size, aw[1] / size, aw[2] / size)
    along = n0[0] * e0 + n0[1] * e1 + n0[2] * e2
    e0, e1, e2 = e0 - along * n0[0], e1 - along * n0[1], e2 - along * n0[2]
    across = sqrt(max(e0 * e0 + e1 * e1 + e2 * e2, 1e-30))
    turned[0], turned[1], turned[2] = e0 / across, e1 / across, e2 / across
    return acos(min(1.0, max(-1.0, along)))


@_free
def _strip_lines(aw: Any, n0: Any, turned: Any, angle: float, radius: float, lines: Any) -> None:
    """Signed distances [px] of the CELLS + 1 lines of a rounded strip from the inner body's edge: the surface points
    whose normals divide the turn into equal parts."""
    d0 = radius * (aw[0] * n0[0] + aw[1] * n0[1] + aw[2] * n0[2])
    d1 = radius * (aw[0] * turned[0] + aw[1] * turned[1] + aw[2] * turned[2])
    c, s = cos(angle / CELLS), sin(angle / CELLS)
    lines[0] = d0
    for j in range(1, CELLS + 1):
        d0, d1 = c * d0 + s * d1, c * d1 - s * d0
        lines[j] = d0
    for j in range(1, CELLS + 1):
        lines[j] = max(lines[j], lines[j - 1])


@_free
def _brightness(light: Any, x: float, y: float, z: float) -> float:
    """How bright a surface of normal (x, y, z) looks."""
    total, k, a = 0.0, np.int64(0), 1.0
    for i in range(LIGHT_DEGREE + 1):
        b = a
        for j in range(LIGHT_DEGREE + 1 - i):
            total += light[k] * b
            k += 1
            if i + j < LIGHT_DEGREE:
                total += light[k] * b * z
                k += 1
            b *= y
        a *= x
    return max(total, light[k])


@_free
def _strip_shades(light: Any, n0: Any, turned: Any, angle: float, interior: bool, strip: Any) -> None:
    """In `strip` (CELLS + 1, 4) what each line adds to the basis functions, of a strip that the light shades."""
    kind = 1 if interior else 0
    for j in range(CELLS + 1):
        for a in range(4):
            strip[j, a] = _STRIP[kind, j, a]
    if not light[LIGHT_TERMS + 1] > 0.0:
        return
    first = _brightness(light, n0[0], n0[1], n0[2])
    c, s = cos(angle), sin(angle)
    last = _brightness(light, c * n0[0] + s * turned[0], c * n0[1] + s * turned[1], c * n0[2] + s * turned[2])
    near, far = 1.0, 0.0
    for j in range(CELLS):
        u = (j + 0.5) / CELLS
        c, s = cos(u * angle), sin(u * angle)
        here = _brightness(light, c * n0[0] + s * turned[0], c * n0[1] + s * turned[1], c * n0[2] + s * turned[2])
        if interior:
            shade = here / ((1.0 - u) * first + u * last)
            strip[j, 0], strip[j, 1] = (1.0 - u) * shade - near, u * shade - far
            near, far = near + strip[j, 0], far + strip[j, 1]
        else:
            strip[j, 0] = here / first - near
            near += strip[j, 0]
    strip[CELLS, 0], strip[CELLS, 1] = -near, 1.0 - far


@_free
def _place(shape: Shape, eyes: Eyes, view: int, pos: Any, R: Any, desk: Desk) -> bool:
    """Put the die before one view: vertices in camera axes and in pixels, which faces look at it. False where a vertex
    lies behind the camera."""
    Rcw, tcw = eyes.rotation[view], eyes.translation[view]
    K, dist = eyes.matrix[view], eyes.distortion[view]
    for i in range(shape.vertices.shape[0]):
        x, y, z = shape.vertices[i, 0], shape.vertices[i, 1], shape.vertices[i, 2]
        for a in range(3):
            desk.arm[i, a] = R[a, 0] * x + R[a, 1] * y + R[a, 2] * z
        for a in range(3):
            desk.cam[i, a] = tcw[a]
            for b in range(3):
                desk.cam[i, a] += Rcw[a, b] * (pos[b] + desk.arm[i, b])
        if desk.cam[i, 2] <= 1e-6:
            return False
        desk.px[i, 0], desk.px[i, 1] = _project(K, dist, desk.cam[i, 0], desk.cam[i, 1], desk.cam[i, 2], desk.J)
    # From the die's centre to the camera's.
    e0, e1, e2 = -pos[0], -pos[1], -pos[2]
    for b in range(3):
        e0 -= Rcw[b, 0] * tcw[b]
        e1 -= Rcw[b, 1] * tcw[b]
        e2 -= Rcw[b, 2] * tcw[b]
    gap = sqrt(e0 * e0 + e1 * e1 + e2 * e2)
    for f in range(shape.normals.shape[0]):
        for a in range(3):
            desk.normal[f, a] = (
                R[a, 0] * shape.normals[f, 0] + R[a, 1] * shape.normals[f, 1] + R[a, 2] * shape.normals[f, 2]
            )
        toward = desk.normal[f, 0] * e0 + desk.normal[f, 1] * e1 + desk.normal[f, 2] * e2
        desk.facing[f] = (toward - shape.offsets[f] - shape.radius) / gap
    return True


@_free
def _hull(shape: Shape, desk: Desk) -> int:
    """Lines (a, b, c) of the outline of the die as placed, a x + b y + c > 0 inside; their number. The ball's radius is
    left to APART_PX and to the caller's margin."""
    mx, my = 0.0, 0.0
    for i in range(desk.px.shape[0]):
        mx += desk.px[i, 0] / desk.px.shape[0]
        my += desk.px[i, 1] / desk.px.shape[0]
    count = 0
    for e in range(shape.edges.shape[0]):
        if (desk.facing[shape.edge_faces[e, 0]] > 0.0) == (desk.facing[shape.edge_faces[e, 1]] > 0.0):
            continue
        i, j = shape.edges[e, 0], shape.edges[e, 1]
        dx, dy = desk.px[j, 0] - desk.px[i, 0], desk.px[j, 1] - desk.px[i, 1]
        length = max(hypot(dx, dy), 1e-9)
        a, b = -dy / length, dx / length
        c = -(a * desk.px[i, 0] + b * desk.px[i, 1])
        if a * mx + b * my + c < 0.0:
            a, b, c = -a, -b, -c
        desk.hull[count, 0], desk.hull[count, 1], desk.hull[count, 2] = a, b, c
        count += 1
    return count


@_free
def _within(hull: Any, count: int, x: float, y: float, margin: float) -> bool:
    """Whether a pixel lies inside the outline widened by a margin [px]."""
    for k in range(count):
        if hull[k, 0] * x + hull[k, 1] * y + hull[k, 2] < -margin:
            return False
    return count > 0


@_free
def _neighbours(face: Any, edges: Any, px: Any, e: int, steep: bool, out: Any) -> int:
    """The other edges of a face (its edges padded with -1) as functions of the pixel line that crosses them: first and
    last line, where the first vertex's line is, position there, and step a line. How many there are."""
    count = 0
    for j in range(face.shape[0]):
        o = face[j]
        if o < 0:
            break
        if o == e:
            continue
        i, k = edges[o, 0], edges[o, 1]
        dx, dy = px[k, 0] - px[i, 0], px[k, 1] - px[i, 1]
        run, rise, start, at = (dx, dy, px[i, 1], px[i, 0]) if steep else (dy, dx, px[i, 0], px[i, 1])
        if abs(rise) < 1e-9:
            continue
        slack = 0.02 * abs(rise)
        out[count, 0], out[count, 1] = min(start, start + rise) - slack, max(start, start + rise) + slack
        out[count, 2], out[count, 3], out[count, 4] = start, at, run / rise
        count += 1
    return count


@_free
def _room_beside(others: Any, count: int, line: int, at: float) -> float:
    """Distance along a pixel line from an edge's point to the nearest other edge of its face that the line crosses."""
    nearest = 1e9
    for j in range(count):
        if line >= others[j, 0] and line <= others[j, 1]:
            nearest = min(nearest, abs(others[j, 3] + (line - others[j, 2]) * others[j, 4] - at))
    return nearest


@_free
def _rounded_basis(
    d: float, ib: float, shade: float, strip: Any, lines: Any, full: bool, phi: Any, slope: Any, spread: Any, n: int
) -> None:
    """Basis functions of the intensities of pixel n at distance d from a rounded edge, with their derivatives by d and,
    where `full`, by the blur 1 / ib.

    A cell's share is the difference of two steps; summed by parts, each of the CELLS + 1 lines is looked up once and
    weighs what the basis function changes by there.
    """
    f0, f1, f2, f3 = 1.0, 0.0, 0.0, 0.0
    s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
    b0, b1, b2, b3 = 0.0, 0.0, 0.0, 0.0
    for j in range(CELLS + 1):
        t = (d - lines[j]) * ib
        a, p = _step(t)
        v0, v1, v2, v3 = strip[j, 0], strip[j, 1], strip[j, 2], strip[j, 3]
        f0, f1, f2, f3 = f0 + v0 * a, f1 + v1 * a, f2 + v2 * a, f3 + v3 * a
        p *= ib
        s0, s1, s2, s3 = s0 + v0 * p, s1 + v1 * p, s2 + v2 * p, s3 + v3 * p
        if full:
            p *= -t
            b0, b1, b2, b3 = b0 + v0 * p, b1 + v1 * p, b2 + v2 * p, b3 + v3 * p
    phi[0, n], phi[1, n], phi[2, n], phi[3, n] = f0, f1 * shade, f2, f3
    slope[0, n], slope[1, n], slope[2, n], slope[3, n] = s0, s1 * shade, s2, s3
    if full:
        spread[0, n], spread[1, n], spread[2, n], spread[3, n] = b0, b1 * shade, b2, b3


@_free_sums
def _sharp_basis(n: int, near: Any, far: Any, near_slope: Any, far_slope: Any) -> None:
    """Basis functions of the two intensities of n pixels beside sharp edges, and their derivatives by the distance, in place
    of that distance in blurs (`near`), what shades the far side (`far`), and one over the blur (`near_slope`).

    As `_step`, without branches: several pixels at once.
    """
    for i in range(n):
        x = (min(max(near[i], -_FAR), _FAR) + _FAR) * _FINE
        k = int(x)
        x -= k
        a = _PHI[k] + x * (_PHI[k + 1] - _PHI[k])
        p = (_BELL[k] + x * (_BELL[k + 1] - _BELL[k])) * near_slope[i]
        near_slope[i], far_slope[i] = -p, p * far[i]
        near[i], far[i] = 1.0 - a, a * far[i]


@_free
def _step(t: float) -> tuple[float, float]:
    """Φ(t) and its derivative."""
    if t >= _FAR:
        return 1.0, 0.0
    if t <= -_FAR:
        return 0.0, 0.0
    x = (t + _FAR) * _FINE
    k = int(x)
    x -= k
    return _PHI[k] + x * (_PHI[k + 1] - _PHI[k]), _BELL[k] + x * (_BELL[k + 1] - _BELL[k])


@_free
def _view_equations(
    view: int, sight: Sight, backgrounds: Any, eyes: Eyes, shape: Shape, pos: Any, R: Any, vel: Any, omega: Any,
    exposure: float, sigma: float, band: float, stride: int, floor_grey: float, rounding_grey: float, strip_share: float,
    light: Any, full: bool, desk: Desk, H: Any, g: Any, stats: Any,
) -> None:  # fmt: skip
    """Add what one view says: H (8, 8, lower half) and g (8,) of pose, contour error and blur (the last only where
    `full`), and `stats`.

    `backgrounds` (cameras, height, width) float32 are whole pictures, NaN where something stands before the die; one pixel
    line in `stride` is used. `stats` counts: robust cost, pixels used, pixels seen, length of visible contour inside the
    image [px], length of it with a clear step, stretches used, and the sum over pixels of the logarithm of the noise left
    over.
    """
    hidden_by = 0
    if eyes.partner[view] >= 0 and _place(shape, eyes, eyes.partner[view], pos, R, desk):
        hidden_by = _hull(shape, desk)
    if not _place(shape, eyes, view, pos, R, desk):
        return
    camera = eyes.camera[view]
    image, background = sight.pixels[camera], backgrounds[camera]
    x0, y0 = sight.corner[camera, 0], sight.corner[camera, 1]
    x1, y1 = x0 + sight.size[camera, 0] - 1, y0 + sight.size[camera, 1] - 1
    K, dist, Rcw = eyes.matrix[view], eyes.distortion[view], eyes.rotation[view]
    mirrored = eyes.partner[view] >= 0 and eyes.partner[view] < view
    radius, sharp = shape.radius, shape.radius == 0.0
    px, cam, arm, J, aw, edges = desk.px, desk.cam, desk.arm, desk.J, desk.across, shape.edges
    phi, slope, spread, grey, lines = desk.phi, desk.slope, desk.spread, desk.grey, desk.lines
    near_edges, far_edges = desk.beside[0], desk.beside[1]
    hull, normal, rows, starts = desk.hull, desk.normal, desk.rows, desk.begin
    speed2 = omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2
    curved = speed2 * exposure * exposure / 24.0 * _reach(shape) * K[0, 0] / cam[0, 2] > CURVED_PX
    lines[:] = 0.0
    strip_grey = light[view, LIGHT_TERMS + 1]
    desk.shared[view] = 0.0
    desk.by_shared[view] = 0.0
    desk.pull[view] = 0.0
    for e in range(shape.edges.shape[0]):
        f0, f1 = shape.edge_faces[e, 0], shape.edge_faces[e, 1]
        if desk.facing[f0] <= 0.0 and desk.facing[f1] <= 0.0:
            continue
        if desk.facing[f0] <= 0.0:
            f0, f1 = f1, f0
        interior = desk.facing[f1] > 0.0
        # A face seen at less than about 2 degrees is a sliver: its own edges lie within a pixel of each other and
        # neither can be told from the other.
        if desk.facing[f0] < SLIVER or (interior and desk.facing[f1] < SLIVER):
            continue
        iA, iB = shape.edges[e, 0], shape.edges[e, 1]
        ax, ay, bx, by = px[iA, 0], px[iA, 1], px[iB, 0], px[iB, 1]
        length = hypot(bx - ax, by - ay)
        if length < 6.0:
            continue
        steep = abs(by - ay) > abs(bx - ax)
        lo, hi = (min(ay, by), max(ay, by)) if steep else (min(ax, bx), max(ax, bx))
        trim = ((1.0 + 1.2 * sigma) if sharp else (1.5 + 1.5 * sigma)) * (hi - lo) / length
        first, last = ceil(lo + trim), floor(hi - trim)
        # Only what lies inside the window can be walked.
        first, last = (max(first, y0), min(last, y1)) if steep else (max(first, x0), min(last, x1))
        if last - first < 2:
            continue
        # Middle of the near face, to give the edge normal its sign: d grows away from face f0.
        mx, my, count = 0.0, 0.0, 0
        for j in range(shape.face_edges.shape[1]):
            o = shape.face_edges[f0, j]
            if o < 0:
                break
            mx += px[shape.edges[o, 0], 0] + px[shape.edges[o, 1], 0]
            my += px[shape.edges[o, 0], 1] + px[shape.edges[o, 1], 1]
            count += 2
        mx /= count
        my /= count
        beside_near = _neighbours(shape.face_edges[f0], edges, px, e, steep, near_edges)
        beside_far = _neighbours(shape.face_edges[f1], edges, px, e, steep, far_edges)
        n = m = np.int64(0)
        walked, under_sum = 0.0, 0.0
        row_length = stride * length / (hi - lo)
        Ax, Ay, Az, Bz = cam[iA, 0], cam[iA, 1], cam[iA, 2], cam[iB, 2]
        Dx, Dy, Dz = cam[iB, 0] - Ax, cam[iB, 1] - Ay, Bz - Az
        Px, Py, Pz = arm[iA, 0], arm[iA, 1], arm[iA, 2]
        Qx, Qy, Qz = arm[iB, 0] - Px, arm[iB, 1] - Py, arm[iB, 2] - Pz
        for line in range(first, last + 1 + stride, stride):
            if m > 0 and (walked >= SEGMENT_PX or line > last):
                if sharp:
                    _sharp_basis(n, phi[0], phi[1], slope[0], slope[1])
                    if full:
                        for j in range(n):
                            spread[0, j], spread[1, j] = -slope[0, j] * spread[0, j], -slope[1, j] * spread[0, j]
                _stretch(
                    desk, n, m, sharp, interior, under_sum, walked, floor_grey, eyes.weight[view],
                    rounding_grey, strip_share, strip_grey, (last - first + 1) / (stride * m), full, view,
                    f0, f1 if interior else len(desk.facing), H, g, stats,
                )  # fmt: skip
                n = m = np.int64(0)
                walked, under_sum = 0.0, 0.0
            if line > last:
                break
            lam = (line - ay) / (by - ay) if steep else (line - ax) / (bx - ax)
            s = lam * Az / ((1.0 - lam) * Bz + lam * Az)
            u, v = _project(K, dist, Ax + s * Dx, Ay + s * Dy, Az + s * Dz, J)
            tx = J[0, 0] * Dx + J[0, 1] * Dy + J[0, 2] * Dz
            ty = J[1, 0] * Dx + J[1, 1] * Dy + J[1, 2] * Dz
            tl = sqrt(tx * tx + ty * ty)
            nx, ny = ty / tl, -tx / tl
            if nx * (u - mx) + ny * (v - my) < 0.0:
                nx, ny = -nx, -ny
            a0, a1, a2 = nx * J[0, 0] + ny * J[1, 0], nx * J[0, 1] + ny * J[1, 1], nx * J[0, 2] + ny * J[1, 2]
            for a in range(3):
                aw[a] = Rcw[0, a] * a0 + Rcw[1, a] * a1 + Rcw[2, a] * a2
            rx, ry, rz = Px + s * Qx, Py + s * Qy, Pz + s * Qz
            qx, qy, qz = ry * aw[2] - rz * aw[1], rz * aw[0] - rx * aw[2], rx * aw[1] - ry * aw[0]
            if not sharp:
                angle = _strip_turn(aw, normal[f0], normal[f1], interior, desk.turned)
                _strip_lines(aw, normal[f0], desk.turned, angle, radius, lines)
                if m == 0:
                    _strip_shades(light[view], normal[f0], desk.turned, angle, interior, desk.strip)
            low, high = min(lines[0], 0.0), max(lines[CELLS], 0.0)
            blur, bend = sigma, 0.0
            if exposure > 0.0:
                move = (
                    aw[0] * vel[0] + aw[1] * vel[1] + aw[2] * vel[2] + qx * omega[0] + qy * omega[1] + qz * omega[2]
                ) * exposure
                blur = sqrt(sigma * sigma + move * move / 12.0)
                if curved:
                    bend = _bend(J, Rcw, nx, ny, rx, ry, rz, Qx, Qy, Qz, vel, omega) * exposure * exposure / 24.0
            across, middle = (abs(nx), u) if steep else (abs(ny), v)
            # The band stops short of the other edges of the faces beside it, and of their own strip and blur.
            inside = min(band - low, _room_beside(near_edges, beside_near, line, middle) * across - 2.0 * blur)
            outside = band + high
            if interior:
                outside = min(outside, _room_beside(far_edges, beside_far, line, middle) * across - 2.0 * blur)
            if inside + low < 1.2 * blur or outside - high < 1.2 * blur:
                continue
            if hidden_by > 0 and (mirrored or not interior):
                reach = high + 2.0 * blur
                if _within(hull, hidden_by, u, v, APART_PX + reach):
                    continue
            # Along the pixel line the signed distance grows with slope `step`.
            step = nx if steep else ny
            if step > 0.0:
                begin, end = ceil(middle - inside / step), floor(middle + outside / step)
            else:
                begin, end = ceil(middle + outside / step), floor(middle - inside / step)
            begin, end = (max(begin, x0), min(end, x1)) if steep else (max(begin, y0), min(end, y1))
            if end - begin < 2 or n + end - begin + 1 > BUFFER:
                continue
            # (line - u) or (line - v) is what the lens distortion leaves over; it shifts every pixel of the row alike.
            d = step * (begin - middle) + (ny * (line - v) if steep else nx * (line - u)) + bend
            ib = 1.0 / blur
            under_row = 0.0
            i = n
            for q in range(begin, end + 1):
                if steep:
                    value, under = image[line - y0, q - x0], background[line, q]
                else:
                    value, under = image[q - y0, line - x0], background[q, line]
                under_row += under
                shade = 1.0 if interior else float(under)
                if sharp:
                    phi[0, i], phi[1, i], slope[0, i] = d * ib, shade, ib
                    if full:
                        # The row's blur grows with the lens blur by σ / blur.
                        spread[0, i] = d * ib * sigma * ib
                else:
                    _rounded_basis(d, ib, shade, desk.strip, lines, full, phi, slope, spread, i)
                grey[i] = value
                d += step
                i += 1
            if isnan(under_row):
                continue
            if full and not sharp:
                for a in range(4):
                    for j in range(n, i):
                        spread[a, j] *= sigma * ib
            rows[m, 0], rows[m, 1], rows[m, 2] = -aw[0], -aw[1], -aw[2]
            rows[m, 3], rows[m, 4], rows[m, 5] = -qx, -qy, -qz
            # A contour taken δ too far out has every pixel δ nearer to the die.
            rows[m, 6] = 0.0 if interior else -1.0
            starts[m] = n
            under_sum += float(i - n) if interior else under_row
            n = i
            m += 1
            starts[m] = n
            walked += row_length
    if sharp:
        _eliminate(desk, view, COLUMNS if full else BLUR, H, g)


@_free
def _bend(
    J: Any, Rcw: Any, nx: float, ny: float, rx: float, ry: float, rz: float, Qx: float, Qy: float, Qz: float, vel: Any,
    omega: Any,
) -> float:  # fmt: skip
    """Second derivative by time [px/s²] of a pixel's signed distance d = n (p - e) from a moving edge, e its point there:
    2 φ' (t · e') - n · e'', with φ' the rate at which the edge's direction t turns in the picture. Of the point's
    acceleration only ω × (ω × r) counts; gravity moves it by nanometres within an exposure."""
    wx, wy, wz = omega[0], omega[1], omega[2]
    vx, vy, vz = wy * rz - wz * ry, wz * rx - wx * rz, wx * ry - wy * rx
    cx, cy, cz = wy * vz - wz * vy, wz * vx - wx * vz, wx * vy - wy * vx
    ex, ey, ez = wy * Qz - wz * Qy, wz * Qx - wx * Qz, wx * Qy - wy * Qx
    vx, vy, vz = vx + vel[0], vy + vel[1], vz + vel[2]
    along, across, turning, length, falling = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(3):
        # Normal and tangent (-ny, nx) of the edge, as derivatives by a world displacement along axis k.
        x = J[0, 0] * Rcw[0, k] + J[0, 1] * Rcw[1, k] + J[0, 2] * Rcw[2, k]
        y = J[1, 0] * Rcw[0, k] + J[1, 1] * Rcw[1, k] + J[1, 2] * Rcw[2, k]
        normal, tangent = nx * x + ny * y, nx * y - ny * x
        vk, ck, ek, qk = (vx, cx, ex, Qx) if k == 0 else ((vy, cy, ey, Qy) if k == 1 else (vz, cz, ez, Qz))
        along += tangent * vk
        across += normal * vk
        falling += normal * ck
        turning += normal * ek
        length += tangent * qk
    return 2.0 * turning / length * along - falling


@_free
def _reach(shape: Shape) -> float:
    """Farthest point of the die from its centre [m]."""
    reach = 0.0
    for i in range(shape.outer.shape[0]):
        reach = max(reach, sqrt(shape.outer[i, 0] ** 2 + shape.outer[i, 1] ** 2 + shape.outer[i, 2] ** 2))
    return reach


# --- steps ------------------------------------------------------------------------------------------------------------


@_inner
def _inverse(A: Any, n: int, out: Any) -> bool:
    """Inverse of the leading n × n of a symmetric positive definite matrix; False where it is not."""
    L, e, x = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    if not _factor(A, n, L, 1e-13):
        return False
    for a in range(n):
        e[:] = 0.0
        e[a] = 1.0
        _back(L, n, e, x)
        for b in range(n):
            out[b, a] = x[b]
    return True


@_inner
def _product(A: Any, B: Any) -> Any:
    """A B (3, 3)."""
    out = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            out[a, b] = A[a, 0] * B[0, b] + A[a, 1] * B[1, b] + A[a, 2] * B[2, b]
    return out


@_inner
def _turn_from(R: Any, Q: Any) -> Any:
    """Q Rᵀ (3, 3): the turn that takes R to Q."""
    out = np.empty((3, 3))
    for a in range(3):
        for b in range(3):
            out[a, b] = Q[a, 0] * R[b, 0] + Q[a, 1] * R[b, 1] + Q[a, 2] * R[b, 2]
    return out


@_inner
def turn(R: Any, w: Any) -> Any:
    """exp(w) R, by Rodrigues' formula; below 1e-8 rad the first-order form is exact to rounding."""
    return _product(_exp(w), R)


@_inner
def _exp(w: Any) -> Any:
    angle = sqrt(w[0] * w[0] + w[1] * w[1] + w[2] * w[2])
    W = np.zeros((3, 3))
    W[0, 1], W[0, 2], W[1, 2] = -w[2], w[1], -w[0]
    W[1, 0], W[2, 0], W[2, 1] = w[2], -w[1], w[0]
    if angle < 1e-8:
        return np.eye(3) + W
    s, c = sin(angle) / angle, (1.0 - cos(angle)) / (angle * angle)
    E = np.eye(3)
    for i in range(3):
        for j in range(3):
            square = W[i, 0] * W[0, j] + W[i, 1] * W[1, j] + W[i, 2] * W[2, j]
            E[i, j] += s * W[i, j] + c * square
    return E


@_free
def _log(R: Any, out: Any) -> None:
    """Rotation vector of a rotation by less than about 3 rad."""
    x, y, z = R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]
    s = 0.5 * sqrt(x * x + y * y + z * z)
    c = 0.5 * (R[0, 0] + R[1, 1] + R[2, 2] - 1.0)
    factor = 0.5 if s < 1e-9 else 0.5 * atan2(s, c) / s
    out[0], out[1], out[2] = factor * x, factor * y, factor * z


# --- the picture as a whole -------------------------------------------------------------------------------------------


@_inner
def picture_cost(
    sight: Sight, backgrounds: Any, eyes: Eyes, shape: Shape, pos: Any, R: Any, noise: float, samples: int, margin: float,
    desk: Desk,
) -> tuple[float, float]:  # fmt: skip
    """How badly the drawn die explains its surroundings, as the mean over `samples` pixels of truncated squared sigmas,
    and the share of the die's own pixels that differ from the background.

    Inside a face the image should be that face's mean grey; outside it should be the background, or a darker shade of it. Of a
    rounded die faces end at its contour, short of where those of a sharp one would.
    The surroundings are the outline's box and `margin` [px] about it, so rivals near each other see the same pixels.
    """
    score, number, inside, differs = 0.0, 0.0, 0.0, 0.0
    for view in range(eyes.camera.shape[0]):
        camera = eyes.camera[view]
        mirrored = eyes.partner[view] >= 0 and eyes.partner[view] < view
        if mirrored or sight.size[camera, 0] == 0 or not _place(shape, eyes, view, pos, R, desk):
            continue
        contour, ball_px = _contour(shape, eyes, view, pos, desk)
        if not _draw_outer(shape, eyes, view, pos, R, desk):
            return 1e9, 0.0
        x0, y0 = sight.corner[camera, 0], sight.corner[camera, 1]
        x1, y1 = x0 + sight.size[camera, 0], y0 + sight.size[camera, 1]
        low_x = max(floor(desk.px[:, 0].min() - margin), x0)
        low_y = max(floor(desk.px[:, 1].min() - margin), y0)
        high_x = min(ceil(desk.px[:, 0].max() + margin) + 1, x1)
        high_y = min(ceil(desk.px[:, 1].max() + margin) + 1, y1)
        if high_x - low_x < 4 or high_y - low_y < 4:
            continue
        a, b, c = _box_score(
            sight.pixels[camera], backgrounds[camera], x0, y0, low_x, low_y, high_x, high_y, shape, desk, contour, ball_px,
            noise, samples,
        )  # fmt: skip
        score += a
        number += 1.0
        inside += b
        differs += c
    if number == 0.0:
        return 1e9, 0.0
    return score / number, differs / max(inside, 1.0)


@_free
def _draw_outer(shape: Shape, eyes: Eyes, view: int, pos: Any, R: Any, desk: Desk) -> bool:
    """Put the vertices of the flat faces' sharp polyhedron, not those of the inner body, in pixels on the desk."""
    for i in range(shape.outer.shape[0]):
        for a in range(3):
            desk.cam[i, a] = eyes.translation[view, a]
            for b in range(3):
                arm = R[b, 0] * shape.outer[i, 0] + R[b, 1] * shape.outer[i, 1] + R[b, 2] * shape.outer[i, 2]
                desk.cam[i, a] += eyes.rotation[view, a, b] * (pos[b] + arm)
        if desk.cam[i, 2] <= 1e-6:
            return False
        desk.px[i, 0], desk.px[i, 1] = _project(
            eyes.matrix[view], eyes.distortion[view], desk.cam[i, 0], desk.cam[i, 1], desk.cam[i, 2], desk.J
        )
    return True


@compiled(nogil=True)
def score_many(
    image: Any, background: Any, eyes: Eyes, shape: Shape, low_x: int, low_y: int, high_x: int, high_y: int,
    positions: Any, rotations: Any, noise: float, samples: int, score: Any, differs: Any,
) -> None:  # fmt: skip
    """Judge many poses by one box of the first camera's picture: mean truncated squared sigmas a pixel, and the share of
    the die's pixels that differ from the background."""
    desk = new_desk(shape, eyes)
    corner_x, corner_y = np.int64(0), np.int64(0)
    for k in range(positions.shape[0]):
        score[k], differs[k] = 1e9, 0.0
        if not _place(shape, eyes, corner_x, positions[k], rotations[k], desk):
            continue
        contour, ball_px = _contour(shape, eyes, corner_x, positions[k], desk)
        if _draw_outer(shape, eyes, corner_x, positions[k], rotations[k], desk):
            total, inside, other = _box_score(
                image, background, corner_x, corner_y, low_x, low_y, high_x, high_y, shape, desk, contour, ball_px,
                noise, samples,
            )  # fmt: skip
            score[k], differs[k] = total, other / max(inside, 1.0)


@_inner
def _box_score(
    image: Any, background: Any, x0: int, y0: int, low_x: int, low_y: int, high_x: int, high_y: int, shape: Shape,
    desk: Desk, contour: int, ball_px: float, noise: float, samples: int,
) -> tuple[float, float, float]:  # fmt: skip
    """Mean of the truncated squared sigmas over about `samples` pixels of a box, pixels on the die, and those of them that
    differ from the background; pixels whose background is NaN do not count. No face reaches beyond the outline of the inner
    body, of so many lines as `contour`, widened by `ball_px`; corners of the outline stay sharp."""
    stride = max(1, int(sqrt((high_x - low_x) * (high_y - low_y) / samples)))
    nf, most = shape.face_edges.shape
    lines, count = np.zeros((nf, most, 3)), np.zeros(nf, np.int64)
    for f in range(nf):
        if desk.facing[f] > 0.0:
            count[f] = _face_lines(shape, desk, f, lines[f])
    columns = (high_x - low_x + stride - 1) // stride
    label = np.full(((high_y - low_y + stride - 1) // stride, columns), -1)
    total, number, mean = np.zeros(nf), np.zeros(nf), np.zeros(nf)
    for i in range(label.shape[0]):
        y = low_y + i * stride
        for j in range(columns):
            x = low_x + j * stride
            for f in range(nf):
                if count[f] == 0:
                    continue
                hit = True
                for k in range(count[f]):
                    if lines[f, k, 0] * x + lines[f, k, 1] * y + lines[f, k, 2] < 0.0:
                        hit = False
                        break
                if hit:
                    if isnan(background[y, x]) or (contour > 0 and not _within(desk.hull, contour, x, y, ball_px)):
                        break
                    label[i, j] = f
                    total[f] += image[y - y0, x - x0]
                    number[f] += 1.0
                    break
    for f in range(nf):
        mean[f] = total[f] / max(number[f], 1.0)
    # Marks pull the mean down: once more without what lies far below or above it.
    total[:] = 0.0
    number[:] = 0.0
    for i in range(label.shape[0]):
        for j in range(columns):
            f = label[i, j]
            if f >= 0:
                value = image[low_y + i * stride - y0, low_x + j * stride - x0]
                if abs(value - mean[f]) < 12.0 * noise:
                    total[f] += value
                    number[f] += 1.0
    for f in range(nf):
        if number[f] > 0.0:
            mean[f] = total[f] / number[f]
    score, judged, inside, differs = 0.0, 0.0, 0.0, 0.0
    iv = 1.0 / (noise * noise)
    for i in range(label.shape[0]):
        y = low_y + i * stride
        for j in range(columns):
            x = low_x + j * stride
            f = label[i, j]
            value = image[y - y0, x - x0]
            difference = value - background[y, x]
            if isnan(difference):
                continue
            judged += 1.0
            if f >= 0:
                inside += 1.0
                if abs(difference) > 3.0 * noise:
                    differs += 1.0
                e = value - mean[f]
                score += min(e * e / (4.0 * noise * noise + (0.04 * mean[f]) ** 2), FACE_CUT)
            else:
                score += min(difference * difference * iv, SHADOW_CUT if difference < 0.0 else FACE_CUT)
    return score / max(judged, 1.0), inside, differs


@_free
def _contour(shape: Shape, eyes: Eyes, view: int, pos: Any, desk: Desk) -> tuple[int, float]:
    """Lines on the desk's hull of the outline of a rounded die's inner body as placed, their number, and how far beyond them its
    contour lies in the picture; none of a sharp die, whose faces end there."""
    if shape.radius == 0.0:
        return 0, 0.0
    depth = eyes.translation[view, 2]
    for b in range(3):
        depth += eyes.rotation[view, 2, b] * pos[b]
    return _hull(shape, desk), shape.radius * eyes.matrix[view, 0, 0] / depth


@_free
def _face_lines(shape: Shape, desk: Desk, f: int, lines: Any) -> int:
    """Half-planes a x + b y + c >= 0 of a face as placed."""
    mx, my, count = 0.0, 0.0, 0
    for j in range(shape.face_edges.shape[1]):
        e = shape.face_edges[f, j]
        if e < 0:
            break
        i, k = shape.edges[e, 0], shape.edges[e, 1]
        a, b = desk.px[i, 1] - desk.px[k, 1], desk.px[k, 0] - desk.px[i, 0]
        lines[j, 0], lines[j, 1], lines[j, 2] = a, b, -(a * desk.px[i, 0] + b * desk.px[i, 1])
        mx += 0.5 * (desk.px[i, 0] + desk.px[k, 0])
        my += 0.5 * (desk.px[i, 1] + desk.px[k, 1])
        count += 1
    for j in range(count):
        if lines[j, 0] * mx / count + lines[j, 1] * my / count + lines[j, 2] < 0.0:
            for q in range(3):
                lines[j, q] = -lines[j, q]
    return count


# --- many frames ------------------------------------------------------------------------------------------------------


@_free
def _moved_px(eyes: Eyes, pos: Any, step: Any, turned: float, reach: float) -> float:
    """How far in the picture a step (3,) [m] of the centre and a turn by `turned` [m] at the die's `reach` move its farthest
    points, in the view that shows most of it: a step along the line of sight moves them little."""
    most = 0.0
    for view in range(eyes.camera.shape[0]):
        x, y, z, depth = 0.0, 0.0, 0.0, eyes.translation[view, 2]
        for b in range(3):
            x += eyes.rotation[view, 0, b] * step[b]
            y += eyes.rotation[view, 1, b] * step[b]
            z += eyes.rotation[view, 2, b] * step[b]
            depth += eyes.rotation[view, 2, b] * pos[b]
        if depth > 1e-6:
            aside = sqrt(x * x + y * y) + reach * abs(z) / depth + turned
            most = max(most, eyes.matrix[view, 0, 0] / depth * aside)
    return most


@compiled(nogil=True)
def look(
    sight: Sight, backgrounds: Any, eyes: Eyes, shape: Shape, lens: Lens, pos: Any, R: Any, vel: Any, omega: Any,
    sigma_m: float, sigma_rad: float, coarse: int, desk: Desk, H: Any, g: Any, stats: Any,
) -> tuple[Any, Any, float]:  # fmt: skip
    """Refine a pose by Gauss-Newton, `coarse` steps at larger blurs first, and judge it: position (3,), rotation (3, 3)
    and cost.

    The prior is isotropic about the start: `sigma_m` and `sigma_rad` are its standard deviations. H (8, 8), g (8,) and
    `stats` (8,) are those of the pixels alone before the last step, see `_view_equations`; the last of `stats` is the
    share of the die that shows nothing but the background. H is zero where the pixels and the prior leave no solution.

    The intensities that stretches share are those of the step before, and of the first step what the desk holds: those of the
    frame before where its user knows one, which takes two steps less, or nothing.
    """
    p, Q = pos.copy(), R.copy()
    away, step = np.zeros(6), np.zeros(6)
    A, L, y = np.zeros((6, 6)), np.zeros((6, 6)), np.zeros(6)
    wp, wr = 1.0 / sigma_m**2, 1.0 / sigma_rad**2
    reach, six = _reach(shape), np.int64(6)
    desk.greys[:] = 0.0
    desk.which[:] = 0
    for it in range(coarse + lens.fine_steps):
        fine = it >= coarse
        sigma, band = (lens.blur, max(lens.band, 4.0 * lens.blur)) if fine else COARSE[len(COARSE) - coarse + it]
        H[:] = 0.0
        g[:] = 0.0
        stats[:] = 0.0
        for view in range(eyes.camera.shape[0]):
            if eyes.weight[view] > 0.0 and sight.size[eyes.camera[view], 0] > 0:
                _view_equations(
                    view, sight, backgrounds, eyes, shape, p, Q, vel, omega, lens.exposure, sigma, band, lens.stride,
                    lens.floor_grey, lens.rounding_grey, lens.strip_share, lens.light, lens.full and fine, desk, H, g, stats,
                )  # fmt: skip
        for a in range(COLUMNS):
            for b in range(a):
                H[b, a] = H[a, b]
        for a in range(6):
            for b in range(6):
                A[a, b] = H[a, b]
            w = wp if a < 3 else wr
            A[a, a] += w
            y[a] = g[a] - w * away[a]
        if not _factor(A, six, L, 1e-13):
            H[:] = 0.0
            break
        _back(L, six, y, step)
        gain = 0.0
        for a in range(6):
            gain += step[a] * y[a]
        # One step may move the die by a third of its reach or turn it by 8 degrees at the most: edges of other faces
        # come into the band beyond that.
        lp = sqrt(step[0] ** 2 + step[1] ** 2 + step[2] ** 2)
        lr = sqrt(step[3] ** 2 + step[4] ** 2 + step[5] ** 2)
        shrink = min(OVERSTEP if fine else 1.0, reach / 3.0 / max(lp, 1e-300), 0.14 / max(lr, 1e-300))
        for a in range(6):
            step[a] *= shrink
            away[a] += step[a]
        for a in range(3):
            p[a] += step[a]
        Q = turn(Q, step[3:])
        _share_greys(desk, step)
        if fine and (gain < lens.enough or _moved_px(eyes, pos, step, shrink * lr * reach, reach) < lens.settled_px):
            break
    cost = 0.0
    if lens.samples > 0:
        cost, differs = picture_cost(sight, backgrounds, eyes, shape, p, Q, lens.noise, lens.samples, 8.0, desk)
        stats[7] = 1.0 - differs
        cost += 2.0 * (1.0 - stats[4] / max(stats[3], 1e-9)) + 10.0 * stats[0] / max(stats[2], 1.0)
    return p, Q, cost


@_inner
def sight_of(pictures: Any, eyes: Eyes, shape: Shape, pos: Any, R: Any, margin: float, desk: Desk) -> Sight:
    """The windows of one frame's pictures (cameras, height, width) round the die, and its reflection, as placed."""
    cameras, height, width = pictures.shape
    corner, size = np.zeros((cameras, 2), np.int64), np.zeros((cameras, 2), np.int64)
    low, high = np.full((cameras, 2), 1e9), np.full((cameras, 2), -1e9)
    for view in range(eyes.camera.shape[0]):
        if not _place(shape, eyes, view, pos, R, desk):
            continue
        c = eyes.camera[view]
        for a in range(2):
            low[c, a] = min(low[c, a], desk.px[:, a].min() - margin)
            high[c, a] = max(high[c, a], desk.px[:, a].max() + margin)
    rows, columns = 0, 0
    for c in range(cameras):
        x0, y0 = int(max(low[c, 0], 0.0)), int(max(low[c, 1], 0.0))
        x1, y1 = int(min(high[c, 0] + 1.0, float(width))), int(min(high[c, 1] + 1.0, float(height)))
        if x1 - x0 > 4 and y1 - y0 > 4:
            corner[c, 0], corner[c, 1], size[c, 0], size[c, 1] = x0, y0, x1 - x0, y1 - y0
            rows, columns = max(rows, y1 - y0), max(columns, x1 - x0)
    pixels = np.empty((cameras, rows, columns), np.float32)
    for c in range(cameras):
        for i in range(size[c, 1]):
            there, here = pictures[c, corner[c, 1] + i, corner[c, 0] :], pixels[c, i]
            for j in range(size[c, 0]):
                here[j] = there[j]
    return Sight(pixels, corner, size)


@compiled(nogil=True)
def coast(x: Any, R: Any, P: Any, dt: float) -> Any:
    """Carry a motion on by dt [s], also backwards: x (9,) is position, velocity, angular velocity; P (12, 12) the
    covariance of position, turn, velocity, angular velocity. Returns the rotation.

    δp' = δp + dt δv, δθ' = E δθ + dt (1 + W/2) δω with E = exp(ω dt) and W the cross matrix of ω dt: the left Jacobian
    to second order, enough for a covariance.
    """
    w = np.zeros(3)
    for a in range(3):
        w[a] = x[6 + a] * dt
        x[a] += x[3 + a] * dt
    x[2] -= 0.5 * GRAVITY * dt * dt
    x[5] -= GRAVITY * dt
    E = _exp(w)
    M = np.eye(12)
    for a in range(3):
        M[a, 6 + a] = dt
        M[3 + a, 9 + a] = dt
        for b in range(3):
            M[3 + a, 3 + b] = E[a, b]
    M[3, 10] -= 0.5 * dt * w[2]
    M[3, 11] += 0.5 * dt * w[1]
    M[4, 9] += 0.5 * dt * w[2]
    M[4, 11] -= 0.5 * dt * w[0]
    M[5, 9] -= 0.5 * dt * w[1]
    M[5, 10] += 0.5 * dt * w[0]
    half = np.zeros((12, 12))
    for i in range(12):
        for j in range(12):
            s = 0.0
            for k in range(12):
                if M[i, k] != 0.0:
                    s += M[i, k] * P[k, j]
            half[i, j] = s
    for i in range(12):
        for j in range(i + 1):
            s = 0.0
            for k in range(12):
                if M[j, k] != 0.0:
                    s += half[i, k] * M[j, k]
            P[i, j] = s
            P[j, i] = s
    return _product(E, R)


@_inner
def _innovation(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens, S: Any, z: Any) -> bool:
    """What a pose (p, Q) with information H adds to a motion: the difference z (6,), and the inverse S (6, 6) of its
    covariance; False where there is none.

    The pose's covariance is taken four times too large, and no smaller than a small part of the tight prior: what shading
    does to single poses goes on for many frames.
    """
    A = np.zeros((6, 6))
    for a in range(6):
        for b in range(6):
            A[a, b] = 0.25 * H[a, b]
        A[a, a] += 1.0 / (lens.loose_m**2 if a < 3 else lens.loose_rad**2)
    if not _inverse(A, np.int64(6), S):
        return False
    for a in range(6):
        for b in range(6):
            A[a, b] = S[a, b] + P[a, b]
    for a in range(3):
        z[a] = p[a] - x[a]
        A[a, a] += (lens.tight_m / 25.0) ** 2
        A[3 + a, 3 + a] += (lens.tight_rad / 12.0) ** 2
    _log(_turn_from(R, Q), z[3:])
    return _inverse(A, np.int64(6), S)


@_inner
def surprise(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens) -> float:
    """Squared distance of a pose from a motion, in the sigmas of both."""
    S, z = np.zeros((6, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, lens, S, z):
        return 1e9
    total = 0.0
    for a in range(6):
        for b in range(6):
            total += z[a] * S[a, b] * z[b]
    return total


@compiled(nogil=True)
def correct(x: Any, R: Any, P: Any, p: Any, Q: Any, H: Any, lens: Lens) -> Any:
    """Let a motion learn from a pose (p, Q) with information H: the Kalman filter on positions and turns. Returns the
    rotation. P grows by FADE a frame, so that some twenty frames count.
    """
    S, gain, z = np.zeros((6, 6)), np.zeros((12, 6)), np.zeros(6)
    if not _innovation(x, R, P, p, Q, H, lens, S, z):
        return R
    for i in range(12):
        for a in range(6):
            for b in range(6):
                gain[i, a] += P[i, b] * S[b, a]
    change = np.zeros(12)
    for i in range(12):
        for a in range(6):
            change[i] += gain[i, a] * z[a]
    top = P[:6].copy()
    for i in range(12):
        for j in range(12):
            for a in range(6):
                P[i, j] -= gain[i, a] * top[a, j]
            P[i, j] *= FADE
    for a in range(3):
        x[a] += change[a]
        x[3 + a] += change[6 + a]
        x[6 + a] += change[9 + a]
    return turn(R, change[3:6])


@_free
def note_screen(
    sight: Sight, backgrounds: Any, screen: Screen, eyes: Eyes, shape: Shape, lens: Lens, pos: Any, R: Any, desk: Desk
) -> None:
    """Learn from one frame whose pose (pos, R) is known what stands before the die: pixels well inside the outline whose
    neighbourhood shows the background alone, and goes on to do so: what changes later was no screen, but a face as grey as
    the table. `backgrounds` become NaN there and SCREEN_PX beyond the whole neighbourhood, for a blurred border belongs to
    neither."""
    far = 2 * SCREEN_PX
    for view in range(eyes.camera.shape[0]):
        c = eyes.camera[view]
        mirrored = eyes.partner[view] >= 0 and eyes.partner[view] < view
        if mirrored or sight.size[c, 0] == 0 or not _place(shape, eyes, view, pos, R, desk):
            continue
        count = _hull(shape, desk)
        x0, y0 = sight.corner[c, 0], sight.corner[c, 1]
        width, height = sight.size[c, 0], sight.size[c, 1]
        still, image = screen.still[c], sight.pixels[c]
        fresh = np.int64(0)
        for i in range(height):
            for j in range(width):
                if abs(image[i, j] - still[y0 + i, x0 + j]) > CHANGED_SIGMAS * lens.noise:
                    screen.changed[c, y0 + i, x0 + j] = 1
                    if screen.core[c, y0 + i, x0 + j] == 1:
                        screen.core[c, y0 + i, x0 + j] = 0
                        screen.found[0] -= 1
                        fresh += 1
        for i in range(SCREEN_PX, height - SCREEN_PX):
            for j in range(SCREEN_PX, width - SCREEN_PX):
                x, y = x0 + j, y0 + i
                if screen.core[c, y, x] == 1 or not _within(desk.hull, count, float(x), float(y), -float(SCREEN_PX)):
                    continue
                total, steady = 0.0, True
                for a in range(-SCREEN_PX, SCREEN_PX + 1):
                    for b in range(-SCREEN_PX, SCREEN_PX + 1):
                        steady = steady and screen.changed[c, y + a, x + b] == 0
                        total += (image[i + a, j + b] - still[y + a, x + b]) ** 2
                    if not steady:
                        break
                if steady and total < (SCREEN_SIGMAS * lens.noise * (2 * SCREEN_PX + 1)) ** 2:
                    screen.core[c, y, x] = 1
                    screen.found[0] += 1
                    fresh += 1
        if fresh == 0:
            continue
        low_y, high_y = max(y0 - far, 0), min(y0 + height + far, still.shape[0])
        low_x, high_x = max(x0 - far, 0), min(x0 + width + far, still.shape[1])
        for y in range(low_y, high_y):
            for x in range(low_x, high_x):
                backgrounds[c, y, x] = still[y, x]
        for y in range(max(low_y - far, 0), min(high_y + far, still.shape[0])):
            for x in range(max(low_x - far, 0), min(high_x + far, still.shape[1])):
                if screen.core[c, y, x] == 1:
                    for a in range(max(y - far, 0), min(y + far + 1, still.shape[0])):
                        for b in range(max(x - far, 0), min(x + far + 1, still.shape[1])):
                            backgrounds[c, a, b] = np.nan


@_free
def _write(
    k: int, p: Any, Q: Any, h: Any, row: Any, cost: float, positions: Any, rotations: Any, H: Any, stats: Any,
    costs: Any,
) -> None:  # fmt: skip
    """Row k of the outputs; number by number, which is compiled in a tenth of the time that slices need."""
    costs[k] = cost
    for a in range(3):
        positions[k, a] = p[a]
        for b in range(3):
            rotations[k, a, b] = Q[a, b]
    for a in range(COLUMNS):
        for b in range(COLUMNS):
            H[k, a, b] = h[a, b]
    for a in range(8):
        stats[k, a] = row[a]


@compiled(nogil=True)
def chase(
    frames: Any, times: Any, backgrounds: Any, screen: Screen, eyes: Eyes, shape: Shape, lens: Lens, x: Any, R: Any,
    P: Any, clock: Any, surprising: float, positions: Any, rotations: Any, H: Any, stats: Any, motions: Any, costs: Any,
) -> int:  # fmt: skip
    """Follow a die in flight over frames (n, cameras, height, width) at `times` (n,), as long as picture and motion tell
    the same story. Returns how many frames it did; the rows of the outputs are filled that far. A pose that lies
    `surprising` squared sigmas from where the motion led belongs to another story in any case.

    x (9,), R (3, 3), P (12, 12) are the motion at clock[0] [s], and are carried along with it; clock[1] is the usual cost
    of a pose, clock[2] how many poses of this flight have been seen. What turns out to stand before the die is put in
    `screen`, and `backgrounds` become NaN there.
    """
    desk = new_desk(shape, eyes)
    h, g, row = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS), np.zeros(8)
    reach, moved = _reach(shape), np.zeros(3)
    for k in range(frames.shape[0]):
        ahead, P_ahead = x.copy(), P.copy()
        R_ahead = coast(ahead, R, P_ahead, times[k] - clock[0])
        # Carried back to where they were known, variances cancel, and rounding may leave less than nothing.
        sigma_m = sqrt(max(P_ahead[0, 0], P_ahead[1, 1], P_ahead[2, 2], 0.0))
        sigma_rad = sqrt(max(P_ahead[3, 3], P_ahead[4, 4], P_ahead[5, 5], 0.0))
        off = scale_px(eyes, ahead[:3]) * (sigma_m + sigma_rad * reach)
        coarse = 4 if off > 1.5 else (2 if off > 0.6 else (1 if off > 0.3 else 0))
        sight = sight_of(frames[k], eyes, shape, ahead[:3], R_ahead, WINDOW_PX if coarse > 0 else NARROW_PX, desk)
        if sight.pixels.shape[1] == 0:
            return k
        prior_m = min(max(4.0 * sigma_m, lens.tight_m), lens.loose_m)
        prior_rad = min(max(4.0 * sigma_rad, lens.tight_rad), lens.loose_rad)
        p, Q, cost = look(
            sight, backgrounds, eyes, shape, lens, ahead[:3], R_ahead, ahead[3:6], ahead[6:9], prior_m, prior_rad,
            coarse, desk, h, g, row,
        )  # fmt: skip
        new = clock[2] < 3.0
        far_m, far_rad = (0.28 * reach, 0.157) if new else (0.14 * reach, 0.035)
        _log(_turn_from(R_ahead, Q), moved)
        turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
        gone = sqrt((p[0] - ahead[0]) ** 2 + (p[1] - ahead[1]) ** 2 + (p[2] - ahead[2]) ** 2)
        usual = clock[1] if clock[2] > 0.0 else cost
        seen_enough = row[3] >= 20.0 and row[4] > 0.45 * row[3] and h[0, 0] > 0.0
        # Where the pose is where the motion leads, a dearer picture only means that the light has changed; and what the
        # pixels leave open, as the distance of a face seen alone, may be far off.
        allowed = DEARER
        if not new and seen_enough and turned < far_rad:
            off = surprise(ahead, R_ahead, P_ahead, p, Q, h, lens)
            if off > surprising:
                return k
            if off < NEAR:
                allowed, far_m = 1e9 if row[4] > 0.6 * row[3] else MUCH_DEARER, 0.28 * reach
        if not (seen_enough and turned < far_rad and gone < far_m and cost < usual + allowed):
            return k
        for a in range(3):
            x[a], x[3 + a], x[6 + a] = ahead[a], ahead[3 + a], ahead[6 + a]
        for a in range(12):
            for b in range(12):
                P[a, b] = P_ahead[a, b]
        for a in range(6):
            motions[k, a] = ahead[3 + a]
        corrected = correct(x, R_ahead, P, p, Q, h, lens)
        for a in range(3):
            for b in range(3):
                R[a, b] = corrected[a, b]
        clock[0] = times[k]
        clock[1] = usual + (cost - usual) / min(clock[2] + 1.0, 8.0)
        clock[2] += 1.0
        _write(k, p, Q, h, row, cost, positions, rotations, H, stats, costs)
        if row[7] > SCREENED or screen.found[0] > 0:
            note_screen(sight, backgrounds, screen, eyes, shape, lens, p, Q, desk)
    return frames.shape[0]


@_free
def scale_px(eyes: Eyes, pos: Any) -> float:
    """Pixels a metre at a point, in the nearest view."""
    best = 0.0
    for view in range(eyes.camera.shape[0]):
        z = eyes.translation[view, 2]
        for b in range(3):
            z += eyes.rotation[view, 2, b] * pos[b]
        if z > 1e-6:
            best = max(best, eyes.matrix[view, 0, 0] / z)
    return best


@compiled(nogil=True)
def settle(
    frames: Any, which: Any, backgrounds: Any, eyes: Eyes, shape: Shape, lens: Lens, positions: Any, rotations: Any,
    motions: Any, H: Any, stats: Any, costs: Any,
) -> None:  # fmt: skip
    """Refine the poses of frames number `which` (m,) of many (n, cameras, height, width), each from its own start, in place; a
    start whose position is NaN is left out.

    Most starts lie so near that the lens blur does at once; where the pose moves by more than NEARBY_PX, it begins again
    from the start with coarser steps.
    """
    desk = new_desk(shape, eyes)
    h, g, row = np.zeros((COLUMNS, COLUMNS)), np.zeros(COLUMNS), np.zeros(8)
    moved, reach = np.zeros(3), _reach(shape)
    for k in range(which.shape[0]):
        H[k] = 0.0
        if isnan(positions[k, 0]):
            continue
        start, R = positions[k].copy(), rotations[k].copy()
        for again in range(2):
            if again:
                desk.usual[:] = 0.0
            sight = sight_of(frames[which[k]], eyes, shape, start, R, WINDOW_PX if again else NARROW_PX, desk)
            if sight.pixels.shape[1] == 0:
                break
            p, Q, cost = look(
                sight, backgrounds, eyes, shape, lens, start, R, motions[k, :3], motions[k, 3:], lens.loose_m,
                lens.loose_rad, 2 * again, desk, h, g, row,
            )  # fmt: skip
            _write(k, p, Q, h, row, cost, positions, rotations, H, stats, costs)
            _log(_turn_from(R, Q), moved)
            turned = sqrt(moved[0] ** 2 + moved[1] ** 2 + moved[2] ** 2)
            if (
                _moved_px(eyes, start, p - start, reach * turned, reach) < NEARBY_PX
                and row[4] > 0.6 * row[3]
                and row[3] > 20.0
            ):
                break
