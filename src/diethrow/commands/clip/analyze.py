"""`diethrow analyze`: track the die, find its bounces, fit the model, and write the results.

Each step is one public function of its stage. This module passes values from one to the next, measures the time, and writes the
records into a folder that appears whole or not at all.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...executors import loaded_ahead, one_thread
from ...files.analysis_folder import AnalysedThrow, result_tables, write_values
from ...files.csv_and_json import read_json
from ...files.outputs import whole_folder
from ...files.provenance import Stopwatch, demand_same, unchanged_inputs
from ...files.scene import Scene
from ...fitting.results import Choices, IntervalMethod
from ...replay.elements import Record, ReportDetails, VideoEncoding
from ...runs import PLAIN, Progress, Shown, Tracking, rate_hz, silent
from ...tracking.check import Finding, contact_heights, fall_of_correlated_frames, frame_timing, judge_throw
from ...tracking.footage import WHOLE_CLIP, Decimation
from ...tracking.quality import STANDARD, Quality
from ...tracking.timing import Timing
from .fit import estimate_sequentially, model_track, record_replay, run_fit, write_pages
from .footage import first_clip
from .track import (
    EarlierTracking,
    check_scene,
    input_paths,
    origin_table,
    same_command,
    track_scene,
    write_origin,
)

WRITERS = ("diethrow.replay.recording", "diethrow.replay.pages")
"""Loaded in a thread while frames are tracked: Rerun takes a third of a second."""


def analyze(
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    quality: Quality = STANDARD,
    decimation: Decimation = WHOLE_CLIP,
    intervals: IntervalMethod = "profile",
    shown: Shown = PLAIN,
    timing: Timing = "corrected",
    progress: Progress = silent,
    command: tuple[str, ...] = (),
    tracked: EarlierTracking | None = None,
) -> AnalysedThrow:
    """Everything from clip to replay, written to the folder `out`.

    `decimation` leaves out frames, or makes the pictures smaller; `intervals` says where those of the parameters come
    from; `shown` what is drawn besides; `timing` whether the times of missing and repeated frames are corrected; `command`
    is repeated in the provenance, and left out it is the one that would do the same; `tracked` is what the scene's clips gave
    with these settings, if they were tracked before. Raises SceneError for a scene that cannot be analysed, RunError for a clip
    without a die, InputChangedError if a file has changed meanwhile, OutputExistsError for a folder that exists (unless `force`);
    then no folder is left.
    """
    watch = Stopwatch()
    check_scene(scene)
    paths = input_paths(scene)
    command = command or same_command("analyze", scene, out, quality, decimation, intervals, timing)
    with (
        one_thread(),
        whole_folder(out, force=force, inputs=paths) as folder,
        unchanged_inputs(paths) as inputs,
        loaded_ahead(*WRITERS),
        VideoEncoding(lambda: first_clip(scene, decimation), watch.stage) as encoding,
    ):
        if tracked is None:
            tracking = track_scene(scene, progress, watch, quality, decimation=decimation, timing=timing)
        else:
            tracking = tracked.tracking
            demand_same(tracked.files, inputs.files)
        found = _fitted(scene, tracking, decimation, intervals, progress, watch)
        write_values(folder, found)
        record_replay(folder, found.record, progress, watch, encoding if encoding.available else None)
        write_origin(folder, scene, command, inputs, watch, tracking)
        details = replace(found.details, origin=read_json(folder / "provenance.json"), tables=result_tables(folder))
        write_pages(folder, found.record, details, shown, progress, watch)
    return replace(found, details=details, folder=Path(out), seconds=watch.seconds)


def analysed(
    scene: Scene,
    *,
    quality: Quality = STANDARD,
    decimation: Decimation = WHOLE_CLIP,
    intervals: IntervalMethod = "profile",
    timing: Timing = "corrected",
    progress: Progress = silent,
) -> AnalysedThrow:
    """Everything from clip to fit, written nowhere. Raises as `analyze`."""
    watch = Stopwatch()
    check_scene(scene)
    with one_thread(), unchanged_inputs(input_paths(scene)) as inputs:
        tracking = track_scene(scene, progress, watch, quality, decimation=decimation, timing=timing)
        found = _fitted(scene, tracking, decimation, intervals, progress, watch)
        origin = origin_table(scene, (), inputs, watch, tracking)
    return replace(found, details=replace(found.details, origin=origin), seconds=watch.seconds)


def _fitted(
    scene: Scene,
    tracking: Tracking,
    decimation: Decimation,
    intervals: IntervalMethod,
    progress: Progress,
    watch: Stopwatch,
) -> AnalysedThrow:
    """The analysis of a tracked throw, without its origin."""
    fit = run_fit(tracking.unbiased, tracking.measured, tracking.die, progress, watch, Choices(intervals))
    fit = replace(fit, messages=(*fit.messages, *scene.assumptions))
    record = Record(
        title=scene.name,
        die=tracking.die,
        track=tracking.smoothed,
        measured=tracking.measured,
        fps=rate_hz(tracking.frames),
        clip=tracking.clips[0],
        camera=tracking.cameras[0],
        fit=fit,
        simulated=model_track(fit, tracking.frames),
        estimates=estimate_sequentially(tracking.unbiased, tracking.measured, tracking.die, fit, progress, watch),
        notices=tracking.notices,
    )
    details = ReportDetails(tracking.unbiased, _findings(scene, tracking))
    return AnalysedThrow(record, details, scene, tracking.faces.numbers, decimation)


def _findings(scene: Scene, tracking: Tracking) -> tuple[Finding, ...]:
    """Timing of the first camera's clip; scale, vertical and table height from the flights and bounces of the throw."""
    clip = tracking.clips[0]
    return judge_throw(
        frame_timing(clip, clip.notices, tracking.times),
        fall_of_correlated_frames(tracking.frames, tracking.measured),
        contact_heights(tracking.measured, tracking.die),
        tracking.die,
        scene.clip.exposure_s,
    )
