"""Films kept as pictures: a folder, a glob pattern, one picture of a numbered sequence, or a multi-page TIFF.

Pictures come at their own depth: 8-bit ones as uint8, 16-bit ones as uint16; colour becomes luma with the weights of BT.601.
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

from .reader import Footage, Frame, check_size, cut_off, times_from_rate

PICTURE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".pgm", ".pnm", ".webp", ".jp2")

LARGEST_PICTURE_BYTES = 2**29
"""Of the largest frame that is believed, in 16 bit and colour, not compressed."""
MOST_SQUEEZED = 5000
"""Pixels that one byte of a file can stand for at most: no codec of TIFF packs a flat picture tighter."""
PNG_START = b"\x89PNG\r\n\x1a\n"
TIFF_DAMAGE = Exception
"""What tifffile raises on a damaged file: whatever its arithmetic on damaged tags comes to, division by zero among it."""


def open_pictures(path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> Footage:
    """A numbered sequence, named by its folder, by a glob pattern, or by one of its pictures; or a multi-page TIFF."""
    if _is_whole_film(path):
        return TiffClip(path, fps, frame_range)
    return PictureClip(path, picture_files(path), fps, frame_range)


def files_of_pictures(path: Path) -> tuple[Path, ...]:
    """The files that `open_pictures` reads; raises ValueError where it would."""
    return (path,) if _is_whole_film(path) else tuple(picture_files(path))


def _is_whole_film(path: Path) -> bool:
    """Whether a path is a TIFF of several pages, and not one picture of a sequence."""
    if not (path.is_file() and is_tiff(path)):
        return False
    with _opened_tiff(path) as tiff:
        return _page_count(tiff) != 1


def is_tiff(path: Path) -> bool:
    """Whether a file begins like a TIFF (classic or big)."""
    with path.open("rb") as file:
        return file.read(4) in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")


def picture_files(path: Path) -> list[Path]:
    """The files of a sequence in the order of their numbers (frame_2 before frame_10)."""
    if path.is_dir():
        files = [file for file in path.iterdir() if file.suffix.lower() in PICTURE_SUFFIXES and _number(file)]
        kinds = sorted({_pattern(file) for file in files})
        if len(kinds) > 1:
            raise ValueError(
                f"{path.name}: the folder holds pictures of {len(kinds)} kinds ({', '.join(kinds[:3])}); name one of the sequence"
            )
    elif path.is_file():
        files = (
            [file for file in path.parent.iterdir() if _pattern(file) == _pattern(path)] if _number(path) else [path]
        )
    else:
        files = [Path(name) for name in glob.glob(str(path))]
    if not files:
        raise ValueError(f"{path.name}: no pictures there; accepted are {', '.join(PICTURE_SUFFIXES)}")
    return sorted(files, key=lambda file: [int(n) for n in re.findall(r"\d+", file.stem)] or [0])


def read_picture(path: Path) -> Frame:
    """(height, width) grey levels at native depth; ValueError for what is no picture of 8 or 16 bit."""
    if is_tiff(path):
        with _opened_tiff(path) as tiff:
            return _page_pixels(path, tiff, 0)
    if path.stat().st_size > LARGEST_PICTURE_BYTES:
        raise ValueError(f"{path.name}: {path.stat().st_size} bytes are too many for a picture; save it again")
    data = np.fromfile(path, np.uint8)
    _check_declared_size(path, data.tobytes())
    if not _is_whole_png(data.tobytes()):
        raise ValueError(f"{path.name}: the picture is damaged (its checksums are wrong); save it again")
    try:
        with _quiet():
            picture = cv2.imdecode(data, cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION) if len(data) else None
    except cv2.error:
        picture = None
    if picture is None:
        raise ValueError(
            f"{path.name}: the picture is empty, damaged or of an unknown kind; save it again as PNG or TIFF"
        )
    return to_grey(path, picture, bgr=True)


def _check_declared_size(path: Path, data: bytes) -> None:
    """Before memory is taken for the pixels; kinds that only OpenCV knows are left to its own limit."""
    try:
        with (
            warnings.catch_warnings(action="ignore", category=Image.DecompressionBombWarning),
            Image.open(io.BytesIO(data)) as picture,
        ):
            width_px, height_px = picture.size
    except Image.DecompressionBombError as error:
        raise ValueError(f"{path.name}: the picture is larger than any camera's; save it again") from error
    except Exception:  # whatever a damaged header makes Pillow raise; decoding tells what is wrong with it
        return
    check_size(path, width_px, height_px)


def _is_whole_png(data: bytes) -> bool:
    """Whether the chunks of a PNG are all there, with the right checksums; True for every other kind of picture.

    libpng would report damage on the terminal, past every setting, and fill the rest of the picture.
    """
    if not data.startswith(PNG_START):
        return True
    at = len(PNG_START)
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
        raise ValueError(f"{path.name}: pixels of the kind {picture.dtype}; save 8- or 16-bit unsigned grey levels")
    picture = picture.astype(picture.dtype.newbyteorder("="))
    if picture.ndim == 3 and picture.shape[2] in (3, 4):
        return np.asarray(
            cv2.cvtColor(np.ascontiguousarray(picture[..., :3]), cv2.COLOR_BGR2GRAY if bgr else cv2.COLOR_RGB2GRAY)
        )
    if picture.ndim == 3 and picture.shape[2] in (1, 2):
        picture = picture[..., 0]
    if picture.ndim != 2:
        raise ValueError(f"{path.name}: an array of shape {picture.shape} is no picture; save grey or RGB pictures")
    return np.ascontiguousarray(picture)


class PictureClip(Footage):
    """One file a frame; the first picture gives size and depth."""

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
            raise ValueError(
                f"{self._files[number].name}: the picture is {w} × {h} px {frame.dtype} and the first "
                f"{self.width_px} × {self.height_px} px {self._dtype}; keep one sequence in a folder"
            )
        return frame


class TiffClip(Footage):
    """The pages of one TIFF, read one at a time."""

    def __init__(self, path: Path, fps: float | None, frame_range: tuple[int, int] | None) -> None:
        keep = ExitStack()
        self._tiff = keep.enter_context(_opened_tiff(path))
        weakref.finalize(self, keep.close)
        count, notices = _readable_pages(path, self._tiff)
        if not count:
            raise ValueError(f"{path.name}: the TIFF is cut off within its first page; save it again")
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
    """The last run of digits in a file's name, which counts the frames."""
    runs = re.findall(r"\d+", path.stem)
    return runs[-1] if runs else None


