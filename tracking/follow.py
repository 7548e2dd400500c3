"""From a clip to a track: the die found, followed through its bounces, and every frame's pose refined.

First pass (`chase`): from the first frame on which the die is wholly seen, forwards to the end and backwards to where it
came in. Second pass: the bounces are found, each flight is fitted, the lens blur is estimated, and every frame is refined
once more from its flight, which brings back frames that the first pass lost or got wrong. The poses are those of single
frames: nothing is smoothed here (`smooth`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ..model.motion import Flight, Throw
from ..model.rotations import (
    continuous_sign,
    matrix_from_quat,
    quat_from_matrix,
    rotation_between,
)
from ..model.solids import Die
from .background import estimate_background
from .beginning import begin_by_hand, find_beginning
from .bounces import NoFlightError, calibrated, measure, measure_throw
from .camera import Camera
from .chase import Seen
from .clip import Clip
from .corners import (
    FRAMES,
    Corners,
    Looks,
    Rounding,
    by_flights,
    by_free_poses,
    contour_sigma_px,
    look_rounded,
    looks_in_flight,
)
from .edges import Eyes, Lens, settle
from .flights import transition
from .hints import HandStart, excluded_rows
from .marks import FramePoses, Refining, frames_to_learn_from, learn_marks
from .marks_textures import Marks
from .offsets import Offsets, eyes_at, find_offsets
from .parting import spared
from .pose import (
    THREADS,
    View,
    blur_step,
    contour_leans,
    covariances,
    labelled_like,
    make_view,
    rounded,
    share_in_view,
    shares_in_view,
    sight_boxes,
    with_reflections,
)
from .quality import STANDARD, Quality
from .reel import Frames, Reel
from .rest import flown, frames_in_flight
from .segment import noise_and_rounding
from .track import ABSENT, LOST, TRACKED, Track

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]
Progress = Callable[[int, int], None]

FIRST_BLUR_PX = 0.7
"""Lens blur until it is estimated."""
LEAST_BLUR_PX, MOST_BLUR_PX = 0.3, 6.0
BLUR_FRAMES = 16
"""Frames over which the lens blur is estimated."""
ROUNDINGS, SAME_RADIUS, LESS = 3, 0.1, 0.9
"""Most first passes with a radius of the corners that is being found, the change, as a share, that needs no other, and the
factor on a radius whose flights do not bear it out: a bounce is lost or not by a little, and rather with too large a one."""
ROUND_SHARE = 0.25
"""Radius of the corners, as a share of the inscribed radius, of a die that may be rounded and is not found as a sharp one."""
LOST_SUPPORT, CUT_SUPPORT = 0.45, 0.6
"""Least share of the contour that bears a pose out, of a die wholly in view and of one that is cut by the border."""
LEAST_IN_VIEW = 0.3
"""Share of the corners that must lie in view for a frame to be refined from its flight."""
OPEN_RAD = np.radians(6.0)
"""A pose whose turn is less sure than this is no pose."""
CHI2_MEDIAN = 5.348
"""Median of chi-square with six degrees of freedom."""
CONTRADICTED = 30.0
"""Squared sigmas of six numbers from which marks and edges do not tell of one motion."""
WORTHWHILE = 0.0
"""Least gain of the marks, see `_gain`: marks and edges together must be as sure of the flights as edges alone. Asked for sigmas
half as large, dice of 20 px an edge did without their marks, and were turned by 0.46° and not by 0.10°."""


class NoDieError(ValueError):
    """No die was found in the clip."""


@dataclass(frozen=True, eq=False)
class Followed:
    """What following a die through a clip gives."""

    track: Track
    marks: Marks | None
    """What the die's faces show; None where that was not asked for, or they show nothing that places them."""
    offsets: Offsets
    """Of the cameras' clocks; looked for with a second pass alone."""
    die: Die
    """With the radius of its corners as it was found, where that was looked for."""
    corners: Corners | None
    """That radius with its standard error; None where it was given, or the corners look sharp."""


