"""Laws of a view and of the region cost: which faces are visible, and that the true pose costs least."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, still, studio
from random_throws import random_quaternion
from rounded_dice import photograph_rounded

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


@pytest.mark.parametrize("radius_share", [0.1, 0.3, 0.5])
def test_the_true_pose_of_a_rounded_cube_has_the_lowest_region_cost(radius_share: float) -> None:
    """Nearer and farther ones included, of which a larger die sees more of the quiet table."""
    cube = DICE["cube"]
    rng, die = np.random.default_rng(21), replace(cube, corner_radius_m=radius_share * cube.solid.inradius)
    room, position = replace(ROOM, noise_grey=2.0), np.array([0.0, 0.0, 0.018])
    toward = (ROOM.camera.centre_m - position) / np.linalg.norm(ROOM.camera.centre_m - position)
    axes = np.vstack([np.eye(3), -np.eye(3)])
    for _ in range(4):
        state = State(0.0, position, random_quaternion(rng), np.zeros(3), np.zeros(3))
        view, image = room.view(die), photograph_rounded(room, die, state, rng)
        turned = [matrix_from_quat(quat_from_rotvec(0.15 * axis)) @ state.rotation for axis in axes]
        along = [position + share * 0.4 * toward for share in (-0.04, -0.02, 0.02, 0.04)]
        box = outline_box(view, position, state.rotation, 12.0)
        assert box is not None
        positions, rotations = (
            np.array([position] * 7 + along),
            np.array([state.rotation, *turned, *[state.rotation] * 4]),
        )
        costs, _ = region_costs(view, image, box, positions, rotations, 100_000)
        assert (costs[1:] > costs[0]).all()


def test_poses_are_compared_on_the_same_pixels() -> None:
    """Whatever box is looked at, one pose costs so much more than another, in all."""
    rng, state = np.random.default_rng(3), still(np.random.default_rng(3))
    view, image = ROOM.view(DICE["cube"]), photograph(ROOM, DICE["cube"], state, rng)
    other = state.rotation @ matrix_from_quat(quat_from_rotvec(np.array([0.1, -0.2, 0.1])))
    sums = []
    for margin_px in (8.0, 20.0):
        box = outline_box(view, state.position_m, state.rotation, margin_px)
        assert box is not None
        positions, rotations = np.array([state.position_m] * 2), np.array([state.rotation, other])
        costs, _ = region_costs(view, image, box, positions, rotations, 1_000_000)
        sums.append((costs[1] - costs[0]) * (box[2] - box[0]) * (box[3] - box[1]))
    assert sums[1] == pytest.approx(sums[0], rel=1e-9)


def test_a_cube_seen_from_its_corner_shows_three_faces() -> None:
    view = ROOM.view(DICE["cube"])
    toward = ROOM.camera.centre_m / np.linalg.norm(ROOM.camera.centre_m)
    corner = DICE["cube"].solid.vertices[7] / np.linalg.norm(DICE["cube"].solid.vertices[7])
    axis = np.cross(corner, toward)
    angle = np.arctan2(np.linalg.norm(axis), corner @ toward)
    rotation = matrix_from_quat(quat_from_rotvec(angle * axis / np.linalg.norm(axis)))
    assert len(visible_faces(view, np.zeros(3), rotation)) == 3
