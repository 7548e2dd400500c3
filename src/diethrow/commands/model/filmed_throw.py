"""A simulated throw as a clip: the images that a given camera would record, with the true motion.

The folder contains a scene file, the clip, an image of the empty table and the truth (`film_truth`). `frames.csv` states what
the camera did with each frame of the file: the picture that it shows, the gain, and the shift by a stabiliser. `diethrow analyze
DIR/scene.toml` analyses it, and `benchmarks/tracker.py` compares the analysis with the truth.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ...files.csv_and_json import write_table
from ...files.outputs import whole_folder
from ...files.plan import Plan
from ...files.provenance import Stopwatch, write_provenance
from ...files.scene import Scene
from ...files.settings import refuse
from ...model.die import MAX_CORNER_RADIUS_FRACTION, Die
from ...model.errors import InputError
from ...model.laws import CoulombImpact, SmoothImpact
from ...model.rotations import continuous_sign, quat_from_rotvec, quat_multiply
from ...model.throw import State, Throw, Until, throw_die
from ...model.world import GRAVITY_M_S2
from ...replay.render import (
    Aperture,
    Appearance,
    Codec,
    FilmRenderer,
    FixedPattern,
    FrameFaults,
    Processing,
    Processor,
    RenderSettings,
    Sensor,
    Shutter,
    expose,
    filtered,
    fixed_pattern,
    frame_light,
    gains,
    lamp_beside,
    rounded,
    shifts_px,
    shown_pictures,
    write_film,
)
from ...tracking.camera import Camera
from ...tracking.footage import Response, grey_of, is_linear
from .film_settings import MAX_FRAMES, USUAL_SETTINGS, FilmSettings
from .film_truth import write_truth

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

EXPOSURE_S = 2e-4
"""Default exposure without a scene: half a pixel of blur at 2 m/s and 1.3 px/mm, a tenth of a disturbing blur."""
FIELD_OF_VIEW_RAD = 0.15
"""Field of view without a scene: a lens of 100 mm on a sensor of 15 mm."""
DEPRESSION_RAD = np.radians(28.0)
"""Angle below the horizontal at which the camera points, without a scene."""
HEADING_RAD = np.radians(20.0)
"""Heading of the camera from the y axis, without a scene: no face of a die at rest is seen edge-on."""
AFTER_LANDING_S = 0.05
"""Time that a film continues after the landing face is decided, to show the die come to rest."""
BACKGROUND_EXPOSURES = 16
"""Exposures of the empty table whose mean is the background, so that it has little noise."""
MEDIUM_LIGHT = 0.3
"""Light of a pixel of medium brightness, as a share of full scale."""
POSE = ("x", "y", "z", "qw", "qx", "qy", "qz")
FRAME_COLUMNS = ("frame", "picture", "t", "gain", "shift_x_px", "shift_y_px", "fault")
"""Of `frames.csv`; `picture` counts those that the camera took, at t = picture / fps."""
SECOND_DIE_RADII = (2.6, 3.2, 4.0, 5.0)
"""Distances between the releases of two dice, in circumscribed radii, of which the nearest is taken that keeps them apart."""
SECOND_DIE_TURN = np.array([0.9, -0.7, 0.4])
"""[rad] rotation vector from the first die to the second at their release: they show different faces."""
SECOND_DIE_SIDES = 12
"""Directions from the first die to the second that are tried."""
APART_RADII = 2.05
"""Least distance of two dice in circumscribed radii: at 2 their corners could touch."""


@dataclass(frozen=True, eq=False)
class _Understood:
    """The settings of a film in its provenance."""

    plan: Plan
    settings: FilmSettings
    camera: Camera


@dataclass(frozen=True, eq=False)
class FilmJob:
    """Everything that determines a clip."""

    name: str
    throw: Throw
    law: SmoothImpact | CoulombImpact
    die: Die
    camera: Camera
    surface: str
    fps: float
    exposure_s: float
    frames: int
    appearance: Appearance
    sensor: Sensor
    response: Response = None
    blur_px: float = 0.6
    rendering: RenderSettings = field(default_factory=RenderSettings)
    seed: int = 1
    """Seed of noise, light paths and faults."""
    readout_s: float = 0.0
    aperture: Aperture = field(default_factory=Aperture)
    codec: Codec = field(default_factory=Codec)
    processing: Processing = field(default_factory=Processing)
    faults: FrameFaults = field(default_factory=FrameFaults)
    second: Throw | None = None
    """The throw of a second die."""

    @property
    def clip_name(self) -> str:
        """Of the film's file."""
        return f"clip{self.codec.suffix}"

    @property
    def throws(self) -> tuple[Throw, ...]:
        """Those of all dice."""
        return (self.throw,) if self.second is None else (self.throw, self.second)

    @property
    def shown(self) -> NDArray[np.int64]:
        """(n,) number of the camera's picture that each frame of the file shows."""
        return shown_pictures(self.faults, self.frames, self.seed)


