"""One recording for one throw: experiment and model on the same two timelines, `frame` and `t`.

    world                                 metres, z up
      table                               the plane z = 0 with a grid of 10 mm
      camera                              pose and pinhole of the camera
        image                             the film
          silhouette, edges, corners      /measured and /simulated, projected through the lens
      measured, simulated
        die                               the pose, with its mesh and edges
        trail                             where every corner has just been
        impacts                           contact points on the table
    plots                                 height, spin, energy, residual, chi
    events, phase                         bounces; flights, and what tracking knows
    report/estimate                       the findings in words

Times are whole nanoseconds: seconds as floats would be cut off, and miss their frame by one. A bounce stands on `t` at
its own instant, and on `frame` at the first frame that shows it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike, NDArray
from rerun.error_utils import strict_mode

from ..model.contact import Held
from ..model.motion import Impact, Throw
from ..model.solids import Die, Solid
from ..tracking.camera import Camera
from ..tracking.clip import Clip
from ..tracking.track import ABSENT, LOST, TRACKED, Track
from .blueprint import Shown, blueprint
from .outline import Outline, outlines
from .palette import AXIS_COLOURS, COLOURS, GRID, IMPACT, MEASURED, SIMULATED, TABLE, Colour, mixed
from .record import Motion, Record, motion_of, motions_of, residuals, track_of
from .video import can_encode_av1, display_window, encode_av1, encode_jpegs
from .words import bounce_sentence, markdown, number

if TYPE_CHECKING:
    from ..fitting.results import Parameter

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

WHITE: Colour = (255, 255, 255)
BLACK: Colour = (0, 0, 0)
GRID_M = 0.01
"""Spacing of the lines on the table."""


@dataclass(frozen=True, eq=False)
class Clock:
    """The frames of the recording and their times."""

    frame: Integers
    """(n,) increasing."""
    time_s: Array
    """(n,)."""

    def frame_of(self, times_s: ArrayLike) -> Integers:
        """The first frame at or after each instant (k,); the last frame for what comes later."""
        after = np.searchsorted(self.time_s, np.asarray(times_s, float))
        return np.asarray(self.frame[np.minimum(after, len(self.frame) - 1)])


def write_recording(path: Path, record: Record) -> None:
    """Write the throw as a Rerun recording with its views, to be opened by `rerun PATH`.

    What the record lacks (clip, camera, fit, poses of some frames) is absent from the recording, and no pose stands
    on a frame where it is not known. Raises OSError where the file cannot be written.
    """
    motions = motions_of(record)
    clock = Clock(record.track.frame, record.track.time_s)
    stage = _stage(record.die.solid, motions, record.camera)
    shown = _shown(
        stage,
        motions,
        record.fps,
        picture_px=(record.clip.width_px, record.clip.height_px) if record.clip is not None else None,
        residuals=record.simulated is not None,
        chi=_knows_chi(record.measured.impacts) or _fitted_chi(record) is not None,
        bounces=bool(record.measured.impacts),
    )
    with _recording(path, record.title, shown) as recording:
        _send_properties(recording, record)
        _send_table(recording, stage)
        display = _send_footage(recording, record)
        for motion in motions:
            _send_motion(recording, record.die.solid, motion, clock)
            if record.camera is not None:
                _send_overlay(recording, record.die.solid, record.camera, motion)
        _send_status(recording, record.track)
        _send_residuals(recording, record)
        _send_chi(recording, record, clock)
        _send_text(recording, markdown(record, display))


def write_throw_recording(path: Path, die: Die, throw: Throw, fps: float, title: str) -> None:
    """Write a modelled throw alone, with poses on the frames of a camera at `fps` [Hz].

    Raises ValueError where fps is not positive, and OSError where the file cannot be written.
    """
    track = track_of(throw, fps)
    motion = motion_of("simulated", track, throw)
    clock = Clock(track.frame, track.time_s)
    stage = _stage(die.solid, [motion], None)
    shown = _shown(stage, [motion], fps, bounces=bool(throw.bounces), chi=_knows_chi(throw.bounces))
    with _recording(path, title, shown) as recording:
        _send_table(recording, stage)
        _send_motion(recording, die.solid, motion, clock)
        _send_bounce_chi(recording, motion, clock)
        lines = [f"- {bounce_sentence(k, impact)}" for k, impact in enumerate(throw.bounces, 1)]
        _send_text(recording, "\n".join([f"# {title}", "", *(lines or ["No bounce."])]))


@contextmanager
def _recording(path: Path, title: str, shown: Shown) -> Iterator[rr.RecordingStream]:
    """A stream into `path` that raises on bad calls instead of warning, and leaves no torso behind."""
    if not path.parent.is_dir():
        raise FileNotFoundError(f"{path.parent} is not a folder: make it before the recording {path.name} is written")
    was_strict = strict_mode()
    rr.set_strict_mode(True)
    recording = rr.RecordingStream("diethrow")
    try:
        recording.set_log_time_enabled(False)
        recording.save(path, default_blueprint=blueprint(shown))
        recording.send_recording_name(title)
        recording.log("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        yield recording
        recording.flush()
        recording.disconnect()
    except BaseException:
        recording.disconnect()
        path.unlink(missing_ok=True)
        raise
    finally:
        rr.set_strict_mode(was_strict)


@dataclass(frozen=True, eq=False)
class Stage:
    """The box that holds the throw, and from where it is looked at."""

    low_m: Array
    """(3,) lowest corner; on the table."""
    high_m: Array
    """(3,) highest corner."""
    eye_m: Array
    """(3,)."""
    frames: tuple[int, int]
    """First and last frame with a pose."""


def _stage(solid: Solid, motions: Sequence[Motion], camera: Camera | None) -> Stage:
    """The box of the first motion that has poses: the model's may go on far beyond what was seen."""
    shown = next((motion for motion in motions if len(motion.frame)), None)
    if shown is None:
        low, high, frames = np.full(3, -0.05), np.full(3, 0.05), (0, 1)
    else:
        corners = shown.corners_m(solid)
        low, high = corners.min((0, 1)), corners.max((0, 1))
        frames = int(shown.frame[0]), int(shown.frame[-1])
    low[2] = 0.0
    target = 0.5 * (low + high)
    # Without a camera from the front, a little from the right and above; with one, from its side of the table.
    direction = camera.centre_m - target if camera is not None else np.array([0.35, -0.85, 0.45])
    eye = target + direction / np.linalg.norm(direction) * 0.95 * float(np.linalg.norm(high - low))
    return Stage(low, high, eye, frames)


