"""The die's own marks as features of its pose: pips, numbers, grain, whatever its faces show.

A rounded or shaded edge lies where no model of a sharp edge expects it, and it does so alike on every frame, so that no
averaging helps. What is printed on a flat face has no such error: the plane of the face is known to a part in a thousand
from the die's size whatever its edges look like. The appearance of each face is learned from the clip itself.

1. *Learning.* From the flights of a first track, chosen frames are brought onto a grid of face coordinates; the grey of
   frame k on face f is modelled as

       I(x) = c T_f(a(x), b(x)) + p + q a + r b

   with T_f the texture (about one on bare paint) and four numbers of light for each face and frame, fitted robustly (Tukey's
   biweight), so that glare, shadow and whatever hides the die drop out. T_f is the mean of what the frames show, each
   weighted by its contrast, its noise and the squared cosine of its view.
2. *Signal.* Even and odd frames give two textures whose noise is independent. Marks are where the product of their slopes
   exceeds what noise leaves in the mean by SIGNAL; a plain face has none and costs nothing from there on.
3. *Adjustment.* The textures were placed by the poses that they are meant to improve, so that an error which all poses
   share is learned along with them. It shows as soon as the die turns: a texture placed wrongly on its face does not
   follow the turn of a rigid body about its centre. Flights (twelve numbers each, gravity known) and for every face a
   shift, a turn and a stretch of its texture are adjusted together (bundle adjustment, Gauss-Newton), the edges entering as weak observations;
   then the textures are learned again from the adjusted flights. Size, and with it distance, comes from the known
   distance of the faces from the centre about which the die turns, and from gravity.
4. *Refinement.* A frame's residual is taken on its own pixels, never on resampled ones, so that their noise stays
   independent; the light is eliminated by a Schur complement (variable projection). Marks and edges are added with the weights that their own
   scatter about the flights gives them (variance components): errors of edges are systematic, not white.

Pose increments are (δp, δθ): world position [m], and rotation vector in world axes [rad], R_true = exp(δθ) R.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ..model.motion import GRAVITY_M_S2, Flight, State, Throw
from ..model.rotations import matrix_from_quat, quat_from_matrix, rotation_between
from ..model.solids import Solid
from .camera import Camera
from .joined import moved, transitions
from .marks_kernels import GRAZING, MARGIN_BLURS, SHARED, TUKEY, WARPS, look_at_face, mark_equations, refine_on_marks
from .pose import Pose, View, outline_box
from .track import Track

Array = NDArray[np.float64]
Image = NDArray[np.float32]

PRIOR_BLUR, PRIOR_LENS_PX = 1.0, 0.3
"""Standard deviations of a texture's blur [texel², as variance] and of the lens blur [px]."""
LOOKS = 120
"""Frames learned from at the most: the texture's noise is then a tenth of one frame's, and the cost does not grow with
the clip."""
FEWEST_LOOKS = 3
"""Frames that must show a texel before it is known."""
SHORT_FLIGHT = 10
"""Frames of a flight below which all are looked at."""
TEXEL_PX = 0.75
"""Size of a texel in pixels of a face seen squarely at the median distance: finer than the pixels by as much as a lens
resolves at the best."""
SIGNAL = 4.0
"""Power of the texture's slopes over that of the noise in them from which a place counts as marked. Noise in the slopes
makes them seem steeper than they are; at 4 the information is overrated by a quarter there, and by far less on the whole."""
SIGNAL_TEXELS = 7
"""Side of the square over which signal and noise are compared."""
FEWEST_TEXELS = 50
"""Marked texels (about 28 pixels) without which a face is called plain."""
CUTS = (8.0 * TUKEY, 3.0 * TUKEY, 1.5 * TUKEY, TUKEY, TUKEY, TUKEY, TUKEY)
"""Cut of the robust weights [sigmas] in each round of adjusting and learning again; the last ones are left out when nothing
moves any more. A narrow cut from the start would take what the first poses misplaced for something that hides the die."""
SETTLED_SIGMAS = 0.3
"""A round that moves no flight by more than this many of its sigmas is the last."""
PRIOR_WARP = 0.02
"""Standard deviation of a texture's warps, where the die's edge is the unit of length: several times what the worst edges
misplace it."""
BLUR_RANGE_PX = (0.3, 4.0)
"""A pixel alone has 0.29; beyond the other there would be no marks."""
CHI2_MEDIAN = 5.348
"""Median of chi-square with six degrees of freedom."""
CONTOUR_SHARE = 0.01
"""Misplacement of edges, over the die's edge, that is thought possible before any was measured: bevels of 3 to 4 % of the edge
shift the apparent contour by 1 to 2 %."""
LINK_M, LINK_RAD = 1e-5, 5e-4
"""How well flights meet at a bounce: a contact lasts some 0.05 ms, in which a die leaves the corner between its two motions by a
quarter of that time its speed."""
PRIOR_INSTANT_S = 2e-3
NEAR_BOUNCE = 1.0
"""Frames from an impact within which a frame teaches nothing: its exposure may straddle it."""
UNBOUNDED_GREY = 1e9
"""Noise of a face that no frame has been asked for yet."""
STEPS = 4
"""Gauss-Newton steps of a refinement; from a flight the first one settles it to a hundredth of a pixel."""


