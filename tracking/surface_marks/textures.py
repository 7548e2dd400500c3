"""Textures of a die's faces, learned from frames on which its pose is known.

Each face has a square grid of face coordinates. Frames are sampled at its texels, divided by the light on that face
and frame, and averaged with weights (inverse variance times the squared cosine of the view). The texture is then as
blurred as the mean of those frames: lens and motion, as a covariance in face coordinates.

**Signal.** Even and odd frames give two textures whose noise is independent. A place is marked if the product of
their slopes exceeds the noise that remains in the mean by LEAST_SLOPE_SNR. A plain face has no marked place and costs
nothing from there on.
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
from ...model.throw import Flight
from ..camera import Camera
from ..flights import transition_matrices
from ..picture import THREADS, PoseState, View
from .kernel_types import LEAST_VIEW_COSINE, MARGIN_BLURS, MOST_OCCLUDED, Faces, Frame, Optics, new_workspace
from .texture_sampling import UNBOUNDED_GREY, TextureSums, sample_texture

Array = NDArray[np.float64]
Image = NDArray[np.float32]
Texels = NDArray[np.uint8]

FEWEST_FRAMES = 3
"""Frames that must show a texel before it is known."""
TEXEL_PX = 0.75
"""Side of a texel in pixels of a face seen squarely at the median distance: finer than the pixels by as much as a
lens resolves at best."""
LEAST_SLOPE_SNR = 4.0
"""Power of the texture's slopes over that of their noise from which a place counts as marked. Noise makes slopes look
steeper than they are; at 4 the information is overestimated by a quarter there, and by far less on the whole."""
SNR_TEXELS = 7
"""Side of the square over which signal and noise are compared."""
FEWEST_MARKED_TEXELS = 50
"""Marked texels (about 28 pixels) below which a face is plain."""
LEAST_FIRST_SNR = 50.0
"""Signal-to-noise ratio of slopes that FEWEST_MARKED_TEXELS of some face must exceed when it is first learned, or the
die has no marks at all. What stays in the picture while the die hardly moves in it, such as a sensor's pattern or the
traces of a codec, is the same on even and odd frames: on plain faces of twelve clips it came to 15 at most, on the
clearest face of eleven marked dice marks came to 900 at least."""
STEEP_SHARE_OF_MARKS = 0.1
"""Slope, over the steepest one on a face, from which marked texels are slopes rather than flat ground."""
SPLINE_TEXELS = 5
"""Side of the square that must be known about a used texel: a cubic spline reaches two texels to either side."""
CLEANED_TEXELS = 3
"""Side of the smallest square that counts as marked; isolated texels are noise."""
BESIDE_TEXELS = 7
"""Side of the square by which marked places are widened: the flat ground beside marks determines the light."""
PRIOR_CONTOUR_SHARE = 0.01
"""Displacement of edges, over the die's edge, that is assumed before it is estimated: bevels of 3 to 4 % of the edge
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
class SurfaceMarks:
    """The textures of a die's faces, learned from a clip, and the flights that they were adjusted with."""

    grid: FaceGrid
    texture: Array
    """(faces, n, n) reflectance over that of the bare paint, rows along b; NaN where it was never seen."""
    coefficients: Array
    """(faces, n, n) of the cubic B-spline through it."""
    marked: Texels
    """(faces, n, n) 2 on the slopes of marks, 1 around them, 0 where no pixel is used."""
    noise_grey: Array
    """(faces,) usual residual of a pixel; 0 for faces that are plain or were not seen."""
    frame_counts: NDArray[np.int64]
    """(faces,) frames that showed the face."""
    rays: NDArray[np.float32]
    """(height, width, 2) undistorted camera rays x/z, y/z of the pixels."""
    saturation_grey: float
    """Grey level from which pixels are left out."""
    texture_blur_m2: Array
    """(faces, 2, 3) blur of each texture: variances aa, ab, bb in the mean of its frames, of a lens blur of one pixel
    and of the motion."""
    variance_factor: float
    """Residual variance of the marks' poses about the flights over that from pixel noise; at least 1."""
    contour_m: float
    """Bias of the edges relative to the edge model, beyond the error of single frames, as one length: the poses by
    edges have a common error of this size over the die's (see `bundle_adjustment.contour_covariance`)."""
    placement_m: float
    """Common error of the placement of marks, as one length like `contour_m`: what contradicts the edges beyond all stated
    errors; 0 where nothing does."""
    flights: tuple[Flight, ...]
    """The adjusted flights; their covariance includes the uncertain placement of the textures."""
    shared_covariance: tuple[Array, ...]
    """(12, 12) for each flight: the part of its covariance that comes from that placement and is common to all
    frames, however many there are."""

    @property
    def marked_faces(self) -> NDArray[np.int64]:
        """Indices of the faces that have marks."""
        return np.flatnonzero(self.noise_grey > 0)


