"""Laws of the estimated corner radius: that of a rounded die is found, and a sharp die stays sharp."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from types import SimpleNamespace

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, Image, photograph, studio
from random_throws import random_quaternion
from replay_records import ArrayClip
from rounded_dice import photograph_rounded

from diethrow.model.die.die import Die
from diethrow.model.die.solid import SHAPES
from diethrow.model.laws import SmoothImpact
from diethrow.model.rotations import quat_from_matrix, rotation_between
from diethrow.model.throw.motion import State, Throw
from diethrow.model.throw.simulate import Until, throw_die
from diethrow.tracking.clip_parameters.corner_radius import (
    CornerRadius,
    CornerRounding,
    SampledFrames,
    compared_radius_px,
    contour_sigma_px,
    gain_over_sharp,
    is_rounded,
    radius_by_free_poses,
    radius_on_flights,
    rounding_gain,
)
from diethrow.tracking.footage import FrameSource
from diethrow.tracking.frame_to_frame import TrackingTask
from diethrow.tracking.picture.view import LEAST_ROUNDED_PX, View
from diethrow.tracking.pose.clip_poses import ClipPoses
from diethrow.tracking.pose.refine import pose_state, refine_pose
from diethrow.tracking.quality import FAST
from diethrow.tracking.sequence import rounded_corners, tracker
from diethrow.tracking.sequence.rounded_corners import CLEARLY_ROUNDED_PX, _is_tracked_well, track_rounded
from diethrow.tracking.sequence.tracker import ClipFacts, TrackedClip, track_clip
from diethrow.tracking.sequence.tracking_pass import track_throughout

STUDIO = replace(studio(), noise_grey=2.0)
CUBE = DICE["cube"]
FEW, MANY = 12, 24
PX_PER_M = 3750.0
"""Scale in the middle of the studio's picture."""


def states(count: int) -> list[State]:
    """Random orientations, in the middle of the picture."""
    made = []
    for k in range(count):
        rng = np.random.default_rng([5, k])
        position = np.array([*rng.uniform(-2e-3, 2e-3, 2), 0.018])
        made.append(State(0.0, position, random_quaternion(rng), np.zeros(3), np.zeros(3)))
    return made


def sampled(drawn: Callable[[State, np.random.Generator], Image], count: int, *, error: float = 0.0) -> SampledFrames:
    """Pictures of a die at rest in those orientations, with errors of the position of `error` times 0.1 mm."""
    rng = np.random.default_rng(1)
    at = states(count)
    wrong = error * rng.standard_normal((count, 3)) * 1e-4
    return SampledFrames(
        tuple(drawn(state, rng)[None] for state in at),
        np.array([state.position_m for state in at]) + wrong,
        np.array([state.rotation for state in at]),
        np.zeros((count, 6)),
    )


@cache
def round_frames(radius_m: float, count: int = FEW) -> SampledFrames:
    """Pictures of a rounded cube, at its true poses."""
    die = replace(CUBE, corner_radius_m=radius_m)
    return sampled(lambda state, rng: photograph_rounded(STUDIO, die, state, rng), count)


@pytest.mark.parametrize("shape", SHAPES)
def test_a_sharp_die_has_radius_zero(shape: str) -> None:
    die = DICE[shape]
    view = STUDIO.view(die)
    frames = sampled(lambda state, rng: photograph(STUDIO, die, state, rng), MANY, error=1.0)
    gain, sigma = rounding_gain(view, frames, compared_radius_px(view))
    assert gain < -3.0 * sigma  # the penalty for the two more intensities of a rounded edge, and a little more
    assert not is_rounded(view, frames.sample)
    free = radius_by_free_poses(view, frames)
    assert free is not None
    assert free.radius_m == 0.0


