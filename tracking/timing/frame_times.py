"""The times of a clip's frames, with what the motion says against those of the file.

`find_frame_times` names missing, doubled and frozen frames of a track, each with its evidence, and gives the times that are
right where it is certain. A frame that repeats a picture is not used; its time lies evenly between its neighbours'.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat
from ..camera import Camera
from ..footage import Clip
from ..throw import first_supported_row, rows_without_outliers, weighted_poses
from ..track import Track
from .motion_clock import StepKind, TimeStep, find_time_steps
from .repeated_pictures import repeated_pictures

Array = NDArray[np.float64]
Rows = NDArray[np.int64]

MIN_POSES = 8
"""Fewest poses in flight in which a step is sought: four on either side."""
MEANINGFUL_STEP = 0.5
"""Largest distance [frame intervals] of the free estimate of a step from the one that is stated, for both to be one."""
LEAST_SPACING = 0.99
"""Share of the interval between frames below which those of a gap are spread evenly over it: some of them are there twice."""
MAX_LISTED = 6
"""Most faults of a kind that a message lists with their evidence."""


class FaultKind(Enum):
    """What is wrong with the times of some frames."""

    MISSING = "missing"
    """Frames between two others are missing from the file."""
    DOUBLED = "doubled"
    """Frames repeat a picture, and were added: the clock stood."""
    FROZEN = "frozen"
    """Frames repeat a picture in the place of their own: the clock ran on."""
    FRACTION = "fraction"
    """The clock steps by a part of a frame interval."""
    UNDECIDED = "undecided"
    """Frames are missing or repeated at an impact, or where the motion is too slow to say what the clock did."""


@dataclass(frozen=True)
class FrameFault:
    """A fault of the times in one gap of a clip."""

    kind: FaultKind
    before: int
    """Number of the last frame before it."""
    after: int
    """Number of the first frame behind it that shows a pose of its own."""
    intervals: float
    """Frame intervals by which all frames behind are later than filmed."""
    sigma_intervals: float
    """Standard error of the measured step."""
    measured_intervals: float
    evidence: float
    """Gain in log-likelihood over the next best hypothesis."""
    repeated: tuple[int, ...] = ()
    """Numbers of the frames between whose picture repeats the one before."""

    @property
    def is_certain(self) -> bool:
        """Whether the times can be corrected."""
        return self.kind in (FaultKind.MISSING, FaultKind.DOUBLED, FaultKind.FROZEN)

    @property
    def record(self) -> dict[str, object]:
        """The fault as numbers and words, for a file."""
        return {
            "kind": self.kind.value,
            "after_frame": self.before,
            "before_frame": self.after,
            "intervals": self.intervals,
            "measured_intervals": self.measured_intervals,
            "sigma_intervals": self.sigma_intervals,
            "log_likelihood_gain": self.evidence,
            "repeated_frames": list(self.repeated),
        }

    @property
    def sentence(self) -> str:
        """What was found, with its evidence."""
        step = f"step of {self.measured_intervals:.2f} ± {self.sigma_intervals:.2f} frame intervals"
        gain = f"log-likelihood gain {self.evidence:.0f}"
        gap = f"between frames {self.before} and {self.after}"
        if self.kind is FaultKind.MISSING:
            return f"{_frames(round(self.intervals))} missing {gap} ({step}, {gain})"
        if self.kind is FaultKind.FRACTION:
            return f"the clock makes a {step} {gap} ({gain})"
        if self.repeated:
            names = _named(self.repeated)
            what = {
                FaultKind.DOUBLED: "is a copy and the clock stood",
                FaultKind.FROZEN: "shows an old picture while the clock ran on",
            }.get(self.kind, "repeats the picture before, and the motion does not show whether the clock ran on")
            # At an impact the step is that of the likeliest hypothesis, and no free estimate has a meaning.
            free = abs(self.measured_intervals - self.intervals) < MEANINGFUL_STEP
            return f"{names} {what} ({step}, {gain})" if free else f"{names} {what} (beside an impact, {gain})"
        if self.intervals < 0:
            return f"the motion makes a {step} {gap}, and no picture there is a copy ({gain})"
        return f"{_frames(round(self.intervals))} probably missing {gap}, where an impact lies ({gain})"


@dataclass(frozen=True, eq=False)
class FrameTimes:
    """Times of a clip's frames, and the faults that were found in those of the file."""

    times_s: Array
    """(n,) [s] of the clip's frames: corrected if `corrected`, else those of the file."""
    faults: tuple[FrameFault, ...]
    corrected: bool
    """Whether the certain faults are corrected in `times_s`."""
    why_not: str = ""
    """Why certain faults are not corrected; empty where they are."""

    @staticmethod
    def as_filmed(clip: Clip) -> FrameTimes:
        """The times of the file."""
        return FrameTimes(np.asarray(clip.times_s, float), (), False)

    def renumbered(self, first: int, every: int) -> FrameTimes:
        """The same with frame numbers of the file, of which one in `every` was numbered on from the first."""

        def in_file(number: int) -> int:
            return first + every * (number - first)

        faults = tuple(
            replace(
                fault,
                before=in_file(fault.before),
                after=in_file(fault.after),
                repeated=tuple(map(in_file, fault.repeated)),
            )
            for fault in self.faults
        )
        return replace(self, faults=faults)

    @property
    def changes(self) -> bool:
        """Whether the faults change times, or leave out pictures."""
        return any(fault.is_certain or fault.repeated for fault in self.faults)

    def uncorrected(self, why_not: str, clip: Clip) -> FrameTimes:
        """The same faults at the times of the file, with the reason."""
        return FrameTimes(np.asarray(clip.times_s, float), self.faults, False, why_not)

    @property
    def unused(self) -> tuple[tuple[int, int], ...]:
        """Ranges (first, stop) of the frames whose pictures are not used: they repeat others."""
        return tuple((k, k + 1) for fault in self.faults for k in fault.repeated) if self.corrected else ()

    @property
    def notices(self) -> tuple[str, ...]:
        """One sentence a kind of fault, with the frames and the evidence of the first few."""
        out = []
        for kind in FaultKind:
            some = [fault for fault in self.faults if fault.kind is kind]
            if not some:
                continue
            listed = "; ".join(fault.sentence for fault in some[:MAX_LISTED])
            more = f"; and {len(some) - MAX_LISTED} more" if len(some) > MAX_LISTED else ""
            out.append(f"Frame times, from the motion: {listed}{more}. {self._consequence(some[0])}")
        return tuple(out)

    def _consequence(self, fault: FrameFault) -> str:
        if not fault.is_certain:
            return "Times are as filmed there; look at these frames."
        if self.corrected:
            return "The times are corrected; --timing as-filmed leaves them."
        return f"The times are as filmed: {self.why_not}."