def _shown(
    stage: Stage,
    motions: Sequence[Motion],
    fps: float,
    *,
    picture_px: tuple[int, int] | None = None,
    residuals: bool = False,
    chi: bool = False,
    bounces: bool = False,
) -> Shown:
    return Shown(
        tuple(motion.name for motion in motions),
        fps,
        stage.eye_m,
        0.5 * (stage.low_m + stage.high_m),
        stage.frames,
        1e3 * float(stage.high_m[2]),
        picture_px,
        residuals,
        chi,
        bounces,
    )


def _fitted_chi(record: Record) -> Parameter | None:
    """The fitted restitution where the fit determined one."""
    chi = record.fit.parameters.get("chi") if record.fit is not None else None
    return chi if chi is not None and chi.value is not None else None


def _knows_chi(impacts: Sequence[Impact]) -> bool:
    return any(np.isfinite(impact.chi) for impact in impacts)


def _nanoseconds(times_s: ArrayLike) -> NDArray[np.timedelta64]:
    return np.rint(np.asarray(times_s, float) * 1e9).astype(np.int64).astype("timedelta64[ns]")


def _indexes(frame: Integers, time_s: Array) -> list[rr.TimeColumn]:
    """Both timelines for rows that stand on frames."""
    return [rr.TimeColumn("frame", sequence=frame), rr.TimeColumn("t", duration=_nanoseconds(time_s))]