def _pattern(path: Path) -> str:
    """A file's name without its number: what the pictures of one sequence have in common."""
    return re.sub(r"\d+(?!.*\d)", "#", path.stem) + path.suffix.lower()


def _missing_numbers(path: Path, files: list[Path]) -> tuple[str, ...]:
    numbers = [int(_number(file) or 0) for file in files]
    steps = np.diff(numbers)
    if len({_pattern(file) for file in files}) > 1 or not len(steps) or (steps == steps[0]).all():
        return ()
    missing = int(sum(step - 1 for step in steps if step > 1))
    return (
        f"{path.name}: {missing} numbers are missing between {files[0].name} and {files[-1].name}; "
        "the pictures are taken to be evenly spaced at fps.",
    )


@contextmanager
def _quiet() -> Iterator[None]:
    """tifffile and OpenCV report damage on the terminal; here it is told by errors and notices."""
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
def _first_page_read(file: BinaryIO, name: str) -> tifffile.TiffFile:
    """A TIFF whose first page's tags have been read, which is where damage shows."""
    tiff = tifffile.TiffFile(file, name=name)
    assert tiff.pages.first is not None
    return tiff


@contextmanager
def _opened_tiff(path: Path) -> Iterator[tifffile.TiffFile]:
    """A TIFF that is closed behind its last use; tifffile itself leaves the file open where the first page is damaged."""
    with path.open("rb") as file:
        try:
            tiff = _first_page_read(file, path.name)
        except TIFF_DAMAGE as error:
            raise ValueError(f"{path.name}: the TIFF is damaged from its first page on; save it again") from error
        yield tiff


