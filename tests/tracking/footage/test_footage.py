"""Laws that every reader of footage obeys, each format written here and read back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from footage_files import noisy_frames, write_cine, write_photron, write_pictures, write_tiff, write_video
from numpy.typing import NDArray

from diethrow.tracking.footage.clip import open_clip, scan_notices

COUNT = 23


@dataclass(frozen=True)
class Format:
    """A way to write a film without loss."""

    name: str
    bits: int
    write: Callable[[Path, NDArray], Path]
    fps: float | None = 1500.0

    def __str__(self) -> str:
        return self.name


def _video(name: str, **options: object) -> Callable[[Path, NDArray], Path]:
    return lambda folder, frames: write_video(folder / name, frames, **options)


LOSSLESS_H264 = {"qp": "0", "g": "8", "preset": "fast", "bf": "3"}
FORMATS = [
    Format("FFV1 AVI", 8, _video("clip.avi", fps=30)),
    Format("FFV1 MKV at 1500/s", 8, _video("clip.mkv")),
    Format("FFV1 gray10", 10, _video("clip.mkv", pixels="gray10le")),
    Format("FFV1 gray12", 12, _video("clip.mkv", pixels="gray12le")),
    Format("FFV1 gray16", 16, _video("clip.mkv", pixels="gray16le")),
    Format("raw AVI", 8, _video("clip.avi", codec="rawvideo", fps=30)),
    Format("H.264 MP4", 8, _video("clip.mp4", codec="libx264", options=LOSSLESS_H264)),
    Format("H.264 MKV, duplicated timestamps", 8, _video("clip.mkv", codec="libx264", options=LOSSLESS_H264)),
    Format("H.264 AVI", 8, _video("clip.avi", codec="libx264", fps=30, options=LOSSLESS_H264)),
    Format(
        "H.264 open GOP", 8, _video("clip.mp4", codec="libx264", options=LOSSLESS_H264 | {"x264opts": "open-gop=1"})
    ),
    Format("PNG folder", 8, lambda folder, frames: write_pictures(folder / "pictures", frames)),
    Format("PNG 16 bit, one named", 16, lambda folder, frames: write_pictures(folder / "p", frames) / "frame_7.png"),
    Format(
        "BMP pattern", 8, lambda folder, frames: write_pictures(folder / "p", frames, suffix=".bmp") / "frame_*.bmp"
    ),
    Format("TIFF sequence", 16, lambda folder, frames: write_pictures(folder / "p", frames, suffix=".tif")),
    Format("TIFF pages", 16, lambda folder, frames: write_tiff(folder / "clip.tif", frames)),
    Format(
        "TIFF pages, deflated", 8, lambda folder, frames: write_tiff(folder / "clip.tif", frames, compression="zlib")
    ),
    Format("Photron 8 bit", 8, lambda folder, frames: write_photron(folder / "c.cih", frames, stored_bits=8), None),
    Format(
        "Photron 12 packed", 12, lambda folder, frames: write_photron(folder / "c.cihx", frames, stored_bits=12), None
    ),
    Format("Photron 16 bit", 12, lambda folder, frames: write_photron(folder / "c.cih", frames, stored_bits=16), None),
    Format(
        "Photron by its pixels",
        12,
        lambda folder, frames: write_photron(folder / "c.cihx", frames, stored_bits=12).with_suffix(".mraw"),
        None,
    ),
    Format("Phantom 8 bit", 8, lambda folder, frames: write_cine(folder / "c.cine", frames, stored_bits=8), None),
    Format("Phantom 12 packed", 12, lambda folder, frames: write_cine(folder / "c.cine", frames, stored_bits=12), None),
    Format("Phantom 16 bit", 12, lambda folder, frames: write_cine(folder / "c.cine", frames, stored_bits=16), None),
]


@pytest.fixture(params=FORMATS, ids=str)
def film(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[Format, Path, NDArray]:
    form: Format = request.param
    frames = noisy_frames(COUNT, bits=form.bits)
    return form, form.write(tmp_path, frames), frames


def test_every_frame_is_read_exactly_in_order_at_native_depth(film: tuple[Format, Path, NDArray]) -> None:
    form, path, frames = film
    clip = open_clip(path, fps=form.fps)
    read = list(clip.frames())
    assert (len(clip), clip.height_px, clip.width_px) == frames.shape
    assert clip.bit_depth == form.bits
    assert all(frame.dtype == frames.dtype for frame in read)
    np.testing.assert_array_equal(np.stack(read), frames)
    assert scan_notices(clip) == ()


def test_random_access_gives_the_frames_of_the_iteration(film: tuple[Format, Path, NDArray]) -> None:
    form, path, frames = film
    clip = open_clip(path, fps=form.fps)
    for k in (COUNT - 1, 0, 9, 8, 10, 16, 7, 7, 15, 3, *range(COUNT - 1, -1, -1)):
        np.testing.assert_array_equal(clip.frame(k), frames[k], err_msg=f"frame {k}")


def test_time_is_the_frame_number_over_the_rate_counted_from_the_first_of_the_file(
    film: tuple[Format, Path, NDArray],
) -> None:
    form, path, frames = film
    part = open_clip(path, fps=form.fps, frame_range=(5, 17))
    assert (len(part), part.first_frame) == (12, 5)
    # Equal to the last bit but for the order of the two operations.
    np.testing.assert_allclose(part.times_s, np.arange(5, 17) / 1500.0, rtol=1e-15)
    np.testing.assert_array_equal(np.stack(list(part.frames())), frames[5:17])
    np.testing.assert_array_equal(np.stack(list(part.frames(3, 6))), frames[8:11])


def test_frames_outside_the_film_are_index_errors_and_ranges_outside_are_refused(
    film: tuple[Format, Path, NDArray],
) -> None:
    form, path, _ = film
    clip = open_clip(path, fps=form.fps)
    for k in (-1, COUNT):
        with pytest.raises(IndexError, match=f"frame {k}"):
            clip.frame(k)
    for wrong in ((0, COUNT + 1), (5, 5), (-1, 4)):
        with pytest.raises(ValueError, match=rf"the file has {COUNT}"):
            open_clip(path, fps=form.fps, frame_range=wrong)


def test_a_missing_or_impossible_rate_is_refused_where_the_file_has_none(film: tuple[Format, Path, NDArray]) -> None:
    form, path, _ = film
    if form.fps is None:
        assert open_clip(path).metadata()["record_rate_hz"] == 1500.0
        return
    assert open_clip(path, fps=form.fps).metadata()["record_rate_hz"] is None
    with pytest.raises(ValueError, match="fps"):
        open_clip(path)
    with pytest.raises(ValueError, match="above 0"):
        open_clip(path, fps=0.0)


def test_changing_a_frame_that_was_read_changes_no_later_reading(film: tuple[Format, Path, NDArray]) -> None:
    form, path, frames = film
    clip = open_clip(path, fps=form.fps)
    clip.frame(4)[:] = 0
    np.testing.assert_array_equal(clip.frame(4), frames[4])


def test_an_exact_copy_among_noisy_frames_is_reported_and_a_still_rendering_is_not(tmp_path: Path) -> None:
    frames = noisy_frames(COUNT)
    frames[12] = frames[11]
    clip = open_clip(write_tiff(tmp_path / "dropped.tif", frames), fps=1500)
    assert clip.notices == ()
    assert "1 of 23 frames are exact copies of the one before (12)" in scan_notices(clip)[0]
    assert scan_notices(clip) == clip.notices
    still = np.zeros_like(frames)
    still[15:, 4:8, 4:8] = np.arange(8, dtype=np.uint8)[:, None, None] + 1
    assert scan_notices(open_clip(write_tiff(tmp_path / "still.tif", still), fps=1500)) == ()


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.avi", b""),
        ("noise.avi", np.random.default_rng(2).bytes(20000)),
        ("letter.txt", b"Dear reader, this is no film.\n" * 50),
        ("list.avi", b"ffconcat version 1.0\nfile other.avi\n"),
        ("half.png", b"\x89PNG\r\n\x1a\n" + b"\0" * 30),
        ("half.tif", b"II*\0\x08\0\0\0"),
        ("far.tif", b"II*\0\xff\xff\xff\x7f"),
        ("empty.cihx", b"<cih></cih>"),
        ("cut.cihx", b"<cih><imageDataInfo>"),
        ("lonely.mraw", b"\0" * 100),
        ("begun.cine", b"CI\x2c\0" + b"\0" * 20),
        ("zeros.cine", b"CI\x2c\0" + b"\0" * 20000),
        ("noise.cine", b"CI\x2c\0" + np.random.default_rng(6).bytes(20000)),
    ],
)
def test_a_file_that_is_no_film_is_refused_by_name(
    name: str, content: bytes, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises((ValueError, FileNotFoundError)) as caught:
        open_clip(path, fps=1500)
    assert name in str(caught.value)
    assert "\n" not in str(caught.value)
    # FFmpeg and the TIFF library must not chatter past the sentence.
    assert capfd.readouterr() == ("", "")


def test_a_clip_that_does_not_exist_is_reported_as_missing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="no such clip"):
        open_clip(tmp_path / "none.avi", fps=1500)
    with pytest.raises(ValueError, match="no pictures there"):
        open_clip(tmp_path / "none_*.png", fps=1500)
    with pytest.raises(ValueError, match="no pictures there"):
        open_clip(tmp_path, fps=1500)
