"""Laws of Photron footage: packing, depth, times, damage."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_photron

from diethrow.tracking.footage.clip import FillsFrames, open_clip
from diethrow.tracking.footage.photron import unpack_12bit

FRAMES = noisy_frames(9, bits=12)


def test_twelve_bits_are_packed_high_bits_first() -> None:
    # By hand: 0xABC and 0x123 stand as AB C1 23.
    np.testing.assert_array_equal(unpack_12bit(np.array([0xAB, 0xC1, 0x23], np.uint8)), [0xABC, 0x123])


@pytest.mark.parametrize("suffix", [".cih", ".cihx"])
def test_left_out_frames_stretch_the_times(suffix: str, tmp_path: Path) -> None:
    path = write_photron(
        tmp_path / f"x{suffix}", FRAMES, stored_bits=12, record_rate_hz=15000, save_step=100, start_frame=-36
    )
    for fps in (
        None,
        15000,
        15001,
        150,
    ):  # the camera's rate, the same rounded, and the rate of the frames that are left
        clip = open_clip(path, fps=fps)
        np.testing.assert_allclose(clip.times_s, np.arange(9) / 150, rtol=1e-15)
    assert clip.metadata()["start_frame"] == -36
    assert clip.metadata()["record_rate_hz"] == 15000


@pytest.mark.parametrize("suffix", [".cih", ".cihx"])
def test_the_shutter_is_a_reciprocal_second(suffix: str, tmp_path: Path) -> None:
    path = write_photron(tmp_path / f"x{suffix}", FRAMES, stored_bits=12, shutter_hz=50000)
    assert open_clip(path).metadata()["exposure_s"] == pytest.approx(20e-6, rel=1e-12)


def test_a_rate_that_contradicts_the_header_is_an_error_that_names_both(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=12, record_rate_hz=1500)
    with pytest.raises(ValueError, match=r"fps = 1000; .*header.* 1500"):
        open_clip(path, fps=1000)


def test_an_externally_clocked_camera_needs_the_rate_of_the_scene(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cih", FRAMES, stored_bits=12, record_rate_hz=0)
    with pytest.raises(ValueError, match="fps"):
        open_clip(path)
    assert open_clip(path, fps=1500).times_s[1] == pytest.approx(1 / 1500)


def test_effective_bits_on_the_high_side_are_moved_down(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cih", FRAMES << 4, stored_bits=16, effective_bits=12, side="Higher")
    clip = open_clip(path)
    assert clip.bit_depth == 12
    np.testing.assert_array_equal(clip.frame(3), FRAMES[3])


def test_the_upper_eight_of_twelve_bits_stay_eight(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cih", FRAMES >> 4, stored_bits=8, effective_bits=12, side="Higher")
    clip = open_clip(path)
    assert clip.bit_depth == 8
    np.testing.assert_array_equal(clip.frame(3), FRAMES[3] >> 4)


def test_pixels_truncated_within_a_frame_give_the_complete_frames_and_a_notice(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=12)
    pixels = path.with_suffix(".mraw")
    pixels.write_bytes(pixels.read_bytes()[:-1])
    clip = open_clip(path)
    assert len(clip) == 8
    assert "declares 9 frames and the file holds 8" in clip.notices[0]
    np.testing.assert_array_equal(clip.frame(7), FRAMES[7])


def test_pixels_beyond_the_header_are_ignored_and_reported(tmp_path: Path) -> None:
    clip = open_clip(write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=12, declared_frames=5))
    assert len(clip) == 5
    assert "the 5 frames" in clip.notices[0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("Image Width : 64", "Image Width : 999999999", "the header is broken"),
        ("Image Width : 64", "Image Width : -64", "the header is broken"),
        ("Image Width : 64", "Image Width : wide", "Image Width = wide"),
        ("Image Width : 64\n", "", "Image Width = None"),
        ("Total Frame : 9", "Total Frame : 999999999999", "declares 999999999999 frames"),
        ("Image Height : 48", "Image Height : 16000", "cut off"),
        ("Color Bit : 12", "Color Bit : 10", "Color Bit = 10"),
        ("Color Type : Mono", "Color Type : Color", "Color Type = Color"),
        ("EffectiveBit Depth : 12", "EffectiveBit Depth : 77", "EffectiveBit Depth = 77"),
        ("Image Width : 64\nImage Height : 48", "Image Width : 63\nImage Height : 47", "63 × 47"),
    ],
)
def test_a_hostile_header_is_refused_before_memory_is_taken(old: str, new: str, message: str, tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cih", FRAMES, stored_bits=12)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    if "Total" in old:  # a count that is too large is a film cut off
        assert message in open_clip(path).notices[0]
        return
    with pytest.raises(ValueError, match=message) as caught:
        open_clip(path)
    assert str(caught.value).startswith("x.")


def test_header_and_pixels_must_lie_in_one_folder(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=12)
    path.with_suffix(".mraw").rename(tmp_path / "y.mraw")
    with pytest.raises(FileNotFoundError, match=r"x\.mraw"):
        open_clip(path)
    with pytest.raises(FileNotFoundError, match=r"y\.cihx or \.cih"):
        open_clip(tmp_path / "y.mraw")


@pytest.mark.parametrize("stored_bits", [8, 12, 16])
@pytest.mark.parametrize("width_px", [16, 15])
def test_a_part_of_a_frame_equals_that_part_of_the_whole_frame(stored_bits: int, width_px: int, tmp_path: Path) -> None:
    # Two pixels share three bytes: with an odd width every other line begins in the middle of a byte.
    levels = np.random.default_rng(stored_bits).integers(0, 2 ** min(stored_bits, 12), (5, 14, width_px))
    frames = levels.astype(np.uint8 if stored_bits == 8 else np.uint16)
    clip = open_clip(write_photron(tmp_path / "x.cihx", frames, stored_bits=stored_bits))
    assert isinstance(clip, FillsFrames)
    whole, part = np.zeros_like(frames), np.zeros_like(frames)
    clip.fill(0, whole)
    np.testing.assert_array_equal(whole, frames)
    boxes = np.array([[0, 0, 1, 1], [3, 2, 8, 9], [5, 13, width_px, 14], [4, 4, 4, 4], [0, 0, width_px, 14]])
    clip.fill(0, part, boxes)
    for frame, wanted, (x0, y0, x1, y1) in zip(part, frames, boxes, strict=True):
        np.testing.assert_array_equal(frame[y0:y1, x0:x1], wanted[y0:y1, x0:x1])


def test_a_file_that_is_truncated_while_it_is_read_is_reported(tmp_path: Path) -> None:
    path = write_photron(tmp_path / "x.cihx", FRAMES, stored_bits=12)
    clip = open_clip(path)
    assert isinstance(clip, FillsFrames)
    pixels = path.with_suffix(".mraw")
    pixels.write_bytes(pixels.read_bytes()[:-10])
    with pytest.raises(ValueError, match="cut off"):
        clip.fill(0, np.zeros_like(FRAMES))