@pytest.mark.parametrize("blur_px", [1.2, 2.4, 3.5])
@pytest.mark.parametrize("shape", ["tetrahedron", "cube"])
def test_a_sharp_die_out_of_focus_is_not_taken_for_rounded(shape: str, blur_px: float) -> None:
    """A die whose radius exceeds the blur is."""
    setting, die = replace(STUDIO, blur_px=blur_px), DICE[shape]
    assert not is_rounded(
        setting.view(die), sampled(lambda at, rng: photograph(setting, die, at, rng), MANY, error=1.0).sample
    )
    ball = replace(CUBE, corner_radius_m=1.5 * blur_px / PX_PER_M)
    frames = sampled(lambda at, rng: photograph_rounded(setting, ball, at, rng), FEW)
    assert is_rounded(setting.view(CUBE), frames.sample)


# From half a pixel, a little less than the lens blur, to a die that is nearly a ball: 0.6 to 9 pixels.
@pytest.mark.parametrize("radius_m", [0.15e-3, 0.6e-3, 2.5e-3])
def test_the_radius_of_a_rounded_die_is_found_within_its_error(radius_m: float) -> None:
    frames, view = round_frames(radius_m), STUDIO.view(CUBE)
    # Half a pixel is distinguished from none by more frames than these.
    assert is_rounded(view, frames.sample) or radius_m < 0.5 / PX_PER_M + 0.1e-3
    free = radius_by_free_poses(view, frames)
    assert free is not None
    assert abs(free.radius_m - radius_m) < 2.5 * free.sigma_m
    found = radius_on_flights(view, frames, free.radius_m)
    assert found is not None
    assert abs(found.radius_m - radius_m) < 2.0 * found.sigma_m
    assert found.sigma_m < free.sigma_m  # known poses determine it better than free ones


@pytest.mark.parametrize("gloss_grey", [0.0, 60.0])
def test_light_on_the_bevels_moves_a_rounded_die_by_little_more_than_its_standard_errors(gloss_grey: float) -> None:
    setting, die, squared = replace(STUDIO, noise_grey=3.0), replace(CUBE, corner_radius_m=0.6e-3), []
    for k, state in enumerate(states(MANY)):
        image = photograph_rounded(setting, die, state, np.random.default_rng([11, k]), gloss_grey=gloss_grey)
        pose = refine_pose(setting.view(die), image, pose_state(state.position_m, state.rotation), coarse=0)
        if pose.covariance is not None:
            turned = rotation_between(state.quaternion, quat_from_matrix(pose.rotation))
            errors = np.concatenate([pose.position_m - state.position_m, turned])
            squared.append(errors @ np.linalg.solve(pose.covariance, errors))
    assert len(squared) > MANY - 3
    # The median of chi-square is 5.35. Strips whose shade is bound too closely to that of the faces come to 38, 58
    # with gloss.
    assert np.median(squared) < 5.0 * 5.35


def test_flights_that_the_pictures_contradict_give_no_radius() -> None:
    frames = round_frames(0.6e-3)
    wrong = replace(frames, position_m=frames.position_m + np.array([1e-3, 0.0, 0.0]))
    assert radius_on_flights(STUDIO.view(CUBE), wrong, 0.6e-3) is None
    none = replace(
        frames, pictures=(), position_m=np.zeros((0, 3)), rotation=np.zeros((0, 3, 3)), motion=np.zeros((0, 6))
    )
    assert radius_on_flights(STUDIO.view(CUBE), none, 0.6e-3) is None
    assert radius_by_free_poses(STUDIO.view(CUBE), none) is None
    assert rounding_gain(STUDIO.view(CUBE), none, 1.0) == (0.0, np.inf)


