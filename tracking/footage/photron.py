"""Photron footage: a header (.cih text or .cihx XML) and the raw pixels (.mraw) next to it.

Pixels are 8 bit, 16 bit little-endian, or 12 bit packed: two pixels in three bytes, the first pixel's high bits first,
a = b0 << 4 | b1 >> 4, b = (b1 & 15) << 8 | b2.

The camera may save every n-th frame only (`Save Step`, `skipFrame`): frame k of the file was then exposed at
k n / record rate. In .cihx `shutterSpeed` is the reciprocal of the exposure: 50000 means 1/50000 s.
"""

from __future__ import annotations

import re
import threading
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled, inner
from ...model.errors import InputError
from .reader import Footage, Frame, check_size, cut_off, times_from_rate

MAX_HEADER_BYTES = 2**24
"""A thousand times a header; a larger file is something else."""
RECOGNISED_BYTES = 4096
"""Start of a file in which a header shows."""
HEADER_SUFFIXES = (".cihx", ".cih")
RATE_TOLERANCE = 1e-3
"""Largest relative difference between the header's rate and the scene's that counts as rounding."""
CIHX_KEYS = {
    "Image Width": "imageDataInfo/resolution/width",
    "Image Height": "imageDataInfo/resolution/height",
    "Color Type": "imageDataInfo/colorInfo/type",
    "Color Bit": "imageDataInfo/colorInfo/bit",
    "EffectiveBit Depth": "imageDataInfo/effectiveBit/depth",
    "EffectiveBit Side": "imageDataInfo/effectiveBit/side",
    "Total Frame": "frameInfo/totalFrame",
    "Start Frame": "frameInfo/startFrame",
    "Save Step": "frameInfo/skipFrame",
    "Record Rate(fps)": "recordInfo/recordRate",
    "Shutter Speed(s)": "recordInfo/shutterSpeed",
    "Shutter Type2(nsec)": "recordInfo/shutterSpeedNsec",
    "Camera Type": "deviceInfo/deviceName",
    "Date": "fileInfo/date",
}
"""Paths in the XML header, by the keys of the text header."""


@dataclass(frozen=True)
class Header:
    """The pixels and their times, as a Photron header declares them."""

    width_px: int
    height_px: int
    stored_bits: int
    """8, 12 (packed) or 16."""
    effective_bits: int
    high_side: bool
    """Whether the effective bits are the upper ones of those stored."""
    total_frames: int
    start_frame: int
    """Number of the first frame, counted from the trigger."""
    save_step: int
    record_rate_hz: float | None
    exposure_s: float | None
    camera: str
    date: str

    @property
    def frame_bytes(self) -> int:
        """Size of one frame in the file."""
        return self.width_px * self.height_px * self.stored_bits // 8

    @property
    def bit_depth(self) -> int:
        """Bits of a grey level after reading."""
        return min(self.stored_bits, self.effective_bits) if self.stored_bits == 16 else self.stored_bits


def is_photron(path: Path) -> bool:
    """Whether a file is a Photron header, or has the name of its pixels, which have no signature."""
    with path.open("rb") as file:
        start = file.read(RECOGNISED_BYTES)
    return (
        path.suffix.lower() == ".mraw" or b"<cih>" in start or start.lstrip().startswith(b"#Camera Information Header")
    )