@dataclass(frozen=True, eq=False)
class FrameWindow:
    """One frame that is learned from: its window round the die, and the pose by edges."""

    time_s: float
    flight: int
    x0: int
    y0: int
    image: Image
    edge_position_m: Array
    edge_quaternion: Array
    edge_covariance: Array


@dataclass(frozen=True, eq=False)
class FlightPoses:
    """Poses of the flights at the windows' times."""

    position_m: Array
    rotation: Array
    velocity_m_s: Array
    omega_rad_s: Array
    by_initial_state: Array
    """(n, 6, 12) derivative of the pose by the initial state of its flight."""

    def frame(self, k: int, window: FrameWindow) -> Frame:
        """Window k with its pose, for the kernels."""
        pose = PoseState(self.position_m[k], self.rotation[k], self.velocity_m_s[k], self.omega_rad_s[k])
        return Frame(window.image, window.x0, window.y0, pose)


def flight_poses(windows: list[FrameWindow], flights: tuple[Flight, ...]) -> FlightPoses:
    """The poses of the flights at the times of the windows."""
    n = len(windows)
    out = FlightPoses(np.empty((n, 3)), np.empty((n, 3, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 6, 12)))
    flight_of = np.array([window.flight for window in windows])
    times = np.array([window.time_s for window in windows])
    for k in np.unique(flight_of):
        mine, flight = flight_of == k, flights[k]
        out.position_m[mine], q = flight.poses(times[mine])
        out.rotation[mine] = matrix_from_quat(q)
        out.velocity_m_s[mine], out.omega_rad_s[mine] = np.split(flight.rates(times[mine]), 2, axis=1)
        out.by_initial_state[mine] = transition_matrices(flight, times[mine])[:, :6]
    return out


def face_grid(view: View, positions_m: Array) -> FaceGrid:
    """Grids with texels of TEXEL_PX at the median distance of positions (n, 3) of the die."""
    solid, camera = view.die.solid, view.camera
    depth = positions_m @ camera.rotation[2] + camera.translation_m[2]
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    texel = TEXEL_PX * float(np.median(depth)) / focal
    axes = face_axes(solid)
    most = max(len(face) for face in solid.faces)
    corners = np.zeros((len(axes), most, 2))
    for f, face in enumerate(solid.faces):
        # The flat part of a rounded face is the inner body's face, moved outwards by the radius.
        corners[f, : len(face)] = view.inner[list(face)] @ axes[f, :2].T
    size = 2 * (int(np.ceil(np.abs(corners).max() / texel)) + 2) + 1
    counts = np.array([len(face) for face in solid.faces], np.int64)
    return FaceGrid(axes, solid.offsets.copy(), corners, counts, size, texel)


def face_axes(solid: Solid) -> Array:
    """(faces, 3, 3) right-handed axes of each face in rows: along its first edge, across it, and the outward normal."""
    out = np.empty((len(solid.faces), 3, 3))
    for f, face in enumerate(solid.faces):
        along = solid.vertices[face[1]] - solid.vertices[face[0]]
        out[f, 0] = along / np.linalg.norm(along)
        out[f, 2] = solid.normals[f]
        out[f, 1] = np.cross(out[f, 2], out[f, 0])
    return out


def pixel_rays(camera: Camera) -> NDArray[np.float32]:
    """Undistorted rays x/z, y/z (height, width, 2) of all pixels of a camera."""
    columns, rows = np.meshgrid(np.arange(camera.width_px), np.arange(camera.height_px))
    return camera.rays(np.stack([columns, rows], axis=-1)).astype(np.float32)


def unlearned_marks(view: View, grid: FaceGrid, saturation_grey: float, flights: tuple[Flight, ...]) -> SurfaceMarks:
    """Surface marks of which nothing is known yet."""
    faces = len(grid.axes)
    shape = (faces, grid.size, grid.size)
    return SurfaceMarks(
        grid,
        texture=np.full(shape, np.nan),
        coefficients=np.ones(shape),
        marked=np.zeros(shape, np.uint8),
        noise_grey=np.zeros(faces),
        frame_counts=np.zeros(faces, np.int64),
        rays=pixel_rays(view.camera),
        saturation_grey=float(saturation_grey),
        texture_blur_m2=np.zeros((faces, 2, 3)),
        variance_factor=1.0,
        contour_m=PRIOR_CONTOUR_SHARE * view.die.solid.edge_m,
        placement_m=0.0,
        flights=flights,
        shared_covariance=tuple(np.full((12, 12), np.nan) for _ in flights),
    )