def follow(
    clip: Clip | Sequence[Clip],
    camera: Camera | Sequence[Camera],
    die: Die,
    *,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32] | None] | None = None,
    exposure_s: float | None = None,
    mirror: bool = False,
    start: HandStart | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    quality: Quality = STANDARD,
    progress: Progress | None = None,
) -> Track:
    """Track a die through a clip: a pose with covariance for every frame on which it can be known. As `look_through`."""
    return look_through(
        clip, camera, die, background=background, exposure_s=exposure_s, mirror=mirror, start=start, excluded=excluded,
        quality=quality, progress=progress,
    ).track  # fmt: skip


def look_through(
    clip: Clip | Sequence[Clip],
    camera: Camera | Sequence[Camera],
    die: Die,
    *,
    background: NDArray[np.float32] | Sequence[NDArray[np.float32] | None] | None = None,
    exposure_s: float | None = None,
    mirror: bool = False,
    start: HandStart | None = None,
    excluded: Sequence[tuple[int, int]] = (),
    rounding: Rounding = Rounding.GIVEN,
    quality: Quality = STANDARD,
    progress: Progress | None = None,
) -> Followed:
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
    reel = Reel(clips)
    view = _view_of(clips, cameras, die, background, exposure_s, mirror, quality)
    report = _Reporter(progress, (1 + quality.second_pass + quality.marks) * len(reel))
    unused = np.zeros(len(reel), bool)
    unused[list(excluded_rows(excluded, reel.first_frame, len(reel)))] = True
    view, seen, corners = _first_pass_rounded(view, reel, report, start, unused, rounding)
    throw = _measured(view, reel, seen)
    if throw is not None and any(impact.contact == "unresolved" for impact in throw.impacts):
        seen = _labelled_across(view, seen, throw, reel.times_s)
        throw = _measured(view, reel, seen)
    offsets = Offsets.none(len(clips))
    if quality.second_pass:
        view = with_reflections(view)
        view = replace(view, blur_px=_lens_blur(view, reel, seen, seen.known))
        report.at_least(len(reel))
        if throw is not None:
            offsets = find_offsets(view, reel.frame, reel.times_s, throw)
        seen = _second_pass(view, reel, seen, throw, unused, report, offsets)
    marks, shared = None, None
    if quality.marks:
        seen, marks, shared = _third_pass(view, reel, seen, report)
        report.at_least(3 * len(reel))
    track = replace(_track(reel, view, seen, throw), shared=shared)
    if corners is not None:
        corners, sigma_px = _corners_in_flight(view, reel, track, corners)
        view, track = rounded(view, corners.radius_m), replace(track, contour_sigma_px=sigma_px)
    sure = calibrated(track, view.die, view.camera, every=spared(track, view.die))
    return Followed(sure, marks, offsets, view.die, corners)


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
    view: View, reel: Reel, report: _Reporter, by_hand: HandStart | None, unused: Mask
) -> tuple[View, Seen]:
    """A pose for every frame that can be followed from the start, and the view with its blur estimated there."""
    beginning = (
        find_beginning(view, reel, unused, report.at_least)
        if by_hand is None
        else begin_by_hand(view, reel, by_hand, unused)
    )
    if beginning is None:
        raise NoDieError(
            f"no die was found in {len(reel)} frames: look at the clip, the background and the [die] shape and edge"
        )
    chase, seen = beginning
    view = replace(view, blur_px=_lens_blur(view, reel, seen, seen.known))
    chase.view = replace(chase.view, blur_px=view.blur_px)
    first_known = int(np.flatnonzero(seen.known)[0])
    back = chase.turned_back(seen, first_known)
    chase.to_the_end(reel, seen, report.at_least, all_frames=not view.quality.second_pass)
    for first, frames in reel.blocks_backwards(first_known):
        back.over(frames, reel.times_s, first, seen)
        if back.misses > 3:
            break
    # What was found to stand before the die is known from here on.
    return chase.view, seen


