"""Laws of what a pixel of a die shows: rays meet the rounded body where its normal says, and contours are at their distance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from footage_of_throws import DICE, studio
from numpy.typing import NDArray
from random_throws import random_quaternion

from diethrow.model.compiled import compiled
from diethrow.model.die import inner_vertices
from diethrow.model.die.solid import SHAPES
from diethrow.model.rotations import matrix_from_quat
from diethrow.tracking.picture import with_corner_radius
from diethrow.tracking.picture.view import View
from diethrow.tracking.placed_die.kernel_types import CameraRig, PoseState, Shape, Workspace, new_workspace
from diethrow.tracking.placed_die.projection import face_lines, place_die
from diethrow.tracking.placed_die.rounded_surface import (
    NOTHING,
    contour_segments,
    face_at,
    fill_nearest_contour,
    fill_ray,
    flat_faces,
    part_on_ray,
    rays_about_centre,
)
from diethrow.tracking.pose import pose_state

Array = NDArray[np.float64]

RADIUS_SHARE = 0.3
"""Radius of the corners, as a share of the inscribed radius."""
READOUT_S = 5e-3
"""From the first row to the last: a telephone's at 120 frames a second."""
SPIN_RAD_S = 30.0
"""Standard deviation of each component of the angular velocity."""
EDGE_ON_RAD = 0.02
"""A face is seen edge-on within this angle."""


@compiled
def part_at(
    shape: Shape, rig: CameraRig, pose: PoseState, x: float, y: float, ray: Any, normal: Any, work: Workspace
) -> int:
    """Python cannot call a kernel that only kernels call. The part that a pixel shows, its ray (2, 3) and its normal."""
    view = np.int64(0)
    place_die(shape, rig, view, pose, work)
    fill_ray(rig, view, pose, rays_about_centre(rig, view, pose.position), x, y, ray)
    lines, count = flat_faces(shape, rig, view, pose, work)
    face = face_at(lines, count, x, y)
    if face != NOTHING:
        for q in range(3):
            normal[q] = shape.normals[face, q]
        return int(face)
    hit = np.zeros(6)
    part = part_on_ray(shape, work.face_cosine, ray, np.int64(NOTHING), hit)
    for q in range(3):
        normal[q] = hit[q]
    return int(part)


@compiled
def distance_at(shape: Shape, rig: CameraRig, pose: PoseState, x: float, y: float, out: Any, work: Workspace) -> None:
    place_die(shape, rig, np.int64(0), pose, work)
    fill_nearest_contour(contour_segments(shape, work), x, y, out)


@compiled
def shows_face(shape: Shape, rig: CameraRig, pose: PoseState, f: int, px: Any, rounded: bool, work: Workspace) -> int:
    """How many of pixels (n, 2) show a face, if it is not turned away: of the rounded body, or of the sharp one."""
    view, number, one = np.int64(0), 0, np.zeros((1, shape.face_edges.shape[1], 3))
    place_die(shape, rig, view, pose, work)
    if not work.face_cosine[f] > 0.0:
        return 0
    lines, count = flat_faces(shape, rig, view, pose, work)
    if not rounded:
        count[f] = face_lines(shape, work, f, one[0])
    for k in range(px.shape[0]):
        number += face_at(lines[f : f + 1] if rounded else one, count[f : f + 1], px[k, 0], px[k, 1]) == 0
    return number


def rounded_view(shape: str) -> View:
    view = studio().view(DICE[shape])
    return with_corner_radius(view, RADIUS_SHARE * view.die.solid.inradius)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_ray_meets_the_rounded_body_where_the_normal_says(shape: str) -> None:
    """The body touches its supporting plane of every normal at the points of that normal: a ray enters there, and neither the
    body nor the ray before it lies beyond."""
    view, rng = rounded_view(shape), np.random.default_rng(1)
    solid, radius = view.die.solid, view.shape.radius
    inner, work = inner_vertices(solid, radius), new_workspace(view.shape, view.rig)
    position, kinds = np.array([0.001, -0.002, 0.02]), set()
    for _ in range(6):
        R = matrix_from_quat(random_quaternion(rng))
        pose = pose_state(position, R)
        centre = view.camera.project(position[None])[0]
        for x, y in centre + rng.uniform(-45.0, 45.0, (80, 2)):
            ray, normal = np.zeros((2, 3)), np.zeros(3)
            part = part_at(view.shape, view.rig, pose, x, y, ray, normal, work)
            if part == NOTHING:
                continue
            nf, ne = len(solid.normals), len(view.shape.edges)
            kinds.add("face" if part < nf else "strip" if part < nf + ne else "corner")
            assert np.linalg.norm(normal) == pytest.approx(1.0)
            reach = (inner @ normal).max() + radius
            origin, direction = ray
            point = origin + (reach - origin @ normal) / (direction @ normal) * direction
            assert direction @ normal < 0.0
            # The centre of the ball that touches there lies in the inner body.
            assert ((point - radius * normal) @ solid.normals.T - view.shape.offsets).max() < 3e-7
    assert kinds == {"face", "strip", "corner"}


