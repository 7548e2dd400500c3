"""Laws of the frame blocks: every frame of every camera is read once and in order, with every reader."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_photron
from replay_records import ArrayClip

from diethrow.tracking.footage.clip import open_clip
from diethrow.tracking.footage.frame_blocks import BLOCKS_AHEAD, FrameSource
from diethrow.tracking.footage.reader import Frame

COUNT = 150


def clip_of(seed: int, count: int = COUNT, shape: tuple[int, int] = (12, 16)) -> ArrayClip:
    frames = np.random.default_rng(seed).integers(0, 256, (count, *shape), dtype=np.uint8)
    return ArrayClip(frames, np.arange(count) / 1000.0, 8)


class Counted(ArrayClip):
    """A clip that counts the frames that are read."""

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


@pytest.fixture
def nothing_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("diethrow.tracking.footage.frame_blocks.KEPT_BYTES", 0)


def test_blocks_hold_every_frame_once_and_in_order() -> None:
    clip = clip_of(1)
    blocks = list(FrameSource([clip]).blocks())
    assert len(blocks) > 1
    np.testing.assert_array_equal(np.concatenate([block.rows for block in blocks]), np.arange(COUNT))
    np.testing.assert_array_equal(np.concatenate([b.frames for b in blocks])[:, 0], np.array(list(clip.frames())))


@pytest.mark.usefixtures("nothing_kept")
def test_a_block_that_is_not_released_is_not_written_again() -> None:
    clip = clip_of(11, 1000)
    source, plain = FrameSource([clip]), np.array(list(clip.frames()))
    held = list(source.blocks())
    for block in source.blocks(37):
        np.testing.assert_array_equal(block.frames[:, 0], plain[block.rows])
    for block in held:
        np.testing.assert_array_equal(block.frames[:, 0], plain[block.rows])


@pytest.mark.usefixtures("nothing_kept")
def test_released_blocks_serve_a_whole_pass_with_the_memory_of_a_few() -> None:
    clip = clip_of(13, 3000)
    source, plain = FrameSource([clip]), np.array(list(clip.frames()))
    places, blocks = set(), 0
    for _ in range(2):
        for block in source.blocks():
            with block:
                np.testing.assert_array_equal(block.frames[:, 0], plain[block.rows])
                places.add(block.frames.__array_interface__["data"][0])
                blocks += 1
    assert blocks > 90
    assert len(places) <= BLOCKS_AHEAD + 2  # besides those that wait: the one in use and the one being read


@pytest.mark.usefixtures("nothing_kept")
def test_a_block_may_be_released_twice_and_is_used_again_once() -> None:
    source = FrameSource([clip_of(14, 1000)])
    block = next(source.blocks())
    block.release()
    with block:
        pass
    two = [next(source.blocks(start)) for start in (0, 100)]
    assert not np.shares_memory(two[0].frames, two[1].frames)


@pytest.mark.usefixtures("nothing_kept")
def test_a_repeated_frame_is_found_though_the_block_before_was_released(tmp_path: Path) -> None:
    levels = noisy_frames(COUNT, bits=12)
    levels[64] = levels[63]  # the first frame of the second block, and the last of the first
    clip = open_clip(write_photron(tmp_path / "x.cihx", levels, stored_bits=12))
    for block in FrameSource([clip]).blocks():
        block.release()
    assert any("(64)" in notice for notice in clip.notices)


@pytest.mark.usefixtures("nothing_kept")
def test_large_frames_that_fill_a_block_each_are_not_taken_for_copies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("diethrow.tracking.footage.frame_blocks.MAX_BLOCK_FRAMES", 1)
    clip = open_clip(write_photron(tmp_path / "x.cihx", noisy_frames(20, bits=12), stored_bits=12))
    for block in FrameSource([clip]).blocks():
        block.release()
    assert not any("copies" in notice for notice in clip.notices)


def test_backwards_the_last_block_comes_first() -> None:
    source, stop = FrameSource([clip_of(2)]), 100
    back = list(source.blocks_backwards(stop))
    assert back[0].rows[-1] + 1 == stop
    np.testing.assert_array_equal(np.concatenate([block.rows for block in back[::-1]]), np.arange(stop))
    forwards = np.concatenate([block.frames for block in source.blocks(0, stop)])
    np.testing.assert_array_equal(np.concatenate([block.frames for block in back[::-1]]), forwards)


def test_single_frames_can_be_read_in_any_order() -> None:
    clip = clip_of(3)
    source, wanted = FrameSource([clip]), np.array(list(clip.frames()))
    for k in np.random.default_rng(4).integers(0, COUNT, 60):
        np.testing.assert_array_equal(source.frame(int(k))[0], wanted[k])


def test_a_short_clip_is_decoded_once_for_all_passes() -> None:
    plain = np.array(list(clip_of(9).frames()))
    clip = Counted(plain, np.arange(COUNT) / 1000.0, 8)
    source = FrameSource([clip])
    for k in (0, 5, 70):
        np.testing.assert_array_equal(source.frame(k)[0], plain[k])
    before = clip.handed_out
    for _ in range(2):
        np.testing.assert_array_equal(np.concatenate([b.frames for b in source.blocks()])[:, 0], plain)
        np.testing.assert_array_equal(next(source.blocks_backwards(90)).frames[:, 0], plain[90 - 64 : 90])
    assert source.frame(COUNT - 1)[0].tolist() == plain[-1].tolist()
    assert clip.handed_out == before + COUNT


def test_frames_of_two_cameras_are_stacked_and_the_smaller_is_padded() -> None:
    large, small = clip_of(5), clip_of(6, shape=(8, 10))
    frames = next(FrameSource([large, small]).blocks()).frames
    assert frames.shape[1:] == (2, 12, 16)
    np.testing.assert_array_equal(frames[7, 1, :8, :10], small.frame(7))
    assert not frames[7, 1, 8:].any()


@pytest.mark.usefixtures("nothing_kept")
def test_boxes_hold_the_pixels_of_their_frames_and_frames_without_one_are_skipped(tmp_path: Path) -> None:
    levels = noisy_frames(COUNT, bits=12)
    clip = open_clip(write_photron(tmp_path / "x.cihx", levels, stored_bits=12))
    rng = np.random.default_rng(1)
    corner, wanted = rng.integers(0, 6, (COUNT, 1, 2)), rng.random(COUNT) < 0.3
    boxes = np.concatenate([corner, corner + 7 * wanted[:, None, None]], axis=-1)
    shown = []
    for block in FrameSource([clip]).blocks_within(boxes):
        shown += block.rows.tolist()
        for row, frame in zip(block.rows, block.frames[:, 0], strict=True):
            x0, y0, x1, y1 = boxes[row, 0]
            np.testing.assert_array_equal(frame[y0:y1, x0:x1], levels[row, y0:y1, x0:x1])
    assert shown == np.flatnonzero(wanted).tolist()


@pytest.mark.usefixtures("nothing_kept")
def test_a_clip_that_cannot_fill_frames_reads_those_without_a_box_too() -> None:
    clip, boxes = clip_of(12, 1000), np.zeros((1000, 1, 4), np.int64)
    boxes[::9, 0, 2:] = 5
    blocks = list(FrameSource([clip]).blocks_within(boxes))
    np.testing.assert_array_equal(np.concatenate([block.rows for block in blocks]), np.arange(1000))
    plain = np.array(list(clip.frames()))
    for block in blocks:
        np.testing.assert_array_equal(block.frames[:, 0], plain[block.rows])


def test_clips_of_different_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match="150, 149 frames"):
        FrameSource([clip_of(1), clip_of(1, COUNT - 1)])


def test_an_error_while_reading_ahead_is_raised_where_the_blocks_are_read() -> None:
    whole = clip_of(7)
    broken = Broken(np.array(list(whole.frames())), whole.times_s, 8)
    blocks = FrameSource([broken]).blocks()
    assert next(blocks).rows[-1] < 100
    with pytest.raises(OSError, match="ends at frame 100"):
        list(blocks)


def test_the_reading_thread_ends_when_its_blocks_are_closed() -> None:
    before = readers_alive()
    blocks = FrameSource([clip_of(8, 2000)]).blocks()
    next(blocks)
    blocks.close()  # type: ignore[attr-defined]
    assert readers_alive() == before
