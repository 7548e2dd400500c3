"""One frame: the pose of the die that explains its pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.solids import Die, symmetry_rotations
from .camera import Camera
from .edges import refine, region_score

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class View:
    """What a camera shows of a die: everything about the scene that stays the same from frame to frame."""

    camera: Camera
    background: NDArray[np.float32]
    """(height, width) the table without the die, in grey levels."""
    inner: Array
    """(n, 3) [m] vertices of the sharp body round which the ball of `radius_m` rolls; the die's own if it is sharp."""
    offsets: Array
    """(faces,) [m] distances of the inner body's faces."""
    die: Die
    face_edges: NDArray[np.int64]
    """(faces, most) edges of each face, padded with -1."""
    noise_grey: float
    """Standard deviation of a pixel of the still background between frames."""
    exposure_s: float
    """0 where it is not known."""
    blur_px: float
    """Standard deviation of the lens blur."""
    symmetries: Array
    """(order, 3, 3) rotations that leave the die's shape as it is: nothing but marks tells its labellings apart."""

    @property
    def reach_m(self) -> float:
        """Farthest point of the die from its centre."""
        return self.die.solid.circumradius


@dataclass(frozen=True, eq=False)
class Pose:
    """Where the die is on one frame, and how well the pixels of this frame say so."""

    position_m: Array
    rotation: Array
    """(3, 3) body to world."""
    information: Array
    """(6, 6) inverse covariance from the pixels of this frame alone: position [m], rotation vector [rad], world axes."""
    unexplained: float
    """Mean truncated cost of an edge pixel, 0 to 1: the share that the edge model does not explain."""
    support: float
    """Share of the visible contour that shows a clear step, 0 to 1."""
    contour_px: float
    """Length of visible contour that was walked."""
    log_noise: float
    """Mean logarithm of the grey noise that the edge model leaves over; the right blur makes it smallest."""

    @property
    def covariance(self) -> Array | None:
        """(6, 6), or None where the pixels leave a direction open."""
        scale = np.array([1e-3] * 3 + [1e-2] * 3)
        scaled = self.information * np.outer(scale, scale)
        values = np.linalg.eigvalsh(scaled)
        if not np.isfinite(values).all() or values[0] <= 1e-9 * values[-1] or values[-1] <= 0:
            return None
        return np.asarray(np.linalg.inv(scaled) * np.outer(scale, scale))


def make_view(
    camera: Camera,
    die: Die,
    background: NDArray[np.float32],
    noise_grey: float,
    exposure_s: float | None,
    blur_px: float,
) -> View:
    """Prepare the geometry that every frame shares."""
    solid = die.solid
    shrink = 1.0 - die.corner_radius_m / solid.inradius
    most = max(len(face) for face in solid.faces)
    table = np.full((len(solid.faces), most), -1, np.int64)
    fill = [0] * len(solid.faces)
    for e, pair in enumerate(solid.edge_faces):
        for f in pair:
            table[f, fill[f]] = e
            fill[f] += 1
    return View(
        camera,
        np.ascontiguousarray(background, np.float32),
        np.ascontiguousarray(solid.vertices * shrink),
        solid.offsets - die.corner_radius_m,
        die,
        table,
        noise_grey,
        exposure_s or 0.0,
        blur_px,
        symmetry_rotations(solid),
    )


COARSE = ((4.0, 12.0), (3.0, 10.0), (2.2, 8.0), (1.6, 6.5), (1.2, 5.0))
"""Blur and band [px] of the first steps from an uncertain start."""
FINE_STEPS = 6


