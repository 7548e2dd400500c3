"""Laws of manual initialisation: a rough pose or rough clicks become the pose of the picture, or an error with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, film, photograph, studio
from numpy.typing import NDArray
from random_throws import random_quaternion

from diethrow.model.die.symmetry import nearest_equivalent_rotation
from diethrow.model.rotations import angle_between, quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.tracking.picture.view import View, visible_faces
from diethrow.tracking.pose.manual_pose import (
    Click,
    ManualInitialisation,
    excluded_rows,
    manual_initial_pose,
    poses_from_clicks,
)
from diethrow.tracking.pose.refine import Pose
from diethrow.tracking.sequence.tracker import ClipFacts, track_clip
from diethrow.tracking.track import LOST, TRACKED

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=2.0)
PLACE = np.array([0.001, -0.002, 0.03])


def shown(shape: str, seed: int) -> tuple[View, State, NDArray[np.float32], NDArray[np.int64]]:
    """A die at rest in the air, its picture, and the corners that can be seen."""
    rng = np.random.default_rng(seed)
    state = State(0.0, PLACE, random_quaternion(rng), np.zeros(3), np.zeros(3))
    view = ROOM.view(DICE[shape])
    faces = visible_faces(view, PLACE, state.rotation)
    corners = np.unique([c for f in faces for c in DICE[shape].solid.faces[f]])
    return view, state, photograph(ROOM, DICE[shape], state, rng), corners


def clicks(view: View, state: State, corners: NDArray[np.int64], error_px: float, named: bool) -> tuple[Click, ...]:
    rng = np.random.default_rng(11)
    pixels = view.camera.project(view.die.solid.vertices[corners] @ state.rotation.T + state.position_m)
    pixels = pixels + error_px * rng.normal(size=pixels.shape)
    return tuple(Click(px, int(c) if named else None) for px, c in zip(pixels, corners, strict=True))


def turned_deg(view: View, pose: Pose, state: State, *, any_label: bool) -> float:
    rotation = (
        nearest_equivalent_rotation(pose.rotation, state.rotation, view.symmetries) if any_label else pose.rotation
    )
    return float(np.degrees(angle_between(rotation, state.rotation)))


@pytest.mark.parametrize("shape", list(DICE))
@pytest.mark.parametrize("named", [True, False], ids=["named", "unnamed"])
def test_clicks_a_few_pixels_off_become_the_pose_of_the_picture(shape: str, named: bool) -> None:
    if shape == "tetrahedron":
        seeds = [seed for seed in range(40) if len(shown(shape, seed)[3]) == 4][:2]
    else:
        seeds = [1, 2]
    for seed in seeds:
        view, state, image, corners = shown(shape, seed)
        start = ManualInitialisation(0, clicks=clicks(view, state, corners[:7], 1.5, named))
        pose = manual_initial_pose(view, image, start)
        # One frame of a die 80 px across determines the rotation to 0.3° and the depth to 0.5 mm. The labelling is that of
        # the clicks if they name the corners.
        assert turned_deg(view, pose, state, any_label=not named) < 1.0
        assert np.linalg.norm(pose.position_m - state.position_m) < 1e-3


def test_the_picture_decides_between_the_two_tilts_of_one_clicked_face() -> None:
    view, state, image, _ = shown("cube", 3)
    face = np.array(view.die.solid.faces[int(visible_faces(view, PLACE, state.rotation)[0])])
    start = ManualInitialisation(0, clicks=clicks(view, state, face, 0.5, True))
    assert 1 <= len(poses_from_clicks(view, start)) <= 2
    assert turned_deg(view, manual_initial_pose(view, image, start), state, any_label=False) < 1.0


def test_a_rough_pose_becomes_that_of_the_picture_in_the_given_labelling() -> None:
    view, state, image, _ = shown("cube", 5)
    rough = quat_multiply(quat_from_rotvec(np.radians([6.0, -5.0, 4.0])), state.quaternion)
    pose = manual_initial_pose(view, image, ManualInitialisation(0, PLACE + np.array([0.001, -0.001, 0.002]), rough))
    assert turned_deg(view, pose, state, any_label=False) < 1.0
    assert np.linalg.norm(pose.position_m - PLACE) < 1e-3


def test_input_that_the_picture_does_not_confirm_is_refused() -> None:
    view, state, image, corners = shown("cube", 5)
    with pytest.raises(ValueError, match=r"start\.frame = 7\b.* cube"):
        manual_initial_pose(
            view, image, ManualInitialisation(7, PLACE + np.array([0.012, 0.006, 0.0]), state.quaternion)
        )
    good = clicks(view, state, corners, 0.0, True)
    with pytest.raises(ValueError, match=r"start\.corners has 3 clicks"):
        manual_initial_pose(view, image, ManualInitialisation(7, clicks=good[:3]))
    away = tuple(Click(np.array(px), None) for px in ([5.0, 5.0], [190.0, 8.0], [100.0, 12.0], [150.0, 190.0]))
    with pytest.raises(ValueError, match=r"start\.corners.* cube .*4 clicks"):
        manual_initial_pose(view, image, ManualInitialisation(7, clicks=away))
    swapped = tuple(Click(a.px, b.vertex) for a, b in zip(good, good[1:] + good[:1], strict=True))
    with pytest.raises(ValueError, match=r"start\."):
        manual_initial_pose(view, image, ManualInitialisation(7, clicks=swapped))


def test_excluded_ranges_are_rows_of_the_clip() -> None:
    assert excluded_rows([(3, 5), (8, 9), (98, 300)], 4, 96) == {0, 4, 94, 95}
    assert excluded_rows([], 0, 10) == frozenset()


def test_a_clip_is_tracked_from_a_manual_pose_and_excluded_frames_are_lost() -> None:
    die, frames = DICE["cube"], 24
    drift, spin = np.array([0.3, 0.1, 0.0]), np.array([9.0, 20.0, 3.0])
    turn = State(0.0, np.array([0.0, 0.0, 0.035]), random_quaternion(np.random.default_rng(4)), drift, spin)
    throw = Throw((Flight(turn, frames / FPS),), ())
    clip = film(ROOM, die, throw, frames)
    ruined = slice(8, 11)
    clip.array[ruined] = 250 - clip.array[ruined]
    truth = throw.at(12 / FPS)
    start = ManualInitialisation(12, truth.position_m + 5e-4, truth.quaternion)
    facts, table = ClipFacts(start=start, excluded=[(8, 11)]), np.rint(ROOM.table)
    track = track_clip(clip, ROOM.camera, die, background=table, facts=facts).track
    assert (track.status[ruined] == LOST).all()
    assert np.isnan(track.position_m[ruined]).all()
    assert (np.delete(track.status, np.r_[ruined]) == TRACKED).all()
    # The labelling is that of the start, so the result is the true orientation itself, not a symmetric equivalent.
    _, quaternions = throw.poses(track.time_s)
    assert np.degrees(angle_between(track.quaternion[track.tracked], quaternions[track.tracked])).max() < 1.0
    with pytest.raises(ValueError, match=r"start\.frame = 9\b"):
        track_clip(clip, ROOM.camera, die, background=table, facts=replace(facts, start=replace(start, frame=9)))