@dataclass(frozen=True, eq=False)
class FaceGrid:
    """Where texels lie on the faces: the same for the whole clip."""

    axes: Array
    """(faces, 3, 3) rows a, b and the outward normal, body axes."""
    offsets: Array
    """(faces,) [m] of the face planes from the centre."""
    corners: Array
    """(faces, most, 2) [m] corners of the flat part in (a, b), padded."""
    counts: NDArray[np.int64]
    """(faces,) corners of each."""
    size: int
    """Texels along a side."""
    texel_m: float


@dataclass(frozen=True, eq=False)
class Marks:
    """What the faces of a die look like, learned from a clip, and how well they place it."""

    grid: FaceGrid
    texture: Array
    """(faces, n, n) reflectance over that of the bare paint, rows along b; NaN where it was never seen."""
    coefficients: Array
    """(faces, n, n) of the cubic B-spline through it."""
    marked: NDArray[np.uint8]
    """(faces, n, n) 2 on the slopes of marks, 1 around them, 0 where no pixel is looked at."""
    noise_grey: Array
    """(faces,) usual residual of a pixel; 0 for faces that are plain or were not seen."""
    looks: NDArray[np.int64]
    """(faces,) frames that showed the face."""
    rays: NDArray[np.float32]
    """(height, width, 2) camera rays x/z, y/z of the pixels, lens distortion undone."""
    saturation_grey: float
    blur_px: float
    """Lens blur (standard deviation) as the marks show it: no bevel or shade beside an edge takes part in it."""
    base: Array
    """(faces, 2, 3) [m²] how blurred each texture is: variances aa, ab, bb that a lens blur of one pixel and the motion leave
    in the mean of its looks."""
    factor: float
    """Scatter of the marks' poses about the flights over what pixel noise says, as a variance; at least 1."""
    contour_m: float
    """By how much the edges seem to lie elsewhere than the model of an edge expects, as one length: their poses have a common
    error of this size over the die's (see `edge_covariance`)."""
    flights: tuple[Flight, ...]
    """The adjusted flights, with covariance: uncertain places of the textures included."""
    shared: tuple[Array, ...]
    """(12, 12) for each flight: the part of its covariance that comes from those places and is common to all frames, however
    many there are."""

    @property
    def marked_faces(self) -> NDArray[np.int64]:
        """Indices of the faces that show marks."""
        return np.flatnonzero(self.noise_grey > 0)


@dataclass(frozen=True, eq=False)
class _Look:
    """One frame that is learned from: the window round the die."""

    time_s: float
    flight: int
    x0: int
    y0: int
    image: Image
    edge_position_m: Array
    edge_quaternion: Array
    edge_covariance: Array


@dataclass(frozen=True, eq=False)
class _Poses:
    """Where the flights put the die on every look."""

    position_m: Array
    rotation: Array
    velocity_m_s: Array
    omega_rad_s: Array
    by_start: Array
    """(n, 6, 12) derivative of the pose by the state at the start of its flight."""


