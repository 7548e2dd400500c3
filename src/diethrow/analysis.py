"""analysis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .fitting.results import Fit
from .model.die import Die
from .model.throw import Throw
from .tracking.camera import Camera
from .tracking.check import fall_notices, measure_fall
from .tracking.clip_parameters import Corners, Offsets
from .tracking.footage import Clip
from .tracking.surface_marks import FaceNumbers
from .tracking.track import Track

Progress = Callable[[str, int, int], None]
"""Told the name of the stage, what is done and what there is to do; a total of 0 where that is not known."""


class RunError(ValueError):
    """A run whose input is well formed and still gives no result; the text says why."""


@dataclass(frozen=True)
class Shown:
    """What is drawn of a throw besides the recording and the plain report."""

    embed_replay: bool = False
    """The viewer and the recording within the report: some 20 MB more."""
    figures: bool = False
    """Every figure of the report as a file of its own, PNG and SVG."""


PLAIN = Shown()


@dataclass(frozen=True, eq=False)
class Tracking:
    """What the footage says, before any model of an impact."""

    clips: tuple[Clip, ...]
    """One a camera, as they were looked through."""
    cameras: tuple[Camera, ...]
    die: Die
    """The scene's, with its faces in the order of the numbers on them where those could be read."""
    faces: FaceNumbers
    """What could be read on the faces."""
    frames: Track
    """The pose of each frame alone."""
    straight: Track
    """The same with the error that all frames share taken out, and covariances for a fit that takes them for independent."""
    measured: Throw
    smoothed: Track
    """The same frames, with the exact motion of the flights where it holds."""
    offsets: Offsets
    """Of the clocks of several cameras."""
    corners: Corners | None
    """How rounded the die looks; None where the scene says it, or the corners look sharp. `die` has that radius."""

    @property
    def face_numbers(self) -> tuple[int | None, ...]:
        """The number on each face of `die`; None where it could not be read."""
        count = len(self.faces.numbers)
        return tuple(range(1, count + 1)) if self.faces.complete else self.faces.numbers

    @property
    def notices(self) -> tuple[str, ...]:
        """What a careful reader should know of the footage and of the motion in it, one sentence each."""
        return (
            *(n for clip in self.clips for n in clip.notices),
            *self.offsets.notices(1.0 / rate_hz(self.frames)),
            *((self.corners.notice,) if self.corners is not None else ()),
            *((self.faces.verdict,) if self.die.marks is not None and not self.faces.complete else ()),
            *fall_notices(measure_fall(self.frames, self.measured)),
        )


@dataclass(frozen=True, eq=False)
class Analysis:
    """A whole analysis, as it was written to `folder`."""

    folder: Path
    track: Track
    measured: Throw
    fit: Fit
    notices: tuple[str, ...]
    """What a careful reader should know of the footage, one sentence each."""
    seconds: dict[str, float]
    """Time that each stage took."""


def silent(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


def rate_hz(track: Track) -> float:
    """Frames a second of the clock of the track, whatever it came from."""
    steps = np.diff(track.time_s) / np.maximum(np.diff(track.frame), 1)
    return 1.0 / float(np.median(steps))