def find_frame_times(
    track: Track,
    die: Die,
    camera: Camera,
    clip: Clip,
    interval_s: float | None = None,
    excluded: Sequence[tuple[int, int]] = (),
) -> FrameTimes:
    """The faults of a clip's times that a track shows, and the times with those corrected that are certain.

    `interval_s` is the interval of the camera's clock, by default the clip's; pictures of frames in the ranges `excluded`
    (first, stop) are not examined. Times that the file states for every frame are not corrected."""
    if len(track) < MIN_POSES:
        return FrameTimes.as_filmed(clip)
    interval = float(np.median(np.diff(clip.times_s))) if interval_s is None else interval_s
    copies = repeated_pictures(track, die, camera, clip.frame, excluded)
    whole = _wholly_in_view(track, die, camera)
    found = FrameTimes(np.asarray(clip.times_s, float), _faults(track, die, copies, whole, interval), True)
    if found.changes and clip.metadata().get("time_stamps"):
        return found.uncorrected("the file states the time of every frame, and the motion contradicts it", clip)
    return replace(found, times_s=_corrected(found.times_s, track.frame, found.faults, interval))


def joined(earlier: FrameTimes, later: FrameTimes) -> FrameTimes:
    """What was found at the times of the file, and at times that had been corrected by it."""
    kept = tuple(fault for fault in earlier.faults if fault.is_certain or fault.repeated)
    new = tuple(fault for fault in later.faults if all(fault.before != old.before for old in kept))
    faults = tuple(sorted((*kept, *new), key=lambda fault: fault.before))
    return replace(later, faults=faults)


