"""Laws of refinement on edges: an undetermined direction has a large covariance, and the frame is not lost."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, film, studio
from numpy.typing import NDArray

from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotation_between
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.clip_parameters.clock_offsets import ClockOffsets
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.refine import covariances
from diethrow.tracking.sequence import refine_on_edges
from diethrow.tracking.sequence.refine_on_edges import EdgeRefinement

Array = NDArray[np.float64]

FRAMES = 6


def basis(first: Array, near: Array) -> Array:
    """(3, 3) right-handed, with this direction first and the second towards another."""
    a = first / np.linalg.norm(first)
    b = near - a * (a @ near)
    b /= np.linalg.norm(b)
    return np.column_stack([a, b, np.cross(a, b)])


@pytest.mark.parametrize("slope", [0.0, 0.02])
def test_a_tetrahedron_with_a_face_edge_on_is_not_lost(slope: float) -> None:
    room, die = replace(studio(), noise_grey=1.0), DICE["tetrahedron"]
    position = np.array([0.0, 0.0, 0.03])
    toward, normals = room.camera.centre_m - position, die.solid.normals
    sine = die.solid.inradius / np.linalg.norm(toward) + slope
    front = normals[0] - normals[1] * (normals[0] @ normals[1])
    eye = front / np.linalg.norm(front) * np.sqrt(1.0 - sine**2) + normals[1] * sine
    rotation = basis(toward, np.array([0.3, 0.1, 1.0])) @ basis(eye, normals[2] - normals[3]).T
    flight = Flight(State(0.0, position, quat_from_matrix(rotation), np.array([0.05, 0.0, -0.1]), np.zeros(3)), np.inf)
    clip, view, first = film(room, die, flight, FRAMES), room.view(die), ClipPoses.empty(FRAMES)
    truth = [flight.at(float(t)) for t in clip.times_s]
    for k, state in enumerate(truth):
        first.position_m[k], first.rotation[k], first.motion[k, :3] = (
            state.position_m,
            state.rotation,
            state.velocity_m_s,
        )
    first.known[:] = True
    refinement = EdgeRefinement(view, FrameSource([clip]), first, None, np.ones(FRAMES, bool), ClockOffsets.none(1))
    refined = refinement.refine(np.ones(FRAMES, bool), lambda _: None)
    assert refined.known.all()
    found = covariances(refined.H[:, :6, :6])
    for k, state in enumerate(truth):
        rotated = rotation_between(state.quaternion, quat_from_matrix(refined.rotation[k]))
        errors = np.concatenate([refined.position_m[k] - state.position_m, rotated])
        assert errors @ np.linalg.solve(found[k], errors) < 22.5  # once in a thousand
        # Two lines of its contour, and that is all: some turn is open, at the least as far as the prior of 0.1 rad leaves it.
        assert np.sqrt(np.linalg.eigvalsh(found[k][3:, 3:])[-1]) > 0.09


def test_a_flight_is_not_followed_into_the_table() -> None:
    """The camera shows a die there all the same."""
    room, die = replace(studio(), noise_grey=1.0), DICE["cube"]
    turned = quat_from_rotvec(np.array([0.2, 0.3, 0.1]))
    rise = np.array([0.0, 0.0, 0.2 * die.solid.edge_m * FPS])
    flight = Flight(State(0.0, np.zeros(3), turned, rise, np.zeros(3)), np.inf)
    clip, view, tracked = film(room, die, flight, FRAMES), room.view(die), ClipPoses.empty(FRAMES)
    for k, time_s in enumerate(clip.times_s):
        state = flight.at(float(time_s))
        tracked.position_m[k], tracked.rotation[k], tracked.motion[k, :3] = (
            state.position_m,
            state.rotation,
            state.velocity_m_s,
        )
    every = np.ones(FRAMES, bool)
    for first in (0, 3):
        tracked.known[:] = np.arange(FRAMES) >= first
        refinement = EdgeRefinement(
            view, FrameSource([clip]), tracked, Throw((flight,), ()), every, ClockOffsets.none(1)
        )
        refined = refinement.refine(every, lambda _: None)
        assert refined.known[2:].all()
        assert refined.known[0] == (first == 0)


def test_poses_of_a_rounded_die_are_the_same_with_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    room, die = replace(studio(), noise_grey=2.0), DICE["cube"].with_corner_radius(0.002)
    start = State(
        0.0, np.array([0.0, 0.0, 0.03]), quat_from_rotvec(np.array([0.5, 0.3, 0.1])), np.zeros(3), 20.0 * np.ones(3)
    )
    throw = Throw((Flight(start, np.inf),), ())
    clip, view, tracked = film(room, die, throw, FRAMES), room.view(die), ClipPoses.empty(FRAMES)
    assert view.shows_surface(start.position_m)
    position, quaternion = throw.poses(clip.times_s)
    tracked.position_m[:], tracked.rotation[:] = position, matrix_from_quat(quaternion)
    tracked.motion[:], tracked.known[:] = throw.rates(clip.times_s), True
    every, found = np.ones(FRAMES, bool), []
    for threads in (1, 2):
        monkeypatch.setattr(refine_on_edges, "THREADS", threads)
        refinement = EdgeRefinement(view, FrameSource([clip]), tracked, throw, every, ClockOffsets.none(1))
        found.append(refinement.refine(every, lambda _: None))
    np.testing.assert_array_equal(found[0].position_m, found[1].position_m)
