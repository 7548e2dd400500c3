"""The radius of the corners: a clip is tracked again with a rounded die if its pictures show one, and with another radius until
its flights show the one that it was tracked with. A die of a given radius that hardly shows is followed by its edges."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from functools import partial

import numpy as np

from ...model.rotations import matrix_from_quat
from ..clip_parameters import (
    RADIUS_FRAMES,
    SUFFICIENT_FRAMES,
    SURFACE_FRAMES,
    ClockOffsets,
    CornerRadius,
    CornerRounding,
    contour_sigma_px,
    gain_over_sharp,
    is_clearly_rounded,
    is_rounded,
    largest_radius_m,
    may_be_rounder,
    radius_by_free_poses,
    radius_by_surface,
    radius_on_flights,
    sample_in_flight,
    surface_gain_over_sharp,
    unexplained_contacts,
)
from ..footage import FrameSource
from ..frame_to_frame import TrackingTask
from ..picture import View, with_corner_radius
from ..pose import ClipPoses, as_track, wholly_in_view
from ..throw import NoFlightError, decimation_factor, measure
from ..track import Track
from .initialisation import MIN_HYPOTHESES
from .lost_ranges import stays_in_view
from .refine_on_edges import EdgeRefinement
from .tracking_pass import NoDieError, find_where_lost, track_once, track_throughout

MAX_RADIUS_TRIALS = 3
"""Most tracking passes with an estimated radius of the corners."""
TRIAL_FRAMES = MIN_HYPOTHESES
"""Frames on which the initial pose of such a pass is searched at the most: as many as decide by agreement. With a radius that is
not the die's none may be certain on any, and each hypothesis takes long to follow: of a sharp tetrahedron that turns far from
frame to frame, 20 to 55 s a frame of the search."""
SAME_RADIUS = 0.1
"""Relative change of the radius that needs no further pass."""
SMALLER_RADIUS = 0.9
"""Factor on a radius that the flights of its pass do not support: little decides whether an impact is lost, and it is rather lost
with a radius that is too large."""
EXCLUDED_SIGMAS = 4.0
"""Standard errors of the contour, by the flights of a sharp die, by which it must lie nearer to that than to a rounded one's."""
SHARP_CONTOUR_PX = 0.25
"""Error of that contour [px] up to which its die may be sharp. It was chosen on one seed of random clips: flights of six sharp
dice showed up to 0.14, those of 15 of 18 rounded ones 0.16 to 0.8. Of the others two are rounded by too little to differ so, and
one leaves 0.2 open."""
CLEARLY_ROUNDED_PX = 1.0
"""Radius in the picture from which the whole surface of a die is compared from the first. Below it edges follow most dice. They
take a small part of the time, and of dark dice, whose faces and bevels hardly differ, they find the outline where a wrong pose
explains as much of the surface. It was chosen on nineteen random clips."""
MOST_LOST_SHARE = 0.05
"""Share of the frames that may lack a pose, or a flight, of a die that edges track well."""
LATE_FRAMES = 2
"""Frames at which a die may come into view or leave it before it has a pose, or after its last."""
ROUND_SHARE = 0.25
"""Radius of the corners, as a share of the inscribed radius, of a die that may be rounded and is not found as a sharp one."""


