"""`diethrow track`: from the footage of a scene to poses, bounces and the files of the tracking stage."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...executors import one_thread
from ...files.analysis_folder import write_tracked
from ...files.csv_and_json import write_json
from ...files.measured_throw import TrackedThrow
from ...files.outputs import whole_folder
from ...files.provenance import InputFile, Inputs, Stopwatch, provenance_table, unchanged_inputs
from ...files.scene import Scene
from ...files.settings import SceneError, refuse
from ...fitting.results import IntervalMethod
from ...model.die import Die
from ...model.throw import Throw
from ...runs import Progress, RunError, Tracking, silent
from ...tracking.camera import Camera
from ...tracking.check import doubtful_frame_notices, find_second_die
from ...tracking.footage import (
    WHOLE_CLIP,
    Clip,
    Decimation,
    clip_files,
    clip_in_light,
    level_grey,
)
from ...tracking.quality import QUALITIES, STANDARD, Quality
from ...tracking.sequence import ClipFacts
from ...tracking.surface_marks import read_faces, with_numbers
from ...tracking.throw import CalibrationErrors, NoFlightError, flights_only, measure
from ...tracking.timing import ClipClock, TimedTracking, Timing, clip_at_times, track_clip_in_time
from ...tracking.track import ABSENT, LOST, Track
from .footage import open_background, open_footage, readout_of_frames


@dataclass(frozen=True, eq=False)
class EarlierTracking:
    """What a scene's clips gave before, and the files that it was tracked from."""

    tracking: Tracking
    files: tuple[InputFile, ...]


@dataclass(frozen=True, eq=False)
class FoundThrow:
    """What the poses of single frames show."""

    independent: Track
    """The frames without the error that they share, with covariances for a fit that takes them as independent."""
    throw: Throw
    """The flights and the impacts between them."""
    smoothed: Track
    """All frames, those in flight smoothed."""
    doubts: tuple[str, ...]
    """Sentences that name frames whose poses contradict each other."""
    cameras: tuple[Camera, ...] = ()
    """As the throw shows them: the poses lie on their pictures."""


