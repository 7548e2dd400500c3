"""Writers of small films in every format, for the tests of the readers and for the data samples."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray


def noisy_frames(count: int, *, bits: int = 8, height: int = 48, width: int = 64, seed: int = 1) -> NDArray[np.uint16]:
    """(count, height, width) of a moving bright square in noise, over the full depth; no two frames are equal."""
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
    extradata: bytes | None = None,
) -> Path:
    """A film of grey frames by PyAV; `times` are presentation times in ticks of 1/fps."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=fps, options=options or {})
        stream.height, stream.width, stream.pix_fmt = frames.shape[1], frames.shape[2], pixels
        if color_range is not None:
            stream.codec_context.color_range = color_range
        if extradata is not None:
            stream.codec_context.extradata = extradata
        for k, pixels_of_frame in enumerate(frames):
            frame = video_frame(pixels_of_frame, "gray" if frames.dtype == np.uint8 else pixels)
            if times is not None:
                frame.pts, frame.time_base = times[k], Fraction(1, fps)
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return path


def with_display_matrix(path: Path, a: float, b: float, c: float, d: float) -> Path:
    """An MP4 with another display matrix [a b; c d] in its track header."""
    content = bytearray(path.read_bytes())
    # The matrix of a track header of version 0 follows 44 bytes behind its name.
    begin = content.find(b"tkhd") + 44
    assert content[begin + 32 : begin + 36] == b"\x40\0\0\0"
    a, b, c, d = (round(each * (1 << 16)) for each in (a, b, c, d))
    content[begin : begin + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(content)
    return path


def video_frame(levels: NDArray, pixels: str) -> av.VideoFrame:
    """A grey frame for the encoder, written by its plane, since PyAV supports some depths only."""
    height, width = levels.shape
    frame = av.VideoFrame(width, height, pixels)
    lines = np.zeros((height, frame.planes[0].line_size // levels.itemsize), levels.dtype)
    lines[:, :width] = levels
    frame.planes[0].update(lines.tobytes())
    return frame


def write_pictures(folder: Path, frames: NDArray, *, suffix: str = ".png") -> Path:
    """A numbered sequence whose numbers are not padded, so that sorting by name would be wrong."""
    folder.mkdir(exist_ok=True)
    for k, frame in enumerate(frames, 1):
        assert cv2.imwrite(str(folder / f"frame_{k}{suffix}"), frame)
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


def write_cine(
    path: Path,
    frames: NDArray,
    *,
    stored_bits: int,
    real_bits: int | None = None,
    rate_hz: int = 1500,
    times_s: Sequence[float] | None = None,
    timed: bool = True,
    exposure_s: float | Sequence[float] = 2e-4,
    flips: tuple[int, int] = (0, 0),
    annotation: bytes = b"",
) -> Path:
    """A Phantom .cine: three headers, tagged blocks of times and exposures, offsets, frames."""
    count, height, width = frames.shape
    setup = bytearray(5740)
    struct.pack_into("<2sH", setup, 140, b"ST", len(setup))
    struct.pack_into("<iiII", setup, 756, *flips, 0, rate_hz)
    struct.pack_into("<I", setup, 896, real_bits or min(stored_bits, 12))
    struct.pack_into("<I", setup, 1568, round(1e9 * float(np.mean(exposure_s))))
    trigger_s = 1_785_000_000.25
    times = np.arange(count) / rate_hz if times_s is None else np.asarray(times_s)
    # In two steps: seconds since 1970 and 32 bits of fraction exceed a double.
    stamps = (np.uint64(int(trigger_s * 2**32)) + np.rint(times * 2**32).astype(np.int64).view(np.uint64)).astype("<u8")
    exposures = np.rint(np.broadcast_to(exposure_s, count) * 2.0**32).astype("<u4")
    blocks = b""
    if timed:
        blocks += struct.pack("<IHH", 8 + 8 * count, 1002, 1) + stamps.tobytes()
        blocks += struct.pack("<IHH", 8 + 5, 1007, 1) + b"later"  # a block that no reader needs
    blocks += struct.pack("<IHH", 8 + 4 * count, 1003, 0) + exposures.tobytes()
    offsets_at = 44 + 40 + len(setup) + len(blocks)
    picture = [pack_cine(frame, stored_bits) for frame in frames]
    begin = struct.pack("<I", 8 + len(annotation)) + annotation + struct.pack("<I", len(picture[0]))
    size = len(begin) + len(picture[0])
    offsets = offsets_at + 8 * count + size * np.arange(count)
    packing = {10: 256, 12: 1024}.get(stored_bits, 0)
    counts = -7, 4 * count, -7, count  # the trigger is within the film, whose recording was four times as long
    file_header = struct.pack("<2sHHHiIiIIII", b"CI", 44, 0, 1, *counts, 44, 84, offsets_at)
    bits = 8 if stored_bits == 8 else 16
    bitmap = struct.pack("<IiiHHIIiiII", 40, width, height, 1, bits, packing, len(picture[0]), 0, 0, 0, 0)
    path.write_bytes(
        b"".join([file_header, struct.pack("<II", 2**30, int(trigger_s)), bitmap, setup, blocks])
        + offsets.astype("<u8").tobytes()
        + b"".join(begin + pixels for pixels in picture)
    )
    return path


def pack_cine(frame: NDArray, stored_bits: int) -> bytes:
    """The bytes of one frame of a .cine: rows from the bottom up unless they are packed."""
    if stored_bits == 10:
        a, b, c, d = frame.reshape(-1, 4).astype(np.uint16).T
        five = [a >> 2, (a & 3) << 6 | b >> 4, (b & 15) << 4 | c >> 6, (c & 63) << 2 | d >> 8, d & 255]
        return np.stack(five, axis=1).astype(np.uint8).tobytes()
    return pack(frame, 12) if stored_bits == 12 else pack(frame[::-1], stored_bits)


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
