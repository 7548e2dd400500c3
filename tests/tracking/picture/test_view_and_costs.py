"""Laws of a view and of the region cost: which faces are visible, and that the true pose costs least."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from random_throws import random_quaternion

from diethrow.model.die.solid import SHAPES
from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw.motion import State
from diethrow.tracking.picture.pose_costs import region_costs
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


def test_a_cube_seen_from_its_corner_shows_three_faces() -> None:
    view = ROOM.view(DICE["cube"])
    toward = ROOM.camera.centre_m / np.linalg.norm(ROOM.camera.centre_m)
    corner = DICE["cube"].solid.vertices[7] / np.linalg.norm(DICE["cube"].solid.vertices[7])
    axis = np.cross(corner, toward)
    angle = np.arctan2(np.linalg.norm(axis), corner @ toward)
    rotation = matrix_from_quat(quat_from_rotvec(angle * axis / np.linalg.norm(axis)))
    assert len(visible_faces(view, np.zeros(3), rotation)) == 3
