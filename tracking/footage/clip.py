"""Frames and their times, read on demand: one interface for every file format.

`open_clip` recognises a format by the content of the file, not only by its name. A new format is one more reader: a `Footage`
with `_read`, and a line in `open_clip`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from .cine import is_cine, open_cine
from .images import files_of_pictures, is_tiff, open_pictures
from .photron import is_photron, open_photron, photron_files
from .reader import Frame as Frame
from .video import open_video

PICTURE_SIGNATURES = (b"\x89PNG", b"\xff\xd8\xff", b"BM", b"P5\n", b"P2\n", b"P6\n", b"\0\0\0\x0cjP  ")
"""First bytes of PNG, JPEG, BMP, PGM, PPM and JPEG 2000; TIFF and WebP have more than one signature."""


class Clip(Protocol):
    """A film of `len(clip)` grey frames. No reader holds more than a few of them in memory."""

    width_px: int
    height_px: int
    bit_depth: int
    """Significant bits of a pixel: full scale is 2**bit_depth - 1."""
    times_s: NDArray[np.float64]
    """(n,) mid-exposure."""
    first_frame: int
    """Number, in the file, of the first frame read."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Problems of the file, one sentence each: a variable rate, repeated frames, a truncated file."""
        ...

    def __len__(self) -> int: ...

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order, each (height, width) uint8 or uint16 at native depth."""
        ...

    def frame(self, index: int) -> Frame:
        """One frame, at random access."""
        ...

    def metadata(self) -> dict[str, Any]:
        """What the file declares; `record_rate_hz` and `exposure_s` are None where it does not declare them."""
        ...


@runtime_checkable
class FillsFrames(Protocol):
    """A clip that writes frames, or parts of them, into given memory: see `Footage.fill`."""

    @property
    def in_any_order(self) -> bool:
        """Whether reading a frame takes the same time whichever frame was read before. If not, leaving out frames saves
        nothing."""
        ...

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width), at least the pixels of `boxes` (n, 4) of each."""
        ...


class DerivedClip:
    """A `Clip` made of another one: every frame passes through `_changed`, and all else is as of the other."""

    def __init__(self, clip: Clip) -> None:
        self._clip = clip
        self.width_px, self.height_px, self.bit_depth = clip.width_px, clip.height_px, clip.bit_depth
        self.times_s, self.first_frame = clip.times_s, clip.first_frame

    def _changed(self, frame: Frame) -> Frame:
        return frame

    @property
    def notices(self) -> tuple[str, ...]:
        """Those of the file."""
        return self._clip.notices

    def __len__(self) -> int:
        return len(self._clip)

    def frame(self, index: int) -> Frame:
        """One frame; raises as the clip does."""
        return self._changed(self._clip.frame(index))

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as the clip does."""
        return map(self._changed, self._clip.frames(start, stop))

    def metadata(self) -> dict[str, Any]:
        """What the file declares."""
        return self._clip.metadata()


class FillingDerivedClip(DerivedClip):
    """The same of a clip that writes into given memory, which the derived one then has to do as well (`fill`)."""

    @property
    def _filling(self) -> FillsFrames:
        assert isinstance(self._clip, FillsFrames)
        return self._clip

    @property
    def in_any_order(self) -> bool:
        """As of the clip."""
        return self._filling.in_any_order


def open_clip(
    path: Path, *, fps: float | None = None, frame_range: tuple[int, int] | None = None, as_stored: bool = False
) -> Clip:
    """A clip of any format: video, numbered pictures, multi-page TIFF, Photron, Phantom.

    `path` is a video; a folder of numbered pictures, one of them (for the whole sequence) or a glob pattern; a TIFF; a .cih or
    .cihx header or its .mraw; a .cine. `fps` [1/s] is the recording rate, required where the file has only a playback rate.
    `frame_range` (first, stop) restricts the frames; times still count from the file's first frame. Frames of a video are turned
    as it asks players to, unless `as_stored`.

    Raises FileNotFoundError where there is no such file, and ValueError for a file that is no film, for a rate that is missing
    or contradicts the file's, and for a range outside the film.
    """
    path = Path(path)
    if path.is_dir() or (not path.exists() and any(mark in path.name for mark in "*?[")):
        return open_pictures(path, fps, frame_range)
    if not path.exists():
        raise FileNotFoundError(
            f"{path}: there is no such clip; give a film, a folder of pictures, a pattern or a header"
        )
    if path.stat().st_size == 0:
        raise InputError(f"{path.name}: the clip is an empty file; copy it again")
    if is_cine(path):
        return open_cine(path, fps, frame_range)
    if is_photron(path):
        return open_photron(path, fps, frame_range)
    if _is_picture(path):
        return open_pictures(path, fps, frame_range)
    return open_video(path, fps, frame_range, as_stored=as_stored)


def clip_files(path: Path) -> tuple[Path, ...]:
    """Every file that `open_clip` reads: the pixels next to a Photron header, and all pictures of a sequence.

    A path without a file, or of no film, is returned as it is; `open_clip` raises the error.
    """
    path = Path(path)
    try:
        if not path.is_file():
            return files_of_pictures(path)
        if is_photron(path):
            return photron_files(path)
        return files_of_pictures(path) if _is_picture(path) else (path,)
    except (ValueError, OSError):
        return (path,)


def scan_notices(clip: Clip) -> tuple[str, ...]:
    """The clip's notices after every frame has been read once, so that repeated frames are among them."""
    for _ in clip.frames():
        pass
    return clip.notices


def _is_picture(path: Path) -> bool:
    with path.open("rb") as file:
        start = file.read(16)
    return is_tiff(path) or start.startswith(PICTURE_SIGNATURES) or (start[:4] == b"RIFF" and start[8:12] == b"WEBP")