def film(
    plan: Plan,
    out: Path,
    *,
    scene: Scene | None = None,
    settings: FilmSettings = USUAL_SETTINGS,
    force: bool = False,
    progress: Progress = lambda stage, done, total: None,
    command: tuple[str, ...] = (),
) -> FilmJob:
    """Simulate the throw of a plan and write its film to the folder `out`.

    The scene gives the camera, its rate, exposure and response, the table's surface and the marks of the die. Without a scene the
    camera is placed so that the throw stays in view. Raises SceneError for a scene without a camera or with another die,
    NoRendererError without Mitsuba, OutputExistsError if the folder exists (unless `force`). After an error no folder
    remains.
    """
    watch = Stopwatch()
    inputs = (*plan.inputs, *((scene.path,) if scene else ()))
    with whole_folder(out, force=force, inputs=inputs) as folder:
        with watch.stage("throw"):
            job = film_job(plan, scene, settings, Path(out).name)
            if plan.mesh_path is not None:
                shutil.copyfile(plan.mesh_path, folder / plan.mesh_path.name)
        with watch.stage("film"):
            write_clip(folder, job, progress)
        write_provenance(
            folder,
            command=command,
            understood=_Understood(plan, settings, job.camera),
            inputs=inputs,
            seconds=watch.seconds,
            seeds={"film": settings.seed},
        )
    return job


def film_job(plan: Plan, scene: Scene | None, settings: FilmSettings, name: str) -> FilmJob:
    """Simulate the throw and determine all settings that were left open. Raises SceneError as `film` does."""
    fps = settings.fps or (scene.clip.fps if scene and scene.clip.fps else plan.fps)
    exposure_s, readout_s = _shutter_times(scene, settings, fps)
    plan = replace(plan, die=_die(plan, scene, settings))
    throw, frames = _throw_on_film(plan, fps, settings)
    times = np.arange(frames) / fps
    camera = _scene_camera(scene, plan) if scene else camera_for(throw, plan.die, times, settings.size_px)
    return FilmJob(
        name=name,
        throw=throw,
        law=plan.law,
        die=plan.die,
        camera=camera,
        surface=scene.table.surface if scene else plan.table.surface,
        fps=fps,
        exposure_s=exposure_s,
        readout_s=readout_s,
        frames=frames,
        appearance=_appearance(plan.die, camera, settings),
        sensor=settings.sensor,
        response=settings.response if settings.response is not None or scene is None else scene.clip.response,
        blur_px=settings.blur_px,
        aperture=settings.aperture(_die_distance_m(throw, camera)),
        codec=settings.stored_as,
        processing=settings.processing,
        faults=settings.faults,
        second=second_throw(plan, throw, camera, times) if settings.second_die else None,
        rendering=settings.rendering,
        seed=settings.seed,
    )


