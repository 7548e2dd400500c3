"""Textures of a die's faces, learned from frames on which its pose is known (see `marks`).

Each face has a square grid of face coordinates. What frames show of it is brought there, divided by the light on that face and
frame, and averaged with weights; the texture of a face is then as blurred as the mean of its looks (lens and motion, as a
covariance in face coordinates), and a frame that is blurred more or less than that is modelled by blurring the texture by the
difference.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from ...model.die import Solid
from ...model.rotations import matrix_from_quat
from ...model.throw import Flight, Throw
from ..camera import Camera
from ..picture import THREADS, View
from ..throw import transition_matrices
from .kernel_types import GRAZING, MARGIN_BLURS, MOST_HIDDEN, Faces, Optics, new_bench
from .texture_gains import look_at_face

Array = NDArray[np.float64]
Image = NDArray[np.float32]

FEWEST_LOOKS = 3
"""Frames that must show a texel before it is known."""
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
CLEAR = 50.0
"""Power of the slopes over that of their noise that FEWEST_TEXELS of some face must exceed when it is first seen, or the die has
no marks at all. What stays in the picture while the die hardly moves in it, a sensor's pattern or what a codec leaves, is on even
frames as on odd ones: on plain faces of twelve clips it came to 15 times the noise at the most, on the clearest face of eleven
marked dice marks came to 900 at the least."""
UNBOUNDED_GREY = 1e9
"""Noise of a face that no frame has been asked for yet."""
MOST_TURNS, SAME_RAY = 20, 1e-9
"""Turns in which a lens is undone, and by how much, as a slope, one moves a ray that is the last: single precision is coarser.
The distortion of a usable lens is a contraction; each turn gains one to two digits."""
CONTOUR_SHARE = 0.01
"""Misplacement of edges, over the die's edge, that is thought possible before any was measured: bevels of 3 to 4 % of the edge
shift the apparent contour by 1 to 2 %."""


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
    """By how much the edges lie elsewhere than the model of an edge expects, beyond what each frame errs for itself, as one
    length: their poses have a common error of this size over the die's (see `marks_adjustment.contour_covariance`)."""
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
class Look:
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
class Poses:
    """Where the flights put the die on every look."""

    position_m: Array
    rotation: Array
    velocity_m_s: Array
    omega_rad_s: Array
    by_start: Array
    """(n, 6, 12) derivative of the pose by the state at the start of its flight."""


def poses_of(looks: list[Look], flights: tuple[Flight, ...]) -> Poses:
    n = len(looks)
    out = Poses(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 6, 12)))
    of = np.array([look.flight for look in looks])
    times = np.array([look.time_s for look in looks])
    for k in np.unique(of):
        mine, flight = of == k, flights[k]
        out.position_m[mine], q = flight.poses(times[mine])
        out.rotation[mine] = matrix_from_quat(q)
        out.velocity_m_s[mine], out.omega_rad_s[mine] = np.split(flight.rates(times[mine]), 2, axis=1)
        out.by_start[mine] = transition_matrices(flight, times[mine])[:, :6]
    return out


def face_grid(view: View, looks: list[Look], throw: Throw) -> FaceGrid:
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


def undistorted_rays(camera: Camera) -> NDArray[np.float32]:
    """Camera rays x/z, y/z (height, width, 2) of all pixels, by Newton-like fixed-point steps on the distortion."""
    K, d = camera.matrix, camera.distortion
    yd = (np.arange(camera.height_px)[:, None] - K[1, 2]) / K[1, 1]
    xd = (np.arange(camera.width_px) - K[0, 2] - K[0, 1] * yd) / K[0, 0]
    x, y = xd, yd
    for _ in range(MOST_TURNS if np.any(d) else 0):
        r2 = x * x + y * y
        g = 1.0 + r2 * (d[0] + r2 * (d[1] + r2 * d[4]))
        dx, dy = 2.0 * d[2] * x * y + d[3] * (r2 + 2.0 * x * x), d[2] * (r2 + 2.0 * y * y) + 2.0 * d[3] * x * y
        was, x, y = (x, y), (xd - dx) / g, (yd - dy) / g
        if max(np.abs(x - was[0]).max(), np.abs(y - was[1]).max()) < SAME_RAY:
            break
    rays = np.empty((camera.height_px, camera.width_px, 2), np.float32)
    rays[..., 0], rays[..., 1] = x, y
    return rays


