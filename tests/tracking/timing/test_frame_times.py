"""Clips with missing, doubled and frozen frames get the times at which their pictures were taken."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from footage_of_throws import DICE, FPS, falling_cube, film, studio
from numpy.typing import NDArray
from replay_records import ArrayClip

from diethrow.tracking.check.clip_quality import FrameTiming
from diethrow.tracking.check.verdicts import Verdict, _timing
from diethrow.tracking.quality import FAST
from diethrow.tracking.sequence import ClipFacts
from diethrow.tracking.timing import (
    ClipClock,
    FaultKind,
    TimedTracking,
    Timing,
    clip_at_times,
    find_frame_times,
    track_clip_in_time,
)

Rows = NDArray[np.int64]
ROOM = replace(studio(), noise_grey=2.0)
CUBE = DICE["cube"]
FRAMES = 64
BOUNCE = 36
"""Frame before the bounce of the filmed cube."""


@cache
def whole() -> ArrayClip:
    return film(ROOM, CUBE, falling_cube(FRAMES / FPS), FRAMES)


def holding(kept: Rows) -> ArrayClip:
    """The clip of a file that holds these frames, timed one after the other."""
    return ArrayClip(whole().array[kept], np.arange(len(kept)) / FPS)


def tracked(clip: ArrayClip, timing: Timing = "corrected") -> TimedTracking:
    return track_clip_in_time(
        [clip], [ROOM.camera], CUBE, background=np.rint(ROOM.table).astype(np.float32), facts=ClipFacts(1e-4),
        quality=FAST, clock=ClipClock(timing),
    )  # fmt: skip


def test_a_whole_clip_keeps_its_times() -> None:
    timed = tracked(whole())
    assert timed.times.faults == ()
    assert np.array_equal(timed.times.times_s, whole().times_s)
    assert np.array_equal(timed.tracked.track.time_s, whole().times_s)


def test_missing_doubled_and_frozen_frames_are_named_and_their_times_are_the_true_ones() -> None:
    # Frame 12 is missing, 22 is there twice, and 29 stands in the place of 30.
    kept = np.array([*range(12), *range(13, 23), *range(22, 30), 29, *range(31, FRAMES)])
    timed = tracked(holding(kept))
    missing, doubled, frozen = timed.times.faults
    assert (missing.kind, missing.before, missing.after, missing.intervals) == (FaultKind.MISSING, 11, 12, 1)
    assert (doubled.kind, doubled.repeated, doubled.intervals) == (FaultKind.DOUBLED, (22,), -1)
    assert (frozen.kind, frozen.repeated, frozen.intervals) == (FaultKind.FROZEN, (30,), 0)
    own = np.setdiff1d(np.arange(len(kept)), [22, 30])
    assert timed.times.times_s[own] == pytest.approx(kept[own] / FPS, abs=1e-9)
    assert (np.diff(timed.times.times_s) > 0).all()
    track = timed.tracked.track
    assert np.array_equal(track.time_s, timed.times.times_s)
    assert not track.tracked[[22, 30]].any()
    text = " ".join(timed.times.notices)
    for words in ("1 frame is missing between frames 11 and 12", "frame 22 is a copy", "frame 30 shows an old picture"):
        assert words in text
    assert [fault.record["kind"] for fault in timed.times.faults] == ["missing", "doubled", "frozen"]


def test_times_as_filmed_are_left_and_judged_bad() -> None:
    clip = holding(np.delete(np.arange(FRAMES), 15))
    timed = tracked(clip, "as-filmed")
    (fault,) = timed.times.faults
    assert fault.is_certain
    assert np.array_equal(timed.tracked.track.time_s, clip.times_s)
    found = _timing(FrameTiming(len(clip), FPS, None, None, None, 0.0, (), timed.times), None)
    assert found.verdict is Verdict.BAD
    assert "1 frame is missing between frames 14 and 15" in found.measured
    corrected = replace(timed.times, corrected=True)
    found = _timing(FrameTiming(len(clip), FPS, None, None, None, 0.0, (), corrected), None)
    assert found.verdict is Verdict.DOUBTFUL
    assert found.values["missing_gaps"] == 1.0


def test_times_that_the_file_states_are_not_corrected() -> None:
    class Stamped(ArrayClip):
        def metadata(self) -> dict[str, object]:
            return {**super().metadata(), "time_stamps": True}

    clip = holding(np.delete(np.arange(FRAMES), 15))
    timed = tracked(Stamped(clip.array, clip.times_s))
    assert [fault.kind for fault in timed.times.faults] == [FaultKind.MISSING]
    assert np.array_equal(timed.tracked.track.time_s, clip.times_s)
    assert "the file states the time of every frame" in timed.times.notices[0]


def test_frames_that_the_border_cuts_are_no_clock() -> None:
    clip = holding(np.delete(np.arange(FRAMES), 12))
    track = tracked(clip, "as-filmed").tracked.track
    assert [fault.before for fault in find_frame_times(track, CUBE, ROOM.camera, clip).faults] == [11]
    cut = int(ROOM.camera.project(track.position_m[16])[1])
    below = replace(ROOM.camera, matrix=ROOM.camera.matrix - [[0, 0, 0], [0, 0, cut], [0, 0, 0]])
    cropped = ArrayClip(clip.array[:, cut:], clip.times_s)
    assert find_frame_times(track, CUBE, replace(below, height_px=clip.array.shape[1] - cut), cropped).faults == ()


def test_a_clip_at_other_times_has_the_same_pictures() -> None:
    times = whole().times_s + np.where(np.arange(FRAMES) > 9, 1.0, 0.0)
    late = clip_at_times(whole(), times)
    assert np.array_equal(late.times_s, times)
    assert np.array_equal(late.frame(11), whole().frame(11))
    assert len(list(late.frames(3, 7))) == 4
    assert clip_at_times(whole(), whole().times_s) is whole()
    with pytest.raises(ValueError, match="increase"):
        clip_at_times(whole(), times[::-1])