@_quiet()
def _page_count(tiff: tifffile.TiffFile) -> int:
    """Pages, or the pictures behind one page (ImageJ describes a stack above 4 GB by its first page only)."""
    try:
        pages = len(tiff.pages)
        if pages == 1 and tiff.is_imagej and tiff.series[0].dataoffset is not None:
            return max(1, int(tiff.series[0].size // tiff.pages.first.size))
    except TIFF_DAMAGE as error:
        raise ValueError(f"{tiff.filename}: the TIFF is damaged, its pages cannot be counted; save it again") from error
    return pages


def _readable_pages(path: Path, tiff: tifffile.TiffFile) -> tuple[int, tuple[str, ...]]:
    """How many pages have all their bytes in the file, and a notice where some have not."""
    declared, size = _page_count(tiff), path.stat().st_size
    count = declared
    while count and _page_end(tiff, count - 1) > size:
        count -= 1
    cut = count < declared or (declared > 1 and not _chain_ends(tiff))
    notice = f"{path.name}: the TIFF seems cut off; its first {count} pages are used."
    return count, (notice,) if cut else ()


@_quiet()
def _page_end(tiff: tifffile.TiffFile, number: int) -> float:
    """The offset behind the last byte of a page; infinite where the page itself cannot be read."""
    if number >= len(tiff.pages):
        first = tiff.pages.first
        return int(tiff.series[0].dataoffset) + (number + 1) * int(first.nbytes)
    try:
        page = tiff.pages[number]
        return max((o + n for o, n in zip(page.dataoffsets, page.databytecounts, strict=True)), default=np.inf)
    except TIFF_DAMAGE:
        return np.inf


@_quiet()
def _chain_ends(tiff: tifffile.TiffFile) -> bool:
    """Whether the last page says that no page follows, as it does in a whole file."""
    try:
        last, form = tiff.pages[-1], tiff.tiff
        file = tiff.filehandle
        file.seek(last.offset)
        tags = int.from_bytes(file.read(form.tagnosize), "little" if tiff.byteorder == "<" else "big")
        file.seek(last.offset + form.tagnosize + tags * form.tagsize)
        return not any(file.read(form.offsetsize))
    except TIFF_DAMAGE:
        return False


@_quiet()
def _page_pixels(path: Path, tiff: tifffile.TiffFile, number: int) -> Frame:
    """(height, width) grey levels of one page."""
    first = tiff.pages.first
    _check_page_size(path, first)
    if number >= len(tiff.pages):
        offset = int(tiff.series[0].dataoffset) + number * int(first.nbytes)
        # Read, not mapped: a file that is cut off under a map ends the program.
        pixels = np.fromfile(path, first.dtype.newbyteorder(tiff.byteorder), int(np.prod(first.shape)), offset=offset)
        if len(pixels) < np.prod(first.shape):
            raise cut_off(path, number)
        return to_grey(path, pixels.reshape(first.shape), bgr=False)
    try:
        page = tiff.pages[number]
    except TIFF_DAMAGE as error:
        raise ValueError(f"{path.name}: page {number} is damaged or was cut off; save the TIFF again") from error
    _check_page_size(path, page)
    try:
        pixels = page.asarray()
    except TIFF_DAMAGE as error:
        return _page_by_opencv(path, number, error)
    if page.photometric == tifffile.PHOTOMETRIC.MINISWHITE and pixels.dtype.kind == "u":
        pixels = np.iinfo(pixels.dtype).max - pixels
    return to_grey(path, pixels, bgr=False)


def _check_page_size(path: Path, page: Any) -> None:
    """Before memory is taken: a damaged tag may hold any number, or several."""
    if not all(isinstance(size, int) for size in (page.imagewidth, page.imagelength)):
        raise ValueError(
            f"{path.name}: a page of {page.imagewidth} × {page.imagelength} px; the TIFF is damaged, save it again"
        )
    check_size(path, page.imagewidth, page.imagelength)
    asked = page.imagewidth * page.imagelength * max(_number_of(page.samplesperpixel), _number_of(page.imagedepth))
    if not 0 < asked <= MOST_SQUEEZED * path.stat().st_size:
        raise ValueError(
            f"{path.name}: a page asks for {asked} numbers, and the file has {path.stat().st_size} bytes; the TIFF is damaged, "
            "save it again"
        )


def _number_of(tag: Any) -> int:
    """The value of a tag that holds one number above zero; 1 for what damage has made of it."""
    return tag if isinstance(tag, int) and tag > 0 else 1


def _page_by_opencv(path: Path, number: int, error: Exception) -> Frame:
    """A page in a compression that tifffile knows only with its codecs installed (LZW)."""
    try:
        with _quiet():
            done, pages = cv2.imreadmulti(str(path), number, 1, flags=cv2.IMREAD_UNCHANGED)
    except cv2.error:
        done, pages = False, ()
    if not done or not len(pages):
        raise ValueError(f"{path.name}: page {number} cannot be decoded; save the TIFF without compression") from error
    return to_grey(path, pages[0], bgr=True)