def blank_marks(view: View, grid: FaceGrid, saturation_grey: float, throw: Throw) -> Marks:
    """Marks of which nothing is known yet."""
    shape = (len(grid.axes), grid.size, grid.size)
    faces = len(grid.axes)
    return Marks(
        grid, np.full(shape, np.nan), np.ones(shape), np.zeros(shape, np.uint8), np.zeros(faces),
        np.zeros(faces, np.int64), undistorted_rays(view.camera), float(saturation_grey), view.blur_px,
        np.zeros((faces, 2, 3)), 1.0, CONTOUR_SHARE * view.die.solid.edge_m, throw.flights,
        tuple(np.full((12, 12), np.nan) for _ in throw.flights),
    )  # fmt: skip


def with_learned_textures(
    view: View, looks: list[Look], flights: tuple[Flight, ...], marks: Marks, cut: float
) -> Marks:
    """Textures anew from the poses of `flights`, with the old ones as what a face should look like, where there are."""
    grid = marks.grid
    shape = (len(grid.axes), grid.size, grid.size)
    # Even and odd looks apart: their noise is independent.
    total, weight = np.zeros((2, *shape)), np.zeros((2, *shape))
    count = np.zeros((2, *shape), np.int32)
    base, base_weight = np.zeros((shape[0], 2, 3)), np.zeros(shape[0])
    seen = np.zeros(shape[0], np.int64)
    poses = poses_of(looks, flights)
    facings = _facings(view, grid, poses)
    optics, faces = optics_of(view, marks), faces_of(view, marks, cut)

    def learn(f: int) -> None:
        known = bool(np.isfinite(marks.texture[f]).any())
        if known and not marks.noise_grey[f]:
            return
        knots, bench, own = _knots(marks.coefficients[f]), new_bench(grid.size**2, grid.size), np.zeros((2, 3))
        for i in np.flatnonzero(facings[:, f] > GRAZING):
            look, half = looks[i], seen[f] % 2
            share, together = look_at_face(
                look.image, look.x0, look.y0, optics, faces, f, knots, poses.position_m[i], poses.rotation[i],
                poses.velocity_m_s[i], poses.omega_rad_s[i], known, facings[i, f] ** 2, bench, total[half, f],
                weight[half, f], count[half, f], own,
            )  # fmt: skip
            if share >= MOST_HIDDEN:
                seen[f] += 1
                base[f] += together * own
                base_weight[f] += together

    # Faces know nothing of each other, and each takes its looks in their order: the same sums with any number of threads. Those
    # that were seen most begin, so that none is left over at the end.
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(learn, np.argsort(-(facings > GRAZING).sum(0), kind="stable").tolist()))
    return _with_textures(replace(marks, base=_where_seen(base, base_weight, marks.base)), total, weight, count, seen)


def _knots(coefficients: Array) -> Array:
    """(3, n, n) of a cubic B-spline surface where its coefficients (n, n) sit: value, and slopes x and y [1/texel]."""
    level, slope = np.array([1.0, 4.0, 1.0]) / 6.0, np.array([-0.5, 0.0, 0.5])
    both = ((level, level), (slope, level), (level, slope))
    return np.stack([cv2.sepFilter2D(coefficients, cv2.CV_64F, x, y) for x, y in both])


def _facings(view: View, grid: FaceGrid, poses: Poses) -> Array:
    """(looks, faces) cosines between the faces' normals and the way to the camera, from the middle of each face."""
    normals = np.einsum("nij,fj->nfi", poses.rotation, grid.axes[:, 2])
    toward = view.camera.centre_m - poses.position_m[:, None] - grid.offsets[:, None] * normals
    return np.asarray((toward * normals).sum(2) / np.linalg.norm(toward, axis=2))


