"""Laws of a view and of the region cost: which faces are visible, and that the true pose costs least."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from random_throws import random_quaternion
from scipy.spatial import ConvexHull

from diethrow.model.die.solid import SHAPES, inner_vertices
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw.motion import State
from diethrow.tracking.picture.pose_costs import region_costs
from diethrow.tracking.picture.region_cost import SQUARED_SIGMAS_CUT
from diethrow.tracking.picture.view import outline_box, visible_faces

ROOM = studio()


@pytest.mark.parametrize("shape", SHAPES)
def test_the_true_pose_has_the_lowest_region_cost(shape: str) -> None:
    rng = np.random.default_rng(13)
    room = replace(ROOM, noise_grey=2.0)
    position = np.array([0.0, 0.0, 0.018]) + rng.uniform(-0.003, 0.003, 3)
    state = State(0.0, position, random_quaternion(rng), np.zeros(3), np.zeros(3))
    view = room.view(DICE[shape])
    image = photograph(room, DICE[shape], state, rng)
    box = outline_box(view, state.position_m, state.rotation, 8.0)
    assert box is not None
    axes = np.vstack([np.eye(3), -np.eye(3)])
    turned = [matrix_from_quat(quat_from_rotvec(0.12 * axis)) @ state.rotation for axis in axes]
    aside = [state.position_m + 1e-3 * a for a in np.vstack([ROOM.camera.rotation[:2], -ROOM.camera.rotation[:2]])]
    positions = np.array([state.position_m] * 7 + aside)
    rotations = np.array([state.rotation, *turned, *[state.rotation] * 4])
    costs, differs = region_costs(view, image, box, positions, rotations, 100_000)
    assert differs[0] > 0.9
    assert (costs[1:] > costs[0]).all()


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("share", [0.3, 0.8])
def test_the_region_of_a_rounded_die_is_all_that_its_balls_cover(shape: str, share: float) -> None:
    rng = np.random.default_rng(5)
    die = replace(DICE[shape], corner_radius_m=share * DICE[shape].solid.inradius)
    view, position, rotation = ROOM.view(die), np.array([0.0, 0.0, 0.018]), matrix_from_quat(random_quaternion(rng))
    # A picture of one grey fits any face, and nowhere the table: every pixel outside costs as much as one can.
    bright = np.full(ROOM.table.shape, ROOM.table.max() + 1e3 * view.noise_grey, np.float32)
    box = (0, 0, ROOM.camera.width_px, ROOM.camera.height_px)
    (cost,), _ = region_costs(view, bright, box, position[None], rotation[None], 1_000_000)
    area_px = (1.0 - cost / SQUARED_SIGMAS_CUT) * bright.size
    angle = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    sight = (position - ROOM.camera.centre_m) / np.linalg.norm(position - ROOM.camera.centre_m)
    circle = die.corner_radius_m * np.array([np.cos(angle), np.sin(angle)]).T @ np.linalg.svd(sight[None])[2][1:]
    corners = position + inner_vertices(die.solid, die.corner_radius_m) @ rotation.T
    outline = ConvexHull(ROOM.camera.project((corners[:, None] + circle).reshape(-1, 3)))
    # Of some 5000 pixels those on the border count whole or not at all; and so far from the axis a ball is drawn as an ellipse.
    assert area_px == pytest.approx(outline.volume, rel=0.01)


def test_a_cube_seen_from_its_corner_shows_three_faces() -> None:
    view = ROOM.view(DICE["cube"])
    toward = ROOM.camera.centre_m / np.linalg.norm(ROOM.camera.centre_m)
    corner = DICE["cube"].solid.vertices[7] / np.linalg.norm(DICE["cube"].solid.vertices[7])
    axis = np.cross(corner, toward)
    angle = np.arctan2(np.linalg.norm(axis), corner @ toward)
    rotation = matrix_from_quat(quat_from_rotvec(angle * axis / np.linalg.norm(axis)))
    assert len(visible_faces(view, np.zeros(3), rotation)) == 3
