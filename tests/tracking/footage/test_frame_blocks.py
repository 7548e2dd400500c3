"""Laws of the reel: every frame of every camera, once, in order, whatever the way it is asked for."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_photron
from replay_records import ArrayClip

from diethrow.tracking.footage.clip import open_clip
from diethrow.tracking.footage.frame_blocks import Reel
from diethrow.tracking.footage.reader import Frame

COUNT = 150


def clip_of(seed: int, count: int = COUNT, shape: tuple[int, int] = (12, 16)) -> ArrayClip:
    frames = np.random.default_rng(seed).integers(0, 256, (count, *shape), dtype=np.uint8)
    return ArrayClip(frames, np.arange(count) / 1000.0, 8)


class Counted(ArrayClip):
    """A clip that counts the frames it hands out."""

    handed_out = 0

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        for frame in super().frames(start, stop):
            self.handed_out += 1
            yield frame


class Broken(ArrayClip):
    """A clip whose file ends early."""

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        for k, frame in enumerate(super().frames(start, stop), start):
            if k == 100:
                raise OSError("the file ends at frame 100")
            yield frame


def readers_alive() -> int:
    return sum(thread.name.startswith("Thread-") and thread.is_alive() for thread in threading.enumerate())


def test_blocks_hold_every_frame_once_and_in_order() -> None:
    clip = clip_of(1)
    blocks = list(Reel([clip]).blocks())
    assert len(blocks) > 1
    np.testing.assert_array_equal([first for first, _ in blocks], np.cumsum([0, *(len(f) for _, f in blocks[:-1])]))
    np.testing.assert_array_equal(np.concatenate([f for _, f in blocks])[:, 0], np.array(list(clip.frames())))


def test_a_block_that_is_held_is_not_written_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.tracking.footage.frame_blocks.KEPT_BYTES", 0)
    clip = clip_of(11, 1000)
    reel, plain = Reel([clip]), np.array(list(clip.frames()))
    held = [(first, frames[3:5, 0]) for first, frames in reel.blocks()]
    for first, frames in reel.blocks(37):
        np.testing.assert_array_equal(frames[:, 0], plain[first : first + len(frames)])
    for first, frames in held:
        np.testing.assert_array_equal(frames, plain[first + 3 : first + 5])


def test_backwards_the_last_block_comes_first() -> None:
    reel = Reel([clip_of(2)])
    back = list(reel.blocks_backwards(100))
    assert back[0][0] + len(back[0][1]) == 100
    forwards = np.concatenate([f for _, f in reel.blocks(0, 100)])
    np.testing.assert_array_equal(np.concatenate([f for _, f in back[::-1]]), forwards)


def test_single_frames_may_be_asked_for_in_any_order() -> None:
    clip = clip_of(3)
    reel, wanted = Reel([clip]), np.array(list(clip.frames()))
    for k in np.random.default_rng(4).integers(0, COUNT, 60):
        np.testing.assert_array_equal(reel.frame(int(k))[0], wanted[k])


def test_a_short_clip_is_decoded_once_whatever_is_asked_of_it() -> None:
    plain = np.array(list(clip_of(9).frames()))
    clip = Counted(plain, np.arange(COUNT) / 1000.0, 8)
    reel = Reel([clip])
    for k in (0, 5, 70):
        np.testing.assert_array_equal(reel.frame(k)[0], plain[k])
    before = clip.handed_out
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate([f for _, f in reel.blocks()])[:, 0], plain)
        np.testing.assert_array_equal(next(reel.blocks_backwards(90))[1][:, 0], plain[90 - 64 : 90])
    assert reel.frame(COUNT - 1)[0].tolist() == plain[-1].tolist()
    assert clip.handed_out == before + COUNT


def test_frames_of_two_cameras_are_stacked_and_the_smaller_is_padded() -> None:
    large, small = clip_of(5), clip_of(6, shape=(8, 10))
    _, frames = next(iter(Reel([large, small]).blocks()))
    assert frames.shape[1:] == (2, 12, 16)
    np.testing.assert_array_equal(frames[7, 1, :8, :10], small.frame(7))
    assert not frames[7, 1, 8:].any()


def test_boxes_hold_what_the_frames_have_there_and_empty_ones_are_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("diethrow.tracking.footage.frame_blocks.KEPT_BYTES", 0)
    levels = noisy_frames(COUNT, bits=12)
    clip = open_clip(write_photron(tmp_path / "x.cihx", levels, stored_bits=12))
    rng = np.random.default_rng(1)
    corner, wanted = rng.integers(0, 6, (COUNT, 1, 2)), rng.random(COUNT) < 0.3
    boxes = np.concatenate([corner, corner + 7 * wanted[:, None, None]], axis=-1)
    shown = []
    for rows, frames in Reel([clip]).looked_at(boxes):
        shown += rows.tolist()
        for row, frame in zip(rows, frames[:, 0], strict=True):
            x0, y0, x1, y1 = boxes[row, 0]
            np.testing.assert_array_equal(frame[y0:y1, x0:x1], levels[row, y0:y1, x0:x1])
    assert shown == np.flatnonzero(wanted).tolist()


def test_a_clip_that_cannot_fill_frames_shows_those_without_a_box_as_well(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.tracking.footage.frame_blocks.KEPT_BYTES", 0)
    clip, boxes = clip_of(12, 1000), np.zeros((1000, 1, 4), np.int64)
    boxes[::9, 0, 2:] = 5
    parts = list(Reel([clip]).looked_at(boxes))
    np.testing.assert_array_equal(np.concatenate([rows for rows, _ in parts]), np.arange(1000))
    plain = np.array(list(clip.frames()))
    for rows, frames in parts:
        np.testing.assert_array_equal(frames[:, 0], plain[rows])


def test_clips_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="150, 149 frames: synchronised clips have as many"):
        Reel([clip_of(1), clip_of(1, COUNT - 1)])


def test_what_breaks_while_reading_ahead_reaches_whoever_reads() -> None:
    whole = clip_of(7)
    broken = Broken(np.array(list(whole.frames())), whole.times_s, 8)
    blocks = Reel([broken]).blocks()
    first, frames = next(blocks)
    assert first + len(frames) <= 100
    with pytest.raises(OSError, match="ends at frame 100"):
        list(blocks)


def test_a_reader_that_is_left_stops() -> None:
    before = readers_alive()
    blocks = Reel([clip_of(8, 2000)]).blocks()
    next(blocks)
    blocks.close()  # type: ignore[attr-defined]
    assert readers_alive() == before