def track_rounded(
    view: View, task: TrackingTask, rounding: CornerRounding
) -> tuple[View, ClipPoses, CornerRadius | None]:
    """Poses from tracking, the view that they were tracked with, and the radius of the corners if it was estimated.

    Unless the radius is given, the pass is repeated with a rounded die if the pictures show one, until its flights show the
    radius that it was done with. A rounded die that looked sharp must have been tracked over as many frames as the sharp one, or
    over hardly fewer with a radius that its flights support. Raises NoDieError if no die was found."""
    if rounding is CornerRounding.GIVEN:
        return *_track_by_edges_or_surface(view, task), None
    first, poses = _track_sharp_or_round(view, task, rounding)
    corners, is_clear = _radius_from_pictures(first, task.source, poses, rounding)
    if corners is None or corners.radius_m == 0.0:
        return first, poses, corners if rounding is CornerRounding.ESTIMATED else None
    is_tested = rounding is CornerRounding.TESTED and first.die.corner_radius_m == 0.0
    if is_tested and not _flies_as_rounded(first, poses, task.source, corners.radius_m, is_clear):
        return first, poses, None
    trials = _radius_trials(view, task, corners)
    if is_tested:
        trials = [trial for trial in trials if _explains_better_than_sharp(trial, poses, task.source)]
    if trials:
        most = max(trial.poses.frames for trial in trials)
        sufficient = [trial for trial in trials if trial.poses.frames >= SUFFICIENT_FRAMES * most]
        corners = sufficient[-1].corners
        # Poses with a smaller radius than the final one lie farther away than the latter implies.
        chosen = min(sufficient, key=lambda trial: abs(trial.radius_m - corners.radius_m))
        found = find_where_lost(chosen.view, task, chosen.poses)
        if not is_tested or found.frames >= (SUFFICIENT_FRAMES if chosen.is_supported else 1.0) * poses.frames:
            return with_corner_radius(chosen.view, corners.radius_m), found, corners
    if is_tested:
        return first, poses, None
    return with_corner_radius(first, corners.radius_m), poses, corners


def _track_by_edges_or_surface(view: View, task: TrackingTask) -> tuple[View, ClipPoses]:
    """A pass with the radius of the view's die. One that is rounded by less than CLEARLY_ROUNDED_PX is followed by its edges,
    where they suffice, and the poses are refined on its surface; else the surface is compared from the first."""
    if view.die.corner_radius_m == 0.0:
        return track_throughout(view, task)
    try:
        by_edges, poses = track_throughout(replace(view, surface_from_px=CLEARLY_ROUNDED_PX), task)
    except NoDieError:
        return track_throughout(view, task)
    compared = [
        view.shows_surface(place) and not by_edges.shows_surface(place) for place in poses.position_m[poses.known]
    ]
    surface = replace(by_edges, surface_from_px=view.surface_from_px)
    if not any(compared):
        return surface, poses
    if not _is_tracked_well(by_edges, poses, task):
        return track_throughout(view, task)
    offsets = ClockOffsets.none(len(task.source.clips))
    refinement = EdgeRefinement(surface, task.source, poses.interpolated(), None, ~task.unused, offsets)
    refined = refinement.refine(poses.known, lambda frames: None)
    return surface, replace(refined, frame_stride=poses.frame_stride)


def _is_tracked_well(view: View, poses: ClipPoses, task: TrackingTask) -> bool:
    """Whether the die has poses while it is in view, and these lie on flights that meet as impacts at one corner do."""
    source, known = task.source, np.flatnonzero(poses.known)
    lost = ~(poses.interpolated().known | task.unused)
    if lost[known[0] : known[-1] + 1].mean() > MOST_LOST_SHARE:
        return False
    for k, step in ((int(known[0]), -LATE_FRAMES), (int(known[-1]), LATE_FRAMES)):
        if 0 <= k + step < len(lost) and lost[k + step] and stays_in_view(view, source, poses, k, step):
            return False
    track = as_track(view, source, poses, wholly_in_view(view, poses) & poses.evenly_spaced)
    try:
        found = measure(track, view.die, view.camera, every=decimation_factor(track, view.die))
    except NoFlightError:
        return False
    return unexplained_contacts(found) == 0 and bool(found.unexplained[track.tracked].mean() <= MOST_LOST_SHARE)


class _Corners(Enum):
    """What flights say of the corners of a die."""

    SHARP = auto()
    ROUNDED = auto()
    OPEN = auto()


