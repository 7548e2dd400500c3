"""Measures the quality of a clip on few frames: the numbers behind `diethrow check`.

A dozen frames over the clip show the background and its noise. A part of at most PART_FRAMES frames is tracked, from the first
frame with the die in view. All else follows from its poses and their pixels:

- motion blur: how far the projected corners move within the exposure;
- lens blur: the width of edge that leaves the least noise on a few frames, each refined again for every trial width;
- the fall: the acceleration with nothing assumed about it (`gravity`). Errors of neighbouring frames are correlated (shading,
  marks, depth). With a first-order autoregression of correlation r, a sum of n terms has (1 + r) / (1 - r) times the variance of
  independent ones, and the interval is widened accordingly;
- the shutter: the readout that shears the die in the picture (`shutter`);
- a second die: regions as large as the die beside it (`second_die`);
- the table: the height of the contact at every bounce that was resolved.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die, inner_vertices
from ...model.rotations import matrix_from_quat
from ...model.throw import State, Throw
from ..camera import Camera
from ..clip_parameters import CornerRadius
from ..flights import transition_matrix
from ..footage import Clip, Frame, estimate_background
from ..picture import (
    PixelNoise,
    View,
    background_noise,
    differs_from_background,
    flight_from,
    largest_blob,
    level_step,
    make_view,
    outline_box,
    pixel_noise,
    without_shadow,
)
from ..pose import ManualInitialisation, die_blobs, pose_state, refine_pose
from ..quality import FAST
from ..sequence import NO_FACTS, ClipFacts, NoDieError
from ..throw import NoFlightError, measure_throw
from ..timing import ITS_OWN, ClipClock, FrameTimes, track_clip_in_time
from ..track import Track
from .gravity import Fall, measure_fall
from .second_die import SecondDie, find_second_die
from .shutter import Readout, estimate_readout

Array = NDArray[np.float64]
Image = NDArray[np.float32]

PART_FRAMES = 180
"""Most frames tracked: 0.12 s at 1500 frames/s, in which a die falls 7 cm from rest and usually bounces."""
LEAD_FRAMES = 4
"""Frames tracked before the first one that shows the whole die."""
SAMPLED_FRAMES = 12
"""Frames over the clip that background and noise are measured on."""
SEARCHED_FRAMES = 48
"""Frames over the clip on which the die is searched for."""
BLURS_PX = (0.3, 0.45, 0.6, 0.8, 1.05, 1.4, 1.9, 2.6)
"""Trial widths of an edge, each a third larger than the one before: a parabola through three finds the minimum."""
START_BLUR_PX = 0.7
"""Width of an edge until it is measured: that of a well-focused lens."""
BLUR_FRAMES = 6
"""Frames that the width of an edge is measured on: their median excludes one that is spoiled."""
ALWAYS_SHARE = 0.8
"""Share of the frames on which a pixel of a wrong background differs; one under a moving die or shadow differs on fewer."""
BRIGHTEST_PERCENTILE = 99.9
"""Of the grey levels, for their brightest: single hot pixels do not count."""
MAX_CORRELATION = 0.97
"""Of neighbouring frames; beyond it the residuals are a drift, and the interval says little."""
MAX_RESIDUAL = 5.0
"""Median residuals at which a residual is cut off: a few wrong poses must not decide the correlation."""
SHORT_S = 1e-6
"""Step of the finite difference for the speed of a corner in the picture."""


@dataclass(frozen=True, eq=False)
class FrameTiming:
    """The times of the frames."""

    frames: int
    rate_hz: float
    """Frame rate by the times in use."""
    file_rate_hz: float | None
    """Recording rate that the file declares; None where it does not."""
    playback_hz: float | None
    file_exposure_s: float | None
    uneven_share: float
    """Largest deviation of a step between frames from the median step, as a share of it."""
    notices: tuple[str, ...]
    """Notices of the reader; repeated frames are among them if they were read."""
    found: FrameTimes | None = None
    """Missing and repeated frames that the motion shows; None where no die was tracked."""


@dataclass(frozen=True)
class BackgroundMatch:
    """How well the background matches the clip."""

    estimated: bool
    """Whether it was estimated from the clip, because no picture of the empty scene was given."""
    noise_grey: float
    offset_grey: float
    """Median difference between a frame and the background, on the worst frame."""
    differing_share: float
    """Share of the pixels that differ on nearly every frame on which the die is elsewhere."""
    brightest_share: float
    """Brightest grey level of the sampled frames (BRIGHTEST_PERCENTILE), as a share of full scale."""


@dataclass(frozen=True, eq=False)
class TrackedPart:
    """The die on the tracked part of a clip."""

    track: Track
    throw: Throw | None
    diameter_px: tuple[float, float]
    """Smallest and largest size of the die: diameter of a disc with the area of its outline."""
    motion_blur_px: tuple[float, float] | None
    """Median and 95th percentile over the frames, of the largest shift of a corner within the exposure; None without one."""
    shift_px: float
    """95th percentile over the frames, of the largest shift of a corner to the next frame."""
    lens_blur_px: float
    """Standard deviation of the spread of an edge, without motion blur."""
    saturated_share: float
    """Share of the pixels of the die's box that are at full scale, on the worst frame."""
    fall: Fall | None
    """Acceleration in flight, its covariance widened for the correlation of neighbouring frames."""
    contact_height_m: Array
    """(k,) heights of the contacts at resolved bounces."""
    contact_sigma_m: Array
    """(k,) their standard errors."""
    corners: CornerRadius | None = None
    """The estimated radius of the corners; None where the scene gives it, or the corners look sharp."""
    readout: Readout | None = None
    """The readout of a rolling shutter, estimated from the shear of the die; None where too few frames show it."""
    second_die: SecondDie | None = None
    """A second die in view; None where too few frames show one."""