def _shutter_times(scene: Scene | None, settings: FilmSettings, fps: float) -> tuple[float, float]:
    """Exposure and readout [s]. Raises ValueError for one that is longer than the time between two frames."""
    interval_s = 1.0 / fps
    exposure_s, readout_s = settings.exposure_s, settings.readout_s
    if exposure_s is None and settings.exposure_share is not None:
        exposure_s = settings.exposure_share * interval_s
    if readout_s is None and settings.readout_share is not None:
        readout_s = settings.readout_share * interval_s
    exposure_s = exposure_s or (scene.clip.exposure_s if scene else None) or min(EXPOSURE_S, interval_s)
    if readout_s is None:
        readout_s = scene.clip.readout_s if scene else 0.0
    for name, value in (("exposure_s", exposure_s), ("readout_s", readout_s)):
        if value > interval_s * (1.0 + 1e-9):
            raise InputError(f"{name} = {value}: wanted at most the {interval_s:.4g} s between two frames")
    return exposure_s, readout_s


def _die(plan: Plan, scene: Scene | None, settings: FilmSettings) -> Die:
    """The die of the plan with the marks of the scene, rounded and marked as the settings ask for."""
    die, marks = plan.die, plan.die.marks or (scene.die.marks if scene else None)
    if settings.mark_depth > 0 and marks is None:
        marks = "pips" if die.solid.name == "cube" else "numbers"
    radius_m = settings.corner_radius_m
    if radius_m is None and settings.corner_radius_share is not None:
        radius_m = settings.corner_radius_share * die.solid.inradius
    if radius_m is None:
        radius_m = die.corner_radius_m
    most = MAX_CORNER_RADIUS_FRACTION * die.solid.inradius
    if radius_m > most:
        raise InputError(
            f"corner_radius_m = {radius_m}: wanted at most {most:.4g}, {MAX_CORNER_RADIUS_FRACTION:g} inscribed radii"
        )
    return die.with_corner_radius(radius_m).with_marks(marks)


def _appearance(die: Die, camera: Camera, settings: FilmSettings) -> Appearance:
    """Light and surfaces as the settings ask for."""
    given = {
        name: getattr(settings, name) for name in ("roughness", "lamp_side_m") if getattr(settings, name) is not None
    }
    return Appearance(
        lamp_beside(camera),
        seed=settings.seed,
        speckle=settings.speckle,
        translucency=settings.translucency,
        mark_depth_m=settings.mark_depth * die.solid.edge_m,
        stretch=settings.stretch,
        **given,
    )


def _die_distance_m(throw: Throw, camera: Camera) -> float:
    """Distance along the axis of the camera at the first impact, or at the end of a throw without one."""
    at_s = throw.impacts[0].time_s if throw.impacts else throw.flights[-1].end_s
    position = throw.poses(np.array([at_s if np.isfinite(at_s) else 0.0]))[0][0]
    return float(camera.rotation[2] @ position + camera.translation_m[2])


def second_throw(plan: Plan, throw: Throw, camera: Camera, times_s: Array) -> Throw:
    """The throw of an equal die, released beside the first with the same velocity, turned, that never touches the first.

    Of all directions the one is taken in which it is in view for most of the time. Raises ValueError if all dice would meet.
    """
    first, size = throw.flights[0].start, plan.die.solid.circumradius
    positions = throw.poses(times_s)[0]
    turned = quat_multiply(quat_from_rotvec(SECOND_DIE_TURN), first.quaternion)
    for distance in SECOND_DIE_RADII:
        found: list[tuple[float, Throw]] = []
        for angle in 2.0 * np.pi * np.arange(SECOND_DIE_SIDES) / SECOND_DIE_SIDES:
            beside = first.position_m + distance * size * np.array([np.cos(angle), np.sin(angle), 0.0])
            beside[2] = max(beside[2], size * 1.01)  # whichever corner points down
            release = replace(first, position_m=beside, quaternion=turned)
            other = throw_die(
                plan.die,
                release,
                plan.law,
                until=Until(time_s=float(times_s[-1]) + AFTER_LANDING_S),
                table=plan.model_table,
                drag_per_m=plan.drag_per_m,
            ).throw
            there = other.poses(times_s)[0]
            if np.linalg.norm(there - positions, axis=1).min() > APART_RADII * size:
                seen = camera.project(there)
                inside = (seen >= 0).all(1) & (seen <= [camera.width_px - 1, camera.height_px - 1]).all(1)
                found.append((float(inside.mean()), other))
        if found:
            return max(found, key=lambda each: each[0])[1]
    raise InputError("second_die: every throw beside the first meets it; film a shorter part of the throw, with frames")