def _send_instants(
    recording: rr.RecordingStream, entity: str, times_s: ArrayLike, clock: Clock, columns: rr.ComponentColumnList
) -> None:
    """Rows at instants between frames: exact on `t`, at the first frame that shows them on `frame`."""
    times = np.asarray(times_s, float)
    if len(times):
        recording.send_columns(entity, [rr.TimeColumn("t", duration=_nanoseconds(times))], columns)
        recording.send_columns(entity, [rr.TimeColumn("frame", sequence=clock.frame_of(times))], columns)


def _send_properties(recording: rr.RecordingStream, record: Record) -> None:
    chi = _fitted_chi(record)
    known = {
        "chi": chi.value if chi is not None else None,
        "bounces": len(record.measured.impacts),
        "frames": len(record.track),
        "fps_hz": record.fps,
    }
    recording.send_property(
        "throw", rr.AnyValues(**{name: value for name, value in known.items() if value is not None})
    )


def _send_text(recording: rr.RecordingStream, text: str) -> None:
    recording.log("report/estimate", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)


# The table and the camera's picture


def _send_table(recording: rr.RecordingStream, stage: Stage) -> None:
    """A square round the throw with lines every 10 mm, just below z = 0: a face that lies on it stays in front."""
    middle = np.round(0.5 * (stage.low_m + stage.high_m)[:2] / GRID_M) * GRID_M
    half = GRID_M * np.ceil((0.5 * float((stage.high_m - stage.low_m)[:2].max()) + 0.01) / GRID_M)
    ticks = np.arange(-half, half + 0.5 * GRID_M, GRID_M)
    corners = [(x, y, -5e-5) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
    plane = np.add(corners, [*middle, 0.0])
    recording.log(
        "world/table/plane",
        rr.Mesh3D(vertex_positions=plane, triangle_indices=[(0, 1, 2), (0, 2, 3)], vertex_colors=[TABLE] * 4),
        static=True,
    )
    across = [[(-half, tick, 0.0), (half, tick, 0.0)] for tick in ticks]
    along = [[(tick, -half, 0.0), (tick, half, 0.0)] for tick in ticks]
    lines = np.add(across + along, [*middle, 0.0])
    recording.log("world/table/grid", rr.LineStrips3D(lines, radii=-0.4, colors=[GRID]), static=True)


def _send_footage(recording: rr.RecordingStream, record: Record) -> tuple[str, ...]:
    """The camera and its film, where there are any; what a reader should know of the picture."""
    if record.camera is not None:
        _send_camera(recording, record.camera)
    if record.clip is None:
        return ("There is no film in this recording.",)
    return _send_film(recording, record.clip)


def _send_camera(recording: rr.RecordingStream, camera: Camera) -> None:
    recording.log("world/camera", rr.Transform3D(translation=camera.centre_m, mat3x3=camera.rotation.T), static=True)
    recording.log(
        "world/camera",
        rr.Pinhole(
            image_from_camera=np.add(camera.matrix, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]),
            resolution=(camera.width_px, camera.height_px),
            camera_xyz=rr.ViewCoordinates.RDF,
            image_plane_distance=0.1 * float(np.linalg.norm(camera.centre_m)),
            color=IMPACT,
        ),
        static=True,
    )


