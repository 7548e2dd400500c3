"""A clip as video for the viewer: AV1 in mp4, or one JPEG per frame if no AV1 encoder is available.

The encoders take 8 bits per pixel and at most 240 frames per second. Deeper footage is mapped to 8 bits by one window of
grey levels for the whole clip, for display only. The video has a nominal 30 frames per second, and each frame of the
recording refers to its frame of the video. One frame is in memory at a time.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.errors import InputError

if TYPE_CHECKING:
    from ...tracking.footage import Clip, Frame

NOMINAL_FPS = 30
AV1_PRESET = "8"
"""The fastest preset that SVT-AV1 recommends for films."""
AV1_QUALITY = "28"
"""Constant rate factor, 0 (lossless) to 63: larger values give smaller files."""
KEY_FRAME_INTERVAL = "30"
"""Frames between key frames: a shorter interval makes seeking faster and files larger."""
AV1_MIN_SIZE_PX = 64
"""The AV1 encoder refuses smaller images."""
JPEG_QUALITY = 90
THREADS = Path("/proc/self/task")
"""Where Linux lists the threads of this process; the priorities below are a problem on Linux only."""
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


def can_encode_av1() -> bool:
    """Whether this build of FFmpeg has the AV1 encoder SVT-AV1."""
    return "libsvtav1" in av.codecs_available


def encode_av1(clip: Clip, window: Window) -> bytes:
    """The clip as an AV1 video in mp4, frame k at k / 30 s. Images of odd size gain a row or column at the end."""
    buffer = io.BytesIO()
    width, height = (max(size + size % 2, AV1_MIN_SIZE_PX) for size in (clip.width_px, clip.height_px))
    margin = ((0, height - clip.height_px), (0, width - clip.width_px))
    with _quiet_encoder(), _ordinary_priority() as reset_priority, av.open(buffer, "w", format="mp4") as video:
        options = {"preset": AV1_PRESET, "crf": AV1_QUALITY, "g": KEY_FRAME_INTERVAL, "svtav1-params": "lp=2"}
        stream = video.add_stream("libsvtav1", rate=NOMINAL_FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = Fraction(1, NOMINAL_FPS)
        for number, frame in enumerate(clip.frames()):
            picture = av.VideoFrame.from_ndarray(np.pad(window.apply(frame), margin, mode="edge"), format="gray")
            picture = picture.reformat(format="yuv420p")
            picture.pts, picture.time_base = number, Fraction(1, NOMINAL_FPS)
            video.mux(stream.encode(picture))
            if number == 0:
                reset_priority()  # the encoder has started its threads
        video.mux(stream.encode(None))
    return buffer.getvalue()


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
    """Each frame as a JPEG. Raises ValueError if a frame cannot be encoded."""
    for frame in clip.frames():
        done, data = cv2.imencode(".jpg", window.apply(frame), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        if not done:
            raise InputError(f"a frame of {frame.shape[1]} x {frame.shape[0]} pixels could not be encoded as JPEG")
        yield data.tobytes()