def _throw_on_film(plan: Plan, fps: float, settings: FilmSettings) -> tuple[Throw, int]:
    """The throw from the beginning of the film to its end, and the number of frames."""
    motion = plan.table.motion
    if motion is not None and motion.amplitude_m > 0:
        raise refuse(plan.path, "table.motion.amplitude_m", motion.amplitude_m, "films need a table at rest, wanted 0")
    release, frames = _release_at(plan, settings.start_s), settings.frames
    until_s = None if plan.until_s is None else plan.until_s - settings.start_s
    until = Until(time_s=until_s, impacts=plan.until_impacts)
    if frames is not None:
        until = Until(time_s=frames / fps)
    table, drag_per_m = plan.model_table, plan.drag_per_m
    throw = throw_die(plan.die, release, plan.law, until=until, table=table, drag_per_m=drag_per_m).throw
    end_s = throw.flights[-1].end_s
    if until == Until():
        end_s += AFTER_LANDING_S
        until = Until(time_s=end_s)
        throw = throw_die(plan.die, release, plan.law, until=until, table=table, drag_per_m=drag_per_m).throw
    count = frames or int(np.floor(end_s * fps + 1e-9)) + 1
    if count > MAX_FRAMES:
        wanted = f"the throw lasts {end_s:.3g} s, {count} frames; wanted at most {MAX_FRAMES}, set until.time_s"
        raise refuse(plan.path, "output.fps", fps, wanted)
    return throw, count


def _release_at(plan: Plan, start_s: float) -> State:
    """The state at the beginning of the film, as a release at time 0. Raises ValueError after the first impact."""
    if start_s == 0.0:
        return plan.release
    first = throw_die(
        plan.die,
        plan.release,
        plan.law,
        until=Until(impacts=1),
        table=plan.model_table,
        drag_per_m=plan.drag_per_m,
    ).throw
    impact_s = first.impacts[0].time_s if first.impacts else first.flights[0].end_s
    if start_s >= impact_s:
        raise InputError(f"start_s = {start_s}: wanted a time before the first impact at {impact_s:.5g} s")
    return replace(first.flights[0].at(start_s), time_s=0.0)


def _scene_camera(scene: Scene, plan: Plan) -> Camera:
    """The scene's first camera. Raises SceneError if it has none, or another die than the plan."""
    if not scene.cameras:
        raise refuse(scene.path, "camera", None, "wanted a [camera] table, whose camera films the throw")
    if scene.die.solid.name != plan.die.solid.name:
        wanted = f"the throw file has a {plan.die.solid.name}; wanted the same die in both"
        raise refuse(scene.path, "die.shape", scene.die.solid.name, wanted)
    return scene.cameras[0].camera


