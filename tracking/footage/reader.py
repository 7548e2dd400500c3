"""What every reader of footage shares: the range that is read, the times, and an eye on repeated frames.

A reader is a `Footage` that knows how to read one frame of its file (`_read`). Range, random access, iteration and notices
are the same for all, so that every law that holds for one format holds for the others.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

Frame = NDArray[np.uint8] | NDArray[np.uint16]

NOISE_SHARE = 0.05
"""Share of pixels that must change from frame to frame before an unchanged frame is suspicious.

Sensor noise changes most pixels; a compressed or rendered still scene changes almost none, and repeats itself honestly.
"""
SEEN_LINES = 8
"""Every so manieth line of a frame is compared with the one before; all of them where those are alike."""
MOST_PIXELS = 2**26
"""Largest frame that is believed [px], several times that of any high-speed camera; a header that says more is broken."""
MOST_FRAMES = 2**24
"""Most frames that are believed: beyond them the times alone fill the memory."""


class DuplicateWatch:
    """Sees frames go by and remembers which were exactly like the one before.

    A camera repeats no noise, so an exact copy among noisy frames is a frame that was dropped and filled in.
    """

    def __init__(self, count: int) -> None:
        self._changed_share = np.full(count, np.nan, np.float32)
        self._last: tuple[int, Frame] | None = None

    def see(self, index: int, frame: Frame) -> None:
        """Compare a frame, which nobody may write to from now on, with the one before it, where that was seen last."""
        if self._last is not None and self._last[0] == index - 1:
            some = slice(None, None, SEEN_LINES)
            share = _share_changed(self._last[1][some], frame[some])
            self._changed_share[index] = share or _share_changed(self._last[1], frame)
        self._last = (index, frame)

    def repeated(self) -> list[int]:
        """Indices of the frames that repeat the one before, so far; empty where the film has no noise to tell by."""
        changed = self._changed_share[self._changed_share > 0]
        if not len(changed) or np.median(changed) < NOISE_SHARE:
            return []
        return [int(i) for i in np.flatnonzero(self._changed_share == 0)]

    def stood_still(self) -> bool:
        """Whether every frame was seen and is the same picture as the first."""
        return len(self._changed_share) > 1 and not self._changed_share[1:].any()


def _share_changed(before: Frame, after: Frame) -> float:
    return float(np.count_nonzero(before != after) / after.size)


class Footage(ABC):
    """A film in a file, or a range of its frames, each (height, width) uint8 or uint16 at native depth."""

    in_any_order = True
    """Whether a frame takes as long wherever the one before was."""

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
        """Keep what the reader found; `file_times_s` (n,) are those of every frame of the file."""
        first, stop = _checked_range(path, frame_range, len(file_times_s))
        self.path = path
        self.width_px, self.height_px, self.bit_depth = width_px, height_px, bit_depth
        self.first_frame = first
        self.times_s = file_times_s[first:stop]
        self._static_notices = notices
        self._facts = facts or {}
        self._watch = DuplicateWatch(stop - first)
        self._last: tuple[int, Frame] | None = None

    def __len__(self) -> int:
        return len(self.times_s)

    @property
    def notices(self) -> tuple[str, ...]:
        """What a careful user should know, one sentence each; repeated frames once they have been read."""
        if self._watch.stood_still():
            still = f"{self.path.name}: all {len(self)} frames are one and the same picture, so nothing moves in them."
            return (*self._static_notices, still)
        repeated = [i + self.first_frame for i in self._watch.repeated()]
        if not repeated:
            return self._static_notices
        names = ", ".join(map(str, repeated[:8])) + (", ..." if len(repeated) > 8 else "")
        return (
            *self._static_notices,
            f"{self.path.name}: {len(repeated)} of {len(self)} frames are exact copies of the one before ({names}): "
            "dropped frames may have been filled in.",
        )

    def metadata(self) -> dict[str, Any]:
        """What the file says of itself; `record_rate_hz` and `exposure_s` are None where it does not say."""
        return {"record_rate_hz": None, "exposure_s": None, **self._facts}

    def frame(self, index: int) -> Frame:
        """The frame at `index`, counted from `first_frame`.

        Raises IndexError outside 0 ... len - 1, ValueError where the file cannot be decoded there.
        """
        if not 0 <= index < len(self):
            raise IndexError(f"{self.path.name}: frame {index} was asked for, and there are 0 to {len(self) - 1}")
        if self._last is not None and self._last[0] == index:
            return self._last[1].copy()
        frame = self._read(self.first_frame + index)
        self._watch.see(index, frame)
        self._last = (index, frame)
        return frame.copy()

    def frames(self, start: int = 0, stop: int | None = None) -> Iterator[Frame]:
        """Frames `start` to `stop` in order; raises as `frame` does."""
        for index in range(start, len(self) if stop is None else stop):
            yield self.frame(index)

    def fill(self, start: int, out: Frame, boxes: NDArray[np.int64] | None = None) -> None:
        """Put the frames from `start` on into `out` (n, height, width), which nobody may write to from then on.

        With `boxes` (n, 4), pixels x0, y0, x1, y1 (end exclusive), no more than that part of a frame needs to be there: of a raw
        format the rest is not unpacked, and is left as it was. Raises as `frame` does.
        """
        for index, picture in enumerate(out, start):
            if boxes is not None:
                x0, y0, x1, y1 = (int(edge) for edge in boxes[index - start])
                if x1 > x0 and y1 > y0:
                    self._put(self.first_frame + index, picture, (x0, y0, x1, y1))
                continue
            self._put(self.first_frame + index, picture, (0, 0, self.width_px, self.height_px))
            self._watch.see(index, picture)

    @abstractmethod
    def _read(self, number: int) -> Frame:
        """Frame `number` of the file, as a new array."""

    def _put(self, number: int, out: Frame, box: tuple[int, int, int, int]) -> None:
        """At least a box of frame `number` into `out` (height, width); a reader that can leave other pixels out does."""
        out[:] = self._read(number)


def times_from_rate(
    path: Path, fps: float | None, count: int, playback: str = "no recording rate"
) -> NDArray[np.float64]:
    """(count,) [s], t = k / fps; raises ValueError where fps is missing or impossible."""
    if fps is None:
        raise ValueError(
            f"{path.name}: the file carries {playback}; give the recording rate as fps, in frames per second"
        )
    if not (np.isfinite(fps) and fps > 0):
        raise ValueError(f"{path.name}: fps = {fps}; the recording rate must be above 0 frames per second")
    check_count(path, count)
    return np.arange(count) / fps


def check_size(path: Path, width_px: int, height_px: int) -> None:
    """Raise ValueError for a frame size that no camera has, before memory is taken for it."""
    if width_px < 1 or height_px < 1 or width_px * height_px > MOST_PIXELS:
        raise ValueError(
            f"{path.name}: frames of {width_px} × {height_px} px; the header is broken, or this is not a film"
        )


def check_count(path: Path, count: int) -> None:
    """Raise ValueError for more frames than any camera holds, before memory is taken for their times."""
    if count > MOST_FRAMES:
        raise ValueError(f"{path.name}: the header declares {count} frames; it is broken, or this is not a film")


def cut_off(path: Path, number: int) -> ValueError:
    """The error for a frame whose bytes were there when the film was opened, and are there no longer."""
    return ValueError(
        f"{path.name}: the file ends before frame {number}; it was cut off while it was read, copy it again"
    )


def _checked_range(path: Path, frame_range: tuple[int, int] | None, count: int) -> tuple[int, int]:
    if count == 0:
        raise ValueError(f"{path.name}: no frame can be read; the file is empty or cut off before the first one")
    first, stop = frame_range or (0, count)
    if not 0 <= first < stop <= count:
        raise ValueError(
            f"{path.name}: frames = [{first}, {stop}]; the file has {count}, so give 0 <= first < stop <= {count}"
        )
    return first, stop
