"""Laws of a track made from a clip: the truth lies within its standard errors, and frames without a die have no pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, falling_cube, fast_cube, film, photograph, pips, studio
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.model.rotations import (
    quat_conjugate,
    quat_from_matrix,
    quat_multiply,
    rotation_between,
)
from diethrow.model.throw.motion import Flight, State, Throw
from diethrow.model.world import GRAVITY_M_S2
from diethrow.tracking.footage.background import estimate_background
from diethrow.tracking.footage.frame_blocks import FrameSource
from diethrow.tracking.frame_to_frame.frame_tracker import FrameTracker
from diethrow.tracking.frame_to_frame.impact_trials import widest_sigma
from diethrow.tracking.frame_to_frame.motion_filter import predict_motion
from diethrow.tracking.picture import PixelNoise
from diethrow.tracking.picture.view import make_view, share_in_view
from diethrow.tracking.pose.clip_poses import ClipPoses, longest_stride
from diethrow.tracking.pose.refine import pose_state, refine_pose
from diethrow.tracking.sequence.initialisation import find_initial_pose
from diethrow.tracking.sequence.tracker import ClipFacts, NoDieError, track_clip
from diethrow.tracking.throw.flight_segmentation import decimation_factor
from diethrow.tracking.throw.measurement import measure_throw
from diethrow.tracking.throw.smoothing import smooth
from diethrow.tracking.track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]

ROOM = replace(studio(), noise_grey=2.0, shadow=0.4)
CUBE = DICE["cube"]
FRAMES = 64


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
    """The falling cube's clip, its track, and the progress that was reported."""
    clip = film(ROOM, CUBE, falling_cube(FRAMES / FPS), FRAMES, bit_depth=bit_depth)
    said: list[tuple[int, int]] = []
    table = np.rint(ROOM.table * np.float32(2.0 ** (bit_depth - 8)))
    track = track_clip(
        clip, ROOM.camera, CUBE, background=table, progress=lambda done, total: said.append((done, total))
    ).track
    return clip, track, said


def errors_of(track: Track, throw: Throw | Landing) -> Array:
    """(n, 6) true minus tracked, under the labelling of the plain die that the track chose on its first frame."""
    positions, quaternions = throw.poses(track.time_s)
    first = int(np.flatnonzero(track.tracked)[0])
    alike = quat_multiply(quaternions[first], quat_from_matrix(ROOM.view(CUBE).symmetries))
    chosen = int(np.argmax(np.abs(alike @ track.quaternion[first])))
    relabelled = quat_multiply(quaternions, quat_multiply(quat_conjugate(quaternions[first]), alike[chosen]))
    turns = np.full((len(track), 3), np.nan)
    turns[track.tracked] = rotation_between(track.quaternion[track.tracked], relabelled[track.tracked])
    return np.concatenate([positions - track.position_m, turns], axis=1)


@pytest.mark.parametrize("bit_depth", [8, 12])
def test_a_bouncing_cube_is_tracked_on_every_frame(bit_depth: int) -> None:
    _, track, _ = bouncing(bit_depth)
    assert (track.status == TRACKED).all()
    errors = errors_of(track, falling_cube(FRAMES / FPS))
    rotated = np.degrees(np.linalg.norm(errors[:, 3:], axis=1))
    across_m = np.linalg.norm(errors[:, :3] @ ROOM.camera.rotation[:2].T, axis=1)
    # 80 px across, contrast 60 and noise 2 grey levels: the pixels hold 0.04 degrees and 3 µm.
    assert np.median(rotated) < 0.08
    assert np.median(across_m) < 8e-6
    # One frame shows little more than a single face; its standard error is a third of a degree.
    assert rotated.max() < 0.9
    assert across_m.max() < 8e-5
    nees = np.array([e @ np.linalg.solve(C, e) for e, C in zip(errors, track.covariance, strict=True)])
    # The median of chi-square with six numbers is 5.35; its standard deviation over 64 frames is 0.5, and the shadow of this die
    # and the rounding to whole grey levels are not in the model. A smaller value is expected: every covariance contains
    # the errors common to all frames of a clip, and this clip has none.
    assert 1.5 < np.median(nees) < 9.0