def camera_for(throw: Throw, die: Die, times_s: Array, size_px: int = 512) -> Camera:
    """A camera above the table that keeps the die in view from its first impact on.

    It also shows as much of the fall as possible without more than twice the distance.
    """
    first = throw.impacts[0].time_s if throw.impacts else float(times_s[-1])
    low, high = _extent(throw, die, times_s[times_s >= first] if (times_s >= first).any() else times_s)
    target = (low + high) / 2
    reach = float(np.linalg.norm(high - low)) / 2
    whole_low, whole_high = _extent(throw, die, times_s)
    wanted = min(float(np.linalg.norm(whole_high - whole_low)) / 2, 2.0 * reach)
    if wanted > reach:
        target = np.array([target[0], target[1], low[2] + wanted * (target[2] - low[2]) / reach])
        reach = wanted
    ahead = np.array([np.sin(HEADING_RAD), np.cos(HEADING_RAD), 0.0]) * np.cos(DEPRESSION_RAD)
    ahead[2] = -np.sin(DEPRESSION_RAD)
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    rotation = np.array([right, np.cross(ahead, right), ahead])
    focal = size_px / 2 / np.tan(FIELD_OF_VIEW_RAD / 2)
    middle = (size_px - 1) / 2
    matrix = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    centre = target - reach / np.tan(FIELD_OF_VIEW_RAD / 2) * ahead
    return Camera(size_px, size_px, matrix, np.zeros(5), rotation, -rotation @ centre)


def _extent(throw: Throw, die: Die, times_s: Array) -> tuple[Array, Array]:
    """The lowest and the highest corner (3,) of the box that contains the die at these times."""
    positions = throw.poses(times_s)[0]
    size = die.solid.circumradius
    return positions.min(0) - size, positions.max(0) + size


# --- writing ---


def write_clip(folder: Path, job: FilmJob, progress: Progress = lambda stage, done, total: None) -> None:
    """Write the clip with its scene, background and truth into an existing folder."""
    renderer = FilmRenderer(
        job.die,
        job.camera,
        job.surface,
        job.appearance,
        blur_px=job.blur_px,
        aperture=job.aperture,
        dice=len(job.throws),
        rendering=job.rendering,
    )
    pattern = fixed_pattern(job.sensor, job.camera.height_px, job.camera.width_px)
    progress("Lighting the table", 0, 0)
    cv2.imwrite(str(folder / "background.png"), _background(job, pattern, renderer.empty()))
    write_film(folder / job.clip_name, _frames(renderer, job, pattern, progress), job.codec, job.sensor.bit_depth)
    (folder / "scene.toml").write_text(scene_text(job, job.clip_name), encoding="utf-8")
    times_s = job.shown / job.fps
    write_truth(folder, job.throw, job.die, job.camera, job.law, job.fps, len(times_s), times_s)
    write_table(folder / "frames.csv", FRAME_COLUMNS, _frame_rows(job))
    if job.second is not None:
        write_table(folder / "second_die.csv", ("frame", "t", *POSE), _pose_rows(job.second, times_s))


def _frames(renderer: FilmRenderer, job: FilmJob, pattern: FixedPattern, progress: Progress) -> Iterator[NDArray]:
    """The frames of the file, as the camera records and processes them."""
    rng = np.random.default_rng([job.seed, 1])
    times, shown = np.arange(job.frames) / job.fps, job.shown
    gain, shift_px = gains(job.processing, job.frames), shifts_px(job.processing, job.frames, job.seed)
    processor = Processor(job.processing, _noise_levels(job))
    shutter = Shutter(job.exposure_s, job.readout_s)
    for k, light in enumerate(frame_light(renderer, job.throws, times, shutter)):
        progress("Filming", k + 1, job.frames)
        levels = expose(job.sensor, pattern, filtered(gain[k] * light, job.processing), rng)
        picture = rounded(job.sensor, processor.levels(_stored(job, levels), shift_px[k]))
        for _ in range(int((shown == k).sum())):
            yield picture


def _background(job: FilmJob, pattern: FixedPattern, light: Array) -> NDArray:
    """The mean of BACKGROUND_EXPOSURES exposures of the empty table, processed as a frame."""
    rng = np.random.default_rng([job.seed, 2])
    light = filtered(light, job.processing)
    exposures = [expose(job.sensor, pattern, light, rng) for _ in range(BACKGROUND_EXPOSURES)]
    processor = Processor(job.processing, _noise_levels(job))
    return rounded(job.sensor, processor.levels(_stored(job, np.mean(exposures, 0)), np.zeros(2)))


