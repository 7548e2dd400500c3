"""The fitting stage: a track fitted by the model, and the parts of `analyze` that follow tracking."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ...executors import one_thread
from ...files.analysis_folder import AnalysedThrow, result_tables, write_values
from ...files.csv_and_json import read_json
from ...files.measured_throw import read_measured_throw, throw_path
from ...files.outputs import MIN_FREE_BYTES, check_free_space, whole_folder
from ...files.provenance import Stopwatch, add_timings, unchanged_inputs
from ...files.scene import Scene
from ...files.throw_records import covariance_path, read_track, simulated_track
from ...fitting.predict import Estimate, sequential_estimates
from ...fitting.results import USUAL_CHOICES, Choices, Fit, IntervalMethod
from ...fitting.throw import fit_throw
from ...model.die import Die
from ...model.laws import Table as ModelTable
from ...model.throw import Throw, turning_of
from ...replay.elements import Record, ReportDetails, VideoEncoding
from ...runs import PLAIN, Progress, Shown, rate_hz, silent
from ...tracking.footage import WHOLE_CLIP
from ...tracking.throw import frames_in_flight, smooth
from ...tracking.track import Track
from .track import FoundThrow, find_impacts, if_there, smoothed_notices, write_origin


def fit_track(
    track_path: Path,
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    choices: Choices = USUAL_CHOICES,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> AnalysedThrow:
    """The fitting stage alone, on a track from anywhere; the scene gives the die and the table. With what tracking wrote beside
    the track (`files.measured_throw`) the result is that of `analyze`. Raises as `analyze`."""
    watch = Stopwatch()
    table = scene.table.in_model
    frames = read_track(track_path, table.gravity_m_s2, turning_of(scene.die))
    paths = (
        *scene.settings_paths,
        track_path,
        *if_there(covariance_path(track_path)),
        *if_there(throw_path(track_path)),
    )
    with one_thread(), whole_folder(out, force=force, inputs=paths) as folder, unchanged_inputs(paths) as inputs:
        tracked = read_measured_throw(track_path, frames, scene.die, scene.rounding)
        die = scene.given_die() if tracked is None else tracked.die
        numbers = (None,) * len(die.solid.faces) if tracked is None else tracked.face_numbers
        if tracked is None:
            found = find_impacts(frames, track_path, die, None, progress, watch)
        else:
            found = FoundThrow(tracked.frames, tracked.throw, smooth(tracked.frames, tracked.throw), ())
        frames, measured, notices = found.independent, found.throw, (*smoothed_notices(track_path), *found.doubts)
        fit = run_fit(frames, measured, die, progress, watch, choices, table)
        if tracked is not None:
            fit = replace(fit, messages=(*fit.messages, *scene.assumptions))
        record = Record(
            title=scene.title or _name_of(track_path),
            die=die,
            track=found.smoothed,
            measured=measured,
            fps=rate_hz(frames),
            fit=fit,
            simulated=model_track(fit, frames),
            estimates=estimate_sequentially(frames, measured, die, fit, progress, watch, table),
            notices=notices,
        )
        analysis = AnalysedThrow(record, ReportDetails(frames), scene, numbers, WHOLE_CLIP, Path(out), watch.seconds)
        write_values(folder, analysis)
        record_replay(folder, record, progress, watch)
        write_origin(folder, scene, command, inputs, watch)
        account = replace(analysis.details, origin=read_json(folder / "provenance.json"), tables=result_tables(folder))
        write_pages(folder, record, account, PLAIN, progress, watch)
    return replace(analysis, details=account)


def run_fit(
    frames: Track,
    measured: Throw,
    die: Die,
    progress: Progress,
    watch: Stopwatch,
    choices: Choices = USUAL_CHOICES,
    table: ModelTable | None = None,
) -> Fit:
    """The fit of a track whose flights are measured."""
    with watch.stage("fit"):
        progress("Fitting the model", 0, 0)
        return fit_throw(frames_in_flight(frames, measured), measured, die, table, choices)


def estimate_sequentially(
    frames: Track,
    measured: Throw,
    die: Die,
    fit: Fit,
    progress: Progress,
    watch: Stopwatch,
    table: ModelTable | None = None,
) -> tuple[Estimate, ...]:
    """The estimates from the frames up to each bounce."""
    with watch.stage("estimates"):
        progress("Bounce by bounce", 0, 0)
        return sequential_estimates(frames_in_flight(frames, measured), measured, die, fit, table)


def model_track(fit: Fit, frames: Track) -> Track | None:
    """The model's poses on the frames of a track; None without a fitted throw."""
    return None if fit.throw is None else simulated_track(fit.throw, frames.frame, frames.time_s)


def refitted(analysis: AnalysedThrow, effects: tuple[str, ...] | None, intervals: IntervalMethod) -> AnalysedThrow:
    """An analysis with another fit of the same measured throw. Raises ValueError for a name that is no effect."""
    record, frames, watch = analysis.record, analysis.details.frames, Stopwatch()
    assert frames is not None
    table = analysis.scene.table.in_model
    choices = Choices(intervals, effects=effects)
    with one_thread():
        fit = run_fit(frames, record.measured, record.die, silent, watch, choices, table)
        # A track from elsewhere knows nothing of what the scene assumes.
        assumptions = [one for one in analysis.scene.assumptions if one in analysis.result.messages]
        fit = replace(fit, messages=(*fit.messages, *assumptions))
        estimates = estimate_sequentially(frames, record.measured, record.die, fit, silent, watch, table)
    record = replace(record, fit=fit, simulated=model_track(fit, record.track), estimates=estimates)
    # The tables that it was loaded with are those of the other fit.
    details = replace(analysis.details, tables={})
    return replace(analysis, record=record, details=details, folder=None, seconds=watch.seconds)


def _name_of(track_path: Path) -> str:
    """The name of the track, or that of the folder of results that it lies in."""
    return track_path.resolve().parent.name if track_path.stem in ("track", "track_frames") else track_path.stem


def record_replay(
    folder: Path, record: Record, progress: Progress, watch: Stopwatch, encoding: VideoEncoding | None = None
) -> None:
    """Write replay.rrd, if there is room for it; `encoding` is the video of the record's clip, if it was begun before."""
    from ...replay.recording import write_recording  # Rerun, which takes a third of a second to load

    check_free_space(folder, replay_bytes(record))
    with watch.stage("replay"):
        progress("Writing the replay", 0, 0)
        write_recording(folder / "replay.rrd", record, encoding)


def write_pages(
    folder: Path, record: Record, account: ReportDetails, shown: Shown, progress: Progress, watch: Stopwatch
) -> None:
    """Write the report, with the provenance, and the figures; then add their time to the provenance."""
    from ...replay.pages import write_figures, write_report

    with watch.stage("report"):
        progress("Writing the report", 0, 0)
        replay = folder / "replay.rrd" if shown.embed_replay else None
        write_report(folder / "report.html", record, account, replay)
        if shown.figures:
            write_figures(folder / "figures", record, account)
    add_timings(folder / "provenance.json", watch)


def replay_bytes(record: Record) -> int:
    """An upper limit of a recording and a report: 2 kB a frame beside the film, and a twentieth of its pixels."""
    film = record.clip.width_px * record.clip.height_px * len(record.clip) // 20 if record.clip is not None else 0
    return MIN_FREE_BYTES + 2048 * len(record.track) + film