def _first_pass_rounded(
    view: View, reel: Reel, report: _Reporter, by_hand: HandStart | None, unused: Mask, rounding: Rounding
) -> tuple[View, Seen, Corners | None]:
    """The first pass, done again with rounded corners where the die is to be looked at and shows them, until its flights
    show the radius that it was done with."""
    if rounding is Rounding.GIVEN:
        return *_first_pass(view, reel, report, by_hand, unused), None
    try:
        first, seen = _first_pass(view, reel, report, by_hand, unused)
    except NoDieError:
        # A die that is round all over is none with sharp corners.
        ball = rounded(view, ROUND_SHARE * view.die.solid.inradius)
        first, seen = _first_pass(ball, reel, report, by_hand, unused)
        if _corners_at_sight(first, reel, seen, rounding) is None:
            raise
    corners = _corners_at_sight(first, reel, seen, rounding)
    if corners is None or corners.radius_m == 0.0:
        return first, seen, corners if rounding is Rounding.ESTIMATED else None
    radius_m, tried = corners.radius_m, []
    for _ in range(ROUNDINGS):
        # From the view as it was: where a sharp die's corners would be, something seemed to stand before it.
        try:
            first, seen = _first_pass(rounded(view, radius_m), reel, report, by_hand, unused)
        except NoDieError:
            break  # so round that nothing starts with it; what was followed before still is a start
        tried.append((radius_m, first, seen))
        whole = shares_in_view(first, seen.position_m, seen.rotation) == 1.0
        found, _ = _corners_in_flight(first, reel, _as_track(first, reel, seen, whole & seen.even), corners)
        before, borne_out, corners = radius_m, found is not corners, found
        radius_m = corners.radius_m if borne_out else LESS * radius_m
        if borne_out and abs(radius_m - before) < SAME_RADIUS * before:
            break
    if tried:
        # Poses of a smaller radius than is told in the end lie farther away than it says.
        _, first, seen = min(tried, key=lambda each: abs(each[0] - corners.radius_m))
    return rounded(first, corners.radius_m), seen, corners


def _corners_at_sight(view: View, reel: Reel, seen: Seen, rounding: Rounding) -> Corners | None:
    """How rounded the die of a first pass looks; None where it looks sharp, or too few frames show it."""
    whole = np.flatnonzero(seen.known & (shares_in_view(view, seen.position_m, seen.rotation) == 1.0))

    def looks(count: int) -> Looks:
        poses = seen.position_m[whole], seen.rotation[whole], seen.motion[whole]
        return Looks.at(whole, reel.frame, *poses, count)

    if rounding is Rounding.LOOKED_AT and not look_rounded(view, looks):
        return None
    return by_free_poses(view, looks(FRAMES))


def _corners_in_flight(view: View, reel: Reel, track: Track, corners: Corners) -> tuple[Corners, float]:
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
    looks = looks_in_flight(view, reel.frame, track, found.throw)
    again = by_flights(view, looks, corners.radius_m, found.joined.contour_sigma_px)
    if again is None or again.sigma_m > corners.sigma_m or again.radius_m == 0.0:
        return corners, 0.0
    return again, contour_sigma_px(view, again.sigma_m, p, R)


# --- the second pass --------------------------------------------------------------------------------------------------


def _measured(view: View, reel: Reel, seen: Seen) -> Throw | None:
    """Flights of the first pass, from the frames that show the die whole; None where they are too few to measure any."""
    whole = shares_in_view(view, seen.position_m, seen.rotation) == 1.0
    track = _as_track(view, reel, seen, whole & seen.even)
    try:
        return measure_throw(track, view.die, view.camera, every=spared(track, view.die))
    except NoFlightError:
        return None


def _labelled_across(view: View, seen: Seen, throw: Throw, times_s: Array) -> Seen:
    """The sightings with one labelling throughout: where contacts follow each other too fast for the poses between them
    to be sure, each flight takes the labelling that turns least from the flight before."""
    rotation = seen.rotation.copy()
    relabel = np.eye(3)
    for k, impact in enumerate(throw.impacts):
        before = throw.flights[k].at(impact.time_s).rotation @ relabel
        after = throw.flights[k + 1].at(impact.time_s).rotation
        relabel = after.T @ labelled_like(view, after, before)
        end = throw.impacts[k + 1].time_s if k + 1 < len(throw.impacts) else np.inf
        mine = (times_s > impact.time_s) & (times_s <= end)
        rotation[mine] = rotation[mine] @ relabel
    return replace(seen, rotation=rotation)


