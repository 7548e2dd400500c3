"""From a clip to a replay: follow the die, find its bounces, fit the model, and write everything down.

Each step is one public function of its stage; this module only carries values from one to the next, keeps the time,
and puts the records into a folder that appears whole or not at all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from .account import account_of
from .executors import one_thread
from .fitting.growing import Estimate, estimates
from .fitting.results import Fit
from .fitting.whole_throw import IntervalMethod, fit_throw
from .model.motion import Throw
from .model.solids import Die
from .model.tables import LEVEL
from .model.tables import Table as ModelTable
from .outputs import ROOM_BYTES, demand_room, whole_folder
from .provenance import Inputs, Stopwatch, add_timings, steady, write_provenance
from .records import (
    covariance_path,
    read_json,
    read_track,
    simulated_track,
    write_bounces,
    write_faces,
    write_fit,
    write_simulated,
    write_track,
    write_vertices,
)
from .replay.account import Account
from .replay.plates import write_figures
from .replay.record import Record
from .replay.recording import write_recording
from .replay.report import write_report
from .scene import ClipSource, Scene, View
from .settings import SceneError, refuse
from .tracking.background import load_background
from .tracking.bounces import NoFlightError, measure
from .tracking.camera import Camera
from .tracking.clip import Clip, clip_files, open_clip
from .tracking.coarser import WHOLE, Coarseness
from .tracking.corners import Corners
from .tracking.faces import FaceNumbers, read_faces, with_numbers
from .tracking.follow import Followed, look_through
from .tracking.gravity import fall_notices, measure_fall
from .tracking.offsets import Offsets
from .tracking.quality import QUALITIES, STANDARD, Quality
from .tracking.rest import flown, frames_in_flight
from .tracking.smooth import smooth
from .tracking.track import ABSENT, LOST, Track

Progress = Callable[[str, int, int], None]
"""Told the name of the stage, what is done and what there is to do; a total of 0 where that is not known."""


class RunError(ValueError):
    """A run whose input is well formed and still gives no result; the text says why."""


@dataclass(frozen=True)
class Shown:
    """What is drawn of a throw besides the recording and the plain report."""

    embed_replay: bool = False
    """The viewer and the recording within the report: some 20 MB more."""
    figures: bool = False
    """Every figure of the report as a file of its own, PNG and SVG."""


PLAIN = Shown()


@dataclass(frozen=True, eq=False)
class Tracking:
    """What the footage says, before any model of an impact."""

    clips: tuple[Clip, ...]
    """One a camera, as they were looked through."""
    cameras: tuple[Camera, ...]
    die: Die
    """The scene's, with its faces in the order of the numbers on them where those could be read."""
    faces: FaceNumbers
    """What could be read on the faces."""
    frames: Track
    """The pose of each frame alone."""
    straight: Track
    """The same with the error that all frames share taken out, and covariances for a fit that takes them for independent."""
    measured: Throw
    smoothed: Track
    """The same frames, with the exact motion of the flights where it holds."""
    offsets: Offsets
    """Of the clocks of several cameras."""
    corners: Corners | None
    """How rounded the die looks; None where the scene says it, or the corners look sharp. `die` has that radius."""

    @property
    def face_numbers(self) -> tuple[int | None, ...]:
        """The number on each face of `die`; None where it could not be read."""
        count = len(self.faces.numbers)
        return tuple(range(1, count + 1)) if self.faces.complete else self.faces.numbers

    @property
    def notices(self) -> tuple[str, ...]:
        """What a careful reader should know of the footage and of the motion in it, one sentence each."""
        return (
            *(n for clip in self.clips for n in clip.notices),
            *self.offsets.notices(1.0 / _rate_hz(self.frames)),
            *((self.corners.notice,) if self.corners is not None else ()),
            *((self.faces.verdict,) if self.die.marks is not None and not self.faces.complete else ()),
            *fall_notices(measure_fall(self.frames, self.measured)),
        )