@dataclass(frozen=True, eq=False)
class _Trial:
    """A tracking pass with a radius of the corners."""

    radius_m: float
    view: View
    poses: ClipPoses
    is_supported: bool
    """Whether its flights show a radius."""
    corners: CornerRadius
    """The radius known after it."""


def _track_sharp_or_round(view: View, task: TrackingTask, rounding: CornerRounding) -> tuple[View, ClipPoses]:
    """A first pass with the view's radius; with a well-rounded die if none is found and the pictures then show one."""
    try:
        return track_throughout(view, task)
    except NoDieError:
        # A die that is round all over is not found as one with sharp corners.
        ball = with_corner_radius(view, min(ROUND_SHARE * view.die.solid.inradius, largest_radius_m(view.die)))
        first, poses = track_throughout(ball, task)
        if _radius_from_pictures(first, task.source, poses, rounding)[0] is None:
            raise
        return first, poses


def _radius_trials(view: View, task: TrackingTask, corners: CornerRadius) -> list[_Trial]:
    """Passes with an estimated radius, each with that of the one before, until it no longer changes."""
    radius_m, trials = corners.radius_m, []
    for _ in range(MAX_RADIUS_TRIALS):
        # From the original view: tracking a sharp die takes what its corners would cover for an occluder.
        try:
            tracked_view, poses = track_once(with_corner_radius(view, radius_m), task, TRIAL_FRAMES)
        except NoDieError:
            break  # so round that no initial pose is found; the poses tracked before remain
        use = wholly_in_view(tracked_view, poses) & poses.evenly_spaced
        track = as_track(tracked_view, task.source, poses, use)
        found, _ = radius_in_flight(tracked_view, task.source, track, corners)
        is_supported, corners = found is not corners, found
        trials.append(_Trial(radius_m, tracked_view, poses, is_supported, corners))
        before, radius_m = radius_m, corners.radius_m if is_supported else SMALLER_RADIUS * radius_m
        if is_supported and abs(radius_m - before) < SAME_RADIUS * before:
            break
    return trials


def _explains_better_than_sharp(trial: _Trial, sharp: ClipPoses, source: FrameSource) -> bool:
    """Whether a rounded die explains the pictures that both show better than the sharp one. A sharp die out of focus looks a
    little rounded; with a radius that is not its own it is lost, or tracked with poses that draw it worse."""
    both = sharp.known & trial.poses.known
    some = [poses.sample(source.frame, both, SURFACE_FRAMES) for poses in (sharp, trial.poses)]
    by_surface = surface_gain_over_sharp(trial.view, trial.radius_m, *some)
    if by_surface is not None:
        return by_surface[0] > 0.0
    more = (poses.sample(source.frame, both, RADIUS_FRAMES) for poses in (sharp, trial.poses))
    gain, sigma = gain_over_sharp(trial.view, trial.radius_m, *more)
    return gain > 0.0 or sigma == np.inf


def _flies_as_rounded(view: View, sharp: ClipPoses, source: FrameSource, radius_m: float, is_clear: bool) -> bool:
    """Whether flights leave it open that a die which was tracked with sharp corners is rounded by a radius, if the pictures are
    clear about it, or else show it."""
    shown = _corners_in_flight(view, sharp, source, radius_m)
    return shown is _Corners.ROUNDED or (is_clear and shown is not _Corners.SHARP)