def _lens_blur(view: View, reel: Reel, seen: Seen, known: Mask) -> float:
    """The lens blur [px] that fits some frames spread over the track best: Newton steps on their common blur, each frame
    weighted by what it says of it, frames far from the others left out."""
    have = np.flatnonzero(known)
    picked = np.unique(have[np.linspace(0, len(have) - 1, min(BLUR_FRAMES, len(have))).astype(int)])
    images = {int(k): np.asarray(reel.frame(int(k)), np.float32) for k in picked}
    for _ in range(4):
        steps = np.array(
            [
                blur_step(view, image, seen.position_m[k], seen.rotation[k], seen.motion[k, :3], seen.motion[k, 3:])
                for k, image in images.items()
            ]
        )
        far = np.abs(steps[:, 0] - np.median(steps[:, 0]))
        weight = np.where(far <= 3.0 * max(float(np.median(far)), 0.01), steps[:, 1], 0.0)
        if not weight.sum() > 0.0:
            break
        change = float(np.clip(weight @ steps[:, 0] / weight.sum(), -0.3 * view.blur_px, 0.5 * view.blur_px))
        view = replace(view, blur_px=float(np.clip(view.blur_px + change, LEAST_BLUR_PX, MOST_BLUR_PX)))
        if abs(change) < 2e-3:
            break
    return view.blur_px


def _second_pass(
    view: View, reel: Reel, first: Seen, throw: Throw | None, unused: Mask, report: _Reporter, offsets: Offsets
) -> Seen:
    """Every frame refined from its flight, and from the first pass where that lies elsewhere; the better is kept."""
    first = first.filled()
    wanted, tries = first, [_Settling(view, first, first.known, offsets, np.zeros(len(reel), bool))]
    if throw is not None:
        wanted = _motions(throw, reel.times_s)
        apart = first.known & _apart(view, wanted, first)
        tries = [_Settling(view, wanted, ~unused, offsets, apart), _Settling(view, first, apart, offsets, apart)]

    def begun(frames: Frames, start: int, pool: Executor) -> list[Future[None]]:
        return [job for one in tries for job in one.see(frames, start, pool)]

    _see_all(reel, _looked_at(view, tries, len(reel)), begun, report, len(reel))
    seen = tries[0].seen(len(reel))
    for one in tries[1:]:
        other = one.seen(len(reel))
        seen.take(np.flatnonzero(other.known & (~seen.known | (other.cost < seen.cost))), other)
    seen.rotation[seen.known] = labelled_like(view, seen.rotation[seen.known], wanted.rotation[seen.known])
    return seen


def _looked_at(view: View, tries: Sequence[_Settling], count: int) -> NDArray[np.int64]:
    """(count, cameras, 4) pixels that hold all that a pass looks at."""
    boxes = np.zeros((count, len(view.cameras), 4), np.int64)
    for one in tries:
        mine = sight_boxes(view, one.position_m, one.rotation)
        there = boxes[one.rows]
        both = np.concatenate([np.minimum(there, mine)[..., :2], np.maximum(there, mine)[..., 2:]], axis=-1)
        lone, blank = (np.asarray(~some.any(-1))[..., None] for some in (there, mine))
        boxes[one.rows] = np.where(lone, mine, np.where(blank, there, both))
    return boxes


