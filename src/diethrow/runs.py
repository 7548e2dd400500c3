"""Values of a run: what tracking found, what is written, and what is reported on the way."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .model.die import Die
from .model.errors import InputError
from .model.throw import Throw
from .tracking.camera import Camera
from .tracking.check import SecondDie, fall_notices, measure_fall
from .tracking.clip_parameters import ClockOffsets, CornerRadius, EstimatedResponse, open_contour_notice
from .tracking.footage import Clip
from .tracking.picture import Lens
from .tracking.surface_marks import FaceNumbers
from .tracking.timing import FrameTimes
from .tracking.track import Track

Progress = Callable[[str, int, int], None]
"""Called with the name of the stage, the amount done and the total; a total of 0 is unknown."""


class RunError(InputError):
    """A run with well-formed input and no result; the text states the reason."""


@dataclass(frozen=True)
class Shown:
    """What is written besides the recording and the plain report."""

    embed_replay: bool = False
    """Embed the viewer and the recording in the report: some 20 MB more."""
    figures: bool = False
    """Also write every figure of the report as PNG and SVG."""


PLAIN = Shown()


@dataclass(frozen=True, eq=False)
class Tracking:
    """Result of tracking, which needs no impact law."""

    clips: tuple[Clip, ...]
    """One per camera, as used."""
    cameras: tuple[Camera, ...]
    """As the throw shows them, where they are known only so far: the poses lie on their pictures."""
    die: Die
    """The scene's die, with its faces in the order of their numbers if those could be read."""
    faces: FaceNumbers
    """Numbers read from the faces."""
    frames: Track
    """The pose of each frame alone."""
    unbiased: Track
    """The same without the bias common to all frames, with covariances for a fit that assumes independent errors."""
    measured: Throw
    smoothed: Track
    """The same frames, with the exact motion of the flights in flight."""
    offsets: ClockOffsets
    """Clock offsets of several cameras."""
    corners: CornerRadius | None
    """Estimated corner radius, which `die` has; None if the scene states it or the corners look sharp."""
    times: FrameTimes
    """Times of the frames, and the faults that the motion shows in those of the file."""
    second_die: SecondDie | None = None
    """A second die in view of the first camera."""
    doubts: tuple[str, ...] = ()
    """Sentences that name frames whose poses contradict each other."""
    response: EstimatedResponse | None = None
    """Estimated response of the cameras; None if the scene states it or the pictures do not show it."""
    lens: Lens | None = None
    """Estimated lens of the first camera; None if the pictures show no depth of field."""

    @property
    def notices(self) -> tuple[str, ...]:
        """Reservations about the footage and the motion in it, one sentence each."""
        contour_px = self.frames.contour_sigma_px
        return (
            *(n for clip in self.clips for n in clip.notices),
            *self.times.notices,
            *self.offsets.notices(1.0 / rate_hz(self.frames)),
            *((self.corners.notice,) if self.corners is not None else ()),
            *((open_contour_notice(contour_px),) if self.corners is None and contour_px > 0.0 else ()),
            *((self.response.notice,) if self.response is not None and not self.response.is_exact else ()),
            *((self.lens.notice,) if self.lens is not None else ()),
            *((self.second_die.notice,) if self.second_die is not None else ()),
            *((self.faces.verdict,) if self.die.marks is not None and not self.faces.complete else ()),
            *self.doubts,
            *fall_notices(measure_fall(self.frames, self.measured)),
        )


def silent(stage: str, done: int, total: int) -> None:
    """Ignore progress."""


def rate_hz(track: Track) -> float:
    """Frames per second of the track's clock."""
    steps = np.diff(track.time_s) / np.maximum(np.diff(track.frame), 1)
    return 1.0 / float(np.median(steps))
