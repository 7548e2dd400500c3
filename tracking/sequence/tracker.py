"""From a clip to a track: the die is found and tracked through its impacts, and every frame's pose is refined.

1. Tracking (`tracking_pass`, `rounded_corners`): from the first frame that shows the whole die, forwards to the end and backwards
   to where it came in; again if the background was estimated and turns out to show the die (`empty_scene`), and in light if edges
   show a display curve that the scene does not state (`response`). Then impacts are found, each flight is fitted, and the lens
   blur is estimated; the light as well for a rounded die.
2. Refinement on edges (`refine_on_edges`): every frame, along its flight.
3. Refinement on surface marks (`refine_on_marks`): once more, on what is printed on the faces.

The poses are those of single frames: nothing is smoothed here (`throw.smoothing`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from ...model.die import Die
from ...model.errors import InputError
from ...model.rotations import continuous_sign, matrix_from_quat, quat_from_matrix
from ...model.throw import Throw, turning_of
from ...model.world import GRAVITY_M_S2
from ..camera import Camera
from ..clip_parameters import (
    BLUR_FRAMES,
    ClockOffsets,
    CornerRadius,
    CornerRounding,
    EstimatedResponse,
    empty_scene,
    estimate_clock_offsets,
    estimate_lens,
    estimate_response,
    flies_as_before,
    radius_by_impacts,
    with_light,
)
from ..footage import Clip, FrameSource, clip_in_light, estimate_background, level_grey, picture_in_light
from ..frame_to_frame import TrackingTask
from ..picture import (
    Lens,
    PixelNoise,
    View,
    make_view,
    pixel_noise,
    share_in_view,
    with_corner_radius,
    with_lens,
    with_reflections,
)
from ..pose import ClipPoses, ManualInitialisation, as_track, excluded_rows, exposure_times_s, wholly_in_view
from ..quality import STANDARD, Quality
from ..surface_marks import SurfaceMarks
from ..throw import NoFlightError, decimation_factor, measure, measure_throw, with_calibrated_covariance
from ..track import ABSENT, LOST, Track
from .labelling import with_consistent_labels, with_labels_of_marks
from .refine_on_edges import EdgeRefinement
from .refine_on_marks import MarkRefinement, refine_on_marks
from .rounded_corners import radius_in_flight, track_contour_sigma_px, track_rounded
from .tracking_pass import NoDieError as NoDieError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Background = NDArray[np.float32]
Progress = Callable[[int, int], None]

INITIAL_BLUR_PX = 0.7
"""Lens blur [px] until it is estimated."""
NOISE_FRAMES = 12
"""Frames from which the noise of the still background is estimated."""


@dataclass(frozen=True)
class ClipFacts:
    """What is known of a clip before it is tracked, beside its cameras, its background and the die."""

    exposure_s: float | None = None
    """None if it is not known."""
    mirror: bool = False
    """Whether the table reflects the die."""
    start: ManualInitialisation | None = None
    """An initial pose by hand."""
    excluded: Sequence[tuple[int, int]] = ()
    """Ranges (first, stop) of frame numbers whose pictures are not used: they are lost."""
    rounding: CornerRounding = CornerRounding.GIVEN
    """Whether the radius of the die's corners is given."""
    corners: CornerRadius | None = None
    """A given radius that the impacts of an earlier tracking showed, with its standard error; None if it was measured."""
    level_grey: float = 1.0
    """Grey values per level of the file: above 1 for a clip mapped to light."""
    readout_s: float = 0.0
    """Time from the exposure of the first row to that of the last, of every camera; 0 for a global shutter."""
    gravity_m_s2: float = GRAVITY_M_S2
    """Of the place, along -z."""
    estimates_response: bool = False
    """Whether the response of the cameras is not known, and is estimated."""
    response_sigma: float = 0.0
    """Standard deviation of the exponent of a response that was estimated before."""


NO_FACTS = ClipFacts()
MOST_CHANGED = 0.02
"""Share of the pixels behind the die whose background turns out to be another one, beyond which the clip is tracked again. Only
time is lost if it is small. Of nine random clips seven have backgrounds of which at most 0.011 is off, and two, whose dice hardly
move, 0.14 and 0.18."""