def _with_textures(
    marks: Marks, total: Array, weight: Array, count: NDArray[np.int32], seen: NDArray[np.int64]
) -> Marks:
    """Marks with the means of what was seen, and where on them there is signal."""
    both, clear = weight.sum(0), bool(len(marks.marked_faces))
    known = (count.sum(0) >= FEWEST_LOOKS) & (both > 0)
    # Where nothing was looked at anew, what was known stays.
    texture = np.where(known, total.sum(0) / np.where(known, both, 1.0), marks.texture)
    coefficients, marked, noise = marks.coefficients.copy(), marks.marked.copy(), marks.noise_grey.copy()
    for f in np.flatnonzero(known.sum((1, 2)) >= FEWEST_TEXELS):
        coefficients[f] = ndimage.spline_filter(_filled(texture[f]), order=3, mode="mirror")
        if noise[f] == 0.0:
            split = (count[:, f] > 0).all(0) & known[f]
            halves = [np.where(split, total[h, f] / np.where(split, weight[h, f], 1.0), np.nan) for h in (0, 1)]
            marked[f], strength = _marked(*halves)
            noise[f] = UNBOUNDED_GREY if (marked[f] > 0).sum() >= FEWEST_TEXELS else 0.0
            clear = clear or (noise[f] > 0.0 and strength > CLEAR)
        marked[f] = _steep_places(coefficients[f], marked[f])
    if not clear:
        noise[:] = 0.0
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


def _marked(even: Array, odd: Array) -> tuple[NDArray[np.uint8], float]:
    """Where two textures of independent noise agree on slopes steeper than that noise makes, and a little around; and the
    ratio of their powers that FEWEST_TEXELS reach."""
    known = (np.isfinite(even) & np.isfinite(odd)).astype(np.uint8)
    # Splines reach over two texels: nothing is looked at so near to what is unknown.
    inner = cv2.erode(known, np.ones((5, 5), np.uint8), borderValue=0)
    slopes = [
        np.array(np.gradient(_filled(half))) if known.any() else np.zeros((2, *half.shape)) for half in (even, odd)
    ]
    box = (SIGNAL_TEXELS, SIGNAL_TEXELS)
    signal = cv2.blur((slopes[0] * slopes[1]).sum(0) * inner, box)
    # The mean of both halves has a quarter of the power of their difference as noise.
    noise = cv2.blur(((slopes[0] - slopes[1]) ** 2).sum(0) * inner, box) / 4.0
    ratio = np.where(inner > 0, signal / np.maximum(noise, 1e-300), 0.0)
    clear = (ratio > SIGNAL).astype(np.uint8)
    clear = cv2.morphologyEx(clear, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    strength = (
        float(np.partition(ratio, -FEWEST_TEXELS, axis=None)[-FEWEST_TEXELS]) if ratio.size > FEWEST_TEXELS else 0.0
    )
    return np.asarray(cv2.dilate(clear, np.ones((7, 7), np.uint8)) * inner, np.uint8), strength


def _steep_places(texture: Array, marked: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """2 for marked texels on and beside slopes, 1 for those on flat ground."""
    slope = np.hypot(*np.gradient(texture)) * (marked > 0)
    steep = cv2.dilate((slope > 0.1 * slope.max()).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.where(marked > 0, 1 + steep, 0).astype(np.uint8)


def optics_of(view: View, marks: Marks) -> Optics:
    """The camera as the kernels want it."""
    camera = view.camera
    return Optics(
        marks.rays, camera.matrix, camera.distortion, camera.rotation, camera.translation_m, float(view.exposure_s),
        float(marks.blur_px),
    )  # fmt: skip


def faces_of(view: View, marks: Marks, cut: float) -> Faces:
    """The faces and their marks as the kernels want them, for robust weights that end at `cut` [sigmas]."""
    grid = marks.grid
    return Faces(
        grid.axes, grid.offsets, grid.corners, grid.counts, marks.base, marks.coefficients, marks.marked, marks.noise_grey,
        MARGIN_BLURS * marks.blur_px + 0.5, float(grid.texel_m), float(marks.saturation_grey),
        float(view.settings.floor_grey), float(cut),
    )  # fmt: skip