def _wholly_in_view(track: Track, die: Die, camera: Camera) -> Rows:
    """Rows with a pose whose die lies within the picture. Errors of poses that the border of the picture cuts are not those that
    they state, and grow as the die leaves: beside it the motion of a sound clip once seemed to step by a frame."""
    rows = np.flatnonzero(track.tracked)
    corners = np.einsum("nij,vj->nvi", matrix_from_quat(track.quaternion[rows]), die.solid.vertices)
    return rows[camera.contains(camera.project(corners + track.position_m[rows, None])).all(1)]


def _faults(track: Track, die: Die, copies: Rows, whole: Rows, interval_s: float) -> tuple[FrameFault, ...]:
    """Every fault, in order, by poses of the rows `whole` that are no copies."""
    use = np.setdiff1d(whole, copies)
    if len(use) < MIN_POSES:
        return ()
    observations = weighted_poses(track, use)
    kept = rows_without_outliers(observations, die)
    use, observations = use[kept], observations.rows(kept)
    flying = first_supported_row(observations, die) if len(use) else 0
    use, observations = use[:flying], observations.rows(slice(0, flying))
    if len(use) < MIN_POSES:
        return ()
    numbers = track.frame[copies]
    steps = find_time_steps(observations, track.frame[use], interval_s, numbers)
    return tuple(_fault(step, track, numbers, interval_s) for step in steps)


def _fault(step: TimeStep, track: Track, copies: Rows, interval_s: float) -> FrameFault:
    between = tuple(int(k) for k in copies if step.before < k < step.after)
    kind = {
        StepKind.FRACTION: FaultKind.FRACTION,
        StepKind.UNDECIDED: FaultKind.UNDECIDED,
        StepKind.RUNS_ON: FaultKind.FROZEN,
        StepKind.WHOLE: FaultKind.MISSING if step.intervals > 0 else FaultKind.DOUBLED,
    }[step.kind]
    begin_s, end_s = track.time_s[np.searchsorted(track.frame, [step.before, step.after])]
    if kind is FaultKind.DOUBLED and end_s - begin_s + step.intervals * interval_s < 0.5 * interval_s:
        # The motion stands or goes back although no frame lies between: the pictures are none of one clock.
        kind = FaultKind.UNDECIDED
    return FrameFault(
        kind,
        step.before,
        step.after,
        step.intervals,
        step.sigma_intervals,
        step.measured_intervals,
        step.evidence,
        between,
    )


def _corrected(times_s: Array, frames: Rows, faults: tuple[FrameFault, ...], interval_s: float) -> Array:
    """Times (n,) of frames (n,) with every certain fault corrected; those of repeated pictures lie evenly between others."""
    out = times_s.copy()
    for fault in faults:
        if fault.is_certain:
            out[frames >= fault.after] += fault.intervals * interval_s
    for fault in faults:
        before, after = np.searchsorted(frames, [fault.before, fault.after])
        if fault.repeated or out[after] - out[before] < (after - before) * interval_s * LEAST_SPACING:
            out[before : after + 1] = np.linspace(out[before], out[after], after - before + 1)
    return out


def _frames(count: int) -> str:
    return "1 frame is" if count == 1 else f"{count} frames are"


def _named(frames: tuple[int, ...]) -> str:
    return f"frame {frames[0]}" if len(frames) == 1 else f"each of frames {frames[0]} to {frames[-1]}"
