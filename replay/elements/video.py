"""A clip as a film that the viewer can play: AV1 in mp4, or one JPEG a frame where AV1 cannot be had.

The encoders take 8 bits a pixel and at most 240 frames per second. Deeper footage is mapped to 8 bits through one fixed
window for the whole clip, for display only; the film runs at a nominal 30 frames per second, and each frame of the
recording refers to its own frame of the film. Frames pass through one at a time.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ...tracking.footage import Clip, Frame

NOMINAL_FPS = 30
THREADS = Path("/proc/self/task")
"""Where Linux, the only system where this happens, lists the threads of this process."""
SMALLEST_PX = 64
"""The AV1 encoder takes no smaller picture."""


@dataclass(frozen=True)
class Window:
    """The grey levels shown as black and as white."""

    black: float
    white: float

    def apply(self, frame: Frame) -> NDArray[np.uint8]:
        """The frame in 8 bits."""
        if frame.dtype == np.uint8 and (self.black, self.white) == (0.0, 255.0):
            return np.asarray(frame, np.uint8)
        scaled = (frame.astype(np.float32) - self.black) * (255.0 / (self.white - self.black))
        return np.clip(np.rint(scaled), 0, 255).astype(np.uint8)


def display_window(clip: Clip) -> Window:
    """8-bit clips as they are; deeper ones from the 0.1 to the 99.9 per cent level of 16 frames over the clip."""
    if clip.bit_depth <= 8:
        return Window(0.0, float(2**clip.bit_depth - 1))
    chosen = np.unique(np.linspace(0, len(clip) - 1, 16).round().astype(int))
    # Every 16th pixel of 16 frames: the window needs a few grey levels, not the clip.
    sample = np.concatenate([clip.frame(int(k)).ravel()[::16] for k in chosen])
    black, white = np.percentile(sample, [0.1, 99.9])
    return Window(float(black), float(max(white, black + 1.0)))


def can_encode_av1() -> bool:
    """Whether this build of FFmpeg has the AV1 encoder."""
    return "libsvtav1" in av.codecs_available


def encode_av1(clip: Clip, window: Window) -> bytes:
    """The clip as an mp4 of AV1, its frame k at k / 30 s. Pictures of odd size gain a row or column at the end."""
    buffer = io.BytesIO()
    width, height = (max(size + size % 2, SMALLEST_PX) for size in (clip.width_px, clip.height_px))
    margin = ((0, height - clip.height_px), (0, width - clip.width_px))
    with _quiet_encoder(), _behind_nobody() as calm, av.open(buffer, "w", format="mp4") as film:
        # Preset 8 is the fastest that the encoder recommends for films; a key frame every 30 keeps seeking short.
        options = {"preset": "8", "crf": "28", "g": "30", "svtav1-params": "lp=2"}
        stream = film.add_stream("libsvtav1", rate=NOMINAL_FPS, options=options)
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = Fraction(1, NOMINAL_FPS)
        for number, frame in enumerate(clip.frames()):
            picture = av.VideoFrame.from_ndarray(np.pad(window.apply(frame), margin, mode="edge"), format="gray")
            picture = picture.reformat(format="yuv420p")
            picture.pts, picture.time_base = number, Fraction(1, NOMINAL_FPS)
            film.mux(stream.encode(picture))
            if number == 0:
                calm()  # the encoder has begun, and its threads with it
        film.mux(stream.encode(None))
    return buffer.getvalue()


@contextmanager
def _quiet_encoder() -> Iterator[None]:
    """SVT-AV1 writes its settings to stderr, past FFmpeg's log, unless this variable asks for errors only."""
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
def _behind_nobody() -> Iterator[Callable[[], None]]:
    """Started by root, SVT-AV1 gives its threads, and the one that called it, the highest real-time priority: nothing else
    on the machine runs while they do, and whatever the process starts later inherits it. Within the block the function,
    and at its end the block itself, puts all threads of this process back among the others."""
    calm = _with_ordinary_priority if THREADS.is_dir() and os.geteuid() == 0 else lambda: None
    try:
        yield calm
    finally:
        calm()


def _with_ordinary_priority() -> None:
    for thread in THREADS.iterdir():
        with suppress(ProcessLookupError):  # a thread that has just ended
            if os.sched_getscheduler(int(thread.name)) in (os.SCHED_FIFO, os.SCHED_RR):
                os.sched_setscheduler(int(thread.name), os.SCHED_OTHER, os.sched_param(0))


def encode_jpegs(clip: Clip, window: Window) -> Iterator[bytes]:
    """Each frame as a JPEG of quality 90."""
    for frame in clip.frames():
        done, data = cv2.imencode(".jpg", window.apply(frame), [cv2.IMWRITE_JPEG_QUALITY, 90])
        if not done:
            raise ValueError(f"a frame of {frame.shape[1]} x {frame.shape[0]} pixels could not be written as JPEG")
        yield data.tobytes()
