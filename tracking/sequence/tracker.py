"""From a clip to a track: the die found, followed through its bounces, and every frame's pose refined.

First pass (`chase`): from the first frame on which the die is wholly seen, forwards to the end and backwards to where it
came in. Then the bounces are found, each flight is fitted, and the lens blur is estimated, of a rounded die the light as well.
Second pass (`second_pass`): every frame is refined on its edges, along its flight. Third pass (`third_pass`): once more on what
is printed on the faces. The poses are those of single frames: nothing is smoothed here (`smooth`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.rotations import matrix_from_quat
from ...model.throw import Throw
from ..camera import Camera
from ..clip_parameters import (
    BLUR_FRAMES,
    RADIUS_FRAMES,
    ClockOffsets,
    CornerRadius,
    CornerRounding,
    contour_sigma_px,
    estimate_clock_offsets,
    estimate_lens_blur,
    is_rounded,
    radius_by_free_poses,
    radius_on_flights,
    sample_in_flight,
    with_light,
)
from ..footage import Clip, FrameSource, estimate_background
from ..picture import View, make_view, noise_and_rounding, share_in_view, with_corner_radius, with_reflections
from ..pose import ClipPoses, ManualInitialisation, as_track, excluded_rows, wholly_in_view
from ..quality import STANDARD, Quality
from ..surface_marks import SurfaceMarks
from ..throw import NoFlightError, decimation_factor, measure, measure_throw, with_calibrated_covariance
from ..track import ABSENT, LOST, Track
from .depth_reversal import correct_depth_reversals
from .initialisation import find_initial_pose, initial_pose_by_hand
from .labelling import with_consistent_labels
from .refine_on_edges import EdgeRefinement
from .refine_on_marks import MarkRefinement, third_pass

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Progress = Callable[[int, int], None]

FIRST_BLUR_PX = 0.7
"""Lens blur until it is estimated."""
ROUNDINGS, SAME_RADIUS, LESS = 3, 0.1, 0.9
"""Most first passes with a radius of the corners that is being found, the change, as a share, that needs no other, and the
factor on a radius whose flights do not bear it out: a bounce is lost or not by a little, and rather with too large a one."""
KEPT = 0.95
"""Share of the frames over which the die was followed with another radius, or none, without which a radius is a wrong one."""
ROUND_SHARE = 0.25
"""Radius of the corners, as a share of the inscribed radius, of a die that may be rounded and is not found as a sharp one."""


class NoDieError(ValueError):
    """No die was found in the clip."""


@dataclass(frozen=True, eq=False)
class TrackedClip:
    """What following a die through a clip gives."""

    track: Track
    marks: SurfaceMarks | None
    """What the die's faces show; None where that was not asked for, or they show nothing that places them."""
    offsets: ClockOffsets
    """Of the cameras' clocks; looked for with a second pass alone."""
    die: Die
    """With the radius of its corners as it was found, where that was looked for."""
    corners: CornerRadius | None
    """That radius with its standard error; None where it was given, or the corners look sharp."""


def follow(
    clip: Clip | Sequence[Clip],
    camera: Camera | Sequence[Camera],
    die: Die,
    *,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32] | None] | None = None,
    exposure_s: float | None = None,
    mirror: bool = False,
    start: ManualInitialisation | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    quality: Quality = STANDARD,
    progress: Progress | None = None,
) -> Track:
    """Track a die through a clip: a pose with covariance for every frame on which it can be known. As `track_clip`."""
    return track_clip(
        clip, camera, die, background=background, exposure_s=exposure_s, mirror=mirror, start=start, excluded=excluded,
        quality=quality, progress=progress,
    ).track  # fmt: skip