def track_only(
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    quality: Quality = STANDARD,
    decimation: Decimation = WHOLE_CLIP,
    timing: Timing = "corrected",
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> Tracking:
    """The tracking stage alone, written to the folder `out`. Raises as `analyze`."""
    watch = Stopwatch()
    check_scene(scene)
    paths = input_paths(scene)
    with one_thread(), whole_folder(out, force=force, inputs=paths) as folder, unchanged_inputs(paths) as inputs:
        tracking = track_scene(scene, progress, watch, quality, decimation=decimation, timing=timing)
        known = TrackedThrow(tracking.unbiased, tracking.measured, tracking.die, tracking.faces.numbers)
        write_tracked(folder, tracking.smoothed, known)
        command = command or same_command("track", scene, out, quality, decimation, timing=timing)
        write_origin(folder, scene, command, inputs, watch, tracking)
    return tracking


def smoothed_notices(track_path: Path) -> tuple[str, ...]:
    """A notice if the track is smoothed and one of independent frames lies beside it."""
    independent = track_path.with_name("track_frames.csv")
    if track_path.name != "track.csv" or not independent.exists():
        return ()
    return (
        f"{track_path} is smoothed, so its errors are correlated and the intervals will be too narrow; "
        f"fit {independent.name} instead.",
    )


def check_scene(scene: Scene) -> None:
    """Raises SceneError for a well-formed scene that cannot be analysed: no footage, two views, a table that moves."""
    scene.views()
    scene.still_table()


def track_scene(
    scene: Scene,
    progress: Progress = silent,
    watch: Stopwatch | None = None,
    quality: Quality = STANDARD,
    clips: Sequence[Clip] | None = None,
    decimation: Decimation = WHOLE_CLIP,
    timing: Timing = "corrected",
) -> Tracking:
    """Track the die through the footage of a scene, find its bounces, and smooth its flights.

    `clips`, one per camera, replace the footage that the scene names. `timing` says whether missing and repeated frames that
    the motion shows are corrected, or times are as filmed. Raises SceneError for footage that does not fit the
    scene, RunError if no die is found.
    """
    watch = watch or Stopwatch()
    views = scene.views()
    with watch.stage("open"):
        clips = [open_footage(scene, view) for view in views] if clips is None else clips
        backgrounds = [open_background(scene, view, clip) for view, clip in zip(views, clips, strict=True)]
        scene = readout_of_frames(scene, clips)
    light = [clip_in_light(clip, scene.clip.response) for clip in clips]
    # One unit for all: the noise is that of the noisiest camera.
    unit_grey = max(level_grey(clip, scene.clip.response) for clip in clips)
    cameras = tuple(view.camera for view in views)
    interval_s = float(np.median(np.diff(clips[0].times_s))) if len(clips[0]) > 1 else None
    if not decimation.is_whole:
        scene, light, backgrounds, cameras = _decimated(scene, light, backgrounds, decimation)
        clips = [decimation.clip(clip) for clip in clips]
    try:
        with watch.stage("track"):
            progress("Tracking the die", 0, len(clips[0]))
            how = _How(quality, timing, interval_s, unit_grey)
            timed = _follow(scene, light, cameras, backgrounds, how, progress)
            followed, times = timed.tracked, timed.times
            clips = [clip_at_times(clip, times.times_s) for clip in clips]
        if followed.response is not None:
            unit_grey *= level_grey(light[0], followed.response.exponent)
            light = [clip_in_light(clip, followed.response.exponent) for clip in light]
        faces = read_faces(followed.die, followed.marks)
        die = with_numbers(followed.die, faces)
        frames = replace(followed.track, frame=decimation.frame_numbers(followed.track.frame))
        known = scene.known_errors(interval_s)
        with ThreadPoolExecutor(1) as beside:  # the impacts need no pictures
            other = beside.submit(
                find_second_die, light[0], followed.track, cameras[0], followed.die, followed.background, unit_grey
            )
            found = find_impacts(frames, scene.path, die, (cameras[0], known), progress, watch)
            second = other.result()
    except RunError as error:
        # A truncated clip may be the reason why no die is found.
        for notice in (notice for clip in clips for notice in clip.notices):
            error.add_note(notice)
        raise
    shown_by = found.cameras if decimation.is_whole else tuple(decimation.camera(camera) for camera in found.cameras)
    return Tracking(
        tuple(clips), shown_by, die, faces, frames, found.independent, found.throw, found.smoothed, followed.offsets,
        followed.corners, times.renumbered(clips[0].first_frame, decimation.every), second, found.doubts,
        followed.response, followed.lens,
    )  # fmt: skip


def input_paths(scene: Scene) -> tuple[Path, ...]:
    """Every file that an analysis of this scene reads."""
    clips = [file for view in scene.cameras if view.path is not None for file in clip_files(view.path)]
    backgrounds = [view.background_path for view in scene.cameras if view.background_path is not None]
    calibrations = [view.calibration_path for view in scene.cameras if view.calibration_path is not None]
    return tuple(dict.fromkeys((*scene.settings_paths, *clips, *backgrounds, *calibrations)))


def _decimated(
    scene: Scene,
    clips: Sequence[Clip],
    backgrounds: Sequence[NDArray[np.float32] | None],
    decimation: Decimation,
) -> tuple[Scene, list[Clip], list[NDArray[np.float32] | None], tuple[Camera, ...]]:
    """Everything that a scene says of its footage, for the part of it that is used."""
    if scene.start is not None:
        wanted = "an initial pose by hand needs the whole clip: leave out [start], --every and --shrink"
        raise refuse(scene.path, "start.frame", scene.start.frame, wanted)
    first = clips[0].first_frame
    source = replace(scene.clip, excluded=decimation.frame_ranges(first, scene.clip.excluded))
    try:
        fewer = [decimation.clip(clip) for clip in clips]
    except ValueError as error:
        raise SceneError(f"{scene.path}: {error}") from error
    smaller = [None if picture is None else decimation.picture(picture) for picture in backgrounds]
    cameras = tuple(decimation.camera(view.camera) for view in scene.views())
    row_s = source.readout_s / (scene.views()[0].camera.height_px - 1)
    source = replace(source, readout_s=decimation.shrink * row_s * (cameras[0].height_px - 1))
    return replace(scene, clip=source), fewer, smaller, cameras


@dataclass(frozen=True)
class _How:
    """How the clips of a scene are tracked."""

    quality: Quality
    timing: Timing
    interval_s: float | None
    """Interval of the cameras' clock; None for a single frame."""
    unit_grey: float
    """Levels of the clips in light per level of the files."""


def _follow(
    scene: Scene,
    clips: Sequence[Clip],
    cameras: Sequence[Camera],
    backgrounds: Sequence[NDArray[np.float32] | None],
    how: _How,
    progress: Progress,
) -> TimedTracking:
    mirror = scene.table.surface == "mirror"
    facts = ClipFacts(
        scene.clip.exposure_s, mirror, scene.start, scene.clip.excluded, scene.rounding, level_grey=how.unit_grey,
        readout_s=scene.clip.readout_s, gravity_m_s2=scene.table.gravity_m_s2,
        estimates_response=scene.clip.response is None,
    )  # fmt: skip
    try:
        return track_clip_in_time(
            clips,
            cameras,
            scene.die,
            background=backgrounds,
            facts=facts,
            quality=how.quality,
            progress=lambda done, total: progress("Tracking the die", done, total),
            clock=ClipClock(how.timing, how.interval_s),
        )
    except (ValueError, OSError) as error:
        raise RunError(f"{scene.path}: {error}") from error


def find_impacts(
    frames: Track,
    source: Path,
    die: Die,
    filmed_by: tuple[Camera, CalibrationErrors] | None,
    progress: Progress,
    watch: Stopwatch,
) -> FoundThrow:
    """The flights that the frames show and the impacts between them. Raises RunError if there is no flight."""
    _demand_a_die(frames, source, die)
    with watch.stage("bounces"):
        progress("Finding the bounces", 0, 0)
        try:
            camera, known = filmed_by or (None, None)
            found = measure(frames, die, camera, known=known)
        except NoFlightError as error:
            raise RunError(f"{source}: {error}") from error
        smoothed = found.smoothed_frames
        notices = doubtful_frame_notices(found, smoothed)
        cameras = found.calibration.cameras
        return FoundThrow(found.independent_frames, flights_only(found.throw), smoothed, notices, cameras)


def _demand_a_die(frames: Track, source: Path, die: Die) -> None:
    """Raises RunError, with the likely reason, if no frame has a pose."""
    absent, lost = int((frames.status == ABSENT).sum()), int((frames.status == LOST).sum())
    if absent == len(frames):
        raise RunError(
            f"{source}: no die was found in any frame (absent in all {absent}); "
            "check that the clip shows a throw, and that the background shows the scene without the die"
        )
    if absent + lost == len(frames):
        raise RunError(
            f"{source}: something moves, but no frame shows a {die.solid.name} of this size "
            f"(lost in {lost} frames, absent in {absent}); check that [die] and [camera] belong to this clip"
        )


def same_command(
    name: str,
    scene: Scene,
    out: Path,
    quality: Quality,
    decimation: Decimation,
    intervals: IntervalMethod = "profile",
    timing: Timing = "corrected",
) -> tuple[str, ...]:
    """The command line that does the same; empty for a quality without a name."""
    if quality not in QUALITIES.values():
        return ()
    less = ("--every", str(decimation.every), "--shrink", str(decimation.shrink)) if not decimation.is_whole else ()
    other = ("--intervals", intervals) if intervals != "profile" else ()
    times = ("--timing", timing) if timing != "corrected" else ()
    start = ("diethrow", name, str(scene.path), "--out", str(out), "--allow-outside")
    return (*start, "--quality", quality.name, *less, *times, *other)


def write_origin(
    folder: Path,
    scene: Scene,
    command: tuple[str, ...],
    inputs: Inputs,
    watch: Stopwatch,
    tracking: Tracking | None = None,
) -> None:
    """Write `provenance.json`."""
    write_json(folder / "provenance.json", origin_table(scene, command, inputs, watch, tracking))


def origin_table(
    scene: Scene, command: tuple[str, ...], inputs: Inputs, watch: Stopwatch, tracking: Tracking | None = None
) -> dict[str, Any]:
    """The contents of `provenance.json`, with what was estimated because the scene does not give it, and every fault of the frame
    times."""
    found: dict[str, object] = {}
    if tracking is not None and tracking.corners is not None:
        found |= {"corner_radius_m": tracking.corners.radius_m, "sigma_corner_radius_m": tracking.corners.sigma_m}
    if tracking is not None and tracking.response is not None and not tracking.response.is_exact:
        found |= {"response": tracking.response.exponent, "sigma_response": tracking.response.sigma}
    if tracking is not None and tracking.lens is not None:
        found |= {"aperture_m": tracking.lens.aperture_m, "focus_m": tracking.lens.focus_m}
    if tracking is not None and tracking.times.faults:
        found |= {"times_corrected": tracking.times.corrected}
        found |= {"frame_time_faults": [fault.record for fault in tracking.times.faults]}
    return provenance_table(command=command, understood=scene, inputs=inputs, seconds=watch.seconds, found=found)


def if_there(path: Path) -> tuple[Path, ...]:
    return (path,) if path.exists() else ()
