"""A clip as video for the viewer: AV1 in mp4, or one JPEG per frame if no AV1 encoder is available.

The encoders take 8 bits per pixel and at most 240 frames per second. Deeper footage is mapped to 8 bits by one window of
grey levels for the whole clip, for display only. The video has a nominal 30 frames per second, and each frame of the
recording refers to its frame of the video. One frame is in memory at a time.

The video does not depend on what is found in it, so a `VideoEncoding` makes it in a thread while the clip is tracked. It reads
the file by itself, because a decoder serves one reader only.
"""

from __future__ import annotations

import io
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

if TYPE_CHECKING:
    from ...tracking.footage import Clip, Frame

NOMINAL_FPS = 30
AV1_PRESET = "10"
"""Of 8, the fastest that SVT-AV1 recommends for films, to 13. Against 8 it takes 0.6 of the time and 4 % more bytes (of five
clips, 10 % less to 23 % more), at 0.3 dB less; 12 takes 0.4 of it, at 0.9 dB less (`benchmarks/recording.py --presets`)."""
AV1_QUALITY = "28"
"""Constant rate factor, 0 (lossless) to 63: larger values give smaller files."""
KEY_FRAME_INTERVAL = "30"
"""Frames between key frames: a shorter interval makes seeking faster and files larger."""
AV1_MIN_SIZE_PX = 64
"""The AV1 encoder refuses smaller images."""
MOST_SHOWN_FRAMES = 3000
"""Most frames of a video: two seconds at 1500 frames/s. To encode a frame takes twice the time of tracking it in a long clip,
whose neighbouring frames hardly differ."""
JPEG_QUALITY = 90
THREADS = Path("/proc/self/task")
"""Where Linux lists the threads of this process; the priorities below are a problem on Linux only."""
LUMA = np.rint(16.0 + 219.0 / 255.0 * np.arange(256)).astype(np.uint8)
"""(256,) level in a video of 8 bits of each grey level: black is 16 and white 235 (ITU-R BT.601)."""
NO_COLOUR = 128
"""Level of grey's chroma there."""
WINDOW_PERCENTILES = (0.1, 99.9)
"""Grey levels shown as black and white: beyond them lie glare and defective pixels."""
WINDOW_FRAMES = 16
"""Frames, spread over the clip, that the percentiles are taken from."""
WINDOW_PIXEL_STEP = 16
"""Every 16th pixel of those frames: the percentiles need a few thousand grey levels."""


@dataclass(frozen=True)
class Window:
    """The grey levels that are shown as black and as white."""

    black: float
    white: float

    def apply(self, frame: Frame) -> NDArray[np.uint8]:
        """The frame in 8 bits."""
        if frame.dtype == np.uint8 and (self.black, self.white) == (0.0, 255.0):
            return np.asarray(frame, np.uint8)
        scaled = (frame.astype(np.float32) - self.black) * (255.0 / (self.white - self.black))
        return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def display_window(clip: Clip) -> Window:
    """The full range for clips of up to 8 bits; for deeper ones, WINDOW_PERCENTILES of frames spread over the clip."""
    if clip.bit_depth <= 8:
        return Window(0.0, float(2**clip.bit_depth - 1))
    chosen = np.unique(np.linspace(0, len(clip) - 1, WINDOW_FRAMES).round().astype(int))
    sample = np.concatenate([clip.frame(int(k)).ravel()[::WINDOW_PIXEL_STEP] for k in chosen])
    black, white = np.percentile(sample, WINDOW_PERCENTILES)
    return Window(float(black), float(max(white, black + 1.0)))


