"""What a clip offers to a tracker, measured on as few frames as tell it: the numbers behind `diethrow check`.

A dozen frames over the clip show the background, its noise and where the die is in view. From there on a piece of at most
PIECE_FRAMES frames is tracked; everything else is read off its poses and their pixels:

- blur by motion: how far the drawn corners move within the exposure; by the lens: the width of edge that leaves the least
  noise on a few of the frames, each refined anew for every trial;
- the fall: the acceleration with nothing assumed of it (`gravity`), with an interval widened by the correlation of
  neighbouring frames, whose errors (shading, marks, depth) go together: a first-order autoregression of correlation r leaves
  a sum of n terms (1 + r) / (1 - r) times the variance of independent ones;
- the table: how high the contact lies at every bounce that was resolved.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat
from ...model.throw import Flight, State, Throw
from ..camera import Camera
from ..clip_parameters import CornerRadius, CornerRounding
from ..footage import Clip, Frame, estimate_background
from ..picture import (
    View,
    background_noise,
    differing,
    largest_blob,
    level_step,
    make_view,
    noise_and_rounding,
    outline_box,
    without_shadow,
)
from ..pose import ManualInitialisation, die_blobs, refine_pose
from ..quality import FAST
from ..sequence import NoDieError, track_clip
from ..throw import NoFlightError, measure_throw, transition_matrix
from ..track import Track
from .gravity import Fall, measure_fall

Array = NDArray[np.float64]
Image = NDArray[np.float32]

PIECE_FRAMES = 180
"""Frames tracked at the most: 0.12 s at 1500 frames/s, in which a die falls 7 cm from rest and usually bounces."""
LEAD_FRAMES = 4
"""Frames tracked before the first one found with the die wholly in view."""
SAMPLED = 12
"""Frames over the clip that show background and noise."""
LOOKS = 48
"""Frames over the clip on which the die is looked for."""
BLURS_PX = (0.3, 0.45, 0.6, 0.8, 1.05, 1.4, 1.9, 2.6)
"""Widths of edge that are tried; each is a third more than the one before."""
BLUR_FRAMES = 6
NEARLY_EVERY = 0.8
"""Share of the frames on which a pixel of a foreign background differs; a moving die or shadow does on fewer."""
STRONGEST_CORRELATION = 0.97
"""Of neighbouring frames; beyond it the residuals are a drift and no noise, and the interval means little."""


@dataclass(frozen=True, eq=False)
class Timing:
    """What is known of the frames' times."""

    frames: int
    rate_hz: float
    """Frames a second of the times in use."""
    file_rate_hz: float | None
    """The recording rate that the file carries."""
    playback_hz: float | None
    file_exposure_s: float | None
    uneven_share: float
    """Largest deviation of a step between frames from the usual one, as a share of it."""
    notices: tuple[str, ...]
    """What the reader has to say, repeated frames among those that were read included."""


@dataclass(frozen=True)
class Backdrop:
    """How well the background fits the clip."""

    estimated: bool
    """From the clip, since no picture of the empty scene was given."""
    noise_grey: float
    offset_grey: float
    """Median difference between the frames and the background, at its worst."""
    differing_share: float
    """Share of the pixels that differ on nearly every frame that does not show the die there."""
    brightest_share: float
    """Brightest grey level of the sampled frames (99.9th percentile), as a share of full scale."""


@dataclass(frozen=True, eq=False)
class Sight:
    """The die as it is seen on the tracked piece."""

    track: Track
    throw: Throw | None
    across_px: tuple[float, float]
    """Smallest and largest width of the die: diameter of a disc of its outline's area."""
    motion_blur_px: tuple[float, float] | None
    """Median and 95th percentile over the frames of the largest shift of a corner within the exposure; None without one."""
    shift_px: float
    """95th percentile of the largest shift of a corner from one frame to the next."""
    lens_blur_px: float
    saturated_share: float
    """Share of the die's pixels at full scale, on the worst frame."""
    fall: Fall | None
    """Acceleration in flight, the interval widened by the correlation of neighbouring frames."""
    contact_m: Array
    """(k,) heights of the contacts at resolved bounces."""
    contact_sigma_m: Array
    """(k,)"""
    corners: CornerRadius | None = None
    """How rounded the die looks; None where the scene says it, or the corners look sharp."""


@dataclass(frozen=True, eq=False)
class Preflight:
    """Everything that was measured."""

    timing: Timing
    backdrop: Backdrop
    sight: Sight | None
    """None where no die could be followed."""
    trouble: str
    """Why there is none."""