@dataclass(frozen=True, eq=False)
class Analysis:
    """A whole analysis, as it was written to `folder`."""

    folder: Path
    track: Track
    measured: Throw
    fit: Fit
    notices: tuple[str, ...]
    """What a careful reader should know of the footage, one sentence each."""
    seconds: dict[str, float]
    """Time that each stage took."""


def silent(stage: str, done: int, total: int) -> None:
    """Progress that nobody sees."""


def analyze(
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    quality: Quality = STANDARD,
    coarseness: Coarseness = WHOLE,
    intervals: IntervalMethod = "profile",
    shown: Shown = PLAIN,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> Analysis:
    """Everything from clip to replay, written to the folder `out`.

    `coarseness` leaves out frames, or makes the pictures smaller; `intervals` says where those of the parameters come
    from; `shown` what is drawn besides; `command` is repeated in the provenance, and left out it is the one that would do
    the same. Raises SceneError for a scene that cannot be analysed, RunError for a clip without a die, OutputExistsError
    for a folder that exists (unless `force`); then no folder is left.
    """
    watch = Stopwatch()
    check_scene(scene)
    paths = input_paths(scene)
    with one_thread(), whole_folder(out, force=force, inputs=paths) as folder, steady(paths) as inputs:
        tracking = track_scene(scene, progress, watch, quality, coarseness=coarseness)
        fit = _fit(tracking.straight, tracking.measured, tracking.die, progress, watch, intervals)
        notices = tracking.notices
        write_tracking(folder, scene, tracking)
        simulated = _write_model(folder, fit, tracking.frames)
        record = Record(
            title=scene.path.resolve().parent.name,
            die=tracking.die,
            track=tracking.smoothed,
            measured=tracking.measured,
            fps=_rate_hz(tracking.frames),
            clip=tracking.clips[0],
            camera=tracking.cameras[0],
            fit=fit,
            simulated=simulated if fit.throw else None,
            estimates=_growing(tracking.straight, tracking.measured, tracking.die, fit, progress, watch),
            notices=notices,
        )
        _write_recording(folder, record, progress, watch)
        command = command or _same_command("analyze", scene, out, quality, coarseness, intervals)
        _write_origin(folder, scene, command, inputs, watch, tracking.corners)
        account = account_of(scene, tracking, read_json(folder / "provenance.json"))
        _write_pages(folder, record, account, shown, progress, watch)
    return Analysis(Path(out), tracking.smoothed, tracking.measured, fit, notices, watch.seconds)


def track_only(
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    quality: Quality = STANDARD,
    coarseness: Coarseness = WHOLE,
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> Tracking:
    """The tracking stage alone, written to the folder `out`. Raises as `analyze`."""
    watch = Stopwatch()
    check_scene(scene)
    paths = input_paths(scene)
    with one_thread(), whole_folder(out, force=force, inputs=paths) as folder, steady(paths) as inputs:
        tracking = track_scene(scene, progress, watch, quality, coarseness=coarseness)
        write_tracking(folder, scene, tracking)
        command = command or _same_command("track", scene, out, quality, coarseness)
        _write_origin(folder, scene, command, inputs, watch, tracking.corners)
    return tracking


def fit_track(
    track_path: Path,
    scene: Scene,
    out: Path,
    *,
    force: bool = False,
    intervals: IntervalMethod = "profile",
    progress: Progress = silent,
    command: tuple[str, ...] = (),
) -> Analysis:
    """The fitting stage alone, on a track from anywhere; the scene gives the die and the table. Raises as `analyze`."""
    watch = Stopwatch()
    table, die = scene.table.in_model, scene.given_die()
    frames = read_track(track_path)
    paths = (scene.path, track_path, *_if_there(covariance_path(track_path)))
    with one_thread(), whole_folder(out, force=force, inputs=paths) as folder, steady(paths) as inputs:
        frames, measured, smoothed = _bounces(frames, track_path, die, None, progress, watch)
        fit = _fit(frames, measured, die, progress, watch, intervals, table)
        write_vertices(folder / "vertices.csv", die.solid)
        write_bounces(folder / "bounces.csv", measured.impacts)
        simulated = _write_model(folder, fit, frames)
        record = Record(
            title=track_path.stem,
            die=die,
            track=smoothed,
            measured=measured,
            fps=_rate_hz(frames),
            fit=fit,
            simulated=simulated if fit.throw else None,
            estimates=_growing(frames, measured, die, fit, progress, watch, table),
            notices=smoothed_notices(track_path),
        )
        _write_recording(folder, record, progress, watch)
        _write_origin(folder, scene, command, inputs, watch)
        account = Account(frames=frames, origin=read_json(folder / "provenance.json"))
        _write_pages(folder, record, account, PLAIN, progress, watch)
    return Analysis(Path(out), smoothed, measured, fit, smoothed_notices(track_path), watch.seconds)


def smoothed_notices(track_path: Path) -> tuple[str, ...]:
    """A sentence where the track is a smoothed one, and one of independent frames lies beside it."""
    independent = track_path.with_name("track_frames.csv")
    if track_path.name != "track.csv" or not independent.exists():
        return ()
    return (
        f"{track_path} is smoothed, so its errors go together and the intervals come out too narrow; "
        f"fit {independent.name} beside it.",
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
    coarseness: Coarseness = WHOLE,
) -> Tracking:
    """Follow the die through the footage of a scene, find its bounces, and smooth its flights.

    `clips`, one a camera, stand for the footage that the scene names. Raises SceneError for footage that does not fit the
    scene, RunError where no die is found.
    """
    watch = watch or Stopwatch()
    views = scene.views()
    with watch.stage("open"):
        clips = [open_footage(scene, view) for view in views] if clips is None else clips
        backgrounds = [_background(scene, view, clip) for view, clip in zip(views, clips, strict=True)]
    cameras = tuple(view.camera for view in views)
    if not coarseness.is_whole:
        scene, clips, backgrounds, cameras = _coarser(scene, clips, backgrounds, coarseness)
    try:
        with watch.stage("track"):
            progress("Following the die", 0, len(clips[0]))
            followed = _follow(scene, clips, cameras, backgrounds, quality, progress)
        faces = read_faces(followed.die, followed.marks)
        die = with_numbers(followed.die, faces)
        frames = replace(followed.track, frame=coarseness.numbers(followed.track.frame))
        straight, measured, smoothed = _bounces(frames, scene.path, die, cameras[0], progress, watch)
    except RunError as error:
        # A clip that is cut off may be why nothing is found in it.
        for notice in (notice for clip in clips for notice in clip.notices):
            error.add_note(notice)
        raise
    return Tracking(
        tuple(clips), cameras, die, faces, frames, straight, measured, smoothed, followed.offsets, followed.corners
    )


def open_footage(scene: Scene, view: View) -> Clip:
    """The clip of a view. Raises SceneError where it cannot be read, or its frames are not the camera's."""
    source: ClipSource = scene.clip
    assert view.path is not None, "views() demands paths"
    try:
        clip = open_clip(view.path, fps=source.fps, frame_range=source.frame_range)
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: clip.path = {view.path.name}: {error}") from error
    camera = view.camera
    if (clip.width_px, clip.height_px) != (camera.width_px, camera.height_px):
        wanted = f"the frames of {view.path.name} have {clip.width_px} × {clip.height_px} px; wanted their own camera"
        raise refuse(scene.path, "camera.width and camera.height", [camera.width_px, camera.height_px], wanted)
    return clip


def input_paths(scene: Scene) -> tuple[Path, ...]:
    """Every file that an analysis of this scene reads."""
    clips = [file for view in scene.cameras if view.path is not None for file in clip_files(view.path)]
    backgrounds = [view.background_path for view in scene.cameras if view.background_path is not None]
    return tuple(dict.fromkeys((scene.path, *clips, *backgrounds)))


def write_tracking(folder: Path, scene: Scene, tracking: Tracking) -> None:
    """The files of the tracking stage."""
    write_vertices(folder / "vertices.csv", scene.die.solid)
    write_track(folder / "track.csv", tracking.smoothed)
    write_track(folder / "track_frames.csv", tracking.straight)
    write_bounces(folder / "bounces.csv", tracking.measured.impacts)
    write_faces(folder / "faces.csv", tracking.die.solid, tracking.face_numbers)


def _background(scene: Scene, view: View, clip: Clip) -> NDArray[np.float32] | None:
    if view.background_path is None:
        return None
    try:
        return load_background(view.background_path, clip)
    except (ValueError, OSError) as error:
        raise SceneError(f"{scene.path}: clip.background = {view.background_path.name}: {error}") from error


def _coarser(
    scene: Scene,
    clips: Sequence[Clip],
    backgrounds: Sequence[NDArray[np.float32] | None],
    coarseness: Coarseness,
) -> tuple[Scene, list[Clip], list[NDArray[np.float32] | None], tuple[Camera, ...]]:
    """Everything that a scene says of its footage, for the part of it that is used."""
    if scene.start is not None:
        wanted = "a first pose by hand goes with the whole clip: leave out [start], or use every frame at its own size"
        raise refuse(scene.path, "start.frame", scene.start.frame, wanted)
    first = clips[0].first_frame
    source = replace(scene.clip, excluded=coarseness.rows(first, scene.clip.excluded))
    try:
        fewer = [coarseness.clip(clip) for clip in clips]
    except ValueError as error:
        raise SceneError(f"{scene.path}: {error}") from error
    smaller = [None if picture is None else coarseness.picture(picture) for picture in backgrounds]
    cameras = tuple(coarseness.camera(view.camera) for view in scene.views())
    return replace(scene, clip=source), fewer, smaller, cameras


def _follow(
    scene: Scene,
    clips: Sequence[Clip],
    cameras: Sequence[Camera],
    backgrounds: Sequence[NDArray[np.float32] | None],
    quality: Quality,
    progress: Progress,
) -> Followed:
    try:
        return look_through(
            clips,
            cameras,
            scene.die,
            background=backgrounds,
            exposure_s=scene.clip.exposure_s,
            mirror=scene.table.surface == "mirror",
            start=scene.start,
            excluded=scene.clip.excluded,
            rounding=scene.rounding,
            quality=quality,
            progress=lambda done, total: progress("Following the die", done, total),
        )
    except (ValueError, OSError) as error:
        raise RunError(f"{scene.path}: {error}") from error


def _bounces(
    frames: Track, source: Path, die: Die, camera: Camera | None, progress: Progress, watch: Stopwatch
) -> tuple[Track, Throw, Track]:
    """The frames without the error that they share, the flights that they show, and all with those in flight smoothed."""
    _demand_a_die(frames, source, die)
    with watch.stage("bounces"):
        progress("Finding the bounces", 0, 0)
        try:
            found = measure(frames, die, camera)
        except NoFlightError as error:
            raise RunError(f"{source}: {error}") from error
        return found.independent, flown(found.throw), smooth(found.on_table, found.own, found.floor, found.alone)


def _demand_a_die(frames: Track, source: Path, die: Die) -> None:
    """Raises RunError where there is no pose at all, with the likely reason."""
    absent, lost = int((frames.status == ABSENT).sum()), int((frames.status == LOST).sum())
    if absent == len(frames):
        raise RunError(
            f"{source}: no die was found in any frame (absent in all {absent}); "
            "look whether the clip shows a throw, and whether the background is the scene without the die"
        )
    if absent + lost == len(frames):
        raise RunError(
            f"{source}: something moves, but no frame shows a {die.solid.name} of this size "
            f"(lost in {lost} frames, absent in {absent}); look whether [die] and [camera] belong to this clip"
        )


def _fit(
    frames: Track,
    measured: Throw,
    die: Die,
    progress: Progress,
    watch: Stopwatch,
    intervals: IntervalMethod,
    table: ModelTable = LEVEL,
) -> Fit:
    with watch.stage("fit"):
        progress("Fitting the model", 0, 0)
        return fit_throw(frames_in_flight(frames, measured), measured, die, table, intervals)


def _growing(
    frames: Track,
    measured: Throw,
    die: Die,
    fit: Fit,
    progress: Progress,
    watch: Stopwatch,
    table: ModelTable = LEVEL,
) -> tuple[Estimate, ...]:
    with watch.stage("estimates"):
        progress("Bounce by bounce", 0, 0)
        return estimates(frames_in_flight(frames, measured), measured, die, fit, table)


def _write_model(folder: Path, fit: Fit, frames: Track) -> Track:
    """fit.json and simulated.csv; without a fitted throw the latter has its rows and no numbers."""
    write_fit(folder / "fit.json", fit)
    if fit.throw is not None:
        simulated = simulated_track(fit.throw, frames.frame, frames.time_s)
    else:
        n = len(frames)
        nothing = np.full((n, 3), np.nan), np.full((n, 4), np.nan), np.full((n, 6, 6), np.nan)
        simulated = Track(frames.frame, frames.time_s, *nothing, np.full(n, ABSENT))
    write_simulated(folder / "simulated.csv", simulated)
    return simulated


def _write_recording(folder: Path, record: Record, progress: Progress, watch: Stopwatch) -> None:
    demand_room(folder, _replay_bytes(record))
    with watch.stage("replay"):
        progress("Writing the replay", 0, 0)
        write_recording(folder / "replay.rrd", record)


def _write_pages(
    folder: Path, record: Record, account: Account, shown: Shown, progress: Progress, watch: Stopwatch
) -> None:
    """The report, which tells the provenance, and the figures; then their time goes into the provenance, too."""
    with watch.stage("report"):
        progress("Writing the report", 0, 0)
        replay = folder / "replay.rrd" if shown.embed_replay else None
        write_report(folder / "report.html", record, account, replay)
        if shown.figures:
            write_figures(folder / "figures", record, account)
    add_timings(folder / "provenance.json", watch.seconds)


def _replay_bytes(record: Record) -> int:
    """More than a recording and a report take: 2 kB a frame beside the film, and a twentieth of its pixels."""
    film = record.clip.width_px * record.clip.height_px * len(record.clip) // 20 if record.clip is not None else 0
    return ROOM_BYTES + 2048 * len(record.track) + film


def _same_command(
    name: str,
    scene: Scene,
    out: Path,
    quality: Quality,
    coarseness: Coarseness,
    intervals: IntervalMethod = "profile",
) -> tuple[str, ...]:
    """The command line that does the same; empty for a quality that has no name there."""
    if quality not in QUALITIES.values():
        return ()
    less = ("--every", str(coarseness.every), "--shrink", str(coarseness.shrink)) if not coarseness.is_whole else ()
    other = ("--intervals", intervals) if intervals != "profile" else ()
    start = ("diethrow", name, str(scene.path), "--out", str(out), "--allow-outside")
    return (*start, "--quality", quality.name, *less, *other)


def _write_origin(
    folder: Path,
    scene: Scene,
    command: tuple[str, ...],
    inputs: Inputs,
    watch: Stopwatch,
    corners: Corners | None = None,
) -> None:
    found = {} if corners is None else {"corner_radius_m": corners.radius_m, "sigma_corner_radius_m": corners.sigma_m}
    write_provenance(
        folder / "provenance.json",
        command=command,
        understood=scene,
        inputs=inputs,
        seconds=watch.seconds,
        found=found,
    )


def _rate_hz(track: Track) -> float:
    """Frames a second of the clock of the track, whatever it came from."""
    steps = np.diff(track.time_s) / np.maximum(np.diff(track.frame), 1)
    return 1.0 / float(np.median(steps))


def _if_there(path: Path) -> tuple[Path, ...]:
    return (path,) if path.exists() else ()
