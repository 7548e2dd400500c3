"""The frames of one throw, whatever camera took them: blocks read ahead while others are worked on.

A reel joins the clips of synchronised cameras: its frame k is the stack of every camera's frame k. Reading happens in a
thread of its own, so that decoding and tracking overlap. Every pass over the clip wants all frames again: those of a short
clip are decoded once and kept; of a long one never more than a few blocks are in memory.
"""

from __future__ import annotations

import sys
import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from queue import Empty, Full, Queue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .clip import Clip, Filling

Frames = NDArray[Any]
Rows = NDArray[np.int64]

BLOCK_BYTES = 2**24
"""Size of a block: large enough for threads to share its frames, small enough to keep three in memory."""
MOST_FRAMES = 64
RECENT_BYTES = 2**26
"""Frames that random access keeps."""
KEPT_BYTES = 2**27
"""Pixels of a clip that is kept whole: 512 frames of 512 × 512 and 8 bit. What takes longest to decode is filmed for seconds,
not minutes; a clip that is larger comes from a format that costs little to read again."""

_UNHELD = 3
"""References to a block in a list that is gone through: the list's, the loop's, and that of the call which counts them."""


class Reel:
    """Synchronised clips as one."""

    def __init__(self, clips: Sequence[Clip]) -> None:
        """Raises ValueError where the clips do not run over the same frames."""
        self.clips = tuple(clips)
        counts = {len(clip) for clip in clips}
        if len(counts) > 1:
            raise ValueError(
                f"the cameras have {', '.join(str(len(clip)) for clip in clips)} frames: synchronised clips have as many "
                "frames as each other; give clip.frames = [first, stop] that all of them cover"
            )
        self.times_s = np.asarray(clips[0].times_s, float)
        self.first_frame = clips[0].first_frame
        height, width = max(c.height_px for c in clips), max(c.width_px for c in clips)
        self._shape = (len(clips), height, width)
        self._dtype = np.uint8 if all(c.bit_depth <= 8 for c in clips) else np.uint16
        self._recent: OrderedDict[int, Frames] = OrderedDict()
        frame_bytes = int(np.prod(self._shape)) * np.dtype(self._dtype).itemsize
        self.block = int(np.clip(BLOCK_BYTES // frame_bytes, 1, MOST_FRAMES))
        """Frames that are worked on at once."""
        self._keep = max(4, RECENT_BYTES // frame_bytes)
        self._rooms: list[Frames] = []
        self._taking = threading.Lock()
        self._whole: Frames | None = None
        if len(self) * frame_bytes <= KEPT_BYTES:
            self._whole, self._there = np.empty((len(self), *self._shape), self._dtype), np.zeros(len(self), bool)

    def __len__(self) -> int:
        return len(self.times_s)

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[tuple[int, Frames]]:
        """Index of the first frame and frames (n, cameras, height, width), in order, read ahead in a thread."""
        stop = len(self) if stop is None else stop
        for rows, frames in self._ahead(np.arange(start, stop), None):
            yield int(rows[0]), frames

    def looked_at(self, boxes: NDArray[np.int64]) -> Iterator[tuple[Rows, Frames]]:
        """Rows (n,) and frames (n, cameras, height, width), in order, of at least those frames of the clip whose `boxes`
        (frames of the clip, cameras, 4), pixels x0, y0, x1, y1 (end exclusive), hold any. Whoever asks looks at no other pixels:
        they may be those of other frames."""
        rows = np.arange(len(self))
        if self._whole is None and all(isinstance(clip, Filling) and clip.in_any_order for clip in self.clips):
            holds = np.asarray((boxes[:, :, 2:] > boxes[:, :, :2]).all(axis=2))
            rows = np.flatnonzero(holds.any(axis=1))
        return self._ahead(rows, boxes)

    def _ahead(self, rows: Rows, boxes: NDArray[np.int64] | None) -> Iterator[tuple[Rows, Frames]]:
        """Some rows in blocks, read ahead in a thread."""
        pieces = [rows[k : k + self.block] for k in range(0, len(rows), self.block)]
        if self._whole is not None and self._there[rows].all():
            for some in pieces:
                assert some[-1] - some[0] == len(some) - 1, "of a clip that is kept whole rows follow each other"
                yield some, self._whole[some[0] : some[-1] + 1]
            return
        queue: Queue[Any] = Queue(maxsize=2)
        closed = threading.Event()
        reader = threading.Thread(target=self._read, args=(pieces, boxes, queue, closed), daemon=True)
        reader.start()
        try:
            while True:
                item = queue.get()
                if item is None:
                    return
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            closed.set()
            while reader.is_alive():
                try:
                    queue.get_nowait()
                except Empty:
                    reader.join(0.01)

    def blocks_backwards(self, stop: int) -> Iterator[tuple[int, Frames]]:
        """The frames before `stop` in blocks, the last block first; frames within a block in their own order."""
        while stop > 0:
            start = max(0, stop - self.block)
            yield start, np.concatenate([frames for _, frames in self.blocks(start, stop)])
            stop = start

    def frame(self, k: int) -> Frames:
        """One frame (cameras, height, width), cheap where it is asked for again soon."""
        if self._whole is not None and self._there[k]:
            return np.asarray(self._whole[k])
        if k in self._recent:
            return self._recent[k]
        self._remember(k, self._stack([clip.frame(k) for clip in self.clips]))
        return self._recent[k]

    def _remember(self, k: int, stack: Frames) -> None:
        self._recent[k] = stack
        self._keep_whole(k, stack[None])
        while len(self._recent) > self._keep:
            self._recent.popitem(last=False)

    def _keep_whole(self, first: int, block: Frames) -> None:
        """Keep frames of a clip that is kept whole; the same ones again do no harm."""
        if self._whole is not None:
            self._whole[first : first + len(block)] = block
            self._there[first : first + len(block)] = True

    def _stack(self, frames: Sequence[Frames]) -> Frames:
        if len(frames) == 1:
            return frames[0][None]
        out = np.zeros(self._shape, self._dtype)
        for c, frame in enumerate(frames):
            out[c, : frame.shape[0], : frame.shape[1]] = frame
        return out

    def _room(self) -> Frames:
        """A block to write frames to: one that nobody holds any more, no view of it either, or a new one. New memory costs as
        much as the pixels in it. A block that is used again holds older frames where nothing is written."""
        with self._taking:
            for room in self._rooms:
                if sys.getrefcount(room) == _UNHELD:
                    return room
            room = np.zeros((self.block, *self._shape), self._dtype)
            self._rooms.append(room)
            return room

    def _read(
        self, pieces: list[Rows], boxes: NDArray[np.int64] | None, queue: Queue[Any], closed: threading.Event
    ) -> None:
        """Fill the queue; what goes wrong is handed on to whoever waits."""
        last: Any = None
        try:
            runs = [_Run(clip, pieces) for clip in self.clips]
            boxes = None if self._whole is not None else boxes  # what is kept is kept whole
            for rows in pieces:
                block = self._room()[: len(rows)]
                for c, run in enumerate(runs):
                    if not run.put(rows, block[:, c], None if boxes is None else boxes[rows, c], closed):
                        return
                self._keep_whole(int(rows[0]), block)
                _put(queue, (rows, block), closed)
        except BaseException as error:  # raised again by the thread that reads the blocks
            last = error
        _put(queue, last, closed)


class _Run:
    """Frames of one clip in order, as quickly as it hands them out: any, or all of a range where it knows no other way."""

    def __init__(self, clip: Clip, pieces: list[Rows]) -> None:
        self._size = clip.height_px, clip.width_px
        self._filling = clip if isinstance(clip, Filling) else None
        whole = pieces and not self._filling
        self._frames = clip.frames(int(pieces[0][0]), int(pieces[-1][-1]) + 1) if whole else iter(())

    def put(self, rows: Rows, out: Frames, boxes: NDArray[np.int64] | None, closed: threading.Event) -> bool:
        """Write some frames into `out` (n, height, width); whether they were all written before it was closed."""
        out = out[:, : self._size[0], : self._size[1]]
        for k, row in enumerate(rows.tolist()):
            if closed.is_set():
                return False
            if self._filling:
                self._filling.fill(row, out[k : k + 1], None if boxes is None else boxes[k : k + 1])
            else:
                out[k] = next(self._frames)
        return True


def _put(queue: Queue[Any], item: Any, closed: threading.Event) -> None:
    while not closed.is_set():
        try:
            queue.put(item, timeout=0.1)
            return
        except Full:
            continue