def preflight(
    clip: Clip,
    camera: Camera,
    die: Die,
    open_part: Callable[[int, int], Clip],
    *,
    background: Image | None = None,
    exposure_s: float | None = None,
    start: ManualInitialisation | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    rounding: CornerRounding = CornerRounding.GIVEN,
) -> Preflight:
    """Measure what the clip offers. `open_part` opens frames first to stop (numbers in the file) of the same clip.

    `background` (height, width) is a frame without the die; `exposure_s`, `start`, `excluded` and `rounding` as for
    `track_clip`.
    Raises ValueError where the clip cannot be read.
    """
    estimated = background is None
    empty = estimate_background(clip) if background is None else background
    rows = np.unique(np.linspace(0, len(clip) - 1, min(SAMPLED, len(clip))).astype(int))
    sample = [_grey(clip.frame(int(k))) for k in rows]
    noise, step = noise_and_rounding(sample, empty)
    backdrop = _backdrop(sample, empty, estimated, clip.bit_depth)
    sight, trouble, notices = None, "", clip.notices
    first = _first_sight(clip, make_view(camera, die, empty, noise, exposure_s, 0.7, rounding_grey=step), start)
    if first is None:
        trouble = "nothing that could be a die is wholly in view on any of the frames that were looked at"
    else:
        stop = min(first + PIECE_FRAMES, len(clip))
        part = open_part(clip.first_frame + first, clip.first_frame + stop)
        try:
            seen = track_clip(
                part, camera, die, background=empty, exposure_s=exposure_s, start=start, excluded=excluded,
                rounding=rounding, quality=FAST,
            )  # fmt: skip
            view = make_view(camera, seen.die, empty, noise, exposure_s, 0.7)
            sight = _sight(part, seen.track, view, seen.corners)
        except NoDieError as error:
            trouble = str(error)
        notices = (*notices, *(told for told in part.notices if told not in notices))
    return Preflight(timing_of(clip, notices), backdrop, sight, trouble)


def _grey(frame: Frame) -> Image:
    return np.ascontiguousarray(frame, np.float32)


def timing_of(clip: Clip, notices: tuple[str, ...]) -> Timing:
    """What a clip says of the times of its frames."""
    said = clip.metadata()
    steps = np.diff(clip.times_s)
    usual = float(np.median(steps)) if len(steps) else np.nan
    uneven = float(np.abs(steps / usual - 1.0).max()) if len(steps) else 0.0
    return Timing(
        len(clip),
        1.0 / usual,
        said.get("record_rate_hz"),
        said.get("playback_fps"),
        said.get("exposure_s"),
        uneven,
        notices,
    )


def _backdrop(sample: list[Image], background: Image, estimated: bool, bit_depth: int) -> Backdrop:
    offsets = [float(np.median(image - background)) for image in sample]
    # Other light than the background's is no noise: a tracker takes it for some, and sees less.
    still = [image - off for image, off in zip(sample, offsets, strict=True)]
    noise = background_noise(still, background, level_step(sample))
    brightest = max(float(np.percentile(image[::2, ::2], 99.9)) for image in sample)
    worst = max(offsets, key=abs)
    return Backdrop(estimated, noise, worst, _always_off(sample, background, noise), brightest / (2**bit_depth - 1))


