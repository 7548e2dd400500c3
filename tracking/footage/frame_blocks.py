"""The frames of one throw from all its cameras, read ahead in blocks.

`FrameSource` joins the clips of synchronised cameras: its frame k is the stack of every camera's frame k. A thread of its own
reads, so that decoding and tracking overlap. Every pass over the clip needs all frames again. A short clip is decoded once
and kept in memory; of a long clip a few blocks are in memory at a time.

The blocks of a long clip lie in buffers that are used again, because new memory costs as much time as the pixels in it. A
`FrameBlock` owns its buffer until `release`. A block that is never released keeps its buffer for itself.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from queue import Empty, Full, Queue
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError
from .clip import Clip, FillsFrames
from .reader import KEPT_BYTES, Footage

Frames = NDArray[Any]
Rows = NDArray[np.int64]

BLOCK_BYTES = 2**24
"""Size of a block: large enough for threads to share its frames, small enough to keep a few in memory."""
MAX_BLOCK_FRAMES = 64
"""Most frames in a block: more of them delay the first result and give the threads no more to share."""
BLOCKS_AHEAD = 2
"""Blocks that wait for their reader: one hides an uneven decoder, and more only take memory."""
RECENT_BYTES = 2**26
"""Memory for single frames read at random access."""
POLL_S = 0.1
"""Longest time after which the reading thread notices that nobody waits for its blocks any more."""


class FrameBlock:
    """Some frames of every camera. `with block:` releases its memory at the end."""

    def __init__(
        self, rows: Rows, frames: Frames, pool: _BufferPool | None = None, buffer: Frames | None = None
    ) -> None:
        self.rows = rows
        """(n,) rows of the frames in the clip, ascending."""
        self.frames = frames
        """(n, cameras, height, width)."""
        self._pool, self._buffer = pool, buffer

    @property
    def first(self) -> int:
        """Row of the first frame."""
        return int(self.rows[0])

    def release(self) -> None:
        """Hand the memory back: neither `frames` nor a view of them may be read from now on."""
        if self._pool is not None and self._buffer is not None:
            self._pool.put_back(self._buffer)
            self._buffer = None

    def __enter__(self) -> FrameBlock:
        return self

    def __exit__(self, *_: object) -> None:
        self.release()


class _BufferPool:
    """Buffers of one shape, zero where they are new. One that is not put back belongs to whoever took it."""

    def __init__(self, shape: tuple[int, ...], dtype: type) -> None:
        self._shape, self._dtype = shape, dtype
        self._free: list[Frames] = []

    def take(self) -> Frames:
        """A free buffer, which holds older frames, or a new one."""
        try:
            return self._free.pop()  # atomic, as is append: the reading thread and its user share the list
        except IndexError:
            return np.zeros(self._shape, self._dtype)

    def put_back(self, buffer: Frames) -> None:
        """Offer a buffer that nobody reads any more."""
        self._free.append(buffer)


class FrameSource:
    """Synchronised clips as one."""

    def __init__(self, clips: Sequence[Clip]) -> None:
        """Raises ValueError where the clips do not run over the same frames."""
        self.clips = tuple(clips)
        counts = {len(clip) for clip in clips}
        if len(counts) > 1:
            raise InputError(
                f"the cameras have {', '.join(str(len(clip)) for clip in clips)} frames; wanted as many of each, since the "
                "clips are synchronised; give clip.frames = [first, stop] that all of them cover"
            )
        self.times_s = np.asarray(clips[0].times_s, float)
        self.first_frame = clips[0].first_frame
        height, width = max(c.height_px for c in clips), max(c.width_px for c in clips)
        self._shape = (len(clips), height, width)
        self._dtype = np.uint8 if all(c.bit_depth <= 8 for c in clips) else np.uint16
        self._recent: OrderedDict[int, Frames] = OrderedDict()
        frame_bytes = int(np.prod(self._shape)) * np.dtype(self._dtype).itemsize
        self.block_frames = int(np.clip(BLOCK_BYTES // frame_bytes, 1, MAX_BLOCK_FRAMES))
        """Frames in a block."""
        self._max_recent = max(4, RECENT_BYTES // frame_bytes)
        self._pool = _BufferPool((self.block_frames, *self._shape), self._dtype)
        self._kept: Frames | None = None
        if (kept := _kept_by(self.clips)) is not None:
            self._kept, self._is_kept = kept[0][:, None], kept[1]
        elif len(self) * frame_bytes <= KEPT_BYTES:
            self._kept, self._is_kept = np.zeros((len(self), *self._shape), self._dtype), np.zeros(len(self), bool)

    def __len__(self) -> int:
        return len(self.times_s)

    def blocks(self, start: int = 0, stop: int | None = None) -> Iterator[FrameBlock]:
        """The frames from `start` to `stop` in order, read ahead in a thread."""
        return self._read_ahead(np.arange(start, len(self) if stop is None else stop), None)

    def blocks_within(self, boxes: NDArray[np.int64]) -> Iterator[FrameBlock]:
        """At least the frames whose `boxes` hold a pixel, in order; outside its boxes a frame may show other frames' pixels.

        `boxes` (frames of the clip, cameras, 4) are pixels x0, y0, x1, y1 (end exclusive).
        """
        rows = np.arange(len(self))
        if self._kept is None and all(isinstance(clip, FillsFrames) and clip.in_any_order for clip in self.clips):
            nonempty = np.asarray((boxes[:, :, 2:] > boxes[:, :, :2]).all(axis=2))
            rows = np.flatnonzero(nonempty.any(axis=1))
        return self._read_ahead(rows, boxes)

    def blocks_backwards(self, stop: int) -> Iterator[FrameBlock]:
        """The frames before `stop`, the last block first; frames within a block in their own order."""
        while stop > 0:
            start = max(0, stop - self.block_frames)
            yield from self.blocks(start, stop)
            stop = start

    def frame(self, k: int) -> Frames:
        """One frame (cameras, height, width), fast where it was read a short while ago."""
        if self._kept is not None and self._is_kept[k]:
            return np.asarray(self._kept[k])
        if k not in self._recent:
            frames = self._stack([clip.frame(k) for clip in self.clips])
            self._recent[k] = frames
            if self._kept is not None:
                self._kept[k], self._is_kept[k] = frames, True
            if len(self._recent) > self._max_recent:
                self._recent.popitem(last=False)
        return self._recent[k]

    def _stack(self, frames: Sequence[Frames]) -> Frames:
        if len(frames) == 1:
            return frames[0][None]
        out = np.zeros(self._shape, self._dtype)
        for c, frame in enumerate(frames):
            out[c, : frame.shape[0], : frame.shape[1]] = frame
        return out

    def _read_ahead(self, rows: Rows, boxes: NDArray[np.int64] | None) -> Iterator[FrameBlock]:
        """Blocks of some rows, from the frames that are kept or read ahead in a thread."""
        pieces = [rows[k : k + self.block_frames] for k in range(0, len(rows), self.block_frames)]
        if self._kept is not None and self._is_kept[rows].all():
            yield from (FrameBlock(piece, self._kept[piece[0] : piece[-1] + 1]) for piece in pieces)
            return
        queue: Queue[FrameBlock | BaseException | None] = Queue(maxsize=BLOCKS_AHEAD)
        closed = threading.Event()
        reader = threading.Thread(target=self._read, args=(pieces, boxes, queue, closed), daemon=True)
        reader.start()
        try:
            while (item := queue.get()) is not None:
                if isinstance(item, BaseException):
                    raise item
                yield item
        finally:
            closed.set()
            while reader.is_alive() or not queue.empty():
                try:
                    item = queue.get_nowait()
                except Empty:
                    reader.join(0.1 * POLL_S)
                else:
                    if isinstance(item, FrameBlock):
                        item.release()

    def _read(
        self,
        pieces: list[Rows],
        boxes: NDArray[np.int64] | None,
        queue: Queue[FrameBlock | BaseException | None],
        closed: threading.Event,
    ) -> None:
        """Fill the queue with blocks, then None; an error goes into the queue and is raised by the thread that waits."""
        end: BaseException | None = None
        try:
            readers = [_ClipReader(clip, pieces) for clip in self.clips]
            for rows in pieces:
                block = self._empty_block(rows)
                # A frame that is kept is read whole, whatever part of it is asked for now.
                parts = None if boxes is None or self._kept is not None else boxes[rows]
                for c, reader in enumerate(readers):
                    if not reader.read(rows, block.frames[:, c], None if parts is None else parts[:, c], closed):
                        block.release()
                        return
                if self._kept is not None:
                    self._is_kept[rows] = True
                _put(queue, block, closed)
        except BaseException as error:
            end = error
        _put(queue, end, closed)

    def _empty_block(self, rows: Rows) -> FrameBlock:
        """A block to write the frames `rows` to: of a clip that is kept, the place where they are kept."""
        if self._kept is not None:
            return FrameBlock(rows, self._kept[rows[0] : rows[-1] + 1])
        buffer = self._pool.take()
        return FrameBlock(rows, buffer[: len(rows)], self._pool, buffer)


def _kept_by(clips: Sequence[Clip]) -> tuple[Frames, NDArray[np.bool_]] | None:
    """The frames that a single clip keeps itself, and which of them are there."""
    only = clips[0] if len(clips) == 1 else None
    return only.kept_frames if isinstance(only, Footage) else None


class _ClipReader:
    """Frames of one clip, in order: any of them where the clip fills frames, else all of a range."""

    def __init__(self, clip: Clip, pieces: list[Rows]) -> None:
        self._size = clip.height_px, clip.width_px
        self._filling = clip if isinstance(clip, FillsFrames) else None
        in_order = pieces and not self._filling
        self._frames = clip.frames(int(pieces[0][0]), int(pieces[-1][-1]) + 1) if in_order else iter(())

    def read(self, rows: Rows, out: Frames, boxes: NDArray[np.int64] | None, closed: threading.Event) -> bool:
        """Write the frames `rows` (n,) into `out` (n, height, width); False where `closed` was set before the last."""
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
            queue.put(item, timeout=POLL_S)
            return
        except Full:
            continue