def frames_to_learn_from(track: Track, throw: Throw) -> NDArray[np.int64]:
    """Rows of the track, about LOOKS, spread evenly over the frames that surely lie on a flight; short flights are not
    thinned out."""
    spacing = float(np.median(np.diff(track.time_s))) if len(track) > 1 else 0.0
    bounces = np.array([impact.time_s for impact in throw.impacts])
    good = np.flatnonzero(track.tracked)
    if len(bounces):
        away = np.abs(track.time_s[good, None] - bounces).min(1)
        good = good[away > NEAR_BOUNCE * spacing]
    flight = np.array([throw.flight_at(float(t)) for t in track.time_s[good]])
    chosen = []
    for k in np.unique(flight):
        mine = good[flight == k]
        share = int(np.ceil(LOOKS * len(mine) / len(good)))
        chosen.append(
            mine[np.unique(np.linspace(0, len(mine) - 1, min(len(mine), max(share, SHORT_FLIGHT))).round().astype(int))]
        )
    return np.concatenate(chosen) if chosen else good


def learn_marks(
    view: View, images: Iterable[tuple[int, Image]], track: Track, throw: Throw, *, saturation_grey: float = np.inf
) -> Marks | None:
    """What the faces of the die look like, or None where no face shows anything that places it.

    `images` are pairs of a row of `track` and its whole frame (height, width) float32, best those of
    `frames_to_learn_from`; only a window of each is kept. `track` holds poses of single frames from edges, `throw` the
    flights measured through them. Pixels at `saturation_grey` and above are left out.
    """
    looks = _looks(view, images, track, throw)
    if len(looks) < 2 * FEWEST_LOOKS:
        return None
    grid = _face_grid(view, looks, throw)
    links = _links(looks, throw)
    few = _thinned(looks)
    marks = _learned(view, few, throw.flights, _blank(view, grid, saturation_grey, throw), CUTS[0])
    for cut in CUTS:
        if not len(marks.marked_faces):
            return None
        chosen = looks if cut == TUKEY else few
        marks, moved_sigmas = _adjusted(view, chosen, links, marks, cut)
        marks = _learned(view, chosen, marks.flights, marks, cut)
        if cut == TUKEY and moved_sigmas < SETTLED_SIGMAS:
            break
    return marks if len(marks.marked_faces) else None


def refine_by_marks(view: View, marks: Marks, image: Image, pose: Pose, start: State | None = None) -> Pose:
    """The pose that marks and edges of one frame bear out together.

    `pose` is that of the edges; `start` the state that the flight gives for this frame, from which the steps begin where
    it is known. Where no marked face is seen, the edges' pose comes back, its covariance widened by their systematic errors.
    """
    edges = edge_information(view, marks, pose)
    still = np.zeros(3)
    if start is None:
        start = State(0.0, pose.position_m, quat_from_matrix(pose.rotation), still, still)
    rotation = start.rotation
    away = np.concatenate([pose.position_m - start.position_m, _turn_between(rotation, pose.rotation)])
    p, R, H = refine_on_marks(
        image, 0, 0, *_seen_by(view, marks), np.asarray(start.position_m, float), rotation,
        *_blurs(view, marks, start.velocity_m_s, start.omega_rad_s), *_on_faces(view, marks, TUKEY), marks.factor,
        edges, edges @ away, STEPS, np.zeros((len(marks.looks), 3)),
    )  # fmt: skip
    if not H.any():
        return replace(pose, information=edges)
    return replace(pose, position_m=p, rotation=R, information=H + edges)


def edge_information(view: View, marks: Marks, pose: Pose) -> Array:
    """(6, 6) of a pose from edges, what they get wrong in common taken into account."""
    common = _contour_covariance(view, pose.position_m, marks.contour_m)
    # (Σ + S)⁻¹ by way of the information, which may be singular where Σ does not exist.
    return np.asarray(pose.information @ np.linalg.inv(np.eye(6) + common @ pose.information))


def undistorted_rays(camera: Camera) -> NDArray[np.float32]:
    """Camera rays x/z, y/z (height, width, 2) of all pixels, by Newton-like fixed-point steps on the distortion."""
    K, d = camera.matrix, camera.distortion
    v, u = np.mgrid[0 : camera.height_px, 0 : camera.width_px]
    yd = (v - K[1, 2]) / K[1, 1]
    xd = (u - K[0, 2] - K[0, 1] * yd) / K[0, 0]
    x, y = xd.copy(), yd.copy()
    # The distortion of a usable lens is a contraction; each turn gains one to two digits.
    for _ in range(20 if np.any(d) else 0):
        r2 = x * x + y * y
        g = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
        dx, dy = 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x), d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y
        x, y = (xd - dx) / g, (yd - dy) / g
    return np.stack([x, y], axis=-1).astype(np.float32)


