"""Laws of the motion between frames: what it says of a pose, and where a flight may end."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, film, studio
from random_throws import random_quaternion
from scipy.spatial.transform import Rotation

from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec
from diethrow.model.throw import Flight, State, Throw
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.frame_to_frame.acceptance import NEW_FLIGHT_RAD, PRIOR_SIGMAS
from diethrow.tracking.frame_to_frame.frame_tracker import FrameTracker
from diethrow.tracking.frame_to_frame.motion_filter import lowest_m, motion_prior
from diethrow.tracking.picture.view import View, with_corner_radius
from diethrow.tracking.pose.candidate_poses import velocity_across_m_s
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.refine import Pose, pose_state, refine_pose
from diethrow.tracking.pose.refine_kernels import seen_distance_m
from diethrow.tracking.sequence import initialisation
from diethrow.tracking.sequence.initialisation import find_initial_pose

ROOM = studio()
CUBE = DICE["cube"]


def test_the_prior_of_a_pose_is_the_predicted_covariance_with_what_distance_and_tilt_share() -> None:
    settings, rng = ROOM.view(CUBE).settings, np.random.default_rng(1)
    scale = np.repeat([0.3 * settings.loose_m, 0.3 * settings.loose_rad], 3) / PRIOR_SIGMAS
    P = np.zeros((12, 12))
    factor = rng.standard_normal((6, 6)) / np.sqrt(6.0)
    P[:6, :6] = factor @ factor.T * np.outer(scale, scale)
    floor = np.diag(np.repeat([settings.tight_m, settings.tight_rad], 3) ** 2)
    cap = np.diag(1.0 / np.repeat([settings.loose_m, settings.loose_rad], 3) ** 2)
    wanted = np.linalg.inv(PRIOR_SIGMAS**2 * P[:6, :6] + floor) + cap
    np.testing.assert_allclose(motion_prior(P, settings), wanted, rtol=1e-8, atol=1e-8 * np.abs(wanted).max())


def test_an_unknown_motion_leaves_the_loose_prior_and_a_rounded_off_one_a_prior_as_well() -> None:
    settings = ROOM.view(CUBE).settings
    cap = 1.0 / np.repeat([settings.loose_m, settings.loose_rad], 3) ** 2
    np.testing.assert_allclose(np.diag(motion_prior(1e6 * np.eye(12), settings)), cap, rtol=1e-3)
    # Variances predicted back to where they were known may come out below zero.
    np.testing.assert_allclose(motion_prior(-np.eye(12), settings), np.diag(cap))


@pytest.mark.parametrize("radius_share", [0.0, 0.3])
def test_the_lowest_point_is_that_of_the_rounded_body(radius_share: float) -> None:
    view = with_corner_radius(ROOM.view(CUBE), radius_share * CUBE.solid.inradius)
    rng, r = np.random.default_rng(2), radius_share * CUBE.solid.inradius
    for _ in range(20):
        R, p = matrix_from_quat(random_quaternion(rng)), rng.normal(size=3)
        inner = (1.0 - radius_share) * CUBE.solid.vertices @ R.T
        assert lowest_m(view.shape, p, R) == pytest.approx(p[2] + inner[:, 2].min() - r, abs=1e-12)


def test_a_step_counts_as_the_camera_sees_it() -> None:
    view, reach = ROOM.view(CUBE), CUBE.solid.circumradius
    rng, at = np.random.default_rng(3), np.array([0.0, 0.0, 0.018])
    sight = at - ROOM.camera.centre_m
    depth = np.linalg.norm(sight)
    for _ in range(10):
        across = np.cross(sight / depth, rng.normal(size=3))
        assert seen_distance_m(view.rig, at, 1e-3 * across, reach) == pytest.approx(
            1e-3 * np.linalg.norm(across), rel=0.01
        )
    # Along the line of sight it changes the size of the outline.
    assert seen_distance_m(view.rig, at, 1e-3 * sight / depth, reach) == pytest.approx(1e-3 * reach / depth, rel=0.03)


def tracker_at(height_m: float) -> tuple[FrameTracker, Pose, State]:
    """A tracker that knows the motion of a still cube from ten poses, and a pose twice as far from it as ends a flight."""
    room = replace(ROOM, noise_grey=1.0)
    state = State(0.0, np.array([0.0, 0.0, height_m]), np.array([0.9, 0.1, 0.3, 0.2]) / np.linalg.norm([0.9, 0.1, 0.3, 0.2]),
                  np.zeros(3), np.zeros(3))  # fmt: skip
    clip = film(room, CUBE, Throw((Flight(state, np.inf),), ()), 2)
    view = room.view(CUBE)
    pose = refine_pose(view, np.asarray(clip.frame(0), np.float32), pose_state(state.position_m, state.rotation))
    tracker = FrameTracker.from_pose(view, pose, np.arange(3) / FPS, 0, np.zeros(3, bool))
    tracker.clock[2], tracker.P = 10.0, 1e-8 * np.eye(12)
    turned = matrix_from_quat(quat_from_rotvec(np.array([0.0, 0.0, 2.0 * NEW_FLIGHT_RAD]))) @ pose.rotation
    return tracker, replace(pose, rotation=turned), state


@pytest.mark.parametrize(("height_m", "ends"), [(0.06, False), (0.012, True)])
def test_a_flight_ends_only_where_the_table_is_near(height_m: float, ends: bool) -> None:
    tracker, pose, state = tracker_at(height_m)
    predicted, R = tracker.motion.copy(), tracker.rotation.copy()
    tracker._update(pose, state, predicted, R, tracker.P.copy(), 1.0 / FPS, 1.0 / FPS)
    assert tracker.clock[2] == (1.0 if ends else 11.0)


@pytest.mark.parametrize("seed", [0, 1, 4])
def test_a_face_seen_alone_may_be_inclined_as_its_picture_does_not_show(seed: int) -> None:
    """A tetrahedron near the table that turns one face to the camera, 31 pixels an edge: its inclination is known to some
    degrees, which is no impact. Each flight begun by mistake forgets the motion, and the die slides into another triangle."""
    room, die, frames = replace(studio(focal_px=700.0), noise_grey=6.0), DICE["tetrahedron"], 40
    position = np.array([0.0, 0.0, 0.012])
    toward = room.camera.centre_m - position
    toward /= np.linalg.norm(toward)
    aside = np.cross(toward, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    to_camera, _ = Rotation.align_vectors(
        [np.cos(0.25) * toward + np.sin(0.25) * aside, np.cross(toward, aside)],
        [die.solid.normals[0], die.solid.vertices[die.solid.faces[0][0]]],
        weights=[np.inf, 1.0],
    )
    spin = 25.0 * toward + 10.0 * np.cross(toward, aside)
    start = State(0.0, position, quat_from_matrix(to_camera.as_matrix()), np.array([0.05, 0.0, 0.12]), spin)
    throw = Throw((Flight(start, np.inf),), ())
    view, source = room.view(die), FrameSource([film(room, die, throw, frames, seed=seed)])
    first = pose_state(position, start.rotation, start.velocity_m_s, spin)
    pose = refine_pose(view, np.asarray(source.frame(0), np.float32), first, coarse=0)
    rates = np.concatenate([start.velocity_m_s, spin])
    tracker = FrameTracker.from_pose(view, pose, source.times_s, 0, np.zeros(frames, bool), rates)
    tracker.searches = True
    poses = ClipPoses.empty(frames)
    poses.put(0, pose, rates)
    tracker.track_to_end(source, poses, lambda frame: None, all_frames=True)
    assert poses.known.all()
    assert not poses.begins.any()


def far_moving() -> tuple[View, FrameSource, Throw]:
    """A cube that crosses the picture by more than its own radius from frame to frame: a fall filmed by a telephone."""
    room = replace(studio(440, 300), noise_grey=2.0, exposure_s=1e-3)
    right, fps = room.camera.rotation[0], 120.0
    position, velocity = np.array([0.0, 0.0, 0.018]) - 0.035 * right, 1.35 * right + np.array([0.0, 0.0, 0.25])
    start = State(0.0, position, random_quaternion(np.random.default_rng(4)), velocity, np.array([3.0, -2.0, 4.0]))
    throw = Throw((Flight(start, np.inf),), ())
    source = FrameSource([film(room, CUBE, throw, 7, fps=fps)])
    return room.view(CUBE), source, throw


def begun_right(view: View, source: FrameSource, throw: Throw) -> bool:
    begun = find_initial_pose(view, source, np.zeros(len(source), bool))
    if begun is None:
        return False
    known = np.flatnonzero(begun[1].known)
    position = throw.poses(source.times_s[known])[0]
    return len(known) == len(source) and bool(
        np.linalg.norm(begun[1].position_m[known] - position, axis=1).max() < 1e-3
    )


def test_a_die_that_moves_by_its_radius_between_frames_is_followed(monkeypatch: pytest.MonkeyPatch) -> None:
    view, source, throw = far_moving()
    assert begun_right(view, source, throw)
    monkeypatch.setattr(initialisation, "_rate_px_s", lambda *_: np.zeros(2))
    assert not begun_right(view, source, throw)


def test_the_velocity_of_a_region_is_that_of_the_die_in_it() -> None:
    view, source, throw = far_moving()
    state = throw.at(float(source.times_s[3]))
    pose = refine_pose(view, np.asarray(source.frame(3), np.float32), pose_state(state.position_m, state.rotation))
    rate = initialisation._rate_px_s(view, source, 3, np.zeros(len(source), bool))
    across = velocity_across_m_s(view, pose.position_m, rate)
    true = throw.rates(source.times_s[3:4])[0, :3]
    ahead = view.camera.rotation[2]
    assert np.linalg.norm(across - (true - (true @ ahead) * ahead)) < 0.1 * np.linalg.norm(true)
