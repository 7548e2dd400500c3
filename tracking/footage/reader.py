"""What the readers of all formats share: the range of frames, their times, random access, and the check for repeated frames.

A reader is a `Footage` that reads one frame of its file (`_read`). Everything else is here, so that a property that holds
for one format holds for all.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

Frame = NDArray[np.uint8] | NDArray[np.uint16]

MIN_NOISY_SHARE = 0.05
"""Share of pixels that must change from frame to frame before an unchanged frame is suspicious.

Sensor noise changes most pixels. A compressed or rendered still scene changes almost none, so its exact copies are genuine.
"""
COMPARED_LINES = 8
"""One line in so many is compared with the frame before; all lines where these are equal."""
MAX_PIXELS = 2**26
"""Largest frame accepted [px], several times that of any high-speed camera; a header that declares more is broken."""
MAX_FRAMES = 2**24
"""Most frames accepted: with more of them the times alone fill the memory."""
REPEATED = "exact copies of the one before"
"""Words of the notice on repeated frames, by which others recognise it."""
TURNED = "as the file asks players to"
"""Words of the notice on turned frames."""
AS_STORED = "as they are stored"
"""Words of the notice on frames that are not shown as the file asks players to."""
MOSAIC = "raw mosaic of a colour sensor"
"""Words of the notice on frames with colour filters."""
MAX_LISTED = 8
"""Most frame numbers that a notice lists."""
KEPT_BYTES = 2**27
"""Largest film whose decoded frames are kept: 512 frames of 512 × 512 px and 8 bit. The formats that take longest to decode hold
seconds, not minutes; a larger film comes in a format that costs little to read again."""


class DuplicateDetector:
    """Finds frames that equal the frame before.

    A camera repeats no noise, so an exact copy among noisy frames was a dropped frame that the software filled in.
    """

    def __init__(self, count: int) -> None:
        self._changed_share = np.full(count, np.nan, np.float32)
        self._last: Frame = np.empty(0, np.uint8)
        self._last_index = -2  # no frame follows it

    def add(self, index: int, frame: Frame) -> None:
        """Compare a frame with the one before it, if that was the last one added. The detector keeps a copy of its own."""
        if self._last_index == index - 1:
            lines = slice(None, None, COMPARED_LINES)
            share = _share_changed(self._last[lines], frame[lines])
            self._changed_share[index] = share or _share_changed(self._last, frame)
        if (self._last.shape, self._last.dtype) != (frame.shape, frame.dtype):
            self._last = np.empty_like(frame)
        np.copyto(self._last, frame)
        self._last_index = index

    def repeated(self) -> list[int]:
        """Indices of the frames so far that equal the one before; empty where the film has no noise to decide by."""
        changed = self._changed_share[self._changed_share > 0]
        if not len(changed) or np.median(changed) < MIN_NOISY_SHARE:
            return []
        return [int(i) for i in np.flatnonzero(self._changed_share == 0)]

    def all_equal(self) -> bool:
        """Whether every frame was added and equals the first."""
        return len(self._changed_share) > 1 and not self._changed_share[1:].any()


def _share_changed(before: Frame, after: Frame) -> float:
    return float(np.count_nonzero(before != after) / after.size)


class Footage(ABC):
    """A film in a file, or a range of its frames, each (height, width) uint8 or uint16 at native depth."""

    in_any_order = True
    """Whether reading a frame takes the same time whichever frame was read before."""

    def __init__(
        self,
        path: Path,
        *,
        width_px: int,
        height_px: int,
        bit_depth: int,
        file_times_s: NDArray[np.float64],
        frame_range: tuple[int, int] | None,
        notices: tuple[str, ...] = (),
        facts: dict[str, Any] | None = None,
    ) -> None:
        """Keep what the reader found. `file_times_s` (n,) has the time of every frame of the file; `facts` go to `metadata`."""
        first, stop = _checked_range(path, frame_range, len(file_times_s))
        self.path = path
        self.width_px, self.height_px, self.bit_depth = width_px, height_px, bit_depth
        self.first_frame = first
        self.times_s = file_times_s[first:stop]
        self._static_notices = notices
        self._facts = facts or {}
        self._duplicates = DuplicateDetector(stop - first)
        self._last: tuple[int, Frame] | None = None
        self._kept: Frame | None = None
        self._is_kept = np.zeros(stop - first, bool)
        shape, pixel_bytes = (stop - first, height_px, width_px), 1 if bit_depth <= 8 else 2
        if not self.in_any_order and int(np.prod(shape)) * pixel_bytes <= KEPT_BYTES:
            self._kept = np.zeros(shape, np.uint8) if pixel_bytes == 1 else np.zeros(shape, np.uint16)

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def notices(self) -> tuple[str, ...]:
        """Problems of the file, one sentence each; repeated frames are among them once they have been read."""
        if self._duplicates.all_equal():
            still = (
                f"{self.path.name}: all {len(self)} frames are the same picture, so nothing moves; give another clip."
            )
            return (*self._static_notices, still)
        repeated = [i + self.first_frame for i in self._duplicates.repeated()]
        if not repeated:
            return self._static_notices
        names = ", ".join(map(str, repeated[:MAX_LISTED])) + (", ..." if len(repeated) > MAX_LISTED else "")
        return (
            *self._static_notices,
            f"{self.path.name}: {len(repeated)} of {len(self)} frames are {REPEATED} ({names}): "
            "dropped frames may have been filled in.",
        )

    def metadata(self) -> dict[str, Any]:
        """What the file declares; `record_rate_hz` and `exposure_s` are None where it does not declare them, and `time_stamps`
        says whether it states the time of every frame. Of a video, `turned_deg` is the angle, counter-clockwise, by which its
        frames are turned."""
        return {"record_rate_hz": None, "exposure_s": None, "time_stamps": False, **self._facts}

    def frame(self, index: int) -> Frame:
        """The frame at `index`, counted from `first_frame`.

        Raises IndexError outside 0 ... len - 1, ValueError where the file cannot be decoded there.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.path.name}: frame {index} was asked for; the clip has 0 to {len(self) - 1}")
        if self._last is not None and self._last[0] == index:
            return self._last[1].copy()
        frame = self._kept_or_read(index)
        self._duplicates.add(index, frame)
        self._last = (index, frame)
        return frame.copy()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as `frame` does."""
        for index in range(start, len(self) if stop is None else stop):
            yield self.frame(index)

    @property
    def kept_frames(self) -> tuple[Frame, NDArray[np.bool_]] | None:
        """The decoded frames (n, height, width), not to be written to, and which are there (n,); None if none are kept."""
        return None if self._kept is None else (self._kept, self._is_kept)

    def _kept_or_read(self, index: int) -> Frame:
        """The frame at `index`, read from the file at most once where decoded frames are kept; not to be written to."""
        if self._kept is None:
            return self._read(self.first_frame + index)
        if not self._is_kept[index]:
            self._keep(self.first_frame + index, self._read(self.first_frame + index))
        return self._kept[index]

    def _keep(self, number: int, frame: Frame) -> None:
        """Keep frame `number` of the file, which a reader may have decoded on its way to another; nothing without room."""
        index = number - self.first_frame
        if self._kept is not None and 0 <= index < len(self) and frame.dtype == self._kept.dtype:
            self._kept[index], self._is_kept[index] = frame, True

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Write the frames from `start` on into `out` (n, height, width).

        With `boxes` (n, 4), pixels x0, y0, x1, y1 (end exclusive), at least these pixels of each frame are written. A raw
        format is unpacked no further, and `out` keeps what it held elsewhere. Raises as `frame` does.
        """
        for index, picture in enumerate(out, start):
            if boxes is not None:
                x0, y0, x1, y1 = (int(edge) for edge in boxes[index - start])
                if x1 > x0 and y1 > y0:
                    self._read_into(self.first_frame + index, picture, (x0, y0, x1, y1))
                continue
            self._read_into(self.first_frame + index, picture, (0, 0, self.width_px, self.height_px))
            self._duplicates.add(index, picture)

    @abstractmethod
    def _read(self, number: int) -> Frame:
        """Frame `number` of the file, as a new array."""

    def _read_into(self, number: int, out: Frame, box: tuple[int, int, int, int]) -> None:
        """Write at least a box of frame `number` into `out` (height, width); a raw format need not unpack the rest."""
        out[:] = self._kept_or_read(number - self.first_frame)