@dataclass(frozen=True, eq=False)
class TrackedClip:
    """The result of tracking a die through a clip."""

    track: Track
    marks: SurfaceMarks | None
    """What the die's faces show; None if that was not wanted, or determines no position."""
    offsets: ClockOffsets
    """Of the cameras' clocks; estimated only if frames are refined on edges."""
    die: Die
    """With the radius of its corners as estimated, if that was wanted."""
    corners: CornerRadius | None
    """That radius with its standard error; None if it was given, or the corners look sharp."""
    background: Background
    """(height, width) what the first camera sees without the die, given or estimated, in grey levels of `response`."""
    response: EstimatedResponse | None = None
    """Of the cameras, if that was wanted and the pictures show it."""
    lens: Lens | None = None
    """Of the first camera, if the pictures show its depth of field."""


def track_clip(
    clip: Clip | Sequence[Clip],
    camera: Camera | Sequence[Camera],
    die: Die,
    *,
    background: Background | Sequence[Background | None] | None = None,
    facts: ClipFacts = NO_FACTS,
    quality: Quality = STANDARD,
    progress: Progress | None = None,
) -> TrackedClip:
    """Track a die through a clip: a pose with covariance for every frame on which it can be known.

    `clip` and `camera` are one each, or as many synchronised ones as there are cameras. `background` (height, width) is a frame
    without the die (one a camera), estimated from the clip if it is None. `progress` is called with frames done and frames to do.
    Raises ValueError if camera, background and clip differ in size, and NoDieError if no die was found."""
    clips = list(clip) if isinstance(clip, Sequence) else [clip]
    cameras = [camera] if isinstance(camera, Camera) else list(camera)
    source = FrameSource(clips)
    given = [background] if background is None or isinstance(background, np.ndarray) else list(background)
    given += [None] * (len(clips) - len(given))
    view = _view_of(clips, cameras, die, given, facts, quality)
    report = _Reporter(progress, (1 + quality.second_pass + quality.marks) * len(source))
    unused = np.zeros(len(source), bool)
    unused[list(excluded_rows(facts.excluded, source.first_frame, len(source)))] = True
    task = TrackingTask(source, unused, facts.start, report.at_least)
    empty, (view, poses, corners) = _track_before_empty_scene(view, task, facts.rounding, given)
    response = _response(view, source, poses) if facts.estimates_response and quality.second_pass else None
    if response is not None and not response.is_linear:
        pictures = [
            None if picture is None else picture_in_light(picture, one, response.exponent)
            for picture, one in zip(given, clips, strict=True)
        ]
        known = replace(
            facts, estimates_response=False, response_sigma=response.sigma,
            level_grey=facts.level_grey * level_grey(clips[0], response.exponent),
        )  # fmt: skip
        light = [clip_in_light(one, response.exponent) for one in clips]
        found = track_clip(light, cameras, die, background=pictures, facts=known, quality=quality, progress=progress)
        return replace(found, response=response)
    if response is not None:
        view = replace(view, response_sigma=response.sigma)
    poses, throw = _measured(view, source, poses)
    if throw is not None and any(impact.contact == "unresolved" for impact in throw.impacts):
        poses = with_consistent_labels(view, poses, throw, exposure_times_s(view, source, poses))
        poses, throw = _measured(view, source, poses)
        if throw is not None and quality.marks and len(clips) == 1:
            before, poses = poses, with_labels_of_marks(view, source, poses, throw)
            if poses is not before:
                poses, throw = _measured(view, source, poses)
    if quality.second_pass:
        view, offsets, result = _refined(view, source, poses, throw, ~unused, report)
    else:
        offsets, result = ClockOffsets.none(len(clips)), MarkRefinement(poses, None, None)
    track = replace(_track(source, view, result.poses, throw), shared_covariance=result.shared_covariance)
    if facts.corners is not None:
        # Pictures do not show this radius: on flights they would make it smaller.
        corners = facts.corners
        track = replace(track, contour_sigma_px=track_contour_sigma_px(view, track, corners))
    elif corners is not None:
        corners, sigma_px = radius_in_flight(view, source, track, corners)
        view = with_corner_radius(view, corners.radius_m)
        track = replace(track, contour_sigma_px=sigma_px, turning=turning_of(view.die))
    elif facts.rounding is CornerRounding.TESTED and view.die.corner_radius_m == 0.0:
        every = decimation_factor(track, view.die)
        corners, sigma_px = radius_by_impacts(track, view.die, view.camera, every)
        track = replace(track, contour_sigma_px=sigma_px)
        if corners is not None:
            view = with_corner_radius(view, corners.radius_m)
            track = replace(track, turning=turning_of(view.die))
            rounded = partial(track_clip, clips, cameras, background=background, quality=quality, progress=progress)
            again = _tracked_as_rounded(rounded, view.die, facts, corners)
            if again is not None and flies_as_before(again.track, track, view.die, view.camera, every):
                return again
    calibrated = with_calibrated_covariance(track, view.die, view.camera, every=decimation_factor(track, view.die))
    if view.readout_s != 0.0:
        calibrated = _at_frame_times(view, source, calibrated, throw)
    lens = view.lens if view.lens.aperture_m > 0.0 else None
    return TrackedClip(calibrated, result.marks, offsets, view.die, corners, empty, response, lens)


