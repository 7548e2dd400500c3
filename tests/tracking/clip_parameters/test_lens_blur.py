"""Laws of the lens estimated from a clip: its blur, and a depth of field where the pictures show one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, photograph, studio
from numpy.typing import NDArray
from random_throws import random_quaternion
from replay_records import ArrayClip

from diethrow.model.rotations import matrix_from_quat, quat_from_rotvec
from diethrow.model.throw import Flight, State
from diethrow.tracking.clip_parameters.lens_blur import FEWEST_FRAMES, depth_of_field, estimate_lens
from diethrow.tracking.picture import View
from diethrow.tracking.picture.view import Lens, with_lens
from diethrow.tracking.pose.clip_poses import SampledFrames
from diethrow.tracking.pose.refine import pose_state, refine_pose
from diethrow.tracking.sequence.tracker import track_clip

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=1.0)
FOCAL_PX = float(ROOM.camera.matrix[0, 0])
OPEN = Lens(0.7, aperture_m=0.012, focus_m=0.4)
"""Blurs by 0.7 px in focus, and by 3.3 px where the die is nearest."""
CLOSED = Lens(0.9)
NEAR_M, FAR_M = 0.31, 0.43


def depths_m(count: int) -> Array:
    return np.linspace(NEAR_M, FAR_M, count)


def states(count: int) -> list[State]:
    """Dice at rest on the line of sight, nearer and farther."""
    rng, none = np.random.default_rng(4), np.zeros(3)
    sight = ROOM.camera.rotation[2]
    return [State(0.0, ROOM.camera.centre_m + z * sight, random_quaternion(rng), none, none) for z in depths_m(count)]


def blur_px(lens: Lens, state: State) -> float:
    depth_m = float((state.position_m - ROOM.camera.centre_m) @ ROOM.camera.rotation[2])
    return float(lens.blur_at_px(np.array([depth_m]), FOCAL_PX)[0])


def frames_through(lens: Lens, shape: str, count: int) -> tuple[View, SampledFrames]:
    """Pictures by a lens, with poses that are off by a tenth of a millimetre and of a degree."""
    rng, seen = np.random.default_rng(6), states(count)
    pictures = [photograph(replace(ROOM, blur_px=blur_px(lens, one)), DICE[shape], one, rng)[None] for one in seen]
    turns = matrix_from_quat(quat_from_rotvec(np.radians(0.1) * rng.normal(size=(count, 3))))
    rotations = turns @ matrix_from_quat(np.array([one.quaternion for one in seen]))
    positions = np.array([one.position_m for one in seen]) + 1e-4 * rng.normal(size=(count, 3))
    return ROOM.view(DICE[shape]), SampledFrames(tuple(pictures), positions, rotations, np.zeros((count, 6)))


@pytest.mark.parametrize("shape", ["cube", "dodecahedron"])
def test_an_open_lens_is_found_with_its_aperture_and_focus(shape: str) -> None:
    view, frames = frames_through(OPEN, shape, 16)
    first = depth_of_field(view, frames)
    assert first is not None
    lens = estimate_lens(with_lens(view, first), frames)
    found, true = lens.blur_at_px(depths_m(16), FOCAL_PX), OPEN.blur_at_px(depths_m(16), FOCAL_PX)
    np.testing.assert_allclose(found, true, rtol=0.12)
    assert abs(lens.focus_m - OPEN.focus_m) < 0.02
    assert abs(lens.aperture_m - OPEN.aperture_m) < 0.15 * OPEN.aperture_m


@pytest.mark.parametrize("shape", ["cube", "dodecahedron"])
def test_one_blur_stays_one_blur(shape: str) -> None:
    view, frames = frames_through(CLOSED, shape, 16)
    assert depth_of_field(view, frames) is None
    lens = estimate_lens(view, frames)
    assert lens.aperture_m == 0.0
    assert abs(lens.blur_px - CLOSED.blur_px) < 0.05


def test_too_few_frames_show_no_depth_of_field() -> None:
    view, frames = frames_through(OPEN, "cube", FEWEST_FRAMES - 1)
    assert depth_of_field(view, frames) is None


def test_the_distance_of_a_blurred_die_is_right_with_the_depth_of_field_of_the_lens() -> None:
    """With the blur of the focus, a die that is twice as blurred seems nearer or farther."""
    near, off_mm = states(16)[0], []
    picture = photograph(replace(ROOM, blur_px=blur_px(OPEN, near)), DICE["cube"], near)
    for lens in (OPEN, Lens(OPEN.blur_px)):
        view = with_lens(ROOM.view(DICE["cube"]), lens)
        pose = refine_pose(view, picture, pose_state(near.position_m, near.rotation), coarse=0)
        off_mm.append(1e3 * abs(float((pose.position_m - near.position_m) @ ROOM.camera.rotation[2])))
    # Without noise. A contour blurred by three pixels leaves room for a slope of the shade beside it.
    assert off_mm[0] < 0.12
    assert off_mm[0] < 0.5 * off_mm[1]


def test_a_clip_through_an_open_lens_is_tracked_with_its_depth_of_field() -> None:
    """A cube that flies towards the camera, out of focus."""
    die, count, fps, sight = DICE["cube"], 60, 1500.0, ROOM.camera.rotation[2]
    release = State(
        0.0, ROOM.camera.centre_m + 0.4 * sight, states(1)[0].quaternion, -1.4 * sight, np.array([8.0, 5.0, -6.0])
    )
    flight, rng = Flight(release, np.inf), np.random.default_rng(8)
    seen = [flight.at(k / fps) for k in range(count)]
    pictures = [photograph(replace(ROOM, blur_px=blur_px(OPEN, one)), die, one, rng) for one in seen]
    clip = ArrayClip(np.clip(np.rint(pictures), 0, 255).astype(np.uint8), np.arange(count) / fps)
    found = track_clip(clip, ROOM.camera, die, background=ROOM.table)
    assert found.lens is not None
    assert abs(found.lens.aperture_m - OPEN.aperture_m) < 0.2 * OPEN.aperture_m
    assert f"{1e3 * found.lens.aperture_m:.0f} mm" in found.lens.notice
    assert found.track.tracked.mean() > 0.9
    off_m = (found.track.position_m - np.array([one.position_m for one in seen]))[found.track.tracked] @ sight
    assert float(np.median(np.abs(off_m))) < 2e-4
