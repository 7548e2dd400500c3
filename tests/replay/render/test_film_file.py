"""Files of films: every codec gives back the grey levels that were written, in its range and depth."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest

from diethrow.replay.render.film_file import CRF_RANGE, DEPTHS, Codec, write_film
from diethrow.tracking.footage.clip import open_clip

CASES = [
    (name, bits, full_range)
    for name, depths in DEPTHS.items()
    for bits in depths
    for full_range in ((False, True) if name in ("h264", "hevc") else (False,))
]


@pytest.mark.parametrize(("name", "bits", "full_range"), CASES)
def test_grey_levels_come_back(name: str, bits: int, full_range: bool, tmp_path: Path) -> None:
    top = 2**bits - 1
    ramp = np.rint(np.tile(np.linspace(0, top, 64), (48, 1))).astype(np.uint8 if bits == 8 else np.uint16)
    best = None if name == "ffv1" else CRF_RANGE[name][0]
    codec = Codec(name, best, full_range)
    path = tmp_path / f"clip{codec.suffix}"
    write_film(path, iter([ramp, ramp[:, ::-1].copy(), ramp]), codec, bits)
    clip = open_clip(path, fps=1000.0)
    assert (clip.bit_depth, len(clip)) == (bits, 3)
    for frame, wanted in zip(clip.frames(), (ramp, ramp[:, ::-1], ramp), strict=True):
        # Limited range has 219 steps for 255; a wrong range would be off by up to 20.
        worst = 0 if name == "ffv1" else 1.01
        assert np.abs(frame.astype(float) - wanted).max() * 255 / top <= worst


@pytest.mark.skipif(not hasattr(av.VideoStream, "set_display_rotation"), reason="PyAV 18 writes rotations")
@pytest.mark.parametrize("turned_deg", [90, 180, 270])
def test_a_player_turns_the_frames_of_a_turned_film_upright(turned_deg: int, tmp_path: Path) -> None:
    upright = np.zeros((48, 64), np.uint8)
    upright[:20, :30] = 200
    path = tmp_path / "clip.mp4"
    write_film(path, iter([upright]), Codec("h264", 10, True, turned_deg), 8)
    with av.open(str(path)) as container:
        frame = next(container.decode(video=0))
    stored = frame.to_ndarray(format="gray")
    assert frame.rotation % 360 == turned_deg
    # PyAV counts the angle of its frames counter-clockwise, as numpy does.
    shown = np.rot90(stored, frame.rotation // 90)
    assert np.abs(shown.astype(float) - upright).mean() < 2.0


@pytest.mark.parametrize("name", ["h264", "hevc", "mjpeg"])
def test_a_higher_rate_factor_makes_smaller_files(name: str, tmp_path: Path) -> None:
    frames = [np.random.default_rng(k).integers(0, 255, (48, 64), dtype=np.uint8) for k in range(3)]
    sizes = []
    for crf in (4, 28):
        codec = Codec(name, crf)
        path = tmp_path / f"{crf}{codec.suffix}"
        write_film(path, iter(frames), codec, 8)
        sizes.append(path.stat().st_size)
    assert sizes[1] < 0.8 * sizes[0]


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        (("vp9",), "codec = 'vp9': wanted one of ffv1, h264, hevc, mjpeg"),
        (("ffv1", 20), "crf = 20: ffv1 stores frames without loss"),
        (("h264", 99), "crf = 99: wanted 0 to 51 for h264"),
        (("mjpeg", 0), "crf = 0: wanted 1 to 31 for mjpeg"),
        (("mjpeg", None, True), "full_range: the range of mjpeg is fixed"),
        (("h264", None, False, 45), "turned_deg = 45: wanted 0, 90, 180 or 270"),
        (("ffv1", None, False, 90), "turned_deg = 90: only MP4 states it"),
    ],
)
def test_impossible_codecs_are_refused(settings: tuple[object, ...], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        Codec(*settings)  # type: ignore[arg-type]


def test_a_depth_or_size_that_a_codec_cannot_hold_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"bit_depth = 12: wanted one of 8, 10 for h264"):
        Codec("h264").checked(12)
    with pytest.raises(ValueError, match=r"63 × 48 pixels: h264 stores chroma for 2 × 2 pixels"):
        write_film(tmp_path / "clip.mp4", iter([np.zeros((48, 63), np.uint8)]), Codec("h264"), 8)