def with_learned_textures(
    view: View, windows: list[FrameWindow], poses: FlightPoses, marks: SurfaceMarks, cut: float
) -> SurfaceMarks:
    """The textures learned again from the `poses` of the windows; known textures say what a face should look like."""
    grid = marks.grid
    faces = len(grid.axes)
    shape = (faces, grid.size, grid.size)
    # Even and odd frames are summed separately: their noise is independent.
    total, weight = np.zeros((2, *shape)), np.zeros((2, *shape))
    count = np.zeros((2, *shape), np.int32)
    blur, blur_weight = np.zeros((faces, 2, 3)), np.zeros(faces)
    frame_counts = np.zeros(faces, np.int64)
    facing = _view_cosines(view, grid, poses)
    optics, face_records = optics_of(view, marks), faces_of(view, marks, cut)

    def learn(f: int) -> None:
        if face_records.learned[f] and not marks.noise_grey[f]:
            return
        knots, workspace = _values_and_slopes(marks.coefficients[f]), new_workspace(grid.size**2, grid.size)
        frame_blur = np.zeros((2, 3))
        for i in np.flatnonzero(facing[:, f] > LEAST_VIEW_COSINE).tolist():
            half = frame_counts[f] % 2
            sums = TextureSums(total[half, f], weight[half, f], count[half, f], frame_blur)
            used, weight_sum = sample_texture(
                poses.frame(i, windows[i]), optics, face_records, f, knots, facing[i, f] ** 2, workspace, sums
            )
            if used >= 1.0 - MOST_OCCLUDED:
                frame_counts[f] += 1
                blur[f] += weight_sum * frame_blur
                blur_weight[f] += weight_sum

    # Faces are independent, and each takes its frames in their order: the sums are the same for any number of
    # threads. Faces that most frames show come first, so that none of them is left over at the end.
    with ThreadPoolExecutor(THREADS) as pool:
        list(pool.map(learn, np.argsort(-(facing > LEAST_VIEW_COSINE).sum(0), kind="stable").tolist()))
    blurred = replace(marks, texture_blur_m2=_mean_or_old(blur, blur_weight, marks.texture_blur_m2))
    return _with_means(blurred, total, weight, count, frame_counts)


def _values_and_slopes(coefficients: Array) -> Array:
    """(3, n, n) of a cubic B-spline surface at its knots: value, and slopes x and y [1/texel]."""
    value, slope = np.array([1.0, 4.0, 1.0]) / 6.0, np.array([-0.5, 0.0, 0.5])
    filters = ((value, value), (slope, value), (value, slope))
    return np.stack([cv2.sepFilter2D(coefficients, cv2.CV_64F, x, y) for x, y in filters])


def _view_cosines(view: View, grid: FaceGrid, poses: FlightPoses) -> Array:
    """(windows, faces) cosines between the faces' normals and the direction from their middles to the camera."""
    normals = np.einsum("nij,fj->nfi", poses.rotation, grid.axes[:, 2])
    toward = view.camera.centre_m - poses.position_m[:, None] - grid.offsets[:, None] * normals
    return np.asarray((toward * normals).sum(2) / np.linalg.norm(toward, axis=2))


def _with_means(
    marks: SurfaceMarks, total: Array, weight: Array, count: NDArray[np.int32], frame_counts: NDArray[np.int64]
) -> SurfaceMarks:
    """The marks with the weighted means of the samples (even and odd frames, faces, n, n), and where these have
    signal."""
    both, clear = weight.sum(0), bool(len(marks.marked_faces))
    known = (count.sum(0) >= FEWEST_FRAMES) & (both > 0)
    # Texels without a new sample keep their values.
    texture = np.where(known, total.sum(0) / np.where(known, both, 1.0), marks.texture)
    coefficients, marked, noise = marks.coefficients.copy(), marks.marked.copy(), marks.noise_grey.copy()
    for f in np.flatnonzero(known.sum((1, 2)) >= FEWEST_MARKED_TEXELS):
        coefficients[f] = ndimage.spline_filter(_filled(texture[f]), order=3, mode="mirror")
        if noise[f] == 0.0:
            split = (count[:, f] > 0).all(0) & known[f]
            halves = [np.where(split, total[h, f] / np.where(split, weight[h, f], 1.0), np.nan) for h in (0, 1)]
            marked[f], snr = _marked_texels(*halves)
            noise[f] = UNBOUNDED_GREY if (marked[f] > 0).sum() >= FEWEST_MARKED_TEXELS else 0.0
            clear = clear or (noise[f] > 0.0 and snr > LEAST_FIRST_SNR)
        marked[f] = _steep_or_flat(coefficients[f], marked[f])
    if not clear:
        noise[:] = 0.0
    return replace(
        marks, texture=texture, coefficients=coefficients, marked=marked, noise_grey=noise,
        frame_counts=np.maximum(frame_counts, marks.frame_counts),
    )  # fmt: skip