def _always_off(sample: list[Image], background: Image, noise: float) -> float:
    """Share of the pixels that differ from the background on nearly every frame on which the largest region that differs,
    the die, lies elsewhere; what is only darker does not count, since a slow shadow stays long in a small picture."""
    looked, off = np.zeros(background.shape, int), np.zeros(background.shape, int)
    for image in sample:
        mask = differing(image, background, noise)
        elsewhere = np.ones(mask.shape, bool)
        blob = largest_blob(mask)
        if blob is not None:
            x0, y0, x1, y1 = blob.box
            elsewhere[y0:y1, x0:x1] = False
        looked += elsewhere
        off += without_shadow(image, background, noise, mask) & elsewhere
    known = looked >= max(len(sample) // 4, 1)
    if not known.any():
        return 1.0  # what differs fills the picture on every frame
    return float((off[known] >= NEARLY_EVERY * looked[known]).mean())


def _first_sight(clip: Clip, view: View, start: ManualInitialisation | None) -> int | None:
    """Row of the clip at which the piece to track begins: a little before the die is first wholly in view."""
    if start is not None:
        return max(start.frame - clip.first_frame - PIECE_FRAMES // 2, 0)
    step = max(1, len(clip) // LOOKS)
    seen = next((k for k in range(0, len(clip), step) if die_blobs(view, _grey(clip.frame(k)))), None)
    return None if seen is None else max(seen - step - LEAD_FRAMES, 0)


def _sight(clip: Clip, track: Track, view: View, corners: CornerRadius | None) -> Sight | None:
    rows = np.flatnonzero(track.tracked)
    throw: Throw | None = None
    with suppress(NoFlightError):  # a few poses still tell the size of the die and the blur
        throw = measure_throw(track, view.die)
    poses = [(track.position_m[k], matrix_from_quat(track.quaternion[k])) for k in rows]
    across = np.array([_across_px(view, *pose) for pose in poses])
    shifts = np.array([_shift_px(view, throw.at(float(track.time_s[k])), 1.0) for k in rows]) if throw else np.zeros(1)
    step_s = float(np.median(np.diff(track.time_s)))
    blur = shifts * view.exposure_s
    heights, sigmas = contacts_of(throw, view.die) if throw else (np.empty(0), np.empty(0))
    return Sight(
        track,
        throw,
        (float(across.min()), float(across.max())),
        (float(np.median(blur)), float(np.percentile(blur, 95))) if view.exposure_s and throw else None,
        float(np.percentile(shifts, 95)) * step_s,
        _lens_blur_px(clip, view, track, throw),
        _saturated_share(clip, view, track),
        fall_of(track, throw) if throw else None,
        heights,
        sigmas,
        corners,
    )


def _across_px(view: View, position: Array, rotation: Array) -> float:
    """Diameter [px] of a disc as large as the die's outline, by the convex hull's area (shoelace)."""
    px = view.camera.project(view.die.solid.vertices @ rotation.T + position).astype(np.float32)
    return float(np.sqrt(4.0 / np.pi * cv2.contourArea(cv2.convexHull(px))))


def _shift_px(view: View, state: State, time_s: float) -> float:
    """How far [px] the fastest corner would move in `time_s` at its present velocity on the picture."""
    short = 1e-6
    flight = Flight(state, np.inf)
    now, then = (
        view.camera.project(view.die.solid.vertices @ each.rotation.T + each.position_m)
        for each in (state, flight.at(state.time_s + short))
    )
    return float(np.linalg.norm(then - now, axis=1).max()) * time_s / short


def _spread_rows(track: Track, count: int) -> list[int]:
    rows = np.flatnonzero(track.tracked)
    return [int(k) for k in rows[np.unique(np.linspace(0, len(rows) - 1, min(count, len(rows))).astype(int))]]


def _lens_blur_px(clip: Clip, view: View, track: Track, throw: Throw | None) -> float:
    """Standard deviation [px] of the edge's spread that leaves least noise, motion blur apart: the minimum of a parabola
    through the best of BLURS_PX and its neighbours."""
    noise = []
    for k in _spread_rows(track, BLUR_FRAMES):
        image, state = _grey(clip.frame(k)), throw.at(float(track.time_s[k])) if throw else None
        velocity, omega = (state.velocity_m_s, state.omega_rad_s) if state is not None else (None, None)
        rotation = matrix_from_quat(track.quaternion[k])
        trials = [
            refine_pose(
                replace(view, blur_px=blur), image, track.position_m[k], rotation,
                velocity_m_s=velocity, omega_rad_s=omega, coarse=0,
            )
            for blur in BLURS_PX
        ]  # fmt: skip
        noise.append([trial.log_noise for trial in trials])
    level = np.median(np.array(noise) - np.min(noise, axis=1, keepdims=True), axis=0)
    best = int(np.clip(np.argmin(level), 1, len(BLURS_PX) - 2))
    x, y = np.array(BLURS_PX[best - 1 : best + 2]), level[best - 1 : best + 2]
    a, b, _ = np.polyfit(x, y, 2)
    return float(np.clip(-b / (2.0 * a), x[0], x[2])) if a > 0 else float(BLURS_PX[int(np.argmin(level))])


def _saturated_share(clip: Clip, view: View, track: Track) -> float:
    """Share of pixels at full scale within the die's box, on the worst of a few frames."""
    full, worst = 2**clip.bit_depth - 1, 0.0
    for k in _spread_rows(track, 2 * BLUR_FRAMES):
        box = outline_box(view, track.position_m[k], matrix_from_quat(track.quaternion[k]), 0.0)
        if box is not None:
            x0, y0, x1, y1 = box
            worst = max(worst, float((clip.frame(k)[y0:y1, x0:x1] >= full).mean()))
    return worst


def fall_of(track: Track, throw: Throw) -> Fall | None:
    """The acceleration in flight, with an interval that knows that neighbours err alike."""
    fall = measure_fall(track, throw)
    if fall is None:
        return None
    rows = np.flatnonzero(track.tracked)
    drawn, _ = throw.poses(track.time_s[rows])
    left = track.position_m[rows] - drawn
    same = (np.diff(rows) == 1) & (np.diff(throw.flights_at(track.time_s[rows])) == 0)
    scale = np.maximum(np.median(np.abs(left), axis=0), 1e-9)
    # Bounded: a few wild frames must not decide the correlation.
    bounded = np.clip(left / scale, -5.0, 5.0)
    correlation = (bounded[1:] * bounded[:-1])[same].mean(0) / (bounded**2).mean(0) if same.any() else np.zeros(3)
    r = float(np.clip(correlation.max(), 0.0, STRONGEST_CORRELATION))
    return replace(fall, covariance=fall.covariance * (1.0 + r) / (1.0 - r))


def contacts_of(throw: Throw, die: Die) -> tuple[Array, Array]:
    """Heights [m] of the lowest point at each resolved bounce, with their standard errors: 0 on a table that is where it is
    said to be."""
    shrink = 1.0 - die.corner_radius_m / die.solid.inradius
    heights, sigmas = [], []
    for k, impact in enumerate(throw.impacts):
        before = throw.flights[k]
        if impact.contact == "unresolved" or before.covariance is None:
            continue
        state = before.at(impact.time_s)
        corners = shrink * die.solid.vertices @ state.rotation.T
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