def _tracked_as_rounded(
    tracked: Callable[..., TrackedClip], die: Die, facts: ClipFacts, corners: CornerRadius
) -> TrackedClip | None:
    """The clip tracked again, with a die that has the radius which impacts showed; None if that is not found."""
    try:
        return tracked(die=die, facts=replace(facts, rounding=CornerRounding.GIVEN, corners=corners))
    except NoDieError:
        return None


def _response(view: View, source: FrameSource, poses: ClipPoses) -> EstimatedResponse | None:
    """The response of the cameras, from tracked poses; None if too few frames show the die whole, or cameras differ in kind."""
    if len({clip.bit_depth for clip in source.clips}) > 1:
        return None
    return estimate_response(view, partial(poses.sample, source.frame, wholly_in_view(view, poses)), source.clips[0])


# --- the view of the scene ---------------------------------------------------------------------------------------------


def _view_of(
    clips: list[Clip],
    cameras: list[Camera],
    die: Die,
    given: Sequence[Background | None],
    facts: ClipFacts,
    quality: Quality,
) -> View:
    """The scene as the refinement needs it, with the noise of the still background."""
    pictures, noises = [], []
    for one, camera, picture in zip(clips, cameras, given, strict=True):
        _check_sizes(one, camera, picture)
        picture = np.asarray(estimate_background(one) if picture is None else picture, np.float32)
        chosen = np.unique(np.linspace(0, len(one) - 1, NOISE_FRAMES).astype(int))
        noises.append(
            pixel_noise([np.asarray(one.frame(int(k)), np.float32) for k in chosen], picture, facts.level_grey)
        )
        pictures.append(picture)
    noise = PixelNoise(
        max(each.noise_grey for each in noises), max(each.rounding_grey for each in noises), facts.level_grey
    )
    view = make_view(
        cameras, die, pictures, noise, facts.exposure_s, INITIAL_BLUR_PX, mirror=facts.mirror, quality=quality,
        readout_s=facts.readout_s, gravity_m_s2=facts.gravity_m_s2,
    )  # fmt: skip
    saturation_grey = float(2 ** min(clip.bit_depth for clip in clips) - 1)
    return replace(view, response_sigma=facts.response_sigma, saturation_grey=saturation_grey)


def _check_sizes(clip: Clip, camera: Camera, background: Background | None) -> None:
    """Raises ValueError if camera, background and clip differ in size."""
    if (clip.width_px, clip.height_px) != (camera.width_px, camera.height_px):
        raise InputError(
            f"the clip is {clip.width_px} × {clip.height_px} pixels and the camera "
            f"{camera.width_px} × {camera.height_px}: give the camera of this clip"
        )
    if background is not None and background.shape != (clip.height_px, clip.width_px):
        raise InputError(
            f"the background is {background.shape[1]} × {background.shape[0]} pixels and the clip "
            f"{clip.width_px} × {clip.height_px}: give a frame of this clip without the die"
        )


def _track_before_empty_scene(
    view: View, task: TrackingTask, rounding: CornerRounding, given: Sequence[Background | None]
) -> tuple[Background, tuple[View, ClipPoses, CornerRadius | None]]:
    """The background of the first camera, and the result of `track_rounded`. Where backgrounds were estimated and the poses show
    that the die is part of them, the clip is tracked again before better ones. Raises NoDieError if no die was found."""
    found = track_rounded(view, task, rounding)
    if all(picture is not None for picture in given):
        return view.background, found
    scene = empty_scene(view, task.source, found[1], task.unused)
    if scene.changed_share <= MOST_CHANGED:
        return view.background, found
    is_given = np.array([picture is not None for picture in given])[:, None, None]
    view = replace(view, backgrounds=np.where(is_given, view.backgrounds, scene.backgrounds))
    return view.background, track_rounded(view, task, rounding)


# --- refinement --------------------------------------------------------------------------------------------------------