def _corners_in_flight(view: View, sharp: ClipPoses, source: FrameSource, radius_m: float) -> _Corners:
    """What the flights of a die that was tracked with sharp corners say of its corners, beside a radius.

    The contour of a rounded die lies within that of a sharp one, for which it seems too far away. The fall and the table
    then show that the contour of the sharp die is drawn so far out as the radius says; of a die that is sharp they show
    hardly an error, whatever a codec or a sharpening filter does to its edges. Only a throw with an impact at one corner says
    so: the corners of a rounded die touch elsewhere."""
    use = wholly_in_view(view, sharp) & sharp.evenly_spaced
    inset_px = contour_sigma_px(view, radius_m, sharp.position_m[use], sharp.rotation[use])
    track = replace(as_track(view, source, sharp, use), contour_sigma_px=inset_px)
    try:
        throw = measure(track, view.die, view.camera)
    except NoFlightError:
        return _Corners.OPEN
    # Flights may turn at a corner and not meet the table there.
    strikes = zip(throw.throw.impacts, throw.chain.links, strict=False)
    if not len(throw.chain.shared) or not any(i.contact == "vertex" and link.impact is not None for i, link in strikes):
        return _Corners.OPEN
    found, sigma = float(throw.chain.shared[0]), throw.chain.contour_sigma_px
    if abs(found) < SHARP_CONTOUR_PX and abs(found) + EXCLUDED_SIGMAS * sigma < abs(found + inset_px):
        return _Corners.SHARP
    return _Corners.ROUNDED if found < -SHARP_CONTOUR_PX - EXCLUDED_SIGMAS * sigma else _Corners.OPEN


def _radius_from_pictures(
    view: View, source: FrameSource, poses: ClipPoses, rounding: CornerRounding
) -> tuple[CornerRadius | None, bool]:
    """The radius of the corners from single pictures, None if the die looks sharp, or too few frames show it; and whether the
    pictures alone suffice to take a sharp die for rounded.

    Edges show that a die is rounded from a pixel on, and the whole surface how much, from two pixels on. A smaller radius is
    that of the edges, no larger than the surface allows; since what smears an edge looks like a bevel, flights must show it
    unless the edges are clear."""
    looks = partial(poses.sample, source.frame, wholly_in_view(view, poses))
    shows_bevels = rounding is CornerRounding.ESTIMATED or is_rounded(view, looks)
    if not (shows_bevels or may_be_rounder(view, looks(SURFACE_FRAMES))):
        return None, False
    surface = radius_by_surface(view, looks(SURFACE_FRAMES))
    if surface is not None and surface.is_rounded:
        return surface.best, True
    is_sharp = rounding is CornerRounding.TESTED and surface is not None and surface.is_sharp
    if is_sharp or not shows_bevels:
        return None, False
    found = radius_by_free_poses(view, looks(RADIUS_FRAMES))
    if surface is None or found is None:
        return found, True
    is_clear = is_clearly_rounded(view, looks(RADIUS_FRAMES))
    return replace(found, radius_m=min(found.radius_m, surface.most_m)), is_clear


def radius_in_flight(
    view: View, source: FrameSource, track: Track, corners: CornerRadius
) -> tuple[CornerRadius, float]:
    """The radius of the corners from the flights of a track, and the contour error [px] that remains; `corners` itself and 0 if
    the flights do not determine it better.

    The flights are free to correct their distance. That leaves more ways to join them. Where these fail, the pictures contradict
    the flights, or the flights the radius: the poses then do better without that freedom."""
    if not track.tracked.any():
        return corners, 0.0
    open_contour = replace(track, contour_sigma_px=track_contour_sigma_px(view, track, corners))
    try:
        found = measure(open_contour, view.die, view.camera)
    except NoFlightError:
        return corners, 0.0
    looks = sample_in_flight(view, source.frame, track, found.throw)
    again = radius_on_flights(view, looks, corners.radius_m, found.chain.contour_sigma_px)
    if again is None or again.sigma_m > corners.sigma_m or again.radius_m == 0.0:
        return corners, 0.0
    return again, track_contour_sigma_px(view, track, again)


def track_contour_sigma_px(view: View, track: Track, corners: CornerRadius) -> float:
    """Standard deviation [px] of the place of the contour that a radius leaves open at the poses of a track."""
    position_m, quaternion = track.position_m[track.tracked], track.quaternion[track.tracked]
    return contour_sigma_px(view, corners.sigma_m, position_m, matrix_from_quat(quaternion))