def _send_film(recording: rr.RecordingStream, clip: Clip) -> tuple[str, ...]:
    """The clip as AV1, or as JPEGs where this FFmpeg has no encoder for it."""
    window = display_window(clip)
    entity, frames = "world/camera/image", clip.first_frame + np.arange(len(clip), dtype=np.int64)
    said = []
    if clip.bit_depth > 8:
        levels = f"{window.black:.0f} to {window.white:.0f}"
        said.append(f"The film shows grey levels {levels} of {clip.bit_depth} bits as black to white.")
    if can_encode_av1():
        film = rr.AssetVideo(contents=encode_av1(clip, window), media_type="video/mp4")
        stamps = film.read_frame_timestamps_nanos()
        assert len(stamps) == len(clip), f"{len(stamps)} frames in the film of {len(clip)}"
        recording.log(entity, film, static=True)
        recording.send_columns(entity, _indexes(frames, clip.times_s), rr.VideoFrameReference.columns_nanos(stamps))
    else:
        said.append("The film is stored as JPEG pictures, because no AV1 encoder was found.")
        for number_, picture in enumerate(encode_jpegs(clip, window)):
            row = _indexes(frames[number_ : number_ + 1], clip.times_s[number_ : number_ + 1])
            recording.send_columns(entity, row, rr.EncodedImage.columns(blob=[picture], media_type=["image/jpeg"]))
    return tuple(said)


# One motion: the die, its trail, its plots and its bounces


def _send_motion(recording: rr.RecordingStream, solid: Solid, motion: Motion, clock: Clock) -> None:
    if len(motion.frame):
        _send_die(recording, solid, motion)
        _send_trail(recording, solid, motion)
        _send_heights(recording, solid, motion)
    if motion.throw is not None:
        _send_spin_and_energy(recording, motion, motion.throw, clock)
        _send_bounces(recording, motion, motion.throw, clock)