def shown_rows(clip: Clip) -> NDArray[np.int64]:
    """Rows of the frames that a recording shows: all of them, or every n-th of a clip of more than MOST_SHOWN_FRAMES. The poses
    of the others are there, over the picture shown last."""
    step = -(-len(clip) // MOST_SHOWN_FRAMES)
    return np.arange(0, len(clip), step)


def can_encode_av1() -> bool:
    """Whether this build of FFmpeg has the AV1 encoder SVT-AV1."""
    import av

    return "libsvtav1" in av.codecs_available


def encode_av1(clip: Clip, window: Window, stop: threading.Event | None = None) -> bytes:
    """The frames `shown_rows` of a clip as an AV1 video in mp4, number k at k / 30 s. Images of odd size gain a row or column at
    the end.

    Raises CancelledError once `stop` is set, and as `clip.frames`.
    """
    import av  # by whoever encodes: results without a clip are drawn with these elements as well

    buffer = io.BytesIO()
    width, height = (max(size + size % 2, AV1_MIN_SIZE_PX) for size in (clip.width_px, clip.height_px))
    margin = ((0, height - clip.height_px), (0, width - clip.width_px))
    # The three planes of yuv420p below each other: luma, and two of chroma at half size.
    planes = np.full((height + height // 2, width), NO_COLOUR, np.uint8)
    with _quiet_encoder(), _ordinary_priority() as reset_priority, av.open(buffer, "w", format="mp4") as video:
        options = {"preset": AV1_PRESET, "crf": AV1_QUALITY, "g": KEY_FRAME_INTERVAL, "svtav1-params": "lp=2"}
        stream = video.add_stream("libsvtav1", rate=NOMINAL_FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = Fraction(1, NOMINAL_FPS)
        for number, frame in enumerate(_shown_frames(clip)):
            if stop is not None and stop.is_set():
                raise CancelledError
            planes[:height] = np.pad(cv2.LUT(window.apply(frame), LUMA), margin, mode="edge")
            picture = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            picture.pts, picture.time_base = number, Fraction(1, NOMINAL_FPS)
            video.mux(stream.encode(picture))
            if number == 0:
                reset_priority()  # the encoder has started its threads
        video.mux(stream.encode(None))
    return buffer.getvalue()


class VideoEncoding:
    """The AV1 video of a clip, encoded in a thread. The end of the block stops the thread."""

    def __init__(
        self, open_clip: Callable[[], Clip], timed: Callable[[str], AbstractContextManager[None]] | None = None
    ) -> None:
        """`open_clip` opens the clip for this thread alone; `timed` measures the stage "video"."""
        self._open, self._timed = open_clip, timed or (lambda name: nullcontext())
        self._stop = threading.Event()
        self._thread = ThreadPoolExecutor(1)
        self._video = self._thread.submit(self._encoded) if can_encode_av1() else None

    @property
    def available(self) -> bool:
        """Whether there is an encoder."""
        return self._video is not None

    def result(self) -> bytes:
        """The video, once it is complete. Raises as `encode_av1`, and whatever opening the clip raised."""
        assert self._video is not None, "there is no encoder"
        return self._video.result()

    def __enter__(self) -> VideoEncoding:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.shutdown(cancel_futures=True)

    def _encoded(self) -> bytes:
        threading.current_thread().name = "encoder"
        with self._timed("video"):
            clip = self._open()
            return encode_av1(clip, display_window(clip), self._stop)


@contextmanager
def _quiet_encoder() -> Iterator[None]:
    """Suppress the settings that SVT-AV1 writes to stderr past FFmpeg's log, by its variable for errors only."""
    before = os.environ.get("SVT_LOG")
    os.environ["SVT_LOG"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["SVT_LOG"]
        else:
            os.environ["SVT_LOG"] = before


@contextmanager
def _ordinary_priority() -> Iterator[Callable[[], None]]:
    """Keep the threads of this process at ordinary priority; the function that is given resets it, and so does the end.

    If root starts SVT-AV1, it gives its own threads and the calling one the highest real-time priority. They then block
    all other work on the machine, and processes that are started later inherit the priority.
    """
    reset = _reset_priorities if THREADS.is_dir() and os.geteuid() == 0 else lambda: None
    try:
        yield reset
    finally:
        reset()


def _reset_priorities() -> None:
    for thread in THREADS.iterdir():
        with suppress(ProcessLookupError):  # the thread has just ended
            if os.sched_getscheduler(int(thread.name)) in (os.SCHED_FIFO, os.SCHED_RR):
                os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))


def encode_jpegs(clip: Clip, window: Window) -> Iterator[bytes]:
    """Each of the frames `shown_rows` as a JPEG. Raises ValueError if a frame cannot be encoded."""
    for frame in _shown_frames(clip):
        done, data = cv2.imencode(".jpg", window.apply(frame), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not done:
            raise InputError(f"a frame of {frame.shape[1]} x {frame.shape[0]} pixels could not be encoded as JPEG")
        yield data.tobytes()


def _shown_frames(clip: Clip) -> Iterator[Frame]:
    """In order; where all are shown, as the clip reads them fastest."""
    rows = shown_rows(clip)
    return clip.frames() if len(rows) == len(clip) else (clip.frame(k) for k in rows.tolist())
