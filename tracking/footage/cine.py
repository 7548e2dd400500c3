"""Phantom .cine footage: three headers, tagged blocks with the time and exposure of every frame, and the pixels, all in one
file, little-endian, read a frame at a time.

    CINEFILEHEADER (44 bytes) · BITMAPINFOHEADER (40) · SETUP (its own length) · tagged blocks · offsets of the frames
    each frame: annotation size, annotation, image size, pixels

Pixels are 8 bit, 16 bit (10 to 16 of them in use), or packed with the high bits first: two pixels of 12 bit in three
bytes, four of 10 bit in five. The rows of unpacked frames run from the bottom up, as in a Windows bitmap, those of packed
frames from the top down. A setting of the camera's software may flip the picture in addition; the flip is carried out here, as
that software does when it shows and exports the picture.

Packed 10-bit samples are not linear. They are 12-bit levels after the transfer curve of ITU-R BT.709 (section 1.2), with black
at 64 in both scales, white at 1014 of 1024 and 4064 of 4096:

    level = 64 + 4000 L((code - 63.4) / 950.5),    L(V) = V / 4.5                          for V < 0.081
                                                   L(V) = ((V + 0.099) / 1.099)^(1 / 0.45) else

This agrees with the maker's table of 1024 entries to one level of 4096, its rounding, everywhere but at code 0. Brighter codes
are saturated. The reader returns these 12-bit levels, so noise, contrast and blur mean the same as in other formats.

Times are those of the camera's clock (32.32 fixed-point seconds). Where they are even to a hundredth of a frame, they are
roundings of k / rate, and k / rate is used; else they are used as they are. The rate in the header may differ from that of the
saved frames, and is used only where there are no times.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ...model.compiled import compiled
from ...model.errors import InputError
from .photron import RATE_TOLERANCE, unpack_12bit
from .reader import Footage, Frame, check_count, check_size, times_from_rate

Array = NDArray[np.float64]

FILE_HEADER = struct.Struct("<2sHHHiIiIIIIQ")
BITMAP_HEADER = struct.Struct("<IiiHHIIiiII")
SETUP_NEEDED_BYTES = 900
"""Length of the shortest setup that declares the number of significant bits; older ones are from cameras before 2003."""
# Offsets in SETUP [bytes].
AT_MARK = 140
"""The mark ST, and the length of SETUP."""
AT_FLIPS = 756
AT_FRAME_RATE = 768
AT_FILTERS = 808
"""Colour filters of the sensor."""
AT_ROTATE = 884
AT_REAL_BITS = 896
AT_SHUTTER_NS = 1568
"""Exposure time."""
TIMES_TAG = 1002
EXPOSURES_TAG = 1003
# biCompression of BITMAPINFOHEADER.
UNPACKED = 0
PACKED_10 = 256
PACKED_12 = 1024
# Compression of CINEFILEHEADER; 0 is grey, or colour of three samples a pixel.
JPEG = 1
COLOUR_FILTERED = 2
FIXED_POINT = 2.0**32
"""Units of a stored time in a second."""
IRIG_BITS = 3
"""The lowest bits of a stored time: flags of an external clock, not part of the time."""
MAX_ROUNDING = 0.01
"""Largest deviation of a time from k / rate that counts as rounding, in frames: a die moves 0.02 mm in it at most."""
RATE_ROUNDING = 1e-6
"""Largest relative difference between a declared rate and that of the times that counts as rounding."""
GAP_FRAMES = 1.5
"""Step between time stamps, in frames, from which frames are missing."""
MAX_EXPOSURE_SPREAD = 0.01
"""Range of the exposures, as a share of their median, up to which they count as equal."""
MAX_LISTED = 8
"""Most frame numbers that a notice lists."""


@dataclass(frozen=True)
class Header:
    """The pixels and their times, as a .cine file declares them."""

    width_px: int
    height_px: int
    packing: int
    """UNPACKED, PACKED_10 or PACKED_12."""
    stored_bits: int
    """Of a pixel in the file: 8, 10, 12 or 16."""
    bit_depth: int
    """Of a grey level after reading."""
    first_image: int
    """Number of the first frame, counted from the trigger; often negative."""
    image_count: int
    recorded_count: int
    """Frames that the camera recorded; the file holds some of them."""
    offsets_at: int
    """Offset in the file of the table of the frames' offsets [bytes]."""
    flip_sideways: bool
    flip_over: bool
    rotate_deg: int
    frame_rate_hz: int
    """As declared; 0 where it is not declared."""
    shutter_ns: int

    @property
    def frame_bytes(self) -> int:
        """Size of the pixels of one frame in the file."""
        return self.width_px * self.height_px * self.stored_bits // 8


