"""Writers of small films in every format, for the tests of the readers and for the data samples."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray


def noisy_frames(count: int, *, bits: int = 8, height: int = 48, width: int = 64, seed: int = 1) -> NDArray[np.uint16]:
    """(count, height, width) of a moving bright square in noise, over all of the depth; no two frames alike."""
    rng = np.random.default_rng(seed)
    top = 2**bits - 1
    frames = rng.integers(0, top // 4, (count, height, width))
    for k, frame in enumerate(frames):
        frame[8:20, (2 * k) % (width - 12) :][:, :12] += top // 2
    frames[:, 0, 0], frames[:, 0, 1] = 0, top
    return frames.astype(np.uint8 if bits <= 8 else np.uint16)


def write_video(
    path: Path,
    frames: NDArray,
    *,
    codec: str = "ffv1",
    pixels: str = "gray",
    fps: int = 1500,
    options: dict[str, str] | None = None,
    times: Sequence[int] | None = None,
    color_range: int | None = None,
) -> Path:
    """A film of grey frames by PyAV; `times` are presentation times in ticks of 1/fps."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps, options=options or {})
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], pixels
        if color_range is not None:
            stream.codec_context.color_range = color_range
        for k, pixels_of_frame in enumerate(frames):
            frame = video_frame(pixels_of_frame, "gray" if frames.dtype == np.uint8 else pixels)
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, fps)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def video_frame(levels: NDArray, pixels: str) -> av.VideoFrame:
    """A grey frame for the encoder, written plane by plane since PyAV knows only some depths."""
    height, width = levels.shape
    frame = av.VideoFrame(width, height, pixels)
    lines = np.zeros((height, frame.planes[0].line_size // levels.itemsize), levels.dtype)
    lines[:, :width] = levels
    frame.planes[0].update(lines.tobytes())
    return frame


def write_pictures(folder: Path, frames: NDArray, *, suffix: str = ".png", first: int = 1) -> Path:
    """A numbered sequence whose numbers are not padded, so that sorting by name would be wrong."""
    folder.mkdir(exist_ok=True)
    for k, frame in enumerate(frames):
        assert cv2.imwrite(str(folder / f"frame_{first + k}{suffix}"), frame)
    return folder


def write_tiff(path: Path, frames: NDArray, *, compression: str | None = None) -> Path:
    """A multi-page TIFF."""
    with tifffile.TiffWriter(path) as tiff:
        for frame in frames:
            tiff.write(frame, compression=compression, contiguous=False)
    return path


def write_photron(
    header: Path,
    frames: NDArray,
    *,
    stored_bits: int,
    record_rate_hz: int = 1500,
    save_step: int = 1,
    start_frame: int = 0,
    shutter_hz: int = 5000,
    effective_bits: int | None = None,
    side: str = "Lower",
    declared_frames: int | None = None,
) -> Path:
    """A Photron header (.cih or .cihx, by its suffix) and the .mraw beside it, laid out as the camera's software does."""
    count, height, width = frames.shape
    header.with_suffix(".mraw").write_bytes(pack(frames, stored_bits))
    values = {
        "width": width,
        "height": height,
        "bit": stored_bits,
        "depth": effective_bits or min(stored_bits, 12),
        "side": side,
        "total": count if declared_frames is None else declared_frames,
        "start": start_frame,
        "step": save_step,
        "rate": record_rate_hz,
        "shutter": shutter_hz,
        "nsec": round(1e9 / shutter_hz),
    }
    if header.suffix == ".cih":
        header.write_text(CIH.format(**values))
    else:
        header.write_bytes(
            b"!!! This file can not be edited. !!!".ljust(1024, b"\0") + b"CIHX" + CIHX.format(**values).encode()
        )
    return header


def pack(frames: NDArray, stored_bits: int) -> bytes:
    """The bytes of an .mraw."""
    if stored_bits == 8:
        return frames.astype(np.uint8).tobytes()
    if stored_bits == 16:
        return frames.astype("<u2").tobytes()
    first, second = frames.reshape(-1, 2).astype(np.uint16).T
    return np.stack([first >> 4, (first & 15) << 4 | second >> 8, second & 255], axis=1).astype(np.uint8).tobytes()


CIH = """#Camera Information Header
Date : 2026/01/15
Camera Type : FASTCAM
Record Rate(fps) : {rate}
Shutter Speed(s) : 1/{shutter}
Total Frame : {total}
Start Frame : {start}
Save Step : {step}
Image Width : {width}
Image Height : {height}
Color Type : Mono
Color Bit : {bit}
File Format : MRaw
EffectiveBit Depth : {depth}
EffectiveBit Side : {side}
"""

CIHX = """<?xml version="1.0" encoding="utf-8"?>
<cih>
    <fileInfo><version>1.0</version><date>2026/1/15</date></fileInfo>
    <imageFileInfo>
        <fileFormat>Mraw</fileFormat>
        <resolution><width>{width}</width><height>{height}</height></resolution>
    </imageFileInfo>
    <imageDataInfo>
        <resolution><width>{width}</width><height>{height}</height></resolution>
        <colorInfo><type>Mono</type><bit>{bit}</bit></colorInfo>
        <effectiveBit><depth>{depth}</depth><side>{side}</side></effectiveBit>
    </imageDataInfo>
    <frameInfo>
        <totalFrame>{total}</totalFrame>
        <startFrame>{start}</startFrame>
        <skipFrame>{step}</skipFrame>
    </frameInfo>
    <recordInfo>
        <recordRate>{rate}</recordRate>
        <shutterSpeed>{shutter}</shutterSpeed>
        <shutterSpeedNsec>{nsec}</shutterSpeedNsec>
    </recordInfo>
    <deviceInfo><deviceName>rendered, no camera</deviceName></deviceInfo>
</cih>
"""