def open_photron(path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> Footage:
    """The clip of a header or of its pixels. Raises ValueError or FileNotFoundError where the two do not match."""
    header, pixels = photron_files(path)
    return PhotronClip(header, pixels, fps, frame_range)


def photron_files(path: Path) -> tuple[Path, Path]:
    """Header and pixels, from either of them; raises FileNotFoundError where the other is not next to it."""
    if path.suffix.lower() == ".mraw":
        return _file_next_to(path, HEADER_SUFFIXES), path
    return path, _file_next_to(path, (".mraw",))


class PhotronClip(Footage):
    """A Photron clip; each frame is read when it is needed."""

    def __init__(self, header: Path, pixels: Path, fps: float | None, frame_range: tuple[int, int] | None) -> None:
        self.header = read_header(header)
        check_size(header, self.header.width_px, self.header.height_px)
        count, notices = _readable_frames(pixels, self.header)
        rate_hz = _frame_rate_hz(header, self.header, fps)
        self._pixels, self._buffers = pixels, threading.local()
        super().__init__(
            header,
            width_px=self.header.width_px,
            height_px=self.header.height_px,
            bit_depth=self.header.bit_depth,
            file_times_s=times_from_rate(header, rate_hz, count),
            frame_range=frame_range,
            notices=notices,
            facts={"format": "photron", **vars(self.header)},
        )

    def _read(self, number: int) -> Frame:
        header, size = self.header, self.header.frame_bytes
        with self._pixels.open("rb", buffering=0) as file:
            file.seek(number * size)
            raw = np.fromfile(file, np.uint8, size)
        if len(raw) < size:
            raise cut_off(self._pixels, number)
        shape = (header.height_px, header.width_px)
        if header.stored_bits == 8:
            return raw.reshape(shape)
        if header.stored_bits == 12:
            return unpack_12bit(raw).reshape(shape)
        levels = raw.view("<u2").astype(np.uint16).reshape(shape)
        return levels >> np.uint16(16 - header.bit_depth) if header.high_side else levels

    def _read_into(self, number: int, out: Frame, box: tuple[int, int, int, int]) -> None:
        """Read only the lines of the box, and unpack only the box."""
        header, (x0, y0, x1, y1) = self.header, box
        line_bits = header.width_px * header.stored_bits
        if line_bits % 8 or header.stored_bits == 16:
            out[y0:y1, x0:x1] = self._read(number)[y0:y1, x0:x1]
            return
        line = line_bits // 8
        raw = self._line_buffer()[: (y1 - y0) * line]
        with self._pixels.open("rb", buffering=0) as file:
            file.seek(number * header.frame_bytes + y0 * line)
            if file.readinto(raw.data) < len(raw):
                raise cut_off(self._pixels, number)
        raw = raw.reshape(y1 - y0, line)
        if header.stored_bits == 8:
            out[y0:y1, x0:x1] = raw[:, x0:x1]
            return
        # Pixels are packed in pairs, so whole pairs are unpacked.
        first, last = x0 // 2, (x1 + 1) // 2
        _unpack_lines(raw[:, 3 * first : 3 * last], out[y0:y1, 2 * first : 2 * last])

    def _line_buffer(self) -> NDArray[np.uint8]:
        """Memory for the bytes of one frame, one for each thread: new memory costs as much time as reading."""
        if not hasattr(self._buffers, "bytes"):
            self._buffers.bytes = np.empty(self.header.frame_bytes, np.uint8)
        return np.asarray(self._buffers.bytes)


@compiled(nogil=True)
def unpack_12bit(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """(2n,) levels from (3n,) bytes. Ten times as fast as numpy, which needs three passes and copies."""
    levels = np.empty(len(packed) // 3 * 2, np.uint16)
    _unpack(packed, levels)
    return levels


@compiled(nogil=True)
def _unpack_lines(packed: NDArray[np.uint8], levels: NDArray[np.uint16]) -> None:
    """The same, line by line, into levels (lines, 2n) from bytes (lines, 3n)."""
    for k in range(len(packed)):
        _unpack(packed[k], levels[k])


@inner
def _unpack(packed: NDArray[np.uint8], levels: NDArray[np.uint16]) -> None:
    for i in range(len(packed) // 3):
        first, middle, last = np.uint16(packed[3 * i]), np.uint16(packed[3 * i + 1]), np.uint16(packed[3 * i + 2])
        levels[2 * i] = (first << 4) | (middle >> 4)
        levels[2 * i + 1] = ((middle & 15) << 8) | last


def read_header(path: Path) -> Header:
    """A .cih or .cihx header. Raises ValueError with the key that is missing or impossible."""
    if path.stat().st_size > MAX_HEADER_BYTES:
        raise InputError(
            f"{path.name}: {path.stat().st_size} bytes are too many for a Photron header; give its .cih or .cihx"
        )
    content = path.read_bytes()
    keys = _xml_keys(path, content) if b"<cih>" in content else _text_keys(content)
    header = Header(
        width_px=_whole(path, keys, "Image Width"),
        height_px=_whole(path, keys, "Image Height"),
        stored_bits=_whole(path, keys, "Color Bit"),
        effective_bits=_whole(path, keys, "EffectiveBit Depth", keys.get("Color Bit")),
        high_side=keys.get("EffectiveBit Side", "Lower").lower() == "higher",
        total_frames=_whole(path, keys, "Total Frame"),
        start_frame=_whole(path, keys, "Start Frame", "0"),
        save_step=max(1, _whole(path, keys, "Save Step", "1")),
        record_rate_hz=_rate_hz(keys),
        exposure_s=_exposure_s(keys),
        camera=keys.get("Camera Type", ""),
        date=keys.get("Date", ""),
    )
    _check(path, header, keys.get("Color Type", "Mono"))
    return header


def _check(path: Path, header: Header, colour: str) -> None:
    """Raise ValueError for a header whose pixels cannot be read."""
    if colour.lower() not in ("mono", "raw") or header.stored_bits not in (8, 12, 16):
        raise InputError(
            f"{path.name}: Color Type = {colour}, Color Bit = {header.stored_bits}; "
            "wanted Mono or Raw of 8, 12 or 16 bit; export the film as one of these"
        )
    if header.stored_bits == 12 and header.width_px * header.height_px % 2:
        raise InputError(
            f"{path.name}: 12-bit packed needs an even number of pixels, got {header.width_px} × {header.height_px}; "
            "export the film in 16 bit"
        )
    if not 1 <= header.effective_bits <= 16:
        raise InputError(
            f"{path.name}: EffectiveBit Depth = {header.effective_bits}; wanted 1 to 16; export the film again"
        )


def _text_keys(content: bytes) -> dict[str, str]:
    """`Key : Value` lines; the first line of a key counts, since tables of versions follow."""
    keys: dict[str, str] = {}
    for line in content.decode("latin-1").splitlines():
        key, colon, value = line.partition(" : ")
        if colon:
            keys.setdefault(key.strip(), value.strip())
    return keys


def _xml_keys(path: Path, content: bytes) -> dict[str, str]:
    """The keys of the text header, from the XML inside a binary file."""
    end = content.find(b"</cih>")
    if end < 0:
        raise InputError(f"{path.name}: the header ends before </cih>; copy it again from the camera")
    try:
        root = ElementTree.fromstring(
            content[content.index(b"<cih>") : end + len(b"</cih>")].decode("utf-8", "replace")
        )
    except ElementTree.ParseError as error:
        raise InputError(f"{path.name}: the header is damaged XML ({error}); copy it again from the camera") from error
    return {key: text.strip() for key, place in CIHX_KEYS.items() if (text := root.findtext(place))}


def _whole(path: Path, keys: dict[str, str], key: str, default: str | None = None) -> int:
    text = keys.get(key, default)
    if text is None or not re.fullmatch(r"[+-]?\d{1,15}", text):
        raise InputError(f"{path.name}: {key} = {text}; wanted a whole number; export the film again")
    return int(text)


def _number(text: str) -> float | None:
    """A decimal number or a fraction above zero; None for anything else."""
    # Powers of ten are excluded: Fraction("1e999999999") would compute every digit.
    if not re.fullmatch(r"\d{1,15}(\.\d{0,15}|/\d{1,15})?", text.strip()):
        return None
    try:
        value = float(Fraction(text.strip()))
    except (ValueError, ZeroDivisionError):
        return None
    return value if value > 0 else None


def _rate_hz(keys: dict[str, str]) -> float | None:
    """The record rate; None where an external clock drove the camera."""
    return _number(keys.get("Record Rate(fps)", ""))


def _exposure_s(keys: dict[str, str]) -> float | None:
    """From the nanoseconds where given, else from the shutter: `1/15371` in .cih, its reciprocal in .cihx."""
    nanoseconds, shutter = _number(keys.get("Shutter Type2(nsec)", "")), _number(keys.get("Shutter Speed(s)", ""))
    if nanoseconds:
        return nanoseconds * 1e-9
    return (shutter if shutter <= 1 else 1 / shutter) if shutter else None


def _frame_rate_hz(path: Path, header: Header, fps: float | None) -> float | None:
    """Frame rate of the file; `fps` may be the camera's rate or, where frames were left out, that of the file."""
    recorded = header.record_rate_hz
    if recorded is None:
        return fps / header.save_step if fps else fps
    if fps is not None and min(abs(fps - recorded), abs(fps - recorded / header.save_step)) > RATE_TOLERANCE * fps:
        step = f" (every {header.save_step}th frame kept)" if header.save_step > 1 else ""
        raise InputError(
            f"{path.name}: fps = {fps:g}; the header declares {recorded:g} frames/s{step}; correct fps, or leave it out"
        )
    return recorded / header.save_step


def _readable_frames(pixels: Path, header: Header) -> tuple[int, tuple[str, ...]]:
    """Number of complete frames in the file, and a notice where the header declares another."""
    size = pixels.stat().st_size
    held = size // header.frame_bytes
    if held == 0:
        raise InputError(
            f"{pixels.name}: {size} bytes; one frame takes {header.frame_bytes}, so the file is empty or cut off; copy it again"
        )
    count = min(held, header.total_frames) if header.total_frames > 0 else held
    if held < header.total_frames:
        return count, (
            f"{pixels.name}: the header declares {header.total_frames} frames and the file holds {held}; those are used.",
        )
    if size > header.total_frames * header.frame_bytes:
        return count, (
            f"{pixels.name}: the file is longer than the {header.total_frames} frames in its header; {count} are used.",
        )
    return count, ()


def _file_next_to(path: Path, suffixes: tuple[str, ...]) -> Path:
    """The file of the same name with one of these suffixes, in either case."""
    for suffix in suffixes:
        for candidate in (path.with_suffix(suffix), path.with_suffix(suffix.upper())):
            if candidate.is_file():
                return candidate
    raise FileNotFoundError(
        f"{path.name}: there is no {path.stem}{' or '.join(suffixes)} next to it; keep header and pixels together"
    )