def track_clip(
    clip: Clip | Sequence[Clip],
    camera: Camera | Sequence[Camera],
    die: Die,
    *,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32] | None] | None = None,
    exposure_s: float | None = None,
    mirror: bool = False,
    start: ManualInitialisation | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    rounding: CornerRounding = CornerRounding.GIVEN,
    quality: Quality = STANDARD,
    progress: Progress | None = None,
) -> TrackedClip:
    """Follow a die through a clip, and learn what its faces show where the quality asks for it.

    `clip` and `camera` are one each, or as many synchronised ones as there are cameras. `background` (height, width) is a
    frame without the die (one a camera), estimated from the clip where it is None. `mirror` says that the table reflects
    the die. `start` is a first pose by hand. `excluded` are ranges (first, stop) of frame numbers whose pictures are not
    used: they are lost. `rounding` says whether the radius of the die's corners is given. `progress` is called with frames
    done and frames to do. Raises ValueError where camera, background and clip differ in size, and NoDieError where no die was
    found.
    """
    clips = list(clip) if isinstance(clip, Sequence) else [clip]
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    source = FrameSource(clips)
    view = _view_of(clips, cameras, die, background, exposure_s, mirror, quality)
    report = _Reporter(progress, (1 + quality.second_pass + quality.marks) * len(source))
    unused = np.zeros(len(source), bool)
    unused[list(excluded_rows(excluded, source.first_frame, len(source)))] = True
    view, seen, corners = _first_pass_rounded(view, source, report, start, unused, rounding)
    throw = _measured(view, source, seen)
    if throw is not None and any(impact.contact == "unresolved" for impact in throw.impacts):
        seen = with_consistent_labels(view, seen, throw, source.times_s)
        throw = _measured(view, source, seen)
    offsets = ClockOffsets.none(len(clips))
    marked = MarkRefinement(seen, None, None)
    if quality.second_pass:
        view = with_light(with_reflections(view), source.frame, seen)
        view = replace(view, blur_px=estimate_lens_blur(view, seen.sample(source.frame, seen.known, BLUR_FRAMES)))
        report.at_least(len(source))
        if throw is not None:
            offsets = estimate_clock_offsets(view, source.frame, source.times_s, throw)
        second = EdgeRefinement(view, source, seen.interpolated(), throw, ~unused, offsets)
        every = _every_in_second_pass(view, source, seen) if quality.marks and throw is not None else 1
        seen = second.see(np.arange(len(source)) % every == 0, lambda done: report.at_least(len(source) + done))
        marked = MarkRefinement(seen, None, None)
        if quality.marks:
            marked = third_pass(second, seen, every, lambda done: report.at_least(2 * len(source) + done))
            report.at_least(3 * len(source))
    track = replace(_track(source, view, marked.seen, throw), shared=marked.shared)
    if corners is not None:
        corners, sigma_px = _corners_in_flight(view, source, track, corners)
        view, track = with_corner_radius(view, corners.radius_m), replace(track, contour_sigma_px=sigma_px)
    sure = with_calibrated_covariance(track, view.die, view.camera, every=decimation_factor(track, view.die))
    return TrackedClip(sure, marked.marks, offsets, view.die, corners)


def _view_of(
    clips: list[Clip],
    cameras: list[Camera],
    die: Die,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32] | None] | None,
    exposure_s: float | None,
    mirror: bool,
    quality: Quality,
) -> View:
    """The scene as the refinement wants it, with the noise of the still background."""
    given = [background] if background is None or isinstance(background, np.ndarray) else list(background)
    given += [None] * (len(clips) - len(given))
    pictures, noises, roundings = [], [], []
    for one, camera, picture in zip(clips, cameras, given, strict=True):
        _check_sizes(one, camera, picture)
        picture = np.asarray(estimate_background(one) if picture is None else picture, np.float32)
        chosen = np.unique(np.linspace(0, len(one) - 1, 12).astype(int))
        noise, rounding = noise_and_rounding([np.asarray(one.frame(int(k)), np.float32) for k in chosen], picture)
        noises.append(noise)
        roundings.append(rounding)
        pictures.append(picture)
    return make_view(
        cameras, die, pictures, max(noises), exposure_s, FIRST_BLUR_PX, rounding_grey=max(roundings), mirror=mirror,
        quality=quality,
    )  # fmt: skip


