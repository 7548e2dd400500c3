"""Laws of Phantom footage: packing, linear levels, times, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import av
import numpy as np
import pytest
from footage_files import noisy_frames, write_cine

from diethrow.tracking.footage.cine import linear_levels, unpack_10bit
from diethrow.tracking.footage.clip import open_clip

FRAMES = noisy_frames(9, bits=12)


def test_ten_bits_are_packed_high_bits_first() -> None:
    # By hand: 0x3A5 0x012 0x2F0 0x0FF are the forty bits 1110100101 0000010010 1011110000 0011111111.
    packed = np.array([0b11101001, 0b01000001, 0b00101011, 0b11000000, 0b11111111], np.uint8)
    np.testing.assert_array_equal(unpack_10bit(packed), [0x3A5, 0x012, 0x2F0, 0x0FF])


def test_packed_ten_bit_levels_are_linear_light() -> None:
    levels = linear_levels().astype(int)
    # Entries of the maker's table: black, both sides of the step where the curve turns from straight to a power, white.
    for code, level in ((64, 64), (96, 94), (140, 136), (160, 156), (256, 290), (512, 998), (800, 2468), (1014, 4064)):
        assert abs(levels[code] - level) <= 1
    assert (np.diff(levels) >= 0).all()
    assert (levels[1015:] == 4095).all()


def test_packed_ten_bit_frames_are_read_as_levels_of_twelve_bits(tmp_path: Path) -> None:
    codes = noisy_frames(9, bits=10)
    clip = open_clip(write_cine(tmp_path / "x.cine", codes, stored_bits=10))
    assert clip.bit_depth == 12
    np.testing.assert_array_equal(clip.frame(5), linear_levels()[codes[5]])


@pytest.mark.parametrize("stored_bits", [8, 12, 16])
@pytest.mark.parametrize("flips", [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_flips_of_the_camera_software_are_carried_out(stored_bits: int, flips: tuple[int, int], tmp_path: Path) -> None:
    frames = FRAMES >> 4 if stored_bits == 8 else FRAMES
    clip = open_clip(write_cine(tmp_path / "x.cine", frames, stored_bits=stored_bits, flips=flips))
    step = (-1 if flips[1] else 1, -1 if flips[0] else 1)
    np.testing.assert_array_equal(clip.frame(2), frames[2][:: step[0], :: step[1]])
    assert ("mirror" in " ".join(clip.notices)) == (sum(flips) == 1)


@pytest.mark.parametrize("flip_over", [0, 1])
def test_another_decoder_reads_the_same_unpacked_picture(flip_over: int, tmp_path: Path) -> None:
    path = write_cine(tmp_path / "x.cine", FRAMES >> 4, stored_bits=8, flips=(0, flip_over))
    ours = open_clip(path)
    with av.open(str(path)) as container:
        theirs = next(container.decode(video=0)).to_ndarray(format="gray16le")
    np.testing.assert_array_equal(ours.frame(0), theirs >> 8)


def test_the_metadata_are_those_of_the_file(tmp_path: Path) -> None:
    path = write_cine(tmp_path / "x.cine", FRAMES, stored_bits=16, real_bits=14, annotation=b"noted" * 3)
    clip = open_clip(path)
    said = clip.metadata()
    assert (said["start_frame"], said["record_rate_hz"], clip.bit_depth) == (-7, 1500, 14)
    assert said["exposure_s"] == pytest.approx(2e-4, rel=1e-6)  # the fixed point has 2e-10 s
    np.testing.assert_array_equal(clip.frame(8), FRAMES[8])


def test_time_stamps_are_used_rather_than_the_declared_rate(tmp_path: Path) -> None:
    # Every tenth frame of 15000 a second was saved, and the header still says 15000.
    path = write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, rate_hz=15000, times_s=np.arange(9) / 1500)
    for fps in (None, 1500.0, 1500.1):
        # Fixed point has 2e-10 s; a stated rate within a thousandth is taken for rounding.
        np.testing.assert_allclose(open_clip(path, fps=fps).times_s, np.arange(9) / 1500, atol=1e-6)
    with pytest.raises(ValueError, match=r"fps = 15000; .*time stamps.* 1500"):
        open_clip(path, fps=15000)


def test_missing_frames_are_named_and_delay_the_frames_after_them(tmp_path: Path) -> None:
    ticks = np.array([0, 1, 2, 3, 6, 7, 8, 10, 11])
    clip = open_clip(write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, times_s=ticks / 1500))
    np.testing.assert_allclose(clip.times_s, ticks / 1500, atol=1e-9)
    assert "about 3 frames are missing before frames 4, 7" in clip.notices[0]


def test_uneven_times_are_used_and_reported(tmp_path: Path) -> None:
    times = np.arange(9) / 1500 + np.random.default_rng(4).normal(0.0, 5e-5, 9)
    times -= times[0]
    clip = open_clip(write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, times_s=times))
    np.testing.assert_allclose(clip.times_s, times, atol=1e-9)
    assert "time stamps are uneven" in clip.notices[0]


def test_an_impossible_time_stamp_is_interpolated_and_named(tmp_path: Path) -> None:
    # Seen in a camera's own file: the last frame of 235 stamped 292 days after the others.
    times = np.arange(9) / 1500
    times[8] += 2.5e7
    clip = open_clip(write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, times_s=times))
    np.testing.assert_allclose(clip.times_s, np.arange(9) / 1500, atol=1e-9)
    assert "time stamps of 1 frames (8)" in clip.notices[0]


def test_without_times_the_declared_rate_counts_and_without_both_fps_is_required(tmp_path: Path) -> None:
    path = write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, timed=False)
    np.testing.assert_allclose(open_clip(path).times_s, np.arange(9) / 1500, rtol=1e-15)
    with pytest.raises(ValueError, match=r"fps = 1000; .*header.* 1500"):
        open_clip(path, fps=1000)
    path = write_cine(tmp_path / "y.cine", FRAMES, stored_bits=12, timed=False, times_s=np.zeros(9), rate_hz=0)
    with pytest.raises(ValueError, match="fps"):
        open_clip(path)
    assert open_clip(path, fps=1500).times_s[1] == pytest.approx(1 / 1500)


def test_an_exposure_that_varies_is_reported(tmp_path: Path) -> None:
    clip = open_clip(write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12, exposure_s=[1e-4] * 5 + [2e-4] * 4))
    assert "the exposure varies from 100 to 200 µs" in clip.notices[0]
    assert clip.metadata()["exposure_s"] == pytest.approx(1e-4, rel=1e-5)


def test_a_truncated_film_gives_its_complete_frames_and_a_notice(tmp_path: Path) -> None:
    path = write_cine(tmp_path / "x.cine", FRAMES, stored_bits=12)
    path.write_bytes(path.read_bytes()[:-1])
    clip = open_clip(path)
    assert len(clip) == 8
    assert "declares 9 frames and the file holds 8" in clip.notices[0]
    np.testing.assert_array_equal(clip.frame(7), FRAMES[7])


@pytest.mark.parametrize(
    ("place", "form", "value", "message"),
    [
        (20, "<I", 2**31, "declares 2147483648 frames"),
        (20, "<I", 10**6, "ends before the offsets of its frames"),
        (28, "<I", 2**32 - 1, "ends before its setup"),
        (4, "<H", 1, "Compression = 1"),
        (6, "<H", 0, "a .cine of an old kind"),
        (48, "<i", 2**30, "the header is broken"),
        (48, "<i", -64, "the header is broken"),
        (48, "<i", 63, "divisible by 2, got 63 × 47"),
        (58, "<H", 24, "biBitCount = 24"),
        (60, "<I", 77, "biCompression = 77"),
        (84 + 808, "<I", 3, "CFA = 3"),
    ],
)
def test_a_hostile_header_is_refused_before_memory_is_taken(
    place: int, form: str, value: int, message: str, tmp_path: Path
) -> None:
    frames = FRAMES[:, :47] if value == 63 else FRAMES
    content = bytearray(write_cine(tmp_path / "x.cine", frames, stored_bits=12).read_bytes())
    struct.pack_into(form, content, place, value)
    (tmp_path / "x.cine").write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        open_clip(tmp_path / "x.cine")
    assert str(caught.value).startswith("x.cine: ")


def test_a_frame_whose_own_header_is_broken_is_named(tmp_path: Path) -> None:
    path = write_cine(tmp_path / "x.cine", FRAMES, stored_bits=16)
    size = 8 + 2 * FRAMES[0].size
    content = bytearray(path.read_bytes())
    struct.pack_into("<I", content, len(content) - 2 * size, 2**31)
    struct.pack_into("<I", content, len(content) - size + 4, 12)
    path.write_bytes(content)
    clip = open_clip(path)
    with pytest.raises(ValueError, match="ends before frame 7"):
        clip.frame(7)
    with pytest.raises(ValueError, match="frame 8 has 12 bytes of pixels"):
        clip.frame(8)
