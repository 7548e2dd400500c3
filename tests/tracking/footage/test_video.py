"""Laws of film containers: grey levels, timestamps, damage."""

from __future__ import annotations

import struct
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
from footage_files import noisy_frames, with_display_matrix, write_video
from numpy.typing import NDArray

from diethrow.tracking.footage import video
from diethrow.tracking.footage.clip import Clip, open_clip

MJPEG_RANGE, VIDEO_RANGE = 2, 1
# Every level of grey as a 4 × 4 patch: large enough that a lossy codec at its finest keeps it to a level or two.
RAMP = np.kron(np.arange(256, dtype=np.uint8).reshape(16, 16), np.ones((4, 4), np.uint8))


@pytest.mark.parametrize(
    ("name", "codec", "pixels", "options", "color_range", "tolerance"),
    [
        # Monochrome is stored as it is, for any tag of the decoder.
        ("x.mp4", "libx264", "gray", {"qp": "0"}, None, 0),
        ("x.avi", "libx264", "gray", {"qp": "0"}, None, 0),
        ("x.mkv", "libx265", "gray", {"x265-params": "lossless=1:log-level=none"}, None, 0),
        # Full range is tagged; limited range loses levels in the rounding to 219 of them, and no more.
        ("x.mp4", "libx264", "yuvj420p", {"qp": "0"}, MJPEG_RANGE, 0),
        ("x.mp4", "libx264", "yuv420p", {"qp": "0"}, None, 1),
        ("x.mp4", "libx264", "yuv420p", {"qp": "0"}, VIDEO_RANGE, 1),
        ("x.mkv", "ffv1", "yuv420p", {}, None, 1),
        ("x.mkv", "ffv1", "yuv444p10le", {}, None, 4),
        ("x.avi", "rawvideo", "bgr24", {}, None, 0),
        ("x.avi", "huffyuv", "rgb24", {}, None, 0),
    ],
)
def test_no_pixel_format_shifts_the_grey_levels(
    name: str, codec: str, pixels: str, options: dict[str, str], color_range: int | None, tolerance: int, tmp_path: Path
) -> None:
    path = write_video(
        tmp_path / name,
        np.stack([RAMP] * 3),
        codec=codec,
        pixels=pixels,
        fps=30,
        options=options,
        color_range=color_range,
    )
    clip = open_clip(path, fps=1500)
    deeper = 2 ** (clip.bit_depth - 8)
    error = clip.frame(1) / deeper - RAMP * ((2**clip.bit_depth - 1) / 255 / deeper)
    assert np.abs(error).max() <= tolerance
    assert abs(error.mean()) <= 0.5  # the rounding of the encoder to limited range; an untreated range shifts by 9


@pytest.mark.parametrize(("pixels", "top"), [("gray", 2**8), ("gray12le", 2**12), ("rgb24", 2**8)])
def test_lines_stored_from_the_bottom_up_are_read_from_the_top_down(pixels: str, top: int, tmp_path: Path) -> None:
    levels = np.random.default_rng(5).integers(0, top, (3, 34, 50)).astype(np.uint8 if top == 2**8 else np.uint16)
    path = write_video(tmp_path / "x.nut", levels, codec="rawvideo", pixels=pixels, extradata=b"BottomUp\0")
    with av.open(str(path)) as container:
        assert next(container.decode(video=0)).planes[0].line_size < 0  # or this would test nothing
    # FFmpeg hands the stored lines out from the last to the first.
    np.testing.assert_array_equal(np.stack(list(open_clip(path, fps=1500).frames())), levels[:, ::-1])


def test_a_whole_film_is_read_in_any_order_from_a_few_key_frames(tmp_path: Path) -> None:
    frames = noisy_frames(120)
    clip = open_clip(
        write_video(tmp_path / "x.mp4", frames, codec="libx264", options={"qp": "0", "g": "50", "bf": "5"}), fps=1500
    )
    for k in np.random.default_rng(3).permutation(120)[:40]:
        np.testing.assert_array_equal(clip.frame(int(k)), frames[k])