def _mean_or_old(total: Array, weight: Array, old: Array) -> Array:
    """Weighted means (faces, 2, 3) of the faces that were seen, the old values of the others."""
    seen = (weight > 0)[:, None, None]
    return np.where(seen, total / np.where(seen, weight[:, None, None], 1.0), old)


def _filled(texture: Array) -> Array:
    """The texture with unknown texels copied from the nearest known one, so that a spline through it has no jump
    there."""
    unknown = ~np.isfinite(texture)
    nearest = ndimage.distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return np.asarray(texture[tuple(nearest)])


def _marked_texels(even: Array, odd: Array) -> tuple[Texels, float]:
    """Where two textures of independent noise agree on slopes steeper than the noise, and BESIDE_TEXELS around; and the
    signal-to-noise ratio that FEWEST_MARKED_TEXELS reach."""
    known = (np.isfinite(even) & np.isfinite(odd)).astype(np.uint8)
    inner = cv2.erode(known, np.ones((SPLINE_TEXELS, SPLINE_TEXELS), np.uint8), borderValue=0)
    slopes = [
        np.array(np.gradient(_filled(half))) if known.any() else np.zeros((2, *half.shape)) for half in (even, odd)
    ]
    box = (SNR_TEXELS, SNR_TEXELS)
    signal = cv2.blur((slopes[0] * slopes[1]).sum(0) * inner, box)
    # The noise power of the mean of both halves is a quarter of the power of their difference.
    noise = cv2.blur(((slopes[0] - slopes[1]) ** 2).sum(0) * inner, box) / 4.0
    ratio = np.where(inner > 0, signal / np.maximum(noise, 1e-300), 0.0)
    clear = (ratio > LEAST_SLOPE_SNR).astype(np.uint8)
    clear = cv2.morphologyEx(clear, cv2.MORPH_OPEN, np.ones((CLEANED_TEXELS, CLEANED_TEXELS), np.uint8))
    fewest = FEWEST_MARKED_TEXELS
    snr = float(np.partition(ratio, -fewest, axis=None)[-fewest]) if ratio.size > fewest else 0.0
    beside = cv2.dilate(clear, np.ones((BESIDE_TEXELS, BESIDE_TEXELS), np.uint8))
    return np.asarray(beside * inner, np.uint8), snr


def _steep_or_flat(texture: Array, marked: Texels) -> Texels:
    """2 for marked texels on and beside slopes, 1 for those on flat ground, 0 for the others."""
    slope = np.hypot(*np.gradient(texture)) * (marked > 0)
    steep = cv2.dilate((slope > STEEP_SHARE_OF_MARKS * slope.max()).astype(np.uint8), np.ones((3, 3), np.uint8))
    return np.where(marked > 0, 1 + steep, 0).astype(np.uint8)


def optics_of(view: View, marks: SurfaceMarks) -> Optics:
    """The first camera of the view, for the kernels."""
    camera = view.camera
    return Optics(
        marks.rays, camera.matrix, camera.distortion, camera.rotation, camera.translation_m, float(view.exposure_s),
        view.lens.blur_px, view.lens.aperture_m, view.lens.focus_m, float(view.rig.row_s[0]),
    )  # fmt: skip


def faces_of(view: View, marks: SurfaceMarks, cut: float) -> Faces:
    """The faces and their textures, for the kernels; robust weights end at `cut` [sigmas]."""
    grid = marks.grid
    learned = np.asarray(np.isfinite(marks.texture).any(axis=(1, 2)))
    return Faces(
        grid.axes, grid.offsets, grid.corners, grid.counts, learned, marks.texture_blur_m2, marks.coefficients, marks.marked,
        marks.noise_grey, MARGIN_BLURS * view.blur_px + 0.5, float(grid.texel_m), float(marks.saturation_grey),
        float(view.settings.noise_floor_grey), float(cut),
    )  # fmt: skip
