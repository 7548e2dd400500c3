"""Clips stored as pictures: a folder, a glob pattern, one picture of a numbered sequence, or a multi-page TIFF.

Pictures keep their depth: 8 bit as uint8, 16 bit as uint16. Colour becomes luma with the weights of ITU-R BT.601.
"""

from __future__ import annotations

import glob
import io
import logging
import re
import struct
import warnings
import weakref
import zlib
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import tifffile
from PIL import Image

from ...model.errors import InputError
from .reader import Footage, Frame, check_size, cut_off, times_from_rate

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".pnm", ".webp", ".jp2")

MAX_PICTURE_BYTES = 2**29
"""Size of the largest frame accepted (MAX_PIXELS) in 16 bit and colour, uncompressed."""
MAX_PIXELS_PER_BYTE = 5000
"""Of a compressed page: no codec of TIFF compresses a uniform picture more."""
MAX_KINDS_NAMED = 3
"""Most kinds of file names that an error lists."""
PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
TIFF_ERRORS = Exception
"""What tifffile raises on a damaged file: any error of its arithmetic on damaged tags, such as a division by zero."""


def open_pictures(path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> Footage:
    """A numbered sequence, given by its folder, a glob pattern or one of its pictures; or a multi-page TIFF."""
    if _is_multi_page(path):
        return TiffClip(path, fps, frame_range)
    return PictureClip(path, picture_files(path), fps, frame_range)


def files_of_pictures(path: Path) -> tuple[Path, ...]:
    """The files that `open_pictures` reads; raises the same ValueError."""
    return (path,) if _is_multi_page(path) else tuple(picture_files(path))


def _is_multi_page(path: Path) -> bool:
    """Whether a path is a TIFF of several pages, rather than one picture of a sequence."""
    if not (path.is_file() and is_tiff(path)):
        return False
    with _opened_tiff(path) as tiff:
        return _page_count(tiff) != 1


def is_tiff(path: Path) -> bool:
    """Whether a file begins like a TIFF (classic or big)."""
    with path.open("rb") as file:
        return file.read(4) in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def picture_files(path: Path) -> list[Path]:
    """The files of a sequence, by their numbers (frame_2 before frame_10). Raises ValueError where there is none."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES and _number(file)]
        kinds = sorted({_pattern(file) for file in files})
        if len(kinds) > 1:
            raise InputError(
                f"{path.name}: the folder holds pictures of {len(kinds)} kinds "
                f"({', '.join(kinds[:MAX_KINDS_NAMED])}); give one picture of the sequence"
            )
    elif path.is_file():
        files = (
            [file for file in path.parent.iterdir() if _pattern(file) == _pattern(path)] if _number(path) else [path]
        )
    else:
        files = [Path(name) for name in glob.glob(str(path))]
    if not files:
        raise InputError(f"{path.name}: no pictures there; accepted are {', '.join(PICTURE_SUFFIXES)}")
    return sorted(files, key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)] or [0])


def read_picture(path: Path) -> Frame:
    """(height, width) grey levels at native depth. Raises ValueError for a file that is no picture of 8 or 16 bit."""
    if is_tiff(path):
        with _opened_tiff(path) as tiff:
            return _page_pixels(path, tiff, 0)
    if path.stat().st_size > MAX_PICTURE_BYTES:
        raise InputError(
            f"{path.name}: {path.stat().st_size} bytes; wanted a picture of {MAX_PICTURE_BYTES} at most; save it again"
        )
    data = np.fromfile(path, np.uint8)
    _check_declared_size(path, data.tobytes())
    if not _is_whole_png(data.tobytes()):
        raise InputError(f"{path.name}: the picture is damaged (wrong checksums); save it again")
    try:
        with _quiet():
            picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION) if len(data) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise InputError(
            f"{path.name}: the picture is empty, damaged or of an unknown kind; save it again as PNG or TIFF"
        )
    return to_grey(path, picture, bgr=True)


def _check_declared_size(path: Path, data: bytes) -> None:
    """Raise ValueError for a picture that is too large, before memory is taken. OpenCV limits the kinds that only it reads."""
    try:
        with (
            warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(io.BytesIO(data)) as picture,
        ):
            width_px, height_px = picture.size
    except Image.DecompressionBombError as error:
        raise InputError(
            f"{path.name}: the header declares more pixels than any camera has; save the picture again"
        ) from error
    except Exception:  # any error of Pillow on a damaged header; decoding reports the damage
        return
    check_size(path, width_px, height_px)


def _is_whole_png(data: bytes) -> bool:
    """Whether the chunks of a PNG are complete, with the right checksums; True for every other kind of picture.

    libpng reports damage on the terminal, which no setting prevents, and fills the rest of the picture.
    """
    if not data.startswith(PNG_SIGNATURE):
        return True
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        size, kind = struct.unpack_from(">I4s", data, at)
        if data[at + 8 + size : at + 12 + size] != zlib.crc32(data[at + 4 : at + 8 + size]).to_bytes(4, "big"):
            return False
        if kind == b"IEND":
            return True
        at += 12 + size
    return False


def to_grey(path: Path, picture: Any, *, bgr: bool) -> Frame:
    """Luma of a picture (height, width) or (height, width, channels)."""
    picture = np.asarray(picture)
    if picture.dtype not in (np.uint8, np.uint16):
        raise InputError(
            f"{path.name}: pixels of type {picture.dtype}; wanted 8- or 16-bit unsigned grey levels; save the picture so"
        )
    picture = picture.astype(picture.dtype.newbyteorder("="))
    if picture.ndim == 3 and picture.shape[2] in (3, 4):
        return np.asarray(
            cv2.cvtColor(np.ascontiguousarray(picture[..., :3]), cv2.COLOR_BGR2GRAY if bgr else cv2.COLOR_RGB2GRAY)
        )
    if picture.ndim == 3 and picture.shape[2] in (1, 2):
        picture = picture[..., 0]
    if picture.ndim != 2:
        raise InputError(f"{path.name}: an array of shape {picture.shape}; wanted a grey or RGB picture; save it so")
    return np.ascontiguousarray(picture)


class PictureClip(Footage):
    """A sequence of one file a frame; the first picture gives size and depth."""

    def __init__(self, path: Path, files: list[Path], fps: float | None, frame_range: tuple[int, int] | None) -> None:
        first = read_picture(files[0])
        self._files = files
        self._dtype = first.dtype
        super().__init__(
            path,
            width_px=first.shape[1],
            height_px=first.shape[0],
            bit_depth=8 * first.dtype.itemsize,
            file_times_s=times_from_rate(path, fps, len(files)),
            frame_range=frame_range,
            notices=_missing_numbers(path, files),
            facts={"format": "pictures", "first_file": files[0].name, "last_file": files[-1].name},
        )

    def _read(self, number: int) -> Frame:
        frame = read_picture(self._files[number])
        if frame.shape != (self.height_px, self.width_px) or frame.dtype != self._dtype:
            h, w = frame.shape
            raise InputError(
                f"{self._files[number].name}: the picture has {w} × {h} px {frame.dtype}; wanted the first one's "
                f"{self.width_px} × {self.height_px} px {self._dtype}; keep one sequence in a folder"
            )
        return frame


class TiffClip(Footage):
    """The pages of one TIFF, read one at a time."""

    def __init__(self, path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> None:
        stack = ExitStack()
        self._tiff = stack.enter_context(_opened_tiff(path))
        weakref.finalize(self, stack.close)
        count, notices = _readable_pages(path, self._tiff)
        if not count:
            raise InputError(f"{path.name}: the TIFF is cut off within its first page; save it again")
        first = _page_pixels(path, self._tiff, 0)
        super().__init__(
            path,
            width_px=first.shape[1],
            height_px=first.shape[0],
            bit_depth=8 * first.dtype.itemsize,
            file_times_s=times_from_rate(path, fps, count),
            frame_range=frame_range,
            notices=notices,
            facts={"format": "tiff", "pages": count},
        )

    def _read(self, number: int) -> Frame:
        return _page_pixels(self.path, self._tiff, number)


def _number(path: Path) -> str | None:
    """The last run of digits in a file's name: the number of the frame."""
    runs = re.findall(r"\d+", path.stem)
    return runs[-1] if runs else None


def _pattern(path: Path) -> str:
    """A file's name without its number, which all pictures of a sequence share."""
    return re.sub(r"\d+(?!.*\d)", "#", path.stem) + path.suffix.lower()


def _missing_numbers(path: Path, files: list[Path]) -> tuple[str, ...]:
    numbers = [int(_number(file) or 0) for file in files]
    steps = np.diff(numbers)
    if len({_pattern(file) for file in files}) > 1 or not len(steps) or (steps == steps[0]).all():
        return ()
    missing = int(sum(step - 1 for step in steps if step > 1))
    return (
        f"{path.name}: {missing} numbers are missing between {files[0].name} and {files[-1].name}; "
        "the pictures count as evenly spaced at fps.",
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep tifffile and OpenCV from reporting damage on the terminal; errors and notices report it."""
    log = logging.getLogger("tifffile")
    before, before_opencv = log.level, cv2.utils.logging.getLogLevel()
    log.setLevel(logging.CRITICAL + 1)
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        log.setLevel(before)
        cv2.utils.logging.setLogLevel(before_opencv)


@_quiet()
def _with_first_page(file: BinaryIO, name: str) -> tifffile.TiffFile:
    """A TIFF after reading the tags of its first page, which is where damage shows."""
    tiff = tifffile.TiffFile(file, name=name)
    assert tiff.pages.first is not None
    return tiff


@contextmanager
def _opened_tiff(path: Path) -> Iterator[tifffile.TiffFile]:
    """A TIFF that is closed after its last use; tifffile leaves the file open where the first page is damaged."""
    with path.open("rb") as file:
        try:
            tiff = _with_first_page(file, path.name)
        except TIFF_ERRORS as error:
            raise InputError(f"{path.name}: the TIFF is damaged on its first page; save it again") from error
        yield tiff


@_quiet()
def _page_count(tiff: tifffile.TiffFile) -> int:
    """Number of pages, or of pictures after one page (ImageJ describes a stack above 4 GB by its first page only)."""
    try:
        pages = len(tiff.pages)
        if pages == 1 and tiff.is_imagej and tiff.series[0].dataoffset is not None:
            return max(1, int(tiff.series[0].size // tiff.pages.first.size))
    except TIFF_ERRORS as error:
        raise InputError(f"{tiff.filename}: the TIFF is damaged, its pages cannot be counted; save it again") from error
    return pages


def _readable_pages(path: Path, tiff: tifffile.TiffFile) -> tuple[int, tuple[str, ...]]:
    """Number of pages with all their bytes in the file, and a notice where some are incomplete."""
    declared, size = _page_count(tiff), path.stat().st_size
    count = declared
    while count and _page_end(tiff, count - 1) > size:
        count -= 1
    cut = count < declared or (declared > 1 and not _chain_ends(tiff))
    notice = f"{path.name}: the TIFF seems cut off; its first {count} pages are used."
    return count, (notice,) if cut else ()


@_quiet()
def _page_end(tiff: tifffile.TiffFile, number: int) -> float:
    """The offset after the last byte of a page; infinite where the page cannot be read."""
    if number >= len(tiff.pages):
        first = tiff.pages.first
        return int(tiff.series[0].dataoffset) + (number + 1) * int(first.nbytes)
    try:
        page = tiff.pages[number]
        return max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=np.inf)
    except TIFF_ERRORS:
        return np.inf


@_quiet()
def _chain_ends(tiff: tifffile.TiffFile) -> bool:
    """Whether the last page declares that no page follows, as it does in a complete file."""
    try:
        last, form = tiff.pages[-1], tiff.tiff
        file = tiff.filehandle
        file.seek(last.offset)
        tags = int.from_bytes(file.read(form.tagnosize), "little" if tiff.byteorder == "<" else "big")
        file.seek(last.offset + form.tagnosize + tags * form.tagsize)
        return not any(file.read(form.offsetsize))
    except TIFF_ERRORS:
        return False


@_quiet()
def _page_pixels(path: Path, tiff: tifffile.TiffFile, number: int) -> Frame:
    """(height, width) grey levels of one page."""
    first = tiff.pages.first
    _check_page_size(path, first)
    if number >= len(tiff.pages):
        offset = int(tiff.series[0].dataoffset) + number * int(first.nbytes)
        # Read, not memory-mapped: if a mapped file is cut off, the program is killed.
        pixels = np.fromfile(path, first.dtype.newbyteorder(tiff.byteorder), int(np.prod(first.shape)), offset=offset)
        if len(pixels) < np.prod(first.shape):
            raise cut_off(path, number)
        return to_grey(path, pixels.reshape(first.shape), bgr=False)
    try:
        page = tiff.pages[number]
    except TIFF_ERRORS as error:
        raise InputError(f"{path.name}: page {number} is damaged or cut off; save the TIFF again") from error
    _check_page_size(path, page)
    try:
        pixels = page.asarray()
    except TIFF_ERRORS as error:
        return _page_by_opencv(path, number, error)
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and pixels.dtype.kind == "u":
        pixels = np.iinfo(pixels.dtype).max - pixels
    return to_grey(path, pixels, bgr=False)


def _check_page_size(path: Path, page: Any) -> None:
    """Raise ValueError for an impossible size, before memory is taken: a damaged tag may hold any number, or several."""
    if not all(isinstance(size, int) for size in (page.imagewidth, page.imagelength)):
        raise InputError(
            f"{path.name}: a page of {page.imagewidth} × {page.imagelength} px; the TIFF is damaged; save it again"
        )
    check_size(path, page.imagewidth, page.imagelength)
    declared = page.imagewidth * page.imagelength * max(_number_of(page.samplesperpixel), _number_of(page.imagedepth))
    if not 0 < declared <= MAX_PIXELS_PER_BYTE * path.stat().st_size:
        raise InputError(
            f"{path.name}: a page declares {declared} numbers, and the file has {path.stat().st_size} bytes; "
            "the TIFF is damaged; save it again"
        )


def _number_of(tag: Any) -> int:
    """The value of a tag that holds one number above zero; 1 for a damaged tag."""
    return tag if isinstance(tag, int) and tag > 0 else 1


def _page_by_opencv(path: Path, number: int, error: Exception) -> Frame:
    """A page in a compression for which tifffile needs further packages (LZW)."""
    try:
        with _quiet():
            done, pages = cv2.imreadmulti(str(path), number, 1, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error:
        done, pages = False, ()
    if not done or not len(pages):
        raise InputError(f"{path.name}: page {number} cannot be decoded; save the TIFF without compression") from error
    return to_grey(path, pages[0], bgr=True)
