"""Laws of a track made from a clip: the truth within its sigmas where the die is seen, honest words where it is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from diethrow.model.impacts import SmoothImpact
from diethrow.model.motion import Flight, State, Throw
from diethrow.model.rotations import quat_conjugate, quat_multiply, rotation_between, rotvec_from_quat
from diethrow.model.simulate import Until, throw_die
from diethrow.tracking.background import estimate_background
from diethrow.tracking.bounces import measure_throw
from diethrow.tracking.follow import NoDieError, follow
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track
from footage_of_throws import DICE, FPS, film, studio
from random_throws import random_quaternion
from replay_records import ArrayClip

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=2.0, shadow=0.4)
CUBE = DICE["cube"]
FRAMES = 64


def falling_cube() -> Throw:
    """A cube that comes down, bounces once at frame 36.5 of the clip, and stays in the picture."""
    rng = np.random.default_rng(1)
    start, down = np.array([-0.002, 0.0, 0.028]), np.array([0.05, 0.05, -0.6])
    release = State(0.0, start, random_quaternion(rng), down, 20.0 * rng.normal(size=3))
    return throw_die(CUBE, release, SmoothImpact(0.6), until=Until(time_s=FRAMES / FPS)).throw


def crossing_cube() -> Throw:
    """A cube that flies through the picture from left to right and touches nothing."""
    right = ROOM.camera.rotation[0]
    middle = State(
        0.5 * FRAMES / FPS, np.array([0.0, 0.0, 0.018]), np.array([0.5, 0.5, -0.1, 0.7]), 2.0 * right, np.array([9.0, 25.0, 3.0])
    )  # fmt: skip
    middle = replace(middle, quaternion=middle.quaternion / np.linalg.norm(middle.quaternion))
    return Throw((Flight(Flight(middle, np.inf).at(0.0), FRAMES / FPS),), ())


@cache
def bouncing(bit_depth: int) -> tuple[ArrayClip, Track, list[tuple[int, int]]]:
    """The falling cube's clip, its track, and what was said of the progress."""
    clip = film(ROOM, CUBE, falling_cube(), FRAMES, bit_depth=bit_depth)
    said: list[tuple[int, int]] = []
    table = np.rint(ROOM.table * np.float32(2.0 ** (bit_depth - 8)))
    track = follow(clip, ROOM.camera, CUBE, background=table, progress=lambda done, total: said.append((done, total)))
    return clip, track, said


def errors_of(track: Track, throw: Throw) -> Array:
    """(n, 6) true minus tracked on every frame, under the labelling that the track chose on its first frame."""
    positions, quaternions = throw.poses(track.time_s)
    first = int(np.flatnonzero(track.tracked)[0])
    relabel = quat_multiply(quat_conjugate(quaternions[first]), track.quaternion[first])
    turns = np.full((len(track), 3), np.nan)
    use = track.tracked
    nearest = nearest_symmetry(relabel)
    turns[use] = rotation_between(track.quaternion[use], quat_multiply(quaternions[use], nearest))
    return np.concatenate([positions - track.position_m, turns], axis=1)


def nearest_symmetry(quaternion: Array) -> Array:
    """The rotation of the cube's own group that is nearest: all that tells a plain die's labellings apart."""
    view = ROOM.view(CUBE)
    from diethrow.model.rotations import quat_from_matrix

    group = quat_from_matrix(view.symmetries)
    return np.asarray(group[int(np.argmax(np.abs(group @ quaternion)))])


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_a_bouncing_cube_is_followed_on_every_frame(bit_depth: int) -> None:
    _, track, _ = bouncing(bit_depth)
    print(track.status[~track.tracked], len(falling_cube().impacts))
    errors = errors_of(track, falling_cube())
    nees = [e @ np.linalg.solve(C, e) for e, C in zip(errors, track.covariance, strict=True)]
    turned = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
    across = np.linalg.norm(errors[:, :3] @ ROOM.camera.rotation[:2].T, axis=1)
    print(np.median(turned), turned.max(), np.median(across) * 1e3, across.max() * 1e3, np.median(nees), np.mean(nees), np.argmax(nees))


def test_the_bounce_of_a_filmed_cube_is_found_to_a_small_part_of_a_frame() -> None:
    truth = falling_cube()
    throw = measure_throw(bouncing(8)[1], CUBE)
    print([(i.time_s * FPS, i.sigma_time_s * FPS, i.chi, i.chi_low, i.chi_high) for i in throw.impacts], [i.time_s * FPS for i in truth.impacts])


def test_progress_only_grows_and_ends_at_the_total() -> None:
    said = bouncing(8)[2]
    done = [d for d, _ in said]
    assert {total for _, total in said} == {said[0][1]}
    assert all(a <= b for a, b in zip(done[:-1], done[1:], strict=True))
    assert said[-1][0] == said[-1][1]


@cache
def crossing() -> tuple[ArrayClip, Track]:
    clip = film(replace(ROOM, shadow=0.0), CUBE, crossing_cube(), FRAMES)
    return clip, follow(clip, ROOM.camera, CUBE)


def test_a_die_that_comes_and_goes_is_absent_before_and_after() -> None:
    _, track = crossing()
    print("".join(s[0] for s in track.status))
    p, q = crossing_cube().poses(track.time_s)
    print(np.nanmax(np.linalg.norm(errors_of(track, crossing_cube()), axis=1)))