# --- what the kernels want ---


def _seen_by(view: View, marks: Marks) -> tuple[Array | NDArray[np.float32], ...]:
    camera = view.camera
    return marks.rays, camera.matrix, camera.distortion, camera.rotation, camera.translation_m


def _on_faces(view: View, marks: Marks, cut: float) -> tuple[object, ...]:
    grid = marks.grid
    return (
        grid.axes, grid.offsets, grid.corners, grid.counts, _margin_px(marks), grid.texel_m,
        marks.saturation_grey, max(0.5, 0.5 * view.noise_grey), cut, marks.noise_grey, marks.coefficients, marks.marked,
    )  # fmt: skip


def _blurs(
    view: View, marks: Marks, velocity_m_s: Array, omega_rad_s: Array
) -> tuple[Array, Array, float, float, Array]:
    return velocity_m_s, omega_rad_s, view.exposure_s, marks.blur_px, marks.base


def _margin_px(marks: Marks) -> float:
    return MARGIN_BLURS * marks.blur_px + 0.5


# --- looking ---


def _looks(view: View, images: Iterable[tuple[int, Image]], track: Track, throw: Throw) -> list[_Look]:
    """Windows round the die on the frames of flights that have enough of them."""
    looks = []
    for row, image in images:
        time_s = float(track.time_s[row])
        flight = throw.flight_at(time_s)
        state = throw.flights[flight].at(time_s)
        box = outline_box(view, state.position_m, state.rotation, 6.0)
        if box is None or not track.tracked[row]:
            continue
        x0, y0, x1, y1 = box
        window = np.ascontiguousarray(image[y0:y1, x0:x1], np.float32)
        looks.append(
            _Look(time_s, flight, x0, y0, window, track.position_m[row], track.quaternion[row], track.covariance[row])
        )
    counts = np.bincount([look.flight for look in looks], minlength=len(throw.flights))
    return [look for look in looks if counts[look.flight] >= 2]


def _thinned(looks: list[_Look]) -> list[_Look]:
    """Every second look, and all of short flights: enough to come near, in half the time."""
    counts = np.bincount([look.flight for look in looks])
    return [look for i, look in enumerate(looks) if i % 2 == 0 or counts[look.flight] <= SHORT_FLIGHT]


def _poses(looks: list[_Look], flights: tuple[Flight, ...]) -> _Poses:
    n = len(looks)
    out = _Poses(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 6, 12)))
    of = np.array([look.flight for look in looks])
    times = np.array([look.time_s for look in looks])
    for k in np.unique(of):
        mine, flight = of == k, flights[k]
        out.position_m[mine], q = flight.poses(times[mine])
        out.rotation[mine] = matrix_from_quat(q)
        fall = GRAVITY_M_S2 * (times[mine] - flight.start.time_s)
        out.velocity_m_s[mine] = flight.start.velocity_m_s - np.outer(fall, [0.0, 0.0, 1.0])
        out.omega_rad_s[mine] = flight.start.omega_rad_s
        out.by_start[mine] = transitions(flight, times[mine])[:, :6]
    return out


def _face_grid(view: View, looks: list[_Look], throw: Throw) -> FaceGrid:
    """Grids a texel of TEXEL_PX at the median distance."""
    solid, camera = view.die.solid, view.camera
    places = np.array([throw.flights[look.flight].at(look.time_s).position_m for look in looks])
    depth = places @ camera.rotation[2] + camera.translation_m[2]
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    texel = TEXEL_PX * float(np.median(depth)) / focal
    axes = face_axes(solid)
    most = max(len(face) for face in solid.faces)
    corners = np.zeros((len(axes), most, 2))
    flat = view.inner
    for f, face in enumerate(solid.faces):
        # The flat part of a rounded face is the inner body's face, pushed out by the radius.
        corners[f, : len(face)] = flat[list(face)] @ axes[f, :2].T
    size = 2 * (int(np.ceil(np.abs(corners).max() / texel)) + 2) + 1
    counts = np.array([len(face) for face in solid.faces], np.int64)
    return FaceGrid(axes, solid.offsets.copy(), corners, counts, size, texel)