class _Settling:
    """Some frames on their way from a start each to the pose that their pixels bear out: what there is to know without the
    pictures is worked out for all of them at once."""

    def __init__(self, view: View, start: Seen, use: Mask, offsets: Offsets, judged: Mask) -> None:
        """Rows in `use` are refined from `start`. Pictures as a whole are judged where a frame is `judged`, or one near it:
        where there is another start to compare with."""
        in_view = shares_in_view(view, start.position_m, start.rotation) >= LEAST_IN_VIEW
        self.rows: NDArray[np.int64] = np.flatnonzero(use & in_view)
        n = len(self.rows)
        self._view, self._start, self._offsets, self._judged = view, start, offsets, judged
        self.position_m, self.rotation = start.position_m[self.rows], start.rotation[self.rows]
        self._motion, self._H = start.motion[self.rows], np.zeros((n, 8, 8))
        self._stats, self._cost = np.zeros((n, 8)), np.full(n, np.inf)

    def see(self, frames: Frames, first: int, pool: Executor) -> list[Future[None]]:
        """Refine those that are among some pictures (n, cameras, height, width), the first of them that of row `first`, in the
        threads of a pool: the jobs that were begun."""
        a, b = (int(k) for k in np.searchsorted(self.rows, (first, first + len(frames))))
        some = frames if b - a == len(frames) else frames[self.rows[a:b] - first]
        judged = self._judged[first : first + len(frames)].any()
        lens = self._view.lens if judged else self._view.lens._replace(samples=0)
        cuts = np.linspace(a, b, THREADS + 1).astype(int).tolist()
        return [pool.submit(self._settle, some[i - a : j - a], slice(i, j), lens) for i, j in pairwise(cuts) if j > i]

    def _settle(self, frames: Frames, mine: slice, lens: Lens) -> None:
        if not self._offsets.any:
            self._settle_with(frames, mine, lens, self._view.eyes)
            return
        for k, frame in enumerate(range(mine.start, mine.stop)):
            # Late cameras stand elsewhere for every frame.
            eyes = eyes_at(self._view.eyes, self._offsets.seconds, self.position_m[frame], self._motion[frame])
            self._settle_with(frames[k : k + 1], slice(frame, frame + 1), lens, eyes)

    def _settle_with(self, frames: Frames, mine: slice, lens: Lens, eyes: Eyes) -> None:
        view = self._view
        settle(
            frames, view.backgrounds, eyes, view.shape, lens, self.position_m[mine], self.rotation[mine],
            self._motion[mine], self._H[mine], self._stats[mine], self._cost[mine],
        )  # fmt: skip

    def seen(self, count: int) -> Seen:
        """What the pixels bear out of it, as rows of a clip of so many frames."""
        seen, good = Seen.empty(count), self._borne_out()
        rows = self.rows[good]
        seen.known[rows] = True
        seen.position_m[rows], seen.rotation[rows], seen.motion[rows] = (
            self.position_m[good],
            self.rotation[good],
            self._motion[good],
        )
        seen.H[rows], seen.stats[rows], seen.cost[rows] = self._H[good], self._stats[good], self._cost[good]
        return seen

    def _borne_out(self) -> Mask:
        """(n,) where the pixels bear a refined pose out."""
        gone = np.linalg.norm(self.position_m - self._start.position_m[self.rows], axis=1)
        turned = _angles(self.rotation, self._start.rotation[self.rows])
        support = self._stats[:, 4] / np.maximum(self._stats[:, 3], 1e-9)
        whole = shares_in_view(self._view, self.position_m, self.rotation) == 1.0
        open_rad = np.sqrt(np.trace(covariances(self._H[:, :6, :6])[:, 3:, 3:], axis1=1, axis2=2))
        near = (gone < 0.5 * self._view.reach_m) & (turned < OPEN_RAD)
        plain = (self._stats[:, 3] >= 20.0) & (support >= np.where(whole, LOST_SUPPORT, CUT_SUPPORT))
        return np.asarray(near & plain & (open_rad < OPEN_RAD))


def _see_all(
    reel: Reel,
    boxes: NDArray[np.int64],
    begun: Callable[[Frames, int, Executor], list[Future[None]]],
    report: _Reporter,
    done: int,
) -> None:
    """Hand all frames, block by block and cut to `boxes`, to what begins the jobs of a block in a pool; that counts frames from
    `done` on to its end. The jobs of a block are waited for when those of the next are begun: no thread then has nothing to do
    because another is late."""
    with ThreadPoolExecutor(THREADS) as pool:
        under_way: list[Future[None]] = []
        for first, frames in reel.blocks(boxes=boxes):
            jobs = begun(frames, first, pool)
            for job in under_way:
                job.result()
            under_way = jobs
            report.at_least(done + first)
        for job in under_way:
            job.result()
    report.at_least(done + len(reel))


def _apart(view: View, flown: Seen, first: Seen) -> Mask:
    """(n,) where the first pass lies further from the flight than a refinement is sure to cover."""
    moved = np.linalg.norm(flown.position_m - first.position_m, axis=1)
    return np.asarray((_angles(flown.rotation, first.rotation) > np.radians(1.5)) | (moved > 0.1 * view.reach_m))


