"""A second die in view is named; a shadow, a reflection or a hand beside the die is none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, Studio, falling_cube, photograph, studio
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.model.rotations import matrix_from_quat, quat_from_matrix
from diethrow.model.throw.motion import State
from diethrow.tracking.check import SecondDie, Verdict, find_second_die, judge, measure_clip_quality
from diethrow.tracking.sequence import ClipFacts
from diethrow.tracking.track import LOST, TRACKED, Track

Array = NDArray[np.float64]

CUBE = DICE["cube"]
FRAMES = 40
ROOM = replace(studio(320, 260), noise_grey=2.0)
THROW = falling_cube(FRAMES / FPS)
ASIDE_M = np.array([0.026, 0.004, 0.0])
"""From the die to another one that does not touch its picture."""
UPSIDE_DOWN = np.diag([1.0, 1.0, -1.0])


def filmed(beside: Callable[[Studio, State], Studio], shadow: float = 0.0, noise_grey: float = 2.0) -> ArrayClip:
    """The throw in front of what each picture shows beside the die."""
    rng = np.random.default_rng(6)
    states = [THROW.at(k / FPS) for k in range(FRAMES)]
    pictures = [
        photograph(replace(beside(ROOM, state), shadow=shadow, noise_grey=noise_grey), CUBE, state, rng)
        for state in states
    ]
    stack = np.clip(np.rint(np.array(pictures)), 0, 255).astype(np.uint8)
    return ArrayClip(stack, np.arange(FRAMES) / FPS)


def with_die_at(room: Studio, state: State) -> Studio:
    return replace(room, table=photograph(replace(room, noise_grey=0.0), CUBE, state))


def falling_beside(room: Studio, state: State) -> Studio:
    return with_die_at(room, replace(state, position_m=state.position_m + ASIDE_M))


def lying_beside(room: Studio, state: State) -> Studio:
    at_rest = np.array([0.026, 0.004, CUBE.solid.inradius])
    return with_die_at(room, replace(state, position_m=at_rest, quaternion=np.array([1.0, 0.0, 0.0, 0.0])))


def reflected(room: Studio, state: State) -> Studio:
    """The mirror image of a cube is the cube that is turned by the mirrored rotation."""
    rotation = UPSIDE_DOWN @ matrix_from_quat(state.quaternion) @ UPSIDE_DOWN
    below = replace(state, position_m=UPSIDE_DOWN @ state.position_m, quaternion=quat_from_matrix(rotation))
    return with_die_at(room, below)


def with_hand(room: Studio, state: State) -> Studio:
    table = room.table.copy()
    table[90:160, 240:] = 150.0
    return replace(room, table=table)


def true_track(rows: slice = slice(None)) -> Track:
    """The true poses on some rows; the others are lost."""
    times = np.arange(FRAMES) / FPS
    position, quaternion = THROW.poses(times)
    status = np.full(FRAMES, LOST, dtype=object)
    status[rows] = TRACKED
    return Track(np.arange(FRAMES), times, position, quaternion, np.tile(np.eye(6), (FRAMES, 1, 1)), status.astype(str))


def found_in(clip: ArrayClip, rows: slice = slice(None)) -> SecondDie | None:
    return find_second_die(clip, true_track(rows), ROOM.camera, CUBE, ROOM.table)


@cache
def two_dice() -> ArrayClip:
    return filmed(falling_beside)


@pytest.mark.parametrize("beside", [falling_beside, lying_beside])
@pytest.mark.parametrize("shadow", [0.0, 0.5])
def test_another_die_is_seen_whether_it_falls_or_lies(beside: Callable[[Studio, State], Studio], shadow: float) -> None:
    found = found_in(filmed(beside, shadow))
    assert found is not None
    assert found.frames > 0.8 * found.searched


@pytest.mark.parametrize("beside", [lambda room, state: room, reflected, with_hand], ids=["alone", "mirror", "hand"])
@pytest.mark.parametrize("shadow", [0.0, 0.3, 0.6])
@pytest.mark.parametrize("noise_grey", [0.3, 2.0])  # with less noise, more of a shadow differs from a darker table
def test_a_lone_die_has_no_second_one(
    beside: Callable[[Studio, State], Studio], shadow: float, noise_grey: float
) -> None:
    assert found_in(filmed(beside, shadow, noise_grey)) is None


def test_a_few_wrong_poses_are_no_second_die() -> None:
    clip = filmed(lambda room, state: room)
    track = true_track()
    track.position_m[::8] += ASIDE_M  # beside such an outline lies the die itself
    assert find_second_die(clip, track, ROOM.camera, CUBE, ROOM.table) is None


def test_a_few_frames_do_not_decide() -> None:
    assert found_in(two_dice(), slice(5, 7)) is None
    assert found_in(two_dice(), slice(5, 8)) == SecondDie(3, 3)


def test_the_check_names_a_second_die() -> None:
    clip = two_dice()

    def part(first: int, stop: int) -> ArrayClip:
        return replace(clip, array=clip.array[first:stop], times_s=clip.times_s[first:stop], first_frame=first)

    quality = measure_clip_quality(clip, ROOM.camera, CUBE, part, background=np.rint(ROOM.table), facts=ClipFacts(1e-4))
    found = {each.name: each for each in judge(quality, CUBE, 1e-4)}["second die"]
    assert found.verdict is Verdict.DOUBTFUL
    assert "searched frames show something of the size of a die beside the tracked one" in found.measured
    assert "keep others out of view" in found.advice
