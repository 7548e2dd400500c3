"""The first pose, found with no click.

The region that differs from the background gives a place and, by its area, a distance; orientations are tried on a
fixed grid over the rotations that the die's symmetry leaves apart; every trial is scored by how well the drawn die
explains the picture, the best are refined on the edges and scored again. Shadow may or may not be part of the region:
both readings are tried.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import NDArray

from ..model.rotations import matrix_from_quat
from .pose import COARSE, Pose, View, picture_score, refine_pose
from .segment import Blob, differing, largest_blob, without_shadow

Array = NDArray[np.float64]

ROTATIONS = {"tetrahedron": 12, "cube": 24, "octahedron": 24, "dodecahedron": 60, "icosahedron": 60}
"""Order of each die's rotation group: the grid needs that many times fewer orientations."""
GRID = 12_000
"""Orientations over all rotations, before the symmetry divides them: near enough for the edges to pull a start in."""
REFINED, KEPT = 48, 6
LIT_SHARE = 0.2
"""A region of which less than this is not shadow shows no die."""


def find_start(view: View, image: NDArray[np.float32]) -> list[tuple[float, Pose]]:
    """Candidate poses for one frame, best first, each with its picture score; empty where no die is seen."""
    blobs = die_blobs(view, image)
    if not blobs:
        return []
    # One window for all readings, so that their scores can be compared.
    corners = np.array([blob.box for blob in blobs])
    x0, y0 = (int(v) for v in corners[:, :2].min(0))
    x1, y1 = (int(v) for v in corners[:, 2:].max(0))
    margin = int(0.2 * max(x1 - x0, y1 - y0)) + 6
    width, height = view.camera.width_px, view.camera.height_px
    box = (max(x0 - margin, 0), max(y0 - margin, 0), min(x1 + margin, width), min(y1 + margin, height))
    found = [pair for blob in blobs for pair in _search(view, image, blob, box)]
    found.sort(key=lambda pair: pair[0])
    return _apart(view, found)[:KEPT]


def die_blobs(view: View, image: NDArray[np.float32]) -> list[Blob]:
    """The regions that may be the die, not cut by the image border: with what looks like shadow taken out, and with it."""
    mask = differing(image, view.background, view.noise_grey)
    lit = without_shadow(image, view.background, view.noise_grey, mask)
    bright = mask & (image > view.background)
    rest, whole = largest_blob(lit), largest_blob(mask)
    if rest is None or whole is None or rest.area_px < LIT_SHARE * whole.area_px:
        # Nothing but a shadow: it often comes into view before the die that casts it.
        return []
    return [b for b in (rest, largest_blob(bright), whole) if b and not b.touches_border]


def _search(
    view: View, image: NDArray[np.float32], blob: Blob, box: tuple[int, int, int, int]
) -> list[tuple[float, Pose]]:
    """Grid search about one blob, then refinement of the best."""
    camera, solid = view.camera, view.die.solid
    stride = max(1, int(np.sqrt((box[2] - box[0]) * (box[3] - box[1]) / 1500)))
    focal = float(np.sqrt(camera.matrix[0, 0] * camera.matrix[1, 1]))
    depth = focal * np.sqrt(_mean_shadow_area(solid.vertices, solid.faces) / blob.area_px)
    ray = camera.rotation.T @ _ray(camera.matrix, blob.centre_px)
    trials = []
    for factor in (0.85, 0.95, 1.06, 1.18):
        position = camera.centre_m + ray * depth * factor
        if position[2] < 0.5 * solid.inradius:
            continue
        for rotation in _grid(GRID // ROTATIONS.get(solid.name, 12)):
            trials.append((picture_score(view, image, box, position, rotation, stride)[0], position, rotation))
    trials.sort(key=lambda t: t[0])
    found = []
    for _, position, rotation in trials[:REFINED]:
        pose = refine_pose(
            view, image, position, rotation, coarse=len(COARSE), prior_position_m=2e-2, prior_rotation_rad=0.3
        )
        if pose.covariance is None or pose.position_m[2] < 0.3 * solid.inradius:
            continue
        score, differs = picture_score(view, image, box, pose.position_m, pose.rotation, max(1, stride // 2))
        if differs > 0.4 and pose.support > 0.5:
            found.append((score + 2.0 * (1.0 - pose.support) + 10.0 * pose.unexplained, pose))
    return found


def _apart(view: View, found: list[tuple[float, Pose]]) -> list[tuple[float, Pose]]:
    """One of each group of poses that draw the same picture: every corner within a twentieth of an edge of some corner
    of the other, which the die's symmetry makes likely."""
    vertices = view.die.solid.vertices
    near = 0.05 * view.die.solid.edge_m
    kept: list[tuple[float, Pose]] = []
    drawn: list[Array] = []
    for score, pose in found:
        corners = vertices @ pose.rotation.T + pose.position_m
        if any(np.linalg.norm(corners[:, None] - other[None], axis=2).min(1).max() < near for other in drawn):
            continue
        kept.append((score, pose))
        drawn.append(corners)
    return kept


def _ray(matrix: Array, pixel: Array) -> Array:
    """Camera ray of unit depth through a pixel; lens distortion is left out, which a start can bear."""
    return np.asarray(np.linalg.solve(matrix, np.array([pixel[0], pixel[1], 1.0])))


def _mean_shadow_area(vertices: Array, faces: tuple[tuple[int, ...], ...]) -> float:
    """Mean projected area [m²] of a convex body over all directions: a quarter of its surface (Cauchy)."""
    surface = 0.0
    for face in faces:
        a = vertices[face[0]]
        for j in range(1, len(face) - 1):
            surface += 0.5 * float(np.linalg.norm(np.cross(vertices[face[j]] - a, vertices[face[j + 1]] - a)))
    return surface / 4.0


@cache
def _grid(count: int) -> Array:
    """`count` rotations (count, 3, 3) spread evenly: super-Fibonacci spirals (Alexa, CVPR 2022)."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    a, b = 2.0 * np.pi * s / phi, 2.0 * np.pi * s / psi
    return matrix_from_quat(np.stack([r * np.sin(a), r * np.cos(a), big * np.sin(b), big * np.cos(b)], 1))