def test_every_frame_of_a_short_film_becomes_a_picture_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also those that lie on the way to another; the caller may write into what it gets."""
    path = tmp_path / "film.mp4"
    frames = noisy_frames(24)
    write_video(path, frames, codec="libx264", options={"qp": "0", "g": "8", "bf": "0"})
    clip, decoded = open_clip(path, fps=1000.0, frame_range=(2, 24)), []
    grey = video._grey
    monkeypatch.setattr(video, "_grey", lambda *frame: decoded.append(1) or grey(*frame))
    for k in (17, 3, 21, 16, 3, *range(22)):
        picture = clip.frame(k)
        np.testing.assert_array_equal(picture, frames[2 + k])
        picture[:] = 0
    assert len(decoded) == len(clip)


def test_two_iterations_at_once_do_not_disturb_each_other(tmp_path: Path) -> None:
    frames = noisy_frames(12)
    clip = open_clip(write_video(tmp_path / "x.mp4", frames, codec="libx264", options={"qp": "0"}), fps=1500)
    for k, (early, late) in enumerate(zip(clip.frames(0, 6), clip.frames(6), strict=True)):
        np.testing.assert_array_equal(early, frames[k])
        np.testing.assert_array_equal(late, frames[6 + k])


def _film_with_times(path: Path, ticks: list[int], per_second: int) -> Clip:
    frames = noisy_frames(len(ticks))
    return open_clip(write_video(path, frames, fps=per_second, times=ticks, codec="libx264"), fps=1500)


def test_rounded_timestamps_are_no_variable_rate(tmp_path: Path) -> None:
    # Matroska's millisecond turns 0, 0.67, 1.33, 2 ms into 0, 1, 1, 2.
    clip = open_clip(write_video(tmp_path / "x.mkv", noisy_frames(200)), fps=1500)
    assert clip.notices == ()


def test_a_gap_at_the_recording_rate_delays_the_frames_after_it(tmp_path: Path) -> None:
    ticks = [*range(10), *range(13, 30)]
    clip = _film_with_times(tmp_path / "x.mp4", ticks, 1500)
    assert "timestamps are uneven" in clip.notices[0]
    assert "used as the frames' times" in clip.notices[0]
    # The container's time base is finer than 1e-5 s.
    np.testing.assert_allclose(clip.times_s, np.array(ticks) / 1500, atol=1e-5)


def test_a_variable_playback_rate_is_reported_and_not_used(tmp_path: Path) -> None:
    clip = _film_with_times(tmp_path / "x.mp4", [*range(10), *range(13, 30)], 30)
    assert "evenly spaced at fps" in clip.notices[0]
    np.testing.assert_allclose(clip.times_s, np.arange(27) / 1500, rtol=1e-15)


@pytest.mark.parametrize("name", ["x.avi", "x.mkv"])
@pytest.mark.parametrize("kept", [0.5, 0.99])
def test_a_truncated_film_gives_its_complete_frames_and_a_notice(name: str, kept: float, tmp_path: Path) -> None:
    frames = noisy_frames(40)
    whole = write_video(tmp_path / f"whole_{name}", frames, fps=30).read_bytes()
    path = tmp_path / name
    path.write_bytes(whole[: int(kept * len(whole))])
    clip = open_clip(path, fps=1500)
    assert 40 * kept - 4 <= len(clip) < 40 + (kept > 0.9 and name == "x.mkv")
    np.testing.assert_array_equal(np.stack(list(clip.frames())), frames[: len(clip)])
    if len(clip) < 40 and name == "x.avi":
        assert "declares 40 frames" in clip.notices[0]


def test_a_frame_that_cannot_be_decoded_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = write_video(
        tmp_path / "x.avi", noisy_frames(20), codec="mpeg4", pixels="yuv420p", fps=30, options={"g": "1"}
    )
    with av.open(str(path)) as container:
        packet = list(container.demux(video=0))[10]
        place, size = packet.pos, packet.size
    content = bytearray(path.read_bytes())
    content[place + 8 : place + 8 + size] = bytes(size)
    path.write_bytes(content)
    clip = open_clip(path, fps=1500)
    with pytest.raises(ValueError, match=r"x\.avi: frame 1\d .*frames"):
        list(clip.frames())
    assert capfd.readouterr() == ("", "")


def test_sound_is_no_film(tmp_path: Path) -> None:
    path = tmp_path / "x.wav"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), format="s16", layout="mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))
    with pytest.raises(ValueError, match=r"x\.wav: .*'wav'"):
        open_clip(path, fps=1500)


def _mp4(path: Path, frames: NDArray[np.uint16], ticks: list[int] | None = None, per_second: int = 30) -> Path:
    return write_video(
        path, frames, fps=per_second, times=ticks, codec="libx264", options={"qp": "0", "bf": "3", "g": "20"}
    )


def test_coarse_timestamps_count_the_frame_intervals_between_frames(tmp_path: Path) -> None:
    # A time base of 1/600 s at 240 frames/s: 2.5 ticks a frame, rounded. Frames 10 to 12 are missing.
    frames = [*range(10), *range(13, 60)]
    path = _mp4(tmp_path / "x.mp4", noisy_frames(len(frames)), [round(2.5 * k) for k in frames], 600)
    clip = open_clip(path, fps=240)
    assert "whole frame intervals" in clip.notices[0]
    np.testing.assert_allclose(clip.times_s, np.array(frames) / 240, rtol=1e-12)
    assert clip.metadata()["time_stamps"] is True


@pytest.mark.parametrize("left_out", [7, 20, 33])
def test_frames_that_an_edit_list_leaves_out_are_counted_and_not_read(left_out: int, tmp_path: Path) -> None:
    frames = noisy_frames(60)
    content = bytearray(_mp4(tmp_path / "whole.mp4", frames).read_bytes())
    begin = content.find(b"elst") + 12
    with av.open(str(tmp_path / "whole.mp4")) as container:
        step = int(1 / (30 * container.streams.video[0].time_base))
    duration, start, rate = struct.unpack(">IiI", content[begin : begin + 12])
    content[begin : begin + 12] = struct.pack(">IiI", duration - left_out * 1000 // 30, start + left_out * step, rate)
    path = tmp_path / "trimmed.mp4"
    path.write_bytes(content)
    clip = open_clip(path, fps=1500)
    assert len(clip) == 60 - left_out
    (notice,) = clip.notices
    assert f"leaves out {left_out} of 60 frames" in notice
    for k in np.random.default_rng(1).permutation(len(clip)):
        np.testing.assert_array_equal(clip.frame(int(k)), frames[left_out + k])


@pytest.mark.parametrize("turn_deg", [0, 90, 180, 270])
def test_frames_are_turned_as_the_file_asks_players_to(turn_deg: int, tmp_path: Path) -> None:
    frames = noisy_frames(5)
    cos, sin = np.cos(np.radians(turn_deg)), np.sin(np.radians(turn_deg))
    path = with_display_matrix(_mp4(tmp_path / "x.mp4", frames), cos, -sin, sin, cos)
    clip = open_clip(path, fps=1500)
    assert clip.metadata()["turned_deg"] == turn_deg
    assert (clip.height_px, clip.width_px) == np.rot90(frames[0], turn_deg // 90).shape
    # An independent reader: OpenCV turns frames as players do. Its grey levels have another range.
    others = cv2.VideoCapture(str(path))
    for frame in clip.frames():
        found, other = others.read()
        assert found
        grey = cv2.cvtColor(other, cv2.COLOR_BGR2GRAY)
        assert grey.shape == frame.shape
        assert np.corrcoef(frame.ravel(), grey.ravel())[0, 1] > 0.99
    others.release()
    np.testing.assert_array_equal(clip.frame(3), np.rot90(frames[3], turn_deg // 90))
    np.testing.assert_array_equal(open_clip(path, fps=1500, as_stored=True).frame(3), frames[3])
    words = {0: "", 90: "90° counter-clockwise", 180: "180°", 270: "90° clockwise"}[turn_deg]
    assert [f"turned by {words}, as the file asks" in notice for notice in clip.notices] == [True] * bool(turn_deg)


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ((-1, 0, 0, 1), "mirror its frames"),
        ((0, 1, 1, 0), "mirror its frames"),
        ((np.sqrt(0.75), 0.5, -0.5, np.sqrt(0.75)), "turn its frames by 30° clockwise"),
    ],
)
def test_mirrored_and_tilted_displays_are_reported_and_not_followed(
    matrix: tuple[float, float, float, float], words: str, tmp_path: Path
) -> None:
    frames = noisy_frames(5)
    clip = open_clip(with_display_matrix(_mp4(tmp_path / "x.mp4", frames), *matrix), fps=1500)
    assert f"asks players to {words}; the frames are used as they are stored, 64 × 48 px" in clip.notices[0]
    np.testing.assert_array_equal(clip.frame(3), frames[3])


def test_stored_frames_have_a_notice_with_the_turn_that_is_left_out(tmp_path: Path) -> None:
    path = with_display_matrix(_mp4(tmp_path / "x.mp4", noisy_frames(5)), 0, 1, -1, 0)
    (notice,) = open_clip(path, fps=1500, as_stored=True).notices
    assert "turn its frames by 90° clockwise; the frames are used as they are stored, 64 × 48 px" in notice
