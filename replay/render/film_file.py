"""Writes frames of grey levels as a film: without loss (FFV1), or as phones and cameras store them (H.264, HEVC, MJPEG).

The lossy codecs hold luma and chroma (4:2:0); the chroma is that of grey. Luma has limited range (16 to 235 in 8 bit) unless
full range is chosen, and the file declares which. MJPEG has full range always. FFV1 holds monochrome frames at full scale.

A phone that is held upright stores its frames lying on their side, with the rotation that a player has to undo in the MP4.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

Frame = NDArray[np.uint8] | NDArray[np.uint16]

CONTAINER_FPS = 30
"""Nominal rate of the container, because AVI refuses 1500 frames per second; the scene states the true rate."""
CODECS = ("ffv1", "h264", "hevc", "mjpeg")
ENCODERS = {"ffv1": "ffv1", "h264": "libx264", "hevc": "libx265", "mjpeg": "mjpeg"}
DEPTHS = {"ffv1": (8, 10, 12, 16), "h264": (8, 10), "hevc": (8, 10, 12), "mjpeg": (8,)}
"""Bits of a pixel that each codec can hold and common readers support."""
USUAL_CRF = {"h264": 20, "hevc": 22, "mjpeg": 4}
"""What phones and cameras use in good quality. The encoders' own values are 23, 28 and about 5."""
CRF_RANGE = {"h264": (0, 51), "hevc": (0, 51), "mjpeg": (1, 31)}
LIMITED_RANGE, FULL_RANGE = 1, 2
"""FFmpeg's AVCOL_RANGE_MPEG and AVCOL_RANGE_JPEG."""


@dataclass(frozen=True)
class Codec:
    """How a film is stored."""

    name: str = "ffv1"
    crf: int | None = None
    """Constant rate factor of H.264 and HEVC, or quantiser of MJPEG: higher is smaller and worse. None: USUAL_CRF."""
    full_range: bool = False
    """Whether the luma of H.264 and HEVC has full range."""
    turned_deg: int = 0
    """Angle, counter-clockwise, by which players turn the stored frames to show them upright: 0, 90, 180 or 270."""

    def __post_init__(self) -> None:
        if self.name not in CODECS:
            raise InputError(f"codec = {self.name!r}: wanted one of {', '.join(CODECS)}")
        if self.crf is not None:
            if self.name == "ffv1":
                raise InputError(
                    f"crf = {self.crf}: ffv1 stores frames without loss; wanted h264, hevc or mjpeg with it"
                )
            low, high = CRF_RANGE[self.name]
            if not low <= self.crf <= high:
                raise InputError(f"crf = {self.crf}: wanted {low} to {high} for {self.name}")
        if self.full_range and self.name not in ("h264", "hevc"):
            raise InputError(f"full_range: the range of {self.name} is fixed; wanted h264 or hevc with it")

        if self.turned_deg % 90 or not 0 <= self.turned_deg < 360:
            raise InputError(f"turned_deg = {self.turned_deg}: wanted 0, 90, 180 or 270")
        if self.turned_deg and self.suffix != ".mp4":
            raise InputError(f"turned_deg = {self.turned_deg}: only MP4 states it; wanted h264 or hevc with it")
        if self.turned_deg and not hasattr(av.VideoStream, "set_display_rotation"):
            raise InputError(
                f"turned_deg = {self.turned_deg}: PyAV {av.__version__} cannot write it; wanted PyAV 18 or newer"
            )

    @property
    def suffix(self) -> str:
        """Of the file: AVI, or MP4 where the codec belongs in it."""
        return ".mp4" if self.name in ("h264", "hevc") else ".avi"

    def checked(self, bit_depth: int) -> None:
        """Raises ValueError for a depth that the codec cannot hold."""
        if bit_depth not in DEPTHS[self.name]:
            wanted = ", ".join(map(str, DEPTHS[self.name]))
            raise InputError(f"bit_depth = {bit_depth}: wanted one of {wanted} for {self.name}")