def face_axes(solid: Solid) -> Array:
    """(faces, 3, 3) right-handed axes of each face, in rows: along its first edge, across it, and the outward normal."""
    out = np.empty((len(solid.faces), 3, 3))
    for f, face in enumerate(solid.faces):
        along = solid.vertices[face[1]] - solid.vertices[face[0]]
        out[f, 0] = along / np.linalg.norm(along)
        out[f, 2] = solid.normals[f]
        out[f, 1] = np.cross(out[f, 2], out[f, 0])
    return out


def _blank(view: View, grid: FaceGrid, saturation_grey: float, throw: Throw) -> Marks:
    shape = (len(grid.axes), grid.size, grid.size)
    faces = len(grid.axes)
    return Marks(
        grid, np.full(shape, np.nan), np.ones(shape), np.zeros(shape, np.uint8), np.zeros(faces),
        np.zeros(faces, np.int64), undistorted_rays(view.camera), float(saturation_grey), view.blur_px, np.zeros((faces, 2, 3)), 1.0,
        CONTOUR_SHARE * view.die.solid.edge_m, throw.flights, tuple(np.zeros((12, 12)) for _ in throw.flights),
    )  # fmt: skip


# --- learning ---


def _learned(view: View, looks: list[_Look], flights: tuple[Flight, ...], marks: Marks, cut: float) -> Marks:
    """Textures anew from the poses of `flights`, with the old ones as what a face should look like, where there are."""
    grid = marks.grid
    shape = (len(grid.axes), grid.size, grid.size)
    # Even and odd looks apart: their noise is independent.
    total, weight = np.zeros((2, *shape)), np.zeros((2, *shape))
    count = np.zeros((2, *shape), np.int32)
    base, base_weight = np.zeros((shape[0], 2, 3)), np.zeros(shape[0])
    values, w = np.zeros((2, *shape[1:]))
    own = np.zeros((2, 3))
    seen = np.zeros(shape[0], np.int64)
    camera = view.camera
    floor_grey = max(0.5, 0.5 * view.noise_grey)
    poses = _poses(looks, flights)
    facings = _facings(view, grid, poses)
    for i, look in enumerate(looks):
        for f in np.flatnonzero(facings[i] > GRAZING):
            known = bool(np.isfinite(marks.texture[f]).any())
            if known and not marks.noise_grey[f]:
                continue
            share = look_at_face(
                look.image, look.x0, look.y0, camera.matrix, camera.distortion, camera.rotation,
                camera.translation_m, poses.position_m[i], poses.rotation[i], poses.velocity_m_s[i], poses.omega_rad_s[i],
                view.exposure_s,
                marks.blur_px, marks.base[f], grid.axes[f], grid.offsets[f], grid.corners[f],
                grid.counts[f], _margin_px(marks), grid.texel_m, marks.saturation_grey, floor_grey, cut, marks.coefficients[f],
                marks.marked[f], known,
                values, w, own,
            )  # fmt: skip
            if share < 0.5:
                continue
            half = seen[f] % 2
            seen[f] += 1
            used = w > 0
            total[half, f][used] += facings[i, f] ** 2 * w[used] * values[used]
            base[f] += facings[i, f] ** 2 * w.sum() * own
            base_weight[f] += facings[i, f] ** 2 * w.sum()
            weight[half, f] += facings[i, f] ** 2 * w
            count[half, f] += used
    return _with_textures(replace(marks, base=_where_seen(base, base_weight, marks.base)), total, weight, count, seen)


def _facings(view: View, grid: FaceGrid, poses: _Poses) -> Array:
    """(looks, faces) cosines between the faces' normals and the way to the camera, from the middle of each face."""
    normals = np.einsum("nij,fj->nfi", poses.rotation, grid.axes[:, 2])
    toward = view.camera.centre_m - poses.position_m[:, None] - grid.offsets[:, None] * normals
    return np.asarray((toward * normals).sum(2) / np.linalg.norm(toward, axis=2))