@dataclass(frozen=True, eq=False)
class ClipQuality:
    """The quality of one camera's clip."""

    timing: FrameTiming
    background_match: BackgroundMatch
    tracked_part: TrackedPart | None
    """None where no die could be tracked."""
    failure: str
    """The reason why no die could be tracked; empty where one was."""


def measure_clip_quality(
    clip: Clip,
    camera: Camera,
    die: Die,
    open_part: Callable[[int, int], Clip],
    *,
    background: Image | None = None,
    facts: ClipFacts = NO_FACTS,
    clock: ClipClock = ITS_OWN,
) -> ClipQuality:
    """Measure the quality of a clip. `open_part` opens the frames from first to stop (numbers in the file) of the same clip.

    `background` (height, width) is a frame without the die; `clock` says whether missing and repeated frames are corrected.
    Raises ValueError where the clip cannot be read.
    """
    estimated = background is None
    empty = estimate_background(clip) if background is None else background
    rows = np.unique(np.linspace(0, len(clip) - 1, min(SAMPLED_FRAMES, len(clip))).astype(int))
    sample = [_grey(clip.frame(int(k))) for k in rows]
    noise = pixel_noise(sample, empty, facts.level_grey)
    background_match = _background_match(sample, empty, estimated, clip.bit_depth, facts.level_grey)
    tracked_part, times, failure, notices = None, None, "", clip.notices
    view = make_view(
        camera, die, empty, noise, facts.exposure_s, START_BLUR_PX, readout_s=facts.readout_s,
        gravity_m_s2=facts.gravity_m_s2,
    )  # fmt: skip
    first = _first_frame_with_die(clip, view, facts.start)
    if first is None:
        failure = "no frame that was searched shows the whole of anything that could be a die"
    else:
        stop = min(first + PART_FRAMES, len(clip))
        part = open_part(clip.first_frame + first, clip.first_frame + stop)
        try:
            timed = track_clip_in_time([part], [camera], die, background=empty, facts=facts, quality=FAST, clock=clock)
            followed, times = timed.tracked, timed.times
            still = PixelNoise(noise.noise_grey, level_grey=noise.level_grey)

            def view_with(readout_s: float, blur_px: float = START_BLUR_PX) -> View:
                return make_view(
                    camera, followed.die, empty, still, facts.exposure_s, blur_px, readout_s=readout_s,
                    gravity_m_s2=facts.gravity_m_s2,
                )  # fmt: skip

            tracked_part = _tracked_part(part, followed.track, view_with(facts.readout_s), followed.corners)
            tracked_part = _with_readout(part, tracked_part, view_with, facts.readout_s)
            if tracked_part is not None:
                other = find_second_die(part, followed.track, camera, followed.die, empty, facts.level_grey)
                tracked_part = replace(tracked_part, second_die=other)
        except NoDieError as error:
            failure = str(error)
        notices = (*notices, *(notice for notice in part.notices if notice not in notices))
    return ClipQuality(frame_timing(clip, notices, times), background_match, tracked_part, failure)


def _grey(frame: Frame) -> Image:
    return np.ascontiguousarray(frame, np.float32)


def frame_timing(clip: Clip, notices: tuple[str, ...], found: FrameTimes | None = None) -> FrameTiming:
    """The times of a clip's frames, the rates that its file declares, and what was found in the motion."""
    declared = clip.metadata()
    steps = np.diff(clip.times_s)
    usual = float(np.median(steps)) if len(steps) else np.nan
    uneven = float(np.abs(steps / usual - 1.0).max()) if len(steps) else 0.0
    return FrameTiming(
        len(clip),
        1.0 / usual,
        declared.get("record_rate_hz"),
        declared.get("playback_fps"),
        declared.get("exposure_s"),
        uneven,
        notices,
        found,
    )