def test_the_contour_error_is_that_of_the_outline() -> None:
    """A cube that shows one face keeps its outline when it is rounded. Seen along a diagonal it loses 0.41 radii all
    round, like a larger distance, which the flights must be free to correct."""
    view = STUDIO.view(CUBE)
    ahead = STUDIO.camera.rotation[2]
    position = STUDIO.camera.centre_m + 0.4 * ahead
    face = np.column_stack([STUDIO.camera.rotation[0], STUDIO.camera.rotation[1], ahead])
    corner_axis = np.array([1.0, 1.0, 1.0]) / np.sqrt(3.0)
    across = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
    body = np.column_stack([across, np.cross(corner_axis, across), corner_axis])
    errors = [contour_sigma_px(view, 0.1e-3, position[None], R[None]) for R in (face, face @ body.T)]
    assert errors[0] == pytest.approx(0.0, abs=0.03 * 0.1e-3 * PX_PER_M)  # from so near the sides are visible
    assert errors[1] == pytest.approx(0.414 * 0.1e-3 * PX_PER_M, rel=0.05)
    assert contour_sigma_px(view, 0.0, position[None], face[None]) == 0.0


# --- a whole clip ---

RADIUS_M = 0.8e-3
FRAMES = 28
ROUND = replace(CUBE, corner_radius_m=RADIUS_M)


@cache
def clip() -> tuple[ArrayClip, Throw]:
    """A rounded cube that falls and bounces once, in the middle.

    With twice the noise, or another orientation, frames are lost while the light on it is not yet known, and the last bit decides
    whether its radius is found."""
    quiet = replace(STUDIO, noise_grey=1.0)
    start, down = np.array([-0.001, 0.0, 0.022]), np.array([0.05, 0.05, -0.7])
    release = State(0.0, start, random_quaternion(np.random.default_rng(5)), down, np.array([12.0, -25.0, 9.0]))
    throw = throw_die(ROUND, release, SmoothImpact(0.6), until=Until(time_s=FRAMES / FPS)).throw
    times, rng = np.arange(FRAMES) / FPS, np.random.default_rng(2)
    frames = [np.clip(np.rint(photograph_rounded(quiet, ROUND, throw.at(float(t)), rng)), 0, 255) for t in times]
    return ArrayClip(np.array(frames).astype(np.uint8), times, 8), throw


@cache
def tracked(rounding: CornerRounding, radius_m: float) -> TrackedClip:
    """The clip, tracked from a radius that is given or to be found."""
    die = replace(CUBE, corner_radius_m=radius_m)
    facts, table = ClipFacts(rounding=rounding), np.rint(STUDIO.table)
    return track_clip(clip()[0], STUDIO.camera, die, background=table, facts=facts, quality=FAST)


def depth_errors_m(result: TrackedClip) -> np.ndarray:
    """(n,) position errors along the line of sight."""
    track, (_, throw) = result.track, clip()
    use = track.tracked
    off = throw.poses(track.time_s[use])[0] - track.position_m[use]
    return np.asarray(off @ STUDIO.camera.rotation[2])


@pytest.mark.parametrize("rounding", [CornerRounding.TESTED, CornerRounding.ESTIMATED])
def test_a_die_is_tracked_with_the_radius_that_it_shows(rounding: CornerRounding) -> None:
    result = tracked(rounding, 0.0)
    assert isinstance(result.corners, CornerRadius)
    assert abs(result.corners.radius_m - RADIUS_M) < 2.0 * result.corners.sigma_m
    assert result.die.corner_radius_m == result.corners.radius_m
    assert "radius" in result.corners.notice


def test_a_rounded_die_taken_for_sharp_appears_too_far_away() -> None:
    """Contours further inside correspond to a larger distance."""
    sharp, found, given = (
        float(np.median(depth_errors_m(each)))
        for each in (
            tracked(CornerRounding.GIVEN, 0.0),
            tracked(CornerRounding.TESTED, 0.0),
            tracked(CornerRounding.GIVEN, RADIUS_M),
        )
    )
    # Of single frames, without the distance from the flights: the model of a bevel leaves a third of the error.
    assert abs(found) < 0.5 * abs(sharp)
    assert abs(given) < 0.5 * abs(sharp)