def write_film(path: Path, frames: Iterator[Frame], codec: Codec, bit_depth: int) -> None:
    """Write frames (height, width), one in memory at a time. Raises ValueError for an odd size with a codec of 4:2:0."""
    with av.open(str(path), "w") as container:
        stream = None
        for number, upright in enumerate(frames):
            levels = _turned(upright, codec.turned_deg)
            if stream is None:
                stream = _stream(container, codec, bit_depth, *levels.shape)
            frame = _video_frame(levels, stream.pix_fmt, codec, bit_depth)
            frame.pts, frame.time_base = number, Fraction(1, CONTAINER_FPS)
            container.mux(stream.encode(frame))
        if stream is not None:
            container.mux(stream.encode(None))


def _turned(upright: Frame, turned_deg: int) -> Frame:
    """The frame as it is stored, before a player turns it back."""
    turned = np.rot90(upright, -turned_deg // 90)
    return turned.astype(np.uint8) if upright.itemsize == 1 else turned.astype(np.uint16)


def _stream(
    container: av.container.OutputContainer, codec: Codec, bit_depth: int, height: int, width: int
) -> av.VideoStream:
    if codec.name != "ffv1" and (height % 2 or width % 2):
        raise InputError(f"{width} × {height} pixels: {codec.name} stores chroma for 2 × 2 pixels; wanted an even size")
    stream = container.add_stream(ENCODERS[codec.name], rate=CONTAINER_FPS, options=_options(codec))
    stream.height, stream.width = height, width
    stream.pix_fmt = _pixel_format(codec, bit_depth)
    if codec.turned_deg:
        stream.set_display_rotation(codec.turned_deg)
    if codec.name != "ffv1":
        stream.codec_context.color_range = FULL_RANGE if _is_full_range(codec) else LIMITED_RANGE
    return stream


def _options(codec: Codec) -> dict[str, str]:
    # One thread each: the encoders' own threads would compete with the renderer's, and change the result of HEVC.
    crf = str(codec.crf if codec.crf is not None else USUAL_CRF.get(codec.name, 0))
    if codec.name == "h264":
        return {"threads": "1", "crf": crf, "preset": "medium"}
    if codec.name == "hevc":
        return {"x265-params": f"crf={crf}:log-level=none:pools=none:frame-threads=1", "preset": "fast"}
    return {"threads": "1", "qmin": crf, "qmax": crf} if codec.name == "mjpeg" else {"threads": "1"}


def _pixel_format(codec: Codec, bit_depth: int) -> str:
    deep = "" if bit_depth == 8 else f"{bit_depth}le"
    if codec.name == "ffv1":
        return f"gray{deep}"
    return "yuvj420p" if codec.name == "mjpeg" else f"yuv420p{deep}"


def _is_full_range(codec: Codec) -> bool:
    return codec.full_range or codec.name == "mjpeg"


def _video_frame(levels: Frame, pixel_format: str, codec: Codec, bit_depth: int) -> av.VideoFrame:
    """The frame with its planes filled; FFmpeg's own conversion would not know the range of the levels."""
    height, width = levels.shape
    frame = av.VideoFrame(width, height, pixel_format)
    if codec.name == "ffv1":
        _fill(frame.planes[0], levels)
        return frame
    frame.color_range = FULL_RANGE if _is_full_range(codec) else LIMITED_RANGE
    top, scale = 2**bit_depth - 1, 2 ** (bit_depth - 8)
    luma = levels.astype(float) if _is_full_range(codec) else 16 * scale + levels * (219 * scale / top)
    _fill(frame.planes[0], np.rint(luma).astype(levels.dtype))
    for plane in frame.planes[1:]:
        _fill(plane, np.full((height // 2, width // 2), 128 * scale, levels.dtype))
    return frame


def _fill(plane: av.video.plane.VideoPlane, levels: Frame) -> None:
    """Write pixels into a plane, whose lines may be padded."""
    lines = np.zeros((levels.shape[0], plane.line_size // levels.itemsize), levels.dtype)
    lines[:, : levels.shape[1]] = levels
    plane.update(lines.tobytes())