def _check_sizes(clip: Clip, camera: Camera, background: NDArray[np.float32] | None) -> None:
    if (clip.width_px, clip.height_px) != (camera.width_px, camera.height_px):
        raise ValueError(
            f"the clip is {clip.width_px} × {clip.height_px} pixels and the camera "
            f"{camera.width_px} × {camera.height_px}: give the camera of this clip"
        )
    if background is not None and background.shape != (clip.height_px, clip.width_px):
        raise ValueError(
            f"the background is {background.shape[1]} × {background.shape[0]} pixels and the clip "
            f"{clip.width_px} × {clip.height_px}: give a frame of this clip without the die"
        )


# --- the first pass ---------------------------------------------------------------------------------------------------


def _first_pass(
    view: View, source: FrameSource, report: _Reporter, by_hand: ManualInitialisation | None, unused: Mask
) -> tuple[View, ClipPoses]:
    """A pose for every frame that can be followed from the start, and the view with its blur estimated there."""
    beginning = (
        find_initial_pose(view, source, unused, report.at_least)
        if by_hand is None
        else initial_pose_by_hand(view, source, by_hand, unused)
    )
    if beginning is None:
        raise NoDieError(
            f"no die was found in {len(source)} frames: look at the clip, the background and the [die] shape and edge"
        )
    chase, seen = beginning
    view = replace(view, blur_px=estimate_lens_blur(view, seen.sample(source.frame, seen.known, BLUR_FRAMES)))
    chase.view = replace(chase.view, blur_px=view.blur_px)
    first_known = int(np.flatnonzero(seen.known)[0])
    back = chase.turned_back()
    chase.to_the_end(source, seen, report.at_least, all_frames=not view.quality.second_pass)
    for block in source.blocks_backwards(first_known):
        with block:
            back.over(block.frames, source.times_s, block.first, seen)
        if back.misses > 3:
            break
    # What was found to stand before the die is known from here on.
    return chase.view, correct_depth_reversals(chase.view, source, seen, unused)


def _first_pass_rounded(
    view: View,
    source: FrameSource,
    report: _Reporter,
    by_hand: ManualInitialisation | None,
    unused: Mask,
    rounding: CornerRounding,
) -> tuple[View, ClipPoses, CornerRadius | None]:
    """The first pass, done again with rounded corners where the die is to be looked at and shows them, until its flights
    show the radius that it was done with."""
    if rounding is CornerRounding.GIVEN:
        return *_first_pass(view, source, report, by_hand, unused), None
    try:
        first, seen = _first_pass(view, source, report, by_hand, unused)
    except NoDieError:
        # A die that is round all over is none with sharp corners.
        ball = with_corner_radius(view, ROUND_SHARE * view.die.solid.inradius)
        first, seen = _first_pass(ball, source, report, by_hand, unused)
        if _corners_at_sight(first, source, seen, rounding) is None:
            raise
    corners = _corners_at_sight(first, source, seen, rounding)
    if corners is None or corners.radius_m == 0.0:
        return first, seen, corners if rounding is CornerRounding.ESTIMATED else None
    radius_m, tried = corners.radius_m, []
    for _ in range(ROUNDINGS):
        # From the view as it was: where a sharp die's corners would be, something seemed to stand before it.
        try:
            one, known = _first_pass(with_corner_radius(view, radius_m), source, report, by_hand, unused)
        except NoDieError:
            break  # so round that nothing starts with it; what was followed before still is a start
        whole = wholly_in_view(one, known)
        found, _ = _corners_in_flight(one, source, as_track(one, source, known, whole & known.evenly_spaced), corners)
        borne_out, corners = found is not corners, found
        tried.append(_Trial(radius_m, one, known, borne_out, corners))
        before, radius_m = radius_m, corners.radius_m if borne_out else LESS * radius_m
        if borne_out and abs(radius_m - before) < SAME_RADIUS * before:
            break
    was_sharp = first.die.corner_radius_m == 0.0
    if rounding is CornerRounding.TESTED and was_sharp and not _better_than_sharp(tried, seen.frames):
        return first, seen, None
    if tried:
        most = max(each.seen.frames for each in tried)
        kept = [each for each in tried if each.seen.frames >= KEPT * most]
        corners = kept[-1].corners
        # Poses of a smaller radius than is told in the end lie farther away than it says.
        chosen = min(kept, key=lambda each: abs(each.radius_m - kept[-1].corners.radius_m))
        first, seen = chosen.view, chosen.seen
    return with_corner_radius(first, corners.radius_m), seen, corners