def test_a_given_radius_is_kept() -> None:
    result = tracked(CornerRounding.GIVEN, RADIUS_M)
    assert result.corners is None
    assert result.die.corner_radius_m == RADIUS_M
    assert result.track.contour_sigma_px == 0.0


def shown_by_impacts(monkeypatch: pytest.MonkeyPatch) -> TrackedClip:
    """The clip, whose pictures show sharp corners and whose impacts show the radius."""
    shown = CornerRadius(RADIUS_M, 0.1 * RADIUS_M, by_impacts=True)
    monkeypatch.setattr(rounded_corners, "_radius_from_pictures", lambda *_: (None, False))
    monkeypatch.setattr(tracker, "radius_by_impacts", lambda *_: (shown, 0.6))
    return tracked.__wrapped__(CornerRounding.TESTED, 0.0)


def test_a_die_is_tracked_again_with_the_radius_that_its_impacts_show(monkeypatch: pytest.MonkeyPatch) -> None:
    """As if it had been given; but the place of its contour is only known as well as the radius is."""
    given, result = tracked(CornerRounding.GIVEN, RADIUS_M), shown_by_impacts(monkeypatch)
    assert np.array_equal(result.track.position_m, given.track.position_m, equal_nan=True)
    assert result.corners is not None
    assert "sharp" in result.corners.notice
    assert result.die.corner_radius_m == result.corners.radius_m == RADIUS_M
    assert 0.0 < result.track.contour_sigma_px < 0.4 * result.corners.sigma_m * PX_PER_M


def test_poses_of_a_sharp_die_remain_where_it_does_not_fly_as_rounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tracker, "_tracked_as_rounded", lambda *_: tracked(CornerRounding.GIVEN, RADIUS_M))
    monkeypatch.setattr(tracker, "flies_as_before", lambda *_: False)
    sharp, result = tracked(CornerRounding.GIVEN, 0.0), shown_by_impacts(monkeypatch)
    assert np.array_equal(result.track.position_m, sharp.track.position_m, equal_nan=True)
    assert result.track.contour_sigma_px == 0.6


@cache
def sharp_clip() -> ArrayClip:
    """A sharp cube in the same throw."""
    throw = throw_die(CUBE, clip()[1].flights[0].start, SmoothImpact(0.6), until=Until(time_s=FRAMES / FPS)).throw
    rng = np.random.default_rng(2)
    times = np.arange(FRAMES) / FPS
    frames = np.array([np.clip(np.rint(photograph(STUDIO, CUBE, throw.at(float(t)), rng)), 0, 255) for t in times])
    return ArrayClip(frames.astype(np.uint8), times, 8)


def sharp_tracked(rounding: CornerRounding) -> TrackedClip:
    facts, table = ClipFacts(rounding=rounding), np.rint(STUDIO.table)
    return track_clip(sharp_clip(), STUDIO.camera, CUBE, background=table, facts=facts, quality=FAST)


def test_the_test_for_rounding_leaves_the_track_of_a_sharp_die_unchanged() -> None:
    """Not one bit of the poses differs."""
    tested, given = sharp_tracked(CornerRounding.TESTED), sharp_tracked(CornerRounding.GIVEN)
    assert tested.corners is None
    assert tested.die is CUBE
    assert np.array_equal(tested.track.position_m, given.track.position_m, equal_nan=True)
    assert np.array_equal(tested.track.covariance, given.track.covariance, equal_nan=True)


SLIGHTLY_M = 0.6 / PX_PER_M
"""Radius of six tenths of a pixel."""


def slightly_rounded(die: Die) -> tuple[View, ClipPoses, TrackingTask]:
    """The view and the poses with which the clip is tracked as that of a die of a given radius."""
    source = FrameSource([sharp_clip()])
    task = TrackingTask(source, np.zeros(FRAMES, bool), None, lambda frame: None)
    room = replace(STUDIO, table=np.rint(STUDIO.table))
    view, poses, corners = track_rounded(replace(room.view(die), quality=FAST), task, CornerRounding.GIVEN)
    assert corners is None
    return view, poses, task