def _noise_levels(job: FilmJob) -> float:
    """Standard deviation [grey levels] of the noise of a pixel of medium brightness, which noise reduction assumes."""
    electrons = MEDIUM_LIGHT * job.sensor.full_well_e
    return float(np.sqrt(electrons + job.sensor.read_noise_e**2) * job.sensor.top / job.sensor.full_well_e)


def _frame_rows(job: FilmJob) -> Iterable[Sequence[Any]]:
    """What the camera did with each frame of the file."""
    gain, shift_px = gains(job.processing, job.frames), shifts_px(job.processing, job.frames, job.seed)
    before = -1
    for frame, picture in enumerate(job.shown.tolist()):
        fault = "repeated" if picture == before else "after a gap" if picture > before + 1 else ""
        yield (frame, picture, picture / job.fps, float(gain[picture]), *shift_px[picture].tolist(), fault)
        before = picture


def _pose_rows(throw: Throw, times_s: Array) -> Iterable[Sequence[Any]]:
    """Frame, time and pose."""
    positions, quaternions = throw.poses(times_s)
    for k, (position, quaternion) in enumerate(zip(positions, continuous_sign(quaternions), strict=True)):
        yield (k, float(times_s[k]), *position.tolist(), *quaternion.tolist())


def recorded(job: FilmJob, levels: Array) -> NDArray:
    """Whole grey levels (height, width) from those of the linear sensor, after the camera's response."""
    return rounded(job.sensor, _stored(job, levels))


def _stored(job: FilmJob, levels: Array) -> Array:
    """The same before rounding; levels of a response other than linear are clipped to full scale."""
    if is_linear(job.response):
        return levels
    return np.asarray(job.sensor.top * grey_of(np.clip(levels / job.sensor.top, 0.0, 1.0), job.response))


def scene_text(job: FilmJob, clip: str) -> str:
    """The scene file of this clip."""
    response = "" if is_linear(job.response) else f"response = {json.dumps(job.response)}\n"
    readout = f"readout_s = {float(job.readout_s)!r}\n" if job.readout_s else ""
    gravity_m_s2 = job.throw.flights[0].gravity_m_s2
    world = f"\n[world]\ngravity_m_s2 = {gravity_m_s2!r}\n" if gravity_m_s2 != GRAVITY_M_S2 else ""
    return f"""# {job.name}: a simulated throw, rendered as filmed at {job.fps:g} frames per second.

[clip]
path = "{clip}"
fps = {float(job.fps)!r}
fps_sigma = 0.0
exposure_s = {float(job.exposure_s)!r}
background = "background.png"
{readout}{response}
{scene_tables(job.camera, job.surface, job.die)}{world}"""


def scene_tables(camera: Camera, surface: str, die: Die) -> str:
    """The tables of a scene file that describe camera, table and die, all of them known exactly."""
    radius = f"corner_radius_m = {die.corner_radius_m!r}\n" if die.corner_radius_m else ""
    is_stated = die.is_spherical_top and not die.is_homogeneous
    inertia = f"inertia_kg_m2 = {die.inertia_kg_m2!r}\n" if is_stated else ""
    marks = f'marks = "{die.marks}"\n' if die.marks else ""
    dimensions = "".join(f"{name} = {value!r}\n" for name, value in die.solid.dimensions.items())
    return f"""[camera]
width = {camera.width_px}
height = {camera.height_px}
matrix = {camera.matrix.tolist()}
distortion = {camera.distortion.tolist()}
rotation = {camera.rotation.tolist()}
translation_m = {camera.translation_m.tolist()}
calibration = "exact"

[table]
surface = "{surface}"

[die]
shape = "{die.solid.name}"
{dimensions}edge_sigma_m = 0.0
mass_kg = {die.mass_kg!r}
{inertia}{radius}{marks}"""