def refine_pose(
    view: View,
    image: NDArray[np.float32],
    position_m: Array,
    rotation: Array,
    *,
    velocity_m_s: Array | None = None,
    omega_rad_s: Array | None = None,
    coarse: int = 2,
    prior_position_m: float = 3e-3,
    prior_rotation_rad: float = 0.1,
) -> Pose:
    """The pose near a predicted one that explains the frame's edges best.

    `image` is the whole frame as float32; `coarse` is how many of the COARSE steps come before the fine ones; the
    prior keeps directions that the pixels leave open near the prediction and is too weak to pull the others.
    """
    solid, camera = view.die.solid, view.camera
    blur = view.blur_px
    start = COARSE[len(COARSE) - coarse :]
    sigmas = np.array([s for s, _ in start] + [blur] * FINE_STEPS)
    bands = np.array([b for _, b in start] + [max(3.5, 4.0 * blur)] * FINE_STEPS)
    stats = np.zeros(7)
    zero = np.zeros(3)
    p, Q, info = refine(
        image, view.background, 0, 0, camera.matrix, camera.distortion, camera.rotation, camera.translation_m,
        np.asarray(position_m, float), np.ascontiguousarray(rotation, float),
        zero if velocity_m_s is None else velocity_m_s, zero if omega_rad_s is None else omega_rad_s, view.exposure_s,
        view.inner, solid.normals, view.offsets, solid.edges, solid.edge_faces, view.face_edges,
        view.die.corner_radius_m, sigmas, bands, max(0.5, 0.5 * view.noise_grey), prior_position_m, prior_rotation_rad,
        stats,
    )  # fmt: skip
    return Pose(
        p,
        Q,
        info,
        unexplained=float(stats[0] / max(stats[2], 1.0)),
        support=float(stats[4] / max(stats[3], 1e-9)),
        contour_px=float(stats[3]),
        log_noise=float(stats[6] / max(stats[2], 1.0)),
    )


def labelled_like(view: View, rotation: Array, wanted: Array) -> Array:
    """Of the orientations (3, 3) that draw the same die as `rotation`, the one nearest to `wanted`."""
    alike = rotation @ view.symmetries
    return np.asarray(alike[int(np.argmax(np.einsum("nij,ij->n", alike, wanted)))])


def visible_faces(view: View, position_m: Array, rotation: Array) -> NDArray[np.int64]:
    """Indices of the faces that look at the camera."""
    solid = view.die.solid
    toward = (solid.normals @ rotation.T) @ (view.camera.centre_m - position_m) - solid.offsets
    return np.flatnonzero(toward > 0)


def outline_box(view: View, position_m: Array, rotation: Array, margin_px: float) -> tuple[int, int, int, int] | None:
    """Pixel window x0, y0, x1, y1 (end exclusive) round the drawn die, or None where it lies outside the image."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position_m)
    if not np.isfinite(px).all():
        return None
    x0, y0 = np.floor(px.min(0) - margin_px).astype(int)
    x1, y1 = np.ceil(px.max(0) + margin_px).astype(int) + 1
    x0, y0 = max(x0, 0), max(y0, 0)
    x1, y1 = min(x1, view.camera.width_px), min(y1, view.camera.height_px)
    return (int(x0), int(y0), int(x1), int(y1)) if x1 - x0 > 4 and y1 - y0 > 4 else None


def share_in_view(view: View, position_m: Array, rotation: Array) -> float:
    """Share of the die's projected vertices that lie inside the image, 0 to 1."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position_m)
    inside = (px >= 0).all(1) & (px[:, 0] <= view.camera.width_px - 1) & (px[:, 1] <= view.camera.height_px - 1)
    return float(inside.mean())


def picture_score(
    view: View,
    image: NDArray[np.float32],
    box: tuple[int, int, int, int],
    position_m: Array,
    rotation: Array,
    stride: int,
) -> tuple[float, float]:
    """How badly the drawn die explains the window `box` (truncated squared sigmas a pixel), and the share of the die's
    pixels that differ from the background."""
    x0, y0, x1, y1 = box
    solid = view.die.solid
    px = view.camera.project(solid.vertices @ rotation.T + position_m) - (x0, y0)
    faces = visible_faces(view, position_m, rotation)
    planes = np.zeros((max(len(faces), 1), max(len(f) for f in solid.faces), 3))
    count = np.zeros(max(len(faces), 1), np.int64)
    for k, f in enumerate(faces):
        corners = px[list(solid.faces[f])]
        middle = corners.mean(0)
        step = np.roll(corners, -1, 0) - corners
        a, b = -step[:, 1], step[:, 0]
        c = -(a * corners[:, 0] + b * corners[:, 1])
        sign = np.where(a * middle[0] + b * middle[1] + c >= 0, 1.0, -1.0)
        planes[k, : len(corners)] = np.stack([a, b, c], 1) * sign[:, None]
        count[k] = len(corners)
    score, inside, differs = region_score(
        image[y0:y1, x0:x1], view.background[y0:y1, x0:x1], view.noise_grey, stride, planes, count, len(faces), 16.0, 4.0
    )  # fmt: skip
    pixels = max(1, ((y1 - y0) // stride) * ((x1 - x0) // stride))
    return score / pixels, differs if inside > 0 else 0.0
