"""Laws of labelling: a frame of a symmetric die has that of its flight, or of its neighbours if no flight determines it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, studio
from marked_throws import FRAMES as MARKED_FRAMES
from marked_throws import VIEW as MARKED_VIEW
from marked_throws import marked_film, tossed
from numpy.typing import NDArray
from random_throws import random_quaternion
from replay_records import ArrayClip

from diethrow.model.die.solid import SHAPES
from diethrow.model.die.symmetry import nearest_equivalent_rotation
from diethrow.model.rotations import angle_between, matrix_from_quat, quat_from_matrix, quat_from_rotvec, quat_multiply
from diethrow.model.throw.motion import Flight, Impact, State, Throw
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.picture.view import View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.sequence.labelling import (
    _groups,
    with_consistent_labels,
    with_labels_of_flights,
    with_labels_of_marks,
)
from diethrow.tracking.track import Track

Array = NDArray[np.float64]

FRAMES, STRUCK = 24, 11.5
"""Frames of a die that spins, and when it strikes the table, in frames."""
SPIN = np.array([60.0, -90.0, 40.0])
TIMES_S = np.arange(FRAMES) / FPS


def spinning(shape: str, seed: int) -> tuple[View, ClipPoses]:
    """A die seen on every frame, in one labelling: 4.5 degrees a frame, about another axis from STRUCK on."""
    rng, view = np.random.default_rng(seed), studio().view(DICE[shape])
    q, seen = random_quaternion(rng), ClipPoses.empty(FRAMES)
    for k in range(FRAMES):
        seen.rotation[k] = matrix_from_quat(q)
        q = quat_multiply(quat_from_rotvec((SPIN if k < STRUCK else SPIN[::-1]) / FPS), q)
    seen.position_m[:], seen.known[:] = [0.0, 0.0, 0.02], True
    return view, seen


def relabelled(view: View, seen: ClipPoses, rows: slice, seed: int) -> ClipPoses:
    """The same with some rows in another labelling, one for all."""
    rng = np.random.default_rng(seed)
    other = view.symmetries[rng.integers(1, len(view.symmetries))]
    rotation = seen.rotation.copy()
    rotation[rows] = rotation[rows] @ other
    return replace(seen, rotation=rotation)


def through(seen: ClipPoses, *turns: list[float]) -> Throw:
    """Two flights without spin that meet in an unresolved contact, each turned by a rotation vector (3,) from how the die is seen
    just before it and just behind."""
    time_s, flights = STRUCK / FPS, []
    for row, turn, start_s, end_s in ((11, turns[0], 0.0, time_s), (12, turns[1], time_s, np.inf)):
        rotation = matrix_from_quat(quat_from_rotvec(turn)) @ seen.rotation[row]
        still = State(start_s, seen.position_m[row], quat_from_matrix(rotation), np.zeros(3), np.zeros(3))
        flights.append(Flight(still, end_s))
    nothing = np.full(3, np.nan)
    unresolved = Impact(time_s, "unresolved", (), nothing[:2], nothing, np.nan, np.nan, np.nan, np.nan, 0, 0)
    return Throw(tuple(flights), (unresolved,))


@pytest.mark.parametrize("shape", SHAPES)
def test_consecutive_frames_keep_their_labelling_wherever_flights_lead(shape: str) -> None:
    for seed in range(6):
        view, seen = spinning(shape, seed)
        astray = through(seen, [0.0, 0.5, 0.0], [0.9, 0.0, -0.4])
        assert with_consistent_labels(view, seen, astray, TIMES_S).rotation == pytest.approx(seen.rotation, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_an_instant_at_which_flights_meet_decides_the_labelling(shape: str) -> None:
    """A die begins to spin, by two thirds of the least angle of a symmetry a frame, at a contact that is measured a frame late:
    at that instant another labelling is nearer, and so it is from frame to frame."""
    misled = 0
    for seed in range(6):
        rng, view, seen = np.random.default_rng([41, seed]), studio().view(DICE[shape]), ClipPoses.empty(FRAMES)
        least_rad = np.sort(angle_between(np.eye(3), view.symmetries))[1]
        axis = rng.normal(size=3)
        spins = (np.zeros(3), axis / np.linalg.norm(axis) * (2.0 / 3.0) * least_rad * FPS)
        measured_s, place, turned = (STRUCK + 0.45) / FPS, np.array([0.0, 0.0, 0.02]), random_quaternion(rng)
        met = State((STRUCK - 0.45) / FPS, place, turned, np.zeros(3), spins[0])
        flights = [Flight(replace(met, omega_rad_s=spin), np.inf, gravity_m_s2=0.0) for spin in spins]
        for rows, flight in zip((slice(0, 12), slice(12, FRAMES)), flights, strict=True):
            seen.position_m[rows], quaternions = flight.poses(TIMES_S[rows])
            seen.rotation[rows], seen.known[rows] = matrix_from_quat(quaternions), True
        ends_s = (measured_s, np.inf)
        for other in view.symmetries:
            rotation = seen.rotation.copy()
            rotation[12:] = rotation[12:] @ other
            labelled = [np.eye(3), other]
            starts = [flight.at(s) for flight, s in zip(flights, (0.0, measured_s), strict=True)]
            starts = [
                replace(start, quaternion=quat_from_matrix(start.rotation @ label))
                for start, label in zip(starts, labelled, strict=True)
            ]
            throw = Throw(
                tuple(Flight(s, end, gravity_m_s2=0.0) for s, end in zip(starts, ends_s, strict=True)),
                (replace(through(seen, [0.0] * 3, [0.0] * 3).impacts[0], time_s=measured_s),),
            )
            found = with_consistent_labels(view, replace(seen, rotation=rotation), throw, TIMES_S)
            assert found.rotation == pytest.approx(seen.rotation, abs=1e-9)
        there = nearest_equivalent_rotation(seen.rotation[12], seen.rotation[11], view.symmetries)
        misled += int(angle_between(there, seen.rotation[12]) > 0.1)
    assert misled > 0


@pytest.mark.parametrize("shape", SHAPES)
def test_flights_determine_the_labelling_behind_frames_without_a_pose(shape: str) -> None:
    view, seen = spinning(shape, 1)
    gap, behind = slice(10, 14), slice(14, FRAMES)
    known = seen.known.copy()
    known[gap] = False
    other = relabelled(view, replace(seen, known=known), slice(12, FRAMES), 2)
    found = with_consistent_labels(view, other, through(other, [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]), TIMES_S)
    assert found.rotation[:10] == pytest.approx(seen.rotation[:10], abs=1e-12)
    assert found.rotation[behind] == pytest.approx(seen.rotation[behind], abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_frame_is_labelled_like_its_flight_or_if_that_is_off_like_the_tracked_pose(shape: str) -> None:
    view, first = spinning(shape, 3)
    rotated = matrix_from_quat(quat_from_rotvec([0.02, -0.03, 0.01]))
    refined = relabelled(view, replace(first, rotation=rotated @ first.rotation), slice(0, FRAMES), 4)
    wrong = relabelled(view, first, slice(0, FRAMES), 5)
    right = rotated @ first.rotation
    assert with_labels_of_flights(view, refined, first, wrong).rotation == pytest.approx(right, abs=1e-12)
    astray = replace(first, rotation=matrix_from_quat(quat_from_rotvec([0.24, 0.15, -0.24])) @ first.rotation)
    assert with_labels_of_flights(view, refined, astray, first).rotation == pytest.approx(right, abs=1e-12)
    # Where the first pass has none there is nothing else to go by.
    unknown = replace(first, known=np.zeros(FRAMES, bool))
    nearest = nearest_equivalent_rotation(refined.rotation, astray.rotation, view.symmetries)
    assert with_labels_of_flights(view, refined, astray, unknown).rotation == pytest.approx(nearest, abs=1e-12)


def tossed_and_seen() -> tuple[FrameSource, ClipPoses]:
    """A marked cube with its true poses."""
    clip = ArrayClip(np.array([marked_film()[k] for k in range(MARKED_FRAMES)]), np.arange(MARKED_FRAMES) / FPS)
    seen, (position_m, quaternion) = ClipPoses.empty(MARKED_FRAMES), tossed().poses(clip.times_s)
    seen.known[:], seen.position_m[:], seen.rotation[:] = True, position_m, matrix_from_quat(quaternion)
    seen.motion[:], seen.H[:] = tossed().rates(clip.times_s), 1e6 * np.eye(seen.H.shape[1])
    return FrameSource([clip]), seen


@pytest.mark.parametrize("lost", [0, 6])
def test_marks_carry_the_labelling_through_a_contact_or_a_gap_that_leaves_it_open(lost: int) -> None:
    source, seen = tossed_and_seen()
    seen.known[45 : 45 + lost] = False
    other = relabelled(MARKED_VIEW, seen, slice(45, MARKED_FRAMES), 7)
    middle_s = 44.5 / FPS if lost == 0 else np.inf
    nothing = np.full(3, np.nan)
    unresolved = Impact(middle_s, "unresolved", (), nothing[:2], nothing, np.nan, np.nan, np.nan, np.nan, 0, 0)
    throw = Throw((replace(tossed(), end_s=middle_s), replace(tossed(), end_s=np.inf)), (unresolved,))
    found = with_labels_of_marks(MARKED_VIEW, source, other, throw)
    assert found.rotation[seen.known] == pytest.approx(seen.rotation[seen.known], abs=1e-12)
    assert with_labels_of_marks(MARKED_VIEW, source, seen, throw) is seen


@pytest.mark.parametrize(
    ("lost", "spin", "is_sure"), [(0, 1.0, True), (2, 1.0, True), (6, 1.0, False), (0, 50.0, False)]
)
def test_where_the_die_hardly_turns_between_two_frames_marks_do_not_change_its_labelling(
    lost: int, spin: float, is_sure: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    source, seen = tossed_and_seen()
    seen.known[45 : 45 + lost] = False
    seen.motion[:, 3:] *= spin
    middle_s, nothing = 44.5 / FPS, np.full(3, np.nan)
    unresolved = Impact(middle_s, "unresolved", (), nothing[:2], nothing, np.nan, np.nan, np.nan, np.nan, 0, 0)
    throw = Throw((replace(tossed(), end_s=middle_s), replace(tossed(), end_s=np.inf)), (unresolved,))
    asked: list[int] = []

    def other_marks(view: View, images: object, track: Track, rates: Array, groups: NDArray[np.int64]) -> list[Array]:
        asked.append(int(groups.max()) + 1)
        return [np.eye(3), *[view.symmetries[7]] * int(groups.max())]

    monkeypatch.setattr("diethrow.tracking.sequence.labelling.labels_by_marks", other_marks)
    found = with_labels_of_marks(MARKED_VIEW, source, seen, throw)
    assert (found is seen) == is_sure
    assert asked == [1 if is_sure else 2]


def test_frames_that_cannot_be_compared_are_labelled_with_those_of_their_own_segment() -> None:
    view, seen = spinning("cube", 3)
    other = relabelled(view, seen, slice(12, FRAMES), 5)
    rows, segments = np.r_[0:10, 16:FRAMES], np.repeat([0, 1], [12, FRAMES - 12])
    groups = _groups(view, other, TIMES_S, rows, segments)
    np.testing.assert_array_equal(groups, segments)