def _measured(view: View, source: FrameSource, poses: ClipPoses) -> tuple[ClipPoses, Throw | None]:
    """Tracked poses, labelled as their flights are, and these flights, from the frames that show the die whole; None if these are
    too few."""
    track = as_track(view, source, poses, wholly_in_view(view, poses) & poses.evenly_spaced)
    try:
        found = measure(track, view.die, view.camera, every=decimation_factor(track, view.die))
    except NoFlightError:
        return poses, None
    return replace(poses, rotation=poses.rotation @ found.labels), found.throw


def _refined(
    view: View, source: FrameSource, poses: ClipPoses, throw: Throw | None, usable: Mask, report: _Reporter
) -> tuple[View, ClockOffsets, MarkRefinement]:
    """The poses refined on edges, and on marks if the quality asks for it, with the view and the clock offsets used."""
    view = with_reflections(view)
    if not view.shows_surface(np.median(poses.position_m[poses.known], axis=0)):
        # Whole surfaces show the light by themselves, on bevels that bear no marks.
        view = with_light(view, source.frame, poses)
    view = with_lens(view, estimate_lens(view, poses.sample(source.frame, poses.known, BLUR_FRAMES)))
    count, offsets = len(source), ClockOffsets.none(len(source.clips))
    report.at_least(count)
    # With a rolling shutter the cameras see the die at instants of their own, which are no offset of their clocks.
    if throw is not None and view.readout_s == 0.0:
        offsets = estimate_clock_offsets(view, source.frame, source.times_s, throw)
    refinement = EdgeRefinement(view, source, poses.interpolated(), throw, usable, offsets)
    use_marks = view.quality.marks
    every = _refined_first(view, source, poses) if use_marks and throw is not None else 1
    refined = refinement.refine(np.arange(count) % every == 0, lambda done: report.at_least(count + done))
    if not use_marks:
        return view, offsets, MarkRefinement(refined, None, None)
    result = refine_on_marks(refinement, refined, every, lambda done: report.at_least(2 * count + done))
    report.at_least(3 * count)
    return view, offsets, result


def _refined_first(view: View, source: FrameSource, poses: ClipPoses) -> int:
    """One in how many frames is refined on edges before the marks are learned: the others take less time along the flights that
    the marks show. With several cameras marks are not used, and all frames are refined at once."""
    if len(source.clips) > 1:
        return 1
    track = as_track(view, source, poses, wholly_in_view(view, poses) & poses.evenly_spaced)
    return poses.frame_stride * decimation_factor(track, view.die)


def _track(source: FrameSource, view: View, poses: ClipPoses, throw: Throw | None) -> Track:
    """The final track: frames without a pose are absent if the motion leads out of view, else lost."""
    track = as_track(view, source, poses)
    status = track.status.copy()
    for k in np.flatnonzero(status == LOST):
        if throw is None:
            continue
        state = throw.at(float(track.time_s[k]))
        if share_in_view(view, state.position_m, state.rotation) == 0.0:
            status[k] = ABSENT
    return replace(track, status=status)


def _at_frame_times(view: View, source: FrameSource, track: Track, throw: Throw | None) -> Track:
    """The track of a rolling shutter at the times of the frames, from the instants at which the row of the die's centre was
    exposed. Each pose keeps its difference from the flights: that of the position, and that of the rotation in body axes. Without
    flights the track keeps its times."""
    try:
        throw = measure_throw(track, view.die, view.camera, every=decimation_factor(track, view.die))
    except NoFlightError:
        if throw is None:
            return track
    rows = np.flatnonzero(track.tracked)
    position, covariance = track.position_m.copy(), track.covariance.copy()
    quaternion = track.quaternion.copy()
    (p, q), (p_then, q_then) = throw.poses(source.times_s[rows]), throw.poses(track.time_s[rows])
    turn = matrix_from_quat(q) @ np.swapaxes(matrix_from_quat(q_then), 1, 2)
    position[rows] += p - p_then
    quaternion[rows] = quat_from_matrix(turn @ matrix_from_quat(quaternion[rows]))
    T = np.tile(np.eye(6), (len(rows), 1, 1))
    T[:, 3:, 3:] = turn
    covariance[rows] = T @ covariance[rows] @ np.swapaxes(T, 1, 2)
    return replace(
        track,
        time_s=source.times_s,
        position_m=position,
        quaternion=continuous_sign(quaternion),
        covariance=covariance,
    )


class _Reporter:
    """Reports the frames done, which never decrease."""

    def __init__(self, progress: Progress | None, total: int) -> None:
        self._progress, self._total, self._done = progress, total, 0

    def at_least(self, done: int) -> None:
        self._done = max(self._done, done)
        if self._progress is not None:
            self._progress(min(self._done, self._total), self._total)