def _with_textures(
    marks: Marks, total: Array, weight: Array, count: NDArray[np.int32], seen: NDArray[np.int64]
) -> Marks:
    """Marks with the means of what was seen, and where on them there is signal."""
    both = weight.sum(0)
    known = (count.sum(0) >= FEWEST_LOOKS) & (both > 0)
    # Where nothing was looked at anew, what was known stays.
    texture = np.where(known, total.sum(0) / np.where(known, both, 1.0), marks.texture)
    coefficients, marked, noise = marks.coefficients.copy(), marks.marked.copy(), marks.noise_grey.copy()
    for f in np.flatnonzero(known.sum((1, 2)) >= FEWEST_TEXELS):
        coefficients[f] = ndimage.spline_filter(_filled(texture[f]), order=3, mode="mirror")
        if noise[f] == 0.0:
            split = (count[:, f] > 0).all(0) & known[f]
            halves = [np.where(split, total[h, f] / np.where(split, weight[h, f], 1.0), np.nan) for h in (0, 1)]
            marked[f] = _marked(*halves)
            noise[f] = UNBOUNDED_GREY if (marked[f] > 0).sum() >= FEWEST_TEXELS else 0.0
        marked[f] = _steep_places(coefficients[f], marked[f])
    seen = np.maximum(seen, marks.looks)
    return replace(marks, texture=texture, coefficients=coefficients, marked=marked, noise_grey=noise, looks=seen)


def _where_seen(base: Array, weight: Array, old: Array) -> Array:
    """Weighted means of the faces that were seen, the old values of the others."""
    seen = (weight > 0)[:, None, None]
    return np.where(seen, base / np.where(seen, weight[:, None, None], 1.0), old)


def _filled(texture: Array) -> Array:
    """The texture with unknown texels taken from their nearest known neighbour: a spline through it has no jump there."""
    unknown = ~np.isfinite(texture)
    nearest = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(texture[tuple(nearest)])


