"""Laws of clips stored as pictures, and of the background."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from footage_files import noisy_frames, write_pictures, write_tiff

from diethrow.tracking.footage.background import estimate_background, load_background
from diethrow.tracking.footage.clip import open_clip

FRAMES = noisy_frames(12)


def test_a_missing_number_is_reported(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "p", FRAMES)
    (folder / "frame_5.png").unlink()
    clip = open_clip(folder, fps=1500)
    assert len(clip) == 11
    assert "1 numbers are missing between frame_1.png and frame_12.png" in clip.notices[0]


def test_a_folder_of_two_sequences_is_refused(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "p", FRAMES)
    cv2.imwrite(str(folder / "background.png"), FRAMES[0])  # carries no number, so it is no frame
    assert len(open_clip(folder, fps=1500)) == 12
    cv2.imwrite(str(folder / "left_1.png"), FRAMES[0])
    with pytest.raises(ValueError, match="pictures of 2 kinds"):
        open_clip(folder, fps=1500)
    assert len(open_clip(folder / "frame_3.png", fps=1500)) == 12


def test_a_picture_of_another_size_is_named(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "p", FRAMES)
    cv2.imwrite(str(folder / "frame_7.png"), FRAMES[0][:, :-2])
    clip = open_clip(folder, fps=1500)
    with pytest.raises(ValueError, match=r"frame_7\.png: .*62 × 48 px"):
        clip.frame(6)


def test_a_colour_picture_of_greys_is_read_as_these_greys(tmp_path: Path) -> None:
    folder = tmp_path / "p"
    folder.mkdir()
    cv2.imwrite(str(folder / "a_1.png"), np.repeat(FRAMES[0][..., None], 3, axis=2))
    tifffile.imwrite(folder / "b_1.tif", np.repeat(FRAMES[0][..., None], 3, axis=2), photometric="rgb")
    for name in ("a_1.png", "b_1.tif"):
        np.testing.assert_array_equal(open_clip(folder / name, fps=1500).frame(0), FRAMES[0])


def test_a_tiff_with_white_as_zero_is_inverted(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", 255 - FRAMES, photometric="miniswhite")
    np.testing.assert_array_equal(open_clip(tmp_path / "x.tif", fps=1500).frame(4), FRAMES[4])


@pytest.mark.parametrize("byteorder", ["<", ">"])
def test_a_stack_of_imagej_is_read_in_either_byte_order(byteorder: str, tmp_path: Path) -> None:
    frames = noisy_frames(6, bits=16)
    tifffile.imwrite(tmp_path / "x.tif", frames, imagej=True, byteorder=byteorder)
    read = np.stack(list(open_clip(tmp_path / "x.tif", fps=1500).frames()))
    np.testing.assert_array_equal(read, frames)


@pytest.mark.parametrize("kept", [0.3, 0.5, 0.97])
def test_a_truncated_tiff_gives_its_complete_pages_and_a_notice(kept: float, tmp_path: Path) -> None:
    content = write_tiff(tmp_path / "whole.tif", FRAMES).read_bytes()
    path = tmp_path / "x.tif"
    path.write_bytes(content[: int(kept * len(content))])
    clip = open_clip(path, fps=1500)
    assert 12 * kept - 2 <= len(clip) < 12
    assert "cut off" in clip.notices[0]
    np.testing.assert_array_equal(np.stack(list(clip.frames())), FRAMES[: len(clip)])


def test_pixels_that_are_not_whole_numbers_are_refused(tmp_path: Path) -> None:
    tifffile.imwrite(tmp_path / "x.tif", FRAMES.astype(np.float32))
    with pytest.raises(ValueError, match="float32"):
        open_clip(tmp_path / "x.tif", fps=1500)


def test_the_background_is_the_scene_behind_a_moving_die(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = rng.integers(20, 200, (60, 80))
    frames = np.clip(scene + rng.normal(0.0, 3.0, (150, 60, 80)), 0, 255).round().astype(np.uint8)
    for k in range(150):
        frames[k, 10:25, k // 2 : k // 2 + 15] = 250
    clip = open_clip(write_tiff(tmp_path / "x.tif", frames), fps=1500)
    error = estimate_background(clip) - scene
    # The mean of most of 60 has a seventh of the noise: 0.42; the die takes a fifth of the samples of some pixels.
    assert error.std() < 0.8
    assert np.abs(error).max() < 5 * 0.8


def test_the_background_is_the_scene_where_a_turning_die_covers_it_most_of_the_time(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    scene = rng.integers(20, 60, (60, 80))
    frames = scene + rng.normal(0.0, 2.0, (60, 60, 80))
    for k in range(36):
        frames[k, 10:25, 20:35] = rng.uniform(60.0, 200.0)
    clip = open_clip(write_tiff(tmp_path / "x.tif", frames.round().astype(np.uint8)), fps=1500)
    error = estimate_background(clip) - scene
    # 24 of 60 frames show the scene there: their mean has a noise of 0.4.
    assert error.std() < 0.6
    assert np.abs(error).max() < 5 * 0.6


def test_a_background_of_another_size_or_depth_is_refused(tmp_path: Path) -> None:
    clip = open_clip(write_tiff(tmp_path / "x.tif", FRAMES), fps=1500)
    right, small, deep = tmp_path / "right.png", tmp_path / "small.png", tmp_path / "deep.png"
    cv2.imwrite(str(right), FRAMES[0])
    cv2.imwrite(str(small), FRAMES[0][:40])
    cv2.imwrite(str(deep), FRAMES[0].astype(np.uint16) << 8)
    np.testing.assert_array_equal(load_background(right, clip), FRAMES[0])
    with pytest.raises(ValueError, match=r"small\.png: .*64 × 40 px.*64 × 48"):
        load_background(small, clip)
    with pytest.raises(ValueError, match=r"deep\.png: .*16-bit"):
        load_background(deep, clip)
    with pytest.raises(FileNotFoundError, match="no such background picture"):
        load_background(tmp_path / "none.png", clip)