def test_a_slightly_rounded_die_is_tracked_by_its_edges_if_these_suffice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else by its whole surface. Either way its poses are those of the surface."""
    compared_from_px = []

    def recorded(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
        compared_from_px.append(view.surface_from_px)
        return track_throughout(view, task)

    monkeypatch.setattr(rounded_corners, "track_throughout", recorded)
    die = replace(CUBE, corner_radius_m=SLIGHTLY_M)
    view, by_edges, _ = slightly_rounded(die)
    assert view.shows_surface(by_edges.position_m[0])
    assert compared_from_px == [CLEARLY_ROUNDED_PX]
    monkeypatch.setattr(rounded_corners, "_is_tracked_well", lambda *_: False)
    view, by_surface, _ = slightly_rounded(die)
    assert view.shows_surface(by_surface.position_m[0])
    assert compared_from_px == [CLEARLY_ROUNDED_PX, CLEARLY_ROUNDED_PX, LEAST_ROUNDED_PX]
    across = (by_surface.position_m - by_edges.position_m) @ STUDIO.camera.rotation[:2].T
    assert np.abs(across).max() * PX_PER_M < 0.3
    # A cube of more than a pixel shows its surface from the first.
    slightly_rounded(replace(CUBE, corner_radius_m=3.0 * SLIGHTLY_M))
    assert compared_from_px[3:] == [CLEARLY_ROUNDED_PX]


def test_edges_suffice_if_they_lose_no_frame_and_flights_meet_at_one_corner() -> None:
    view, poses, task = slightly_rounded(CUBE)
    assert poses.known.all()
    assert _is_tracked_well(view, poses, task)
    for lost in (slice(12, 15), slice(-4, None), slice(0, 4)):
        some = poses.copy()
        some.known[lost] = False
        assert not _is_tracked_well(view, some, task)
    turned = poses.copy()
    turned.rotation[FRAMES // 2 :] = turned.rotation[FRAMES // 2 :][:, [1, 2, 0]]
    assert not _is_tracked_well(view, turned, task)


def test_a_first_radius_with_which_no_initial_pose_is_found_is_discarded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rounded_corners, "_radius_from_pictures", lambda *_: (CornerRadius(5e-3, 0.5e-3), True))
    tested, given = sharp_tracked(CornerRounding.TESTED), sharp_tracked(CornerRounding.GIVEN)
    assert tested.corners is None
    assert np.array_equal(tested.track.position_m, given.track.position_m, equal_nan=True)


def test_flights_exclude_corners_that_a_codec_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures alone may take smeared edges for bevels; a die so rounded would fall at another distance."""
    monkeypatch.setattr(rounded_corners, "_radius_from_pictures", lambda *_: (CornerRadius(0.5e-3, 0.1e-3), True))
    monkeypatch.setattr(rounded_corners, "_radius_trials", lambda *_: pytest.fail("tracked with rounded corners"))
    assert sharp_tracked(CornerRounding.TESTED).corners is None