def _send_die(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """Poses, and the die itself from the first frame of each run of known poses until the first frame without one.

    The mesh is not static: static data cannot be cleared, and a die would stand at its last place while it is lost.
    """
    entity = f"world/{motion.name}/die"
    poses = rr.Transform3D.columns(translation=motion.position_m, quaternion=np.roll(motion.quaternion, -1, axis=1))
    recording.send_columns(entity, _indexes(motion.frame, motion.time_s), poses)
    colour = COLOURS[motion.name]
    edges = rr.LineStrips3D(solid.vertices[solid.edges], radii=-0.9, colors=[mixed(colour, WHITE, 0.35)])
    for run in motion.runs:
        begin = slice(run.start, run.start + 1)
        recording.set_time("frame", sequence=int(motion.frame[begin][0]))
        recording.set_time("t", duration=_nanoseconds(motion.time_s[begin])[0])
        recording.log(entity, _mesh(solid, colour))
        recording.log(f"{entity}/edges", edges)
    recording.reset_time()
    _send_clears(recording, entity, motion)


def _mesh(solid: Solid, colour: Colour) -> rr.Mesh3D:
    """Flat faces, each in its own tint, so that the eye can follow which face is which."""
    positions: list[Array] = []
    normals: list[Array] = []
    tints: list[Colour] = []
    triangles: list[tuple[int, int, int]] = []
    for number_, (face, normal) in enumerate(zip(solid.faces, solid.normals, strict=True)):
        first = len(positions)
        positions += [solid.vertices[v] for v in face]
        normals += [normal] * len(face)
        tints += [mixed(colour, WHITE, 0.6 * number_ / (len(solid.faces) - 1))] * len(face)
        triangles += [(first, first + j, first + j + 1) for j in range(1, len(face) - 1)]
    return rr.Mesh3D(
        vertex_positions=positions, vertex_normals=normals, vertex_colors=tints, triangle_indices=triangles
    )


def _send_clears(recording: rr.RecordingStream, entity: str, motion: Motion) -> None:
    """Empty the entity and all below it on every frame without a pose."""
    if len(motion.gone_frame):
        gone = rr.Clear.columns(is_recursive=[True] * len(motion.gone_frame))
        recording.send_columns(entity, _indexes(motion.gone_frame, motion.gone_time_s), gone)


def _send_trail(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """The way of every corner from the frame before; the views join the last of these."""
    corners = motion.corners_m(solid)
    colour = mixed(COLOURS[motion.name], BLACK, 0.25)
    for run in motion.runs:
        steps = np.stack([corners[run][:-1], corners[run][1:]], axis=2)
        if not len(steps):
            continue
        count = np.full(len(steps), len(solid.vertices))
        strips = rr.LineStrips3D.columns(
            strips=steps.reshape(-1, 2, 3), radii=np.full(count.sum(), -0.5), colors=[colour] * int(count.sum())
        ).partition(count)
        rows = slice(run.start + 1, run.stop)
        recording.send_columns(f"world/{motion.name}/trail", _indexes(motion.frame[rows], motion.time_s[rows]), strips)


def _send_heights(recording: rr.RecordingStream, solid: Solid, motion: Motion) -> None:
    """One series a corner: dots for what was measured, lines for the model."""
    entity, count = f"plots/height/{motion.name}", len(solid.vertices)
    colours = [COLOURS[motion.name]] * count
    names = [f"{motion.name} corner {k}" for k in range(count)]
    if motion.name == "measured":
        style = rr.SeriesPoints(colors=colours, names=names, markers=["circle"] * count, marker_sizes=[1.5] * count)
    else:
        style = rr.SeriesLines(colors=colours, names=names, widths=[1.0] * count)
    recording.log(entity, style, static=True)
    _send_series(recording, entity, motion, 1e3 * motion.corners_m(solid)[:, :, 2])


def _send_series(recording: rr.RecordingStream, entity: str, motion: Motion, values: Array) -> None:
    """Values (n, series) on the frames of a motion, broken where the pose is not known."""
    columns = rr.Scalars.columns(scalars=values.ravel()).partition(np.full(len(values), values.shape[1]))
    recording.send_columns(entity, _indexes(motion.frame, motion.time_s), columns)
    _send_clears(recording, entity, motion)


def _send_spin_and_energy(recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock) -> None:
    """Both are constant in flight and jump at a bounce: steps."""
    begins = _flight_begins(throw, clock)
    speeds = np.array([np.linalg.norm(flight.start.omega_rad_s) for flight in throw.flights])
    _send_steps(recording, f"plots/spin/{motion.name}", motion.name, begins, speeds, clock)
    if throw.impacts:
        energies = [throw.impacts[0].energy_before_J, *(impact.energy_after_J for impact in throw.impacts)]
        _send_steps(recording, f"plots/energy/{motion.name}", motion.name, begins, 1e3 * np.array(energies), clock)


def _stretches(throw: Throw) -> list[str]:
    """A name for every stretch between two events: the flights in their order, and what is held on the table."""
    names, flown = [], 0
    for flight in throw.flights:
        if isinstance(flight, Held):
            kinds = {1: "on vertex", 2: "on edge"}
            names.append(" ".join([kinds.get(len(flight.vertices), "on face"), *map(str, flight.vertices)]))
        else:
            flown += 1
            names.append(f"flight {flown}")
    return names


def _flight_begins(throw: Throw, clock: Clock) -> Array:
    """When each flight begins; the first not before the recording does."""
    first = max(float(clock.time_s[0]), throw.flights[0].start.time_s)
    times = [impact.time_s for impact in throw.impacts]
    return np.array([min([first, *times]), *times])


def _send_steps(
    recording: rr.RecordingStream, entity: str, name: str, begins_s: Array, values: Array, clock: Clock
) -> None:
    """Values that hold from each instant to the next, the last one to the end; what is not known is left out."""
    known = np.isfinite(values)
    if not known.any():
        return
    instants = np.append(begins_s[known], max(clock.time_s[-1], begins_s[-1]))
    style = rr.SeriesLines(
        colors=COLOURS[name],
        names=name,
        # The model is drawn over the measurement: both stay in sight where they agree.
        widths=4.0 if name == "measured" else 1.5,
        interpolation_mode=rr.components.InterpolationMode.StepAfter,
    )
    recording.log(entity, style, static=True)
    steps = np.append(values[known], values[known][-1])
    _send_instants(recording, entity, instants, clock, rr.Scalars.columns(scalars=steps))


def _send_bounces(recording: rr.RecordingStream, motion: Motion, throw: Throw, clock: Clock) -> None:
    """Contact points, marks in the height plot, sentences in the event log, lanes of flights."""
    impacts, colour = throw.bounces, COLOURS[motion.name]
    flights = _stretches(throw)
    times = np.array([impact.time_s for impact in impacts])
    names = list(dict.fromkeys(flights))
    shades = [mixed(colour, BLACK, 0.3 * (k % 2)) for k in range(len(names))]
    recording.log(f"phase/{motion.name}", rr.StateConfiguration(values=names, colors=shades), static=True)
    lanes = rr.StateChange.columns(state=flights)
    _send_instants(recording, f"phase/{motion.name}", _flight_begins(throw, clock), clock, lanes)
    if not impacts:
        return
    points = np.array([[*impact.point_m, 2e-4] for impact in impacts])
    known = np.isfinite(points).all(1)
    labels = [str(k) for k in np.flatnonzero(known) + 1]
    recording.log(
        f"world/{motion.name}/impacts",
        rr.Points3D(points[known], radii=-3.0, colors=[colour], labels=labels, show_labels=True),
        static=True,
    )
    recording.log(
        f"plots/height/bounces/{motion.name}",
        rr.SeriesPoints(colors=colour, markers="up", marker_sizes=4.0, names=f"{motion.name} bounce"),
        static=True,
    )
    _send_instants(
        recording, f"plots/height/bounces/{motion.name}", times, clock, rr.Scalars.columns(scalars=np.zeros(len(times)))
    )
    said = [f"{motion.name}: {bounce_sentence(k, impact)}" for k, impact in enumerate(impacts, 1)]
    log = rr.TextLog.columns(text=said, level=["INFO"] * len(said), color=[colour] * len(said))
    _send_instants(recording, f"events/{motion.name}", times, clock, log)


# On the picture


def _send_overlay(recording: rr.RecordingStream, solid: Solid, camera: Camera, motion: Motion) -> None:
    """Visible edges and corners on the film. The simulated die is drawn thinner, and on top."""
    drawn = outlines(solid, camera, motion.position_m, motion.quaternion)
    if not drawn:
        return
    top = motion.name == "simulated"
    image, order = "world/camera/image", 20.0 if top else 10.0
    silhouettes = [outline.silhouette_px for outline in drawn]
    inner = [outline.inner_px for outline in drawn]
    _send_lines(recording, f"{image}/silhouette/{motion.name}", motion, silhouettes, 0.5 if top else 1.8, order)
    _send_lines(recording, f"{image}/edges/{motion.name}", motion, inner, 0.4 if top else 1.2, order)
    _send_corners(recording, f"{image}/corners/{motion.name}", motion, drawn, 1.2 if top else 2.8, order)


def _send_lines(
    recording: rr.RecordingStream, entity: str, motion: Motion, lines_px: list[Array], radius: float, order: float
) -> None:
    style = rr.LineStrips2D.from_fields(colors=[COLOURS[motion.name]], radii=[-radius], draw_order=order)
    recording.log(entity, style, static=True)
    counts = [len(lines) for lines in lines_px]
    strips = rr.LineStrips2D.columns(strips=_viewer_px(np.concatenate(lines_px))).partition(counts)
    recording.send_columns(entity, _indexes(motion.frame, motion.time_s), strips)
    _send_clears(recording, entity, motion)


def _send_corners(
    recording: rr.RecordingStream, entity: str, motion: Motion, drawn: list[Outline], radius: float, order: float
) -> None:
    style = rr.Points2D.from_fields(colors=[COLOURS[motion.name]], radii=[-radius], draw_order=order)
    recording.log(entity, style, static=True)
    corners = [outline.corners_px for outline in drawn]
    points = rr.Points2D.columns(positions=_viewer_px(np.concatenate(corners))).partition([len(c) for c in corners])
    recording.send_columns(entity, _indexes(motion.frame, motion.time_s), points)
    _send_clears(recording, entity, motion)


def _viewer_px(points_px: Array) -> Array:
    """The viewer puts the first pixel's corner at the origin, the camera model its centre."""
    return points_px + 0.5


# Experiment against model


def _send_status(recording: rr.RecordingStream, track: Track) -> None:
    """What tracking knows, where that changes."""
    changes = np.flatnonzero(np.r_[True, track.status[1:] != track.status[:-1]])
    recording.log(
        "phase/tracking",
        rr.StateConfiguration(values=[TRACKED, LOST, ABSENT], colors=[MEASURED, SIMULATED, IMPACT]),
        static=True,
    )
    states = rr.StateChange.columns(state=[str(s) for s in track.status[changes]])
    recording.send_columns("phase/tracking", _indexes(track.frame[changes], track.time_s[changes]), states)


def _send_residuals(recording: rr.RecordingStream, record: Record) -> None:
    if record.simulated is None:
        return
    rest = residuals(record.track, record.simulated)
    index = _indexes(rest.frame, rest.time_s)
    for axis, colour, values in zip("xyz", AXIS_COLOURS, rest.position_mm.T, strict=True):
        entity = f"plots/residual/position_mm/{axis}"
        recording.log(entity, rr.SeriesLines(colors=colour, names=f"{axis} [mm]", widths=1.0), static=True)
        recording.send_columns(entity, index, rr.Scalars.columns(scalars=values))
    for entity, name, values in (
        ("angle_deg", "angle [°]", rest.rotation_deg),
        ("sigmas", "standard errors", rest.sigmas),
    ):
        recording.log(f"plots/residual/{entity}", rr.SeriesLines(colors=MEASURED, names=name, widths=1.0), static=True)
        recording.send_columns(f"plots/residual/{entity}", index, rr.Scalars.columns(scalars=values))


def _send_chi(recording: rr.RecordingStream, record: Record, clock: Clock) -> None:
    """The restitution of every bounce with its interval, and the fitted one as a line between its bounds."""
    _send_bounce_chi(recording, motion_of("measured", record.track, record.measured), clock)
    chi = _fitted_chi(record)
    if chi is None:
        return
    ends = np.array([0, len(clock.frame) - 1])
    for part, value, width in (("estimate", chi.value, 2.0), ("low", chi.low, 1.0), ("high", chi.high, 1.0)):
        if value is None:
            continue
        name = f"fitted χ = {number(value)}" if part == "estimate" else f"{part} end of its interval"
        style = rr.SeriesLines(colors=SIMULATED, names=name, widths=width)
        recording.log(f"plots/chi/{part}", style, static=True)
        columns = rr.Scalars.columns(scalars=[value, value])
        recording.send_columns(f"plots/chi/{part}", _indexes(clock.frame[ends], clock.time_s[ends]), columns)


def _send_bounce_chi(recording: rr.RecordingStream, motion: Motion, clock: Clock) -> None:
    parts = (
        ("bounce", "chi", "circle", 4.0),
        ("bounce_low", "chi_low", "up", 3.0),
        ("bounce_high", "chi_high", "down", 3.0),
    )
    for part, field, marker, size in parts:
        known = [impact for impact in motion.impacts if np.isfinite(getattr(impact, field))]
        if not known:
            continue
        style = rr.SeriesPoints(
            colors=COLOURS[motion.name], markers=marker, marker_sizes=size, names=f"{motion.name} {part}"
        )
        recording.log(f"plots/chi/{part}", style, static=True)
        values = rr.Scalars.columns(scalars=[getattr(impact, field) for impact in known])
        _send_instants(recording, f"plots/chi/{part}", [impact.time_s for impact in known], clock, values)