def is_cine(path: Path) -> bool:
    """Whether a file begins like a .cine: CI, and the size of its first header."""
    with path.open("rb") as file:
        return file.read(4) == b"CI" + FILE_HEADER.size.to_bytes(2, "little")


def open_cine(path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> Footage:
    """The clip in a .cine file. Raises ValueError for one that is broken, coloured or compressed, or contradicts fps."""
    return CineClip(path, fps, frame_range)


class CineClip(Footage):
    """A Phantom clip; each frame is read from its offset."""

    def __init__(self, path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> None:
        with path.open("rb") as file:
            content = _Reader(path, file)
            header, tags_at = read_header(content)
            self._offsets, cut_off = _offsets(content, header)
            stamps, exposures = _tagged_blocks(content, header, tags_at)
        self.header = header
        count = len(self._offsets)
        declared = header.frame_rate_hz or None
        times, late, stamped = _times(path, stamps, declared, fps, count, header)
        step_s = float(np.median(np.diff(times))) if count > 1 else None
        if exposures is not None and step_s is not None:
            exposures = exposures[exposures <= step_s]  # some files declare a longer one for their last frame
        exposure_s = (
            float(np.median(exposures)) if exposures is not None and len(exposures) else header.shutter_ns * 1e-9
        )
        super().__init__(
            path,
            width_px=header.width_px,
            height_px=header.height_px,
            bit_depth=header.bit_depth,
            file_times_s=times,
            frame_range=frame_range,
            notices=(*cut_off, *late, *_exposure_notices(path, exposures), *_orientation_notices(path, header)),
            facts={
                "format": "phantom",
                "record_rate_hz": _rate_hz(step_s, declared) if step_s is not None else declared,
                "exposure_s": exposure_s or None,
                "time_stamps": stamped,
                "declared_rate_hz": declared,
                "start_frame": header.first_image,
                "packed": {UNPACKED: None, PACKED_10: 10, PACKED_12: 12}[header.packing],
            },
        )

    def _read(self, number: int) -> Frame:
        header = self.header
        with self.path.open("rb") as file:
            content = _Reader(self.path, file)
            raw = np.frombuffer(_pixels(content, int(self._offsets[number]), header, number), np.uint8)
        if header.packing == PACKED_10:
            levels: Frame = linear_levels()[unpack_10bit(raw)]
        elif header.packing == PACKED_12:
            levels = unpack_12bit(raw)
        else:
            levels = raw.copy() if header.stored_bits == 8 else raw.view("<u2").astype(np.uint16)
        levels = levels.reshape(header.height_px, header.width_px)
        bottom_up = header.packing == UNPACKED
        if bottom_up != header.flip_over:
            levels = levels[::-1]
        if header.flip_sideways:
            levels = levels[:, ::-1]
        return levels.copy()


@compiled
def unpack_10bit(packed: NDArray[np.uint8]) -> NDArray[np.uint16]:
    """(4n,) codes from (5n,) bytes, high bits first. The codes are not linear (`linear_levels`)."""
    codes = np.empty(len(packed) // 5 * 4, np.uint16)
    for i in range(len(packed) // 5):
        a, b, c = np.uint16(packed[5 * i]), np.uint16(packed[5 * i + 1]), np.uint16(packed[5 * i + 2])
        d, e = np.uint16(packed[5 * i + 3]), np.uint16(packed[5 * i + 4])
        codes[4 * i] = (a << 2) | (b >> 6)
        codes[4 * i + 1] = ((b & 63) << 4) | (c >> 4)
        codes[4 * i + 2] = ((c & 15) << 6) | (d >> 2)
        codes[4 * i + 3] = ((d & 3) << 8) | e
    return codes


@lru_cache
def linear_levels() -> NDArray[np.uint16]:
    """(1024,) linear 12-bit level of each packed 10-bit code; the module states the equation."""
    signal = (np.arange(1024) - 63.4) / 950.5
    light = np.where(signal < 0.081, signal / 4.5, ((np.maximum(signal, 0.0) + 0.099) / 1.099) ** (1.0 / 0.45))
    levels = np.rint(64.0 + 4000.0 * light).astype(np.uint16)
    levels[1015:] = 4095
    return levels


def read_header(content: _Reader) -> tuple[Header, int]:
    """The three headers, and the offset of the tagged blocks. Raises ValueError for an impossible entry."""
    path = content.path
    _, _, compression, version, _, recorded, first, count, bitmap_at, setup_at, offsets_at, _ = content.unpack(
        FILE_HEADER, 0, "its first header"
    )
    _, width, height, _, bits, packing, _, _, _, _, _ = content.unpack(BITMAP_HEADER, bitmap_at, "its bitmap header")
    mark, length = content.unpack(struct.Struct("<2sH"), setup_at + AT_MARK, "its setup")
    if version != 1 or mark != b"ST" or length < SETUP_NEEDED_BYTES:
        raise InputError(
            f"{path.name}: a .cine of an old kind (version {version}, setup of {length} bytes); "
            "save it again with the camera's software"
        )
    (filters,) = content.unpack(struct.Struct("<I"), setup_at + AT_FILTERS, "its setup")
    if compression == JPEG or compression not in (0, COLOUR_FILTERED) or filters & 0xFF or bits not in (8, 16):
        raise InputError(
            f"{path.name}: Compression = {compression}, biBitCount = {bits}, CFA = {filters}; wanted uncompressed "
            "grey pictures; save the film as a grey raw cine or as TIFF"
        )
    check_size(path, width, height)
    stored, depth = _depths(content, packing, bits, setup_at)
    per_group = {PACKED_10: 4, PACKED_12: 2}.get(packing, 1)
    if width * height % per_group:
        raise InputError(
            f"{path.name}: {stored}-bit packed needs a number of pixels divisible by {per_group}, "
            f"got {width} × {height}; save the film in 16 bit"
        )
    flips = content.unpack(struct.Struct("<ii"), setup_at + AT_FLIPS, "its setup")
    (rate,) = content.unpack(struct.Struct("<I"), setup_at + AT_FRAME_RATE, "its setup")
    (rotate,) = content.unpack(struct.Struct("<i"), setup_at + AT_ROTATE, "its setup")
    long = length >= AT_SHUTTER_NS + 4
    (shutter,) = content.unpack(struct.Struct("<I"), setup_at + AT_SHUTTER_NS, "its setup") if long else (0,)
    header = Header(
        width_px=width,
        height_px=height,
        packing=packing,
        stored_bits=stored,
        bit_depth=depth,
        first_image=first,
        image_count=count,
        recorded_count=max(recorded, count),
        offsets_at=offsets_at,
        flip_sideways=flips[0] != 0,
        flip_over=flips[1] != 0,
        rotate_deg=rotate,
        frame_rate_hz=rate,
        shutter_ns=shutter,
    )
    return header, setup_at + length


class _Reader:
    """A file that checks every read against its size first."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self.path = path
        self._file = file
        self.size = path.stat().st_size

    def bytes(self, place: int, count: int, what: str) -> bytes:
        """`count` bytes. Raises ValueError where the file ends before them, or the offset is impossible."""
        if place < 0 or place + count > self.size:
            raise InputError(f"{self.path.name}: the file of {self.size} bytes ends before {what}; copy it again")
        self._file.seek(place)
        content = self._file.read(count)
        if len(content) < count:
            raise InputError(f"{self.path.name}: the file was cut off before {what} while it was read; copy it again")
        return content

    def unpack(self, form: struct.Struct, place: int, what: str) -> tuple[Any, ...]:
        return form.unpack(self.bytes(place, form.size, what))


def _depths(content: _Reader, packing: int, bits: int, setup_at: int) -> tuple[int, int]:
    """Bits of a pixel in the file, and of its grey level after reading."""
    if packing == PACKED_10:
        return 10, 12
    if packing == PACKED_12:
        return 12, 12
    (real,) = content.unpack(struct.Struct("<I"), setup_at + AT_REAL_BITS, "its setup")
    if packing != UNPACKED or not (real == 8 if bits == 8 else 8 <= real <= 16):
        raise InputError(
            f"{content.path.name}: biCompression = {packing}, biBitCount = {bits}, RealBPP = {real}; wanted 8 or 16 bit, or "
            "packed 10 or 12 bit; save the film as one of these"
        )
    return bits, real


def _offsets(content: _Reader, header: Header) -> tuple[NDArray[np.uint64], tuple[str, ...]]:
    """(n,) offsets of the frames that are complete in the file, and a notice where the header declares more."""
    path, declared = content.path, header.image_count
    check_count(path, declared)
    table = np.frombuffer(content.bytes(header.offsets_at, 8 * declared, "the offsets of its frames"), "<u8")
    # At least eight bytes precede the pixels: the sizes of annotation and picture.
    ends = table + np.uint64(8 + header.frame_bytes)
    held = int(np.argmin(np.append(ends <= content.size, False)))
    if held == declared:
        return table, ()
    return table[:held], (
        f"{path.name}: the header declares {declared} frames and the file holds {held}; those are used.",
    )


def _pixels(content: _Reader, place: int, header: Header, number: int) -> bytes:
    """The pixels of a frame as stored."""
    what = f"frame {number}"
    (annotation,) = content.unpack(struct.Struct("<I"), place, what)
    if annotation < 8:
        raise InputError(
            f"{content.path.name}: frame {number} has an annotation of {annotation} bytes; wanted at least 8; "
            "the file is damaged, copy it again"
        )
    (size,) = content.unpack(struct.Struct("<I"), place + annotation - 4, what)
    if size != header.frame_bytes:
        raise InputError(
            f"{content.path.name}: frame {number} has {size} bytes of pixels; wanted {header.frame_bytes} for "
            f"{header.width_px} × {header.height_px} px of {header.stored_bits} bit; the file is damaged, copy it again"
        )
    return content.bytes(place + annotation, size, what)


def _tagged_blocks(content: _Reader, header: Header, place: int) -> tuple[NDArray[np.uint64] | None, Array | None]:
    """Time stamps (image_count,) as stored and exposures (image_count,) [s], each None where the file has none."""
    stamps: NDArray[np.uint64] | None = None
    exposures: Array | None = None
    more = 1
    while more and place + 8 <= header.offsets_at:
        size, kind, more = content.unpack(struct.Struct("<IHH"), place, "its tagged blocks")
        if size < 8:
            break  # the size is impossible, so no block can follow
        if kind == TIMES_TAG and size - 8 == 8 * header.image_count:
            stamps = np.frombuffer(content.bytes(place + 8, size - 8, "its times"), "<u8")
        if kind == EXPOSURES_TAG and size - 8 == 4 * header.image_count:
            exposures = np.frombuffer(content.bytes(place + 8, size - 8, "its exposures"), "<u4") / FIXED_POINT
        place += size
    return stamps, exposures


def _times(
    path: Path,
    stamps: NDArray[np.uint64] | None,
    declared_hz: float | None,
    fps: float | None,
    count: int,
    header: Header,
) -> tuple[Array, tuple[str, ...], bool]:
    """Frame times (count,) [s] since the first frame, notices on them, and whether the file states a time for every frame."""
    if stamps is None or count < 2:
        _check_rate(path, fps, declared_hz, "header declares")
        return times_from_rate(path, fps or declared_hz, count), (), False
    stamps = stamps[:count] & ~np.uint64(IRIG_BITS)
    since_s = (stamps - stamps[0]).view(np.int64) / FIXED_POINT
    step_s = float(np.median(np.diff(since_s)))
    if not step_s > 0:
        _check_rate(path, fps, declared_hz, "header declares")
        notice = f"{path.name}: the time stamps do not rise; the frames count as evenly spaced at the given rate."
        return times_from_rate(path, fps or declared_hz, count), (notice,), False
    _check_rate(path, fps, 1.0 / step_s, "time stamps have")
    since_s, replaced = _without_impossible_times(path, since_s, step_s, header.recorded_count)
    rate = _rate_hz(step_s, fps or declared_hz)
    even = np.arange(count) / rate
    if np.abs(since_s - even).max() <= MAX_ROUNDING / rate:
        return even, replaced, True
    return since_s, (*replaced, *_gaps(path, since_s, step_s)), True


def _rate_hz(step_s: float, stated: float | None) -> float:
    """The stated rate where the step between frames is a rounding of it, else the rate of the step."""
    return stated if stated is not None and abs(stated * step_s - 1.0) < RATE_ROUNDING else 1.0 / step_s


def _check_rate(path: Path, fps: float | None, found_hz: float | None, source: str) -> None:
    """Raise ValueError for an impossible fps, or one that contradicts the rate in the file."""
    if fps is not None and not (np.isfinite(fps) and fps > 0):
        raise InputError(f"{path.name}: fps = {fps}; wanted a recording rate above 0 frames per second")
    if fps is not None and found_hz is not None and abs(fps - found_hz) > RATE_TOLERANCE * fps:
        raise InputError(
            f"{path.name}: fps = {fps:g}; the {source} {found_hz:.6g} frames/s; correct fps, or leave it out"
        )


def _without_impossible_times(
    path: Path, since_s: Array, step_s: float, recorded: int
) -> tuple[Array, tuple[str, ...]]:
    """The times, interpolated where they are impossible: where they fall, or exceed the length of the recording."""
    longest_s = (recorded + 1) * step_s
    good = np.ones(len(since_s), bool)
    last = 0.0
    for k in range(1, len(since_s)):
        good[k] = 0.0 < since_s[k] - last <= longest_s
        last = since_s[k] if good[k] else last
    if good.all():
        return since_s, ()
    rows = np.arange(len(since_s))
    known = np.interp(rows, rows[good], since_s[good])
    behind = rows > rows[good][-1]
    known[behind] = since_s[good][-1] + step_s * (rows[behind] - rows[good][-1])
    names = _listed(np.flatnonzero(~good))
    notice = f"{path.name}: the time stamps of {np.count_nonzero(~good)} frames ({names}) are impossible, and were interpolated."
    return known, (notice,)


def _gaps(path: Path, since_s: Array, step_s: float) -> tuple[str, ...]:
    """A notice on missing frames, or on a rate that changes."""
    steps = np.diff(since_s) / step_s
    after_gap = np.flatnonzero(steps > GAP_FRAMES)
    if len(after_gap):
        missing = int(np.rint(steps[after_gap] - 1.0).sum())
        return (
            f"{path.name}: about {missing} frames are missing before frames {_listed(after_gap + 1)} by their time stamps, "
            "which are used as the frames' times.",
        )
    return (
        f"{path.name}: the time stamps are uneven, {steps.min():.3g} to {steps.max():.3g} of the usual step; "
        "they are used as the frames' times.",
    )


def _listed(numbers: NDArray[np.int64]) -> str:
    return ", ".join(map(str, numbers[:MAX_LISTED])) + (", ..." if len(numbers) > MAX_LISTED else "")


def _exposure_notices(path: Path, exposures: Array | None) -> tuple[str, ...]:
    if (
        exposures is None
        or not len(exposures)
        or np.ptp(exposures) <= MAX_EXPOSURE_SPREAD * float(np.median(exposures))
    ):
        return ()
    low, high = 1e6 * exposures.min(), 1e6 * exposures.max()
    return (f"{path.name}: the exposure varies from {low:.4g} to {high:.4g} µs over the clip; the median is used.",)


def _orientation_notices(path: Path, header: Header) -> tuple[str, ...]:
    """Notices on rotations and flips in the file, which a calibration must share."""
    if header.rotate_deg:
        return (
            f"{path.name}: the file declares a rotation by {header.rotate_deg}°, which is not carried out; calibrate without it.",
        )
    if header.flip_sideways == header.flip_over:
        return ()
    return (
        f"{path.name}: the file declares a mirrored picture, which is carried out; "
        "calibrate with pictures that are mirrored in the same way.",
    )