ROLLING = replace(ROOM, readout_s=0.95 / FPS)
"""Almost the whole interval between two frames. The cube passes 60 rows above and below the middle one."""


@cache
def rolling_clip() -> ArrayClip:
    return film(ROLLING, CUBE, fast_cube(FRAMES), FRAMES)


def tracked_with(readout_s: float, clip: ArrayClip) -> tuple[Array, Track]:
    """(n, 6) errors of a track with a readout time, and the track."""
    facts = ClipFacts(readout_s=readout_s)
    track = track_clip(clip, ROOM.camera, CUBE, background=np.rint(ROOM.table), facts=facts).track
    return errors_of(track, fast_cube(FRAMES)), track


def test_a_rolling_shutter_is_tracked_as_accurately_as_a_global_one() -> None:
    errors, track = tracked_with(ROLLING.readout_s, rolling_clip())
    flat, _ = tracked_with(0.0, film(ROOM, CUBE, fast_cube(FRAMES), FRAMES))
    assert (track.status == TRACKED).all()
    assert np.array_equal(track.time_s, np.arange(FRAMES) / FPS)
    for numbers in (slice(0, 3), slice(3, 6)):
        rolling_error, global_error = (float(np.median(np.linalg.norm(e[:, numbers], axis=1))) for e in (errors, flat))
        # Other noise on other pixels, and rows interpolated in the rendering.
        assert rolling_error < 1.5 * global_error
    nees = np.array([e @ np.linalg.solve(C, e) for e, C in zip(errors, track.covariance, strict=True)])
    assert np.median(nees) < 9.0


def test_a_film_upside_down_with_its_rows_in_reverse_order_gives_the_same_poses() -> None:
    clip, camera = rolling_clip(), ROOM.camera
    half_turn = np.diag([-1.0, -1.0, 1.0])
    matrix = camera.matrix.copy()
    matrix[:2, 2] = np.array([camera.width_px, camera.height_px]) - 1.0 - matrix[:2, 2]
    turned = replace(
        camera, matrix=matrix, rotation=half_turn @ camera.rotation, translation_m=half_turn @ camera.translation_m
    )
    upright, _ = tracked_with(ROLLING.readout_s, clip)
    track = track_clip(
        replace(clip, array=clip.array[:, ::-1, ::-1].copy()),
        turned,
        CUBE,
        background=np.rint(ROOM.table)[::-1, ::-1].copy(),
        facts=ClipFacts(readout_s=-ROLLING.readout_s),
    ).track
    errors = errors_of(track, fast_cube(FRAMES))
    assert (track.status == TRACKED).all()
    for numbers in (slice(0, 3), slice(3, 6)):
        error, usual = (float(np.median(np.linalg.norm(e[:, numbers], axis=1))) for e in (errors, upright))
        # The same pixels; only candidates of initial poses and the order of sums differ.
        assert error < 1.1 * usual


def test_without_its_readout_time_a_rolling_shutter_is_tracked_worse() -> None:
    known, _ = tracked_with(ROLLING.readout_s, rolling_clip())
    unknown, _ = tracked_with(0.0, rolling_clip())
    with_key, without = (np.nanmedian(np.linalg.norm(e[:, 3:], axis=1)) for e in (known, unknown))
    assert without > 2.0 * with_key


TIMES_FASTER = 6
"""Of a film that shows a throw on six frames for every usual one."""