@dataclass(frozen=True, eq=False)
class _Trial:
    """A first pass with a radius of the corners, and whether its flights bear that out."""

    radius_m: float
    view: View
    seen: ClipPoses
    borne_out: bool
    corners: CornerRadius
    """What is known of the radius then."""


def _better_than_sharp(tried: list[_Trial], frames: int) -> bool:
    """Whether a rounded die was followed over as many frames as the sharp one was, or hardly fewer and its flights bear
    the radius out. A sharp die out of focus looks a little rounded, and is lost with a radius that is not its own."""
    return any(each.seen.frames >= (KEPT if each.borne_out else 1.0) * frames for each in tried)


def _corners_at_sight(
    view: View, source: FrameSource, seen: ClipPoses, rounding: CornerRounding
) -> CornerRadius | None:
    """How rounded the die of a first pass looks; None where it looks sharp, or too few frames show it."""
    looks = partial(seen.sample, source.frame, wholly_in_view(view, seen))
    if rounding is CornerRounding.TESTED and not is_rounded(view, looks):
        return None
    return radius_by_free_poses(view, looks(RADIUS_FRAMES))


def _corners_in_flight(
    view: View, source: FrameSource, track: Track, corners: CornerRadius
) -> tuple[CornerRadius, float]:
    """The same as the flights of a track show it, and the contour error [px] that their sigmas are to know of then; what it
    was, and none, where the flights do not show it any better.

    The flights are free to correct their distance. That leaves more ways to join them, and where they come out wrong for it
    the pictures deny them, or they deny the radius: then the poses do better without that freedom.
    """
    p, R = track.position_m[track.tracked], matrix_from_quat(track.quaternion[track.tracked])
    if not len(p):
        return corners, 0.0
    try:
        found = measure(
            replace(track, contour_sigma_px=contour_sigma_px(view, corners.sigma_m, p, R)), view.die, view.camera
        )
    except NoFlightError:
        return corners, 0.0
    looks = sample_in_flight(view, source.frame, track, found.throw)
    again = radius_on_flights(view, looks, corners.radius_m, found.chain.contour_sigma_px)
    if again is None or again.sigma_m > corners.sigma_m or again.radius_m == 0.0:
        return corners, 0.0
    return again, contour_sigma_px(view, again.sigma_m, p, R)


# --- between the passes --------------------------------------------------------------------------------------------------


def _measured(view: View, source: FrameSource, seen: ClipPoses) -> Throw | None:
    """Flights of the first pass, from the frames that show the die whole; None where they are too few to measure any."""
    track = as_track(view, source, seen, wholly_in_view(view, seen) & seen.evenly_spaced)
    try:
        return measure_throw(track, view.die, view.camera, every=decimation_factor(track, view.die))
    except NoFlightError:
        return None


def _every_in_second_pass(view: View, source: FrameSource, seen: ClipPoses) -> int:
    """Of how many frames one has a second pass before the marks are known, along whose flights that of the others takes less
    time. With several cameras poses do without marks."""
    if len(source.clips) > 1:
        return 1
    return seen.frame_stride * decimation_factor(
        as_track(view, source, seen, wholly_in_view(view, seen) & seen.evenly_spaced), view.die
    )


# --- the table of poses -----------------------------------------------------------------------------------------------


def _track(source: FrameSource, view: View, seen: ClipPoses, throw: Throw | None) -> Track:
    """The final table: frames without a pose are absent where the motion leads out of view, or lost."""
    track = as_track(view, source, seen)
    status = track.status.copy()
    for k in np.flatnonzero(status == LOST):
        if throw is None:
            continue
        state = throw.at(float(track.time_s[k]))
        if share_in_view(view, state.position_m, state.rotation) == 0.0:
            status[k] = ABSENT
    return replace(track, status=status)


class _Reporter:
    """Counts frames for whoever wants to know."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def at_least(self, done: int) -> None:
        self._done = max(self._done, done)
        if self._progress is not None:
            self._progress(min(self._done, self._total), self._total)