def _marked(even: Array, odd: Array) -> NDArray[np.uint8]:
    """Where two textures of independent noise agree on slopes steeper than that noise makes, and a little around."""
    known = (np.isfinite(even) & np.isfinite(odd)).astype(np.uint8)
    # Splines reach over two texels: nothing is looked at so near to what is unknown.
    inner = cv2.erode(known, np.ones((5, 5), np.uint8), borderValue=0)
    slopes = [
        np.stack(np.gradient(_filled(half))) if known.any() else np.zeros((2, *half.shape)) for half in (even, odd)
    ]
    box = (SIGNAL_TEXELS, SIGNAL_TEXELS)
    signal = cv2.blur((slopes[0] * slopes[1]).sum(0) * inner, box)
    # The mean of both halves has a quarter of the power of their difference as noise.
    noise = cv2.blur(((slopes[0] - slopes[1]) ** 2).sum(0) * inner, box) / 4.0
    clear = ((signal > SIGNAL * noise) & (inner > 0)).astype(np.uint8)
    clear = cv2.morphologyEx(clear, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    return np.asarray(cv2.dilate(clear, np.ones((7, 7), np.uint8)) * inner, np.uint8)


def _steep_places(texture: Array, marked: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """2 for marked texels on and beside slopes, 1 for those on flat ground."""
    slope = np.hypot(*np.gradient(texture)) * (marked > 0)
    steep = cv2.dilate((slope > 0.1 * slope.max()).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.where(marked > 0, 1 + steep, 0).astype(np.uint8)


# --- adjusting ---


def _links(looks: list[_Look], throw: Throw) -> list[tuple[int, float]]:
    """Flight and instant of every bounce that joins two flights which are both looked at."""
    used = {look.flight for look in looks}
    return [
        (k, impact.time_s)
        for k, impact in enumerate(throw.impacts)
        if impact.contact != "unresolved" and k in used and k + 1 in used
    ]


def _adjusted(
    view: View, looks: list[_Look], links: list[tuple[int, float]], marks: Marks, cut: float
) -> tuple[Marks, float]:
    """Flights moved to where marks that sit anywhere on their faces, and weakly the edges, want them; and the largest
    move, in sigmas.

    Unknowns are twelve numbers a flight, the warps of each marked face's texture, the lens blur, and the instant of each bounce, at which
    position and orientation go on without a jump.
    """
    used = np.unique([look.flight for look in looks])
    column = {int(k): 12 * i for i, k in enumerate(used)}
    place_of = {int(f): 12 * len(used) + WARPS * i for i, f in enumerate(marks.marked_faces)}
    blur_at = 12 * len(used) + WARPS * len(place_of)
    in_flight = np.bincount([look.flight for look in looks])
    poses = _poses(looks, marks.flights)
    equations = [_equations(view, marks, look, poses, i, cut) for i, look in enumerate(looks)]
    edges = _edges_minus_flights(looks, poses)
    squared = [q for H, g, _, _ in equations if (q := _whitened_square(H, g)) is not None]
    factor = max(1.0, float(np.median(squared)) / CHI2_MEDIAN) if squared else marks.factor
    A = np.diag(_priors(view, len(used), len(place_of), len(links)))
    y = np.zeros(len(A))
    for look, (H, g, place, _), M, away in zip(looks, equations, poses.by_start, edges, strict=True):
        # What edges get wrong they get wrong alike on all frames of a flight: together they count as one.
        common = look.edge_covariance + _contour_covariance(view, look.edge_position_m, marks.contour_m)
        E = np.linalg.inv(common) / in_flight[look.flight]
        c = slice(column[look.flight], column[look.flight] + 12)
        A[c, c] += M.T @ (H / factor + E) @ M
        y[c] += M.T @ (g / factor + E @ away)
        for f, at in place_of.items():
            if not place[f].any():
                continue
            s = np.r_[at : at + WARPS, blur_at]
            cross = M.T @ place[f][:, :6].T / factor
            A[c, s] += cross
            A[s, c] += cross.T
            A[np.ix_(s, s)] += place[f][:, 6:-1] / factor
            y[s] += place[f][:, -1] / factor
    for i, (k, time_s) in enumerate(links):
        J, gap = _link_equations(marks.flights[k], marks.flights[k + 1], time_s)
        s = np.r_[column[k] : column[k] + 12, column[k + 1] : column[k + 1] + 12, blur_at + SHARED + i]
        A[np.ix_(s, s)] += J.T @ J
        y[s] += J.T @ gap
    C = _inverse(A)
    step = C @ y
    # What would be left if the places of the textures were known: the rest of C is common to all frames.
    sure = np.r_[0 : 12 * len(used), blur_at + SHARED : len(A)]
    own = _inverse(A[np.ix_(sure, sure)])
    flights, shared = list(marks.flights), list(marks.shared)
    for k, at in column.items():
        c = slice(at, at + 12)
        flights[k] = replace(flights[k], start=moved(flights[k].start, step[c]), covariance=C[c, c])
        shared[k] = C[c, c] - own[c, c]
    moves = [np.abs(step[c : c + 12]) / np.sqrt(np.diag(C)[c : c + 12]) for c in column.values()]
    blur = marks.blur_px * float(np.clip(1.0 + step[blur_at] / marks.blur_px, 0.7, 1.4))
    noise = np.array([np.where(stats[:, 1] > 0, stats[:, 2], np.nan) for _, _, _, stats in equations])
    usual = np.nanmedian(np.where(np.isfinite(noise).any(0), noise, 0.0), axis=0)
    adjusted = replace(
        marks, flights=tuple(flights), shared=tuple(shared), factor=factor,
        blur_px=float(np.clip(blur, *BLUR_RANGE_PX)), noise_grey=np.where(marks.noise_grey > 0, usual, 0.0),
    )  # fmt: skip
    return replace(adjusted, contour_m=_contour_error(view, looks, adjusted)), float(np.max(moves))


def _priors(view: View, flights: int, faces: int, links: int) -> Array:
    """Diagonal of the prior's information, in the order of the unknowns."""
    edge = view.die.solid.edge_m
    warp = PRIOR_WARP * np.array([edge, edge, 1.0, 1.0, 1.0, 1.0, 1.0 / edge, 1.0 / edge])
    places = np.tile(1.0 / np.append(warp, PRIOR_BLUR) ** 2, faces)
    return np.concatenate(
        [np.zeros(12 * flights), places, [1.0 / PRIOR_LENS_PX**2], np.full(links, 1.0 / PRIOR_INSTANT_S**2)]
    )


def _link_equations(before: Flight, after: Flight, time_s: float) -> tuple[Array, Array]:
    """Rows (6, 25) and right side (6,), in sigmas, of: both flights meet at time_s + δt."""
    a, b = before.at(time_s), after.at(time_s)
    gap = np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)])
    drift = np.concatenate([b.velocity_m_s - a.velocity_m_s, b.omega_rad_s - a.omega_rad_s])
    instant = np.array([time_s])
    J = np.hstack([transitions(before, instant)[0, :6], -transitions(after, instant)[0, :6], -drift[:, None]])
    sigma = np.array([LINK_M] * 3 + [LINK_RAD] * 3)
    return J / sigma[:, None], gap / sigma