@pytest.fixture
def few_are_plenty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Lower the number of frames from which frames are skipped, because rendering thousands takes long."""
    monkeypatch.setattr("diethrow.tracking.pose.clip_poses.ENOUGH_FRAMES", FRAMES)
    monkeypatch.setattr("diethrow.tracking.throw.flight_segmentation.ENOUGH_FRAMES", FRAMES)


@pytest.mark.usefixtures("few_are_plenty")
def test_frames_of_a_film_far_faster_than_the_die_are_skipped_except_at_impacts() -> None:
    """The tracker skips frames in flight, and none after an impact until the flight is determined. The refinement then has a pose
    for every frame, as accurate as on a usual film."""
    count, fps, throw = TIMES_FASTER * FRAMES, TIMES_FASTER * FPS, falling_cube(FRAMES / FPS)
    clip, table = film(ROOM, CUBE, throw, count, fps=fps), np.rint(ROOM.table)
    source, view = FrameSource([clip]), make_view([ROOM.camera], CUBE, [table], PixelNoise(2.0), None, 0.7)
    initial = find_initial_pose(view, source, np.zeros(count, bool))
    assert initial is not None
    tracker, seen = initial
    tracker.track_to_end(source, seen, lambda frame: None, all_frames=False)
    (bounce,) = throw.bounces
    struck = int(np.ceil(bounce.time_s * fps))
    assert seen.frame_stride > 1
    assert seen.known[struck + 4 : struck + 20].all()
    assert seen.known.mean() < 0.7
    rows = np.flatnonzero(seen.known)
    assert (np.diff(rows) <= longest_stride(count)).all()
    filled = seen.interpolated()
    assert filled.known[rows[0] : rows[-1] + 1].all()
    off_m = np.linalg.norm(
        filled.position_m[rows[0] : rows[-1]] - throw.poses(clip.times_s[rows[0] : rows[-1]])[0], axis=1
    )
    # Half of the way is where a line meets the arc: the bounce alone bends it. Depth is known to some tenths of a millimetre.
    assert np.quantile(off_m, 0.95) < 1e-3

    track = track_clip(clip, ROOM.camera, CUBE, background=table).track
    assert (track.status == TRACKED).all()
    rotated = np.degrees(np.linalg.norm(errors_of(track, throw)[:, 3:], axis=1))
    assert np.median(rotated) < 0.08
    assert np.quantile(rotated, 0.95) < 0.3
    (found,) = measure_throw(track, CUBE, ROOM.camera).impacts
    assert abs(found.time_s - bounce.time_s) < 0.02 / FPS


@dataclass(frozen=True)
class Landing:
    """A die that flies and, from one instant on, lies still."""

    flight: Flight
    lands_s: float

    def at(self, time_s: float) -> State:
        return self.flight.at(min(time_s, self.lands_s))

    def poses(self, times_s: Array) -> tuple[Array, Array]:
        return self.flight.poses(np.minimum(times_s, self.lands_s))


@pytest.mark.usefixtures("few_are_plenty")
def test_a_spinning_die_that_lands_on_such_a_film_keeps_its_labelling_on_every_frame() -> None:
    """Most frames are refined along the flights that the marks of other frames determine. The last flight ends where the die
    lies; continued, it would turn by a right angle in 20 ms, and so would the faces on frames refined along it."""
    fps, lands_s, fall_m_s = TIMES_FASTER * FPS, 0.014, np.array([0.05, 0.05, -0.5])
    height_m = CUBE.solid.inradius + 0.5 * lands_s + 0.5 * GRAVITY_M_S2 * lands_s**2
    upright, spin = np.array([1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 80.0])
    release = State(0.0, np.array([0.0, 0.0, height_m]), upright, fall_m_s, spin)
    throw = Landing(Flight(release, np.inf), lands_s)
    clip = film(ROOM, CUBE, throw, 300, fps=fps, spots=pips(CUBE))
    reports: list[tuple[int, int]] = []
    track = track_clip(
        clip,
        ROOM.camera,
        CUBE,
        background=np.rint(ROOM.table),
        progress=lambda done, total: reports.append((done, total)),
    ).track
    assert track.shared_covariance is not None, "marks were used"
    assert (track.status == TRACKED).all()
    rotated = np.degrees(np.linalg.norm(errors_of(track, throw)[:, 3:], axis=1))
    assert np.median(rotated) < 0.15
    assert rotated.max() < 1.0
    # Progress is reported until the last pass is over.
    assert sum(done < total for done, total in reports[-5:]) >= 2


@pytest.mark.usefixtures("few_are_plenty")
def test_an_excluded_frame_stays_lost_although_no_flight_passes_over_it() -> None:
    """Frames that tracking skipped are refined from interpolated poses; an excluded one is not."""
    rotated, still_m_s = np.array([0.9, 0.0, 0.0, 0.4]) / np.hypot(0.9, 0.4), np.zeros(3)
    lies = State(0.0, np.array([0.0, 0.0, CUBE.solid.inradius]), rotated, still_m_s, still_m_s)
    still = np.rint(photograph(ROOM, CUBE, lies, np.random.default_rng(1), pips(CUBE))).astype(np.uint8)
    rng = np.random.default_rng(2)
    frames = np.clip(still + rng.integers(-2, 3, (3 * FRAMES, *still.shape)), 0, 255).astype(np.uint8)
    clip = ArrayClip(frames, np.arange(len(frames)) / FPS, 8)
    track = track_clip(
        clip, ROOM.camera, CUBE, background=np.rint(ROOM.table), facts=ClipFacts(excluded=[(101, 102)])
    ).track
    assert track.status[101] == LOST
    assert (np.delete(track.status, 101) == TRACKED).all()


def test_the_decimation_factor_ignores_a_long_rest() -> None:
    """No frame of a flight at usual speed is left out because of a long rest behind it; frames of slow motion are."""
    usual = Flight(falling_cube(FRAMES / FPS).flights[0].start, np.inf)
    times, slow = np.arange(FRAMES + 40_000) / FPS, np.arange(4000) / (40.0 * FPS)
    assert decimation_factor(tracked(times, *usual.poses(np.minimum(times, FRAMES / FPS))), CUBE) == 1
    assert decimation_factor(tracked(slow, *usual.poses(slow)), CUBE) > 3


def tracked(times_s: Array, position_m: Array, quaternion: Array) -> Track:
    count = len(times_s)
    covariance = np.tile(1e-9 * np.eye(6), (count, 1, 1))
    return Track(np.arange(count), times_s, position_m, quaternion, covariance, np.full(count, TRACKED))


def behind_a_bar() -> tuple[ArrayClip, Array, slice]:
    """The falling cube with a bar before its right side all the time, a fifth of its width; the table with the bar, and
    the bar's columns."""
    clip, table = film(ROOM, CUBE, falling_cube(FRAMES / FPS), FRAMES), np.rint(ROOM.table)
    middle = ROOM.camera.project(falling_cube(FRAMES / FPS).at(0.5 * FRAMES / FPS).position_m[None])[0, 0]
    bar = slice(int(middle) + 8, int(middle) + 24)
    frames, noise = (
        clip.array.copy(),
        np.random.default_rng(3).normal(scale=ROOM.noise_grey, size=(FRAMES, len(table), 16)),
    )
    frames[:, :, bar] = np.clip(np.rint(30.0 + noise), 0, 255)
    table[:, bar] = 30.0
    return ArrayClip(frames, clip.times_s, 8), table, bar


