"""Laws of poses that are compared on the same pixels: a pose gains nothing by leaving out what it does not explain."""

from __future__ import annotations

from dataclasses import replace

import footage_of_throws
import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from numpy.typing import NDArray

from diethrow.model.rotations import quat_from_matrix
from diethrow.model.throw.motion import State
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.refine import pose_state, refine_pose
from diethrow.tracking.pose.same_pixels import excess_on_same_pixels

Array = NDArray[np.float64]
CUBE = DICE["cube"]
PLACE_M = np.array([0.0, 0.0, 0.018])
BRIGHT, DARK = 180.0, 45.0
"""Grey levels of the two faces that are seen; the table has 75."""
TILT_RAD = np.radians(35.0)
SHADOW_PX = 25.0


def tilted(view: View, tilt_rad: float) -> Array:
    """(3, 3) rotation of a cube that turns a face to the camera, tilted so that another one shows beside it."""
    c, s = np.cos(tilt_rad), np.sin(tilt_rad)
    return np.asarray(view.camera.rotation.T @ np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]))


def two_poses(monkeypatch: pytest.MonkeyPatch) -> tuple[View, NDArray[np.float32], list[ClipPoses]]:
    """A picture of a cube with a bright face and a dark one above its soft shadow, the cube's pose, and that of a cube whose
    bright face is tilted the other way: it leaves the dark one out, and has another where the table is seen."""
    room = studio()
    room = replace(room, noise_grey=1.5, table=np.full_like(room.table, 75.0))
    view = room.view(CUBE)
    rotations = [tilted(view, sign * TILT_RAD) for sign in (-1.0, 1.0)]
    bright = int(np.argmin(CUBE.solid.normals @ rotations[0].T @ view.camera.rotation[2]))
    middle_m = PLACE_M + CUBE.solid.inradius * rotations[0] @ CUBE.solid.normals[bright]
    places = [middle_m - CUBE.solid.inradius * rotation @ CUBE.solid.normals[bright] for rotation in rotations]
    monkeypatch.setattr(footage_of_throws, "greys", lambda die, turned: np.where(np.arange(6) == bright, BRIGHT, DARK))
    away_px = view.camera.project(PLACE_M + CUBE.solid.edge_m * view.camera.rotation[1])
    v, u = np.mgrid[: view.camera.height_px, : view.camera.width_px]
    shade = 1.0 - 0.5 * np.exp(-0.5 * ((u - away_px[0]) ** 2 + (v - away_px[1]) ** 2) / SHADOW_PX**2)
    shaded = replace(room, table=np.asarray(room.table * shade, np.float32))
    state = State(0.0, PLACE_M, quat_from_matrix(rotations[0]), np.zeros(3), np.zeros(3))
    picture = np.rint(photograph(shaded, CUBE, state, np.random.default_rng(3)))
    poses = []
    for place, rotation in zip(places, rotations, strict=True):
        one = ClipPoses.empty(1)
        one.put(0, refine_pose(view, picture, pose_state(place, rotation)), np.zeros(6))
        poses.append(one)
    return view, picture, poses


def test_a_pose_that_leaves_out_a_dark_face_beside_a_shadow_costs_more_on_the_same_pixels(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    view, picture, (right, wrong) = two_poses(monkeypatch)
    excess = excess_on_same_pixels(view, picture, (right, wrong), 0)
    # On its own pixels the wrong one costs hardly more: more of its contour shows no step, and less of its region is shadow.
    assert wrong.cost[0] - right.cost[0] < 0.2
    assert wrong.cost[0] + excess[1] - right.cost[0] - excess[0] > 0.8
    np.testing.assert_array_equal(excess_on_same_pixels(view, picture, (wrong, right), 0), excess[::-1])


def test_a_pose_alone_and_one_beside_itself_keep_their_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """But for the pixels that the region is sampled on."""
    view, picture, (right, _) = two_poses(monkeypatch)
    assert excess_on_same_pixels(view, picture, (right,), 0) == 0.0
    assert np.abs(excess_on_same_pixels(view, picture, (right, right), 0)).max() < 0.1