def _angles(a: Array, b: Array) -> Array:
    """(n,) [rad] between rotations (n, 3, 3); NaN where one is not known."""
    cosine = 0.5 * (np.einsum("nij,nij->n", a, b) - 1.0)
    return np.asarray(np.arccos(np.clip(cosine, -1.0, 1.0)))


def _motions(throw: Throw, times_s: Array) -> Seen:
    """Where the flights lead on every frame, as starts for a refinement."""
    out = Seen.empty(len(times_s))
    position, quaternion = throw.poses(times_s)
    out.position_m[:], out.rotation[:] = position, matrix_from_quat(quaternion)
    out.motion[:] = throw.rates(times_s)
    out.known[:] = True
    return out


# --- the third pass: what is printed on the faces ---------------------------------------------------------------------


def _third_pass(view: View, reel: Reel, seen: Seen, report: _Reporter) -> tuple[Seen, Marks | None, Array | None]:
    """Every frame refined once more on the marks of the die's faces, where it has any, with what all frames then err
    alike (n, 6, 6).

    Marks are those that the first camera sees. With several, they are learned to be read: the edges of all cameras cross each
    other's lines of sight, which marks of one do not.
    """
    whole = shares_in_view(view, seen.position_m, seen.rotation) == 1.0
    track = _as_track(view, reel, seen, whole)
    try:
        every = spared(track, view.die)
        found = measure(track, view.die, view.camera, every=every)
    except NoFlightError:
        return seen, None, None
    edges = _as_sure_as_they_scatter(found.frames, flown(found.throw))
    throw, track = flown(found.throw), edges
    if throw is not found.throw:
        # Not where the die flies to the end: a thinned fit ends before the last frame does.
        track = frames_in_flight(edges, throw)
    rows = frames_to_learn_from(track, throw)
    full_scale = float(2 ** reel.clips[0].bit_depth - 1)
    images = ((int(k), np.asarray(reel.frame(int(k))[0], np.float32)) for k in rows)
    marks = learn_marks(view, images, track, throw, saturation_grey=full_scale)
    if marks is None or len(reel.clips) > 1:
        return seen, marks, None
    learned = np.flatnonzero([np.isfinite(shared).all() for shared in marks.shared])
    both = [(throw.flights[k], marks.flights[k]) for k in learned]
    if _contradiction(both) > CONTRADICTED or _gain(both, [found.own.flights[k] for k in learned], every) < WORTHWHILE:
        return seen, marks, None
    # Frames without edges have nothing to be refined. On those of a die that the table carries edges do as well: marks are known
    # to where they were learned, on the flights.
    known = np.flatnonzero(track.tracked)
    adjusted = Throw(marks.flights, throw.impacts)
    refining = Refining(view, marks, _poses_by_edges(view, edges, seen, known), adjusted, edges.time_s[known])
    boxes = np.zeros((len(reel), 1, 4), np.int64)
    boxes[known, 0] = refining.boxes

    def begun(frames: Frames, first: int, pool: Executor) -> list[Future[None]]:
        a, b = (int(k) for k in np.searchsorted(known, (first, first + len(frames))))
        some = frames if b - a == len(frames) else frames[known[a:b] - first]
        return refining.see(some, slice(a, b), pool)

    _see_all(reel, boxes, begun, report, 2 * len(reel))
    out, shared = Seen.empty(len(reel)), np.full((len(reel), 6, 6), np.nan)
    out.take(np.arange(len(reel)), seen)
    carried = np.flatnonzero(edges.tracked & ~track.tracked)
    shared[known] = refining.shared
    for put, poses in ((known, refining.poses()), (carried, _poses_by_edges(view, edges, seen, carried))):
        out.position_m[put], out.rotation[put] = poses.position_m, poses.rotation
        out.lean[put], out.H[put, :6, :6] = poses.contour_lean, poses.information
    return out, marks, shared


def _poses_by_edges(view: View, edges: Track, seen: Seen, rows: NDArray[np.int64]) -> FramePoses:
    """What the edges of some tracked frames say, with the covariances of `edges`."""
    return FramePoses(
        edges.position_m[rows], matrix_from_quat(edges.quaternion[rows]),
        np.linalg.inv(edges.covariance[rows]).astype(np.float64), contour_leans(seen.H[rows], view.lens),
    )  # fmt: skip