@pytest.mark.parametrize("shape", SHAPES)
def test_distance_from_a_contour(shape: str) -> None:
    """That of the nearest of many points on the outline of the inner body."""
    view, rng = rounded_view(shape), np.random.default_rng(2)
    work = new_workspace(view.shape, view.rig)
    R = matrix_from_quat(random_quaternion(rng))
    position = np.array([0.0, 0.0, 0.02])
    px = view.camera.project(view.shape.vertices @ R.T + position)
    outline = outline_points(px)
    for x, y in px.mean(0) + rng.uniform(-60.0, 60.0, (100, 2)):
        out = np.zeros(5)
        distance_at(view.shape, view.rig, pose_state(position, R), x, y, out, work)
        nearest = float(np.linalg.norm(outline - (x, y), axis=1).min())
        outside = not is_inside(px, np.array([x, y]))
        if outside:
            assert out[0] == pytest.approx(nearest, abs=0.05)
            assert np.hypot(out[1], out[2]) == pytest.approx(1.0)
        else:
            # Inside, the nearest line, which may lie beyond its edge.
            assert -nearest - 0.05 < out[0] <= 0.0


@pytest.mark.parametrize("rounded", [True, False], ids=["rounded", "sharp"])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_face_seen_edge_on_shows_a_sliver_to_a_rolling_shutter(shape: str, rounded: bool) -> None:
    """Rows that are exposed one after the other bend it, so that two of its sides may cross."""
    room = replace(studio(), readout_s=READOUT_S)
    view, rng = room.view(DICE[shape]), np.random.default_rng(3)
    view = with_corner_radius(view, RADIUS_SHARE * view.die.solid.inradius) if rounded else view
    work, position = new_workspace(view.shape, view.rig), np.array([0.001, -0.002, 0.02])
    toward = view.camera.rotation.T @ -view.camera.translation_m - position
    toward /= np.linalg.norm(toward)
    away = np.linalg.norm(view.camera.translation_m)
    for _ in range(300):
        across = np.cross(toward, rng.normal(size=3))
        across /= np.linalg.norm(across)
        # The camera lies this little above the plane of the face.
        above = rng.uniform(0.0, EDGE_ON_RAD) + view.die.solid.offsets[0] / away
        R = onto(view.die.solid.normals[0], across + above * toward, rng.uniform(0.0, 2.0 * np.pi))
        pose = pose_state(position, R, np.zeros(3), SPIN_RAD_S * rng.normal(size=3))
        px = view.camera.project(position[None])[0] + rng.uniform(-45.0, 45.0, (400, 2))
        assert shows_face(view.shape, view.rig, pose, np.int64(0), px, rounded, work) < 0.05 * len(px)


def onto(body: Array, world: Array, turned_rad: float) -> Array:
    """(3, 3) a rotation that takes a direction of the body to one of the world, turned about that."""
    frames = []
    for direction in (body, world):
        first = direction / np.linalg.norm(direction)
        second = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
        second /= np.linalg.norm(second)
        frames.append(np.column_stack([first, second, np.cross(first, second)]))
    c, s = np.cos(turned_rad), np.sin(turned_rad)
    return np.asarray(frames[1] @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ frames[0].T)


def outline_points(px: Array) -> Array:
    """(n, 2) points of the convex hull of corners, closely spaced."""
    hull = convex_hull(px)
    t = np.linspace(0.0, 1.0, 400)[:, None]
    return np.concatenate([a + t * (b - a) for a, b in zip(hull, np.roll(hull, -1, axis=0), strict=True)])


def convex_hull(px: Array) -> Array:
    """(k, 2) corners of the hull in order: gift wrapping."""
    at = int(np.argmin(px[:, 0]))
    hull = [at]
    while True:
        following = next(k for k in range(len(px)) if k != hull[-1])
        for k in range(len(px)):
            a, b = px[following] - px[hull[-1]], px[k] - px[hull[-1]]
            if a[0] * b[1] - a[1] * b[0] < 0.0:
                following = k
        if following == hull[0]:
            return px[hull]
        hull.append(following)


def is_inside(px: Array, point: Array) -> bool:
    hull = convex_hull(px)
    a, b = hull, np.roll(hull, -1, axis=0)
    cross = (b[:, 0] - a[:, 0]) * (point[1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (point[0] - a[:, 0])
    return bool((cross >= 0.0).all() or (cross <= 0.0).all())
