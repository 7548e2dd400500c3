"""Reading: bit depths, frame rates and numbers of frames."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tifffile
from footage_files import noisy_frames, write_photron, write_pictures, write_tiff

from diethrow.tracking.footage.clip import open_clip, scan_notices

Report = Callable[[str], None]


def error_of(path: Path, fps: float | None = 1500.0) -> str:
    """The error for a file that is no clip."""
    with pytest.raises(ValueError, match=r"^clip\.\w+: .+") as caught:
        open_clip(path, fps=fps)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("kind", ["float32", "float64", "int16", "uint32", "bool"])
def test_pixels_of_other_types_are_refused(kind: str, tmp_path: Path, happened: Report) -> None:
    """Pixels that are not whole grey levels of 8 or 16 bit are refused: their full scale is unknown."""
    tifffile.imwrite(tmp_path / "clip.tif", noisy_frames(3).astype(kind), photometric="minisblack")
    message = error_of(tmp_path / "clip.tif")
    assert "8- or 16-bit unsigned" in message
    happened(message)


def test_a_one_bit_png_is_black_and_white(tmp_path: Path, happened: Report) -> None:
    """A PNG of 1 bit is read as black and white of 8 bit."""
    bilevel = (noisy_frames(3) > 60).astype(np.uint8) * 255
    for k, frame in enumerate(bilevel):
        cv2.imwrite(str(tmp_path / f"clip_{k}.png"), frame, [cv2.IMWRITE_PNG_BILEVEL, 1])
    clip = open_clip(tmp_path, fps=1500.0)
    np.testing.assert_array_equal(list(clip.frames()), bilevel)
    happened(f"levels {np.unique(clip.frame(0)).tolist()}, bit depth {clip.bit_depth}")


@pytest.mark.parametrize("suffix", [".tif", ".png", ".mraw"])
def test_sixteen_bits_are_read_to_the_last_level(suffix: str, tmp_path: Path, happened: Report) -> None:
    """Levels from 0 to the full scale of 16 bit are read as they were written."""
    frames = noisy_frames(3, bits=16)
    if suffix == ".tif":
        path = write_tiff(tmp_path / "clip.tif", frames)
    elif suffix == ".png":
        path = write_pictures(tmp_path / "clip", frames)
    else:
        path = write_photron(tmp_path / "clip.cihx", frames, stored_bits=16, effective_bits=16)
    clip = open_clip(path, fps=1500.0)
    np.testing.assert_array_equal(list(clip.frames()), frames)
    happened(f"levels 0 to {max(int(frame.max()) for frame in clip.frames())}, all as written")


@pytest.mark.parametrize("fps", [1.0, 1e6], ids=lambda fps: f"{fps:.0f} frames/s")
def test_times_are_multiples_of_the_frame_interval_and_no_sums(fps: float, tmp_path: Path, happened: Report) -> None:
    """Frame k of 60 000 is at k / fps to the last bit, and the last frame is readable."""
    frames = np.arange(60_000, dtype=np.uint16)[:, None, None] % 4096 * np.ones((1, 2, 8), np.uint16)
    path = write_photron(tmp_path / "clip.cihx", frames, stored_bits=12, record_rate_hz=int(fps))
    clip = open_clip(path, fps=fps)
    np.testing.assert_array_equal(clip.times_s, np.arange(60_000) / fps)
    np.testing.assert_array_equal(clip.frame(59_999), frames[-1])
    happened(f"{len(clip)} frames, the last at {clip.times_s[-1]:g} s, its pixels right")


@pytest.mark.parametrize("fps", [0.0, -1.0, np.inf, np.nan, None], ids=str)
def test_an_impossible_rate_is_refused(fps: float | None, tmp_path: Path, happened: Report) -> None:
    """A clip is not read at an impossible rate, nor without a rate."""
    happened(error_of(write_tiff(tmp_path / "clip.tif", noisy_frames(2)), fps))


def test_one_frame_is_a_clip(tmp_path: Path, happened: Report) -> None:
    """A clip of one frame is read."""
    clip = open_clip(write_tiff(tmp_path / "clip.tif", noisy_frames(1)), fps=1500.0)
    assert (len(clip), clip.times_s.tolist()) == (1, [0.0])
    happened("1 frame at 0 s")


def test_a_clip_that_stands_still_has_a_notice(tmp_path: Path, happened: Report) -> None:
    """A clip whose frames are all the same picture has a notice; a still scene with sensor noise has none."""
    still = write_tiff(tmp_path / "still.tif", np.repeat(noisy_frames(1), 40, axis=0))
    notices = scan_notices(open_clip(still, fps=1500.0))
    assert len(notices) == 1
    assert "all 40 frames" in notices[0]
    assert scan_notices(open_clip(write_tiff(tmp_path / "noisy.tif", noisy_frames(40)), fps=1500.0)) == ()
    happened(notices[0])