def test_a_bar_in_front_of_the_die_does_not_bias_its_poses() -> None:
    clip, table, _ = behind_a_bar()
    track = track_clip(clip, ROOM.camera, CUBE, background=table).track
    rotated = np.degrees(np.linalg.norm(errors_of(track, falling_cube(FRAMES / FPS))[track.tracked, 3:], axis=1))
    states = [falling_cube(FRAMES / FPS).at(float(t)) for t in track.time_s]
    whole = np.array([share_in_view(ROOM.view(CUBE), s.position_m, s.rotation) == 1.0 for s in states])
    assert track.tracked[whole].mean() > 0.9
    # Less of the contour is seen, and what is left of it says as much as before: usual frames are off by 0.1 degrees, and
    # none by what a pose drawn to the bar would be.
    assert np.median(rotated) < 0.3
    assert rotated.max() < 3.0


def test_an_occluder_is_found_and_nothing_else() -> None:
    clip, table, bar = behind_a_bar()
    view = replace(ROOM, table=np.asarray(table, np.float32)).view(CUBE)
    state = falling_cube(FRAMES / FPS).at(0.0)
    pose = refine_pose(view, np.asarray(clip.frame(0), np.float32), pose_state(state.position_m, state.rotation))
    tracker = FrameTracker.from_pose(view, pose, clip.times_s, 0, np.zeros(FRAMES, bool))
    tracker.track(clip.array[:30, None], clip.times_s, 0, ClipPoses.empty(FRAMES))
    blank = np.isnan(tracker.view.backgrounds[0])
    columns = np.flatnonzero(blank.any(0))
    # Two pixels on either side go with it, where bar and die mix.
    assert columns.min() >= bar.start - 2
    assert columns.max() < bar.stop + 2
    # The die is eighty pixels tall, and most of what it passed behind is known.
    assert blank[:, (bar.start + bar.stop) // 2].sum() > 40
    assert not np.isnan(view.backgrounds).any()


def test_a_motion_predicted_back_to_where_it_was_known_has_no_negative_variance() -> None:
    rng, below = np.random.default_rng(20261122), 0
    for _ in range(100):
        P, A = np.zeros((12, 12)), rng.standard_normal((6, 6))
        P[6:, 6:] = A @ A.T
        motion, rotation = np.concatenate([rng.standard_normal(6), 10.0 * rng.standard_normal(3)]), np.eye(3)
        for dt in (1e-3, -3e-4, -7e-4):
            rotation = predict_motion(motion, rotation, P, dt, GRAVITY_M_S2)
        below += bool(np.diag(P)[:3].max() < 0.0)
        # A millisecond of some metres a second, to the root of rounding.
        assert 0.0 <= widest_sigma(P, 0) < 1e-3 * 1e-7
    assert below  # rounding did leave less than nothing


def test_twelve_bits_give_the_track_of_eight() -> None:
    plain, deep = bouncing(8)[1], bouncing(12)[1]
    between = np.linalg.norm(plain.position_m - deep.position_m, axis=1)
    # The same noise on both: they differ by the rounding, 0.3 of a grey level against noise of 2.
    assert np.median(between) < 2e-5
    assert len(measure_throw(deep, CUBE).impacts) == 1


def test_the_impact_of_a_filmed_cube_is_found_to_a_small_part_of_a_frame() -> None:
    true, throw = falling_cube(FRAMES / FPS), measure_throw(bouncing(8)[1], CUBE)
    assert [i.contact for i in throw.impacts] == ["vertex"]
    found, impact = throw.impacts[0], true.impacts[0]
    assert abs(found.time_s - impact.time_s) < 0.05 / FPS
    assert abs(found.time_s - impact.time_s) < 4.0 * found.sigma_time_s
    # One interval of 95 % proves little; twice its width proves a blunder.
    middle, half = (found.chi_low + found.chi_high) / 2.0, (found.chi_high - found.chi_low) / 2.0
    assert abs(0.6 - middle) < 2.0 * half
    assert half < 0.02


def test_progress_only_grows_and_ends_at_the_total() -> None:
    said = bouncing(8)[2]
    done = [d for d, _ in said]
    assert {total for _, total in said} == {said[0][1]}
    assert all(a <= b for a, b in pairwise(done))
    assert said[-1][0] >= said[-1][1] - 1


@cache
def crossing() -> tuple[ArrayClip, Track]:
    clip = film(replace(ROOM, shadow=0.0), CUBE, crossing_cube(), FRAMES)
    return clip, track_clip(clip, ROOM.camera, CUBE).track


def shares(track: Track) -> Array:
    """Share of the true die's corners in the picture, on every frame."""
    throw = crossing_cube()
    states = [throw.at(float(t)) for t in track.time_s]
    return np.array([share_in_view(ROOM.view(CUBE), state.position_m, state.rotation) for state in states])


def test_a_die_that_comes_and_goes_is_absent_before_and_after() -> None:
    track, share = crossing()[1], shares(crossing()[1])
    # A frame at either end, where a corner is about to show, may be called either way.
    assert (track.status[1:-1][share[1:-1] == 0.0] != TRACKED).all()
    assert np.sum((track.status == ABSENT) != (share == 0.0)) <= 2
    assert set(track.status[(share > 0.0) & (share < 1.0)]) <= {TRACKED, LOST, ABSENT}


def test_a_die_wholly_in_the_picture_is_tracked_with_no_background_given() -> None:
    track, share = crossing()[1], shares(crossing()[1])
    assert (track.status[share == 1.0] == TRACKED).all()
    rotated = np.degrees(np.linalg.norm(errors_of(track, crossing_cube())[share == 1.0, 3:], axis=1))
    assert np.median(rotated) < 0.1
    assert rotated.max() < 1.0


def test_frames_without_a_pose_hold_no_numbers() -> None:
    track = crossing()[1]
    unknown = ~track.tracked
    assert unknown.any()
    for values in (track.position_m, track.quaternion, track.covariance):
        assert np.isnan(values[unknown]).all()
        assert np.isfinite(values[track.tracked]).all()


def test_a_flight_through_the_picture_has_no_impact() -> None:
    assert measure_throw(crossing()[1], CUBE).impacts == ()


def test_neighbouring_quaternions_never_flip() -> None:
    for track in (bouncing(8)[1], crossing()[1]):
        q = track.quaternion[track.tracked]
        assert ((q[1:] * q[:-1]).sum(1) > 0.0).all()
        np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)