@pytest.mark.parametrize(
    ("contacts", "found_px", "sigma_px", "clear", "unclear"),
    [
        (("vertex",), 0.1, 0.02, False, False), (("vertex", "unresolved"), 0.1, 0.02, False, False),
        (("unresolved",), 0.1, 0.02, True, False), ((), 0.0, 0.02, True, False), (("vertex",), 0.1, 0.3, True, False),
        (("vertex",), -0.4, 0.02, True, True), (("vertex",), -0.9, 0.02, True, True), (("vertex",), -0.4, 0.1, True, False),
        (("apart",), 0.1, 0.02, True, False), (("apart",), -0.9, 0.02, True, False),
    ],
)  # fmt: skip
def test_flights_show_a_radius_where_a_corner_touches(
    monkeypatch: pytest.MonkeyPatch,
    contacts: tuple[str, ...],
    found_px: float,
    sigma_px: float,
    clear: bool,
    unclear: bool,
) -> None:
    """Beside a radius that would move the contour by a pixel; whether the die may be rounded if pictures show that clearly, and
    if they do not. A die whose contour lies between the two is rounded by less. Flights that turn at a corner apart from the
    table show nothing."""
    impacts = [SimpleNamespace(contact="vertex" if contact == "apart" else contact) for contact in contacts]
    links = tuple(SimpleNamespace(impact=object() if contact == "vertex" else None) for contact in contacts)
    chain = SimpleNamespace(shared=np.array([found_px]), contour_sigma_px=sigma_px, links=links)
    measured = SimpleNamespace(throw=SimpleNamespace(impacts=impacts), chain=chain)
    monkeypatch.setattr(rounded_corners, "measure", lambda *_: measured)
    monkeypatch.setattr(rounded_corners, "contour_sigma_px", lambda *_: 1.0)
    source = FrameSource([ArrayClip(np.zeros((8, 4, 4), np.uint8), np.arange(8) / FPS, 8)])
    for is_clear, may_be_rounded in ((True, clear), (False, unclear)):
        found = rounded_corners._flies_as_rounded(STUDIO.view(CUBE), ClipPoses.empty(8), source, 1e-3, is_clear)
        assert found is may_be_rounded


@pytest.mark.parametrize(
    ("frames", "borne_out", "gain", "better"),
    [
        (100, False, 0.1, True), (99, False, 0.1, False), (96, True, 0.1, True), (94, True, 0.1, False),
        (120, True, -0.1, False),
    ],
)  # fmt: skip
def test_a_radius_with_which_the_die_is_lost_or_drawn_worse_is_discarded(
    monkeypatch: pytest.MonkeyPatch, frames: int, borne_out: bool, gain: float, better: bool
) -> None:
    sharp, rounded = ClipPoses.empty(120), ClipPoses.empty(120)
    sharp.known[:100] = True
    rounded.known[:frames] = True
    view, radius = STUDIO.view(CUBE), CornerRadius(1e-3, 1e-4)
    trial = rounded_corners._Trial(1e-3, view, rounded, borne_out, radius)
    found = {
        "_track_sharp_or_round": (view, sharp), "_radius_from_pictures": (radius, True),
        "_flies_as_rounded": True, "_radius_trials": [trial], "surface_gain_over_sharp": None, "gain_over_sharp": (gain, 0.01),
    }  # fmt: skip
    for name, value in found.items():
        monkeypatch.setattr(rounded_corners, name, lambda *_, value=value: value)
    monkeypatch.setattr(rounded_corners, "find_where_lost", lambda view, task, poses: poses)
    source = FrameSource([ArrayClip(np.zeros((120, 4, 4), np.uint8), np.arange(120) / FPS, 8)])
    task = TrackingTask(source, np.zeros(120, bool), None, lambda frame: None)
    _, poses, corners = rounded_corners.track_rounded(view, task, CornerRounding.TESTED)
    assert (poses is rounded, corners is radius) == (better, better)
    assert better or (poses is sharp and corners is None)


@pytest.mark.parametrize("is_rounded_die", [False, True])
def test_the_pictures_tell_which_corners_a_die_has_at_the_poses_of_each(is_rounded_die: bool) -> None:
    radius_m = 8.0 / PX_PER_M
    rounded = replace(CUBE, corner_radius_m=radius_m)
    draw = (lambda s, rng: photograph_rounded(STUDIO, rounded, s, rng)) if is_rounded_die else (
        lambda s, rng: photograph(STUDIO, CUBE, s, rng)
    )  # fmt: skip
    frames = sampled(draw, FEW)
    gain, sigma = gain_over_sharp(STUDIO.view(CUBE), radius_m, frames, frames)
    assert (gain > 3.0 * sigma) is is_rounded_die
    assert (gain < -3.0 * sigma) is not is_rounded_die