def _inverse(A: Array) -> Array:
    """Inverse of a normal matrix whose unknowns have different units."""
    unit = 1.0 / np.sqrt(np.diag(A))
    scaled = A * np.outer(unit, unit)
    # Far below any direction that was observed, and enough for one that only rounding tells from none.
    scaled[np.diag_indices_from(scaled)] += 1e-12
    return np.asarray(np.linalg.inv(scaled) * np.outer(unit, unit))


def _contour_covariance(view: View, position_m: Array, contour_m: float) -> Array:
    """(6, 6) of the pose from edges that all lie `contour_m` off, in world axes: sideways by as much, in distance by the share of the
    die's size that it is, and turned by it over half the die's size."""
    toward = position_m - view.camera.centre_m
    distance = float(np.linalg.norm(toward))
    ray = toward / distance
    size = 2.0 * view.reach_m
    out = np.zeros((6, 6))
    out[:3, :3] = contour_m**2 * (np.eye(3) + ((2.0 * distance / size) ** 2 - 1.0) * np.outer(ray, ray))
    out[3:, 3:] = (2.0 * contour_m / size) ** 2 * np.eye(3)
    return out


def _contour_error(view: View, looks: list[_Look], marks: Marks) -> float:
    """The length [m] that makes the edges' distance from the flights what `_contour_covariance` expects."""
    squared = []
    for look, away in zip(looks, _edges_minus_flights(looks, _poses(looks, marks.flights)), strict=True):
        unit = _contour_covariance(view, look.edge_position_m, 1.0)
        squared.append(float(away @ np.linalg.solve(unit, away)))
    return float(np.sqrt(np.median(squared) / CHI2_MEDIAN))


def _equations(
    view: View, marks: Marks, look: _Look, poses: _Poses, i: int, cut: float
) -> tuple[Array, Array, Array, Array]:
    """Normal equations of look `i` at the pose of its flight."""
    H, g = np.zeros((6, 6)), np.zeros(6)
    place = np.zeros((len(marks.looks), WARPS + SHARED, 7 + WARPS + SHARED))
    stats = np.zeros((len(marks.looks), 3))
    mark_equations(
        look.image, look.x0, look.y0, *_seen_by(view, marks), poses.position_m[i], poses.rotation[i],
        *_blurs(view, marks, poses.velocity_m_s[i], poses.omega_rad_s[i]), *_on_faces(view, marks, cut), True, H, g,
        place, stats,
    )  # fmt: skip
    return H, g, place, stats


def _edges_minus_flights(looks: list[_Look], poses: _Poses) -> Array:
    """(looks, 6) from the flights' poses to those of the edges."""
    moved_m = np.array([look.edge_position_m for look in looks]) - poses.position_m
    edges = matrix_from_quat(np.array([look.edge_quaternion for look in looks]))
    return np.concatenate([moved_m, _turn_between(poses.rotation, edges)], axis=1)


def _turn_between(start: Array, end: Array) -> Array:
    """Rotation vectors (..., 3), world axes, that take orientations (..., 3, 3) to others less than half a turn away."""
    D = end @ np.swapaxes(start, -1, -2)
    axis = 0.5 * np.stack([D[..., 2, 1] - D[..., 1, 2], D[..., 0, 2] - D[..., 2, 0], D[..., 1, 0] - D[..., 0, 1]], -1)
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    angle = np.arctan2(sine, 0.5 * (np.trace(D, axis1=-2, axis2=-1)[..., None] - 1.0))
    return np.asarray(axis * np.where(sine > 1e-12, angle / np.maximum(sine, 1e-12), 1.0))


def _whitened_square(H: Array, g: Array) -> float | None:
    """gᵀ H⁻¹ g: how far, in squared sigmas, the marks of one frame alone want to move its pose; None where they leave a
    direction open."""
    unit = np.sqrt(np.diag(H))
    if not (unit > 0).all():
        return None
    values, vectors = np.linalg.eigh(H / np.outer(unit, unit))
    if values[0] < 1e-6 * values[-1]:
        return None
    return float((((g / unit) @ vectors) ** 2 / values).sum())