def test_a_smoothed_track_is_nearer_to_the_truth() -> None:
    track = bouncing(8)[1]
    smoothed = smooth(track, measure_throw(track, CUBE))
    before, after = (np.linalg.norm(errors_of(t, falling_cube(FRAMES / FPS))[:, 3:], axis=1) for t in (track, smoothed))
    # Thirty frames share twelve numbers: the errors shrink by the square root of five if they are independent, and the
    # noise of the pixels is.
    assert np.median(after) < 0.7 * np.median(before)


def test_a_clip_of_the_empty_table_holds_no_die() -> None:
    rng = np.random.default_rng(3)
    pictures = [photograph(ROOM, CUBE, None, rng) for _ in range(20)]
    clip = ArrayClip(np.rint(pictures).astype(np.uint8), np.arange(20) / FPS)
    with pytest.raises(NoDieError, match="no die was found in 20 frames"):
        track_clip(clip, ROOM.camera, CUBE, background=ROOM.table)


def test_camera_background_and_clip_must_be_of_one_size() -> None:
    clip = ArrayClip(np.zeros((3, 200, 200), np.uint8), np.arange(3) / FPS)
    narrow = replace(ROOM.camera, width_px=180)
    with pytest.raises(ValueError, match="the clip is 200 × 200 pixels and the camera 180 × 200"):
        track_clip(clip, narrow, CUBE)
    with pytest.raises(ValueError, match="the background is 200 × 190 pixels and the clip 200 × 200"):
        track_clip(clip, ROOM.camera, CUBE, background=ROOM.table[:190])


def test_the_background_is_what_most_frames_agree_on() -> None:
    clip = crossing()[0]
    estimated = estimate_background(clip)
    assert estimated.shape == (clip.height_px, clip.width_px)
    # The median of 60 frames with noise 2 has an error of 0.3; where the die passes, of up to 0.5 and a shift of a
    # tenth of the noise for each tenth of the frames that it covers.
    assert np.sqrt(np.mean((estimated - ROOM.table) ** 2)) < 1.0
    assert np.abs(estimated - ROOM.table).max() < 6.0