def times_from_rate(
    path: Path, fps: float | None, count: int, playback: str = "no recording rate"
) -> NDArray[np.float64]:
    """(count,) [s], t = k / fps; raises ValueError if fps is missing or not above 0. `playback` says which rate the file has."""
    if fps is None:
        raise InputError(
            f"{path.name}: the file carries {playback}; give the recording rate as fps, in frames per second"
        )
    if not (np.isfinite(fps) and fps > 0):
        raise InputError(f"{path.name}: fps = {fps}; wanted a recording rate above 0 frames per second")
    check_count(path, count)
    return np.arange(count) / fps


def check_size(path: Path, width_px: int, height_px: int) -> None:
    """Raise ValueError for a frame size that no camera has, before memory is taken for it."""
    if width_px < 1 or height_px < 1 or width_px * height_px > MAX_PIXELS:
        raise InputError(
            f"{path.name}: the header declares frames of {width_px} × {height_px} px; wanted 1 to {MAX_PIXELS} px in all; "
            "the header is broken, or this is not a film"
        )


def check_count(path: Path, count: int) -> None:
    """Raise ValueError for more frames than any camera holds, before memory is taken for their times."""
    if count > MAX_FRAMES:
        raise InputError(
            f"{path.name}: the header declares {count} frames; wanted {MAX_FRAMES} at most; the header is broken, or this is "
            "not a film"
        )


def cut_off(path: Path, number: int) -> InputError:
    """The error for a frame that has been cut off since the film was opened."""
    return InputError(
        f"{path.name}: the file ends before frame {number}; it was cut off while it was read; copy it again"
    )


def _checked_range(path: Path, frame_range: tuple[int, int] | None, count: int) -> tuple[int, int]:
    if count == 0:
        raise InputError(
            f"{path.name}: no frame can be read; the file is empty or cut off before the first frame; copy it again"
        )
    first, stop = frame_range or (0, count)
    if not 0 <= first < stop <= count:
        raise InputError(
            f"{path.name}: frames = [{first}, {stop}]; the file has {count} frames; wanted 0 <= first < stop <= {count}"
        )
    return first, stop