def _background_match(
    sample: list[Image], background: Image, estimated: bool, bit_depth: int, level_grey: float
) -> BackgroundMatch:
    offsets = [float(np.median(image - background)) for image in sample]
    # Another level of light than the background's is not noise.
    still = [image - off for image, off in zip(sample, offsets, strict=True)]
    noise = background_noise(still, background, level_grey if level_grey != 1.0 else level_step(sample))
    brightest = max(float(np.percentile(image[::2, ::2], BRIGHTEST_PERCENTILE)) for image in sample)
    worst = max(offsets, key=abs)
    differing = _always_differing_share(sample, background, noise, level_grey)
    return BackgroundMatch(estimated, noise / level_grey, worst / level_grey, differing, brightest / (2**bit_depth - 1))


def _always_differing_share(sample: list[Image], background: Image, noise: float, level_grey: float) -> float:
    """Share of the pixels that differ from the background on nearly every frame on which the die is elsewhere.

    The die is taken to be the largest region that differs. Pixels that are only darker do not count: a slow shadow stays long in
    a small picture.
    """
    counted, differed = np.zeros(background.shape, int), np.zeros(background.shape, int)
    for image in sample:
        mask = differs_from_background(image, background, noise, level_grey)
        elsewhere = np.ones(mask.shape, bool)
        blob = largest_blob(mask)
        if blob is not None:
            x0, y0, x1, y1 = blob.box
            elsewhere[y0:y1, x0:x1] = False
        counted += elsewhere
        differed += without_shadow(image, background, noise, mask) & elsewhere
    known = counted >= max(len(sample) // 4, 1)
    if not known.any():
        return 1.0  # the region that differs fills the picture on every frame
    return float((differed[known] >= ALWAYS_SHARE * counted[known]).mean())


def _first_frame_with_die(clip: Clip, view: View, start: ManualInitialisation | None) -> int | None:
    """First row of the part to track: a little before the first searched frame with the whole die; None without one."""
    if start is not None:
        return max(start.frame - clip.first_frame - PART_FRAMES // 2, 0)
    step = max(1, len(clip) // SEARCHED_FRAMES)
    shown = next((k for k in range(0, len(clip), step) if die_blobs(view, _grey(clip.frame(k)))), None)
    return None if shown is None else max(shown - step - LEAD_FRAMES, 0)


def _tracked_part(clip: Clip, track: Track, view: View, corners: CornerRadius | None) -> TrackedPart | None:
    rows = np.flatnonzero(track.tracked)
    throw: Throw | None = None
    with suppress(NoFlightError):  # a few poses are enough for the size of the die and the blur
        throw = measure_throw(track, view.die)
    poses = [(track.position_m[k], matrix_from_quat(track.quaternion[k])) for k in rows]
    diameter = np.array([_diameter_px(view, *pose) for pose in poses])
    shifts = np.array([_shift_px(view, throw.at(float(track.time_s[k])), 1.0) for k in rows]) if throw else np.zeros(1)
    step_s = float(np.median(np.diff(track.time_s)))
    blur = shifts * view.exposure_s
    heights, sigmas = contact_heights(throw, view.die) if throw else (np.empty(0), np.empty(0))
    return TrackedPart(
        track,
        throw,
        (float(diameter.min()), float(diameter.max())),
        (float(np.median(blur)), float(np.percentile(blur, 95))) if view.exposure_s and throw else None,
        float(np.percentile(shifts, 95)) * step_s,
        _lens_blur_px(clip, view, track, throw),
        _saturated_share(clip, view, track),
        fall_of_correlated_frames(track, throw) if throw else None,
        heights,
        sigmas,
        corners,
    )


def _with_readout(
    clip: Clip, part: TrackedPart | None, view_with: Callable[[float, float], View], readout_s: float
) -> TrackedPart | None:
    """The tracked part with the readout that it shows."""
    if part is None or part.throw is None:
        return part
    blur_px = part.lens_blur_px
    found = estimate_readout(
        clip, part.track, part.throw, view_with(readout_s, blur_px), lambda trial_s: view_with(trial_s, blur_px)
    )
    return replace(part, readout=found)


def _diameter_px(view: View, position: Array, rotation: Array) -> float:
    """Diameter [px] of a disc with the area of the die's outline, the convex hull of its projected corners."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position).astype(np.float32)
    return float(np.sqrt(4.0 / np.pi * cv2.contourArea(cv2.convexHull(px))))


def _shift_px(view: View, state: State, time_s: float) -> float:
    """Distance [px] that the fastest corner moves in the picture in `time_s`, at its present velocity."""
    flight = flight_from(view, state)
    now, then = (
        view.camera.project(view.die.solid.vertices @ each.rotation.T + each.position_m)
        for each in (state, flight.at(state.time_s + SHORT_S))
    )
    return float(np.linalg.norm(then - now, axis=1).max()) * time_s / SHORT_S


def _spread_rows(track: Track, count: int) -> list[int]:
    rows = np.flatnonzero(track.tracked)
    return [int(k) for k in rows[np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))]]


def _lens_blur_px(clip: Clip, view: View, track: Track, throw: Throw | None) -> float:
    """Standard deviation [px] of the spread of an edge, without motion blur, that leaves the least noise.

    It is the minimum of a parabola through the best of BLURS_PX and its neighbours.
    """
    noise = []
    for k in _spread_rows(track, BLUR_FRAMES):
        image, state = _grey(clip.frame(k)), throw.at(float(track.time_s[k])) if throw else None
        velocity, omega = (state.velocity_m_s, state.omega_rad_s) if state is not None else (None, None)
        start = pose_state(track.position_m[k], matrix_from_quat(track.quaternion[k]), velocity, omega)
        trials = [refine_pose(replace(view, blur_px=blur), image, start, coarse=0) for blur in BLURS_PX]
        noise.append([trial.log_noise for trial in trials])
    level = np.median(np.array(noise) - np.min(noise, axis=1, keepdims=True), axis=0)
    best = int(np.clip(np.argmin(level), 1, len(BLURS_PX) - 2))
    x, y = np.array(BLURS_PX[best - 1 : best + 2]), level[best - 1 : best + 2]
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-b / (2.0 * a), x[0], x[2])) if a > 0 else float(BLURS_PX[int(np.argmin(level))])


def _saturated_share(clip: Clip, view: View, track: Track) -> float:
    """Share of the pixels at full scale in the die's box, on the worst of a few frames."""
    full, worst = 2**clip.bit_depth - 1, 0.0
    for k in _spread_rows(track, 2 * BLUR_FRAMES):
        box = outline_box(view, track.position_m[k], matrix_from_quat(track.quaternion[k]), 0.0)
        if box is not None:
            x0, y0, x1, y1 = box
            worst = max(worst, float((clip.frame(k)[y0:y1, x0:x1] >= full).mean()))
    return worst


def fall_of_correlated_frames(track: Track, throw: Throw) -> Fall | None:
    """The acceleration in flight, its covariance widened for correlated errors of neighbouring frames; None as `measure_fall`."""
    fall = measure_fall(track, throw)
    if fall is None:
        return None
    rows = np.flatnonzero(track.tracked)
    drawn, _ = throw.poses(track.time_s[rows])
    residuals = track.position_m[rows] - drawn
    same = (np.diff(rows) == 1) & (np.diff(throw.flights_at(track.time_s[rows])) == 0)
    scale = np.maximum(np.median(np.abs(residuals), axis=0), 1e-9)
    bounded = np.clip(residuals / scale, -MAX_RESIDUAL, MAX_RESIDUAL)
    correlation = (bounded[1:] * bounded[:-1])[same].mean(0) / (bounded**2).mean(0) if same.any() else np.zeros(3)
    r = float(np.clip(correlation.max(), 0.0, MAX_CORRELATION))
    return replace(fall, covariance=fall.covariance * (1.0 + r) / (1.0 - r))


def contact_heights(throw: Throw, die: Die) -> tuple[Array, Array]:
    """Heights [m] of the lowest point at each resolved bounce, with their standard errors; 0 at the calibrated table."""
    inner = inner_vertices(die.solid, die.corner_radius_m)
    heights, sigmas = [], []
    for k, impact in enumerate(throw.impacts):
        before = throw.flights[k]
        if impact.contact == "unresolved" or before.covariance is None:
            continue
        state = before.at(impact.time_s)
        corners = inner @ state.rotation.T
        low = int(np.argmin(corners[:, 2]))
        x, y, z = corners[low]
        row = np.zeros(12)
        row[2], row[3:6] = 1.0, (y, -x, 0.0)  # ẑ · (δθ × r)
        covariance = (
            transition_matrix(before, impact.time_s) @ before.covariance @ transition_matrix(before, impact.time_s).T
        )
        speed = impact.normal_velocity_before_m_s * impact.sigma_time_s
        heights.append(float(state.position_m[2] + z - die.corner_radius_m))
        sigmas.append(float(np.sqrt(max(float(row @ covariance @ row), 0.0) + speed**2)))
    return np.array(heights), np.array(sigmas)