def _contradiction(both: Sequence[tuple[Flight, Flight]]) -> float:
    """Median squared distance of flights by edges and by marks half-way through each, in the sigmas of both.

    Two ways to see one motion must agree. Where they do not, the marks were learned in the wrong places: many small faces,
    each seen for a short time, can shift against each other without the pictures telling.
    """
    squared = []
    for ours, theirs in both:
        if ours.covariance is None or theirs.covariance is None or not np.isfinite(ours.end_s):
            continue
        t = 0.5 * (ours.start.time_s + ours.end_s)
        a, b = ours.at(t), theirs.at(t)
        miss = np.concatenate([b.position_m - a.position_m, rotation_between(a.quaternion, b.quaternion)])
        M, N = transition(ours, t)[:6], transition(theirs, t)[:6]
        C = M @ ours.covariance @ M.T + N @ theirs.covariance @ N.T
        squared.append(float(miss @ np.linalg.solve(C, miss)))
    return float(np.median(squared)) if squared else 0.0


def _gain(both: Sequence[tuple[Flight, Flight]], own: Sequence[Flight], every: int) -> float:
    """By how much marks, weakly helped by edges, are surer than edges alone of the pose half-way through a flight: median
    difference of the logarithms of the determinants of the covariances. Those of the edges count as if from all frames, of which
    one in `every` was used, but for what all frames err alike and their `own` covariances leave out."""
    gains = []
    for (ours, theirs), alone in zip(both, own, strict=True):
        if ours.covariance is None or alone.covariance is None or theirs.covariance is None:
            continue
        if np.isfinite(ours.end_s):
            t = 0.5 * (ours.start.time_s + ours.end_s)
            M, N = transition(ours, t)[:6], transition(theirs, t)[:6]
            shared = ours.covariance - alone.covariance
            edges, marks = M @ (alone.covariance / every + shared) @ M.T, N @ theirs.covariance @ N.T
            gains.append(float(np.linalg.slogdet(edges)[1] - np.linalg.slogdet(marks)[1]))
    return float(np.median(gains)) if gains else -np.inf


def _as_sure_as_they_scatter(track: Track, throw: Throw) -> Track:
    """The track with its covariances scaled, by one number, to how far single poses usually lie from their flights. What
    neighbouring frames err alike is left out: the marks estimate for themselves what the edges err in common."""
    use = np.flatnonzero(track.tracked & (track.time_s <= throw.flights[-1].end_s))
    p, q = throw.poses(track.time_s[use])
    miss = np.concatenate([track.position_m[use] - p, rotation_between(q, track.quaternion[use])], axis=1)
    squared = np.einsum("ni,nij,nj->n", miss, np.linalg.inv(track.covariance[use]), miss)
    return replace(track, covariance=track.covariance * max(1.0, float(np.median(squared)) / CHI2_MEDIAN))


# --- the table of poses -----------------------------------------------------------------------------------------------


def _as_track(view: View, reel: Reel, seen: Seen, use: Mask | None = None) -> Track:
    """A track of the frames that have a pose; the others are lost."""
    n = len(reel)
    known = seen.known if use is None else seen.known & use
    covariance = np.full((n, 6, 6), np.nan)
    covariance[known] = covariances(seen.H[known][:, :6, :6])
    known = known & np.isfinite(covariance[:, 0, 0])
    position = np.where(known[:, None], seen.position_m, np.nan)
    quaternion = np.full((n, 4), np.nan)
    quaternion[known] = quat_from_matrix(seen.rotation[known])
    status = np.where(known, TRACKED, LOST).astype("<U7")
    frames = reel.first_frame + np.arange(n)
    lean = np.full((n, 6), np.nan)
    lean[known] = contour_leans(seen.H[known], view.lens)
    lean = np.where(np.isfinite(seen.lean), seen.lean, lean)
    return Track(frames, reel.times_s, position, continuous_sign(quaternion), covariance, status, lean)


def _track(reel: Reel, view: View, seen: Seen, throw: Throw | None) -> Track:
    """The final table: frames without a pose are absent where the motion leads out of view, or lost."""
    track = _as_track(view, reel, seen)
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
