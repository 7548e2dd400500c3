"""Laws of several views of one die: cameras and mirrors add information, and covariances show how much."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, ArrayClip, Studio, film, photograph, pips, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from throws import later

from diethrow.model.die.symmetry import symmetry_rotations
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import matrix_from_quat, quat_from_matrix, quat_from_rotvec, rotvec_from_quat
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.camera import Camera
from diethrow.tracking.clip_parameters.clock_offsets import rig_at
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import MIRRORED, View, make_view, stack_pictures, with_reflections
from diethrow.tracking.pose.refine import Pose, pose_state, refine_pose
from diethrow.tracking.quality import FAST, STANDARD
from diethrow.tracking.sequence.tracker import track_clip
from diethrow.tracking.surface_marks.face_numbers import read_faces

Array = NDArray[np.float64]
Image = NDArray[np.float32]

CUBE = DICE["cube"]
ROOM = replace(studio(), noise_grey=3.0)
CASES = 24


def from_the_side(room: Studio) -> Studio:
    """The same table seen after a quarter turn of the camera about the vertical."""
    turn = matrix_from_quat(quat_from_rotvec(np.array([0.0, 0.0, np.pi / 2])))
    camera = room.camera
    return replace(room, camera=replace(camera, rotation=camera.rotation @ turn))


def in_a_mirror(room: Studio, state: State, rng: np.random.Generator) -> Image:
    """A frame on a table that reflects: the mirrored die drawn first, the die over it, and the noise last."""
    mirrored = replace(room.camera, rotation=room.camera.rotation @ MIRRORED)
    below = photograph(replace(room, camera=mirrored, noise_grey=0.0), CUBE, state)
    picture = photograph(replace(room, table=below, noise_grey=0.0), CUBE, state)
    return np.asarray(picture + rng.normal(scale=room.noise_grey, size=picture.shape), np.float32)


def state_at(rng: np.random.Generator, height_m: float) -> State:
    return State(0.0, np.array([0.0, 0.0, height_m]), random_quaternion(rng), np.zeros(3), np.zeros(3))


def found(view: View, image: Image, state: State) -> Pose:
    start = matrix_from_quat(quat_from_rotvec([0.02, -0.02, 0.02])) @ state.rotation
    return refine_pose(view, image, pose_state(state.position_m + np.array([4e-4, -4e-4, 8e-4]), start), coarse=3)


def judged(view: View, states: list[State], images: list[Image]) -> tuple[Array, Array]:
    """NEES, and the sigma of the position in its least known direction [m], of frames with a covariance."""
    nees, worst = [], []
    for state, image in zip(states, images, strict=True):
        pose = found(view, image, state)
        covariance = pose.covariance
        if covariance is None:
            continue
        rotated = rotvec_from_quat(quat_from_matrix(state.rotation @ pose.rotation.T))
        errors = np.concatenate([state.position_m - pose.position_m, rotated])
        nees.append(errors @ np.linalg.solve(covariance, errors))
        worst.append(np.sqrt(np.linalg.eigvalsh(covariance[:3, :3])[-1]))
    return np.array(nees), np.array(worst)


def view_of(cameras: list[Camera], tables: list[Image], *, mirror: bool = False) -> View:
    return make_view(cameras, CUBE, tables, PixelNoise(ROOM.noise_grey), None, ROOM.blur_px, mirror=mirror)


def test_a_second_camera_gives_the_depth_that_the_first_lacks() -> None:
    rng, side = np.random.default_rng(1), from_the_side(ROOM)
    states = [state_at(rng, 0.018) for _ in range(CASES)]
    images = [[photograph(room, CUBE, state, rng) for room in (ROOM, side)] for state in states]
    alone = judged(view_of([ROOM.camera], [ROOM.table]), states, [pair[0] for pair in images])
    both = view_of([ROOM.camera, side.camera], [ROOM.table, side.table])
    together = judged(both, states, [stack_pictures(pair) for pair in images])
    # Depth is ten to thirty times worse known than what lies across the picture; the other camera sees it from the side.
    assert np.median(together[1]) < 0.2 * np.median(alone[1])
    # The median of chi-square with six numbers is 5.35, with a standard deviation of 0.8 over 24 frames.
    assert 3.0 < np.median(together[0]) < 8.5


def test_a_reflection_is_a_second_view_and_does_not_disturb_the_first() -> None:
    rng = np.random.default_rng(2)
    states = [state_at(rng, 0.022) for _ in range(CASES)]
    images = [in_a_mirror(ROOM, state, rng) for state in states]
    watched = view_of([ROOM.camera], [ROOM.table], mirror=True)
    alone, together = judged(watched, states, images), judged(with_reflections(watched), states, images)
    assert 3.0 < np.median(alone[0]) < 8.5
    assert 3.0 < np.median(together[0]) < 8.5
    # The mirrored camera looks up from below at 70 degrees to the other.
    assert np.median(together[1]) < 0.4 * np.median(alone[1])


@pytest.fixture(scope="module")
def crossing() -> Throw:
    """A cube that crosses the pictures of both cameras and touches nothing."""
    start = State(0.0, np.array([0.0, 0.0, 0.012]), random_quaternion(np.random.default_rng(5)),
                  np.array([0.1, 0.1, 0.25]), np.array([9.0, 25.0, 3.0]))  # fmt: skip
    return Throw((Flight(start, 40 / 1500.0),), ())


def test_two_synchronised_clips_make_one_track(crossing: Throw) -> None:
    room, side = (replace(r, noise_grey=2.0) for r in (ROOM, from_the_side(ROOM)))
    clips = [film(r, CUBE, crossing, 40, seed=k) for k, r in enumerate((room, side))]
    track = track_clip(clips, [room.camera, side.camera], CUBE, background=[room.table, side.table]).track
    assert track.tracked.all()
    off = np.linalg.norm(track.position_m - crossing.poses(track.time_s)[0], axis=1)
    # Across each picture a frame is good to 3 µm, and one camera's depth is the other's across.
    assert np.median(off) < 2e-5


def test_a_fast_track_is_a_less_accurate_one_of_the_same_throw(crossing: Throw) -> None:
    clip = film(replace(ROOM, noise_grey=2.0), CUBE, crossing, 40, seed=3)
    fast, standard = (
        track_clip(clip, ROOM.camera, CUBE, background=ROOM.table, quality=quality).track
        for quality in (FAST, STANDARD)
    )
    across = ROOM.camera.rotation[:2]
    for track, allowed_m in ((fast, 2e-5), (standard, 1e-5)):
        assert track.tracked.all()
        off = (track.position_m - crossing.poses(track.time_s)[0]) @ across.T
        assert np.median(np.linalg.norm(off, axis=1)) < allowed_m


def bouncing_cube() -> Throw:
    """A cube that falls, bounces and rises within both pictures."""
    release = State(0.0, np.array([0.0, 0.0, 0.022]), random_quaternion(np.random.default_rng(8)),
                    np.array([0.08, 0.05, -0.45]), np.array([12.0, -25.0, 9.0]))  # fmt: skip
    return throw_die(CUBE, release, SmoothImpact(0.6), until=Until(time_s=50 / 1500.0)).throw


def test_a_clock_offset_is_estimated_and_corrected() -> None:
    throw, late_s = bouncing_cube(), 0.3 / 1500.0
    room, side = (replace(r, noise_grey=2.0) for r in (ROOM, from_the_side(ROOM)))
    clips = [film(room, CUBE, throw, 48, seed=1), film(side, CUBE, later(throw, -late_s), 48, seed=2)]
    found = track_clip(clips, [room.camera, side.camera], CUBE, background=[room.table, side.table])
    offsets, track = found.offsets, found.track
    assert abs(offsets.seconds[1] - late_s) < 4.0 * offsets.sigma_s[1] < 0.1 / 1500.0
    assert "camera 2" in offsets.notices(1 / 1500.0)[0]
    assert "later" in offsets.notices(1 / 1500.0)[0]
    away = np.abs(track.time_s[:, None] - [i.time_s for i in throw.impacts]).min(1) > 1.5 / 1500.0
    off = np.linalg.norm(track.position_m - throw.poses(track.time_s)[0], axis=1)[away & track.tracked]
    # At 0.4 m/s a third of a frame is 0.1 mm; as two synchronised clips above.
    assert np.median(off) < 2e-5


def test_synchronised_cameras_show_no_offset() -> None:
    throw = bouncing_cube()
    room, side = (replace(r, noise_grey=2.0) for r in (ROOM, from_the_side(ROOM)))
    clips = [film(r, CUBE, throw, 48, seed=k) for k, r in enumerate((room, side))]
    offsets = track_clip(clips, [room.camera, side.camera], CUBE, background=[room.table, side.table]).offsets
    assert not offsets.any
    assert offsets.notices(1 / 1500.0) == ()
    assert offsets.sigma_s[1] < 0.05 / 1500.0


def test_a_camera_with_a_clock_offset_is_a_synchronised_one_in_another_place() -> None:
    rng = np.random.default_rng(4)
    state = replace(state_at(rng, 0.02), velocity_m_s=rng.normal(size=3), omega_rad_s=30.0 * rng.normal(size=3))
    rig = view_of([ROOM.camera, from_the_side(ROOM).camera], [ROOM.table] * 2, mirror=True).rig
    late_s = np.array([0.0, 2e-4])
    moved = rig_at(rig, late_s, state.position_m, np.concatenate([state.velocity_m_s, state.omega_rad_s]))
    for e in range(len(rig.camera)):
        then = Flight(state, np.inf).at(late_s[rig.camera[e]])
        truly = (
            rig.rotation[e] @ (CUBE.solid.vertices @ then.rotation.T + then.position_m).T + rig.translation[e][:, None]
        )
        now = CUBE.solid.vertices @ state.rotation.T + state.position_m
        # Gravity over the offset is left out: g δ²/2 is 0.2 µm.
        np.testing.assert_allclose(moved.rotation[e] @ now.T + moved.translation[e][:, None], truly, atol=3e-7)


def test_face_numbers_are_read_with_several_cameras() -> None:
    cube, side, rng = replace(CUBE, marks="pips"), from_the_side(ROOM), np.random.default_rng(5)
    start = State(
        0.0, np.array([0.0, 0.0, 0.018]), np.array([0.8, 0.3, 0.4, 0.33]), np.array([0.0, 0.0, 0.15]),
        np.array([60.0, 45.0, 30.0]),
    )  # fmt: skip
    times = np.arange(60) / FPS
    states = [Flight(start, np.inf).at(float(t)) for t in times]
    clips = []
    for room in (ROOM, side):
        frames = [np.clip(photograph(room, cube, state, rng, pips(cube)), 0, 255) for state in states]
        clips.append(ArrayClip(np.rint(frames).astype(np.uint8), times, 8))
    followed = track_clip(clips, [ROOM.camera, side.camera], cube, background=[ROOM.table, side.table])
    read = read_faces(cube, followed.marks)
    claimed = [number for number in read.numbers if number is not None]
    # Two faces are hardly seen by the first camera, whose pictures are read.
    assert len(claimed) >= 4
    assert len(set(claimed)) == len(claimed)
    # Which face is called the first is open; from there on all must be what was painted.
    turns = symmetry_rotations(cube.solid)
    normals = cube.solid.normals
    painted = [
        np.array([int(np.argmin(np.linalg.norm(normals - n @ turn.T, axis=1))) + 1 for n in normals]) for turn in turns
    ]
    assert any(all(n is None or n == one[f] for f, n in enumerate(read.numbers)) for one in painted)
    assert followed.track.shared_covariance is None
